"""Messages of ROS as tables write them, and files of two sources that time stamps join.

Read are `ros2 topic echo --csv` (no header; the joints' names in each row), `rostopic echo -p` (%time, field.name0),
and exports of bagpy and rosbags (header.stamp.secs, lists in a cell). The stamp of the header goes before any other
time. Each row of the file of poses is joined to where the joints were then: interpolated where they are read closely
and stood still, or the nearest row within a gap.
"""

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calibench.calibration.columns import POSITION, QUATERNION, TIMES, measured_axes
from calibench.calibration.rigid import Array, Index, Mask
from calibench.core.notes import Code, DataError, Note
from calibench.core.tables.columns import Columns, as_seconds
from calibench.core.words import plain

GAP = 0.1  # s, between a pose and the joints' reading, where nothing is stated
_STILL = 2e-4  # of the way of a joint: less than it moves about a moment at which it stands
_SIZES = {3: POSITION, 7: (*POSITION, *QUATERNION)}
_HEADLESS = re.compile(r"\d{9,10},\d{1,9},[^,]*,")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|nan", re.IGNORECASE)
_QUOTED = re.compile(r"['\"]([^'\"]*)['\"]")  # names of joints in one cell
_OF_PLACE, _OF_TURN = {"position", "point", "translation"}, {"orientation", "rotation"}


def ros_columns(text: str) -> Columns | None:
    """Return joints by name, places and quaternions, and `t_s` [s] of a file that ROS wrote; None for any other."""
    first, _, rest = text.partition("\n")
    if _HEADLESS.match(first):
        # `ros2 topic echo --csv`: sec, nanosec, frame_id, and joints or a pose behind them
        rows = [row for row in csv.reader(text.splitlines()) if row and row[0].isdigit()]
        seconds = np.array([float(row[0]) + 1e-9 * float(row[1]) for row in rows])
        split: list[tuple[Sequence[str], Sequence[str]]] = []
        for row in rows:
            words = next((k for k, cell in enumerate(row[3:]) if _NUMBER.fullmatch(cell.strip())), len(row) - 3)
            split.append((row[3 : 3 + words], row[3 + words :]))
        most, numbers = max(len(words) for words, _ in split), max(len(values) for _, values in split)
        if most == 0 or (most == 1 and numbers > 3):
            axes = _SIZES[7] if numbers >= 7 else _SIZES.get(numbers)
            if axes is None:
                return None
            split = [(axes, values) for _, values in split]
        messages = [[(name.strip(), value) for name, value in zip(*one, strict=False)] for one in split]
    else:
        heads = [head.strip() for head in next(csv.reader([first]), [])]
        times = _stamps(heads)
        rows = [] if times is None else [row for row in csv.reader(rest.splitlines()) if len(row) == len(heads)]
        if times is None or not rows:
            return None
        cells = dict(zip(heads, zip(*rows, strict=True), strict=True))
        read = {at: np.array([float(cell or "nan") for cell in cells[at]]) for at in times}
        seconds = np.sum([unit * read[at] for at, unit in times.items()], axis=0)
        messages = _messages(cells, len(rows))
    columns: dict[str, Any] = {"t_s": seconds}
    for i, message in enumerate(messages):
        for name, value in message:
            columns.setdefault(name, np.full(len(rows), np.nan))[i] = float(value or "nan")
    text = f"a file of ROS, {len(rows)} messages: {', '.join(name for name in columns if name != 't_s')}"
    units = {"t_s": "s"} | {axis: "m" for axis in POSITION if axis in columns}
    return Columns(columns, notes=(Note(Code.FILE, text),), units=units)


def _stamps(heads: list[str]) -> dict[str, float] | None:
    """Return the columns whose sum is the time, and the seconds of their units; None where a file is not of ROS."""
    ends = {tuple(re.split(r"[./]", head.lower())[-2:]): head for head in heads}
    for second, nano in (("sec", "nanosec"), ("secs", "nsecs"), ("sec", "nsec")):
        for of in (("stamp",), ()):
            if (*of, second) in ends and (*of, nano) in ends:
                return {ends[(*of, second)]: 1.0, ends[(*of, nano)]: 1e-9}
    return {ends.get(("header", "stamp"), "%time"): 1e-9} if "%time" in heads else None


def _messages(cells: Mapping[str, tuple[str, ...]], n: int) -> list[list[tuple[str, str]]]:
    """Return name and number of all that each row holds: joints, of which it says its own order, places and turns."""
    names, places = (
        [head for head in cells if re.fullmatch(rf"(?:field\.)?{what}_?\d*", head)] for what in ("name", "position")
    )
    axes = {}
    for head in cells:
        *_, of, axis = ["", *re.split(r"[./]", head.lower())]
        if (of in _OF_PLACE and axis in POSITION) or (of in _OF_TURN and axis in "xyzw"):
            axes[head] = axis if of in _OF_PLACE else f"q{axis}"
    messages = []
    for i in range(n):
        words = [word for head in names for word in _QUOTED.findall(cells[head][i]) or [cells[head][i]] if word]
        numbers = [number for head in places for number in _NUMBER.findall(cells[head][i])]
        messages.append([*zip(words, numbers, strict=False), *((name, cells[head][i]) for head, name in axes.items())])
    return messages


