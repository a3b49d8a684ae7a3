"""The exact Orthoglide with everything that may be wrong with it: axes, joints, legs, bars, gauges.

Three spheres of radius L_i about the joint centres A_i meet in the tool centre point p, eq. (2) with the joint centres
anywhere. The perfect machine has A_i = rho_i e_i. A gauge at a leg keeps its plane across the leg, section 3.2, and
reads along `direction` how far the leg's line has gone from where it crossed that plane at Zero.

Quantities beside the six parameters, mm and rad, zero where nothing is wrong (i, j, k are x, y, z):
tilt_ij, offset_ij: axis i leans towards j, is shifted along j. joint_i, length_i: joint i stands further, leg i is
longer than it should at the posture; joint_i_zero, length_i_zero: at the Zero it is compared with. skew_ij: the bar of
leg i that the gauge touches ends at the tool that far along j of where it should. tilt_ij_now, tilt_ij_zero and so on:
what a tilt, an offset or a skew is more at the posture, and at that Zero. gauge_roll: the gauge is turned about the
leg, towards the other direction across it; gauge_pitch: towards +leg; gauge_shift: its plane cuts the leg's axis that
much further from the origin than stated.

The table of an Orthoglide's measurement: its columns, validated and returned as arrays.

A row is one deviation [mm]: how far `leg` stands along `direction` from where it stood at the Zero posture, with the
tool moved to `level_mm` along the axis that `posture` names (x, or xmax and xmin for the ends of the stroke; max and
min for the leg's own axis). Needed: leg, direction, posture (and level_mm where the posture names no end), deviation.
With defaults: gauge_position (.5, the share of the leg from its joint to the tool), against_mm (0: compared with Zero),
pass (fwd: the tool arrives moving towards +, or rev), zero_pass (as pass), payload_N (0), repeat (0).
Optional: t_s and zero_t_s, temp_K and zero_temp_K: time and temperature of the reading and of its Zero reading.

The Zero is read once for a gauge that stands where it stands, and subtracted from all its readings: rows that agree in
leg, direction, gauge_position, zero_pass, payload_N and repeat share it. It is reached along the leg's own axis. Where
against_mm is another level, as in Table 1, zero_pass, zero_t_s and zero_temp_K are those of the reading there.

The five sets the chapter prints, as measured data: exp1, exp2, exp2_t1, exp3_t1, exp3_t2.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, final, get_args
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from calibench.core.notes import Code, Note
from calibench.core.options import suggest
from calibench.core.words import as_columns
from calibench.discrepancy.checks.validate import entered
from calibench.discrepancy.model.machine import Numbers, Quantities
from calibench.discrepancy.model.measured import Column, DataError, MeasuredData
from calibench.problems import constants
from calibench.problems.base import Array
from calibench.problems.orthoglide.kinematics import AXES, PAPER, geometry, inverse_kinematics
from calibench.problems.orthoglide.measured import SetName, check_deviations, measured
from calibench.problems.orthoglide.plans import Reading, check_plan

PAIRS = tuple((i, j) for i in range(3) for j in range(3) if i != j)
FIXED = ("tilt", "offset", "skew")  # the same at every moment, but for what is said to be more at one
GAUGE = ("gauge_roll", "gauge_pitch", "gauge_shift")
IMPERFECTIONS = (
    *(f"{kind}_{AXES[i]}{AXES[j]}{when}" for kind in FIXED for i, j in PAIRS for when in ("", "_now", "_zero")),
    *(f"{kind}_{axis}{when}" for kind in ("joint", "length") for axis in AXES for when in ("", "_zero")),
    *GAUGE,
)


def deviations(rows: Rows, q: Quantities) -> Numbers:
    """Return the deviations the gauges must show, shape (n,), mm."""
    gauge = _gauges(rows, q)
    read = gauge.read(gauge.after) - np.where(rows.against == 0, 0.0, gauge.read(gauge.before))
    return np.asarray(read)


def slopes(rows: Rows, q: Quantities) -> dict[str, Array]:
    """Return the derivative of `deviations` in each quantity but the reading, name -> (n,)."""
    gauge = _gauges(rows, q)
    compared = np.where(rows.against == 0, 0.0, -1.0)
    found = {name: np.zeros(len(rows.level)) for name in (*_PARAMETERS, *IMPERFECTIONS)}
    centre_zero, tool_zero = np.zeros((2, len(rows.level), 3))
    for posture, weight, when in ((gauge.after, 1.0, ""), (gauge.before, compared, "_zero")):
        across, share = gauge.across(posture), gauge.share(posture)
        rise = gauge.rise(posture) - gauge.rise(gauge.zero)
        slope, pitch = gauge.slope(posture), gauge.pitch
        gain = weight / (1 - slope * pitch)
        lever = weight * rise * pitch / (1 - slope * pitch) ** 2 / gauge.span(posture)
        gauge.push(
            found,
            posture,
            across * ((1 - share) * gain - lever)[:, None],
            across * (share * gain + lever)[:, None],
            when,
        )
        turned = gauge.turned(posture) - gauge.turned(gauge.zero)
        found["gauge_roll"] += (
            gain * turned + weight * rise * pitch * gauge.turned_slope(posture) / (1 - slope * pitch) ** 2
        )
        found["gauge_pitch"] += weight * rise * slope / (1 - slope * pitch) ** 2
        share_zero, plane = gauge.share(gauge.zero), gain * (slope - gauge.slope(gauge.zero))
        found["gauge_shift"] += plane
        across_zero = gauge.across(gauge.zero) * -gain[:, None]
        centre_zero += across_zero * (1 - share_zero)[:, None] + gauge.along * (plane * (1 - rows.share))[:, None]
        tool_zero += across_zero * share_zero[:, None] + gauge.along * (plane * rows.share)[:, None]
    gauge.push(found, gauge.zero, centre_zero, tool_zero, "_zero", rows.against == 0)
    return found


_PARAMETERS = (*(f"drho_{a}" for a in AXES), *(f"dL_{a}" for a in AXES))


@final
@dataclass(frozen=True, eq=False)
class _Posture:
    """Joint centres and axes, shape (n, 3, 3) and (3, n, 3), true joints and lengths, tool and bar's end, (n, 3).

    `centre` is the joint centre of the leg that is measured, (n, 3); `norms` those of the axes before, (3, n).
    """

    centres: Numbers
    centre: Numbers
    axes: Numbers
    norms: Numbers
    joints: Numbers
    lengths: Numbers
    tool: Numbers
    end: Numbers


@final
@dataclass(frozen=True, eq=False)
class _Gauges:
    """The gauges of all rows: where their planes are, which way they read, and the three postures of each row."""

    rows: Rows
    q: Quantities
    after: _Posture
    before: _Posture
    zero: _Posture

    @cached_property
    def along(self) -> Array:
        return np.eye(3)[self.rows.leg]

    @property
    def pitch(self) -> Numbers:
        return self.q["gauge_pitch"]

    @cached_property
    def reads(self) -> Numbers:
        """Return the direction a gauge reads across its leg, shape (n, 3)."""
        roll = np.asarray(self.q["gauge_roll"])[..., None]
        return np.asarray(np.cos(roll) * np.eye(3)[self.rows.direction] + np.sin(roll) * np.eye(3)[self.rows.other])

    @cached_property
    def plane(self) -> Numbers:
        """Return where a gauge's plane cuts the leg's axis, shape (n,), eq. (10) for a gauge at any share."""
        share, at = self.rows.share, self.zero
        place = share * _dot(at.end, self.along) + (1 - share) * _dot(at.centre, self.along)
        return np.asarray(place + self.q["gauge_shift"])

    def read(self, at: _Posture) -> Numbers:
        """Return how far the gauge's tip has gone since Zero, shape (n,): a pitched one slides along a sloping leg."""
        return np.asarray((self.rise(at) - self.rise(self.zero)) / (1 - self.slope(at) * self.pitch))

    def rise(self, at: _Posture) -> Numbers:
        """Return where the leg crosses the gauge's plane, along the direction it reads, shape (n,)."""
        return _dot(self._crossing(at), self.reads)

    def share(self, at: _Posture) -> Numbers:
        """Return mu of section 3.2, the share of the leg at which it crosses the plane, shape (n,)."""
        return np.asarray((self.plane - _dot(at.centre, self.along)) / self.span(at))

    def span(self, at: _Posture) -> Numbers:
        return _dot(at.end - at.centre, self.along)

    def slope(self, at: _Posture) -> Numbers:
        """Return how much the leg rises along the direction read for a step along the axis, shape (n,)."""
        return np.asarray(_dot(at.end - at.centre, self.reads) / self.span(at))

    def across(self, at: _Posture) -> Numbers:
        """Return d rise / d place of the leg's line, shape (n, 3)."""
        return np.asarray(self.reads - self.slope(at)[:, None] * self.along)

    def turned(self, at: _Posture) -> Numbers:
        """Return d rise / d roll, shape (n,)."""
        return _dot(self._crossing(at), self._turn)

    def _crossing(self, at: _Posture) -> Numbers:
        """Return where the leg crosses the gauge's plane, shape (n, 3)."""
        return np.asarray(at.centre + self.share(at)[:, None] * (at.end - at.centre))

    def turned_slope(self, at: _Posture) -> Numbers:
        return np.asarray(_dot(at.end - at.centre, self._turn) / self.span(at))

    def push(
        self, found: dict[str, Array], at: _Posture, centre: Array, tool: Array, when: str, where: Array | bool = True
    ) -> None:
        """Add to `found` what a posture's quantities do, given d read / d centre of the leg and d read / d bar's end.

        Joints and lengths of the moment (`when`) are pushed only `where` the posture is that moment's.
        """
        legs = np.arange(len(centre))
        rays = at.tool[:, None, :] - at.centres  # M of the relations before eq. (5)
        weights = np.linalg.solve(rays.swapaxes(1, 2), tool[:, :, None])[:, :, 0]
        on_centres = weights[:, :, None] * rays
        on_centres[legs, self.rows.leg] += centre
        for i, axis in enumerate(AXES):
            joint, length = _dot(on_centres[:, i], at.axes[i]), weights[:, i] * at.lengths[:, i]
            for name, value in ((f"drho_{axis}", joint), (f"dL_{axis}", length)):
                found[name] += value
            found[f"joint_{axis}{when}"] += np.where(where, joint, 0.0)
            found[f"length_{axis}{when}"] += np.where(where, length, 0.0)
        for i, j in PAIRS:
            ij = AXES[i] + AXES[j]
            lean = (np.eye(3)[j] - at.axes[i] * at.axes[i][:, j : j + 1]) / at.norms[i][:, None]
            for kind, value in (
                ("tilt", at.joints[:, i] * _dot(on_centres[:, i], lean)),
                ("offset", on_centres[:, i, j]),
                ("skew", np.where(self.rows.leg == i, tool[:, j], 0.0)),
            ):
                found[f"{kind}_{ij}"] += value
                found[f"{kind}_{ij}{when or '_now'}"] += np.where(where, value, 0.0)

    @cached_property
    def _turn(self) -> Numbers:
        roll = np.asarray(self.q["gauge_roll"])[..., None]
        return np.asarray(np.cos(roll) * np.eye(3)[self.rows.other] - np.sin(roll) * np.eye(3)[self.rows.direction])


