"""Exact tests for small samples: few rows, an unknown variance and many candidates.

Where a model misses the readings by far more than they scatter, the misfit itself acts as the noise. A candidate is
tested by F in the residual space of the calibration, linear about it; the smallest p of all is compared with those of
random rotations of the residual vector. If that has a uniform direction there (so it is for any mixture of Gaussians),
the test is exact, however the candidates are correlated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np
from scipy.special import fdtrc, fdtri, stdtr

from calibench.discrepancy.fitting.fit import orthonormal, project_off
from calibench.discrepancy.model.effect import Effect, name_of
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array
from calibench.problems.fitting import gauss_newton

_FULL = 1e-9  # of the largest singular value, below which columns are short of rank


@final
@dataclass(frozen=True, eq=False)
class Calibrated:
    """A formulation about its calibrated machine x.

    `weighted` tells whether rows were mixed until no noise is shared; then residuals are in that mixture, else plain.
    """

    model: Model
    x: Array
    weighted: bool

    @cached_property
    def r(self) -> Array:
        """Return the residuals, shape (n,), without the slopes, which take most of the time."""
        r = self.model.formulation.constraints(self.model.quantities(self.x)[1])
        return (self.model.formulation.decorrelate(r) if self.weighted else r)[:, 0]

    @cached_property
    def J(self) -> Array:
        """Return the slopes of the residuals, shape (n, p)."""
        formulation, (_, slopes) = self.model.formulation, self._point
        own = np.column_stack([slopes[p.name][:, 0] for p in formulation.parameters])
        own = formulation.decorrelate(own) if self.weighted else own
        return np.column_stack([own, *map(self.columns, self.model.effects)])

    def columns(self, effect: Effect) -> Array:
        """Return the signature of a unit of each coefficient of `effect`, shape (n, k)."""
        formulation, (recorded, slopes) = self.model.formulation, self._point
        basis = effect.basis(recorded, formulation.data, np.zeros(len(effect.coefficients)))
        raw = np.asarray(sum(slopes[name] * change for name, change in basis.items()))
        return formulation.decorrelate(raw) if self.weighted else raw

    @cached_property
    def _point(self) -> tuple[Quantities, Mapping[str, Array]]:
        recorded, true = self.model.quantities(self.x)
        return recorded, self.model.formulation.slopes(true)


@final
@dataclass(frozen=True, eq=False)
class Supported:
    """The statistics of one candidate of visible rank m.

    `share` of the misfit it explains, F with p of this candidate alone and `p_tried` of the best of all tried; `aicc`
    relative to the calibration alone (below 0: better; None where there are too few rows); `loo`, the rms error [unit
    of the constraints] when each row is predicted from the others; coefficients with standard errors, shape (k,), and
    whether their size is `plausible`.
    """

    name: str
    rank: int
    share: float
    F: float
    p: float
    p_tried: float
    aicc: float | None
    loo: float
    coefficients: Array
    standard_errors: Array
    plausible: bool


@final
@dataclass(frozen=True, eq=False)
class SmallSample:
    """The calibration alone (rms and leave-one-out rms, `degrees` of freedom), and all candidates, smallest p first.

    `needed` is the share of the misfit that a single coefficient must explain to be significant at 5 % among all that
    were tried.
    """

    case: str
    rows: int
    degrees: int
    rms: float
    loo: float
    tried: int
    needed: float
    candidates: tuple[Supported, ...]

    def __getitem__(self, name: str) -> Supported:
        """Return the line of one candidate."""
        for candidate in self.candidates:
            if candidate.name == name:
                return candidate
        raise KeyError(name)


def linear(formulation: Formulation, *effects: Effect, weighted: bool) -> Calibrated:
    """Return a formulation with `effects` at its least squares answer.

    `weighted`: rows are weighted by the noise that they share. It needs one constraint a row, and noise of one size in
    all of them. A direction of which the data see less than `SEEN` is held where it was.
    """
    model = Model(formulation).with_effects(*effects)
    x = gauss_newton(
        lambda x: Calibrated(model, x, weighted).r,
        lambda x: Calibrated(model, x, weighted).J,
        model.start,
        rank_tolerance=thresholds().small_seen / 10,
    )
    return Calibrated(model, x, weighted)


def small_sample(
    about: Calibrated, candidates: Sequence[Effect], plausible: Mapping[str, float] | None = None,
    draws: int = 5_000, seed: int = 0,
) -> SmallSample:  # fmt: skip
    """Return what each of the `candidates`, alone, explains of the residuals of a calibration.

    `plausible` is family -> the largest size of a coefficient that such a machine can have. Candidates that calibration
    absorbs, or that leave no degree of freedom, are not tried.
    """
    q = orthonormal(about.J, _FULL)
    r = project_off(about.r, q)
    n, degrees = len(r), len(r) - q.shape[1]
    total = float(r @ r)
    seen: list[tuple[Effect, Array, Array]] = []
    for effect in candidates:
        U, back = _visible(about.columns(effect), q)
        if 0 < U.shape[1] < degrees:
            seen.append((effect, U, back))
    # the smallest p of all candidates for `draws` directions drawn evenly from the residual space
    v = np.random.default_rng(seed).standard_normal((draws, n))
    v -= (v @ q) @ q.T
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    least = np.ones(draws)
    for _, U, _ in seen:
        m = U.shape[1]
        share = np.minimum(((v @ U) ** 2).sum(axis=1), 1 - 1e-15)
        least = np.minimum(least, fdtrc(m, degrees - m, share / m / ((1 - share) / (degrees - m))))
    found = []
    for effect, U, back in seen:
        m, z = U.shape[1], U.T @ r
        explained = float(z @ z)
        rest = degrees - m
        F = explained / m / ((total - explained) / rest)
        p = float(fdtrc(m, rest, F))
        c = -back @ z
        error = np.sqrt((total - explained) / rest) * np.sqrt((back**2).sum(axis=1))
        limit = (plausible or {}).get(effect.family, np.inf)
        # AICc less that of the calibration alone, the variance counted as one more unknown
        k, aicc = q.shape[1], None
        if n - (k + m + 1) - 1 > 0:
            pairs = ((k + m, total - explained), (k, total))
            own, plain = (n * np.log(rss / n) + 2 * (j + 1) * n / (n - j - 2) for j, rss in pairs)
            aicc = float(own - plain)
        tried = float((1 + (least <= p * (1 + 1e-9)).sum()) / (1 + len(least)))
        one = Supported(
            name=name_of(effect), rank=m, share=explained / total, F=F, p=p, p_tried=tried, aicc=aicc,
            loo=_loo(np.column_stack([q, U]), r), coefficients=c, standard_errors=error,
            plausible=bool(np.abs(c).max() <= limit),
        )  # fmt: skip
        found.append(one)
    edge = float(np.quantile(least, 0.05)) if len(least) else np.nan
    F = float(fdtri(1, degrees - 1, 1 - edge)) if degrees > 1 else np.nan
    return SmallSample(
        case=about.model.formulation.data.name, rows=n, degrees=degrees, rms=float(np.sqrt(total / n)),
        loo=_loo(q, r), tried=len(found), needed=F / (F + degrees - 1),
        candidates=tuple(sorted(found, key=lambda s: (round(s.p, 9), s.name))),
    )  # fmt: skip


@final
@dataclass(frozen=True)
class Likeness:
    """The similarity of two residual vectors in one residual space: cosine, slope, and one-sided p.

    The p is that of a vector with random direction in `degrees` dimensions.
    """

    cosine: float
    slope: float
    degrees: int
    p: float


def likeness(earlier: Calibrated, later: Calibrated) -> Likeness:
    """Return how similar the residuals of `later` and `earlier` are: the same rows, each set calibrated by itself."""
    q = orthonormal(later.J, _FULL)
    one, two = (project_off(v, q) for v in (earlier.r, later.r))
    return direction(one, two, len(two) - q.shape[1])


def direction(predicted: Array, measured: Array, degrees: int) -> Likeness:
    """Return the similarity of a prediction and a measurement, vectors in a space of `degrees` dimensions."""
    cosine = float(predicted @ measured / np.linalg.norm(predicted) / np.linalg.norm(measured))
    t = cosine * np.sqrt((degrees - 1) / max(1 - cosine**2, 1e-300))
    slope = float(predicted @ measured / (predicted @ predicted))
    return Likeness(cosine, slope, degrees, float(stdtr(degrees - 1, -t)))


def _visible(D: Array, q: Array) -> tuple[Array, Array]:
    """Return a basis U (n, m) of what calibration leaves of D (n, k), and back (k, m): D back = U + absorbed part."""
    size = np.linalg.norm(D, axis=0)
    if not size.max() > 0:
        return np.empty((len(D), 0)), np.empty((D.shape[1], 0))
    unit = D / np.where(size > 1e-12 * size.max(), size, np.inf)
    W, s, Vt = np.linalg.svd(project_off(unit, q), full_matrices=False)
    kept = s > thresholds().small_seen
    return W[:, kept], (Vt.T[:, kept] / s[kept]) / np.where(size > 0, size, 1.0)[:, None]


def _loo(columns: Array, r: Array) -> float:
    """Return the rms error of each row predicted from the others by `columns`."""
    q = orthonormal(columns, _FULL)
    lever = 1 - (q**2).sum(axis=1)
    if lever.min() < 1e-9:
        return float("inf")
    return float(np.sqrt(np.mean((project_off(r, q) / lever) ** 2)))
