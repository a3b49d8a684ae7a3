"""Tables and figures by their numbers: what stands in them follows from the rows, and what is printed from the data."""

import json
import sys

import numpy as np
import pandas as pd
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.cli import main
from calibench.bench.papers import ADDITIONS
from calibench.bench.papers.cong2008 import figures as paper_tables
from calibench.bench.papers.cong2008.figures import gauge
from calibench.bench.report.study import figures
from calibench.bench.report.study.explored import bands, groups_of
from calibench.bench.statistics import summary as stats, tables
from calibench.bench.statistics.fixed_target import Hits
from calibench.bench.statistics.targets import levels_of
from calibench.bench.store.runs import ResultStore
from calibench.problems import constants

pytestmark = pytest.mark.usefixtures("one_process")

SWEEPS = [
    "run -m problem=sensor_zero problem.n=3,9 problem.error=J1,J2 optimizer=fmincon,lm study=paper seeds=1",
    "run -m problem=link_length problem.error=J1,J2,J3 optimizer=fmincon,fmincon_matlab study=paper seeds=1",
    "run -m problem=link_length problem.error=J1,J2,J3 optimizer=fmincon_relative study=paper seeds=1",
    "run -m problem=full12 problem.gauge=ya2 problem.error=J3 optimizer=trf study=paper seeds=1",
    "run -m problem=full11 problem.paper_section=3 problem.error=J3 optimizer=trf study=paper seeds=1",
    "run -m problem=full12 problem.error=J1,J2,J3 optimizer=de,pso,ga,lm study=paper seeds=3",
]


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    folder, path = tmp_path_factory.mktemp("results"), [*sys.path]
    for sweep in SWEEPS:
        with pytest.raises(SystemExit) as ended:
            main([*sweep.split(), "budget=2000", f"results={folder}"])
        assert ended.value.code == 0
    sys.path[:] = path
    return ResultStore(folder / "paper")


@pytest.fixture(scope="module")
def runs(store):
    return store.runs()


def cell(table, /, **where):
    for key, value in where.items():
        table = table[table[key] == value]
    assert len(table) == 1, table
    return table.iloc[0]


def test_every_printed_value_stands_beside_ours(runs):
    for name, build in paper_tables.TABLES.items():
        table = build(runs)
        for key in set(table["table"]):
            column = constants.column("cong2008", key)
            rows = table[(table["table"] == key) & table["printed"].notna()]
            for quantity, entry in column.entries.items():
                if quantity == "iterations" or name == "table6":
                    continue
                found = rows[rows["quantity"] == quantity]
                assert len(found), (key, quantity)
                assert (found["printed"] == entry.printed).all()
                assert (found["read"] == entry.value).all()


def test_medians_follow_from_the_rows(runs):
    table = paper_tables.TABLES["table6"](runs)
    for method in ("de", "pso", "ga"):
        for error in ("J1", "J2", "J3"):
            mine = runs[(runs["optimizer"] == method) & (runs["problem"] == "full12")]
            mine = mine[[json.loads(o)["error"] == error for o in mine["problem_options"]]]
            row = cell(table, method=method, quantity=error)
            assert row["median"] == np.median(mine["best_value"])
            assert row["n"] == 3
            assert row["budget"] == 2000


def test_j1_times_the_scale_is_a_row_of_its_own(runs):
    table = paper_tables.TABLES["table6"](runs)
    for method in ("de", "pso", "ga"):
        scaled, plain = cell(table, method=method, quantity="J1 x 4 l_b^2"), cell(table, method=method, quantity="J1")
        assert scaled["median"] == pytest.approx(4 * 244**2 * plain["median"])
        assert scaled["unit"] == "mm^4"


def test_twelve_parameters_end_off_the_truth_and_on_the_gauge_curve_and_eleven_precise(runs):
    table = paper_tables.TABLES["table4"](runs)
    raw = cell(table, table="table4.j3_12", quantity="kmrmse", method="trf")
    aligned = cell(table, table="table4.j3_12", quantity="kmrmse_aligned", method="trf")
    eleven = cell(table, table="table4.j3_11", quantity="kmrmse", method="trf")
    assert aligned["median"] < 1e-9 < 1e-3 < raw["median"]
    assert eleven["median"] < 1e-9
    misprint = cell(table, table="table4.j3_12", quantity="lb2", method="trf")
    assert misprint["printed"] != misprint["read"]
    assert misprint["why"]


