"""A telescope mount of vectors and rotations about them, with faults whose form is not the catalogue's to the last.

Nothing here is shared with the machine that searches. The polar axis, the declination axis and the tube are vectors in
the frame of the ground (south, east, up); the axes turn them (Rodrigues), gravity bends what they carry. Every fault
is multiplied by 1 + e g, g a smooth random function of where the telescope points, of rms 1, and e between .05 and .15.
Its size is drawn by what is visible of it: the rms, in sigma, of what calibrating the geometry leaves.

    case(k) is the k-th case: `case(k).columns`, `.stated`, and the truth that a search must not see.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

ARCSEC = np.pi / 648000
UP = np.array([0.0, 0.0, 1.0])
SOUTH = np.array([1.0, 0.0, 0.0])
EAST = np.array([0.0, 1.0, 0.0])
SEED = 20261122

EQUATORIAL = ("TF", "TX", "DAF", "FO", "HCE", "DCE", "pier_IH", "pier_ID", "PHH")
ALTAZ = ("TF", "TX", "ACE", "ECE", "HSxA2", "HExA2")
OUTSIDE = ("bump", "mirror", "creep")  # in no catalogue


@dataclass(frozen=True)
class Case:
    """What a file would hold, and the truth: the fault's name ("" for none) and its visible size in sigma.

    `outside` is how much of that is not the textbook's form, 0 to 1 and more: the geometry may take the form away and
    leave what is off it.
    """

    columns: dict[str, Any]
    stated: dict[str, Any]
    truth: str
    visible: float
    sigma: float
    outside: float


def turned(v: Any, about: Any, by: Any) -> Any:
    """Return vectors turned about axes by angles: Rodrigues."""
    about = about / np.linalg.norm(about, axis=-1, keepdims=True)
    c, s = np.cos(by)[..., None], np.sin(by)[..., None]
    return v * c + np.cross(about, v) * s + about * np.sum(about * v, axis=-1, keepdims=True) * (1 - c)


@dataclass(frozen=True)
class Mechanism:
    """A mount on the ground: where its first axis points at rest, and six small errors [rad]."""

    altaz: bool
    latitude: float
    errors: tuple[float, ...]  # index of both axes, square, across, and two tilts of the first axis

    def axes(self) -> tuple[Any, Any, Any]:
        """Return the first axis, the second axis and the tube, both axes reading zero."""
        _, _, square, across, tilt_1, tilt_2 = self.errors
        if self.altaz:  # reading zero: the tube to the north, level; azimuth grows to the east, clockwise from above
            first, tube = -UP, -SOUTH
            second = EAST  # turning about it by a positive angle lifts what looks north
        else:
            first = np.cos(self.latitude) * -SOUTH + np.sin(self.latitude) * UP
            tube = np.sin(self.latitude) * SOUTH + np.cos(self.latitude) * UP  # the equator on the meridian
            first, second = -first, EAST  # hour angle grows to the west: clockwise about the pole
        second = turned(second, tube, np.asarray(square))
        tube = turned(tube, np.cross(second, tube), np.asarray(across))
        axes = [turned(turned(v, SOUTH, np.asarray(tilt_1)), EAST, np.asarray(tilt_2)) for v in (first, second, tube)]
        return axes[0], axes[1], axes[2]

    def points(self, one: Any, two: Any, faults: Any = None) -> Any:
        """Return where the tube points, unit vectors (n, 3) on the ground; `faults` bends it: (angles, towards)."""
        first, second, tube = self.axes()
        n = len(one)
        lift = -1.0 if not self.altaz else 1.0
        d_one, d_two, bend = faults(one, two) if faults else (np.zeros(n), np.zeros(n), None)
        a, b = one + self.errors[0] + d_one, two + self.errors[1] + d_two
        second = turned(np.tile(second, (n, 1)), np.tile(first, (n, 1)), a)
        looking = turned(np.tile(tube, (n, 1)), np.tile(first, (n, 1)), a)
        looking = turned(looking, second, lift * b)
        return bend(looking, second) if bend else looking


def _perfect(altaz: bool, latitude: float) -> Mechanism:
    return Mechanism(altaz, latitude, (0.0,) * 6)


def _readings(machine: Mechanism, towards: Any, flips: Any) -> tuple[Any, Any]:
    """Return the readings at which a perfect mount of this kind points along unit vectors."""
    first, second, tube = _perfect(machine.altaz, machine.latitude).axes()
    pole = -first
    height = np.arcsin(np.clip(towards @ pole, -1, 1))
    west = -second if not machine.altaz else second
    one = np.arctan2(towards @ west, towards @ tube)
    over = np.asarray(flips) & (one < 0)
    return np.where(over, one + np.pi, one), np.where(over, np.pi - height, height)


def _smooth(rng: np.random.Generator, one: Any, two: Any) -> Any:
    """Return a smooth random function of both axes, of mean square 1 over the stars."""
    total = np.zeros(len(one))
    for _ in range(3):
        k, m = rng.integers(0, 3, 2)
        total += rng.standard_normal() * np.cos(k * one + m * two + rng.uniform(0, 2 * np.pi))
    total -= total.mean()
    return total / max(np.sqrt(np.mean(total**2)), 1e-9)


def _fault(name: str, rng: np.random.Generator, one: Any, two: Any, t: Any, altaz: bool) -> Callable[..., Any]:
    """Return (size [rad], textbook=False) -> the faults of a mechanism, in their own form or the textbook's."""
    own = 1 + rng.uniform(0.05, 0.15) * _smooth(rng, one, two) if name else 1.0
    phase = rng.uniform(0, 2 * np.pi)
    beyond = np.cos(two) < 0
    moment = rng.uniform(0.2, 0.8)
    place = rng.uniform(-2, 2), rng.uniform(0.3, 0.9)

    def of(size: float, textbook: bool = False) -> Any:
        def faults(a: Any, b: Any) -> Any:
            zero = np.zeros(len(a))
            s = size * (1.0 if textbook else own) + zero
            on_one = {
                "HCE": s * np.sin(a + phase),
                "ACE": s * np.sin(a + phase),
                "PHH": s * a,
                "pier_IH": np.where(beyond, -s, s),
                "bump": s * np.exp(-(((a - place[0]) / 0.4) ** 2)),
            }
            on_two = {"DCE": s * np.sin(b + phase), "ECE": s * np.sin(b + phase), "pier_ID": np.where(beyond, -s, s),
                      "FO": s * np.cos(a), "HExA2": s * np.sin(2 * a + phase),
                      "mirror": s * np.sign(np.sin(3 * a + 2 * b + phase))}  # fmt: skip

            def bend(looking: Any, second: Any) -> Any:
                level = np.cross(looking, UP)  # about it what looks is lifted
                sine = np.maximum(np.linalg.norm(level, axis=1), 1e-12)
                height = looking @ UP
                if name == "TF":
                    return turned(looking, level / sine[:, None], -s * sine)
                if name == "TX":
                    return turned(looking, level / sine[:, None], -s * sine / np.maximum(height, 0.1))
                if name == "DAF":  # the axis droops with its load: across, by its component of gravity
                    return turned(looking, np.cross(looking, second), s * height)
                if name == "HSxA2":
                    return turned(looking, np.cross(looking, second), s * np.sin(2 * a + phase))
                if name == "creep":  # something slid to the side after a moment of the night, and on
                    late = np.maximum(t / t.max() - moment, 0) ** 2
                    return turned(looking, np.cross(looking, second), s * late / max(late.max(), 1e-9))
                return looking

            return on_one.get(name, zero), on_two.get(name, zero), bend

        return faults

    return of


