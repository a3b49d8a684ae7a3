"""One reading that makes nearly all of what a calibrated model leaves: a wild one, or the only one of its kind.

Least squares bends the model towards it, so all others are off as well, and no test shows what is wrong. Left out, it
shows: the sum of squares falls by r' (I - H)^-1 r over its residuals r, with H its block of the projection on the
columns of the parameters (Cook and Weisberg, Residuals and Influence in Regression, 1982, ch. 2).
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from calibench.core.counted import plain
from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.fitting.projection import orthonormal
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.roles import inputs_of

ALONE = "makes nearly all of what the calibrated model leaves"  # in a note, by which a page knows it
_MOST_LEFT = 0.1  # of the sum of squares, without the reading
_CHANCE = 1e-6  # that the largest of as many sound readings is so large
_LEAST_LEFT = 3  # equations beside the parameters, without the reading
_RANK = 1e-10  # of the largest singular value
_COLUMNS = 4  # by which the reading is told


def one_reading(at: Fit) -> tuple[str, ...]:
    """Return a note on the reading without which the fit leaves a tenth of its sum of squares, or less; else none."""
    data = at.model.formulation.data
    n = len(data)
    width, odd = divmod(len(at.r), n)
    if odd or not width or at.exact:
        return ()
    r, q = np.asarray(at.r).reshape(n, width), orthonormal(at.J, _RANK)
    freedom = len(at.r) - q.shape[1] - width
    whole = float(np.sum(r**2))
    if freedom < _LEAST_LEFT or not whole > 0:
        return ()
    blocks = q.reshape(n, width, -1)
    beside = np.eye(width) - blocks @ blocks.transpose(0, 2, 1)
    # a reading that alone determines a parameter tells nothing of itself
    known = np.linalg.eigvalsh(beside)[:, 0] > 1e-9
    if not known.any():
        return ()
    falls = np.zeros(n)
    falls[known] = np.einsum("ij,ij->i", r[known], np.linalg.solve(beside[known], r[known][..., None])[..., 0])
    k = int(np.argmax(falls))
    left = max(whole - falls[k], 1e-12 * whole)
    if left > _MOST_LEFT * whole or n * fdtrc(width, freedom, falls[k] / width / (left / freedom)) > _CHANCE:
        return ()
    times = np.sqrt(whole / len(at.r) / (left / (len(at.r) - width)))
    told = told_by(at.model.formulation, k)
    return (
        f"one reading ({told}) {ALONE}: without it the others lie {plain(times, 2)} times nearer; look at it, and "
        "leave its row out if it was misread",
    )


def told_by(formulation: Formulation, k: int) -> str:
    """Return which row of the file row `k` is, and its first columns with their numbers: inputs, then readings."""
    data = formulation.data
    columns = dict.fromkeys((*inputs_of(formulation), *formulation.readings))
    told = [f"{name} {plain(float(np.asarray(data[name])[k]), 5)}" for name in columns if name in data]
    return f"{data.rows_named(np.array([k]))}: {', '.join(told[:_COLUMNS])}"
