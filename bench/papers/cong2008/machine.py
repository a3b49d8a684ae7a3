"""Sections 2 and 3 of Cong et al. 2008: the procedure by hand, given numbers, counts, and the gauge of 12 parameters.

Each given number is solved from the printed initial offsets, which follow from it. The columns of Tables 4 and 7 are
points of a curve along which no reading changes; their other sound lengths say what must stand in a cell. Table 1 was
measured on a real machine whose readings are not published: what can be checked is whether its numbers fit together,
and whether the nine-point procedure does from these starts what it is said to do.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from calibench import bench, optimizers, problems
from calibench.bench.papers import ledger
from calibench.bench.papers.cong2008 import actual
from calibench.bench.papers.ledger import Array, Evidence, Printed, Row, Tolerance
from calibench.problems.planar.gpm2002 import NAMES, home, inverse_kinematics, makers_machine
from calibench.problems.planar.tracking import Tracking

_Z = ("z1", "z2", "z3")
_EXACT = Tolerance(0.0, "a given or counted number")
_OFF = 7e-4  # mm: how far the sound lengths of both columns are from the curve, at most (measured)


def machine_rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield geometry, sections 3.1 and 3.3, the actual and initial columns of Tables 2 to 4."""

    def solved(key: str, table: str, name: str) -> Row:
        value, worth = implied(printed, table, name)
        return printed.cell(
            key, value, Tolerance(worth, "what the last digit, 1e-5 rad, of the printed initial offsets is worth here"),
            f"solved from Table {table.removeprefix('table')}'s initial offsets, all else as printed",
        )  # fmt: skip

    for name in printed.column("geometry"):
        yield solved(f"geometry.{name}", "table2", name)
    yield from _counts(printed)
    nominal = dict(zip(NAMES, makers_machine(), strict=True))
    for table, problem in (
        ("table2", ledger.problem("sensor_zero")),
        ("table3", ledger.problem("link_length")),
        ("table4", ledger.problem("full12", gauge="ya2", error="J2")),
    ):
        for name in printed.column(f"{table}.actual"):
            yield solved(f"{table}.actual.{name}", table, name)
        starts = {p.name: p.start for p in problem.parameters}
        for name in printed.column(f"{table}.initial"):
            key = f"{table}.initial.{name}"
            if name in _Z:
                digit = Tolerance(1e-5, "the last printed digit")
                yield printed.cell(key, starts[name], digit, "z + theta(home; nominal) - theta((210, 245); actual)")
            else:
                yield printed.cell(key, nominal[name], _EXACT, "the nominal value of section 3.1")


def implied(printed: Printed, table: str, name: str) -> tuple[float, float]:
    """Return what `table`'s printed initial offsets need for `name`, and what one 1e-5 rad is worth there; in Table 2
    `name` may also be a nominal base, the `link`, or a coordinate of the home or estimated point."""
    wanted = np.array([printed.column(f"{table}.initial")[z] for z in _Z])
    actual, geometry = makers_machine(), printed.column("geometry")
    for key in printed.column(f"{table}.actual"):
        actual[NAMES.index(key)] = printed.column(f"{table}.actual")[key]
    estimate = np.array([geometry["estimate_x"], geometry["estimate_y"]])
    given = geometry[name] if name in geometry and table == "table2" else actual[NAMES.index(name)]

    def misfit(value: float) -> Array:
        machine, nominal, reached, reference = actual.copy(), makers_machine(), estimate.copy(), home()
        if name == "link":
            machine[6:12] = nominal[6:12] = value
        elif name.startswith(("home", "estimate")):
            point = reference if name.startswith("home") else reached
            point[("x", "y").index(name[-1])] = value
        else:
            machine[NAMES.index(name)] = value
            if table == "table2" and name not in _Z:
                nominal[NAMES.index(name)] = value
        there = inverse_kinematics(machine, reached[None])[0]
        return np.asarray(machine[12:15] + inverse_kinematics(nominal, reference[None])[0] - there - wanted)

    unit = 1e-3 if name in _Z else 1.0  # begin away from what is printed
    value, slopes = ledger.solved_for(misfit, given + 0.3 * unit, unit)
    return value, float(1e-5 * np.abs(slopes).sum() / (slopes @ slopes))


