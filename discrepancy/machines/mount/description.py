"""What a telescope mount declares for files, commands and pages: columns, words, formats, plans, what ships.

Findings are written as a TPOINT model: a caption, the method (T: the terms turn recorded into true directions) with the
number of stars and the rms on the sky [arcsec], then term, coefficient and its standard deviation, and END. What is no
term of the field (a drift, a slip) is a comment. A file of observations as TheSky and TPOINT write it:

    ! a comment, and a line of caption          anywhere before the site
    :NODA :EQUAT :ALTAZ :ALLSKY ...             options, a line or more; :EQUAT where none tells the mount
    +39 00 26 2024 7 14 29.20 987.00 ...        latitude (d m s), date, weather; or the latitude alone (+35 01 32.0)
    21 43 18.4 +72 29 08.3  09 28 59.9 +109 20 06.4  16 23.130        a star: RA (h m s), Dec (d m s),
    END                                          the mount (RA h m s or Az d m s, Dec or El d m s), sidereal time (h m)

A star of an altazimuth mount may be four numbers in degrees: its azimuth and elevation, and those of the mount. A
sidereal time in whole minutes with a number of seconds behind it (16 23 07.8) is h m s.

A declination of the mount beyond +-90 degrees means that the tube has gone over the pole. Hour angles are sidereal time
less right ascension; time is sidereal, and may pass midnight. What stands behind are auxiliary readings (`aux_1`, ...).
"""

import re
from math import isfinite
from typing import Any, Literal

import numpy as np

from calibench.core.notes import Code, Note
from calibench.core.tables.columns import Columns, Quantity
from calibench.discrepancy.effects.general.harmonics import PERIODIC
from calibench.discrepancy.machines.mount import geometry
from calibench.discrepancy.machines.mount.effects import TARGET
from calibench.discrepancy.machines.mount.geometry import AXES, ERRORS, FRAME, NAMED, NORTH_EAST, TERMS, TURNS, Kind
from calibench.discrepancy.model.machine import Correction, Description, Stated
from calibench.discrepancy.model.measured import DataError, MeasuredData
from calibench.discrepancy.registries import describe
from calibench.discrepancy.report import Report


def pointing_model(report: Report) -> Correction | None:
    """Return the pointing model of a finished search; None for a report without its model."""
    if report.fitted is None:
        return None
    model, x = report.model.model, report.model.best
    sd = np.sqrt(np.diag(report.model.fit.covariance()))
    known = {term.name for term in TERMS if not term.name.startswith("pier_")}
    names = [p.name for p in model.formulation.parameters]
    names += [name for effect in model.effects for name in effect.coefficients]
    own = len(model.formulation.parameters)
    families = [effect.family for effect in model.effects for _ in effect.coefficients]
    lines, beside = [], []
    for k, (name, value, wide) in enumerate(zip(names, x, sd)):
        if k < own or name in known:
            lines.append(f"  {name:<8}{value:+12.2f}{wide:10.3f}")
        else:
            beside.append(f"! not a term of the field: {families[k - own]} {name} {value:+.6g}")
    errors = model.residuals(x).real
    rms = float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))
    head = [f"{report.case}: {report.verdict}", f"T {len(errors)} {rms:.4f}"]
    return Correction(".mod", "\n".join([*head, *lines, *beside, "END", ""]))


PlanName = Literal["sky", "cross"]
_MOST = 100_000
_MINUTES = 1.0  # between two stars


