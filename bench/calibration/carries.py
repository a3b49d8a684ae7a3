"""How far a calibration carries: the error of places that it foretells, among the poses that were read and beyond.

It follows from the scatter of the readings and from what the poses tell of the arm. A number that keeps its nominal
value since the poses tell it badly is counted as off by `OFF`, the others as they were told.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibench.bench.calibration.fit import Fit, is_length, order_of, told_of
from calibench.bench.calibration.model import ArmModel
from calibench.problems.arm.chains.chain import Chain
from calibench.problems.arm.chains.kinematics import forward, nominal
from calibench.problems.base import Array

OFF = 0.5  # mm, or mrad: by as much a placement of an arm differs from its table
_POSES = 300  # drawn at random in each of the two ranges


def foretold(fit: Fit, level: str) -> tuple[float, float]:
    """Return the standard error of the target's place [mm], rms over poses within the ranges read, and all limits."""
    model, p = fit.model, fit.p
    told = told_of(model, p, order_of(model.names, level, model.sliding), fit.weights)
    weights = np.sqrt(fit.weights)[:, None, None]
    rows = (weights * model.jacobian(p, told, fit.weights)[0]).reshape(-1, len(told))
    unsure = np.array([
        0.0 if place in fit.kept else 1.0 / (OFF if is_length(model.names[place], model.sliding) else 1e-3 * OFF)
        for place in told
    ])  # fmt: skip
    triangle = np.asarray(np.linalg.qr(np.vstack([rows, np.diag(unsure)]), mode="r"))
    rng = np.random.default_rng(0)
    found = []
    for low, high in ranges(model):
        joints = low + (high - low) * rng.random((_POSES, len(low)))
        slopes = at(model, joints).jacobian(p, told, np.ones(_POSES))[0][:, :3] * model.sigma[0]
        errors = np.linalg.solve(triangle.T, slopes.reshape(-1, len(told)).T)
        found.append(float(np.sqrt((errors**2).sum() / _POSES)))
    return found[0], found[1]


def ranges(model: ArmModel) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return the lowest and the highest value of each joint among the poses that were read, and by its limits."""
    low, high = model.joints.min(axis=0), model.joints.max(axis=0)
    lower, upper = stops(model.chain)
    ends = np.isfinite(upper - lower)
    return (low, high), (np.where(ends, np.minimum(low, lower), low), np.where(ends, np.maximum(high, upper), high))


def stops(chain: Chain) -> tuple[Array, Array]:
    """Return the limits of each joint [rad, mm], half a turn to each side at most; inf of a slide without."""
    there = {joint.name: joint for joint in chain.joints}
    low, high = np.empty(len(chain.driven)), np.empty(len(chain.driven))
    for k, name in enumerate(chain.driven):
        joint = there.get(name)
        edge = np.pi if joint is None or joint.kind == "rotary" else np.inf  # a turn to either side tells all
        low[k], high[k] = (-edge, edge) if joint is None else (max(-edge, joint.lower), min(edge, joint.upper))
    return low, high


def at(model: ArmModel, joints: Array) -> ArmModel:
    """Return the model at other joints; the readings there do not affect its Jacobian."""
    n = len(joints)
    poses = forward(model.chain, nominal(model.chain), joints)
    turns = None if model.turns is None else poses[:, :3, :3]
    none = np.full(n, -1, dtype=np.int64)
    return replace(model, joints=joints, position=poses[:, :3, 3], turns=turns, socket=none, place=none)
