"""`calibench.plot`: the drawings of the pages in axes of one's own, their numbers, and what a notebook shows."""

import importlib
import inspect
import json
import re
import shutil
import sys
import warnings
from pathlib import Path
from types import ModuleType, SimpleNamespace

import matplotlib
import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

import calibench
from calibench import bench, optimizers, plot, problems
from calibench.bench.cli import main
from calibench.bench.report.study import figures
from calibench.bench.statistics.fixed_target import ert, performance_profile

OF_RUNS = ("convergence", "ecdf", "profile", "heatmap")
PACKAGES = ("", ".bench", ".problems", ".optimizers", ".discrepancy", ".testing", ".plot")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A study of two problems that prefer different starts, and three methods."""
    results = tmp_path_factory.mktemp("results")
    words = ["problem=sensor_zero,full11", "optimizer=lm,trf,de", "budget=300", "seeds=2"]
    calibench.sweep(*words, f"results={results}", "study=two")
    return results / "two"


@pytest.fixture(scope="module")
def rows(folder):
    return bench.ResultStore(folder).runs()


def lines_of(axes):
    return {line.get_label(): line for line in axes.get_lines() if not line.get_label().startswith("_")}


@pytest.mark.parametrize("name", OF_RUNS)
def test_a_store_its_path_and_its_table_give_the_same_numbers(name, folder, rows):
    data = getattr(plot, name).data
    numbers = data(folder, problem="full11")
    assert len(numbers)
    for source in (str(folder), bench.ResultStore(folder), rows):
        pd.testing.assert_frame_equal(data(source, problem="full11"), numbers)


@pytest.mark.parametrize("name", OF_RUNS)
def test_a_drawing_is_in_the_axes_that_were_given_or_in_a_figure_of_its_own(name, folder):
    import matplotlib.pyplot as plt

    before = dict(matplotlib.rcParams)
    draw = getattr(plot, name)
    figure = Figure()
    ours, mine = figure.subplots(1, 2)
    assert draw(folder, ours, problem="full11") is ours
    assert not mine.has_data()
    own = draw(folder, problem="full11")
    assert own.figure is not figure
    if name == "heatmap":  # what a notebook shows of the axes is made by one method for all
        assert own._repr_png_().startswith(b"\x89PNG")
    assert plt.get_fignums() == []
    assert dict(matplotlib.rcParams) == before


def test_lines_of_convergence_are_its_numbers_and_those_of_the_page(folder, rows):
    numbers = plot.convergence.data(folder)
    assert set(numbers["problem"]) == {"sensor_zero", "full11"}
    mine = rows[rows["problem"] == "full11"]
    page, drawn = figures.convergence(mine, bench.ResultStore(folder).traces())
    axes = plot.convergence(folder, problem="full11")
    assert set(lines_of(axes)) == {"lm", "trf", "de"}
    for method, line in lines_of(axes).items():
        told = numbers[(numbers["problem"] == "full11") & (numbers["method"] == method)]
        assert np.array_equal(line.get_ydata(), told["median"], equal_nan=True)
        assert np.array_equal(told["median"], drawn.loc[drawn["method"] == method, "median"], equal_nan=True)
        assert np.array_equal(line.get_ydata(), lines_of(page.axes[0])[method].get_ydata(), equal_nan=True)


def test_a_method_whose_start_the_problem_decides_is_one(folder):
    """sensor_zero begins at its nominal start and full11 at random ones: that makes no second method."""
    numbers = plot.ecdf.data(folder)
    assert set(numbers["method"]) == {"lm", "trf", "de"}
    assert set(numbers["problems"]) == {2}
    assert set(plot.heatmap.data(folder)["method"]) == {"lm", "trf", "de"}


def test_the_profile_is_that_of_the_expected_running_times(folder, rows):
    numbers = plot.profile.data(folder)
    store = bench.ResultStore(folder)
    from calibench.bench.statistics.targets import levels_of

    hits = store.hits(levels_of(rows))
    told = performance_profile(ert(hits[hits["quantity"] == "gap"], rows))
    assert sorted(numbers["share"]) == sorted(told["share"])
    assert set(numbers["tasks"]) == {2 * 51}
    for method, line in lines_of(plot.profile(folder)).items():
        ends = numbers.loc[numbers["method"] == method, "share"].max()
        assert line.get_ydata()[-1] == ends


def test_of_several_problems_one_has_to_be_chosen_for_a_convergence(folder):
    with pytest.raises(ValueError, match="there are 2: problem="):
        plot.convergence(folder)
    with pytest.raises(ValueError, match="did you mean 'full11'"):
        plot.ecdf(folder, problem="full1")


def test_a_name_that_is_among_the_choices_is_that_one_problem(rows):
    mine = rows[rows["problem"] == "sensor_zero"]
    own = [mine.assign(problem="own.py:Bowl", problem_options=text) for text in ("{}", '{"readings": 60}')]
    both = pd.concat([one.assign(run_id=one["run_id"] + str(i)) for i, one in enumerate(own)], ignore_index=True)
    assert set(plot.heatmap.data(both, problem="own.py:Bowl")["problem_options"]) == {"{}"}
    assert set(plot.heatmap.data(both, problem="Bowl")["problem_options"]) == {"{}", '{"readings": 60}'}


def test_a_method_has_one_look_in_all_drawings_of_one_source(folder):
    figure = Figure()
    axes = figure.subplots(1, 4)
    plot.convergence(folder, axes[0], problem="full11")
    plot.convergence(folder, axes[1], problem="sensor_zero")
    plot.ecdf(folder, axes[2])
    plot.profile(folder, axes[3])
    looks = [
        {method: (line.get_color(), line.get_linestyle()) for method, line in lines_of(one).items()} for one in axes
    ]
    assert len(set(looks[0].values())) == 3
    assert all(look == looks[0] for look in looks[1:])
    assert list(looks[0]) != list(looks[3])  # though each lists them in an order of its own


def test_the_best_value_of_a_run_is_drawn_as_the_steps_that_it_is():
    run = bench.execute(problems.make("sensor_zero"), optimizers.make("de"), budget=60)
    line = lines_of(plot.convergence(run))["de"]
    assert line.get_drawstyle() == "steps-post"
    held = run.trace["best_value"].to_numpy()[np.searchsorted(run.trace["charged"], line.get_xdata(), side="right") - 1]
    assert np.array_equal(line.get_ydata(), held)


def test_all_numbers_call_a_method_alike_and_how_it_ends_stands_beside_it(folder):
    field = plot.heatmap.data(folder)
    assert set(field["method"]) == set(plot.ecdf.data(folder)["method"]) == {"lm", "trf", "de"}
    assert set(zip(field["label"], field["ends"])) == {("lm · stops", "stops"), ("trf · stops", "stops"), ("de", "")}


def apart(texts):
    """Tell whether no two texts cover each other."""
    boxes = [text.get_window_extent() for text in texts]
    return not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


@pytest.mark.parametrize("layout", ["constrained", None])
def test_names_and_numbers_in_small_axes_do_not_cover_each_other(rows, layout):
    more = [rows.assign(data_id=f"{i}", run_id=rows["run_id"] + f"{i}") for i in range(6)]
    more += [
        one[one["optimizer"] != "lm"].assign(optimizer=one["optimizer"] + f"_{i}", run_id=one["run_id"] + f" {i}")
        for i in range(4)
        for one in more
    ]
    many = pd.concat(more, ignore_index=True)
    figure = Figure(figsize=(15, 4), layout=layout)
    _, field, ranked = figure.subplots(1, 3)
    plot.heatmap(many, field)
    plot.ranks(many, ranked)
    figure.canvas.draw()
    assert len(field.get_xticklabels()) == 12
    assert apart(field.get_xticklabels())
    assert apart(ranked.get_xticklabels())
    assert len(ranked.get_xticklabels()) > 2
    assert apart(ranked.texts)


def test_a_table_that_does_not_know_its_traces_says_what_to_give(folder, rows):
    alone = rows.copy()
    alone.attrs.clear()
    with pytest.raises(ValueError, match=r"traces=store\.traces\(\)"):
        plot.ecdf(alone)
    traces = bench.ResultStore(folder).traces()
    pd.testing.assert_frame_equal(plot.ecdf.data(alone, traces=traces), plot.ecdf.data(folder))
    with pytest.raises(ValueError, match="no table of runs"):
        plot.heatmap(traces)
    with pytest.raises(ValueError, match="there is no run to draw"):
        plot.heatmap(rows.iloc[:0])
    with pytest.raises(TypeError, match="runs are needed, not int"):
        plot.heatmap([1, 2])


def test_runs_that_were_never_stored_are_drawn_too():
    made = [
        bench.execute(problems.make("sensor_zero"), optimizers.make(name), budget=60, seed=seed)
        for name in ("lm", "de")
        for seed in range(2)
    ]
    assert set(lines_of(plot.convergence(made))) == {"lm", "de"}
    assert set(lines_of(plot.convergence(made[0]))) == {"lm"}
    assert set(plot.ecdf.data(made)["method"]) == {"lm", "de"}


def test_ranks_are_drawn_where_there_is_a_test_and_else_say_why_not(folder, rows):
    with pytest.raises(ValueError, match="needs 10 blocks"):
        plot.ranks(folder)
    many = pd.concat([rows.assign(data_id=f"{i}", run_id=rows["run_id"] + f"{i}") for i in range(6)], ignore_index=True)
    numbers = plot.ranks.data(many)
    assert numbers["mean_rank"].is_monotonic_increasing
    axes = plot.ranks(many)
    said = [text.get_text().strip() for text in axes.texts]
    for method, rank in zip(numbers["method"], numbers["mean_rank"]):
        assert f"{method}  {rank:.2f}" in said


def test_names_of_a_ranking_stand_within_its_axes():
    from calibench.bench.report.study.figures import draw_ranks
    from calibench.bench.statistics.ranking import Blocks, friedman

    names = ("lm", "nlopt_LD_TNEWTON_PRECOND_RESTART", "de", "nlopt_GN_DIRECT_L_RAND_NOSCAL", "pygmo_cmaes")
    ranked = friedman(Blocks(names, np.random.default_rng(0).normal(size=(20, 5)) + np.arange(5)))
    figure = Figure(figsize=(10, 3))
    axes = figure.subplots()
    draw_ranks(axes, ranked)
    figure.canvas.draw()
    frame = axes.get_window_extent()
    for text in axes.texts:
        box = text.get_window_extent()
        assert frame.x0 <= box.x0
        assert box.x1 <= frame.x1


@pytest.fixture(scope="module")
def report():
    return calibench.discover("gpm2002", "demo_backlash")


def test_a_discovery_shows_the_residual_before_and_after_and_the_gap(report):
    means = plot.discovery.data(report)
    assert means["after"].abs().max() < 0.2 * means["before"].abs().max()
    axes = plot.discovery(report)
    drawn = {bars.get_label().partition(":")[0]: bars for bars in axes.containers}
    for when in ("before", "after"):
        assert np.allclose(drawn[when].lines[0].get_ydata(), means[when])
    assert drawn["before"].get_label() == f"before: {report.gap.held_out_before:.2f}"
    gap = plot.discovery.data(report, show="gap")
    assert gap["rms"].tolist() == [report.gap.held_out_before, report.gap.held_out_after]
    bars = [bar for bars in plot.discovery(report, show="gap").containers for bar in bars]
    assert sorted(bar.get_width() for bar in bars) == sorted(gap["rms"])
    with pytest.raises(ValueError, match="effect='backlas'"):
        plot.discovery(report, effect="backlas")


def test_a_report_from_json_draws_the_gap_for_it_has_no_readings(report, tmp_path):
    told = json.loads(json.dumps(report.to_dict()))
    assert plot.discovery.data(told)["rms"].tolist() == pytest.approx(plot.discovery.data(report, show="gap")["rms"])
    (tmp_path / "report.json").write_text(json.dumps(told))
    assert plot.discovery(tmp_path / "report.json").get_xlabel().startswith("rms error on unseen readings")
    with pytest.raises(ValueError, match="was read from JSON, which has no readings"):
        plot.discovery(told, show="residuals")
    with pytest.raises(ValueError, match="no 'verdict'"):
        plot.discovery({})


def over(joint, unit, at, before, after):
    return {
        "joint": joint, "unit": unit, "at": at, "low": at - 5, "high": at + 5, "before": before, "after": after,
        "poses": 9,
    }  # fmt: skip


def test_a_calibration_is_drawn_over_its_joints(tmp_path):
    rows = [
        over("first", "°", -20.0, 2.0, 0.4),
        over("first", "°", 20.0, 3.0, 0.5),
        over("lift", "mm", 100.0, 9.0, 1.0),
    ]
    (tmp_path / "calibration.json").write_text(json.dumps({"over_joints": rows}))
    assert plot.calibration.data(tmp_path).to_dict("records") == rows
    axes = plot.calibration(tmp_path / "calibration.json")
    before = [y for line in axes.get_lines() if line.get_linestyle() == "--" for y in line.get_ydata()]
    assert before == [2.0, 3.0, 9.0]
    assert axes.get_ylim()[1] > 9
    assert [label.get_text() for label in axes.get_xticklabels()] == ["first\n-25 to 25 °", "lift\n95 to 105 mm"]
    with pytest.raises(ValueError, match="it has no over_joints"):
        plot.calibration({})
    with pytest.raises(ValueError, match=r"nowhere\.json"):
        plot.calibration("nowhere.json")


@pytest.mark.parametrize("name", PACKAGES)
def test_a_package_shows_what_its_all_says(name):
    package = importlib.import_module(f"calibench{name}")
    assert dir(package) == sorted(package.__all__)
    for public in package.__all__:
        assert getattr(package, public) is not None


@pytest.mark.parametrize("name", [n for n in problems.names() if n not in ("arm", "bbob", "ioh")])
def test_a_problem_is_a_line_with_name_options_and_dimension_and_a_table_in_a_notebook(name):
    problem = problems.make(name)
    line = repr(problem)
    assert "\n" not in line
    assert len(line) < 200
    assert line.startswith(f"<problem {name}")
    assert line.endswith(f"{len(problem.lower)} parameters>")
    assert all(f"{p.name}</td>" in problem._repr_html_() for p in problem.parameters)


def test_a_store_a_run_and_a_report_are_a_line_and_a_table_in_a_notebook(folder, rows, report):
    run = bench.execute(problems.make("sensor_zero"), optimizers.make("lm"), budget=60)
    store = bench.ResultStore(folder)
    for shown, words in ((run, "<td>z1</td>"), (store, "full11"), (report, "backlash joint 2")):
        assert "\n" not in repr(shown)
        assert len(repr(shown)) < 300
        assert words in shown._repr_html_()
    assert f"{len(rows)} finished runs" in store._repr_html_()
    assert repr(store) == f"<store {store.folder}: {len(rows)} finished runs>"
    assert repr(bench.ResultStore("nowhere/none")).startswith("<store nowhere/none: there is no such study folder")
    assert "named backlash joint 2" in repr(report)
    assert "there is no such study folder" in bench.ResultStore("nowhere")._repr_html_()
    assert repr(report.model).startswith(f"<problem {report.case}: ")
    assert len(repr(report.model)) < 2000


def test_a_store_shows_what_the_page_on_python_names(folder):
    page = (Path(__file__).resolve().parents[1] / "docs" / "api.md").read_text()
    told = page[page.index("- `ResultStore(folder)`") : page.index("- `answer(")]
    shown = set(dir(bench.ResultStore(folder)))
    assert {"runs", "traces", "write"} <= shown
    assert all(f"`{name}" in told for name in shown)
    assert shown <= set(dir(bench.ResultStore)) | {"folder"}


def test_a_source_answers_which_method_is_best_and_how_sure_that_is(folder, rows, capsys):
    told = calibench.answer(folder)
    assert told.best.startswith("Within 300 evaluations a run, ")
    for source in (bench.ResultStore(folder), rows):
        assert calibench.answer(source) == told
    for said in (told.verdict, told.best, told.sure, told.compared):
        assert said in repr(told)
    assert "\n" not in repr(told)
    assert told.compared in told._repr_html_()
    alone = bench.execute(problems.make("sensor_zero"), optimizers.make("lm"), budget=60)
    assert calibench.answer(alone).verdict == "alone"
    with pytest.raises(ValueError, match="there is no run"):
        calibench.answer(rows.iloc[:0])
    assert capsys.readouterr() == ("", "")


def test_a_run_that_stands_in_several_studies_is_told(folder, tmp_path):
    for study in ("first", "second"):
        shutil.copytree(folder, tmp_path / study)
    with pytest.warns(UserWarning, match=r"^10 runs stand in several studies .*each counted as a run"):
        calibench.answer(tmp_path)


def test_an_answer_of_a_store_waits_for_what_is_planned(folder, tmp_path):
    store = bench.ResultStore(shutil.copytree(folder, tmp_path / "more"))
    left = {"of": "a cell", "another": "a cell"}
    store.plan(left, budgets={"a cell": 300})
    assert "not finished" in calibench.answer(store).sure


WORDS = ("problem=sensor_zero", "optimizer=lm,trf", "budget=60", "seeds=1")


def test_a_sweep_says_nothing_unless_it_is_asked_to(tmp_path, capsys):
    calibench.sweep(*WORDS, f"results={tmp_path}", "study=quiet")
    assert capsys.readouterr() == ("", "")
    calibench.sweep(*WORDS, f"results={tmp_path}", "study=loud", progress=True)
    assert "2/2 runs" in capsys.readouterr().err


REMARKED = """
import itertools, os
import numpy as np
class Box:
    lower, upper, start = -np.ones(2), np.ones(2), np.array([0.5, 0.2])
    def __call__(self, x):
        return float(x @ x) if x[0] < 0.55 else float("nan")
