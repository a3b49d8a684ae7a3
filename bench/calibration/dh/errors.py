"""What is wrong in a table of Denavit and Hartenberg that readings do not fit, found by trying what people mistake.

Tried are the other convention, each row with the other kind of joint, every two rows exchanged (with their names,
which is another order of the joints, and without), the columns a and d or alpha and theta exchanged, each alpha with
the other sign or a quarter turn more or less. Where none of these helps as much as it should, each length is tried as
the readings have it: a free number fits more than a slip of the pen. A change is told if the readings fit the arm with
it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import combinations
from math import inf, pi
from typing import Any

from calibench.bench.calibration.dh.lengths import LENGTHS, length_told
from calibench.bench.calibration.files import Table
from calibench.bench.calibration.readings import read_readings
from calibench.bench.calibration.request import CalibrateRequest
from calibench.bench.calibration.start import APART, DOUBTFUL, slid, started, unit_of
from calibench.core.tables.cells import between
from calibench.core.words import plain
from calibench.discrepancy import DataError
from calibench.problems.arm.chains.chain import ChainError
from calibench.problems.arm.chains.dh import FORMS
from calibench.problems.arm.chains.dh_table import NUMBERS, DhRow, DhTable
from calibench.problems.arm.chains.kinematics import forward, nominal

_BETTER = 0.2  # of the misfit of the table as it stands: one change of an arm that is merely not calibrated gains less
_AS_WELL = 2.0  # times the misfit of the best change: one that leaves less may be meant as well
_TOLD = 3  # changes: of as many axes that are parallel the offsets say the same
_STRAIGHT = 1e-3  # rad: an alpha that is nearer to a multiple of a quarter turn is one


def fits(table: DhTable, data: Table, request: CalibrateRequest) -> bool:
    """Return whether the readings fit the arm of `table`."""
    return misfit(table, data, request) < inf


def misfit(table: DhTable, data: Table, request: CalibrateRequest) -> float:
    """Return how far readings and nominal arm lie apart, as a part of its reach; infinite where it is not this arm."""
    try:
        chain = table.chain
        readings = read_readings(data, chain, request.observe, request.limits)
        if readings.position is not None:
            found = slid(readings, chain, forward(chain, nominal(chain), readings.joints))[2]
            if found.left > APART * found.reach or unit_of(found) is None:
                return inf  # before `started` looks for the reason
        started(readings, chain, request.rotation)
    except (DataError, ChainError):
        return inf
    return 0.0 if readings.position is None else found.left / found.reach


def error_of_table(table: DhTable, data: Table, request: CalibrateRequest) -> str:
    """Return which one change of `table` makes the readings fit the arm; "" where none does, or several would.

    Readings that fit the table as it stands, as well as arms do that are not calibrated, tell no error.
    """
    own = misfit(table, data, request)
    if own < DOUBTFUL:
        return ""
    found = _cures(_changed(table), own, data, request)
    if not found or found[0][0] > DOUBTFUL:
        found = sorted([*found, *_cures(_other_lengths(table, data, request), own, data, request)])
    likely = [said for left, said in found if left <= _AS_WELL * found[0][0]]
    return ", or ".join(likely) if 0 < len(likely) <= _TOLD else ""


def _cures(
    tried: Iterable[tuple[DhTable, str]], own: float, data: Table, request: CalibrateRequest
) -> list[tuple[float, str]]:
    """Return what each change leaves that cures a misfit of `own`, with the change, the best first."""
    found = [(misfit(other, data, request), said) for other, said in tried]
    return sorted(one for one in found if one[0] < min(APART / 2, _BETTER * own))


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
            told = "slides: type prismatic" if slides else "turns: type revolute"
            yield _with(table, {k: other}), f"if row {k + 1} ({row.name}) {told}"
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
            said = f"if alpha of row {k + 1} ({row.name}) is {now}, not {was}"
            yield _with(table, {k: replace(row, alpha=alpha)}), said


def _other_alphas(alpha: float) -> Iterator[float]:
    """Yield what an alpha may have been meant to be: of the other sign, or a quarter turn for none, or none for one."""
    if abs(alpha) < _STRAIGHT:
        yield from (pi / 2, -pi / 2)
        return
    if pi - abs(alpha) > _STRAIGHT:
        yield -alpha
    if abs(abs(alpha) - pi / 2) < _STRAIGHT:
        yield 0.0


def _other_lengths(table: DhTable, data: Table, request: CalibrateRequest) -> Iterator[tuple[DhTable, str]]:
    """Yield tables with one length as the readings have it, and the change, as `_changed` does."""
    try:
        readings = read_readings(data, table.chain, request.observe, request.limits)
    except (DataError, ChainError):
        return
    for k, row in enumerate(table.rows):
        for one in LENGTHS:
            told = length_told(table, k, one, readings)
            if told is not None:
                was, now = (plain(between(one, "mm", table.length) * v, 3) for v in (getattr(row, one), told))
                said = f"if {one} of row {k + 1} ({row.name}) is about {now} {table.length}, not {was}"
                changed: dict[str, Any] = {one: told}
                yield _with(table, {k: replace(row, **changed)}), said


def _columns_exchanged(table: DhTable, one: str, other: str) -> DhTable:
    rows = (replace(row, **{one: getattr(row, other), other: getattr(row, one)}) for row in table.rows)
    return replace(table, rows=tuple(rows))


def _with(table: DhTable, rows: dict[int, DhRow]) -> DhTable:
    return replace(table, rows=tuple(rows.get(k, row) for k, row in enumerate(table.rows)))


def _named_as(row: DhRow, numbers: DhRow) -> DhRow:
    return replace(row, kind=numbers.kind, **{one: getattr(numbers, one) for one in NUMBERS})