def _gauges(rows: Rows, q: Quantities) -> _Gauges:
    at_zero = rows.against == 0
    after, before = _posture(rows, q, rows.level, "", True), _posture(rows, q, rows.against, "_zero", True)
    return _Gauges(rows, q, after, before, _posture(rows, q, np.zeros(len(rows.level)), "_zero", at_zero))


def _posture(rows: Rows, q: Quantities, level: Array, when: str, moment: Array | bool) -> _Posture:
    """Return the posture with the tool sent to `level`; errors of the moment `when` count where `moment`."""
    commanded, n = rows.joints(level), len(level)
    joints, lengths, centres, axes, norms = [], [], [], [], []
    for i, axis in enumerate(AXES):
        joints.append(commanded[:, i] + q[f"drho_{axis}"] + np.where(moment, q[f"joint_{axis}{when}"], 0.0))
        lengths.append(
            geometry().length + q[f"dL_{axis}"] + np.where(moment, q[f"length_{axis}{when}"], 0.0) + np.zeros(n)
        )
        leaning = _components(i, "tilt", q, n, 1.0, when, moment)
        norms.append(np.sqrt(_dot(leaning, leaning)))
        axes.append(leaning / norms[i][:, None])
        centres.append(_components(i, "offset", q, n, 0.0, when, moment) + joints[i][:, None] * axes[i])
    radii = np.stack(lengths, axis=1)
    # where three spheres meet on the side of the origin, shape (n, 3): eqs. (2) solved without rotation
    one, two = centres[1] - centres[0], centres[2] - centres[0]
    b1 = (_dot(one, one) + radii[:, 0] ** 2 - radii[:, 1] ** 2) / 2
    b2 = (_dot(two, two) + radii[:, 0] ** 2 - radii[:, 2] ** 2) / 2
    g11, g12, g22 = _dot(one, one), _dot(one, two), _dot(two, two)
    square = g11 * g22 - g12**2  # of twice the triangle's area
    foot = ((b1 * g22 - b2 * g12) / square)[:, None] * one + ((b2 * g11 - b1 * g12) / square)[:, None] * two
    normal = np.cross(one, two)
    height = np.sqrt((radii[:, 0] ** 2 - _dot(foot, foot)) / square)
    tool = np.asarray(centres[0] + foot - height[:, None] * normal)
    skew = np.stack([_components(i, "skew", q, n, 0.0, when, moment) for i in range(3)], axis=1)[np.arange(n), rows.leg]
    stacked = np.stack(centres, axis=1)
    own = stacked[np.arange(n), rows.leg]
    along, sizes = np.stack(axes), np.stack(norms)
    return _Posture(
        stacked, own, along, norms=sizes, joints=np.stack(joints, axis=1), lengths=radii, tool=tool, end=tool + skew
    )


