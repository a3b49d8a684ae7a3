"""A chain from a table: Denavit and Hartenberg's rows, Craig's modified rows, and Hayati's where axes are parallel.

A row is a mapping. All lengths are mm, all angles rad; what is left out is 0.

    standard   Rz(theta) Tz(d) Tx(a) Rx(alpha)             the joint turns about z before the row
    modified   Rx(alpha) Tx(a) Rz(theta) Tz(d)             the joint turns about z behind alpha and a
    Hayati     either with Ry(beta) at its end (standard) or behind Rx(alpha) (modified), and d = 0 where the next axis
               is parallel

`kind` is "rotary" (theta turns), "sliding" (d slides) or "fixed" (nothing moves: a flange, a pedestal); `name`, `lower`
and `upper` are the joint's own. In the standard table a row's constant part belongs to the next joint's origin, and the
last row's to the tail. (Denavit and Hartenberg 1955; Craig 1986; Hayati and Mirmirani 1985.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from calibench.core.options import suggest
from calibench.problems.arm.chains.chain import Chain, ChainError, ChainJoint
from calibench.problems.arm.chains.rigid import rpy, slide

Form = Literal["standard", "modified"]
RowKind = Literal["rotary", "sliding", "fixed"]
FORMS: tuple[Form, ...] = ("standard", "modified")
KINDS: tuple[RowKind, ...] = ("rotary", "sliding", "fixed")
_NUMBERS = ("theta", "d", "a", "alpha", "beta", "lower", "upper")
_KEYS = (*_NUMBERS, "name", "kind")
_X, _Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


def chain_of_table(rows: Sequence[Mapping[str, Any]], form: Form = "standard", name: str = "arm") -> Chain:
    """Return the chain of a table; joints without a name are called joint_1, joint_2, ...

    >>> two = chain_of_table([{"a": 300.0}, {"a": 200.0}])
    >>> [joint.name for joint in two.joints], two.tail[0, 3]
    (['joint_1', 'joint_2'], np.float64(200.0))

    Raises `ChainError` for an unknown form or key, and for what is no number.
    """
    if form not in FORMS:
        raise ChainError(f"form={form!r}: {suggest(str(form), FORMS)}")
    checked = [_checked(row, k) for k, row in enumerate(rows, 1)]
    theta, d, a, alpha, beta = np.array([[value[one] for one in _NUMBERS[:5]] for _, value in checked]).reshape(-1, 5).T
    none, along_x, along_z = np.zeros(len(rows)), slide(_X, a), slide(_Z, d)  # of all rows at once, (rows, 4, 4) each
    turned, twisted, leant = rpy(none, none, theta) @ along_z, rpy(alpha, none, none), rpy(none, beta, none)
    if form == "modified":
        before, behind = twisted @ leant @ along_x, np.broadcast_to(np.eye(4), turned.shape)
    else:
        before, behind = None, along_x @ twisted @ leant  # the first two commute, as do those about and along z
    joints, held = [], np.eye(4)
    for k, (row, (kind, _)) in enumerate(zip(rows, checked, strict=True), 1):
        origin = (held if before is None else held @ before[k - 1]) @ turned[k - 1]
        if kind == "fixed":
            held = origin @ behind[k - 1]
            continue
        held = behind[k - 1]
        low, high = (float(row.get(side, usual)) for side, usual in (("lower", -np.inf), ("upper", np.inf)))
        joints.append(ChainJoint(str(row.get("name", f"joint_{k}")), kind, origin, _Z, low, high))
    return Chain(tuple(joints), np.asarray(held), name)


def _checked(row: Mapping[str, Any], k: int) -> tuple[RowKind, dict[str, float]]:
    for key in row:
        if key not in _KEYS:
            raise ChainError(f"row {k}: {key!r} is unknown; {suggest(str(key), _KEYS)}")
    kind: RowKind = row.get("kind", "rotary")
    if kind not in KINDS:
        raise ChainError(f"row {k}: kind={kind!r}; {suggest(str(kind), KINDS)}")
    try:
        value = {key: float(row.get(key, 0.0)) for key in _NUMBERS[:5]}
    except (TypeError, ValueError):
        raise ChainError(f"row {k}: theta, d, a, alpha and beta are numbers [rad, mm]") from None
    if not np.isfinite(list(value.values())).all():
        raise ChainError(f"row {k}: theta, d, a, alpha and beta are finite numbers [rad, mm]")
    return kind, value
