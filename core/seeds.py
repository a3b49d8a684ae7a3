"""Seeds from names: the same names give the same numbers in every process, on every machine and in any order of jobs.

Python's `hash` differs from process to process, so names become numbers by a digest of their JSON.
"""

from __future__ import annotations

import json
from hashlib import blake2b
from typing import Any

import numpy as np

_BASE = 2008  # the first word of every seed sequence


def digest(*parts: Any) -> str:
    """Return 16 hexadecimal digits that stand for `parts`."""
    return blake2b(json.dumps(parts, sort_keys=True, default=list).encode(), digest_size=8).hexdigest()


def seed_sequence(*names: Any, repetition: int) -> np.random.SeedSequence:
    """Return the seed sequence of these names, each as it is or as the number of its digest, and the repetition."""
    words = (name if isinstance(name, int) else int(digest(name), 16) for name in names)
    return np.random.SeedSequence([_BASE, *words, repetition])
