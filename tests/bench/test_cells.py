"""Cells: no statistic mixes what differs in options, start, budget or target, and none skips what was not solved."""

import itertools
import json
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest

from calibench import bench, optimizers, problems
from calibench.bench.commands.cells import print_summary
from calibench.bench.papers.cong2008 import figures as paper_tables
from calibench.bench.report.study import figures
from calibench.bench.report.study.html_tables import methods, ranked
from calibench.bench.statistics import ranking, summary, tables
from calibench.bench.statistics.cells import CELL, mixed_code
from calibench.bench.statistics.names import method_labels, problem_titles
from calibench.bench.store.arrays import RUNS_SCHEMA, to_pandas

pytestmark = pytest.mark.usefixtures("one_process")


@dataclass(frozen=True)
class Bowl:
    function: int = 1
    instance: int = 1

    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.5)
    targets = (1e-2, 1e-8)

    def __call__(self, x):
        return self.function * float((x - 0.1 * self.instance) @ (x - 0.1 * self.instance))


@pytest.fixture(scope="module")
def base():
    return bench.execute(Bowl(), optimizers.make("de"), budget=60).row | {"chance": None}  # methods differ


@pytest.fixture
def made(base):
    """Return what makes rows: made(method="de", best=[...], hit=[...]) is a cell of as many runs; keys go into rows."""

    def rows(best, hit=None, options=None, **columns):
        hits = [None] * len(best) if hit is None else hit
        text = {} if options is None else {"problem_options": json.dumps(options, sort_keys=True)}
        return [
            base
            | {"run_id": f"{next(count)}", "repetition": i, "best_value": value, "targets": [1e-2, 1e-8]}
            | {"hits_charged": [h, h], "hits": [h, h], "charged": 1000}
            | text
            | columns
            for i, (value, h) in enumerate(zip(best, hits, strict=True))
        ]

    count = itertools.count()
    return rows


def frame(*cells):
    import pyarrow as pa

    rows = [{name: row.get(name) for name in RUNS_SCHEMA.names} for cell in cells for row in cell]
    return to_pandas(pa.Table.from_pylist(rows, RUNS_SCHEMA))


def test_the_median_of_ten_runs_is_the_mean_of_the_middle_two(made):
    (row,) = summary.summary(frame(made([1.0, 1, 1, 1, 1, 3, 3, 3, 3, 3]))).to_dict("records")
    assert (row["best_q1"], row["best_median"], row["best_q3"]) == (1.0, 2.0, 3.0)


def test_runs_without_a_value_are_worst_and_no_quantile_is_nan(made):
    (row,) = summary.summary(frame(made([1.0, 2.0, np.inf, np.inf]))).to_dict("records")
    assert (row["best_q1"], row["best_median"], row["best_q3"]) == (1.75, np.inf, np.inf)
    (row,) = summary.summary(frame(made([1.0, 2.0, 3.0, np.inf]))).to_dict("records")
    assert (row["best_median"], row["best_q3"]) == (2.5, np.inf)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 10])
def test_quantiles_are_those_of_numpy_where_all_is_finite(n):
    values = np.random.default_rng(n).normal(size=(n, 3))
    np.testing.assert_allclose(
        summary.quantiles(values, summary.QUARTILES), np.quantile(values, summary.QUARTILES, axis=0)
    )


def test_each_function_and_instance_of_a_family_is_a_cell(made):
    cells = [made([float(f * k)] * 2, options={"function": f, "instance": k}) for f in (1, 2, 3) for k in (1, 2)]
    table = tables.overview(frame(*cells))
    assert len(table) == 6
    assert sorted(table["best_median"]) == [1, 2, 2, 3, 4, 6]
    assert table["problem_options"].nunique() == 6


@pytest.mark.parametrize("columns", [{"budget": 500}, {"start": "nominal"}, {"target": 1e-2}, {"data_id": "other"}])
def test_start_budget_target_and_data_set_cells_apart_everywhere(made, columns):
    apart = frame(made([1.0, 1.0], start="random"), made([3.0, 3.0], **({"start": "random"} | columns)))
    for table in (summary.summary(apart), tables.overview(apart)):
        assert sorted(table["best_median"]) == [1.0, 3.0]
    titles = problem_titles(apart).str.cat(method_labels(apart))
    assert titles.nunique() == apart.groupby(CELL, dropna=False).ngroups == 2


