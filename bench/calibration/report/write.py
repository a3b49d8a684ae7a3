"""The files of a calibration: the URDF or table, the readings as a table, JSON, drawings and a page."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calibench.bench.calibration.readings import Readings
from calibench.bench.calibration.report.result import Calibration
from calibench.bench.calibration.request import CalibrateRequest
from calibench.bench.measured import write_measured
from calibench.bench.measured.sources import OF_A_CALIBRATION
from calibench.bench.store.atomic_file import write_whole
from calibench.discrepancy import MeasuredData
from calibench.problems.arm.chains.rigid import rpy_of


def write_calibration(
    found: Calibration, written: Mapping[str, tuple[str, bytes]], readings: Readings, request: CalibrateRequest
) -> Calibration:
    """Write everything of one calibration into its folder; return it with the files' names."""
    folder = request.folder / found.case
    folder.mkdir(parents=True, exist_ok=True)
    files: dict[str, str] = {}
    if found.chosen != "frames":
        for kind, (name, content) in written.items():
            files[kind] = str(_put(folder / name, content))
    files["readings"] = str(write_measured(readings_table(readings, request.distance), folder / OF_A_CALIBRATION))
    found = replace(found, files=files)
    if request.page:
        from calibench.bench.calibration.report.page.write import write_page

        files["page"] = str(write_page(found, folder))
    files["json"] = str(folder / "calibration.json")
    found = replace(found, files=files)
    _put(Path(files["json"]), json.dumps(found.to_dict(), indent=1, allow_nan=False).encode())
    return found


def _put(path: Path, content: bytes) -> Path:
    return write_whole(path, lambda file: file.write(content))


def readings_table(readings: Readings, distance: float = 0.0) -> MeasuredData:
    """Return the readings in the columns that every arm has, in mm and rad: what `machine=arm` reads.

    `distance` of a place's two sockets [mm] is stated in it; 0 where it is not known.
    """
    columns: dict[str, Any] = {f"q_{name}": readings.joints[:, k] for k, name in enumerate(readings.matched.joints)}
    units = {f"q_{name}": "mm" if name in readings.sliding else "rad" for name in readings.matched.joints}
    if readings.position is not None:
        columns |= dict(zip("xyz", readings.position.T, strict=True))
        units |= dict.fromkeys("xyz", "mm")
    if readings.turns is not None:
        columns |= dict(zip(("rx", "ry", "rz"), rpy_of(readings.turns).T, strict=True))
        units |= dict.fromkeys(("rx", "ry", "rz"), "rad")
    if readings.observed == "sockets":
        first = {place: readings.socket[readings.place == place].min() for place in np.unique(readings.place)}
        columns["socket"] = readings.socket - np.array([first[place] for place in readings.place])
        columns["place"] = readings.place
    columns |= dict(readings.other)
    of_joints = {name: readings.matched.other[name] for name in readings.other}
    units |= {name: unit for name, own in of_joints.items() if (unit := readings.table.units.get(own))}
    if readings.hold is not None:
        columns["split"] = np.where(readings.hold, "hold", "train")
    stated: dict[str, Any] = {"rotation": "rpy"} if readings.turns is not None else {}
    stated |= {"socket_distance_mm": distance} if distance else {}
    return MeasuredData(columns, "arm", stated, readings.table.name, units=units)
