"""What the page draws from: the numbers of the statistics, rounded and thinned, whatever their count."""

import json
import re

import numpy as np
import pandas as pd
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.report.study import figures
from calibench.bench.report.study.answer import answer
from calibench.bench.report.study.explored import (
    Panel,
    as_json,
    bands,
    explored,
    groups_of,
    policy,
    reached_targets,
    scripts,
)
from calibench.bench.report.study.html_tables import by_error, goal_text, methods
from calibench.bench.report.study.page import StudyPage, contents, headline
from calibench.bench.report.study.write import report_progress, write_report
from calibench.bench.statistics import summary as stats
from calibench.bench.statistics.cells import CELL
from calibench.bench.statistics.fixed_target import ecdf, ert
from calibench.bench.statistics.optimum import optimum_of
from calibench.bench.statistics.targets import levels_of
from calibench.bench.store.runs import ResultStore
from tests.few import few

pytestmark = pytest.mark.usefixtures("one_process")


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    store = ResultStore(tmp_path_factory.mktemp("results") / "mine")
    store.open()
    for problem in ("sensor_zero", "link_length"):
        for method in ("lm", "de", "nlopt_LN_BOBYQA"):
            for seed in range(4):
                made = problems.make(problem), optimizers.make(method)
                store.write(bench.execute(*made, budget=200, seed=seed, start="random"))
    return store


def panels_of(runs):
    return [
        Panel(
            title,
            error,
            f"problem-{figures.file_name(title)}",
            mine,
            optimum_of(mine),
            goal_text(mine, optimum_of(mine)),
        )
        for title, group in figures.panels_of(runs).items()
        for error, mine in by_error(group)
    ]


def numbers_of(store, runs=None):
    runs = store.runs() if runs is None else runs
    return explored(panels_of(runs), store.traces(), store.hits(levels_of(store.runs())), stats.summary(runs), "mine")


def quartiles_of_one(traces, at):
    """Return the quartiles after each of `at` counts, shape (3, counts), a run at a time; NaN until all have begun."""
    values = []
    for trace in traces:
        charged, best = trace["charged"].tolist(), trace["best_value"].tolist()
        last = [sum(c <= count for c in charged) - 1 for count in at]
        values.append([best[i] if i >= 0 else np.nan for i in last])
    return stats.quantiles(np.array(values), [0.25, 0.5, 0.75]), ~np.isnan(values).any(axis=0)


def test_the_bands_of_all_cells_are_those_of_each(store):
    runs, traces = store.runs(), store.traces()
    runs["cell"] = runs.groupby(CELL, sort=False, dropna=False).ngroup()
    at = np.unique(np.round(np.geomspace(1, 200, 40)))
    found = bands(runs, traces, at)
    assert sorted(found) == sorted(set(runs["cell"]))
    for cell, band in found.items():
        ids = runs.loc[runs["cell"] == cell, "run_id"]
        alone, begun = quartiles_of_one([traces[traces["run_id"] == run_id] for run_id in ids], at)
        assert (~np.isnan(band[1])).tolist() == begun.tolist()
        assert np.array_equal(band[:, begun], alone[:, begun])


def test_a_run_that_never_began_is_worse_than_all(store):
    runs, traces = store.runs().iloc[:2].assign(cell=0), store.traces()
    at = np.array([1.0, 200.0])
    band = bands(runs, traces[traces["run_id"] != runs["run_id"].iloc[1]], at)[0]
    assert np.isinf(band[2]).all()
    assert np.isfinite(bands(runs.iloc[:1], traces, at)[0][:, 1]).all()


def test_what_is_reached_is_what_the_statistics_say(store):
    runs, hits = store.runs(), store.hits(levels_of(store.runs()))
    runs["cell"] = runs.groupby(CELL, sort=False, dropna=False).ngroup()
    costs = np.array([1.0, 10.0, 30.0, 100.0, 200.0])
    found = {one.quantity: one for one in reached_targets(runs, hits, dict.fromkeys(range(6), float("nan")), costs)}
    table = ert(hits, runs)
    gap = found["gap"]
    assert gap.targets.tolist() == sorted(set(table.loc[table["quantity"] == "gap", "target"]), reverse=True)
    keys = ["problem", "optimizer"]
    cells = runs.drop_duplicates("cell").set_index(keys)["cell"]
    for row in table[table["quantity"] == "gap"].itertuples():
        place = cells[row.problem, row.optimizer], int(np.flatnonzero(gap.targets == row.target)[0])
        assert gap.reached[place] == row.reached
        assert gap.ert[place] == row.ert
    shares = ecdf(hits, runs, keys[:1], at=costs)
    for key, mine in shares[shares["quantity"] == "gap"].groupby(keys):
        assert np.allclose(gap.share[cells[key]], mine["share"])


