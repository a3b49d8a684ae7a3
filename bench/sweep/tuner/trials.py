"""Trials, one after the other: Optuna proposes a setting, its runs are an ordinary sweep, their score is told back.

A trial is one setting on all cells of the command, by the same gate, store and run ids as any sweep. So nothing is kept
of the search but its rows: the same command asks the same proposals of the same seed again, finds the runs of the
finished trials done, tells their scores and goes on. For that a score depends on the runs of its trial alone, in an
order that does not depend on when they were collected; and a trial without one (a run without an answer, or nobody at
the goal) is told as one decade worse than the worst before it, or as failed where there was none.

The default setting is run first, as it is what choosing must beat.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, final

from calibench.bench.statistics.choosing.settings import NEEDED, score_of
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.carry_out import Outcome
from calibench.bench.sweep.request import Request, read_request
from calibench.bench.sweep.tuner.space import Dimension, Tuning
from calibench.core.seeds import seed_sequence

CarryOut = Callable[[Request, int], Outcome]  # a request, and the number of its trial


@final
@dataclass(frozen=True)
class Trial:
    """One setting and what came of it; the `score` is NaN where there is none. Number 0 is the default."""

    number: int
    values: Mapping[str, Any]
    request: Request
    outcome: Outcome
    score: float


def check_optuna(tuning: Tuning) -> None:
    """Raise `ModuleNotFoundError` in one line where Optuna, or what its sampler needs, is not installed."""
    try:
        for package in ("optuna", "cmaes") if tuning.sampler == "cmaes" else ("optuna",):
            import_module(package)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"tuner=optuna: needs {error.name}; pip install 'calibench[optuna]'") from None


def first_request(tuning: Tuning) -> Request:
    """Return the runs of the default setting, after all ends of the space were checked. Raises `RequestError`."""
    middle = {d.option: d.probes()[-1] for d in tuning.space}
    for d in tuning.space:
        for value in d.probes():
            read_request(tuning.words_of(middle | {d.option: value}), multirun=True)
    return read_request(tuning.words_of({}), multirun=True)


def trials(tuning: Tuning, carry: CarryOut) -> Iterator[Trial]:
    """Yield the default and then each trial when its runs are done; `carry` does the runs of a request."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(sampler=_sampler(tuning), direction="minimize")
    worst = -math.inf
    distributions = {d.option: _distribution(d) for d in tuning.space}
    for number in range(tuning.trials + 1):
        asked = study.ask(distributions) if number else None
        values = dict(asked.params) if asked is not None else {}
        request = read_request(tuning.words_of(values), multirun=True)
        outcome = carry(request, number)
        score = _score(request, tuning)
        if math.isfinite(score):
            worst = max(worst, score)
        told = score if math.isfinite(score) else worst + 1.0
        if asked is not None and not math.isfinite(told):
            study.tell(asked, state=optuna.trial.TrialState.FAIL)
        elif asked is not None:
            study.tell(asked, told)
        elif math.isfinite(told) and all(d.default is not None for d in tuning.space):
            default = {d.option: d.default for d in tuning.space}
            study.add_trial(optuna.trial.create_trial(params=default, distributions=distributions, value=told))
        yield Trial(number, values, request, outcome, score)


def _score(request: Request, tuning: Tuning) -> float:
    runs = ResultStore(request.folder).runs(NEEDED)
    mine = runs[runs["run_id"].isin(request.specs)].sort_values("run_id")
    return score_of(mine, tuning.by) if len(mine) == len(request.specs) else math.nan


def _sampler(tuning: Tuning) -> Any:
    import optuna

    seed = int(seed_sequence("tuner", tuning.sampler, repetition=tuning.seed).generate_state(1)[0])
    if tuning.sampler == "random":
        return optuna.samplers.RandomSampler(seed=seed)
    if tuning.sampler == "cmaes":
        independent = optuna.samplers.RandomSampler(seed=seed)  # of choices, and before CMA-ES has a population
        return optuna.samplers.CmaEsSampler(seed=seed, independent_sampler=independent, warn_independent_sampling=False)
    return optuna.samplers.TPESampler(seed=seed)


def _distribution(d: Dimension) -> Any:
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    if d.choices:
        return CategoricalDistribution(d.choices)
    if d.whole:
        return IntDistribution(int(d.low), int(d.high), log=d.log)
    return FloatDistribution(d.low, d.high, log=d.log)
