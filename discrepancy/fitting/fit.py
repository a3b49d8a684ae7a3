"""Fit a model whose *readings* carry the noise: Gauss-Helmert adjustment with damped Gauss-Newton steps.

Slopes taken at the readings carry the noise of the residual they are multiplied with: a bias of order n sigma^2 in
J^T r. So all slopes are taken at the *adjusted* readings theta - Sigma B^T (B Sigma B^T)^-1 F (Pope 1972), whose
remaining noise does not correlate with the residual. `docs/discovery-statistics.md` has the numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from typing import Any, TypeVar, cast, final

import numpy as np
from scipy.linalg import cho_solve, lstsq
from scipy.special import stdtrit

from calibench.core.notes import Code, Note
from calibench.core.words import plain
from calibench.discrepancy.fitting.journal import kept_step
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.machine import Formulation, Quantities, Slopes
from calibench.discrepancy.model.measured import PLACE, DataError, MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import ROUNDING, Noise, Whitener, whitener
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_REWEIGHTED = 30  # times at most, between two looks at the slopes
_DESCENDED = 1e-3, 1e-6  # change of the cost, of itself and of the whole, at which a descent ends
_DIGITS = 1e-13  # of the numbers in a constraint: a model that is this near meets them in all digits
_WIDTH = 50.0  # standard deviations to either side of the fit that the box of a coefficient reaches at least
_SUMMED = 500  # rows from which on steps are by sums
_ALIKE = 1e-4  # part of a column that those before it leave at least, for steps by sums
_DEPENDENT = 1e-11  # least over largest size of a triangle, below which columns depend on each other
_CALM = 1e-5  # damping below which a step is one of Gauss and Newton
_KEPT = 20_000  # numbers of a Jacobian up to which a fit is kept with its arrays


@final
@dataclass(frozen=True, eq=False)
class Linearised:
    """A model linearised at x and adjusted readings: misclosure f (n, c), slopes, whitener, quantities."""

    model: Model
    x: Array
    misclosure: Array
    whiten: Whitener
    recorded: Quantities
    slopes: Mapping[str, Array]
    reading_slopes: Array
    sigma: Array

    @property
    def columns(self) -> Array:
        """Return the derivative of the misclosure in x, (n, c, p), computed at each call: a fit keeps it whitened."""
        return self.model.jacobian_of(self.x, self.recorded, self.slopes)

    @property
    def lean(self) -> Linearised:
        """Return the same without the slopes that were computed so far: a search holds many fits at once."""
        slopes = self.slopes
        return replace(self, slopes=Slopes(slopes.names, slopes.one)) if isinstance(slopes, Slopes) else self


@final
@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model: x, whitened residuals r (m,) and Jacobian J (m, p), both unscaled, and where they were taken."""

    model: Model
    x: Array
    noise: Noise
    at: Linearised
    r: Array
    J: Array
    converged: bool

    @property
    def cost(self) -> float:
        """Return minus twice the log-likelihood of the residuals, but for a constant."""
        return self.noise.cost(self.r)

    @property
    def exact(self) -> bool:
        """Return whether the model meets all readings to rounding, as it does those of a simulation without noise."""
        if np.all(np.abs(self.r) <= ROUNDING):
            return True
        size = np.zeros_like(self.at.misclosure)
        for name in self.at.slopes:
            value = np.abs(np.asarray(self.at.recorded[name], dtype=float))
            if np.any(value):
                size += np.abs(self.at.slopes[name]) * value[..., None]
        return bool(np.all(np.abs(self.at.misclosure) <= _DIGITS * size))

    @property
    def degrees(self) -> int:
        """Return the degrees of freedom that the parameters leave, 1 at least."""
        return max(len(self.r) - len(self.x), 1)

    @property
    def reach(self) -> float:
        """Return how many standard deviations of `covariance` hold 95 %: Student's t where the noise is not known."""
        return float(stdtrit(self.degrees, 0.975)) if self.noise.profiled else REACH

    def covariance(self, stated: bool = False) -> Array:
        """Return the covariance of x, shape (p, p); where the noise is not known, it is estimated from the residuals.

        `stated`: use the stated noise in any case.
        """
        size = np.sqrt((self.J**2).sum(axis=0))
        size[size == 0] = 1.0
        R = np.linalg.qr(self.J / size, mode="r")
        # the root of the information in one whitened residual
        nu = self.noise.t_degrees
        precision = float(np.sqrt((nu + 1) / (nu + 3)) / self.noise.core) if np.isfinite(nu) else self.noise.gain
        spread = np.linalg.pinv(R) / precision / size[:, None]
        learned = self.cost / self.degrees if self.noise.profiled and not stated else 1.0
        return np.asarray(learned * spread @ spread.T)


