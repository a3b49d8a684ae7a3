"""Answers outside the box are marked: in the table of a run, of a comparison, and on the page of a study."""

from __future__ import annotations

import pandas as pd
import pytest

from calibench.bench import ResultStore
from calibench.bench.report.study.html_tables import methods
from calibench.bench.statistics.names import method_titles
from calibench.bench.statistics.summary import outside_box, summary
from calibench.bench.statistics.tables import overview

pytestmark = pytest.mark.usefixtures("one_process")

BEYOND = """
import numpy as np
class Beyond:
    lower, upper, start, targets = np.zeros(2), np.ones(2), np.full(2, 0.5), [1e-8]
    def residuals(self, x): return np.array([x[0] - 3, x[1] - 0.2])
    def __call__(self, x): return float(np.sum(self.residuals(x) ** 2))
class Broken(Beyond):
    def __call__(self, x): return float("nan")
    def residuals(self, x): raise OSError("no sensor")
"""


@pytest.fixture
def swept(run_bench, tmp_path):
    """Return a call of `bench` where `lm`, which knows no bounds, and `trf` have searched."""
    name = f"{tmp_path.name}.py"  # two files of one name would be refused
    (tmp_path / name).write_text(BEYOND)
    words = f"problem=./{name}:Beyond optimizer=lm,trf budget=300 seeds=2 start=random study=s"
    code, out, _ = run_bench(f"run -m {words}")
    assert code == 0
    return run_bench, out


def test_the_table_of_a_run_marks_answers_outside_the_box(swept):
    _, out = swept
    lines = out.splitlines()
    assert "outside box" in lines[0]
    assert "◇ 2" in next(line for line in lines if " lm " in line)
    assert "◇" not in next(line for line in lines if " trf " in line)
    assert "outside box: answers that lie outside lower .. upper" in out


def test_a_table_where_all_answers_are_inside_has_no_such_column(run_bench):
    _, out, _ = run_bench("run problem=sensor_zero optimizer=trf budget=50 seeds=1")
    assert "outside" not in out


def test_a_comparison_marks_them(swept):
    call, _ = swept
    _, out, _ = call("compare results/s --methods trf lm")
    assert "outside box A -> B" in out.splitlines()[0]
    assert "- -> ◇ 2" in out.splitlines()[1]


def test_the_page_marks_them(swept, tmp_path):
    runs = ResultStore(tmp_path / "results/s").runs()
    told = str(methods(runs, method_titles(runs)).rows)
    assert told.count("◇ 2 outside the box") == 1


def test_a_run_without_an_answer_is_not_outside(swept, tmp_path):
    call, _ = swept
    call(f"run -m problem=./{tmp_path.name}.py:Broken optimizer=lm,nlopt_LN_COBYLA budget=30 seeds=1 study=t")
    runs = ResultStore(tmp_path / "results/t").runs()
    assert set(runs["status"]) == {"failed"}
    assert not outside_box(runs).any()
    assert overview(runs)["outside_box"].tolist() == [0, 0]


def test_of_published_runs_nobody_knows(swept, tmp_path):
    runs = ResultStore(tmp_path / "results/s").runs()
    runs["inside_box"] = pd.array([pd.NA] * len(runs), dtype="boolean")
    assert summary(runs)["outside_box"].sum() == 0
