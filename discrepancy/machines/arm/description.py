"""What an arm declares for files, commands and pages: columns that every arm has, what may be stated, words."""

from __future__ import annotations

from calibench.discrepancy.machines.arm.formulation import AIM, TURNED
from calibench.discrepancy.machines.arm.geometry import BASE, PLACE, TOOL, TURNS
from calibench.discrepancy.machines.arm.turns import QUATERNION
from calibench.discrepancy.machines.arm.validate import PAYLOAD, ROW, SITE, SOCKET, WARMTH
from calibench.discrepancy.model.description import Description, Quantity, Stated
from calibench.discrepancy.registries import describe

_COLUMNS = (
    *(Quantity(name, "mm", f"the tracker's {name}") for name in PLACE),
    *(Quantity(name, "rad", f"measured turn {name}") for name in TURNS),
    *(Quantity(name, "1") for name in QUATERNION),
    Quantity("t_s", "s", "time"),
    Quantity("temperature_C", "K", "temperature"),
    Quantity(WARMTH, "K", "temperature above its middle"),
    Quantity(PAYLOAD, "kg", "payload"),
    Quantity(SOCKET, "", "socket", text=True),
    Quantity(SITE, "", "place", text=True),
    Quantity("split", text=True),
)
_QUANTITIES = (
    *(Quantity(name, "mm" if name[-1] in PLACE and "_r" not in name else "rad") for name in (*BASE, *TOOL)),
    *(Quantity(name, "mrad", f"the tracker's {name}") for name in TURNED),
    *(Quantity(name, "rad") for name in AIM),
    Quantity(ROW, "", "row"),
)
# held numbers are those that the readings do not tell from others; frames move as bodies: base_drift and base_shift
_REPLACED = ("free_number", "frame_drift", "frame_shift")

describe(
    "arm",
    Description(
        columns=_COLUMNS,
        quantities=_QUANTITIES,
        stated=(
            Stated("sigma_mm", "positive"),
            Stated("sigma_mrad", "positive"),
            Stated("teeth"),
            Stated("gravity", "list", "gravity=[0,0,-9.81]"),
            Stated("rotation"),
            Stated("socket_distance_mm", "positive"),
            Stated(PAYLOAD),
            Stated("urdf"),
        ),
        targets={"base": "the base", "tool": "the tool"},
        replaced=_REPLACED,
    ),
)
