"""`Report`: what is missing, where, how large, with which rivals; the gap before and after; what was not testable."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from math import isfinite, nan
from typing import Any, Literal, cast, final, get_args

import numpy as np
from numpy.typing import NDArray

from calibench.core.by_value import by_value
from calibench.core.notes import Note
from calibench.core.plain import finite, value_of
from calibench.core.tables.cells import between, factor_to_base, is_unit
from calibench.core.tables.columns import is_table, named_columns
from calibench.core.words import html_table
from calibench.discrepancy.diagnostics.smooth_term import smooth_columns
from calibench.discrepancy.fitting.fit import ResidualProblem
from calibench.discrepancy.model.effect import Effect, OfAnotherRun, Untestable
from calibench.discrepancy.model.formulations import BLOCK
from calibench.discrepancy.model.machine import Formulation, Machine
from calibench.discrepancy.model.measured import TO_PREDICT, DataError, MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import inputs_of, is_clock, roles_of
from calibench.discrepancy.registries import description_of, machines
from calibench.problems.base import Array

SCHEMA_VERSION = 1
_ROUNDS, _SETTLED = 50, 1e-12  # an instrument whose scale is wrong makes its own reading part of what it will read
_OF_A_RUN = ("smooth", "formula", "power", "polynomial", "drift")  # ends of families that tell nothing of another run
_TIMES = 100  # of a run, over which the mean of what follows its clock is taken
_OF_THE_SEARCH = ("candidates", "fitted")  # parts that a report keeps to itself
Verdict = Literal["none", "negligible", "noise", "named", "ambiguous", "partly", "unknown"]
CarriedVerdict = Literal["carries", "does not carry", "not testable there"]


@final
@dataclass(frozen=True)
class Amplitude:
    """The number an engineer quotes, with its 95 % interval.

    What grows evenly with a column changes by it over `span` of that column; NaN for anything else.
    """

    value: float = nan
    unit: str = ""
    ci95: tuple[float, float] = (nan, nan)
    span: float = nan


@final
@dataclass(frozen=True)
class Rival:
    """A member of a set that the data cannot tell apart, with its weight in the set; weights sum to 1.

    `amplitude` is its size if it is the cause and not the first of the set; None of that first one, and of twins that
    the catalogue declares and nothing was fitted of.
    """

    effect: str
    family: str
    target: str
    weight: float
    amplitude: Amplitude | None = None


@final
@dataclass(frozen=True)
class Coefficient:
    """A number of an effect's formula as it was fitted, with its standard deviation."""

    name: str
    value: float
    unit: str
    sd: float


@final
class Doubt(StrEnum):
    """Why a name may not be the cause; readers get its words on the page and on the terminal."""

    FORMULA_ERROR = "formula_error"  # a small name beside a large one: the error of that one's formula
    OTHER_CAUSE = "other_cause"  # beside the name, the same part errs over columns by more than formulas are off
    ONE_CAUSE = "one_cause"  # one error of a part over columns explains as much as all names together
    UNCONFIRMED = "unconfirmed"  # a wave of fitted period, which no other set has confirmed
    NOT_ELSEWHERE = "not_elsewhere"  # a wave of fitted period that other sets do not have


@final
@dataclass(frozen=True)
class Caution:
    """A doubt about a name: its code, and the `columns`, the `part` of the machine or the `cases` that it is of."""

    code: Doubt
    columns: tuple[str, ...] = ()
    part: str = ""
    cases: tuple[str, ...] = ()


@final
@dataclass(frozen=True)
class Shuffled:
    """The control of a name that lives on an order: `by` is time, direction or velocity.

    In `as_much` of `times` shuffles of that order among rows that are alike otherwise, as much was explained.
    """

    by: str
    as_much: int
    times: int
    p: float


