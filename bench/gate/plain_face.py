"""What our own optimisers get of a gate: the same calls and values as by a face, with nothing held back.

A face (`bench.gate.face`) takes a third of a millisecond to make, which a run of sixty evaluations would feel; our own
code needs no wall. A call costs the same: the class is made for one gate and holds its call.
"""

from __future__ import annotations

from typing import Any

from calibench.bench.gate.box import Doors
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.face import COPIES, FIXED, NUMBERS
from calibench.optimizers.base import Objective


def plain_face_of(gate: Evaluator, doors: Doors) -> Objective:
    """Return the objective of one of our own optimisers, whose calls go through `doors`."""
    face = type("Objective", (_PlainFace,), {"__slots__": (), "__call__": staticmethod(doors.value)})()
    face.gate, face.restart = gate, gate.restart
    face.batch, face.batch_below = doors.batch, doors.batch_below
    face.residuals, face.jacobian = doors.residuals, doors.jacobian
    made: Objective = face
    return made


def _value(name: str) -> property:
    return property(lambda face: getattr(face.gate, name))


class _PlainFace:
    __slots__ = ("batch", "batch_below", "gate", "jacobian", "residuals", "restart")

    def __copy__(self) -> Any:
        return self

    def __deepcopy__(self, _memo: object) -> Any:
        return self  # pygmo copies what it is given; the count must stay one


for _name in (*NUMBERS, *COPIES, *FIXED):
    setattr(_PlainFace, _name, _value(_name))
