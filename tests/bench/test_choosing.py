"""Choosing a setting: nested selection against plain NumPy, against known truths, and at the command line."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from calibench.bench.statistics.choosing import Scored, choose, nest, score_of
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.carry_out import sweep
from tests.few import few

pytestmark = pytest.mark.usefixtures("one_process")

STUDIES, RESAMPLES, UNITS, SETTINGS, SEED = 200, 499, 10, 6, 20261122  # of each simulation, stated before it was run


def _mean(values: np.ndarray) -> Scored:
    return Scored(values, np.ones_like(values), log=False)


def _by_hand(paid: np.ndarray, won: np.ndarray, log: bool) -> tuple[float, float, list[int]]:
    """Return apparent and nested score and the choices, by two loops (leave one group out)."""

    def score(s: int, units: list[int]) -> float:
        ratio = sum(paid[s, i] for i in units) / sum(won[s, i] for i in units)
        return float(np.log10(ratio)) if log else float(ratio)

    settings, every = range(len(paid)), list(range(paid.shape[1]))
    chosen = []
    for left in every:
        rest = [i for i in every if i != left]
        chosen.append(min(settings, key=lambda s: score(s, rest)))
    top = sum(paid[s, i] for i, s in enumerate(chosen)) / sum(won[s, i] for i, s in enumerate(chosen))
    return min(score(s, every) for s in settings), float(np.log10(top)) if log else float(top), chosen


@pytest.mark.parametrize("log", [False, True])
def test_nested_selection_is_leave_one_group_out(log: bool) -> None:
    rng = np.random.default_rng(SEED)
    for _ in range(20):
        paid = rng.uniform(1.0, 100.0, (5, 9))
        won = rng.integers(1, 5, (5, 9)).astype(float) if log else np.ones((5, 9))
        found = nest(Scored(paid, won, log), default=0, resamples=99)
        apparent, nested, chosen = _by_hand(paid, won, log)
        assert found.apparent == pytest.approx(apparent, rel=1e-12)
        assert found.nested == pytest.approx(nested, rel=1e-12)
        assert found.optimism == pytest.approx(nested - apparent, abs=1e-9)
        assert found.chosen.tolist() == chosen


def _simulated(ahead: float) -> list[tuple[float, float, float, float, bool, bool]]:
    """Return apparent, nested, truth of what was chosen, gain, above 0, covered, of studies with one setting ahead."""
    rng = np.random.default_rng(SEED)
    truth = np.zeros(SETTINGS)
    truth[1] = -ahead
    found, worth = [], []
    for _ in range(STUDIES):
        easy = rng.normal(0.0, 2.0, UNITS)
        one = nest(
            _mean(truth[:, None] + easy + rng.normal(0.0, 1.0, (SETTINGS, UNITS))), default=0, resamples=RESAMPLES
        )
        worth.append(float(-truth[one.chosen].mean()))
        found.append((one, float(easy.mean())))
    gained = float(np.mean(worth))
    return [
        (one.apparent - level, one.nested - level, -own, one.gain, one.beats_default,
         one.gain_interval[0] <= gained <= one.gain_interval[1])
        for (one, level), own in zip(found, worth, strict=True)
    ]  # fmt: skip


def test_where_all_settings_are_equal_the_apparent_score_is_optimistic_and_the_nested_one_is_not() -> None:
    apparent, nested, _, gain, above, covered = map(np.array, zip(*_simulated(ahead=0.0), strict=True))
    error = 3 / np.sqrt(STUDIES)  # three standard errors of a mean, for each unit of spread
    least = -1.267 / np.sqrt(UNITS)  # the expected least of six normal means
    assert apparent.mean() == pytest.approx(least, abs=error * apparent.std())
    assert apparent.mean() < -4 * apparent.std() / np.sqrt(STUDIES)
    assert abs(nested.mean()) < error * nested.std()
    assert abs(gain.mean()) < error * gain.std()
    assert above.mean() <= 0.05
    assert covered.mean() >= 0.93


@pytest.mark.parametrize("ahead", few(1, [0.5, 1.5, 3.0]))
def test_what_choosing_wins_is_told_without_bias_and_covered(ahead: float) -> None:
    _, nested, truth, gain, above, covered = map(np.array, zip(*_simulated(ahead), strict=True))
    error = 3 / np.sqrt(STUDIES)
    assert abs((nested - truth).mean()) < error * (nested - truth).std()
    assert abs((gain + truth).mean()) < error * (gain + truth).std()
    assert covered.mean() >= 0.92
    assert ahead < 3.0 or above.mean() > 0.95


def test_no_setting_reaching_the_goal_on_one_instance_is_no_number_that_is_made_up() -> None:
    paid, won = np.full((2, 6), 100.0), np.ones((2, 6))
    won[0] = 0.0
    found = nest(Scored(paid, won, log=True), default=0)
    assert found.best == 1
    assert found.gain == np.inf
    assert found.beats_default


SWEEP = "problem=sensor_zero problem.instance=range(1,8) optimizer=de optimizer.population=10,30,150 budget=300 seeds=2"


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("choosing")
    sweep(*SWEEP.split(), f"results={folder}")
    return folder / "adhoc"


def test_a_sweep_is_chosen_from_as_its_rows_say(swept) -> None:
    runs = ResultStore(swept).runs()
    found = choose(runs)
    levels = runs["best_value"] - runs["minimum"].fillna(0.0)
    logs = np.log10(np.maximum(levels, [list(t)[-1] for t in runs["targets"]]))
    table = logs.groupby([runs["optimizer_options"], runs["problem_options"]]).mean().unstack()
    rest = pd.DataFrame({left: table.drop(columns=left).mean(axis=1) for left in table})
    nested = np.mean([table.loc[rest[left].idxmin(), left] for left in table])
    assert found.nested.apparent == pytest.approx(table.mean(axis=1).min(), rel=1e-12)
    assert found.nested.nested == pytest.approx(nested, rel=1e-12)
    default = next(text for text in table.index if json.loads(text)["population"] == 150)
    assert found.names[0] == "population=150"
    assert found.nested.gain == pytest.approx(table.loc[default].mean() - nested, abs=1e-12)
    one = runs[runs["optimizer_options"] == default]
    assert score_of(one, "value") == pytest.approx(table.loc[default].mean(), rel=1e-12)


def test_choose_tells_apparent_nested_optimism_and_gain(run_bench, swept) -> None:
    code, out, err = run_bench(f"choose {swept}")
    assert (code, err) == (0, "")
    assert "de: 3 settings on 7 instances, 42 runs" in out
    assert "population=150 (default)" in out
    for said in ("(apparent)", "(nested, leaving one instance out)", "optimism", "gain over the default"):
        assert said in out
    code, out, _ = run_bench(f"choose {swept} --json")
    [told] = json.loads(out)
    assert sum(setting["times_chosen"] for setting in told["settings"]) == len(told["units"]) == 7
    assert told["optimism"] == pytest.approx(told["nested"] - told["apparent"])


def test_the_goal_is_a_score_too(run_bench, tmp_path, swept) -> None:
    words = SWEEP.replace("optimizer.population=10,30,150", "optimizer.population=10,150").split()
    run_bench(["run", "-m", *words, "target=1e6"])
    [told] = json.loads(run_bench("choose results/adhoc by=goal --json")[1])
    store = ResultStore(tmp_path / "results" / "adhoc")
    runs, hits = store.runs(), store.hits()
    at = hits[hits["target"] == 1e6].set_index("run_id")["charged"].astype(float)[runs["run_id"]].to_numpy()
    hit, paid = np.isfinite(at), np.where(np.isfinite(at), at, runs["charged"])
    sums = pd.DataFrame({"paid": paid, "won": hit, "o": runs["optimizer_options"]}).groupby("o").sum()
    assert 10 ** told["apparent"] == pytest.approx((sums["paid"] / sums["won"]).min())
    code, _, err = run_bench(f"choose {swept} by=target")
    assert code == 2
    assert "goal" in err


def _instance(runs: pd.DataFrame) -> pd.Series:
    return runs["problem_options"].map(lambda text: json.loads(text)["instance"])


def _first(runs: pd.DataFrame) -> pd.Series:
    return runs["optimizer_options"] == runs["optimizer_options"].iloc[0]


@pytest.mark.parametrize(
    ("part", "says"),
    [
        (lambda runs: runs[_instance(runs) <= 5], "problem.instance='range(1,13)'"),
        (lambda runs: runs[_first(runs)], "sweep an option"),
        (lambda runs: pd.concat([runs, runs.assign(budget=900)]), "such as budget=300"),
        (lambda runs: runs[_first(runs) | (runs.index % 5 == 0)], "goes on"),
    ],
)
def test_what_cannot_be_told_is_refused_with_the_way_out(swept, part, says) -> None:
    with pytest.raises(ValueError, match=r"^[^\n]+$") as refused:
        choose(part(ResultStore(swept).runs().sort_values("optimizer_options", ignore_index=True)))
    assert says in str(refused.value)


def test_seeds_are_no_instances(run_bench, tmp_path) -> None:
    run_bench("run -m problem=sensor_zero optimizer=de optimizer.population=10,50 budget=200 seeds=6")
    code, out, err = run_bench("choose results/adhoc")
    assert (code, out) == (2, "")
    assert "nothing can be said about other instances" in err
    assert "or over=seeds nests over seeds" in err
    run_bench("run -m problem=sensor_zero optimizer=de optimizer.population=10,50 budget=200 seeds=2 study=few")
    assert "or seeds=6 or more and over=seeds nest over seeds" in run_bench("choose results/few")[2]
    code, out, _ = run_bench("choose results/adhoc over=seeds")
    assert code == 0
    assert "a statement on new seeds of these instances alone" in out


def test_a_sweep_without_the_default_says_so(swept) -> None:
    runs = ResultStore(swept).runs()
    found = choose(runs[~runs["optimizer_options"].str.contains('"population":150')])
    assert found.nested.default is None
    assert np.isnan(found.nested.gain)


def test_a_default_that_always_fails_is_not_the_best(swept) -> None:
    """Of two settings, one of which never fails, that one is best, and choosing it beats the other."""
    runs = ResultStore(swept).runs()
    whole = choose(runs)
    default, other = whole.options[0], whole.options[1]
    two = runs[runs["optimizer_options"].isin([default, other]) & (runs["repetition"] == 0)].reset_index(drop=True)
    two.loc[two["optimizer_options"] == default, ["status", "best_value"]] = ["failed", np.nan]
    found = choose(two)
    assert found.options[found.nested.best] == other
    assert set(found.nested.chosen) == {found.options.index(other)}
    assert found.nested.gain == pytest.approx(1.0)
    assert found.nested.beats_default


def test_a_run_without_an_answer_counts_as_worse_than_the_worst_of_its_instance(swept) -> None:
    runs = ResultStore(swept).runs()
    whole = choose(runs)
    at = runs.index[runs["optimizer_options"] == whole.options[whole.nested.best]]
    runs.loc[at[:2], ["status", "best_value"]] = ["failed", np.nan]
    found = choose(runs)
    assert found.without_answer == 2
    before = dict(zip(whole.options, whole.nested.scores, strict=True))
    after = dict(zip(found.options, found.nested.scores, strict=True))
    assert after[whole.options[whole.nested.best]] >= before[whole.options[whole.nested.best]]
    assert np.isfinite(list(after.values())).all()


def test_what_was_not_run_on_all_instances_is_left_out_and_named(swept) -> None:
    runs = ResultStore(swept).runs()
    some = runs["optimizer_options"].str.contains('"population":30') & (runs["repetition"] >= 0)
    found = choose(runs.drop(runs.index[some][:2]))
    assert found.left_out == ("population=30",)
    assert len(found.names) == 2
