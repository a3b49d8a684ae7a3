"""Hidden effects that no catalogue has: the honest answer to them is "unknown"."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.blind.gpm2002.design import Plan
from benchmarks.blind.gpm2002.effect import Effect, State, one_joint
from benchmarks.blind.gpm2002.encoder_effects import joint_velocity
from benchmarks.blind.gpm2002.machine import HOME, Array, elbows


def bump(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """A bad spot of the table lifts the arm: leg i is read wrongly within some 30 mm of it."""
    spot, width = _spot(plan, rng, 0.6), rng.uniform(20, 40)
    return _read("bump", i, lambda s: _bell(s, spot, width))


def magnet(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """Two magnets under the table, of opposite poles, disturb encoder i."""
    one, two, width = _spot(plan, rng, 0.7), _spot(plan, rng, 0.7), rng.uniform(30, 55)
    ratio = rng.uniform(0.5, 1.0)
    return _read("magnet", i, lambda s: _bell(s, one, width) - ratio * _bell(s, two, width))


def warm_bow(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """A bimetal frame: bases 2 and 3 part in opposite senses along x with the square of the temperature."""

    def body(a: float, plan: Plan, machine: Array) -> Array:
        change = np.zeros((len(plan.t), 15))
        swing = (plan.temperature - plan.temperature.mean()) ** 2
        change[:, 2], change[:, 4] = a * swing, -a * swing
        return change

    return Effect("warm_bow", "base", "mm/K^2", 1e-3, 0.5, ("temp_K",), known=False, body=body)


def crosstalk(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """The signal of the next encoder leaks into encoder i: a wave over the other joint's angle."""
    other, order, phase = (i + int(rng.integers(1, 3))) % 3, int(rng.integers(12, 25)), rng.uniform(-np.pi, np.pi)
    return _read("crosstalk", i, lambda s: np.sin(order * s.rest.motor_angles[:, other] + phase))


def speed_squared(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """Centrifugal bending: an error with the square of the joint's velocity, whatever its sign."""
    return _read("speed_squared", i, lambda s: _scaled(joint_velocity(s)[:, i] ** 2), f"vel_{i + 1}")


def heading_tilt(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """The carriage leans with the axis of travel, the same to and fro."""
    phase = rng.uniform(-np.pi, np.pi)
    return _read("heading_tilt", i, lambda s: np.cos(2 * s.plan.heading + phase), "heading")


def hum(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """A periodic disturbance in time: some 8 to 20 periods over the run."""
    count, phase = rng.uniform(8, 20), rng.uniform(-np.pi, np.pi)
    return _read("hum", i, lambda s: np.sin(2 * np.pi * count * s.plan.phase + phase))


def elbow_bearing(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """An oval bearing at elbow i: the distal link is longer or shorter with the angle between the links."""
    order, phase = int(rng.integers(7, 13)), rng.uniform(-np.pi, np.pi)

    def read(a: float, s: State) -> Array:
        b = elbows(s.members, s.rest.link_angles)[:, i]
        passive = np.arctan2(*(s.rest.position - b).T[::-1])
        return one_joint(i, a * np.sin(order * (passive - s.rest.link_angles[:, i]) + phase))

    return Effect("elbow_bearing", f"joint {i + 1}", "rad", 1e-4, 0.02, known=False, read=read)


def plane_tilt(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """Leg i leaves the plane over a warped table: its height, a mm at the rim, shortens the distal link by a cosine."""
    axis, waves = rng.uniform(-np.pi, np.pi), rng.uniform(1.2, 2.0)

    def body(a: float, plan: Plan, machine: Array) -> Array:
        along = (plan.position - HOME) @ [np.cos(axis), np.sin(axis)] / plan.radius
        height, lb = a * np.sin(np.pi * waves * along), machine[9 + i]
        change = np.zeros((len(plan.t), 15))
        change[:, 9 + i] = np.sqrt(lb**2 - height**2) - lb
        return change

    return Effect("plane_tilt", f"leg {i + 1}", "mm", 3.0, 60.0, known=False, body=body)


def load_squared(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """The table sags under the square of the load, and encoder i with it."""
    return _read("load_squared", i, lambda s: _scaled((s.plan.load**2).sum(axis=1)), "load_x", "load_y")


def memory(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """Creeping friction: encoder i remembers the moves of the last visits, each less than the one before."""
    keep = rng.uniform(0.5, 0.8)

    def shape(s: State) -> Array:
        moves = np.sign(np.diff(s.rest.motor_angles[:, i], prepend=s.rest.motor_angles[0, i]))
        moves[s.plan.repeat > 0] = 0.0
        trace, out = 0.0, np.empty(len(moves))
        for k, move in enumerate(moves):
            trace = trace if s.plan.repeat[k] else keep * trace + move
            out[k] = trace
        return out

    return _read("memory", i, shape)


def _read(family: str, i: int, shape: Callable[[State], Array], *needs: str) -> Effect:
    def read(a: float, s: State) -> Array:
        return one_joint(i, a * shape(s))

    return Effect(family, f"joint {i + 1}", "rad", 1e-4, 0.05, needs, known=False, read=read)


def _spot(plan: Plan, rng: np.random.Generator, within: float) -> Array:
    r, angle = plan.radius * within * np.sqrt(rng.random()), rng.uniform(-np.pi, np.pi)
    return HOME + r * np.array([np.cos(angle), np.sin(angle)])


def _bell(s: State, spot: Array, width: float) -> Array:
    return np.exp(-((s.rest.position - spot) ** 2).sum(axis=1) / (2 * width**2))


def _scaled(values: Array) -> Array:
    return values / np.abs(values).max()
