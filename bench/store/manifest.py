"""What a folder of results says of itself: its manifest, and the notes and tags that people gave it.

``manifest.json`` says what the folder is, which runs it is to have, by which commands. ``notes.json`` belongs to
whatever folder it stands in: a study, a discovery, a calibration. It goes wherever the study goes: `bench merge` joins
the notes of its sources, `bench pack` and the exports carry them.
"""

import json
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, final

from calibench.bench.execution.run_row import SCHEMA_VERSION
from calibench.bench.store.atomic_file import write_whole
from calibench.core.options import suggest
from calibench.core.plain import json_of
from calibench.core.tables.data_file import read_whole

KIND = "calibench study"
LARGEST_MANIFEST = 200_000_000  # bytes: that of five million planned runs has less
DISCOVERY = "calibench discovery"  # the kind of the studies of `bench discover`, which `bench.discovery.store` keeps


class StoreError(ValueError):
    """A results folder that is not ours, cannot be read, or holds a damaged file."""


_ENTRIES: dict[str, tuple[type, ...]] = {  # a dictionary or list, and of what
    "planned": (dict, str, str), "called": (dict, str, str), "budgets": (dict, str, int), "abandoned": (list, str),
    "commands": (list, str), "other_shards": (list, str), "files": (dict, str, str), "costs": (list, dict),
}  # fmt: skip


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a study of runs: kind, schema_version, study, planned {run_id: label of its cell} ...

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
        found: Any = json_of(read_whole(path, LARGEST_MANIFEST))
    except FileNotFoundError:
        raise StoreError(
            f"{folder}: has no manifest.json, so it is no study of ours; take another folder{_near(folder)}"
        ) from None
    except (OSError, ValueError) as error:
        raise StoreError(f"{path}: cannot be read: {error}") from None
    manifest: dict[str, Any] = found if isinstance(found, dict) else {}
    if manifest.get("kind") == DISCOVERY:
        raise StoreError(
            f"{folder}: is a study of bench discover; read CASE/report.html, findings.parquet and gaps.parquet"
        )
    if manifest.get("kind") != KIND:
        raise StoreError(f"{path}: is not a manifest of ours; take another folder")
    if manifest.get("schema_version") != SCHEMA_VERSION:
        raise StoreError(f"{folder}: schema {manifest.get('schema_version')!r}, this version reads {SCHEMA_VERSION}")
    cells = manifest.pop("cells", None)  # as it is written: a label once, and the runs of its cell
    try:
        manifest["planned"] = {run_id: cell["label"] for cell in cells for run_id in cell["runs"]}
        for key, name in (("called", "called"), ("budgets", "budget")):
            manifest[key] = {cell["label"]: cell[name] for cell in cells if name in cell}
    except (TypeError, KeyError):
        raise StoreError(f"{path}: its entry 'planned' is damaged") from None
    if not (isinstance(manifest.get("study"), str) and manifest["study"]):
        raise StoreError(f"{path}: its entry 'study' is damaged")
    for key, (kind, *inside) in _ENTRIES.items():
        entry = manifest.get(key)
        if entry is None:
            continue
        whole = isinstance(entry, kind)
        columns = () if not whole else (entry,) if kind is list else (entry, entry.values())
        if not whole or any(
            not issubclass(found, one) for column, one in zip(columns, inside) for found in {*map(type, column)}
        ):
            raise StoreError(f"{path}: its entry {key!r} is damaged")
    return manifest


