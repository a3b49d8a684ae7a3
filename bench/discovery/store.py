"""What searches for a missing effect left on disk: a folder a file searched, and two tables over all of them.

``<study>/<case>/report.json`` is written last, whole or not at all: a case that has one of the same id has been done.
``findings.parquet`` (a row a finding) and ``gaps.parquet`` (a row a case) are folded from the reports.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from math import isfinite
from pathlib import Path
from typing import Any, final

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from bench.provenance import provenance
from bench.store import DISCOVERY, StoreError, is_discovery, to_pandas
from bench.whole import write_whole

SCHEMA_VERSION = 1
_TEXT, _INT, _REAL, _BOOL = pa.string(), pa.int64(), pa.float64(), pa.bool_()
_ORIGIN = [
    ("git_commit", _TEXT), ("git_dirty", _BOOL), ("versions", _TEXT), ("platform", _TEXT),
    ("started_at", pa.timestamp("us", tz="UTC")), ("schema_version", _INT),
]  # fmt: skip
_RIVAL = pa.struct([("effect", _TEXT), ("family", _TEXT), ("target", _TEXT), ("weight", _REAL)])
FINDINGS_SCHEMA = pa.schema(
    [
        ("case_id", _TEXT), ("study", _TEXT), ("case", _TEXT), ("machine", _TEXT), ("verdict", _TEXT), ("rank", _INT),
        ("effect", _TEXT), ("family", _TEXT), ("target", _TEXT), ("amplitude", _REAL), ("amplitude_unit", _TEXT),
        ("amplitude_low", _REAL), ("amplitude_high", _REAL), ("gain", _REAL), ("set", pa.list_(_RIVAL)),
        ("separated_by", _TEXT), *_ORIGIN,
    ]
)  # fmt: skip
GAPS_SCHEMA = pa.schema(
    [
        ("case_id", _TEXT), ("study", _TEXT), ("case", _TEXT), ("machine", _TEXT), ("options", _TEXT),
        ("data_id", _TEXT), ("status", _TEXT), ("error", _TEXT), ("verdict", _TEXT), ("findings", _INT),
        ("noise_floor", _REAL), ("train_before", _REAL), ("train_after", _REAL), ("held_out_before", _REAL),
        ("held_out_after", _REAL), ("held_out_low", _REAL), ("held_out_high", _REAL), ("excess_shrink", _REAL),
        ("seconds", _REAL), *_ORIGIN,
    ]
)  # fmt: skip
_GAP = ("noise_floor", "train_before", "train_after", "held_out_before", "held_out_after", "excess_shrink")


@final
class FindingStore:
    """The folder of one study of `bench discover`. Writing creates it."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    @property
    def study(self) -> str:
        """Return the study's name, which is its folder's."""
        return self.folder.resolve().name

    def findings(self) -> pd.DataFrame:
        """Return a row a finding of all cases (columns: `FINDINGS_SCHEMA`)."""
        return to_pandas(self._tables()[0])

    def gaps(self) -> pd.DataFrame:
        """Return a row a case (columns: `GAPS_SCHEMA`)."""
        return to_pandas(self._tables()[1])

    def check(self) -> None:
        """Raise `StoreError` where something else stands in the folder's place."""
        if self.folder.exists() and not self.folder.is_dir():
            raise StoreError(f"{self.folder}: is a file, a folder for results is needed")
        used = self.folder.is_dir() and any(path.suffix != ".tmp" for path in self.folder.iterdir())
        if used and not is_discovery(self.folder):
            raise StoreError(f"{self.folder}: is no study of bench discover; take another with study=NAME")

    def open(self) -> None:
        """Create the folder for writing. Raises `StoreError` where something else stands there."""
        self.check()
        if is_discovery(self.folder):
            return
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            manifest = {"kind": DISCOVERY, "schema_version": SCHEMA_VERSION, "study": self.study}
            _write_json(manifest, self.folder / "manifest.json")
        except OSError as error:
            raise StoreError(f"{self.folder}: cannot be written: {error.strerror}") from None

    def done(self, case: str, case_id: str) -> dict[str, Any] | None:
        """Return the report of `case` if it is there, of the same id, and no failure."""
        found = _read(self.folder / case / "report.json")
        same = found is not None and found.get("case_id") == case_id and "error" not in found
        return found if same else None

    def write(self, report: Mapping[str, Any]) -> Path:
        """Write a case's report: the mark that it is done."""
        path = self.folder / str(report["case"]) / "report.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        return _write_json(report, path)

    def collect(self) -> None:
        """Fold all reports into the two tables, sorted by case."""
        findings, gaps = self._tables()
        _write_table(findings, self.folder / "findings.parquet")
        _write_table(gaps, self.folder / "gaps.parquet")

    def _tables(self) -> tuple[pa.Table, pa.Table]:
        if not self.folder.is_dir():
            raise StoreError(f"{self.folder}: there is no such study folder")
        if not is_discovery(self.folder):
            raise StoreError(f"{self.folder}: is no study of bench discover")
        findings, gaps = [], []
        for path in sorted(self.folder.glob("*/report.json")):
            report = _read(path)
            if report is not None and "case_id" in report:
                origin = self._origin(report)
                findings += [origin | row for row in _finding_rows(report)]
                gaps.append(origin | _gap_row(report))
        return pa.Table.from_pylist(findings, FINDINGS_SCHEMA), pa.Table.from_pylist(gaps, GAPS_SCHEMA)

    def _origin(self, report: Mapping[str, Any]) -> dict[str, Any]:
        origin = dict(report.get("provenance", {}))
        origin["started_at"] = datetime.fromisoformat(origin["started_at"]) if "started_at" in origin else None
        named = {key: report.get(key, "") for key in ("case_id", "case", "machine", "verdict")}
        return {**origin, **named, "study": self.study, "schema_version": SCHEMA_VERSION}


