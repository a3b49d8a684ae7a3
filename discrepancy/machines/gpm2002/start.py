"""The start of the fit: encoder offsets at which the legs of the nominal machine nearly meet.

Offsets are known up to a few tenths of a radian, or not at all; a fit from there may end in another configuration. So
all three are scanned over the turn on a few readings of the nominal machine, and the best are refined.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain, product

import numpy as np

from calibench.discrepancy.model.machine import Formulation
from calibench.problems.base import Array

_STEPS = (24, 36)  # of the turn, in each offset; the second where the first finds nothing that closes
_ROWS = 7  # that the scan looks at
_TRIED = 80
_CLOSED = 1.0  # mm: offsets that close the nominal legs as well as this are not searched for any longer
_WILD = 150.0  # mm: a miss beyond counts as this much; near-singular readings must not decide
_ROUNDS = 30
_LINK = 244.0  # mm
_STEP = 1e-4  # mm, of differences
_CLEARLY = 0.5  # offsets elsewhere must close this many times better than those near the stated ones


def closing_offsets(
    formulation: Formulation, nominal: Mapping[str, float], free: tuple[str, ...], stated: bool
) -> tuple[dict[str, float], float]:
    """Return the offsets `free`, rad, with which the nominal machine closes best on the rows, and the misclosure, mm.

    The misclosure is a median over readings. Where the offsets are `stated`, those in `nominal` are a start as well,
    and are kept unless others close clearly better.
    """
    q = {name: np.asarray(value) for name, value in {**formulation.fixed, **nominal}.items()}
    q |= {name: formulation.data[name] for name in formulation.readings}
    begin = np.array([nominal[name] for name in free])
    if not free:
        return {}, float(np.median(np.abs(_missed(formulation, q, free, begin)[0]).max(axis=1)))
    near, miss = _refined(formulation, q, free, begin)
    if not (stated and miss < 3.0):
        far, other = begin, np.inf
        for place in chain.from_iterable(_scan(formulation, q, free, steps) for steps in _STEPS):
            end, left = _refined(formulation, q, free, place)
            if left < other:
                far, other = end, left
            if other < _CLOSED:
                break
        if not stated or other < _CLEARLY * miss:
            near, miss = far, other
    turns = 2 * np.pi * np.round((begin - near) / (2 * np.pi))
    return dict(zip(free, (near + turns).tolist())), miss


def _scan(formulation: Formulation, q: dict[str, Array], free: tuple[str, ...], steps: int) -> list[Array]:
    """Return the offsets of the scan with the smallest misclosure, at most `_TRIED`, the best first.

    With a tracker each leg's constraint depends on its own offset alone, and three scans suffice.
    """
    turn = np.linspace(0, 2 * np.pi, steps, endpoint=False)
    apart = len(formulation.readings) > 3
    axes = [turn] if apart else [turn] * len(free)
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    few = np.unique(np.linspace(0, len(formulation.data) - 1, _ROWS).round().astype(int))
    at = {name: value[few] if np.ndim(value) else value for name, value in q.items()}
    at |= {name: grid[:, 0 if apart else k, None] for k, name in enumerate(free)}
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        power = formulation.constraints(at)
        spread = np.zeros_like(power)
        for name in formulation.readings:
            step = _STEP / _arm(name)
            spread += ((formulation.constraints({**at, name: at[name] + step}) - power) / _STEP) ** 2
        missed = np.minimum(np.nan_to_num(np.abs(power) / np.sqrt(spread), nan=_WILD), _WILD).mean(axis=1)
    if not apart:
        return list(grid[np.argsort(missed[:, 0])[:_TRIED]])
    best = [turn[np.argsort(missed[:, int(name[1]) - 1])[:2]] for name in free]
    return [np.array(choice) for choice in product(*best)]


@np.errstate(divide="ignore", invalid="ignore", over="ignore")  # elbows in line: a step there is refused by its miss
def _refined(formulation: Formulation, q: dict[str, Array], free: tuple[str, ...], z: Array) -> tuple[Array, float]:
    """Return the offsets after damped Gauss-Newton steps from `z`, and the median over readings of the largest miss."""
    damping, (missed, jacobian) = 1e-2, _missed(formulation, q, free, z)
    for _ in range(_ROUNDS):
        flat, columns = missed.ravel(), jacobian.reshape(-1, len(z))
        normal = columns.T @ columns
        damped = normal + damping * (np.diag(np.diag(normal)) + 1e-12 * np.eye(len(z)))
        trial = z - np.linalg.solve(damped, columns.T @ flat)
        there = _missed(formulation, q, free, trial)
        before, after = float(flat @ flat), float(np.square(there[0]).sum())
        if after < before:
            z, (missed, jacobian), damping = trial, there, damping / 10
            if before - after < 1e-9 * before:
                break
        else:
            damping = max(damping, 1e-6) * 10
            if damping > 1e6:
                break
    return z, float(np.median(np.abs(missed).max(axis=1)))


def _missed(formulation: Formulation, q: dict[str, Array], free: tuple[str, ...], z: Array) -> tuple[Array, Array]:
    """Return the misclosure of the legs, (n, c), in mm of displacement, and its slopes in `free`.

    It is the power over the power's slope in the readings, because the power alone has no meaning where the elbows are
    almost in line and the radical centre is far away.
    """
    at = q | dict(zip(free, z))
    slopes = formulation.slopes(at)
    spread = np.sqrt(sum((slopes[name] / _arm(name)) ** 2 for name in formulation.readings))
    return formulation.constraints(at) / spread, np.stack([slopes[name] / spread for name in free], axis=-1)


def _arm(reading: str) -> float:
    """Return the factor that turns a unit of a reading into about a millimetre."""
    return _LINK if reading.startswith("enc") else 1.0
