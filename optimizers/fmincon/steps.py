"""How far `fmincon` steps for a difference: the rules of MATLAB's releases, and ours.

`typical_x` is the documented rule, in the code since February 2003: v sign'(x) max(|x|, TypicalX), where v is
FiniteDifferenceStepSize and sign'(0) = 1. `gradient` is the rule before it: -1e-8 / g, with the gradient g of the
iterate before, so that f changes by about 1e-8. Both are held between DiffMinChange and DiffMaxChange, the sign kept.
`box`, ours and the default, is relative to the width of the box and is found where the differences are taken.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from calibench.optimizers.base import Array

StepRule = Literal["box", "typical_x", "gradient"]
Numbers = float | tuple[float, ...]

_EPS = float(np.finfo(float).eps)
_WANTED = 1e-8  # by how much f should change over a step of the rule `gradient`


def typical_steps(x: Array, size: Numbers | None, typical: Numbers, kind: str) -> Array:
    """Return the steps of the rule `typical_x` at x, shape (n,), signed for forward differences.

    `size` None stands for eps^(1/2) (forward) or eps^(1/3) (central).

    >>> typical_steps(np.array([-3.0, 0.0, 0.5]), 0.1, 1.0, "forward").round(3).tolist()
    [-0.3, 0.1, 0.1]
    """
    default = _EPS**0.5 if kind == "forward" else _EPS ** (1 / 3)
    v = each("FiniteDifferenceStepSize", default if size is None else size, len(x))
    steps: Array = v * np.maximum(np.abs(x), np.abs(each("TypicalX", typical, len(x))))
    return steps * np.where(x < 0, -1.0, 1.0) if kind == "forward" else steps


def gradient_steps(before: Array) -> Array:
    """Return the steps of the rule `gradient`, shape (n,), from the gradient of the Lagrangian one iterate `before`.

    They point against that gradient, but where it is above 1e-8 / eps = 4.5e7: there eps turns the sign.

    >>> gradient_steps(np.array([2.0, -0.5, 1e8])).round(18).tolist()
    [-5e-09, 2e-08, 1e-16]
    """
    steps = -_WANTED / (before + _EPS)
    signed: Array = np.where(steps + _EPS >= 0, 1.0, -1.0) * np.abs(steps)
    return signed


def first_gradient(x0: Array) -> Array:
    """Return what the rule `gradient` takes for a gradient at the first two iterates, when it has none: 10 (|x0| + 1).

    Its steps, 1e-9 / (|x0| + 1), are below DiffMinChange.
    """
    guessed: Array = 10.0 * (np.abs(x0) + 1.0)
    return guessed


def held(steps: Array, least: float, most: float) -> Array:
    """Return the steps with their lengths between `least` (DiffMinChange) and `most` (DiffMaxChange), signs kept."""
    lengths: Array = np.minimum(np.maximum(np.abs(steps), least), most)
    return np.where(steps < 0, -lengths, lengths)


def each(name: str, values: Numbers, n: int) -> Array:
    """Return `values` as one number for each of n variables; raise `ValueError` where there are neither 1 nor n."""
    given = np.atleast_1d(np.asarray(values, dtype=float))
    if len(given) not in (1, n):
        raise ValueError(f"{name} has {len(given)} values: one, or one for each of {n} variables, is needed")
    return np.broadcast_to(given, (n,))
