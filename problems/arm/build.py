"""How `arm_ur10`, `arm_panda` and `arm` are made from chosen options (`families`): measured, or drawn.

Columns of a file are named as `calibration.columns` matches them, with units in brackets (`elbow_joint [deg]`). Here
nothing renames a column or states its unit but the header itself, and messages say so.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from calibench.calibration.columns import ARM
from calibench.calibration.determined import gauge
from calibench.calibration.dh import read_dh
from calibench.calibration.kinematics import Chain, Compared, parameter_units, sockets, targets
from calibench.calibration.readings import Readings, Table, read_readings
from calibench.calibration.rigid import Rotation
from calibench.calibration.start import Start, start_of
from calibench.calibration.urdf import read_urdf
from calibench.core.notes import Code
from calibench.core.tables.columns import columns_of, in_base_units
from calibench.core.tables.csv_table import read_table
from calibench.problems.arm.calibration import ArmCalibration
from calibench.problems.arm.families import shipped
from calibench.problems.arm.instances import GAP, GAP_WEIGHT, ArmInstance, arm_instance
from calibench.problems.base import Parameter

_IN_HEADER = {
    **dict.fromkeys((Code.JOINT_UNIT, Code.POSITION_UNIT), "; write the unit in the header, as x [m]"),
    **dict.fromkeys((Code.JOINTS_EXCHANGED, Code.LEFT_HANDED), "; rename the columns in the header"),
}
HALF = {"mm": 8.0, "rad": 0.06}  # of the box about the nominal arm; arms are wrong by some mm and mrad


def of_own(given: Mapping[str, Any], file: Path) -> ArmCalibration:
    """Return the problem of a user's own arm, described in `file`, and of the postures in ``given["data"]``."""
    chosen, data, described = dict(given), Path(given["data"]), "dh" if "dh" in given else "urdf"
    if described == "dh":
        chain = read_dh(file, chosen.get("convention", ""), "problem.").chain
    else:
        chain = read_urdf(file, "problem.").chain(chosen["base"], chosen["tip"])
    begin = read_measured(data, chain, chosen["rotation"], sockets=chosen["reads"] == "sockets", by_train=False)
    readings, reads = begin.readings, chosen["reads"]
    there = {
        "pose": readings.turns is not None,
        "position": readings.position is not None,
        "sockets": readings.observed == "sockets",
    }
    if reads == "auto":
        reads = next(kind for kind, is_there in there.items() if is_there)
    elif not there[reads]:
        columns = {"pose": "x y z and rx ry rz", "position": "x y z", "sockets": "socket"}[reads]
        raise ValueError(f"arm.reads={reads}: the file has no columns {columns}; leave reads out, or add them")
    chain = chain.placed(None if readings.position is None else begin.base, begin.tool)
    if described == "dh":
        chosen = {key: value for key, value in chosen.items() if key not in ("urdf", "base", "tip")}
    options = chosen | {described: file.name, "data": data.name}  # no path of this machine in a row
    return _measured("arm", options, chain, readings, reads, chosen["gap"])


@lru_cache(maxsize=64)  # a problem is a value, and reading it takes a thousand times as long as a call
def of_shipped(name: str, given: tuple[tuple[str, Any], ...]) -> ArmCalibration:
    """Return the problem `arm_ur10` or `arm_panda`, whose readings come with the package."""
    chosen = dict(given)
    if name == "arm_panda":
        chain = read_urdf(shipped("panda.urdf")).chain(tip="ball_link")
        begin = read_measured(shipped("panda_sockets.csv"), chain)
        return _measured(name, chosen, chain, begin.readings, "sockets", GAP)
    chain = read_urdf(shipped("ur10.urdf")).chain()
    begin = read_measured(shipped(f"ur10_{chosen['series'].lower()}.csv"), chain, "xyz")
    return _measured(name, chosen, chain.placed(begin.base, begin.tool), begin.readings, chosen["reads"])


