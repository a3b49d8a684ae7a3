"""Names and units that the owner of a file gives to its columns: `columns=` and `units=`.

`columns={"enc_1": "Winkel 1"}`: the column that the file calls Winkel 1 is enc_1. `units={"enc_1": "deg"}`: what the
numbers are in, where the file does not say it, or not in a way that is understood.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from calibench.bench.measured.found import Found
from calibench.core.annotated import read_word
from calibench.core.options import suggest
from calibench.core.tables.csv_table import heads
from calibench.core.tables.units import is_unit
from calibench.discrepancy import DataError
from calibench.discrepancy.registries import description_of


def pairs_of(key: str, value: Any) -> dict[str, str]:
    """Return what `columns=` or `units=` states, name -> word: a mapping, or name:word with commas between.

    A shell, YAML and JSON leave it with and without quotation marks and braces.

    >>> pairs_of("columns", "enc_1:Winkel 1,enc_2:Winkel 2")
    {'enc_1': 'Winkel 1', 'enc_2': 'Winkel 2'}
    >>> pairs_of("units", "{Winkel 1:deg}")
    {'Winkel 1': 'deg'}

    Raises `DataError` for anything else.
    """
    example = '{"x": "Weg X"}' if key == "columns" else '{"x": "mm"}'
    said = value
    if isinstance(value, str):
        word = value.strip()
        value = read_word(word if word[:1] == "{" else f"{{{word}}}", dict[str, str])
    if not isinstance(value, Mapping) or not all(isinstance(w, str) and n and w for n, w in value.items()):
        raise DataError(f"{key}={said}: names with words are needed, such as {key}={example}")
    return {str(name): word for name, word in value.items()}


def renamed(found: Found, machine: str, columns: Mapping[str, str], units: Mapping[str, str]) -> Found:
    """Return what a file holds, under the names that `columns` give it, and in the units that `units` state.

    Raises `DataError` for a column there is not, one that is named twice, and a name that is taken already.
    """
    there = {source: target for target, source in ((t, _plain(s, found)) for t, s in columns.items())}
    described = description_of(machine)
    known = [column.name for column in described.columns]
    for target, source in columns.items():
        if _plain(source, found) not in found.columns:
            raise DataError(f"columns: {target} is to be {source!r}; {suggest(source, list(found.columns))}")
        of_a_part = described.named is not None and described.named(target) is not None  # such as q_ and a joint
        if known and target not in known and not of_a_part:
            raise DataError(f"columns: {target!r} is no column of {machine}; {suggest(target, known)}")
        if target in found.columns and target not in there:
            raise DataError(f"columns: {target} is in the file already, beside {source!r}; leave out one of them")
    if len(there) < len(columns):
        twice = next(source for source in columns.values() if list(columns.values()).count(source) > 1)
        raise DataError(f"columns: {twice!r} cannot be two columns at once; name each once")
    stated = {there.get(name, name): unit for name, unit in found.units.items()}
    notes = list(found.notes)
    for source, target in there.items():
        last = source.rpartition("_")[2]
        if target not in stated and target not in units and source != target and _tells_unit(source, last):
            stated[target] = last
            notes.append(f"{target}: the name {source} states the unit {last}")
    renamed_columns = {there.get(name, name): column for name, column in found.columns.items()}
    for name, unit in units.items():
        if there.get(name, name) not in renamed_columns:
            raise DataError(f"units: {name} is no column of the file; {suggest(name, list(renamed_columns))}")
        if {name, columns.get(name)} & found.of_day and unit.strip() != "s":
            raise DataError(
                f"units: {name} holds times of day, read in seconds; write an angle as one number of degrees"
            )
        stated[there.get(name, name)] = unit
    return replace(found, columns=renamed_columns, units=stated, notes=tuple(notes))


def of_part(
    found: Found, columns: Mapping[str, str], units: Mapping[str, str]
) -> tuple[dict[str, str], dict[str, str]]:
    """Return those of `columns` and `units`, stated for several files, that concern this one."""
    names = {target: source for target, source in columns.items() if _plain(source, found) in found.columns}
    there = {*found.columns, *names, *names.values()}
    return names, {name: unit for name, unit in units.items() if name in there}


def _plain(source: str, found: Found) -> str:
    """Return the name of a column whose head, with or without its unit, is `source`."""
    if source in found.columns:
        return source
    try:
        [name], units = heads([source])
    except ValueError:
        return source
    return name if units.get(name) == found.units.get(name, "\0") else source


def _tells_unit(source: str, last: str) -> bool:
    return source != last and len(last) > 1 and (is_unit(last) or last.casefold() == "grad")
