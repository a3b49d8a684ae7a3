"""Sections 4.1 to 4.4 of Cong et al. 2008: settings, Table 5, Table 6, Figs 3 to 5 and what is said about them.

The paper stops at 5e7 evaluations. At a smaller budget a level can be refuted (ours is lower already by more than a
decade); whatever else is said of a search is open there, and the verdict says so.

Some of its words are ambiguous: the study cong2008_readings runs GA and PSO in each reading, named by the options that
differ from the default. Its distance from a printed level is that of decimal logarithms; from a column of Table 6, the
mean over J1, J2 and J3. What the operators of our GA and PSO do is seen from outside, by candidates at the gate.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench import bench, optimizers
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import (
    NOTHING,
    Array,
    Evidence,
    Ours,
    Row,
    Ruling,
    Tolerance,
    at_budget,
    decades_between,
    judge_at_least,
    judge_level,
    judge_limit,
    judge_near,
    values_of,
)
from calibench.bench.papers.row import problem as make_problem
from calibench.bench.provenance.run_id import options_of
from calibench.bench.statistics.summary import goal_hits, median_of_reached

_EXACT = Tolerance(0.0, "a given number")
_METHODS = ("ga", "pso", "de")
_ERRORS = ("J1", "J2", "J3")
_FIGURES = {"J1": "Fig. 3", "J2": "Fig. 4", "J3": "Fig. 5"}
_BITS, _DIMENSION = 10, 4
_STUDY = "cong2008_readings"
_SECTIONS = {"ga": "4.1", "pso": "4.2"}
_DEFAULT = "as read by default"


@final
@dataclass(frozen=True)
class Reading:
    """A reading: its name, and the best values of its runs under each error function."""

    name: str
    best: Mapping[str, Array]

    def distance(self, error: str, printed: float) -> float:
        """Return the decades between the median and what is printed; infinite where nothing was run."""
        best = self.best[error]
        return decades_between(float(np.median(best)), printed) if len(best) else np.inf


def reading_rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield for each method the nearest reading over its column of Table 6, and for each of its cells."""
    for method in _SECTIONS:
        readings = readings_of(evidence, method)
        yield _column(printed, evidence, method, readings)
        for error in _ERRORS:
            yield _cell(printed, evidence, method, error, readings)


def readings_of(evidence: Evidence, method: str) -> list[Reading]:
    """Return the readings that were run, that by default first."""
    runs = evidence.runs[(evidence.runs["study"] == _STUDY) & (evidence.runs["optimizer"] == method)]
    default = json.loads(json.dumps(dict(options_of(optimizers.make(method)))))
    texts = sorted(set(runs["optimizer_options"]), key=lambda text: json.loads(text) != default)
    readings = []
    for text in texts:
        options = json.loads(text)
        changed = [f"{key}={value}" for key, value in options.items() if value != default[key]]
        mine = {error: evidence.of(_STUDY, "full12", method, {"error": error}, options) for error in _ERRORS}
        best = {error: values_of(some, "best_value") for error, some in mine.items()}
        readings.append(Reading(" ".join(changed).replace("False", "false") or _DEFAULT, best))
    return readings


def _column(printed: Printed, evidence: Evidence, method: str, readings: list[Reading]) -> Row:
    levels = {error: printed.column(f"table6.{method}")[error.lower()] for error in _ERRORS}
    far = {r.name: float(np.mean([r.distance(error, levels[error]) for error in _ERRORS])) for r in readings}
    order = sorted(far, key=lambda name: far[name])
    nearest = far[order[0]] if order else np.nan
    distances = "; ".join(f"{name} {far[name]:.2f}" for name in order)
    # more evaluations only lower a level: what a reading is too low by already, under the error where that is most, is
    # the least it can come to
    too_low = [
        max(
            reading.distance(error, level) if len(best) and np.median(best) < level else 0.0
            for error, level in levels.items()
            for best in [reading.best[error]]
        )
        for reading in readings
    ]
    least = min(too_low, default=np.nan)
    ruling = judge_limit(nearest, 0.0, 1.0)
    if not least > 1.0:
        ruling = at_budget(ruling, _reading_budget(evidence), printed.column("section44")["evaluations"])
    return printed.claim(
        f"reading_{method}", f"Section {_SECTIONS[method]}, Table 6",
        f"some reading of the open words gives the printed levels of {method.upper()}",
        ours=nearest if np.isfinite(nearest) else NOTHING, ruling=ruling,
        rule="true at no distance, in kind within a decade, over J1, J2 and J3; with less than the printed budget it "
        "is open until each reading is a decade too low under one of them",
        method=f"least mean distance of {len(readings)} readings from the column of Table 6, decades of medians",
        reason=f"nearest: {order[0] if order else 'none was run'}. Decades from it: {distances}. The reading that is "
        f"least too low is so by {least:.2f} decades under its worst error", unit="decades", printed=0.0,
    )  # fmt: skip


