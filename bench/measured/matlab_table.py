"""The variables of a MATLAB file as a table: vectors of one length, or a matrix beside a list of its columns' names.

The variables of a struct are its fields. What a file says of them is looked at before SciPy reads them, as a hundred
kilobytes can state more than the process bears. Files of version 7.3 are HDF5 and not read.
"""

import io
import struct
import warnings
import zlib
from collections import Counter
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, whosmat

from calibench.core.notes import Code, DataError, Note
from calibench.core.tables.columns import Columns, as_words
from calibench.core.tables.csv_table import heads
from calibench.core.tables.data_file import LARGEST_TEXT, MEGABYTE, MOST_NUMBERS, check_columns, read_whole
from calibench.core.words import shortened

_SMALLER = "take part of the readings or of the columns"
_LARGEST_UNPACKED = 200 * MEGABYTE  # twice the most numbers, and words
_MOST_SIDES = 32  # of an array, to NumPy 1
_DEEPEST = 10  # arrays inside arrays: a list of words inside a struct is 3
_HEAD, _PACKED, _SHAPE, _ARRAY = 128, 15, 5, 14  # bytes before the first element; kinds of elements


def read_matlab(path: Path, text: Collection[str] = ()) -> Columns:
    """Return the columns, of which `text` hold words, and the units that names in brackets state."""
    content = read_whole(path, LARGEST_TEXT, _SMALLER)
    if content[:64].startswith(b"MATLAB 7.3") or content[:8] == b"\x89HDF\r\n\x1a\n":
        raise DataError("is a MATLAB file of version 7.3, which is HDF5; save it with save('-v7', ...)")
    file: Any = io.BytesIO(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            _check_elements(content)
            stated = whosmat(file)
            count = sum(int(np.prod(shape)) for _, shape, _ in stated)
            if count > MOST_NUMBERS:
                raise DataError(f"has {count} numbers, and at most {MOST_NUMBERS} are read; {_SMALLER}")
            twice = next((name for name, times in Counter(name for name, *_ in stated).items() if times > 1), None)
            if twice is not None:
                raise DataError(f"column {twice} is there twice; give each a name of its own")
            file.seek(0)
            variables = loadmat(file, squeeze_me=True, struct_as_record=True, chars_as_strings=True)
    except (DataError, MemoryError):
        raise
    except Exception as error:  # scipy raises what zlib, NumPy and its own checks raise
        raise DataError(
            f"is no MATLAB file that can be read ({type(error).__name__}: {error}); save it as CSV"
        ) from None
    fields: dict[str, Any] = {}  # of structs in the place of these
    for name, value in variables.items():
        array = np.asarray(value)
        if name.startswith("__"):  # SciPy's own
            continue
        if array.dtype.names and array.ndim == 0:
            fields |= {field: array[field].item() for field in array.dtype.names}
        elif array.dtype.names:
            fields |= {field: np.array([one[field] for one in array.ravel()]) for field in array.dtype.names}
        else:
            fields[name] = value
    columns, notes = _columns(fields)
    names, units = heads(list(columns))
    check_columns(len(names))
    plain: dict[str, Any] = {}
    for name, column in zip(names, columns.values(), strict=True):
        if name in text or column.dtype.kind in "UO":
            plain[name] = as_words(name, [str(one) for one in column.tolist()])
        else:
            plain[name] = column.astype({"b": bool, "i": np.int64, "u": np.int64}.get(column.dtype.kind, float))
    return Columns(plain, notes=notes, units=units)


def _check_elements(content: bytes) -> None:
    """Raise `DataError` for variables that unpack to too much, state too much, or stand too deep in each other.

    A file of version 5 (also 6 and 7) is a row of elements: kind, length, content, of which an array has its flags,
    its shape, its name and then its values, or further arrays. Source: MathWorks, MAT-File Format, 2024, chapter 1.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[_HEAD - 2 : _HEAD])
    if order is None:
        return  # version 4, which packs and nests nothing
    unpacked, at = 0, _HEAD
    while at + 8 <= len(content):
        kind, size = struct.unpack_from(f"{order}II", content, at)
        at, inside = at + 8 + size, content[at : at + 8 + size]
        if kind == _PACKED:
            inside = zlib.decompressobj().decompress(inside[8:], _LARGEST_UNPACKED - unpacked + 1)
            unpacked += len(inside)
            if unpacked > _LARGEST_UNPACKED:
                raise DataError(
                    f"unpacks to more than {_LARGEST_UNPACKED // MEGABYTE} MB, and no more are read; {_SMALLER}"
                )
        ahead = [(0, len(inside), 0)]
        while ahead:
            start, end, deep = ahead.pop()
            ahead += _arrays_in(inside, order, start, end, deep)


def _arrays_in(content: bytes, order: str, at: int, end: int, deep: int) -> list[tuple[int, int, int]]:
    """Return where the arrays inside an array begin and end, and how deep they stand; refuse a shape that is none."""
    arrays, first = [], True
    while at + 8 <= end:
        kind, size = struct.unpack_from(f"{order}II", content, at)
        if kind >> 16:  # kind and length in one word, and the content in the other
            at += 8
            continue
        inside, at = at + 8, at + 8 + size + -size % 8
        if kind == _ARRAY:
            if deep == _DEEPEST:
                raise DataError(f"has arrays more than {_DEEPEST} deep in each other; write the columns by themselves")
            arrays.append((inside, min(inside + size, end), deep + 1))
        elif kind == _SHAPE and first and deep:
            shape = np.frombuffer(content, f"{order}i4", min(size, end - inside) // 4, inside)
            count = np.prod(shape, dtype=float)
            if len(shape) > _MOST_SIDES or shape.min(initial=0) < 0:
                raise DataError(f"has an array of the shape {shortened(str(shape.tolist()))}, which is none")
            if count > MOST_NUMBERS:
                raise DataError(f"has {count:.0f} numbers, and at most {MOST_NUMBERS} are read; {_SMALLER}")
            first = False
    return arrays


def _columns(named: dict[str, Any]) -> tuple[dict[str, Any], tuple[Note, ...]]:
    arrays = {name: np.asarray(value) for name, value in named.items()}
    words = {name: array for name, array in arrays.items() if _is_words(array)}
    matrices = {n: a for n, a in arrays.items() if a.ndim == 2 and a.dtype.kind in "iufb"}
    for matrix in matrices.values():
        for names in words.values():
            if len(names) == matrix.shape[1]:
                return {str(n).strip(): matrix[:, k] for k, n in enumerate(names)}, ()
    vectors = {n: a for n, a in arrays.items() if a.ndim == 1 and (a.dtype.kind in "iufb" or _is_words(a))}
    lengths = [len(a) for a in vectors.values() if a.dtype.kind in "iufb"]
    if len(matrices) == 1 and not lengths:
        [(name, matrix)] = matrices.items()
        last = matrix.shape[1]
        note = f"the columns of {name} have no names: they are called column_1 to column_{last}; columns= names them"
        return {f"column_{k + 1}": matrix[:, k] for k in range(matrix.shape[1])}, (Note(Code.FILE, note),)
    if not lengths and not matrices:
        there = ", ".join(f"{n} {a.shape}" for n, a in arrays.items()) or "nothing"
        raise DataError(f"holds {there}: vectors of one length, or a matrix and the names of its columns, are needed")

    # the vectors, and the columns of the matrices as NAME_1, NAME_2 ..., that have the usual number of rows
    rows = [*lengths, *map(len, matrices.values())]
    most = max(set(rows), key=lambda n: (rows.count(n), n))
    columns: dict[str, Any] = {}
    notes: list[Note] = []
    for name, array in arrays.items():
        if name in vectors and len(array) == most:
            columns[name] = array
        elif name in matrices and len(array) == most:
            columns |= {f"{name}_{k + 1}": array[:, k] for k in range(array.shape[1])}
            notes.append(Note(Code.FILE, f"the columns of {name} are called {name}_1 to {name}_{array.shape[1]}"))
    others = sorted(n for n in arrays if n not in {**vectors, **matrices} or len(arrays[n]) != most)
    if others:
        shapes = ", ".join(f"{n} ({' x '.join(map(str, arrays[n].shape)) or 'one value'})" for n in others)
        text = f"variables {shapes} have another shape and are not read: columns have {most} values"
        notes.append(Note(Code.COLUMNS_UNREAD, text, tuple(others)))
    return columns, tuple(notes)


def _is_words(array: Any) -> bool:
    return bool(array.ndim == 1 and len(array) and all(isinstance(one, str) for one in array.tolist()))