def test_a_problem_says_its_goal_and_whether_its_values_are_noisy(store, tmp_path):
    found = numbers_of(store)["problems"]
    assert [one["goal"] for one in found] == ["J2 ≤ 1e-18 mm⁴, the rounding floor"] * 2
    assert not any(one["noisy"] for one in found)
    assert (
        "<b>J2 ≤ 1e-18 mm⁴, the rounding floor</b><span>is the goal</span>"
        in StudyPage(folder=tmp_path, runs=store.runs()).html()
    )


def test_cells_that_differ_only_in_their_own_target_stay_apart(tmp_path):
    store = ResultStore(tmp_path / "mine")
    store.open()
    for target in (1e3, 1e-3):
        made = problems.make("sensor_zero"), optimizers.make("nlopt_LN_BOBYQA")
        store.write(bench.execute(*made, budget=200, target=target))
    found = numbers_of(store)
    assert len(found["methods"]) == len(found["cells"]["runs"]) == 2
    gap = next(one for one in found["quantities"] if one["key"] == "gap")
    assert len(gap["reached"][0]) != len(gap["reached"][1])  # the one stopped early


def test_what_is_lost_of_a_cell_is_failed_or_out_of_time(store):
    runs = store.runs()
    runs.loc[runs.index[:3], "status"] = ["failed", "timeout", "timeout"]
    assert sum(numbers_of(store, runs)["cells"]["failed"]) == 3


def test_numbers_are_data_that_no_name_can_leave():
    evil = "</script><!--\u2028&"
    told = as_json({"name": evil})
    assert not set("<>&\u2028") & set(told)
    assert json.loads(told) == {"name": evil}


@pytest.mark.slow
def test_many_cells_take_no_more_than_the_room_there_is(store, monkeypatch):
    for name, room in (("_CURVES", 11_000), ("_SHARES", 16_000), ("_TARGETS", 6_000)):  # a tenth of what a page has
        monkeypatch.setattr(f"calibench.bench.report.study.explored.{name}", room)
    runs = store.runs()
    many = pd.concat(
        [runs.assign(start=f"start {i}", run_id=runs["run_id"] + str(i)) for i in range(20)], ignore_index=True
    )
    small, large = numbers_of(store), numbers_of(store, many)
    assert len(large["cells"]["runs"]) == 20 * len(small["cells"]["runs"])
    assert len(large["at"]) < len(small["at"])
    assert len(as_json(large)) < 150_000


def test_only_our_scripts_may_run_and_none_reaches_out():
    assert policy().startswith("default-src 'none'; script-src 'sha256-")
    assert "unsafe-eval" not in policy()
    library, ours = scripts()
    assert "uPlot" in library[:100]
    for word in (
        "innerHTML",
        "insertAdjacentHTML",
        "document.write",
        "eval(",
        "fetch(",
        "XMLHttpRequest",
        "localStorage",
    ):
        assert word not in ours


def test_a_problem_stands_in_the_group_that_it_declares(store):
    runs = store.runs()
    assert set(groups_of(runs)) == {"sensor_zero", "link_length"}
    runs.loc[runs["problem"] == "sensor_zero", "problem_group"] = "separable"
    assert set(groups_of(runs)) == {"separable", "link_length"}


def answered(store, keep=lambda runs: runs):
    runs = keep(store.runs())
    return answer(runs, stats.summary(runs), stats.method_names(runs))


def test_the_answer_names_the_best_and_what_was_compared(store):
    told = answered(store)
    assert (
        "lm reaches the goal most: in 8 of 8 runs (100\u00a0%; 95 % interval 68\u00a0% to 100\u00a0%) on 2 problems"
        in told.best
    )
    assert told.compared.startswith("Compared: 3 methods on 2 problems, 24 runs (4 a method and problem)")
    assert "no run failed" in told.compared


