"""The manifest of a study: ``manifest.json`` says what the folder is, which runs it is to have, by which commands."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from calibench.bench.execution.run_row import SCHEMA_VERSION
from calibench.bench.store.atomic_file import write_whole
from calibench.core.options import suggest
from calibench.core.plain import json_of

KIND = "calibench study"
DISCOVERY = "calibench discovery"  # the kind of the studies of `bench discover`, which `bench.discovery.store` keeps


class StoreError(ValueError):
    """A results folder that is not ours, cannot be read, or holds a damaged file."""


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a study of runs: kind, schema_version, study, and planned, {run_id: label of its cell}.

    It may also have called {label: name of the cell on a terminal}, budgets {label: budget}, other_shards [run_id],
    abandoned [run_id: finished, and dropped from the plan], commands, files, costs.
    Raises `StoreError` where the folder is missing or none of ours.
    """
    path = folder / "manifest.json"
    if not folder.is_dir():
        near = _near(folder.parent, folder.name)
        known = [path.parent.as_posix() for path in sorted(Path("results").glob("*/manifest.json"))]
        if not near and known:  # a study's name may stand for its folder
            named = [path for path in known if path.endswith(f"/{folder.as_posix()}")]
            hint = f"did you mean {named[0]}?" if named else suggest(f"results/{folder.as_posix()}", known)
            near = f"; {hint}"
        raise StoreError(f"{folder}: there is no such study folder{near}")
    try:
        manifest = json_of(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise StoreError(
            f"{folder}: has no manifest.json, so it is no study of ours; take another folder{_near(folder)}"
        ) from None
    except (OSError, ValueError) as error:
        raise StoreError(f"{path}: cannot be read: {error}") from None
    if _is_of_a_discovery(manifest):
        raise StoreError(
            f"{folder}: is a study of bench discover; read CASE/report.html, findings.parquet and gaps.parquet"
        )
    if not isinstance(manifest, dict) or manifest.get("kind") != KIND:
        raise StoreError(f"{path}: is not a manifest of ours; take another folder")
    if manifest.get("schema_version") != SCHEMA_VERSION:
        raise StoreError(f"{folder}: schema {manifest.get('schema_version')!r}, this version reads {SCHEMA_VERSION}")
    found: dict[str, Any] = manifest
    cells = found.pop("cells", None)  # as it is written: a label once, and the runs of its cell
    try:
        found["planned"] = {run_id: cell["label"] for cell in cells for run_id in cell["runs"]}
        found["called"], found["budgets"] = (
            {cell["label"]: cell[key] for cell in cells if key in cell} for key in ("called", "budget")
        )
    except (TypeError, KeyError):
        raise StoreError(f"{path}: its entry 'planned' is damaged") from None
    for key, is_right in _KINDS.items():
        if not is_right(found.get(key)):
            raise StoreError(f"{path}: its entry {key!r} is damaged")
    return found


def write_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest, whole."""
    cells: dict[str, list[str]] = {}
    names, budgets = manifest.get("called", {}), manifest.get("budgets", {})
    for run_id, label in manifest["planned"].items():
        cells.setdefault(label, []).append(run_id)
    kept = {key: value for key, value in manifest.items() if key not in ("planned", "called", "budgets")}
    lines = [f" {json.dumps(key)}: " + json.dumps(value, indent=1).replace("\n", "\n ") for key, value in kept.items()]
    entries = (
        {"label": label}
        | ({"called": names[label]} if label in names else {})
        | ({"budget": budgets[label]} if label in budgets else {})
        | {"runs": ids}
        for label, ids in cells.items()
    )
    runs = ",\n".join(f"  {json.dumps(cell)}" for cell in entries)
    text = "{\n" + ",\n".join([*lines, f' "cells": [\n{runs}\n ]']) + "\n}\n"
    write_whole(folder / "manifest.json", lambda file: file.write(text.encode()))


def new_manifest(study: str) -> dict[str, Any]:
    """Return the manifest of a study of which nothing is planned yet."""
    return {"kind": KIND, "schema_version": SCHEMA_VERSION, "study": study, "planned": {}}


def in_other_shards(manifest: Mapping[str, Any], done: Collection[str]) -> set[str]:
    """Return the runs of this sweep that other shards were to do, and that are neither planned nor `done` here."""
    others: set[str] = set(manifest.get("other_shards", ()))
    return others.difference(manifest["planned"], done)


def remaining_by_budget(manifest: Mapping[str, Any], done: Collection[str]) -> dict[int, int]:
    """Return how many planned runs are not `done`, by their budget."""
    budgets = manifest.get("budgets") or {}
    left = (budgets.get(label) for run_id, label in manifest.get("planned", {}).items() if run_id not in done)
    return dict(Counter(budget for budget in left if budget is not None))


def studies_in(parent: Path) -> list[Path]:
    """Return the folders of the studies under `parent` that hold runs, by name; those of `bench discover` do not."""
    folders = [path.parent for path in sorted(parent.glob("*/manifest.json"))]
    return [folder for folder in folders if not is_discovery(folder)]


def is_discovery(folder: Path) -> bool:
    """Tell whether `folder` holds a study of `bench discover`."""
    try:
        manifest = json_of((folder / "manifest.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return _is_of_a_discovery(manifest)


def _is_of_a_discovery(manifest: Any) -> bool:
    return isinstance(manifest, dict) and manifest.get("kind") == DISCOVERY


def _near(parent: Path, name: str = "") -> str:
    """Return a hint of the studies that stand in `parent`; '' where there are none."""
    known = [path.parent.name for path in sorted(parent.glob("*/manifest.json"))]
    return f"; in {parent} {suggest(name, known)}" if known else ""


def _are(key: type, value: type) -> Any:
    return lambda found: (
        isinstance(found, dict) and all(isinstance(k, key) and isinstance(v, value) for k, v in found.items())
    )


def _is_list(kind: type) -> Any:
    return lambda found: isinstance(found, list) and all(isinstance(item, kind) for item in found)


def _or_missing(is_right: Any) -> Any:
    return lambda found: found is None or is_right(found)


_KINDS = {
    "study": lambda found: isinstance(found, str) and found != "",
    "planned": _are(str, str),
    "called": _or_missing(_are(str, str)),
    "budgets": _or_missing(_are(str, int)),
    "abandoned": _or_missing(_is_list(str)),
    "commands": _or_missing(_is_list(str)),
    "other_shards": _or_missing(_is_list(str)),
    "files": _or_missing(_are(str, str)),
    "costs": _or_missing(_is_list(dict)),
}
