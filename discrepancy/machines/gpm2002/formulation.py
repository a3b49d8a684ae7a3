"""The GPM2002 as a measured machine (Cong et al. 2008): three legs that must meet in one point.

Angles only: the end-effector is eliminated and one constraint a reading is left, the power of the radical centre of
the three distal circles, eqs. (32)-(33); a planar similarity is invisible, so 11 of 15 numbers are free. With an
external tracker's x, y each leg closes on its own: three constraints a reading, all 15 numbers free.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import final

import numpy as np

from calibench.core.counted import plain
from calibench.discrepancy.machines.gpm2002.roles import roles_of
from calibench.discrepancy.machines.gpm2002.start import closing_offsets
from calibench.discrepancy.machines.gpm2002.validate import (
    ENCODERS,
    OWN,
    SHARED,
    rows_for_start,
    stated_numbers,
    validated,
)
from calibench.discrepancy.model.machine import WORKSPACE, Formulation, Numbers, Quantities
from calibench.discrepancy.model.measured.data import MeasuredData, MisfitError
from calibench.discrepancy.model.measured.sensor import Sensor
from calibench.discrepancy.model.roles import Roles
from calibench.discrepancy.registries import machines
from calibench.problems.base import Array, Parameter
from calibench.problems.planar.gpm2002 import NAMES, UNITS, makers_machine

LEGS = (1, 2, 3)
_GAUGE = ("xa1", "ya1", "xa2", "ya2")  # held where nothing but angles is read
_OFFSETS = ("z1", "z2", "z3")
_FAR = 40.0  # mm: nominal legs that miss each other by more at the best offsets are not those of the data


@final
@dataclass(frozen=True)
class Gpm2002:
    """The planar 2-dof manipulator with three driven legs."""

    name: str = field(default="gpm2002", init=False)

    def formulate(self, data: MeasuredData) -> Formulation:
        """Return the closure of the three legs, with the tracker's x, y where those columns are there.

        Raises `DataError` for data that cannot be of this machine; what only costs something is among the notes of
        `formulation.data`. The offsets start where the nominal legs meet (see `gpm2002_start`).
        """
        data = validated(data)
        stated, held = stated_numbers(data)
        tracked = data.has("x", "y")
        nominal = dict(zip(NAMES, makers_machine().tolist())) | stated
        held = held if tracked else (*held, *_gauge(nominal, held))
        closure = LegClosure(data, (), {name: nominal[name] for name in held}, tracked)
        offsets = tuple(name for name in _OFFSETS if name not in held)
        sample = closure.on(data.rows(rows_for_start(data, 60)))
        found, miss = closing_offsets(sample, nominal, offsets, all(name in stated for name in offsets))
        if not miss < _FAR:
            raise MisfitError(
                f"{data.name}: the legs of the nominal machine miss each other by {plain(miss, 3)} mm at the best "
                "offsets: "
                "are the angles in radians, lengths in mm, and is metadata nominal that of this machine?"
            )
        start = nominal | found
        parameters = tuple(
            Parameter(name, unit, start[name], start[name] - width, start[name] + width)
            for name, unit in zip(NAMES, UNITS)
            if name not in held
            for width in (10.0 if unit == "mm" else 0.4,)
        )
        return replace(closure, parameters=parameters)


def _gauge(nominal: Mapping[str, float], held: Sequence[str]) -> tuple[str, ...]:
    """Return what must be held besides `held`, where only angles are read, so that every move can be observed.

    Angles do not determine where the machine is, how it is turned, nor how large it is.
    """
    moves = np.zeros((len(NAMES), 4))
    for k, name in enumerate(NAMES):
        if name[:2] in ("xa", "ya"):
            other = nominal[("y" if name[0] == "x" else "x") + name[1:]]
            moves[k] = (name[0] == "x", name[0] == "y", -other if name[0] == "x" else other, nominal[name])
        else:
            moves[k] = (0, 0, 1, 0) if name[0] == "z" else (0, 0, 0, nominal[name])
    moves /= np.linalg.norm(moves, axis=0)
    chosen = list(held)

    def rank() -> int:
        rows = moves[[NAMES.index(name) for name in chosen]]
        return int(np.linalg.matrix_rank(rows, tol=1e-6)) if chosen else 0

    for name in (*_GAUGE, *NAMES):
        before = rank()
        chosen.append(name)
        if rank() == before:
            chosen.pop()
    return tuple(chosen[len(held) :])


@final
@dataclass(frozen=True, eq=False)
class LegClosure:
    """The closure of the legs over one set of data: angles only (n, 1), or with a tracker (n, 3), mm."""

    data: MeasuredData
    parameters: tuple[Parameter, ...]
    fixed: dict[str, float]
    tracked: bool
    unit: str = "mm"

    @property
    def readings(self) -> tuple[str, ...]:
        """Return the columns that carry noise."""
        return tuple(sensor.column for sensor in self.sensors)

    @cached_property
    def sensors(self) -> tuple[Sensor, ...]:
        """Return an encoder at each driven joint, and with a tracker its two coordinates."""
        resolution = float(self.data.metadata.get("encoder_lsb") or 0.0)
        encoders = tuple(
            Sensor(f"enc_{i}", "encoder", "rad", f"joint {i}", (f"leg {i}",), f"angle of joint {i}", resolution, True)
            for i in LEGS
        )
        return (*encoders, Sensor("x", "tracker", "mm"), Sensor("y", "tracker", "mm")) if self.tracked else encoders

    @cached_property
    def roles(self) -> Roles:
        """Return what the machine is made of."""
        return roles_of(self.data.metadata, self.tracked)

    @property
    def sigma(self) -> dict[str, float]:
        """Return the stated noise of the encoders [rad] and of the tracker [mm]."""
        stated = dict.fromkeys(ENCODERS, float(self.data.metadata["sigma_enc"]))
        return stated | (dict.fromkeys("xy", float(self.data.metadata["sigma_xy"])) if self.tracked else {})

    def constraints(self, q: Quantities) -> Numbers:
        """Return the power of P over 2 * 244 mm: of the radical centre, (n, 1), or of the tracked point, (n, 3)."""
        bx, by = _elbows(q)
        px, py = (q["x"], q["y"]) if self.tracked else _radical_centre(bx, by, q)
        legs = LEGS if self.tracked else LEGS[:1]  # at the radical centre all three powers are equal
        powers = [(px - bx[i - 1]) ** 2 + (py - by[i - 1]) ** 2 - q[f"lb{i}"] ** 2 for i in legs]
        return np.stack(powers, axis=-1) / _SCALE

    def slopes(self, q: Quantities) -> dict[str, Array]:
        """Return the derivative of the constraints in each quantity, name -> (n, c)."""
        bx, by = _elbows(q)
        px, py = (q["x"], q["y"]) if self.tracked else _radical_centre(bx, by, q)
        weights = np.ones((3, len(self.data))) if self.tracked else _barycentric(px, py, bx, by)
        slopes: dict[str, Array] = {}
        for i in LEGS:
            x, y, w = bx[i - 1] - px, by[i - 1] - py, 2 * weights[i - 1] / _SCALE
            theta = q[f"enc_{i}"] + q[f"z{i}"]
            cos, sin = np.cos(theta), np.sin(theta)
            leg = {
                f"xa{i}": w * x,
                f"ya{i}": w * y,
                f"la{i}": w * (x * cos + y * sin),
                f"lb{i}": -w * q[f"lb{i}"],
                f"z{i}": w * q[f"la{i}"] * (y * cos - x * sin),
            }
            leg[f"enc_{i}"] = leg[f"z{i}"]
            slopes |= {name: self._placed(value, i) for name, value in leg.items()}
        if self.tracked:
            slopes["x"] = 2 * np.stack([px - x for x in bx], axis=-1) / _SCALE
            slopes["y"] = 2 * np.stack([py - y for y in by], axis=-1) / _SCALE
        return slopes

    def decorrelate(self, rows: Array) -> Array:
        """Return `rows` as they are: each reading has noise of its own."""
        return rows

    def position(self, q: Quantities) -> tuple[Numbers, Numbers]:
        """Return the end-effector, each (n,), mm: as tracked, or the radical centre."""
        return (q["x"], q["y"]) if self.tracked else _radical_centre(*_elbows(q), q)

    def covariates(self, q: Quantities) -> dict[str, dict[str, Array]]:
        """Return target -> covariate -> (n,): a leg's own angle, the others' angles, its further columns, the place.

        Columns that are missing or constant are left out.
        """
        of_leg = {f"leg {i}": (*ENCODERS, *SHARED, *(f"{kind}_{i}" for kind in OWN)) for i in LEGS}
        met = {leg: {name: self.data[name] for name in names if self._varies(name)} for leg, names in of_leg.items()}
        x, y = self.position(q)
        return {**met, WORKSPACE: {"x": np.real(x), "y": np.real(y)}}

    def on(self, data: MeasuredData) -> LegClosure:
        """Return the same closure over other rows."""
        return replace(self, data=data)

    def _varies(self, column: str) -> bool:
        return column in self.data and bool(np.ptp(self.data[column]) > 0)

    def _placed(self, value: Array, leg: int) -> Array:
        """Return a leg's slope among the constraints: in the leg's own, or in the only one."""
        if not self.tracked:
            return value[:, None]
        column = np.zeros((len(value), 3))
        column[:, leg - 1] = value
        return column


_SCALE = 488.0  # turns a power in mm^2 into about the miss of the point in mm: twice the nominal distal link


def _elbows(q: Quantities) -> tuple[list[Numbers], list[Numbers]]:
    """Return x and y of the elbows B_i, each (n,), mm."""
    theta = [q[f"enc_{i}"] + q[f"z{i}"] for i in LEGS]
    x = [q[f"xa{i}"] + q[f"la{i}"] * np.cos(theta[i - 1]) for i in LEGS]
    y = [q[f"ya{i}"] + q[f"la{i}"] * np.sin(theta[i - 1]) for i in LEGS]
    return x, y


def _radical_centre(bx: list[Numbers], by: list[Numbers], q: Quantities) -> tuple[Numbers, Numbers]:
    """Return the radical centre of the distal circles, eqs. (32)-(33), in coordinates centred at B_1."""
    x2, y2, x3, y3 = bx[1] - bx[0], by[1] - by[0], bx[2] - bx[0], by[2] - by[0]
    d2 = (x2**2 + y2**2 - q["lb2"] ** 2 + q["lb1"] ** 2) / 2  # eq. (32), the squares lost in print restored
    d3 = (x3**2 + y3**2 - q["lb3"] ** 2 + q["lb1"] ** 2) / 2
    twice_area = x2 * y3 - x3 * y2
    return bx[0] + (d2 * y3 - d3 * y2) / twice_area, by[0] + (d3 * x2 - d2 * x3) / twice_area


def _barycentric(px: Numbers, py: Numbers, bx: list[Numbers], by: list[Numbers]) -> Array:
    """Return the weights of P in the triangle of the elbows, shape (3, n): sum w = 1, sum w_i (P - B_i) = 0."""
    x, y = [b - px for b in bx], [b - py for b in by]
    areas = np.stack([x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]])
    return np.asarray(areas / areas.sum(axis=0))


machines.register("gpm2002")(Gpm2002)