def _counts(printed: Printed) -> Iterator[Row]:
    full = ledger.problem("full12", gauge="ya2", error="J2")
    unknowns = len(full.lower)
    needed = next(n for n in range(1, 100) if 6 * n >= 5 * n + unknowns)
    for name, value, method in (
        ("fixed_coordinates", len(NAMES) - unknowns, "numbers of the machine less the unknowns of the problem"),
        ("parameters", unknowns, "unknowns of the problem full12"),
        ("configurations_needed", needed, "least n with 6n >= 5n + 12"),
        ("equations_then", 6 * needed, "6n"),
        ("variables_then", 5 * needed + unknowns, "5n + 12"),
    ):
        reason = "right as a count; see the claims on section 3.1 for what can be seen" if value > 5 else ""
        yield printed.cell(f"section31.{name}", value, _EXACT, method, reason=reason)
    for name in ("e1", "e2"):
        each, besides = counted_closure(name)
        for what, number in (("equations", each[0]), ("variables", each[1])):
            how = f"written out for 12 and 13 configurations: {what} that one more adds"
            yield printed.cell(f"section31.{name}_{what}_each", number, _EXACT, how)
        yield printed.cell(
            f"section31.{name}_variables_besides", besides, _EXACT,
            "written out for 12 configurations: variables that move an equation, less those of the configurations",
        )  # fmt: skip
    twelve = problems.identify(ledger.problem("full12", gauge="ya2", error="J2", n=needed))
    yield printed.claim(
        "three_fixed_coordinates", "Section 3.1", "three base coordinates held leave one machine to be found",
        ours=twelve.dimension - twelve.rank, ruling=ledger.judge_limit(twelve.dimension - twelve.rank, 0.0),
        rule="true where the Jacobian has no null direction", method="null directions of full12 (gauge=ya2)",
        reason=f"angle readings cannot see a planar similarity, four numbers: {twelve.sentence()}", printed=0.0,
        about="section31.fixed_coordinates",
        differs="three is what the paper holds; whether that is enough is asked here",
    )  # fmt: skip
    yield printed.claim(
        "twelve_equations_suffice", "Section 3.1", "12 configurations determine the 12 parameters", ours=twelve.rank,
        ruling=ledger.judge_near(unknowns, unknowns, twelve.rank, _EXACT), rule="true where the rank is 12",
        method=f"rank of the Jacobian of full12 (gauge=ya2) at {needed} configurations",
        reason="as many equations as unknowns, but they are not independent", printed=unknowns,
        about="section31.configurations_needed", differs="the count is right; the equations are not independent",
    )  # fmt: skip
    for name, problem in (
        ("samples_a_few", ledger.problem("sensor_zero", n=3)),
        ("samples_a_many", ledger.problem("sensor_zero")),
        ("samples_b", ledger.problem("link_length")),
        ("samples_c", full),
    ):
        yield printed.cell(f"section33.{name}", len(problem.readings), _EXACT, f"readings of {problem.name}, as rerun")
    rank = problems.identify(full).rank
    yield printed.cell("section33.parameters_identified", rank, _EXACT, "rank of the Jacobian of full12 (gauge=ya2)")


def counted_closure(name: str) -> tuple[tuple[int, int], int]:
    """Return how many (equations, variables) a configuration adds to E1 (36) or E2 (38), and the variables besides."""
    sizes = []
    for n in (12, 13):  # at least as many as there are parameters: with fewer the problem refuses
        problem: Any = ledger.problem("full12", gauge="ya2", error="J2", n=n)
        free = [NAMES.index(p.name) for p in problem.parameters]
        angles = problem.readings  # with the offsets they are the active angles

        def equations(v: Array, n: int = n, free: list[int] = free, angles: Array = angles) -> Array:
            full = makers_machine()
            full[free] = v[: len(free)]
            active = angles + full[12:15]
            dx = v[len(free) : len(free) + n, None] - full[0:6:2] - full[6:9] * np.cos(active)
            dy = v[len(free) + n : len(free) + 2 * n, None] - full[1:6:2] - full[6:9] * np.sin(active)
            if name == "e2":
                return np.asarray(dx**2 + dy**2 - full[9:12] ** 2).ravel()  # eq. (38)
            passive = v[len(free) + 2 * n :].reshape(n, 3)
            closed = [dx - full[9:12] * np.cos(passive), dy - full[9:12] * np.sin(passive)]  # eq. (36)
            return np.asarray(closed).ravel()

        passive = np.linspace(0.3, 2.8, 3 * n)  # any angles, as only what moves what is asked
        v = np.concatenate([problem.truth, *problem.true_positions.T, passive if name == "e1" else []])
        moved = [np.abs(equations(v + step) - equations(v)).max() > 1e-9 for step in 1e-4 * np.eye(len(v))]
        sizes.append((len(equations(v)), int(np.sum(moved))))
    each = (sizes[1][0] - sizes[0][0], sizes[1][1] - sizes[0][1])
    return each, sizes[0][1] - 12 * each[1]


