"""Figures drawn at once are those drawn one by one."""

import os

import pandas as pd
import pytest
from matplotlib.figure import Figure

from calibench.bench.report.shared import drawn


def _drawable(count):
    def draw(k):
        figure = Figure(layout="constrained")
        figure.subplots().plot([0, k], [k, 1])
        return figure, pd.DataFrame({"k": [k]})

    return [(f"figure_{k}", lambda k=k: draw(k)) for k in range(count)]


def _saved(folder, monkeypatch, cores, drawable):
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    told = []
    found = list(drawn.save_all(drawable, folder, told.append))
    return told, found, {path.name: path.read_bytes() for _, paths in found for path in paths}


def test_figures_drawn_at_once_have_the_same_bytes_and_order(tmp_path, monkeypatch):
    one = _saved(tmp_path / "one", monkeypatch, 1, _drawable(5))
    many = _saved(tmp_path / "many", monkeypatch, 3, _drawable(5))
    assert one[2] == many[2]
    assert len(one[2]) == 15
    assert one[0] == many[0] == [name for name, _ in many[1]]


@pytest.mark.parametrize("cores", [1, 3])
def test_what_a_drawing_raises_is_raised(tmp_path, monkeypatch, cores):
    def fail():
        raise ValueError("no runs to draw")

    drawable = [*_drawable(3), ("bad", fail)]
    with pytest.raises(ValueError, match="no runs to draw"):
        _saved(tmp_path, monkeypatch, cores, drawable)
