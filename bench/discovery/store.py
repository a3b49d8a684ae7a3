"""The results of searches on disk: a folder for each file searched, and two tables over all of them.

``<study>/<case>/report.json``, a `SearchRecord`, is written last, whole or not at all: a case that has one of the same
id has been done. ``findings.parquet`` (a row for each finding) and ``gaps.parquet`` (a row for each case) are made from
the reports. ``report.schema.json`` beside this file ships with the package, and a test holds it to the classes;
``python -m tests.bench.write_report_schema`` writes it anew.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import partial
from importlib.resources import files
from math import nan
from pathlib import Path
from typing import Any, final

import pyarrow as pa
import pyarrow.parquet as pq

from calibench.bench.provenance.environment import provenance
from calibench.bench.store.arrays import array_of
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.store.manifest import DISCOVERY, StoreError, is_discovery
from calibench.core.plain import finite, json_of
from calibench.discrepancy.report import Gap, Report

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
        ("amplitude_low", _REAL), ("amplitude_high", _REAL), ("amplitude_span", _REAL), ("gain", _REAL),
        ("set", pa.list_(_RIVAL)), ("separated_by", _TEXT), *_ORIGIN,
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
_EPOCH, _MICROSECOND = datetime.fromtimestamp(0, UTC), timedelta(microseconds=1)
_GAP = ("noise_floor", "train_before", "train_after", "held_out_before", "held_out_after", "excess_shrink")


@final
class FindingStore:
    """The folder of one study of `bench discover`. Writing creates it."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.study = self.folder.resolve().name

    def check(self) -> None:
        """Raise `StoreError` where something else stands in the folder's place."""
        if self.folder.exists() and not self.folder.is_dir():
            raise StoreError(f"{self.folder}: is a file, a folder for results is needed")
        used = self.folder.is_dir() and any(path.suffix != ".tmp" for path in self.folder.iterdir())
        if used and not is_discovery(self.folder):
            raise StoreError(f"{self.folder}: is no study of bench discover; take another with study=NAME")

    def open(self, command: str = "") -> None:
        """Create the folder for writing, and note the `command`. Raises `StoreError` where something else is there."""
        self.check()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            manifest: dict[str, Any] = {"kind": DISCOVERY, "schema_version": SCHEMA_VERSION, "study": self.study}
            manifest["commands"] = []
            if is_discovery(self.folder):
                manifest |= json_of((self.folder / "manifest.json").read_bytes())
                if not command or command in manifest["commands"]:
                    return
            manifest["commands"] = [*manifest["commands"], *filter(None, [command])]
            text = json.dumps(manifest, indent=1, allow_nan=False).encode()
            write_whole(self.folder / "manifest.json", lambda file: file.write(text))
        except OSError as error:
            raise StoreError(f"{self.folder}: cannot be written: {error.strerror}") from None

    def done(self, case: str, case_id: str) -> SearchRecord | None:
        """Return the record of `case` if it is there, of the same id, and no failure."""
        record = _read(self.folder / case / "report.json")
        return record if record is not None and record.case_id == case_id and not record.error else None

    def write(self, record: SearchRecord) -> Path:
        path = self.folder / record.case / "report.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps(record.to_dict(), indent=1, allow_nan=False).encode()
        return write_whole(path, lambda file: file.write(text))

    def collect(self) -> None:
        if not is_discovery(self.folder):
            raise StoreError(f"{self.folder}: is no study of bench discover")
        findings: list[dict[str, Any]] = []
        gaps: list[dict[str, Any]] = []
        for record in map(_read, sorted(self.folder.glob("*/report.json"))):
            if record is None or not record.case_id:
                continue
            report, began = record.report, record.provenance.get("started_at")
            origin = {
                **record.provenance, "started_at": began and (datetime.fromisoformat(began) - _EPOCH) // _MICROSECOND,
                "case_id": record.case_id, "case": record.case, "machine": record.machine,
                "verdict": report.verdict if report else "", "study": self.study, "schema_version": SCHEMA_VERSION,
            }  # fmt: skip
            named = report.findings if report else ()
            for rank, finding in enumerate(named, start=1):
                low, high = finding.amplitude.ci95
                findings.append({
                    **origin, "effect": finding.effect, "family": finding.family, "target": finding.target,
                    "gain": finite(finding.gain), "rank": rank, "amplitude": finite(finding.amplitude.value),
                    "amplitude_unit": finding.amplitude.unit, "amplitude_low": finite(low),
                    "amplitude_high": finite(high), "amplitude_span": finite(finding.amplitude.span),
                    "set": finite(finding.set),
                    "separated_by": finding.separated_by or "",
                })  # fmt: skip
            gap = report.gap if report else Gap()
            low, high = gap.held_out_ci95
            gaps.append({
                **origin, **{key: finite(getattr(gap, key)) for key in _GAP}, "held_out_low": finite(low),
                "held_out_high": finite(high), "options": record.options, "data_id": record.data_id,
                "status": "failed" if record.error else "ok", "error": record.error, "findings": len(named),
                "seconds": finite(record.seconds),
            })  # fmt: skip
        metadata = {"calibench": json.dumps(provenance() | {"schema_version": SCHEMA_VERSION})}
        for name, rows, schema in (("findings", findings, FINDINGS_SCHEMA), ("gaps", gaps, GAPS_SCHEMA)):
            columns = [array_of([row.get(field.name) for row in rows], field.type) for field in schema]
            table = pa.Table.from_arrays(columns, schema=schema.with_metadata(metadata))
            write_whole(self.folder / f"{name}.parquet", partial(pq.write_table, table, compression="zstd"))


