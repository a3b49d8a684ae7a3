"""`DhArm`: an arm whose errors are those of its table's own numbers, with its forward kinematics and Jacobian.

    base:   mount Trans(base_x, base_y, base_z) Rz(base_rz) Ry(base_ry) Rx(base_rx)
    row J:  its numbers in the table plus theta_J, d_J, a_J, alpha_J, and beta_J where the next axis is parallel
    joint:  motion(gain_J q_J), about z, or along it
    tool:   tail tool Trans(tool_x, tool_y, tool_z) Rz(tool_rz) Ry(tool_ry) Rx(tool_rx)

All are errors: 0 for the arm of the table, and 1 for a gain. [mm, rad]. theta of a row that turns, and d of one that
slides, is the joint's zero. Rows without a joint have no errors of their own: those of their neighbours say the same.
Two parallel axes have their common normal anywhere, so beta is offered there and nowhere else (Hayati and Mirmirani
1985).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import final

import numpy as np

from calibench.problems.arm.chains.chain import Chain
from calibench.problems.arm.chains.dh_table import NUMBERS, DhTable
from calibench.problems.arm.chains.kinematics import PLACEMENT, forward, frames, jacobian, nominal
from calibench.problems.arm.chains.rigid import cross, slide, turn
from calibench.problems.base import Array

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
                own = [one for one in NUMBERS if one != "beta" or row.name in self._leaning]
                names += [f"{one}_{row.name}" for one in (*own, "gain")]
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
        chain, own = self._chain(p)
        return forward(chain, own, q)

    def jacobian(self, p: Array, q: Array) -> Array:
        """Return the derivative of the target's pose in all parameters, (n, 6, P), as `kinematics.jacobian` has it."""
        chain, own = self._chain(p)
        plain, every = jacobian(chain, own, q), frames(chain, own, q)
        target, place = every[-1][:, :3, 3], {name: k for k, name in enumerate(self.names)}
        found = np.zeros((len(q), 6, len(self.names)))
        found[:, :, :6], found[:, :, -6:] = plain[:, :, :6], plain[:, :, -6:]
        for k, joint in enumerate(chain.joints):
            found[:, :, place[f"gain_{joint.name}"]] = plain[:, :, 13 + 8 * k]
        for moved, steps in enumerate(_segments(self.corrected(p))):
            at = every[moved]
            for number, name, step in steps:
                if f"{number}_{name}" in place:
                    along = at[:, :3, _AXIS[number]]
                    ways = (along, 0.0 * along) if number in _SHIFTS else (cross(along, target - at[:, :3, 3]), along)
                    found[:, :, place[f"{number}_{name}"]] = np.concatenate(ways, axis=1)
                at = at @ step
        return found

    def _chain(self, p: Array) -> tuple[Chain, Array]:
        """Return the chain of the corrected table, and the vector of what remains: base, tool, gains."""
        chain = self.corrected(p).chain.placed(self.mount, self.tool)
        own = nominal(chain)
        own[:6], own[-6:] = p[:6], p[-6:]
        own[13:-6:8] = [value for name, value in zip(self.names, p, strict=True) if name.startswith("gain_")]
        return chain, own

    @cached_property
    def _leaning(self) -> frozenset[str]:
        """Return the joints whose row has a beta: one that stands between two parallel axes."""
        rows, found = self.table.rows, set()
        moving = [k for k, row in enumerate(rows) if row.kind != "fixed"]
        for k, (one, other) in enumerate(pairwise(moving), start=1):
            cosine = self.table.chain.joints[k].origin[2, 2]  # both axes are z
            if other == one + 1 and 1 - cosine**2 < _PARALLEL**2:
                found.add(rows[one if self.table.form == "standard" else other].name)
        return frozenset(found)


def _segments(table: DhTable) -> list[list[tuple[str, str, Array]]]:
    """Return the steps (number, row, (4, 4)) before each joint, and those behind the last."""
    steps = {one: _steps(one, np.array([getattr(row, one) for row in table.rows])) for one in NUMBERS}
    before, behind = _STEPS[table.form]
    found: list[list[tuple[str, str, Array]]] = [[]]
    for k, row in enumerate(table.rows):
        found[-1] += [(one, row.name, steps[one][k]) for one in before]
        if row.kind != "fixed":
            found.append([])
        found[-1] += [(one, row.name, steps[one][k]) for one in behind]
    return found


def _steps(number: str, values: Array) -> Array:
    """Return the turns about the axis of a number, or the shifts along it, of all rows, (rows, 4, 4)."""
    made: Array = (slide if number in _SHIFTS else turn)(np.eye(3)[_AXIS[number]], values)
    return made
