"""`Prediction`: what a machine with its findings predicts for instruments, at readings that were not fitted.

A machine that predicts has one measured column in each constraint, with a slope of 1 or -1: its prediction is that
column less the constraint. For a machine that states only constraints, the result is the constraints at the new
readings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np

from calibench.discrepancy.diagnostics.smooth_term import smooth_columns
from calibench.discrepancy.model.formulations import BLOCK
from calibench.discrepancy.model.machine import Formulation, Machine
from calibench.discrepancy.model.measured import TO_PREDICT, DataError, MeasuredData
from calibench.discrepancy.model.model import Model, signature
from calibench.discrepancy.model.roles import inputs_of
from calibench.problems.base import Array

_ROUNDS, _SETTLED = 50, 1e-12  # an instrument whose scale is wrong makes its own reading part of what it will read


@final
@dataclass(frozen=True, eq=False)
class Prediction:
    """What is expected at n new readings, in the units in which the machine is fitted.

    `measured` is column -> (n,), NaN in rows of another kind; empty for a machine that predicts nothing. `sd` is the
    uncertainty of the calibrated numbers and of the findings in it; the noise of a reading comes on top. `residuals`,
    (n, c), are measured less predicted, or the constraints; NaN in rows that hold no measured value.
    """

    measured: Mapping[str, Array] = field(default_factory=dict)
    sd: Mapping[str, Array] = field(default_factory=dict)
    residuals: Array = field(default_factory=lambda: np.empty((0, 0)))


def predicted_at(
    model: Model,
    x: Array,
    covariance: Array,
    start: Array,
    data: MeasuredData,
    machine: Callable[[], Machine | None],
) -> Prediction:
    """Return the prediction of `model` at `x`, with `covariance` (p, p), for `data`.

    `start` are the parameters of the machine without effects, at which unnamed smooth functions were found. `machine()`
    makes the columns of the model from those of a file, where they differ; measured columns may be missing. Raises
    `DataError` for a missing input.
    """
    if not len(data):
        raise DataError(f"{data.name}: there are no rows to predict")
    there, known = _placed(model.formulation, data, machine)
    there = there.on(there.data.with_columns(smooth_columns(there, start)))
    at = Model(there, model.effects)
    order = np.argsort(there.data[TO_PREDICT]) if TO_PREDICT in there.data else np.arange(len(there.data))
    signs = _signs(at, x)
    if not signs:
        lost = [name for name in there.readings if not known[name].all()]
        if lost:
            raise DataError(
                f"{data.name}: no value of {', '.join(lost)} in every row; {data.machine} states what vanishes "
                "and predicts no reading, so all that it reads is needed"
            )
        return Prediction(residuals=_constraints(at, x)[order])
    found = {name: np.asarray(there.data[name], dtype=float) for name in signs}
    before = {name: np.where(known[name], value, np.nan) for name, value in found.items()}
    for _ in range(_ROUNDS):
        left = _constraints(at, x)
        change = {name: (sign * left).sum(axis=1) for name, sign in signs.items()}
        found = {name: found[name] - change[name] for name in found}
        at = Model(there.on(there.data.with_columns(found)), model.effects)
        if all(np.max(np.abs(change[n])) <= _SETTLED * (1 + np.max(np.abs(found[n]))) for n in found):
            break
    slopes = _slopes(at, x)
    spread = np.sqrt(np.maximum(np.einsum("ncp,pq,ncq->nc", slopes, covariance, slopes), 0.0))
    read = {name: np.abs(sign).sum(axis=1) > 0 for name, sign in signs.items()}
    left = np.zeros_like(spread)
    for name, sign in signs.items():
        left = left + np.where(sign != 0, (before[name] - found[name])[:, None], 0.0)
    return Prediction(
        {name: np.where(read[name], value, np.nan)[order] for name, value in found.items()},
        {n: np.where(read[n], (np.abs(sign) * spread).sum(axis=1), np.nan)[order] for n, sign in signs.items()},
        left[order],
    )


def _placed(
    formulation: Formulation, data: MeasuredData, machine: Callable[[], Machine | None]
) -> tuple[Formulation, dict[str, Array]]:
    """Return the formulation over new rows, and in which of them each reading has a value, (n,) of booleans."""
    n, fitted = len(data), formulation.data
    of_new = getattr(formulation, "of_new", None)
    if of_new is not None:
        data = of_new(replace(data, metadata={**fitted.metadata, **data.metadata}))
    for name, column in data.columns.items():
        if column.dtype.kind not in "iufb" and name in fitted and fitted[name].dtype.kind in "iufb":
            raise DataError(f"{data.name}: column {name} holds words; give the numbers that the report reads them as")
    own = {name: np.asarray(data[name], dtype=float) for name in formulation.readings if name in data}
    finite = {name: np.isfinite(own[name]) if name in own else np.zeros(n, dtype=bool) for name in formulation.readings}
    fill = {name: np.where(there, own.get(name, 0.0), 0.0) for name, there in finite.items()}
    filled = replace(
        data.with_columns({**fill, TO_PREDICT: np.arange(n)}), metadata={**formulation.data.metadata, **data.metadata}
    )
    needed = [*inputs_of(formulation), *([BLOCK] if BLOCK in formulation.data else [])]
    missing = [name for name in needed if name not in filled]
    if not missing:
        return formulation.on(filled), finite
    maker = machine()
    if maker is None:
        raise DataError(f"{data.name}: no column {', '.join(missing)}; machine= makes it of a file's own columns")
    made = maker.formulate(filled).data
    if TO_PREDICT not in made:
        raise DataError(
            f"{data.name}: {data.machine} leaves columns out of its rows, so nothing tells which row is which; take "
            "the rows of a block by data.rows(...), which keeps all columns"
        )
    if len(made) != n:
        raise DataError(f"{data.name}: {data.machine} takes {len(made)} of {n} rows; leave out those it cannot read")
    rows = np.asarray(made[TO_PREDICT], dtype=int)
    known = {name: there[rows] | (np.asarray(made[name], dtype=float) != 0) for name, there in finite.items()}
    return formulation.on(made), known


def _constraints(model: Model, x: Array) -> Array:
    return np.asarray(model.formulation.constraints(model.quantities(x)[1])).real


def _signs(model: Model, x: Array) -> dict[str, Array]:
    """Return for each reading its sign in the constraints, (n, c) of 1, -1 and 0.

    The mapping is empty where a constraint mixes several readings.
    """
    slopes = model.formulation.slopes(model.quantities(x)[1])
    signs = {name: np.asarray(slopes[name]) for name in model.formulation.readings}
    size = np.abs(np.stack(list(signs.values())))
    alone = (np.isclose(size, 1.0) | (size == 0)).all() and (np.sum(size > 0, axis=0) == 1).all()
    return {name: np.sign(sign) for name, sign in signs.items()} if alone else {}


def _slopes(model: Model, x: Array) -> Array:
    """Return the derivative of the constraints in x, (n, c, p)."""
    recorded, true = model.quantities(x)
    slopes = model.formulation.slopes(true)
    columns = [np.stack([slopes[p.name] for p in model.formulation.parameters], axis=-1)]
    columns += [signature(effect, c, recorded, slopes, model.formulation) for effect, c in model.coefficients(x)]
    return np.concatenate(columns, axis=2)