def _components(
    i: int, kind: str, q: Quantities, n: int, own: float, when: str, moment: Array | bool
) -> Numbers:  # fmt: skip
    """Return the vector, (n, 3), of `own` along axis i and the quantities kind_ij along the others, at a moment."""
    parts: list[Any] = []
    for j in range(3):
        name = f"{kind}_{AXES[i]}{AXES[j]}"
        parts.append(own if j == i else _with_more(q[name], q[f"{name}{when or '_now'}"], moment))
    vector = np.empty((n, 3), dtype=np.result_type(*parts))
    for j, part in enumerate(parts):
        vector[:, j] = part
    return vector


def _with_more(value: Any, more: Any, moment: Array | bool) -> Any:
    nothing = np.ndim(more) == 0 and more == 0
    return value if nothing else value + np.where(moment, more, 0.0)


def _dot(a: Numbers, b: Numbers) -> Numbers:
    return np.asarray((a * b).sum(axis=-1))


Index = NDArray[np.intp]
_WORDS = ("leg", "direction", "posture", "pass", "zero_pass")
_DEFAULTS = {"gauge_position": 0.5, "against_mm": 0.0, "payload_N": 0.0, "repeat": 0.0}
ACCEPTED = "checked"  # the column that says so
_OPTIONAL = ("t_s", "zero_t_s", "temp_K", "zero_temp_K")


