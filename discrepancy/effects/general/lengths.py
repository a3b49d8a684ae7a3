"""Errors of a member: growth with temperature, compliance and play under the force along it; held numbers; instruments.

Members follow a thermometer with an unknown lag, so causes have one form for each lag. A column in degrees Celsius is
far from its zero: the calibrated zero of a joint, or a length, would be that of the machine at 0 °C, which nobody has
seen. Counted from the mean of the run the model is the same, and the calibrated value is that at this mean. A number
that is held is known for one temperature, so its column must be relative to that, and stays as it is.
"""

from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg.lapack import dtbtrs

from calibench.discrepancy.effects.general.recipe import Built, declared, each, named, recipe
from calibench.discrepancy.model.effect import Effect, EffectFamily, NotTestable, needs
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
    of = (data[clock], data[column], run[clock], run[column])
    for columns, constant, warm in _WARM:  # the same for each joint and link that follows the thermometer
        if constant == late and all(a is b for a, b in zip(columns, of)):
            return warm
    asked, measured = (np.asarray(data[name], dtype=float) for name in (clock, column))
    known, then = (np.asarray(run[name], dtype=float) for name in (clock, column))
    # times and readings of the thermometer, (k,), of `run` and of the rows of `data` from the same run
    t, shown = asked, measured
    if not np.array_equal(asked, known):
        new = ~np.isin(asked, known)
        order = np.argsort(known, kind="stable")
        during = (asked >= known[order[0]]) & (asked <= known[order[-1]])
        apart = measured[during] - np.interp(asked[during], known[order], then[order])
        if not (during.any() and np.mean(apart**2) > _OTHER_RUN * np.var(then)):
            t, shown = np.concatenate([known, asked[new]]), np.concatenate([then, measured[new]])
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
    warm = np.asarray(np.interp(asked, even, follows + seen[0]))
    warm.flags.writeable = False
    _WARM.append((of, late, warm))
    return warm


_WARM: deque[tuple[tuple[Any, ...], float, Array]] = deque(maxlen=4 * _FORMS)


_ROWS = 500  # rows that are used, evenly over the run
_SAME = 1e-8  # part of a signature: what is left of one that calibration absorbs is rounding


def reference_of(formulation: Formulation, column: str, quantity: str) -> float:
    """Return the temperature in `column` that counts as zero for `quantity`: the mean of the run, or 0."""
    values = np.asarray(formulation.data[column], dtype=float)
    if values.min() <= 0.0 <= values.max():
        return 0.0
    mean, count, some = float(values.mean()), len(values), formulation
    if quantity in {p.name for p in formulation.parameters}:
        return mean
    if count > _ROWS:
        some = formulation.on(formulation.data.rows(np.linspace(0, count - 1, _ROWS).astype(int)))
    # whether the calibrated parameters can imitate a constant error in all rows
    slopes = some.slopes(Model(some).quantities()[0])
    error = np.asarray(slopes[quantity], dtype=float).ravel()
    own = np.stack([np.asarray(slopes[p.name], dtype=float).ravel() for p in some.parameters], axis=-1)
    length = np.linalg.norm(own, axis=0)
    own = own[:, length > 0] / length[length > 0]
    rest = error - own @ np.linalg.lstsq(own, error, rcond=1e-12)[0]
    return mean if np.linalg.norm(rest) <= _SAME * np.linalg.norm(error) else 0.0


