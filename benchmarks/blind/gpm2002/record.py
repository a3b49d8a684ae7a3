"""What is written down of a run: the columns of the file, with their own small errors, and files on disk."""

from __future__ import annotations

import json
from collections.abc import Mapping, Set
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from benchmarks.blind.gpm2002.design import Plan
from benchmarks.blind.gpm2002.machine import DISTAL, Array
from benchmarks.blind.gpm2002.statics import Rest, geometry

if TYPE_CHECKING:
    from benchmarks.blind.gpm2002.simulate import Case

LEGS = (1, 2, 3)
UNITS = {
    "t_s": "s", "enc": "rad", "x": "mm", "y": "mm", "vel": "rad/s", "dir": "1", "tau": "N mm", "axial": "N",
    "load": "N", "temp": "K", "speed": "mm/s", "heading": "rad",
}  # fmt: skip
GROUPS = (("vel", "dir"), ("tau",), ("axial",), ("load",), ("temp",), ("speed", "heading"))
STANDS = 1e-3  # rad/s: slower than this a joint has no direction


def columns_of(
    plan: Plan,
    machine: Array,
    rest: Rest,
    readings: Array,
    tracker: Array | None,
    sigma: float,
    needed: Set[str],
    rng: np.random.Generator,
) -> tuple[dict[str, NDArray[Any]], float | None, list[str]]:
    """Return the columns, the resolution of the encoders [rad] (None: not stated), and the columns left out.

    Torques and forces are good to half a per cent, the thermometer to .02 K, the load to .1 N. In a third of the cases
    some optional columns are missing; those that the true effect needs only in one case of 25.
    """
    n = len(plan.t)
    lsb = None
    if rng.random() < 0.5:
        lsb = float(2 * np.pi / 2 ** np.ceil(np.log2(2 * np.pi / (sigma / rng.uniform(2, 8)))))
    written = readings if lsb is None else lsb * np.round(readings / lsb)
    members = np.broadcast_to(machine, (n, 15)).copy()
    members[:, DISTAL] = rest.distal
    g, _ = geometry(members, rest.position, rest.link_angles)
    velocity = np.einsum("nik,ni->nk", g, plan.velocity)
    gauges = rng.standard_normal((n, 9))
    columns: dict[str, NDArray[Any]] = {
        "t_s": plan.t,
        "pose_id": plan.pose,
        "visit_id": plan.visit,
        "repeat": plan.repeat,
        "split": np.where(plan.train, "train", "hold"),
    }
    columns |= {f"enc_{i}": written[:, i - 1] for i in LEGS}
    if tracker is not None:
        columns |= {"x": tracker[:, 0], "y": tracker[:, 1]}
    columns |= {f"vel_{i}": velocity[:, i - 1] for i in LEGS}
    columns |= {f"dir_{i}": _direction(velocity[:, i - 1]) for i in LEGS}
    columns |= {f"tau_{i}": rest.torque[:, i - 1] * (1 + 0.005 * gauges[:, i - 1]) for i in LEGS}
    columns |= {f"axial_{i}": rest.axial[:, i - 1] * (1 + 0.005 * gauges[:, i + 2]) for i in LEGS}
    columns |= {"load_x": plan.load[:, 0] + 0.1 * gauges[:, 6], "load_y": plan.load[:, 1] + 0.1 * gauges[:, 7]}
    columns |= {"temp_K": plan.temperature + 0.02 * gauges[:, 8], "speed": plan.speed, "heading": plan.heading}

    poor, withhold, drops = rng.random() < 0.35, rng.random() < 0.04, rng.random(len(GROUPS)) < 0.3
    missing = []
    for group, drop in zip(GROUPS, drops):
        names = [name for name in columns if name.split("_")[0] in group]
        if (withhold and needed & set(names)) or (poor and drop and not needed & set(names)):
            missing += names
    columns = {name: values for name, values in columns.items() if name not in missing}
    if rng.random() < 0.3:
        columns["valid"] = _with_faults(columns, n, rng)
    return columns, lsb, missing


def table_of(columns: Mapping[str, NDArray[Any]], metadata: Mapping[str, Any] | None) -> pa.Table:
    """Return the Arrow table: units with the columns, `metadata` under the key `measured_data`."""
    fields = []
    for name, values in columns.items():
        unit = UNITS.get(name) or UNITS.get(name.split("_")[0])
        fields.append(pa.field(name, pa.array(values).type, metadata={"unit": unit} if unit else None))
    about = None if metadata is None else {"measured_data": json.dumps(metadata)}
    return pa.table([pa.array(values) for values in columns.values()], schema=pa.schema(fields, metadata=about))


def write(case: Case, folder: Path, sealed_folder: Path, stem: str) -> None:
    """Write the measured file folder/stem.parquet and, apart from it, the truth sealed_folder/stem.json."""
    folder, sealed_folder = Path(folder), Path(sealed_folder)
    if folder.resolve() == sealed_folder.resolve():
        raise ValueError(f"sealed_folder={str(sealed_folder)!r}: the truth must lie apart from the data")
    for place in (folder, sealed_folder):
        place.mkdir(parents=True, exist_ok=True)
    pq.write_table(table_of(case.columns, case.metadata), folder / f"{stem}.parquet")
    (sealed_folder / f"{stem}.json").write_text(json.dumps({"case": stem, **case.truth}, indent=1) + "\n")


def _direction(velocity: Array) -> NDArray[np.int64]:
    return np.where(np.abs(velocity) < STANDS, 0, np.sign(velocity)).astype(np.int64)


def _with_faults(columns: dict[str, NDArray[Any]], n: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return `valid`, and spoil what the few rows say that are not."""
    valid = np.ones(n, dtype=bool)
    valid[rng.choice(n, int(rng.integers(0, 4)), replace=False)] = False
    column = f"enc_{rng.integers(1, 4)}"
    columns[column] = np.where(valid, columns[column], columns[column] + 0.05)
    return valid
