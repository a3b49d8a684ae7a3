"""Parameters that data cannot determine: a combination of them changes no reading, so some are held at nominal values.

At a fit, a parameter whose column is a combination of others' columns is held at its nominal value. It and those others
have no standard deviation, because only their combination is determined. Equations are counted by rank as well:
constraints of a reading that its noise cannot change independently count once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, final

import numpy as np
from scipy.linalg import qr, solve_triangular

from calibench.core.notes import Code, Note
from calibench.discrepancy.fitting.fit import Fit, fit, fit_at, readings_of
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured import DataError, MeasuredData
from calibench.discrepancy.model.model import Model, relearned
from calibench.problems.base import Array, Parameter

_SEEN = 1e-9  # part of a column, all scaled to length 1, that must be left beside the others for it to be told
_TAKES_PART = 1e-6  # of a combination, scaled likewise
_TAKES_A_PART = 0.02  # of one that is nearly undetermined, scaled by the bounds
_ANY = 1e12  # sigma, for the width of a parameter without bounds
_COSTS = 4.0  # cost, times that of the far fit, up to which the fit with held parameters is taken


@final
@dataclass(frozen=True)
class Undetermined:
    """A parameter that is held. `others`, name -> change, together change the readings like a unit of the held one."""

    name: str
    others: Mapping[str, float]

    def note(self, parameter: Parameter) -> Note:
        held = f"{self.name} is held at {parameter.start:g}{f' {parameter.unit}' if parameter.unit else ''}"
        text = f"these data do not determine {self.name}: {held} and has no standard error"
        if self.others:
            text = (
                f"these data cannot tell {self.name} from {', '.join(self.others)}: only a combination of them is "
                f"determined; {held}, and none of them has a standard error"
            )
        return Note(Code.UNDETERMINED, text, values={"parameters": [self.name, *self.others], "at": parameter.start})


@final
@dataclass(frozen=True, eq=False)
class Held:
    """A formulation with some of its parameters held at their nominal values; everything else is unchanged."""

    inner: Formulation
    names: frozenset[str]
    parameters: tuple[Parameter, ...] = field(init=False)
    fixed: Mapping[str, float] = field(init=False)

    def __post_init__(self) -> None:
        free = tuple(p for p in self.inner.parameters if p.name not in self.names)
        held = {p.name: p.start for p in self.inner.parameters if p.name in self.names}
        object.__setattr__(self, "parameters", free)
        object.__setattr__(self, "fixed", {**self.inner.fixed, **held})

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "inner":
            raise AttributeError(name)
        return getattr(self.inner, name)

    def on(self, data: MeasuredData) -> Held:
        return replace(self, inner=self.inner.on(data))

    def relearned(self, left: Array, spent: float) -> Held:
        """Return the same with the unknown noise estimated from the constraints `left`, (n, c), by a fit."""
        return replace(self, inner=relearned(self.inner, left, spent))


def undetermined(at: Fit, within: Array | None = None) -> tuple[Undetermined, ...]:
    """Return which parameters of a fitted machine, without effects, its data cannot tell from others.

    With widths `within`, (p,), these are those that can change by their width and the readings by less than their
    noise.
    """
    names = [p.name for p in at.model.formulation.parameters]
    J = at.J[:, : len(names)]
    size = np.linalg.norm(J, axis=0)
    seen = np.flatnonzero(size > _SEEN**2 * (size.max() if len(size) else 0.0))
    found = [Undetermined(name, {}) for k, name in enumerate(names) if k not in seen]
    if not len(seen):
        return tuple(found)
    if within is not None:
        size = 1 / within
    _, R, order = qr(J[:, seen] / size[seen], mode="economic", pivoting=True, check_finite=False)
    diagonal = np.abs(np.diag(R))
    rank = max(int(np.sum(diagonal > (_SEEN * diagonal[0] if within is None else 1.0))), 1)
    like = solve_triangular(R[:rank, :rank], R[:rank, rank:], check_finite=False)
    for column, k in enumerate(seen[order[rank:]].tolist()):
        share = like[:, column]
        others = {
            names[j]: float(-share[i] * size[k] / size[j])
            for i, j in enumerate(seen[order[:rank]].tolist())
            if abs(share[i]) > (_TAKES_PART if within is None else _TAKES_A_PART)
        }
        found.append(Undetermined(names[k], dict(sorted(others.items(), key=lambda pair: names.index(pair[0])))))
    return tuple(found)


def determined(formulation: Formulation, nominal: Fit) -> tuple[Formulation, Fit, tuple[Undetermined, ...]]:
    """Return the formulation with the undetermined parameters held, its fit, and these parameters.

    Raises `DataError` where the data leave no equation to check the machine with.
    """
    made_up: Mapping[str, Mapping[str, float]] = getattr(formulation, "made_up", {})
    lacking = undetermined(nominal) or tuple(Undetermined(name, others) for name, others in made_up.items())
    rank = len(formulation.parameters) - len(lacking)
    # of each row as many as its noise changes independently
    equations = int(np.sum(np.linalg.matrix_rank(nominal.at.reading_slopes * nominal.at.sigma[:, None, :])))
    if equations <= rank:
        n = len(formulation.data)
        seen = f"; they tell {rank} of them" if lacking else ""
        raise DataError(
            f"{formulation.data.name}: {n} row{'s' if n > 1 else ''} cannot carry {len(formulation.parameters)} "
            f"parameters{seen}, and leave none of their {equations} equations to check the machine with; take more "
            "readings, or hold parameters"
        )
    if lacking:
        held = Held(formulation, frozenset(u.name for u in lacking))
        return held, fit(Model(held), nominal.noise), lacking

    # nearly undetermined parameters are held where they have led the fit far outside its bounds
    def is_inside(at: Fit) -> bool:  # no parameter is further outside its bounds than the width of its box
        known = zip(at.model.formulation.parameters, at.x.tolist())
        return all(p.lower - (p.upper - p.lower) <= value <= p.upper + (p.upper - p.lower) for p, value in known)

    if is_inside(nominal):
        return formulation, nominal, ()
    model, width = Model(formulation), np.array([p.upper - p.lower for p in formulation.parameters])
    here = fit_at(model, nominal.noise, model.start, readings_of(model), False)
    if not (np.isfinite(here.J).all() and (width > 0).all()):
        return formulation, nominal, ()
    size = np.linalg.norm(here.J[:, : len(width)], axis=0)
    free = np.where(np.isfinite(width), width, _ANY / np.where(size > 0, size, 1.0))
    if not (lacking := undetermined(here, free)):
        return formulation, nominal, ()
    held = Held(formulation, frozenset(u.name for u in lacking))
    back = fit(Model(held), nominal.noise)
    better = is_inside(back) and back.cost <= _COSTS * nominal.cost
    return (held, back, lacking) if better else (formulation, nominal, ())


def spread(at: Fit, lacking: tuple[Undetermined, ...]) -> Array:
    """Return the standard deviations of a fit's free parameters, (p,); NaN where only a combination is determined."""
    names = [p.name for p in at.model.formulation.parameters]
    sd = np.sqrt(np.diag(at.covariance()))[: len(names)]
    sd[np.isin(names, [name for u in lacking for name in (u.name, *u.others)])] = np.nan
    return sd
