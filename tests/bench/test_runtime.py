"""Fixed target: what a failed run pays, what an interval holds, what a curve counts; each beside an independent one."""

import tracemalloc

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from scipy import stats

from calibench.bench.statistics.fixed_target import Hits, ecdf, ert, ert_interval, performance_profile, runtimes
from calibench.bench.store.arrays import HITS_SCHEMA

ORACLE = "an independent library, not installed here (see docs/statistics.md)"


def study(costs, spent=1000, method="a", problem="p", options="{}", first=0, dimension=4):
    """Return runs and hits of one cell: `costs`, a list a run of what each target cost it, None where it never came."""
    spent = [spent] * len(costs) if np.isscalar(spent) else spent
    ids = [f"{problem}{options}{method}{first + i}" for i in range(len(costs))]
    runs = pd.DataFrame(
        {
            "run_id": ids, "problem": problem, "problem_options": options, "data_id": options, "optimizer": method,
            "optimizer_options": "{}", "start": "random", "budget": 1000, "target": np.nan, "dimension": dimension,
            "charged": spent, "evaluations": spent, "repetition": range(first, first + len(costs)),
            "best_value": np.arange(len(costs)) * 1.0, "judged_value": np.nan, "judged_evaluations": np.nan,
            "unit": "", "minimum": np.nan, "stop_reason": "budget",
        }
    )  # fmt: skip
    rows = [
        (run_id, "value", 10.0**-j, cost) for run_id, own in zip(ids, costs, strict=True) for j, cost in enumerate(own)
    ]
    hits = pd.DataFrame(rows, columns=["run_id", "quantity", "target", "charged"])
    return runs, hits.astype({"charged": float})


def both(*studies):
    return tuple(pd.concat(frames, ignore_index=True) for frames in zip(*studies, strict=True))


def random_study(seed, n=12, targets=6):
    rng = np.random.default_rng(seed)
    made = []
    for method in "ab":
        costs = np.sort(rng.integers(1, 1500, (n, targets)), axis=1)
        spent = rng.integers(900, 1000, n)
        rows = [[int(c) if c <= s else None for c in own] for own, s in zip(costs, spent, strict=True)]
        made.append(study(rows, spent.tolist(), method))
    return both(*made)


def test_a_failed_run_pays_its_own_evaluations():
    runs, hits = study([[100], [300], [None], [None]], spent=[500, 500, 70, 900])
    (row,) = ert(hits, runs).to_dict("records")
    assert row["ert"] == (100 + 300 + 70 + 900) / 2
    assert (row["reached"], row["runs"], row["spent"]) == (2, 4, 1370)
    assert np.isnan(row["at_least"])


def test_where_no_run_arrived_only_a_bound_is_known():
    runs, hits = study([[None]] * 5, spent=200)
    (row,) = ert(hits, runs).to_dict("records")
    assert row["ert"] == np.inf
    assert row["at_least"] == 1000
    assert row["ert_high"] == np.inf
    assert 200 < row["ert_low"] == pytest.approx(200 / stats.binomtest(0, 5).proportion_ci(method="wilson").high)


def test_of_runs_that_failed_before_their_first_evaluation_ert_is_infinite():
    runs, hits = study([[None], [None], [None]], spent=0)
    (row,) = ert(hits, runs).to_dict("records")
    assert (row["ert"], row["at_least"]) == (np.inf, 0)


def test_success_has_wilsons_interval():
    runs, hits = study([[5]] * 7 + [[None]] * 3)
    (row,) = ert(hits, runs).to_dict("records")
    known = stats.binomtest(7, 10).proportion_ci(0.95, method="wilson")
    assert (row["success_low"], row["success_high"]) == (known.low, known.high)


def test_without_chance_there_is_no_interval():
    runs, hits = study([[5]])
    (row,) = ert(hits, runs).to_dict("records")
    assert row["ert"] == 5
    runs, hits = study([[5], [5]])
    runs["best_value"] = 1.0
    runs["optimizer"], runs["start"] = "lm", "nominal"
    (row,) = ert(hits, runs).to_dict("records")
    assert np.isnan([row["ert_low"], row["ert_high"], row["success_low"]]).all()


def test_targets_of_the_runs_are_told_apart_from_those_looked_at():
    runs, hits = study([[3, 7], [4, None]])
    runs["target"] = 0.01
    table = ert(hits, runs)
    assert table["target_value"].tolist() == [0.01, 0.01]
    assert table["target"].tolist() == [1.0, 0.1]


