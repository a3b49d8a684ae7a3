"""What an optimiser gets instead of the gate: a face with its calls and live values, which nobody can set.

Values are copies. To set or delete an attribute, or to pickle a face, raises an error in the optimiser, and is noted in
the run's row. This keeps honest code honest: in one process of Python nothing can be hidden from code that searches it.

The calls go through doors. Points outside the box by more than an ulp, or not finite, are counted; that takes as long
as all the rest of the gate's work for a scalar call. So only those optimisers are checked of which nothing is known, of
other packages, and ours whose trait says ``bounded=False``: for all others the tests prove that they stay in the box.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from operator import attrgetter
from typing import Any, NoReturn

import numpy as np

from calibench.bench.gate.evaluator import Evaluator
from calibench.optimizers.base import Objective
from calibench.problems.base import Array

NUMBERS = (
    "batch_evaluations", "best_evaluation", "best_value", "charged", "evaluations", "gradient_evaluations",
    "jacobian_evaluations", "joint_evaluations", "non_finite", "non_finite_slopes", "outside_evaluations", "remaining",
    "residual_evaluations", "restarts", "stopped",
)  # fmt: skip
COPIES = ("best_x", "hits", "hits_charged", "trace")
FIXED = (
    "budget", "dimension", "has_gradient", "has_jacobian", "has_residuals", "lower", "start", "target", "targets",
    "upper",
)  # fmt: skip
KNOWN = frozenset({*NUMBERS, *COPIES, *FIXED})  # what a run knows of itself, for the optimiser to read
METHODS = ("batch", "batch_below", "gradient", "jacobian", "residuals", "value_and_gradient", "restart")


Doors = dict[str, Callable[..., Any]]  # the calls through which an optimiser evaluates, by name


def doors_of(gate: Evaluator) -> Doors:
    """Return the gate's own calls."""
    return {"__call__": gate.single_call(), **{name: getattr(gate, name) for name in METHODS}}


def watched_doors_of(gate: Evaluator) -> Doors:
    """Return the gate's calls, each with a check of its points; those outside are counted in `outside_evaluations`."""
    outside, many = looks()
    box = np.array([np.nextafter(gate.lower, -np.inf), np.nextafter(gate.upper, np.inf)])  # writable: 30 ns less a call
    shape, batch, batch_below = gate.lower.shape, gate.batch, gate.batch_below
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

    def looked_at_all(points: Any) -> Array:
        own = points if type(points) is np.ndarray else np.array(points, dtype=np.float64)
        if own.ndim == 2 and own.shape[1:] == shape:
            own = np.ascontiguousarray(own, dtype=np.float64)
            found = many(own[: max(gate.remaining, 0)], box)
            if found:
                gate.note_outside(found)
        return own

    return {
        "__call__": gate.single_call(outside, box, look),
        "batch": lambda points: batch(looked_at_all(points)),
        "batch_below": lambda points, limits: batch_below(looked_at_all(points), np.array(limits, dtype=np.float64)),
        "residuals": lambda x: gate.residuals(look(x)),
        "jacobian": lambda x: gate.jacobian(point(x)),
        "gradient": lambda x: gate.gradient(point(x)),
        "value_and_gradient": lambda x: gate.value_and_gradient(look(x)),
        "restart": gate.restart,
    }


def face_of(gate: Evaluator, doors: Doors) -> Objective:
    """Return the face of `gate`, whose calls go through `doors`."""
    members: dict[str, Any] = {name: staticmethod(call) for name, call in doors.items()}
    face: Any = type("Face", (_Face,), members | {"__slots__": (), "__module__": __name__})()
    object.__setattr__(face, "_gate", gate)
    return face  # type: ignore[no-any-return]


def _refusing(attempt: str) -> Callable[..., NoReturn]:
    def refuse(face: Any, name: object, _value: object = None) -> NoReturn:
        tried = attempt.format(name)
        face._gate.note(tried)
        raise AttributeError(f"{tried}: the objective only counts; an optimizer cannot change it")

    return refuse


class _Face:
    """The objective of a run: see `optimizers.base.Objective`."""

    __slots__ = ("_gate",)
    __setattr__ = _refusing("set {}")
    __delattr__ = _refusing("delete {}")
    __reduce_ex__ = _refusing("pickle")

    def __deepcopy__(self, _memo: Any = None) -> _Face:
        return self

    __copy__ = __deepcopy__

    def __dir__(self) -> list[str]:
        return [*KNOWN, *METHODS]


def _copied(name: str, face: Any) -> Any:
    """Return a value of the gate that nobody can change: a list as a tuple, an array as a copy without writing."""
    value = getattr(face._gate, name)
    if isinstance(value, np.ndarray):
        return value.view() if name in FIXED else np.frombuffer(value.tobytes())
    return tuple(value) if isinstance(value, list) else value


for _name in KNOWN:
    setattr(_Face, _name, property(attrgetter(f"_gate.{_name}") if _name in NUMBERS else partial(_copied, _name)))


@cache
def looks() -> tuple[Any, Any]:
    """Return the checks of one point and of many, compiled before any clock starts and any child is forked."""
    from calibench.bench.gate._scan_kernels import is_outside, outside_of
    from calibench.core.compilation.compiled import exact

    one, many, box = exact(is_outside, 1, 2), exact(outside_of, 2, 2), np.zeros((2, 1))
    one(box[0], box), many(box, box)
    return one, many
