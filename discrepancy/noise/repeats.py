"""Estimate the noise from repeats: from back-to-back pairs, and from separated visits of one pose.

Back-to-back readings differ by noise alone, but noise that is correlated from reading to reading cancels there. Visits
of one pose some time apart are free of that, but they also differ by whatever changes in time. If pairs scatter less
and visits as stated, the noise is correlated (AR(1)); if both scatter less, or both more, the statement is wrong.
"""

from dataclasses import replace

import numpy as np
from scipy.special import chdtrc, fdtrc

from calibench.core.notes import Code, Note
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.noise.whiten import ROUNDING, Noise
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_FOR_ANY = "names, weights and intervals hold at any noise, all else at the one that is assumed"
_CARRIED = 0.8  # of the noise at most, from one reading to the next
TAILS = (3.0, 4.0, 6.0, 10.0)  # tried besides the Gaussian


def pairs_of(data: MeasuredData) -> tuple[Array, Array]:
    """Return the rows of readings that follow each other within a visit, two arrays (m,); empty without repeats."""
    if not data.has("visit_id"):
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    order = np.argsort(data["visit_id"], kind="stable")
    ids = np.asarray(data["visit_id"])[order]
    same = ids[1:] == ids[:-1]
    return order[:-1][same], order[1:][same]


def law_of(r: Array, data: MeasuredData, stated: bool = True) -> tuple[Noise, int, tuple[Note, ...]]:
    """Return the law of the noise behind residuals whitened by the stated one, (n, c), the number of repeats, remarks.

    The stated noise is kept unless repeats contradict it. Where it is not `stated` but a first estimate, repeats alone
    tell it: pairs that scatter less are then no sign that noise is carried on.
    """
    t, (first, second) = thresholds(), pairs_of(data)
    last = again = np.zeros(0, dtype=int)  # the last rows of a visit, and the first of the next visit of its pose
    if data.has("visit_id", "pose_id"):
        order = np.lexsort((np.arange(len(data)), data["visit_id"], data["pose_id"]))
        pose, visit = np.asarray(data["pose_id"])[order], np.asarray(data["visit_id"])[order]
        cut = (pose[1:] == pose[:-1]) & (visit[1:] != visit[:-1])
        last, again = order[:-1][cut], order[1:][cut]
    visited = float(np.mean((r[last] - r[again]) ** 2) / 2) if len(last) else np.nan
    n, n_visits = len(first) * r.shape[1], len(last) * r.shape[1]
    if n < t.repeat_pairs:
        few = f"{n} difference{'s' * (n > 1)} between readings where {t.repeat_pairs} are needed"
        why = f"repeats are too few to tell the noise, {few}" if n else "no repeats tell the noise"
        return Noise(profiled=True), n, (Note(Code.NO_REPEATS, f"{why}: {_FOR_ANY}", values={"pairs": n}),)
    difference = (r[first] - r[second]).ravel() / np.sqrt(2)
    if np.all(np.abs(difference) <= ROUNDING):
        if n_visits and visited <= ROUNDING**2:
            text = "repeats are the same in all digits: they tell nothing of the noise"
            return Noise(), n, (Note(Code.REPEATS_EQUAL, text),)
        return Noise(1.0, _CARRIED), n, (_quieter(0.0, n_visits),)  # visits that differ carry on the noise
    if not stated and np.median(np.abs(difference)) <= ROUNDING:
        text = "repeats are mostly the same number: they tell nothing of the noise"
        return Noise(profiled=True), n, (Note(Code.REPEATS_EQUAL, text),)
    # the degrees of freedom of the t law that fits single readings, from differences of two over root 2
    gaussian = Noise(float(np.sqrt(np.mean(difference**2))))
    t_degrees, likely = np.inf, t.tails_gain + 2 * gaussian.loglikelihood(difference)
    for tail in TAILS:
        value = 2 * Noise(np.sqrt(variance(difference, tail)), 0.0, tail).loglikelihood(difference)
        if value > likely:
            t_degrees, likely = tail, value
    spread = variance(difference, t_degrees)
    width = np.sqrt((2 if not np.isfinite(t_degrees) else 5) / n)
    if stated and spread < 1 - 2 * width:
        # visits that scatter as stated, and not as little as pairs do, tell that the noise is correlated
        carried = n_visits < t.repeat_pairs or visited >= 1
        if not carried:
            gain = n_visits * (visited / spread - visited + np.log(spread))
            carried = bool(gain > -t.statement_doubt)
        if carried:
            return Noise(1.0, float(min(1 - spread, _CARRIED))), n, (_quieter(spread, n_visits),)
        return _estimated(spread, t_degrees, n), n, _misstated(spread)
    useless = not stated or spread > t.statement_useless
    if useless and n_visits >= t.repeat_pairs:
        visits = variance((r[last] - r[again]).ravel() / np.sqrt(2), t_degrees)
        if visits > spread * (1 + 3 * np.sqrt(2 if not np.isfinite(t_degrees) else 5) / np.sqrt(n_visits)):
            # no statement contradicts that noise is carried on, and it is likelier than an effect
            part = float(min(1 - spread / visits, _CARRIED))
            text = f"visits scatter more: {100 * part:.0f} % of the noise is taken to be carried on"
            more = Note(Code.NOISE_CARRIED, text, values={"part": part})
            law = replace(_estimated(visits, np.inf, n_visits), autocorrelation=part)
            return law, n, (*(_misstated(visits) if stated else ()), more)
    if not stated:
        return _estimated(spread, t_degrees, n), n, ()
    if spread > 1 + 3 * width:
        return _estimated(spread, t_degrees, n), n, _misstated(spread)
    if np.isfinite(t_degrees):  # the tests rest on the core, and only the repeats tell it
        text = f"the noise has heavier tails than a Gaussian: as of a t law of {t_degrees:g} degrees of freedom"
        heavier = Note(Code.HEAVY_TAILS, text, values={"t_degrees": t_degrees})
        return _estimated(spread, t_degrees, n), n, (heavier,)
    return Noise(), n, ()


