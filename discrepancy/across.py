"""`carried`: which findings of one set of readings other sets of the same machine carry.

A name that one set told is an expectation for the next: the same effect, with the numbers that it had, is fitted beside
a calibration of that set alone. So nothing is searched for, and chance has no choice. The size there is compared with
the first by the difference over its standard error, and by the errors of whole poses that were left out of the fit. An
error that repeats over some readings may be that of any shape: only another set tells whether the machine repeats it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from scipy.special import chdtrc, ndtri

from calibench.core.process import one_thread
from calibench.discrepancy.checks.validate import validate
from calibench.discrepancy.diagnostics.score import projected_scores, score_all
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting.fit import Fit, fit, orthonormal, project_off
from calibench.discrepancy.model import effect as effects_of
from calibench.discrepancy.model.effect import ChangePoint, Effect, Untestable, has_free_period, is_possible, name_of
from calibench.discrepancy.model.machine import Machine, Quantities
from calibench.discrepancy.model.measured import PLACE, MeasuredData
from calibench.discrepancy.model.model import Model, signature
from calibench.discrepancy.model.roles import roles_of
from calibench.discrepancy.procedure import calibrated, searched
from calibench.discrepancy.report import Carried, CarriedVerdict, Caution, Doubt, Finding, Report
from calibench.discrepancy.search.finding import amplitude_of
from calibench.discrepancy.search.form import forms_of
from calibench.discrepancy.search.select import delta_bic
from calibench.discrepancy.thresholds import thresholds
from calibench.discrepancy.validation import errors_left_out, folds
from calibench.problems.base import Array

_APART = 2.5758  # standard errors: sizes that differ by less agree, as 99 of 100 of one size do
_FORMULA = 0.1  # of a size: no formula is exact physics, and other poses weigh its error otherwise
_OF_RUN = "it follows the time of its run, which no other run shares"
_LOST = "the machine has no value there with all that is expected"
_BEYOND = "the size that fits there is one that no machine has"
_DIGITS = 1e-10  # of the largest singular value, below which a direction is rounding


def carried(report: Report, others: Sequence[MeasuredData]) -> Report:
    """Return the report with `across`: of each finding, what each of the `others`, sets of the same machine, says.

    All rows of the others are fitted. A wave whose period was fitted is "periodic over these readings" until one of
    them confirms it. Raises `DataError` for a set that cannot be of this machine, `LookupError` for a report that was
    read from a file.

    >>> from calibench import bench, discrepancy
    >>> from calibench.bench.measured import shipped_path
    >>> one, other = (bench.read_measured(shipped_path(n, "gpm2002")) for n in ("demo_backlash", "demo_nothing"))
    >>> report = discrepancy.carried(discrepancy.explain("gpm2002", one), [other])
    >>> [(row.effect, row.case, row.verdict) for row in report.across]
    [('backlash joint 2', 'demo_nothing', 'does not carry')]
    """
    for one in others:
        if not isinstance(one, MeasuredData):
            raise TypeError(f"others: a {type(one).__name__}: MeasuredData or bench.read_measured is needed")
    first, known = report.model.fit, report.fitted.machine if report.fitted else None
    assert known is not None  # of every search
    with one_thread():
        rows = [row for other in others for row in _in_another(report.findings, first, known, other)]
    findings: list[Finding] = []
    ordered: list[Carried] = []
    for finding in report.findings:
        own = [row for row in rows if row.effect == finding.effect]
        ordered += own
        # the doubt that it is of these readings alone is settled by other sets where they can
        lost = tuple(row.case for row in own if row.verdict == "does not carry")
        confirmed = any(row.verdict == "carries" for row in own)
        doubts = tuple(one for one in finding.caution if one.code is not Doubt.UNCONFIRMED)
        if doubts != finding.caution and (confirmed or lost):
            settled = () if confirmed else (Caution(Doubt.NOT_ELSEWHERE, cases=lost),)
            finding = replace(finding, caution=(*doubts, *settled))
        findings.append(finding)
    return replace(report, findings=tuple(findings), across=tuple(ordered))


@final
@dataclass(frozen=True, eq=False)
class _Expected:
    """A finding as another set should show it: its effect with its forms, and the numbers that they had, (K,).

    `weights`, (k, K), make the coefficients of the effect from these numbers: of a formula and its form only their sum
    over the readings of the first set has a size. `spread` is the covariance of the coefficients, (k, k).
    """

    finding: Finding
    effects: tuple[Effect, ...]
    numbers: Array
    weights: Array
    spread: Array
    wave: bool  # of a period that was fitted

    def held(self) -> "_Expected":
        """Return the same at the period that it had, where that was fitted."""
        [of, *forms] = self.effects
        if forms or not has_free_period(of):
            return self
        k = len(self.numbers) - 1
        at = float(self.numbers[k])  # the last coefficient tells the period

        def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
            return {name: columns[:, :-1] for name, columns in of.basis(q, data, np.append(np.zeros(k), at)).items()}

        effect = effects_of.LinearEffect(
            of.family, of.target, of.formula, channel=of.channel, columns=of.columns, coefficients=of.coefficients[:-1],
            units=of.units[:-1], unit=of.unit, changes=changes, twins=of.twins,
            measure=lambda c: of.amplitude(np.append(c, at)), largest=getattr(of, "largest", np.inf),
        )  # fmt: skip
        return replace(
            self, effects=(effect,), numbers=self.numbers[:k], weights=self.weights[:k, :k], spread=self.spread[:k, :k]
        )


def _numbers(of: Fit, effects: Sequence[Effect], weights: Array) -> tuple[Array, Array]:
    """Return the coefficients of `effects` in a fit, (K,), and the covariance of `weights` (k, K) times these."""
    places = np.concatenate([np.arange(len(of.x))[of.model.place_of(effect)] for effect in effects])
    covariance = of.covariance(stated=True) * _left(of)
    return of.x[places], np.asarray(weights @ covariance[np.ix_(places, places)] @ weights.T)


def _why_not(one: _Expected, base: Fit, untestable: Sequence[Untestable]) -> str:
    """Return why the readings of `base` cannot test what is expected; "" where they can."""
    formulation, finding = base.model.formulation, one.finding
    columns = [column for effect in one.effects for column in effect.columns]
    for u in untestable:
        if u.family == finding.family and u.target in ("", finding.target):
            return u.reason
    if lacking := [column for column in columns if column not in formulation.data]:
        return f"needs column {', '.join(dict.fromkeys(lacking))}"
    clock = one.effects[0].columns[:1]
    if isinstance(one.effects[0], ChangePoint) or set(clock) & {roles_of(formulation).time, "t_s", PLACE} - {""}:
        return _OF_RUN
    one, at = one.held(), base.at
    numbers = np.split(one.numbers, np.cumsum([len(e.coefficients) for e in one.effects])[:-1])
    parts = [
        signature(effect, c, at.recorded, at.slopes, formulation)
        for effect, c in zip(one.effects, numbers, strict=True)
    ]
    moved = at.whiten(np.concatenate(parts, axis=2)) @ one.numbers
    seen = project_off(moved, orthonormal(base.J, _DIGITS), times=2)
    if not np.linalg.norm(seen) > thresholds().visible * np.linalg.norm(moved):
        return "calibration absorbs it there"
    return ""


def _refitted(expected: Sequence[_Expected], base: Fit, of_run: Sequence[Effect], case: str) -> list[Carried]:
    """Return what a fit of all that is expected says of each, beside the calibration of the other set.

    Of what the first run did over its time, candidates `of_run`, the other run has its own, where it shows.
    """
    held = [one.held() for one in expected]
    joint = _beside(base, held)
    if not np.isfinite(joint.cost):
        return [_row(one.finding, case, "not testable there", _LOST) for one in expected]
    own: tuple[Effect, ...] = ()
    for name in dict.fromkeys(map(name_of, of_run)):
        on = projected_scores(joint)
        scored = [s for s, _ in score_all(joint, on, [e for e in of_run if name_of(e) == name], sums=True)]
        best = max(scored, key=lambda s: delta_bic(s, on))
        more = (*own, best.effect)
        if delta_bic(best, on) > 0 and np.isfinite((beside := _beside(base, held, more)).cost):
            own, joint = more, beside
    shown = [_gains(joint, one) for one in held]
    # a wave that shows at the period it had may have its own here
    free = [one if gain > 0 else other for one, other, (gain, _) in zip(expected, held, shown, strict=True)]
    settled = _beside(base, free, own) if any(a is not b for a, b in zip(free, held)) else joint
    if not (settled.converged and np.isfinite(settled.cost)):
        free, settled = held, joint
    sizes = [one.weights @ _numbers(settled, one.effects, one.weights)[0] for one in free]
    beyond = [one for one, c in zip(free, sizes) if not is_possible(one.effects[0], one.effects[0].amplitude(c))]
    if beyond:  # the bounds of a search: the others are fitted without it
        names = {one.finding.effect for one in beyond}
        left = [one for one in expected if one.finding.effect not in names]
        told = [_row(one.finding, case, "not testable there", _BEYOND) for one in beyond]
        return [*told, *(_refitted(left, base, of_run, case) if left else ())]
    return [_compared(one, settled, gains, case) for one, gains in zip(free, shown, strict=True)]


def _in_another(findings: Sequence[Finding], first: Fit, machine: Machine, other: MeasuredData) -> list[Carried]:
    whole = validate(machine, other)
    fitted = calibrated(whole, searched(whole.data, np.ones(len(whole.data), dtype=bool)))
    base, known = fitted.base, catalogue(fitted.whole)
    rows: list[Carried] = []
    testable: list[_Expected] = []
    for finding in findings:
        own = next((e for e in first.model.effects if name_of(e) == finding.effect), None)
        if own is None:  # a law of the noise, of which no model holds an effect
            rows.append(_row(finding, other.name, "not testable there", "it is of the noise, and moves no reading"))
            continue
        effects = (own, *forms_of(own, first.model.effects))
        data, eye = first.model.formulation.data, np.eye(len(own.coefficients))
        weights = np.hstack([eye, *(form.nearest(first.at.recorded, data) for form in forms_of(own, effects))])
        numbers, spread = _numbers(first, effects, weights)
        one = _Expected(finding, effects, numbers, weights, spread=spread, wave=has_free_period(own))
        if why := _why_not(one, base, known.untestable):
            rows.append(_row(finding, other.name, "not testable there", why))
        else:
            testable.append(one)
    of_run = [c for c in known.candidates if name_of(c) in {row.effect for row in rows if row.why == _OF_RUN}]
    return [*rows, *(_refitted(testable, base, of_run, other.name) if testable else ())]


def _beside(base: Fit, expected: Sequence[_Expected], own: tuple[Effect, ...] = ()) -> Fit:
    """Return the fit of all that is expected, and of what is the `own` of the other run, beside the calibration."""
    model = Model(base.model.formulation, (*(effect for one in expected for effect in one.effects), *own))
    start = np.concatenate([base.x, *(one.numbers for one in expected), np.zeros(model.size)])[: model.size]
    return fit(model, base.noise, start, about=base)


def _gains(joint: Fit, one: _Expected) -> tuple[float, float]:
    """Return the gain of an effect beside the others, and that on poses left out of the fit, in squares of the noise.

    The noise is that which the fit of all leaves, where it is above the noise of the readings.
    """
    rest = tuple(effect for effect in joint.model.effects if effect not in one.effects)
    places = np.concatenate([np.arange(len(joint.x))[joint.model.place_of(effect)] for effect in one.effects])
    without = fit(Model(joint.model.formulation, rest), joint.noise, np.delete(joint.x, places), about=joint)
    fold = folds(joint.model.formulation.data, thresholds().folds)
    # the squares of the errors of whole poses, each left out of the linearised fit in turn
    errors = []
    for found in (without, joint):
        root = np.sqrt(found.noise.weights(found.r))
        each = np.repeat(fold, found.at.misclosure.shape[1])
        errors.append(float(np.sum(errors_left_out(found.J * root[:, None], root * found.r, each) ** 2)))
    taken = len(places) * np.log(len(joint.r))
    return (without.cost - joint.cost) / _left(joint) - taken, (errors[0] - errors[1]) / _left(joint)


def _left(found: Fit) -> float:
    """Return the variance that a fit leaves, in that of the noise, 1 at least where the noise is known."""
    if np.isfinite(found.noise.t_degrees):
        return 1.0
    left = found.cost / found.degrees
    return left if found.noise.profiled else max(left, 1.0)


def _compared(one: _Expected, joint: Fit, gains: tuple[float, float], case: str) -> Carried:
    effect, before, (gain, unseen) = one.effects[0], np.asarray(one.weights @ one.numbers), gains
    numbers, spread = _numbers(joint, one.effects, one.weights)
    c, both = one.weights @ numbers, spread + one.spread
    apart = _standard_errors(c - before, both)
    agrees = _standard_errors(c - before, both + _FORMULA**2 * np.outer(before, before)) <= _APART
    verdict: CarriedVerdict
    if gain > 0 and unseen > 0 and agrees:
        verdict, why = "carries", ""
    elif gain > 0:
        other = f"another {'wave' if one.wave else 'size'} is there" if unseen > 0 else ""
        verdict, why = "does not carry", other or "with it poses left out of the fit are no nearer"
    elif agrees:  # neither the size nor nothing can be ruled out
        would = _standard_errors(before, spread)
        verdict, why = "not testable there", f"its size would be {would:.1f} standard errors there, too few to show"
    else:
        verdict, why = "does not carry", "nothing of it shows"
    sizes = [amplitude_of(effect, at, own, joint.reach) for at, own in ((before, one.spread), (c, spread))]
    period = effect.period(c) if has_free_period(effect) and verdict == "carries" else 0.0  # type: ignore[attr-defined]
    return Carried(
        effect=one.finding.effect, family=one.finding.family, target=one.finding.target, case=case, verdict=verdict,
        why=why, size=sizes[0], there=sizes[1], apart=apart, agrees=bool(agrees), gain=gain, held_out_gain=unseen,
        period=period,
    )  # fmt: skip


def _standard_errors(difference: Array, covariance: Array) -> float:
    """Return the length of a difference in standard errors: of several numbers, that of one with the same p."""
    square = float(difference @ np.linalg.pinv(covariance, hermitian=True) @ difference)
    p = float(chdtrc(len(difference), square))
    return float(np.sqrt(square)) if len(difference) == 1 or p < 1e-300 else float(-ndtri(p / 2))


def _row(finding: Finding, case: str, verdict: CarriedVerdict, why: str) -> Carried:
    return Carried(finding.effect, finding.family, finding.target, case, verdict, why, finding.amplitude)
