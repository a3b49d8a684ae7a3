"""What a set of readings can show before any effect is fitted: which ones, of what smallest size, and which look alike.

Each candidate's signature in the whitened constraints is projected off what calibration absorbs. The length of the
projected signature over that of the signature is its *visible fraction*. The amplitude at which a test would notice the
projected signature is the minimum detectable one. The angle between the projected signatures of two candidates tells
whether data of this design can tell them apart.
"""

from dataclasses import dataclass
from typing import Any, final

import numpy as np
from scipy.sparse.csgraph import connected_components

from calibench.core.notes import Note
from calibench.core.plain import finite
from calibench.core.process import one_thread
from calibench.discrepancy.checks.validate import looked_at
from calibench.discrepancy.diagnostics.score import lengths_apart, smallest_amplitude
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting.fit import fit, orthonormal, project_off
from calibench.discrepancy.model.effect import Effect, Untestable, name_of, still_open
from calibench.discrepancy.model.machine import Formulation, Machine, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.model import Model, signature, signature_of
from calibench.discrepancy.noise.whiten import Noise, whitener
from calibench.discrepancy.registries import machines
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_NUDGE, _HANGS = 1e-12, 1e-3  # a signature that so small a part of the readings changes so much is rounding
_FULL = 1e-10  # of the largest singular value, below which the Jacobian is short of rank


@final
@dataclass(frozen=True, eq=False)
class Detectability:
    """One candidate: its visible fraction, its minimum detectable amplitude in `unit`, and the class it belongs to.

    The 1 % test over all candidates finds that amplitude with a power of 90 %. With several coefficients it is a mean
    over their directions, with several forms the median. It is infinite where the candidate is invisible. What grows
    evenly with a column has it over `span` of that column.
    """

    effect: str
    family: str
    target: str
    unit: str
    visible_fraction: float
    minimum_detectable: float
    group: int
    span: float = np.nan

    @property
    def visible(self) -> bool:
        return self.visible_fraction >= thresholds().invisible


