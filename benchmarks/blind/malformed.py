"""Files that nobody should get a confident name from: each takes a good case and spoils it in one way.

`SPOILED` names the ways. `hopeless` ones can only be refused, with a clear line; of the others a report may come, with
a note that says what they lack.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

from benchmarks.blind.gpm2002.record import table_of
from benchmarks.blind.gpm2002.simulate import Case

Columns = dict[str, Any]
Metadata = dict[str, Any]


@dataclass(frozen=True)
class Spoiled:
    """What a file says; `metadata` None: the file has none. `mentions` are words of which one must be in the answer."""

    columns: Columns
    metadata: Metadata | None
    hopeless: bool
    mentions: tuple[str, ...]


SPOILED: dict[str, Callable[[Case], Spoiled]] = {}


def spoiled(*mentions: str, hopeless: bool = False) -> Callable[[Callable[[Columns, Metadata], Any]], Any]:
    """Enter a way to spoil columns and metadata in place; it may return what to put in the metadata's place."""

    def enter(change: Callable[[Columns, Metadata], Any]) -> Any:
        def apply(case: Case) -> Spoiled:
            columns = {name: values.copy() for name, values in case.columns.items()}
            metadata = dict(case.metadata)
            other = change(columns, metadata)
            if other == "none":
                return Spoiled(columns, None, hopeless, mentions)
            return Spoiled(columns, metadata, hopeless, mentions)

        SPOILED[change.__name__] = apply
        return change

    return enter


@spoiled("enc_2", hopeless=True)
def encoder_missing(columns: Columns, metadata: Metadata) -> None:
    """One encoder was not recorded."""
    del columns["enc_2"]


@spoiled("enc_1", hopeless=True)
def encoder_misnamed(columns: Columns, metadata: Metadata) -> None:
    """A hyphen where the underscore should be."""
    columns["enc-1"] = columns.pop("enc_1")


@spoiled("pose_id", "pose")
def poses_unnamed(columns: Columns, metadata: Metadata) -> None:
    """No pose, visit and repeat numbers: no repeats can be told."""
    for name in ("pose_id", "visit_id", "repeat"):
        del columns[name]


@spoiled("t_s", "time")
def clock_missing(columns: Columns, metadata: Metadata) -> None:
    """No time column."""
    del columns["t_s"]


@spoiled("y", "tracker")
def tracker_halved(columns: Columns, metadata: Metadata) -> None:
    """x without y."""
    columns.setdefault("x", np.zeros(len(columns["enc_1"])))
    columns.pop("y", None)


@spoiled("degree", "rad", hopeless=True)
def degrees(columns: Columns, metadata: Metadata) -> None:
    """Angles in degrees."""
    for i in (1, 2, 3):
        columns[f"enc_{i}"] = np.degrees(columns[f"enc_{i}"])


@spoiled("NaN", "nan", "finite")
def rows_blank(columns: Columns, metadata: Metadata) -> None:
    """Some rows without readings."""
    columns["enc_3"][[3, 40, 41]] = np.nan


@spoiled("NaN", "nan", "finite", "enc_1", hopeless=True)
def column_blank(columns: Columns, metadata: Metadata) -> None:
    """An encoder that never said anything."""
    columns["enc_1"][:] = np.nan


@spoiled("finite", "inf")
def reading_infinite(columns: Columns, metadata: Metadata) -> None:
    """One reading overflowed."""
    columns["enc_2"][7] = np.inf


@spoiled("t_s", "time", "duplicate")
def times_duplicate(columns: Columns, metadata: Metadata) -> None:
    """A clock with a resolution of ten minutes."""
    columns["t_s"] = np.floor(columns["t_s"] / 600) * 600


@spoiled("repeat")
def repeats_missing(columns: Columns, metadata: Metadata) -> None:
    """Each pose visited once and read once."""
    _, first = np.unique(columns["pose_id"], return_index=True)
    _keep(columns, np.sort(first))


@spoiled("hold", "held", "cross")
def nothing_held_out(columns: Columns, metadata: Metadata) -> None:
    """All rows are for fitting."""
    columns["split"][:] = "train"


