"""Sections 4.1 to 4.4 of Cong et al. 2008: settings, Tables 5 and 6, Figs 3 to 5, what is said of them; and the errata.

The paper stops at 5e7 evaluations: at a smaller budget a level can be refuted, and all else is open. The study
cong2008_readings runs GA and PSO in each reading of the paper's ambiguous words, called by what differs from default.
Of an erratum of a formula, `printed` is what the printed formula gives, `read` what it must give, and ours what the
corrected one gives. A new erratum in the data file without its computation here is an error.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import nan
from statistics import NormalDist
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench import bench, optimizers
from calibench.bench.papers import ledger
from calibench.bench.papers.cong2008.machine import Recorder, columns, implied, nine_point_rounds
from calibench.bench.papers.ledger import Array, Evidence, Ours, Printed, Row, Ruling, Tolerance
from calibench.bench.provenance.run_id import options_of
from calibench.bench.statistics.summary import goal_hits, median_of_reached
from calibench.problems.planar.gpm2002 import NAMES, home, inverse_kinematics, makers_machine, to_cartesian, to_polar

_EXACT = Tolerance(0.0, "a given number")
_DECADE = Tolerance(0.0, "in kind within a decade", 1.0, decades=True)
_METHODS = ("ga", "pso", "de")
_ERRORS = ("J1", "J2", "J3")
_FIGURES = {"J1": "Fig. 3", "J2": "Fig. 4", "J3": "Fig. 5"}
_BITS = 10
# a function of four variables that never improves; its points are the integers that strings stand for
_NEVER_IMPROVING = np.zeros(4), np.full(4, 2.0**_BITS - 1), lambda points: np.ones(len(points))
_STUDY = "cong2008_readings"
_SECTIONS = {"ga": "4.1", "pso": "4.2"}
_DEFAULT = "as read by default"
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


def reading_rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield for each method the nearest reading over its column of Table 6, and for each of its cells."""
    asked = printed.column("section44")["evaluations"]
    budgets = evidence.runs.loc[evidence.runs["study"] == _STUDY, "budget"]
    budget = float(budgets.max()) if len(budgets) else np.nan
    for method in _SECTIONS:
        # those that were run, that by default first
        runs = evidence.runs[(evidence.runs["study"] == _STUDY) & (evidence.runs["optimizer"] == method)]
        plainly = json.loads(json.dumps(dict(options_of(optimizers.make(method)))))
        levels = {error: printed.column(f"table6.{method}")[error.lower()] for error in _ERRORS}
        best: dict[str, dict[str, Array]] = {}  # values of each reading's runs under each error function
        for text in sorted(set(runs["optimizer_options"]), key=lambda text: json.loads(text) != plainly):
            options = json.loads(text)
            changed = [f"{key}={value}" for key, value in options.items() if value != plainly[key]]
            mine = {error: evidence.of(_STUDY, "full12", method, {"error": error}, options) for error in _ERRORS}
            name = " ".join(changed).replace("False", "false") or _DEFAULT
            best[name] = {error: ledger.values_of(some, "best_value") for error, some in mine.items()}
        far = {  # decades between the median and what is printed; infinite where nothing was run
            name: {error: ledger.decades_between(ledger.median(of[error]), levels[error]) for error in _ERRORS}
            for name, of in best.items()
        }
        yield _column(printed, method, best, far, levels, budget)
        for error, level in levels.items():
            order = sorted(far, key=lambda name: far[name][error])
            ours = Ours.of(best[order[0]][error]) if order else ledger.NOTHING
            ruling = ledger.judge_level(level, ours, budget, asked, _DECADE)
            # one that is not too low yet may come to it
            if any(len(of[error]) and np.median(of[error]) >= level / 10 for of in best.values()):
                ruling = ledger.at_budget(ruling, budget, asked)
            default = far[_DEFAULT][error] if _DEFAULT in far else np.nan
            yield printed.claim(
                f"reading_{method}_{error}", f"Table 6, {method.upper()} under {error}",
                f"the reading of {method.upper()} that comes nearest under {error}", ours=ours, ruling=ruling,
                rule="in kind within a decade; with less than the printed budget not reproduced where all are lower, "
                "else open",
                method=f"best {error}, the nearest of {len(best)} readings, full12 (gauge=xa2), random plan",
                reason=f"nearest: {order[0]}, {far[order[0]][error]:.2f} decades after {budget:.3g} evaluations; "
                f"{_DEFAULT} {default:.2f}; farthest: {order[-1]}, {far[order[-1]][error]:.2f}"
                if order else "none was run", unit="mm^2" if error == "J1" else "mm^4", printed=level,
                about=f"table6.{method}.{error.lower()}", differs="it is the nearest of all readings after its own "
                "budget, the cell the reading by default after another",
            )  # fmt: skip