def fit(
    model: Model, noise: Noise, start: Array | None = None, *, near: bool = True, steps: int = 60,
    about: Fit | None = None,
) -> Fit:  # fmt: skip
    """Return `model` fitted under `noise`: with damping from its nominal start; without from a `start` that is `near`.

    `about` is a fit of nearly the same model to the same rows: its adjusted readings are the first ones.
    """
    return kept_step(
        lambda: _fit(model, noise, start, near, steps, about), ("fit", model.size, start, noise.scale, near),
        lambda found: (found.x, readings_of(found.at.model), found.converged),
        lambda kept: fit_at(model, noise, *kept),
    )  # fmt: skip


# a step beyond the machine's reach: its cost is not finite, so it is refused
@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def _fit(model: Model, noise: Noise, start: Array | None, near: bool, steps: int, about: Fit | None) -> Fit:
    x = model.start if start is None else np.asarray(start, dtype=float).copy()
    readings = readings_of(model)
    if start is None or not near:
        x = _descend(model, noise, x, readings, steps)
    adjusted = readings if about is None else readings_of(about.at.model)
    converged = False
    for _ in range(8):
        at = linearise(model, noise, x, adjusted, readings)
        columns = at.columns
        r, J = at.whiten(at.misclosure), at.whiten(columns)
        step = _step(r, J, noise)
        # until the weights of heavy-tailed noise no longer change; slopes are kept
        for _ in range(_REWEIGHTED if np.isfinite(noise.t_degrees) else 0):
            further = _step(r + J @ step, J, noise)
            step = step + further
            if not np.sqrt(np.mean((J @ further) ** 2)) >= thresholds().step_still * noise.scale:
                break
        x = x + step
        left, moved = at.misclosure + columns @ step, J @ step
        still = bool(np.sqrt(np.mean(moved**2)) < thresholds().step_still * noise.scale)
        converged = still and adjusted is not readings  # slopes at the unadjusted readings do not decide convergence
        # less the noise as the misclosure tells it, row by row: Sigma B^T (B Sigma B^T)^-1 f, (n, k)
        scaled = at.reading_slopes * at.sigma[:, None, :]
        covariance, right = scaled @ scaled.transpose(0, 2, 1), left[:, :, None]
        pull = right / covariance if covariance.shape[1] == 1 else np.linalg.solve(covariance, right)
        adjusted = readings - np.asarray((scaled.transpose(0, 2, 1) @ pull)[:, :, 0] * at.sigma)
        if converged:
            break
    return fit_at(model, noise, x, adjusted, converged)


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def fit_at(model: Model, noise: Noise, x: Array, adjusted: Array, converged: bool) -> Fit:
    """Return the fit that ended at x and `adjusted` readings, (n, k)."""
    at = linearise(model, noise, x, adjusted, readings_of(model))
    r, J = at.whiten(at.misclosure), at.whiten(at.columns)
    return Fit(model, x, noise, at.lean, r, J, converged)


