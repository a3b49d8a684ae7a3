"""`explain`: fit -> test -> where -> name -> add -> refit -> validate -> verdict, on one set of measured data."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from discrepancy import machines
from discrepancy.atlas import Chart, charts
from discrepancy.data import DataError, MeasuredData
from discrepancy.effect import Effect, name_of
from discrepancy.effects import catalogue, noise_laws
from discrepancy.fit import PLACE, Fit, fit
from discrepancy.holdout import held_out, root, shrink
from discrepancy.interval import amplitude_interval
from discrepancy.machine import Formulation, Machine
from discrepancy.model import Model
from discrepancy.repeats import Repeats, excess_p, law_of
from discrepancy.report import (
    Amplitude,
    Candidate,
    Finding,
    Gap,
    Invisible,
    ParameterChange,
    Place,
    Report,
    Rival,
    Untested,
    Verdict,
)
from discrepancy.residual_problem import ResidualProblem, predicted
from discrepancy.score import VISIBLE, Scored
from discrepancy.select import Option, Tests, best_of_each, gain, options, run_tests, sets_of
from discrepancy.whiten import Noise
from problems.base import Array

_MOST = 3  # effects looked for
_EXPLAINED = 0.85  # part of the excess that names must account for
_CLEARLY = 6.0  # gain by which a chart must beat the names
_MATTERS = 0.15  # visible size [sigma] below which what is found is too small to matter


def explain(machine: str | Machine, data: MeasuredData, *, seed: int = 0, level: float = 0.01) -> Report:
    """Return what `data` say is missing from the machine's model, with error rates held at `level`.

    The same data and seed give the same report. Raises `DataError` for data that cannot be of this machine.
    """
    began = time.perf_counter()
    rng = np.random.default_rng(seed)
    machine = machines.make(machine) if isinstance(machine, str) else machine
    data = _in_order(data)
    whole = machine.formulate(data)
    train, hold = _parts(data)
    formulation = whole.on(data.rows(train))
    _enough(formulation)

    plain = fit(Model(formulation), Noise())
    noise, told, remarks = law_of(plain.r.reshape(len(formulation.data), -1), formulation.data)
    base = fit(Model(formulation), noise, plain.x)
    atlas, wide = charts(base)
    base = fit(Model(formulation.on(formulation.data.with_columns(wide))), noise, base.x)
    candidates, gaps = catalogue(whole)

    hunt = _hunt(base, candidates, atlas, rng, level)
    verdict, findings = _verdict(hunt, base)
    final = hunt.fit if verdict != "none" else base
    gap = _gap(base, final, whole.on(data.rows(hold)) if hold.any() else None, noise, told, hunt, rng)
    invisible, table = _table(hunt.first)
    return Report(
        case=data.name,
        machine=machine.name,
        verdict=verdict,
        findings=findings,
        gap=gap,
        where=_where(hunt.first) if verdict != "none" else (),
        not_testable=tuple(Untested(g.family, g.target, g.reason) for g in gaps),
        invisible=invisible,
        parameters=_parameters(base, final),
        seconds=time.perf_counter() - began,
        p=hunt.p,
        notes=(*whole.data.notes, *remarks),
        candidates=table,
        model=ResidualProblem(final.model, final),
        before=ResidualProblem(base.model, base),
    )


@final
@dataclass(frozen=True, eq=False)
class _Hunt:
    """What the search ended with: the fit with all picks, their sets, the first tests, whether something is left."""

    fit: Fit
    sets: tuple[tuple[Option, ...], ...]
    first: Tests
    p: float
    alarm: bool
    left: bool
    charted: bool
    chart: Chart | None


def _hunt(
    base: Fit, candidates: Sequence[Effect], atlas: Sequence[Chart], rng: np.random.Generator, level: float
) -> _Hunt:
    current, sets, picks = base, (), []  # type: ignore[var-annotated]
    first: Tests | None = None
    first_p, charted, left, chart = 1.0, False, False, None
    while True:
        taken = {name_of(e) for e in picks}
        tests = run_tests(current, [e for e in candidates if name_of(e) not in taken], atlas, rng)
        p = _overall(current, tests)
        if first is None:
            first, first_p = tests, p
        left = p < level
        if not left:
            break
        found = options(current, tests) if tests.p_names < level else ()  # misfit alone names nothing
        if found and tests.charted <= found[0].gain + _CLEARLY and found[0].gain > 0 and len(picks) < _MOST:
            picks.append(found[0].effect)
            picked = sets_of(picks, base, candidates)
            picks, current, sets = [s[0].effect for s in picked.sets], picked.fit, picked.sets
            continue
        if tests.charts and tests.charted > (found[0].gain if found else 0) + _CLEARLY:
            charted, chart = True, tests.charts[0].effect  # type: ignore[assignment]
        break
    return _Hunt(current, sets, first, first_p, first_p < level, left, charted, chart)


def _overall(at: Fit, tests: Tests) -> float:
    """Return the p of "nothing more": the smallest of names (weight .5), charts (.3) and lack of fit (.2)."""
    y, degrees = tests.on.y, tests.on.degrees
    lack = excess_p(float(y @ y) / degrees, degrees, at.noise.known)
    return min(1.0, tests.p_names / 0.5, tests.p_charts / 0.3, lack / 0.2)


def _verdict(hunt: _Hunt, base: Fit) -> tuple[Verdict, tuple[Finding, ...]]:
    if not hunt.alarm:
        return "none", ()
    before, after = _excess(base), _excess(hunt.fit)
    explained = 1 - max(after, 0.0) / before if before > 0 else 1.0
    if not hunt.sets or (hunt.left and (explained < _EXPLAINED or hunt.charted)):
        return "unknown", ()
    findings = tuple(_finding(hunt, i) for i in range(len(hunt.sets)))
    if np.sqrt(sum(f.visible**2 for f in findings)) < _MATTERS:
        return "negligible", findings
    return ("ambiguous" if any(len(f.set) > 1 for f in findings) else "named"), findings


def _excess(at: Fit) -> float:
    y = at.noise.scores(at.r)
    return float(y @ y) / (len(y) - at.J.shape[1]) - 1


def _finding(hunt: _Hunt, i: int) -> Finding:
    options_ = hunt.sets[i]
    best = options_[0]
    weights = {o.name: float(np.exp((o.gain - best.gain) / 2)) for o in options_}
    members = {o.name: (o.effect.family, o.effect.target) for o in options_}
    for o in options_:
        for twin in o.effect.twins:
            family, target = twin.split(" ", 1)
            weights.setdefault(twin, weights[o.name])
            members.setdefault(twin, (family, target))
    total = sum(weights.values())
    rivals = tuple(
        Rival(name, *members[name], weight / total) for name, weight in sorted(weights.items(), key=lambda w: -w[1])
    )
    effect, found = best.effect, hunt.fit
    at = _place_of(found.model, effect)
    c = found.x[at]
    covariance = found.covariance()[at, at]
    amplitude = Amplitude(effect.amplitude(c), effect.unit, amplitude_interval(effect, c, covariance))
    visible = np.sqrt(max(best.gain, 0.0) / len(found.r))
    return Finding(best.name, effect.family, effect.target, amplitude, best.gain, rivals, None, float(visible))


def _place_of(model: Model, effect: Effect) -> slice:
    at = len(model.formulation.parameters)
    for e in model.effects:
        if name_of(e) == name_of(effect):
            return slice(at, at + len(e.coefficients))
        at += len(e.coefficients)
    raise LookupError(name_of(effect))


def _gap(
    base: Fit, final: Fit, hold: Formulation | None, noise: Noise, told: Repeats, hunt: _Hunt, rng: np.random.Generator
) -> Gap:
    floor = noise.scale
    c = final.at.misclosure.shape[1]
    data = base.model.formulation.data
    train = [predicted(f.model, f.x, data).reshape(-1, c) for f in (base, final)]
    parts = [base.J.shape[1], final.J.shape[1]]
    scale = [np.sqrt(r.size / max(r.size - p, 1)) for r, p in zip(train, parts)]
    before, after = (root(r) * s for r, s in zip(train, scale))
    if hold is None:
        return Gap(floor, before, after, float("nan"), float("nan"), (float("nan"),) * 2, shrink(before, after, floor))
    unseen = [predicted(f.model, f.x, hold.data) for f in (base, final)]
    seen = held_out(*unseen, hold.data, rng)
    return Gap(floor, before, after, seen.before, seen.after, seen.ci95, shrink(seen.before, seen.after, floor))


def _where(tests: Tests) -> tuple[Place, ...]:
    ranked = sorted(tests.charts, key=lambda s: s.p)
    return tuple(Place(s.effect.target, s.effect.covariate, s.p) for s in ranked)  # type: ignore[attr-defined]


def _table(tests: Tests) -> tuple[tuple[Invisible, ...], tuple[Candidate, ...]]:
    best = best_of_each(tests.names, tests.on)
    hidden = tuple(
        Invisible(s.effect.family, s.effect.target, s.visible, s.detectable, s.effect.unit)
        for s in best
        if not s.m or s.visible < VISIBLE
    )
    table = tuple(
        Candidate(
            s.name, s.effect.family, s.effect.target, gain(s, tests.on), s.p, s.visible, s.detectable, s.effect.unit
        )
        for s in best
    )
    return hidden, table


def _parameters(base: Fit, final: Fit) -> dict[str, ParameterChange]:
    sd = np.sqrt(np.diag(final.covariance()))
    names = [p.name for p in base.model.formulation.parameters]
    return {n: ParameterChange(float(base.x[k]), float(final.x[k]), float(sd[k])) for k, n in enumerate(names)}


def _in_order(data: MeasuredData) -> MeasuredData:
    """Return the valid rows in the order of time, each with its place."""
    n = len(data)
    time_ = np.asarray(data["t_s"]) if data.has("t_s") else np.arange(n)
    order = np.argsort(time_, kind="stable")
    places = np.empty(n)
    places[order] = np.arange(n)
    data = data.with_columns({PLACE: places}).rows(order)
    return data.rows(np.asarray(data["valid"], dtype=bool)) if data.has("valid") else data


def _parts(data: MeasuredData) -> tuple[Array, Array]:
    if not data.has("split"):
        return np.ones(len(data), dtype=bool), np.zeros(len(data), dtype=bool)  # type: ignore[return-value]
    hold = np.asarray(data["split"]) == "hold"
    return ~hold, hold  # type: ignore[return-value]


def _enough(formulation: Formulation) -> None:
    n, p = len(formulation.data), len(formulation.parameters)
    if n < p + 1:
        raise DataError(f"{formulation.data.name}: {n} rows cannot carry {p} parameters; at least {p + 1} are needed")
