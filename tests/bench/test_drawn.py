"""Figures drawn at once are those drawn one by one."""

import os
import time

import pandas as pd
import pytest
from matplotlib.figure import Figure

from calibench.bench.report.shared import drawing


def _drawable(count):
    def draw(k):
        figure = Figure(layout="constrained")
        figure.subplots().plot([0, k], [k, 1])
        return figure, pd.DataFrame({"k": [k]})

    return [(f"figure_{k}", lambda k=k: draw(k)) for k in range(count)]


def _saved(folder, monkeypatch, cores, drawable):
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    told = []
    with drawing.drawn(drawable, folder, told.append) as wait:
        files = wait()
    return told, files, {path.name: path.read_bytes() for paths in files.values() for path in paths}


@pytest.mark.slow
def test_figures_drawn_at_once_have_the_same_bytes_and_order(tmp_path, monkeypatch):
    one = _saved(tmp_path / "one", monkeypatch, 1, _drawable(5))
    many = _saved(tmp_path / "many", monkeypatch, 3, _drawable(5))
    assert one[2] == many[2]
    assert len(one[2]) == 15
    assert one[0] == many[0] == list(many[1])
    assert many[1]["figure_2"][0] == tmp_path / "many" / "figure_2.svg"


@pytest.mark.parametrize("cores", [1, 3])
def test_what_a_drawing_raises_is_raised(tmp_path, monkeypatch, cores):
    def fail():
        raise ValueError("no runs to draw")

    drawable = [*_drawable(3), ("bad", fail)]
    with pytest.raises(ValueError, match="no runs to draw"):
        _saved(tmp_path, monkeypatch, cores, drawable)


def test_what_ends_the_report_ends_the_drawings(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 3)

    def slow():
        time.sleep(60)

    began = time.monotonic()
    drawable = [(f"slow_{k}", slow) for k in range(3)]
    with pytest.raises(ValueError, match="no table"), drawing.drawn(drawable, tmp_path, lambda name: None):
        raise ValueError("no table")
    assert time.monotonic() - began < 30