@final
@dataclass(frozen=True, eq=False)
class Rows:
    """The rows as arrays, shape (n,): indices 0 1 2 for x y z, mm, N, and +1 or -1 for the direction of arrival."""

    leg: Index
    direction: Index
    axis: Index
    level: Array
    against: Array
    share: Array
    arrival: Array
    zero_arrival: Array
    payload: Array
    repeat: Array

    @property
    def other(self) -> Index:
        """Return the direction across the leg that the gauge does not read, shape (n,)."""
        return np.asarray(3 - self.leg - self.direction)

    def joints(self, level: Array) -> Array:
        """Return the commanded joints, shape (n, 3), mm, with the tool moved to `level`, shape (n,), on its axis."""
        return inverse_kinematics(level[:, None] * np.eye(3)[self.axis])

    def senses(self) -> tuple[Array, Array]:
        """Return the sense of each joint's last move, +1, -1 or 0, shape (n, 3): at the posture and at the Zero.

        The moved joint goes with the tool; the others are drawn in by sqrt(L^2 - v^2) as it leaves Zero.
        """
        own, home = np.eye(3)[self.axis], np.eye(3)[self.leg]
        home = np.where(self.against[:, None] == 0, home, own)
        drawn_in = np.where(self.against == 0, 1.0, -np.sign(self.against) * self.zero_arrival)
        at_posture = own * self.arrival[:, None] + (1 - own) * (-np.sign(self.level) * self.arrival)[:, None]
        return at_posture, home * self.zero_arrival[:, None] + (1 - home) * drawn_in[:, None]

    def zero_group(self) -> Index:
        """Return the number of the Zero reading each row was subtracted from, shape (n,)."""
        parts = (self.leg, self.direction, self.share, self.zero_arrival, self.payload, self.repeat)
        key = np.column_stack([np.asarray(part, dtype=float) for part in parts])
        return np.asarray(np.unique(key, axis=0, return_inverse=True)[1]).reshape(-1)


