"""Errors of any member: growth with temperature, compliance under the force along it, play along it; held numbers.

A number that is held may have another value than the stated one.

The temperature of members: they follow a thermometer with an unknown lag, so causes have one form for each lag.

The temperature at which an effect of temperature is zero: the thermometer's own zero, or the mean of the run.

A column in degrees Celsius is far from its zero. The calibrated zero of a joint, or a length, would then be that of the
machine at 0 °C, which nobody has seen and which its bounds do not allow for. Counted from the mean of the run the model
is the same, and the calibrated value is that of the machine at that mean temperature. A number that is held is known
for one temperature, so its column must be relative to that temperature, and stays as it is.

Errors of an instrument that measures from outside: its scale, and readings that come late.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.linalg.lapack import dtbtrs

from calibench.discrepancy.effects.general.recipe import (
    Built,
    declared,
    each_instrument,
    each_length,
    each_length_and_all,
    instrument_of,
    lengths_of,
    recipe,
)
from calibench.discrepancy.model.effect import Effect, EffectFamily, LinearEffect, NotTestable, needs
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import roles_of
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_THIN = 45.0  # s: thin tubes; each next form is twice as slow, because lags in between cannot be distinguished
_SLOWEST = 0.25  # of the run: a slower lag cannot be distinguished from the unknown temperature at the start
_FORMS = 8
_OTHER_RUN = 0.25  # of the variance over the run: if temperatures at equal times differ by more, it is another run


def time_constants(data: MeasuredData, clock: str) -> tuple[float, ...]:
    """Return the time constants [s] that a column `clock` [s] can tell apart; without a clock only zero."""
    run = float(np.ptp(data[clock])) if clock and data.has(clock) else 0.0
    ladder = (_THIN * 2**k for k in range(_FORMS))
    return (0.0, *(late for late in ladder if late < _SLOWEST * run))


def warmth(data: MeasuredData, late: float, column: str, clock: str, run: MeasuredData) -> Array:
    """Return the members' temperature above the reference, (n,), K: that of `column` through a lag of first order.

    `late` is the time constant [s]. Members are taken to be as warm as the thermometer when the run begins; between the
    rows the temperature is taken to change linearly. `run` are the rows in which the lag was searched for. Some of
    them, or further rows of the same run, have a temperature that depends on the rows before.
    """
    if not late:
        return np.asarray(data[column], dtype=float)
    asked = np.asarray(data[clock], dtype=float)
    t, shown = _record(data, column, clock, run)
    order = np.argsort(t, kind="stable")
    even = np.linspace(t[order[0]], t[order[-1]], int(min(np.ptp(t) / late * 10, 200_000)) + 2)
    seen = np.interp(even, t[order], shown[order])
    kept = np.exp(-(even[1] - even[0]) / late)
    middle = np.concatenate([seen[:1], (seen[1:] + seen[:-1]) / 2])
    # y with y_k = `kept` y_{k-1} + `steps`_k, (n,), as SciPy's `lfilter` does
    steps = (1 - kept) * (middle - seen[0])
    bands = np.ones((2, len(steps)))
    bands[1] = -kept
    follows = np.asarray(dtbtrs(bands, steps[:, None], uplo="L", diag="U")[0][:, 0])
    return np.asarray(np.interp(asked, even, follows + seen[0]))


def _record(data: MeasuredData, column: str, clock: str, run: MeasuredData) -> tuple[Array, Array]:
    """Return the times, (k,), and the thermometer's readings, of `run` and of the rows of `data` from the same run.

    Rows belong to another run where the thermometer showed something else at the same time. They are then returned
    without those of `run`.
    """
    t, shown = (np.asarray(data[name], dtype=float) for name in (clock, column))
    known, then = (np.asarray(run[name], dtype=float) for name in (clock, column))
    if np.array_equal(t, known):
        return t, shown
    new = ~np.isin(t, known)
    order = np.argsort(known, kind="stable")
    during = (t >= known[order[0]]) & (t <= known[order[-1]])
    apart = shown[during] - np.interp(t[during], known[order], then[order])
    if during.any() and np.mean(apart**2) > _OTHER_RUN * np.var(then):
        return t, shown
    return np.concatenate([known, t[new]]), np.concatenate([then, shown[new]])


_ROWS = 500  # rows that are used, evenly over the run
_SAME = 1e-8  # part of a signature: what is left of one that calibration absorbs is rounding


def reference_of(formulation: Formulation, column: str, quantity: str) -> float:
    """Return the temperature in `column` that counts as zero for `quantity`: the mean of the run, or 0.

    It is the mean where no reading is near 0 and calibration finds a constant error of the quantity by itself.
    """
    values = np.asarray(formulation.data[column], dtype=float)
    if values.min() <= 0.0 <= values.max() or not _is_absorbed(formulation, quantity):
        return 0.0
    return float(values.mean())


def _is_absorbed(formulation: Formulation, quantity: str) -> bool:
    """Tell whether the calibrated parameters can imitate a constant error of `quantity` in all rows."""
    if quantity in {p.name for p in formulation.parameters}:
        return True
    count = len(formulation.data)
    some = formulation
    if count > _ROWS:
        some = formulation.on(formulation.data.rows(np.linspace(0, count - 1, _ROWS).astype(int)))
    model = Model(some)
    slopes = some.slopes(model.quantities(model.start)[0])
    error = np.asarray(slopes[quantity], dtype=float).ravel()
    own = np.stack([np.asarray(slopes[p.name], dtype=float).ravel() for p in some.parameters], axis=-1)
    length = np.linalg.norm(own, axis=0)
    own = own[:, length > 0] / length[length > 0]
    rest = error - own @ np.linalg.lstsq(own, error, rcond=1e-12)[0]
    return bool(np.linalg.norm(rest) <= _SAME * np.linalg.norm(error))


NOWHERE: Mapping[str, float] = {}


def _growth(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    lengths = lengths_of(formulation, target)
    roles = roles_of(formulation)
    heat = {one.quantity: declared(one.temperature or roles.temperature, one.name, "temperature") for one in lengths}
    needs(formulation.data, *dict.fromkeys(heat.values()))
    own_at = {name: reference_of(formulation, column, name) for name, column in heat.items()}
    return grown(family, target, heat, formulation.data, roles.time, own_at)


def grown(
    family: EffectFamily, target: str, heat: dict[str, str], run: MeasuredData, clock: str,
    own_at: Mapping[str, float] = NOWHERE,
) -> tuple[Effect, ...]:  # fmt: skip
    """Return the growth of quantities with the temperature in their columns, `heat`, over `run`: one form for each lag.

    `own_at` is the temperature at which a quantity has its nominal length, 0 where it is not stated.
    """

    def form(late: float) -> LinearEffect:
        def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
            warm = {column: warmth(data, late, column, clock, run) for column in dict.fromkeys(heat.values())}
            return {name: (q[name] * (warm[column] - own_at.get(name, 0.0)))[:, None] for name, column in heat.items()}

        columns = tuple(dict.fromkeys(heat.values()))
        return family.linear(target, columns, {"alpha": "1/K"}, changes)

    return tuple(form(late) for late in time_constants(run, clock))


def _stretch(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [length] = lengths_of(formulation, target)
    force = declared(length.force, length.name, "force")
    needs(formulation.data, force)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {length.quantity: data[force][:, None]}

    unit = f"{length.unit}/N"
    return (family.linear(target, (force,), {"k": unit}, changes),)


def _clearance(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [length] = lengths_of(formulation, target)
    force = declared(length.force, length.name, "force")
    needs(formulation.data, force)
    if not np.ptp(np.sign(formulation.data[force])) > 0:
        raise NotTestable(f"column {force} never changes its sign", (force,))

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {length.quantity: 0.5 * np.sign(data[force])[:, None]}

    unit = length.unit
    return (family.linear(target, (force,), {"play": unit}, changes),)


def _freed(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    units = {one.quantity: one.unit for one in roles_of(formulation).lengths}
    return (freed(family, target, (target,), units.get(target, "")),)


def freed(family: EffectFamily, target: str, names: tuple[str, ...], unit: str) -> LinearEffect:
    """Return held numbers as coefficients: the difference of each from the number it is held at."""

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        each = np.eye(len(names))
        return {name: np.tile(each[k], (len(data), 1)) for k, name in enumerate(names)}

    return family.linear(target, (), dict.fromkeys(names, unit), changes)


growth = recipe(
    "thermal_length", "A member, or all of them, grow with temperature", ("length_i *= 1 + alpha T, T follows the "
        "temperature"), channel="link", columns=("the temperature",), unit="1/K", targets="each length, all",
    targets_in=each_length_and_all, make=_growth, label="thermal growth",
    label_of_all="thermal growth of all members",
)  # fmt: skip
stretch = recipe(
    "axial_compliance", "A member gives way to the force along it", "length_i += k force_i", channel="link",
    columns=("the force",), unit="mm/N", targets="each length", targets_in=each_length, make=_stretch,
)  # fmt: skip
clearance = recipe(
    "clearance", "The joints of a member have play along it", "length_i += play / 2 * sign(force_i)", channel="link",
    columns=("the force",), unit="mm", targets="each length", targets_in=each_length, make=_clearance,
)  # fmt: skip
free_number = recipe(
    "free_number", "A number that is held is not the stated one", "number += c", channel="link", columns=(),
    unit="that of the number", targets="each held number", targets_in=lambda formulation: tuple(formulation.fixed),
    make=_freed, label="another value",
)  # fmt: skip


def _scale(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    columns = instrument_of(formulation, target).columns
    needs(formulation.data, *columns)
    if _own_noise(formulation, columns) > 1:
        raise NotTestable("what it measures is too near to its noise: each error would be explained by itself", columns)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {name: -np.asarray(q[name])[:, None] for name in columns}

    return (family.linear(target, columns, {"k": "1"}, changes, largest=thresholds().largest_scale),)


def _own_noise(formulation: Formulation, columns: tuple[str, ...]) -> float:
    """Return the gain, in twice the log-likelihood, that noise alone gives to the scale of noisy readings.

    The noise is in the reading and in its error, so the two correlate: n values whose rms is R sigma gain n / R^2 where
    nothing is wrong.
    """
    n = len(formulation.data) * len(columns)
    size = sum(
        float(np.mean((np.asarray(formulation.data[c]) / np.asarray(formulation.sigma[c])) ** 2)) for c in columns
    )
    return n * len(columns) / size if size > 0 else np.inf


def _lag(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    instrument = instrument_of(formulation, target)
    declared("".join(instrument.velocity[:1]), target, "velocity of what it measures")
    needs(formulation.data, *instrument.velocity)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {name: data[v][:, None] for name, v in zip(instrument.columns, instrument.velocity)}

    columns = instrument.velocity
    return (family.linear(target, columns, {"tau": "s"}, changes),)


scale = recipe(
    "instrument_scale", "An instrument reads too large or too small", "measured -= k measured", channel="prediction",
    columns=("what it measures",), unit="1", targets="each instrument", targets_in=each_instrument, make=_scale,
    label="scale error",
)  # fmt: skip
lag = recipe(
    "instrument_lag", "An instrument is read too early or too late", "measured_i += tau velocity_i",
    channel="prediction", columns=("the velocity of what it measures",), unit="s", targets="each instrument",
    targets_in=each_instrument, make=_lag, label="timing lag",
)  # fmt: skip
