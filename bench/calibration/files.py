"""The files of an arm's measurement as one table: several series, joints and tracker apart, or a folder of sockets.

Files with the same columns follow each other; others with as many rows are joined row by row. A folder of folders with
hole_0.csv ... (or socket_K) is one place of a tool with sockets each, named by its path.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calibench.bench.measured.files import read_sockets, socket_files
from calibench.bench.measured.sources import joined, sets
from calibench.calibration import columns
from calibench.calibration.readings import Table
from calibench.core.notes import DataError, once
from calibench.core.plain import json_of
from calibench.core.tables import csv_table
from calibench.core.tables.columns import Columns, Declared, Quantity, columns_of

_DEMONSTRATIONS = Path(__file__).resolve().parents[2] / "discrepancy" / "demo" / "arm"
ARM = replace(columns.ARM, demonstrations=_DEMONSTRATIONS)
_PRIORS = Declared("", (Quantity("name", text=True),))


def read_table(named: str, stated: Mapping[str, Any]) -> Table:
    """Return the table of ``data=named``: a file, a glob, files parted by commas, or a folder. Raises `DataError`."""
    path = Path(named).expanduser()
    if named and path.is_dir():
        # the postures of all sockets of all places below a folder
        if not socket_files(path):
            raise DataError(
                f"{path}: holds no hole_0.csv, hole_1.csv or socket_0.csv in folders by place; name a file of readings"
            )
        by_label, note = read_sockets(path, ARM, stated)
        whole = _one_after_the_other([_of_one(label, content) for label, content in by_label.items()])
        return replace(whole, name=path.name, notes=(note, *whole.notes))
    named_sets = sets(named, ARM, stated)
    several = len(named_sets) > 1
    contents = [one.columns(ARM, stated, part=several) for one in named_sets]
    read = [_of_one(one.case, content) for one, content in zip(named_sets, contents, strict=True)]
    if not several:
        return read[0]
    first = set(read[0].columns)
    if all(set(one.columns) == first for one in read):
        return _one_after_the_other(read)
    return _of_one(read[0].name, joined(dict(zip([one.name for one in read], contents, strict=True)), stated))


def read_priors(named: str) -> dict[str, tuple[float, float]]:
    """Return what ``priors=`` states, name -> value and sd: a table with these columns, or JSON. Raises `DataError`."""
    try:
        if named.lstrip().startswith("{"):
            rows = [(name, *pair) for name, pair in json_of(named).items()]
        else:
            table = columns_of(csv_table.read_table(Path(named).expanduser()), _PRIORS).columns
            rows = list(zip(*(table[key].tolist() for key in ("name", "value", "sd")), strict=True))
        return {str(name): (float(value), float(sd)) for name, value, sd in rows}
    except KeyError as error:
        raise DataError(f"priors={named}: has no column {error}; name, value and sd are needed") from None
    except OSError as error:
        raise DataError(f"priors={named}: {error.strerror}") from None
    except (AttributeError, TypeError, ValueError) as error:
        raise DataError(f"priors={named}: {error}; name, value and sd are needed, in mm and rad") from None


def _of_one(name: str, content: Columns) -> Table:
    return Table.of(content.columns, name, units=content.units, stated=content.metadata, notes=content.notes)


def _one_after_the_other(tables: Sequence[Table]) -> Table:
    for one in tables[1:]:
        other = {name for name in one.units if one.units[name] != tables[0].units.get(name)}
        if other:
            raise DataError(f"{one.name}: column {min(other)} is in another unit than in {tables[0].name}")
    columns = {name: np.concatenate([one.columns[name] for one in tables]) for name in tables[0].columns}
    file, row = (np.concatenate([getattr(one, key) for one in tables]) for key in ("file", "row"))
    name = "_".join(one.name for one in tables) if len(tables) <= 3 else tables[0].name
    notes = once(note for one in tables for note in one.notes)
    return Table(
        columns=columns, units=tables[0].units, stated=tables[0].stated, file=file, row=row, name=name, notes=notes
    )