@final
@dataclass(frozen=True, eq=False)
class Column:
    """A printed 12-parameter column beside its gauge curve; the lengths that are printed right are what is fitted."""

    key: str
    problem: Any
    names: tuple[str, ...]
    read: Array
    fit: Array

    def angle(self, without: str = "") -> float:
        """Return phi [rad], fitted to the sound lengths but that of `without`."""
        kept = self.fit & np.array([n != without for n in self.names])
        curve = self.problem.gauge_curve
        return ledger.solved_for(lambda phi: np.asarray((curve(phi) - self.read)[kept]), 0.0)[0]

    def predicted(self, name: str) -> float:
        """Return what the curve says for `name`, from the others."""
        return float(self.problem.gauge_curve(self.angle(name))[self.names.index(name)])

    @property
    def similarity(self) -> float:
        """Return by how much of its distance from A_1 the turn and scale move a point."""
        phi = self.angle()
        at = self.names.index("lb1")
        scale = self.problem.gauge_curve(phi)[at] / self.problem.gauge_curve(0.0)[at]
        return float(abs(scale * np.exp(1j * phi) - 1))


def columns(printed: Printed) -> tuple[Column, Column]:
    made = []
    for key, gauge in (("table4.j3_12", "ya2"), ("table7.de_j3", "xa2")):
        problem, column = ledger.problem("full12", gauge=gauge), printed.column(key)
        names = tuple(p.name for p in problem.parameters)
        sound = [not column.entries[n].is_misprint and n[0] != "z" for n in names]
        made.append(Column(key, problem, names, np.array([column[n] for n in names]), np.array(sound)))
    return made[0], made[1]


def gauge_rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield Table 4's 12 values, Table 7, its echo in the text, and the claims about 12 parameters."""
    four, seven = columns(printed)
    for column in (four, seven):
        for name in printed.column(column.key):
            cell = f"{column.key}.{name}"
            if name == "kmrmse":
                yield _kmrmse_row(printed, cell, column)
                continue
            if name == "iterations":
                yield actual.row(printed, column.key, name)
                continue
            # how far the cell may be from what the others say: its own misfit, and theirs at its leverage
            slope = (column.problem.gauge_curve(1e-6) - column.problem.gauge_curve(-1e-6)) / 2e-6
            others = np.abs(slope[column.fit & np.array([n != name for n in column.names])])
            carried = abs(slope[column.names.index(name)]) * others.sum() / (others**2).sum()
            misfit = _OFF / 244.0 if name[0] == "z" else _OFF
            tolerance = Tolerance(
                float(misfit + carried * _OFF + printed.digit(cell)),
                f"a search stops near the curve, not on it: {_OFF:g} mm for each length (an offset: over a link), as "
                "far as the fitted angle carries it, and a printed digit, as digits are cut off and not rounded in "
                "places",
            )
            how = "the gauge curve through the actual machine, its angle fitted to the column's other lengths"
            yield printed.cell(cell, column.predicted(name), tolerance, how, of_print=True)
    for name in printed.column("table7.actual"):
        other = printed.column("table5.actual")[name]
        yield printed.cell(f"table7.actual.{name}", other, Tolerance(0.0, "a given number"), "Table 5, actual values")
    # what the text says of Table 7
    values, true = printed.column("table7.de_j3"), printed.column("table7.actual")
    gaps = {n: abs(values[n] - true[n]) for n in true}
    lengths = {n: g for n, g in gaps.items() if n[0] != "z"}
    worst = max(lengths, key=lambda n: lengths[n])
    yield printed.cell(
        "text.largest_error", lengths[worst], Tolerance(5e-5, "half a printed digit"),
        "largest difference of Table 7's columns, misprint corrected", reason=f"it is that of {worst}", of_print=True,
    )  # fmt: skip
    limit = printed.column("text")["most_errors_below"]
    below = float(np.mean([g < limit for g in gaps.values()]))
    yield printed.cell(
        "text.most_errors_below", float(np.median(list(gaps.values()))),
        Tolerance(limit, "the claim is that most lie between 0 and the limit"),
        "median difference of Table 7's columns", reason=f"{below:.0%} of the errors are below",
        ruling=ledger.judge_at_least(below, 0.5), of_print=True,
    )  # fmt: skip
    limit = printed.column("text")["z_errors_below"]
    angles = [g for n, g in gaps.items() if n[0] == "z"]
    yield printed.cell(
        "text.z_errors_below", angles, Tolerance(limit, "the claim is that all lie between 0 and the limit"),
        "differences of Table 7's offsets", reason=f"the largest is {max(angles):.2g}",
        ruling=ledger.judge_limit(max(angles), limit), of_print=True,
    )  # fmt: skip
    yield _kmrmse_row(printed, "text.kmrmse", seven)
    yield from _claims(printed, evidence, four, seven)


