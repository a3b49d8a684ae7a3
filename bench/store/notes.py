"""Notes and tags of a study: what people say of it, in ``notes.json`` beside tables that stay as they were written.

The file belongs to whatever folder of results it stands in: a study, a discovery, a calibration. It goes wherever the
study goes: `bench merge` joins the notes of its sources, `bench pack` and the exports carry them.
"""

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, final

from calibench.bench.store.atomic_file import write_whole
from calibench.bench.store.manifest import StoreError
from calibench.core.plain import json_of
from calibench.core.tables.data_file import read_whole

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
        notes = Notes(
            tuple(found["tags"]),
            found["archived"],
            tuple(Note(one["at"], one["text"], one["run_id"]) for one in found["notes"]),
        )
        texts = [*notes.tags, *(text for note in notes.notes for text in (note.at, note.text, note.run_id))]
        if not all(isinstance(text, str) for text in texts) or not isinstance(notes.archived, bool):
            raise TypeError
        if not all(_TAG.fullmatch(tag) for tag in notes.tags):
            raise TypeError
    except FileNotFoundError:
        return Notes()
    except (OSError, ValueError, KeyError, TypeError):
        raise StoreError(f"{path}: holds no notes of ours; put back a copy, or delete it") from None
    return notes


def write_notes(folder: Path, notes: Notes) -> Path:
    """Write the notes of a folder, whole."""
    text = json.dumps(asdict(notes), indent=1, ensure_ascii=False).encode()
    return write_whole(folder / NOTES, lambda file: file.write(text))


def join_notes(sources: Iterable[Path], target: Path) -> None:
    """Add to the notes and tags of `target` those of the `sources`, each once."""
    parts = [read_notes(folder) for folder in (target, *sources)]
    tags = dict.fromkeys(tag for part in parts for tag in part.tags)
    notes = dict.fromkeys(note for part in parts for note in part.notes)
    joined = Notes(tuple(tags), parts[0].archived, tuple(sorted(notes, key=lambda note: note.at)))
    if joined != parts[0]:
        write_notes(target, joined)
