"""`Thresholds`: the numbers at which the search decides, in one place, each with its unit, its meaning and its origin.

The rate of false alarms is not among them: it is the argument `level` of `explain`. `explain(...,
thresholds=replace(THRESHOLDS, close=3.0))` searches with another value; inside a search, code asks `thresholds()`. The
cost of each (rates of false alarms, right names and sets at half and twice its value) is measured by ``python -m
benchmarks thresholds`` and stands in docs/thresholds.md. Numbers that depend on a machine (how far a gauge can lean,
how far legs may miss each other) stand with the machine; steps, tolerances and block sizes of an algorithm stand with
the algorithm.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import Field, dataclass, field, fields
from typing import Any, final

JUDGED = "judged while the procedure was built on simulated cases"
CONVENTION = "the usual value"
MEASURED = "chosen on parts of three measured series of an arm"
NUMERICAL = "rounding, memory or time: no verdict should hang on it"


def _of(value: float, chosen: str, unit: str, meaning: str) -> Any:
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "chosen": chosen})


@final
@dataclass(frozen=True)
class Thresholds:
    """The numbers at which the search decides. `about` tells the unit, the meaning and the origin of each."""

    # Noise, as repeats tell it
    repeat_pairs: int = _of(10, JUDGED, "pairs", "least number of differences between repeats that is used to estimate "
        "the noise; with fewer, the statement stands")  # fmt: skip
    noises_differ: float = _of(0.01, CONVENTION, "p", "columns of one instrument, of unknown noise, have one common "
        "noise unless the p of equal noise is below this; so equal noise is split by chance in one of a hundred runs, "
        "and an unequal one is pooled where readings are few")  # fmt: skip
    statement_doubt: float = _of(4.0, JUDGED, "2 log L", "gain in log-likelihood at which separated visits show that "
        "the stated noise is wrong")  # fmt: skip
    statement_useless: float = _of(4.0, JUDGED, "variance", "repeats scatter by this many times the stated variance: "
        "the statement is not used any more")  # fmt: skip
    tails_gain: float = _of(7.0, JUDGED, "2 log L", "log-likelihood that a t law must gain over a Gaussian for the "
        "noise to have heavy tails")  # fmt: skip
    calmer: float = _of(0.97, JUDGED, "1", "noise is estimated again from repeats after a finding; below this part of "
        "the noise before, the new value is used")  # fmt: skip
    correlation_kept: float = _of(0.001, NUMERICAL, "1", "smallest correlation between two readings that whitening "
        "takes into account")  # fmt: skip
    residual_cut: float = _of(2.0, CONVENTION, "core", "size beyond which a residual of heavy-tailed noise is clipped "
        "(Huber), in scales of the t law")  # fmt: skip
    scatter_asked: float = _of(2.5, JUDGED, "variance", "where repeats scatter within this factor of the stated "
        "variance, the noise of each kind of sensor is not estimated")  # fmt: skip
    scale_ratio: float = _of(3.0, JUDGED, "1", "ratio between the estimated scales of two kinds of sensors above which "
        "the stated noise is corrected")  # fmt: skip
    scale_tails: float = _of(5.0, JUDGED, "degrees of freedom", "of the t law under which those scales are fitted, so "
        "that single bad readings do not decide")  # fmt: skip

    # Noise that is blamed
    wild_gain_all: float = _of(9.0, JUDGED, "2 log L", "gain of the law with wild readings over laws without, for all "
        "sensors of a kind together, at which they are reported")  # fmt: skip
    wild_gain_one: float = _of(10.0, JUDGED, "2 log L", "the same gain for one sensor, the worst of its kind")
    wild_moment: float = _of(0.03, JUDGED, "part of the run", "part left out around the largest change: a step shows "
        "only there, wild readings show everywhere")  # fmt: skip
    wild_elsewhere: float = _of(0.5, JUDGED, "1", "part of the two gains above that the rest of the run must have "
        "without that moment")  # fmt: skip
    wild_share: float = _of(0.75, JUDGED, "1", "part of the outlying energy that one sensor must account for to be "
        "blamed alone")  # fmt: skip
    wild_energy_most: float = _of(25.0, JUDGED, "variance", "most energy that one change contributes there, because a "
        "single wild reading does not tell the sensor")  # fmt: skip
    wild_rival: float = _of(0.15, JUDGED, "weight", "weight at which the other explanation of wild readings (one "
        "sensor, or all) joins the set")  # fmt: skip
    wild_carried: float = _of(0.005, CONVENTION, "p", "p that far readings lie anywhere, over their order and all "
        "columns, below which they are no noise: something that is missing carries them")  # fmt: skip
    wide_core_all: float = _of(2.0, JUDGED, "standard errors", "the middle half of all changes must be wider than "
        "stated by this much to give the deviation instead")  # fmt: skip
    wide_core_one: float = _of(3.0, JUDGED, "standard errors", "the same for the changes of one sensor")
    wild_size_gain: float = _of(8.0, JUDGED, "2 log L", "gain above which the size of outlying readings is fitted to "
        "repeats instead of to residuals")  # fmt: skip
    step_gain: float = _of(10.0, JUDGED, "2 log L", "gain that coarse steps of a sensor must have to be reported")
    off_step: float = _of(0.5, JUDGED, "stated standard deviation", "distance of values from whole steps above which "
        "the values are equally spaced poses with noise, not coarse readings")  # fmt: skip

    # What can be seen
    visible: float = _of(0.0002, NUMERICAL, "part of the signature", "least part of a candidate's signature that "
        "calibration must leave for it to be tested")  # fmt: skip
    smooth_visible: float = _of(0.03, JUDGED, "part of the signature", "the same for a direction of a smooth term, "
        "which is not tested where calibration absorbs nearly all of it")  # fmt: skip
    invisible: float = _of(0.0001, NUMERICAL, "part of the signature", "below this part, what calibration leaves of a "
        "signature is rounding and curvature")  # fmt: skip
    cancelled: float = _of(0.02, JUDGED, "part of the signature", "below this part, signatures of several quantities "
        "cancel each other but for errors of the covariates")  # fmt: skip
    detect_level: float = _of(0.01, CONVENTION, "p", "level, over all candidates, of the test that the smallest "
        "detectable size refers to")  # fmt: skip
    detect_power: float = _of(0.9, CONVENTION, "probability", "power of the test that the smallest detectable size "
        "refers to")  # fmt: skip
    told_apart: float = _of(6.0, CONVENTION, "chi-square", "by which the better of two names must explain more for a "
        "design to tell them apart")  # fmt: skip
    forms_looked_at: int = _of(5, JUDGED, "forms", "most forms of one name (places of a step, time constants) that a "
        "design computes")  # fmt: skip
    small_seen: float = _of(0.05, JUDGED, "part of the signature", "part of a direction that calibration must leave, "
        "for tests of a handful of readings")  # fmt: skip

    # Tests and their draws
    drawn_rows: int = _of(4000, NUMERICAL, "rows", "with more rows, the smallest p of many tests is corrected by their "
        "number instead of by drawn noise")  # fmt: skip
    drawn: int = _of(1000, NUMERICAL, "draws", "draws of noise in the same design, for the distribution of the "
        "smallest p")  # fmt: skip
    tails_of: int = _of(50, JUDGED, "scores", "scores that are needed to tell whether their tails are heavy")
    tails_heavy: float = _of(1.0, JUDGED, "excess kurtosis", "of scores, above which they are clipped before the first "
        "test")  # fmt: skip
    tails_cut: float = _of(4.0, MEASURED, "core", "size at which they are clipped: the largest at which t noise of 3 "
        "to 5 degrees keeps the level")  # fmt: skip
    p_sure: float = _of(1e-06, NUMERICAL, "p", "a smallest p below this is significant without draws")
    p_calm: float = _of(0.01, CONVENTION, "p", "a smallest p above this is not significant, without draws; below it, a "
        "place is reported in which something is left")  # fmt: skip
    share_names: float = _of(0.4, JUDGED, "1", "part of the level that is spent on tests of named effects")
    share_smooth: float = _of(0.2, JUDGED, "1", "part of the level that is spent on tests of smooth terms")
    share_misfit: float = _of(0.1, JUDGED, "1", "part of the level that is spent on the test of lack of fit")
    curve_terms: int = _of(7, JUDGED, "terms", "terms of a smooth curve over one covariate")
    map_terms: int = _of(5, JUDGED, "terms", "terms of a smooth map along each side of the workspace")

    # Selection
    close: float = _of(6.0, CONVENTION, "delta BIC", "distance to the best name within which a rival stays in the set: "
        "odds of one in twenty")  # fmt: skip
    refit_within: float = _of(10.0, JUDGED, "delta BIC", "distance of the linear gain to the best one within which a "
        "candidate is fitted exactly")  # fmt: skip
    refit_most: int = _of(12, NUMERICAL, "candidates", "most candidates that are fitted exactly at one step of the "
        "selection")  # fmt: skip
    form: float = _of(0.001, JUDGED, "part of the gain", "of the best gain by which a candidate may be behind without "
        "being less likely, because no formula is exact")  # fmt: skip
    bent: float = _of(0.2, JUDGED, "part of the signature", "below this part, calibration absorbs so much that the "
        "linear gain is unreliable and the candidate is fitted exactly")  # fmt: skip
    largest_angle: float = _of(0.3, JUDGED, "rad", "angle error beyond which a sensor would have been replaced, so no "
        "effect may have it")  # fmt: skip
    largest_scale: float = _of(0.5, JUDGED, "1", "scale error beyond which a column is in another unit or not read, so "
        "no effect may have it")  # fmt: skip
    largest_ratio: float = _of(0.2, JUDGED, "1", "largest error of a scale, a gear ratio or, in rods, a delta's length")
    largest_play: float = _of(0.05, JUDGED, "rad", "play of a drive: 3 degrees are seen by the eye and felt by the "
        "hand, so no effect may have more")  # fmt: skip
    largest_windup: float = _of(0.05, JUDGED, "rad", "by which the largest torque that was met may twist a drive, or "
        "lean a bearing: one that its own load moves further holds no position")  # fmt: skip
    softest_drive: float = _of(1e-5, CONVENTION, "rad/(N mm)", "largest compliance of a drive: about that of the "
        "smallest strain-wave gears sold, 100 N m a radian")  # fmt: skip
    largest_lag: float = _of(0.5, JUDGED, "s", "by which a reading may be late: instruments and filters answer in "
        "tenths of a second")  # fmt: skip
    largest_delay: float = _of(0.25, JUDGED, "of a trial", "by which a simulator's output may be late, in place of "
        "`largest_lag`: processes differ in speed")  # fmt: skip
    largest_growth: float = _of(0.001, CONVENTION, "1/K", "growth of a member: five times that of polyethylene, "
        "which grows more than all that machines are made of")  # fmt: skip
    largest_warm_zero: float = _of(0.003, JUDGED, "rad/K", "by which one kelvin may move the zero of a joint: a "
        "sixth of a degree")  # fmt: skip
    largest_strain: float = _of(0.02, CONVENTION, "part of the length", "by which the largest force that was met, or "
        "play, may change a member: metals yield at a tenth of it")  # fmt: skip
    effects_most: int = _of(8, JUDGED, "effects", "most effects that are selected")
    exchanged_at_once: int = _of(3, NUMERICAL, "effects", "up to this many picks, all are exchanged after each new "
        "one; with more, only at the end")  # fmt: skip
    pairs_most: int = _of(3, NUMERICAL, "pairs", "most pairs of picks that are exchanged two at a time, the least "
        "certain first")  # fmt: skip
    pair_names: int = _of(20, NUMERICAL, "names", "of the best single names, all pairs are tried in the place of two "
        "picks; this is their number")  # fmt: skip
    further_gain: float = _of(12.0, JUDGED, "delta BIC", "gain that a further effect must have")
    formula_error: float = _of(0.0225, JUDGED, "part of the gain", "an effect below this part of those before it may "
        "be the error of their formulas, which are off by up to .15 of their size")  # fmt: skip
    form_off: float = _of(0.1, JUDGED, "part of the size", "largest rms error of a formula over its argument; errors "
        "of .3 and .6 times this are as likely")  # fmt: skip
    form_odds: float = _of(6.0, JUDGED, "2 log odds", "odds, before the data, that a formula is exact and not off in "
        "its form: 20 to 1")  # fmt: skip
    form_smooth: float = _of(0.7, JUDGED, "probability", "before the data, that the error of a formula is a smooth "
        "function of the place, where effects are functions of one; else it is anything of its size")  # fmt: skip
    form_runaway: float = _of(10.0, JUDGED, "times the size without the form", "that an effect may have beside a form "
        "of it; if larger, effect and form cancel each other on the fitted rows")  # fmt: skip
    form_share: float = _of(0.2, JUDGED, "part of the size", "change of an effect's size with a covariate, from which "
        "on the finding reports the change of size")  # fmt: skip
    along_share: float = _of(0.02, JUDGED, "part of the size", "the same change along the way of the effect's own "
        "carriage, where its formula is a constant")  # fmt: skip
    change_places: int = _of(40, NUMERICAL, "places", "places of a step that are scanned at once")
    change_hopeful: float = _of(0.5, JUDGED, "part of the largest gain", "a step is tried at the places between its "
        "scanned ones only if its gain there is above this part of the largest gain of all candidates; a larger value "
        "saves tests, and may leave a step at the wrong one of two readings")  # fmt: skip
    change_edge: float = _of(0.04, JUDGED, "part of the run", "part at either end of the run in which no step is "
        "looked for, because single readings would decide it")  # fmt: skip
    weight_left_out: float = _of(0.2, JUDGED, "weight", "total weight of unlikely members that may be left out of a "
        "set")  # fmt: skip
    weight_left_out_few: float = _of(0.1, JUDGED, "weight", "the same where gains are inexact: residuals are few, or "
        "nothing tells the noise and forms are off over a place")  # fmt: skip
    weight_left_out_untold: float = _of(0.05, JUDGED, "weight", "the same where also no repeats tell the noise: a set "
        "then leaves out one case of twenty")  # fmt: skip
    few_degrees: int = _of(8, JUDGED, "degrees of freedom", "left by calibration; with at most so many the residuals' "
        "scatter tells no noise, so names are compared with the stated noise")  # fmt: skip
    equations_each: float = _of(4.0, MEASURED, "equations", "with fewer for each calibrated parameter, and noise that "
        "nobody stated, a note says that names may not hold for other readings")  # fmt: skip
    few_residuals: int = _of(150, JUDGED, "residuals", "with at most so many, gains are inexact")

    course: float = _of(0.9, JUDGED, "part of the variance", "of a smooth function over what was met that a formula "
        "must have, to be named though the rest has no name")  # fmt: skip
    shuffles: int = _of(99, CONVENTION, "shuffles", "of the order, direction or time of rows that are alike "
        "otherwise, by which a name that lives on these is tested")  # fmt: skip
    shuffled_p: float = _of(0.05, CONVENTION, "p", "part of the shuffles in which as much is explained, above which "
        "such a name is none")  # fmt: skip

    # Verdict
    explained: float = _of(0.85, JUDGED, "part of the excess", "part of the excess over the noise that names must "
        "explain")  # fmt: skip
    explained_plain: float = _of(0.92, JUDGED, "part of the excess", "the same where the residual test after the "
        "search is below p_plain; with less, the verdict is partly")  # fmt: skip
    explained_part: float = _of(0.7, JUDGED, "part of the excess", "part that names must explain with the catalogue's "
        "own formulas, where their sizes depend on a covariate")  # fmt: skip
    explained_by_far: float = _of(0.5, JUDGED, "part of the excess", "part that names must explain where one of them "
        "gains `smooth_far` times as much as any smooth term")  # fmt: skip
    p_plain: float = _of(0.0001, JUDGED, "p", "p of the residual test below which a misfit is clear")
    smooth_clearly: float = _of(6.0, CONVENTION, "delta BIC", "by which smooth terms must gain more than the names for "
        "the verdict unknown")  # fmt: skip
    smooth_far: float = _of(2.5, JUDGED, "times the best name's gain", "a smooth term that gains this many times as "
        "much ends the search for names; a name that gains this many times as much as smooth terms stands")  # fmt: skip
    floors_left: float = _of(1.5, CONVENTION, "times the floor", "remaining error beyond which the names do not "
        "explain everything: the verdict is partly")  # fmt: skip
    smooth_beside: int = _of(3, JUDGED, "terms", "least number of smooth functions that names are compared with")
    matters: float = _of(0.15, JUDGED, "sigma", "visible size below which a finding is negligible")

    # The fallback model, and validation
    smooth_most: int = _of(5, JUDGED, "components", "most components of a smooth correction")
    smooth_gain: float = _of(2.0, JUDGED, "log L", "gain that a component must have")
    smooth_sure: float = _of(1.0, JUDGED, "standard errors", "by which a component must predict left-out poses better, "
        "over poses")  # fmt: skip
    folds: int = _of(5, CONVENTION, "folds", "parts of a cross-validation, of whole poses each")
    floor_unseen: float = _of(5.0, JUDGED, "times the noise", "that noise alone may leave on readings left out of a "
        "fit; if more, so few readings predict no others")  # fmt: skip
    bootstrap_draws: int = _of(1000, NUMERICAL, "draws", "draws of whole poses, for the interval of the held-out error")

    # Very many readings
    searched_rows: int = _of(3000, NUMERICAL, "rows", "that a search fits, spread over the run where there are more: "
        "in so many an effect of the size `matters` is eight standard errors from nothing")  # fmt: skip
    step_still: float = _of(0.0001, NUMERICAL, "sigma", "rms of the last step of a fit that has converged")


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
