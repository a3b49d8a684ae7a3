"""A sweep whose next setting is proposed from the scores of those before: Optuna over the options of one optimiser.

A trial is one setting on all cells of the command, by the same gate, store and run ids as any sweep. So nothing is kept
of the search but its rows: the same command asks the same proposals again, finds their runs done, and goes on. A trial
without a score (a run without an answer, or nobody at the goal) counts as one decade worse than the worst before it, or
as failed where there was none. The default setting is run first, as it is what choosing must beat.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal, final, get_args

from calibench.bench.statistics.choosing import NEEDED, By, score_of
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.carry_out import Outcome
from calibench.bench.sweep.composition import as_annotated, last_value, parse, values_of
from calibench.bench.sweep.request import Request, read_request
from calibench.bench.sweep.words import PlainOverride
from calibench.bench.verbs import TunerWords
from calibench.bench.words import RequestError, read
from calibench.core.options import unquoted
from calibench.core.seeds import seed_sequence
from calibench.optimizers import registry

Sampler = Literal["tpe", "random", "cmaes"]
_WHOLE_SWEEP = ("shard", "stop_after")  # a trial is judged by all its runs


@final
@dataclass(frozen=True)
class Dimension:
    """What one option may be: numbers from `low` to `high`, or where there are `choices` one of them, as Hydra text."""

    word: str
    option: str
    low: float
    high: float
    whole: bool
    log: bool
    choices: tuple[str, ...]
    default: Any


@final
@dataclass(frozen=True)
class Tuning:
    """What was asked for: the words of every trial, the options that vary, and how they are proposed."""

    words: tuple[str, ...]
    space: tuple[Dimension, ...]
    optimizer: str
    trials: int
    sampler: Sampler
    seed: int
    by: By

    def words_of(self, values: Mapping[str, Any]) -> list[str]:
        """Return the words of ``bench run`` for a setting {option: value}; an option not in it has its default."""
        given = [(d, values[d.option]) for d in self.space if d.option in values]
        return [*self.words, *(f"{d.word}={value if d.choices else repr(value)}" for d, value in given)]


def read_tuning(words: Sequence[str]) -> Tuning:
    ours = [text for text in words if text.partition("=")[0].partition(".")[0] == "tuner"]
    rest = [text for text in words if text not in ours]
    given = read(TunerWords, "run", ours)
    if given.tuner != "optuna":
        way = f"; write tuner=optuna tuner.sampler={given.tuner}" if given.tuner in get_args(Sampler) else ""
        raise RequestError(f"tuner={given.tuner}: tuner=optuna is needed{way}")
    overrides = parse(rest)
    for o in overrides:
        if o.key_or_group in _WHOLE_SWEEP:
            raise RequestError(f"{o.input_line}: a trial is judged by all its runs; leave {o.key_or_group}= out")
    optimizer = last_value([o for o in overrides if not o.is_sweep_override()], "optimizer", "")
    if not optimizer:
        raise RequestError("tuner=optuna: one optimizer=NAME is needed, whose options are to be chosen")
    varied = [o for o in overrides if _option(o.key_or_group, optimizer) and o.is_sweep_override()]
    if not varied:
        raise RequestError(
            "tuner=optuna: no option varies; give one, such as 'optimizer.population=int(interval(10,200))'"
        )
    space = tuple(_dimension(o, optimizer) for o in varied)
    for one, other in combinations(space, 2):
        if one.option == other.option:
            raise RequestError(f"{one.word} and {other.word} are one option; give it once")
    words_left = tuple(text for text, o in zip(rest, overrides, strict=True) if o not in varied)
    if given.sampler == "cmaes" and sum(not d.choices for d in space) < 2:
        raise RequestError("tuner.sampler=cmaes: needs two options that are intervals, or tuner.sampler=tpe")
    return Tuning(
        words=words_left, space=space, optimizer=optimizer, trials=given.trials, sampler=given.sampler, seed=given.seed,
        by=given.by,
    )  # fmt: skip


def _option(key: str, optimizer: str) -> str:
    """Return which option of the optimiser a word is about, ``noise.sigma`` inside another; "" for none."""
    for prefix in ("optimizer.", f"opt.{optimizer}.", f"opt.{optimizer.rpartition(':')[2]}."):
        if key.startswith(prefix):
            return key.removeprefix(prefix)
    return ""


def _dimension(override: Any, optimizer: str) -> Dimension:
    from hydra.core.override_parser.types import IntervalSweep

    word = override.key_or_group
    option = _option(word, optimizer)
    default: Any = None
    kind: Any = Any
    with suppress(ValueError):  # a preset, or a class by its path: read_request says what is wrong with it
        declared = registry.option(optimizer, option)
        default, kind = declared.default, declared.annotation
    value = None if isinstance(override, PlainOverride) else override.value()
    if not isinstance(value, IntervalSweep):
        choices = tuple(dict.fromkeys(values_of(as_annotated(override, kind))))
        if not choices:
            raise RequestError(f"{override.input_line}: holds no value")
        own = next((text for text in choices if _same(text, default)), None)
        ends = {"low": 0.0, "high": 0.0}
        return Dimension(word=word, option=option, **ends, whole=False, log=False, choices=choices, default=own)
    low, high = value.start, value.end
    if low is None or high is None:
        raise RequestError(f"{override.input_line}: interval(LOW,HIGH) with finite LOW < HIGH is needed")
    whole, log = isinstance(low, int) and isinstance(high, int), "log" in value.tags
    if value.tags - {"log"}:
        raise RequestError(f"{override.input_line}: the one tag known is log, as in tag(log,interval(1e-3,1))")
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise RequestError(f"{override.input_line}: interval(LOW,HIGH) with finite LOW < HIGH is needed")
    if log and low <= 0:
        raise RequestError(f"{override.input_line}: a logarithmic scale needs LOW above 0")
    inside = isinstance(default, int | float) and not isinstance(default, bool) and low <= default <= high
    own = (int(default) if whole else float(default)) if inside else None
    return Dimension(word=word, option=option, low=low, high=high, whole=whole, log=log, choices=(), default=own)


def _same(text: str, default: Any) -> bool:
    if isinstance(default, bool) or default is None:
        return text.lower() == {None: "null", True: "true", False: "false"}[default]
    try:
        return float(text) == float(default)
    except (TypeError, ValueError):
        return unquoted(text) == str(default)


@final
@dataclass(frozen=True)
class Trial:
    """One setting and what came of it; the `score` is NaN where there is none. Number 0 is the default."""

    number: int
    values: Mapping[str, Any]
    request: Request
    outcome: Outcome
    score: float


def first_request(tuning: Tuning) -> Request:
    """Return the runs of the default setting, after all ends of the space were checked. Raises `RequestError`."""
    probes: dict[str, list[Any]] = {}  # of each option all choices, or both ends and one between
    for d in tuning.space:
        between = d.low + (d.high - d.low) / math.pi
        probes[d.option] = [*d.choices] or [d.low, d.high, round(between) if d.whole else between]
    middle = {option: values[-1] for option, values in probes.items()}
    for option, values in probes.items():
        for value in values:
            read_request(tuning.words_of(middle | {option: value}), multirun=True)
    return read_request(tuning.words_of({}), multirun=True)


def trials(tuning: Tuning, carry: Callable[[Request, int], Outcome]) -> Iterator[Trial]:
    """Yield the default and then each trial when its runs are done; `carry` does a request, given its number too."""
    import optuna
    from optuna import distributions as optunas, samplers

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    seed = int(seed_sequence("tuner", tuning.sampler, repetition=tuning.seed).generate_state(1)[0])
    sampler: Any = samplers.RandomSampler(seed=seed)
    if tuning.sampler == "cmaes":  # the random one of choices, and before CMA-ES has a population
        sampler = samplers.CmaEsSampler(seed=seed, independent_sampler=sampler, warn_independent_sampling=False)
    elif tuning.sampler == "tpe":
        sampler = samplers.TPESampler(seed=seed)
    distributions: dict[str, Any] = {}
    for d in tuning.space:
        if d.choices:
            distributions[d.option] = optunas.CategoricalDistribution(d.choices)
        elif d.whole:
            distributions[d.option] = optunas.IntDistribution(int(d.low), int(d.high), log=d.log)
        else:
            distributions[d.option] = optunas.FloatDistribution(d.low, d.high, log=d.log)

    study = optuna.create_study(sampler=sampler, direction="minimize")
    worst = -math.inf
    for number in range(tuning.trials + 1):
        asked = study.ask(distributions) if number else None
        values = dict(asked.params) if asked is not None else {}
        request = read_request(tuning.words_of(values), multirun=True)
        outcome = carry(request, number)
        runs = ResultStore(request.folder).runs(NEEDED)
        mine = runs[runs["run_id"].isin(request.specs)].sort_values("run_id")
        score = score_of(mine, tuning.by) if len(mine) == len(request.specs) else math.nan
        if math.isfinite(score):
            worst = max(worst, score)
        value = score if math.isfinite(score) else worst + 1.0
        if asked is not None and not math.isfinite(value):
            study.tell(asked, state=optuna.trial.TrialState.FAIL)
        elif asked is not None:
            study.tell(asked, value)
        elif math.isfinite(value) and all(d.default is not None for d in tuning.space):
            default = {d.option: d.default for d in tuning.space}
            study.add_trial(optuna.trial.create_trial(params=default, distributions=distributions, value=value))
        yield Trial(number, values, request, outcome, score)
