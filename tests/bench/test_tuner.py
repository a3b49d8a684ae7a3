"""A sweep that Optuna proposes: ordinary rows by the same gate, the same proposals again, resumed where it ended."""

from __future__ import annotations

import re
import sys

import numpy as np
import pandas as pd
import pytest

from calibench.bench.statistics.choosing import choose, score_of
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep import tuner
from calibench.bench.sweep.carry_out import carry_out
from calibench.bench.sweep.tuner import first_request, read_tuning, trials
from calibench.bench.words import RequestError
from tests.bench.test_cli import REPEATABLE

pytestmark = pytest.mark.usefixtures("one_process")

pytest.importorskip("optuna")
pytest.importorskip("cmaes")

CELLS = ["problem=sensor_zero", "problem.instance=range(1,7)", "optimizer=de", "budget=120", "seeds=1"]
FEW = ["problem=sensor_zero", "problem.instance=range(1,4)", "budget=20", "seeds=1"]
SPACE = ["optimizer.population=tag(log,int(interval(5,60)))", "optimizer.F=interval(0.3,0.9)"]
TUNED = [*CELLS, *SPACE, "tuner=optuna"]


def _rows(folder, study="adhoc") -> pd.DataFrame:
    return ResultStore(folder / "results" / study).runs().sort_values("run_id", ignore_index=True)


def _trials(out: str) -> list[str]:
    return re.findall(r"^trial \d+.*score .*|^the default.*score .*", out, re.MULTILINE)


def test_trials_are_ordinary_rows_and_the_choice_is_told(run_bench, tmp_path) -> None:
    code, out, err = run_bench(["run", *TUNED, "tuner.trials=4"])
    assert code == 0, err
    rows = _rows(tmp_path)
    settings = rows.groupby("optimizer_options").size()
    assert len(settings) == 5  # the default and four
    assert (settings == 6).all()
    assert (rows["charged"] <= 120).all()
    assert len(_trials(out)) == 5
    assert "(nested, leaving one instance out)" in out
    assert "gain over the default" in out
    assert "the nested score leaves out that optimism" in out
    found = choose(rows)
    told = {round(float(number), 3) for number in re.findall(r"score (-?[\d.]+)", "\n".join(_trials(out)))}
    assert told == {round(float(score), 3) for score in found.nested.scores}
    one = rows[rows["optimizer_options"] == settings.index[0]]
    assert score_of(one, "value") == pytest.approx(found.nested.scores[found.options.index(settings.index[0])])


@pytest.mark.slow
def test_a_longer_search_goes_on_where_the_shorter_ended_with_any_number_of_workers(run_bench, tmp_path) -> None:
    _, short, _ = run_bench(["run", *TUNED, "tuner.trials=11"])
    done = _rows(tmp_path)
    _, long, _ = run_bench(["run", *TUNED, "tuner.trials=12", "execution=processes", "execution.n_jobs=2"])
    _, whole, _ = run_bench(["run", *TUNED, "tuner.trials=12", "study=whole"])

    def settings(out: str) -> list[str]:
        return [re.sub(r" of \d+", "", line) for line in _trials(out)]

    assert settings(long)[:12] == settings(short)
    assert settings(long) == settings(whole)
    both = [_rows(tmp_path), _rows(tmp_path, "whole")]
    varying = [*REPEATABLE, "study"]
    pd.testing.assert_frame_equal(*(rows.drop(columns=varying, errors="ignore") for rows in both))
    again = both[0].set_index("run_id").loc[done["run_id"], "started_at"].tolist()
    assert again == done["started_at"].tolist()
    assert f"{len(done)} of those asked for were done before" in long


@pytest.mark.slow
def test_a_search_that_was_killed_within_a_trial_is_as_if_it_had_not_been(run_bench, tmp_path) -> None:
    _, whole, _ = run_bench(["run", *TUNED, "tuner.trials=3", "study=whole"])
    rows = _rows(tmp_path, "whole")
    last = rows[rows["optimizer_options"] == rows.sort_values("started_at")["optimizer_options"].iloc[-1]]
    store = ResultStore(tmp_path / "results" / "whole")
    store.forget(set(last["run_id"].iloc[:4]))  # what the kill took: most runs of the last trial
    code, again, _ = run_bench(["run", *TUNED, "tuner.trials=3", "study=whole"])
    assert code == 0
    assert _trials(again) == _trials(whole)
    assert "20 of those asked for were done before" in again
    assert len(_rows(tmp_path, "whole")) == 24