class Drifts(Box):
    called = itertools.count()
    def __call__(self, x):
        os.environ["ROBOT"] = "moves"
        return float(x @ x) + next(self.called)
"""


def test_what_the_command_line_remarks_is_a_warning_in_python(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(REMARKED)
    words = ["problem=own.py:Box,own.py:Drifts", "optimizer=scipy_nelder_mead,scipy_powell", "budget=9", "seeds=2"]
    words += ["study=remarked"]
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        calibench.sweep(*words)
    assert capsys.readouterr() == ("", "")
    assert {(one.filename, one.category) for one in warned} == {(__file__, UserWarning)}
    said = [str(one.message) for one in warned]
    for part in ("the same point gave", "not finite", "changed the state of the process", "1 run: a deterministic"):
        assert len([line for line in said if part in line]) == 1, part
    with pytest.raises(SystemExit):
        main(["run", "-m", *words[:-1], "study=told"])
    told = "".join(capsys.readouterr())
    assert all(re.sub(r"[\d.]+", "", line) in re.sub(r"[\d.]+", "", told) for line in said)  # Drifts has drifted on
    with pytest.warns(UserWarning, match="ends within the first sample of de"):
        calibench.sweep("problem=sensor_zero", "optimizer=de", "budget=60", "seeds=1", "study=vain")


def test_a_misspelt_name_is_told_without_frames_of_ours():
    for words, near in ((("problem=full13", "optimizer=lm"), "full12"), (("problem=full12", "optimizer=lmm"), "lm")):
        with pytest.raises(ValueError, match=f"did you mean '{near}'") as raised:
            calibench.sweep(*words, "budget=60")
        assert len(raised.traceback) == 2  # the test, and the public function
        assert raised.value.__cause__ is None


def test_in_a_notebook_a_sweep_has_a_bar_that_needs_no_widgets(tmp_path, monkeypatch, capsys):
    seen = []

    class ZMQInteractiveShell:
        """The shell of a notebook."""

    def display(bar, display_id):
        return SimpleNamespace(update=lambda bar: seen.append((repr(bar), bar._repr_html_())))

    python, module = ModuleType("IPython"), ModuleType("IPython.display")
    monkeypatch.setattr(python, "get_ipython", ZMQInteractiveShell, raising=False)
    monkeypatch.setattr(module, "display", display, raising=False)
    monkeypatch.setitem(sys.modules, "IPython", python)
    monkeypatch.setitem(sys.modules, "IPython.display", module)
    calibench.sweep(*WORDS, f"results={tmp_path}", "study=shown", progress=True)
    said, html = seen[-1]
    assert said.startswith("2/2 runs, ")
    assert '<progress value="2" max="2"' in html
    assert capsys.readouterr() == ("", "")


def test_the_page_on_python_writes_each_call_as_it_is():
    page = (Path(__file__).resolve().parents[1] / "docs" / "api.md").read_text()
    told = {"plot." + name: getattr(plot, name) for name in plot.__all__}
    told |= {
        "execute": calibench.execute,
        "sweep": calibench.sweep,
        "answer": calibench.answer,
        "discover": calibench.discover,
        "calibrate": calibench.calibrate,
        "design": calibench.design,
        "hand_eye": calibench.hand_eye,
        "identify": calibench.identify,
    }
    for name, function in told.items():
        signature = inspect.signature(function)
        bare = [p.replace(annotation=inspect.Parameter.empty) for p in signature.parameters.values()]
        call = str(signature.replace(parameters=bare, return_annotation=inspect.Signature.empty)).replace("'", '"')
        assert f"`{name}{call}`" in " ".join(page.split()), f"{name}{call}"
    assert all(f"`{name}" in page or f"`calibench.{name}`" in page for name in calibench.__all__)
