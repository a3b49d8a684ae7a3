"""Fixed budget: gaps at budgets and the area over the curve, point by point and beside an independent library."""

import numpy as np
import pandas as pd
import pytest

from calibench.bench.statistics.fixed_budget import anytime, gaps
from tests.bench.test_runtime import ORACLE

BUDGET = 50


@pytest.fixture
def study():
    """Two runs of one cell, as steps: what they had from each charged evaluation on; the best of the study is 0.5."""
    traces = pd.DataFrame(
        [("a", 1, 100.5), ("a", 10, 1.5), ("a", 40, 0.5), ("b", 5, 10.5), ("b", 20, 0.6)],
        columns=["run_id", "charged", "best_value"],
    )
    runs = pd.DataFrame(
        {
            "run_id": ["a", "b"], "problem": "made:P", "problem_options": "{}", "data_id": "", "optimizer": "made:M",
            "optimizer_options": "{}", "start": "random", "budget": BUDGET, "target": np.nan, "targets": [[0.51]] * 2,
            "best_value": [0.5, 0.6], "minimum": np.nan, "inside_box": True, "judged_value": np.nan,
            "judged_evaluations": np.nan, "unit": "",
        }
    )  # fmt: skip
    return runs, traces


def gap_at(trace, n):
    """Return the gap after n evaluations, the slow obvious way; infinite where there is no value yet."""
    seen = [value for charged, value in trace if charged <= n]
    return max(seen[-1] - 0.5, 0.51 - 0.5) if seen else np.inf


def points(traces, run_id):
    mine = traces[traces["run_id"] == run_id]
    return list(zip(mine["charged"], mine["best_value"], strict=True))


def test_quartiles_of_log_gap_are_those_of_the_runs(study):
    runs, traces = study
    table = gaps(runs, traces, budgets=[1, 10, 39, 50])
    for row in table.to_dict("records"):
        found = np.log10([gap_at(points(traces, run_id), row["charged"]) for run_id in "ab"])
        expected = np.quantile(found, [0.25, 0.5, 0.75]) if np.isfinite(found).all() else [np.inf] * 3
        assert [row["q1"], row["median"], row["q3"]] == pytest.approx(list(expected))
    assert table["floor"].tolist() == pytest.approx([0.01] * 4)  # the last target: below it values are tied
    assert table["reference"].tolist() == [0.5] * 4


def test_the_area_is_the_mean_over_all_evaluations_and_has_its_bounds_beside_it(study):
    runs, traces = study
    (row,) = anytime(runs, traces, bounds=(-1.5, 1.0)).to_dict("records")
    areas = []
    for run_id in "ab":
        logs = np.log10([gap_at(points(traces, run_id), n) for n in range(1, BUDGET + 1)])
        areas.append(float(np.mean(1 - (np.clip(logs, -1.5, 1.0) + 1.5) / 2.5)))
    assert row["mean"] == pytest.approx(np.mean(areas), rel=1e-12)
    assert (row["lower"], row["upper"], row["charged"], row["axis"]) == (-1.5, 1.0, BUDGET, "linear")
    assert row["floor"] == pytest.approx(0.01)  # the last target, as of gaps
    with pytest.raises(ValueError, match="below the upper"):
        anytime(runs, traces, bounds=(1.0, 1.0))


@pytest.mark.parametrize("axis", ["log10", "Log", "", None])
def test_an_axis_that_is_not_known_is_refused(study, axis):
    with pytest.raises(ValueError, match=r"^axis=.*: .*choices: linear, log$"):
        anytime(*study, axis=axis)


def test_a_best_value_of_nought_has_a_gap_that_is_a_number(study):
    runs, traces = study
    traces["best_value"] -= 0.5
    runs = runs.assign(targets=[[]] * 2, best_value=[0.0, 0.1])
    table = gaps(runs, traces, budgets=[BUDGET])
    assert table["floor"].iloc[0] == np.spacing(0.0)
    assert table["q1"].iloc[0] == pytest.approx(0.75 * np.log10(np.spacing(0.0)) + 0.25 * np.log10(0.1))


def test_noisy_values_have_no_curve(study):
    runs, traces = study
    noisy = runs.assign(judged_value=1.0, judged_evaluations=30)
    assert gaps(noisy, traces).empty
    assert anytime(noisy, traces).empty


def test_the_area_is_that_of_iohinspector_but_for_the_last_evaluation(study):
    """iohinspector weighs 0 .. B - 1 in place of 1 .. B: a run with a value from the first evaluation on has its worst
    height twice and its last once less.
    """
    aocc = pytest.importorskip("iohinspector.metrics.aocc", reason=ORACLE)
    polars = pytest.importorskip("polars", reason=ORACLE)
    runs, traces = study
    runs, traces = runs[runs["run_id"] == "a"], traces[traces["run_id"] == "a"]
    (row,) = anytime(runs, traces, bounds=(-1.5, 1.0)).to_dict("records")
    height = [1 - (np.clip(np.log10(max(v - 0.5, 0.01)), -1.5, 1.0) + 1.5) / 2.5 for v in traces["best_value"]]
    data = {"evaluations": traces["charged"].astype(float), "eaf": height, "data_id": 1, "function_name": "f"}
    known = aocc.get_aocc(polars.from_dict(pd.DataFrame(data).to_dict("list")), BUDGET, free_vars=["function_name"])
    assert row["mean"] - (height[-1] - height[0]) / BUDGET == pytest.approx(float(known["AOCC"].iloc[0]), rel=1e-9)