def ended(runs, **how):
    """Return the runs, of which so many have ended in another way than `ok`."""
    statuses = [status for status, count in how.items() for _ in range(count)]
    runs.loc[runs.index[: len(statuses)], "status"] = statuses
    return runs


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"failed": 2}, "; 2 runs failed and count as not arrived."),
        ({"timeout": 1}, "; 1 run was ended by its time limit and keeps what it reached."),
        (
            {"failed": 1, "timeout": 2},
            "1 run failed and counts as not arrived; 2 runs were ended by their time limit and keep what they reached.",
        ),
    ],
)
def test_the_answer_tells_runs_that_failed_from_those_that_their_time_limit_ended(store, how, said):
    assert answered(store, lambda runs: ended(runs, **how)).compared.endswith(said)


def test_the_head_and_the_tables_tell_runs_that_failed_from_those_that_their_time_limit_ended(store):
    runs = ended(store.runs(), failed=2, timeout=3)
    names, cells = stats.method_names(runs), stats.summary(runs)
    head = headline(runs, [], [], "", answer(runs, cells, names))
    assert [fact[:2] for fact in head["facts"][1:3]] == [("2", "failed"), ("3", "ended by the time limit")]
    assert head["lost"].startswith(
        "2 of 24 runs failed and count as not arrived; 3 of 24 runs were ended by their time"
    )
    table = contents(panels_of(runs), names, cells)
    assert [head.title for head in table.heads[-2:]] == ["failed runs", "ended by the time limit"]
    lost = [int(re.sub(r"<[^>]*>|✗", "", str(cell))) for row in table.rows for cell in row[-2:]]
    assert (sum(lost[::2]), sum(lost[1::2])) == (2, 3)
    marks = " ".join(str(cell) for row in methods(runs, names).rows for cell in row)
    assert "✗ 2 failed" in marks
    assert sum(map(int, re.findall(r"✗ (\d) ended by the time limit", marks))) == 3


def test_who_reaches_the_goal_more_often_on_fewer_problems_is_told_beside_the_best(store):
    def fewer(runs):
        lm = runs[runs["optimizer"] == "lm"]
        others = runs[(runs["optimizer"] != "lm") & (runs["problem"] == "link_length")]
        missed = (lm["problem"] == "link_length") & (lm["repetition"] < 2)
        none = lm["hits"].map(lambda told: [None] * len(told))
        lm = lm.assign(
            best_value=lm["best_value"].mask(missed, 1e9),
            hits=lm["hits"].where(~missed, none),
            hits_charged=lm["hits_charged"].where(~missed, none),
        )
        best = runs[(runs["optimizer"] == "lm") & (runs["problem"] == "link_length")]
        return pd.concat([lm, others, best.assign(optimizer="twin", run_id=best["run_id"] + "t")], ignore_index=True)

    told = answered(store, fewer)
    assert "lm reaches the goal most: in 6 of 8 runs" in told.best
    assert "On fewer problems a larger share reaches it: twin in 4 of 4 runs on the 1 that it was run on" in told.best
    assert "3 comparisons" in told.sure


def test_few_runs_leave_the_answer_undecided(store):
    told = answered(store)  # four pairs: no test can refuse at 5 %
    assert told.verdict == "undecided"
    assert "So few runs cannot decide, whatever they hold: it takes 5 seeds or more" in told.sure


def clones(store, seeds, problems=1):
    """Return the runs on one problem as if `seeds` seeds and `problems` problems had been alike."""
    first = store.runs().query("problem == 'link_length' and repetition == 0")
    return pd.concat(
        [
            first.assign(repetition=seed, run_id=first["run_id"] + f"{seed}-{problem}", data_id=f"{problem}")
            for seed in range(seeds)
            for problem in range(problems)
        ],
        ignore_index=True,
    )


@pytest.mark.parametrize(("seeds", "problems"), few(1, [(5, 2), (4, 3)]))
def test_the_least_number_that_the_page_asks_for_decides(store, seeds, problems):
    def apart(runs):  # the same order everywhere: no test can be surer
        return runs.assign(best_value=runs["optimizer"].map({"lm": 1.0, "de": 2.0, "trf": 3.0}).fillna(4.0))

    enough = answered(store, lambda _: apart(clones(store, seeds, problems)))
    assert enough.verdict == "decided"
    told = answered(store, lambda _: apart(clones(store, seeds - 1, problems)))
    assert told.verdict == "undecided"
    assert f"it takes {seeds} seeds or more" in told.sure


def test_ten_problems_cannot_decide_between_eight_methods_and_the_page_says_how_many_can(store):
    def eight(problems):
        one = clones(store, 1, problems).query("optimizer == 'de'")
        many = [one.assign(optimizer=f"m{i}", run_id=one["run_id"] + f"m{i}", best_value=float(i)) for i in range(8)]
        return pd.concat(many, ignore_index=True)

    told = answered(store, lambda _: eight(10))
    assert told.verdict == "undecided"
    assert "it takes 11 problems or more" in told.sure
    assert answered(store, lambda _: eight(11)).verdict == "decided"