def test_a_method_that_solves_one_of_two_cheaply_is_not_before_one_that_solves_the_other_dearly(made):
    one, two = {"function": 1}, {"function": 2}
    runs = frame(
        made([0.0] * 2, [10, 10], one, optimizer="de"), made([1.0] * 2, None, two, optimizer="de"),
        made([1.0] * 2, None, one, optimizer="pso"), made([0.0] * 2, [900, 900], two, optimizer="pso"),
    )  # fmt: skip
    table = tables.overview(runs).groupby("optimizer")[["rank", "solved", "mean_place"]].first()
    assert table.loc["de"].tolist() == table.loc["pso"].tolist() == [1, 0.5, 1.5]


def test_a_method_that_was_run_on_fewer_tasks_stands_behind_and_is_judged_by_its_own(made):
    one, two = {"function": 1}, {"function": 2}
    runs = frame(
        made([0.0], [10], one, optimizer="de"),
        made([0.0], [20], one, optimizer="pso"), made([0.0], [20], two, optimizer="pso"),
    )  # fmt: skip
    table = tables.overview(runs).groupby("optimizer").first()
    assert table.loc["pso", ["rank", "tasks", "of_tasks", "solved"]].tolist() == [1, 2, 2, 1.0]
    assert table.loc["de", ["rank", "tasks", "of_tasks", "solved"]].tolist() == [2, 1, 2, 1.0]


def test_at_the_goal_values_are_tied_and_above_it_they_are_not(made):
    low, lower = made([1e-20] * 3, [50] * 3, optimizer="de"), made([1e-30] * 3, [50] * 3, optimizer="pso")
    cells = summary.summary(frame(low, lower))
    assert ranking.places(cells).tolist() == [1.5, 1.5]
    apart = summary.summary(frame(made([1e-3] * 3, optimizer="de"), made([1e-4] * 3, optimizer="pso")))
    assert ranking.places(apart).tolist() == [2.0, 1.0]


