"""A sweep whose next setting is proposed from the scores of those before: Optuna over the options of one optimiser.

``interval(0.3,0.9)`` is any number between, ``int(interval(10,200))`` any whole one, ``tag(log,int(interval(10,200)))``
likewise on a logarithmic scale; ``range(10,200,10)`` and ``a,b,c`` are values to choose from.

A trial is one setting on all cells of the command, by the same gate, store and run ids as any sweep. So nothing is kept
of the search but its rows: the same command asks the same proposals of the same seed again, finds the runs of the
finished trials done, tells their scores and goes on. For that a score depends on the runs of its trial alone, in an
order that does not depend on when they were collected; and a trial without one (a run without an answer, or nobody at
the goal) counts as one decade worse than the worst before it, or as failed where there was none. The default setting is
run first, as it is what choosing must beat.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import combinations
from typing import Annotated, Any, Literal, final, get_args

from calibench.bench.statistics.choosing import NEEDED, By, default_of, score_of
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.carry_out import Outcome
from calibench.bench.sweep.composition import as_annotated, last_value, parse, values_of
from calibench.bench.sweep.request import Request, read_request
from calibench.bench.sweep.words import PlainOverride, RequestError, Word, read
from calibench.core.options import LARGEST_WHOLE, unquoted
from calibench.core.seeds import seed_sequence
from calibench.optimizers import registry

Sampler = Literal["tpe", "random", "cmaes"]
MOST_TRIALS = 10_000
_WHOLE_SWEEP = ("shard", "stop_after")  # a trial is judged by all its runs


@final
@dataclass(frozen=True)
class Dimension:
    """What one option may be: numbers from `low` to `high`, or where there are `choices` one of them, as Hydra text.

    `option` is its name, ``noise.sigma`` inside another, and `word` what the command calls it. `default` is the
    declared one; None where it is not known or lies outside.
    """

    word: str
    option: str
    low: float
    high: float
    whole: bool
    log: bool
    choices: tuple[str, ...]
    default: Any

    def probes(self) -> list[Any]:
        """Return values that must be right before anything runs: all choices, or both ends and one between."""
        if self.choices:
            return list(self.choices)
        between = self.low + (self.high - self.low) / math.pi
        return [self.low, self.high, round(between) if self.whole else between]

    def text(self, value: Any) -> str:
        """Return KEY=VALUE for `value`."""
        return f"{self.word}={value if self.choices else repr(value)}"


@final
@dataclass(frozen=True)
class TunerWords:
    """The words that say how options are proposed."""

    tuner: Annotated[str, Word("tuner", "optuna", "Optuna proposes values for options")] = ""
    trials: Annotated[int, Word("tuner.trials", "N", "how many settings are tried", least=1, most=MOST_TRIALS)] = 20
    sampler: Annotated[Sampler, Word("tuner.sampler", "tpe|random|cmaes", "how the next one is chosen")] = "tpe"
    seed: Annotated[int, Word("tuner.seed", "N", "of the sampler", least=0, most=LARGEST_WHOLE)] = 0
    by: Annotated[By, Word("tuner.by", "value|goal", "what is best")] = "value"


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
        return [*self.words, *(d.text(values[d.option]) for d in self.space if d.option in values)]


def read_tuning(words: Sequence[str]) -> Tuning:
    """Return what `words` ask for. Raises `RequestError`."""
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
        words=words_left,
        space=space,
        optimizer=optimizer,
        trials=given.trials,
        sampler=given.sampler,
        seed=given.seed,
        by=given.by,
    )


def _option(key: str, optimizer: str) -> str:
    """Return which option of the optimiser a word is about, ``noise.sigma`` inside another; "" where it is about none.

    A class of a file is addressed by its name alone, too.
    """
    for prefix in ("optimizer.", f"opt.{optimizer}.", f"opt.{optimizer.rpartition(':')[2]}."):
        if key.startswith(prefix):
            return key.removeprefix(prefix)
    return ""


def _dimension(override: Any, optimizer: str) -> Dimension:
    from hydra.core.override_parser.types import IntervalSweep

    word = override.key_or_group
    option = _option(word, optimizer)
    try:
        default = default_of(optimizer, option)
    except ValueError:  # a preset, or a class by its path: read_request says what is wrong with it
        default = None
    value = None if isinstance(override, PlainOverride) else override.value()
    if not isinstance(value, IntervalSweep):
        choices = tuple(dict.fromkeys(values_of(as_annotated(override, _kind(optimizer, option)))))
        if not choices:
            raise RequestError(f"{override.input_line}: holds no value")
        own = next((text for text in choices if _same(text, default)), None)
        return Dimension(
            word=word, option=option, low=0.0, high=0.0, whole=False, log=False, choices=choices, default=own
        )
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


def _kind(optimizer: str, option: str) -> Any:
    """Return what an option is annotated with; anything where that is not known."""
    try:
        return registry.option(optimizer, option).annotation
    except ValueError:  # a preset, or a class by its path: read_request says what is wrong with it
        return Any


def _same(text: str, default: Any) -> bool:
    """Tell whether Hydra's text stands for a default."""
    if isinstance(default, bool) or default is None:
        return text.lower() == {None: "null", True: "true", False: "false"}[default]
    try:
        return float(text) == float(default)
    except (TypeError, ValueError):
        return unquoted(text) == str(default)


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