def test_more_samples_are_more_precise_where_tolerances_stop_the_search(store):
    with pytest.raises(SystemExit):
        main(
            f"run -m problem=sensor_zero problem.n=3,9 problem.error=J1,J2 optimizer=fmincon_matlab seeds=1 "
            f"budget=2000 study=matlab results={store.folder.parent}".split()
        )
    table = paper_tables.TABLES["table2"](ResultStore(store.folder.parent / "matlab").runs())
    for error in ("j1", "j2"):
        few, many = (cell(table, table=f"table2.{error}_n{n}", quantity="kmrmse")["median"] for n in (3, 9))
        assert many < few


def test_where_tolerances_stop_it_j1_times_the_scale_is_where_j2_is(runs):
    table = paper_tables.TABLES["table3"](runs)
    chosen = [json.loads(text) for text in table["options"]]
    relative = np.array([o.get("StepTolerance") == 1e-6 and o.get("StopRule") == "relative" for o in chosen])
    rows = table[(table["quantity"] == "best J as mm^4") & relative]
    j1, j2 = (rows.loc[rows["table"] == f"table3.{error}", "median"].item() for error in ("j1", "j2"))
    assert j1 / j2 == pytest.approx(1, rel=0.1)


def test_other_plans_and_noise_do_not_enter_the_papers_tables(store):
    with pytest.raises(SystemExit):
        main(
            f"run -m problem=full12 problem.error=J3 problem.plan=circle,disc problem.noise=1e-4 optimizer=de seeds=1 "
            f"budget=200 study=other results={store.folder.parent}".split()
        )
    assert paper_tables.TABLES["table7"](ResultStore(store.folder.parent / "other").runs()).empty


def test_a_summary_counts_what_failed_and_what_was_reached(runs):
    summary = stats.summary(runs)
    lm = summary[(summary["optimizer"] == "lm") & (summary["problem"] == "full12")]
    assert (lm["reached"] == 3).all()
    assert (lm["charged_to_target"] < 400).all()
    de = summary[(summary["optimizer"] == "de") & (summary["problem"] == "full12")]
    assert (de["reached"] == 0).all()
    assert de["charged_to_target"].isna().all()
    broken = runs.assign(status="failed")
    assert (stats.summary(broken)["failed"] == stats.summary(broken)["runs"]).all()


def test_variants_of_a_method_have_names_of_their_own(runs):
    names = stats.method_names(runs)
    assert {"fmincon", "fmincon_matlab", "fmincon_relative", "de", "lm"} <= set(names)
    pairs = runs.groupby(["optimizer", "optimizer_options"]).ngroups
    assert names.nunique() == pairs


def test_a_convergence_band_is_the_quartiles_of_the_traces():
    flat = [pd.DataFrame({"charged": [1, 10], "best_value": [8.0 * k, float(k)]}) for k in (1, 2, 3, 4, 5)]
    late = pd.DataFrame({"charged": [7], "best_value": [1.0]})
    traces = pd.concat([trace.assign(run_id=str(i)) for i, trace in enumerate([*flat, late])], ignore_index=True)
    runs = pd.DataFrame({"run_id": [str(i) for i in range(6)], "cell": 0})
    band = bands(runs.iloc[:5], traces, np.array([1.0, 5.0, 10.0, 100.0]))[0]
    assert band[:, 1].tolist() == [16.0, 24.0, 32.0]
    assert band[:, 3].tolist() == [2.0, 3.0, 4.0]
    assert np.isnan(bands(runs, traces, np.array([5.0, 7.0]))[0]).tolist() == [[True, False]] * 3


def test_convergence_draws_what_its_numbers_say(runs, store):
    mine = runs[(runs["problem"] == "full12") & runs["optimizer"].isin(["de", "lm"])]
    figure, numbers = figures.convergence(mine, store.traces())
    assert set(numbers["method"]) == {"de", "lm"}
    panel = figure.axes[0]
    drawn = {line.get_label(): line for line in panel.get_lines()}
    first = numbers[(numbers["error"] == numbers["error"].iloc[0]) & (numbers["method"] == "de")]
    np.testing.assert_array_equal(drawn["de"].get_ydata(), first["median"])
    falls = numbers.groupby(["error", "method"])["median"].apply(lambda v: (np.diff(v) <= 0).all())
    assert falls.all()


def test_the_target_chart_draws_what_nobody_sees_no_more_than_five_times(runs):
    one = runs[(runs["problem"] == "full12") & (runs["optimizer"] == "de")].iloc[[0] * 40]
    figure, numbers = figures.target_chart(one.reset_index(drop=True))
    assert max(len(line.get_xdata()) for line in figure.axes[0].get_lines()) == 5
    assert len(numbers) == 40