def thinned(found: Fit) -> Fit:
    """Return a fit at `drawn_rows` of its residuals, evenly spaced: of very many, a part tells the same."""
    n, c = found.at.misclosure.shape
    some = np.unique(np.linspace(0, n - 1, min(n, thresholds().drawn_rows // c)).round().astype(int))
    if len(some) == n:
        return found
    extra = {name: v if np.ndim(v) == 0 else np.asarray(v)[some] for name, v in found.noise.extra.items()}
    formulation = found.model.formulation
    model = Model(formulation.on(formulation.data.rows(some)), found.model.effects)
    return fit_at(model, replace(found.noise, extra=extra), found.x, readings_of(found.at.model)[some], found.converged)


def linearise(model: Model, noise: Noise, x: Array, adjusted: Array, readings: Array) -> Linearised:
    """Return `model` linearised at x and `adjusted` readings (n, k); the misclosure is that of the recorded ones."""
    formulation = model.formulation
    data = formulation.data
    if adjusted is not readings:
        data = data.with_columns({name: adjusted[:, j] for j, name in enumerate(formulation.readings)})
        model = Model(formulation.on(data), model.effects)
    recorded, true = model.quantities(x)
    slopes = model.formulation.slopes(true)
    B = np.stack([slopes[name] for name in formulation.readings], axis=-1)
    misclosure = np.asarray(model.formulation.constraints(true))
    if adjusted is not readings:
        misclosure = misclosure + np.einsum("nck,nk->nc", B, readings - adjusted)
    misclosure = model.formulation.decorrelate(misclosure)
    # the standard deviation of each reading without `scale`, (n, k), from the stated and the extra variance
    stated, sigma = model.formulation.sigma, np.empty(readings.shape)
    for k, name in enumerate(formulation.readings):
        sigma[:, k] = np.sqrt(np.asarray(stated[name]) ** 2 + noise.extra.get(name, 0.0))
    whiten = whitener(B, sigma, noise.autocorrelation, reading_order(data))
    return Linearised(
        model=model, x=x, misclosure=misclosure, whiten=whiten, recorded=recorded, slopes=slopes, reading_slopes=B,
        sigma=sigma,
    )  # fmt: skip


def readings_of(model: Model) -> Array:
    data = model.formulation.data
    return np.stack([np.asarray(data[name], dtype=float) for name in model.formulation.readings], axis=-1)


def reading_order(data: MeasuredData) -> Array:
    """Return the place of each row in the order of reading, shape (n,)."""
    return np.asarray(data[PLACE]) if data.has(PLACE) else np.arange(len(data), dtype=float)


def _step(r: Array, J: Array, noise: Noise, damping: float = 0.0) -> Array:
    """Return the Gauss-Newton step by orthogonal decomposition, columns scaled, damped as Levenberg's where asked.

    Columns that depend on each other share what they explain: of all such steps it is the shortest.
    """
    root = np.sqrt(noise.weights(r))
    if len(r) >= _SUMMED and (step := step_by_sums(r, J, root, damping)) is not None:
        return step
    A, b = J * root[:, None], -root * r
    size = np.sqrt((A**2).sum(axis=0))
    size[size == 0] = 1.0
    A = A / size
    if damping:
        A, b = np.vstack([A, np.sqrt(damping) * np.eye(A.shape[1])]), np.concatenate([b, np.zeros(A.shape[1])])
    step = lstsq(A, b, cond=_DEPENDENT, lapack_driver="gelsy", check_finite=False)[0]
    return np.asarray(step / size)


def step_by_sums(r: Array, J: Array, root: Array, damping: float) -> Array | None:
    """Return the step by sums of products; None where columns are so alike that these lose its digits.

    A step is off by rounding times the square of the condition. That does not move where steps end, which is where J'r
    vanishes, and sums over very many rows take a fraction of the time of a decomposition of the rows.
    """
    weighted = J if root.min() == root.max() else J * root[:, None]
    size = np.sqrt(np.einsum("np,np->p", weighted, weighted))
    if not np.all(size > 0):
        return None
    products = weighted.T @ weighted / size / size[:, None] + damping * np.eye(len(size))
    try:
        L = np.linalg.cholesky(products)
    except np.linalg.LinAlgError:
        return None
    if not np.diag(L).min(initial=np.inf) > _ALIKE:
        return None
    right = weighted.T @ (r if weighted is J else root * r) / size
    return np.asarray(-cho_solve((L, True), right, check_finite=False) / size)


def _descend(model: Model, noise: Noise, x: Array, readings: Array, steps: int) -> Array:
    """Return x after damped steps at the readings themselves; the damping falls to zero as steps succeed."""
    damping, at = 1e-3, linearise(model, noise, x, readings, readings)
    r, J = at.whiten(at.misclosure), at.whiten(at.columns)
    cost = noise.cost(r)
    for _ in range(steps):
        step = _step(r, J, noise, damping)
        trial = linearise(model, noise, x + step, readings, readings)
        trial_r = trial.whiten(trial.misclosure)
        trial_cost = noise.cost(trial_r)
        if np.isfinite(trial_cost) and trial_cost <= cost:
            gained, x, r, cost = cost - trial_cost, x + step, trial_r, trial_cost
            J = trial.whiten(trial.columns)
            damping = 0.0 if damping < 1e-9 else damping / 10
            if gained < _DESCENDED[0] + _DESCENDED[1] * cost and damping < _CALM:
                break
        elif damping > 1e8 or (damping <= _CALM and trial_cost - cost < _DESCENDED[0] + _DESCENDED[1] * cost):
            break  # the whitening moves with x: at the bottom a Gauss-Newton step may climb by a hair for ever
        else:
            damping = max(4 * damping, 1e-6)
    return x


def orthonormal(columns: Array, least: float) -> Array:
    """Return an orthonormal basis (n, m) of the span of `columns`, (n, p), each scaled to length 1."""
    lengths = np.linalg.norm(columns, axis=0)
    left, values, _ = np.linalg.svd(columns / np.where(lengths > 0, lengths, 1.0), full_matrices=False)
    return np.asarray(left[:, values > least * np.max(values, initial=0.0)])


def project_off(columns: Array, basis: Array, times: int = 1) -> Array:
    """Return `columns`, (..., n, k) or (n,), less their part in the span of an orthonormal `basis`, (n, p).

    Twice for what the basis all but holds: the second time takes away what rounding left of the first.
    """
    for _ in range(times):
        columns = columns - basis @ (basis.T @ columns)
    return columns


REACH = 1.959964

_POINTS = 2000


def amplitude_interval(effect: Effect, c: Array, covariance: Array, reach: float = REACH) -> tuple[float, float]:
    """Return the 95 % interval of the amplitude at coefficients c, (k,), of `covariance` (k, k).

    For one coefficient that is its estimate -+ `reach` standard deviations. The length of several (an eccentricity with
    its phase) has no such formula: its range over the ellipsoid (c - c^)' C^-1 (c - c^) <= reach^2 is the profile
    interval, and it reaches 0 where zero coefficients lie within. `reach` is that of a Gaussian; Student's where the
    variance was learned as well.
    """
    k = len(c)
    if k == 1:
        ends = [effect.amplitude(c + side * reach * np.sqrt(covariance[0])) for side in (-1, 1)]
        return float(min(ends)), float(max(ends))
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0))
    # points on the unit sphere, always the same
    if k == 2:
        angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)
        directions = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    else:
        drawn = np.random.default_rng(0).standard_normal((_POINTS, k))
        directions = np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))
    sizes = [effect.amplitude(c + reach * root @ d) for d in directions]
    signed = effect.amplitude(-c) < 0 or effect.amplitude(c) < 0
    inside = float(c @ np.linalg.pinv(covariance) @ c) <= reach**2
    return float(0.0 if inside and not signed else min(sizes)), float(max(sizes))


