"""What the GPM2002 is made of: three driven joints with encoders, six links, a clock, a thermometer, a tracker."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calibench.discrepancy.model.roles import Instrument, Joint, Length, Roles

JOINTS = ("joint 1", "joint 2", "joint 3")
LEGS = ("leg 1", "leg 2", "leg 3")


def joint_of(leg: str) -> str:
    """Return the joint that drives a leg."""
    return JOINTS[LEGS.index(leg)]


def distal(leg: str) -> str:
    """Return the name of the distal link of a leg."""
    return f"distal link {LEGS.index(leg) + 1}"


def roles_of(metadata: Mapping[str, Any], tracked: bool) -> Roles:
    """Return the roles; tooth numbers are those that are stated of the data."""
    joints = tuple(
        Joint(
            name, f"enc_{i}", direction=f"dir_{i}", velocity=f"vel_{i}", torque=f"tau_{i}", teeth=teeth_of(metadata, i)
        )
        for i, name in enumerate(JOINTS, start=1)
    )
    proximal = tuple(Length(f"proximal link {i}", f"la{i}") for i in (1, 2, 3))
    links = tuple(Length(f"distal link {i}", f"lb{i}", force=f"axial_{i}") for i in (1, 2, 3))
    tracker = (Instrument("tracker", ("x", "y")),) if tracked else ()
    return Roles(joints, (*proximal, *links), "t_s", "temp_K", tracker)


def teeth_of(metadata: Mapping[str, Any], i: int) -> float:
    """Return the tooth number of joint i: from a list, a mapping (`1`, `joint 1`, `enc_1`) or one number for all.

    0 where none is stated.
    """
    stated = metadata.get("tooth_numbers")
    if isinstance(stated, Mapping):
        stated = next((stated[key] for key in (str(i), f"joint {i}", f"enc_{i}") if key in stated), None)
    elif isinstance(stated, list | tuple | np.ndarray):
        stated = stated[i - 1] if len(stated) >= i else None
    try:
        teeth = float(stated) if stated is not None else 0.0
    except (TypeError, ValueError):
        teeth = 0.0
    return teeth if np.isfinite(teeth) and teeth > 0 else 0.0
