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

The table of a measurement, whose columns docs/orthoglide-data.md tells, is validated and returned as arrays. Rows that
agree in leg, direction, gauge_position, zero_pass, payload_N and repeat share the Zero reading that was subtracted from
them. Where against_mm is another level, as in Table 1, zero_pass, zero_t_s and zero_temp_K are those of the reading
there. The five sets that the chapter prints are measured data as well: exp1, exp2, exp2_t1, exp3_t1, exp3_t2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, final, get_args
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from calibench.core.notes import Code, Note
from calibench.core.options import suggest
from calibench.core.words import as_columns
from calibench.discrepancy.checks.validate import entered
from calibench.discrepancy.model.machine import Numbers, Quantities
from calibench.discrepancy.model.measured import Column, DataError, MeasuredData, refuse_rows
from calibench.problems import constants
from calibench.problems.base import Array
from calibench.problems.orthoglide.kinematics import AXES, PAPER, geometry, inverse_kinematics
from calibench.problems.orthoglide.plans import Reading, SetName, check_deviations, check_plan, measured

PAIRS = tuple((i, j) for i in range(3) for j in range(3) if i != j)
_FIXED = ("tilt", "offset", "skew")  # the same at every moment, but for what is said to be more at one
IMPERFECTIONS = (
    *(f"{kind}_{AXES[i]}{AXES[j]}{when}" for kind in _FIXED for i, j in PAIRS for when in ("", "_now", "_zero")),
    *(f"{kind}_{axis}{when}" for kind in ("joint", "length") for axis in AXES for when in ("", "_zero")),
    "gauge_roll", "gauge_pitch", "gauge_shift",
)  # fmt: skip


def deviations(rows: Rows, q: Quantities) -> Numbers:
    """Return the deviations the gauges must show, shape (n,), mm; analytic in all quantities."""
    along, roll = np.eye(3)[rows.leg], np.asarray(q["gauge_roll"])[..., None]
    read, other = np.eye(3)[rows.direction], np.eye(3)[3 - rows.leg - rows.direction]
    reads = np.cos(roll) * read + np.sin(roll) * other
    zero = _leg(rows, q, np.zeros(len(rows.level)), "_zero", rows.against == 0)
    # where a gauge's plane cuts the leg's axis, eq. (10) for a gauge at any share
    plane = rows.share * _dot(zero[1], along) + (1 - rows.share) * _dot(zero[0], along) + q["gauge_shift"]

    # where each leg crosses the plane, at mu of section 3.2, along what is read, and how much it rises for a step on
    now, then = _leg(rows, q, rows.level, "", True), _leg(rows, q, rows.against, "_zero", True)
    rises, climbs = [], []
    for centre, end in (zero, now, then):
        span = _dot(end - centre, along)
        crossing = centre + ((plane - _dot(centre, along)) / span)[:, None] * (end - centre)
        rises.append(_dot(crossing, reads))
        climbs.append(_dot(end - centre, reads) / span)
    # a pitched gauge slides along a sloping leg
    after, before = ((rises[k] - rises[0]) / (1 - climbs[k] * q["gauge_pitch"]) for k in (1, 2))
    return np.asarray(after - np.where(rows.against == 0, 0.0, before))


def _leg(rows: Rows, q: Quantities, level: Array, when: str, moment: Array | bool) -> tuple[Numbers, Numbers]:
    """Return the joint centre of the measured leg and the tool end of its bar, (n, 3), with the tool at `level`.

    Errors of the moment `when` count where `moment`.
    """
    commanded, n = rows.joints(level), len(level)
    lengths, centres = [], []
    for i, axis in enumerate(AXES):
        joint = commanded[:, i] + q[f"drho_{axis}"] + np.where(moment, q[f"joint_{axis}{when}"], 0.0)
        lengths.append(geometry().length + q[f"dL_{axis}"] + np.where(moment, q[f"length_{axis}{when}"], 0.0))
        leaning = _components(i, "tilt", q, n, 1.0, when, moment)
        leaning = leaning / np.sqrt(_dot(leaning, leaning))[:, None]
        centres.append(_components(i, "offset", q, n, 0.0, when, moment) + joint[:, None] * leaning)
    # where three spheres meet on the side of the origin, shape (n, 3): eqs. (2) solved without rotation
    one, two = centres[1] - centres[0], centres[2] - centres[0]
    b1 = (_dot(one, one) + lengths[0] ** 2 - lengths[1] ** 2) / 2
    b2 = (_dot(two, two) + lengths[0] ** 2 - lengths[2] ** 2) / 2
    g11, g12, g22 = _dot(one, one), _dot(one, two), _dot(two, two)
    square = g11 * g22 - g12**2  # of twice the triangle's area
    foot = ((b1 * g22 - b2 * g12) / square)[:, None] * one + ((b2 * g11 - b1 * g12) / square)[:, None] * two
    height = np.sqrt((lengths[0] ** 2 - _dot(foot, foot)) / square)
    tool = centres[0] + foot - height[:, None] * np.cross(one, two)
    skew = np.stack([_components(i, "skew", q, n, 0.0, when, moment) for i in range(3)], axis=1)
    measured_leg = np.arange(n), rows.leg
    return np.stack(centres, axis=1)[measured_leg], tool + skew[measured_leg]


