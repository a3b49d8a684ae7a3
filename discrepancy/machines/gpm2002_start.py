"""Where to begin: encoder offsets at which the legs of the nominal machine about meet, whatever they are stated to be.

Offsets are known up to a few tenths of a radian, or not at all; a fit from there may end in another configuration. So
all three are scanned over the turn on a few readings of the nominal machine, and the best are refined.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from discrepancy.machine import Formulation
from problems.base import Array

_STEPS = 24  # of the turn, in each offset
_TRIED = 12
_WILD = 150.0  # mm: a miss beyond counts as this much; near-singular readings must not decide
_ROUNDS = 30
_CLEARLY = 0.5  # offsets elsewhere must close this many times better than those near the stated ones


def closing_offsets(
    formulation: Formulation, nominal: Mapping[str, float], free: tuple[str, ...], stated: bool
) -> tuple[dict[str, float], float]:
    """Return the offsets `free`, rad, that close the nominal machine best on the formulation's rows, and the miss, mm.

    The miss is a median over readings. Where the offsets are `stated` those in `nominal` are begun from, too, and
    kept to unless others close clearly better.
    """
    q = {name: np.asarray(value) for name, value in {**formulation.fixed, **nominal}.items()}
    q |= {name: formulation.data[name] for name in formulation.readings}
    begin = np.array([nominal[name] for name in free])
    if not free:
        return {}, _miss(formulation, q, free, begin)
    near, miss = _refined(formulation, q, free, begin)
    if not (stated and miss < 3.0):
        ends = [_refined(formulation, q, free, far) for far in _scan(formulation, q, free)]
        far, other = min(ends, key=lambda end: end[1])
        if not stated or other < _CLEARLY * miss:
            near, miss = far, other
    turns = 2 * np.pi * np.round((begin - near) / (2 * np.pi))
    return dict(zip(free, (near + turns).tolist())), miss


def _scan(formulation: Formulation, q: dict[str, Array], free: tuple[str, ...]) -> list[Array]:
    """Return the offsets of the scan that miss least, at most `_TRIED`."""
    turn = np.linspace(0, 2 * np.pi, _STEPS, endpoint=False)
    grid = np.stack(np.meshgrid(*[turn] * len(free), indexing="ij"), axis=-1).reshape(-1, len(free))
    few = np.unique(np.linspace(0, len(formulation.data) - 1, 10).round().astype(int))
    at = {name: value[few] if np.ndim(value) else value for name, value in q.items()}
    at |= {name: grid[:, k, None] for k, name in enumerate(free)}
    with np.errstate(divide="ignore", invalid="ignore"):
        powers = np.abs(formulation.constraints(at)).reshape(len(grid), -1)
    misses = np.minimum(np.where(np.isfinite(powers), powers, _WILD), _WILD).mean(axis=1)
    order = np.argsort(misses)
    return [grid[k] for k in order[:_TRIED]]


def _refined(formulation: Formulation, q: dict[str, Array], free: tuple[str, ...], z: Array) -> tuple[Array, float]:
    """Return the offsets after damped Gauss-Newton steps from `z`, and their miss."""
    damping, best = 1e-2, _square(formulation, q, free, z)
    for _ in range(_ROUNDS):
        at = q | dict(zip(free, z))
        slopes = formulation.slopes(at)
        jacobian = np.stack([slopes[name].ravel() for name in free], axis=1)
        gradient, normal = jacobian.T @ formulation.constraints(at).ravel(), jacobian.T @ jacobian
        trial = z - np.linalg.solve(normal + damping * (np.diag(np.diag(normal)) + 1e-12 * np.eye(len(z))), gradient)
        square = _square(formulation, q, free, trial)
        if square < best:
            settled = best - square < 1e-9 * best
            z, best, damping = trial, square, damping / 10
            if settled:
                break
        else:
            damping = max(damping, 1e-6) * 10
            if damping > 1e6:
                break
    return z, _miss(formulation, q, free, z)


def _square(formulation: Formulation, q: dict[str, Array], free: tuple[str, ...], z: Array) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        square = float((formulation.constraints(q | dict(zip(free, z))) ** 2).sum())
    return square if np.isfinite(square) else np.inf


def _miss(formulation: Formulation, q: dict[str, Array], free: tuple[str, ...], z: Array) -> float:
    """Return the median over readings of the largest miss, mm."""
    return float(np.median(np.abs(formulation.constraints(q | dict(zip(free, z)))).max(axis=1)))