def planned(
    plan: PlanName = "sky", n: int = 100, mount: Kind = "equatorial", latitude_deg: float = 40.0,
    lowest_deg: float = 25.0, flips: bool = True, sigma_arcsec: float = 60.0, seed: int = 0,
) -> MeasuredData:  # fmt: skip
    """Return `n` stars evenly spread over the sky (plan=sky) or along the meridian and one vertical (plan=cross)."""
    if not 3 <= n <= _MOST or not 0 <= lowest_deg < 85 or abs(latitude_deg) > 90:
        raise DataError(f"plan.n={n}, lowest_deg={lowest_deg:g}, latitude_deg={latitude_deg:g}: 3 stars or more, "
                        "a lowest elevation of 0 to 85 and a latitude of -90 to 90 degrees are needed")  # fmt: skip
    rng = np.random.default_rng(seed)
    lowest = np.radians(lowest_deg)
    if plan == "sky":
        azimuth = 2 * np.pi * rng.random(n)
        elevation = np.arcsin(rng.uniform(np.sin(lowest), 1.0, n))
    else:
        turn = np.linspace(lowest, np.pi - lowest, n)
        elevation, azimuth = np.minimum(turn, np.pi - turn), np.where(turn < np.pi / 2, 0.0, np.pi)
        azimuth = azimuth + np.where(np.arange(n) % 2, np.pi / 2, 0.0)
    t_s = 60 * _MINUTES * np.arange(n)
    if mount == "altaz":
        columns = {"az": azimuth, "el": elevation, "star_az": azimuth, "star_el": elevation, "t_s": t_s}
    else:
        latitude = np.radians(latitude_deg)
        north, east, up = geometry.direction(azimuth, elevation).T
        meridian = up * np.cos(latitude) - north * np.sin(latitude)
        pole = up * np.sin(latitude) + north * np.cos(latitude)
        hour, declination = geometry.angles(np.stack([meridian, -east, pole], axis=-1))
        over = flips & (hour < 0)
        ha, dec = np.where(over, hour + np.pi, hour), np.where(over, np.pi - declination, declination)
        columns = {"ha": ha, "dec": dec, "star_ha": hour, "star_dec": declination, "t_s": t_s}
    stated = {"machine": "mount", "mount": mount, "latitude_deg": latitude_deg, "sigma_arcsec": sigma_arcsec}
    return MeasuredData(columns, "mount", stated, f"{plan} of {n} stars")


_SIDEREAL = 86164.0905  # s of a turn of the sky
_STAR, _LEAST_SITE = 14, 6  # numbers in a line of a star, and in that of the site up to the date
_LATITUDE, _IN_DEGREES = 3, 4  # numbers of a latitude alone, and of a star in degrees
_FIRST_YEAR = 1900
_NUMBERS = f"a star needs {_STAR} numbers (its place, the mount's, sidereal time h m)"
_NEEDED = {"equatorial": _NUMBERS, "altaz": f"{_NUMBERS} or 4 in degrees (azimuth and elevation, the mount's)"}
_IGNORED = ("NODA", "ALLSKY", "EQUINOX")


