"""Torques of gravity on an arm's joints in each row of a table, from the masses of its URDF and the row's payload."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from calibench.core.notes import Code
from calibench.discrepancy.machines.arm.geometry import READING, Stand, walk
from calibench.discrepancy.machines.arm.loads import GRAVITY, ROD, as_rods, moments
from calibench.discrepancy.machines.arm.validate import PAYLOAD, stated_number
from calibench.discrepancy.model.measured import DataError, MeasuredData
from calibench.problems.arm.chains.chain import Chain
from calibench.problems.base import Array

_WEIGHTLESS = (
    "the {told} tells no masses and the file no payload_kg: for what gravity bends each link is taken for a rod of "
    f"{ROD:g} kg a metre, so the size of a compliance or a bending is a guess, and either may stand under an "
    "eccentricity, a harmonic or an angle error of the same joint; {way_out}"
)
_WAY_OUT = {"URDF": "write masses into the URDF", "table": "a URDF has a place for masses"}


def with_loads(chain: Chain, stand: Stand, start: Mapping[str, float], data: MeasuredData) -> MeasuredData:
    """Return the data with the torques that vary, and a note where no mass is told."""
    held = torques(chain, stand, start, data)
    if held and weightless(chain, data):
        text = _WEIGHTLESS.format(told=chain.told, way_out=_WAY_OUT[chain.told])
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
    told = data[PAYLOAD] if PAYLOAD in data else np.full(len(data), stated_number(data.metadata, PAYLOAD, 0.0))
    payload = np.where(np.isnan(told), 0.0, np.asarray(told, dtype=float))
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