@final
@dataclass(frozen=True)
class Finding:
    """One missing effect: the most likely name and its rivals, the gain over the model without it.

    `visible` is its size in sigma: the rms of its signature in the whitened constraints after calibration. `form` tells
    how it differs from the catalogue's formula ("size depends on the angle of joint 2"): then it is like the effect of
    that name, and not that effect. `caution` has the doubts about the name. `coefficients` are the numbers of its
    formula. `period` is that of a periodic effect, in the unit of its argument; 0 otherwise. `shuffled` is the control
    of a name that lives on order, direction or time; None for any other.
    """

    effect: str
    family: str
    target: str
    amplitude: Amplitude
    gain: float
    set: tuple[Rival, ...]
    separated_by: str | None
    visible: float = 0.0
    form: str = ""
    caution: tuple[Caution, ...] = ()
    coefficients: tuple[Coefficient, ...] = ()
    period: float = 0.0
    shuffled: Shuffled | None = None


@final
@dataclass(frozen=True)
class Carried:
    """What another set of the same machine, `case`, says of a finding: does it carry, and `why` it does not.

    `size` is that of the first set and `there` that of the other, both under the noise that their fits leave; they are
    `apart` by so many standard errors of their difference. `gain` is that beside the other findings there, and
    `held_out_gain` by how much less poses left out of the fit err with it, in squares of the noise. `period` is that of
    a wave that was fitted there, 0 otherwise.
    """

    effect: str
    family: str
    target: str
    case: str
    verdict: CarriedVerdict
    why: str = ""
    size: Amplitude = field(default_factory=Amplitude)
    there: Amplitude = field(default_factory=Amplitude)
    apart: float = nan
    agrees: bool = False
    gain: float = nan
    held_out_gain: float = nan
    period: float = 0.0


@final
@dataclass(frozen=True)
class Gap:
    """Rms of the whitened constraints, in units of the stated noise; `noise_floor` is the rms of noise alone.

    Values that were not measured are NaN.
    """

    noise_floor: float = nan
    train_before: float = nan
    train_after: float = nan
    held_out_before: float = nan
    held_out_after: float = nan
    held_out_ci95: tuple[float, float] = (nan, nan)
    excess_shrink: float = nan
    cross_validated: bool = False


@final
@dataclass(frozen=True)
class Place:
    """A smooth term that is significant; p is of this term alone."""

    target: str
    covariate: str
    p: float


@final
@dataclass(frozen=True)
class Left:
    """What remains beside the names: `times` is the error over the noise floor.

    `place` is the clearest one, or None.
    """

    times: float
    place: Place | None = None


@final
@dataclass(frozen=True)
class Unnamed:
    """A smooth function without a name that was fitted: `quantity` errs by it over `covariate`.

    `size` is from its least to its largest value, in `unit`; `course` is its shape in words, "" for a shape without
    words.
    """

    quantity: str
    covariate: str
    size: float
    unit: str
    course: str = ""


@final
@dataclass(frozen=True)
class Nearest:
    """The formula nearest to an unnamed error: it explains the `share` of the excess over the noise, in squares."""

    effect: str
    family: str
    target: str
    share: float


@final
@dataclass(frozen=True)
class FormulaRival:
    """A formula that these data hardly tell from the one that is told: `behind` is in twice the log-likelihood."""

    text: str
    behind: float


@final
@dataclass(frozen=True)
class Formula:
    """A formula for what has no name, as it was added to the model: `text` with letters for its `sizes`.

    `numbers` are those inside its shapes that were fitted too, `intervals` the 95 % of sizes and numbers. `changes` are
    the quantities that it changes and `largest` by how much at most over the fitted readings. `share` of the excess
    over the noise, in squares, is explained by it. `structure` has a row a term: the quantity, then shape and column of
    each factor. `smooth_beside`: smooth functions take a part of what it leaves. `over_time`: it follows the clock, and
    so describes this run alone. `code` enters it into a catalogue.
    """

    text: str
    sizes: tuple[Coefficient, ...]
    numbers: tuple[Coefficient, ...] = ()
    intervals: tuple[Amplitude, ...] = ()
    largest: tuple[Amplitude, ...] = ()
    changes: tuple[str, ...] = ()
    share: float = nan
    smooth_beside: bool = False
    over_time: bool = False
    rivals: tuple[FormulaRival, ...] = ()
    structure: tuple[tuple[str, ...], ...] = ()
    code: str = ""

    def to_effect(self) -> str:
        """Return the lines of Python that enter the formula as an effect into the machine's catalogue."""
        return self.code


