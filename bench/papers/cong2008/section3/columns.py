"""Tables 2 to 4 of Cong et al. 2008, a printed column a run: values, kmrmse and iterations where fmincon stopped.

The method is the one that the paper names, as `fmincon_matlab` emulates it: from the printed start, on the problem's
own plan. Plans and stopping rule are not printed, so four random plans tell beside it what they leave open.

A band that could fail: a value agrees to print within one unit of its last digit. In kind it agrees where its *error*,
value less actual, is that of the print within a decade, as kmrmse must be: a search that stops nearer to the truth than
the printed one did, or farther from it, does not reproduce the column. The printed error itself would be no band: the
truth always lies within it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, final

import numpy as np

from calibench.bench.papers.cong2008.section3.stopping import COLUMNS as TABLES_2_AND_3
from calibench.bench.papers.cong2008.section3.stopping import plan as plan_of
from calibench.bench.papers.evidence import problem as make_problem
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Row, Tolerance
from calibench.bench.sweep.request import build_member
from calibench.optimizers.fmincon import Options, fmincon

COLUMNS: Mapping[str, tuple[str, dict[str, Any]]] = {
    **TABLES_2_AND_3,
    "table4.j3_12": ("full12", {"error": "J3", "gauge": "ya2"}),
    "table4.j3_11": ("full11", {"error": "J3", "paper_section": 3}),
}
PRESET = "fmincon_matlab"
_MOST = 20_000  # evaluations: a limit, met by no column
_METHOD = f"one run of {PRESET} a column, from the printed start"


@final
@dataclass(frozen=True)
class Answer:
    """Where one run of fmincon ended: calibrated values, quality and cost, all of the same run."""

    values: Mapping[str, float]
    kmrmse: float
    kmrmse_aligned: float
    iterations: int
    evaluations: int
    J: float
    x: tuple[float, ...]


def rows(printed: Printed, _: object) -> Iterator[Row]:
    """Yield the calibrated columns of Tables 2, 3 and 4 (11 values)."""
    for key in COLUMNS:
        if key != "table4.j3_12":  # its values are judged along its gauge curve: cong2008_gauge
            for name in printed.column(key):
                yield row(printed, key, name)


def row(printed: Printed, key: str, name: str) -> Row:
    """Return the row of a cell of a calibrated column, from the column's run."""
    cell, run = f"{key}.{name}", answer(key)
    others = [answer(key, plan) for plan in range(4)]
    if name == "iterations":
        tolerance = Tolerance(
            0.0, "a count; in kind within a factor of two, as the release of fmincon is not printed",
            float(np.log10(2)), decades=True,
        )  # fmt: skip
        return printed.cell(cell, run.iterations, tolerance, _METHOD, _spread([o.iterations for o in others]))
    if name == "kmrmse":
        tolerance = Tolerance(
            printed.digit(cell) / 2,
            "half a printed digit; in kind within a decade, as plan and stopping rule are not printed", 1.0,
            decades=True,
        )  # fmt: skip
        return printed.cell(cell, run.kmrmse, tolerance, _METHOD, _spread([o.kmrmse for o in others]))
    return _value(printed, key, name, run, others)


@cache
def answer(key: str, plan: int = -1) -> Answer:
    """Return where the run of a printed column ends: on the problem's own plan, or from 0 on on a random one."""
    name, options = COLUMNS[key]
    built: Any = make_problem(name, **options, **plan_of(name, plan))
    ended = fmincon(built, built.start, lb=built.lower, ub=built.upper, options=matlab_options())
    x = np.asarray(ended.x)
    merit = built.merit(x)
    machine = np.asarray(built.physical(x))
    return Answer(
        {p.name: float(value) for p, value in zip(built.parameters, machine, strict=True)},
        merit["kmrmse"], merit.get("kmrmse_aligned", merit["kmrmse"]), ended.output.iterations,
        ended.output.funcCount, ended.fval, tuple(x.tolist()),
    )  # fmt: skip


@cache
def matlab_options() -> Options:
    """Return the options of the preset, for the direct call of `fmincon`: the same search without a gate."""
    emulator = build_member("optimizer", [f"optimizer={PRESET}"])
    shared = {field.name for field in fields(Options)} & {field.name for field in fields(emulator)}
    given = {name: getattr(emulator, name) for name in shared}
    return Options(**(given | {"MaxFunctionEvaluations": _MOST, "SpecifyObjectiveGradient": False}))


def _value(printed: Printed, key: str, name: str, run: Answer, others: list[Answer]) -> Row:
    cell = f"{key}.{name}"
    entry, digit = printed.column(key).entries[name], printed.digit(cell)
    actual = printed.column(f"{key.partition('.')[0]}.actual")[name]
    reason = _spread([abs(o.values[name] - actual) for o in others], "off")
    if entry.is_misprint:
        apart = abs(entry.printed - entry.value)
        tolerance = Tolerance(
            apart / 4, f"a quarter of what lies between the two readings, {apart:g} {entry.unit}: the cell asks which "
            "of them it is; how far the search stops from the truth is asked of the column's other cells",
        )  # fmt: skip
    elif abs(entry.value - actual) < 0.5 * digit:
        tolerance = Tolerance(
            digit, "one unit of the last printed digit, which is cut off or rounded: no error is printed, so none in "
            "that digit may be ours",
        )  # fmt: skip
    else:
        tolerance = Tolerance(
            digit, "one unit of the last printed digit, which is cut off or rounded; in kind where the error, value "
            "less actual, is the printed one within a decade, as plan and stopping rule are not printed", 1.0,
            decades=True, origin=actual,
        )  # fmt: skip
        off = abs(run.values[name] - actual)
        reason = f"{off:.2g} {entry.unit} off, printed {abs(entry.value - actual):.2g}; {reason}"
    return printed.cell(cell, run.values[name], tolerance, _METHOD, reason)


def _spread(values: list[float] | list[int], what: str = "") -> str:
    return f"over four random plans {min(values):.3g} to {max(values):.3g} {what}".strip()
