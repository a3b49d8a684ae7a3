"""The report of one pick: its amplitude with an interval, its rivals with their weights, and what would separate them.

More poses do not separate effects that have the same signature, beside calibration, at all positions of the joints. So
poses are drawn at random: each joint anywhere in the range of its readings, independently of the others, and from
either side; the instruments read what the model predicts there. Example: the scale of the only joint that slides, and
the scale of the tracker; the calibrated lengths absorb the difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from calibench.discrepancy.fitting.fit import Fit, amplitude_interval, orthonormal, project_off
from calibench.discrepancy.labels import effect_label, quantity_label
from calibench.discrepancy.model.effect import ChangePoint, Effect, OfFreePeriod, over_of
from calibench.discrepancy.model.formulations import Predicted
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.model import Model, signature
from calibench.discrepancy.model.roles import roles_of, words_of
from calibench.discrepancy.noise.laws import NoiseFinding
from calibench.discrepancy.registries import description_of, family_of
from calibench.discrepancy.report import Amplitude, Coefficient, Finding, Rival
from calibench.discrepancy.search.form import forms_of
from calibench.discrepancy.search.select import Option, spared, told_apart
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

FREE_PERIOD = "period"  # the coefficient that a fitted period is told as
BEGINS = "from"  # the coefficient that the place from which an effect acts is told as, where it was searched for
_SAME = 1e-6  # of a signature: rounding, and what is of second order
_PARTS = "look at the parts themselves"
_TOGETHER = 0.5  # part of a column's variance: another column that explains so much goes together with it
_NOT_POSES = "a known length, a second instrument, or a reading of another kind"
FORMULA_ERROR = "may be the error of the first formula"


def finding_of(found: Fit, options: Sequence[Option]) -> Finding:
    """Return the finding of one set of options, the first of which is in the fit `found`."""
    best, top = options[0], max(options, key=lambda o: o.gain)
    behind = {o.name: _behind(o, top) for o in options}
    weights = {name: float(np.exp(-max(0.0, told_apart(top, far)) / 2)) for name, far in behind.items()}
    members = {o.name: (o.effect.family, o.effect.target) for o in options}
    for o in options:
        for twin in o.effect.twins:
            family, target = twin.split(" ", 1)
            weights[twin] = max(weights.get(twin, 0.0), weights[o.name])  # no data can say which of the two it is
            members.setdefault(twin, (family, target))
    known = weights
    weights = _held(known, (best.name, *_of_the_same_course(options, found)), _left_out(found, best))
    for o in options:
        alike = [name for name in (o.name, *o.effect.twins) if name in known]
        if any(name in weights for name in alike):  # of two that no data can part, none is less likely
            weights |= {name: known[name] for name in alike}
    total = sum(weights.values())
    ranked = sorted(weights.items(), key=lambda w: (w[0] != best.name, -w[1]))
    sizes = {o.name: _size(o) for o in options if o is not best}
    rivals = tuple(Rival(name, *members[name], weight / total, sizes.get(name)) for name, weight in ranked)
    effect = best.effect
    whole = _with_its_form(effect, found)
    nearest, spread = whole @ found.x, whole @ found.covariance() @ whole.T
    interval = amplitude_interval(effect, nearest, spread, found.reach)
    amplitude = Amplitude(effect.amplitude(nearest), effect.unit, interval)
    visible = found.noise.size_of(best.gain, len(found.r))
    return Finding(
        effect=best.name,
        family=effect.family,
        target=effect.target,
        amplitude=amplitude,
        gain=best.gain,
        set=rivals,
        separated_by=_separated_by([o for o in options if o.name in weights], found),
        visible=visible,
        coefficients=_coefficients(effect, nearest, np.sqrt(np.diag(spread))),
        period=effect.period(nearest) if isinstance(effect, OfFreePeriod) else _period_of(effect, found),
    )


def _size(o: Option) -> Amplitude | None:
    """Return the size of an option beside the other picks, with its interval; None where its fit was not kept."""
    if not len(o.fit.J):
        return None
    own = slice(len(o.fit.x) - len(o.effect.coefficients), None)
    c, spread = o.fit.x[own], o.fit.covariance()[own, own]
    return Amplitude(o.effect.amplitude(c), o.effect.unit, amplitude_interval(o.effect, c, spread, o.fit.reach))


def _with_its_form(effect: Effect, found: Fit) -> Array:
    """Return the matrix, (k, p), from the numbers of a fit to those of the formula nearest to effect and form together.

    Where form and formula are functions of the same argument, each may contain a part of the other. Then only their sum
    has a size, and the formula's own numbers alone have no meaning.
    """
    onto = np.zeros((len(effect.coefficients), len(found.x)))
    onto[:, found.model.place_of(effect)] = np.eye(len(onto))
    for form in forms_of(effect, found.model.effects):
        onto[:, found.model.place_of(form)] = form.nearest(found.at.recorded, found.model.formulation.data)
    return onto


def _behind(o: Option, top: Option) -> float:
    if np.isfinite(o.behind):
        return o.behind
    return top.gain - o.gain - max(spared(o, top), thresholds().form * top.gain)


def _coefficients(effect: Effect, c: Array, sd: Array) -> tuple[Coefficient, ...]:
    """Return the numbers of an effect's formula; a fitted frequency, the last of them, is returned as its period.

    Behind them stands from where on the effect acts, without a deviation, where that place was searched for.
    """
    numbers = [
        Coefficient(name, float(value), unit, float(each))
        for name, value, unit, each in zip(effect.coefficients, c, effect.units, sd)
    ]
    if isinstance(effect, OfFreePeriod):
        step = np.zeros(len(c))
        step[-1] = sd[-1]
        about = abs(effect.period(c + step) - effect.period(c - step)) / 2
        numbers[-1] = Coefficient(FREE_PERIOD, effect.period(c), effect.period_unit, float(about))
    begins = getattr(effect, "begins", np.nan)
    if np.isfinite(begins):
        numbers.append(Coefficient(BEGINS, float(begins), getattr(effect, "begins_unit", ""), np.nan))
    return tuple(numbers)


def _period_of(effect: Effect, found: Fit) -> float:
    data = found.model.formulation.data
    family = family_of(data.machine, effect.family)
    period = family.period(data.metadata, effect.target) if family and family.period else 0.0
    return float(period)


def with_cautions(findings: Sequence[Finding], whole: Mapping[str, float]) -> tuple[Finding, ...]:
    """Return findings, the largest first, with a caution where one may only be the error of another one's formula.

    No formula is exact physics. If it is off by a tenth, a hundredth of the explained energy remains, and another name
    of the catalogue explains a part of that. On the same part of the machine it is a hundredth of the whole effect
    there, `whole` (mean square in sigma), although calibration may have absorbed most of that.
    """
    larger: list[Finding] = []
    for one in sorted(findings, key=lambda f: -f.gain):
        before = sum(f.visible**2 for f in larger)
        there = sum(max(f.visible**2, whole.get(f.effect, 0.0)) for f in larger if f.target == one.target)
        small = 0 < one.visible**2 < thresholds().formula_error * max(before, there)
        larger.append(replace(one, caution=FORMULA_ERROR) if small else one)
    return tuple(larger)


def _left_out(found: Fit, best: Option) -> float:
    """Return the total weight of unlikely members that may be left out: smaller where gains are less exact.

    So they are where nothing tells the noise and the weights are those of forms over a place.
    """
    if len(found.r) > thresholds().few_residuals:
        of_forms = found.noise.profiled and over_of(best.effect)
        return thresholds().weight_left_out_few if of_forms else thresholds().weight_left_out
    return thresholds().weight_left_out_untold if found.noise.profiled else thresholds().weight_left_out_few


def _of_the_same_course(options: Sequence[Option], found: Fit) -> list[str]:
    """Return the rivals on the part of the first option whose column has nearly the same course as that of the first.

    Where a column differs from another by less than formulas may be off, as a temperature that rises with time, the
    better fit of one of the two is no reason to leave the other out.
    """
    data, first = found.model.formulation.data, options[0].effect

    def own(effect: Effect) -> str:
        name = effect.columns[0] if len(effect.columns) == 1 else ""
        return name if name in data and data[name].dtype.kind in "iuf" else ""

    along = own(first)
    rivals = [o for o in options[1:] if o.effect.target == first.target and own(o.effect) not in ("", along)]
    least = 1 - thresholds().formula_error
    return [o.name for o in rivals if along and _told_by(data[along], data[own(o.effect)]) > least]


def _held(weights: Mapping[str, float], safe: Sequence[str], share: float) -> dict[str, float]:
    """Return the weights without the smallest ones, whose total stays below a share of the whole.

    Many unlikely rivals together may be likely. Those in `safe` are kept.
    """
    most, out = share * sum(weights.values()), 0.0
    held = dict(weights)
    for name, weight in sorted(weights.items(), key=lambda w: w[1]):
        if out + weight >= most:
            break
        if name not in safe:
            out += held.pop(name)
    return held


def parted_by(effects: Sequence[Effect], machine: str) -> str:
    """Return the other kind of reading that parts effects from their declared twins; "" where none is declared."""
    kinds = (family.parted_by for twin in sorted(_twins(effects)) if (family := family_of(machine, twin)))
    return next((kind for kind in kinds if kind), "")


def _twins(effects: Sequence[Effect]) -> set[str]:
    """Return the families of the declared twins of effects."""
    return {twin.split(" ", 1)[0] for effect in effects for twin in effect.twins}


def _separated_by(options: Sequence[Option], found: Fit) -> str | None:
    """Return a measurement that would tell the members of a set apart; None where one name stands alone."""
    families = {o.effect.family for o in options}
    twins = _twins([o.effect for o in options])
    formulation = found.model.formulation
    machine = formulation.data.machine
    if kind := parted_by([o.effect for o in options], machine):
        return kind
    if len(options) == 1 or families | twins == families & twins:
        return f"no further readings tell these apart, they leave the same signature: {_PARTS}" if twins else None
    targets = {o.effect.target for o in options}
    ways = {family.resolved_by if (family := family_of(machine, name)) else "" for name in families}
    if len(targets) == len(ways) == 1 and all(ways):
        return ways.pop().format(target=targets.pop())
    if any(isinstance(o.effect, ChangePoint) for o in options):
        return "readings of the same poses, back to back, before and after the change"
    absent = [column for column in description_of(machine).helpful if column not in formulation.readings]
    columns = f"columns {', '.join(absent)}, or " if absent else ""
    alike = same_in_any_pose(found, [o.effect for o in options])
    if len(alike) == len(options) * (len(options) - 1) // 2:
        return f"{_NOT_POSES}; in every pose these leave the same signature, so more poses do not part them"
    if not alike and _one_signature(options):
        same = "in all of these readings they leave the same signature, and more of the kind do not part them"
        return f"{columns}{same}: {_PARTS}"
    parted = f"{columns}{_going_apart(options, formulation) or 'more readings where their signatures differ'}"
    if not alike:
        return parted
    pairs = [" from ".join(effect_label(machine, e.family, e.target) for e in pair) for pair in alike]
    return f"{parted}; no pose parts {', nor '.join(pairs)}: that takes {_NOT_POSES}"


def _one_signature(options: Sequence[Option]) -> bool:
    """Return whether all members of a set have the same signature, up to rounding and size."""
    signatures = [o.fit.J[:, -len(o.effect.coefficients) :] for o in options]
    if not all(len(one) for one in signatures):
        return False
    bases = [orthonormal(one, _SAME) for one in signatures]
    first = bases[0]
    return all(U.shape == first.shape and np.abs(U - first @ (first.T @ U)).max() < _SAME for U in bases[1:])


def _going_apart(options: Sequence[Option], formulation: Formulation) -> str:
    """Return which of the columns that the members of a set depend on have the same course in these data.

    The text is "" where there are none.
    """
    data, words = formulation.data, words_of(roles_of(formulation))
    followed = [o.effect.columns[0] for o in options if len(o.effect.columns) == 1 and o.effect.columns[0] in data]
    known = [name for name in dict.fromkeys(followed) if data[name].dtype.kind in "iuf"]
    pairs = [(_told_by(data[one], data[other]), one, other) for one, other in combinations(known, 2)]
    share, *pair = max(pairs, default=(0.0,))
    if share < _TOGETHER:
        return ""
    both = " and ".join(quantity_label(data.machine, str(name), words) for name in pair)
    return f"readings in which {both} do not go together: here the one tells {100 * share:.0f} % of the other"


def _told_by(one: Array, other: Array) -> float:
    """Return the part of a column's variance that a cubic of the other explains: the larger of both directions."""
    shares = []
    for u, v in ((one, other), (other, one)):
        u, v = (np.asarray(w, dtype=float) - np.mean(w) for w in (u, v))
        if not np.ptp(u) * np.ptp(v) > 0:
            return 0.0
        cubic = np.vander(v / np.abs(v).max(), 4)
        rest = u - cubic @ np.linalg.lstsq(cubic, u, rcond=None)[0]
        shares.append(1 - float(rest @ rest) / float(u @ u))
    return max(shares)