@final
@dataclass(frozen=True, eq=False)
class Design:
    """What one design can tell. `classes` are sets of names that an effect of `size` sigma (rms) would not tell apart.

    `sines`, (m, m), are between the visible candidates in the order of `visible`: 0 where one is contained in the
    other. `threshold` is the sine below which two are in one class: there the better of two explains 6 more in
    chi-square at that size. Of two candidates with unequal numbers of visible directions, the one with more has a
    penalty of log(constraints) for each further direction, as in a BIC.
    """

    name: str
    readings: int
    constraints: int
    size: float
    threshold: float
    candidates: tuple[Detectability, ...]
    classes: tuple[tuple[str, ...], ...]
    visible: tuple[str, ...]
    sines: Array
    not_testable: tuple[Untestable, ...]
    notes: tuple[Note, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; an infinite amplitude is None."""
        plain = ("name", "readings", "constraints", "size", "threshold")
        return {
            **{name: getattr(self, name) for name in plain},
            "candidates": [{"class": one.pop("group"), **one} for one in map(finite, self.candidates)],
            "classes": [list(names) for names in self.classes],
            "invisible": [sight.effect for sight in self.candidates if not sight.visible],
            "not_testable": finite(self.not_testable),
            "notes": finite(self.notes),
        }


@one_thread()
def design(machine: str | Machine, data: MeasuredData, size: float = 1.0) -> Design:
    """Return what `data` (measured, or `planned`) could tell of the effects of `machine`, at effects of `size` sigma.

    Raises `DataError` for data that cannot be of this machine.
    """
    formulation = looked_at(machines.make(machine) if isinstance(machine, str) else machine, data)
    known = catalogue(formulation)
    view = WhitenedDesign(formulation, calibrated(formulation))
    forms: dict[str, list[Effect]] = {}
    for effect in still_open(known.candidates, ()):  # a second wave looks as the first, which has to be found before
        forms.setdefault(name_of(effect), []).append(effect)
    candidates = len({name_of(effect) for effect in known.candidates})
    rests, most = {}, thresholds().forms_looked_at
    for name, alike in forms.items():  # of many forms some, evenly over them and not at the ends
        places = range(len(alike))
        if len(alike) > most:
            places = np.linspace(0, len(alike) - 1, most + 2)[1:-1].round().astype(int).tolist()
        rests[name] = [view.rest(alike[k]) for k in places]
    seen = [name for name, rest in rests.items() if max(r.fraction for r in rest) >= thresholds().invisible]
    sines = _sines([[r.directions for r in rests[name]] for name in seen])
    threshold = float(min(1.0, np.sqrt(thresholds().told_apart / (view.rows * size**2))))
    ranks = np.array([max(r.directions.shape[1] for r in rests[name]) for name in seen], dtype=float)
    penalty = np.abs(ranks[:, None] - ranks) * np.log(view.rows)
    near = sines**2 * view.rows * size**2 + penalty < thresholds().told_apart
    count, group = connected_components(near, directed=False) if seen else (0, np.empty(0, dtype=int))
    classes = tuple(tuple(name for name, k in zip(seen, group) if k == own) for own in range(count))
    number = {name: k for k, names in enumerate(classes) for name in names}
    found = []
    for name, rest in rests.items():
        effect = forms[name][0]
        shown = [r for r in rest if r.fraction >= thresholds().invisible] or rest
        sizes = []  # that a search over the candidates would find, in the effect's unit
        for r in shown:
            energies = np.array([float(column @ column) for column in r.projected.T])
            sizes.append(smallest_amplitude(r.effect, energies, r.directions.shape[1], candidates))
        least = float(np.median(sizes))
        fraction = float(np.median([r.fraction for r in shown]))
        found.append(Detectability(
            effect=name, family=effect.family, target=effect.target, unit=effect.unit, visible_fraction=fraction,
            minimum_detectable=least if name in seen else np.inf, group=number.get(name, -1),
            span=getattr(effect, "span", np.nan),
        ))  # fmt: skip
    used = formulation.data
    return Design(
        name=used.name, readings=len(used), constraints=view.rows, size=size, threshold=threshold,
        candidates=tuple(found), classes=classes, visible=tuple(seen), sines=sines, not_testable=known.untestable,
        notes=used.notes,
    )  # fmt: skip


def calibrated(formulation: Formulation) -> Array:
    """Return the parameters at which data are looked at: calibrated where the data determine them, else the start.

    Signatures that cancel do so at the machine that was measured: where all encoders are late together, one with zeros
    that are off by a degree would show it.
    """
    model = Model(formulation)
    found = fit(model, Noise())
    lower, upper = (np.array([getattr(p, end) for p in formulation.parameters]) for end in ("lower", "upper"))
    inside = np.isfinite(found.x).all() and bool(np.all((lower <= found.x) & (found.x <= upper)))
    full = len(found.r) > found.J.shape[1] == orthonormal(found.J, _FULL).shape[1] if inside else False
    return found.x if found.converged and full else model.start


@final
@dataclass(frozen=True, eq=False)
class ProjectedSignature:
    """What calibration leaves of a candidate: `projected` (rows, k), whitened; orthonormal `directions` (rows, r).

    `fraction` is the length of the projected signature over that of the signature, in the direction where it is
    largest. Where a candidate changes several quantities, it is over the signatures that they would leave one by one.
    """

    effect: Effect
    projected: Array
    directions: Array
    fraction: float


class WhitenedDesign:
    """The whitened constraints of one formulation at `x`, by default its start, and what calibration absorbs."""

    def __init__(self, formulation: Formulation, x: Array | None = None) -> None:
        model = Model(formulation)
        self.formulation = formulation
        self.x = model.start if x is None else x
        self.q: Quantities = model.quantities(self.x)[0]
        self.slopes = formulation.slopes(self.q)
        n, rng = len(formulation.data), np.random.default_rng(0)
        floats = {name: column for name, column in formulation.data.columns.items() if column.dtype.kind == "f"}
        nudged = {name: column * (1 + _NUDGE * rng.uniform(-1, 1, n)) for name, column in floats.items()}
        self.nudged = Model(formulation.on(formulation.data.with_columns(nudged)))  # other numbers in the last digits
        noisy = np.stack([self.slopes[name] for name in formulation.readings], axis=-1)
        sigma = np.stack([np.broadcast_to(formulation.sigma[name], n) for name in formulation.readings], axis=-1)
        self.white = whitener(noisy, sigma, 0.0, np.arange(n, dtype=float))
        self.jacobian = self.white(model.jacobian_of(self.x, self.q, self.slopes))
        self.absorbed = orthonormal(self.jacobian, _FULL)
        self.rows = len(self.jacobian)

    def signature(self, effect: Effect) -> Array:
        """Return what a unit of each coefficient leaves in the whitened constraints, (rows, k)."""
        zero = np.zeros(len(effect.coefficients))
        trace = self.white(signature(effect, zero, self.q, self.slopes, self.formulation))
        there = self.nudged.quantities(self.x)[0]
        basis = effect.basis(there, self.nudged.formulation.data, zero)
        other = self.white(signature_of(basis, self.slopes, self.formulation))  # in the groups that exact numbers make
        rounding = np.linalg.norm(other - trace, axis=0) > _HANGS * np.linalg.norm(trace, axis=0)
        return np.where(rounding, 0.0, trace)

    def rest(self, effect: Effect) -> ProjectedSignature:
        raw, zero = self.signature(effect), np.zeros(len(effect.coefficients))
        lengths = np.linalg.norm(raw, axis=0)
        if not lengths.any():
            return ProjectedSignature(effect, raw, raw[:, :0], 0.0)
        left, values, _ = np.linalg.svd(raw / np.where(lengths > 0, lengths, 1.0), full_matrices=False)
        left = project_off(left[:, values > 1e-9 * values[0]], self.absorbed, times=2)
        directions, fractions, _ = np.linalg.svd(left, full_matrices=False)
        basis = effect.basis(self.q, self.formulation.data, zero)
        if len(basis) > 1:
            # if all encoders are late together, the parts cancel, and only rounding is left
            uncancelled = np.linalg.norm(raw / lengths_apart(self.white, self.slopes, basis)) / np.sqrt(len(zero))
            fractions = fractions * (min(1.0, float(uncancelled)) if uncancelled > thresholds().cancelled else 0.0)
        visible = directions[:, fractions >= thresholds().invisible]
        return ProjectedSignature(effect, project_off(raw, self.absorbed, times=2), visible, float(fractions[0]))


def _sines(forms: list[list[Array]]) -> Array:
    """Return the sines between names, (m, m): of the largest principal angle, for the two forms with the smallest."""
    owner = np.array([k for k, alike in enumerate(forms) for d in alike if d.shape[1]], dtype=int)
    bases = [d for alike in forms for d in alike if d.shape[1]]
    sines = 1.0 - np.eye(len(forms))
    if not bases:
        return sines
    ends = np.cumsum([0, *(d.shape[1] for d in bases)])
    stacked = np.concatenate(bases, axis=1)
    gram = stacked.T @ stacked
    for i in range(len(bases)):
        for j in range(i):
            a, b = owner[i], owner[j]
            if a == b:
                continue
            block = gram[ends[i] : ends[i + 1], ends[j] : ends[j + 1]]
            cosine = abs(block[0, 0]) if block.size == 1 else np.linalg.svd(block, compute_uv=False)[-1]
            sine = np.sqrt(max(0.0, 1.0 - min(1.0, float(cosine)) ** 2))
            sines[a, b] = sines[b, a] = min(sines[a, b], sine)
    return sines