def _estimated(variance: float, t_degrees: float, known: int) -> Noise:
    """Return the law whose scale repeats give: `variance` in units of the stated one, from `known` differences."""
    return Noise(float(np.sqrt(variance)), 0.0, t_degrees, known, from_repeats=True)


def _quieter(spread: float, n_visits: int) -> Note:
    """Return a note for pairs that scatter less than stated, where the statement may still be right."""
    shown = f"repeats show {np.sqrt(spread):.2f} times the stated noise"
    part = f"{100 * (1 - spread):.0f} %"
    if n_visits < thresholds().repeat_pairs:
        text = (
            f"{shown}: the noise is smaller than stated, or {part} of it is carried on from one reading to the next; "
            "the second is assumed, for no pose was read again later; where the first is true, state the smaller noise"
        )
    else:
        later = "poses that were read again later as much as stated"
        text = f"{shown}, {later}: {part} of the noise is carried on to the next reading"
    return Note(Code.NOISE_CARRIED, text, values={"part": 1 - spread})


def _misstated(spread: float) -> tuple[Note, ...]:
    times = float(np.sqrt(spread))
    text = f"repeats scatter {times:.2f} times the stated noise; their scatter is used"
    return (Note(Code.NOISE_MISSTATED, text, values={"times": times}),)


def variance(values: Array, t_degrees: float) -> float:
    """Return the variance of a t law fitted to `values`, from its scale; the mean square for a Gaussian."""
    square = float(np.mean(values**2))
    if not (np.isfinite(t_degrees) and square > 0):
        return square
    # with coarse steps most differences are zero
    core = max(float(np.median(np.abs(values)) / 0.6745) ** 2, 1e-3 * square)
    squares = values**2
    grown = (t_degrees + 1) * squares
    for _ in range(30):
        core = float(np.add.reduce(grown / (t_degrees + squares / core)) / len(squares))
    return core * t_degrees / max(t_degrees - 2, 0.5)


def excess_p(mean_square: float, degrees: float, behind: float, excess_kurtosis: float = 0.0) -> float:
    """Return the probability of a mean square of scores this large under the noise alone.

    `degrees` are its degrees of freedom, and `behind` those of the estimate of the noise, infinite where it is stated.
    Heavy tails make both mean squares scatter as if of fewer degrees, by 1 + half the excess kurtosis (Box and
    Andersen 1955, J. R. Stat. Soc. B 17, 1-34).
    """
    degrees, behind = (count / (1 + excess_kurtosis / 2) for count in (degrees, behind))
    if not np.isfinite(behind):
        return float(chdtrc(degrees, mean_square * degrees))
    return float(fdtrc(degrees, behind, mean_square))