def _measured(
    name: str, given: Mapping[str, Any], chain: Chain, readings: Readings, reads: str, gap: float = 0.0
) -> ArmCalibration:
    """Return the problem of measured postures: rows that are held are kept back, what is not determined is held."""
    seen = compared(readings.where(readings.train), reads, gap)
    held = compared(readings.where(~readings.train), "position" if reads == "pose" else reads, gap)
    units = parameter_units(chain)
    rows = [Parameter(n, units[n], 0.0, -HALF[units[n]], HALF[units[n]]) for n in gauge(chain, seen)]
    limit = given["robust"] if given["robust"] > 0 else np.inf
    return ArmCalibration(
        name=name, options=given, chain=chain, seen=seen, parameters=tuple(rows), held=held if len(held.q) else None,
        robust=limit,
    )  # fmt: skip


def compared(readings: Readings, reads: str, gap: float = 0.0) -> Compared:
    """Return what of `readings` is compared: position, pose, or sockets `gap` [mm] apart, 0 where it is not known."""
    if reads != "sockets":
        assert readings.position is not None
        return targets(readings.joints, readings.position, readings.turns if reads == "pose" else None)
    numbers = {old: new for new, old in enumerate(dict.fromkeys(readings.socket.tolist()))}
    socket = np.array([numbers[s] for s in readings.socket.tolist()], dtype=np.int64)
    of_places = [
        dict.fromkeys(socket[readings.place == one].tolist()) for one in dict.fromkeys(readings.place.tolist())
    ]
    known = tuple((*both, gap) for both in of_places if gap > 0 and len(both) == 2)
    return sockets(readings.joints, socket, known, GAP_WEIGHT)


@lru_cache(maxsize=256)
def simulated(name: str, given: tuple[tuple[str, Any], ...]) -> ArmCalibration:
    """Return the problem that the instance draws: another arm of the kind, its errors, postures, noise and box."""
    chosen = dict(given)

    def problem(drawn: ArmInstance, noise: float) -> ArmCalibration:
        units = parameter_units(drawn.chain)
        box = (drawn.box.lower.tolist(), drawn.box.upper.tolist(), drawn.box.truth.tolist())
        rows = tuple(
            Parameter(name=n, unit=units[n], start=0.0, lower=low, upper=high, true=true)
            for n, low, high, true in zip(drawn.names, *box, strict=True)
        )
        limit = chosen["robust"] if chosen.get("robust", 0.0) > 0 else np.inf
        return ArmCalibration(
            name=name, options=chosen, chain=drawn.chain, seen=drawn.read(noise), parameters=rows, held=None,
            robust=limit, noise=noise, drawn=drawn,
        )  # fmt: skip

    reads = chosen.get("reads", "sockets")
    drawn = arm_instance(name, chosen["instance"], reads, lambda one: problem(one, 0.0))
    return problem(drawn, drawn.noise.level)


def read_measured(
    path: str | Path, chain: Chain, rotation: Rotation = "", *, sockets: bool = False, by_train: bool = True
) -> Start:
    """Return what a CSV file tells of `chain`, and where base and target are, by the fitted rows, or by all."""
    name = f"data={Path(path).name}"
    try:
        content = in_base_units(columns_of(read_table(path), ARM), ARM)
        table = Table.of(content.columns, name, units=content.units)
        readings = read_readings(table, chain, "sockets" if sockets else "", copies=True, option="problem.")
        if len(readings.targets) > 1:
            raise ValueError(f"column target: a problem has one target, and these are {', '.join(readings.targets)}")
        if readings.loci is not None:
            raise ValueError("a problem needs x, y and z in each row; bench calibrate takes less than places")
        begin = start_of(readings if by_train else replace(readings, hold=None), chain, rotation, limits=True)
        return replace(begin, readings=replace(begin.readings, hold=readings.hold))
    except (OSError, ValueError) as error:
        text, note = str(error), getattr(error, "note", None)
        text = text if text.startswith(name) else f"{name}: {text}"
        raise ValueError(f"{text}{_IN_HEADER.get(note.code, '') if note else ''}") from None