def _column(
    printed: Printed, method: str, best: Mapping[str, Mapping[str, Array]], far: Mapping[str, Mapping[str, float]],
    levels: Mapping[str, float], budget: float,
) -> Row:  # fmt: skip
    mean = {name: float(np.mean([*of.values()])) for name, of in far.items()}
    order = sorted(mean, key=lambda name: mean[name])
    nearest = mean[order[0]] if order else np.nan
    # more evaluations only lower a level: what a reading is too low by already, under the error where that is most, is
    # the least it can come to
    too_low = [
        max((far[name][error] for error, values in of.items() if ledger.median(values) < levels[error]), default=0.0)
        for name, of in best.items()
    ]
    least = min(too_low, default=np.nan)
    ruling = ledger.judge_limit(nearest, 0.0, 1.0)
    if not least > 1.0:
        ruling = ledger.at_budget(ruling, budget, printed.column("section44")["evaluations"])
    return printed.claim(
        f"reading_{method}", f"Section {_SECTIONS[method]}, Table 6",
        f"some reading of the open words gives the printed levels of {method.upper()}",
        ours=nearest if np.isfinite(nearest) else ledger.NOTHING, ruling=ruling,
        rule="true at no distance, in kind within a decade, over J1, J2 and J3; with less than the printed budget it "
        "is open until each reading is a decade too low under one of them",
        method=f"least mean distance of {len(best)} readings from the column of Table 6, decades of medians",
        reason=f"nearest: {order[0] if order else 'none was run'}. Decades from it: "
        f"{'; '.join(f'{name} {mean[name]:.2f}' for name in order)}. The reading that is least too low is so by "
        f"{least:.2f} decades under its worst error", unit="decades", printed=0.0,
    )  # fmt: skip


