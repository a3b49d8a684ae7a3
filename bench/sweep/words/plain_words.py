"""Overrides of plain words and numbers, read and composed without Hydra.

Hydra is loaded for what needs its grammar: lists, globs, quotes, presets. ``problem=full12 budget=100`` does not, and
composing it by Hydra costs as much processor time as a small run. What is read here is a part of Hydra's grammar on
which there is nothing to decide, and whatever lies outside is left to Hydra. A test holds both to the same result.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

_KEY = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)?", re.ASCII)
_WORD = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_CLASS = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)  # MODULE:CLASS
_MEMBERS = ("problem", "optimizer")
_WHOLE = re.compile(r"-?(?:0|[1-9]\d{0,17})", re.ASCII)
_DECIMAL = re.compile(r"-?(?:0|[1-9]\d{0,17})(?:\.\d+)?(?:e[+-]?\d{1,2})?", re.ASCII)
_TEXT = re.compile(r"[\w.:/ +-]*", re.ASCII)
_RESERVED = {"null": None, "true": True, "false": False}
_NONE = object()


@final
@dataclass(frozen=True)
class PlainOverride:
    """One value for one key: what this program asks of Hydra's ``Override``, by the same names."""

    key_or_group: str
    input_line: str
    written: str  # as Hydra would write the value

    def value(self) -> Any:
        """Return the value."""
        return _value_of(self.written)

    def is_sweep_override(self) -> bool:
        """Tell whether there are several values."""
        return False

    def get_value_element_as_str(self) -> str:
        """Return the value as text that Hydra reads back."""
        return self.written


def plain_override(argument: str, as_text: bool) -> PlainOverride | None:
    """Return ``key=value`` as an override, its value as text to the letter or as it looks; None: Hydra must read it."""
    key, _, value = argument.partition("=")
    if _KEY.fullmatch(key) is None:
        return None
    if as_text:
        return PlainOverride(key, argument, f"'{value}'") if _TEXT.fullmatch(value) else None
    found = _value_of(value) if not value.startswith("'") else _NONE
    written = "null" if found is None else str(found)  # as Hydra does: 1e5 is 100000.0, true is True
    return None if found is _NONE else PlainOverride(key, argument, written)


def compose_plainly(
    overrides: Sequence[str],
    settings: Callable[[str], Mapping[str, Any]],
    member: Callable[[str, str], Mapping[str, Any] | None],
) -> dict[str, Any] | None:
    """Return the composition of ``key=value`` texts; None where Hydra must make it, or refuse it.

    `settings` returns the composition without overrides but the named execution; ``member(kind, name)`` the options of
    a problem or optimizer with their defaults, or None for a preset. An option is set where it is declared.
    """
    given = dict(text.partition("=")[::2] for text in overrides)
    values = {
        key: text if key in _MEMBERS and _CLASS.fullmatch(text) else _value_of(text) for key, text in given.items()
    }
    if len(given) < len(overrides) or _NONE in values.values():
        return None
    execution = values.pop("execution", "serial")
    composed: dict[str, Any] = {}
    for kind in _MEMBERS:
        if kind in values:
            options = member(kind, given[kind])
            if options is None or type(values.pop(kind)) is not str or not _is_plain(options):
                return None
            composed[kind] = dict(options)
    composed |= settings(str(execution))
    for key, value in values.items():
        group, dot, option = key.partition(".")
        inside = composed.get(group) if dot else composed
        name = option if dot else group
        if not isinstance(inside, dict) or name not in inside or isinstance(inside[name], dict):
            return None
        if key == "execution.name" or name == "study":  # what a member is, and a group of Hydra's
            return None
        inside[name] = value
    return composed


def _value_of(text: str) -> Any:
    """Return the value that Hydra reads from `text`; `_NONE` where that takes its grammar."""
    if _WHOLE.fullmatch(text):
        return int(text)
    if _DECIMAL.fullmatch(text):
        return float(text)
    if text.lower() in _RESERVED:
        return _RESERVED[text.lower()]
    if text[:1] == text[-1:] == "'" and len(text) > 1 and _TEXT.fullmatch(text[1:-1]):
        return text[1:-1]
    return text if _WORD.fullmatch(text) and text.lower() not in ("inf", "nan") else _NONE


def _is_plain(value: Any) -> bool:
    """Tell whether a default stands for itself: OmegaConf resolves ``${...}``, and changes other types."""
    if isinstance(value, dict | list):
        return all(_is_plain(item) for item in (value.values() if isinstance(value, dict) else value))
    return value is None or (type(value) in (str, int, float, bool) and "${" not in str(value))
