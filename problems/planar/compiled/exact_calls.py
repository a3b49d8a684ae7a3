"""The calls of a planar problem that take the caller's array as it is: a copy would cost a call a third of its time.

Such a kernel takes C-ordered float64 arrays of the problem's dimension, and refuses all else by an exception: a
`TypeError` for another type or layout, a `ValueError` for another length (`REFUSED`). Who gets one asks again with what
`CompiledProblem.vector` makes of the array, which also finds the words for an array that cannot be taken at all.
"""

from __future__ import annotations

from typing import Any, Literal, final

from calibench.core.compilation.compiled import exact
from calibench.problems.base import Array

REFUSED = (TypeError, ValueError)


@final
class ExactCalls:
    """``cost(x, packed)``, ``batch(points, packed)`` and ``batch_below(points, limits, packed, screen)``.

    Each is compiled at its first call, as making a problem must not wait for the compiler, and stands ready in its
    slot from then on: a call costs no more than the look at that slot.
    """

    __slots__ = ("batch", "batch_below", "cost", "packed", "screen")

    cost: Any
    batch: Any
    batch_below: Any

    def __init__(self, packed: Array) -> None:
        # Here, as listing the names must not load the compiler.
        from calibench.problems.planar.compiled import _abandon_kernels, _closed_loop_kernels

        self.packed, self.screen = packed, _abandon_kernels.screen(packed)
        self._compile_later("cost", _closed_loop_kernels.cost, 1, 2)
        self._compile_later("batch", _closed_loop_kernels.batch, 2, 2)
        self._compile_later("batch_below", _abandon_kernels.batch_below, 2, 1, 2, 2)

    def _compile_later(self, slot: Literal["cost", "batch", "batch_below"], kernel: Any, *dimensions: int) -> None:
        def first(*arrays: Array) -> Any:
            ready = exact(kernel, *dimensions)
            setattr(self, slot, ready)
            return ready(*arrays)

        setattr(self, slot, first)