def _apart(machine: Mechanism, towards: Any, base: Any) -> Any:
    """Return two components of `towards` about `base` [arcsec], (2n,)."""
    along = np.cross(np.where(np.abs(base @ UP)[:, None] > 0.99, SOUTH, UP), base)
    along /= np.linalg.norm(along, axis=1)[:, None]
    up = np.cross(base, along)
    return np.concatenate([np.sum(along * towards, axis=1), np.sum(up * towards, axis=1)]) / ARCSEC


def case(
    k: int, only: str | None = None, altaz: bool | None = None, visible: float | None = None, base: int = SEED
) -> Case:
    """Return the k-th case of a base: a fifth has no fault, a quarter one of no catalogue, the rest one of the field's.

    `only` names the fault, `altaz` the kind, `visible` the size, instead of drawing them.
    """
    rng = np.random.default_rng(np.random.SeedSequence([base, k]))
    drawn = bool(rng.random() < 0.4)
    altaz = drawn if altaz is None else altaz
    latitude = np.radians(rng.choice([-1, 1]) * rng.uniform(20, 60))
    n = int(rng.integers(60, 250))
    sigma = float(np.exp(rng.uniform(np.log(5.0), np.log(100.0))))
    tails = rng.random() < 0.2
    draw = rng.random()
    german = bool(rng.random() < 0.75)
    names = ALTAZ if altaz else tuple(n for n in EQUATORIAL if german or not n.startswith("pier"))
    name = "" if draw < 0.2 else str(rng.choice(OUTSIDE)) if draw < 0.45 else str(rng.choice(names))
    name = name if only is None else only
    errors = tuple(rng.normal(0, s) * ARCSEC for s in (3000, 2000, 300, 900, 400, 400))
    machine = Mechanism(altaz, float(latitude), errors)
    azimuth, height = rng.uniform(0, 2 * np.pi, n), np.arcsin(rng.uniform(np.sin(np.radians(22)), 0.999, n))
    stars = np.stack([-np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)], axis=1)
    one, two = _readings(machine, stars, german and not altaz)
    t = np.sort(rng.uniform(0, 3 * 3600, n))
    fault = _fault(name, rng, one, two, t, altaz)
    wanted = float(np.exp(rng.uniform(np.log(0.3), np.log(4.0))))
    wanted = wanted if visible is None else visible
    plain = machine.points(one, two)
    jacobian = np.stack([
        _apart(machine, Mechanism(altaz, machine.latitude, tuple(e + 1e-6 * (i == j) for i, e in enumerate(errors)))
               .points(one, two), plain) for j in range(6)], axis=1)  # fmt: skip
    units = [_apart(machine, machine.points(one, two, fault(1e-6, textbook)), plain) for textbook in (False, True)]
    left, told = (unit - jacobian @ np.linalg.lstsq(jacobian, unit, rcond=None)[0] for unit in units)
    rms = float(np.sqrt(np.mean(left**2)))
    outside = float(np.sqrt(np.mean((left - told) ** 2))) / max(rms, 1e-12)
    size = 1e-6 * wanted * sigma / rms if rms > 1e-9 else 0.0
    towards = machine.points(one, two, fault(size if name else 0.0))
    law = rng.standard_t(4, (n, 3)) / np.sqrt(2.0) if tails else rng.standard_normal((n, 3))
    towards = towards + sigma * ARCSEC * law
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    star = _readings(machine, towards, False)
    words = ("az", "el") if altaz else ("ha", "dec")
    columns = dict(zip((*words, *(f"star_{w}" for w in words), "t_s"), (one, two, *star, t)))
    stated = {"mount": "altaz" if altaz else "equatorial", "latitude_deg": float(np.degrees(latitude))}
    return Case(columns, stated, name, wanted if name and rms > 1e-9 else 0.0, sigma, outside if name else 0.0)
