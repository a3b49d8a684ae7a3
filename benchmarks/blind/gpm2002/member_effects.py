"""Hidden effects that act on members: springs, clearances, warmth, a base that moves."""

from __future__ import annotations

import numpy as np

from benchmarks.blind.gpm2002.design import Plan
from benchmarks.blind.gpm2002.effect import Effect, one_joint
from benchmarks.blind.gpm2002.machine import Array

EXPANSION = 12e-6  # 1/K, steel


def stiffening(force: Array, knee: float) -> Array:
    """Return x of the hardening spring x + x^3 / knee^2 = force, in units of the force at unit stiffness: Cardano."""
    return 2 * knee / np.sqrt(3) * np.sinh(np.arcsinh(1.5 * np.sqrt(3) * force / knee) / 3)


def compliance(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """The drive of joint i winds up by a rad per N mm, less and less."""
    knee = rng.uniform(2.0, 4.0) * 15e3

    def windup(a: float, tau: Array) -> Array:
        return one_joint(i, a * stiffening(tau[:, i], knee))

    return _on_leg("compliance", "joint", i, "rad/(N mm)", 1e-8, 1e-6, needs=(f"tau_{i + 1}",), windup=windup)


def proximal_bending(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """Proximal link i bends, a cantilever under the elbow's side force: its chord turns by tau la / (3 E I) = a tau."""
    knee = rng.uniform(4.0, 8.0) * 15e3

    def windup(a: float, tau: Array) -> Array:
        return one_joint(i, a * stiffening(tau[:, i], knee))

    return _on_leg("proximal_bending", "leg", i, "rad/(N mm)", 1e-8, 1e-6, needs=(f"tau_{i + 1}",), windup=windup)


def axial_compliance(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """Distal link i stretches by a mm per N, less and less."""
    knee = rng.uniform(2.0, 4.0) * 80.0

    def stretch(a: float, n: Array) -> Array:
        return one_joint(i, a * stiffening(n[:, i], knee))

    return _on_leg("axial_compliance", "leg", i, "mm/N", 2e-4, 0.02, needs=(f"axial_{i + 1}",), stretch=stretch)


def clearance(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """The pins of distal link i have a mm of play: it is longer by half of it in tension, shorter in compression."""
    soft = rng.uniform(1.0, 5.0)

    def stretch(a: float, n: Array) -> Array:
        return one_joint(i, a / 2 * np.tanh(n[:, i] / soft))

    return _on_leg("clearance", "leg", i, "mm", 0.04, 2.0, needs=(f"axial_{i + 1}",), stretch=stretch)


def thermal_links(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """All six links grow by the fraction a per K, a little after the thermometer."""
    return _thermal("thermal_links", "all", slice(6, 12), plan, rng, EXPANSION)


def thermal_leg(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """Both links of leg i grow by the fraction a per K."""
    return _thermal("thermal_leg", f"leg {i + 1}", [6 + i, 9 + i], plan, rng, EXPANSION)


def thermal_base(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """The table grows by the fraction a per K about its middle, and carries the three bases along."""
    warmth = _late(plan, rng)

    def body(a: float, plan: Plan, machine: Array) -> Array:
        change = np.zeros((len(plan.t), 15))
        a_i = machine[:6].reshape(3, 2)
        change[:, :6] = a * warmth[:, None] * (a_i - a_i.mean(axis=0)).ravel()
        return change

    return Effect("thermal_base", "all", "1/K", EXPANSION, 2e-3, ("temp_K",), body=body)


def base_shift(i: int, plan: Plan, rng: np.random.Generator) -> Effect:
    """Base i gives way once, by a mm in some direction."""
    when, width = rng.uniform(0.2, 0.8), rng.choice([1e-6, rng.uniform(0.003, 0.03)])
    direction = rng.uniform(-np.pi, np.pi)

    def body(a: float, plan: Plan, machine: Array) -> Array:
        change = np.zeros((len(plan.t), 15))
        share = np.clip((plan.phase - when) / width + 0.5, 0, 1)
        change[:, 2 * i : 2 * i + 2] = a * share[:, None] * [np.cos(direction), np.sin(direction)]
        return change

    return Effect("base_shift", f"base {i + 1}", "mm", 0.05, 5.0, body=body)


def _thermal(
    family: str, target: str, columns: object, plan: Plan, rng: np.random.Generator, typical: float
) -> Effect:  # fmt: skip
    warmth = _late(plan, rng)

    def body(a: float, plan: Plan, machine: Array) -> Array:
        change = np.zeros((len(plan.t), 15))
        change[:, columns] = a * warmth[:, None] * machine[columns]
        return change

    return Effect(family, target, "1/K", typical, 2e-3, ("temp_K",), body=body)


def _late(plan: Plan, rng: np.random.Generator) -> Array:
    """Return the members' warmth [K], shape (n,): the thermometer's, through a lag of first order, .5 to 2 minutes."""
    tau, warmth = rng.uniform(30, 120), np.empty(len(plan.t))
    warmth[0] = plan.temperature[0]
    for k, pull in enumerate(-np.expm1(-np.diff(plan.t) / tau)):
        warmth[k + 1] = warmth[k] + pull * (plan.temperature[k + 1] - warmth[k])
    return warmth


def _on_leg(family: str, kind: str, i: int, unit: str, typical: float, largest: float, **parts: object) -> Effect:
    return Effect(family, f"{kind} {i + 1}", unit, typical, largest, **parts)