def _components(i: int, kind: str, q: Quantities, n: int, own: float, when: str, moment: Array | bool) -> Numbers:
    """Return the vector, (n, 3), of `own` along axis i and the quantities kind_ij along the others, at a moment."""
    parts: list[Any] = []
    for j in range(3):
        name = f"{kind}_{AXES[i]}{AXES[j]}"
        value, more = (own, 0) if j == i else (q[name], q[f"{name}{when or '_now'}"])
        nothing = np.ndim(more) == 0 and more == 0
        parts.append(value if nothing else value + np.where(moment, more, 0.0))
    vector = np.empty((n, 3), dtype=np.result_type(*parts))
    for j, part in enumerate(parts):
        vector[:, j] = part
    return vector


def _dot(a: Numbers, b: Numbers) -> Numbers:
    return np.asarray((a * b).sum(axis=-1))


Index = NDArray[np.intp]
_WORDS = ("leg", "direction", "posture", "pass", "zero_pass")
_DEFAULTS = {"gauge_position": 0.5, "against_mm": 0.0, "payload_N": 0.0, "repeat": 0.0}
ACCEPTED = "checked"  # the column that says that data come from `accepted`, perhaps in part, or with other deviations
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


def accepted(data: MeasuredData) -> MeasuredData:
    """Return `data` with every column there, in one spelling, rows without a deviation left out and told in a note."""
    if data.machine not in ("", "orthoglide"):
        raise DataError(f"{data.name}: these are data of machine {data.machine!r}, not of an orthoglide")
    missing = [name for name in ("leg", "direction", "posture", "deviation") if name not in data]
    if missing:
        there = f"there are {', '.join(data.in_file)}: {as_columns({missing[0]: 'NAME'})} tells another name"
        raise DataError(f"{data.name}: no column {', '.join(missing)}; {there}")
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
        _refuse(data, name, columns[name], np.isin(columns[name], ("fwd", "rev")), "fwd or rev is needed")
    for name, value in _DEFAULTS.items():
        columns[name] = _numbers(data, name) if name in data else np.full(len(data), value)
    for name in _OPTIONAL:
        if name in data:
            columns[name] = _numbers(data, name)
    for name, column in columns.items():
        if name not in _WORDS:
            _refuse(data, name, column, np.isfinite(column), "a finite number is needed, or leave the row out")
    columns["deviation"] = _numbers(data, "deviation")
    data = data.with_columns(columns)

    # readings that cannot be told apart are numbered by repeat
    setup = ("leg", "direction", "posture", "level_mm", "gauge_position", "against_mm", "pass")
    seen: dict[tuple[Any, ...], int] = {}
    again = np.zeros(len(data))
    for k, row in enumerate(zip(*(data[name].tolist() for name in (*setup, "payload_N", "repeat")))):
        again[k] = seen[row] = seen.get(row, -1) + 1
    if again.any():
        repeat = data["repeat"] + again * (1 + np.ptp(data["repeat"]))
        count = int((again > 0).sum())
        text = f"{count} rows were there before: they were taken as repeats with a Zero reading of their own"
        data = data.with_columns({"repeat": repeat}).with_note(Code.ROWS_SAID_TWICE, text, rows=data.labels(again > 0))

    alike = []  # a number for each row, the same for rows that agree in all columns
    for agreeing in ((*setup, "zero_pass", "payload_N"), ("leg", "direction", "gauge_position", "payload_N")):
        parts = [np.unique(data[name], return_inverse=True)[1].reshape(-1) for name in agreeing]
        alike.append(np.unique(np.column_stack(parts), axis=0, return_inverse=True)[1].reshape(-1).astype(float))
    data = data.with_columns({"pose_id": alike[0], "visit_id": alike[0], "shared_id": alike[1]})

    # raise `DataError` for a row no Orthoglide can give, or numbers that are not millimetres
    keys = ("leg", "direction", "posture", "level_mm", "gauge_position", "against_mm")
    distinct = list(dict.fromkeys(zip(*(data[key].tolist() for key in keys))))
    try:
        check_plan([Reading(*key) for key in distinct])
        check_deviations(data["deviation"], "deviation")
    except ValueError as error:
        raise DataError(f"{data.name}: {error}") from None
    return replace(data.with_columns({ACCEPTED: np.ones(len(data))}), machine="orthoglide")


