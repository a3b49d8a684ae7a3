"""What an arm declares for files, commands and pages: columns that every arm has, what may be stated, words."""

from __future__ import annotations

from calibench.calibration.walk import PLACE, TURNS
from calibench.discrepancy.machines.arm.formulation import AIM, DEMONSTRATIONS, TURNED
from calibench.discrepancy.machines.arm.readings import PAYLOAD, QUATERNION, ROW, SITE, SOCKET, WARMTH
from calibench.discrepancy.model.machine import Description, Quantity, Stated
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
_WAYS = dict(
    zip(
        (*PLACE, *TURNS),
        ("place along x", "place along y", "place along z", "turn about x", "turn about y", "turn about z"),
    )
)
_BODIES = tuple(
    Quantity(f"{body}_{one}", "mm" if one in PLACE else "rad", f"{body}: {words}")
    for body in ("base", "tool")
    for one, words in _WAYS.items()
)
_OF_A_JOINT = {  # before the name of a joint: unit and words; what its reading is depends on its role
    **{f"{one}_": ("mm" if one in PLACE else "rad", f"{words} of") for one, words in _WAYS.items()},
    "zero_": ("rad", "zero of"), "length_": ("mm", "length of the link to"), "q_": ("", ""),
    "direction_": ("", "direction of"), "velocity_": ("rad/s", "velocity of"), "torque_": ("N mm", "torque of"),
    "pair": ("mm", "sockets"), "socket": ("mm", "socket"),
}  # fmt: skip
_QUANTITIES = (
    *_BODIES,
    *(Quantity(name, "mrad", f"the tool's turn about {one}, as measured") for name, one in zip(TURNED, PLACE)),
    *(Quantity(name, "rad", f"the tool's turn about {one}") for name, one in zip(AIM, PLACE)),
    Quantity(ROW, "", "row"),
)
# held numbers are those that the readings do not tell from others; frames move as bodies: base_drift and base_shift
_REPLACED = ("free_number", "frame_drift", "frame_shift")


def _named(name: str) -> Quantity | None:
    """Return what a quantity is whose name ends with that of a joint, or of a socket."""
    for begins, (unit, words) in _OF_A_JOINT.items():
        if name.startswith(begins) and len(name) > len(begins):
            rest = name.removeprefix(begins)
            if begins in ("pair", "socket"):
                return Quantity(
                    name, "rad" if rest.endswith(("_u", "_v")) else unit, f"{words} {rest.replace('_', ', ')}"
                )
            return Quantity(name, unit, f"{words} {rest}" if words else "", rest if begins in _OWN else "")
    return None


_OWN = ("direction_", "velocity_", "torque_")
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
            Stated("dh"),
            Stated("convention"),
        ),
        targets={"base": "the base", "tool": "the tool"},
        replaced=_REPLACED,
        demonstrations=DEMONSTRATIONS,
        named=_named,
    ),
)
