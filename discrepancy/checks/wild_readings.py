"""Readings that no calibration can explain (a lost target, a pose that was not reached) are left out, with a note.

The machine is fitted with a smaller weight for readings that lie far out. Then a row is wild if what is left of it, in
any constraint, is `_OUT` times the middle one. Where there are many of them, they are no accidents, and all are kept.
`isolated` rows stand alone: what is left of any other is less than half, and no repeat says the same. Few times the
middle one is enough then, because the middle one contains the effects that are looked for.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibench.core.counted import plain
from calibench.discrepancy.model.formulations.learned_noise import weighted_fit
from calibench.discrepancy.model.formulations.predicted import Predicted
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import inputs_of
from calibench.problems.base import Array

_OUT = 12.0  # times the middle size of what is left
_MOST = 0.03  # of the readings
_ALONE, _TWICE = 3.0, 2.0  # times the middle one, and times what is left of any other row, of a row that stands alone
_ROUNDS = 6
_HUBER = 2.0  # robust deviations
_MEDIAN = 0.6745
_EXACT = 1e-10  # of what a constraint is made of: where the middle row leaves less, readings have no noise
_LEAST = 2.0  # readings for each parameter
_COLUMNS = 4  # by which a row is told


def without_wild(formulation: Formulation, machine: str = "machine", isolated: bool = False) -> MeasuredData:
    """Return the data of a formulation without wild rows, with a note that tells them, of the `machine`."""
    data = formulation.data
    fitted = np.asarray(data["split"]) != "hold" if "split" in data else np.ones(len(data), dtype=bool)
    model = Model(formulation)
    start = np.asarray(model.residuals(model.start))
    if fitted.sum() * start.shape[1] < _LEAST * len(formulation.parameters) or not np.isfinite(start).all():
        return data
    noise, made_of = _noise_and_parts(model)
    left = np.asarray(model.residuals(robust(Model(formulation.on(data.rows(fitted))), noise[fitted])))
    size = np.abs(left) / noise
    middle = np.median(size[fitted], axis=0)
    if not (np.isfinite(left).all() and (middle > _EXACT * np.median(made_of / noise, axis=0)).all()):
        return data
    size /= middle
    wild = size.max(axis=1) > _OUT
    if isolated:
        wild = _alone(size.max(axis=1)) & ~_repeated(formulation, wild)
    if not wild.any() or wild.mean() > _MOST:
        return data
    count, worst = int(wild.sum()), int(np.argmax(size.max(axis=1)))
    how, others = ("twice", "any other") if isolated else (f"{_OUT:g} times", "the middle one")
    many, at = count > 1, data.rows_named(np.array([worst]))
    left_out = f"{count} wild readings are left out ({data.rows_named(wild)})" if many else "1 wild reading is left out"
    note = (
        f"{left_out}, more than {how} as far from the calibrated {machine} as {others}: "
        f"{'the worst is ' if many else ''}{at}, {_told(formulation, left, size, worst)}"
    )
    return data.rows(~wild).with_note(note)


def _alone(size: Array) -> NDArray[np.bool_]:
    """Return which rows are far out, and twice as far as all others, from the `size` of what is left, (n,)."""
    order = np.sort(size)[::-1]
    after = np.flatnonzero((order[:-1] > _ALONE) & (order[:-1] > _TWICE * order[1:]))
    return np.asarray(size >= order[after[-1]] if len(after) else np.zeros(len(size), dtype=bool))


def _repeated(formulation: Formulation, wild: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the wild rows whose repeats are wild too, (n,): what the machine does twice is no accident."""
    if not formulation.data.has("pose_id"):
        return np.zeros(len(wild), dtype=bool)
    _, pose = np.unique(formulation.data["pose_id"], return_inverse=True)
    return np.asarray(wild & (np.bincount(pose, weights=wild)[pose] > 1))


def robust(model: Model, noise: Array) -> Array:
    """Return the parameters of a fit in which readings far out, relative to their noise (n, c), have small weight."""
    x = model.start
    weight = 1 / noise
    for _ in range(_ROUNDS):
        x = weighted_fit(model, x, weight)
        left = np.abs(np.asarray(model.residuals(x))) / noise
        spread = np.maximum(np.median(left, axis=0) / _MEDIAN, 1e-12)
        weight = np.sqrt(np.minimum(1.0, _HUBER * spread / np.maximum(left, 1e-300))) / spread / noise
    return np.asarray(x)


def _noise_and_parts(model: Model) -> tuple[Array, Array]:
    """Return the deviation of each constraint by its readings' noise, (n, c), and the sum of its parts' moduli."""
    formulation, q = model.formulation, model.quantities(model.start)[0]
    slopes = formulation.slopes(q)
    sizes = {name: np.abs(np.asarray(q[name], dtype=float))[..., None] for name in slopes}
    parts = np.asarray(sum(np.abs(slope) * sizes[name] for name, slope in slopes.items()))
    sigma = {name: np.asarray(formulation.sigma[name], dtype=float)[..., None] for name in formulation.readings}
    noise = np.sqrt(sum((slopes[name] * sigma[name]) ** 2 for name in formulation.readings))
    return np.maximum(noise, np.finfo(float).eps * np.maximum(parts, 1e-300)), parts


def _told(formulation: Formulation, left: Array, size: Array, row: int) -> str:
    """Return what a row reads: what was measured and how far off it is, or the columns of a closure."""
    data, k = formulation.data, int(np.argmax(size[row]))
    if isinstance(formulation, Predicted):
        name = tuple(formulation.measured)[k]
        off = float(left[row, k])
        where = [f"{n} {plain(float(data[n][row]), 5)}" for n in formulation.inputs if n in data][:_COLUMNS]
        at = f" (at {', '.join(where)})" if where else ""
        return f"{name} = {float(data[name][row]):.6g}, {plain(abs(off), 3)} too {'large' if off > 0 else 'small'}{at}"
    names = dict.fromkeys((*inputs_of(formulation), *formulation.readings))
    return ", ".join([f"{n} {plain(float(data[n][row]), 5)}" for n in names if n in data][: 2 * _COLUMNS])
