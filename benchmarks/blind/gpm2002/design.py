"""What is driven and when: poses in a disc, each visited twice, in different order, and read twice; some held out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.gpm2002.machine import HOME, Array, elbows, inverse
from benchmarks.blind.gpm2002.statics import geometry


@dataclass(frozen=True)
class Plan:
    """One row a reading, in the order of time, n rows. mm, s, N, K above the reference."""

    t: Array
    pose: NDArray[np.int64]
    visit: NDArray[np.int64]
    repeat: NDArray[np.int64]
    train: NDArray[np.bool_]
    position: Array
    velocity: Array
    load: Array
    temperature: Array
    preload: float
    branch: Array
    radius: float

    @property
    def speed(self) -> Array:
        """Speed of the end-effector [mm/s], shape (n,)."""
        return np.hypot(self.velocity[:, 0], self.velocity[:, 1])

    @property
    def heading(self) -> Array:
        """Direction of travel [rad], shape (n,)."""
        return np.arctan2(self.velocity[:, 1], self.velocity[:, 0])

    @property
    def phase(self) -> Array:
        """Time as a fraction of the run, shape (n,)."""
        return (self.t - self.t[0]) / (self.t[-1] - self.t[0])


def random_plan(machine: Array, rng: np.random.Generator, poses: int | None = None) -> Plan:
    """Draw a plan: 45-90 poses to fit (or `poses`), 35-60 held out, discs, radius 95-140 mm, rarely other elbows."""
    fitted, held = int(rng.integers(45, 91)), int(rng.integers(35, 61))
    fitted = fitted if poses is None else poses
    radius = float(rng.uniform(95, 140))
    points = HOME + _disc(fitted + held, radius, rng)
    branch = _branch(machine, points, rng)

    first, second = rng.permutation(fitted), rng.permutation(fitted)
    order = np.concatenate([first, second])
    slots = np.sort(rng.integers(0, len(order) + 1, held))
    order = np.insert(order, slots, fitted + rng.permutation(held))
    visits = len(order)

    starts = rng.uniform(0, 100) + np.cumsum(rng.uniform(6, 15, visits))
    t = (starts[:, None] + np.column_stack([np.zeros(visits), rng.uniform(1.5, 3, visits)])).ravel()
    wander = np.zeros((visits, 2))
    if rng.random() < 0.3:  # a commanded position is met again to some hundredths only
        wander = rng.uniform(0.01, 0.05) * rng.standard_normal((visits, 2))
    heading, speed = rng.uniform(-np.pi, np.pi, visits), rng.uniform(10, 200, visits)
    process, push = rng.uniform(-np.pi, np.pi, visits), rng.uniform(15, 110, visits)
    load = push[:, None] * np.column_stack([np.cos(process), np.sin(process)]) - [0.0, rng.uniform(10, 40)]

    def twice(values: Array) -> Array:
        return np.repeat(values, 2, axis=0)

    return Plan(
        t=t,
        pose=twice(order).astype(np.int64),
        visit=twice(np.arange(visits)).astype(np.int64),
        repeat=np.tile([0, 1], visits).astype(np.int64),
        train=twice(order) < fitted,
        position=twice(points[order] + wander),
        velocity=twice(speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])),
        load=twice(load),
        temperature=_warming(t - t[0], rng),
        preload=float(rng.choice([-1, 1]) * rng.uniform(8, 35)),
        branch=branch,
        radius=radius,
    )


def _disc(n: int, radius: float, rng: np.random.Generator) -> Array:
    r, angle = radius * np.sqrt(rng.random(n)), rng.uniform(-np.pi, np.pi, n)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle)])


def _branch(machine: Array, points: Array, rng: np.random.Generator) -> Array:
    """Return the sides of the elbows: the maker's, or at random one of the others that stays clear of singularities."""
    if rng.random() < 0.25:
        for _ in range(8):
            branch = rng.choice([-1.0, 1.0], 3)
            theta = inverse(machine, points, branch)
            b = elbows(machine, theta)
            p, q = b[:, 1] - b[:, 0], b[:, 2] - b[:, 0]
            spread = np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
            g, _ = geometry(machine, points, theta)
            if spread.min() > 8e3 and np.linalg.cond(g).max() < 7:
                return branch
    return np.ones(3)


def _warming(t: Array, rng: np.random.Generator) -> Array:
    """Return the temperature above the reference [K]: warming up, with a slow swing of the hall."""
    end, tau = rng.uniform(3, 10), rng.uniform(400, 1500)
    swing, period, phase = rng.uniform(1.0, 3.0), rng.uniform(400, 1500), rng.uniform(-np.pi, np.pi)
    return end * (1 - np.exp(-t / tau)) + swing * (np.sin(2 * np.pi * t / period + phase) - np.sin(phase))
