"""Several starts of a fit: from a nominal machine far from the measured one a fit may end in a wrong minimum."""

from __future__ import annotations

import numpy as np

from calibench.core.counted import plain
from calibench.discrepancy.fitting.fit import Fit, fit
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured.data import DataError
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import Noise
from calibench.problems.base import Array

_FAR = 30.0  # times the noise that a calibrated machine leaves, from which on other starts are tried
_STARTS = 8
_BETTER = 0.9  # part of the cost: another minimum below this is taken for better


def fit_from_several(formulation: Formulation) -> tuple[Fit, tuple[str, ...]]:
    """Return the machine without effects fitted to its data, and a note where the nominal start is not the best.

    Other starts are drawn evenly from the box of the parameters, the same at every call. They are used only where the
    fit from the nominal machine did not converge or leaves far more than noise.
    """
    model = Model(formulation)
    nominal = fit(model, Noise())
    if nominal.converged and float(np.sqrt(np.mean(nominal.r**2))) < _FAR:
        return nominal, ()
    others = [found for start in _starts(formulation) if (found := _fitted(model, start)) is not None]
    better = [found for found in others if found.converged and found.cost < _BETTER * nominal.cost]
    if not better:
        _refuse_no_number(nominal)
        return nominal, ()
    best = min(better, key=lambda found: found.cost)
    alike = sum(found.cost < best.cost / _BETTER for found in better)
    note = (
        f"the fit from the nominal machine leaves {plain(np.sqrt(nominal.cost / best.cost), 3)} times as much; "
        f"{alike} of "
        f"{_STARTS} other starts in the box of the parameters lead to the one that is told here"
    )
    return best, (note,)


def _refuse_no_number(found: Fit) -> None:
    """Raise `DataError` where a fit ended at parameters at which the model has no value or no slope."""
    if not all(np.isfinite(values).all() for values in (found.r, found.J, found.at.reading_slopes)):
        raise DataError(
            f"{found.model.formulation.data.name}: no numbers of the machine come near these readings: its fit leads "
            "to where the model has no value; are all units right, and the nominal numbers those of this machine?"
        )


def _starts(formulation: Formulation) -> Array:
    lower, upper = (np.array([getattr(p, side) for p in formulation.parameters]) for side in ("lower", "upper"))
    nominal = np.array([p.start for p in formulation.parameters])
    inside = np.isfinite(lower) & np.isfinite(upper)
    low, high = np.where(inside, lower, nominal), np.where(inside, upper, nominal)
    return np.random.default_rng(0).uniform(low, high, (_STARTS, len(nominal)))


def _fitted(model: Model, start: Array) -> Fit | None:
    try:
        found = fit(model, Noise(), start, near=False)
    except (np.linalg.LinAlgError, ValueError, FloatingPointError):
        return None
    return found if np.isfinite(found.cost) else None
