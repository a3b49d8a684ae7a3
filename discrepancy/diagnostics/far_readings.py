"""Readings far off: are they anywhere, as noise is, or carried by time, place or a column; and which rows stand out.

A law of the noise says that far readings may fall anywhere. So their places, drawn anew at random, must look like those
that were measured: over the order of the readings, over each column, and in how many follow each other (a permutation
test, with the chance of each reading to be seen far off as its weight). Readings that fail are no noise: something is
missing. Apart from it, rows stand out that no law of the noise explains: one by itself, or some close together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, ndtr, stdtr, stdtrit

from calibench.discrepancy.diagnostics.smooth_term import curve, smooth_columns
from calibench.discrepancy.fitting.fit import Fit, Linearised, linearise, readings_of
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured import PLACE, blamable
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.repeats import TAILS, variance
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]

_DRAWN = 999  # permutations
_TERMS = 6  # of a curve over the ranks of a column
_LEVELS = 4  # values of a column up to which each is a group
_LAGS = 3  # readings by which far ones follow each other
_LEAST = 0.1  # weight below which a reading is not far off
_COUNTS = ("pose_id", "visit_id", "shared_id", "repeat", "split", "valid")  # columns that count, and carry nothing


@final
@dataclass(frozen=True)
class Pattern:
    """What carries the far readings of a sensor: the column, `PLACE` for their order; p is that of all columns."""

    target: str
    column: str
    p: float


def columns_of(at: Fit) -> dict[str, Array]:
    """Return the numbers that may carry an error, name -> (n,): the measured columns, the place, and the order."""
    data = at.model.formulation.data
    found = {PLACE: np.asarray(data[PLACE], dtype=float) if PLACE in data else np.arange(len(data), dtype=float)}
    for name in data.columns:
        if name not in (*_COUNTS, PLACE) and data[name].dtype.kind in "iufb":
            found[name] = np.asarray(data[name], dtype=float)
    return found | smooth_columns(at.model.formulation, at.x)


def pattern_of(target: str, weights: Array, chance: Array, columns: Mapping[str, Array]) -> Pattern | None:
    """Return what carries the far ones of m readings, or of m visits in the order of their time; None for noise.

    `weights`, (m,), are the probabilities that each is far off; `chance`, (m,), is that of one to be seen far off if
    it may be any. `columns` are name -> (m,), `PLACE` among them.
    """
    far = weights > _LEAST
    count, m = int(far.sum()), len(weights)
    if not 2 <= count < m or not (chance > 0).any():
        return None
    rng = np.random.default_rng(0)
    # places of the far readings in each draw: the largest keys of log u / chance (Efraimidis and Spirakis 2006)
    keys, places = np.log(np.maximum(chance, 1e-12)), np.empty((_DRAWN + 1, count), dtype=int)
    places[0] = np.flatnonzero(far)
    for k in range(1, _DRAWN + 1):
        places[k] = rng.permutation(np.argpartition(keys + rng.gumbel(size=m), m - count)[m - count :])
    size = weights[far]
    names, found = [], []
    for name, values in columns.items():
        finite = np.isfinite(values)
        distinct, place = np.unique(np.where(finite, values, np.nan), return_inverse=True, equal_nan=True)
        if len(distinct) < 2:
            continue
        # columns in which a dependence on the values shows, (m, k): groups, or a curve over their ranks
        if len(distinct) <= _LEVELS:
            basis = np.asarray(place.ravel()[:, None] == np.arange(1, len(distinct)), dtype=float)
        else:
            ranks = place.ravel().astype(float)
            basis = np.where(finite[:, None], curve(ranks, 0.0, float(ranks.max()), _TERMS + 1)[:, 1:], 0.0)
        sums = np.stack([column[places] @ size for column in basis.T], axis=-1)  # (draws, terms)
        away = sums - sums.mean(axis=0)
        spread = away.std(axis=0)
        names.append(name)
        found.append(((away / np.where(spread > 0, spread, 1.0)) ** 2).sum(axis=1))
    order = np.argsort(columns[PLACE], kind="stable")
    follow = np.empty(_DRAWN + 1)
    for k, place in enumerate(places):
        one = np.zeros(m)
        one[place] = size
        one = one[order]
        follow[k] = sum(float(one[lag:] @ one[:-lag]) for lag in range(1, min(_LAGS, m - 1) + 1))
    names.append(PLACE)
    found.append(follow)
    # how far each lies beyond what is usual among the draws, and the p of the furthest
    beyond = np.stack([(one - one.mean()) / max(float(one.std()), 1e-12) for one in found])
    most = beyond.max(axis=0)
    p = float((most >= most[0]).mean())
    return Pattern(target, names[int(np.argmax(beyond[:, 0]))], p) if p <= thresholds().wild_carried else None


@final
@dataclass(frozen=True, eq=False)
class Standing:
    """Rows that stand out, in `runs` of numbers in the file that follow each other in time, and how far they lie off.

    `times` is their rms in standard deviations of the noise. `sensor` is the one whose errors, `size` each, would
    explain them; "" where several would as well. `others` are all other rows of the fit, (n,).
    """

    runs: tuple[tuple[int, ...], ...]
    times: float
    sensor: str
    size: float
    others: Mask

    def beside(self, left: "Standing | None") -> "Standing | None":
        """Return those runs of which what was found leaves rows standing out: a curve through them bends others."""
        rows = {row for run in left.runs for row in run} if left is not None else set()
        runs = tuple(run for run in self.runs if rows & {*run})
        return replace(self, runs=runs) if runs else None


_ALONE, _TOGETHER = 1e-4, 1e-2  # chance of a row by itself, and of rows close together, anywhere in the data
_FAR = (0.01,)  # chances, by the law, of rows that count as far off in a run
_NEAR = 0.1  # and of one that belongs to a run between such rows
_WINDOWS = (3, 5, 8, 12, 20)  # rows in which some are far off
_SHARE = 0.7  # of the squares of the rows that stand out: so much the errors of one sensor explain
_CLEARLY = 2.0  # times as much is left by any other sensor
_ROUNDS = 5
_FURTHEST = (0.02, 0.05, 0.1)  # parts of the rows, those that lie furthest off
_CORES = 3.0  # times the noise that each of them is off at least
_GAP = 2  # rows from one to the next within a run
_OF_RUN = 0.5  # of the rows of a run, at least, are far off
_LONGEST = 0.2  # of all rows: more are no run
_FEWEST = 20  # rows
_NEARER, _GAUSS = 0.98, 1e6  # part of the readings, and degrees of freedom of a t law that is a Gaussian
_APART, _BETWEEN = 1e-5, 0.05  # chances, over all rows, of rows that lie apart, and of others that would lie in between
_APART_OF, _CLOSE = 100, 3  # rows, at least, and rows to the next one of the same burst


# residuals (n, c), their rows, where these are linearised, and the width of each residual in units of the noise
_Part = tuple[Array, Formulation, Linearised, Array]


def standing_out(final: Fit, unseen: Formulation | None) -> Standing | None:
    """Return the rows that stand out of what a fit leaves, and of `unseen` rows; None without such a row."""
    fitted = final.model.formulation
    if final.exact:
        return None
    r = final.r.reshape(len(fitted.data), -1)
    parts: list[_Part] = [(r, fitted, final.at, np.ones(r.size))]
    if unseen is not None and not final.noise.autocorrelation:
        # in units that hold the doubt of the parameters as well
        extra = {name: variance for name, variance in final.noise.extra.items() if np.ndim(variance) == 0}
        model = Model(unseen, final.model.effects)
        readings = readings_of(model)
        at = linearise(model, Noise(extra=extra), final.x, readings, readings)
        beyond, J = at.whiten(at.misclosure), at.whiten(at.columns)
        share = np.einsum("np,pq,nq->n", J, final.covariance(stated=True), J)
        width = np.sqrt(1 + np.maximum(share, 0.0))
        parts.append(((beyond / width).reshape(len(unseen.data), -1), unseen, at, width))
    left = np.concatenate([one for one, *_ in parts])
    each = [rows.data for _, rows, *_ in parts]
    numbers = np.concatenate([data.row_numbers for data in each])
    places = np.concatenate([data.columns.get(PLACE, data.row_numbers) for data in each]).astype(float)
    order = np.argsort(places, kind="stable")
    others = np.ones(len(left), dtype=bool)
    for _ in range(_ROUNDS):  # rows far off hide others: they widen the law, and are further off
        found = order[standing_rows(left[order], others[order])]
        if not len(found):
            break
        others[found] = False
    rows = np.flatnonzero(~others[order])
    runs = [order[run] for run in np.split(rows, np.flatnonzero(np.diff(rows) > _GAP) + 1) if len(run)]
    if not runs:
        return None
    if final.noise.autocorrelation:  # what a far row carries on is taken from the row behind it, which is sound itself
        own = np.abs(final.at.misclosure)
        far = np.any(own > _CORES * 1.4826 * np.median(own[others], axis=0), axis=1)
        runs = [run[: np.flatnonzero(far[run]).max(initial=-1) + 1 or len(run)] for run in runs]
    rows = np.concatenate(runs)
    times = float(np.sqrt(np.mean(left[rows][left[rows] != 0] ** 2))) / _core(left[others])
    sensor, size = _sensor(left, parts, runs)
    named = tuple(tuple(sorted(numbers[run].tolist())) for run in runs)
    return Standing(named, times, sensor, size, others[: len(r)])


def _sensor(left: Array, parts: Sequence[_Part], runs: Sequence[Rows]) -> tuple[str, float]:
    """Return the sensor of which one error a run explains the rows, and the rms of the errors; "" without one."""
    slopes = {
        sensor.column: np.concatenate([
            (at.whiten(at.reading_slopes[:, :, rows.readings.index(sensor.column)]).ravel() / width).reshape(one.shape)
            for one, rows, at, width in parts
        ])
        for sensor in blamable(parts[0][1].sensors)
    }  # fmt: skip
    whole, explained = 0.0, dict.fromkeys(slopes, 0.0)
    errors: dict[str, list[float]] = {column: [] for column in slopes}
    for run in runs:
        whole += float((left[run] ** 2).sum())
        for column, each in slopes.items():
            square, across = float((each[run] ** 2).sum()), float((each[run] * left[run]).sum())
            if square > 0:
                explained[column] += across**2 / square
                errors[column].append(across / square)
    explained = {column: share for column, share in explained.items() if errors[column]}
    if not explained:
        return "", float("nan")
    first, *others = sorted(explained, key=lambda name: -explained[name])
    next_best = max((explained[name] for name in others), default=0.0)
    if explained[first] < _SHARE * whole or whole - next_best < _CLEARLY * (whole - explained[first]):
        return "", float("nan")
    return first, float(np.sqrt(np.mean(np.square(errors[first]))))


def _core(r: Array) -> float:
    """Return the standard deviation of most residuals, told by the middle of their sizes."""
    found = r[r != 0]
    return 1.4826 * float(np.median(np.abs(found))) if found.size else 1.0


def standing_rows(r: Array, sound: Mask) -> Rows:
    """Return the rows that stand out of whitened residuals r, (n, c), in the order of their time, beside `sound` ones.

    A row stands out by itself, also where a law of heavy tails would have it; or with others close to it: the furthest
    of all rows, as many as they are, lie anywhere if they are noise, so how many of them lie in a window has a
    hypergeometric law, whatever the law of the noise is.
    """
    n, flat = int(sound.sum()), r[sound][r[sound] != 0]
    if n < _FEWEST or len(flat) < _FEWEST:
        return np.empty(0, dtype=int)
    # the chance of each row to lie so far off by noise, (n,), by a Gaussian or a t law, whichever is likelier, with the
    # width of the middle of the `sound` rows
    core = _core(flat)
    law, likely = Noise(core), 2 * Noise(core).loglikelihood(flat) + thresholds().tails_gain
    for tail in TAILS:
        t = Noise(float(np.sqrt(variance(flat, tail))), 0.0, tail)
        if 2 * t.loglikelihood(flat) > likely:
            law, likely = t, 2 * t.loglikelihood(flat)
    one = np.abs(r) / law.core
    beyond = 2 * (stdtr(law.t_degrees, -one) if np.isfinite(law.t_degrees) else ndtr(-one))
    p = -np.expm1(r.shape[1] * np.log1p(-np.minimum(beyond.min(axis=1), 1 - 1e-12)))
    p = np.where(sound, p, 1.0)
    size = np.abs(r).max(axis=1) / _core(r[sound])
    chosen = (p * n < _ALONE) | _apart(r, sound)
    cuts = [np.partition(p[sound], k)[k] for k in sorted({max(2, int(share * n)) for share in _FURTHEST})]
    widths = [width for width in _WINDOWS if width <= len(p)]
    for cut in (*_FAR, *cuts):
        far = p <= cut
        sums, most = np.concatenate([[0], np.cumsum(far)]), int(far.sum())
        tests = n * len(widths) * (len(_FAR) + len(cuts))
        for width in widths:
            count, numbers = sums[width:] - sums[:-width], np.arange(width + 1)
            enough = numbers >= max(3, _OF_RUN * width)
            if not enough[count.max()]:
                continue
            # the hypergeometric chance of each number of them or more
            logs = _choose(most, numbers) + _choose(n - most, width - numbers) - _choose(n, np.array([width]))
            seldom = np.cumsum(np.exp(logs)[::-1])[::-1] * tests < _TOGETHER
            for k in np.flatnonzero((seldom & enough)[count]):
                ends = k + np.flatnonzero(far[k : k + width])
                if size[ends].min() >= _CORES:
                    within = np.arange(ends[0], ends[-1] + 1)
                    chosen[within] |= p[within] < _NEAR
    return np.flatnonzero(chosen) if (chosen | ~sound).mean() <= _LONGEST else np.empty(0, dtype=int)


@np.errstate(divide="ignore")  # of a law that cannot be
def _apart(r: Array, sound: Mask) -> Mask:
    """Return the rows far beyond the law that the nearer readings tell, if no others but close ones lie in between.

    One wild row makes any law of all readings one of heavy tails, which explains it. A law that is told by the nearer
    ones (by the likelihood of a sample cut at `_NEARER`) does not; and where noise has heavy tails, some rows lie
    between the far and the near ones.
    """
    sizes = np.sort(np.abs(r[sound][r[sound] != 0]))
    if int(sound.sum()) < _APART_OF or not sizes.size:
        return np.zeros(len(r), dtype=bool)
    nearer = sizes[: int(_NEARER * len(sizes))]
    likely, p = -np.inf, np.ones(len(r))
    for degrees in (*TAILS, _GAUSS):
        core = float(np.median(sizes)) / stdtrit(degrees, 0.75)
        inside = -(degrees + 1) / 2 * np.log1p((nearer / core) ** 2 / degrees)
        inside += gammaln((degrees + 1) / 2) - gammaln(degrees / 2) - 0.5 * np.log(np.pi * degrees) - np.log(core)
        beyond = (len(sizes) - len(nearer)) * np.log(2 * stdtr(degrees, -nearer[-1] / core))
        if inside.sum() + beyond > likely:
            likely = inside.sum() + beyond
            p = int(sound.sum()) * 2 * r.shape[1] * stdtr(degrees, -np.abs(r).max(axis=1) / core)
    far = (p < _APART) & sound
    close = np.convolve(far, np.ones(2 * _CLOSE + 1), mode="same") > 0
    others = p[sound & ~close]
    return far if others.size and others.min() > _BETWEEN else np.zeros(len(r), dtype=bool)


def _choose(n: int, k: Rows) -> Array:
    """Return the logarithm of n over k; minus infinity where there is no such choice."""
    there = (k >= 0) & (k <= n)
    k = np.where(there, k, 0)
    return np.where(there, gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1), -np.inf)