def _read(path: Path) -> SearchRecord | None:
    try:
        return SearchRecord.from_dict(json_of(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None  # no record, or one that another version or a hand has spoilt: the case is searched again


SCHEMA_VERSION = 1
OF_THE_FILE = ("case_id", "data_id", "options", "provenance")  # what a line of --json leaves out


@final
@dataclass(frozen=True)
class SearchRecord:
    """A report, or the error that ended the search, with the request and the environment.

    `case_id` is a digest of case, data and options, `data_id` of the data alone ("" where they cannot be read);
    `options` is canonical JSON. `seconds` are of computing.
    """

    case: str
    machine: str
    case_id: str
    data_id: str = ""
    options: str = "{}"
    provenance: Mapping[str, Any] = field(default_factory=dict)
    report: Report | None = None
    error: str = ""
    seconds: float = nan

    def to_dict(self) -> dict[str, Any]:
        """Return the record as plain values: the report's own, and beside them the rest."""
        own = {
            "schema_version": SCHEMA_VERSION, "case": self.case, "machine": self.machine, "case_id": self.case_id,
            "data_id": self.data_id, "options": self.options, "provenance": dict(self.provenance),
        }  # fmt: skip
        if self.report is None:
            return {**own, "error": self.error, "seconds": finite(self.seconds)}
        return {**own, **self.report.to_dict(), "case": self.case}

    def line(self) -> dict[str, Any]:
        """Return the record as `bench discover --json` prints it, without the fields that only a file needs."""
        return {key: value for key, value in self.to_dict().items() if key not in OF_THE_FILE}

    @classmethod
    def from_dict(cls, written: Mapping[str, Any]) -> SearchRecord:
        """Return the record that `to_dict` wrote. Raises `KeyError` or `ValueError` for any other mapping."""
        report = None if "error" in written else Report.from_dict(written)
        seconds = written.get("seconds")
        return cls(
            case=str(written["case"]), machine=str(written["machine"]), case_id=str(written.get("case_id", "")),
            data_id=str(written.get("data_id", "")), options=str(written.get("options", "{}")),
            provenance=dict(written.get("provenance") or {}), report=report, error=str(written.get("error", "")),
            seconds=nan if seconds is None else float(seconds),
        )  # fmt: skip


def report_schema() -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of ``report.json`` and of a line of ``bench discover --json``.

    >>> report_schema()["$schema"]
    'https://json-schema.org/draft/2020-12/schema'
    """
    file = files("calibench.bench.discovery").joinpath("report.schema.json")
    schema: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return schema