def _kmrmse_row(printed: Printed, cell: str, column: Column) -> Row:
    """Return the row of a printed kmrmse: a similarity about A_1 moves samples in proportion to their distance."""
    distance = np.hypot(*(home() - makers_machine()[:2]))
    # rms distance from A_1 of a disc about the home point, radius 0 to 150 mm: what an unknown plan may be
    low, high = column.similarity * distance, column.similarity * np.hypot(distance, 150 / np.sqrt(2))
    points = column.problem.true_positions - makers_machine()[:2]
    ours = column.similarity * float(np.sqrt((points**2).sum(axis=1).mean()))
    tolerance = Tolerance(
        max(ours - low, high - ours),
        "the plan is not printed: discs of radius 0 to 150 mm about the home point give this range",
    )
    return printed.cell(
        cell, ours, tolerance, "displacement of the default plan by the column's similarity", of_print=True,
        reason=f"the whole kmrmse is the gauge: phi = {column.angle():.6f}, seen by no reading",
    )  # fmt: skip


def _claims(printed: Printed, evidence: Evidence, four: Column, seven: Column) -> Iterator[Row]:
    for column, table in ((four, "Table 4, 12 values"), (seven, "Table 7")):
        off = np.abs((column.problem.gauge_curve(column.angle()) - column.read)[column.fit])
        yield printed.claim(
            f"on_the_gauge_{column.key.partition('.')[0]}", table,
            "the printed result is one point of the gauge curve, not another machine",
            ours=off, ruling=ledger.judge_limit(float(off.max()), _OFF),
            rule="true where the lengths printed right lie within 7e-4 mm of the curve",
            method="distance of the printed lengths from the curve through the actual machine",
            reason=f"phi = {column.angle():.6f} rad, where no reading differs from those of the actual machine",
            unit="mm", printed=0.0,
        )  # fmt: skip
    true = printed.column("table4.actual")
    errors = [abs(four.read[i] - true[n]) for i, n in enumerate(four.names) if n[0] != "z"]
    yield printed.claim(
        "table4_several_millimetres", "Section 3.3 C and Table 4, 12 values",
        "there are several millimetre errors between the calibrated results and the actual values",
        ours=errors, ruling=ledger.judge_at_least(ledger.median(errors), 2.0, 1.0),
        rule="true where the median error of the nine lengths is 2 mm or more, in kind 1 mm",
        method="errors of the printed lengths, misprints corrected",
        reason=f"they are {min(errors):.1f} to {max(errors):.1f} mm, all of them the gauge's: how many is arbitrary",
        unit="mm",
    )  # fmt: skip
    rank = problems.identify(seven.problem).rank
    yield printed.claim(
        "de_calibrates_all_12", "abstract, sections 4.4 and 5", "DE calibrates all 12 parameters",
        ours=rank, ruling=ledger.judge_at_least(rank, 12.0), rule="true where the readings see 12 parameters",
        method="rank of the Jacobian of full12 (gauge=xa2)",
        reason=f"readings see 11; Table 7 is the point phi = {seven.angle():.6f} rad of a curve on which all are "
        "equally good", printed=12.0, about="section43.parameters",
        differs="twelve is what DE is given; how many of them the readings see is asked here",
    )  # fmt: skip
    runs = evidence.runs
    reached = runs[
        (runs["study"] == "cong2008") & (runs["problem"] == "full12") & (runs["kmrmse_aligned"] < 1e-6)
        & (runs["start"] == "random") & (runs["optimizer"] != "lm")
    ]  # fmt: skip
    raw, aligned = ledger.values_of(reached, "kmrmse"), ledger.values_of(reached, "kmrmse_aligned")
    yield printed.claim(
        "global_search_helps", "section 5", "global optimisation finds what local optimisation could not: all 12",
        ours=raw, ruling=ledger.judge_limit(ledger.median(raw), 1e-3),
        rule="true where runs that reach the floor end at the actual machine, kmrmse below 1e-3 mm",
        method="kmrmse of every bounded run on full12 that is exact modulo the gauge",
        reason=f"{len(raw)} such runs end anywhere on the curve in the box; modulo the gauge they are within "
        f"{np.max(aligned) if len(aligned) else np.nan:.1g} mm", unit="mm",
        printed=printed.column("table7.de_j3").entries["kmrmse"].printed, about="table7.de_j3.kmrmse",
        differs="the cell is a misprint; that so small a kmrmse shows the actual machine is asked here",
    )  # fmt: skip
    phi = ledger.values_of(actual.matlab_runs(evidence), "gauge_phi")
    spread = float(np.ptp(phi)) if len(phi) else np.nan
    yield printed.claim(
        "twelve_depends_on_plan", "Table 4, 12 values", "where on the gauge curve a search ends is told by the data",
        ours=spread, ruling=ledger.judge_limit(spread, 1e-6), unit="rad", printed=0.0,
        rule="true where searches from one start agree to 1e-6 rad",
        method="range of phi over 5 plans, fmincon, one start",
    )  # fmt: skip


