"""How `arm_ur10`, `arm_panda` and `arm` are made from chosen options (`families`): measured, or drawn."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from calibench.calibration.compared import Compared, positions, sockets
from calibench.calibration.compared import poses as of_poses
from calibench.calibration.determined import gauge
from calibench.calibration.dh_file import read_dh
from calibench.calibration.kinematics import Chain, parameter_names, parameter_units
from calibench.calibration.readings import Readings
from calibench.calibration.rigid import Index
from calibench.calibration.urdf import read_urdf
from calibench.problems.arm.calibration import ArmCalibration
from calibench.problems.arm.instances import ArmInstance, arm_instance
from calibench.problems.arm.measured import read_measured, shipped
from calibench.problems.base import Parameter
from calibench.problems.instances import check_instance, refuse_drawn

HALF = {"mm": 8.0, "rad": 0.06}  # of the box about the nominal arm; arms are wrong by some mm and mrad
GAP = 50.0  # mm between the two sockets of the tool
GAP_WEIGHT = 3.0  # a distance between sockets was measured once, and better than the ball sits


def measured_problem(
    name: str, given: Mapping[str, Any], chain: Chain, readings: Readings, reads: str,
    gap: tuple[float, float] = (0.0, 1.0),
) -> ArmCalibration:  # fmt: skip
    """Return the problem of measured postures: rows that are held are kept back, what is not determined is held.

    `gap` is the known distance [mm] of two sockets of a place (0: unknown) and its weight.
    """
    seen = compared(readings.where(readings.train), reads, gap)
    held = compared(readings.where(~readings.train), "position" if reads == "pose" else reads, gap)
    kept = gauge(chain, seen).kept
    units = dict(zip(parameter_names(chain), parameter_units(chain), strict=True))
    rows = [Parameter(n, units[n], 0.0, -HALF[units[n]], HALF[units[n]]) for n in kept]
    limit = given["robust"] if given["robust"] > 0 else np.inf
    return ArmCalibration(
        name=name, options=given, chain=chain, seen=seen, parameters=tuple(rows), held=held if len(held.q) else None,
        robust=limit,
    )  # fmt: skip


def of_own(given: Mapping[str, Any], file: Path) -> ArmCalibration:
    """Return the problem of a user's own arm, described in `file`, and of the postures in ``given["data"]``."""
    chosen, data = dict(given), Path(given["data"])
    if "dh" in chosen:
        chain = read_dh(file, chosen.get("convention", ""), "problem.").chain
    else:
        chain = read_urdf(file, "problem.").chain(chosen["base"], chosen["tip"])
    begin = read_measured(data, chain, chosen["rotation"], sockets=chosen["reads"] == "sockets", by_train=False)
    reads = _reads(chosen["reads"], begin.readings)
    chain = chain.placed(None if begin.readings.position is None else begin.base, begin.tool)
    if "dh" in chosen:
        chosen = {key: value for key, value in chosen.items() if key not in ("urdf", "base", "tip")}
    described = "dh" if "dh" in chosen else "urdf"
    options = chosen | {described: file.name, "data": data.name}  # no path of this machine in a row
    return measured_problem("arm", options, chain, begin.readings, reads, (chosen["gap"], GAP_WEIGHT))


def compared(readings: Readings, reads: str, gap: tuple[float, float] = (0.0, 1.0)) -> Compared:
    """Return what of `readings` is compared: position, pose, or sockets."""
    if reads == "sockets":
        numbers = {old: new for new, old in enumerate(dict.fromkeys(readings.socket.tolist()))}
        socket = np.array([numbers[s] for s in readings.socket.tolist()], dtype=np.int64)
        return sockets(readings.joints, socket, _gaps(socket, readings.place, gap[0]), gap[1])
    assert readings.position is not None
    if reads == "position":
        return positions(readings.joints, readings.position)
    assert readings.turns is not None
    pose = np.tile(np.eye(4), (len(readings), 1, 1))
    pose[:, :3, 3], pose[:, :3, :3] = readings.position, readings.turns
    return of_poses(readings.joints, pose)


def _gaps(socket: Index, site: Index, gap: float) -> tuple[tuple[int, int, float], ...]:
    """Return the known distances: between the two sockets of each place."""
    if gap <= 0:
        return ()
    gaps = []
    for one in dict.fromkeys(site.tolist()):
        both = list(dict.fromkeys(socket[site == one].tolist()))
        if len(both) == 2:
            gaps.append((both[0], both[1], gap))
    return tuple(gaps)


def _reads(asked: str, readings: Readings) -> str:
    there = {
        "pose": readings.turns is not None,
        "position": readings.position is not None,
        "sockets": readings.observed == "sockets",
    }
    if asked == "auto":
        return next(kind for kind, is_there in there.items() if is_there)
    if not there[asked]:
        columns = {"pose": "x y z and rx ry rz", "position": "x y z", "sockets": "socket"}[asked]
        raise ValueError(f"arm.reads={asked}: the file has no columns {columns}; leave reads out, or add them")
    return asked


@lru_cache(maxsize=32)  # a problem is a value, and reading it takes a thousand times as long as a call
def of_ur10(given: tuple[tuple[str, Any], ...]) -> ArmCalibration:
    chosen = dict(given)
    chain = read_urdf(shipped("ur10.urdf")).chain()
    begin = read_measured(shipped(f"ur10_{chosen['series'].lower()}.csv"), chain, "xyz")
    return measured_problem("arm_ur10", chosen, chain.placed(begin.base, begin.tool), begin.readings, chosen["reads"])


@lru_cache(maxsize=32)
def of_panda(given: tuple[tuple[str, Any], ...]) -> ArmCalibration:
    chain = read_urdf(shipped("panda.urdf")).chain(tip="ball_link")
    begin = read_measured(shipped("panda_sockets.csv"), chain)
    return measured_problem("arm_panda", dict(given), chain, begin.readings, "sockets", (GAP, GAP_WEIGHT))


def simulated(name: str, chosen: dict[str, Any]) -> ArmCalibration:
    """Return the problem that the instance draws: another arm of the kind, its errors, postures, noise and box."""
    instance: int = chosen["instance"]
    check_instance(name, instance)
    given = {key: None if key == "series" else value for key, value in chosen.items()}  # so rows say: of none
    return _drawn(name, tuple(sorted(given.items())))


@lru_cache(maxsize=256)
def _drawn(name: str, given: tuple[tuple[str, Any], ...]) -> ArmCalibration:
    chosen = dict(given)
    reads = chosen.get("reads", "sockets")
    drawn = arm_instance(name, chosen["instance"], reads, lambda one: _taken(name, chosen, one, exact=True))
    refuse_drawn(name, chosen["instance"], {}, drawn.options)
    return _taken(name, chosen | drawn.options, drawn, exact=False)


def _taken(name: str, says: dict[str, Any], drawn: ArmInstance, exact: bool) -> ArmCalibration:
    units = dict(zip(parameter_names(drawn.chain), parameter_units(drawn.chain), strict=True))
    box = zip(drawn.names, drawn.box.lower.tolist(), drawn.box.upper.tolist(), drawn.box.truth.tolist(), strict=True)
    rows = tuple(
        Parameter(name=n, unit=units[n], start=0.0, lower=low, upper=high, true=true) for n, low, high, true in box
    )
    limit = says["robust"] if says.get("robust", 0.0) > 0 else np.inf
    noise = 0.0 if exact else drawn.noise.level
    return ArmCalibration(
        name=name, options=says, chain=drawn.chain, seen=drawn.read(noise), parameters=rows, held=None, robust=limit,
        noise=noise, drawn=drawn,
    )  # fmt: skip