def test_the_interval_is_of_pairs_and_the_same_for_equal_methods_in_any_order():
    runs, hits = random_study(3)
    twin = runs[runs["optimizer"] == "a"].assign(optimizer="c", run_id=lambda f: f["run_id"] + "c")
    more = hits[hits["run_id"].isin(runs.loc[runs["optimizer"] == "a", "run_id"])]
    more = more.assign(run_id=more["run_id"] + "c")
    table = ert(pd.concat([hits, more]), pd.concat([runs, twin.iloc[::-1]])).set_index(["optimizer", "target"])
    columns = ["ert", "ert_low", "ert_high"]
    assert table.loc["a", columns].equals(table.loc["c", columns])
    reached = table.loc["a"]["reached"] > 0
    inside = table.loc["a"][reached]
    assert (inside["ert_low"] <= inside["ert"]).all()
    assert (inside["ert"] <= inside["ert_high"]).all()


@pytest.mark.parametrize("success", [0.5, 0.8, 1.0])
def test_the_interval_of_ert_holds_the_truth_as_often_as_it_says(success):
    rng = np.random.default_rng(20081599)
    cost = rng.exponential(size=(20, 1000))
    won = rng.random(cost.shape) < success
    low, high = ert_interval(cost, won)
    held = ((low <= 1 / success) & (1 / success <= high)).mean()
    assert 0.93 <= held <= 0.97


def test_runs_that_all_pay_the_same_have_an_interval_without_width():
    low, high = ert_interval(np.full((10, 1), 7.0), np.ones((10, 1), dtype=bool))
    assert low[0] == high[0] == pytest.approx(7.0)


def test_instances_are_pooled_and_resampled():
    made = [
        study([[100 + 10 * i], [200 + 7 * i]], options=f'{{"instance":{i},"n":3}}', first=0, problem="f")
        for i in range(6)
    ]
    runs, hits = both(*made)
    assert len(ert(hits, runs)) == 6
    (row,) = ert(hits, runs, instances=("instance",)).to_dict("records")
    assert row["problem_options"] == '{"n":3}'
    assert row["runs"] == 12
    assert row["ert"] == pytest.approx(hits["charged"].mean())
    assert row["resampled"] == "instances"
    sums = hits["charged"].to_numpy().reshape(6, 2).sum(axis=1, keepdims=True)
    low, high = ert_interval(sums, np.full((6, 1), 2))
    assert (row["ert_low"], row["ert_high"]) == (low[0], high[0])


def test_a_target_that_one_instance_declares_is_not_asked_of_the_others():
    (runs, first), (others, second) = (
        study([[50]] * 2, options=f'{{"instance":{i},"n":3}}', problem="f") for i in range(2)
    )
    hits = pd.concat([first, second.assign(target=0.5)], ignore_index=True)
    table = ert(hits, pd.concat([runs, others], ignore_index=True), instances=("instance",)).set_index("target")
    assert table[["runs", "reached", "spent", "ert"]].to_numpy().tolist() == [[2, 2, 100, 50]] * 2
    assert table["ert_low"].isna().all()


def test_the_curve_is_the_share_of_pairs_that_were_reached():
    runs, hits = study([[10, 100], [20, None]])
    curve = ecdf(hits, runs, at=[9, 10, 20, 99, 100, 1000])
    assert curve["share"].tolist() == [0, 0.25, 0.5, 0.5, 0.75, 0.75]


def test_a_curve_is_over_the_problems_that_all_methods_were_run_on():
    a = study([[10]]), study([[None]], problem="q"), study([[10]], problem="r")
    runs, hits = both(*a, study([[100]], method="b"), study([[10]], problem="q", method="b"))
    curve = ecdf(hits, runs, at=[50]).set_index("optimizer")
    assert curve["share"].to_dict() == {"a": 0.5, "b": 0.5}
    assert curve[["problems", "of_problems"]].drop_duplicates().to_numpy().tolist() == [[2, 3]]
    apart = ecdf(hits, runs, by=["problem"], at=[50])
    assert sorted(apart["share"]) == [0.0, 0.0, 1.0, 1.0, 1.0]
    profile = performance_profile(ert(hits, runs))
    assert {(row.optimizer, row.ratio, row.share) for row in profile.itertuples()} == {
        ("a", 1.0, 0.5),
        ("b", 1.0, 0.5),
        ("b", 10.0, 1.0),
    }
    assert profile[["tasks", "of_tasks"]].drop_duplicates().to_numpy().tolist() == [[2, 3]]


def test_where_no_problem_has_all_methods_each_is_over_its_own():
    runs, hits = both(study([[10]]), study([[10]], problem="q", method="b"), study([[None]], problem="r", method="b"))
    curve = ecdf(hits, runs, at=[50]).set_index("optimizer")
    assert curve["share"].to_dict() == {"a": 1.0, "b": 0.5}
    assert curve[["problems", "of_problems"]].to_numpy().tolist() == [[1, 3], [2, 3]]
    assert set(performance_profile(ert(hits, runs))["tasks"]) == {1, 2}


