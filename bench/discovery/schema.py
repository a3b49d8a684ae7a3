"""`SearchRecord`: the result of one search of one set of data, as ``report.json`` holds it, and its JSON schema.

``report.schema.json`` beside this file ships with the package; ``python -m tests.bench.write_report_schema`` writes it
anew, and a test holds it to the classes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from math import nan
from typing import Any, final

from calibench.core.plain import finite
from calibench.discrepancy.report import Report

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
