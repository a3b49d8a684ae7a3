"""The manifest of a study: ``manifest.json`` says what the folder is, which runs it is to have, by which commands."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibench.bench.execution.run_row import SCHEMA_VERSION
from calibench.bench.store.atomic_file import write_whole

KIND = "calibench study"
DISCOVERY = "calibench discovery"  # the kind of the studies of `bench discover`, which `bench.discovery.store` keeps
_READABLE = (1, SCHEMA_VERSION)


class StoreError(ValueError):
    """A results folder that is not ours, cannot be read, or holds a damaged file."""


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a study of runs. Raises `StoreError` where the folder is missing or none of ours."""
    if not folder.is_dir():
        raise StoreError(f"{folder}: there is no such study folder")
    try:
        manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise StoreError(f"{folder}: has no manifest.json, so it is no study of ours; take another folder") from None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise StoreError(f"{folder}/manifest.json: cannot be read: {error}") from None
    if is_discovery(folder):
        raise StoreError(
            f"{folder}: is a study of bench discover; read CASE/report.html, findings.parquet and gaps.parquet"
        )
    if not isinstance(manifest, dict) or manifest.get("kind") != KIND:
        raise StoreError(f"{folder}/manifest.json: is not a manifest of ours; take another folder")
    if manifest.get("schema_version") not in _READABLE:
        raise StoreError(f"{folder}: schema {manifest.get('schema_version')}, this version reads {SCHEMA_VERSION}")
    if not isinstance(manifest.get("planned"), dict):
        raise StoreError(f"{folder}/manifest.json: its list of planned runs is damaged")
    found: dict[str, Any] = manifest
    return found


def write_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest, whole."""
    text = json.dumps(manifest, indent=1).encode()
    write_whole(folder / "manifest.json", lambda file: file.write(text))


def new_manifest(study: str) -> dict[str, Any]:
    """Return the manifest of a study of which nothing is planned yet."""
    return {"kind": KIND, "schema_version": SCHEMA_VERSION, "study": study, "planned": {}}


def studies_in(parent: Path) -> list[Path]:
    """Return the folders of the studies under `parent` that hold runs, by name; those of `bench discover` do not."""
    folders = [path.parent for path in sorted(parent.glob("*/manifest.json"))]
    return [folder for folder in folders if not is_discovery(folder)]


def is_discovery(folder: Path) -> bool:
    """Tell whether `folder` holds a study of `bench discover`."""
    try:
        manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(manifest, dict) and manifest.get("kind") == DISCOVERY