def write_manifest(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest, whole."""
    cells: dict[str, list[str]] = {}
    for run_id, label in manifest["planned"].items():
        cells.setdefault(label, []).append(run_id)
    rest = {key: value for key, value in manifest.items() if key not in ("planned", "called", "budgets")}
    lines = [f" {json.dumps(key)}: " + json.dumps(value, indent=1).replace("\n", "\n ") for key, value in rest.items()]
    names = {"called": manifest.get("called", {}), "budget": manifest.get("budgets", {})}
    runs = ",\n".join(
        "  "
        + json.dumps({"label": label} | {key: of[label] for key, of in names.items() if label in of} | {"runs": ids})
        for label, ids in cells.items()
    )
    text = "{\n" + ",\n".join([*lines, f' "cells": [\n{runs}\n ]']) + "\n}\n"
    write_whole(folder / "manifest.json", text.encode())


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
        manifest = json_of(read_whole(folder / "manifest.json", LARGEST_MANIFEST))
    except (OSError, ValueError):
        return False
    return isinstance(manifest, dict) and manifest.get("kind") == DISCOVERY


def _near(parent: Path, name: str = "") -> str:
    """Return a hint of the studies that stand in `parent`; '' where there are none."""
    known = [path.parent.name for path in sorted(parent.glob("*/manifest.json"))]
    return f"; in {parent} {suggest(name, known)}" if known else ""


NOTES = "notes.json"
LONGEST_NOTE, MOST_NOTES = 4_000, 10_000  # characters of a note; notes of a study
_LARGEST = 50_000_000  # bytes of the file
_TAG = re.compile(r"\w[\w.-]{0,39}")


@final
@dataclass(frozen=True)
class Note:
    """What was written `at` a time (ISO, UTC) of the run `run_id`, or of the whole study where that is empty."""

    at: str
    text: str
    run_id: str = ""


@final
@dataclass(frozen=True)
class Notes:
    """All that is noted of one folder."""

    tags: tuple[str, ...] = ()
    archived: bool = False
    notes: tuple[Note, ...] = ()

    def with_note(self, text: str, run_id: str = "") -> "Notes":
        """Return these and one note more. Raises `ValueError` for one that is empty or too long."""
        said = text.strip()
        if not said or len(said) > LONGEST_NOTE:
            raise ValueError(f"note: a text of 1 to {LONGEST_NOTE} characters is needed")
        if len(self.notes) >= MOST_NOTES:
            raise ValueError(f"note: this study has {MOST_NOTES} notes, which is the most")
        now = datetime.now(UTC).isoformat(timespec="seconds")
        return replace(self, notes=(*self.notes, Note(now, said, run_id)))

    def with_tags(self, changes: Sequence[str]) -> "Notes":
        """Return these after changes such as ``+paper`` and ``-draft``. Raises `ValueError` for any other word."""
        tags = dict.fromkeys(self.tags)
        for change in changes:
            if change[:1] not in ("+", "-") or not _TAG.fullmatch(change[1:]):
                raise ValueError(
                    f"tag: {change!r} is no change of a tag; write +paper or -draft, a word of at most 40 letters, "
                    "digits, '_', '.' or '-'"
                )
            if change[0] == "+":
                tags[change[1:]] = None
            else:
                tags.pop(change[1:], None)
        return replace(self, tags=tuple(tags))

    def of_run(self, run_id: str) -> list[str]:
        """Return what is noted of one run."""
        return [note.text for note in self.notes if note.run_id == run_id]


def read_notes(folder: Path) -> Notes:
    """Return what is noted of a folder, nothing where nobody noted anything. Raises `StoreError` for a damaged file."""
    path = folder / NOTES
    try:
        found: Any = json_of(read_whole(path, _LARGEST))
        listed = tuple(Note(one["at"], one["text"], one["run_id"]) for one in found["notes"])
        notes = Notes(tuple(found["tags"]), found["archived"], listed)
        texts = [*notes.tags, *(text for note in notes.notes for text in (note.at, note.text, note.run_id))]
        whole = all(isinstance(text, str) for text in texts) and isinstance(notes.archived, bool)
        if not whole or not all(_TAG.fullmatch(tag) for tag in notes.tags):
            raise TypeError
    except FileNotFoundError:
        return Notes()
    except (OSError, ValueError, KeyError, TypeError):
        raise StoreError(f"{path}: holds no notes of ours; put back a copy, or delete it") from None
    return notes


def write_notes(folder: Path, notes: Notes) -> Path:
    """Write the notes of a folder, whole."""
    return write_whole(folder / NOTES, json.dumps(asdict(notes), indent=1, ensure_ascii=False).encode())
