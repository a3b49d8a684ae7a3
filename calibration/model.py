"""`ArmModel`: the small errors of an arm, and the residuals that they leave of its readings.

The frames that were found are in the chain, so that every parameter is a small number around 0: `base_x` ... `tool_rz`
correct them, `x_J` ... `rz_J` the placement of joint J, `zero_J` its zero, `gain_J` its scale. Of an arm that a table
describes they are errors of the table's own numbers instead: `theta_J`, `d_J`, `a_J`, `alpha_J`, `beta_J`.

Residuals are (n, c), in units of the noise of each kind of reading. For a ball in sockets they are the vector from the
mean point of its socket, and one more for each pair of sockets whose distance is known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from calibench.calibration.dh import DhArm, DhTable
from calibench.calibration.kinematics import Chain, forward, jacobian, nominal, parameter_names
from calibench.calibration.readings import Readings
from calibench.calibration.rigid import Array, Index, Mask, vector_of

KNOWN_TO = 0.05  # mm: how well the distance of two printed or drilled sockets is known where nobody says it


@final
@dataclass(frozen=True, eq=False)
class ArmModel:
    """A chain from the tracker to the target, with the frames that were found, and what was read.

    `sigma` is the noise of a position [mm] and of a rotation [rad]; `distance` that of two sockets of a place [mm], 0
    where it is not known, and `sigma_distance` how well [mm]. `scatter` (n,) is how many times as far as others the
    readings of a socket lie apart; None where all are alike. `rows` is the arm of a table; None for that of a URDF.
    With `every` a fit frees all parameters that it is asked for, however little the readings tell of one.
    """

    chain: Chain
    joints: Array
    position: Array | None
    turns: Array | None
    socket: Index
    place: Index
    sigma: tuple[float, float] = (1.0, 1e-3)
    distance: float = 0.0
    sigma_distance: float = KNOWN_TO
    scatter: Array | None = None
    rows: DhArm | None = None
    every: bool = False

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Return the names of all parameters."""
        return parameter_names(self.chain) if self.rows is None else self.rows.names

    @property
    def sliding(self) -> frozenset[str]:
        """Return the joints that slide."""
        return frozenset(joint.name for joint in self.chain.joints if joint.kind == "sliding")

    @property
    def start(self) -> Array:
        """Return the nominal parameters: nothing is wrong."""
        return nominal(self.chain) if self.rows is None else self.rows.nominal

    @property
    def of_rows(self) -> Array:
        """Return the noise of each position, (n,) [mm]."""
        return self.sigma[0] * (np.ones(len(self.joints)) if self.scatter is None else self.scatter)

    def at(self, keep: Mask) -> ArmModel:
        """Return the model of some poses."""
        position = None if self.position is None else self.position[keep]
        turns = None if self.turns is None else self.turns[keep]
        return replace(
            self, joints=self.joints[keep], position=position, turns=turns, socket=self.socket[keep],
            place=self.place[keep], scatter=None if self.scatter is None else self.scatter[keep],
        )  # fmt: skip

    def numbered(self) -> ArmModel:
        """Return the model with its sockets counted from 0 without a gap."""
        return replace(self, socket=np.unique(self.socket, return_inverse=True)[1].ravel().astype(np.int64))

    def placed(self, p: Array) -> Array:
        """Return the target's pose at each reading, (n, 4, 4)."""
        return forward(self.chain, p, self.joints) if self.rows is None else self.rows.forward(p, self.joints)

    def errors(self, p: Array, weights: Array | None = None) -> tuple[Array, Array | None]:
        """Return the residual position, (n, 3) [mm], and the residual rotation as a vector, (n, 3) [rad] or None.

        For a ball in sockets it is the vector from the mean point of its socket, by `weights` (n,).
        """
        return self._errors(self.placed(p), weights)

    def _errors(self, poses: Array, weights: Array | None) -> tuple[Array, Array | None]:
        if self.position is None:
            return poses[:, :3, 3] - self._means(poses[:, :3, 3], weights)[self.socket], None
        position = poses[:, :3, 3] - self.position
        return position, None if self.turns is None else vector_of(
            np.einsum("nij,nkj->nik", poses[:, :3, :3], self.turns)
        )

    def residuals(self, p: Array, weights: Array) -> tuple[Array, Array]:
        """Return residuals (n, c) over their noise, and those of known distances, (d,)."""
        poses = self.placed(p)
        position, turned = self._errors(poses, weights)
        over = position / self.of_rows[:, None]
        if turned is not None:
            over = np.column_stack([over, turned / self.sigma[1]])
        return over, self._distances(poses, weights)

    def jacobian(self, p: Array, kept: Index, weights: Array) -> tuple[Array, Array]:
        """Return the derivatives of `residuals` in the parameters `kept`: (n, c, k) and (d, k)."""
        of = self.rows
        slopes = (jacobian(self.chain, p, self.joints) if of is None else of.jacobian(p, self.joints))[:, :, kept]
        if self.position is not None:
            over = slopes[:, :3] / self.sigma[0]
            if self.turns is not None:
                over = np.concatenate([over, slopes[:, 3:] / self.sigma[1]], axis=1)
            return over, np.zeros((0, len(kept)))
        means = self._means(slopes[:, :3].reshape(len(slopes), -1), weights).reshape(-1, 3, len(kept))
        over = (slopes[:, :3] - means[self.socket]) / self.of_rows[:, None, None]
        rows = []
        points = self._means(self.placed(p)[:, :3, 3], weights)
        for a, b in self.pairs():
            way = points[a] - points[b]
            rows.append((way / np.linalg.norm(way)) @ (means[a] - means[b]) / self.sigma_distance)
        return over, np.array(rows).reshape(-1, len(kept))

    def pairs(self) -> list[tuple[int, int]]:
        """Return the sockets of one place whose distance is known: those numbered 0 and 1 of each."""
        if not self.distance:
            return []
        known = []
        for place in np.unique(self.place):
            there = np.unique(self.socket[self.place == place])
            if len(there) > 1:
                known.append((int(there[0]), int(there[1])))
        return known

    def spans(self, p: Array, weights: Array | None = None) -> Array:
        """Return the distance of the sockets of each place that has two, (d,) [mm]."""
        return self._spans(self.placed(p), weights)

    def _spans(self, poses: Array, weights: Array | None) -> Array:
        points = self._means(poses[:, :3, 3], weights)
        return np.array([np.linalg.norm(points[a] - points[b]) for a, b in replace(self, distance=1.0).pairs()])

    def _distances(self, poses: Array, weights: Array) -> Array:
        if self.position is not None or not self.distance:
            return np.zeros(0)
        return (self._spans(poses, weights) - self.distance) / self.sigma_distance

    def _means(self, values: Array, weights: Array | None) -> Array:
        """Return the mean of (n, m) over each socket, (k, m)."""
        count = int(self.socket.max()) + 1
        weights = np.ones(len(values)) if weights is None else weights
        total = np.zeros((count, values.shape[1]))
        np.add.at(total, self.socket, weights[:, None] * values)
        size = np.bincount(self.socket, weights, count)
        return np.asarray(total / np.where(size > 0, size, 1.0)[:, None])


def model_of(
    chain: Chain, readings: Readings, base: Array, tool: Array, *, distance: float = 0.0,
    sigma_distance: float = KNOWN_TO, table: DhTable | None = None,
) -> ArmModel:  # fmt: skip
    """Return the model of `readings` with the frames that were found in its chain; of a `table` its numbers."""
    placed = chain.placed(base, chain.tool @ tool)
    return ArmModel(
        chain=placed, joints=readings.joints, position=readings.position, turns=readings.turns,
        socket=readings.socket, place=readings.place, distance=distance,
        sigma_distance=sigma_distance, rows=None if table is None else DhArm(table, placed.mount, placed.tool),
    )  # fmt: skip


def stacked(rows: Array, more: Array, weights: Array) -> Array:
    return np.vstack([(np.sqrt(weights)[:, None, None] * rows).reshape(-1, rows.shape[2]), more])


def stacked_residuals(rows: Array, more: Array, weights: Array) -> Array:
    return np.concatenate([(np.sqrt(weights)[:, None] * rows).ravel(), more])
