"""The fit of both frames, and how well they are known: the arm's adjustment with frames alone, and two noises learned.

A robot's poses are those of a chain of three joints that slide and three that turn, so that hand-eye calibration is the
calibration of an arm whose frames alone are free (`bench.calibration.fit`): board in camera = mount A tool. Places and
rotations scatter differently. The noise of each is what is left over its own degrees of freedom, which are its readings
less its share of the trace of the hat matrix, and the frames are fitted again under it until it settles (Rao 1971 calls
such estimates of variance components). Intervals are Student's, with degrees of freedom by Satterthwaite (1946), as
both noises have a part in each number.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from calibench.bench.calibration.fit import Fit, fitted, fitted_from, order_of
from calibench.bench.calibration.model import ArmModel
from calibench.problems.arm.chains.chain import Chain, ChainJoint
from calibench.problems.arm.chains.kinematics import forward
from calibench.problems.arm.chains.rigid import rpy_of
from calibench.problems.base import Array

_JOINTS = ("x", "y", "z", "yaw", "pitch", "roll")
_FLOOR = 1e-9  # mm or rad: the noise of readings without any
_ROUNDS, _SETTLED = 30, 1e-4
_LEAST = 1.0  # degree of freedom: with fewer nothing tells a noise


@final
@dataclass(frozen=True, eq=False)
class Adjusted:
    """Mount and tool (4, 4) [mm], and the covariance of their errors by the part of each noise.

    An error is a shift [mm] and a turn [rad] behind the frame, x y z each, of the mount and then of the tool.
    `parts` (2, 12, 12) are the covariances that come from the noise of places and of rotations; `sigma` is that noise
    on an axis [mm], [rad], and `freedom` its degrees of freedom, infinite where it was stated. `fit` has the frames in
    its chain.
    """

    fit: Fit
    mount: Array
    tool: Array
    parts: Array
    sigma: tuple[float, float]
    freedom: tuple[float, float]


def model_of_pairs(arm: Array, seen: Array, mount: Array, tool: Array) -> ArmModel:
    """Return the model of poses `seen` (n, 4, 4) of the board in the camera, for the `arm`'s poses (n, 4, 4) [mm]."""
    n, axes = len(arm), np.eye(3)
    joints = tuple(
        ChainJoint(name, "sliding" if k < 3 else "rotary", np.eye(4), axes[k if k < 3 else 5 - k])
        for k, name in enumerate(_JOINTS)
    )
    chain = Chain(joints, np.eye(4), told="table", mount=mount, tool=tool)
    none = np.full(n, -1, dtype=np.int64)
    return ArmModel(chain, stands_of(arm), seen[:, :3, 3], seen[:, :3, :3], none, none, every=True)


def stands_of(poses: Array) -> Array:
    """Return how the six joints stand at `poses` (n, 4, 4): x y z [mm], yaw, pitch and roll [rad], (n, 6).

    Angles are told around their middle, so that the same pose has nearly the same numbers in every row.
    """
    angles = rpy_of(poses)[:, ::-1]
    middle = np.arctan2(np.sin(angles).mean(axis=0), np.cos(angles).mean(axis=0))
    return np.column_stack([poses[:, :3, 3], middle + (angles - middle + np.pi) % (2 * np.pi) - np.pi])


def frames_order(model: ArmModel) -> list[int]:
    """Return the places of mount and tool among the parameters of `model`."""
    return order_of(model.names, "frames")


def adjusted(model: ArmModel, stated: tuple[float, float]) -> Adjusted:
    """Return the fit of mount and tool; `stated` is the noise of a place [mm] and a rotation [rad], 0 to learn it."""
    order = frames_order(model)
    fit = fitted(model, order)
    everywhere = np.ones(len(model.joints), dtype=bool)
    sigma, freedom = fit.model.sigma, (np.inf, np.inf)
    for _ in range(_ROUNDS):
        before = sigma
        sigma, freedom = _noise(fit, before, stated)
        fit = replace(fit, model=replace(fit.model, sigma=sigma))
        fit = replace(fit, p=fitted_from(fit, order, everywhere))
        if np.allclose(sigma, before, rtol=_SETTLED, atol=0.0):
            break
    fit = _with_frames(fit)
    rows = rows_of(fit)
    inverted = _inverse(rows)
    parts = np.stack([inverted @ part.T @ part @ inverted for part in rows])
    return Adjusted(fit, fit.model.chain.mount, fit.model.chain.tool, parts, sigma, freedom)


def _with_frames(fit: Fit) -> Fit:
    """Return the fit with its corrections in the frames of the chain, and none in its parameters."""
    still = replace(fit.model.chain, joints=fit.model.chain.joints)
    nothing = np.zeros((1, len(_JOINTS)))
    p = fit.p.copy()
    p[-6:] = 0.0
    mount = forward(replace(still, tool=np.eye(4)), p, nothing)[0]
    p = fit.p.copy()
    p[:6] = 0.0
    tool = forward(replace(still, mount=np.eye(4)), p, nothing)[0]
    model = replace(fit.model, chain=still.placed(mount, tool))
    return replace(fit, model=model, p=model.start)


def rows_of(fit: Fit) -> Array:
    """Return the derivatives of places and rotations over their noise, (2, 3 n, 12), of mount and tool in order."""
    kept = np.array(sorted(frames_order(fit.model)), dtype=np.int64)
    rows = fit.model.jacobian(fit.p, kept, fit.weights)[0] * fit.weights[:, None, None]
    return np.stack([rows[:, :3].reshape(-1, len(kept)), rows[:, 3:].reshape(-1, len(kept))])


def _inverse(rows: Array) -> Array:
    """Return the inverse of the information of all `rows`, (2, m, 12), scaled by their columns."""
    both = rows.reshape(-1, rows.shape[2])
    scale = np.linalg.norm(both, axis=0) + _FLOOR
    return np.asarray(np.linalg.pinv((both / scale).T @ (both / scale), rcond=1e-13) / np.outer(scale, scale))


def _noise(
    fit: Fit, sigma: tuple[float, float], stated: tuple[float, float]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the noise of places and of rotations, and their degrees of freedom, by the residuals under `sigma`."""
    rows = rows_of(fit)
    inverted = _inverse(rows)
    found, freedom = list(stated), [np.inf, np.inf]
    for k, part in enumerate(fit.model.errors(fit.p)):
        if stated[k] or part is None:
            continue
        spent = float(np.einsum("mi,ij,mj->", rows[k], inverted, rows[k]))
        freedom[k] = max(3 * float(fit.weights.sum()) - spent, _LEAST)
        found[k] = max(float(np.sqrt((fit.weights[:, None] * part**2).sum() / freedom[k])), _FLOOR)
    return (found[0], found[1]), (freedom[0], freedom[1])
