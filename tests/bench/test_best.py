"""The best method against each other one: each p beside SciPy's, the level kept, and by how much it leads."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from benchmarks.statistics import best_of_many
from calibench.bench.report.study.answer import answer
from calibench.bench.report.study.write import write_report
from calibench.bench.statistics import summary
from calibench.bench.statistics.best import Rival, Side, _stouffer, ratio_of, rivals_of
from calibench.bench.statistics.ranking import order_of_scores as order_of, places, scores
from calibench.bench.statistics.targets import COLUMN, with_lowest_seen
from calibench.bench.statistics.two_studies import rank_sum_tails, signed_rank_tails
from calibench.bench.store.manifest import remaining_by_budget
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.request import read_request

pytestmark = pytest.mark.usefixtures("one_process", "undrawn")

BEST, OTHER, THIRD = ("a", "{}"), ("b", "{}"), ("c", "{}")


def side(costs, chance=True, shared=False, won=None):
    """Return the runs of one method: what each paid until the goal, or in vain where it is not `won`."""
    paid = np.asarray(costs, dtype=float)
    hits = np.ones(len(paid)) if won is None else np.asarray(won, dtype=float)
    score = np.column_stack([np.where(hits > 0, paid, np.inf), np.zeros(len(paid))])
    return Side(
        scores=score, repetitions=tuple(range(len(paid))), chance=chance, shared=shared, paid=paid, won=hits
    )  # fmt: skip


def beside(*tasks: dict) -> list[Rival]:
    rivals = [method for method in dict.fromkeys(m for task in tasks for m in task) if method != BEST]
    return rivals_of(tasks, pd.DataFrame(), BEST, rivals)


def drawn(seed, n, middle):
    return np.random.default_rng(seed).lognormal(np.log(middle), 0.8, n).round()


def test_runs_that_share_nothing_are_tested_by_the_rank_sum():
    ours, theirs = drawn(1, 9, 100), drawn(2, 12, 160)
    (rival,) = beside({BEST: side(ours), OTHER: side(theirs)})
    exact = stats.mannwhitneyu(ours, theirs, alternative="less", method="exact").pvalue
    assert rival.p == pytest.approx(exact, abs=1e-12)
    assert rival.p_adjusted == pytest.approx(2 * exact, abs=1e-12)  # either of the two could have been the best


def test_runs_that_share_a_start_are_tested_as_pairs():
    ours, theirs = drawn(3, 10, 100), drawn(4, 10, 150)
    (rival,) = beside({BEST: side(ours, shared=True), OTHER: side(theirs, shared=True)})
    ranks = stats.rankdata(np.concatenate([ours, theirs]))
    assert rival.p == pytest.approx(stats.wilcoxon(ranks[10:] - ranks[:10], alternative="greater").pvalue, abs=1e-12)


def test_a_fixed_value_against_runs_is_a_question_of_one_sample():
    theirs = drawn(5, 15, 150)
    (rival,) = beside({BEST: side([100.0], chance=False), OTHER: side(theirs)})
    worse = int((theirs > 100).sum())
    assert rival.p == pytest.approx(stats.binomtest(worse, 15, alternative="greater").pvalue, abs=1e-12)


def test_a_fixed_value_that_is_ahead_on_six_problems_of_five_runs_is_decided():
    (rival,) = beside(*({BEST: side([100.0], chance=False), OTHER: side(drawn(i, 5, 900) + 100)} for i in range(6)))
    assert rival.p == pytest.approx(stats.combine_pvalues([0.5**5] * 6, method="stouffer").pvalue, rel=1e-9)
    assert rival.verdict == "worse"


def test_facts_are_not_tested_and_one_problem_lost_leaves_it_open():
    ahead, behind = side([100.0], chance=False), side([120.0], chance=False)
    assert [rival.verdict for rival in beside({BEST: ahead, OTHER: behind}, {BEST: ahead, OTHER: ahead})] == ["worse"]
    (lost,) = beside({BEST: ahead, OTHER: behind}, {BEST: behind, OTHER: ahead})
    assert lost.verdict == "better somewhere"
    assert np.isnan(lost.p)


def test_the_correction_runs_over_the_rivals_and_the_methods_that_could_have_led():
    sides = {BEST: side(drawn(7, 8, 100)), OTHER: side(drawn(8, 8, 300)), THIRD: side([400.0], chance=False)}
    other, third = beside(sides)
    p = sorted([other.p, third.p])
    assert sorted([other.p_adjusted, third.p_adjusted]) == pytest.approx(
        [min(1, 4 * 2 * p[0]), min(1, max(4 * 2 * p[0], 4 * p[1]))]  # 2: rivals; 4: two with chance share one half
    )


def test_the_number_of_runs_that_is_asked_for_decides_and_one_less_cannot():
    def apart(n):
        sides = {(f"{i}", "{}"): side(1000.0 * i + np.arange(n)) for i in range(1, 6)}
        return beside({BEST: side(np.arange(n) + 1.0), **sides})

    enough = max(rival.enough for rival in apart(3))
    assert {rival.verdict for rival in apart(enough)} == {"worse"}
    assert {rival.verdict for rival in apart(enough - 1)} == {"open"}


@pytest.mark.parametrize(("setting", "studies"), [(1, 200), (2, 100), pytest.param(5, 200, marks=pytest.mark.slow)])
def test_equals_are_called_better_in_no_more_studies_than_the_level_allows(setting, studies):
    ((_, false, _, _),) = best_of_many(studies, [setting])
    assert false <= 0.05 + 3 * (0.05 * 0.95 / studies) ** 0.5


def test_clear_differences_are_decided_where_the_rule_of_all_pairs_decides_nothing():
    ((_, false, decided, share),) = best_of_many(40, [9])
    assert false <= 0.05
    assert decided > 0.9
    assert share > 0.95


def test_the_ratio_is_that_of_expected_running_times():
    first, second = side([100, 200, 300], won=[1, 1, 0]), side([500, 100], chance=False)
    found = ratio_of([(first, second)])
    assert found.value == pytest.approx((600 / 2) / (600 / 2))
    both = ratio_of([(first, second), (side([10.0], chance=False), side([40.0], chance=False))])
    assert both.value == pytest.approx(np.sqrt(1.0 * 4.0))
    never = ratio_of([(first, side([900.0] * 3, won=[0, 0, 0]))])
    assert np.isnan(never.value)
    assert never.never == 1


@pytest.mark.parametrize("shared", [False, True])
def test_the_interval_of_the_ratio_holds_it(shared):
    """Of 300 studies of 15 runs; the ratio of the means is 2."""
    rng, held, studies = np.random.default_rng(2008), 0, 300
    for _ in range(studies):
        common = rng.normal(0, 0.3, 15) if shared else 0.0
        sides = [side(m * np.exp(common + rng.normal(0, 0.5, 15)), shared=shared) for m in (100.0, 200.0)]
        found = ratio_of([(sides[0], sides[1])])
        held += found.low <= 2.0 <= found.high
    assert 0.91 <= held / studies <= 0.985


def made(values, traces, method="m", **more):
    """Return runs of a problem without a goal, and their traces [(charged, best value)]."""
    runs = pd.DataFrame({
        "run_id": [f"{method}{i}" for i in range(len(values))], "problem": "p", "problem_options": "{}", "data_id": "",
        "optimizer": method, "optimizer_options": "{}", "start": "nominal", "budget": 100, "target": np.nan,
        "status": "ok", "repetition": range(len(values)), "best_value": values, "charged": 100, "inside_box": True,
        "minimum": None, "unit": "", "judged_value": np.nan, "judged_evaluations": np.nan, "evaluations": 100,
        "batch_evaluations": 0, "residual_evaluations": 0, "jacobian_evaluations": 0, "targets": [[]] * len(values),
        "hits_charged": [[]] * len(values), "restarts": 0, "kmrmse": np.nan, "kmrmse_aligned": np.nan,
        "parameter_error_mm": np.nan, "gauge_phi": np.nan, "wall_s": 0.0, "error_type": "", "error": "",
    } | more)  # fmt: skip
    points = [(run, n, value) for run, trace in zip(runs["run_id"], traces, strict=True) for n, value in trace]
    return runs, pd.DataFrame(points, columns=["run_id", "charged", "best_value"])


def joined(*parts):
    runs, traces = zip(*parts, strict=True)
    return pd.concat(runs, ignore_index=True), pd.concat(traces, ignore_index=True)


def test_values_at_the_rounding_floor_are_ties_and_who_arrives_first_is_ahead():
    slow = made([3e-30] * 2, [[(1, 4.0), (90, 3e-30)]] * 2, "slow")
    soon = made([2e-28] * 2, [[(1, 4.0), (20, 2e-28)]] * 2, "soon")
    runs = with_lowest_seen(*joined(slow, soon))
    assert runs[COLUMN].all()
    told = answer(runs, summary.summary(runs), summary.method_names(runs))
    assert "soon reaches the lowest value seen (to rounding) most: in 2 of 2 runs" in told.best
    assert "slow, needs 4.5 times the evaluations" in told.sure


def test_a_failed_run_counts_as_not_arrived_at_the_lowest_value_seen():
    sound = made([1e-30] * 2, [[(1, 4.0), (50, 1e-30)]] * 2, "sound")
    half = made([np.inf, 2e-30], [[], [(1, 4.0), (20, 2e-30)]], "half", status=["failed", "ok"])
    runs = with_lowest_seen(*joined(half, sound))
    cells = summary.summary(runs).set_index("optimizer")
    assert cells["success"].to_dict() == {"half": 0.5, "sound": 1.0}
    told = answer(runs, summary.summary(runs), summary.method_names(runs))
    assert "sound reaches the lowest value seen (to rounding) most: in 2 of 2 runs" in told.best


def test_who_ends_outside_the_box_does_not_reach_the_lowest_value_seen():
    outside = made([1.0, 1.0], [[(1, 4.0), (9, 1.0)]] * 2, "outside", inside_box=[True, False])
    inside = made([1.0, 1.0], [[(1, 4.0), (50, 1.0)]] * 2, "inside")
    runs = with_lowest_seen(*joined(outside, inside))
    told = answer(runs, summary.summary(runs), summary.method_names(runs))
    assert "inside reaches the lowest value seen (to rounding) most: in 2 of 2 runs" in told.best


def test_values_that_agree_to_nine_digits_are_ties_of_runs_and_of_places():
    first, second = made([0.5, 0.5], [[(1, 4.0)]] * 2, "a"), made([0.5 * (1 + 1e-12)] * 2, [[(1, 4.0)]] * 2, "b")
    third = made([0.5 * (1 + 1e-8)] * 2, [[(1, 4.0)]] * 2, "c")
    runs, _ = joined(first, second, third)
    assert places(summary.summary(runs)).tolist() == [1.5, 1.5, 3.0]
    assert order_of(scores(runs)).tolist() == [2.5] * 4 + [5.5] * 2


def test_a_value_that_one_run_alone_has_seen_is_no_goal():
    runs = with_lowest_seen(
        *joined(made([1.0, 3.0], [[(1, 9.0), (5, 1.0)], [(1, 9.0)]]), made([2.0], [[(1, 9.0)]], "b"))
    )
    assert not runs[COLUMN].any()


def test_where_every_run_failed_no_method_is_named():
    runs = with_lowest_seen(
        *joined(made([1.0] * 2, [[(1, 1.0)]] * 2, status="failed"), made([2.0], [[(1, 2.0)]], "b", status="failed"))
    )
    told = answer(runs, summary.summary(runs), summary.method_names(runs))
    assert told.verdict == "undecided"
    assert told.best == "Within 100 evaluations a run, no run ended well: 3 failed."


def test_rounding_makes_no_p_above_1_that_would_take_a_rival_out_of_the_correction():
    same, other = np.full(10, 2.0), np.array([2, 2, 2, 2, 1, 2, 0, 1, 2, 1.0])
    assert max(rank_sum_tails(same, other)) <= 1.0
    assert not np.isnan(beside({BEST: side(same), OTHER: side(other)}, {BEST: side(same), OTHER: side(other)})[0].p)


def test_values_that_differ_by_more_than_rounding_make_no_goal():
    runs = with_lowest_seen(*joined(made([1.0, 3.0, 2.0], [[(1, 9.0)]] * 3), made([4.0], [[(1, 9.0)]], "other")))
    assert not runs[COLUMN].any()


def test_a_sweep_that_was_cut_is_answered_at_the_budget_that_is_done():
    whole = joined(made([1.0, 1.1], [[(1, 9.0)]] * 2, "a"), made([2.0, 2.1], [[(1, 9.0)]] * 2, "b"))[0]
    cut = whole[whole["optimizer"] == "b"].assign(budget=1000, best_value=0.5)
    runs = pd.concat([whole, cut.assign(run_id=cut["run_id"] + "x")], ignore_index=True)
    names, cells = summary.method_names(runs), summary.summary(runs)
    assert answer(runs, cells, names).best.startswith("Within 1\u202f000 evaluations a run, b ")
    assert answer(runs, cells, names, {1000: 2}).best.startswith("Within 100 evaluations a run, a ")
    unfinished = answer(runs, cells, names, {100: 4, 1000: 2})
    assert unfinished.verdict == "undecided"
    assert "2 of 4 planned runs are done" in unfinished.sure


def test_a_method_that_was_not_run_on_every_problem_is_never_the_best():
    both = [made([2.0, 2.1], [[(1, 9.0)]] * 2, "whole", problem=name, data_id=name) for name in ("p", "q")]
    one = made([1.0, 1.1], [[(1, 9.0)]] * 2, "part", problem="p", data_id="p")
    runs = joined(*both, one)[0]
    told = answer(runs, summary.summary(runs), summary.method_names(runs))
    assert "whole" in told.best
    assert "part" not in told.best


def test_an_abandoned_plan_is_not_waited_for_and_decides_nothing(tmp_path):
    def sweep(*words):
        request = read_request(["problem=sensor_zero", "seeds=2", f"results={tmp_path}", "study=cut", *words], True)
        return request, ResultStore(request.folder)

    first, store = sweep("optimizer=lm,de,trf", "budget=20,300")
    store.open()
    store.plan(first.labels, called=first.called, budgets=first.budgets)
    for run_id, spec in first.specs.items():
        if spec.optimizer == "lm" or spec.budget == 20:
            assert run_id == spec.execute().run_id
            store.write(spec.execute())
    store.collect()
    done = store.finished()
    assert remaining_by_budget(store.manifest(), done) == {300: len(first.specs) - len(done)}
    second, _ = sweep("optimizer=trf,de", "budget=20")
    store.plan(second.labels, called=second.called, budgets=second.budgets, drop=True)
    manifest = store.manifest()
    assert set(manifest["planned"]) == set(second.specs)
    assert not remaining_by_budget(manifest, done)
    lm = {run_id for run_id, spec in first.specs.items() if spec.optimizer == "lm"}
    assert lm <= set(manifest["abandoned"])
    written = write_report(store)
    page = next(path for path in written if path.name == "report.html").read_text()
    assert "lm reaches" not in page
    store.plan(first.labels, called=first.called, budgets=first.budgets)
    assert not store.manifest()["abandoned"]


def test_normal_scores_are_joined_as_scipy_joins_them():
    rng = np.random.default_rng(8)
    for p in (rng.uniform(size=5), 10.0 ** rng.uniform(-200, 0, 3), np.array([1.0, 0.5]), np.array([0.0, 0.3])):
        assert _stouffer(p.tolist()) == pytest.approx(stats.combine_pvalues(p, "stouffer").pvalue, rel=1e-9, abs=0.0)


def test_a_report_of_few_runs_does_not_wait_for_scipy():
    code = "import sys, calibench.bench.report.study.write; print('scipy' in sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert loaded == "False\n"


def test_tails_of_many_runs_are_those_of_scipy_to_the_last_bit():
    rng = np.random.default_rng(5)
    for draw in (lambda n: rng.integers(-9, 12, n).astype(float), lambda n: rng.normal(0.05, 1.0, n)):
        first, second, few = draw(300), draw(90), draw(8)
        apart = first[first != 0]
        for one, other in ((first, second), (few, first)):
            expected = [stats.mannwhitneyu(one, other, alternative=way).pvalue for way in ("less", "greater")]
            assert rank_sum_tails(one, other) == tuple(expected)
        expected = [stats.wilcoxon(apart, method="approx", alternative=way).pvalue for way in ("greater", "less")]
        assert signed_rank_tails(first) == tuple(expected)
