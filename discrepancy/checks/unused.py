"""Refuse statements about the data that nothing reads: the user wanted to change something, and nothing changed.

A machine that declares which keys may be stated gives the list. For any other machine the keys that its code and its
effects look up are recorded.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, final

from calibench.core.options import suggest
from calibench.discrepancy.model.measured.data import DataError, MeasuredData
from calibench.discrepancy.registries import description_of

_ALWAYS = ("machine", "schema_version", "columns", "units")


@final
class Asked(dict[str, Any]):
    """Metadata that record which of their keys are looked up.

    `__iter__` records as well, because a merge reads all keys.
    """

    def __init__(self, of: Mapping[str, Any]) -> None:
        super().__init__(of)
        self.read: set[str] = set()

    def __getitem__(self, key: str) -> Any:
        """Return what is stated under `key`, and record that it was looked up."""
        self.read.add(key)
        return super().__getitem__(key)

    def get(self, key: str, default: Any = None) -> Any:
        """Return what is stated under `key`, or `default`, and record that it was looked up."""
        self.read.add(key)
        return super().get(key, default)

    def __iter__(self) -> Iterator[str]:
        return super().__iter__()


def listening(data: MeasuredData) -> tuple[MeasuredData, Asked]:
    """Return the data with metadata that record what is read of them, and these metadata."""
    asked = Asked(data.metadata)
    return replace(data, metadata=asked), asked


def refuse_unused(machine: str, data: MeasuredData, asked: Asked) -> None:
    """Raise `DataError` for a key that was stated beside the file and that neither the machine nor its effects read."""
    declared = [one.key for one in description_of(machine).stated]
    known = declared or sorted(asked.read)
    for key in sorted(data.stated):
        if key in _ALWAYS or key in declared or (not declared and key in asked.read):
            continue
        raise DataError(f"{data.name}: {key}= is stated, and nothing of {machine} reads it; {_way_out(key, known)}")


def _way_out(key: str, known: list[str]) -> str:
    choices = [one for one in known if one not in _ALWAYS]
    return suggest(key, choices) if choices else "leave it out"
