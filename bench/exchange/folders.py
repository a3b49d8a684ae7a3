"""An output folder that appears whole or not at all: filled under a temporary name beside it, then renamed."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path

from calibench.bench.provenance.run_id import digest
from calibench.bench.store.files.atomic_file import temporary_name

_NOT_PLAIN = re.compile(r"[^A-Za-z0-9_.=+-]+")
_LONGEST = 120  # characters of a name; a file system takes 255 bytes, of which the formats add some


def require_free(target: Path) -> None:
    """Raise `ValueError` where `target` is there already: a file, or a folder with something in it."""
    if target.is_dir() and not any(target.iterdir()):
        return
    if target.exists() or target.is_symlink():
        what = "is there and is not empty" if target.is_dir() else "is a file"
        raise ValueError(f"--to {target}: {what}; name a new folder")


def write_folder(target: Path, fill: Callable[[Path], None]) -> None:
    """Let `fill` write into a folder that is then called `target`; what goes wrong leaves nothing behind."""
    require_free(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = temporary_name(target.absolute())
    temporary.mkdir()
    try:
        fill(temporary)
        os.replace(temporary, target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def file_name(text: str) -> str:
    """Return `text` as the name of a file or folder that any system and reader takes; a long one ends in a digest.

    >>> file_name("de (population=200), budget 400")
    'de_population=200_budget_400'
    """
    plain = _NOT_PLAIN.sub("_", text).strip("_.") or "unnamed"
    return plain if len(plain) <= _LONGEST else f"{plain[:_LONGEST]}-{digest(text)[:6]}"


def file_names(texts: list[str]) -> dict[str, str]:
    """Return such a name for each of `texts`: no two are the same, nor the same but for capitals."""
    names: dict[str, str] = {}
    taken: set[str] = set()
    for text in texts:
        plain = name = file_name(text)
        count = 1
        while name.lower() in taken:
            count += 1
            name = f"{plain}_{count}"
        taken.add(name.lower())
        names[text] = name
    return names
