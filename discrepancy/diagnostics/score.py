"""Score tests: what each candidate would explain of the residuals, before anything is fitted.

A candidate's whitened columns are projected off the calibration Jacobian; U is an orthonormal basis of the result, the
part that data can show. With scores y of unit variance, T = |U^T y|^2 is chi2 of U's rank. With the variance taken from
the rest, (T / m) / ((y'y - T) / (N - p - m)) is F, exactly so for Gaussian noise however few the rows are. So the level
depends neither on the stated noise nor on the number of readings. The smallest p of many candidates is calibrated with
noise drawn in the same design. Of very many readings the same numbers come from sums of products (`Sums`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import chdtri, chndtr, fdtrc

from calibench.discrepancy.fitting.fit import Fit, project_off
from calibench.discrepancy.model.effect import ChangePoint, Effect, has_free_period, name_of
from calibench.discrepancy.model.model import signature, signature_of
from calibench.discrepancy.noise.whiten import Whitener
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_OWN = 0.2  # of a score's variance that calibration must leave, for it to tell the tails of the noise
_CORE = 1.4826  # standard deviations in the median of absolute values, of Gaussian ones
_NUMBERS = 4_000_000  # held at once


@final
@dataclass(frozen=True, eq=False)
class Subspace:
    """The visible part of columns D (N, k): `back` (k, m), with which D back is orthonormal beside calibration.

    `visible` is the part of a unit column that is left, in the direction that is seen best; `size` (k,) the length of
    each column, and `left` (k,) the part of that length that calibration leaves.
    """

    back: Array
    visible: float
    size: Array
    left: Array


@final
@dataclass(frozen=True, eq=False)
class Scored:
    """A candidate with its statistic T of rank m, its F test's p, linear coefficients, and its visible part `seen`.

    `scale` is the factor from its columns to units of sigma.
    """

    effect: Effect
    T: float
    m: int
    p: float
    coefficients: Array
    seen: Subspace
    scale: float

    @property
    def name(self) -> str:
        return name_of(self.effect)

    @property
    def energies(self) -> Array:
        """Return the energy of what calibration leaves of a unit of each coefficient, in sigma squared, (k,)."""
        seen = self.seen
        if self.m == len(seen.size):
            return np.asarray((self.scale * seen.size * seen.left) ** 2)
        left = np.linalg.pinv(seen.back) if self.m else np.diag(thresholds().visible * seen.size)
        return np.asarray((left**2).sum(axis=0) * self.scale**2)


@final
@dataclass(frozen=True, eq=False)
class ProjectedScores:
    """What the tests need of a fit: scores y (N,) and an orthonormal basis Q (N, p) of what calibration absorbs.

    `bounded`: the stated noise is an upper bound, because readings with a common error were given more variance;
    residuals smaller than it are no evidence. `profiled`: nothing but the statement gives the size of the noise, see
    `Noise`. `spared`: readings far off are no evidence either, as where it is asked whether anything is missing at all.
    """

    y: Array
    Q: Array
    bounded: bool = False
    profiled: bool = False
    spared: bool = False

    @cached_property
    def total(self) -> float:
        return float(self.y @ self.y)

    @cached_property
    def excess_kurtosis(self) -> float:
        """Return the excess kurtosis of the scores, at least 0: how much heavier than Gaussian their tails are."""
        if not self.spared:
            return 0.0
        left = 1 - (self.Q**2).sum(axis=1)
        squares = self.y[left > _OWN] ** 2 / left[left > _OWN]
        if len(squares) < thresholds().tails_of or not squares.any():
            return 0.0
        return max(float((squares**2).mean() / squares.mean() ** 2) - 3.0, 0.0)

    @cached_property
    def tested(self) -> Array:
        """Return the scores that p is computed from, (N,): clipped where tails are heavy and are to be `spared`."""
        core = _CORE * float(np.median(np.abs(self.y)))
        if core == 0 or self.excess_kurtosis <= thresholds().tails_heavy:
            return self.y
        cut = thresholds().tails_cut * core
        return project_off(np.clip(self.y, -cut, cut), self.Q)

    @property
    def degrees(self) -> int:
        return int(self.Q.shape[0] - self.Q.shape[1])

    def gain(self, T: float, m: int) -> float:
        """Return what a candidate of rank m that explains T brings in twice the log-likelihood."""
        return float(self.gains(np.asarray(T), np.asarray(m))) if self.profiled else T

    def gains(self, T: Array, m: Array) -> Array:
        """Return the same of several candidates."""
        if not self.profiled:
            return T
        if not self.total > 0:
            return np.zeros_like(T)
        rest = np.maximum(self.degrees - m, 1)
        return np.asarray(rest * np.log(self.total / np.maximum(self.total - T, 1e-12 * self.total)))

    def test(self, T: ArrayLike, m: ArrayLike) -> Array:
        """Return the p of the F tests of what candidates of rank m explain, T, of the `tested` scores."""
        total = float(self.tested @ self.tested)
        return f_test(T, m, max(total, self.degrees) if self.bounded else total, self.degrees)


def f_test(T: ArrayLike, m: ArrayLike, total: float, degrees: int) -> Array:
    """Return the p of each T, of rank m, out of a `total` sum of squares with `degrees` of freedom."""
    T, m = np.asarray(T), np.asarray(m)
    rest = degrees - m
    some, left = np.maximum(m, 1), np.maximum(rest, 1)
    p = fdtrc(some, left, np.maximum(T, 0.0) / some / np.maximum((total - T) / left, 1e-300))
    return np.where((rest > 0) & (m > 0), p, 1.0)


def p_by_own_scatter(on: ProjectedScores, U: Array) -> float:
    """Return the p of a basis (N, m) by the scatter that each row itself has beside it (White 1980).

    It holds where noise is larger in some part of the run, of which the F test knows nothing.
    """
    z, rest = U.T @ on.tested, on.degrees - U.shape[1]
    if rest <= 0 or not U.shape[1]:
        return 1.0
    left = on.tested - U @ z
    T = float(z @ np.linalg.lstsq((U * left[:, None] ** 2).T @ U, z, rcond=None)[0])
    return float(fdtrc(U.shape[1], rest, T / U.shape[1]))


def projected_scores(fit: Fit, spared: bool = False, without: Sequence[Effect] = ()) -> ProjectedScores:
    """Return the scores of a fit, projected off what its Jacobian can absorb; `spared` see `ProjectedScores`.

    They are those of the fit `without` some of its effects, to first order.
    """
    r, J = fit.r, fit.J
    if without:
        out = np.concatenate([np.arange(len(fit.x))[fit.model.place_of(effect)] for effect in without])
        r, J = r - J[:, out] @ fit.x[out], np.delete(J, out, axis=1)
    size = np.sqrt((J**2).sum(axis=0))
    size[size == 0] = 1.0
    Q, R = np.linalg.qr(J / size)
    Q = np.asarray(Q[:, np.abs(np.diag(R)) > 1e-10])
    y = fit.noise.scores(r)
    return ProjectedScores(project_off(y, Q), Q, bool(fit.noise.extra), fit.noise.profiled, spared)


def columns(fit: Fit, effect: Effect) -> Array:
    """Return the whitened signature of a unit of each coefficient, (N, k), at the fit and adjusted readings."""
    at, zero = fit.at, np.zeros(len(effect.coefficients))
    return at.whiten(signature(effect, zero, at.recorded, at.slopes, at.model.formulation))


def signatures(fit: Fit, changes: Mapping[str, Array]) -> Array:
    """Return the whitened signatures of m changes of quantities at the fit and adjusted readings: (n, m) -> (N, m)."""
    return fit.at.whiten(signature_of(changes, fit.at.slopes, fit.at.model.formulation))


def uncancelled(effect: Effect, fit: Fit) -> float:
    """Return the length of an effect's signature over the lengths of its parts, one for each quantity that it changes.

    It is 1 for an effect that changes one quantity. Example: if all encoders are late together, the parts describe the
    pose of a moment before and cancel, so that only rounding is left.
    """
    basis = effect.basis(fit.at.recorded, fit.at.model.formulation.data, np.zeros(len(effect.coefficients)))
    if len(basis) < 2:
        return 1.0
    whole = np.linalg.norm(columns(fit, effect), axis=0)
    lengths = lengths_apart(fit.at.whiten, fit.at.slopes, basis)
    return float(np.linalg.norm(whole / lengths) / np.sqrt(len(whole)))


def lengths_apart(white: Whitener, slopes: Mapping[str, Array], changes: Mapping[str, Array]) -> Array:
    """Return the lengths of the whitened signatures of changes of several quantities as if each were alone, (k,)."""
    parts = [white(slopes[name][:, :, None] * change[:, None, :]) for name, change in changes.items()]
    lengths = np.sqrt(sum((part**2).sum(axis=0) for part in parts))
    return np.asarray(np.where(lengths > 0, lengths, 1.0))


def subspaces(on: ProjectedScores, D: Array, least: float | None = None) -> list[tuple[Subspace, Array]]:
    """Return the parts of K candidates' columns, (K, N, k), of which at least `least` is visible, and bases (N, m)."""
    parts, _, W = _seen(on, D.transpose(1, 0, 2), thresholds().visible if least is None else least, bases=True)
    return [(seen, W[:, j, : seen.back.shape[1]]) for j, seen in enumerate(parts)]