@pytest.mark.parametrize("values", [
    {"a": [2, 2, 2, 1, 1], "b": [1, 1, 1, 9, 9], "c": [3, 3, 3, 2, 2], "d": [4, 4, 4, 3, 3]},
    {"a": [2, 2, 1, 1, 2], "b": [1, 1, 9, 9, 9], "c": [3, 3, 2, 2, 1], "d": [4, 4, 3, 3, 3]},
], ids=["more often", "as often"])  # fmt: skip
def test_who_is_first_by_mean_place_is_told_so_where_another_is_first(store, values):
    def placed(_):
        runs = clones(store, 1, 5)
        one = runs.query("optimizer == 'de'").sort_values("data_id")
        named = [one.assign(optimizer=n, run_id=one["run_id"] + n, best_value=v) for n, v in values.items()]
        found = pd.concat(named, ignore_index=True)
        return found.assign(hits_charged=found["targets"].map(lambda t: [None] * len(t)))

    assert (
        "a comes first by its mean place, and has the lowest median value on 2 of 5 problems"
        in answered(store, placed).best
    )


def test_many_runs_decide(store):
    def many(runs):
        copies = [runs.assign(repetition=runs["repetition"] + 10 * i, run_id=runs["run_id"] + str(i)) for i in range(9)]
        return pd.concat(copies, ignore_index=True)

    told = answered(store, many)
    assert told.verdict == "decided"
    assert "better than each of the 2 others" in told.sure


def test_one_method_is_compared_with_nothing(store):
    told = answered(store, lambda runs: runs[runs["optimizer"] == "de"])
    assert told.verdict == "alone"
    assert told.best.endswith(
        "de has the lowest median value on 2 of 2 problems; no method reached the goal of any problem in any run."
    )


def test_where_all_methods_come_to_the_same_the_one_that_is_spoken_of_is_named(store):
    def same(runs):
        return runs.assign(best_value=7.0, hits_charged=runs["targets"].map(lambda t: [None] * len(t)))

    told = answered(store, same)
    assert (
        " is behind no other method by its mean place, and has the lowest median value alone on no problem" in told.best
    )
    assert "are not told apart from it" in told.sure


def test_where_no_method_found_a_value_none_is_named(store):
    def lost(runs):
        return runs.assign(
            status="timeout", best_value=np.inf, hits_charged=runs["targets"].map(lambda t: [None] * len(t))
        )

    told = answered(store, lost)
    assert told.best.endswith("a run, no method reached the goal of any problem in any run.")
    assert told.sure == "No method found a value in most of its runs: they are not compared."


def test_a_share_without_chance_has_no_interval(store):
    told = answered(store, lambda runs: runs[runs["repetition"] == 0].assign(start="nominal", chance=None))
    assert "lm reaches the goal most: in 2 of 2 runs (100\u00a0%) on 2 problems" in told.best


def test_a_method_like_itself_is_never_better(store):
    def twins(runs):
        mine = runs[runs["optimizer"] == "nlopt_LN_BOBYQA"]
        return pd.concat([mine, mine.assign(optimizer="de")], ignore_index=True)

    assert answered(store, twins).verdict == "undecided"


@pytest.mark.slow
def test_a_report_tells_its_steps(store):
    steps = []
    write_report(store, tell=lambda done, of, what: steps.append((done, of, what)))
    assert [done for done, _, _ in steps] == list(range(len(steps)))
    assert steps[-1][0] == steps[-1][1] - 1
    assert {"the runs", "the page", "figure ecdf"} <= {what for _, _, what in steps}


def test_a_log_has_plain_lines_only_where_a_report_takes_long(capsys, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("calibench.bench.report.study.write.time.monotonic", lambda: now[0])
    with report_progress() as tell:
        tell(0, 3, "the runs")
        now[0] = 6.0
        tell(1, 3, "the tables")
        tell(2, 3, "the page")
    assert capsys.readouterr().err == "  report: step 2 of 3, the tables\n"


def test_the_answer_says_that_answers_lie_outside_the_box(store):
    told = answered(store)
    assert "outside the box" not in told.best
    outside = answered(store, lambda runs: runs.assign(inside_box=False))
    assert outside.best.startswith(told.best)
    assert "answers lie outside the box" in outside.best
