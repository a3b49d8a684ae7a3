"""Write the JSON schema of ``report.json`` from its classes: ``python -m tests.bench.write_report_schema``."""

import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import StrEnum
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from calibench.bench.discovery import store
from calibench.bench.discovery.store import OF_THE_FILE, SCHEMA_VERSION, SearchRecord
from calibench.discrepancy.report import Gap, Report

NOT_TOLD = ("candidates", "fitted")  # what `Report.to_dict` leaves out


def made_schema() -> dict[str, Any]:
    """Return the schema as the classes have it now."""
    known: dict[str, Any] = {}
    report = _properties(Report, known, but=NOT_TOLD)
    gap = known[Gap.__name__]
    gap["properties"]["unit"] = {"const": "sigma"}
    gap["required"].append("unit")
    record = _properties(SearchRecord, known, but=("report",))
    of_both = {
        "schema_version": {"const": SCHEMA_VERSION},
        **{name: record[name] for name in ("case", "machine", *OF_THE_FILE)},
    }
    error = {"error": {"type": "string", "description": "What ended the search."}, "seconds": record["seconds"]}
    known["Report"] = _object(of_both | report, Report.__doc__, but=OF_THE_FILE)
    known["Failure"] = _object(of_both | error, "A search that an error ended.", but=OF_THE_FILE)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "calibench: report.json, and a line of `bench discover --json`",
        "description": "Where a number is null it could not be measured. A line of --json is without "
        f"{', '.join(OF_THE_FILE)}; a failed search has an error and no verdict.",
        "if": {"type": "object", "required": ["error"]},  # one of two, told apart: a validator then names the field
        "then": {"$ref": "#/$defs/Failure"},
        "else": {"$ref": "#/$defs/Report"},
        "$defs": dict(sorted(known.items())),
    }


def _properties(cls: Any, known: dict[str, Any], but: tuple[str, ...] = ()) -> dict[str, Any]:
    hints = get_type_hints(cls)
    return {f.name: _of_type(hints[f.name], known) for f in fields(cls) if f.name not in but}


def _object(properties: Mapping[str, Any], about: str | None, but: tuple[str, ...] = ()) -> dict[str, Any]:
    return {
        "description": " ".join((about or "").partition("\n\n")[0].split()),
        "type": "object",
        "properties": dict(properties),
        "required": [name for name in properties if name not in but],
        "additionalProperties": False,
    }


def _of_type(hint: Any, known: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a type's values as `calibench.core.plain.finite` writes them; classes go into `known`."""
    if hint in _PLAIN:
        return dict(_PLAIN[hint])
    if is_dataclass(hint) and isinstance(hint, type):
        if hint.__name__ not in known:
            known[hint.__name__] = {}  # it may hold itself
            known[hint.__name__] |= _object(_properties(hint, known), hint.__doc__)
        return {"$ref": f"#/$defs/{hint.__name__}"}
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return {"enum": [member.value for member in hint]}
    kind, arguments = get_origin(hint), get_args(hint)
    if kind is Literal:
        return {"enum": list(arguments)}
    if kind in (Union, UnionType):
        return {"anyOf": [_of_type(argument, known) for argument in arguments]}
    if kind is tuple and arguments[-1] is Ellipsis:
        return {"type": "array", "items": _of_type(arguments[0], known)}
    if kind is tuple:
        items = [_of_type(argument, known) for argument in arguments]
        return {"type": "array", "prefixItems": items, "items": False, "minItems": len(items)}
    if kind is Mapping:
        return {"type": "object", "additionalProperties": _of_type(arguments[1], known)}
    raise TypeError(f"{hint}: no JSON schema is known for this type")


_PLAIN: dict[Any, dict[str, Any]] = {
    str: {"type": "string"},
    bool: {"type": "boolean"},
    int: {"type": "integer"},
    float: {"type": ["number", "null"]},
    NoneType: {"type": "null"},
    Any: {},
}


if __name__ == "__main__":
    text = json.dumps(made_schema(), indent=1, ensure_ascii=False)
    Path(store.__file__).with_name("report.schema.json").write_text(f"{text}\n", encoding="utf-8")
