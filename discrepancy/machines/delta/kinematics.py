"""A linear delta: three carriages on towers, three rods, and an effector that hangs where three spheres meet.

Carriage i stands at the tower's place in the plane, at the height the endstop and the steps say. The nozzle is the
lower point at a distance of its rod from each of the three carriages. The rods' joints on the effector are taken
together in one point, so `radius` is the tower's less the effector's, as firmware has it.

Quantities, mm and rad; i is a, b or c. What the firmware knows: endstop_i, the height of the nozzle when all carriages
stand at their switches in a printer whose three towers are alike; radius, angle_i, arm_i. What it does not know is
zero where nothing is wrong, and stands beside those: d_radius, d_radius_i, d_angle_i, d_rod, d_rod_i (mm, rad: added
to what is nominal); scale, scale_i (a belt moves 1 + scale times the stated way); lean_i_out, lean_i_side (tower i
leans away from the axis, or to the side of growing angles, about where its carriage stands with the nozzle on the
middle of the bed: what it stands off there is d_radius_i and d_angle_i);
zero_i (what a carriage has gone down beside its way: play, drift); tilt_out, tilt_skew_x,
tilt_skew_y (the effector tilts as it goes outward, and its nozzle goes further by that share); bed_x, bed_y, dome (the
bed's slope, and how far its middle stands above its rim); caliper (added to every distance), shrink (share by which
printed distances are too short).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibench.discrepancy.model.machine import Numbers, Quantities

TOWERS = ("a", "b", "c")
IMPERFECTIONS = (
    "d_radius", *(f"d_radius_{i}" for i in TOWERS), *(f"d_angle_{i}" for i in TOWERS),
    "d_rod", *(f"d_rod_{i}" for i in TOWERS), "scale", *(f"scale_{i}" for i in TOWERS),
    *(f"lean_{i}_{way}" for i in TOWERS for way in ("out", "side")), *(f"zero_{i}" for i in TOWERS),
    "tilt_out", "tilt_skew_x", "tilt_skew_y", "bed_x", "bed_y", "dome", "caliper", "shrink",
)  # fmt: skip


def nozzle(q: Quantities, travel: Sequence[Numbers]) -> tuple[Numbers, Numbers, Numbers]:
    """Return x, y, z of the nozzle, (n,) each, mm, for `travel` of each carriage down from its endstop, likewise."""
    at_x, at_y, h, rod = zip(
        *(_carriage(q, tower, way) for tower, way in zip(TOWERS, travel, strict=True)), strict=True
    )
    x, y, z = lower_point(at_x, at_y, h, rod)
    out, skew_x, skew_y = q["tilt_out"], q["tilt_skew_x"], q["tilt_skew_y"]
    return x + out * x + skew_x * x + skew_y * y, y + out * y + skew_y * x - skew_x * y, z


def lower_point(
    x: Sequence[Numbers], y: Sequence[Numbers], h: Sequence[Numbers], rod: Sequence[Numbers]
) -> tuple[Numbers, Numbers, Numbers]:
    """Return the lower point where three spheres meet, about (x, y, h)_i with radii rod_i; NaN where they do not.

    The differences of the spheres' equations are linear, so x and y follow from z; the first sphere then gives z.
    """
    rises, rows = [], []
    for k in (1, 2):
        dx, dy, dh = x[k] - x[0], y[k] - y[0], h[k] - h[0]
        rows.append((dx, dy))
        rises.append(((dx**2 + dy**2 + dh**2 + rod[0] ** 2 - rod[k] ** 2) / 2, dh))
    (ax, ay), (bx, by) = rows
    (ar, ah), (br, bh) = rises
    area = ax * by - ay * bx
    u0, u1 = (ar * by - ay * br) / area, (ah * by - ay * bh) / area  # from the first carriage: x = u0 - u1 z
    v0, v1 = (ax * br - ar * bx) / area, (ax * bh - ah * bx) / area
    a, b, c = 1 + u1**2 + v1**2, u0 * u1 + v0 * v1, u0**2 + v0**2 - rod[0] ** 2
    z = (b - np.sqrt(b**2 - a * c)) / a
    return x[0] + u0 - u1 * z, y[0] + v0 - v1 * z, h[0] + z


def bed(q: Quantities, x: Numbers, y: Numbers) -> Numbers:
    """Return how high the bed stands at (x, y), mm; the dome falls to zero at the radius `bed_radius`."""
    dome = q["dome"] * (1 - (x**2 + y**2) / q["bed_radius"] ** 2)
    return np.asarray(q["bed_x"] * x + q["bed_y"] * y + dome)


def height(q: Quantities, travel: Sequence[Numbers]) -> Numbers:
    """Return how high the nozzle stands above the bed, (n,), mm."""
    x, y, z = nozzle(q, travel)
    return z - bed(q, x, y)


def distance(q: Quantities, first: Sequence[Numbers], second: Sequence[Numbers]) -> Numbers:
    """Return what a caliper shows between two places of a printed object, (n,), mm, from the travels at both."""
    one, other = nozzle(q, first), nozzle(q, second)
    apart = np.sqrt(sum((b - a) ** 2 for a, b in zip(one, other, strict=True)))
    return np.asarray(apart * (1 - q["shrink"]) + q["caliper"])


def _carriage(q: Quantities, tower: str, way: Numbers) -> tuple[Numbers, Numbers, Numbers, Numbers]:
    """Return x, y, height of a carriage and the length of its rod, for its way down from the endstop, mm."""
    middle = np.sqrt(q[f"arm_{tower}"] ** 2 - q["radius"] ** 2)
    h = q[f"endstop_{tower}"] + middle - q[f"zero_{tower}"] - way * (1 + q["scale"] + q[f"scale_{tower}"])
    angle = q[f"angle_{tower}"] + q[f"d_angle_{tower}"]
    out = q["radius"] + q["d_radius"] + q[f"d_radius_{tower}"] + q[f"lean_{tower}_out"] * (h - middle)
    side = q[f"lean_{tower}_side"] * (h - middle)
    cos, sin = np.cos(angle), np.sin(angle)
    rod = q[f"arm_{tower}"] + q["d_rod"] + q[f"d_rod_{tower}"]
    return out * cos - side * sin, out * sin + side * cos, h, rod + 0 * h