def read_tpoint(text: str) -> Columns:
    """Return the observations of a file; raise `DataError` with the line and what is wrong in it."""
    kind, site, alone, stars, notes = "equatorial", None, None, [], []
    for number, line in enumerate(text.splitlines(), start=1):
        content = line.partition("!")[0].strip() if not line.lstrip().startswith("!") else ""
        if not content:
            continue
        if content.upper() == "END":
            break
        if content.startswith(":"):
            for option in content.replace(":", " ").upper().split():
                kind = {"EQUAT": "equatorial", "ALTAZ": "altaz"}.get(option, kind)
                if option not in ("EQUAT", "ALTAZ", *_IGNORED):
                    notes.append(Note(Code.FILE, f"line {number}: option :{option} is not read"))
            continue
        try:
            numbers: list[float] | None = [float(word) for word in content.split()]
        except ValueError:
            numbers = None
        if numbers is not None and not all(map(isfinite, numbers)):  # nan and inf are words
            numbers = None
        if site is None:
            if numbers is None:
                continue  # a caption
            # the line of the site: a star has more numbers, unless a year tells it
            dated = len(numbers) < _STAR or (numbers[3] >= _FIRST_YEAR and numbers[3] % 1 == 0)
            if len(numbers) >= _LEAST_SITE and dated:
                site = _latitude(content, number)
                continue
            whole = abs(numbers[0]) <= 90 and numbers[0] % 1 == 0 and all(0 <= value <= 60 for value in numbers[1:])
            if len(numbers) == _LATITUDE and whole:
                alone = _latitude(content, number)
                continue
            if alone is None or len(numbers) < _IN_DEGREES:
                if len(numbers) >= _STAR:
                    raise DataError(
                        f"line {number}: stands where the line of the site is needed (latitude d m s, then year month "
                        f"day), and has no year: {content[:60]}"
                    )
                continue  # a caption
            site = alone
        if numbers is None or len(numbers) < _IN_DEGREES:
            raise DataError(f"line {number}: {_NEEDED[kind]}: {content[:60]}")
        stars.append((content.split(), numbers, number))
    if site is None and alone is None:
        raise DataError("no line of the site: latitude (d m s), then year month day, is needed before the stars")
    if site is None or not stars:
        raise DataError("holds a header and no stars")
    # whether a star is four numbers in degrees, with or without auxiliary readings behind them
    words, numbers, _ = stars[0]
    parted = len(numbers) < _STAR and all("." in word for word in words[:_IN_DEGREES])
    in_degrees = kind == "altaz" and (len(numbers) == _IN_DEGREES or parted)
    for _, numbers, number in stars:
        if (len(numbers) < _STAR) != in_degrees:
            content = text.splitlines()[number - 1].strip()
            raise DataError(f"line {number}: {_NEEDED[kind]}, the same in all lines: {content[:60]}")
    if in_degrees:
        least = min(len(numbers) for _, numbers, _ in stars)
        read = np.array([numbers[:least] for _, numbers, _ in stars]).T
        names = ("star_az", "star_el", "az", "el")
        columns: dict[str, Any] = {name: np.radians(column) for name, column in zip(names, read)}
        columns |= {f"aux_{k + 1}": column for k, column in enumerate(read[_IN_DEGREES:])}
        return Columns(columns, {"mount": "altaz", "latitude_deg": site}, tuple(notes))
    return _columns(kind, site, stars, tuple(notes))


def _columns(kind: str, latitude: float, stars: list[Any], notes: tuple[Note, ...]) -> Columns:
    read = np.array([[_sexagesimal(words, values, k, line) for k in (0, 3, 6, 9)] for words, values, line in stars])

    # sidereal time is h m s where no minute has a part, and seconds follow, not all of them alike: time to the minute
    # would be 15 arcmin of the sky, and nobody points by it
    least = min(len(values) for _, values, _ in stars)
    seconds = least > _STAR and not any(values[13] % 1 for _, values, _ in stars)
    if seconds:
        last_cells = [values[_STAR] for _, values, _ in stars]
        seconds = all(0 <= value <= 60 for value in last_cells) and len(set(last_cells)) > 1
    hours = [v[12] + v[13] / 60 + (v[_STAR] / 3600 if seconds else 0.0) for _, v, _ in stars]
    sidereal = np.array(hours) * 15
    if seconds:
        text = "sidereal time stands in whole minutes with seconds behind: read as h m s"
        notes = (*notes, Note(Code.FILE, text))
    first = _STAR + seconds
    star = np.radians(np.stack([sidereal - 15 * read[:, 0], read[:, 1]]))
    roll = sidereal - 15 * read[:, 2] if kind == "equatorial" else read[:, 2]
    mount = np.radians(np.stack([roll, read[:, 3]]))
    names = ("ha", "dec") if kind == "equatorial" else ("az", "el")
    if kind == "altaz":  # azimuth (north through east) and elevation of hour angles and declinations
        x, y, z = geometry.direction(star[0], star[1]).T  # meridian, west, pole
        site = np.radians(latitude)
        north, up = z * np.cos(site) - x * np.sin(site), z * np.sin(site) + x * np.cos(site)
        star = np.stack(geometry.angles(np.stack([north, -y, up], axis=-1)))
    columns: dict[str, Any] = {names[0]: mount[0], names[1]: mount[1]}
    # the time since the first star [s]; the sidereal time [deg] may go round
    steps = (np.diff(sidereal, prepend=sidereal[0]) + 180) % 360 - 180
    columns |= {f"star_{names[0]}": star[0], f"star_{names[1]}": star[1], "t_s": (np.cumsum(steps) / 360 * _SIDEREAL)}
    for k in range(first, least):
        columns[f"aux_{k - first + 1}"] = np.array([values[k] for _, values, _ in stars])
    counted = {"azimuth": NORTH_EAST} if kind == "altaz" else {}  # as that of the star, which its place tells
    return Columns(columns, {"mount": kind, "latitude_deg": latitude, **counted}, notes)


