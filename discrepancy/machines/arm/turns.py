"""Rotations of a body as numbers: from a tracker's columns to matrices, and the difference of two rotations."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.core.words import as_columns
from calibench.discrepancy.machines.arm.geometry import cross
from calibench.discrepancy.model.measured import DataError, MeasuredData
from calibench.problems.arm.chains.rigid import quaternion, turn
from calibench.problems.base import Array

Numbers = NDArray[Any]
ANGLES = ("rx", "ry", "rz")
CALLED = "rotation_columns"  # in the metadata: what the file calls ours
QUATERNION = ("qx", "qy", "qz", "qw")
ORDERS = ("rpy", "xyz", "vector")


def has_turns(data: MeasuredData) -> bool:
    """Tell whether the pose was measured, and not the place alone."""
    return data.has(*ANGLES) or data.has(*QUATERNION)


def measured_turns(data: MeasuredData) -> Array:
    """Return the measured rotations, (n, 3, 3).

    Raise `DataError` where nothing states the order in which angles turn.
    """
    if data.has(*QUATERNION):
        numbers = np.stack([np.asarray(data[name], dtype=float) for name in QUATERNION])
        none = int((~(np.linalg.norm(numbers, axis=0) > 0)).sum())
        if none:
            raise DataError(
                f"{data.name}: {', '.join(QUATERNION)} are all 0 in {none} row{'s' if none > 1 else ''}, which is no "
                "rotation; leave these rows out, or their cells empty"
            )
        return np.asarray(quaternion(*numbers)[:, :3, :3])
    return _of_angles(data, str(data.metadata.get("rotation", "rpy")))


def other_turns(data: MeasuredData) -> dict[str, Array]:
    """Return the rotations, (n, 3, 3), that the same columns would mean under each other statement, by statement."""
    if data.has(*QUATERNION):
        numbers = [np.asarray(data[name], dtype=float) for name in QUATERNION]
        names = {name: QUATERNION[k] for k, name in enumerate(("qw", "qx", "qy", "qz"))}
        w, x, y, z = numbers
        return {as_columns(names): np.asarray(quaternion(x, y, z, w)[:, :3, :3])}
    degrees = data.with_columns({name: np.deg2rad(np.asarray(data[name], dtype=float)) for name in ANGLES})
    called = data.metadata.get(CALLED, {})
    said = f"units={','.join(f'{called.get(name, name)}:deg' for name in ANGLES)} rotation="
    return {f"rotation={order}": _of_angles(data, order) for order in ORDERS} | {
        f"{said}{order}": _of_angles(degrees, order) for order in ORDERS
    }


def _of_angles(data: MeasuredData, order: str) -> Array:
    if order not in ORDERS:
        raise DataError(
            f"{data.name}: rotation={order}: rpy (about fixed x, y, z), xyz (about the moving x, y, z) or vector (axis "
            "times angle) is needed for rx, ry, rz; a quaternion stands in qx, qy, qz, qw"
        )
    if order == "vector":
        return rotation_of(np.stack([np.asarray(data[name], dtype=float) for name in ANGLES], axis=-1))
    each = [turn(np.eye(3)[k], np.asarray(data[name], dtype=float))[:, :3, :3] for k, name in enumerate(ANGLES)]
    return np.asarray(each[2] @ each[1] @ each[0] if order == "rpy" else each[0] @ each[1] @ each[2])


def mean_turn(turns: Array) -> Array:
    """Return the rotation nearest to all of (n, 3, 3), with small weight for those far out, (3, 3)."""
    weight = np.ones(len(turns))
    for _ in range(20):
        U, _, V = np.linalg.svd(np.einsum("n,nij->ij", weight, turns))
        mean = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ V))]) @ V
        far = np.linalg.norm(turns - mean, axis=(1, 2))
        weight = np.minimum(1.0, 2 * np.median(far) / np.maximum(far, 1e-300))
    return np.asarray(mean)


def vector_of(turns: Array) -> Array:
    """Return axis times angle [rad], (n, 3), of rotations by less than a half turn."""
    twice = _odd(turns) * 2
    sine = np.linalg.norm(twice, axis=1) / 2
    angle = np.arctan2(sine, (np.trace(turns, axis1=1, axis2=2) - 1) / 2)
    plain = sine > 1e-12
    return np.asarray(np.where(plain[:, None], twice / 2 * (angle / np.where(plain, sine, 1.0))[:, None], twice / 2))


def rotation_of(vectors: Numbers) -> Numbers:
    """Return the rotations, (n, 3, 3), of axis times angle, (n, 3) [rad]; it accepts complex numbers."""
    angle = np.sqrt(np.sum(vectors * vectors, axis=1) + 1e-300)
    x, y, z = vectors.T
    none = np.zeros_like(x)
    across = np.stack([none, -z, y, z, none, -x, -y, x, none], axis=-1).reshape(-1, 3, 3)
    one = (np.sin(angle) / angle)[:, None, None]
    two = ((1 - np.cos(angle)) / angle**2)[:, None, None]
    return np.asarray(np.eye(3) + one * across + two * (across @ across))


def small_vector_of(turns: Numbers) -> Numbers:
    """Return axis times angle [rad], (n, 3), of rotations by less than .3 rad; it accepts complex numbers."""
    odd = _odd(turns)
    s = np.sum(odd * odd, axis=1)[:, None]
    return np.asarray(odd * (1 + s * (1 / 6 + s * (3 / 40 + s * (15 / 336 + s * 105 / 3456)))))  # arcsin


def beside(vectors: Array, omega: Array) -> Array:
    """Return the change of `vectors`, axis times a small angle, when the body turns by omega about fixed axes.

    `omega` has shape (n, 3).
    """
    once = cross(vectors, omega)
    return np.asarray(omega - once / 2 + cross(vectors, once) / 12)


def _odd(turns: Numbers) -> Numbers:
    return np.asarray(
        np.stack(
            [turns[:, 2, 1] - turns[:, 1, 2], turns[:, 0, 2] - turns[:, 2, 0], turns[:, 1, 0] - turns[:, 0, 1]], axis=-1
        )
        / 2
    )
