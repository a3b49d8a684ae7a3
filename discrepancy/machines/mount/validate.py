"""Observations of stars, checked and completed: both axes within a turn, and how far each star was from the reading.

Needed: `ha`, `dec`, `star_ha`, `star_dec` [rad] and the latitude for an equatorial mount; `az`, `el`, `star_az`,
`star_el` for an altazimuth one. Where a file states the side of the pier in words (`pier_side`: east or west, as ASCOM
has it: west is the tube gone over the pole) a declination within +-90 degrees is carried over the pole.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite
from typing import Any, final

import numpy as np

from calibench.core.notes import Code
from calibench.core.options import suggest
from calibench.discrepancy.checks.validate import entered
from calibench.discrepancy.machines.mount.geometry import (
    ARCSEC,
    AZIMUTHS,
    NORTH_EAST,
    Kind,
    angles,
    direction,
    tangents,
    zenith,
)
from calibench.discrepancy.model.measured import DataError, MeasuredData, with_numbers
from calibench.problems.base import Array

AXES: dict[Kind, tuple[str, str]] = {"equatorial": ("ha", "dec"), "altaz": ("az", "el")}
ERRORS: dict[Kind, tuple[str, str]] = {"equatorial": ("dX", "dDec"), "altaz": ("dS", "dEl")}
NAMED: dict[Kind, tuple[str, str]] = {
    "equatorial": ("hour angle", "declination"),
    "altaz": ("azimuth", "elevation"),
}
FRAME = ("sky_roll", "sky_pitch")
_FARTHEST = np.radians(45.0)  # of a star from where the mount says it points: beyond, a column is of another kind
_LOWEST = np.radians(-1.0)  # of a star that was seen


@final
@dataclass(frozen=True, eq=False)
class Observations:
    """Accepted data of one kind of mount, and its latitude [rad] (0 where none is needed)."""

    data: MeasuredData
    kind: Kind
    latitude: float


def accepted(data: MeasuredData) -> Observations:
    """Return the observations with `ERRORS` [arcsec] and `FRAME` [rad] added; raise `DataError` for what is wrong."""
    kind = _kind(data)
    names = (*AXES[kind], *(f"star_{name}" for name in AXES[kind]))
    missing = [name for name in names if name not in data]
    if missing:
        raise DataError(
            f"{data.name}: no column {', '.join(missing)}; an {kind} mount needs {', '.join(names)}; there are "
            f'{", ".join(data.in_file)}: columns={{"{missing[0]}": "NAME"}} tells another name'
        )
    data = entered(data)
    data = with_numbers(data, dict.fromkeys(names, np.ones(len(data), dtype=bool)))
    read = {name: _column(data, name) for name in names}
    latitude = _latitude(data, kind)
    if kind == "altaz":
        data, counted = _azimuth(data)
        read |= {name: counted[0] * read[name] + counted[1] for name in (names[0], names[2])}
    roll, pitch = _over_the_pole(data, read[names[0]], read[names[1]], kind)
    star = direction(read[names[2]], read[names[3]])
    low = np.flatnonzero(star @ zenith(kind, latitude) < np.sin(_LOWEST))
    if len(low):
        raise DataError(
            f"{data.name}: row {low[0] + 1}: the star is below the horizon; are latitude, units and hour angles right?"
        )
    frame = angles(direction(roll, pitch))
    apart = 2 * np.arcsin(np.clip(np.linalg.norm(star - direction(*frame), axis=1) / 2, 0, 1))
    if np.median(apart) > _FARTHEST:
        raise DataError(
            f"{data.name}: half of the stars are more than {np.degrees(np.median(apart)):.0f} degrees from where the "
            "mount says that it points; are the units right, and is it the mount that the file states (mount=)?"
        )
    wild = np.flatnonzero(apart > _FARTHEST)
    if len(wild):
        raise DataError(
            f"{data.name}: row {wild[0] + 1}: the star is {np.degrees(apart[wild[0]]):.0f} deg from where the mount "
            "says that it points; leave the row out"
        )
    columns: dict[str, Any] = {names[0]: roll, names[1]: pitch, **dict(zip(FRAME, frame))}
    for name, axis in zip(ERRORS[kind], tangents(*frame)):
        columns[name] = np.sum(axis * star, axis=1) / ARCSEC
    columns["side"] = np.where(np.cos(pitch) < 0, -1.0, 1.0)
    kept = {name: column for name, column in data.columns.items() if name not in (*names[2:], "pier_side")}
    data = replace(data, columns={**kept, **columns})  # the star's place is said by the error: once is enough
    return Observations(replace(data, machine="mount"), kind, latitude)


def _kind(data: MeasuredData) -> Kind:
    if data.machine not in ("", "mount"):
        raise DataError(f"{data.name}: these are data of machine {data.machine!r}, not of a mount")
    stated = data.metadata.get("mount", "equatorial" if "ha" in data else "altaz" if "az" in data else "equatorial")
    for kind in AXES:
        if stated == kind:
            return kind
    raise DataError(f"{data.name}: mount={stated}: equatorial or altaz is needed")


def _latitude(data: MeasuredData, kind: Kind) -> float:
    stated = data.metadata.get("latitude_deg")
    if stated is None and kind == "altaz":
        return 0.0
    try:
        latitude = float(stated)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise DataError(f"{data.name}: no latitude; state it in degrees: latitude_deg=39") from None
    if not (isfinite(latitude) and abs(latitude) <= 90):
        raise DataError(f"{data.name}: latitude_deg={latitude:g}: -90 to 90 degrees is needed")
    return float(np.radians(latitude))


def _azimuth(data: MeasuredData) -> tuple[MeasuredData, tuple[int, float]]:
    """Return sign and zero [rad] of azimuth as the file counts it; a note where neither it nor the owner says so."""
    stated = data.metadata.get("azimuth")
    if stated is None:
        others = " or ".join(f"azimuth={way}" for way in AZIMUTHS if way != NORTH_EAST)
        text = (
            f"nobody states how azimuth is counted: from north through east is taken; {others} states another, which "
            "turns signs of terms (AN, AW, CA, NPAE)"
        )
        return data.with_note(Code.SIGNS_TAKEN, text, ("az",)), AZIMUTHS[NORTH_EAST]
    if stated not in AZIMUTHS:
        raise DataError(f"{data.name}: azimuth={stated}: {suggest(str(stated), AZIMUTHS)}")
    return data, AZIMUTHS[stated]


def _column(data: MeasuredData, name: str) -> Array:
    column = np.asarray(data[name], dtype=float)
    if np.max(np.abs(column)) > 4 * np.pi:
        raise DataError(
            f"{data.name}: {name} reaches {np.max(np.abs(column)):.0f} rad; state its unit, in the heading as [deg] or "
            f"by units={name}:deg"
        )
    return column


def _over_the_pole(data: MeasuredData, roll: Array, pitch: Array, kind: Kind) -> tuple[Array, Array]:
    """Return the axes within +-pi, the pitch beyond +-pi/2 where the tube has gone over the pole."""
    if "pier_side" in data and kind == "equatorial":
        words = np.char.lower(np.char.strip(np.asarray(data["pier_side"]).astype(str)))
        unknown = np.flatnonzero(~np.isin(words, ("east", "west", "e", "w")))
        if len(unknown):
            word = words[unknown[0]]
            raise DataError(f"{data.name}: row {unknown[0] + 1}: pier_side={word}: east or west is needed")
        over = np.isin(words, ("west", "w")) & (np.cos(pitch) > 0)
        roll, pitch = np.where(over, roll + np.pi, roll), np.where(over, np.pi - pitch, pitch)
    return _within(roll), _within(pitch)


def _within(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
