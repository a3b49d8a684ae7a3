"""The words for rows in a table, the same for all files: which are valid, and which are kept from the fit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_VALID, _NOT = ("true", "1", "1.0", "yes", "y", "t", "ok"), ("false", "0", "0.0", "no", "n", "f", "", "nan", "none")
_SPLIT, _UNTOLD = ("train", "hold"), ("", "nan", "none")


def valid_rows(words: Any) -> NDArray[np.bool_]:
    """Return which rows the words of a column `valid`, (n,), mark as valid, (n,); an empty cell marks none.

    >>> valid_rows(["Yes", "0", ""]).tolist()
    [True, False, False]

    Raises `ValueError` for any other word.
    """
    said = _said(words)
    _refuse_others("valid", said, (*_VALID, *_NOT), "true or false (1 or 0, yes or no, y or n, t or f, ok)")
    return np.isin(said, _VALID)


def split_rows(words: Any) -> NDArray[np.str_]:
    """Return the part of each row by the words of a column `split`, (n,): train, hold, or "" for an empty cell.

    >>> split_rows(["Train", "hold", ""]).tolist()
    ['train', 'hold', '']

    Raises `ValueError` for any other word, because rows that were kept for checking must not be fitted.
    """
    said = _said(words)
    _refuse_others("split", said, (*_SPLIT, *_UNTOLD), "train (fitted) or hold (kept back)")
    return np.where(np.isin(said, _SPLIT), said, "")


def _said(words: Any) -> NDArray[np.str_]:
    return np.char.lower(np.char.strip(np.asarray(words).astype(str)))


def _refuse_others(column: str, said: NDArray[np.str_], known: tuple[str, ...], needed: str) -> None:
    if other := sorted(set(said.tolist()) - set(known)):
        raise ValueError(f"column {column} holds {other[0]!r}; {needed} is needed")
