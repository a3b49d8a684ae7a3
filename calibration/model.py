"""`ArmModel`: the small errors of an arm, and the residuals that they leave of its readings.

The frames that were found are in the chain, so that every parameter is small (a gain near 1). Residuals (n, c) are in
units of the noise; for a ball in sockets the vector from its socket's mean point, and one for each known distance.
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
    where it is not known. `scatter` (n,) is how many times as far as others the readings of a socket lie apart. `rows`
    is the arm of a table. With `every` a fit frees all parameters that it is asked for.
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
        """Return the model of some poses, with its sockets counted from 0 without a gap."""
        position, turns, scatter = (
            None if one is None else one[keep] for one in (self.position, self.turns, self.scatter)
        )
        socket = np.unique(self.socket[keep], return_inverse=True)[1].ravel().astype(np.int64)
        return replace(
            self, joints=self.joints[keep], position=position, turns=turns, socket=socket, place=self.place[keep],
            scatter=scatter,
        )  # fmt: skip

    def placed(self, p: Array) -> Array:
        """Return the target's pose at each reading, (n, 4, 4)."""
        return forward(self.chain, p, self.joints) if self.rows is None else self.rows.forward(p, self.joints)

    def errors(self, p: Array, weights: Array | None = None, poses: Array | None = None) -> tuple[Array, Array | None]:
        """Return residual positions (n, 3), of a ball from its socket's mean point, and rotations (n, 3) or None."""
        poses = self.placed(p) if poses is None else poses
        if self.position is None:
            return poses[:, :3, 3] - self._means(poses[:, :3, 3], weights)[self.socket], None
        turned = None if self.turns is None else np.einsum("nij,nkj->nik", poses[:, :3, :3], self.turns)
        return poses[:, :3, 3] - self.position, None if turned is None else vector_of(turned)

    def residuals(self, p: Array, weights: Array) -> tuple[Array, Array]:
        """Return residuals (n, c) over their noise, and those of known distances, (d,)."""
        poses = self.placed(p)
        position, turned = self.errors(p, weights, poses)
        over = position / self.of_rows[:, None]
        if turned is not None:
            over = np.column_stack([over, turned / self.sigma[1]])
        if self.position is not None or not self.distance:
            return over, np.zeros(0)
        return over, (self.spans(p, weights, poses) - self.distance) / self.sigma_distance

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
        rows, points = [], self._means(self.placed(p)[:, :3, 3], weights)
        for a, b in self.pairs() if self.distance else ():
            way = points[a] - points[b]
            rows.append((way / np.linalg.norm(way)) @ (means[a] - means[b]) / self.sigma_distance)
        return over, np.array(rows).reshape(-1, len(kept))

    def pairs(self) -> list[tuple[int, int]]:
        """Return the sockets numbered 0 and 1 of each place that has two."""
        there = [np.unique(self.socket[self.place == place]) for place in np.unique(self.place)]
        return [(int(both[0]), int(both[1])) for both in there if len(both) > 1]

    def spans(self, p: Array, weights: Array | None = None, poses: Array | None = None) -> Array:
        """Return the distance of the sockets of each place that has two, (d,) [mm]."""
        points = self._means((self.placed(p) if poses is None else poses)[:, :3, 3], weights)
        return np.array([np.linalg.norm(points[a] - points[b]) for a, b in self.pairs()])

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
    """Return residuals (n, c), or their slopes (n, c, k), by the `weights` (n,) of readings, and what is `more`."""
    weighted = np.sqrt(weights).reshape(-1, *[1] * (rows.ndim - 1)) * rows
    return np.concatenate([weighted.reshape(-1, *rows.shape[2:]), more])