def _seen(on: ProjectedScores, D: Array, least: float, bases: bool) -> tuple[list[Subspace], Array, Array]:
    """Return the visible parts of K candidates, columns D (N, K, k), the scores along them, and bases (N, K, k).

    The second, (K, 2, k), are the scores and the `tested` scores. All columns are projected at once, by one product of
    matrices. A basis has no rows unless `bases` are asked for.
    """
    N, K, k = D.shape
    size = np.sqrt(np.einsum("nkj,nkj->kj", D, D))
    size = np.where(size > 0, size, 1.0)
    left = project_off((D / size).reshape(N, K * k), on.Q, times=2)
    along = (np.stack([on.y, on.tested]) @ left).reshape(2, K, k).transpose(1, 0, 2)
    if k == 1:
        s = np.sqrt(np.einsum("nk,nk->k", left, left))[:, None]
        W, V, lengths = left.reshape(N, K, 1), np.ones((K, 1, 1)), s
        W = W / np.where(s > 0, s, 1.0) if bases else W[:0]
    else:
        # by the Gram matrices, in which the square of the least that is kept stands far above rounding
        each = np.ascontiguousarray(left.reshape(N, K, k).transpose(1, 0, 2))
        gram = each.transpose(0, 2, 1) @ each
        lengths = np.sqrt(np.diagonal(gram, axis1=1, axis2=2))
        s, V = _roots(gram)
        W = (each @ V / np.where(s > 0, s, 1.0)[:, None, :] if bases else each[:, :0]).transpose(1, 0, 2)
    parts, shown = _visible(s, V, size, lengths, least)
    return parts, along @ shown, W