_REAL = "measured on the real machine, readings not published"


def tracking_rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield sections 2.4 and 2.5, Table 1, its consistency, and the propositions of section 2.3."""
    rounds = nine_point_rounds()
    spans = [np.abs(r).max() for r in rounds if len(r) > 1]
    how = "points of one round of our search, with its centre"
    yield printed.cell("section24.estimates", len(rounds[-1]) + 1, _EXACT, how)
    yield printed.cell("section24.d_divisor", spans[0] / spans[1], _EXACT, "pitches of two rounds of our search")
    # halving d until d < limit, and one round more: the last two pitches enclose the limit
    yield printed.cell(
        "section25.d_lower_limit", getattr(optimizers.make("nine_point"), "lower_limit", np.nan), _EXACT,
        "the option lower_limit of nine_point, as rerun",
        reason=f"from d = 1 the last pitches are {spans[-2]:g} and {spans[-1]:g} mm",
    )  # fmt: skip
    circle, near = ledger.problem("tracking_zero").points.mean(axis=0), Tolerance(1e-9, "rounding of a mean")
    for axis, value in zip("xy", circle, strict=True):
        yield printed.cell(f"section25.circle_{axis}", value, near, "mean of the commanded circle, as rerun")
    starts = {tuple(ledger.problem("tracking_zero", experiment=e).start) for e in (1, 2, 3)}
    yield printed.cell("section25.repeats", len(starts), _EXACT, "different starts in Table 1")
    for experiment in (1, 2, 3):
        for which in ("initial", "result"):
            for z in _Z:
                yield printed.unknown(f"table1.experiment{experiment}_{which}.{z}", _REAL)
    yield from _consistency(printed, evidence)
    yield from _propositions(printed)


def nine_point_rounds(step: float = 1.0) -> list[Array]:
    """Return the points of each round of the nine-point search on a bowl with its minimum at the start."""
    bowl = Recorder(np.full(2, -15.0), np.full(2, 15.0), lambda points: np.asarray((points**2).sum(axis=1)))
    bench.execute(bowl, optimizers.make("nine_point", step=step), budget=200)
    return bowl.seen


@final
class Recorder:
    """A function of points, shape (n, dim) to (n,), in a box that holds 0, its start; `seen` are the batches asked."""

    def __init__(self, lower: Array, upper: Array, values: Callable[[Array], Array]) -> None:
        self.lower, self.upper, self.start, self.values = lower, upper, np.zeros(len(lower)), values
        self.seen: list[Array] = []

    def __call__(self, x: Array) -> float:
        return float(self.values(x[None])[0])

    def batch(self, points: Array) -> Array:
        self.seen.append(np.array(points))
        return self.values(points)


def _consistency(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    initial, results = (
        np.array([[printed.column(f"table1.experiment{e}_{which}")[z] for z in _Z] for e in (1, 2, 3)])
        for which in ("initial", "result")
    )
    problems = {e: ledger.problem("tracking_zero", experiment=e) for e in (1, 2, 3)}
    spread, spread_before = (float(np.ptp(numbers, axis=0).max()) for numbers in (results, initial))
    ended = []
    for experiment, problem in problems.items():
        runs = evidence.of("cong2008", "tracking_zero", "nine_point", {"experiment": experiment})
        ended += [problem.offset_errors(np.array(list(x))) for x in runs["best_x"]]
    errors = np.array(ended).reshape(-1, 3)
    ours = float(np.ptp(errors, axis=0).max()) if len(errors) else np.nan
    yield printed.claim(
        "table1_identical", "Table 1 and the text below it", "three starts end at an identical value",
        ours=spread, ruling=ledger.judge_limit(spread, 1e-4, 0.1 * spread_before),
        rule="true where the printed results agree to a printed digit; in kind where they agree ten times better than "
        "the starts", method="largest difference of the three printed results",
        reason=f"a rerun without noise differs by {ours:.2g} rad between the starts, its last pitch of 1/16 to 1/8 "
        f"mm; the printed starts differ by {spread_before:.2g} rad", unit="rad", printed=0.0,
    )  # fmt: skip
    worst = np.abs(errors).max(axis=1)
    yield printed.claim(
        "table1_simulated", "Section 2.5", "the procedure converges from Table 1's three starts",
        ours=worst, ruling=ledger.judge_limit(float(worst.max()) if len(worst) else np.nan, 2e-4, 2e-3),
        rule="true where the worst offset is within 2e-4 rad: half the last pitch over a link length",
        method="worst offset error of nine_point on tracking_zero, circle R80, n = 60, without noise",
        reason="radius and number of points of the circle are ours, they are not printed", unit="rad", printed=0.0,
    )  # fmt: skip
    away = [float(np.hypot(*problem.start)) for problem in problems.values()]
    estimate = np.array([printed.column("geometry")[f"estimate_{axis}"] for axis in "xy"])
    yield printed.claim(
        "hand_moved_several_millimetres", "Section 2.1",
        "by hand there is always several millimetre error between the real and the predefined position",
        ours=away, ruling=ledger.judge_at_least(min(away), 2.0, 1.0),
        rule="true where the hand was 2 mm or more off in each experiment, in kind 1 mm",
        method="displacement of the hand that takes Table 1's results to its initial estimations, by least squares",
        reason=", ".join(f"{value:.1f}" for value in away) + " mm in the three experiments; section 3.3's estimate is "
        f"{np.hypot(*(home() - estimate)):.1f} mm off", unit="mm",
    )  # fmt: skip
    for experiment, problem in problems.items():
        misfit = float(np.abs(problem.start_misfit).max())
        yield printed.claim(
            f"table1_displacement_{experiment}", f"Table 1, Experiment{experiment}, and section 2.4, step 2",
            "initial minus resulting zero positions are one displacement of the hand",
            ours=misfit, ruling=ledger.judge_limit(misfit, 1e-4, spread),
            rule="true where three differences from two unknowns leave at most 1e-4 rad, two printed half digits; in "
            "kind where they leave less than the results differ among themselves",
            method="least squares of the three differences over (dx, dy)", unit="rad", printed=0.0,
        )  # fmt: skip


def _propositions(printed: Printed) -> Iterator[Row]:
    """Yield what happens to the minimum under reading errors that meet the conditions, and that do not."""
    problem: Tracking = ledger.problem("tracking_zero", n=12)
    rng = np.random.default_rng(0)
    infeasible = np.array([np.linalg.eigh(p)[1][:, -1] for p in problem.projectors])  # P_j = u_j u_j^T
    balanced = np.linalg.svd(infeasible.T)[2][3:].T  # amplitudes c with sum c_j u_j = 0
    # d theta / d position, shape (3, 2) each, by central differences: the feasible subspace's basis
    slopes, machine, step = [], makers_machine(), 1e-4
    for point in problem.points:
        moves = [s * e for e in step * np.eye(2) for s in (1.0, -1.0)]
        sides = [inverse_kinematics(machine, (point + move)[None])[0] for move in moves]
        slopes.append(np.column_stack([(sides[0] - sides[1]) / (2 * step), (sides[2] - sides[3]) / (2 * step)]))

    def both() -> Array:
        return np.asarray((1e-3 * balanced @ rng.normal(size=balanced.shape[1]))[:, None] * infeasible)

    cases = (
        ("proposition1", "Proposition 1", "feasible reading errors do not move the minimum",
         lambda: np.array([slope @ rng.normal(0, 2.0, 2) for slope in slopes]), ""),
        ("proposition2", "Proposition 2", "infeasible errors of mean zero do not move the minimum", both,
         "both conditions are needed: mean(delta) = 0 and each delta_j in span P_j"),
        ("proposition2_mean_alone", "Section 2.3, 'robust to the measurement error'",
         "reading errors of mean zero do not move the minimum",
         lambda: np.asarray((errors := 1e-3 * rng.normal(size=(12, 3))) - errors.mean(axis=0)),
         "P_j changes along the circle, so errors of mean zero are not of mean zero once projected"),
        ("proposition2_span_alone", "Section 2.3, 'robust to the measurement error'",
         "infeasible reading errors do not move the minimum",
         lambda: np.asarray(1e-3 * rng.normal(size=(12, 1)) * infeasible), "without mean zero they do"),
        ("proposition2_condition", "Section 2.3, behind Proposition 2",
         "reading errors whose projections P_j delta_j have mean zero do not move the minimum",
         lambda: both() + np.array([slope @ [0.3, -0.2] for slope in slopes]),
         "the condition that is needed: of Proposition 2's two, neither has to hold by itself"),
    )  # fmt: skip
    for key, place, sentence, draw, reason in cases:
        moved = []
        for _ in range(5):
            best = bench.execute(problem.with_reading_errors(draw()), optimizers.make("lm"), budget=500).best_x
            moved.append(np.nan if best is None else float(np.abs(best).max()))
        yield printed.claim(
            key, place, sentence, ours=moved, ruling=ledger.judge_limit(ledger.median(moved), 1e-7),
            rule="true where the minimum stays within 1e-7 mm, the rounding of the search",
            method="minimum of E by lm on tracking_zero (n = 12), five draws of reading errors", reason=reason,
            unit="mm", printed=0.0,
        )  # fmt: skip
    errors, x = both(), np.array([3.0, -7.0])
    variance = float((errors**2).sum(axis=1).mean())
    wrong = problem.with_reading_errors(errors)
    gap = abs(wrong(x) - variance - problem(x)) / problem(x)
    yield printed.claim(
        "equation28", "equation (28)", "E equals sigma^2 plus the norm of the projected error",
        ours=gap, ruling=ledger.judge_limit(gap, 1e-9, 0.1),
        rule="true where the two sides differ by rounding; in kind below a tenth",
        method="relative difference of the two sides 7.6 mm from the truth",
        reason=f"exact at the truth ({abs(wrong(problem.truth) / variance - 1):.0e}), elsewhere to first order only: "
        "d theta is taken for a linear motion", printed=0.0,
    )  # fmt: skip
