"""Which length a row of a table must have for the readings, where all else in the table is right: in closed form.

The nominal pose of the last link is (R_i, f_i + v u_i), v the length and u_i the axis that it lies along. As in
`problems.arm.frames`, B p_i + c = R_i t + f_i + v u_i is linear in where base and target are, and here in v as well.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from calibench.bench.calibration.readings import Readings
from calibench.problems.arm.chains.dh_table import DhTable
from calibench.problems.arm.chains.kinematics import forward, nominal
from calibench.problems.base import Array

LENGTHS = ("a", "d")
_ROUNDS, _FAR = 4, 6.0  # times the median of what is left: a reading beyond has no influence, as it may be wild


def length_told(table: DhTable, row: int, number: str, readings: Readings) -> float | None:
    """Return `number` (a or d) of a row of `table`, counted from 0, in mm, as the readings have it.

    None where they do not tell it: no position was read, or base or target say the same.
    """
    if readings.position is None:
        return None
    here = _poses(table, row, number, 0.0, readings)
    along = _poses(table, row, number, 1.0, readings)[:, :3, 3] - here[:, :3, 3]
    places, middle = readings.position, np.median(readings.position, axis=0)
    size = float(np.median(np.abs(places - middle))) or 1.0
    reach = float(np.abs(here[:, :3, 3]).max()) or 1.0
    rows = _rows(here[:, :3, :3], along, (places - middle) / size, reach)
    wanted = here[:, :3, 3] / reach
    near = np.ones(len(places), dtype=bool)
    for _ in range(_ROUNDS):
        solved, _, rank, _ = np.linalg.lstsq(rows[near].reshape(-1, 16), wanted[near].ravel(), rcond=1e-6)
        left = np.sqrt(((rows @ solved - wanted) ** 2).sum(axis=1))
        near = left <= max(_FAR * float(np.median(left)), 1e-9)
    without = np.linalg.matrix_rank(rows[near][:, :, :15].reshape(-1, 15), rtol=1e-6)
    return float(solved[15] * reach) if rank > without else None


def _poses(table: DhTable, row: int, number: str, value: float, readings: Readings) -> Array:
    """Return the nominal poses (n, 4, 4) [mm] of the table with one number of a row at `value`."""
    changed: dict[str, Any] = {number: value}
    rows = tuple(replace(one, **changed) if k == row else one for k, one in enumerate(table.rows))
    chain = replace(table, rows=rows).chain
    return forward(chain, nominal(chain), readings.joints)


def _rows(turns: Array, along: Array, read: Array, reach: float) -> Array:
    """Return the coefficients of B by rows, c, t and v, the last two as parts of `reach`, (n, 3, 16)."""
    rows = np.zeros((len(read), 3, 16))
    for axis in range(3):
        rows[:, axis, 3 * axis : 3 * axis + 3] = read
        rows[:, axis, 9 + axis] = 1.0
    rows[:, :, 12:15] = -turns
    rows[:, :, 15] = -along
    return rows