def _cell(printed: Printed, evidence: Evidence, method: str, error: str, readings: list[Reading]) -> Row:
    level = printed.column(f"table6.{method}")[error.lower()]
    order = sorted(readings, key=lambda reading: reading.distance(error, level))
    ours = Ours.of(order[0].best[error]) if order else NOTHING
    budget = _reading_budget(evidence)
    decade = Tolerance(0.0, "in kind within a decade", 1.0, decades=True)
    ruling = judge_level(level, ours, budget, printed.column("section44")["evaluations"], decade)
    best = [reading.best[error] for reading in readings if len(reading.best[error])]
    if any(np.median(values) >= level / 10 for values in best):  # one that is not too low yet may come to it
        ruling = at_budget(ruling, budget, printed.column("section44")["evaluations"])
    default = next((r.distance(error, level) for r in readings if r.name == _DEFAULT), np.nan)
    return printed.claim(
        f"reading_{method}_{error}", f"Table 6, {method.upper()} under {error}",
        f"the reading of {method.upper()} that comes nearest under {error}",
        ours=ours, ruling=ruling,
        rule="in kind within a decade; with less than the printed budget not reproduced where all are lower, else open",
        method=f"best {error}, the nearest of {len(readings)} readings, full12 (gauge=xa2), random plan",
        reason=f"nearest: {order[0].name}, {order[0].distance(error, level):.2f} decades after {budget:.3g} "
        f"evaluations; {_DEFAULT} {default:.2f}; farthest: {order[-1].name}, {order[-1].distance(error, level):.2f}"
        if order else "none was run", unit="mm^2" if error == "J1" else "mm^4", printed=level,
        about=f"table6.{method}.{error.lower()}",
        differs="it is the nearest of all readings after its own budget, the cell the reading by default after another",
    )  # fmt: skip


def _reading_budget(evidence: Evidence) -> float:
    budgets = evidence.runs.loc[evidence.runs["study"] == _STUDY, "budget"]
    return float(budgets.max()) if len(budgets) else np.nan


_SETTINGS = {
    "ga": {
        "population": "population", "precision": "precision", "crossover": "PCrossover", "mutation": "PMutation",
        "tournament": "tournament", "still_generations": "NR",
    },
    "pso": {
        "population": "population", "c1": "C1", "c2": "C2", "w_start": "w_first", "w_end": "w_last",
        "still_generations": "NR",
    },
    "de": {"population": "population", "f": "F", "cr": "CR"},
}  # fmt: skip


def search_rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield sections 4.1 to 4.4, Tables 5 and 6, the end values of Figs 3 to 5, and the claims on the methods."""
    yield from _settings(printed, evidence)
    yield from _table5(printed)
    for method in _METHODS:
        for error in _ERRORS:
            yield _level(printed, evidence, f"table6.{method}.{error.lower()}", method, error)
    for name in ("ga_j1", "pso_j1", "de_j1", "de_j2", "de_j3"):
        method, error = name.split("_")
        yield _level(printed, evidence, f"text.{name}", method, error.upper())
    yield from _claims(printed, evidence)


def _settings(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield the settings: what the rerun's rows say they were made with, or what its operators were seen to do."""
    for section in ("section41", "section42", "section43"):
        size = len(make_problem("full12").lower)
        yield printed.cell(
            f"{section}.parameters", size, _EXACT, "unknowns of full12", reason="of which readings see 11"
        )
    mutated, crossed = measured_operators()
    seen = "seen at the gate: children beside their parents, one operator at a time"
    yield printed.cell("section41.mutated_bits", mutated, _EXACT, seen)
    yield printed.cell("section41.crossover_points", crossed, _EXACT, seen)
    from calibench.optimizers.own._random_kernels import random_state, uniform

    with np.errstate(over="ignore"):
        state = random_state(np.random.default_rng(0))
        drawn = [float(uniform(state)) for _ in range(2000)]
    edge = Tolerance(0.01, "2000 numbers come this near to the ends of their range")
    for name, end in (("r_lower", min(drawn)), ("r_upper", max(drawn))):
        yield printed.cell(f"section42.{name}", end, edge, "2000 numbers of the generator of pso")
    for name, option in (("f", "F"), ("cr", "CR")):
        value = _option(evidence, "de", option)
        for bound, sign in (("lower", 1.0), ("upper", -1.0)):
            limit = printed.column("section43")[f"{name}_{bound}"]
            yield printed.cell(
                f"section43.{name}_{bound}", value, Tolerance(np.nan, "a range: true where the setting lies in it"),
                f"{option} in the rows of de", ruling=judge_limit(sign * (limit - value), 0.0),
            )  # fmt: skip
    ran = evidence.of("cong2008", "full12", "de", {"gauge": "xa2"})
    yield printed.cell("section44.samples", len(make_problem("full12").readings), _EXACT, "readings of full12")
    asked = printed.column("section44")["evaluations"]
    most = float(ran["charged"].max()) if len(ran) else np.nan
    yield printed.cell(
        "section44.evaluations", most if len(ran) else NOTHING, _EXACT, "evaluations in the rows of de",
        reason=f"the rerun stopped at {most:.3g}: only the paper budget checks this" if most < asked else "",
        ruling=at_budget(judge_near(asked, asked, most, _EXACT), most, asked),
    )  # fmt: skip
    for method, options in _SETTINGS.items():
        for name, option in options.items():
            value = _option(evidence, method, option)
            yield printed.cell(f"section44.{method}.{name}", value, _EXACT, f"{option} in the rows of {method}")
    for method in ("ga", "pso"):
        yield printed.cell(
            f"section44.{method}.reinitialised_fraction", renewed_fraction(method), _EXACT,
            "individuals drawn anew, seen at the gate on a function that never improves",
        )  # fmt: skip


