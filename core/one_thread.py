"""One thread of BLAS while a run or a search is under way: sums have one order, whatever the number of cores.

With more threads products of matrices are added up in another order, and a search that rounding decides ends elsewhere.
Matrices here are small besides: more threads cost more than they bring.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

STATED = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # who states one of them has chosen, and is not overruled
_LOOKED: dict[int, ThreadpoolController] = {}  # how many modules there were -> the libraries that were loaded


@contextmanager
def one_thread() -> Iterator[None]:
    """Hold BLAS at one thread; the number of before comes back at the end.

    Where ``OPENBLAS_NUM_THREADS`` or ``MKL_NUM_THREADS`` is set, that is obeyed and nothing is held. Of several threads
    of one process the first that asks decides for all of them (a rule of threadpoolctl).
    """
    if any(name in os.environ for name in STATED):
        yield
        return
    import scipy.linalg  # noqa: F401  its BLAS is another one than NumPy's, and must not come later with all threads

    with libraries().limit(limits=1, user_api="blas"):
        yield


def hold_new() -> None:
    """Within `one_thread`, hold a BLAS at one thread too that was loaded since."""
    if not any(name in os.environ for name in STATED):
        for library in libraries().select(user_api="blas").lib_controllers:
            library.set_num_threads(1)


def libraries() -> ThreadpoolController:
    """Return the libraries that are loaded; to look for them takes a millisecond, so only after a further import."""
    from threadpoolctl import ThreadpoolController

    modules = len(sys.modules)
    if modules not in _LOOKED:
        _LOOKED.clear()
        _LOOKED[modules] = ThreadpoolController()
    return _LOOKED[modules]
