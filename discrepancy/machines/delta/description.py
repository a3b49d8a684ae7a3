"""What the delta declares for files, commands and pages: columns, words, what may be stated."""

from __future__ import annotations

from pathlib import Path

from calibench.discrepancy.effects.general.waves import PERIODIC
from calibench.discrepancy.machines.delta.correction import corrected
from calibench.discrepancy.machines.delta.kinematics import IMPERFECTIONS, TOWERS
from calibench.discrepancy.machines.delta.plan import planned
from calibench.discrepancy.machines.delta.printer_cfg import read_printer_cfg
from calibench.discrepancy.machines.delta.validate import NOMINAL
from calibench.discrepancy.model.description import Description, Quantity, Stated
from calibench.discrepancy.registries import describe

_ENDS = ("", "_2")
_COLUMNS = (
    Quantity("kind", text=True),
    Quantity("height", "mm", "height at the probe's trigger"),
    Quantity("distance", "mm", "distance by caliper"),
    *(Quantity(f"travel_{t}{end}", "mm", f"travel of tower {t}") for end in _ENDS for t in TOWERS),
    *(Quantity(f"steps_{t}{end}", "1", f"steps of tower {t}") for end in _ENDS for t in TOWERS),
    *(Quantity(f"direction_{t}", "", f"direction of tower {t}", f"tower {t}") for t in TOWERS),
    Quantity("t_s", "s", "time"),
    Quantity("temp_K", "K", "temperature above reference"),
)
_ANGLES = ("angle", "d_angle", "lean", "bed_x", "bed_y")
# belt_scale, and of each number that is held a family of its own; a belt has no turn
_REPLACED = (
    "gear",
    "free_number",
    "eccentricity",
    "screw_error",
    "second_harmonic",
    "angle_error",
    "position_error",
    "cyclic",
    *PERIODIC,
    "lag",
    "compliance",
)
_SHARES = ("scale", "tilt", "shrink")


_WORDS = {
    "radius": "delta radius", "arm": "rod length", "endstop": "endstop", "bed_radius": "radius of the bed",
    "angle": "angle", "d_radius": "delta radius", "d_rod": "rod length", "scale": "belt scale", "zero": "zero",
    "tilt_out": "effector tilt, outward", "tilt_skew_x": "effector tilt, skewed along x",
    "tilt_skew_y": "effector tilt, skewed along y", "bed_x": "tilt of the bed along x",
    "bed_y": "tilt of the bed along y", "dome": "height of the dome", "caliper": "caliper offset",
    "shrink": "shrinkage of the print",
}  # fmt: skip
_OF_A_TOWER = {**_WORDS, "d_radius": "radius", "d_angle": "angle", "lean": "lean"}
_WAYS = {"out": " outward", "side": " to the side"}


def _words(name: str) -> str:
    """Return a number of the printer in words: `angle of tower b`, `lean of tower a outward`."""
    if name in _WORDS:
        return _WORDS[name]
    head, _, way = name.rpartition("_") if name.endswith(tuple(_WAYS)) else (name, "", "")
    what, _, tower = head.rpartition("_")
    return f"{_OF_A_TOWER[what]} of tower {tower}{_WAYS.get(way, '')}"


def _unit(name: str) -> str:
    return "rad" if name.startswith(_ANGLES) else "1" if name.startswith(_SHARES) else "mm"


describe(
    "delta",
    Description(
        columns=_COLUMNS,
        quantities=tuple(Quantity(name, _unit(name), _words(name)) for name in (*NOMINAL, *IMPERFECTIONS)),
        stated=(
            Stated("sigma_height", "positive"),
            Stated("sigma_distance", "positive"),
            Stated("steps_per_mm"),
            Stated("nominal", "names", 'nominal={"radius":161.75,"arm":345}'),
        ),
        files={".cfg": read_printer_cfg},
        replaced=_REPLACED,
        corrected=corrected,
        plan=planned,
        demonstrations=Path(__file__).resolve().parents[2] / "demo" / "delta",
        targets={"outward": "outward", "skewed": "skewed"},
    ),
)