def accepted(data: MeasuredData) -> MeasuredData:
    """Return `data` with every column there, in one spelling, rows without a deviation left out and told in a note.

    Raises `DataError` that names the column, the row, and the way out.
    """
    if data.machine not in ("", "orthoglide"):
        raise DataError(f"{data.name}: these are data of machine {data.machine!r}, not of an orthoglide")
    missing = [name for name in ("leg", "direction", "posture", "deviation") if name not in data]
    if missing:
        raise DataError(
            f"{data.name}: no column {', '.join(missing)}; there are {', '.join(data.in_file)}: "
            f"{as_columns({missing[0]: 'NAME'})} tells another name"
        )
    data = entered(data)
    keep = np.isfinite(_numbers(data, "deviation"))
    if not keep.any():
        raise DataError(f"{data.name}: no row has a deviation")
    if not keep.all():
        text = f"{int((~keep).sum())} rows without a deviation were left out"
        data = data.rows(keep).with_note(Code.ROWS_LEFT_OUT, text, ("deviation",), rows=data.labels(~keep))
    columns: dict[str, Column] = {name: _words(data, name) for name in _WORDS[:3]}
    columns["posture"], columns["level_mm"] = _levels(data, columns["leg"], columns["posture"])
    columns["pass"] = _words(data, "pass") if "pass" in data else np.full(len(data), "fwd")
    columns["zero_pass"] = _words(data, "zero_pass") if "zero_pass" in data else columns["pass"]
    for name in ("pass", "zero_pass"):
        _refuse_row(data, name, columns[name], np.isin(columns[name], ("fwd", "rev")), "fwd or rev is needed")
    for name, value in _DEFAULTS.items():
        columns[name] = _numbers(data, name) if name in data else np.full(len(data), value)
    for name in _OPTIONAL:
        if name in data:
            columns[name] = _numbers(data, name)
    for name, column in columns.items():
        if name not in _WORDS:
            _refuse_row(data, name, column, np.isfinite(column), "a finite number is needed, or leave the row out")
    columns["deviation"] = _numbers(data, "deviation")
    data = _numbered(data.with_columns(columns))
    # raise `DataError` for a row no Orthoglide can give, or numbers that are not millimetres
    keys = ("leg", "direction", "posture", "level_mm", "gauge_position", "against_mm")
    distinct = list(dict.fromkeys(zip(*(data[key].tolist() for key in keys))))
    try:
        check_plan([Reading(*key) for key in distinct])
        check_deviations(data["deviation"], "deviation")
    except ValueError as error:
        raise DataError(f"{data.name}: {error}") from None
    data = _visited(data)
    return replace(data.with_columns({ACCEPTED: np.ones(len(data))}), machine="orthoglide")