def _latitude(text: str, line: int) -> float:
    words = text.split()
    latitude = _sexagesimal(words, [float(word) for word in words], 0, line)
    if not abs(latitude) <= 90:
        raise DataError(f"line {line}: latitude {latitude:g} degrees: -90 to 90 is needed")
    return latitude


def _sexagesimal(words: list[str], values: list[float], k: int, line: int) -> float:
    """Return the number that three words make; the sign of the first holds for all (-00 30 00 is -.5)."""
    minutes, seconds = values[k + 1], values[k + 2]
    if not (0 <= minutes < 60 and 0 <= seconds <= 60):
        raise DataError(f"line {line}: {' '.join(words[k : k + 3])}: minutes and seconds below 60 are needed")
    size = abs(values[k]) + minutes / 60 + seconds / 3600
    return -size if re.match(r"-", words[k]) else size


_COLUMNS = (
    *(
        Quantity(f"{star}{name}", "rad", f"{words}{' of the star' if star else ''}")
        for kind in AXES
        for star in ("", "star_")
        for name, words in zip(AXES[kind], NAMED[kind])
    ),
    Quantity("pier_side", text=True),
    Quantity("t_s", "s", "time"),
    *(
        Quantity(f"dir_{name}", "", f"direction of the {words} axis")
        for kind in AXES
        for name, words in zip(AXES[kind], NAMED[kind])
    ),
    Quantity("temp_K", "K", "temperature above reference"),
    Quantity("split", text=True),
)
_ERRORS = {"dX": "error on the sky, east-west", "dDec": "error on the sky, north-south",
           "dS": "error on the sky, left-right", "dEl": "error on the sky, up-down"}  # fmt: skip
_GEOMETRY = {
    "IH": "index error in hour angle", "ID": "index error in declination", "IA": "index error in azimuth",
    "IE": "index error in elevation", "CH": "collimation, east-west", "CA": "collimation, left-right",
    "NP": "axes that are not perpendicular", "NPAE": "axes that are not perpendicular",
    "MA": "polar axis off in azimuth", "ME": "polar axis off in elevation",
    "AN": "azimuth axis leans to the north", "AW": "azimuth axis leans to the west",
}  # fmt: skip
_QUANTITIES = (
    *(Quantity(name, "arcsec", _ERRORS[name]) for pair in ERRORS.values() for name in pair),
    *(Quantity(name, "arcsec", _GEOMETRY[name]) for kind in TURNS.values() for name in kind),
    *(Quantity(name, "arcsec") for name in ("TF", "TX")),
    *(Quantity(name, "rad", f"place on the sky, {which} axis") for name, which in zip(FRAME, ("first", "second"))),
    Quantity("side", "", "side of the pier"),
)
# general families that a mount does without: its own terms (PHH, HCES, HHSH2, the geometry) say the same under the
# names of the field, and there are no columns for torque and velocity, nor stars close enough to tell teeth
_REPLACED = ("compliance", "lag", "cyclic", "gear", "eccentricity", "second_harmonic", "angle_error", "free_number",
             "polynomial", "cycle", *PERIODIC)  # fmt: skip

describe(
    "mount",
    Description(
        columns=_COLUMNS,
        quantities=_QUANTITIES,
        stated=(Stated("sigma_arcsec", "positive"), *(Stated(key) for key in ("latitude_deg", "mount", "azimuth"))),
        plan=planned,
        targets={TARGET: ""},
        replaced=_REPLACED,
        files={".dat": read_tpoint},
        corrected=pointing_model,
        orders={"side": "side of the pier"},
        read_from=tuple(f"{of}{name}" for kind in AXES.values() for of in ("", "star_") for name in kind),
    ),
)