@spoiled("split")
def split_unknown(columns: Columns, metadata: Metadata) -> None:
    """Other words for the parts."""
    columns["split"] = np.where(columns["split"] == "train", "a", "b")


@spoiled("few", "reading", "row", "parameter", hopeless=True)
def rows_too_few(columns: Columns, metadata: Metadata) -> None:
    """Four poses for eleven or fifteen parameters."""
    poses = np.unique(columns["pose_id"][columns["split"] == "train"])[:4]
    _keep(columns, np.isin(columns["pose_id"], poses))


@spoiled("few", "no ", "empty", "reading", "row", hopeless=True)
def rows_none(columns: Columns, metadata: Metadata) -> None:
    """A header without rows."""
    _keep(columns, np.zeros(0, dtype=int))


@spoiled("constant", "vary", "var", "same", "changes")
def covariates_constant(columns: Columns, metadata: Metadata) -> None:
    """Sensors that were never connected."""
    for name in columns:
        if name.split("_")[0] in {"vel", "dir", "tau", "axial", "load", "temp", "speed", "heading"}:
            columns[name] = np.zeros_like(columns[name])


@spoiled("pose", "same", "rank", "condition", "vary", "parameter", hopeless=True)
def pose_one(columns: Columns, metadata: Metadata) -> None:
    """The arm never moved: one pose read many times."""
    for name in columns:
        if name.startswith("enc") or name in {"x", "y"}:
            columns[name] = columns[name][0] + 1e-5 * np.random.default_rng(0).standard_normal(len(columns[name]))


@spoiled("machine", hopeless=True)
def machine_other(columns: Columns, metadata: Metadata) -> None:
    """The columns of an Orthoglide under its own name."""
    metadata["machine"] = "orthoglide"
    n = len(columns["t_s"])
    columns.clear()
    columns |= {"leg": np.array(["x"] * n), "level_mm": np.linspace(-100, 60, n), "deviation": np.zeros(n)}


@spoiled("clos", "fit", "residual", "machine", "nominal", "noise", "converge")
def machine_random(columns: Columns, metadata: Metadata) -> None:
    """Angles of no machine at all."""
    rng = np.random.default_rng(0)
    for i in (1, 2, 3):
        columns[f"enc_{i}"] = rng.uniform(-1, 1, len(columns["t_s"]))


@spoiled("measured_data", "metadata", "sigma")
def metadata_missing(columns: Columns, metadata: Metadata) -> str:
    """A bare Parquet file."""
    return "none"


@spoiled("sigma_enc", "noise")
def noise_not_stated(columns: Columns, metadata: Metadata) -> None:
    """No sigma for the encoders."""
    del metadata["sigma_enc"]


@spoiled("sigma_enc", "noise", hopeless=True)
def noise_negative(columns: Columns, metadata: Metadata) -> None:
    """A sigma below zero."""
    metadata["sigma_enc"] = -1e-4


@spoiled("noise", "sigma")
def noise_misstated(columns: Columns, metadata: Metadata) -> None:
    """A data sheet that promises a hundred times less noise than the repeats show."""
    metadata["sigma_enc"] /= 100


@spoiled("enc_1", "number", hopeless=True)
def words_for_numbers(columns: Columns, metadata: Metadata) -> None:
    """A logger that writes "err"."""
    columns["enc_1"] = np.array(["err"] * len(columns["t_s"]))


@spoiled("nominal", "xa9", "name")
def nominal_misnamed(columns: Columns, metadata: Metadata) -> None:
    """A parameter that the machine does not have."""
    metadata["nominal"] = {**metadata["nominal"], "xa9": 1.0}


def write_spoiled(case: Case, folder: Path) -> dict[str, Spoiled]:
    """Write folder/NAME.parquet for each way to spoil `case`; return what each holds."""
    folder.mkdir(parents=True, exist_ok=True)
    made = {name: spoil(case) for name, spoil in SPOILED.items()}
    for name, one in made.items():
        pq.write_table(table_of(one.columns, one.metadata), folder / f"{name}.parquet")
    return made


def _keep(columns: Columns, rows: Any) -> None:
    for name in columns:
        columns[name] = columns[name][rows]
