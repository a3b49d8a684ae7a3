"""Points that an optimiser may not ask for: outside the box by more than an ulp, or not finite. They are counted.

The check takes as long as all the rest of the gate's work for a scalar call. So only those optimisers are checked of
which nothing is known: those of other packages, and ours whose trait says ``bounded=False``. For all others the tests
prove that they stay in the box. The check also copies a point into an array of ours, so that the same point is counted,
evaluated and kept.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, final

import numpy as np

from calibench.bench.gate.evaluator import Evaluator
from calibench.problems.base import Array, frozen


@final
@dataclass(frozen=True)
class Doors:
    """The calls through which an optimiser evaluates: the gate's own, or with a check before each."""

    value: Callable[[Any], float]
    batch: Callable[[Any], Array]
    batch_below: Callable[[Any, Any], Array]
    residuals: Callable[[Any], Array]
    jacobian: Callable[[Any], Array]
    gradient: Callable[[Any], Array]
    value_and_gradient: Callable[[Any], tuple[float, Array]]


def doors_of(gate: Evaluator) -> Doors:
    """Return the gate's own calls."""
    return Doors(
        gate.single_call(), gate.batch, gate.batch_below, gate.residuals, gate.jacobian, gate.gradient,
        gate.value_and_gradient,
    )  # fmt: skip


def watched_doors_of(gate: Evaluator) -> Doors:
    """Return the gate's calls, each with a check of its points; those outside are counted in `outside_evaluations`."""
    outside, many = looks()
    box = frozen([np.nextafter(gate.lower, -np.inf), np.nextafter(gate.upper, np.inf)])
    shape, ndarray = gate.lower.shape, np.ndarray
    value, batch, batch_below = gate.single_call(), gate.batch, gate.batch_below
    residuals, jacobian = gate.residuals, gate.jacobian
    gate.outside_evaluations = 0

    def point(x: Any) -> Array:
        """Return x as an array of ours, shape (dim,)."""
        own: Array = np.array(x, dtype=np.float64, order="C")
        if own.shape != shape:
            raise ValueError(f"the objective takes a point of shape {shape}, and was given {own.shape}")
        return own

    def look(x: Any) -> Array:
        """Return x as `point` does, and count it."""
        own = point(x)
        if outside(own, box):
            gate.note_outside(1)
        return own

    def one(x: Any) -> float:
        if type(x) is ndarray:
            try:
                inside = not outside(x, box)
            except TypeError:  # of another kind of number, or of other strides
                inside = False
            if inside:  # as nearly always
                return value(x)
        return value(look(x))

    def looked_at_all(points: Any) -> Array:
        own = points if type(points) is np.ndarray else np.array(points, dtype=np.float64)
        if own.ndim == 2 and own.shape[1:] == shape:
            own = np.ascontiguousarray(own, dtype=np.float64)
            found = many(own[: max(gate.remaining, 0)], box)
            if found:
                gate.note_outside(found)
        return own

    return Doors(
        one,
        lambda points: batch(looked_at_all(points)),
        lambda points, limits: batch_below(looked_at_all(points), np.array(limits, dtype=np.float64)),
        lambda x: residuals(look(x)),
        lambda x: jacobian(point(x)),
        lambda x: gate.gradient(point(x)),
        lambda x: gate.value_and_gradient(look(x)),
    )


@cache
def looks() -> tuple[Any, Any]:
    """Return the checks of one point and of many, compiled before any clock starts and any child is forked."""
    from calibench.bench.gate._scan_kernels import is_outside, outside_of
    from calibench.core.compilation.compiled import exact

    return exact(is_outside, 1, 2), exact(outside_of, 2, 2)
