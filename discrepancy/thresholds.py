"""`Thresholds`: the numbers at which the search decides, in one place, each with its unit, its meaning and its origin.

The rate of false alarms is not among them: it is the argument `level` of `explain`. `explain(...,
thresholds=replace(THRESHOLDS, close=3.0))` searches with another value; inside a search, code asks `thresholds()`. The
cost of each (rates of false alarms, right names and sets at half and twice its value) is measured by ``python -m
benchmarks thresholds`` and stands in docs/thresholds.md. Numbers that depend on a machine (how far a gauge can lean,
how far legs may miss each other) stand with the machine; steps, tolerances and block sizes of an algorithm stand with
the algorithm.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import Field, dataclass, field, fields
from typing import Any, final

JUDGED = "judged while the procedure was built on simulated cases"
CONVENTION = "the usual value"
MEASURED = "chosen on parts of three measured series of an arm"
NUMERICAL = "rounding, memory or time: no verdict should hang on it"


def _of(value: float, unit: str, meaning: str, chosen: str) -> Any:
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "chosen": chosen})


@final
@dataclass(frozen=True)
class Thresholds:
    """The numbers at which the search decides. `about` tells the unit, the meaning and the origin of each."""

    # Noise, as repeats tell it
    repeat_pairs: int = _of(
        10, "pairs",
        "least number of differences between repeats that is used to estimate the noise; with fewer, the "
        "statement stands", JUDGED,
    )  # fmt: skip
    noises_differ: float = _of(
        0.01, "p",
        "columns of one instrument, of unknown noise, have one common noise unless the p of equal noise "
        "is below this; so equal noise is split by chance in one of a hundred runs, and an unequal one is "
        "pooled where readings are few", CONVENTION,
    )  # fmt: skip
    statement_doubt: float = _of(
        4.0, "2 log L",
        "gain in log-likelihood at which separated visits show that the stated noise is wrong", JUDGED,
    )  # fmt: skip
    statement_useless: float = _of(
        4.0, "variance",
        "repeats scatter by this many times the stated variance: the statement is not used any more", JUDGED,
    )  # fmt: skip
    tails_gain: float = _of(
        7.0, "2 log L",
        "log-likelihood that a t law must gain over a Gaussian for the noise to have heavy tails", JUDGED,
    )  # fmt: skip
    calmer: float = _of(
        0.97, "1",
        "noise is estimated again from repeats after a finding; below this part of the noise before, the "
        "new value is used", JUDGED,
    )  # fmt: skip
    correlation_kept: float = _of(
        0.001, "1",
        "smallest correlation between two readings that whitening takes into account", NUMERICAL,
    )  # fmt: skip
    residual_cut: float = _of(
        2.0, "core",
        "size beyond which a residual of heavy-tailed noise is clipped (Huber), in scales of the t law", CONVENTION,
    )  # fmt: skip
    scatter_asked: float = _of(
        2.5, "variance",
        "where repeats scatter within this factor of the stated variance, the noise of each kind of "
        "sensor is not estimated", JUDGED,
    )  # fmt: skip
    scale_ratio: float = _of(
        3.0, "1",
        "ratio between the estimated scales of two kinds of sensors above which the stated noise is "
        "corrected", JUDGED,
    )  # fmt: skip
    scale_tails: float = _of(
        5.0, "degrees of freedom",
        "of the t law under which those scales are fitted, so that single bad readings do not decide", JUDGED,
    )  # fmt: skip

    # Noise that is blamed
    wild_gain_all: float = _of(
        9.0, "2 log L",
        "gain of the law with wild readings over laws without, for all sensors of a kind together, at "
        "which they are reported", JUDGED,
    )  # fmt: skip
    wild_gain_one: float = _of(10.0, "2 log L", "the same gain for one sensor, the worst of its kind", JUDGED)
    wild_moment: float = _of(
        0.03, "part of the run",
        "part left out around the largest change: a step shows only there, wild readings show everywhere", JUDGED,
    )  # fmt: skip
    wild_elsewhere: float = _of(
        0.5, "1",
        "part of the two gains above that the rest of the run must have without that moment", JUDGED,
    )  # fmt: skip
    wild_share: float = _of(
        0.75, "1",
        "part of the outlying energy that one sensor must account for to be blamed alone", JUDGED,
    )  # fmt: skip
    wild_energy_most: float = _of(
        25.0, "variance",
        "most energy that one change contributes there, because a single wild reading does not tell the "
        "sensor", JUDGED,
    )  # fmt: skip
    wild_rival: float = _of(
        0.15, "weight",
        "weight at which the other explanation of wild readings (one sensor, or all) joins the set", JUDGED,
    )  # fmt: skip
    wide_core_all: float = _of(
        2.0, "standard errors",
        "the middle half of all changes must be wider than stated by this much to give the deviation "
        "instead", JUDGED,
    )  # fmt: skip
    wide_core_one: float = _of(3.0, "standard errors", "the same for the changes of one sensor", JUDGED)
    wild_size_gain: float = _of(
        8.0, "2 log L",
        "gain above which the size of outlying readings is fitted to repeats instead of to residuals", JUDGED,
    )  # fmt: skip
    step_gain: float = _of(10.0, "2 log L", "gain that coarse steps of a sensor must have to be reported", JUDGED)
    off_step: float = _of(
        0.5, "stated standard deviation",
        "distance of values from whole steps above which the values are equally spaced poses with noise, "
        "not coarse readings", JUDGED,
    )  # fmt: skip

    # What can be seen
    visible: float = _of(
        0.0002, "part of the signature",
        "least part of a candidate's signature that calibration must leave for it to be tested", NUMERICAL,
    )  # fmt: skip
    smooth_visible: float = _of(
        0.03, "part of the signature",
        "the same for a direction of a smooth term, which is not tested where calibration absorbs nearly "
        "all of it", JUDGED,
    )  # fmt: skip
    invisible: float = _of(
        0.0001, "part of the signature",
        "below this part, what calibration leaves of a signature is rounding and curvature", NUMERICAL,
    )  # fmt: skip
    cancelled: float = _of(
        0.02, "part of the signature",
        "below this part, signatures of several quantities cancel each other but for errors of the "
        "covariates", JUDGED,
    )  # fmt: skip
    detect_level: float = _of(
        0.01, "p",
        "level, over all candidates, of the test that the smallest detectable size refers to", CONVENTION,
    )  # fmt: skip
    detect_power: float = _of(
        0.9, "probability",
        "power of the test that the smallest detectable size refers to", CONVENTION,
    )  # fmt: skip
    told_apart: float = _of(
        6.0, "chi-square",
        "by which the better of two names must explain more for a design to tell them apart", CONVENTION,
    )  # fmt: skip
    forms_looked_at: int = _of(
        5, "forms",
        "most forms of one name (places of a step, time constants) that a design computes", JUDGED,
    )  # fmt: skip
    confounded_times: float = _of(
        20.0, "1",
        "two parameters are confounded where each standard error is this many times that of their "
        "combination", JUDGED,
    )  # fmt: skip
    small_seen: float = _of(
        0.05, "part of the signature",
        "part of a direction that calibration must leave, for tests of a handful of readings", JUDGED,
    )  # fmt: skip

    # Tests and their draws
    drawn_rows: int = _of(
        4000, "rows",
        "with more rows, the smallest p of many tests is corrected by their number instead of by drawn "
        "noise", NUMERICAL,
    )  # fmt: skip
    drawn: int = _of(
        1000, "draws",
        "draws of noise in the same design, for the distribution of the smallest p", NUMERICAL,
    )  # fmt: skip
    tails_of: int = _of(50, "scores", "scores that are needed to tell whether their tails are heavy", JUDGED)
    tails_heavy: float = _of(
        1.0, "excess kurtosis", "of scores, above which they are clipped before the first test", JUDGED,
    )  # fmt: skip
    tails_cut: float = _of(
        4.0, "core", "size at which they are clipped: the largest at which t noise of 3 to 5 degrees keeps the level",
        MEASURED,
    )  # fmt: skip
    p_sure: float = _of(1e-06, "p", "a smallest p below this is significant without draws", NUMERICAL)
    p_calm: float = _of(
        0.01, "p",
        "a smallest p above this is not significant, without draws; below it, a place is reported in "
        "which something is left", CONVENTION,
    )  # fmt: skip
    share_names: float = _of(0.5, "1", "part of the level that is spent on tests of named effects", JUDGED)
    share_smooth: float = _of(0.3, "1", "part of the level that is spent on tests of smooth terms", JUDGED)
    share_misfit: float = _of(0.2, "1", "part of the level that is spent on the test of lack of fit", JUDGED)
    curve_terms: int = _of(7, "terms", "terms of a smooth curve over one covariate", JUDGED)
    map_terms: int = _of(5, "terms", "terms of a smooth map along each side of the workspace", JUDGED)

    # Selection
    close: float = _of(
        6.0, "delta BIC",
        "distance to the best name within which a rival stays in the set: odds of one in twenty", CONVENTION,
    )  # fmt: skip
    refit_within: float = _of(
        10.0, "delta BIC",
        "distance of the linear gain to the best one within which a candidate is fitted exactly", JUDGED,
    )  # fmt: skip
    refit_most: int = _of(
        12, "candidates",
        "most candidates that are fitted exactly at one step of the selection", NUMERICAL,
    )  # fmt: skip
    form: float = _of(
        0.001, "part of the gain",
        "of the best gain by which a candidate may be behind without being less likely, because no "
        "formula is exact", JUDGED,
    )  # fmt: skip
    bent: float = _of(
        0.2, "part of the signature",
        "below this part, calibration absorbs so much that the linear gain is unreliable and the "
        "candidate is fitted exactly", JUDGED,
    )  # fmt: skip
    largest_angle: float = _of(
        0.3, "rad",
        "angle error beyond which a sensor would have been replaced, so no effect may have it", JUDGED,
    )  # fmt: skip
    largest_scale: float = _of(
        0.5, "1",
        "scale error beyond which a column is in another unit or not read, so no effect may have it", JUDGED,
    )  # fmt: skip
    largest_ratio: float = _of(0.2, "1", "largest error of a scale or a gear ratio that an effect may have", JUDGED)
    effects_most: int = _of(8, "effects", "most effects that are selected", JUDGED)
    exchanged_at_once: int = _of(
        3, "effects",
        "up to this many picks, all are exchanged after each new one; with more, only at the end", NUMERICAL,
    )  # fmt: skip
    pairs_most: int = _of(
        3, "pairs",
        "most pairs of picks that are exchanged two at a time, the least certain first", NUMERICAL,
    )  # fmt: skip
    pair_names: int = _of(
        20, "names",
        "of the best single names, all pairs are tried in the place of two picks; this is their number", NUMERICAL,
    )  # fmt: skip
    further_gain: float = _of(12.0, "delta BIC", "gain that a further effect must have", JUDGED)
    formula_error: float = _of(
        0.0225, "part of the gain",
        "an effect below this part of those before it may be the error of their formulas, which are off "
        "by up to .15 of their size", JUDGED,
    )  # fmt: skip
    form_off: float = _of(
        0.1, "part of the size",
        "largest rms error of a formula over its argument; errors of .3 and .6 times this are as likely", JUDGED,
    )  # fmt: skip
    form_odds: float = _of(
        6.0, "2 log odds",
        "odds, before the data, that a formula is exact and not off in its form: 20 to 1", JUDGED,
    )  # fmt: skip
    form_smooth: float = _of(
        0.7, "probability",
        "before the data, that the error of a formula is a smooth function of the place, where effects are functions "
        "of one; else it is anything of its size", JUDGED,
    )  # fmt: skip
    form_runaway: float = _of(
        10.0, "times the size without the form",
        "that an effect may have beside a form of it; if larger, effect and form cancel each other on the "
        "fitted rows", JUDGED,
    )  # fmt: skip
    form_share: float = _of(
        0.2, "part of the size",
        "change of an effect's size with a covariate, from which on the finding reports the change of "
        "size", JUDGED,
    )  # fmt: skip
    along_share: float = _of(
        0.02, "part of the size",
        "the same change along the way of the effect's own carriage, where its formula is a constant", JUDGED,
    )  # fmt: skip
    linear_hope: float = _of(
        0.25, "part of the gain",
        "of very many readings, exact fits are tried only if the linear gain reaches this part of the "
        "required one", JUDGED,
    )  # fmt: skip
    change_places: int = _of(40, "places", "places of a step that are scanned at once", NUMERICAL)
    change_hopeful: float = _of(
        0.5, "part of the largest gain",
        "a step is tried at the places between its scanned ones only if its gain there is above this part "
        "of the largest gain of all candidates; a larger value saves tests, and may leave a step at the "
        "wrong one of two readings", JUDGED,
    )  # fmt: skip
    change_edge: float = _of(
        0.04, "part of the run",
        "part at either end of the run in which no step is looked for, because single readings would "
        "decide it", JUDGED,
    )  # fmt: skip
    weight_left_out: float = _of(
        0.2, "weight",
        "total weight of unlikely members that may be left out of a set", JUDGED,
    )  # fmt: skip
    weight_left_out_few: float = _of(
        0.1, "weight",
        "the same where gains are inexact: residuals are few, or nothing tells the noise and forms are off over a "
        "place", JUDGED,
    )  # fmt: skip
    weight_left_out_untold: float = _of(
        0.05, "weight",
        "the same where also no repeats tell the noise: a set then leaves out one case of twenty", JUDGED,
    )  # fmt: skip
    few_degrees: int = _of(
        8, "degrees of freedom",
        "left by calibration; with at most so many the residuals' scatter tells no noise, so names are "
        "compared with the stated noise", JUDGED,
    )  # fmt: skip
    equations_each: float = _of(
        4.0, "equations",
        "with fewer for each calibrated parameter, and noise that nobody stated, a note says that names may not hold "
        "for other readings", MEASURED,
    )  # fmt: skip
    few_residuals: int = _of(150, "residuals", "with at most so many, gains are inexact", JUDGED)

    # Verdict
    explained: float = _of(
        0.85, "part of the excess",
        "part of the excess over the noise that names must explain", JUDGED,
    )  # fmt: skip
    explained_plain: float = _of(
        0.92, "part of the excess",
        "the same where the residual test after the search is below p_plain; with less, the verdict is "
        "partly", JUDGED,
    )  # fmt: skip
    explained_part: float = _of(
        0.7, "part of the excess",
        "part that names must explain with the catalogue's own formulas, where their sizes depend on a "
        "covariate", JUDGED,
    )  # fmt: skip
    explained_by_far: float = _of(
        0.5, "part of the excess",
        "part that names must explain where one of them gains `smooth_far` times as much as any smooth "
        "term", JUDGED,
    )  # fmt: skip
    p_plain: float = _of(0.0001, "p", "p of the residual test below which a misfit is clear", JUDGED)
    smooth_clearly: float = _of(
        6.0, "delta BIC",
        "by which smooth terms must gain more than the names for the verdict unknown", CONVENTION,
    )  # fmt: skip
    smooth_far: float = _of(
        2.5, "times the best name's gain",
        "a smooth term that gains this many times as much ends the search for names; a name that gains "
        "this many times as much as smooth terms stands", JUDGED,
    )  # fmt: skip
    floors_left: float = _of(
        1.5, "times the floor",
        "remaining error beyond which the names do not explain everything: the verdict is partly", CONVENTION,
    )  # fmt: skip
    smooth_beside: int = _of(3, "terms", "least number of smooth functions that names are compared with", JUDGED)
    matters: float = _of(0.15, "sigma", "visible size below which a finding is negligible", JUDGED)

    # The fallback model, and validation
    smooth_most: int = _of(5, "components", "most components of a smooth correction", JUDGED)
    smooth_gain: float = _of(2.0, "log L", "gain that a component must have", JUDGED)
    smooth_sure: float = _of(
        1.0, "standard errors",
        "by which a component must predict left-out poses better, over poses", JUDGED,
    )  # fmt: skip
    folds: int = _of(5, "folds", "parts of a cross-validation, of whole poses each", CONVENTION)
    floor_unseen: float = _of(
        5.0, "times the noise",
        "that noise alone may leave on readings left out of a fit; if more, so few readings predict no "
        "others", JUDGED,
    )  # fmt: skip
    bootstrap_draws: int = _of(1000, "draws", "draws of whole poses, for the interval of the held-out error", NUMERICAL)

    # Very many readings
    many_readings: int = _of(
        10_000, "readings",
        "from this number on, a part of the readings is fitted and screened first", NUMERICAL,
    )  # fmt: skip
    part_readings: int = _of(4000, "readings", "readings of that part", NUMERICAL)
    step_still: float = _of(0.0001, "sigma", "rms of the last step of a fit that has converged", NUMERICAL)
    step_nearly: float = _of(
        0.01, "sigma",
        "the same for very many readings, whose next step would be a thousandth of it", NUMERICAL,
    )  # fmt: skip
    behind_errors: float = _of(
        6.0, "standard errors",
        "a candidate is screened out only if it is behind the best by at least this many standard errors", JUDGED,
    )  # fmt: skip
    behind_share: float = _of(
        0.03, "part of the gain",
        "part of the best gain by which it must be behind as well", JUDGED,
    )  # fmt: skip
    behind_share_placed: float = _of(
        0.2, "part of the gain",
        "the same part for a step, because its place is refined later", JUDGED,
    )  # fmt: skip


THRESHOLDS = Thresholds()
_CURRENT: ContextVar[Thresholds] = ContextVar("thresholds", default=THRESHOLDS)


def thresholds() -> Thresholds:
    """Return the thresholds of the search that is under way; `THRESHOLDS` outside of one."""
    return _CURRENT.get()


@contextmanager
def using(chosen: Thresholds) -> Iterator[None]:
    """Decide by `chosen` inside the block."""
    before = _CURRENT.set(chosen)
    try:
        yield
    finally:
        _CURRENT.reset(before)


def about() -> dict[str, Field[Any]]:
    """Return name -> field; its `metadata` has `unit`, `meaning` and `chosen`, its `default` the value."""
    return {one.name: one for one in fields(Thresholds)}
