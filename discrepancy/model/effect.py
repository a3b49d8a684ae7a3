"""What an effect is: named physics that changes quantities of a machine, and is the identity at zero coefficients.

`EffectFamily` is one physical cause on one kind of machine, as data with a function that builds its candidates.
Most are a `LinearEffect`, whose change of the quantities is linear in its coefficients, or a `ChangePoint`: a quantity
that changes once during the run. Of that a family returns one candidate for each of at most `change_places` times
between visits; the procedure keeps the best, charges it `positions`, and may look between its neighbours (`finer`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from operator import attrgetter
from typing import Any, Protocol, cast, final, runtime_checkable

import numpy as np

from calibench.core.by_value import by_value
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData, gaps_in_words
from calibench.discrepancy.registries import GENERAL, effects, load_shipped
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array


class Effect(Protocol):
    """One candidate: a family (`backlash`) on a target (`joint 2`), with its exact form and its derivative.

    `columns` are those it needs; `channel` says what it acts on (reading, link, base, prediction); `twins` are names
    (`family target`) of candidates that leave the same signature whatever the data, by declared physics.
    `coefficients` are the names of its numbers with `units`; `amplitude` turns them into the one number an engineer
    quotes, in `unit`. `positions` is how many places of a change point were scanned to find it: 1 for all others.
    Some effects have more of what a `LinearEffect` has: `largest`, `along`, `begins`, `over`, `whole`, `span`.
    """

    @property
    def family(self) -> str: ...
    @property
    def target(self) -> str: ...
    @property
    def formula(self) -> str: ...
    @property
    def channel(self) -> str: ...
    @property
    def columns(self) -> tuple[str, ...]: ...
    @property
    def twins(self) -> tuple[str, ...]: ...
    @property
    def coefficients(self) -> tuple[str, ...]: ...
    @property
    def units(self) -> tuple[str, ...]: ...
    @property
    def unit(self) -> str: ...
    @property
    def positions(self) -> int: ...

    def shift(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return quantity -> (n,): what it truly is minus what is recorded or nominal, at coefficients c, (k,)."""

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        """Return the derivative of `shift` in the coefficients, quantity -> (n, k)."""

    def amplitude(self, c: Array) -> float:
        """Return the size an engineer quotes, in `unit`, of coefficients of shape (k,)."""