@final
@dataclass(frozen=True, eq=False)
class ResidualProblem:
    """A fitted model as a problem for the optimisers: whitened residuals over the fitting rows, in a box about the fit.

    x holds free parameters and coefficients, `best` is the fit found. Residuals are divided by the noise that the
    readings leave in them, whitened where the fit ended.
    """

    model: Model
    fit: Fit
    names: tuple[str, ...] = field(init=False)
    best: Array = field(init=False)
    start: Array = field(init=False)  # the nominal machine without effects

    def __post_init__(self) -> None:
        vars(self).update(names=self.model.names, best=self.fit.x, start=self.model.start)

    def __repr__(self) -> str:
        return f"<problem {self.model.formulation.data.name}: {', '.join(self.names)}>"

    @property
    def options(self) -> dict[str, object]:
        """Return what distinguishes this problem in a table of results: its data and the added effects."""
        return {"case": self.model.formulation.data.name, "names": list(self.names)}

    @property
    def data_id(self) -> str:
        """Return a digest of the readings and of the noise that they are divided by."""
        arrays = [readings_of(self.model), self.fit.at.sigma, np.array(self.fit.noise.scale), self.fit.x]
        return blake2b(b"".join(np.ascontiguousarray(part).tobytes() for part in arrays), digest_size=8).hexdigest()

    @property
    def lower(self) -> Array:
        return self._box[0]

    @property
    def upper(self) -> Array:
        return self._box[1]

    @property
    def _box(self) -> tuple[Array, Array]:
        parameters = self.model.formulation.parameters
        reach = _WIDTH * np.sqrt(np.diag(self.fit.covariance()))
        lower, upper = np.minimum(self.start, self.fit.x) - reach, np.maximum(self.start, self.fit.x) + reach
        p = len(parameters)
        lower[:p] = np.minimum([q.lower for q in parameters], self.fit.x[:p])
        upper[:p] = np.maximum([q.upper for q in parameters], self.fit.x[:p])
        return lower, upper

    def residuals(self, x: Array, /) -> Array:
        """Return the whitened residuals, shape (m,)."""
        return self.fit.at.whiten(np.asarray(self.model.residuals(x))) / self.fit.noise.scale

    def jacobian(self, x: Array, /) -> Array:
        """Return their derivative, shape (m, dim)."""
        return self.fit.at.whiten(self.model.jacobian(x)) / self.fit.noise.scale

    def __call__(self, x: Array, /) -> float:
        r = self.residuals(x)
        return float(r @ r)

    def predict(self, data: MeasuredData, x: Array | None = None) -> Array:
        """Return the whitened residuals of other rows, shape (n, c), in units of the stated noise."""
        return predicted(self.model, self.fit.x if x is None else x, data, Noise())


