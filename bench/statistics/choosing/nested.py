"""Nested selection: leave one unit out, choose the best setting on the others, score the choice on the one left out.

The best score of a sweep is optimistic: the setting was chosen as it did well on just these instances. Each unit (an
instance) is left out once; the setting that is best on the rest is scored on it, and these scores together are the
nested score: what the act of choosing is worth on an instance that had no part in it, with one instance fewer to choose
on. Optimism is the nested score less the apparent one, gain the default's score less the nested one.

Intervals: units are drawn with replacement, and in each resample all of the nested selection is done again, with every
copy of a unit left out together, so that the interval knows that the choice itself could have been another. Folds share
most of their units; an interval from the spread of the folds alone is too narrow. Quantiles are those at which an
interval of a mean has its t-distributed width with so few units.
Sources: Stone, J. R. Stat. Soc. B 36 (1974); Varma and Simon, BMC Bioinformatics 7:91 (2006); Hesterberg, The American
Statistician 69 (2015), section 4 (expanded percentiles).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FEWEST = 6  # units: of 5 the sign of every one of them has a two-sided p of 1/16, above 5 %
RESAMPLES = 1999
LEVEL = 0.95
_SEED = (2008, 0x4E455354)
_AT_ONCE = 4_000_000  # numbers held of some resamples


@final
@dataclass(frozen=True)
class Scored:
    """The costs of settings on units: `paid` and `won`, shapes (settings, units); a smaller score is better.

    A score is ``sum(paid) / sum(won)``: a mean, where `won` is 1; with `log` its log10: for an ERT, `paid` is what the
    runs were charged and `won` how many reached the goal.
    """

    paid: Array
    won: Array
    log: bool

    def of(self, paid: Array, won: Array) -> Array:
        """Return the scores of sums; infinite where nothing was won."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(won > 0, paid / won, np.inf)
            return np.log10(ratio) if self.log else ratio


@final
@dataclass(frozen=True)
class Nested:
    """The value of choosing, in scores: `best` is the setting chosen on all units, with its `apparent` score.

    `chosen`, shape (units,), is the setting that was chosen with each unit left out. `default` is None, and `gain` with
    its interval NaN, where the sweep does not hold the default.
    """

    scores: Array
    best: int
    apparent: float
    nested: float
    optimism: float
    optimism_interval: tuple[float, float]
    chosen: NDArray[np.int64]
    default: int | None
    gain: float
    gain_interval: tuple[float, float]

    @property
    def beats_default(self) -> bool:
        """Tell whether the interval of the gain is above 0."""
        return self.gain_interval[0] > 0

    @property
    def is_told_apart(self) -> bool:
        """Tell whether the interval of the gain excludes 0."""
        return self.gain_interval[0] > 0 or self.gain_interval[1] < 0


def nest(scored: Scored, default: int | None, resamples: int = RESAMPLES) -> Nested:
    """Return what choosing a setting is worth; of settings that are alike the first is chosen.

    Raises `ValueError` for fewer than two settings or `FEWEST` units.
    """
    settings, units = scored.paid.shape
    if settings < 2 or units < FEWEST:
        raise ValueError(f"{settings} settings on {units} units: 2 settings and {FEWEST} units are needed")
    apparent, nested, gain, chosen = _once(scored, np.ones((1, units)), default)
    scores = scored.of(scored.paid.sum(axis=1), scored.won.sum(axis=1))
    optimism, more = _intervals(scored, default, resamples)
    return Nested(
        scores=scores,
        best=int(np.argmin(scores)),
        apparent=float(apparent[0]),
        nested=float(nested[0]),
        optimism=float(_less(nested, apparent)[0]),
        optimism_interval=optimism,
        chosen=chosen[0],
        default=default,
        gain=float(gain[0]),
        gain_interval=more,
    )


def _once(scored: Scored, weight: Array, default: int | None) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """Return apparent, nested, gain, shapes (resamples,), and what was chosen, shape (resamples, units).

    `weight`, shape (resamples, units), says how often each unit is there; all its copies are left out together.
    """
    units = np.arange(scored.paid.shape[1])
    paid, won = weight @ scored.paid.T, weight @ scored.won.T  # (resamples, settings)
    left_paid = paid[:, :, None] - weight[:, None, :] * scored.paid
    left_won = won[:, :, None] - weight[:, None, :] * scored.won
    chosen = np.argmin(scored.of(left_paid, left_won), axis=1)
    nested = scored.of(
        (weight * scored.paid[chosen, units]).sum(axis=1), (weight * scored.won[chosen, units]).sum(axis=1)
    )
    scores = scored.of(paid, won)
    gain = np.full(len(weight), np.nan) if default is None else _less(scores[:, default], nested)
    return scores.min(axis=1), nested, gain, chosen


def _less(a: Array, b: Array) -> Array:
    """Return a - b; NaN where both are infinite."""
    with np.errstate(invalid="ignore"):
        return a - b


def _intervals(scored: Scored, default: int | None, resamples: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the intervals of optimism and gain."""
    settings, units = scored.paid.shape
    drawn = _draws(units, resamples)
    each = max(1, _AT_ONCE // (settings * units))
    optimism, gain = [], []
    for first in range(0, len(drawn), each):
        apparent, nested, more, _ = _once(scored, drawn[first : first + each], default)
        optimism.append(_less(nested, apparent))
        gain.append(more)
    none = (float("nan"), float("nan"))
    return _ends(np.concatenate(optimism), units), none if default is None else _ends(np.concatenate(gain), units)


def _draws(units: int, resamples: int) -> Array:
    """Return how often each unit is drawn in each resample; one unit alone leaves nothing to choose on."""
    rng = np.random.default_rng(np.random.SeedSequence([*_SEED, units]))
    drawn = rng.multinomial(units, np.full(units, 1 / units), size=resamples).astype(float)
    return np.asarray(drawn[(drawn > 0).sum(axis=1) > 1])


def _ends(values: Array, units: int) -> tuple[float, float]:
    """Return the expanded percentiles of resampled values, shape (resamples,); one that is not known widens both."""
    from scipy.stats import norm, t

    reach = np.sqrt(units / (units - 1)) * t.ppf((1 + LEVEL) / 2, units - 1)
    tail = float(norm.sf(reach))
    first = int(np.floor(tail * (len(values) - 1)))
    low = np.sort(np.where(np.isnan(values), -np.inf, values))[first]
    high = np.sort(np.where(np.isnan(values), np.inf, values))[len(values) - 1 - first]
    return float(low), float(high)