def test_profiles_count_what_is_within_a_factor_of_the_best():
    runs, hits = both(
        study([[10, 50]]), study([[40, None]], method="b"),
        study([[30, None]], problem="q"), study([[15, None]], problem="q", method="b"),
    )  # fmt: skip
    table = ert(hits, runs)
    profile = performance_profile(table)
    told = {(row["optimizer"], row["ratio"]): row["share"] for row in profile.to_dict("records")}
    assert told == {("a", 1.0): 0.5, ("a", 2.0): 0.75, ("b", 1.0): 0.25, ("b", 4.0): 0.5}  # of 4 tasks, one by none


def test_profiles_of_no_task_have_no_steps():
    runs, hits = study([[10]])
    table = ert(hits.iloc[:0], runs)
    assert len(table) == len(performance_profile(table)) == 0


def test_ert_is_that_of_cocopp():
    toolsstats = pytest.importorskip("cocopp.toolsstats", reason=ORACLE)
    runs, hits = random_study(11)
    table = ert(hits, runs)
    for one in runtimes(hits, runs):
        for (method,), mine in one.all_runs.iloc[one.at].reset_index(drop=True).groupby(["optimizer"]):
            at = mine.index.to_numpy()
            for j, target in enumerate(one.all_targets["target"].iloc[one.level]):
                (row,) = table[(table["optimizer"] == method) & (table["target"] == target)].to_dict("records")
                known, share, count = toolsstats.sp(one.paid[at, j], issuccessful=np.isfinite(one.time[at, j]))
                assert row["ert"] == pytest.approx(known, rel=1e-12)
                assert (row["reached"], row["success"]) == (count, pytest.approx(share, rel=1e-12))


def test_the_curve_is_that_of_statsmodels():
    distributions = pytest.importorskip("statsmodels.distributions.empirical_distribution", reason=ORACLE)
    runs, hits = random_study(12)
    at = np.logspace(0, 3.2, 40)
    curve = ecdf(hits, runs, at=at)
    for method, mine in curve.groupby("optimizer"):
        ids = runs.loc[runs["optimizer"] == method, "run_id"]
        times = hits.loc[hits["run_id"].isin(ids), "charged"].fillna(np.inf)
        assert mine["share"].to_numpy() == pytest.approx(distributions.ECDF(times)(at), abs=1e-12)


def test_problems_without_an_option_are_one_group_of_the_curve():
    runs, hits = both(study([[10], [20]]), study([[10], [30]], problem="q"), study([[5]], problem="r"))
    runs = runs.assign(**{"prob.n": runs["problem"].map({"p": np.nan, "q": float("nan"), "r": 3.0})})
    curve = ecdf(hits, runs, by=["prob.n"], at=[15.0])
    assert curve["of_problems"].tolist() == [2, 1]
    assert curve["share"].tolist() == [0.5, 1.0]
    assert ert(hits, runs)["prob.n"].isna().tolist() == [True, True, False]


def test_words_that_are_none_are_refused_with_what_is_near():
    runs, hits = study([[10], [20]])
    with pytest.raises(ValueError, match=r"no column 'problm' .*problem"):
        ecdf(hits, runs, by=["problm"])
    with pytest.raises(ValueError, match="option 'instanc'"):
        ert(hits, runs, instances=("instanc",))


@pytest.mark.parametrize("paid", [[22.0] * 6 + [20.0] * 2, [22, 22, 19, 16, 22, 22, 22, 16]])
def test_runs_that_pay_nearly_the_same_have_an_interval_near_it(paid):
    """A resample of equal runs has no spread of its own: it once drew the lower end to 1."""
    [low], [high] = ert_interval(np.array(paid, float)[:, None], np.ones((len(paid), 1), dtype=bool))
    assert min(paid) - 6 < low < np.mean(paid) < high < max(paid) + 6


def test_hits_are_the_same_in_whatever_parts_and_order_they_come():
    runs, hits = random_study(7)
    schema = pa.schema([HITS_SCHEMA.field(name) for name in Hits.COLUMNS])
    table = pa.Table.from_pandas(hits[Hits.COLUMNS], schema, preserve_index=False)
    whole = ert(hits, runs)
    assert len(whole) > 1
    for size in (1, 7, len(table)):
        parts = (table.slice(begin, size) for begin in range(0, len(table), size))
        pd.testing.assert_frame_equal(ert(Hits.of(parts), runs), whole)
    keys = ["optimizer", "quantity", "target"]
    mixed = ert(hits.sample(frac=1.0, random_state=1), runs).sort_values(keys, ignore_index=True)
    pd.testing.assert_frame_equal(mixed[whole.columns], whole.sort_values(keys, ignore_index=True))


def test_resamples_of_many_runs_are_never_there_at_once():
    """Of 8000 runs 999 resamples are 64 MB as numbers, and twice that as they are drawn."""
    rng = np.random.default_rng(3)
    paid = rng.integers(1, 90, (8000, 2)).astype(float)
    tracemalloc.start()
    low, high = ert_interval(paid, paid < 30)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 32e6
    costs = paid.sum(axis=0) / (paid < 30).sum(axis=0)
    assert (low < costs).all()
    assert (costs < high).all()