def search_rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield sections 4.1 to 4.4, Tables 5 and 6, the end values of Figs 3 to 5, and the claims on the methods."""
    searches = _Searches(evidence, printed.column("section44")["evaluations"])
    budget, asked = searches.budget, searches.asked
    yield from _settings(printed, searches)
    column = {role: printed.column(f"table5.{role}") for role in ("nominal", "actual", "lower", "upper")}
    for name in column["nominal"]:
        nominal, low, high = (column[role][name] for role in ("nominal", "lower", "upper"))
        for role, value, method in (
            ("nominal", printed.column("table8.nominal")[name], "Table 8, nominal values"),
            ("actual", printed.column("table7.actual")[name], "Table 7, actual values"),
            ("lower", 2 * nominal - high, "the box is symmetric: twice the nominal value less the upper bound"),
            ("upper", 2 * nominal - low, "the box is symmetric: twice the nominal value less the lower bound"),
        ):
            yield printed.cell(f"table5.{role}.{name}", value, Tolerance(1e-12, "a given number"), method)
    keys = [f"table6.{method}.{error.lower()}" for method in _METHODS for error in _ERRORS]
    for key in (*keys, "text.ga_j1", "text.pso_j1", "text.de_j1", "text.de_j2", "text.de_j3"):
        method, error = key.upper().replace("_", ".").split(".")[-2:]
        name, _, quantity = key.rpartition(".")
        entry, digit, reason = printed.column(name).entries[quantity], printed.digit(key), ""
        ours = Ours.of(searches.best(method.lower(), error))
        if ours.n:
            figure = f"{_FIGURES[error]}: " if key.startswith("text") else ""
            apart = float(np.log10(ours.median / entry.value)) if ours.median > 0 else np.nan
            reason = f"{figure}{apart:+.1f} decades from it after {budget:.3g} "
            reason += f"evaluations, the printed level is said of {asked:.0e}"
        why = "plan and random numbers are not printed: in kind within a decade"
        tolerance = Tolerance(digit / 2, why, 1.0, decades=True)
        how = f"best {error} of {method.lower()}, paper's settings, full12 (gauge=xa2), random plan"
        ruling = ledger.judge_level(entry.value, ours, budget, asked, tolerance)
        yield printed.cell(key, ours, tolerance, how, reason=reason, ruling=ruling)
    after = f"after {budget:.3g} evaluations; the sentence is about {asked:.0e}"
    for error in _ERRORS:
        best = {m: searches.best(m, error) for m in _METHODS}
        wins = (best["de"] < best["pso"]) & (best["pso"] < best["ga"]) if _paired(*best.values()) else np.array([])
        share = float(wins.mean()) if len(wins) else np.nan
        yield printed.claim(
            f"ranking_{error}", f"Section 4.4, {_FIGURES[error]}", f"from worst to best: GA, PSO, DE ({error})",
            ours=share, ruling=ledger.at_budget(ledger.judge_at_least(share, 0.9, 0.5), budget, asked),
            rule="true where nine tenths of the repetitions are in this order, in kind half; open at a smaller budget",
            method="share of repetitions in this order", reason=after, printed=1.0,
        )  # fmt: skip
    scale = 4.0 * printed.column("geometry")["link"] ** 2
    for method in _METHODS:
        j1, j2, j3 = (searches.best(method, error) for error in _ERRORS)
        table6 = printed.column(f"table6.{method}")
        ratios = j2 / (scale * j1) if _paired(j1, j2) else np.array([])
        yield printed.claim(
            f"j2_lower_than_j1_{method}", "Section 4.4, Fig. 4",
            f"under J2 the errors get lower than under J1 ({method})",
            ours=ratios, ruling=ledger.at_budget(ledger.judge_limit(ledger.median(ratios), 0.5), budget, asked),
            rule="true below 1/2, open at a smaller budget: J1 x 4 l_b^2 is what compares with J2",
            method="J2 over J1 x 238144, repetition by repetition", reason=f"J1 and J2 have different units; {after}",
            printed=table6["j2"] / (scale * table6["j1"]),
        )  # fmt: skip
        ratios = j3 / j2 if _paired(j2, j3) else np.array([])
        yield printed.claim(
            f"j3_improves_{method}", "Section 4.4, Fig. 5", f"under J3 the search results improve ({method})",
            ours=ratios, ruling=ledger.at_budget(ledger.judge_limit(ledger.median(ratios), 0.5), budget, asked),
            rule="true below 1/2, open at a smaller budget", method="best J3 over best J2, repetition by repetition",
            reason=after, printed=table6["j3"] / table6["j2"],
        )  # fmt: skip
    yield from _single_claims(printed, searches)


@final
@dataclass(frozen=True)
class _Searches:
    """The runs of the paper's own study on full12 (gauge=xa2), and the evaluations that the paper says it made."""

    evidence: Evidence
    asked: float

    def of(self, method: str, **options: str) -> Any:
        return self.evidence.of("cong2008", "full12", method, {"gauge": "xa2"} | options)

    def best(self, method: str, error: str) -> Array:
        return ledger.values_of(self.of(method, error=error), "best_value")

    @property
    def budget(self) -> float:
        runs = self.of("de")
        return float(runs["budget"].max()) if len(runs) else np.nan

    def option(self, method: str, option: str) -> float:
        """Return an option as the rows of the rerun carry it; NaN where nothing was run, or they differ."""
        values: set[Any] = {json.loads(text)[option] for text in self.of(method)["optimizer_options"]}
        return float(values.pop()) if len(values) == 1 else np.nan