@pytest.mark.slow
@pytest.mark.parametrize("sampler", ["tpe", *(pytest.param(s, marks=pytest.mark.slow) for s in ("random", "cmaes"))])
def test_a_seed_proposes_the_same_again_and_another_seed_does_not(sampler, tmp_path) -> None:
    def proposed(seed: int) -> list[dict]:
        few = [word.replace("range(1,7)", "1") for word in TUNED]
        words = [*few, "tuner.trials=6", f"tuner.sampler={sampler}", f"tuner.seed={seed}", f"results={tmp_path}"]
        tuning = read_tuning(words)
        return [
            dict(trial.values)
            for trial in trials(tuning, lambda request, number: carry_out(request, lambda done, of, label: None))
        ]

    first = proposed(0)
    assert proposed(0) == first
    assert proposed(1)[1:] != first[1:]
    assert first[0] == {}
    assert all(5 <= values["population"] <= 60 and 0.3 <= values["F"] <= 0.9 for values in first[1:])


@pytest.mark.slow
def test_a_trial_without_a_score_is_told_as_worse_than_all_before(run_bench, tmp_path) -> None:
    words = [*TUNED, "tuner.trials=3", "tuner.by=goal", "target=1e-200"]
    code, out, _ = run_bench(["run", *words])
    assert code == 0
    assert out.count("no score") == 4
    assert "what choosing is worth is not told" in out


@pytest.mark.slow
def test_choices_and_flags_are_searched_too(run_bench, tmp_path) -> None:
    code, _, err = run_bench(
        ["run", *CELLS, "opt.de.population=10,20", "opt.de.early_abandon=true,false", "tuner=optuna", "tuner.trials=5"]
    )
    assert code == 0, err
    found = _rows(tmp_path)["optimizer_options"].unique()
    assert all('"population":10' in text or '"population":20' in text or '"population":150' in text for text in found)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([*TUNED, "tuner.trials=0"], "tuner.trials=0: a whole number from 1"),
        ([*TUNED, "tuner.sampler=grid"], "tuner.sampler=grid"),
        ([*TUNED, "tuner.trial=3"], "tuner.trials"),
        ([*TUNED, "tuner.by=charged"], "tuner.by=charged"),
        ([*TUNED[:-1], "tuner=skopt"], "tuner=optuna is needed"),
        ([*TUNED[:-1], "tuner=random"], "tuner=optuna is needed; write tuner=optuna tuner.sampler=random"),
        ([*TUNED[:-1], "tuner.trials=3"], "tuner=optuna is needed"),
        ([*TUNED, "shard=1/2"], "judged by all its runs"),
        ([*CELLS, "tuner=optuna"], "no option varies"),
        ([*CELLS, "optimizer.population=interval(5,60)", "tuner=optuna"], "population"),
        ([*CELLS, "optimizer.population=int(interval(60,5))", "tuner=optuna"], "LOW < HIGH"),
        ([*CELLS, "optimizer.population=tag(log,int(interval(0,5)))", "tuner=optuna"], "LOW above 0"),
        ([*CELLS, "optimizer.population=tag(step,int(interval(1,5)))", "tuner=optuna"], "tag known is log"),
        ([*CELLS, "optimizer.popul=int(interval(1,5))", "tuner=optuna"], "population"),
        ([*CELLS, "optimizer.population=int(interval(-9,60))", "tuner=optuna"], "population"),
        ([*CELLS, SPACE[0], "tuner=optuna", "tuner.sampler=cmaes"], "two options"),
        (["problem=sensor_zero", "optimizer=lm,de", SPACE[0], "tuner=optuna"], "one optimizer=NAME"),
    ],
)
def test_a_search_that_makes_no_sense_is_refused_in_one_line(run_bench, tmp_path, words, says) -> None:
    code, out, err = run_bench(["run", *words])
    assert (code, out) == (2, "")
    assert says in err
    assert err.count("\n") == 1
    assert not (tmp_path / "results").exists()


