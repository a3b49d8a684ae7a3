"""Seeds from names: the same names give the same numbers in every process, on every machine and in any order of jobs.

Python's `hash` differs from process to process, so names become numbers by a digest of their JSON.
"""

import json
import random
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.random.mtrand import get_bit_generator, set_bit_generator

_BASE = 2008  # the first word of every seed sequence
_STANDING: list[np.random.BitGenerator] = []  # behind ``np.random`` in the blocks under way, the innermost last
_FREE: list[np.random.BitGenerator] = []  # to make one takes longer than to begin it


def digest(*parts: Any) -> str:
    """Return 16 hexadecimal digits that stand for `parts`."""
    return blake2b(json.dumps(parts, sort_keys=True, default=list).encode(), digest_size=8).hexdigest()


def seed_sequence(*names: Any, repetition: int) -> np.random.SeedSequence:
    """Return the seed sequence of these names, each as it is or as the number of its digest, and the repetition."""
    words = [name if isinstance(name, int) else int(digest(name), 16) for name in names]
    halves = []  # the words of 32 bits that NumPy makes of a number, the lowest first, in a fifth of the time
    for number in (_BASE, *words, repetition):
        halves.append(number & 0xFFFFFFFF)
        while number := number >> 32:
            halves.append(number & 0xFFFFFFFF)
    return np.random.SeedSequence(np.array(halves, dtype=np.uint32))


@contextmanager
def global_generators(sequence: np.random.SeedSequence) -> Iterator[None]:
    """Begin the generators of `random` and of ``np.random`` at `sequence`, and have them go on after it as before."""
    mine, theirs = random.getstate(), get_bit_generator()
    before = np.random.get_state(legacy=False)  # noqa: NPY002
    _STANDING.append(_FREE.pop() if _FREE else np.random.MT19937())
    try:
        begin_generators(sequence)
        yield
    finally:
        _FREE.append(_STANDING.pop())
        random.setstate(mine)
        set_bit_generator(theirs)
        if before["has_gauss"]:
            np.random.set_state(before)  # noqa: NPY002


def begin_generators(sequence: np.random.SeedSequence) -> None:
    """Begin the generators of `random` and of ``np.random`` at `sequence`."""
    words = sequence.generate_state(8)
    if _STANDING:
        set_bit_generator(_STANDING[-1])  # whatever a run has set meanwhile, also one that cannot be seeded
    random.seed(words.tobytes())
    np.random.seed(words)  # noqa: NPY002
