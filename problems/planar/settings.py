"""The settings of the paper's sections: true machine, nominal machine, start and box; and those of a user's machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibench.core.options import suggest
from calibench.problems import constants
from calibench.problems.base import Array
from calibench.problems.planar.gpm2002 import NAMES, PAPER, home, inverse_kinematics, makers_machine


@dataclass(frozen=True)
class Setting:
    """The machine of one of the papers' sections: 15 numbers each. `actual` is None for a user's own machine."""

    actual: Array | None
    nominal: Array
    start: Array
    lower: Array
    upper: Array


def section3(table: str) -> Setting:
    """Return section 3's setting: `table`'s actual machine, the start it prints from (210, 245), boxes of PAPERS."""
    actual = makers_machine()
    column = constants.column(PAPER, f"{table}.actual")
    for name in NAMES:
        if name in column:
            actual[NAMES.index(name)] = column[name]
    start = makers_machine()
    start[12:15] = _start_offsets(actual)
    lower, upper = start - 10.0, start + 10.0  # bases
    lower[6:12], upper[6:12] = makers_machine()[6:12] - 5.0, makers_machine()[6:12] + 5.0
    lower[12:15], upper[12:15] = 1.0 - 0.2, 1.0 + 0.2
    return Setting(actual, makers_machine(), start, lower, upper)


def section4() -> Setting:
    """Return section 4's setting, Table 5: actual machine, nominal start, box."""
    machines = {}
    for role in ("actual", "nominal", "lower", "upper"):
        machine, column = makers_machine(), constants.column(PAPER, f"table5.{role}")
        for name in column:
            machine[NAMES.index(name)] = column[name]
        machines[role] = machine
    return Setting(machines["actual"], machines["nominal"], machines["nominal"], machines["lower"], machines["upper"])


def own_machine(
    nominal: Mapping[str, float], box: Mapping[str, tuple[float, float]], at_home: Sequence[float] | None
) -> Setting:
    """Return the setting of a user's machine: Table 5's widths about their nominal values."""
    table5 = section4()
    start = makers_machine()
    for name, value in nominal.items():
        if name not in NAMES:
            raise ValueError(f"nominal: unknown parameter {name!r}; {suggest(name, NAMES)}")
        if not np.isfinite(value) or (name[0] == "l" and value <= 0):
            raise ValueError(
                f"nominal {name}={value}: a {'length above 0' if name[0] == 'l' else 'finite number'} is needed"
            )
        start[NAMES.index(name)] = value
    if at_home is not None:
        if len(at_home) != 3:
            raise ValueError(f"at_home={list(at_home)}: three readings [rad] are needed")
        joints = inverse_kinematics(start, home()[None])[0]
        if not np.isfinite(joints).all():
            leg = int(np.argmin(np.isfinite(joints))) + 1
            raise ValueError(
                f"at_home: leg {leg} cannot reach the home position with nominal la{leg}, lb{leg}, base {leg}"
            )
        start[12:15] = joints - np.asarray(at_home)
    half = np.maximum((table5.upper - table5.lower) / 2, [5.0] * 12 + [0.0] * 3)
    lower, upper = start - half, start + half
    for name, bounds in box.items():
        if name not in NAMES:
            raise ValueError(f"box: unknown parameter {name!r}; {suggest(name, NAMES)}")
        i = NAMES.index(name)
        try:
            lower[i], upper[i] = (float(bound) for bound in bounds)
        except (TypeError, ValueError):
            raise ValueError(f"box {name}={bounds}: a pair of numbers (lower, upper) is needed") from None
        if not lower[i] <= start[i] <= upper[i]:
            raise ValueError(f"start {name}={start[i]:g} lies outside its box {lower[i]:g} .. {upper[i]:g}")
    return Setting(None, start, start, lower, upper)


def _start_offsets(actual: Array) -> Array:
    """Return the initial offsets of Tables 2-4: the hand stops at (210, 245), taken for the home position."""
    geometry = constants.column(PAPER, "geometry")
    estimate = np.array([[geometry["estimate_x"], geometry["estimate_y"]]])
    assumed = inverse_kinematics(makers_machine(), home()[None])[0]
    return np.asarray(actual[12:15] + assumed - inverse_kinematics(actual, estimate)[0])