@pytest.mark.parametrize("count", [1, 2, 7, 30, 1000])
def test_the_interval_is_that_of_scipy_to_the_last_bit(count):
    for won in range(0, count + 1, max(1, count // 50)):
        theirs = binomtest(won, count).proportion_ci(0.95, method="wilson")
        assert summary.success_interval(won, count) == (theirs.low, theirs.high)


def test_where_chance_has_no_part_there_is_no_interval(made):
    options = {"optimizer_options": "{}"}
    once = frame(made([0.0], [5], optimizer="nlopt_LN_BOBYQA", start="nominal", **options))
    drawn = frame(made([0.0], [5], optimizer="nlopt_LN_BOBYQA", start="random", **options))
    random = frame(made([0.0], [5], optimizer="de", start="nominal", **options))
    low = [summary.summary(runs)["success_low"].iloc[0] for runs in (once, drawn, random)]
    assert np.isnan(low[0])
    assert low[1:] == pytest.approx([0.2065, 0.2065], abs=1e-4)
    assert "no chance" in str(methods(once, summary.method_names(once)).rows)


def test_problems_that_differ_only_in_an_option_left_unsaid_have_names_apart():
    rows = [
        {"problem": "full12", "problem_options": bench.provenance.run_id.canonical(p.options), "data_id": p.data_id}
        for p in (problems.make("full12", n=20), problems.make("full12", n=50))
    ]
    assert problem_titles(pd.DataFrame(rows)).tolist() == ["full12 n=20", "full12 n=50"]
    assert problem_titles(pd.DataFrame(rows[1:])).tolist() == ["full12"]


def test_an_option_that_varies_is_told_at_its_default_too():
    made = [problems.make("nist", name=name) for name in ("Misra1a", "Rat43")]
    rows = [
        {"problem": "nist", "problem_options": bench.provenance.run_id.canonical(p.options), "data_id": p.data_id}
        for p in made
    ]
    assert problem_titles(pd.DataFrame(rows)).tolist() == ["nist name=Misra1a", "nist name=Rat43"]
    assert problem_titles(pd.DataFrame(rows[:1])).tolist() == ["nist"]


def test_a_figure_has_a_line_for_each_budget_and_knows_runs_that_never_began(made):
    early, late = made([1.0, 1.0], budget=100), made([0.5, 0.5], budget=1000)
    never = made([2.0, np.inf, np.inf], optimizer="pso")
    traces = pd.DataFrame(
        [
            {"run_id": row["run_id"], "evaluations": 1, "charged": 1, "best_value": row["best_value"], "restart": 0}
            for row in [*early, *late, never[0]]
        ]
    )
    _figure, numbers = figures.convergence(frame(early, late, never), traces)
    assert set(numbers["method"]) == {"de, budget 100", "de, budget 1000", "pso"}
    assert numbers.loc[numbers["method"] == "pso", "median"].isna().all()
    assert (numbers.loc[numbers["method"] == "pso", "runs"] == 3).all()


def test_the_overviews_figure_has_a_row_a_variant_and_a_column_a_problem(made):
    cells = [
        made([1.0], options={"function": f}, optimizer_options=json.dumps({"population": n}))
        for f in range(4)
        for n in (10, 20)
    ]
    figure, _ = figures.overview(frame(*cells))
    names = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    assert names == ["de (population=10)", "de (population=20)"]
    assert len(figure.axes[0].get_xticklabels()) == 4


def test_methods_of_a_page_are_best_first_under_each_budget(made):
    runs = frame(
        made([0.0], [30], optimizer="de", budget=100), made([0.0], [10], optimizer="de", budget=900),
        made([0.0], [20], optimizer="pso", budget=100), made([0.0], [20], optimizer="pso", budget=900),
    )  # fmt: skip
    cells = ranked(runs, summary.method_names(runs))
    assert list(zip(cells["budget"], cells["method"], strict=True)) == [
        (100, "pso"), (100, "de"), (900, "de"), (900, "pso")
    ]  # fmt: skip


def test_budgets_are_not_mixed_in_the_papers_tables():
    rows = [
        bench.execute(problems.make("full12", error="J3"), optimizers.make("de"), budget=budget).row
        for budget in (200, 400)
    ]
    table = paper_tables.TABLES["table7"](frame(rows))
    assert table[table["quantity"] == "lb1"]["budget"].tolist() == [200, 400]
    assert (table["n"] == 1).all()


def test_the_terminal_shows_what_was_swept_and_the_best_first(made, capsys):
    runs = frame(
        made([0.3, 0.4], optimizer="de", budget=100), made([0.1, 0.2], optimizer="pso", budget=100),
        made([0.1, 0.1], optimizer="de", budget=900), made([0.3, 0.3], optimizer="pso", budget=900),
    )  # fmt: skip
    print_summary(summary.summary(runs).to_dict("list"))
    head, *lines = capsys.readouterr().out.splitlines()[:5]
    assert "budget" in head
    assert "kmrmse" not in head
    assert [(line.split()[3], line.split()[4]) for line in lines] == [
        ("pso", "100"), ("de", "100"), ("de", "900"), ("pso", "900")
    ]  # fmt: skip


def test_a_page_of_many_methods_needs_no_target(made):
    runs = frame(*(made([0.1 * k], optimizer="de", optimizer_options=json.dumps({"population": k}), target=None)
                   for k in range(4, 18)))  # fmt: skip
    points = {"evaluations": [1, 9], "charged": [1, 9], "best_value": [1.0, 0.1], "restart": [0, 0]}
    traces = pd.concat([pd.DataFrame({"run_id": run_id, **points}) for run_id in runs["run_id"]])
    _, numbers = figures.convergence(runs, traces)
    assert numbers["method"].nunique() == 14


def test_without_a_goal_there_is_no_success(made):
    (row,) = summary.summary(frame(made([1.0, 2.0], targets=[], hits=[], hits_charged=[], target=None))).to_dict(
        "records"
    )
    assert np.isnan([row["success"], row["success_low"], row["success_high"]]).all()


def test_a_minimum_that_a_run_falls_below_is_nobodys(made):
    (row,) = summary.summary(frame(made([-3.2, -3.1], minimum=-3.1, inside_box=True))).to_dict("records")
    assert np.isnan(row["minimum"])
    (row,) = summary.summary(frame(made([-3.0, -3.1], minimum=-3.1, inside_box=True))).to_dict("records")
    assert row["minimum"] == -3.1


def test_a_cell_of_two_versions_of_the_code_is_named(made):
    one, other = made([1.0, 2.0], code_digest="a.b.c"), made([1.5], code_digest="d.b.c")
    assert mixed_code(frame(one)) == ""
    assert mixed_code(frame(one, other)).startswith("1 of 1 cells hold runs of more than one version")


def test_methods_that_ran_on_two_versions_of_one_problem_are_told(made):
    one = made([1.0, 2.0], code_digest="a.b.c", optimizer="lm")
    assert mixed_code(frame(one, made([1.5], code_digest="a.d.c", optimizer="de"))) == ""  # methods are other code
    told = mixed_code(frame(one, made([1.5], code_digest="e.d.c", optimizer="de")))
    assert told.endswith("not all methods ran on the same version of the problem's code; the same command with --rerun "
                         "does them again.")  # fmt: skip
    assert "cells hold" not in told