def is_accepted(data: MeasuredData) -> bool:
    """Return whether `data` come from `accepted`, perhaps with fewer rows or other deviations."""
    return ACCEPTED in data


def rows_of(data: MeasuredData) -> Rows:
    """Return the rows of accepted data as arrays; asked again, the same."""
    if data not in _ROWS:
        index = {name: np.searchsorted(AXES, data[name]) for name in ("leg", "direction", "posture")}
        sense = {name: np.where(np.asarray(data[name]) == "fwd", 1.0, -1.0) for name in ("pass", "zero_pass")}
        columns: dict[str, Any] = {
            "leg": index["leg"],
            "direction": index["direction"],
            "axis": index["posture"],
            "level": data["level_mm"],
            "against": data["against_mm"],
            "share": data["gauge_position"],
            "arrival": sense["pass"],
            "zero_arrival": sense["zero_pass"],
            "payload": data["payload_N"],
            "repeat": data["repeat"],
        }
        _ROWS[data] = Rows(**{f.name: columns[f.name] for f in fields(Rows)})
    return _ROWS[data]


def share_rows(data: MeasuredData, other: MeasuredData) -> bool:
    """Let `data` have the rows of `other` if nothing but the deviations differs; tell whether it is so."""
    if any(data.columns.get(name) is not column for name, column in other.columns.items() if name != "deviation"):
        return False
    _ROWS[data] = rows_of(other)
    return True


_ROWS: WeakKeyDictionary[MeasuredData, Rows] = WeakKeyDictionary()


def _numbered(data: MeasuredData) -> MeasuredData:
    """Return the data with readings that cannot be told apart numbered by repeat."""
    names = ("leg", "direction", "posture", "level_mm", "gauge_position", "against_mm", "pass", "payload_N", "repeat")
    seen: dict[tuple[Any, ...], int] = {}
    again = np.zeros(len(data))
    for k, key in enumerate(zip(*(data[name].tolist() for name in names))):
        again[k] = seen[key] = seen.get(key, -1) + 1
    if not again.any():
        return data
    repeat = data["repeat"] + again * (1 + np.ptp(data["repeat"]))
    text = (
        f"{int((again > 0).sum())} rows were there before: they were taken as repeats with a Zero reading of their own"
    )
    return data.with_columns({"repeat": repeat}).with_note(Code.ROWS_SAID_TWICE, text, rows=data.labels(again > 0))


def _visited(data: MeasuredData) -> MeasuredData:
    """Return the data with pose_id and visit_id: readings set up alike are one pose, and its repeats one visit.

    Poses of one gauge are compared with one Zero: they have a shared_id.
    """
    names = (
        "leg",
        "direction",
        "posture",
        "level_mm",
        "gauge_position",
        "against_mm",
        "pass",
        "zero_pass",
        "payload_N",
    )
    pose, gauge = (_alike(data, some) for some in (names, ("leg", "direction", "gauge_position", "payload_N")))
    return data.with_columns({"pose_id": pose, "visit_id": pose, "shared_id": gauge})


def _alike(data: MeasuredData, names: tuple[str, ...]) -> Array:
    """Return a number for each row, (n,), the same for rows that agree in all columns of `names`."""
    parts = [np.unique(data[name], return_inverse=True)[1].reshape(-1) for name in names]
    return np.asarray(np.unique(np.column_stack(parts), axis=0, return_inverse=True)[1].reshape(-1), dtype=float)