@final
@dataclass(frozen=True)
class Shortest:
    """The shortest period of the waves over a column that were tried, in `unit`."""

    column: str
    period: float
    unit: str


@final
@dataclass(frozen=True)
class ReadingNoise:
    """The standard deviation of one reading of each of some columns, as it was stated or assumed, in `unit`."""

    columns: tuple[str, ...]
    size: float
    unit: str


@final
@dataclass(frozen=True)
class OtherNoise:
    """The result of a search under noise of `factor` times the stated one: its verdict, and the names that stand."""

    factor: float
    verdict: Verdict
    effects: tuple[str, ...] = ()


@final
@dataclass(frozen=True)
class Invisible:
    """A candidate that calibration absorbs nearly completely, and the smallest amplitude that would be found.

    What grows evenly with a column has it over `span` of that column, as an `Amplitude`.
    """

    effect: str
    family: str
    target: str
    visible_fraction: float
    minimum_detectable: float
    unit: str = ""
    span: float = nan


@final
@dataclass(frozen=True)
class ParameterChange:
    """A calibrated parameter before and after the findings were added, with its standard deviation after."""

    before: float
    after: float
    sd: float


@final
@dataclass(frozen=True)
class Candidate:
    """A line of the table of candidates, each tested against the model without effects."""

    effect: str
    family: str
    target: str
    gain: float
    p: float
    visible_fraction: float
    minimum_detectable: float
    unit: str
    span: float = nan


@final
@dataclass(frozen=True, eq=False)
class Fitted:
    """The machine with the findings and without: problems that every optimiser here can solve.

    `machine` is the one that was searched, with its options.
    """

    model: ResidualProblem
    before: ResidualProblem
    machine: Machine | None = None