def by_time(contents: Mapping[str, Columns], gap: float = GAP) -> Columns | None:
    """Return the rows of poses with the joints of the other files at their times; None where times do not part them.

    One of the files has what was measured, and each has a time. Raises `DataError` where clocks have nothing in common.
    """
    clocks = {file: next((c for c in one.columns if c.lower() in TIMES), "") for file, one in contents.items()}
    measured = [file for file, one in contents.items() if measured_axes(list(one.columns))]
    times = {}
    for file, clock in clocks.items():
        if clock:
            at = np.asarray(contents[file].columns[clock], dtype=float)
            seconds = None if clock in contents[file].units else as_seconds(at)[0]
            times[file] = at if seconds is None else np.asarray(seconds)
    if len(times) < len(contents) or len(measured) != 1:
        return None
    [poses] = measured
    if all(np.array_equal(one, times[poses], equal_nan=True) for one in times.values()):
        return None
    at, columns = times[poses], {name: np.asarray(column) for name, column in contents[poses].columns.items()}
    known, still, units = np.isfinite(at), np.isfinite(at), dict(contents[poses].units)
    stand = np.zeros(len(at), dtype=np.int64)
    for file in contents:
        if file == poses:
            continue
        begin, end = np.nanmin(times[file]), np.nanmax(times[file])
        if begin > np.nanmax(at) + gap or end < np.nanmin(at) - gap:
            mine, theirs = (
                f"{plain(float(np.nanmin(one)), 12)} to {plain(float(np.nanmax(one)), 12)} s"
                for one in (at, times[file])
            )
            raise DataError(
                f"{poses} is of {mine} and {file} of {theirs}: of two clocks, which nothing joins here; write both by "
                "one clock, as header stamps are"
            )
        found = np.zeros(len(at), dtype=bool)
        for name, column in contents[file].columns.items():
            if name == clocks[file] or column.dtype.kind not in "iuf":
                continue
            if name in columns:
                raise DataError(f"{file}: column {name} is in {poses} too; rename one")
            column = np.asarray(column, dtype=float)
            values, there, stands = _at_times(times[file], column, at, gap)
            columns[name] = values
            found |= there
            still &= stands
            if np.isfinite(column).any():  # a stand ends where the joint moved on
                way = 5 * _STILL * max(float(np.nanmax(column) - np.nanmin(column)), 1e-12)
                stand += np.cumsum(np.abs(np.diff(values, prepend=values[:1])) > way)
        known &= found
        units |= {name: unit for name, unit in contents[file].units.items() if name in columns}
    kept = known & still
    stand += np.cumsum(~kept)  # one that is left out parts two stands
    made = _of_stands(columns, kept, stand)
    count = len(next(iter(made.values())))
    text = (
        f"{', '.join(contents)} are joined by time: {int(kept.sum())} of {len(at)} rows of {poses} are joined, "
        f"{count} poses at which the arm stood; {int((~known).sum())} are further than {plain(gap, 3)} s from all "
        f"joints, at {int((known & ~still).sum())} the arm moved"
    )
    counts = {"rows": len(at), "joined": int(kept.sum()), "poses": count}
    notes = [*(note for one in contents.values() for note in one.notes), Note(Code.FILE, text, values=counts)]
    if not count:
        raise DataError(f"{text}; gap= states how far apart in time rows may be [s]")
    metadata = {key: value for one in contents.values() for key, value in one.metadata.items()}
    return replace(contents[poses], columns=made, units=units, notes=tuple(notes), metadata=metadata)


def _at_times(times: Array, column: Array, at: Array, gap: float) -> tuple[Array, Mask, Mask]:
    """Return a joint at the times `at`, (n,): interpolated, or the nearest; where it was read, and where it stood."""
    some = np.isfinite(times) & np.isfinite(column)
    order = np.argsort(times[some], kind="stable")
    when, values = times[some][order], column[some][order]
    if not len(when):
        return np.full(len(at), np.nan), np.zeros(len(at), dtype=bool), np.ones(len(at), dtype=bool)
    after = np.clip(np.searchsorted(when, at), 1, max(len(when) - 1, 1))
    if len(when) == 1:
        after[:] = 0
    before = np.maximum(after - 1, 0)
    close = (at - when[before] <= gap) & (when[after] - at <= gap) & (at >= when[before]) & (when[after] >= at)
    nearest = np.where(np.abs(at - when[before]) <= np.abs(when[after] - at), before, after)
    there = close | (np.abs(when[nearest] - at) <= gap)
    found = np.where(close, np.interp(at, when, values), values[nearest])
    first, last = np.searchsorted(when, at - gap), np.searchsorted(when, at + gap, side="right")
    ends = np.clip(np.stack([first, last - 1]), 0, len(when) - 1)
    way = _STILL * max(float(np.ptp(values)), 1e-12)
    stands = np.abs(values[ends[1]] - values[ends[0]]) <= way
    for end in ends:  # nor was it elsewhere at either end
        stands &= np.abs(values[end] - found) <= way
    return np.where(there, found, np.nan), there, np.where(close, stands, True)


def _of_stands(columns: Mapping[str, Any], kept: Mask, stand: Index) -> dict[str, Any]:
    """Return one row for each stand: the middle value of numbers, the first of words; quaternions of one sign."""
    rows = np.flatnonzero(kept)
    starts = np.flatnonzero(np.diff(stand[rows], prepend=-1))
    groups = np.split(rows, starts[1:]) if len(rows) else []
    quaternions = [name for name in columns if name in QUATERNION]
    made = {name: np.array(column) for name, column in columns.items()}
    if len(quaternions) == 4:
        q = np.column_stack([made[name] for name in quaternions])
        for group in groups:
            q[group] *= np.where(q[group] @ q[group[0]] < 0, -1.0, 1.0)[:, None]
        made |= dict(zip(quaternions, q.T, strict=True))
    out: dict[str, Any] = {}
    for name, column in made.items():
        if column.dtype.kind in "iuf":
            out[name] = np.array([np.nanpercentile(column[g], 50, method="lower") if np.isfinite(column[g]).any()
                                  else np.nan for g in groups], dtype=float)  # fmt: skip
        else:
            out[name] = column[[group[0] for group in groups]]
    return out