def _settings(printed: Printed, searches: _Searches) -> Iterator[Row]:
    """Yield the settings: what the rerun's rows say they were made with, or what its operators were seen to do."""
    full = ledger.problem("full12")
    for section in ("section41", "section42", "section43"):
        how = "unknowns of full12"
        yield printed.cell(f"{section}.parameters", len(full.lower), _EXACT, how, reason="of which readings see 11")
    # over one generation: bits that a mutation flips, points at which a crossing changes parent
    before, flipped = _generation(PMutation=1.0, PCrossover=0.0)
    mutated = ledger.median([int((before != child).sum(axis=1).min()) for child in flipped])
    parents, crossings = _generation(PMutation=0.0, PCrossover=1.0)
    switches = []  # at how many points, at least, a child changes from one parent to another; 0 for a copy
    for child in crossings:
        at, count = 0, -1
        while at < len(child):
            same = parents[:, at:] == child[at:]
            run = int(np.where(same.all(axis=1), same.shape[1], same.argmin(axis=1)).max())
            if not run:  # of no parent
                count = len(child)
                break
            at, count = at + run, count + 1
        switches.append(count)
    seen = "seen at the gate: children beside their parents, one operator at a time"
    yield printed.cell("section41.mutated_bits", mutated, _EXACT, seen)
    yield printed.cell("section41.crossover_points", ledger.median(switches), _EXACT, seen)
    drawn, edge = drawn_by_pso(0), Tolerance(0.01, "2000 numbers come this near to the ends of their range")
    for name, end in (("r_lower", min(drawn)), ("r_upper", max(drawn))):
        yield printed.cell(f"section42.{name}", end, edge, "2000 numbers of the generator of pso")
    for name, option in (("f", "F"), ("cr", "CR")):
        value = searches.option("de", option)
        for bound, sign in (("lower", 1.0), ("upper", -1.0)):
            limit = printed.column("section43")[f"{name}_{bound}"]
            yield printed.cell(
                f"section43.{name}_{bound}", value, Tolerance(np.nan, "a range: true where the setting lies in it"),
                f"{option} in the rows of de", ruling=ledger.judge_limit(sign * (limit - value), 0.0),
            )  # fmt: skip
    yield printed.cell("section44.samples", len(full.readings), _EXACT, "readings of full12")
    ran, asked = searches.of("de"), searches.asked
    most = float(ran["charged"].max()) if len(ran) else np.nan
    yield printed.cell(
        "section44.evaluations", most, _EXACT, "evaluations in the rows of de",
        reason=f"the rerun stopped at {most:.3g}: only the paper budget checks this" if most < asked else "",
        ruling=ledger.at_budget(ledger.judge_near(asked, asked, most, _EXACT), most, asked),
    )  # fmt: skip
    for method, options in _SETTINGS.items():
        for name, option in options.items():
            how = f"{option} in the rows of {method}"
            yield printed.cell(f"section44.{method}.{name}", searches.option(method, option), _EXACT, how)
    how = "individuals drawn anew, seen at the gate on a function that never improves"
    stand_still = {"C1": 0.0, "C2": 0.0, "w_first": 0.0, "w_last": 0.0, "initial_velocity": "zero"}
    for method in ("ga", "pso"):
        recorder, still = Recorder(*_NEVER_IMPROVING), stand_still if method == "pso" else {}
        bench.execute(recorder, optimizers.make(method, population=100, NR=1, **still), budget=1000)
        rounds = recorder.seen[:-1]  # the budget may have cut the last
        renewed = min(len(points) for points in rounds) / len(rounds[0])  # ga evaluates only who is new
        if method == "pso":
            renewed = max(float((after != before).any(axis=1).mean()) for before, after in pairwise(rounds))
        yield printed.cell(f"section44.{method}.reinitialised_fraction", renewed, _EXACT, how)


def drawn_by_pso(seed: int) -> list[float]:
    """Return 2000 numbers of the generator of our own optimisers."""
    from calibench.optimizers.own._random_kernels import random_state, uniform

    with np.errstate(over="ignore"):
        state = random_state(np.random.default_rng(seed))
        return [float(uniform(state)) for _ in range(2000)]


