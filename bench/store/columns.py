"""Columns of finished runs, read in one way whether pandas, Arrow or a list holds them.

So what is computed of them is written once, and a small sweep that is only told on a terminal does not load pandas.
Swept options become columns ``opt.population``, ``prob.n``: those alone that differ within the study.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from calibench.bench.store.arrays import cast, dictionary, numbers
from calibench.core.options import CLASS

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Columns(Protocol):
    """Columns of one length by name: a `pandas.DataFrame`, or a dictionary of Arrow's columns or of lists."""

    def __getitem__(self, name: str, /) -> Any: ...

    def __contains__(self, name: object, /) -> bool: ...


def columns_of(table: pa.Table) -> dict[str, pa.ChunkedArray]:
    """Return the columns of a table by name."""
    return dict(zip(table.column_names, table.columns, strict=True))


def floats(column: Any) -> Array:
    """Return a column as numbers, NaN where it has none."""
    if isinstance(column, pa.ChunkedArray):
        return numbers(cast(column, pa.float64(), safe=False), np.nan)
    if isinstance(column, list | np.ndarray):
        return np.asarray(column, dtype=float)
    found: Array = column.to_numpy(dtype=float, na_value=np.nan)
    return found


def plain(column: Any) -> list[Any]:
    """Return a column as Python has it, None where it has nothing; NaN is nothing."""
    if isinstance(column, pa.ChunkedArray) and (
        pa.types.is_string(column.type) or pa.types.is_dictionary(column.type)
    ):  # each text once, however many rows have it
        values, place = dictionary(column, missing=-1)
        texts = [*values.to_pylist(), None]
        return [texts[i] for i in place.tolist()]
    if isinstance(column, pa.ChunkedArray):
        values = column.to_pylist()
    elif isinstance(column, list | np.ndarray):
        values = [*column]
    else:
        values = column.to_numpy(dtype=object, na_value=None).tolist()
        if column.dtype == "str" or column.dtype.kind in "biu":
            return list(values)
    return [None if isinstance(value, float) and value != value else value for value in values]


def known(column: Any) -> Flags:
    """Tell where a column has something."""
    if hasattr(column, "notna"):
        return np.asarray(column.notna(), dtype=bool)
    return np.array([value is not None for value in plain(column)], dtype=bool)


def true(column: Any) -> Flags:
    """Tell where a column of flags has a true one."""
    return np.array([bool(value) for value in plain(column)], dtype=bool)


def numbered(columns: Iterable[Any]) -> Counts:
    """Return for each row the number, from 0, of what it has in `columns`; what comes first has the lowest."""
    held = [*columns]
    if held and all(hasattr(column, "factorize") for column in held):  # those of pandas, all rows at once
        import pandas as pd

        codes = np.zeros(len(held[0]), dtype=np.int64)
        for column in held:
            more, values = column.factorize()
            codes = pd.factorize(codes * (len(values) + 1) + more + 1)[0]
        return codes
    seen: dict[tuple[Any, ...], int] = {}
    rows = zip(*map(plain, held), strict=True)
    return np.array([seen.setdefault(row, len(seen)) for row in rows], dtype=np.int64)


def name_rows(table: pd.DataFrame, columns: Sequence[str], names_of: Callable[[list[Any]], Sequence[str]]) -> pd.Series:
    """Return for each row its name, which `names_of` gives to the different rows of `columns`, in their order."""
    import pandas as pd

    number = numbered(table[name] for name in columns)
    different = table[[*columns]].iloc[np.unique(number, return_index=True)[1]]
    names = np.array([*names_of([*zip(*(plain(different[name]) for name in columns), strict=True)])], dtype=object)
    text = pd.StringDtype("python", na_value=np.nan)  # held by reference: cheap to cut and to list
    named: pd.Series = pd.Series(names[number] if len(number) else [], index=table.index, dtype=text)
    return named


_KINDS = (("prob.", "problem", "problem_options"), ("opt.", "optimizer", "optimizer_options"))
PREFIXES = tuple(prefix for prefix, _, _ in _KINDS)  # of the columns
OF_OPTIONS = tuple(column for _, name, options in _KINDS for column in (name, options))

# a member of an enumeration, as rows write it; its class has a capital letter, which data:run.csv has not
_MEMBER = re.compile(r"[A-Za-z_][\w.]*:(?:[A-Za-z_]\w*\.)*_*[A-Z]\w*\.([A-Za-z_]\w*)")


def typed(value: Any) -> Any:
    """Return a value of a row's options as one types it: of a member of an enumeration its name."""
    found = _MEMBER.fullmatch(value) if isinstance(value, str) else None
    return found[1] if found else value


def parts(options: Mapping[str, Any], classes: bool = True) -> dict[str, Any]:
    """Return options with the fields of an object as options of their own, and its class where `classes`.

    >>> parts({"noise": {"class": "rig:Noise", "sigma": 0.1}}, classes=False)
    {'noise.sigma': 0.1}
    """
    found: dict[str, Any] = {}
    for key, value in options.items():
        if isinstance(value, Mapping) and CLASS in value:
            inside = parts(value, classes)
            found |= {f"{key}.{name}": part for name, part in inside.items() if classes or name != CLASS}
        else:
            found[key] = value
    return found


def with_options(runs: pd.DataFrame) -> pd.DataFrame:
    """Return `runs` with a column for each option of which some problem or optimiser has several values here.

    It is ``prob.NAME`` or ``opt.NAME``: floats (integers where none is missing), nullable booleans, else text; missing
    where there is no such option, or null. A mixture of kinds is text, as JSON.
    """
    import pandas as pd

    columns = {}
    for prefix, name, options in _KINDS:
        pairs = runs[[name, options]].drop_duplicates()
        read = {text: parts(json.loads(text)) for text in pairs[options]}
        seen: dict[str, dict[str, set[str]]] = {}
        for owner, text in pairs.itertuples(index=False):
            for key, value in read[text].items():
                seen.setdefault(key, {}).setdefault(owner, set()).add(json.dumps(value, sort_keys=True))
        for key in sorted(key for key, owners in seen.items() if any(len(values) > 1 for values in owners.values())):
            names = {v: typed(v) for text in read for v in [read[text].get(key)] if isinstance(v, str)}
            apart = len({*names.values()}) == len(names)  # no two members of one name
            values = [read[text].get(key) for text in runs[options]]
            values = [names[value] if apart and isinstance(value, str) else value for value in values]
            kinds = {type(value) for value in values if value is not None}
            dtype = "str"
            if kinds <= {bool}:
                dtype = "boolean"
            elif kinds <= {int, float}:
                dtype = "int64" if kinds == {int} and None not in values else "float64"
                values = [float("nan") if value is None else value for value in values]
            elif kinds != {str}:
                values = [None if v is None else json.dumps(v, sort_keys=True, ensure_ascii=False) for v in values]
            columns[prefix + key] = pd.Series(values, runs.index, dtype=dtype)
    return pd.concat([runs, pd.DataFrame(columns, index=runs.index)], axis=1) if columns else runs
