"""The GPM2002 itself (Cong et al. 2008), its gauge, the settings of the paper's sections, plans, and drawn instances.

A machine is an array of shape (15,): xa1 ya1 xa2 ya2 xa3 ya3 la1 la2 la3 lb1 lb2 lb3 z1 z2 z3, mm and rad.
Angle readings cannot see the gauge: the whole machine turned by phi about A_1 and scaled by s, with phi added to the
three sensor offsets. With x_a2 (section 4) or y_a2 (section 3) held, s follows from phi: so "12 parameters" are 11 and
a free choice. The papers do not publish their sampling plans; `disc` and `box` are drawn from a seed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, assert_never, final, get_args

import numpy as np

from calibench.core.options import suggest
from calibench.problems import constants
from calibench.problems.base import Array, frozen
from calibench.problems.instances import Drawn, Stream

# Functions of angles [rad] with the same bits on every processor, as simulated readings decide the id of a run: those
# of the C library, number by number. NumPy's take other code where a processor has wider registers (AVX-512).
cos, sin = np.vectorize(math.cos, otypes=[float]), np.vectorize(math.sin, otypes=[float])
arctan2 = np.vectorize(math.atan2, otypes=[float])
arccos = np.vectorize(lambda x: math.acos(x) if -1 <= x <= 1 else math.nan, otypes=[float])  # NaN beyond -1 and 1

PAPER = "cong2008"
NAMES = ("xa1", "ya1", "xa2", "ya2", "xa3", "ya3", "la1", "la2", "la3", "lb1", "lb2", "lb3", "z1", "z2", "z3")
UNITS = ("mm",) * 12 + ("rad",) * 3


def makers_machine() -> Array:
    """Return the maker's machine, shape (15,): nominal bases and lengths, offsets zero."""
    geometry = constants.column(PAPER, "geometry")
    bases = [geometry[name] for name in NAMES[:6]]
    return np.array(bases + [geometry["link"]] * 6 + [0.0] * 3)


def home() -> Array:
    """Return the home position of the end-effector, shape (2,), mm."""
    geometry = constants.column(PAPER, "geometry")
    return np.array([geometry["home_x"], geometry["home_y"]])


def inverse_kinematics(machine: Array, positions: Array) -> Array:
    """Return the joint angles, shape (n, 3), rad, in the elbow branch + of all legs, for positions (n, 2), mm.

    That branch is the only one of eight that gives Table 2's initial offsets. Out of reach gives NaN.
    """
    angles = np.empty((len(positions), 3))
    for i in range(3):
        dx, dy = positions[:, 0] - machine[2 * i], positions[:, 1] - machine[2 * i + 1]
        la, lb, reach = machine[6 + i], machine[9 + i], np.hypot(dx, dy)
        cosine = (la**2 + reach**2 - lb**2) / (2 * la * reach)
        angles[:, i] = arctan2(dy, dx) + arccos(cosine)
    return angles


def to_cartesian(machine: Array) -> Array:
    """Return the machine with l_a cos z and l_a sin z in the places of l_a and z: the coordinates of J3, eq. (41)."""
    la, z = machine[6:9], machine[12:15]
    return np.concatenate([machine[:6], la * cos(z), machine[9:12], la * sin(z)])


def to_polar(machine: Array, turn: Array) -> Array:
    """Return the machine with l_a and z back in their places, eq. (44) with its square root and division restored.

    An angle is known but for whole turns: z is given in the turn of `turn`, shape (3,), rad.
    """
    lac, las = machine[6:9], machine[12:15]
    z = arctan2(las, lac)
    z = z + 2 * np.pi * np.round((turn - z) / (2 * np.pi))
    return np.concatenate([machine[:6], np.hypot(lac, las), machine[9:12], z])