def predicted(model: Model, x: Array, data: MeasuredData, noise: Noise) -> Array:
    """Return the residuals of `data` under a model at x, whitened by `noise` but for its scale, shape (n, c)."""
    there = Model(model.formulation.on(data), model.effects)
    readings = readings_of(there)
    at = linearise(there, noise, x, readings, readings)
    return at.whiten(at.misclosure).reshape(at.misclosure.shape)


@final
@dataclass(frozen=True, eq=False)
class _End:
    """Where a fit ended: x (p,) and adjusted readings (n, k), the scale of the noise, and whether it converged.

    `found` is the fit itself where it has few numbers. `alive` are the objects whose ids are in the key; the reference
    keeps them alive.
    """

    x: Array
    adjusted: Array
    scale: float
    converged: bool
    found: Fit | None
    alive: tuple[Any, ...]


_ENDS: ContextVar[dict[tuple[Any, ...], Any] | None] = ContextVar("ends", default=None)  # None outside `keeping_fits`
_ANY_SCALE: ContextVar[bool] = ContextVar("any scale", default=False)


@contextmanager
def keeping_fits() -> Iterator[None]:
    """Inside the block, remember where the fits of `fit_once` end, and what `once` makes."""
    before = _ENDS.set({})
    try:
        yield
    finally:
        _ENDS.reset(before)


_T = TypeVar("_T")


