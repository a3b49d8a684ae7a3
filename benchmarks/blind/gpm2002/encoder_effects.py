"""Hidden effects that act where angles are read: discs, gears, counters, clocks, friction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.blind.gpm2002.design import Plan
from benchmarks.blind.gpm2002.effect import Effect, State, one_joint
from benchmarks.blind.gpm2002.machine import Array, inverse

TURN = 2 * np.pi


def eccentricity(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """The disc turns beside its centre, a = e / radius: seen from there the head stands at another angle."""
    phase = rng.uniform(-np.pi, np.pi)

    def read(a: float, s: State) -> Array:
        x = s.rest.motor_angles[:, i] - phase
        return one_joint(i, np.arctan2(a * np.sin(x), 1 - a * np.cos(x)))

    return _joint("eccentricity", i, "rad", 0.01, 0.2, read=read)


def second_harmonic(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """The disc is an ellipse, or the sine and cosine tracks differ in gain by 1 +- a."""
    phase = rng.uniform(-np.pi, np.pi)

    def read(a: float, s: State) -> Array:
        x = s.rest.motor_angles[:, i] - phase
        seen = np.arctan2((1 + a) * np.sin(x), (1 - a) * np.cos(x))
        return one_joint(i, np.remainder(seen - x + np.pi, TURN) - np.pi)

    return _joint("second_harmonic", i, "rad", 0.005, 0.15, read=read)


def angle_error(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """A disc with a slow irregularity: a third harmonic with some of the others."""
    phases, weights = rng.uniform(-np.pi, np.pi, 3), np.array([1.0, *rng.uniform(0, 0.35, 2)])

    def read(a: float, s: State) -> Array:
        x = s.rest.motor_angles[:, i]
        return one_joint(i, a * sum(w * np.sin(k * x + p) for k, w, p in zip((3, 2, 4), weights, phases)))

    return _joint("angle_error", i, "rad", 1e-3, 0.05, read=read)


def gear(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """The reduction is not what the counter believes, by the fraction a."""

    def read(a: float, s: State) -> Array:
        return one_joint(i, a * (s.rest.motor_angles[:, i] - s.still.motor_angles[:, i].mean()))

    return _joint("gear", i, "1", 1e-3, 0.05, read=read)


def cyclic(i: int, plan: Plan, rng: np.random.Generator, teeth: int) -> Effect:
    """Tooth by tooth: an error that rises faster than it falls."""
    phase, skew = rng.uniform(-np.pi, np.pi), rng.uniform(0.0, 0.5)

    def read(a: float, s: State) -> Array:
        x = teeth * s.rest.motor_angles[:, i] + phase
        return one_joint(i, a * np.sin(x + skew * np.sin(x)))

    return _joint("cyclic", i, "rad", 1e-4, 0.01, read=read)


def slip(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """The disc slips on its shaft once, within some readings or at a blow."""
    when, width = rng.uniform(0.2, 0.8), rng.choice([1e-6, rng.uniform(0.003, 0.03)])

    def read(a: float, s: State) -> Array:
        return one_joint(i, a * np.clip((s.plan.phase - when) / width + 0.5, 0, 1))

    return _joint("slip", i, "rad", 1e-4, 0.02, read=read)


def drift(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """The zero creeps, a rad over the run: straight, settling down, or gathering speed."""
    bend = rng.choice([0.0, rng.uniform(0.5, 3.0), -rng.uniform(0.5, 1.5)])

    def read(a: float, s: State) -> Array:
        x = s.plan.phase
        return one_joint(i, a * (x if bend == 0 else np.expm1(-bend * x) / np.expm1(-bend)))

    return _joint("drift", i, "rad", 2e-4, 0.02, read=read)


def quantisation(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """A counter that lost its last bits: steps of a rad, whatever the data sheet says."""

    def coarsen(a: float, readings: Array) -> Array:
        out = readings.copy()
        if a > 0:
            out[:, i] = a * np.round(out[:, i] / a)
        return out

    return _joint("quantisation", i, "rad", 3e-4, 0.05, coarsen=coarsen)


def outlier(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """A bad contact: some readings of one encoder jump, each in a way of its own, about a rad."""
    n = len(plan.t)
    struck = rng.random(n) < rng.uniform(0.03, 0.09)
    struck[rng.choice(np.flatnonzero(plan.train), 4, replace=False)] = True
    jump = struck * rng.choice([-1.0, 1.0], n) * rng.uniform(0.5, 1.5, n)
    return _joint("outlier", i, "rad", 5e-4, 0.05, read=lambda a, s: one_joint(i, a * jump))


def heavy_tails(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """All three encoders are hit now and then: rare shocks of scale a beside the ordinary noise."""
    n = len(plan.t)
    shocks = (rng.random((n, 3)) < rng.uniform(0.04, 0.1)) * rng.standard_t(3, (n, 3)).clip(-6, 6)
    return Effect("heavy_tails", "all", "rad", 3e-4, 0.05, read=lambda a, s: a * shocks)


def backlash(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """A gap a is taken up to the side of motion, and a little more at low speed: Stribeck's friction."""
    stribeck, slow = rng.uniform(0.0, 0.3), rng.uniform(0.02, 0.1)

    def read(a: float, s: State) -> Array:
        v = joint_velocity(s)[:, i]
        return one_joint(i, a / 2 * np.tanh(v / 2e-3) * (1 + stribeck * np.exp(-((v / slow) ** 2))))

    return _joint("backlash", i, "rad", 2e-4, 0.04, needs=(f"dir_{i + 1}", f"vel_{i + 1}"), read=read)


def lag(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """One encoder is read a seconds late: it says where its joint was on the straight line through the pose."""

    def read(a: float, s: State) -> Array:
        earlier = inverse(_stretched(s), s.rest.position - a * s.plan.velocity, s.plan.branch)
        return one_joint(i, (earlier - s.rest.link_angles)[:, i])

    return _joint("lag", i, "s", 1e-3, 0.1, needs=(f"vel_{i + 1}",), read=read)


def tracker_lag(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """The tracker is read a seconds late."""
    needs = ("x", "y", "vel_1", "vel_2", "vel_3", "speed", "heading")
    return Effect(
        "tracker_lag", "tracker", "s", 1e-3, 0.1, needs, gauge="angles", see=lambda a, s: -a * s.plan.velocity
    )  # fmt: skip


def joint_velocity(s: State) -> Array:
    """Return the angular velocities [rad/s], shape (n, 3), by central differences along the path."""
    still, step = _stretched(s), 1e-4
    ahead, behind = (inverse(still, s.rest.position + h * s.plan.velocity, s.plan.branch) for h in (step, -step))
    return (ahead - behind) / (2 * step)


def _stretched(s: State) -> Array:
    members = np.array(s.members)
    members[:, 9:12] = s.rest.distal
    return members


def _joint(family: str, i: int, unit: str, typical: float, largest: float, **parts: object) -> Effect:
    return replace(Effect(family, f"joint {i + 1}", unit, typical, largest), **parts)