@dataclass(frozen=True, slots=True)
class Gauge:
    """The one-parameter family that keeps x_a1, y_a1 and the `held` coordinate of A_2."""

    held: Literal["xa2", "ya2"]

    def scale(self, machine: Array, phi: float) -> float:
        """Return s(phi) for the 15-vector `machine`: that which keeps the held coordinate."""
        dx, dy = machine[2] - machine[0], machine[3] - machine[1]
        if self.held == "xa2":
            return float(dx / (dx * np.cos(phi) - dy * np.sin(phi)))
        return float(dy / (dy * np.cos(phi) + dx * np.sin(phi)))

    def move(self, machine: Array, phi: float) -> Array:
        """Return the machine, shape (15,), that has the same readings and offsets larger by `phi` [rad]."""
        s, c, d = self.scale(machine, phi), np.cos(phi), np.sin(phi)
        moved = machine.copy()
        for base in (0, 2, 4):
            dx, dy = machine[base] - machine[0], machine[base + 1] - machine[1]
            moved[base] = machine[0] + s * (c * dx - d * dy)
            moved[base + 1] = machine[1] + s * (d * dx + c * dy)
        moved[6:12] *= s
        moved[12:15] += phi
        return moved

    def align(self, machine: Array, positions: Array, true_positions: Array) -> tuple[float, Array]:
        """Return (phi, aligned machine): where on its curve `machine` brings its end-effectors nearest to the truth.

        The scale s is positive. `positions` and `true_positions` have shape (n, 2). phi is the gauge angle of `machine`
        seen from the truth.
        With u = tan(turn), the held coordinate gives s cos(turn) = h / (h - k u), so that the sum of squares over the
        positions is a ratio of polynomials in u whose derivative has one root: no search is needed.
        """
        anchor = machine[:2]
        h, k = machine[2] - machine[0], machine[3] - machine[1]
        if self.held == "ya2":
            h, k = k, -h
        arm, wanted = positions - anchor, true_positions - anchor
        size = np.sum(arm * arm)
        along, across = np.sum(arm * wanted), np.sum(arm[:, 0] * wanted[:, 1] - arm[:, 1] * wanted[:, 0])
        lever = h * across + k * along
        up, down = h * (lever - k * size), h * h * size + k * lever
        turn = float(np.arctan2(up, down))
        return -turn, self.move(machine, turn)


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
    actual, start = makers_machine(), makers_machine()
    column = constants.column(PAPER, f"{table}.actual")
    for name in NAMES:
        if name in column:
            actual[NAMES.index(name)] = column[name]
    # the initial offsets of Tables 2-4: the hand stops at (210, 245), taken for the home position
    geometry = constants.column(PAPER, "geometry")
    estimate = np.array([[geometry["estimate_x"], geometry["estimate_y"]]])
    assumed = inverse_kinematics(makers_machine(), home()[None])[0]
    start[12:15] = np.asarray(actual[12:15] + assumed - inverse_kinematics(actual, estimate)[0])
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


_FARTHEST = 1000.0
PlanName = Literal["grid", "disc", "box", "line", "circle", "two_circles"]


def plan_points(plan: PlanName, home: Array, radius: float, n: int, rng: np.random.Generator) -> Array:
    """Return `n` end-effector positions, shape (n, 2), mm, within `radius` of `home` (along x for grid, line, box)."""
    if not radius > 0:
        raise ValueError(f"radius={radius:g}: must be above 0 mm")
    if radius > _FARTHEST:
        raise ValueError(f"radius={radius:g}: out of reach; the legs reach some 490 mm")
    if plan == "grid":  # of equal pitch, three rows where n allows, from -1 to 1 in x; three points are a corner
        if n == 3:
            return home + radius * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        rows = 3 if n % 3 == 0 and n >= 9 else max(d for d in range(1, int(n**0.5) + 1) if n % d == 0)
        columns = n // rows
        if rows < 2 or columns < 2:
            raise ValueError(f"n={n}: a grid needs rows and columns, such as n=9, 21 or 50; or choose another plan")
        pitch = 2.0 / (columns - 1)
        x, y = np.meshgrid(np.arange(columns) * pitch - 1.0, (np.arange(rows) - (rows - 1) / 2) * pitch)
        return home + radius * np.column_stack([x.ravel(), y.ravel()])
    if plan == "disc":
        r, angle = np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
        return home + radius * np.column_stack([r * cos(angle), r * sin(angle)])
    if plan == "box":
        return np.asarray(home + radius * (2 * rng.random((n, 2)) - 1))
    if plan == "line":
        return home + radius * np.column_stack([np.linspace(-1, 1, n), np.zeros(n)])
    if plan == "circle":
        return home + radius * _circle(n)
    if plan == "two_circles":  # the outer one has twice the radius and twice the points
        inner = n // 3
        return home + radius * np.vstack([_circle(n - inner), 0.5 * _circle(inner)])
    assert_never(plan)


