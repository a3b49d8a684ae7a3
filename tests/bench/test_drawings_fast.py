"""What makes drawings faster changes no pixel of them."""

import numpy as np
import pandas as pd
import pytest
from matplotlib import rc_context
from matplotlib.backends import backend_agg
from matplotlib.figure import Figure
from matplotlib.image import imread

from calibench import bench, optimizers, problems
from calibench.bench.report.shared import artists, drawing
from calibench.bench.report.study import figures
from calibench.bench.statistics import tables
from calibench.bench.store.runs import ResultStore


def _two_panels(high=3e4):
    """Two panels that share a logarithmic axis; their other axes are logarithmic over 20 decades, and linear."""
    with rc_context(drawing.STYLE):
        figure = Figure(figsize=(9.0, 2.5), layout="constrained")
        left, right = figure.subplots(1, 2, sharex=True)
        x = np.geomspace(1, high, 30)
        left.plot(x, x**-4.0)
        right.plot(x, np.log(x))
        left.set(xscale="log", yscale="log", xlabel="charged evaluations", ylabel="error")
    return figure, pd.DataFrame({"x": x})


def _written(folder, high):
    return [path.read_bytes() for path in drawing.save("two", _two_panels(high), folder)]


@pytest.mark.parametrize("high", [3e4, pytest.param(3.0, marks=pytest.mark.slow)])
def test_joined_minor_ticks_are_the_same_pixels(tmp_path, monkeypatch, high):
    svg, png, _ = _written(tmp_path / "joined", high)
    monkeypatch.setattr(artists, "join_minor_ticks", lambda figure: None)
    apart_svg, apart_png, _ = _written(tmp_path / "apart", high)
    assert png == apart_png
    assert svg != apart_svg  # the mark of a tick is another element: the test sees the joined ones


def test_layout_and_png_measure_texts_once(tmp_path, monkeypatch):
    made = []

    class Counted(backend_agg.RendererAgg):
        def __init__(self, *size):
            made.append(size)
            super().__init__(*size)

    monkeypatch.setattr(backend_agg, "RendererAgg", Counted)
    _written(tmp_path, 3e4)
    assert len(made) == 1


def test_minor_ticks_are_drawn():
    figure, _ = _two_panels()
    with rc_context(drawing.STYLE):
        artists.join_minor_ticks(figure)
        figure.draw_without_rendering()
    marks = [line for line in figure.axes[1].lines if type(line).__name__ == "_MinorTicks"]
    assert len(marks) == 1
    assert np.asarray(marks[0].get_xdata()).size >= 30


def test_minor_ticks_with_labels_stay():
    figure, _ = _two_panels(high=3.0)
    with rc_context(drawing.STYLE):
        artists.join_minor_ticks(figure)
        figure.draw_without_rendering()
    assert any(tick.label1.get_text() for tick in figure.axes[0].xaxis.get_minor_ticks())


def test_within_a_report_a_problem_is_made_once():
    row = {"problem": "full11", "problem_options": '{"error":"J2"}'}
    with tables.problems_made_once():
        assert tables.problem_of(row) is tables.problem_of(row)
    assert tables.problem_of(row) is not tables.problem_of(row)


def test_long_names_beside_an_axis_are_within_the_picture(tmp_path):
    figure = Figure(figsize=(6.2, 3.8), layout="constrained")
    axes = figure.subplots()
    axes.plot([1, 2, 3], range(3))
    names = ["nlopt_GN_CRS2_LM (population=40)  3/3", "pygmo_cmaes (population=10)  1/3", "de  0/3"]
    axes.set_yticks(range(3), names, fontsize=7.5)
    _, png, _ = drawing.save("names", (figure, pd.DataFrame({"k": [1]})), tmp_path)
    picture = imread(png)[:, :, :3]
    assert (picture[:, :3] == 1.0).all()
    assert (picture[:, :30] < 0.5).any()  # and they are there


def test_long_names_of_methods_stand_beside_the_field(tmp_path):
    store = ResultStore(tmp_path / "study")
    store.open()
    for name in ("mine.py:" + 10 * "Walker", "de"):
        problem, own = problems.make("sensor_zero"), optimizers.make("de", population=10)
        store.write(bench.execute(problem, own, budget=40, optimizer_name=name))
    _, png, _ = drawing.save("field", figures.overview(store.runs()), tmp_path)
    picture = imread(png)[:, :, :3]
    assert (picture[:, :3] == 1.0).all()
    assert (picture[:, :100] < 0.5).any()
