"""Where a telescope points: two axes, the six errors of their geometry, and the tube's bend, exact on the sphere.

Every step is a rotation of a direction, so nothing is wrong near the pole or the zenith, where the field's formulas
grow with sec and tan. Equatorial and altazimuth mounts are one mechanism in two frames:

    equatorial   x: the equator on the meridian, y: west, z: the pole   roll = hour angle, pitch = declination
    altazimuth   x: north, y: east, z: the zenith                       roll = azimuth,    pitch = elevation

A declination beyond +-90 degrees is the other side of the pier: the terms of the axes change their signs by themselves.
Names and signs are those of TPOINT (P. T. Wallace): true = recorded + correction, an hour angle to the west and a pitch
upwards counted positive, a correction of azimuth to the left. MA positive: the pole of the mount is east of the true
one; ME: below it; AN, AW: north and west of the zenith; TF: the tube droops. A harmonic `HrfaN` adds to result r the
function f (S sine, C cosine) of N times the angle a: results H, D, X (on the sky, across), P (non-perpendicularity), or
A, E, S (on the sky, left-right); A is counted from the south through east there. Some names are one signature: DAF is
HCEC beside NP, TF of an altazimuth mount is ECEC; HDCH is FO, and is not listed twice.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, final

import numpy as np
from numpy.typing import NDArray

from calibench.problems.base import Array

Kind = Literal["equatorial", "altaz"]
AXES: dict[Kind, tuple[str, str]] = {"equatorial": ("ha", "dec"), "altaz": ("az", "el")}
ERRORS: dict[Kind, tuple[str, str]] = {"equatorial": ("dX", "dDec"), "altaz": ("dS", "dEl")}
NAMED: dict[Kind, tuple[str, str]] = {"equatorial": ("hour angle", "declination"), "altaz": ("azimuth", "elevation")}
FRAME = ("sky_roll", "sky_pitch")
Numbers = NDArray[Any]
ARCSEC = np.pi / 180 / 3600  # rad
NORTH_EAST = "north_east"
AZIMUTHS = {NORTH_EAST: (1, 0.0), "north_west": (-1, 0.0), "south_east": (-1, np.pi), "south_west": (1, np.pi)}
"""Way of counting azimuth, from where and through where -> its sign and zero [rad], seen from north through east."""
LOWEST = np.sin(np.radians(5.0))  # sine of the elevation at which cot E ends: nobody points lower

# term -> the turn it makes, and its sign in the frame of the mount; in the order in which the turns follow each other
TURNS = {
    "equatorial": {"IH": ("roll", 1), "ID": ("pitch", 1), "CH": ("across", 1), "NP": ("square", 1),
                   "MA": ("sideways", 1), "ME": ("forwards", 1)},
    "altaz": {"IA": ("roll", -1), "IE": ("pitch", 1), "CA": ("across", -1), "NPAE": ("square", -1),
              "AW": ("sideways", 1), "AN": ("forwards", -1)},
}  # fmt: skip
_ORDER = {"across": (0, 1), "pitch": (0, 2), "square": (2, 1), "roll": (0, 1), "sideways": (1, 2), "forwards": (0, 2)}


def direction(roll: Numbers, pitch: Numbers) -> Numbers:
    """Return the unit vector of two angles [rad], shape (n, 3)."""
    return np.stack([np.cos(pitch) * np.cos(roll), np.cos(pitch) * np.sin(roll), np.sin(pitch) + 0 * roll], axis=-1)


def angles(towards: Numbers) -> tuple[Array, Array]:
    """Return the roll, within +-pi, and the pitch, within +-pi/2, of real unit vectors (n, 3)."""
    return np.arctan2(towards[:, 1], towards[:, 0]), np.arcsin(np.clip(towards[:, 2], -1, 1))


def tangents(roll: Numbers, pitch: Numbers) -> tuple[Numbers, Numbers]:
    """Return the unit vectors in which roll and pitch grow, (n, 3) each: the two components of an error on the sky."""
    along = np.stack([-np.sin(roll), np.cos(roll), 0 * roll], axis=-1)
    up = np.stack([-np.sin(pitch) * np.cos(roll), -np.sin(pitch) * np.sin(roll), np.cos(pitch) + 0 * roll], axis=-1)
    return along, up


def zenith(kind: Kind, latitude: float) -> Array:
    """Return the zenith in the frame of the mount, (3,)."""
    return np.array([np.cos(latitude), 0.0, np.sin(latitude)]) if kind == "equatorial" else np.array([0.0, 0.0, 1.0])


def pointing(kind: Kind, latitude: float, roll: Numbers, pitch: Numbers, terms: dict[str, Numbers]) -> Numbers:
    """Return where the telescope truly points, unit vectors (n, 3), at recorded axes [rad] and `terms` [arcsec].

    `terms` has all of `TURNS` and `TF`, `TX`; each a number or (n,). Analytic in all of them.
    """
    at = [1 + 0 * pitch, 0 * pitch, 0 * pitch]
    for i, j, angle in _turns(kind, roll, pitch, terms):
        at[i], at[j] = _turned(at[i], at[j], angle)
    # directions lowered by TF sin z and TX tan z [arcsec], in the vertical plane
    towards = np.stack(np.broadcast_arrays(*at), axis=-1)
    up = zenith(kind, latitude)
    height = towards @ up
    floor = np.where(height.real > LOWEST, height, LOWEST)
    drop = ((terms["TF"] + terms["TX"] / floor) * ARCSEC + 0 * height)[:, None]
    lowered = towards - drop * (up - height[:, None] * towards)
    return np.asarray(lowered / np.sqrt(np.sum(lowered * lowered, axis=-1))[:, None])


def slopes_of(kind: Kind, latitude: float, roll: Array, pitch: Array, terms: dict[str, Array]) -> dict[str, Array]:
    """Return the derivatives of `pointing` in its axes and each of its terms, name -> (n, 3), of one unit each."""
    # the direction and its derivatives so far, (m, 3, n): each turn turns them, and adds its own
    whole = np.zeros((1, 3, len(roll)))
    whole[0, 0] = 1.0
    for i, j, angle in _turns(kind, roll, pitch, terms):
        whole[:, i], whole[:, j] = _turned(whole[:, i], whole[:, j], angle)
        own = np.zeros_like(whole[:1])
        own[0, i], own[0, j] = -whole[0, j], whole[0, i]
        whole = np.concatenate([whole, own])
    whole = np.moveaxis(whole, 1, -1)
    towards, moved = whole[0], whole[1:]
    # lowered by TF sin z and TX tan z, and of length 1 again
    up, tan = zenith(kind, latitude), np.reshape(terms["TX"], (-1, 1))
    height, rise = (towards @ up)[:, None], (moved @ up)[..., None]
    floor, fall = np.maximum(height, LOWEST), up - height * towards
    drop = (np.reshape(terms["TF"], (-1, 1)) + tan / floor) * ARCSEC
    steeper = np.where(height > LOWEST, -tan / floor**2 * ARCSEC, 0.0)
    moved = moved - steeper * rise * fall + drop * (rise * towards + height * moved)
    moved = np.concatenate([moved, -ARCSEC * np.stack([fall, fall / floor])])
    lowered = towards - drop * fall
    length = np.sqrt(np.einsum("nk,nk->n", lowered, lowered))[:, None]
    ahead = lowered / length
    moved = (moved - ahead * np.einsum("mnk,nk->mn", moved, ahead)[..., None]) / length
    by = dict(zip((*_ORDER, "TF", "TX"), moved, strict=True))
    found = {term: sign * ARCSEC * by[name] for term, (name, sign) in TURNS[kind].items()}
    return found | dict(zip(AXES[kind], (by["roll"], by["pitch"]), strict=True)) | {n: by[n] for n in ("TF", "TX")}


def _turns(kind: Kind, roll: Numbers, pitch: Numbers, terms: dict[str, Numbers]) -> Iterator[tuple[int, int, Numbers]]:
    """Yield the two coordinates that each turn mixes, and its angle [rad], in their order."""
    turn = {name: sign * terms[term] * ARCSEC for term, (name, sign) in TURNS[kind].items()}
    turn |= {"pitch": pitch + turn["pitch"], "roll": roll + turn["roll"]}
    for name, (i, j) in _ORDER.items():
        yield i, j, turn[name]


def _turned(a: Numbers, b: Numbers, by: Numbers) -> tuple[Numbers, Numbers]:
    return a * np.cos(by) - b * np.sin(by), a * np.sin(by) + b * np.cos(by)


Seen = Mapping[str, Array]  # roll and pitch [rad] as recorded, height (sine of the elevation), side (+1, -1 beyond)


@final
@dataclass(frozen=True)
class Term:
    """One cause: the quantity that it changes, by what function of the place for a coefficient of one.

    `phase` is the name of the other term of a cause whose phase is any: of its cosine for its sine; "" for any other.
    """

    name: str
    kind: Kind
    cause: str
    formula: str
    quantity: str
    shape: Callable[[Seen], Array]
    phase: str = ""


_RESULT = {  # result -> quantity that the harmonic is added to, and what that is in words
    "H": ("IH", "hour angle"), "D": ("ID", "declination"), "X": ("CH", "east-west"),
    "P": ("NP", "non-perpendicularity"),
    "A": ("IA", "azimuth"), "E": ("IE", "elevation"), "S": ("CA", "left-right"),
}  # fmt: skip
_ANGLE = {"H": "hour angle", "D": "declination", "A": "azimuth", "E": "elevation"}


def _harmonic(kind: Kind, result: str, of: str, times: int = 1, circle: str = "") -> tuple[Term, ...]:
    """Return the sine and the cosine of one result and angle, by the name of a `circle` where that is what errs.

    H, D and E are as recorded, A from the south through east.
    """
    quantity, words = _RESULT[result]
    number = str(times) if times > 1 else ""
    often = {1: "once", 2: "twice"}[times]
    cause = f"An error in {words} comes {often} a turn of the {_ANGLE[of]}"
    sine, cosine = (f"H{result}{letter}{of}{number}" for letter in "SC")
    if circle:
        cause, sine, cosine = f"The circle of the {words} is not centred", f"{circle}S", f"{circle}C"

    def shape(turn: Callable[[Array], Array], at: Seen) -> Array:
        angle = {"H": at["roll"], "A": np.pi - at["roll"], "D": at["pitch"], "E": at["pitch"]}[of]
        return np.asarray(turn(times * angle))

    return tuple(
        Term(
            name, kind, f"{cause} ({turn})", f"{quantity} += {name} {turn}({number}{of})", quantity=quantity,
            shape=partial(shape, getattr(np, turn)), phase=phase,
        )
        for name, turn, phase in ((sine, "sin", cosine), (cosine, "cos", sine))
    )  # fmt: skip


def _plain(kind: Kind, name: str, cause: str, formula: str) -> Term:
    return Term(name, kind, cause, formula, name, lambda at: np.ones_like(at["roll"]))


_REFRACTED = "The tube droops, or refraction is not allowed for, by the tangent of the zenith distance"
_TUBE = (
    ("TF", "The tube droops, by the sine of the zenith distance", "dE = -TF cos E"),
    ("TX", _REFRACTED, "dE = -TX cot E"),
)
TERMS: tuple[Term, ...] = (
    _plain("equatorial", "CH", "The tube is not square to the declination axis (cone error)", "dh = CH sec d"),
    _plain("equatorial", "NP", "The declination axis is not square to the polar axis", "dh = NP tan d"),
    _plain("equatorial", "MA", "The polar axis points east of the pole", "dh = -MA cos h tan d, dd = MA sin h"),
    _plain("equatorial", "ME", "The polar axis points below the pole", "dh = ME sin h tan d, dd = ME cos h"),
    *(_plain("equatorial", *term) for term in _TUBE),
    Term("DAF", "equatorial", "The declination axis droops under its load", "dh = DAF sin E sec d", "CH",
            lambda at: at["height"]),
    Term("FO", "equatorial", "The fork bends with the hour angle", "dd = FO cos h", "ID",
            lambda at: np.cos(at["roll"])),
    *_harmonic("equatorial", "H", "H", circle="HCE"),
    *_harmonic("equatorial", "D", "D", circle="DCE"),
    *_harmonic("equatorial", "H", "H", 2),
    *_harmonic("equatorial", "D", "D", 2),
    Term("HDSH", "equatorial", "An error in declination that follows the sine of the hour angle", "dd = HDSH sin h",
            "ID", lambda at: np.sin(at["roll"])),  # HDCH is FO
    *_harmonic("equatorial", "D", "H", 2),
    *_harmonic("equatorial", "X", "H", 1),
    *_harmonic("equatorial", "X", "H", 2),
    *_harmonic("equatorial", "P", "H", 1),
    Term("PHH", "equatorial", "The hour angle has a wrong scale", "dh = PHH h", "IH", lambda at: at["roll"]),
    Term("PDD", "equatorial", "The declination has a wrong scale", "dd = PDD d", "ID", lambda at: at["pitch"]),
    *(Term(f"pier_{name}", "equatorial", f"{name} differs between the two sides of the pier",
              f"{name} += pier_{name} side", name, lambda at: at["side"]) for name in ("IH", "ID", "CH")),
    _plain("altaz", "CA", "The tube is not square to the elevation axis", "dA = -CA sec E"),
    _plain("altaz", "NPAE", "The elevation axis is not square to the azimuth axis", "dA = -NPAE tan E"),
    _plain("altaz", "AN", "The azimuth axis leans to the north", "dA = -AN sin A tan E, dE = -AN cos A"),
    _plain("altaz", "AW", "The azimuth axis leans to the west", "dA = -AW cos A tan E, dE = AW sin A"),
    *(_plain("altaz", *term) for term in _TUBE),
    *_harmonic("altaz", "A", "A", circle="ACE"),
    *_harmonic("altaz", "E", "E", circle="ECE"),
    *_harmonic("altaz", "A", "A", 2),
    *_harmonic("altaz", "E", "E", 2),
    *_harmonic("altaz", "E", "A", 1),
    *_harmonic("altaz", "E", "A", 2),
    *_harmonic("altaz", "S", "A", 1),
    *_harmonic("altaz", "S", "A", 2),
    Term("PAA", "altaz", "The azimuth has a wrong scale", "dA = -PAA A", "IA", lambda at: at["roll"]),
    Term("PEE", "altaz", "The elevation has a wrong scale", "dE = PEE E", "IE", lambda at: at["pitch"]),
)  # fmt: skip