def blamed_noise(suspect: NoiseFinding) -> Finding:
    """Return a law of the noise as a finding."""
    name = f"{suspect.family} {suspect.target}"
    weight, apart = 1.0, None
    rivals: tuple[Rival, ...] = ()
    if suspect.rival:
        family, target, other = suspect.rival
        weight, rivals = 1 - other, (Rival(f"{family} {target}", family, target, other),)
        apart = f"more repeats: they tell which {suspect.alike} reads far off"
    one = Rival(name, suspect.family, suspect.target, weight)
    amplitude = Amplitude(suspect.amplitude, suspect.unit, suspect.ci95)
    visible = float(np.sqrt(max(suspect.gain, 0.0) / len(suspect.weights)))
    return Finding(
        effect=name,
        family=suspect.family,
        target=suspect.target,
        amplitude=amplitude,
        gain=suspect.gain,
        set=(one, *rivals),
        separated_by=apart,
        visible=visible,
    )


_POSES = 200
_SAME_ANGLE = 1e-8  # sine of the angle between two signatures: what is left of one is rounding
_FULL = 1e-10  # of the largest singular value, below which a direction is rounding


def same_in_any_pose(found: Fit, effects: Sequence[Effect]) -> tuple[tuple[Effect, Effect], ...]:
    """Return the pairs of `effects` that have the same signature in every pose.

    Poses can be drawn for a machine that predicts measured columns from its joints; for any other there are no pairs.
    """
    posed = _posed(found)
    if posed is None:
        return ()
    x = found.x[: len(posed.parameters)]
    q = Model(posed).quantities(x)[0]
    slopes = posed.slopes(q)
    own = np.stack([slopes[p.name] for p in posed.parameters], axis=-1)
    absorbed = orthonormal(_columns(own), _FULL)
    rests = [
        project_off(_columns(signature(e, np.zeros(len(e.coefficients)), q, slopes, posed)), absorbed, times=2)
        for e in effects
    ]
    return tuple((effects[i], effects[j]) for i, j in combinations(range(len(effects)), 2) if _same(rests[i], rests[j]))