@final
@dataclass(frozen=True, eq=False)
class OfAnotherRun:
    """An `Effect` over the clock of one run, in another: its mean over times that were met, `clock` name -> (m,)."""

    of: Effect
    clock: Mapping[str, Array]
    family: str = field(init=False)
    target: str = field(init=False)
    formula: str = field(init=False)
    channel: str = field(init=False)
    columns: tuple[str, ...] = field(init=False)
    coefficients: tuple[str, ...] = field(init=False)
    units: tuple[str, ...] = field(init=False)
    unit: str = field(init=False)
    twins: tuple[str, ...] = field(init=False)
    positions: int = field(init=False)

    def __post_init__(self) -> None:
        vars(self).update({one.name: getattr(self.of, one.name) for one in fields(self) if not one.init})

    def amplitude(self, c: Array) -> float:
        return self.of.amplitude(c)

    def shift(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        return self._mean([self.of.shift(q, there, c) for there in self._at(data)])

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        return self._mean([self.of.basis(q, there, c) for there in self._at(data)])

    def _at(self, data: MeasuredData) -> Iterator[MeasuredData]:
        for values in zip(*self.clock.values()):
            yield data.with_columns({name: np.full(len(data), value) for name, value in zip(self.clock, values)})

    @staticmethod
    def _mean(changes: Sequence[Mapping[str, Array]]) -> dict[str, Array]:
        return {name: np.asarray(np.mean([change[name] for change in changes], axis=0)) for name in changes[0]}


@final
@dataclass(frozen=True, eq=False)
class Moment:
    """The position of something, `at` (n,), while an effect acts: its change of `of` is one of `quantity` there.

    Where `quantity` is another than `of`, it is the change of `of` at this moment relative to home, where `at` is zero.
    """

    quantity: str
    of: str
    at: Array


Along = Callable[[MeasuredData], Mapping[str, Sequence[Moment]]]  # covariate -> the moments at which an effect acts


@final
@dataclass(frozen=True, eq=False)
class Alternative:
    """A candidate that is never named alone, but joins a set beside a name that data cannot tell from it.

    `largest` is the amplitude, in the effect's unit, up to which it does.
    """

    effect: Effect
    largest: float = math.inf


Built = Effect | tuple[Effect, ...]  # what a family makes for a target: one candidate, several forms, or none


@final
@dataclass(frozen=True)
class Untestable:
    """A family, or one target of it, that these data cannot test, and the reason.

    `columns` are those in the reason. `missing`: the data do not have them; with them the target could be tested.
    """

    family: str
    target: str
    reason: str
    columns: tuple[str, ...] = ()
    missing: bool = False


@final
@dataclass(frozen=True, eq=False)
class Catalogue:
    """What data can test: candidates that are looked for, alternatives to what is named, and what cannot be tested.

    Several candidates of one name are several forms or places of one cause, of which the best is kept.
    """

    candidates: tuple[Effect, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    untestable: tuple[Untestable, ...] = ()


class NotTestable(Exception):
    """Raised where these data cannot test one target of a family, or it is not searched for alone.

    `columns` are those in the message; `missing`: the data do not have them.
    """

    def __init__(
        self, why: str, columns: tuple[str, ...] = (), missing: bool = False, alternatives: tuple[Alternative, ...] = ()
    ) -> None:
        super().__init__(why)
        self.columns, self.missing, self.alternatives = columns, missing, alternatives


def name_of(effect: Effect) -> str:
    return f"{effect.family} {effect.target}"


@runtime_checkable
class OfFreePeriod(Protocol):
    """An effect whose period is fitted, by its last coefficient, which moves the frequency.

    `period` is that at coefficients c, in `period_unit`: the unit of the column over which it repeats, "" where nobody
    states it.
    """

    @property
    def period_unit(self) -> str: ...
    def period(self, c: Array) -> float: ...


def has_free_period(effect: Effect) -> bool:
    """Return whether an effect is `OfFreePeriod`, cached for each class, because a protocol check is slow."""
    kind = type(effect)
    if kind not in _FREE:
        _FREE[kind] = isinstance(effect, OfFreePeriod)
    return _FREE[kind]


_FREE: dict[type, bool] = {}  # what a class is does not change


def still_open(candidates: Iterable[Effect], taken: Collection[str]) -> list[Effect]:
    """Return the candidates beside effects whose names are `taken`, without these and those that must come later."""
    known = list(candidates)
    before = {name_of(e): str(getattr(e, "after", "")) for e in known}

    opened = {}
    for name, first in before.items():
        while first and first in taken:
            first = before.get(first, "")
        opened[name] = name not in taken and not first
    return [e for e in known if opened[name_of(e)]]


def is_possible(effect: Effect, size: float) -> bool:
    """Return whether an effect may have such an amplitude; any is possible for an effect that states no `largest`."""
    return bool(abs(size) <= getattr(effect, "largest", math.inf))


@final
@dataclass(frozen=True)
class EffectFamily:
    """A cause of error, with what the page of the catalogue says of it.

    `build` returns the candidate for one target or several forms of it, or raises `NotTestable` (see `needs`).
    `columns` may hold `{i}` for the number of the target, and `metadata.NAME`.
    `twins` is a sentence for readers; those of a candidate are names. `label` and `label_of_all` are the words for it,
    on a target and on `all`; `code` is what a label that explains itself comes down to where it was told before.
    `parted_by` says what parts its declared twins, `resolved_by` what would tell families with the same sentence apart
    (`{target}` is filled in). `period` returns the period of its argument in the unit of its column, 0 for none, from
    the metadata and the target. `targets_in` returns the targets of a family that finds them in what a formulation is
    made of (`Roles`); `targets` are then words for them. `never_negative` is what no machine has less than none of;
    `bounds` are the names of the thresholds above which no machine has it.
    """

    name: str
    machine: str
    cause: str
    formula: str
    channel: str
    columns: tuple[str, ...]
    unit: str
    targets: tuple[str, ...]
    build: Callable[[Formulation, str], Built]
    twins: str = ""
    label: str = ""
    label_of_all: str = ""
    parted_by: str = ""
    resolved_by: str = ""
    period: Callable[[Mapping[str, Any], str], float] | None = None
    targets_in: Callable[[Formulation], tuple[str, ...]] | None = None
    code: str = ""
    never_negative: str = ""
    bounds: tuple[str, ...] = ()
    __reduce__ = by_value

    def names_in(self, formulation: Formulation) -> tuple[str, ...]:
        return self.targets if self.targets_in is None else self.targets_in(formulation)

    def candidates(self, formulation: Formulation) -> Catalogue:
        """Return the candidates of all targets, and the targets that the data cannot test."""
        candidates: list[Effect] = []
        alternatives: list[Alternative] = []
        untestable: list[Untestable] = []
        for target in self.names_in(formulation):
            try:
                built = self.build(formulation, target)
            except NotTestable as why:
                alternatives += why.alternatives
                untestable.append(Untestable(self.name, target, str(why), why.columns, why.missing))
            else:
                candidates += built if isinstance(built, tuple) else (built,)
        return Catalogue(tuple(candidates), tuple(alternatives), tuple(untestable))

    def linear(
        self, target: str, columns: tuple[str, ...], coefficients: Mapping[str, str],
        changes: Callable[[Quantities, MeasuredData], dict[str, Array]], *, unit: str = "",
        twins: tuple[str, ...] = (), measure: Callable[[Array], float] | None = None, largest: float = math.inf,
        along: Along | None = None, positions: int = 1, begins: float = math.nan, begins_unit: str = "",
        span: float = math.nan,
    ) -> LinearEffect:  # fmt: skip
        """Return the effect of this family on `target`: `coefficients` are name -> unit, see `LinearEffect`.

        `unit` is that of its amplitude, by default that of its first coefficient.
        """
        return LinearEffect(
            family=self.name, target=target, formula=self.formula, channel=self.channel, columns=columns,
            coefficients=tuple(coefficients), units=tuple(coefficients.values()),
            unit=unit or next(iter(coefficients.values())), changes=changes, twins=twins, measure=measure or size,
            largest=largest, along=along, positions=positions, begins=begins, begins_unit=begins_unit, span=span,
        )  # fmt: skip

    def steps(
        self, target: str, clock: str, t: Array, changes: Mapping[str, tuple[str, str, float]],
        largest: float = math.inf,
    ) -> tuple[ChangePoint, ...]:  # fmt: skip
        """Return the step of this family on `target` at each time of `t`, (n,) of the column `clock`, that is tried.

        `changes` are quantity -> coefficient, its unit, and one of it in the unit of the quantity.
        """
        times = _thinned(_gaps(t))
        coefficients, units, ones = zip(*changes.values())
        return tuple(
            ChangePoint(
                self.name, target, self.formula, channel=self.channel, quantities=tuple(changes),
                coefficients=coefficients, units=units, ones=ones, at=float(at), positions=len(times), clock=clock,
                largest=largest,
            )
            for at in times
        )  # fmt: skip

    def enter(self) -> EffectFamily:
        """Enter the family under its name; entered again, by lines that are run twice, it takes the place of itself."""
        if self.machine != GENERAL:
            load_shipped()  # first, so that theirs stand first
        said = attrgetter("cause", "formula", "channel", "columns", "unit", "targets")
        effects.register(f"{self.machine}/{self.name}", same=lambda known: said(known) == said(self))(lambda: self)
        return self


def needs(data: MeasuredData, *columns: str) -> None:
    """Raise `NotTestable` unless all `columns` are there and vary.

    Calibration absorbs the effect of a constant column.
    """
    needs_there(data, *columns)
    for column in columns:
        if why := gaps_in_words(data[column]):
            raise NotTestable(f"column {column} {why}", (column,))
    still = tuple(column for column in columns if not np.ptp(data[column]) > 1e-12 * np.max(np.abs(data[column])))
    if still:
        raise NotTestable(f"column {', '.join(still)} is constant", still)


def needs_there(data: MeasuredData, *columns: str) -> None:
    """Raise `NotTestable` unless all `columns` are there, constant or not."""
    missing = tuple(column for column in columns if column not in data)
    if missing:
        raise NotTestable(f"needs column{'s' * (len(missing) > 1)} {', '.join(missing)}", missing, missing=True)


def number(target: str) -> int:
    """Return the number in a target: 2 for `joint 2`."""
    return int(target.rpartition(" ")[2])


Cause = EffectFamily  # the name it had first, kept for scripts


def size(c: Array) -> float:
    """Return a single coefficient with its sign, or the length of several."""
    return float(c[0]) if len(c) == 1 else float(np.linalg.norm(c))


def linear_shift(effect: Effect, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
    """Return the `shift` of an effect whose `basis` is the same at all coefficients."""
    return {name: change @ c for name, change in effect.basis(q, data, c).items()}


@final
@dataclass(frozen=True, eq=False)
class LinearEffect:
    """An `Effect` with `shift = changes @ c`; `changes(q, data)` returns quantity -> (n, k).

    No machine has an amplitude above `largest`, in the effect's unit. `begins` is the value of its column from which on
    the effect acts, in `begins_unit`, where that was searched for. `along(data)` returns covariate -> the moments at
    which it acts: its size may depend on the position at each of them. `span` is the
    change of its column over which the effect, if it grows evenly with it, changes by its amplitude.

    `over` are the columns that together are the place on which its size may depend where its formula is off. `whole` is
    the cause of which it is one term: the sine or the cosine of a wave whose phase is any.
    """

    family: str
    target: str
    formula: str
    channel: str
    columns: tuple[str, ...]
    coefficients: tuple[str, ...]
    units: tuple[str, ...]
    unit: str
    changes: Callable[[Quantities, MeasuredData], dict[str, Array]]
    twins: tuple[str, ...] = ()
    measure: Callable[[Array], float] = size
    positions: int = 1
    largest: float = math.inf
    along: Along | None = None
    begins: float = math.nan
    begins_unit: str = ""
    over: tuple[str, ...] = ()
    whole: Effect | None = None
    span: float = math.nan

    shift = linear_shift
    __reduce__ = by_value

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        return self.changes(q, data)

    def amplitude(self, c: Array) -> float:
        return self.measure(c)


Linear = LinearEffect  # the name it had first, kept for scripts


IN_ROWS = "row"  # the clock where none was read; it counts from 0


@final
@dataclass(frozen=True, eq=False)
class ChangePoint:
    """An `Effect`: each of `quantities` is larger by its coefficient from time `at` [s] of the column `clock` on.

    `ones` are a coefficient of 1 in the unit of each quantity. The amplitude is of the coefficients in the unit of the
    first alone.
    """

    family: str
    target: str
    formula: str
    channel: str
    quantities: tuple[str, ...]
    coefficients: tuple[str, ...]
    units: tuple[str, ...]
    ones: tuple[float, ...]
    at: float
    positions: int
    clock: str
    largest: float = math.inf
    twins: tuple[str, ...] = ()
    unit: str = field(init=False)
    columns: tuple[str, ...] = field(init=False)
    begins: float = field(init=False)
    begins_unit: str = field(init=False)  # `IN_ROWS` for the order of the rows, "" for a clock that may run in any

    def __post_init__(self) -> None:
        unit = {"t_s": "s", IN_ROWS: IN_ROWS}.get(self.clock, "")
        vars(self).update(unit=self.units[0], columns=(self.clock,), begins=self.at, begins_unit=unit)

    shift = linear_shift

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        after, units = data[self.clock] >= self.at, np.diag(self.ones)
        return {name: after[:, None] * units[k] for k, name in enumerate(self.quantities)}

    def amplitude(self, c: Array) -> float:
        return size(np.asarray(c)[[unit == self.unit for unit in self.units]])


def finer(effect: Effect, data: MeasuredData) -> tuple[Effect, ...]:
    """Return `effect` at every place between its neighbours, of times at most `change_places`; () if it has none."""
    if not isinstance(effect, ChangePoint):
        return cast(tuple[Effect, ...], getattr(effect, "nearer", ()))
    gaps = _gaps(data[effect.clock])
    coarse = _thinned(gaps)
    k = int(np.argmin(np.abs(coarse - effect.at)))
    low = coarse[k - 1] if k else -np.inf
    high = coarse[k + 1] if k + 1 < len(coarse) else np.inf
    near = _thinned(gaps[(gaps > low) & (gaps < high)])
    return tuple(replace(effect, at=float(at)) for at in near)


def _gaps(t: Array) -> Array:
    """Return the middle of every gap between two different times of t, (n,), but of those near the ends of the run."""
    ordered = np.sort(t)
    edge = int(thresholds().change_edge * len(t))
    times = np.unique(ordered[edge : len(t) - edge])
    return np.asarray((times[1:] + times[:-1]) / 2)


def _thinned(gaps: Array) -> Array:
    if len(gaps) <= thresholds().change_places:
        return gaps
    return np.asarray(gaps[np.unique(np.linspace(0, len(gaps) - 1, thresholds().change_places).round().astype(int))])
