"""Causes in plain NumPy: an error of one joint over what the machine met; some the grammar can write, others it cannot.

`met` has, for each row in the order of time: angle, torque, velocity, direction (n, joints), t and temperature (n,).
Operators are written here anew, row by row. `truth` is the product of shapes that stands for a cause, as (what, of
which joint, shape), or nothing for a cause that the grammar cannot write.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Met = Mapping[str, Array]
Factor = tuple[str, str, str]  # what was met, "own" or "other" or "" for all, and the shape


@dataclass(frozen=True)
class Cause:
    """A drawn cause: its error for a size of 1, (n,), of what was met; what it is made of; the numbers drawn."""

    name: str
    error: Callable[[Met], Array]
    truth: tuple[Factor, ...] = ()
    numbers: tuple[float, ...] = ()


def _scaled(x: Array) -> Array:
    return x / max(float(np.max(np.abs(x))), 1e-12)


def _reach(x: Array) -> float:
    return float(np.max(np.abs(x - np.mean(x))))


def _hysteresis(x: Array, width: float) -> Array:
    out, at = [], float(x[0])
    for value in x:
        if value - at > width:
            at = value - width
        elif at - value > width:
            at = value + width
        out.append(at)
    return np.array(out)


def draw(name: str, own: int, other: int, rng: np.random.Generator) -> Cause:
    """Return a cause on joint `own`, with its numbers drawn."""
    k, m = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    part, late = rng.uniform(0.15, 0.4), rng.uniform(0.08, 0.3)
    free = float(rng.uniform(3.3, 7.0))
    phase = rng.uniform(-np.pi, np.pi)

    def of(what: str, joint: int) -> Callable[[Met], Array]:
        return lambda met: met[what][:, joint]

    q, v, tau, way = of("angle", own), of("velocity", own), of("torque", own), of("direction", own)
    q2, tau2 = of("angle", other), of("torque", other)

    def temperature(met: Met) -> Array:
        return met["temperature"]

    def time(met: Met) -> Array:
        return (met["t"] - met["t"][0]) / (met["t"][-1] - met["t"][0])

    writable: dict[str, tuple[Callable[[Met], Array], tuple[Factor, ...], tuple[float, ...]]] = {
        "wave_of_other_times_torque": (
            lambda x: np.sin(k * q2(x)) * _scaled(tau(x)), (("angle", "other", "sin"), ("torque", "own", "u")), (k,)),
        "wave_of_own_times_torque": (
            lambda x: np.cos(k * q(x)) * _scaled(tau2(x)), (("angle", "own", "cos"), ("torque", "other", "u")), (k,)),
        "two_waves": (
            lambda x: np.sin((k + 1) * q(x)) * np.cos((m + 1) * q2(x)),
            (("angle", "own", "sin"), ("angle", "other", "cos")), (k + 1, m + 1)),
        "crosstalk": (lambda x: np.sin(free * q2(x) + phase), (("angle", "other", "wave"),), (free,)),
        "torque_times_its_size": (
            lambda x: _scaled(tau(x) * np.abs(tau(x))), (("torque", "own", "signed square"),), ()),
        "speed_square": (lambda x: _scaled(v(x) ** 2), (("velocity", "own", "square"),), ()),
        "falling_friction": (
            lambda x: np.sign(v(x)) * np.exp(-np.abs(v(x)) / (part * np.max(np.abs(v(x))))),
            (("velocity", "own", "fall"),), ()),
        "saturated_torque": (
            lambda x: np.tanh(tau(x) / (part * np.max(np.abs(tau(x))))), (("torque", "own", "tanh"),), ()),
        "dead_zone_of_torque": (
            lambda x: np.sign(tau(x)) * np.maximum(np.abs(_scaled(tau(x))) - part, 0),
            (("torque", "own", "dead"),), ()),
        "play_that_wears_in": (
            lambda x: way(x) * np.exp(-time(x) / late), (("direction", "own", "u"), ("t", "", "exp")), ()),
        "friction_with_torque": (
            lambda x: way(x) * _scaled(np.abs(tau(x))), (("direction", "own", "u"), ("torque", "own", "abs")), ()),
        "torque_softened_by_heat": (
            lambda x: _scaled(tau(x)) * _scaled(temperature(x)),
            (("torque", "own", "u"), ("temperature", "", "u")), ()),
        "heat_and_wave": (
            lambda x: np.sin(k * q(x)) * _scaled(temperature(x)),
            (("angle", "own", "sin"), ("temperature", "", "u")), (k,)),
        "maxwell_slip": (
            lambda x: _scaled(q(x) - _hysteresis(q(x), part * _reach(q(x)))), (("angle", "own", "slip"),), ()),
        "hysteresis_of_torque": (
            lambda x: _scaled(tau(x) - _hysteresis(tau(x), 2 * part * _reach(tau(x)))),
            (("torque", "own", "slip"),), ()),
    }  # fmt: skip
    unwritable: dict[str, Callable[[Met], Array]] = {
        "bump_over_angles": lambda x: np.exp(
            -((q(x) - np.median(q(x))) ** 2 + (q2(x) - np.median(q2(x))) ** 2) / (part * _reach(q(x))) ** 2
        ),
        "three_factors": lambda x: np.sin(q2(x)) * _scaled(tau(x)) * _scaled(temperature(x)),
        "gear_of_a_sum": lambda x: np.sin((k + 1) * (q(x) + q2(x)) + phase),
        "hum": lambda x: np.sin(2 * np.pi * free * 2 * time(x) + phase),
        "steps_in_angle": lambda x: np.floor(3 * q(x) / _reach(q(x))),
        "rational": lambda x: _scaled(tau(x)) / (1 + (v(x) / (part * np.max(np.abs(v(x))))) ** 2),
    }
    if name in writable:
        error, truth, numbers = writable[name]
        return Cause(name, error, truth, tuple(float(n) for n in numbers))
    return Cause(name, unwritable[name])


WRITABLE = (
    "wave_of_other_times_torque", "wave_of_own_times_torque", "two_waves", "crosstalk", "torque_times_its_size",
    "speed_square", "falling_friction", "saturated_torque", "dead_zone_of_torque", "play_that_wears_in",
    "friction_with_torque", "torque_softened_by_heat", "heat_and_wave", "maxwell_slip", "hysteresis_of_torque",
)  # fmt: skip
OTHERS = ("bump_over_angles", "three_factors", "gear_of_a_sum", "hum", "steps_in_angle", "rational")


@dataclass(frozen=True)
class Case:
    """Columns and metadata of a file, the cause, and the true formula as (quantity, "shape column", ...)."""

    machine: str
    columns: dict[str, Any]
    metadata: dict[str, Any]
    cause: str
    visible: float
    truth: tuple[str, ...] = ()
