"""Seeds from names: the same names give the same numbers in every process, on every machine and in any order of jobs.

Python's `hash` differs from process to process, so names become numbers by a digest of their JSON.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from hashlib import blake2b
from typing import Any

import numpy as np

_BASE = 2008  # the first word of every seed sequence


def digest(*parts: Any) -> str:
    """Return 16 hexadecimal digits that stand for `parts`."""
    return blake2b(json.dumps(parts, sort_keys=True, default=list).encode(), digest_size=8).hexdigest()


def seed_sequence(*names: Any, repetition: int) -> np.random.SeedSequence:
    """Return the seed sequence of these names, each as it is or as the number of its digest, and the repetition."""
    words = [name if isinstance(name, int) else int(digest(name), 16) for name in names]
    entropy = [half for number in (_BASE, *words, repetition) for half in _halves(number)]
    return np.random.SeedSequence(np.array(entropy, dtype=np.uint32))


def _halves(number: int) -> Iterator[int]:
    """Yield the words of 32 bits that NumPy makes of a number, the lowest first: its own way takes five times as long.

    >>> list(_halves(0)), list(_halves(7 + (5 << 32)))
    ([0], [7, 5])
    """
    yield number & 0xFFFFFFFF
    while number := number >> 32:
        yield number & 0xFFFFFFFF