def _single_claims(printed: Printed, searches: _Searches) -> Iterator[Row]:
    budget, asked = searches.budget, searches.asked
    # how a random point of the box compares with what GA is said to reach under J1
    problem, rng = ledger.problem("full12", error="J1"), np.random.default_rng(0)
    points = problem.lower + rng.random((20_000, 12)) * (problem.upper - problem.lower)
    share = float((problem.batch(points) <= printed.column("table6.ga")["j1"]).mean())
    tries = float(100 if share == 0 else np.log(0.5) / np.log1p(-share))
    yield printed.claim(
        "j1_of_random_points", "Table 6, GA under J1", "1.3447e3 takes a search of 5e7 evaluations",
        ours=tries, ruling=ledger.judge_at_least(tries, 1e5),
        rule="true where half of all sets of 1e5 random points hold none as good",
        method="random points of Table 5's box after which one is as good with even odds",
        reason=f"{share:.1%} of random points are as good", printed=asked, about="table6.ga.j1",
        differs="it asks whether the level takes a search at all, the cell whether ours ends there",
    )  # fmt: skip
    # when DE passes what PSO ends with, under J1: the 'very fast' of Fig. 3
    level, traces = ledger.median(searches.best("pso", "J1")), searches.evidence.traces
    shares = []
    for run_id in searches.of("de", error="J1")["run_id"]:
        passed = traces[(traces["run_id"] == run_id) & (traces["best_value"] <= level)]
        shares.append(float(passed["charged"].iloc[0]) / budget if len(passed) else np.inf)
    yield printed.claim(
        "de_is_fast", "Section 4.4, Fig. 3", "DE converges faster than PSO",
        ours=[min(s, 2.0) for s in shares],
        ruling=ledger.at_budget(ledger.judge_limit(ledger.median(shares), 0.5, 1.0), budget, asked),
        rule="true where DE passes PSO's end value within half the budget, in kind within it; open at a smaller budget",
        method="evaluations at which DE passes the median end of PSO, over the budget (2: not reached)",
        reason=f"at a budget of {budget:.3g}",
    )  # fmt: skip
    floor = [float(p(p.truth)) for seed in range(10) for p in [ledger.problem("full12", error="J3", data_seed=seed)]]
    level = printed.column("table6.de")["j3"]
    yield printed.claim(
        "de_j3_is_rounding", "Table 6 and Fig. 5, DE under J3", "3.5946e-20 is as near to zero as doubles can tell",
        ours=floor, ruling=ledger.judge_limit(ledger.decades_between(ledger.median(floor), level), 1.0),
        rule="true where J3 of the true machine is within a decade of it",
        method="J3 at the truth over ten random plans",
        reason="rounding, not a better answer: nothing below 1e-18 is ranked", unit="mm^4", printed=level,
        about="table6.de.j3", differs="it asks what rounding leaves at the truth, the cell what DE reached",
    )  # fmt: skip
    # whether deterministic methods are trapped, as section 4 supposes
    runs = searches.of("trf")
    cost = goal_hits(runs)
    cost = cost[np.isfinite(cost)]
    missed = [0.0] * len(cost) + [1.0] * (len(runs) - len(cost))
    yield printed.claim(
        "local_methods_trapped", "Section 4", "deterministic methods are inappropriate: they stay in local minima",
        ours=missed, ruling=ledger.judge_at_least(1 - len(cost) / len(runs) if missed else np.nan, 0.5, 0.1),
        rule="true where they miss the floor in half of all runs, in kind in a tenth",
        method="share of runs of trf, random starts in Table 5's box, J1, J2 and J3, that miss the last target",
        reason=f"they reach it after {median_of_reached(cost):.0f} charged evaluations (median)",
    )  # fmt: skip


def _paired(*columns: Array) -> bool:
    return bool(len(columns[0])) and len({len(column) for column in columns}) == 1