def _roots(gram: Array) -> tuple[Array, Array]:
    """Return the singular values of columns, (K, k), the largest first, and their directions, by Gram matrices."""
    squares, vectors = np.linalg.eigh(gram)
    return np.sqrt(np.maximum(squares[:, ::-1], 0.0)), vectors[:, :, ::-1]


def _visible(s: Array, V: Array, size: Array, left: Array, least: float) -> tuple[list[Subspace], Array]:
    """Return the parts whose singular values are above `least`, and what makes them of unit columns, (K, k, k)."""
    shown = V / np.where(s > least, s, np.inf)[:, None, :]
    ranks, back = (s > least).sum(axis=1).tolist(), shown / size[:, :, None]
    return [Subspace(back[j, :, :m], float(s[j, 0]), size[j], left[j]) for j, m in enumerate(ranks)], shown


def score_all(
    fit: Fit, on: ProjectedScores, effects: Sequence[Effect], least: float | None = None, *, bases: bool = False,
    sums: bool = False,
) -> list[tuple[Scored, Array]]:  # fmt: skip
    """Return the score test of each candidate, and where `bases` are asked for one (N, m) of its visible part.

    From `drawn_rows` rows on bases come without rows, as no noise is drawn in them. By `sums` over the readings so do
    those of waves, and of all candidates where readings have several constraints.
    """
    least = thresholds().visible if least is None else least
    if len(on.y) >= thresholds().drawn_rows:
        return _by_sums(fit, on, effects, least)
    found: list[tuple[Scored, Array]] = [None] * len(effects)  # type: ignore[list-item]
    at, data, wide = fit.at, fit.at.model.formulation.data, fit.at.misclosure.shape[1]
    summed = [place for place, one in enumerate(effects) if sums and (wide > 1 or has_free_period(one))]
    for place, one in zip(summed, _by_sums(fit, on, [effects[place] for place in summed], least) if summed else ()):
        found[place] = one
    by_size: dict[int, list[int]] = {}
    for place, effect in enumerate(effects):
        if found[place] is None:
            by_size.setdefault(len(effect.coefficients), []).append(place)
    most = max(1, _NUMBERS // on.Q.shape[0])
    for k, places in by_size.items():
        for start in range(0, len(places), max(1, most // k)):
            some = places[start : start + max(1, most // k)]
            # the whitened signatures of these, (N, K, k), at once
            raw = np.empty((*at.misclosure.shape, len(some), k))
            for j, tried in enumerate(effects[place] for place in some):
                (first, moved), *more = tried.basis(at.recorded, data, np.zeros(k)).items()
                np.multiply(at.slopes[first][:, :, None], moved[:, None, :], out=raw[:, :, j])
                for name, moved in more:
                    raw[:, :, j] += at.slopes[name][:, :, None] * moved[:, None, :]
            D = at.whiten(at.model.formulation.decorrelate(raw))
            tested = _scored(fit, on, [effects[place] for place in some], *_seen(on, D, least, bases))
            for place, one in zip(some, tested):
                found[place] = one
    return found


def _by_sums(fit: Fit, on: ProjectedScores, effects: Sequence[Effect], least: float) -> list[tuple[Scored, Array]]:
    products = Sums(fit, np.column_stack([on.Q, on.y, on.tested])).of(effects)
    found: list[tuple[Scored, Array]] = [None] * len(effects)  # type: ignore[list-item]
    for k in {len(square) for square, _ in products}:
        places = [place for place, (square, _) in enumerate(products) if len(square) == k]
        square, across = (np.stack([products[place][i] for place in places]) for i in (0, 1))
        size = np.sqrt(np.diagonal(square, axis1=1, axis2=2))
        size = np.where(size > 0, size, 1.0)
        absorbed, b = across[:, :-2] / size[:, None], across[:, -2:] / size[:, None]
        left = square / size[:, None] / size[:, :, None] - absorbed.transpose(0, 2, 1) @ absorbed
        lengths = np.sqrt(np.maximum(np.diagonal(left, axis1=1, axis2=2), 0.0))
        parts, shown = _visible(*_roots(left), size, lengths, least)
        tested = _scored(fit, on, [effects[place] for place in places], parts, b @ shown, np.empty((0, *size.shape)))
        for place, one in zip(places, tested):
            found[place] = one
    return found


def _scored(
    fit: Fit, on: ProjectedScores, effects: Sequence[Effect], parts: Sequence[Subspace], along: Array, W: Array
) -> list[tuple[Scored, Array]]:
    found, scale, squares = [], fit.noise.gain, (along**2).sum(axis=2)
    p = on.test(squares[:, 1], [seen.back.shape[1] for seen in parts])
    for j, (effect, seen, T, own_p) in enumerate(zip(effects, parts, squares[:, 0].tolist(), p.tolist())):
        m = seen.back.shape[1]
        c = -seen.back @ along[j, 0, :m] / scale  # a step of Gauss and Newton: what takes the residual away
        found.append((Scored(effect, T if m else 0.0, m, own_p, c, seen, scale), W[:, j, :m]))
    return found


def smallest_p_law(on: ProjectedScores, seen: Sequence[Array], rng: np.random.Generator) -> Array:
    """Return sorted draws, under noise alone, of the smallest p of F tests on orthonormal bases (N, m)."""
    N = on.Q.shape[0]
    if not seen or thresholds().drawn_rows < N:
        return np.empty(0)
    stacked = np.concatenate([*seen, on.Q], axis=1).astype(np.float32)
    noise = rng.standard_normal((thresholds().drawn, N), dtype=np.float32)
    squares = (noise @ stacked) ** 2
    total = (noise**2).sum(axis=1) - squares[:, stacked.shape[1] - on.Q.shape[1] :].sum(axis=1)
    edges = np.cumsum([0, *(U.shape[1] for U in seen)])
    ranks = np.diff(edges)
    T = np.add.reduceat(squares[:, : edges[-1]], edges[:-1], axis=1)
    p = np.ones(len(T))
    for m in np.unique(ranks[ranks < on.degrees]):  # of tests of one rank, that of the largest T has the smallest p
        most, rest = T[:, ranks == m].max(axis=1), on.degrees - m
        p = np.minimum(p, fdtrc(m, rest, (most / m) / np.maximum((total - most) / rest, 1e-12)))
    return np.sort(p)


def family_wise(p: float, law: Array, tests: int) -> float:
    """Return the probability that the smallest of the p is `p` or less under noise alone."""
    bonferroni = min(1.0, p * tests)
    if not len(law):
        return bonferroni
    below = int(np.searchsorted(law, p, side="right"))
    if below >= 10:
        return below / len(law)
    # beyond the draws the law is a straight line through the origin, as that of any smallest p
    edge = min(len(law) - 1, 20)
    return float(min(bonferroni, p / law[edge] * (edge + 1) / len(law)))


_TOGETHER = 200_000  # numbers of a signature that are multiplied at once: a processor's cache holds them


@final
class Sums:
    """The products of any candidate's whitened columns with each other and with `targets`, (N, t), at one fit.

    With orthonormal Q for what calibration absorbs, and columns D of unit length, (D - Q Q'D)'(D - Q Q'D) is D'D -
    (Q'D)'(Q'D), so that no full matrix is stored. Its relative error is rounding over the square of the visible part;
    the smallest part that is kept is 2e-4. Where each reading's noise is independent, a change of a quantity enters by
    its slope, whitened and multiplied into Q and y once for all candidates; so a sum runs over readings, not
    constraints. A change from some reading on is a sum from there to the end, so that a scan for its place costs one
    pass. Where noise is correlated between readings, each candidate is whitened by itself.
    """

    def __init__(self, fit: Fit, targets: Array) -> None:
        self.fit, self.targets = replace(fit, at=fit.at.lean), targets  # slopes are kept as long as the sums
        rows, data = fit.at.misclosure, fit.at.model.formulation.data
        self._apart = fit.at.model.formulation.decorrelate(rows) is rows and fit.at.whiten.band is None
        # (c, n, t): one after the other, so that sums over the constraints of a reading run over whole arrays
        self._by_constraint = np.ascontiguousarray(targets.reshape(*rows.shape, -1).transpose(1, 0, 2))
        self._clock = np.asarray(data["t_s"]) if self._apart and data.has("t_s") else np.empty(0)
        if np.any(np.diff(self._clock) < 0):
            self._clock = np.empty(0)
        self._ends: dict[tuple[str, ...], Array] = {}
        self._white: dict[str, Array] = {}
        self._pulls: dict[str, Array] = {}
        self._pairs: dict[tuple[str, str], Array] = {}

    def of(self, effects: Sequence[Effect]) -> list[tuple[Array, Array]]:
        """Return D'D, (k, k), and targets'D, (t, k), of each effect's columns D of a unit of each coefficient."""
        at = self.fit.at
        found: list[tuple[Array, Array]] = [(np.empty(0), np.empty(0))] * len(effects)
        alike: dict[tuple[object, ...], dict[int, Mapping[str, Array]]] = {}

        def multiply(some: dict[int, Mapping[str, Array]]) -> None:
            names = [*next(iter(some.values()), ())]
            changes = {name: np.stack([np.asarray(basis[name]).T for basis in some.values()]) for name in names}
            if not changes:
                return
            K, k, n = changes[names[0]].shape
            whole = len(effects[next(iter(some))].coefficients)  # one more than k for waves
            square, across = np.zeros((K, whole, whole)), np.zeros((K, whole, self.targets.shape[1]))
            for one, change in changes.items():
                across[:, :k] += (change.reshape(K * k, n) @ self._pull(one)).reshape(K, k, -1)
                for other, beside in changes.items():
                    square[:, :k, :k] += change @ (self._pair(one, other) * beside).transpose(0, 2, 1)
            for place, one_square, one_across in zip(some, square, across.transpose(0, 2, 1)):
                found[place] = one_square, one_across
            some.clear()

        # one target after the other: its quantities' products, which are large, are kept that long
        order, last = sorted(range(len(effects)), key=lambda place: effects[place].target), ""
        for place, effect in ((place, effects[place]) for place in order):
            if effect.target != last:
                for some in alike.values():
                    multiply(some)
                alike.clear()
                self._pulls.clear()
                self._ends.clear()
                last = effect.target
            if isinstance(effect, ChangePoint) and len(self._clock):
                names, start = effect.quantities, int(np.searchsorted(self._clock, effect.at))
                square = np.array([[self._end(one, other)[start] for other in names] for one in names])
                across = np.stack([self._end(name)[start] for name in names], axis=-1)
                found[place] = square * np.outer(effect.ones, effect.ones), across * effect.ones
                continue
            zero, formulation = np.zeros(len(effect.coefficients)), at.model.formulation
            if not self._apart:
                D = at.whiten(signature(effect, zero, at.recorded, at.slopes, formulation))
                found[place] = D.T @ D, self.targets.T @ D
                continue
            # a wave without a height does not tell its period: the last column is nothing but zeros
            told = len(zero) - has_free_period(effect)
            basis = {
                name: change[:, :told] for name, change in effect.basis(at.recorded, formulation.data, zero).items()
            }
            some = alike.setdefault((*basis, len(zero), told), {})
            some[place] = basis
            if len(some) * told * len(at.misclosure) >= _TOGETHER:
                multiply(some)
        for some in alike.values():
            multiply(some)
        return found

    def _end(self, *names: str) -> Array:
        """Return the sums from each reading to the end, (n + 1, ...): of a pull, or of a pair."""
        if names not in self._ends:
            terms = self._pull(*names) if len(names) == 1 else self._pair(*names)
            ends = np.zeros((len(terms) + 1, *terms.shape[1:]))
            np.cumsum(terms[::-1], axis=0, out=ends[-2::-1])
            self._ends[names] = ends
        return self._ends[names]

    def _slope(self, name: str) -> Array:
        if name not in self._white:
            slope = self.fit.at.slopes[name]
            self._white[name] = self.fit.at.whiten(slope).reshape(slope.shape)
        return self._white[name]

    def _pull(self, name: str) -> Array:
        """Return what a change of a quantity at each reading adds to the products with the targets, (n, t)."""
        if name not in self._pulls:
            slope = self._slope(name)
            pull = slope[:, 0, None] * self._by_constraint[0]
            for k in range(1, slope.shape[1]):
                pull += slope[:, k, None] * self._by_constraint[k]
            self._pulls[name] = pull
        return self._pulls[name]

    def _pair(self, one: str, other: str) -> Array:
        """Return what changes of two quantities at each reading add to their product, (n,)."""
        if (one, other) not in self._pairs:
            pair = np.einsum("nc,nc->n", self._slope(one), self._slope(other))
            self._pairs[one, other] = self._pairs[other, one] = pair
        return self._pairs[one, other]


def smallest_amplitude(effect: Effect, energies: Array, rank: int, candidates: int) -> float:
    """Return the amplitude that a search over `candidates` finds with the stated power, in the effect's unit."""
    sizes = [effect.amplitude(unit) for unit in np.eye(len(energies))]
    per_unit = [float(energy) / abs(size) ** 2 for energy, size in zip(energies, sizes) if size]
    energy = float(np.mean(per_unit)) if per_unit else 0.0
    level = thresholds().detect_level / max(1, candidates)
    needed = noncentrality(max(1, rank), level, thresholds().detect_power)
    return float(np.sqrt(needed / energy)) if energy > 0 else np.inf


@cache
def noncentrality(degrees: int, level: float, power: float) -> float:
    """Return the noncentrality at which a chi-square test at `level` has such a `power`."""
    critical = chdtri(degrees, level)
    return float(brentq(lambda size: 1 - chndtr(critical, degrees, size) - power, 1e-3, 1e3))