def _posed(found: Fit) -> Predicted | None:
    """Return the formulation over poses drawn at random; None where they cannot be drawn."""
    formulation = found.model.formulation
    if not isinstance(formulation, Predicted):
        return None
    joints = roles_of(formulation).joints
    # another commanded input depends on the pose, nobody knows how
    if {joint.reading for joint in joints} != set(formulation.inputs):
        return None
    rng, data = np.random.default_rng(0), formulation.data
    made = data.rows(rng.integers(0, len(data), _POSES))
    ranges = {joint.reading: (np.min(data[joint.reading]), np.max(data[joint.reading])) for joint in joints}
    poses = {name: rng.uniform(low, high, _POSES) for name, (low, high) in ranges.items()}
    poses |= {j.direction: rng.permutation(made[j.direction]) for j in joints if j.direction and j.direction in made}
    unread = {name: np.zeros(_POSES) for name in formulation.readings}
    posed = formulation.on(made.with_columns({**poses, **unread}))
    q = Model(posed).quantities(found.x[: len(posed.parameters)])[0]
    predicted = -np.asarray(posed.constraints(q), dtype=float)
    return posed.on(posed.data.with_columns(dict(zip(formulation.readings, predicted.T))))


def _columns(derivative: Array) -> Array:
    """Return derivatives of the residuals (n, c, k) as columns (n c, k) of length 1, without those that are zero."""
    flat = np.asarray(derivative, dtype=float).reshape(-1, derivative.shape[-1])
    lengths = np.linalg.norm(flat, axis=0)
    return np.asarray(flat[:, lengths > 0] / lengths[lengths > 0])


def _same(one: Array, other: Array) -> bool:
    """Tell whether two sets of columns span the same space."""
    if one.shape[1] != other.shape[1] or not one.shape[1]:
        return False
    ends = [np.linalg.svd(rest, full_matrices=False) for rest in (one, other)]
    if any(values[-1] < _SAME_ANGLE for _, values, _ in ends):  # calibration absorbs it: it is in no set
        return False
    (a, _, _), (b, _, _) = ends
    return bool(np.linalg.norm(a - b @ (b.T @ a), ord=2) < _SAME_ANGLE)
