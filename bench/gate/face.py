"""The object that an optimiser gets instead of the gate: its calls and live values, and no way to the counters.

A face has the calls of `optimizers.base.Objective` and the values below, which nobody can set. A wall
(`bench.gate.guard.wall`) stands between each of them and the gate, so that neither an attribute nor ``__self__`` nor a
closure leads from the face to the gate. Values are copies, and arrays cannot be written. To set, delete, rebuild or
pickle a face raises an error in the optimiser; the attempt is noted in the run's row. A copy of a face is the face
itself: pygmo copies what it is given, and all must be counted in one place.

A call through a face takes as long as a call of the gate: the face's class is made for one gate and holds its call.
This package's own optimisers, which the tests check, get the same names without the walls: making a class with forty of
them is a tenth of the time of a run of sixty evaluations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NoReturn, final

import numpy as np

from calibench.bench.gate.box import Doors
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.guard.wall import walled
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
_REMADE = (
    "__getnewargs__",
    "__getnewargs_ex__",
    "__getstate__",
    "__init__",
    "__reduce__",
    "__reduce_ex__",
    "__setstate__",
)
_OF_THE_GATE = frozenset(Evaluator.__slots__) | {
    name for name in vars(Evaluator) if not name.startswith("__")
}  # fmt: skip


def face_of(gate: Evaluator, doors: Doors) -> Objective:
    """Return the face of `gate`, whose calls go through `doors`."""
    note = gate.note

    def refuse(attempt: str) -> NoReturn:
        note(attempt)
        raise AttributeError(f"{attempt}: the objective only counts; an optimizer cannot change it")

    setting = walled(lambda _, _value: refuse("set by object.__setattr__"))
    deleting = walled(lambda _: refuse("delete by object.__delattr__"))

    def read_only(get: Callable[[Any], Any]) -> property:
        return property(walled(get), setting, deleting)

    def number(name: str) -> property:
        return read_only(lambda _: getattr(gate, name))

    def copied(name: str) -> property:
        return read_only(lambda _: _shown(getattr(gate, name)))

    def fixed(value: Any) -> property:
        return read_only(lambda _: value)

    def missing(_face: Any, name: str) -> NoReturn:
        if name in _OF_THE_GATE:
            note(f"ask for {name}")
        raise AttributeError(f"an objective has no {name!r}")

    def refusing(name: str) -> Any:
        return walled(lambda *_args, **_options: refuse(f"call {name}"))

    members: dict[str, Any] = {name: number(name) for name in NUMBERS}
    members |= {name: copied(name) for name in COPIES} | {name: fixed(_shown(getattr(gate, name))) for name in FIXED}
    calls = [getattr(doors, name) for name in METHODS[:-1]] + [gate.restart]
    members |= {name: fixed(walled(call)) for name, call in zip(METHODS, calls, strict=True)}
    members |= {name: refusing(name) for name in _REMADE}
    members |= {
        "__slots__": (),
        "__refused__": walled(refuse),
        "__module__": __name__,
        "__doc__": "The objective of a run: see `optimizers.base.Objective`.",
        "__call__": staticmethod(walled(doors.value)),
        "__dict__": read_only(lambda _: _Attributes(refuse)),
        "__class__": read_only(type),
        "__getattr__": walled(missing),
        "__setattr__": walled(lambda _, name, _value: refuse(f"set {name}")),
        "__delattr__": walled(lambda _, name: refuse(f"delete {name}")),
        "__copy__": walled(lambda face: face),
        "__deepcopy__": walled(lambda face, _memo: face),
        "__dir__": walled(lambda _: [*NUMBERS, *COPIES, *FIXED, *METHODS]),
    }
    kind: Any = _Kind("Face", (), members)
    face: Objective = object.__new__(kind)
    return face


def own_face_of(gate: Evaluator, doors: Doors) -> Objective:
    """Return the face of `gate` for an optimiser of this package: the same names and values, and no walls."""
    calls: dict[str, Any] = {"__call__": doors.value, "restart": gate.restart}
    calls |= {name: getattr(doors, name) for name in METHODS[:-1]}
    members: dict[str, Any] = {name: staticmethod(call) for name, call in calls.items()}
    face: Any = type("Face", (_OwnFace,), members | {"__slots__": (), "__module__": __name__})()
    object.__setattr__(face, "_gate", gate)
    return face  # type: ignore[no-any-return]


class _OwnFace:
    """The common part of the faces for this package's optimisers: values to read, each from the gate."""

    __slots__ = ("_gate",)

    def __setattr__(self, name: str, _value: object) -> None:
        raise AttributeError(f"set {name}: the objective only counts; an optimizer cannot change it")

    def __copy__(self) -> _OwnFace:
        return self

    def __deepcopy__(self, _memo: Any) -> _OwnFace:
        return self


def _read_from_the_gate(name: str) -> property:
    if name in (*COPIES, "targets"):
        return property(lambda face: _shown(getattr(face._gate, name)))
    return property(lambda face: getattr(face._gate, name))


for _name in (*NUMBERS, *COPIES, *FIXED):
    setattr(_OwnFace, _name, _read_from_the_gate(_name))


@final
class _Attributes(dict[str, Any]):
    """The result of `vars(face)`: an empty mapping that cannot be written."""

    def __init__(self, refuse: Callable[[str], NoReturn]) -> None:
        super().__init__()
        self.refuse = walled(refuse)

    def __setitem__(self, name: str, _value: object) -> None:
        self.refuse(f"set {name}")

    def update(self, *given: Any, **more: Any) -> None:
        for name in {**dict(*given), **more}:
            self.refuse(f"set {name}")


@final
class _Kind(type):
    """The type of a face's class: changes of the class are refused and noted."""

    def __setattr__(cls, name: str, value: object) -> None:
        vars(cls)["__refused__"](f"set {name} of the class")

    def __delattr__(cls, name: str) -> None:
        vars(cls)["__refused__"](f"delete {name} of the class")


def _shown(value: Any) -> Any:
    """Return a value that nobody can change: a list becomes a tuple, an array a copy that cannot be written."""
    if isinstance(value, list):
        return tuple(value)
    return _immutable(value) if isinstance(value, np.ndarray) else value


def _immutable(array: Array) -> Array:
    return np.frombuffer(array.tobytes(), dtype=array.dtype)
