"""What a telescope mount declares for files, commands and pages: columns, words, formats, plans, what ships."""

from __future__ import annotations

from pathlib import Path

from calibench.discrepancy.effects.general.waves import PERIODIC
from calibench.discrepancy.machines.mount.coefficients import pointing_model
from calibench.discrepancy.machines.mount.effects import TARGET
from calibench.discrepancy.machines.mount.geometry import TURNS
from calibench.discrepancy.machines.mount.plan import planned
from calibench.discrepancy.machines.mount.tpoint import read_tpoint
from calibench.discrepancy.machines.mount.validate import AXES, ERRORS, FRAME, NAMED
from calibench.discrepancy.model.description import Description, Quantity, Stated
from calibench.discrepancy.registries import describe

_COLUMNS = (
    Quantity("ha", "rad", "hour angle"),
    Quantity("dec", "rad", "declination"),
    Quantity("star_ha", "rad", "hour angle of the star"),
    Quantity("star_dec", "rad", "declination of the star"),
    Quantity("az", "rad", "azimuth"),
    Quantity("el", "rad", "elevation"),
    Quantity("star_az", "rad", "azimuth of the star"),
    Quantity("star_el", "rad", "elevation of the star"),
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
_REPLACED = (
    "compliance",
    "lag",
    "cyclic",
    "gear",
    "eccentricity",
    "second_harmonic",
    "angle_error",
    "free_number",
    "polynomial",
    "cycle",
    *PERIODIC,
)

describe(
    "mount",
    Description(
        columns=_COLUMNS,
        quantities=_QUANTITIES,
        stated=(
            Stated("sigma_arcsec", "positive"),
            Stated("latitude_deg"),
            Stated("mount"),
            Stated("azimuth"),
        ),
        plan=planned,
        demonstrations=Path(__file__).resolve().parents[2] / "demo" / "mount",
        targets={TARGET: ""},
        replaced=_REPLACED,
        files={".dat": read_tpoint},
        corrected=pointing_model,
    ),
)
