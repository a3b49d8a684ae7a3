"""`Thresholds`: the numbers at which the search decides, in one place, with its unit, its meaning and its origin.

The rate of false alarms is not among them: it is the argument `level` of `explain`.
`explain(..., thresholds=replace(THRESHOLDS, close=3.0))` searches with another one; inside a search the rooms ask
`thresholds()`. What each costs (rates of false alarms, right names and sets at half and twice its value) is measured by
``python -m benchmarks thresholds``, and stands in docs/thresholds.md. What only a machine knows (how far a gauge can
lean, how far legs may miss each other) stands with the machine; steps, tolerances and block sizes of an algorithm stand
with the algorithm.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import Field, dataclass, field, fields
from typing import Any, final

JUDGED = "judged while the procedure was built on simulated cases"
CONVENTION = "the usual value"
NUMERICAL = "rounding, memory or time: no verdict should hang on it"


def _of(value: float, unit: str, meaning: str, chosen: str) -> Any:
    return field(default=value, metadata={"unit": unit, "meaning": meaning, "chosen": chosen})


@final
@dataclass(frozen=True)
class Thresholds:
    """The numbers at which the search decides. `about` tells the unit, the meaning and the origin of each."""

    # Noise, as repeats tell it
    repeat_pairs: int = _of(10, "pairs", "differences between repeats from which on they tell of the noise", JUDGED)
    noises_differ: float = _of(
        0.01, "p", "below which columns of one instrument, of unknown noise, have each a noise of its own", CONVENTION
    )  # fmt: skip
    statement_doubt: float = _of(
        4.0, "2 log L",
        "log-likelihood that it takes to hold the stated noise for wrong", JUDGED,
    )  # fmt: skip
    statement_useless: float = _of(
        4.0, "variance",
        "times the stated variance, from which on the statement says nothing", JUDGED,
    )  # fmt: skip
    tails_gain: float = _of(7.0, "2 log L", "log-likelihood that a heavier tail must bring over a Gaussian", JUDGED)
    calmer: float = _of(
        0.97, "1",
        "times the noise that repeats told, below which they are asked again after something was found", JUDGED,
    )  # fmt: skip
    correlation_kept: float = _of(
        0.001, "1",
        "correlation between readings below which it is taken for none", NUMERICAL,
    )  # fmt: skip
    residual_cut: float = _of(
        2.0, "core",
        "size beyond which a residual of heavy-tailed noise is clipped (Huber)", CONVENTION,
    )  # fmt: skip
    scatter_asked: float = _of(
        2.5, "variance",
        "times the stated variance, or one part in so many, within which one statement for all is kept", JUDGED,
    )  # fmt: skip
    scale_ratio: float = _of(
        3.0, "1",
        "ratio of the scales of two kinds of sensors from which on the statement is not believed", JUDGED,
    )  # fmt: skip
    scale_tails: float = _of(
        5.0, "degrees of freedom",
        "tails of the law under which those scales are fitted: single bad readings do not decide", JUDGED,
    )  # fmt: skip

    # Noise that is blamed
    wild_gain_all: float = _of(
        9.0, "2 log L",
        "gain of wild readings among all sensors of a kind over any law of the stated variance", JUDGED,
    )  # fmt: skip
    wild_gain_one: float = _of(10.0, "2 log L", "the same of one sensor, the worst of its kind", JUDGED)
    wild_moment: float = _of(
        0.03, "part of the run",
        "part left out around the largest change: a step is there and then, wild readings are anywhere", JUDGED,
    )  # fmt: skip
    wild_elsewhere: float = _of(0.5, "1", "part of the gain that the rest of the run must have", JUDGED)
    wild_share: float = _of(
        0.75, "1",
        "part of the outlying energy that one sensor must account for to be blamed", JUDGED,
    )  # fmt: skip
    wild_energy_most: float = _of(
        25.0, "variance",
        "of it from one change: a single wild reading does not say whose fault they all are", JUDGED,
    )  # fmt: skip
    wild_rival: float = _of(
        0.15, "weight",
        "weight from which on the other account of wild readings stands in the set", JUDGED,
    )  # fmt: skip
    wide_core_all: float = _of(
        2.0, "standard errors",
        "from which on the middle half of all changes is wider than stated", JUDGED,
    )  # fmt: skip
    wide_core_one: float = _of(3.0, "standard errors", "the same of one sensor", JUDGED)
    wild_size_gain: float = _of(
        8.0, "2 log L",
        "gain from which on repeats say how far off the outlying readings are", JUDGED,
    )  # fmt: skip
    step_gain: float = _of(10.0, "2 log L", "gain below which coarse steps do not matter", JUDGED)
    off_step: float = _of(
        0.5, "stated standard deviation",
        "distance from whole steps from which on equally spaced readings are a plan and its noise, and no coarse steps",
        JUDGED,
    )  # fmt: skip

    # What can be seen
    visible: float = _of(
        0.0002, "part of the signature",
        "least part of a candidate that calibration must leave for it to be tested", NUMERICAL,
    )  # fmt: skip
    smooth_visible: float = _of(
        0.03, "part of the signature",
        "the same of a direction of a smooth term: what calibration all but absorbs is no place to look", JUDGED,
    )  # fmt: skip
    invisible: float = _of(
        0.0001, "part of the signature",
        "below, what is left is rounding and curvature", NUMERICAL,
    )  # fmt: skip
    cancelled: float = _of(
        0.02, "part of the signature",
        "below, signatures of several quantities cancel to what the covariates are wrong by", JUDGED,
    )  # fmt: skip
    detect_level: float = _of(
        0.01, "p",
        "level of the test, over all candidates, of which the smallest detectable size is told", CONVENTION,
    )  # fmt: skip
    detect_power: float = _of(0.9, "probability", "power of that test", CONVENTION)
    told_apart: float = _of(
        6.0, "chi-square",
        "by which the better of two names must explain more for them to be told apart", CONVENTION,
    )  # fmt: skip
    forms_looked_at: int = _of(
        5, "forms",
        "of one name (places of a step, time constants) that a design looks at", JUDGED,
    )  # fmt: skip
    confounded_times: float = _of(
        20.0, "1",
        "how much wider the standard error of either of two parameters is than that of their combination", JUDGED,
    )  # fmt: skip
    small_seen: float = _of(
        0.05, "part of the signature",
        "part that calibration must leave of a direction of a handful of readings", JUDGED,
    )  # fmt: skip

    # Tests and their draws
    drawn_rows: int = _of(
        4000, "rows",
        "beyond, the smallest p of many tests is charged by their number instead of drawn noise", NUMERICAL,
    )  # fmt: skip
    drawn: int = _of(1000, "draws", "of noise in the same design, for the law of the smallest p", NUMERICAL)
    p_sure: float = _of(1e-06, "p", "below, a smallest p decides without draws", NUMERICAL)
    p_calm: float = _of(0.01, "p", "above, it decides without draws", CONVENTION)
    share_names: float = _of(0.5, "1", "part of the level that goes to named effects", JUDGED)
    share_smooth: float = _of(0.3, "1", "part that goes to smooth terms", JUDGED)
    share_misfit: float = _of(0.2, "1", "part that goes to lack of fit against the repeats", JUDGED)
    curve_terms: int = _of(7, "terms", "of a smooth curve over one covariate", JUDGED)
    map_terms: int = _of(5, "terms", "of a smooth map along each side of the workspace", JUDGED)

    # Selection
    close: float = _of(6.0, "delta BIC", "within which a rival stays in the set: one in twenty", CONVENTION)
    refit_within: float = _of(10.0, "delta BIC", "linear gain within which a candidate is fitted exactly", JUDGED)
    refit_most: int = _of(12, "candidates", "fitted exactly at a step of the selection", NUMERICAL)
    form: float = _of(
        0.001, "part of the gain",
        "not held against a name: no formula is the physics to the last", JUDGED,
    )  # fmt: skip
    bent: float = _of(
        0.2, "part of the signature",
        "below, what calibration absorbed makes the linear gain unreliable: fit exactly", JUDGED,
    )  # fmt: skip
    largest_angle: float = _of(0.3, "rad", "amplitude beyond which a sensor would have been replaced", JUDGED)
    largest_scale: float = _of(0.5, "1", "scale error beyond which a column is in another unit, or not read", JUDGED)
    largest_ratio: float = _of(0.2, "1", "the same of a scale or a gear ratio", JUDGED)
    effects_most: int = _of(8, "effects", "looked for", JUDGED)
    exchanged_at_once: int = _of(
        3, "effects",
        "up to which all are looked for anew as soon as one more is found; of more, at the end", NUMERICAL,
    )  # fmt: skip
    pairs_most: int = _of(3, "pairs", "of picks that are exchanged two at a time, the least sure first", NUMERICAL)
    pair_names: int = _of(20, "names", "the best alone, of which all pairs are tried in the place of two", NUMERICAL)
    further_gain: float = _of(12.0, "delta BIC", "that a further effect must have", JUDGED)
    formula_error: float = _of(
        0.0225, "part of the gain",
        "of those before it below which an effect may be the error of their formulas, off by .15 of their size", JUDGED,
    )  # fmt: skip
    form_off: float = _of(
        0.1, "part of the size",
        "largest rms by which a formula is off in what it is a function of; .3 and .6 of it are as likely", JUDGED,
    )  # fmt: skip
    form_odds: float = _of(
        6.0, "2 log odds",
        "that a form is off and not as the formula has it, before anything is seen: 20 to 1", JUDGED,
    )  # fmt: skip
    form_runaway: float = _of(
        10.0, "times the size without the form",
        "that an effect may have beside a form of it; beyond, the two only cancel where they were fitted", JUDGED,
    )  # fmt: skip
    form_share: float = _of(
        0.2, "part of the size",
        "by which a named effect's size must go with something else for its form to be told", JUDGED,
    )  # fmt: skip
    along_share: float = _of(
        0.02, "part of the size",
        "the same for what it goes with along the way of its own carriage, where its formula is a constant", JUDGED,
    )  # fmt: skip
    linear_hope: float = _of(
        0.25, "part of the gain",
        "that the linear one must reach, of very many readings, for exact fits to be tried", JUDGED,
    )  # fmt: skip
    change_places: int = _of(40, "places", "of a change point that are scanned at once", NUMERICAL)
    change_hopeful: float = _of(
        0.5, "part of the largest gain", "from which a step is looked for between the places that were scanned", JUDGED
    )  # fmt: skip
    change_edge: float = _of(
        0.04, "part of the run",
        "at either end, where a step is all but a matter of single readings", JUDGED,
    )  # fmt: skip
    weight_left_out: float = _of(0.2, "weight", "of unlikely members together that may be left out of a set", JUDGED)
    weight_left_out_few: float = _of(0.1, "weight", "the same where residuals are few and gains rough", JUDGED)
    weight_left_out_untold: float = _of(
        0.05, "weight",
        "the same where besides no repeats tell the noise: a set then holds one of twenty less, and no more", JUDGED,
    )  # fmt: skip
    few_degrees: int = _of(
        8, "degrees of freedom",
        "left by calibration, up to which their scatter tells no name: names are held against the noise as stated",
        JUDGED,
    )  # fmt: skip
    few_residuals: int = _of(150, "residuals", "up to which gains are rough", JUDGED)

    # Verdict
    explained: float = _of(0.85, "part of the excess", "that names must account for", JUDGED)
    explained_plain: float = _of(
        0.92, "part of the excess",
        "the same for the whole of it where what is left is plain; below, it is a part", JUDGED,
    )  # fmt: skip
    explained_part: float = _of(
        0.7, "part of the excess",
        "that names must account for with the catalogue's own formulas, where sizes go with something besides", JUDGED,
    )  # fmt: skip
    explained_by_far: float = _of(
        0.5, "part of the excess",
        "that names must account for where one gains `smooth_far` times what any smooth term does", JUDGED,
    )  # fmt: skip
    p_plain: float = _of(0.0001, "p", "of what is plain", JUDGED)
    explained_nearly: float = _of(
        0.97, "part of the excess",
        "beyond, a smooth term's greater gain shows only a formula's last per cents", JUDGED,
    )  # fmt: skip
    smooth_clearly: float = _of(
        6.0, "delta BIC",
        "by which smooth terms must beat the names for the verdict unknown", CONVENTION,
    )  # fmt: skip
    smooth_far: float = _of(
        2.5, "times the best name's gain",
        "at which a smooth term ends the search for names; the other way round, a name is a part of it", JUDGED,
    )  # fmt: skip
    floors_left: float = _of(
        1.5, "times the floor",
        "of error that is left, beyond which names are not the whole of it: the verdict is partly", CONVENTION,
    )  # fmt: skip
    smooth_beside: int = _of(3, "terms", "of smooth functions at least that names are held against", JUDGED)
    matters: float = _of(0.15, "sigma", "visible size below which what is found is too small to matter", JUDGED)

    # The fallback model, and validation
    smooth_most: int = _of(5, "components", "of a smooth correction", JUDGED)
    smooth_gain: float = _of(2.0, "log L", "that a component must bring", JUDGED)
    smooth_sure: float = _of(1.0, "standard errors", "over poses, by which it must predict them better", JUDGED)
    folds: int = _of(5, "folds", "of a cross-validation, whole poses each", CONVENTION)
    floor_unseen: float = _of(
        5.0, "times the noise",
        "that noise alone may leave on readings left out of a fit; beyond, so few readings predict no others", JUDGED,
    )  # fmt: skip
    bootstrap_draws: int = _of(1000, "draws", "of whole poses, for the interval of the held-out error", NUMERICAL)

    # Very many readings
    many_readings: int = _of(10_000, "readings", "from which on a part of them leads the way", NUMERICAL)
    part_readings: int = _of(4000, "readings", "of that part", NUMERICAL)
    step_still: float = _of(0.0001, "sigma", "rms of the last step of a fit", NUMERICAL)
    step_nearly: float = _of(
        0.01, "sigma",
        "the same of very many readings, whose next step is a thousandth of it", NUMERICAL,
    )  # fmt: skip
    behind_errors: float = _of(
        6.0, "standard errors",
        "by which a candidate that is screened out is behind at least", JUDGED,
    )  # fmt: skip
    behind_share: float = _of(0.03, "part of the gain", "by which it must be behind besides", JUDGED)
    behind_share_placed: float = _of(
        0.2, "part of the gain",
        "the same of a change point, whose finer place is still to come", JUDGED,
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
