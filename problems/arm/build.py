"""How `arm_ur10`, `arm_panda` and `arm` are made from chosen options (`families`): measured, or drawn."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from calibench.problems.arm.calibration import ArmCalibration
from calibench.problems.arm.chains.chain import Chain
from calibench.problems.arm.chains.dh_file import read_dh
from calibench.problems.arm.chains.kinematics import parameter_names, parameter_units
from calibench.problems.arm.chains.urdf import read_urdf
from calibench.problems.arm.gauge import gauge
from calibench.problems.arm.instances import ArmInstance, arm_instance
from calibench.problems.arm.measured import Measured, found_frames, read_measured, shipped
from calibench.problems.arm.readings import Index, Readings, positions, sockets
from calibench.problems.arm.readings import poses as of_poses
from calibench.problems.base import Parameter
from calibench.problems.instances import check_instance, refuse_drawn

HALF = {"mm": 8.0, "rad": 0.06}  # of the box about the nominal arm; arms are wrong by some mm and mrad
GAP = 50.0  # mm between the two sockets of the tool
GAP_WEIGHT = 3.0  # a distance between sockets was measured once, and better than the ball sits


def measured_problem(
    name: str, told: Mapping[str, Any], chain: Chain, measured: Measured, reads: str, gap: tuple[float, float],
    robust: float,
) -> ArmCalibration:  # fmt: skip
    """Return the problem of measured postures: rows that are held are kept back, what is not determined is held.

    `gap` is the known distance [mm] of two sockets of a place (0: unknown) and its weight.
    """
    seen = compared(measured.where(~measured.held), reads, gap)
    held = compared(measured.where(measured.held), "position" if reads == "pose" else reads, gap)
    kept = gauge(chain, seen).kept
    units = dict(zip(parameter_names(chain), parameter_units(chain), strict=True))
    rows = [Parameter(n, units[n], 0.0, -HALF[units[n]], HALF[units[n]]) for n in kept]
    limit = robust if robust > 0 else np.inf
    return ArmCalibration(name, told, chain, seen, tuple(rows), held if len(held.q) else None, limit)


def of_own(given: Mapping[str, Any], file: Path) -> ArmCalibration:
    """Return the problem of a user's own arm, described in `file`, and of the postures in ``given["data"]``."""
    chosen, data = dict(given), Path(given["data"])
    if "dh" in chosen:
        chain = read_dh(file, chosen.get("convention", ""), "problem.").chain
    else:
        chain = read_urdf(file, "problem.").chain(chosen["base"], chosen["tip"])
    measured = read_measured(data, chain, chosen["rotation"])
    reads = _reads(chosen["reads"], measured)
    try:
        chain = found_frames(chain, measured)
    except ValueError as error:
        raise ValueError(f"data={data.name}: {error}") from None
    if "dh" in chosen:
        chosen = {key: value for key, value in chosen.items() if key not in ("urdf", "base", "tip")}
    described = "dh" if "dh" in chosen else "urdf"
    told = chosen | {described: file.name, "data": data.name}  # no path of this machine in a row
    return measured_problem("arm", told, chain, measured, reads, (chosen["gap"], GAP_WEIGHT), chosen["robust"])


def compared(measured: Measured, reads: str, gap: tuple[float, float] = (0.0, 1.0)) -> Readings:
    """Return what of `measured` is compared: position, pose, or sockets."""
    if reads == "sockets":
        assert measured.socket is not None
        assert measured.site is not None
        numbers = {old: new for new, old in enumerate(dict.fromkeys(measured.socket.tolist()))}
        socket = np.array([numbers[s] for s in measured.socket.tolist()], dtype=np.int64)
        return sockets(measured.q, socket, _gaps(socket, measured.site, gap[0]), gap[1])
    assert measured.place is not None
    if reads == "position":
        return positions(measured.q, measured.place)
    assert measured.rotation is not None
    pose = np.tile(np.eye(4), (len(measured.q), 1, 1))
    pose[:, :3, 3], pose[:, :3, :3] = measured.place, measured.rotation
    return of_poses(measured.q, pose)


def _gaps(socket: Index, site: Index, gap: float) -> tuple[tuple[int, int, float], ...]:
    """Return the known distances: between the two sockets of each place."""
    if gap <= 0:
        return ()
    found = []
    for one in dict.fromkeys(site.tolist()):
        both = list(dict.fromkeys(socket[site == one].tolist()))
        if len(both) == 2:
            found.append((both[0], both[1], gap))
    return tuple(found)


def _reads(asked: str, measured: Measured) -> str:
    there = {
        "pose": measured.rotation is not None,
        "position": measured.place is not None,
        "sockets": measured.socket is not None,
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
    measured = read_measured(shipped(f"ur10_{chosen['series'].lower()}.csv"), chain, "xyz")
    chain = found_frames(chain, measured.where(~measured.held))
    return measured_problem("arm_ur10", chosen, chain, measured, chosen["reads"], (0.0, 1.0), chosen["robust"])


@lru_cache(maxsize=32)
def of_panda(given: tuple[tuple[str, Any], ...]) -> ArmCalibration:
    chosen = dict(given)
    chain = read_urdf(shipped("panda.urdf")).chain(tip="ball_link")
    measured = read_measured(shipped("panda_sockets.csv"), chain)
    return measured_problem("arm_panda", chosen, chain, measured, "sockets", (GAP, GAP_WEIGHT), chosen["robust"])


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
    rows = tuple(Parameter(n, units[n], 0.0, low, high, true) for n, low, high, true in box)
    limit = says["robust"] if says.get("robust", 0.0) > 0 else np.inf
    noise = 0.0 if exact else drawn.noise.level
    return ArmCalibration(name, says, drawn.chain, drawn.read(noise), rows, None, limit, noise, drawn=drawn)
