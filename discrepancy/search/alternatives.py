"""Add alternatives that are tested only beside a selected effect.

Some causes are too unlikely to be searched for. Others have nearly the signature of a likelier cause, so that a test of
their own would add nothing. The search does not try them. But where such a cause explains the data as well as the
effect that was named, the name alone would be a guess: the set holds both.
"""

from __future__ import annotations

from collections.abc import Sequence

from calibench.discrepancy.diagnostics.score import projected_scores, score_all
from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.model.effect import Alternative
from calibench.discrepancy.search.select import Option, delta_bic, fit_with, option
from calibench.discrepancy.thresholds import thresholds

Sets = tuple[tuple[Option, ...], ...]


def with_alternatives(sets: Sets, base: Fit, beside: Sequence[Alternative]) -> Sets:
    """Return the sets of all picks, each with those of `beside` that gain nearly as much as its first name, or more."""
    if not beside:
        return sets
    limits = {b.effect: b.largest for b in beside}
    found = []
    for one in sets:
        without = fit_with(base, [s[0].effect for s in sets if s is not one])
        on = projected_scores(without)
        first = one[0].gain
        scored = [
            s
            for s, _ in score_all(without, on, list(limits))
            if s.m and delta_bic(s, on) > first - thresholds().refit_within
        ]
        fitted = [option(without, s, on) for s in scored]
        close = [o for o in fitted if o.gain > first - thresholds().close and o.amplitude <= limits[o.effect]]
        found.append((*one, *close))
    return tuple(found)