def rows_of(data: MeasuredData) -> Rows:
    """Return the rows of accepted data as arrays; asked again, the same."""
    if data not in ROWS:
        index = {name: np.searchsorted(AXES, data[name]) for name in ("leg", "direction", "posture")}
        sense = {name: np.where(np.asarray(data[name]) == "fwd", 1.0, -1.0) for name in ("pass", "zero_pass")}
        ROWS[data] = Rows(
            leg=index["leg"], direction=index["direction"], axis=index["posture"], level=data["level_mm"],
            against=data["against_mm"], share=data["gauge_position"], arrival=sense["pass"],
            zero_arrival=sense["zero_pass"], payload=data["payload_N"], repeat=data["repeat"],
        )  # fmt: skip
    return ROWS[data]


ROWS: WeakKeyDictionary[MeasuredData, Rows] = WeakKeyDictionary()


def _levels(data: MeasuredData, leg: Column, posture: Column) -> tuple[Column, Array]:
    """Return the axis the tool is moved along, and how far [mm]: x and the stroke for xmax."""
    strokes = {"max": geometry().stroke_plus, "min": geometry().stroke_minus}
    given = _numbers(data, "level_mm") if "level_mm" in data else np.full(len(data), np.nan)
    axes, levels = [], given.copy()

    def refused(k: int, why: str) -> DataError:
        return DataError(f"{data.name}: {data.rows_named(np.array([k]))}: posture={why}")

    for k, (own, word) in enumerate(zip(leg, posture)):
        axis, end = (word[0], word[1:]) if word[:1] in AXES else (own, word)
        if end not in ("", *strokes):
            choices = [*AXES, *strokes, *(a + e for a in AXES for e in strokes)]
            raise refused(k, f"{word!r}: {suggest(word, choices)}")
        if not np.isfinite(given[k]):
            if not end:
                raise refused(k, f"{word} needs a level_mm, or xmax, xmin and so on")
            levels[k] = strokes[end]
        elif end and given[k] * strokes[end] <= 0:
            raise refused(k, f"{word} and level_mm={given[k]:g} differ in sign")
        axes.append(axis)
    return np.array(axes), levels


def _words(data: MeasuredData, name: str) -> Column:
    words = [w.decode() if isinstance(w, bytes) else str(w) for w in data[name]]
    column = np.array([w.strip().lower() for w in words])
    if name in ("leg", "direction"):
        _refuse(data, name, column, np.isin(column, AXES), "x, y or z is needed")
    return column


def _refuse(data: MeasuredData, name: str, column: Column, good: NDArray[np.bool_], rule: str) -> None:
    refuse_rows(data, good, lambda k: f"{name}={column[k]}: {rule}")


def _numbers(data: MeasuredData, name: str) -> Array:
    try:
        return np.asarray(data[name], dtype=float)
    except (TypeError, ValueError):
        raise DataError(f"{data.name}: column {name!r} holds something that is not a number") from None


def printed(name: str) -> MeasuredData:
    """Return a printed set: `sigma` is section 4.1's dissimilarity of three readings as the noise of their mean.

    The dissimilarity is an upper limit of .02 mm; the spread of three readings is 1.69 sigma on average, so sigma of
    one reading is at most about .012 mm: section 3.4's .01 mm is taken.
    """
    choice = next((choice for choice in get_args(SetName) if choice == name), None)
    if choice is None:
        raise DataError(f"data={name}: {suggest(name, get_args(SetName))}")
    plan, deviations = measured(choice)
    ends = np.array([r.level_mm > 0 for r in plan])
    compared = np.array([r.against_mm != 0 for r in plan])  # Table 1: Max minus Min
    set_up = ("leg", "direction", "posture", "gauge_position", "level_mm", "against_mm")
    columns = {
        **{key: np.array([getattr(r, key if key != "posture" else "axis") for r in plan]) for key in set_up},
        "pass": np.where(ends, "fwd", "rev"),
        "zero_pass": np.where(compared, "rev", "fwd"),
        "payload_N": np.zeros(len(plan)),
        "repeat": np.zeros(len(plan)),
        "t_s": np.where(ends, 1.0, 2.0),
        "zero_t_s": np.where(compared, 2.0, 0.0),
        "split": np.full(len(plan), "train"),
        "deviation": deviations,
    }
    text = (
        "the chapter prints no times: the path Zero, Max, Min, Zero of section 4.1 stands for them, a step of t_s "
        "a move, so Max and Zero were reached moving towards +, Min towards -"
    )
    sigma = constants.column(PAPER, "text.section34")["sigma"]
    metadata = {"sigma": sigma, "free": "rho", "machine": "orthoglide"}
    return MeasuredData(columns, "orthoglide", metadata, name, (Note(Code.TIME_UNKNOWN, text, ("t_s",)),))