def _growth(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    lengths, roles = named(roles_of(formulation).lengths, target), roles_of(formulation)
    heat = {one.quantity: declared(one.temperature or roles.temperature, one.name, "temperature") for one in lengths}
    needs(formulation.data, *dict.fromkeys(heat.values()))
    own_at = {name: reference_of(formulation, column, name) for name, column in heat.items()}
    return grown(family, target, heat, formulation.data, roles.time, own_at)


def grown(
    family: EffectFamily, target: str, heat: dict[str, str], run: MeasuredData, clock: str,
    own_at: Mapping[str, float] | None = None,
) -> tuple[Effect, ...]:  # fmt: skip
    """Return the growth of quantities with the temperature in their columns, `heat`, over `run`: one form for each lag.

    `own_at` is the temperature at which a quantity has its nominal length, 0 where it is not stated.
    """
    columns, zeros = tuple(dict.fromkeys(heat.values())), own_at or {}

    def changes(late: float, q: Quantities, data: MeasuredData) -> dict[str, Array]:
        warm = {column: warmth(data, late, column, clock, run) for column in columns}
        return {name: (q[name] * (warm[column] - zeros.get(name, 0.0)))[:, None] for name, column in heat.items()}

    forms = (partial(changes, late) for late in time_constants(run, clock))
    largest = thresholds().largest_growth
    return tuple(family.linear(target, columns, {"alpha": "1/K"}, form, largest=largest) for form in forms)


def _forced(
    coefficient: str, per: str, turns: bool, form: Callable[[Array], Array], family: EffectFamily,
    formulation: Formulation, target: str,
) -> Built:  # fmt: skip
    """Return the change of a length by a `form` of the force along it, which must change its sign where it `turns`."""
    [length] = named(roles_of(formulation).lengths, target)
    force = declared(length.force, length.name, "force")
    needs(formulation.data, force)
    if turns and not np.ptp(np.sign(formulation.data[force])) > 0:
        raise NotTestable(f"column {force} never changes its sign", (force,))
    known = {p.name: p.start for p in formulation.parameters} | dict(formulation.fixed)
    most = float(np.max(np.abs(form(formulation.data[force]))))
    strained = thresholds().largest_strain * abs(float(known.get(length.quantity, 0.0))) / most if most > 0 else 0.0
    return family.linear(
        target, (force,), {coefficient: f"{length.unit}{per}"},
        lambda q, data: {length.quantity: form(data[force])[:, None]}, largest=strained or np.inf,
    )  # fmt: skip


growth = recipe(
    "thermal_length", "A member, or all of them, grow with temperature", ("length_i *= 1 + alpha T, T follows the "
        "temperature"), channel="link", columns=("the temperature",), unit="1/K", targets="each length, all",
    targets_in=each("lengths", and_all=True), make=_growth, label="thermal growth",
    label_of_all="thermal growth of all members", bounds=("largest_growth",),
)  # fmt: skip
stretch = recipe(
    "axial_compliance", "A member gives way to the force along it", "length_i += k force_i", channel="link",
    columns=("the force",), unit="mm/N", targets="each length", targets_in=each("lengths"),
    make=partial(_forced, "k", "/N", False, lambda force: force), bounds=("largest_strain",),
)  # fmt: skip
clearance = recipe(
    "clearance", "The joints of a member have play along it", "length_i += play / 2 * sign(force_i)", channel="link",
    columns=("the force",), unit="mm", targets="each length", targets_in=each("lengths"),
    make=partial(_forced, "play", "", True, lambda force: 0.5 * np.sign(force)), bounds=("largest_strain",),
)  # fmt: skip
free_number = recipe(
    "free_number", "A number that is held is not the stated one", "number += c", channel="link", columns=(),
    unit="that of the number", targets="each held number", targets_in=lambda formulation: tuple(formulation.fixed),
    make=lambda family, formulation, target: family.linear(
        target, (), {target: {one.quantity: one.unit for one in roles_of(formulation).lengths}.get(target, "")},
        lambda q, data: {target: np.ones((len(data), 1))},
    ), label="another value",
)  # fmt: skip


def _scale(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [instrument], data = named(roles_of(formulation).instruments, target), formulation.data
    columns = instrument.columns
    needs(data, *columns)
    # the noise is in the reading and in its error, so the two correlate: n values whose rms is R sigma gain n / R^2 in
    # twice the log-likelihood where nothing is wrong
    squares = sum(float(np.mean((np.asarray(data[c]) / np.asarray(formulation.sigma[c])) ** 2)) for c in columns)
    if not squares > 0 or len(data) * len(columns) * len(columns) / squares > 1:
        raise NotTestable("what it measures is too near to its noise: each error would be explained by itself", columns)
    return family.linear(
        target, columns, {"k": "1"}, lambda q, data: {name: -np.asarray(q[name])[:, None] for name in columns},
        largest=thresholds().largest_scale,
    )  # fmt: skip


def _lag(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [instrument] = named(roles_of(formulation).instruments, target)
    declared("".join(instrument.velocity[:1]), target, "velocity of what it measures, and no time (machine.time=)")
    needs(formulation.data, *instrument.velocity)
    pairs = dict(zip(instrument.columns, instrument.velocity))
    return family.linear(
        target, instrument.velocity, {"tau": "s"},
        lambda q, data: {name: data[velocity][:, None] for name, velocity in pairs.items()},
        largest=thresholds().largest_delay * instrument.span or thresholds().largest_lag,
    )  # fmt: skip


scale = recipe(
    "instrument_scale", "An instrument reads too large or too small", "measured -= k measured", channel="prediction",
    columns=("what it measures",), unit="1", targets="each instrument", targets_in=each("instruments"), make=_scale,
    label="scale error", bounds=("largest_scale",),
)  # fmt: skip
lag = recipe(
    "instrument_lag", "An instrument is read too early or too late", "measured_i += tau velocity_i",
    channel="prediction", columns=("the velocity of what it measures",), unit="s", targets="each instrument",
    targets_in=each("instruments"), make=_lag, label="timing lag", bounds=("largest_lag", "largest_delay"),
)  # fmt: skip
