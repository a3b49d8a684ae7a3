"""A cell far from all others of its column: a code for "no value", a lost comma, a sensor that failed.

A wild reading is seen by its misfit in the model. That is not possible for a column that only an effect may depend on,
nor for an angle, because its sine is never large. Such a cell is found by its distance from the other cells of its
column, relative to the range of these.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibench.core.counted import plain
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.roles import columns_of, inputs_of, roles_of
from calibench.discrepancy.registries import description_of

_FAR = 20.0  # ranges of the rest of the column
_FEW = 0.01  # of the rows; two may be in any file
_LEAST = 20  # rows that are needed to tell what is usual
_DIFFERENT = 8  # values of the rest: fewer are levels that somebody chose
_ANGLES = ("rad", "deg")


def rows_apart(formulation: Formulation) -> tuple[NDArray[np.bool_], str]:
    """Return which rows hold a cell far from all others of its column, (n,), and a note on them.

    The note is "" where there is no such row.
    """
    data = formulation.data
    out, told = np.zeros(len(data), dtype=bool), []
    for name in _looked_at(formulation):
        column = np.asarray(data[name], dtype=float)
        apart = _apart(column)
        if apart.any():
            out |= apart
            rest = column[~apart & np.isfinite(column)]
            lie = f"all others lie between {plain(rest.min())} and {plain(rest.max())}"
            told.append(f"{name} is {column[apart][0]:.6g}, {lie}")
    if not told:
        return out, ""
    rows, them = formulation.data.rows_named(out), "them" if out.sum() > 1 else "it"
    return out, f"{rows} left out: {'; '.join(told)}; correct {them}, or mark {them} valid=0"


def _apart(column: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which cells of a column are far from all others, (n,): few cells, many ranges of the others away."""
    apart = np.zeros(len(column), dtype=bool)
    finite = np.flatnonzero(np.isfinite(column))
    few = max(2, int(_FEW * len(column)))
    if len(finite) < _LEAST + few:
        return apart
    order = finite[np.argsort(np.abs(column[finite] - np.median(column[finite])), kind="stable")]
    for k in range(1, few + 1):  # the k outermost values, against the rest
        rest, others = column[order[:-k]], column[order[-k:]]
        away = np.maximum(rest.min() - others, others - rest.max())
        if (away > _FAR * np.ptp(rest)).all() and len(np.unique(rest)) >= _DIFFERENT:
            apart[order[-k:]] = True
            return apart
    return apart


def _looked_at(formulation: Formulation) -> tuple[str, ...]:
    """Return the columns that an error may depend on: no time, no reading or input that turns, and nothing computed."""
    data, roles = formulation.data, roles_of(formulation)
    read = (*formulation.readings, *inputs_of(formulation))
    followed = (*columns_of(roles), *(column.name for column in description_of(data.machine).columns))
    units = {sensor.column: sensor.unit for sensor in formulation.sensors} | dict(data.units)
    units |= {joint.reading: joint.unit for joint in roles.joints}
    names = [name for name in followed if name not in (*read, roles.time, "t_s", *data.computed)]
    names += [name for name in read if units.get(name) in _ANGLES]
    return tuple(name for name in dict.fromkeys(names) if name in data and data[name].dtype.kind in "iuf")