def once(make: Callable[[], _T], of: Sequence[object], *also: object) -> _T:
    """Return what `make` returns; inside `keeping_fits` it is made once for the same objects `of` and values `also`."""
    made = _ENDS.get()
    if made is None:
        return make()
    key = (*map(id, of), *also)
    if key not in made:
        made[key] = make(), of  # kept alive, as ids are those of live objects
    return cast(_T, made[key][0])


@contextmanager
def at_any_scale() -> Iterator[None]:
    """Inside the block, a fit that `fit_once` remembers ends where it ended, whatever the scale of its noise was."""
    before = _ANY_SCALE.set(True)
    try:
        yield
    finally:
        _ANY_SCALE.reset(before)


def rests(found: Fit) -> bool:
    """Return whether a further step is as small as the last step of a converged fit."""
    step = _step(found.r, found.J, found.noise)
    return bool(np.sqrt(np.mean((found.J @ step) ** 2)) < thresholds().step_still * found.noise.scale)


def fit_once(model: Model, noise: Noise, start: Array, *, near: bool = True, about: Fit | None = None) -> Fit:
    """Return what `fit` returns; a fit that was made before from this start is not made again.

    With Gaussian noise the scale changes neither the minimum nor the steps towards it, only the tolerance. So where a
    fit ended is kept, without large arrays: one further step from there shows whether the fit at another scale would
    have ended there too. A fit that did not converge near its start under a wider noise does not do so under a narrower
    one. Where only names are asked for (`at_any_scale`), no further step is.
    """
    ends = _ENDS.get()
    if ends is None or np.isfinite(noise.t_degrees):
        return fit(model, noise, start, near=near, about=about)
    digest = blake2b(digest_size=16)
    if about is not None:
        for name in model.formulation.readings:
            first = about.at.model.formulation.data[name]
            digest.update(name.encode() + np.ascontiguousarray(first, dtype=float).tobytes())
    alive = (model.formulation, *model.effects, *noise.extra.values())
    key = (*map(id, alive), *noise.extra, noise.autocorrelation, near, start.tobytes(), digest.digest())
    end = ends.get(key)
    same = end is not None and (_ANY_SCALE.get() or end.scale == noise.scale)
    if end is not None and (end.converged or same or (near and end.scale > noise.scale)):
        kept = end.found
        found = replace(kept, noise=noise) if kept else fit_at(model, noise, end.x, end.adjusted, end.converged)
        if not end.converged or same or rests(found):
            return found
    found = fit(model, noise, start, near=near, about=about)
    kept = found if found.J.size <= _KEPT else None
    ends[key] = _End(found.x, readings_of(found.at.model), noise.scale, found.converged, kept, alive)
    return found


_FAR = 30.0  # times the noise that a calibrated machine leaves, from which on other starts are tried
_STARTS = 8
_BETTER = 0.9  # part of the cost: another minimum below this is taken for better


def fit_from_several(formulation: Formulation) -> tuple[Fit, tuple[Note, ...]]:
    """Return the machine without effects fitted to its data, and a note where the nominal start is not the best."""
    model = Model(formulation)
    nominal = fit(model, Noise())
    if nominal.converged and float(np.sqrt(np.mean(nominal.r**2))) < _FAR:
        return nominal, ()
    lower, upper = (np.array([getattr(p, side) for p in formulation.parameters]) for side in ("lower", "upper"))
    start = np.array([p.start for p in formulation.parameters])
    inside = np.isfinite(lower) & np.isfinite(upper)
    low, high = np.where(inside, lower, start), np.where(inside, upper, start)
    better = []
    for other in np.random.default_rng(0).uniform(low, high, (_STARTS, len(start))):
        try:
            found = fit(model, Noise(), other, near=False)
        except (np.linalg.LinAlgError, ValueError, FloatingPointError):
            continue
        if np.isfinite(found.cost) and found.converged and found.cost < _BETTER * nominal.cost:
            better.append(found)
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