@final
@dataclass(frozen=True, repr=False)
class Report:
    """The verdict on one set of data.

    `left` is what the names do not explain, None where nothing is named. `other_noise`: the search at half and at twice
    the stated noise, where no repeats tell it. `words` are those that the machine's roles have for its columns.
    `formula` is one for what has no name, of the verdicts unknown and partly, where one was found; it is in the model.
    `unnamed` are the smooth functions of the verdict unknown, `nearest` the formula nearest to them, and `shortest` the
    shortest waves that were looked for. `parted_by`, of that verdict, are other kinds of readings that would part the
    names that came nearest, in words.
    `reading_noise` is the noise in whose times the gap is told, columns of one size together.
    `across` has what other sets of the machine say of each finding.
    `candidates` and `fitted` belong to the search itself: a report that was read back from JSON has none.
    """

    case: str
    machine: str
    verdict: Verdict
    findings: tuple[Finding, ...] = ()
    gap: Gap = field(default_factory=Gap)
    where: tuple[Place, ...] = ()
    not_testable: tuple[Untestable, ...] = ()
    invisible: tuple[Invisible, ...] = ()
    parameters: Mapping[str, ParameterChange] = field(default_factory=dict)
    p: float = nan
    notes: tuple[Note, ...] = ()
    seconds: float = nan
    left: Left | None = None
    other_noise: tuple[OtherNoise, ...] = ()
    words: Mapping[str, str] = field(default_factory=dict)
    unnamed: tuple[Unnamed, ...] = ()
    nearest: Nearest | None = None
    formula: Formula | None = None
    shortest: tuple[Shortest, ...] = ()
    parted_by: tuple[str, ...] = ()
    reading_noise: tuple[ReadingNoise, ...] = ()
    across: tuple[Carried, ...] = ()
    candidates: tuple[Candidate, ...] = field(default=(), repr=False)
    fitted: Fitted | None = field(default=None, repr=False, compare=False)
    __reduce__ = by_value

    @property
    def model(self) -> ResidualProblem:
        """Return the machine with the findings added. Raises `LookupError` for a report that was read from a file."""
        return self._fitted().model

    @property
    def before(self) -> ResidualProblem:
        """Return the machine without effects. Raises `LookupError` for a report that was read from a file."""
        return self._fitted().before

    def predict(self, readings: MeasuredData | Mapping[str, Any], machine: str | Machine | None = None) -> Prediction:
        """Return the prediction of the machine with its findings for new `readings`; measured columns may be missing.

        Readings may be a mapping, name -> n numbers, or a table of pandas. A unit may stand in a name, ``x [mm]``; what
        states none is in the unit in which the machine is fitted. `machine` makes the columns of the fit from those of
        a file; by default it is the machine that was searched. Raises `DataError` for a missing input, `LookupError`
        for a report that was read from a file.
        """
        at, plain = self._fitted().model, self._fitted().before
        maker = machine or self._fitted().machine or (self.machine if self.machine in machines.names() else None)

        if not isinstance(readings, MeasuredData):
            if not is_table(readings):
                kind, needed = type(readings).__name__, "MeasuredData, a table or a mapping of name to numbers"
                raise DataError(f"readings is a {kind}: {needed} is needed")
            each = {str(name): np.atleast_1d(readings[name]) for name in readings.keys()}  # noqa: SIM118  # of pandas
            given = named_columns(each, "readings", at.model.formulation.data.columns)
            readings = MeasuredData(given.columns, self.machine, name="readings", units=given.units)
        if readings.name == MeasuredData.name:  # nobody named them, so nothing tells that they are of the same run
            readings = replace(readings, name="readings")
        with np.errstate(invalid="ignore"):  # what is not known of a row makes its prediction NaN
            return predicted_at(at.model, at.best, at.fit.covariance(), plain.best, readings, maker)

    def __repr__(self) -> str:
        """Return the verdict in a line; `to_dict()` has everything."""
        effects = f" {', '.join(finding.effect for finding in self.findings)}" if self.findings else ""
        gap = self.gap
        error = f"; error {gap.held_out_before:.2f}" if isfinite(gap.held_out_before) else ""
        error += f" to {gap.held_out_after:.2f}" if error and isfinite(gap.held_out_after) else ""
        error += f" times the noise, {gap.noise_floor:.2f} is noise alone" if error else ""
        return f"<report of {self.case} on {self.machine}: {self.verdict}{effects}{error}>"

    def _repr_html_(self) -> str:
        """Return the verdict and the findings, as a notebook shows them."""
        rows = []
        for f in self.findings:
            others = ", ".join(rival.effect for rival in f.set if rival.effect != f.effect)
            rows.append((f.effect, f.amplitude.value, f.amplitude.unit, *f.amplitude.ci95, others))
        return html_table(repr(self).strip("<>"), ("effect", "size", "unit", "95 % from", "to", "or"), rows)

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain values, as `discover --json` prints it; NaN and infinity become None."""
        own = {f.name: finite(getattr(self, f.name)) for f in fields(self) if f.name not in _OF_THE_SEARCH}
        return {"schema_version": SCHEMA_VERSION, **own, "gap": own["gap"] | {"unit": "sigma"}}

    @classmethod
    def from_dict(cls, written: Mapping[str, Any]) -> Report:
        """Return the report that `to_dict` wrote. A missing part is empty; None in place of a number becomes NaN.

        Raises `KeyError` without a case, a machine or a verdict, `ValueError` for an unknown verdict.
        """
        if written["verdict"] not in get_args(Verdict):
            raise ValueError(f"verdict {written['verdict']!r}; there are {', '.join(get_args(Verdict))}")
        of_the_search = dict.fromkeys(_OF_THE_SEARCH)
        return cast(Report, value_of(cls, {**written, **of_the_search}))

    def _fitted(self) -> Fitted:
        if self.fitted is None:
            raise LookupError(f"{self.case}: this report was read from a file; search the data again for its model")
        return self.fitted


@final
@dataclass(frozen=True, eq=False)
class Prediction:
    """What is expected at n new readings, in the units in which the machine is fitted.

    `measured` is column -> (n,), NaN in rows of another kind. `sd` is the uncertainty of the calibrated numbers and of
    the findings in it; the noise of a reading comes on top. `residuals`, (n, c), are measured less predicted; NaN in
    rows that hold no measured value. A machine that predicts has one measured column in each constraint, with a slope
    of 1 or -1: its prediction is that column less the constraint. For one that states only constraints, `measured` is
    empty, and `residuals` are the constraints at the new readings. `beyond` is column -> (n,) of booleans, for inputs
    and columns of the findings of which some rows lie outside what was fitted: there `sd` is too small. Rows that are
    no `MeasuredData` under the name of those that were searched are of another run, and outside where a finding follows
    the clock: of a curve, a formula or a drift over it no more than the mean is in their prediction.
    """

    measured: Mapping[str, Array] = field(default_factory=dict)
    sd: Mapping[str, Array] = field(default_factory=dict)
    residuals: Array = field(default_factory=lambda: np.empty((0, 0)))
    beyond: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)


def predicted_at(
    model: Model, x: Array, covariance: Array, start: Array, data: MeasuredData, machine: str | Machine | None
) -> Prediction:
    """Return the prediction of `model` at `x`, with `covariance` (p, p), for `data`.

    `start` are the parameters of the machine without effects, at which unnamed smooth functions were found. `machine`
    makes the columns of the model from those of a file, where they differ.
    """
    if not len(data):
        raise DataError(f"{data.name}: there are no rows to predict")
    there, known = _placed(model.formulation, data, machine)
    there = there.on(there.data.with_columns(smooth_columns(there, start)))
    at = Model(there, _elsewhere(model, there.data))
    order = np.argsort(there.data[TO_PREDICT]) if TO_PREDICT in there.data else np.arange(len(there.data))
    # the sign of each reading in the constraints, (n, c) of 1, -1 and 0
    each = at.formulation.slopes(at.quantities(x)[1])
    signs = {name: np.asarray(each[name]) for name in there.readings}
    size = np.abs(np.stack(list(signs.values())))
    if not ((np.isclose(size, 1.0) | (size == 0)).all() and (np.sum(size > 0, axis=0) == 1).all()):  # some are mixed
        lost = [name for name in there.readings if not known[name].all()]
        if lost:
            raise DataError(
                f"{data.name}: no value of {', '.join(lost)} in every row; {data.machine} states what vanishes "
                "and predicts no reading, so all that it reads is needed"
            )
        residuals = np.asarray(at.formulation.constraints(at.quantities(x)[1])).real[order]
        return Prediction(residuals=residuals, beyond=_beyond(model, there.data, order))
    signs = {name: np.sign(sign) for name, sign in signs.items()}
    found = {name: np.asarray(there.data[name], dtype=float) for name in signs}
    before = {name: np.where(known[name], value, np.nan) for name, value in found.items()}
    for _ in range(_ROUNDS):
        left = np.asarray(at.formulation.constraints(at.quantities(x)[1])).real
        change = {name: (sign * left).sum(axis=1) for name, sign in signs.items()}
        found = {name: found[name] - change[name] for name in found}
        at = Model(there.on(there.data.with_columns(found)), at.effects)
        if all(np.max(np.abs(change[n])) <= _SETTLED * (1 + np.max(np.abs(found[n]))) for n in found):
            break
    recorded, true = at.quantities(x)
    slopes = at.raw_jacobian(x, recorded, at.formulation.slopes(true))
    spread = np.sqrt(np.maximum(np.einsum("ncp,pq,ncq->nc", slopes, covariance, slopes), 0.0))
    read = {name: np.abs(sign).sum(axis=1) > 0 for name, sign in signs.items()}
    left = np.zeros_like(spread)
    for name, sign in signs.items():
        left = left + np.where(sign != 0, (before[name] - found[name])[:, None], 0.0)
    return Prediction(
        {name: np.where(read[name], value, np.nan)[order] for name, value in found.items()},
        {n: np.where(read[n], (np.abs(sign) * spread).sum(axis=1), np.nan)[order] for n, sign in signs.items()},
        left[order], _beyond(model, there.data, order),
    )  # fmt: skip


def _elsewhere(model: Model, new: MeasuredData) -> tuple[Effect, ...]:
    """Return the effects of a model for `new` rows: in another run curves and drifts over its own clock are their mean.

    Nothing but its name tells that a row is of the run that was fitted: another run may have the same times.
    """
    run, effects = model.formulation.data, []
    some = np.unique(np.linspace(0, len(run) - 1, _TIMES).round().astype(int))
    for effect in model.effects:
        other = effect.family.endswith(_OF_A_RUN) and new.name != run.name
        clock = {c: np.asarray(run[c])[some] for c in effect.columns if other and is_clock(c, model.formulation)}
        effects.append(OfAnotherRun(effect, clock) if clock else effect)
    return tuple(effects)


def _beyond(model: Model, new: MeasuredData, order: NDArray[np.intp]) -> dict[str, NDArray[np.bool_]]:
    """Return the columns of which `new` rows lie outside what was fitted, and which rows."""
    fitted = model.formulation.data
    met = {*inputs_of(model.formulation), *(c for effect in model.effects for c in effect.columns)}
    found = {}
    for name in (c for c in fitted.columns if c in met and c in new and c not in model.formulation.readings):
        if fitted[name].dtype.kind in "iuf":
            other = new.name != fitted.name and is_clock(name, model.formulation)
            found[name] = (other | (new[name] < np.min(fitted[name])) | (new[name] > np.max(fitted[name])))[order]
    return {name: out for name, out in found.items() if out.any()}


def _in_units_of(formulation: Formulation, data: MeasuredData) -> MeasuredData:
    """Return the data with each column whose unit is stated in the unit in which it is fitted."""
    joints = {joint.reading: joint.unit for joint in roles_of(formulation).joints}
    declared = joints | {sensor.column: sensor.unit for sensor in formulation.sensors}
    known = {name: unit for name, unit in declared.items() if is_unit(unit)} | dict(formulation.data.units)
    own = description_of(formulation.data.machine).own_units  # then the unit of the fit is its owner's
    turned, units = {}, dict(data.units)
    for name, unit in data.units.items():
        try:
            units[name] = known.get(name) or (unit if own or not is_unit(unit) else factor_to_base(name, unit)[0])
            factor = 1.0 if units[name] == unit else between(name, unit, units[name], own)
        except ValueError:
            raise DataError(f"{data.name}: column {name} is in {unit}, and in the fit in {units[name]}") from None
        if factor != 1:
            turned[name] = np.asarray(data[name], dtype=float) * factor
    return replace(data.with_columns(turned), units=units)


def _placed(
    formulation: Formulation, data: MeasuredData, machine: str | Machine | None
) -> tuple[Formulation, dict[str, Array]]:
    """Return the formulation over new rows, and in which of them each reading has a value, (n,) of booleans."""
    n, fitted = len(data), formulation.data
    data = _in_units_of(formulation, data)
    of_new = getattr(formulation, "of_new", None)
    if of_new is not None:
        data = of_new(replace(data, metadata={**fitted.metadata, **data.metadata}))
    for name, column in data.columns.items():
        if column.dtype.kind not in "iufb" and name in fitted and fitted[name].dtype.kind in "iufb":
            raise DataError(f"{data.name}: column {name} holds words; give the numbers that the report reads them as")
    own = {name: np.asarray(data[name], dtype=float) for name in formulation.readings if name in data}
    finite = {name: np.isfinite(own[name]) if name in own else np.zeros(n, dtype=bool) for name in formulation.readings}
    fill = {name: np.where(there, own.get(name, 0.0), 0.0) for name, there in finite.items()}
    metadata = {**fitted.metadata, **data.metadata}
    filled = replace(data.with_columns({**fill, TO_PREDICT: np.arange(n)}), metadata=metadata)
    needed = [*inputs_of(formulation), *([BLOCK] if BLOCK in formulation.data else [])]
    missing = [name for name in needed if name not in filled]
    if not missing:
        return formulation.on(filled), finite
    maker = machines.make(machine) if isinstance(machine, str) else machine
    if maker is None:
        raise DataError(f"{data.name}: no column {', '.join(missing)}; machine= makes it of a file's own columns")
    made = maker.formulate(filled).data
    if TO_PREDICT not in made:
        raise DataError(
            f"{data.name}: {data.machine} leaves columns out of its rows, so nothing tells which row is which; take "
            "the rows of a block by data.rows(...), which keeps all columns"
        )
    if len(made) != n:
        raise DataError(f"{data.name}: {data.machine} takes {len(made)} of {n} rows; leave out those it cannot read")
    rows = np.asarray(made[TO_PREDICT], dtype=int)
    known = {name: there[rows] | (np.asarray(made[name], dtype=float) != 0) for name, there in finite.items()}
    return formulation.on(made), known
