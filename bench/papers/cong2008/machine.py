"""Geometry, counts and starts of Cong et al. 2008: every given number, recomputed from another print of itself.

The printed initial offsets follow from the machine, the home point and the point (210, 245): so each given length,
coordinate and offset can be solved from them, and is not only taken over.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from calibench import problems
from calibench.bench.papers.evidence import Array, Evidence, solved_for
from calibench.bench.papers.evidence import problem as make_problem
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Row, Tolerance, judge_limit, judge_near
from calibench.problems.planar.gpm2002 import NAMES, home, inverse_kinematics, makers_machine

_Z = ("z1", "z2", "z3")
_EXACT = Tolerance(0.0, "a given or counted number")


def rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield geometry, sections 3.1 and 3.3, the actual and initial columns of Tables 2 to 4."""
    for name in printed.column("geometry"):
        yield _implied_row(printed, f"geometry.{name}", "table2", name)
    yield from _counts(printed)
    for table, problem in (
        ("table2", make_problem("sensor_zero")),
        ("table3", make_problem("link_length")),
        ("table4", make_problem("full12", gauge="ya2", error="J2")),
    ):
        for name in printed.column(f"{table}.actual"):
            yield _implied_row(printed, f"{table}.actual.{name}", table, name)
        starts = {p.name: p.start for p in problem.parameters}
        nominal = dict(zip(NAMES, makers_machine(), strict=True))
        for name in printed.column(f"{table}.initial"):
            angle = name in _Z
            yield printed.cell(
                f"{table}.initial.{name}",
                starts[name] if angle else nominal[name],
                Tolerance(1e-5, "the last printed digit") if angle else _EXACT,
                "z + theta(home; nominal) - theta((210, 245); actual)" if angle else "the nominal value of section 3.1",
            )


def implied(printed: Printed, table: str, name: str) -> tuple[float, float]:
    """Return the number that `table`'s printed initial offsets need for `name`, and what one 1e-5 rad there is worth.

    All other numbers are as printed. `name` is a parameter of the actual machine; in Table 2, whose machine is the
    nominal one but for its offsets, also a nominal base, the `link`, or a coordinate of the home or estimated point.
    """
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
    value, slopes = solved_for(misfit, given + 0.3 * unit, unit)
    return value, float(1e-5 * np.abs(slopes).sum() / (slopes @ slopes))


def counted_closure(name: str) -> tuple[tuple[int, int], int]:
    """Return how many (equations, variables) a configuration adds to E1 (36) or E2 (38), and the variables besides.

    Both are written out, and a variable counts where it moves an equation.
    """
    least = 12  # as many as there are parameters: with fewer the problem refuses
    sizes = [_written_out(name, least + more) for more in (0, 1)]
    each = (sizes[1][0] - sizes[0][0], sizes[1][1] - sizes[0][1])
    return each, sizes[0][1] - least * each[1]


def _written_out(name: str, n: int) -> tuple[int, int]:
    """Return the number of equations and of variables of E1 or E2 at n configurations."""
    problem: Any = make_problem("full12", gauge="ya2", error="J2", n=n)
    free = [NAMES.index(p.name) for p in problem.parameters]
    machine = makers_machine()
    machine[free] = problem.truth
    angles = problem.readings  # with the offsets they are the active angles

    def equations(v: Array) -> Array:
        full = machine.copy()
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
    return len(equations(v)), int(np.sum(moved))


def _implied_row(printed: Printed, key: str, table: str, name: str) -> Row:
    value, worth = implied(printed, table, name)
    tolerance = Tolerance(worth, "what the last digit, 1e-5 rad, of the printed initial offsets is worth here")
    number = table.removeprefix("table")
    return printed.cell(key, value, tolerance, f"solved from Table {number}'s initial offsets, all else as printed")


def _counts(printed: Printed) -> Iterator[Row]:
    """Yield the counts of sections 3.1 and 3.3, and what the Jacobian says about them."""
    full = make_problem("full12", gauge="ya2", error="J2")
    unknowns = len(full.lower)
    needed = next(n for n in range(1, 100) if 6 * n >= 5 * n + unknowns)
    counted = {
        "fixed_coordinates": (len(NAMES) - unknowns, "numbers of the machine less the unknowns of the problem"),
        "parameters": (unknowns, "unknowns of the problem full12"),
        "configurations_needed": (needed, "least n with 6n >= 5n + 12"),
        "equations_then": (6 * needed, "6n"),
        "variables_then": (5 * needed + unknowns, "5n + 12"),
    }
    for name, (value, method) in counted.items():
        reason = "right as a count; see the claims on section 3.1 for what can be seen" if value > 5 else ""
        yield printed.cell(f"section31.{name}", value, _EXACT, method, reason)
    for name in ("e1", "e2"):
        each, besides = counted_closure(name)
        for what, number in (("equations", each[0]), ("variables", each[1])):
            yield printed.cell(
                f"section31.{name}_{what}_each", number, _EXACT,
                f"written out for 12 and 13 configurations: {what} that one more adds",
            )  # fmt: skip
        yield printed.cell(
            f"section31.{name}_variables_besides", besides, _EXACT,
            "written out for 12 configurations: variables that move an equation, less those of the configurations",
        )  # fmt: skip
    twelve = problems.identify(make_problem("full12", gauge="ya2", error="J2", n=needed))
    yield printed.claim(
        "three_fixed_coordinates", "Section 3.1", "three base coordinates held leave one machine to be found",
        twelve.dimension - twelve.rank, judge_limit(twelve.dimension - twelve.rank, 0.0),
        "true where the Jacobian has no null direction", "null directions of full12 (gauge=ya2)",
        f"angle readings cannot see a planar similarity, four numbers: {twelve.sentence()}", printed=0.0,
        about="section31.fixed_coordinates",
        differs="three is what the paper holds; whether that is enough is asked here",
    )  # fmt: skip
    yield printed.claim(
        "twelve_equations_suffice", "Section 3.1", "12 configurations determine the 12 parameters", twelve.rank,
        judge_near(unknowns, unknowns, twelve.rank, _EXACT), "true where the rank is 12",
        f"rank of the Jacobian of full12 (gauge=ya2) at {needed} configurations",
        "as many equations as unknowns, but they are not independent", printed=unknowns,
        about="section31.configurations_needed", differs="the count is right; the equations are not independent",
    )  # fmt: skip
    sizes = {
        "samples_a_few": make_problem("sensor_zero", n=3),
        "samples_a_many": make_problem("sensor_zero"),
        "samples_b": make_problem("link_length"),
        "samples_c": full,
    }
    for name, problem in sizes.items():
        yield printed.cell(f"section33.{name}", len(problem.readings), _EXACT, f"readings of {problem.name}, as rerun")
    rank = problems.identify(full).rank
    yield printed.cell("section33.parameters_identified", rank, _EXACT, "rank of the Jacobian of full12 (gauge=ya2)")