def test_the_target_chart_keeps_methods_that_never_got_there(runs):
    mine = runs[(runs["problem"] == "full12") & runs["optimizer"].isin(["de", "lm"])]
    mine = mine[[json.loads(o)["gauge"] == "xa2" for o in mine["problem_options"]]]
    figure, numbers = figures.target_chart(mine)
    labels = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    assert labels == ["de  0/3", "lm  3/3"]
    assert numbers["hit"].isna().sum() == 9


def test_the_overview_is_sorted_and_complete(runs):
    table = tables.overview(runs[runs["problem"] == "full12"])
    assert table["rank"].is_monotonic_increasing
    assert table["tasks"].is_monotonic_decreasing
    assert table.groupby("tasks")["solved"].apply(lambda solved: solved.is_monotonic_decreasing).all()
    assert table["runs"].sum() == (runs["problem"] == "full12").sum()


def test_the_gauge_figure_builds_no_problem_after_it_was_found_to_apply(monkeypatch):
    gauge = next(figure for addition in ADDITIONS for figure in addition.figures if figure.name == "gauge")
    runs = pd.DataFrame({"problem": ["full12"]})
    with tables.problems_made_once():
        assert gauge.applies(runs)
        monkeypatch.setattr(problems, "full12", None, raising=False)
        _, points = gauge.draw(runs, runs)
    assert {*points["held"]} == {"ya2", "xa2"}


def test_the_printed_twelve_parameter_results_lie_on_the_gauge_curve():
    _, points = gauge()
    right = points[~points["misprint"] & ~points["parameter"].str.startswith("z")]
    worst = right.groupby("table")["misfit_mm"].apply(lambda m: m.abs().max())
    assert worst["table4.j3_12"] < 1e-3
    assert worst["table7.de_j3"] < 3e-4
    phi = points.groupby("table")["phi"].first()
    assert phi["table4.j3_12"] == pytest.approx(0.0072237, abs=1e-6)
    assert phi["table7.de_j3"] == pytest.approx(0.000707, abs=1e-6)
    scale = points.groupby("table")["scale"].first()
    assert scale["table4.j3_12"] == pytest.approx(1.012698, abs=1e-6)
    assert scale["table7.de_j3"] == pytest.approx(0.9995925, abs=1e-6)


def test_measured_data_are_drawn_above_their_least_value(tmp_path):
    store = ResultStore(tmp_path / "study")
    store.open()
    p = problems.make("orthoglide6")
    for name in ("lm", "de"):
        store.write(bench.execute(p, optimizers.make(name), budget=300))
    runs = store.runs()
    figure, numbers = figures.convergence(runs, store.traces(), title="orthoglide6")
    assert figure.axes[0].get_ylabel() == "best f - f* [mm²]"
    ends = numbers.groupby("method")["median"].last()
    best = runs.set_index("optimizer")["best_value"]
    assert 0 < ends["lm"] < 1e-12
    assert ends["de"] == pytest.approx(best["de"] - p.minimum)
    assert figures.target_chart(runs)[0].axes[0].get_xlabel() == "charged evaluations to f - f* ≤ 1e-12 mm²"


def test_all_figures_that_runs_can_fill_are_drawn(tmp_path):
    store = ResultStore(tmp_path / "study")
    store.open()
    for name, plan in (("full11", "disc"), ("full11", "two_circles"), ("full12", "disc")):
        store.write(bench.execute(problems.make(name, plan=plan), optimizers.make("trf"), budget=100))
    runs, traces = store.runs(), store.traces()
    every = {name: draw() for name, draw in figures.drawable(runs, traces, ADDITIONS)}
    assert {"gauge", "plans", "convergence_full11_plandisc", "convergence_full12"} < set(every)


def test_a_group_without_any_target_has_no_ecdf_and_the_page_is_written(tmp_path):
    class Bowl:
        lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.5)

        def __init__(self, scale=1.0, broken=False):
            self.scale, self.broken = scale, broken

        def __call__(self, x):
            return float(self.scale * x @ x) / (not self.broken)

    store = ResultStore(tmp_path / "study")
    store.open()
    for broken, name in ((False, "whole"), (True, "broken")):
        for scale in (1.0, 2.0):
            store.write(bench.execute(Bowl(scale, broken), optimizers.make("de"), 100, problem_name=name))
    runs = store.runs()
    hits = Hits.of(store.hits(levels_of(runs)))
    assert [name for name, *_ in figures.ecdf_figures(runs, hits, groups_of(runs))] == ["ecdf", "ecdf_whole"]
