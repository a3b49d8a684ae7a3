"""The object that an optimiser gets instead of the gate: its calls and live values, which nobody can set.

A face has the calls of `optimizers.base.Objective` and the values below. Values are copies, and arrays cannot be
written. To set or delete an attribute, or to pickle a face, raises an error in the optimiser, and is noted in the run's
row: a budget that an optimiser changes by mistake, or a copy in another process, would not be counted. A copy of a face
is the face itself: pygmo copies what it is given, and all must be counted in one place.

This keeps honest code honest. Code that searches the gate out, by the private names of this package, by frames or by
the garbage collector, is not held off: in one process of Python nothing can be hidden from it.

A call through a face takes as long as a call of the gate: the face's class is made for one gate and holds its calls.
"""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np

from calibench.bench.gate.box import Doors
from calibench.bench.gate.evaluator import Evaluator
from calibench.optimizers.base import Objective

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


def face_of(gate: Evaluator, doors: Doors) -> Objective:
    """Return the face of `gate`, whose calls go through `doors`."""
    calls: dict[str, Any] = {"__call__": doors.value, "restart": gate.restart}
    calls |= {name: getattr(doors, name) for name in METHODS[:-1]}
    members: dict[str, Any] = {name: staticmethod(call) for name, call in calls.items()}
    face: Any = type("Face", (_Face,), members | {"__slots__": (), "__module__": __name__})()
    object.__setattr__(face, "_gate", gate)
    return face  # type: ignore[no-any-return]


class _Face:
    """The objective of a run: see `optimizers.base.Objective`."""

    __slots__ = ("_gate",)

    def __setattr__(self, name: str, _value: object) -> None:
        _refuse(self, f"set {name}")

    def __delattr__(self, name: str) -> None:
        _refuse(self, f"delete {name}")

    def __reduce_ex__(self, _protocol: object) -> NoReturn:
        _refuse(self, "pickle")

    def __copy__(self) -> _Face:
        return self

    def __deepcopy__(self, _memo: Any) -> _Face:
        return self

    def __dir__(self) -> list[str]:
        return [*KNOWN, *METHODS]


def _refuse(face: Any, attempt: str) -> NoReturn:
    face._gate.note(attempt)
    raise AttributeError(f"{attempt}: the objective only counts; an optimizer cannot change it")


def _read_from_the_gate(name: str) -> property:
    if name in NUMBERS:
        return property(lambda face: getattr(face._gate, name))
    return property(lambda face: _shown(getattr(face._gate, name)))


for _name in KNOWN:
    setattr(_Face, _name, _read_from_the_gate(_name))


def _shown(value: Any) -> Any:
    """Return a value that nobody can change: a list becomes a tuple, an array a copy that cannot be written."""
    if isinstance(value, list):
        return tuple(value)
    return np.frombuffer(value.tobytes(), dtype=value.dtype) if isinstance(value, np.ndarray) else value