def _table5(printed: Printed) -> Iterator[Row]:
    column = {role: printed.column(f"table5.{role}") for role in ("nominal", "actual", "lower", "upper")}
    for name in column["nominal"]:
        nominal, low, high = (column[role][name] for role in ("nominal", "lower", "upper"))
        exact = Tolerance(1e-12, "a given number")
        others = {
            "nominal": (printed.column("table8.nominal")[name], "Table 8, nominal values"),
            "actual": (printed.column("table7.actual")[name], "Table 7, actual values"),
            "lower": (2 * nominal - high, "the box is symmetric: twice the nominal value less the upper bound"),
            "upper": (2 * nominal - low, "the box is symmetric: twice the nominal value less the lower bound"),
        }
        for role, (value, method) in others.items():
            yield printed.cell(f"table5.{role}.{name}", value, exact, method)


def _level(printed: Printed, evidence: Evidence, key: str, method: str, error: str) -> Row:
    column, _, quantity = key.rpartition(".")
    entry = printed.column(column).entries[quantity]
    ours, budget = Ours.of(_best(evidence, method, error)), _budget(evidence)
    asked = printed.column("section44")["evaluations"]
    tolerance = Tolerance(
        printed.digit(key) / 2, "plan and random numbers are not printed: in kind within a decade", 1.0, decades=True
    )
    ruling = judge_level(entry.value, ours, budget, asked, tolerance)
    after = f"after {budget:.3g} evaluations, the printed level is said of {asked:.0e}"
    reason = f"{_decades(ours.median, entry.value):+.1f} decades from it {after}" if ours.n else ""
    figure = f"{_FIGURES[error]}: " if key.startswith("text") and reason else ""
    how = f"best {error} of {method}, paper's settings, full12 (gauge=xa2), random plan"
    return printed.cell(
        key, ours, tolerance, how, reason=figure + reason, ruling=ruling,
    )  # fmt: skip