def _levels(data: MeasuredData, leg: Column, posture: Column) -> tuple[Column, Array]:
    """Return the axis the tool is moved along, and how far [mm]: x and the stroke for xmax."""
    strokes = {"max": geometry().stroke_plus, "min": geometry().stroke_minus}
    given = _numbers(data, "level_mm") if "level_mm" in data else np.full(len(data), np.nan)
    axes, levels = [], given.copy()
    for k, (own, word) in enumerate(zip(leg, posture)):
        axis, end = (word[0], word[1:]) if word[:1] in AXES else (own, word)
        if end not in ("", *strokes):
            choices = [*AXES, *strokes, *(a + e for a in AXES for e in strokes)]
            raise DataError(f"{data.name}: row {k + 1}: posture={word!r}: {suggest(word, choices)}")
        if not np.isfinite(given[k]):
            if not end:
                raise DataError(f"{data.name}: row {k + 1}: posture={word} needs a level_mm, or xmax, xmin and so on")
            levels[k] = strokes[end]
        elif end and given[k] * strokes[end] <= 0:
            raise DataError(f"{data.name}: row {k + 1}: posture={word} and level_mm={given[k]:g} differ in sign")
        axes.append(axis)
    return np.array(axes), levels


def _words(data: MeasuredData, name: str) -> Column:
    words = [w.decode() if isinstance(w, bytes) else str(w) for w in data[name]]
    column = np.array([w.strip().lower() for w in words])
    if name in ("leg", "direction"):
        _refuse_row(data, name, column, np.isin(column, AXES), "x, y or z is needed")
    return column


def _numbers(data: MeasuredData, name: str) -> Array:
    try:
        return np.asarray(data[name], dtype=float)
    except (TypeError, ValueError):
        raise DataError(f"{data.name}: column {name!r} holds something that is not a number") from None


def _refuse_row(data: MeasuredData, name: str, column: Column, good: NDArray[np.bool_], rule: str) -> None:
    if not good.all():
        k = int(np.flatnonzero(~good)[0])
        raise DataError(f"{data.name}: row {k + 1}: {name}={column[k]}: {rule}")


_STEP_NOTE = Note(
    Code.TIME_UNKNOWN,
    "the chapter prints no times: the path Zero, Max, Min, Zero of section 4.1 stands for them, a step of t_s "
    "a move, so Max and Zero were reached moving towards +, Min towards -",
    ("t_s",),
)


def names() -> tuple[str, ...]:
    """Return the names of the printed sets."""
    return get_args(SetName)


def printed(name: str) -> MeasuredData:
    """Return a printed set: `sigma` is section 4.1's dissimilarity of three readings as the noise of their mean.

    The dissimilarity is an upper limit of .02 mm; the spread of three readings is 1.69 sigma on average, so sigma of
    one reading is at most about .012 mm: section 3.4's .01 mm is taken.
    """
    for choice in get_args(SetName):
        if choice == name:
            plan, deviations = measured(choice)
            break
    else:
        raise DataError(f"data={name}: {suggest(name, names())}")
    ends = np.array([r.level_mm > 0 for r in plan])
    compared = np.array([r.against_mm != 0 for r in plan])  # Table 1: Max minus Min
    columns = {
        "leg": np.array([r.leg for r in plan]),
        "direction": np.array([r.direction for r in plan]),
        "posture": np.array([r.axis for r in plan]),
        "gauge_position": np.array([r.gauge_position for r in plan]),
        "level_mm": np.array([r.level_mm for r in plan]),
        "against_mm": np.array([r.against_mm for r in plan]),
        "pass": np.where(ends, "fwd", "rev"),
        "zero_pass": np.where(compared, "rev", "fwd"),
        "payload_N": np.zeros(len(plan)),
        "repeat": np.zeros(len(plan)),
        "t_s": np.where(ends, 1.0, 2.0),
        "zero_t_s": np.where(compared, 2.0, 0.0),
        "split": np.full(len(plan), "train"),
        "deviation": deviations,
    }
    sigma = constants.column(PAPER, "text.section34")["sigma"]
    metadata = {"sigma": sigma, "free": "rho", "machine": "orthoglide"}
    return MeasuredData(columns, "orthoglide", metadata, name, (_STEP_NOTE,))