def _finding_rows(report: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for rank, finding in enumerate(report.get("findings", ()), start=1):
        amplitude = finding.get("amplitude") or {}
        low, high = amplitude.get("ci95") or (None, None)
        yield {
            **{key: finding.get(key) for key in ("effect", "family", "target", "gain")},
            "rank": rank,
            "amplitude": amplitude.get("value"),
            "amplitude_unit": amplitude.get("unit"),
            "amplitude_low": low,
            "amplitude_high": high,
            "set": [{key: rival.get(key) for key in _RIVAL_KEYS} for rival in finding.get("set", ())],
            "separated_by": as_text(finding.get("separated_by")),
        }


_RIVAL_KEYS = ("effect", "family", "target", "weight")


def _gap_row(report: Mapping[str, Any]) -> dict[str, Any]:
    gap = report.get("gap") or {}
    low, high = gap.get("held_out_ci95") or (None, None)
    return {
        **{key: gap.get(key) for key in _GAP},
        "held_out_low": low,
        "held_out_high": high,
        "options": report.get("options", "{}"),
        "data_id": report.get("data_id", ""),
        "status": "failed" if "error" in report else "ok",
        "error": report.get("error", ""),
        "findings": len(report.get("findings", ())),
        "seconds": report.get("seconds"),
    }


def finite(value: Any) -> Any:
    """Return what JSON can hold: a number that is none becomes null, NumPy's numbers and arrays their like.

    >>> finite({"gain": float("nan"), "ci95": (1.0, float("inf"))})
    {'gain': None, 'ci95': [1.0, None]}
    """
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def as_text(value: Any) -> str:
    """Return what a report says in words or in a list of words, as one line."""
    if value is None:
        return ""
    return value if isinstance(value, str) else "; ".join(str(item) for item in value)


def _write_table(table: pa.Table, path: Path) -> None:
    told = {"calibench": json.dumps(provenance() | {"schema_version": SCHEMA_VERSION})}
    write_whole(path, lambda file: pq.write_table(table.replace_schema_metadata(told), file, compression="zstd"))


def _write_json(value: Mapping[str, Any], path: Path) -> Path:
    text = json.dumps(value, indent=1, allow_nan=False).encode()
    return write_whole(path, lambda file: file.write(text))


def _read(path: Path) -> dict[str, Any] | None:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None
