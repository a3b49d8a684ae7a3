"""The report of one pick: its amplitude with an interval, its rivals with their weights, and what would separate them.

More poses do not separate effects that have the same signature, beside calibration, at all positions of the joints. So
poses are drawn at random: each joint anywhere in the range of its readings, independently of the others, and from
either side; the instruments read what the model predicts there. Example: the scale of the only joint that slides, and
the scale of the tracker; the calibrated lengths absorb the difference.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from calibench.discrepancy.diagnostics.smooth_term import curve
from calibench.discrepancy.fitting.fit import Fit, amplitude_interval, orthonormal, project_off
from calibench.discrepancy.labels import effect_label, quantity_label
from calibench.discrepancy.model.effect import ChangePoint, Effect, OfFreePeriod, name_of
from calibench.discrepancy.model.formulations import Predicted
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.model import Model, signature
from calibench.discrepancy.model.roles import columns_of, inputs_of, roles_of, words_of
from calibench.discrepancy.registries import description_of, family_of
from calibench.discrepancy.report import Amplitude, Caution, Coefficient, Doubt, Finding, Rival
from calibench.discrepancy.search.form import forms_of
from calibench.discrepancy.search.select import Option, spared
from calibench.discrepancy.search.standing import left_scale
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

FREE_PERIOD = "period"  # the coefficient that a fitted period is told as
BEGINS = "from"  # the coefficient that the place from which an effect acts is told as, where it was searched for
_SAME = 1e-6  # of a signature: rounding, and what is of second order
_PARTS = "look at the parts themselves"
_TOGETHER = 0.5  # part of a column's variance: another column that explains so much goes together with it
_FEW_INPUTS = 6  # that a sentence lists
_NOT_POSES = "a known length, a second instrument, or a reading of another kind"


def finding_of(found: Fit, options: Sequence[Option]) -> Finding:
    """Return the finding of one set of options, the first of which is in the fit `found`.

    Intervals are those of the noise that is left, where this is more than the stated one.
    """
    best, top, t = options[0], max(options, key=lambda o: o.gain), thresholds()
    effect = best.effect
    known: dict[str, float] = {}
    for o in options:
        exact = top.gain - o.gain - max(spared(o, top), t.form * top.gain)
        behind = o.behind if np.isfinite(o.behind) else exact
        known[o.name] = float(np.exp(-max(0.0, top.fit.noise.told_apart(behind, top.fit.degrees)) / 2))
    members = {o.name: (o.effect.family, o.effect.target) for o in options}
    for o in options:
        for twin in o.effect.twins:
            family, target = twin.split(" ", 1)
            known[twin] = max(known.get(twin, 0.0), known[o.name])  # no data can say which of the two it is
            members.setdefault(twin, (family, target))

    # unlikely members are left out: fewer where gains are less exact, as where nothing tells the noise and the weights
    # are those of forms over a place
    few, profiled = len(found.r) <= t.few_residuals, found.noise.profiled
    share = t.weight_left_out_few if few or (profiled and getattr(effect, "over", None)) else t.weight_left_out
    share = t.weight_left_out_untold if few and profiled else share
    # where the column of a rival on the same part, or of its family, differs from that of the first by less than
    # formulas may be off, as a temperature that rises with time, the better fit of one is no reason to leave the other
    # out
    q, data, least = found.at.recorded, found.model.formulation.data, 1 - t.formula_error
    followed = {o.name: name for o in options if (name := _followed(o.effect, data))}
    along = followed.get(best.name, "")
    rivals = [o for o in options[1:] if along and followed.get(o.name, along) != along]
    rivals = [o for o in rivals if _told_by(data[along], data[followed[o.name]]) > least]
    changed = {o.name: {*o.effect.basis(q, data, np.zeros(len(o.effect.coefficients)))} for o in (best, *rivals)}
    same = {o.name for o in rivals if o.effect.family == effect.family and changed[o.name] == changed[best.name]}
    alike = [o.name for o in rivals if o.effect.target == effect.target or o.name in same]
    weights = _held(known, (best.name, *alike), share)
    for o in options:
        twins = [name for name in (o.name, *o.effect.twins) if name in known]
        if any(name in weights for name in twins):  # of two that no data can part, none is less likely
            weights |= {name: known[name] for name in twins}
    total = sum(weights.values())
    ranked = sorted(weights.items(), key=lambda w: (w[0] != best.name, -w[1]))
    sizes: dict[str, Amplitude] = {}  # beside the other picks, where the fit was kept
    for o in options[1:]:
        if len(o.fit.J):
            own = slice(len(o.fit.x) - len(o.effect.coefficients), None)
            spread = left_scale(o.fit) ** 2 * o.fit.covariance()[own, own]
            sizes[o.name] = amplitude_of(o.effect, o.fit.x[own], spread, o.fit.reach)

    named = Finding(
        effect=best.name, family=effect.family, target=effect.target, amplitude=Amplitude(), gain=best.gain,
        set=tuple(Rival(name, *members[name], weight / total, sizes.get(name)) for name, weight in ranked),
        separated_by=_separated_by([o for o in options if o.name in weights], found),
        visible=found.noise.size_of(best.gain, len(found.r)),
    )  # fmt: skip
    return with_sizes(named, effect, found)


def with_sizes(finding: Finding, effect: Effect, found: Fit) -> Finding:
    """Return a finding with the size and the coefficients that its `effect` has in a fit, and its period or 0."""
    data = found.model.formulation.data
    # where form and formula are functions of the same argument, only their sum has a size: the formula nearest to both
    whole = np.zeros((len(effect.coefficients), len(found.x)))
    whole[:, found.model.place_of(effect)] = np.eye(len(whole))
    for form in forms_of(effect, found.model.effects):
        whole[:, found.model.place_of(form)] = form.nearest(found.at.recorded, data)
    c, spread = whole @ found.x, left_scale(found) ** 2 * whole @ found.covariance() @ whole.T
    sd = np.sqrt(np.diag(spread))
    numbers = [
        Coefficient(name, float(value), unit, float(each))
        for name, value, unit, each in zip(effect.coefficients, c, effect.units, sd)
    ]
    family_here = family_of(data.machine, effect.family)
    if isinstance(effect, OfFreePeriod):  # the last number is a fitted frequency
        step = np.zeros(len(c))
        step[-1] = sd[-1]
        about, period = abs(effect.period(c + step) - effect.period(c - step)) / 2, effect.period(c)
        numbers[-1] = Coefficient(FREE_PERIOD, period, effect.period_unit, float(about))
    else:
        of = family_here.period if family_here else None
        period = float(of(data.metadata, effect.target)) if of else 0.0
    begins = getattr(effect, "begins", np.nan)
    if np.isfinite(begins):
        numbers.append(Coefficient(BEGINS, float(begins), getattr(effect, "begins_unit", ""), np.nan))
    amplitude = amplitude_of(effect, c, spread, found.reach)
    return replace(finding, amplitude=amplitude, coefficients=tuple(numbers), period=period)


def amplitude_of(effect: Effect, c: Array, spread: Array, reach: float) -> Amplitude:
    """Return the size of an effect at its coefficients `c`, whose covariance is `spread`."""
    interval = amplitude_interval(effect, c, spread, reach)
    return Amplitude(effect.amplitude(c), effect.unit, interval, getattr(effect, "span", np.nan))


def with_cautions(findings: Sequence[Finding], whole: Mapping[str, float]) -> tuple[Finding, ...]:
    """Return findings, the largest first, with a caution where one may only be the error of another one's formula.

    No formula is exact physics. If it is off by a tenth, a hundredth of the explained energy remains, and another name
    may explain a part of it; on the same part of the machine it is of the `whole` effect there (mean square in sigma).
    """
    larger: list[Finding] = []
    for one in sorted(findings, key=lambda f: -f.gain):
        before = sum(f.visible**2 for f in larger)
        there = sum(max(f.visible**2, whole.get(f.effect, 0.0)) for f in larger if f.target == one.target)
        small = 0 < one.visible**2 < thresholds().formula_error * max(before, there)
        larger.append(replace(one, caution=(Caution(Doubt.FORMULA_ERROR),)) if small else one)
    return tuple(larger)


def also_told_by(finding: Finding, found: Fit) -> tuple[str, ...]:
    """Return the other columns of which a wave in the fit `found` is a smooth function over its rows.

    A wave as long as the time from trial to trial is one of the time within a trial.
    """
    formulation = found.model.formulation
    [effect] = [e for e in found.model.effects if name_of(e) == finding.effect]
    data, q = formulation.data, found.at.recorded
    c, met = found.x[found.model.place_of(effect)], (*inputs_of(formulation), *columns_of(roles_of(formulation)))
    [wave] = effect.shift(q, data, c).values()
    rivals = {rival.target for rival in finding.set}
    others = [u for u in dict.fromkeys(met) if u not in effect.columns and not any(u in target for target in rivals)]
    told, t = [], thresholds()
    for name in (name for name in others if name in data and data[name].dtype.kind in "iuf"):
        u = np.asarray(data[name], dtype=float)
        terms = curve(u, float(u.min()), float(u.max()), min(t.curve_terms, len(np.unique(u))))
        free, rest = len(u) - terms.shape[1], wave - terms @ np.linalg.lstsq(terms, wave, rcond=None)[0]
        if free > 0 and rest @ rest / free < t.formula_error * np.var(wave):
            told.append(name)
    return tuple(told)


def _followed(effect: Effect, data: MeasuredData) -> str:
    """Return the only column that an effect depends on, where it holds numbers; else ""."""
    name = effect.columns[0] if len(effect.columns) == 1 else ""
    return name if name in data and data[name].dtype.kind in "iuf" else ""


def _held(weights: Mapping[str, float], safe: Sequence[str], share: float) -> dict[str, float]:
    """Return the weights without the smallest ones, whose total stays below a share of the whole."""
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
    twins = sorted({twin.split(" ", 1)[0] for effect in effects for twin in effect.twins})
    return next((family.parted_by for twin in twins if (family := family_of(machine, twin)) and family.parted_by), "")


def _separated_by(options: Sequence[Option], found: Fit) -> str | None:
    """Return a measurement that would tell the members of a set apart; None where one name stands alone."""
    effects = [o.effect for o in options]
    families, targets = {e.family for e in effects}, {e.target for e in effects}
    twins = {twin.split(" ", 1)[0] for effect in effects for twin in effect.twins}
    formulation = found.model.formulation
    machine = formulation.data.machine
    if kind := parted_by(effects, machine):
        return kind
    if len(options) == 1 or families | twins == families & twins:
        return f"no further readings tell these apart, they leave the same signature: {_PARTS}" if twins else None
    ways = {family.resolved_by if (family := family_of(machine, name)) else "" for name in families}
    if len(targets) == len(ways) == 1 and all(ways):
        return ways.pop().format(target=targets.pop())
    if any(isinstance(effect, ChangePoint) for effect in effects):
        return "readings of the same poses, back to back, before and after the change"
    absent = [column for column in description_of(machine).helpful if column not in formulation.readings]
    columns = f"columns {', '.join(absent)}, or " if absent else ""
    alike = same_in_any_pose(found, effects)
    if len(alike) == len(options) * (len(options) - 1) // 2:
        return f"{_NOT_POSES}; in every pose these leave the same signature, so more poses do not part them"

    # whether all have the same signature in these readings, up to rounding and size
    signatures = [] if alike else [o.fit.J[:, -len(o.effect.coefficients) :] for o in options]
    if signatures and all(len(one) for one in signatures):
        first, *others = (orthonormal(one, _SAME) for one in signatures)
        if all(U.shape == first.shape and np.abs(U - first @ (first.T @ U)).max() < _SAME for U in others):
            same = "in all of these readings they leave the same signature, and more of the kind do not part them"
            return f"{columns}{same}: {_PARTS}"
    # which of the columns that they depend on have the same course in these data
    data, words = formulation.data, words_of(roles_of(formulation))
    known = [name for name in dict.fromkeys(_followed(effect, data) for effect in effects) if name]
    courses = [(_told_by(data[one], data[other]), one, other) for one, other in combinations(known, 2)]
    share, *pair = max(courses, default=(0.0,))
    parted = f"{columns}more readings where their signatures differ"
    if share >= _TOGETHER:
        both = " and ".join(quantity_label(machine, str(name), words) for name in pair)
        tells = f"here the one tells {100 * share:.0f} % of the other"
        parted = f"{columns}readings in which {both} do not go together: {tells}"
    if not alike:
        inputs = [quantity_label(machine, name, words) for name in inputs_of(formulation)]
        listed = " and ".join(filter(None, (", ".join(inputs[:-1]), *inputs[-1:])))
        wider = f", such as over wider ranges of {listed}" if 0 < len(inputs) <= _FEW_INPUTS else ""
        return f"{parted}{wider}" if share < _TOGETHER else parted
    pairs = [" from ".join(effect_label(machine, e.family, e.target) for e in pair) for pair in alike]
    return f"{parted}; no pose parts {', nor '.join(pairs)}: that takes {_NOT_POSES}"


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


_POSES = 200
_SAME_ANGLE = 1e-8  # sine of the angle between two signatures: what is left of one is rounding
_FULL = 1e-10  # of the largest singular value, below which a direction is rounding


def same_in_any_pose(found: Fit, effects: Sequence[Effect]) -> tuple[tuple[Effect, Effect], ...]:
    """Return the pairs of `effects` that have the same signature in every pose."""
    formulation = found.model.formulation
    if not isinstance(formulation, Predicted) or formulation.of_rows is not None:  # where each pose is a call
        return ()
    joints = roles_of(formulation).joints
    # another commanded input depends on the pose, nobody knows how
    if {joint.reading for joint in joints} != set(formulation.inputs):
        return ()
    # the formulation over poses drawn at random
    rng, data = np.random.default_rng(0), formulation.data
    made = data.rows(rng.integers(0, len(data), _POSES))
    ranges = {joint.reading: (np.min(data[joint.reading]), np.max(data[joint.reading])) for joint in joints}
    poses = {name: rng.uniform(low, high, _POSES) for name, (low, high) in ranges.items()}
    poses |= {j.direction: rng.permutation(made[j.direction]) for j in joints if j.direction and j.direction in made}
    unread = {name: np.zeros(_POSES) for name in formulation.readings}
    posed = formulation.on(made.with_columns({**poses, **unread}))
    x = found.x[: len(posed.parameters)]
    predicted = -np.asarray(posed.constraints(Model(posed).quantities(x)[0]), dtype=float)
    posed = posed.on(posed.data.with_columns(dict(zip(formulation.readings, predicted.T))))

    q = Model(posed).quantities(x)[0]
    slopes = posed.slopes(q)
    own = np.stack([slopes[p.name] for p in posed.parameters], axis=-1)
    absorbed = orthonormal(_columns(own), _FULL)
    # what calibration leaves of each; one that it absorbs is in no set
    bases = []
    for effect in effects:
        D = _columns(signature(effect, np.zeros(len(effect.coefficients)), q, slopes, posed))
        left, values, _ = np.linalg.svd(project_off(D, absorbed, times=2), full_matrices=False)
        bases.append(left if D.shape[1] and values[-1] >= _SAME_ANGLE else None)
    pairs = []
    for (e, a), (other, b) in combinations(zip(effects, bases), 2):
        if a is None or b is None or a.shape[1] != b.shape[1]:
            continue
        if np.linalg.norm(a - b @ (b.T @ a), ord=2) < _SAME_ANGLE:
            pairs.append((e, other))
    return tuple(pairs)


def _columns(derivative: Array) -> Array:
    """Return derivatives of the residuals (n, c, k) as columns (n c, k) of length 1, without those that are zero."""
    flat = np.asarray(derivative, dtype=float).reshape(-1, derivative.shape[-1])
    lengths = np.linalg.norm(flat, axis=0)
    return np.asarray(flat[:, lengths > 0] / lengths[lengths > 0])
