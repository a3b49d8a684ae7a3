"""Tables of Denavit and Hartenberg's rows, Craig's modified rows, and Hayati's where axes are parallel, and their arms.

All lengths are mm, all angles rad; what a row leaves out is 0.

    standard   Rz(theta) Tz(d) Tx(a) Rx(alpha)             the joint turns about z before the row
    modified   Rx(alpha) Tx(a) Rz(theta) Tz(d)             the joint turns about z behind alpha and a
    Hayati     either with Ry(beta) at its end (standard) or behind Rx(alpha) (modified), and d = 0 where the next axis
               is parallel

`kind` is "rotary" (theta turns), "sliding" (d slides) or "fixed" (nothing moves: a flange, a pedestal); `name`, `lower`
and `upper` are the joint's own. In the standard table a row's constant part belongs to the next joint's origin, and the
last row's to the tail. (Denavit and Hartenberg 1955; Craig 1986; Hayati and Mirmirani 1985.)

`DhTable` holds the rows as values and makes their chain; `DhArm` is the arm whose errors are those of the table's own
numbers:

    base:   mount Trans(base_x, base_y, base_z) Rz(base_rz) Ry(base_ry) Rx(base_rx)
    row J:  its numbers in the table plus theta_J, d_J, a_J, alpha_J, and beta_J where the next axis is parallel
    joint:  motion(gain_J q_J), about z, or along it
    tool:   tail tool Trans(tool_x, tool_y, tool_z) Rz(tool_rz) Ry(tool_ry) Rx(tool_rx)

All are errors: 0 for the arm of the table, and 1 for a gain. theta of a row that turns, and d of one that slides, is
the joint's zero. Rows without a joint have no errors of their own: those of their neighbours say the same. Two parallel
axes have their common normal anywhere, so beta is offered there and nowhere else (Hayati and Mirmirani 1985).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal, final

import numpy as np

from calibench.calibration.kinematics import PLACEMENT, Chain, ChainJoint, forward, frames, jacobian, nominal
from calibench.calibration.rigid import Array, cross, rpy, slide, turn

Form = Literal["standard", "modified"]
RowKind = Literal["rotary", "sliding", "fixed"]
FORMS: tuple[Form, ...] = ("standard", "modified")
_X, _Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
NUMBERS = ("theta", "d", "a", "alpha", "beta")
BASE, TIP = "base", "flange"


@final
@dataclass(frozen=True)
class DhRow:
    """One row: its joint's name, its numbers [mm, rad] and the joint's limits (infinite where there is no stop)."""

    name: str
    kind: RowKind = "rotary"
    theta: float = 0.0
    d: float = 0.0
    a: float = 0.0
    alpha: float = 0.0
    beta: float = 0.0
    lower: float = -np.inf
    upper: float = np.inf


@final
@dataclass(frozen=True, eq=False)
class DhTable:
    """Rows from base to flange, in the `form` "standard" or "modified" (Craig's).

    `length` and `angle` are the units in which its file has its numbers; `notes` say what was found and not stated.
    """

    rows: tuple[DhRow, ...]
    form: Form = "standard"
    name: str = "arm"
    length: str = "mm"
    angle: str = "rad"
    notes: tuple[str, ...] = ()

    @cached_property
    def chain(self) -> Chain:
        """Return the chain from `base` to `flange`. Raises `ChainError` where no row moves, or two have one name."""
        theta, d, a, alpha, beta = np.array([[getattr(row, one) for one in NUMBERS] for row in self.rows]).T
        none, along_x, along_z = (
            np.zeros(len(self.rows)),
            slide(_X, a),
            slide(_Z, d),
        )  # of all rows
        turned, twisted, leant = rpy(none, none, theta) @ along_z, rpy(alpha, none, none), rpy(none, beta, none)
        if self.form == "modified":
            before, behind = twisted @ leant @ along_x, np.broadcast_to(np.eye(4), turned.shape)
        else:
            before, behind = None, along_x @ twisted @ leant  # the first two commute, as do those about and along z
        joints, held = [], np.eye(4)
        for k, row in enumerate(self.rows):
            origin = (held if before is None else held @ before[k]) @ turned[k]
            if row.kind == "fixed":
                held = origin @ behind[k]
                continue
            held = behind[k]
            joints.append(
                ChainJoint(name=row.name, kind=row.kind, origin=origin, axis=_Z, lower=row.lower, upper=row.upper)
            )
        return Chain(tuple(joints), np.asarray(held), self.name, BASE, TIP, source="table")

    @property
    def moving(self) -> tuple[DhRow, ...]:
        """Return the rows whose joints move."""
        return tuple(row for row in self.rows if row.kind != "fixed")


_PARALLEL = 0.05  # sine of the angle of two axes, below which their common normal is anywhere
_AXIS = {"theta": 2, "d": 2, "a": 0, "alpha": 0, "beta": 1}  # which of x, y, z a number turns about, or shifts along
_SHIFTS = ("d", "a")
_STEPS = {  # of a row, before its joint moves and behind it
    "standard": (("theta", "d"), ("a", "alpha", "beta")),
    "modified": (("alpha", "beta", "a", "theta", "d"), ()),
}


@final
@dataclass(frozen=True, eq=False)
class DhArm:
    """A table, and where base and target are taken to be before any fit: `mount` and `tool`, (4, 4) [mm]."""

    table: DhTable
    mount: Array
    tool: Array

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Return the names of all parameters, in the order of the vector: base, each joint's row, tool."""
        names = [f"base_{one}" for one in PLACEMENT]
        for row in self.table.rows:
            if row.kind != "fixed":
                numbers = [one for one in NUMBERS if one != "beta" or row.name in self._leaning]
                names += [f"{one}_{row.name}" for one in (*numbers, "gain")]
        return (*names, *(f"tool_{one}" for one in PLACEMENT))

    @property
    def nominal(self) -> Array:
        """Return the parameters of the arm of the table: 0, and 1 for a gain."""
        return np.array([1.0 if name.startswith("gain_") else 0.0 for name in self.names])

    def corrected(self, p: Array) -> DhTable:
        """Return the table with the errors of `p`, in the order of `names`, added to its numbers."""
        by = dict(zip(self.names, p.tolist(), strict=True))
        rows = []
        for row in self.table.rows:
            more = {one: getattr(row, one) + by.get(f"{one}_{row.name}", 0.0) for one in NUMBERS}
            rows.append(row if row.kind == "fixed" else replace(row, **more))
        return replace(self.table, rows=tuple(rows))

    def forward(self, p: Array, q: Array) -> Array:
        """Return where the target is and how it is turned, (n, 4, 4) [mm], at the readings q, (n, joints)."""
        chain, values = self._chain(p)
        return forward(chain, values, q)

    def jacobian(self, p: Array, q: Array) -> Array:
        """Return the derivative of the target's pose in all parameters, (n, 6, P), as `kinematics.jacobian` has it."""
        chain, values = self._chain(p)
        plain, every = jacobian(chain, values, q), frames(chain, values, q)
        target, place = every[-1][:, :3, 3], {name: k for k, name in enumerate(self.names)}
        slopes = np.zeros((len(q), 6, len(self.names)))
        slopes[:, :, :6], slopes[:, :, -6:] = plain[:, :, :6], plain[:, :, -6:]
        for k, joint in enumerate(chain.joints):
            slopes[:, :, place[f"gain_{joint.name}"]] = plain[:, :, 13 + 8 * k]
        for moved, steps in enumerate(_segments(self.corrected(p))):
            at = every[moved]
            for number, name, step in steps:
                if f"{number}_{name}" in place:
                    along = at[:, :3, _AXIS[number]]
                    ways = (along, 0.0 * along) if number in _SHIFTS else (cross(along, target - at[:, :3, 3]), along)
                    slopes[:, :, place[f"{number}_{name}"]] = np.concatenate(ways, axis=1)
                at = at @ step
        return slopes

    def _chain(self, p: Array) -> tuple[Chain, Array]:
        """Return the chain of the corrected table, and the vector of what remains: base, tool, gains."""
        chain = self.corrected(p).chain.placed(self.mount, self.tool)
        values = nominal(chain)
        values[:6], values[-6:] = p[:6], p[-6:]
        values[13:-6:8] = [value for name, value in zip(self.names, p, strict=True) if name.startswith("gain_")]
        return chain, values

    @cached_property
    def _leaning(self) -> frozenset[str]:
        """Return the joints whose row has a beta: one that stands between two parallel axes."""
        rows, leaning = self.table.rows, set()
        moving = [k for k, row in enumerate(rows) if row.kind != "fixed"]
        for k, (one, other) in enumerate(pairwise(moving), start=1):
            cosine = self.table.chain.joints[k].origin[2, 2]  # both axes are z
            if other == one + 1 and 1 - cosine**2 < _PARALLEL**2:
                leaning.add(rows[one if self.table.form == "standard" else other].name)
        return frozenset(leaning)


def _segments(table: DhTable) -> list[list[tuple[str, str, Array]]]:
    """Return the steps (number, row, (4, 4)) before each joint, and those behind the last."""
    steps = {one: _steps(one, np.array([getattr(row, one) for row in table.rows])) for one in NUMBERS}
    before, behind = _STEPS[table.form]
    segments: list[list[tuple[str, str, Array]]] = [[]]
    for k, row in enumerate(table.rows):
        segments[-1] += [(one, row.name, steps[one][k]) for one in before]
        if row.kind != "fixed":
            segments.append([])
        segments[-1] += [(one, row.name, steps[one][k]) for one in behind]
    return segments


def _steps(number: str, values: Array) -> Array:
    """Return the turns about the axis of a number, or the shifts along it, of all rows, (rows, 4, 4)."""
    made: Array = (slide if number in _SHIFTS else turn)(np.eye(3)[_AXIS[number]], values)
    return made