def _circle(n: int) -> Array:
    angle = 2 * np.pi * np.arange(n) / n
    return np.column_stack([cos(angle), sin(angle)])


NOISES = (1e-6, 3e-4)  # rad
FINEST = 1e-6  # rad: the readings that an instance without noise is held to
_MOST_POSES = 80
FEWEST_POSES = 9
_MARGIN = 10.0  # mm
DIGITS = [5 if unit == "rad" else 3 for unit in UNITS]


@final
@dataclass(frozen=True, eq=False)
class DrawnPlan:
    """The poses: `kind` of `plan_points` with n of them, within `radius` of `centre`, shape (2,), mm."""

    kind: PlanName
    radius: float
    n: int
    centre: Array

    def points(self, data_seed: int) -> tuple[Array, np.random.Generator]:
        """Return the end-effectors, shape (n, 2), mm, and the generator of the readings' noise."""
        where, shake = (np.random.default_rng(s) for s in np.random.SeedSequence(data_seed).spawn(2))
        return plan_points(self.kind, self.centre, self.radius, self.n, where), shake

    @staticmethod
    def drawn(stream: Stream, fewest: int) -> DrawnPlan:
        """Draw a plan of at least `fewest` poses."""
        kind: PlanName = stream.one_of(get_args(PlanName))
        n = round(stream.log_between(fewest, _MOST_POSES))
        away, angle = 30 * stream.between(0, 1) ** 0.5, stream.between(0, 2 * np.pi)
        centre = home() + np.round(away * np.array([cos(angle), sin(angle)]), 3)
        radius = round(stream.between(50, 120), 1)
        return DrawnPlan(kind, radius, 3 * (n // 3) if kind == "grid" else n, frozen(centre))


PlanarInstance = Drawn[Setting, DrawnPlan]


def nominal_machine(stream: Stream) -> Array:
    """Draw a nominal machine, shape (15,)."""
    machine = makers_machine()
    for i in range(len(NAMES)):
        spread = (15.0 if i < 6 else 10.0) if i < 12 else 1.5
        moved = stream.between(-spread, spread)  # drawn for A_1 too, so that all keep their places in the stream
        machine[i] = round(machine[i] + (moved if i > 1 else 0.0), DIGITS[i])
    return machine


def within_reach(machine: Array, points: Array) -> bool:
    """Tell whether every leg reaches every point, shape (n, 2), with room to spare."""
    for i in range(3):
        reach = np.hypot(points[:, 0] - machine[2 * i], points[:, 1] - machine[2 * i + 1])
        la, lb = machine[6 + i], machine[9 + i]
        if reach.max() > la + lb - _MARGIN or reach.min() < abs(la - lb) + _MARGIN:
            return False
    return True


def refuse_out_of_reach(name: str, radius: float, points: Array, angles: Array) -> None:
    """Raise `ValueError` for the first of `points`, (n, 2), mm, where a leg has no angle, (n, 3)."""
    if not np.isfinite(angles).all():
        bad, leg = np.argwhere(~np.isfinite(angles))[0]
        x, y = points[bad]
        raise ValueError(
            f"{name}.radius={radius:g}: position ({x:.1f}, {y:.1f}) mm is out of reach of leg {leg + 1}; "
            "take a smaller radius"
        )
