"""The temperature of members: they follow a thermometer with an unknown lag, so causes have one form for each lag."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dtbtrs

from calibench.discrepancy.model.measured.data import MeasuredData
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
    follows = _followed((1 - kept) * (middle - seen[0]), kept)
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


def _followed(steps: Array, kept: float) -> Array:
    """Return y with y_k = `kept` y_{k-1} + `steps`_k, (n,), as SciPy's `lfilter` does.

    Importing that takes a second.
    """
    bands = np.ones((2, len(steps)))
    bands[1] = -kept
    return np.asarray(dtbtrs(bands, steps[:, None], uplo="L", diag="U")[0][:, 0])