def _generation(**options: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the strings of the first population and of its children, shapes (N, bits) and (N - 1, bits)."""
    recorder = Recorder(*_NEVER_IMPROVING)
    ga = optimizers.make("ga", population=60, precision=1.0, tournament=1, **options)
    bench.execute(recorder, ga, budget=60 + 59)
    strings = []
    for points in recorder.seen[:2]:
        whole = np.rint(points).astype(np.int64)
        bits = (whole[:, :, None] >> np.arange(_BITS - 1, -1, -1)) & 1
        strings.append(np.asarray(bits.reshape(len(points), -1)))
    return strings[0], strings[1]


_COUNT = Tolerance(0.0, "a count")
_ROUNDING = Tolerance(1e-9, "rounding")
_CURVE = Tolerance(1e-3, "the sound lengths of the column lie within 2e-4 mm of the curve")


def erratum_rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield a row for each erratum of the data file. Raises `KeyError` for one without a computation."""
    shown = [*_tables(printed), *_searches(printed, evidence), *_tracking(printed), *_kinematics(printed)]
    return printed.in_order(shown)


def _tables(printed: Printed) -> Iterator[Row]:
    four, seven = columns(printed)
    entry = printed.column("table3.j3").entries["la3"]
    lb3 = printed.column("table3.actual")["lb3"]
    needed = f"solved from their initial offsets; Table 7's curve needs {seven.problem.gauge_curve(0.0)[8]:g}"
    for place, name, quantity, wrong, right, method in (
        ("Table 3, three columns, and Table 4, last column, row la3", "la3", "l_a3", entry.printed, entry.value,
         "solved from the initial offsets of Tables 3 and 4"),
        ("Tables 3 and 4 against Tables 5 to 7, lb3", "lb3", "l_b3 of Tables 3 and 4", lb3, lb3, needed),
    ):  # fmt: skip
        values = [implied(printed, table, name) for table in ("table3", "table4")]
        yield printed.erratum(
            place, quantity, unit="mm", printed=wrong, read=right, ours=[value for value, _ in values], method=method,
            tolerance=Tolerance(max(worth for _, worth in values), "what 1e-5 rad of the printed initial z3 is worth"),
        )  # fmt: skip
    entries = printed.column(four.key).entries
    for cells in (("la1", "la2", "la3"), ("lb2", "lb3")):
        curve = {n: four.predicted(n) for n in cells}
        yield printed.erratum(
            f"Table 4, column '12 values', rows {' '.join(cells)}",
            "largest distance of these cells from the gauge curve", unit="mm",
            printed=max(abs(entries[n].printed - curve[n]) for n in cells), read=0.0,
            ours=[abs(entries[n].value - curve[n]) for n in cells],
            tolerance=Tolerance(1e-3, "the sound cells lie within 7e-4 mm of it"),
            method="the curve, fitted to the other lengths",
        )  # fmt: skip
    column, actual = printed.column(seven.key), printed.column("table7.actual")
    entry, kmrmse = column.entries["ya2"], column.entries["kmrmse"]
    yield printed.erratum(
        "Table 7, row ya2", "y_a2", unit="mm", printed=entry.printed, read=entry.value, ours=seven.predicted("ya2"),
        tolerance=_CURVE, method="gauge curve of Table 7",
    )  # fmt: skip
    yield printed.erratum(
        "Table 7, kmrmse, and the text below it", "rms distance of the samples from A_1 that this kmrmse needs",
        unit="mm", printed=kmrmse.printed / seven.similarity, read=kmrmse.value / seven.similarity,
        ours=float(np.hypot(*(home() - makers_machine()[:2]))),
        tolerance=Tolerance(25.0, "samples within a disc of up to 150 mm about the home point, 216.5 mm from A_1"),
        method="kmrmse over the displacement of a point 1 mm from A_1; ours: the home point",
    )  # fmt: skip
    lengths = [n for n in actual if n[0] != "z"]
    yield printed.erratum(
        "section 4.4, below Table 7", "largest error of Table 7", unit="mm",
        printed=max(abs(column.entries[n].printed - actual[n]) for n in lengths),
        read=max(abs(column[n] - actual[n]) for n in lengths),
        ours=max(abs(seven.predicted(n) - actual[n]) for n in lengths), tolerance=_CURVE,
        method="gauge curve of Table 7",
    )  # fmt: skip


def _searches(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    table, text = printed.column("table6.ga")["j1"], printed.column("text")["ga_j1"]
    runs = ledger.values_of(evidence.of("cong2008", "full12", "ga", {"error": "J1", "gauge": "xa2"}), "best_value")
    spread = float(np.std(np.log10(runs))) if len(runs) > 1 else nan
    apart = float(abs(np.log10(text / table)))
    yield printed.erratum(
        "Table 6, GA under J1, against section 4.4",
        "difference of the two prints, in decades; ours: spread of repetitions", unit="1", printed=apart, read=apart,
        ours=spread,
        tolerance=Tolerance(apart / 2, "decided where two deviations of repetitions are less than the difference"),
        method="standard deviation of log10 J1 of ga",
        ruling=Ruling("not reproduced" if apart > 2 * spread else "not checkable", spread, "at most", apart / 2),
        differs="it asks which of two digits is right, the cells whether the level is reached",
    )  # fmt: skip
    column = printed.column("table6.de")
    yield printed.erratum(
        "section 4.4, end of the text on the figures", "figure that shows 3.5946e-20", unit="1", printed=4, read=5,
        ours=3 + [column[name] for name in column].index(printed.column("text")["de_j3"]), tolerance=_COUNT,
        method="place of the number in Table 6's column: J1 is Fig. 3, J2 Fig. 4, J3 Fig. 5",
    )  # fmt: skip
    yield printed.erratum(
        "Table 5, nominal z2", "nominal z2", unit="rad", printed=nan, read=printed.column("table5.nominal")["z2"],
        ours=printed.column("table8.nominal")["z2"], tolerance=_COUNT, method="Table 8, nominal values",
        differs="the cell's row takes the empty cell for the 0 that Table 8 prints",
    )  # fmt: skip
    yield printed.erratum(
        "section 4.4, first paragraph", "range of i, the joints", unit="1",
        printed=printed.column("section44")["samples"], read=3, ours=ledger.problem("full12").readings.shape[1],
        tolerance=_COUNT, method="readings of one configuration",
    )  # fmt: skip
    drawn = np.array(drawn_by_pso(1))
    normal = NormalDist()
    yield printed.erratum(
        "section 4.3, after (47)", "share of randb outside [0, 1]", unit="1",
        printed=1 - (normal.cdf(1) - normal.cdf(0)), read=0.0, ours=float(((drawn < 0) | (drawn > 1)).mean()),
        tolerance=_COUNT, method="a standard normal number, and 2000 numbers of our generator",
    )  # fmt: skip


def _tracking(printed: Printed) -> Iterator[Row]:
    tracking, identity = ledger.problem("tracking_zero"), np.eye(3)
    ends = []
    for step in (1.0, 2.0, 4.0, 8.0, 16.0):
        best = bench.execute(tracking, optimizers.make("nine_point", step=step), budget=2000).best_x
        ends.append(nan if best is None else float(np.abs(best).max()))
    yield printed.erratum(
        "section 2.5, initial value of d",
        "where the procedure ends from d = 1, 2, 4, 8, 16 mm; the number itself is lost", unit="mm", printed=nan,
        read=nan, ours=ends, tolerance=Tolerance(nan, "not checkable: nothing legible to compare with"),
        method="worst coordinate of nine_point's answer", ruling=ledger.judge_near(nan, nan, nan, _COUNT),
    )  # fmt: skip
    yield printed.erratum(
        "equation (15)", "rank of P: infeasible directions of three joints with two degrees of freedom", unit="1",
        printed=float(np.trace(identity - identity @ np.linalg.inv(identity.T) @ identity.T)), read=3 - 2,
        ours=np.trace(tracking.projectors, axis1=1, axis2=2), tolerance=_ROUNDING,
        method="trace of P, as printed and as in tracking_zero",
    )  # fmt: skip
    listed = {(0, 0), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, -1), (1, -1)}  # with R itself; (-1, 1) is listed twice
    yield printed.erratum(
        "section 2.4, step 5", "estimates compared in step 6", unit="1", printed=len(listed),
        read=printed.column("section24")["estimates"], ours=len(nine_point_rounds()[-1]) + 1, tolerance=_COUNT,
        method="different points in the printed list and in a round of our search",
    )  # fmt: skip
    yield printed.erratum(
        "section 2.3, before (20)", "components of delta_m", unit="1", printed=2, read=3,
        ours=tracking.projectors.shape[-1], tolerance=_COUNT, method="order of P_j, which is applied to it",
    )  # fmt: skip


def _kinematics(printed: Printed) -> Iterator[Row]:
    """Yield the errata of the machine's equations, at Table 5's actual machine and positions in its workspace."""
    column = printed.column("section31")
    yield printed.erratum(
        "section 3.1, after (36)", "equations a configuration", unit="1", printed=3, read=6,
        ours=column["equations_then"] / column["configurations_needed"], tolerance=_COUNT,
        method="equations over configurations of section 3.1; (34) has one a leg, (36) two",
    )  # fmt: skip
    problem: Any = ledger.problem("full12")
    machine = makers_machine()
    for p in problem.parameters:
        machine[NAMES.index(p.name)] = p.true
    points: Array = problem.true_positions
    angles = inverse_kinematics(machine, points)
    la, lb = machine[6:9], machine[9:12]
    # the passive joints, shapes (n, 3) each, eq. (30)
    bx, by = machine[0:6:2] + la * np.cos(angles), machine[1:6:2] + la * np.sin(angles)
    errors = []
    ring = [(0, 1, 2), (1, 2, 0), (2, 0, 1)]
    below = 2 * sum(bx[:, i] * (by[:, j] - by[:, k]) for i, j, k in ring)
    for d in (bx + by - lb, bx**2 + by**2 - lb**2):
        x = sum(d[:, i] * (by[:, j] - by[:, k]) for i, j, k in ring) / below  # eq. (33)
        y = sum(d[:, i] * (bx[:, k] - bx[:, j]) for i, j, k in ring) / below
        errors.append(float(np.abs(np.column_stack([x, y]) - points).max()))
    yield printed.erratum(
        "equation (32)", "largest error of the position by (33)", unit="mm", printed=errors[0], read=0.0,
        ours=errors[1], tolerance=_ROUNDING,
        method="forward kinematics at 50 poses with d_i as printed and with squares",
    )  # fmt: skip
    dx, dy = points[:, :1] - bx, points[:, 1:] - by
    errors = [float(np.hypot(dx - lb * np.cos(b), dy - lb * np.sin(b)).max())
              for b in (np.arctan(dy / dx), np.arctan2(dy, dx))]  # fmt: skip
    yield printed.erratum(
        "equation (34)", "largest closure error of (29) with the passive angle", unit="mm", printed=errors[0],
        read=0.0, ours=errors[1], tolerance=_ROUNDING,
        method="closure at 50 poses with arctan of the quotient and with atan2",
    )  # fmt: skip
    at_home, offsets = inverse_kinematics(makers_machine(), home()[None])[0], makers_machine()[12:15]
    yield printed.erratum(
        "equation (35)", "largest reading at the home position, which is defined as zero, without offsets", unit="rad",
        printed=float(np.abs(at_home - offsets).max()), read=0.0,
        ours=float(np.abs(at_home - at_home - offsets).max()), tolerance=_ROUNDING,
        method="reading at home by (35) as printed and with the home angles",
    )  # fmt: skip
    errors = []
    for ya in (machine[3], machine[1]):
        y = points[:, 1] - ya - machine[6] * np.sin(angles[:, 0])
        errors.append(float(np.abs((points[:, 0] - bx[:, 0]) ** 2 + y**2 - machine[9] ** 2).max()))
    yield printed.erratum(
        "equation (38), row 1", "row 1 of E2 at the actual machine", unit="mm^2", printed=errors[0], read=0.0,
        ours=errors[1], tolerance=_ROUNDING, method="largest value over 50 poses, with y_a2 and with y_a1",
    )  # fmt: skip
    moved = to_cartesian(machine)
    as_printed, as_read = (moved[6:9] * 2 + moved[12:15] * 2) * 0.5, to_polar(moved, machine[12:15])[6:9]
    yield printed.erratum(
        "equation (44)", "largest error of l_a recovered from (l_a cos, l_a sin)", unit="mm",
        printed=float(np.abs(as_printed - la).max()), read=0.0, ours=float(np.abs(as_read - la).max()),
        tolerance=_ROUNDING, method="Table 5's machine there and back",
    )  # fmt: skip