def _claims(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    budget, asked = _budget(evidence), printed.column("section44")["evaluations"]
    after = f"after {budget:.3g} evaluations; the sentence is about {asked:.0e}"
    for error in _ERRORS:
        best = {m: _best(evidence, m, error) for m in _METHODS}
        wins = (best["de"] < best["pso"]) & (best["pso"] < best["ga"]) if _paired(*best.values()) else np.array([])
        share = float(wins.mean()) if len(wins) else np.nan
        yield printed.claim(
            f"ranking_{error}", f"Section 4.4, {_FIGURES[error]}", f"from worst to best: GA, PSO, DE ({error})",
            ours=share, ruling=at_budget(judge_at_least(share, 0.9, 0.5), budget, asked),
            rule="true where nine tenths of the repetitions are in this order, in kind half; open at a smaller budget",
            method="share of repetitions in this order", reason=after, printed=1.0,
        )  # fmt: skip
    scale = 4.0 * printed.column("geometry")["link"] ** 2
    for method in _METHODS:
        j1, j2, j3 = (_best(evidence, method, error) for error in _ERRORS)
        column = printed.column(f"table6.{method}")
        yield printed.claim(
            f"j2_lower_than_j1_{method}", "Section 4.4, Fig. 4",
            f"under J2 the errors get lower than under J1 ({method})",
            ours=Ours.of(j2 / (scale * j1) if _paired(j1, j2) else []), ruling=_below(j2, scale * j1, budget, asked),
            rule="true below 1/2, open at a smaller budget: J1 x 4 l_b^2 is what compares with J2",
            method="J2 over J1 x 238144, repetition by repetition", reason=f"J1 and J2 have different units; {after}",
            printed=column["j2"] / (scale * column["j1"]),
        )  # fmt: skip
        yield printed.claim(
            f"j3_improves_{method}", "Section 4.4, Fig. 5", f"under J3 the search results improve ({method})",
            ours=Ours.of(j3 / j2 if _paired(j2, j3) else []), ruling=_below(j3, j2, budget, asked),
            rule="true below 1/2, open at a smaller budget", method="best J3 over best J2, repetition by repetition",
            reason=after, printed=column["j3"] / column["j2"],
        )  # fmt: skip
    yield _random_points(printed)
    yield _speed(printed, evidence)
    floor = [float(p(p.truth)) for seed in range(10) for p in [make_problem("full12", error="J3", data_seed=seed)]]
    level = printed.column("table6.de")["j3"]
    yield printed.claim(
        "de_j3_is_rounding", "Table 6 and Fig. 5, DE under J3", "3.5946e-20 is as near to zero as doubles can tell",
        ours=Ours.of(floor), ruling=judge_limit(abs(_decades(float(np.median(floor)), level)), 1.0),
        rule="true where J3 of the true machine is within a decade of it",
        method="J3 at the truth over ten random plans",
        reason="rounding, not a better answer: nothing below 1e-18 is ranked", unit="mm^4", printed=level,
        about="table6.de.j3", differs="it asks what rounding leaves at the truth, the cell what DE reached",
    )  # fmt: skip
    yield _local_search(printed, evidence)


def _random_points(printed: Printed) -> Row:
    """Return how a random point of the box compares with what GA is said to reach under J1."""
    problem, rng = make_problem("full12", error="J1"), np.random.default_rng(0)
    points = problem.lower + rng.random((20_000, 12)) * (problem.upper - problem.lower)
    values = problem.batch(points)
    level = printed.column("table6.ga")["j1"]
    share = float((values <= level).mean())
    tries = 100 if share == 0 else np.log(0.5) / np.log1p(-share)
    return printed.claim(
        "j1_of_random_points", "Table 6, GA under J1", "1.3447e3 takes a search of 5e7 evaluations",
        ours=float(tries), ruling=judge_at_least(float(tries), 1e5),
        rule="true where half of all sets of 1e5 random points hold none as good",
        method="random points of Table 5's box after which one is as good with even odds",
        reason=f"{share:.1%} of random points are as good", printed=printed.column("section44")["evaluations"],
        about="table6.ga.j1",
        differs="it asks whether the level takes a search at all, the cell whether ours ends there",
    )  # fmt: skip


def _speed(printed: Printed, evidence: Evidence) -> Row:
    """Return when DE passes what PSO ends with, under J1: the 'very fast' of Fig. 3."""
    budget = _budget(evidence)
    de = evidence.of("cong2008", "full12", "de", {"error": "J1", "gauge": "xa2"})
    pso = _best(evidence, "pso", "J1")
    level = float(np.median(pso)) if len(pso) else np.nan
    shares = []
    for run_id in de["run_id"]:
        trace = evidence.trace(run_id)
        passed = trace[trace["best_value"] <= level]
        shares.append(float(passed["charged"].iloc[0]) / budget if len(passed) else np.inf)
    median = float(np.median(shares)) if shares else np.nan
    return printed.claim(
        "de_is_fast", "Section 4.4, Fig. 3", "DE converges faster than PSO",
        ours=Ours.of(min(s, 2.0) for s in shares),
        ruling=at_budget(judge_limit(median, 0.5, 1.0), budget, printed.column("section44")["evaluations"]),
        rule="true where DE passes PSO's end value within half the budget, in kind within it; open at a smaller budget",
        method="evaluations at which DE passes the median end of PSO, over the budget (2: not reached)",
        reason=f"at a budget of {budget:.3g}",
    )  # fmt: skip


def _local_search(printed: Printed, evidence: Evidence) -> Row:
    """Return whether deterministic methods are trapped, as section 4 supposes."""
    runs = evidence.of("cong2008", "full12", "trf", {"gauge": "xa2"})
    cost = goal_hits(runs)
    cost = cost[np.isfinite(cost)]
    won = [1.0] * len(cost) + [0.0] * (len(runs) - len(cost))
    return printed.claim(
        "local_methods_trapped", "Section 4", "deterministic methods are inappropriate: they stay in local minima",
        ours=Ours.of([1 - w for w in won]), ruling=judge_at_least(1 - float(np.mean(won)) if won else np.nan, 0.5, 0.1),
        rule="true where they miss the floor in half of all runs, in kind in a tenth",
        method="share of runs of trf, random starts in Table 5's box, J1, J2 and J3, that miss the last target",
        reason=f"they reach it after {median_of_reached(cost):.0f} charged evaluations (median)",
    )  # fmt: skip


def _best(evidence: Evidence, method: str, error: str) -> Array:
    return values_of(evidence.of("cong2008", "full12", method, {"error": error, "gauge": "xa2"}), "best_value")


def _budget(evidence: Evidence) -> float:
    runs = evidence.of("cong2008", "full12", "de", {"gauge": "xa2"})
    return float(runs["budget"].max()) if len(runs) else np.nan


def _option(evidence: Evidence, method: str, option: str) -> float:
    """Return an option as the rows of the rerun carry it; NaN where nothing was run, or they differ."""
    runs = evidence.of("cong2008", "full12", method, {"gauge": "xa2"})
    values: set[Any] = {json.loads(text)[option] for text in runs["optimizer_options"]}
    return float(values.pop()) if len(values) == 1 else np.nan


def _below(above: Array, below: Array, budget: float, asked: float) -> Ruling:
    ratio = float(np.median(above / below)) if _paired(above, below) else np.nan
    return at_budget(judge_limit(ratio, 0.5), budget, asked)


def _paired(*columns: Array) -> bool:
    return bool(len(columns[0])) and len({len(column) for column in columns}) == 1


def _decades(a: float, b: float) -> float:
    return float(np.log10(a / b)) if a > 0 and b > 0 else np.nan


class _Recorder:
    """A function on a box whose points are the integers that strings stand for; it never improves."""

    def __init__(self) -> None:
        self.lower, self.upper = np.zeros(_DIMENSION), np.full(_DIMENSION, 2.0**_BITS - 1)
        self.start = self.lower.copy()
        self.seen: list[Array] = []

    def __call__(self, x: Array) -> float:
        return 1.0

    def batch(self, points: Array) -> Array:
        self.seen.append(np.array(points))
        return np.ones(len(points))


def measured_operators() -> tuple[float, float]:
    """Return (bits that a mutation flips, points at which a crossing changes parent), medians over one generation."""
    flipped = _generation(PMutation=1.0, PCrossover=0.0)
    crossed = _generation(PMutation=0.0, PCrossover=1.0)
    distance = [int((flipped[0] != child).sum(axis=1).min()) for child in flipped[1]]
    return float(np.median(distance)), float(np.median([_switches(crossed[0], child) for child in crossed[1]]))


def renewed_fraction(method: str) -> float:
    """Return the share of the population that begins again when nothing improves."""
    still = {"C1": 0.0, "C2": 0.0, "w_first": 0.0, "w_last": 0.0, "initial_velocity": "zero"} if method == "pso" else {}
    recorder = _Recorder()
    bench.execute(recorder, optimizers.make(method, population=100, NR=1, **still), budget=1000)
    rounds = recorder.seen[:-1]  # the budget may have cut the last
    if method == "ga":  # evaluates only who is new
        return min(len(points) for points in rounds) / len(rounds[0])
    pairs = pairwise(rounds)
    return max(float((after != before).any(axis=1).mean()) for before, after in pairs)


def _generation(**options: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the strings of the first population and of its children, shapes (N, bits) and (N - 1, bits)."""
    recorder = _Recorder()
    ga = optimizers.make("ga", population=60, precision=1.0, tournament=1, **options)
    bench.execute(recorder, ga, budget=60 + 59)
    return _strings(recorder.seen[0]), _strings(recorder.seen[1])


def _strings(points: Array) -> NDArray[np.int64]:
    whole = np.rint(points).astype(np.int64)
    bits = (whole[:, :, None] >> np.arange(_BITS - 1, -1, -1)) & 1
    return np.asarray(bits.reshape(len(points), -1))


def _switches(parents: NDArray[np.int64], child: NDArray[np.int64]) -> int:
    """Return at how many points, at least, the child changes from one parent to another; 0 for a copy."""
    at, count = 0, -1
    while at < len(child):
        same = parents[:, at:] == child[at:]
        run = int(np.where(same.all(axis=1), same.shape[1], same.argmin(axis=1)).max())
        if not run:
            return len(child)  # of no parent
        at, count = at + run, count + 1
    return count
