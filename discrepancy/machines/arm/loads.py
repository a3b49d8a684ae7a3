"""The moment of gravity on each joint, of everything beyond it, from masses, pose and payload of each row.

The masses and centres are the URDF's; the payload hangs at the target. Gravity is along `gravity` [m/s2] in the frame
of the base, down its z where nothing else is stated. The moment (n, 3) [N mm] is given in the frame of the joint before
it moves: its part along the axis loads the drive, the rest bends bearing and link. Where no mass is known, each link is
taken for a uniform rod: then the moment depends on the pose nearly as it should, and its size is a guess.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from calibench.calibration.kinematics import Chain
from calibench.calibration.rigid import Array, cross
from calibench.calibration.walk import READING, Stand, Walk, walk
from calibench.core.notes import Code
from calibench.discrepancy.machines.arm.readings import PAYLOAD, stated_number
from calibench.discrepancy.model.measured import DataError, MeasuredData

GRAVITY = (0.0, 0.0, -9.81)  # m/s2
ROD = 10.0  # kg a metre: what links of which no mass is told are taken to weigh
_WEIGHTLESS = (
    "the {source} tells no masses and the file no payload_kg: for what gravity bends each link is taken for a rod of "
    f"{ROD:g} kg a metre, so the size of a compliance or a bending is a guess, and either may stand under an "
    "eccentricity, a harmonic or an angle error of the same joint; {way_out}"
)
_WAY_OUT = {"URDF": "write masses into the URDF", "table": "a URDF has a place for masses"}


def with_loads(chain: Chain, stand: Stand, start: Mapping[str, float], data: MeasuredData) -> MeasuredData:
    """Return the data with the torques that vary, and a note where no mass is told."""
    held = torques(chain, stand, start, data)
    if held and weightless(chain, data):
        text = _WEIGHTLESS.format(source=chain.source, way_out=_WAY_OUT[chain.source])
        data = data.with_note(Code.MASSES_UNKNOWN, text)
    rounding = 1e-9 * max((float(np.max(np.abs(c))) for c in held.values()), default=0.0)
    vary = {name: c for name, c in held.items() if np.ptp(c) > rounding}
    return replace(data.with_columns(vary), computed=data.computed | set(vary))


def torques(chain: Chain, stand: Stand, start: Mapping[str, float], data: MeasuredData) -> dict[str, Array]:
    """Return `torque_J` [N mm] of each driven joint that gravity asks of it, where none was measured."""
    held = loads(chain, stand, start, data)
    gains, _ = chain.following
    return {
        f"torque_{name}": sum(
            gains[k, i] * (held[:, k] @ joint.axis)
            for k, joint in enumerate(chain.joints)
            if gains[k, i] and joint.kind == "rotary"
        )
        + np.zeros(len(data))
        for i, name in enumerate(chain.driven)
        if f"torque_{name}" not in data
    }


def loads(chain: Chain, stand: Stand, start: Mapping[str, float], data: MeasuredData) -> Array:
    """Return the moments on the joints, (n, J, 3) [N mm].

    Links are rods where neither masses nor a payload are stated.
    """
    q: dict[str, Any] = dict(start) | {READING + n: data[READING + n] for n in chain.driven}
    heavy = as_rods(chain) if weightless(chain, data) else chain
    return moments(heavy, walk(chain, stand, q), stand.turned, payload_of(data), gravity_of(data))


def weightless(chain: Chain, data: MeasuredData) -> bool:
    """Tell whether gravity has nothing to act on: neither masses nor a payload are stated."""
    return all(j.mass is None for j in chain.joints) and not payload_of(data).any()


def payload_of(data: MeasuredData) -> Array:
    """Return the payload of each row, (n,) [kg]: its column, in which an empty cell is none, or what is stated of all.

    Raises `DataError` for a payload that is stated beside a column of it, and for one that is below 0 or infinite.
    """
    if PAYLOAD in data and PAYLOAD in data.stated:
        raise DataError(f"{data.name}: {PAYLOAD}= is stated, and the file has a column of it; leave one out")
    stated = data[PAYLOAD] if PAYLOAD in data else np.full(len(data), stated_number(data.metadata, PAYLOAD, 0.0))
    payload = np.where(np.isnan(stated), 0.0, np.asarray(stated, dtype=float))
    wrong = ~((payload >= 0) & (payload < np.inf))
    if wrong.any():
        raise DataError(f"{data.name}: {PAYLOAD} is {payload[wrong][0]:g}: 0 kg or more is needed")
    return payload


def gravity_of(data: MeasuredData) -> Array:
    """Return gravity in the frame of the base, (3,) [m/s2]; raise `DataError` for a value that is not a direction."""
    stated = data.metadata.get("gravity", GRAVITY)
    try:
        pull = np.asarray(stated, dtype=float)
    except (TypeError, ValueError):
        pull = np.zeros(0)
    if pull.shape != (3,) or not 0 < np.linalg.norm(pull) < np.inf:
        raise DataError(f"{data.name}: gravity={stated}: three numbers [m/s2] in the frame of the base are needed")
    return pull


def moments(chain: Chain, way: Walk, turned: Array, payload: Array, gravity: Array) -> Array:
    """Return the moments on the joints, (n, J, 3) [N mm], in each joint's own frame.

    A link without a stated mass has none. `turned`, (3, 3), is the base in the frame of `way`.
    """
    pull = turned @ gravity  # m/s2, in the tracker's frame
    n = len(way.target)
    weights: list[tuple[Array, Array]] = []  # of each moving body: mass (n,) and place (n, 3)
    turns = [*way.frames[1:], way.flange]
    for k, joint in enumerate(chain.joints):
        if joint.mass is None or joint.centre is None:
            weights.append((np.zeros(n), way.target))
            continue
        turn, place = _moved(chain, k, turns[k])
        weights.append((np.full(n, joint.mass), place + turn @ joint.centre))
    weights.append((payload, way.target))
    on_joints = np.zeros((n, len(chain.joints), 3))
    for k in range(len(chain.joints)):
        turn, place = way.frames[k]
        held = np.zeros((n, 3))
        for mass, centre in weights[k:]:
            held -= cross(centre - place, mass[:, None] * pull)
        on_joints[:, k] = np.einsum("...ji,...j->...i", turn, held)
    return on_joints


def as_rods(chain: Chain) -> Chain:
    """Return the chain with each link as an even rod of `ROD`, from its joint to the next one, or to the tip."""
    ways = [*(joint.origin for joint in chain.joints[1:]), chain.tail]
    joints = tuple(
        replace(joint, mass=ROD * float(np.linalg.norm(way[:3, 3])) / 1e3, centre=way[:3, 3] / 2)
        for joint, way in zip(chain.joints, ways, strict=True)
    )
    return replace(chain, joints=joints)


def _moved(chain: Chain, k: int, following: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the frame that moves with joint k, from that of the next joint before it moves, or of the flange."""
    turn, place = following
    fixed = chain.joints[k + 1].origin if k + 1 < len(chain.joints) else chain.tail
    turn = turn @ fixed[:3, :3].T
    return turn, place - turn @ fixed[:3, 3]
