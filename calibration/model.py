"""`ArmModel`: the small errors of an arm, and the residuals that they leave of its readings.

The frames that were found are in the chain, so that every parameter is small (a gain near 1). Residuals (n, c) are in
units of the noise; for a ball in sockets the vector from its socket's mean point, and one for each known distance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import final

import numpy as np

from calibench.calibration.dh import DhArm, DhTable
from calibench.calibration.kinematics import Chain, forward, jacobian, parameter_units
from calibench.calibration.loci import Loci
from calibench.calibration.readings import Readings
from calibench.calibration.rigid import Array, Index, Mask, cross, inverse, vector_of
from calibench.core.notes import DataError
from calibench.core.options import suggest

WITHIN = 20.0  # mm, or mrad: hardly a tolerance; a closer one would keep up the noise that it leaves
KNOWN_TO = 0.05  # mm: how well the distance of two printed or drilled sockets is known where nobody says it


@final
@dataclass(frozen=True, eq=False)
class ArmModel:
    """A chain from the tracker to the target, with the frames that were found, and what was read.

    `sigma` is the noise of a position [mm] and of a rotation [rad]; `distance` that of two sockets of a place [mm], 0
    where it is not known. `scatter` (n,) is how many times as far as others the readings of a socket lie apart. `rows`
    is the arm of a table. `tolerance` [mm, mrad] is the
    standard error of the arm's nominal lengths and angles before any reading. `target` (n,) is the target of each
    reading, 0 the one at the end of the chain; the others sit at `seats` (k, 3) [mm] from it, and at the numbers
    tool_x_K, tool_y_K, tool_z_K from there, which stand before those of the tool. Where less than places was read,
    `loci` says what each reading allows; the numbers of its fixtures stand before those of the tool as well. `priors`
    has numbers of which more is known: by how much they are off, and its standard error [mm, rad]. `torque` [N m],
    (n, columns), is what each joint holds: it stands at its reading less elastic_J, its compliance, times that. With
    `sees` the target is a camera: `position` and `turns` are of the tracker's frame in the target's, and so are
    residuals.
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
    tolerance: float = WITHIN
    target: Index | None = None
    seats: Array = field(default_factory=lambda: np.zeros((0, 3)))
    loci: Loci | None = None
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    torque: Array | None = None
    sees: bool = False

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Return the names of all parameters."""
        names = tuple(parameter_units(self.chain)) if self.rows is None else self.rows.names
        return (*names[:-6], *self._more, *names[-6:])

    @cached_property
    def _more(self) -> tuple[str, ...]:
        """Return the names of the numbers that stand before those of the tool: of further targets, and of fixtures."""
        of_targets = (f"tool_{one}_{k}" for k in range(2, len(self.seats) + 2) for one in "xyz")
        elastic = () if self.torque is None else (f"elastic_{name}" for name in self.chain.driven)
        return (*of_targets, *elastic, *(() if self.loci is None else self.loci.names))

    @property
    def sliding(self) -> frozenset[str]:
        """Return the joints that slide."""
        return frozenset(joint.name for joint in self.chain.joints if joint.kind == "sliding")

    @property
    def start(self) -> Array:
        """Return the nominal parameters, nothing being wrong: 0, and 1 for a gain."""
        return np.array([1.0 if name.startswith("gain_") else 0.0 for name in self.names])

    @property
    def wanted(self) -> Array:
        """Return the parameters before any reading: nominal, or what is known of them."""
        return self.start + [self.priors[name][0] if name in self.priors else 0.0 for name in self.names]

    @property
    def of_rows(self) -> Array:
        """Return the noise of each position, (n,) [mm]."""
        return self.sigma[0] * (np.ones(len(self.joints)) if self.scatter is None else self.scatter)

    @property
    def counted(self) -> Array:
        """Return how many numbers were read at each reading, (n,)."""
        if self.loci is not None and self.position is not None:
            return self.loci.counted(self.position)
        return np.full(len(self.joints), 3.0 if self.turns is None else 6.0)

    def at(self, keep: Mask | Index) -> ArmModel:
        """Return the model of some poses, with its sockets counted from 0 without a gap."""
        position, turns, scatter = (
            None if one is None else one[keep] for one in (self.position, self.turns, self.scatter)
        )
        socket = np.unique(self.socket[keep], return_inverse=True)[1].ravel().astype(np.int64)
        return replace(
            self, joints=self.joints[keep], position=position, turns=turns, socket=socket, place=self.place[keep],
            scatter=scatter, target=None if self.target is None else self.target[keep],
            loci=None if self.loci is None else self.loci.at(keep),
            torque=None if self.torque is None else self.torque[keep],
        )  # fmt: skip

    def placed(self, p: Array) -> Array:
        """Return the target's pose at each reading, (n, 4, 4)."""
        arm, places, stands, _ = self.parts(p)
        poses = forward(self.chain, arm, stands) if self.rows is None else self.rows.forward(arm, stands)
        if self.target is not None:
            poses = poses.copy()
            poses[:, :3, 3] += np.einsum("nij,nj->ni", poses[:, :3, :3], places[self.target])
        return poses

    def slopes(self, p: Array, free: Index) -> Array:
        """Return the derivative of the target's pose in the parameters `free`, (n, 6, k), or (n, 3, k) of places."""
        of, seats, (arm, places, stands, _) = self.rows, 3 * len(self.seats), self.parts(p)
        some, turns = None if self._more else free, self.turns is not None or seats > 0
        slopes = jacobian(self.chain, arm, stands, some, turns) if of is None else of.jacobian(arm, stands, some, turns)
        if not self._more:
            return slopes
        more = np.zeros((*slopes.shape[:2], len(self._more)))
        if self.target is not None:
            first = forward(self.chain, arm, stands) if of is None else of.forward(arm, stands)
            lever = np.einsum("nij,nj->ni", first[:, :3, :3], places[self.target])
            slopes[:, :3] += cross(np.swapaxes(slopes[:, 3:], 1, 2), lever[:, None]).swapaxes(1, 2)
            for k in range(len(self.seats)):
                more[:, :3, 3 * k : 3 * k + 3] = np.where((self.target == k + 1)[:, None, None], first[:, :3, :3], 0.0)
        if self.torque is not None:  # by the slopes in each reading, (n, c, columns), from those in the joints' zeros
            at, (gains, _) = {name: k for k, name in enumerate(self.names)}, self.chain.following
            zeros = [at.get(f"zero_{joint.name}", at.get(f"theta_{joint.name}", -1)) for joint in self.chain.joints]
            of_readings = np.asarray(slopes[:, :, zeros] @ (gains * (np.array(zeros) >= 0)[:, None]))
            more[:, :, seats : seats + self.torque.shape[1]] = -of_readings * self.torque[:, None]
        return np.concatenate([slopes[:, :, :-6], more, slopes[:, :, -6:]], axis=2)[:, :, free]

    def parts(self, p: Array) -> tuple[Array, Array, Array, Array]:
        """Return what p says: the arm's own numbers, where each target sits from the first one, (k + 1, 3) [mm], where

        the joints are that are read, (n, columns), less by what they give way, and the numbers of fixtures.
        """
        more, seats = p[len(p) - 6 - len(self._more) : -6], 3 * len(self.seats)
        arm = np.concatenate([p[: -6 - len(self._more)], p[-6:]]) if self._more else p
        places = np.concatenate([np.zeros((1, 3)), self.seats + more[:seats].reshape(-1, 3)])
        if self.torque is None:
            return arm, places, self.joints, more[seats:]
        first = seats + self.torque.shape[1]
        return arm, places, np.asarray(self.joints - more[seats:first] * self.torque), more[first:]

    def errors(self, p: Array, weights: Array | None = None, poses: Array | None = None) -> tuple[Array, Array | None]:
        """Return residual positions (n, 3), of a ball from its socket's mean point, and rotations (n, 3) or None."""
        poses = self.placed(p) if poses is None else poses
        if self.position is None:
            return poses[:, :3, 3] - self._means(poses[:, :3, 3], weights)[self.socket], None
        if self.loci is not None:
            return self.loci.residuals(poses[:, :3, 3], self.position, self.parts(p)[3])[0], None
        poses = inverse(poses) if self.sees else poses
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
        slopes = self.slopes(p, kept)
        if self.position is not None:
            if self.sees:  # of R, t to R', -R' t: in the target, R' (w x t - dt) and -R' w
                placed = self.placed(p)
                turned = np.cross(slopes[:, 3:], placed[:, :3, 3, None], axis=1) - slopes[:, :3]
                back = placed[:, :3, :3].swapaxes(1, 2)
                slopes = np.concatenate([back @ turned, -back @ slopes[:, 3:]], axis=1)
            over = slopes[:, :3] / self.of_rows[:, None, None]
            if self.loci is not None:
                every = np.zeros((len(slopes), 3, len(p)))
                places, numbers = self.placed(p)[:, :3, 3], self.parts(p)[3]
                _, across, of_fixtures = self.loci.residuals(places, self.position, numbers)
                every[:, :, len(p) - 6 - of_fixtures.shape[2] : -6] = of_fixtures / self.of_rows[:, None, None]
                over = across @ over + every[:, :, kept]
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
    priors: Mapping[str, tuple[float, float]] | None = None, sees: bool = False,
) -> ArmModel:  # fmt: skip
    """Return the model of `readings` with the frames that were found in its chain; of a `table` its numbers.

    Raises `DataError` for `priors` of numbers that the arm has not.
    """
    position, turns = readings.position, readings.turns
    if sees:
        if position is None or turns is None:
            raise DataError("the board's rotations fit no place of a camera on this arm")
        turns = turns.swapaxes(1, 2)
        position = -np.einsum("nij,nj->ni", turns, position)
    placed = chain.placed(base, chain.tool @ tool)
    model = ArmModel(
        chain=placed, joints=readings.joints, position=position, turns=turns, sees=sees,
        socket=readings.socket, place=readings.place, distance=distance,
        sigma_distance=sigma_distance, rows=None if table is None else DhArm(table, placed.mount, placed.tool),
        loci=readings.loci, priors=priors or {},
    )  # fmt: skip
    for name, (value, sd) in model.priors.items():
        known = [one for one in model.names if not one.startswith(("base_", "tool_"))]
        if name not in known:
            raise DataError(f"priors: {name} is no number of the arm; {suggest(name, known)}")
        if not (np.isfinite(value) and 0 < sd < np.inf):
            raise DataError(f"priors: {name}: {value:g} with {sd:g}; a value and a standard error above 0 are needed")
    if not readings.target.any():
        return model
    assert readings.position is not None
    poses = model.placed(model.start)
    there = np.einsum("nji,nj->ni", poses[:, :3, :3], readings.position - poses[:, :3, 3])
    fitted = readings.train
    seats = [np.median(there[fitted & (readings.target == k)], axis=0) for k in range(1, len(readings.targets))]
    return replace(model, target=readings.target, seats=np.array(seats))
