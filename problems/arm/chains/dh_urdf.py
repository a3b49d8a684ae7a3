"""A table of Denavit and Hartenberg as a URDF: the same arm for ROS and simulators, without meshes or masses."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import ceil, floor
from xml.sax.saxutils import quoteattr

import numpy as np

from calibench.problems.arm.chains.chain import ChainJoint
from calibench.problems.arm.chains.dh_table import BASE, TIP, DhTable
from calibench.problems.arm.chains.rigid import rpy_of
from calibench.problems.base import Array

_MM = 1e-3  # metres
_FREE = 1.0  # metres that a joint without a stop slides, either way


def urdf_of_dh(table: DhTable, said: str = "", used: Mapping[str, tuple[float, float]] | None = None) -> str:
    """Return the URDF of a table, from `base` to `flange`, with a comment that says `said`.

    Joints with limits are revolute, those without continuous. What a table does not tell and a URDF needs, effort and
    velocity, is 0. A joint that slides without a stop goes as far as it was `used`, name -> (least, most) [mm], or a
    metre either way, as a URDF must have limits for it; a comment says so. In names stand letters, digits, _ and -
    only, as ROS wants them; others become _.
    """
    chain = table.chain
    used, named = used or {}, _names(chain.driven)
    lines = [f"<robot name={quoteattr(table.name)}>"]
    lines += [f"  <!-- {said.replace('--', '- -')} -->"] if said else []
    lines += [
        f"  <!-- from a {table.form} table of Denavit and Hartenberg; effort and velocity are not known, and 0 -->",
    ]
    for name in (joint.name for joint in chain.joints if _slides_freely(joint)):
        stand = "the range of its readings stands" if name in used else f"{_FREE:g} m either way stand"
        lines.append(f"  <!-- the table has no limits of {name.replace('--', '- -')}: {stand} for them -->")
    lines.append(f'  <link name="{BASE}"/>')
    above = BASE
    for joint in chain.joints:
        below = f"{named[joint.name]}_link"
        lines += [
            f'  <link name="{below}"/>',
            f'  <joint name="{named[joint.name]}" type="{_type(joint)}">',
            f'    <parent link="{above}"/><child link="{below}"/>',
            _origin(joint.origin),
            '    <axis xyz="0 0 1"/>',
            *_limit(joint, used),
            "  </joint>",
        ]
        above = below
    lines += [
        f'  <link name="{TIP}"/>',
        f'  <joint name="{_free(f"{TIP}_joint", list(named.values()))}" type="fixed">',
        f'    <parent link="{above}"/><child link="{TIP}"/>',
        _origin(chain.tail),
        "  </joint>",
        "</robot>",
    ]
    return "\n".join(lines) + "\n"


def _names(joints: Sequence[str]) -> dict[str, str]:
    """Return each joint's name in the URDF."""
    found: dict[str, str] = {}
    for name in joints:
        found[name] = _free(re.sub(r"[^A-Za-z0-9_-]", "_", name), list(found.values()))
    return found


def _free(name: str, taken: Sequence[str]) -> str:
    """Return a name that is not `taken`."""
    return _free(f"{name}_", taken) if name in taken else name


def _type(joint: ChainJoint) -> str:
    if joint.kind == "sliding":
        return "prismatic"
    return "revolute" if np.isfinite(joint.upper - joint.lower) else "continuous"


def _slides_freely(joint: ChainJoint) -> bool:
    return joint.kind == "sliding" and not np.isfinite(joint.upper - joint.lower)


def _limit(joint: ChainJoint, used: Mapping[str, tuple[float, float]]) -> list[str]:
    scale = _MM if joint.kind == "sliding" else 1.0
    sides = (scale * joint.lower, scale * joint.upper)
    if _slides_freely(joint):
        least, most = used.get(joint.name, (-_FREE / _MM, _FREE / _MM))
        sides = (_MM * floor(least), _MM * ceil(most))
    elif not np.isfinite(sides).all():
        return []
    return [f'    <limit lower="{sides[0]:.12g}" upper="{sides[1]:.12g}" effort="0" velocity="0"/>']


def _origin(origin: Array) -> str:
    xyz = " ".join(_number(_MM * v) for v in origin[:3, 3])
    rpy = " ".join(_number(v) for v in rpy_of(origin))
    return f'    <origin xyz="{xyz}" rpy="{rpy}"/>'


def _number(value: float) -> str:
    """Return a number with the digits of a picometre or a picoradian, and no more."""
    return f"{round(float(value), 12) + 0.0:.12g}"
