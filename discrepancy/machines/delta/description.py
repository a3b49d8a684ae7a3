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
    "second_harmonic",
    "angle_error",
    "cyclic",
    *PERIODIC,
    "lag",
    "compliance",
)
_SHARES = ("scale", "tilt", "shrink")


def _unit(name: str) -> str:
    return "rad" if name.startswith(_ANGLES) else "1" if name.startswith(_SHARES) else "mm"


describe(
    "delta",
    Description(
        columns=_COLUMNS,
        quantities=tuple(
            Quantity(name, _unit(name), f"endstop of tower {name[-1]}" if name.startswith("endstop") else "")
            for name in (*NOMINAL, *IMPERFECTIONS)
        ),
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
