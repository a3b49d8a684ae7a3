"""Which effects no pose can tell apart: beside calibration they have the same signature at all positions of the joints.

Poses are drawn at random: each joint anywhere in the range of its readings, independently of the others, and from
either side; the instruments read what the model predicts there. Where one effect is, up to rounding, a combination of
the other one and of calibration's own parameters in all of these poses, more poses do not help. Example: the scale of
the only joint that slides, and the scale of the tracker; the calibrated lengths absorb the difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.fitting.projection import orthonormal, project_off
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.formulations.predicted import Predicted
from calibench.discrepancy.model.model import Model, signature
from calibench.discrepancy.model.roles import roles_of
from calibench.problems.base import Array

_POSES = 200
_SAME = 1e-8  # sine of the angle between two signatures: what is left of one is rounding
_FULL = 1e-10  # of the largest singular value, below which a direction is rounding


def same_in_any_pose(found: Fit, effects: Sequence[Effect]) -> tuple[tuple[Effect, Effect], ...]:
    """Return the pairs of `effects` that have the same signature in every pose.

    Poses can be drawn for a machine that predicts measured columns from its joints; for any other there are no pairs.
    """
    posed = _posed(found)
    if posed is None:
        return ()
    x = found.x[: len(posed.parameters)]
    q = Model(posed).quantities(x)[0]
    slopes = posed.slopes(q)
    own = np.stack([slopes[p.name] for p in posed.parameters], axis=-1)
    absorbed = orthonormal(_columns(own), _FULL)
    rests = [
        project_off(_columns(signature(e, np.zeros(len(e.coefficients)), q, slopes, posed)), absorbed, times=2)
        for e in effects
    ]
    return tuple((effects[i], effects[j]) for i, j in combinations(range(len(effects)), 2) if _same(rests[i], rests[j]))


def _posed(found: Fit) -> Predicted | None:
    """Return the formulation over poses drawn at random; None where they cannot be drawn."""
    formulation = found.model.formulation
    if not isinstance(formulation, Predicted):
        return None
    joints = roles_of(formulation).joints
    # another commanded input depends on the pose, nobody knows how
    if {joint.reading for joint in joints} != set(formulation.inputs):
        return None
    rng, data = np.random.default_rng(0), formulation.data
    made = data.rows(rng.integers(0, len(data), _POSES))
    ranges = {joint.reading: (np.min(data[joint.reading]), np.max(data[joint.reading])) for joint in joints}
    poses = {name: rng.uniform(low, high, _POSES) for name, (low, high) in ranges.items()}
    poses |= {j.direction: rng.permutation(made[j.direction]) for j in joints if j.direction and j.direction in made}
    unread = {name: np.zeros(_POSES) for name in formulation.readings}
    posed = formulation.on(made.with_columns({**poses, **unread}))
    q = Model(posed).quantities(found.x[: len(posed.parameters)])[0]
    predicted = -np.asarray(posed.constraints(q), dtype=float)
    return posed.on(posed.data.with_columns(dict(zip(formulation.readings, predicted.T))))


def _columns(derivative: Array) -> Array:
    """Return derivatives of the residuals (n, c, k) as columns (n c, k) of length 1, without those that are zero."""
    flat = np.asarray(derivative, dtype=float).reshape(-1, derivative.shape[-1])
    lengths = np.linalg.norm(flat, axis=0)
    return np.asarray(flat[:, lengths > 0] / lengths[lengths > 0])


def _same(one: Array, other: Array) -> bool:
    """Tell whether two sets of columns span the same space."""
    if one.shape[1] != other.shape[1] or not one.shape[1]:
        return False
    ends = [np.linalg.svd(rest, full_matrices=False) for rest in (one, other)]
    if any(values[-1] < _SAME for _, values, _ in ends):  # calibration absorbs it: it is in no set
        return False
    (a, _, _), (b, _, _) = ends
    return bool(np.linalg.norm(a - b @ (b.T @ a), ord=2) < _SAME)
