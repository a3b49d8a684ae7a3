"""What is wrong in a table of Denavit and Hartenberg that readings do not fit, found by trying what people mistake.

Tried are the other convention, each row with the other kind of joint, every two rows exchanged (with their names,
which is another order of the joints, and without), the columns a and d or alpha and theta exchanged, each alpha with
the other sign or a quarter turn more or less. Where none of these helps as much as it should, each length is tried as
the readings have it: a free number fits more than a slip of the pen. A change is named if the readings fit the arm with
it.

A length is found in closed form. The nominal pose of the last link is (R_i, f_i + v u_i), v the length and u_i the axis
that it lies along. As in `calibration.frames`, B p_i + c = R_i t + f_i + v u_i is linear in where base and target are,
and here in v as well.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import combinations
from math import inf, pi
from typing import Any

import numpy as np

from calibench.calibration.dh import FORMS, NUMBERS, DhRow, DhTable
from calibench.calibration.frames import ball_in_sockets
from calibench.calibration.kinematics import ChainError, forward, nominal
from calibench.calibration.mistakes import APART, most_apart, reach_of, unit_of
from calibench.calibration.readings import Readings, Table, read_readings
from calibench.calibration.rigid import Array
from calibench.calibration.start import DOUBTFUL, HowRead, slid, start_of
from calibench.core.notes import DataError
from calibench.core.tables.cells import between
from calibench.core.words import plain

LENGTHS = ("a", "d")
_ROUNDS, _FAR = 4, 6.0  # times the median of what is left: a reading beyond has no influence, as it may be wild
_BETTER = 0.2  # of the misfit of the table as it stands: one change of an arm that is merely not calibrated gains less
_AS_WELL = 2.0  # times the misfit of the best change: one that leaves less may be meant as well
_MOST = 3  # changes: of as many axes that are parallel the offsets say the same
_STRAIGHT = 1e-3  # rad: an alpha that is nearer to a multiple of a quarter turn is one


def misfit_of_table(table: DhTable, data: Table, how: HowRead) -> float:
    """Return how far readings and nominal arm lie apart, as a part of its reach; infinite where it is not this arm."""
    try:
        chain = table.chain
        readings = read_readings(data, chain, how.observe)
        if readings.position is None:
            poses = forward(chain, nominal(chain), readings.joints)
            if ball_in_sockets(poses, readings.socket)[2] > most_apart(reach_of(poses), sockets=True):
                return inf  # before `start_of` looks for the reason
        else:
            frames = slid(readings, chain)[2]
            if frames.apart > APART * frames.reach or unit_of(frames) is None:
                return inf
        start_of(readings, chain, how.rotation, how.limits)
    except (DataError, ChainError):
        return inf
    return 0.0 if readings.position is None else frames.apart / frames.reach


def mistake_of_table(table: DhTable, data: Table, how: HowRead) -> str:
    """Return which one change of `table` makes the readings fit the arm; "" where none does, or several would.

    Readings that fit the table as it stands, as well as arms do that are not calibrated, tell no mistake.
    """
    now = misfit_of_table(table, data, how)
    if now < DOUBTFUL:
        return ""
    cures = _cures(_changed(table), now, data, how)
    if not cures or cures[0][0] > DOUBTFUL:
        cures = sorted([*cures, *_cures(_other_lengths(table, data, how), now, data, how)])
    likely = [text for apart, text in cures if apart <= _AS_WELL * cures[0][0]]
    return ", or ".join(likely) if 0 < len(likely) <= _MOST else ""


def _cures(tried: Iterable[tuple[DhTable, str]], now: float, data: Table, how: HowRead) -> list[tuple[float, str]]:
    """Return what each change leaves that cures a misfit of `now`, with the change, the best first."""
    cures = [(misfit_of_table(other, data, how), text) for other, text in tried]
    return sorted(one for one in cures if one[0] < min(APART / 2, _BETTER * now))


def _changed(table: DhTable) -> Iterator[tuple[DhTable, str]]:
    """Yield tables with one thing changed, and the change as the end of "the readings fit the arm ..."."""
    for form in FORMS:
        if form != table.form:
            yield replace(table, form=form), f"as {form}: convention={form}"
    rows = table.rows
    for k, row in enumerate(rows):
        if row.kind != "fixed":
            slides = row.kind == "rotary"
            other = replace(row, kind="sliding" if slides else "rotary", lower=-inf, upper=inf)
            how = "slides: type prismatic" if slides else "turns: type revolute"
            yield _with(table, {k: other}), f"if row {k + 1} ({row.name}) {how}"
    for i, j in combinations(range(len(rows)), 2):
        one, other = rows[i], rows[j]
        pair = f"rows {i + 1} ({one.name}) and {j + 1} ({other.name})"
        yield _with(table, {i: other, j: one}), f"if {pair} are exchanged"
        numbers = {i: _named_as(one, other), j: _named_as(other, one)}
        yield _with(table, numbers), f"if {pair} exchange their numbers, and keep their names"
    for first, second in (("a", "d"), ("alpha", "theta")):
        yield _columns_exchanged(table, first, second), f"if columns {first} and {second} are exchanged"
    scale = between("alpha", "rad", table.angle)
    for k, row in enumerate(rows):
        for alpha in _other_alphas(row.alpha):
            was, now = (f"{plain(scale * v, 4)} {table.angle}" for v in (row.alpha, alpha))
            text = f"if alpha of row {k + 1} ({row.name}) is {now}, not {was}"
            yield _with(table, {k: replace(row, alpha=alpha)}), text


def _other_alphas(alpha: float) -> Iterator[float]:
    """Yield what an alpha may have been meant to be: of the other sign, or a quarter turn for none, or none for one."""
    if abs(alpha) < _STRAIGHT:
        yield from (pi / 2, -pi / 2)
        return
    if pi - abs(alpha) > _STRAIGHT:
        yield -alpha
    if abs(abs(alpha) - pi / 2) < _STRAIGHT:
        yield 0.0


def _other_lengths(table: DhTable, data: Table, how: HowRead) -> Iterator[tuple[DhTable, str]]:
    """Yield tables with one length as the readings have it, and the change, as `_changed` does."""
    try:
        readings = read_readings(data, table.chain, how.observe)
    except (DataError, ChainError):
        return
    for k, row in enumerate(table.rows):
        for one in LENGTHS:
            length = length_of(table, k, one, readings)
            if length is not None:
                was, now = (plain(between(one, "mm", table.length) * v, 3) for v in (getattr(row, one), length))
                text = f"if {one} of row {k + 1} ({row.name}) is about {now} {table.length}, not {was}"
                changed: dict[str, Any] = {one: length}
                yield _with(table, {k: replace(row, **changed)}), text


def _columns_exchanged(table: DhTable, one: str, other: str) -> DhTable:
    rows = (replace(row, **{one: getattr(row, other), other: getattr(row, one)}) for row in table.rows)
    return replace(table, rows=tuple(rows))


def _with(table: DhTable, rows: dict[int, DhRow]) -> DhTable:
    return replace(table, rows=tuple(rows.get(k, row) for k, row in enumerate(table.rows)))


def _named_as(row: DhRow, numbers: DhRow) -> DhRow:
    return replace(row, kind=numbers.kind, **{one: getattr(numbers, one) for one in NUMBERS})


def length_of(table: DhTable, row: int, number: str, readings: Readings) -> float | None:
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
        rest = np.sqrt(((rows @ solved - wanted) ** 2).sum(axis=1))
        near = rest <= max(_FAR * float(np.median(rest)), 1e-9)
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