def test_a_dry_run_writes_nothing(run_bench, tmp_path) -> None:
    code, out, _ = run_bench(["run", *TUNED, "--dry-run"])
    assert code == 0
    assert "the default and 20 trials of 6 runs each, at most 126 runs" in out
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(("missing", "sampler"), [("optuna", "tpe"), ("cmaes", "cmaes")])
def test_without_the_package_one_line_says_how_to_get_it(run_bench, tmp_path, monkeypatch, missing, sampler) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    code, _, err = run_bench(["run", *TUNED, f"tuner.sampler={sampler}"])
    assert code == 2
    assert f"needs {missing}; pip install 'calibench[optuna]'" in err
    assert not (tmp_path / "results").exists()


def test_the_space_is_checked_before_anything_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    real = tuner.read_request
    monkeypatch.setattr(tuner, "read_request", lambda words, **how: asked.extend(words) or real(words, **how))
    tuning = read_tuning(TUNED)
    assert [d.default for d in tuning.space] == [None, 0.5]  # 150 lies outside 5 .. 60
    assert len(first_request(tuning).specs) == 6
    option = tuning.space[1].option
    tried = {float(word.rpartition("=")[2]) for word in asked if word.partition("=")[0].endswith(option)}
    assert any(np.isclose(value, 0.3 + 0.6 / np.pi) for value in tried)


NESTED = """
from dataclasses import dataclass, field

from calibench import optimizers


@dataclass(frozen=True)
class Step:
    size: float = 0.5


@dataclass
class Walk:
    near: Step = field(default_factory=lambda: Step(0.2))
    far: Step = field(default_factory=Step)
    shrink: float = 1.0

    traits = optimizers.Traits(stochastic=True)

    def minimize(self, objective, rng):
        assert self.near.size <= 0.3 <= self.far.size, (self.near, self.far)
        while True:
            size = self.shrink * (self.near.size if rng.random() < 0.5 else self.far.size)
            inside = rng.random(objective.dimension) * (objective.upper - objective.lower)
            objective(objective.lower + size * inside)
"""


@pytest.fixture(scope="module")
def walk(tmp_path_factory) -> str:
    file = tmp_path_factory.mktemp("own") / "walk.py"
    file.write_text(NESTED)
    return f"{file}:Walk"


@pytest.mark.slow
def test_options_of_one_name_in_two_others_are_two_options(run_bench, tmp_path, walk) -> None:
    words = [*CELLS[:2], "budget=20", "seeds=1", f"optimizer={walk}", "tuner=optuna", "tuner.trials=3"]
    space = ["optimizer.near.size=interval(0.1,0.3)", "opt.Walk.far.size=interval(0.3,0.9)", "opt.Walk.shrink=0.5,1.0"]
    tuning = read_tuning([*words, *space])
    assert [(d.option, d.default) for d in tuning.space] == [("near.size", 0.2), ("far.size", 0.5), ("shrink", "1.0")]
    code, out, err = run_bench(["run", *words, *space, "tuner.sampler=random"])
    assert code == 0, err
    rows = ResultStore(tmp_path / "results" / "adhoc").runs(options=True)
    assert (rows["status"] == "ok").all(), rows["error"].tolist()
    assert len(rows) == 4 * 6  # the default and three settings on six instances: no list is swept beside them
    assert rows["opt.near.size"].nunique() == rows["opt.far.size"].nunique() == 4
    assert "near.size=" in out
    assert "(default)" in out


@pytest.mark.slow
def test_a_default_that_always_fails_does_not_end_the_search(run_bench, tmp_path, walk) -> None:
    words = [*FEW, f"optimizer={walk}", "optimizer.near.size=0.5", "tuner=optuna"]
    code, out, err = run_bench(["run", *words, "optimizer.shrink=interval(0.5,1)", "tuner.trials=2", "study=none"])
    assert code == 1, err
    assert out.count("no score (a run without an answer") == 3  # the default and both trials
    assert "9 failed; `bench status" in out
    assert "what choosing is worth is not told" in out
    mixed = [word for word in words if "near" not in word] + ["optimizer.far.size=0.2,0.6", "optimizer.near.size=0.3"]
    code, out, _ = run_bench(["run", *mixed, "tuner.trials=6", "tuner.sampler=random"])
    assert 0 < out.count("no score") < 6  # 0.2 fails, 0.6 does not
    assert code == 1


def test_one_option_by_two_words_is_refused(walk) -> None:
    with pytest.raises(RequestError, match="are one option; give it once"):
        read_tuning([*CELLS, "tuner=optuna", "optimizer.F=interval(0.3,0.9)", "opt.de.F=interval(0.4,0.8)"])
