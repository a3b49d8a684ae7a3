"""Fits that one search asks for again, and fits from several starts.

With Gaussian noise the scale changes neither the minimum nor the steps towards it, only the tolerance. So a search at
half and at twice the stated noise repeats most of its fits. Where a fit ended is kept, but not its arrays. One further
step from there shows whether the fit at the new scale would have ended there too; if not, the fit is made. A fit that
did not converge near its start under a wider noise does not do so under a narrower one: it ends at the same point.
The start belongs to the key of a fit: from another start, as from a nominal machine far from the measured one, it may
end in another minimum.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from hashlib import blake2b
from typing import Any, final

import numpy as np

from calibench.core.notes import Code, Note
from calibench.core.words import plain
from calibench.discrepancy.fitting.fit import Fit, fit, fit_at, readings_of, rests
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured import DataError
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array


@final
@dataclass(frozen=True, eq=False)
class _End:
    """Where a fit ended: x (p,) and adjusted readings (n, k), the scale of the noise, and whether it converged.

    `alive` are the objects whose ids are in the key; the reference keeps them alive.
    """

    x: Array
    adjusted: Array
    scale: float
    converged: bool
    alive: tuple[Any, ...]


_ENDS: ContextVar[dict[tuple[Any, ...], _End] | None] = ContextVar("ends", default=None)


@contextmanager
def keeping_fits() -> Iterator[None]:
    """Inside the block, remember where the fits of `fit_once` end."""
    before = _ENDS.set({})
    try:
        yield
    finally:
        _ENDS.reset(before)


def fit_once(model: Model, noise: Noise, start: Array, *, near: bool = True, about: Fit | None = None) -> Fit:
    """Return what `fit` returns; a fit that was made before from this start is not made again."""
    ends, readings = _ENDS.get(), readings_of(model)
    if ends is None or np.isfinite(noise.t_degrees) or len(readings) >= thresholds().many_readings:
        return fit(model, noise, start, near=near, about=about)
    first = about.at.model.formulation.data if about is not None else None
    alive = (model.formulation, *model.effects, *noise.extra.values())
    key = (
        *map(id, alive), *noise.extra, noise.autocorrelation, near, start.tobytes(),
        _digest({name: first[name] for name in model.formulation.readings} if first is not None else {}),
    )  # fmt: skip
    end = ends.get(key)
    walked = end is not None and (end.scale == noise.scale or (near and end.scale > noise.scale))
    if end is not None and (end.converged or walked):
        found = fit_at(model, noise, end.x, end.adjusted, end.converged)
        if not end.converged or end.scale == noise.scale or rests(found):
            return found
    found = fit(model, noise, start, near=near, about=about)
    ends[key] = _End(found.x, readings_of(found.at.model), noise.scale, found.converged, alive)
    return found


def _digest(columns: Mapping[str, Array]) -> bytes:
    digest = blake2b(digest_size=16)
    for name, column in columns.items():
        digest.update(name.encode() + np.ascontiguousarray(column, dtype=float).tobytes())
    return digest.digest()


_FAR = 30.0  # times the noise that a calibrated machine leaves, from which on other starts are tried
_STARTS = 8
_BETTER = 0.9  # part of the cost: another minimum below this is taken for better


def fit_from_several(formulation: Formulation) -> tuple[Fit, tuple[Note, ...]]:
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
        if not all(np.isfinite(values).all() for values in (nominal.r, nominal.J, nominal.at.reading_slopes)):
            raise DataError(
                f"{formulation.data.name}: no numbers of the machine come near these readings: its fit leads "
                "to where the model has no value; are all units right, and the nominal numbers those of this machine?"
            )
        return nominal, ()
    best = min(better, key=lambda found: found.cost)
    alike = sum(found.cost < best.cost / _BETTER for found in better)
    times = float(np.sqrt(nominal.cost / best.cost))
    text = (
        f"the fit from the nominal machine leaves {plain(times, 3)} times as much; {alike} of "
        f"{_STARTS} other starts in the box of the parameters lead to the one that is told here"
    )
    return best, (Note(Code.OTHER_START, text, values={"times": times, "starts": _STARTS, "alike": alike}),)


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
