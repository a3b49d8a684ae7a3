"""One run on one page: the request, its course, its end, its answer and how well that is known."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from calibench import problems
from calibench.bench.report.one_run.again import again_command
from calibench.bench.report.one_run.curve import curve_lines, curve_of
from calibench.bench.report.one_run.found import Found
from calibench.bench.statistics.tables import parameters_in, problem_of
from calibench.core.counted import plain
from calibench.core.registry import MissingFile, NotImported
from calibench.problems.base import Parameter, parameters_of

_TARGETS = 12  # that are listed


def show_run(found: Found) -> str:
    """Return the run as text."""
    row = found.row
    lines = [f"run {row['run_id']}  (study {row['study']}, {found.folder})", *_asked(row)]
    lines += [*_ended(row), *_answer(row)]
    if (curve := curve_of(found.trace)) is not None:
        lines += ["", "curve, over the logarithm of what was charged:"]
        lines += curve_lines(curve, float(row["minimum"]) if _is_told(row["minimum"]) else None, _unit(row))
    lines += _targets(row)
    if isinstance(row["traceback"], str) and row["traceback"]:
        lines += ["", "the last frames:", row["traceback"].rstrip()]
    lines += _parameters(row)
    try:
        command = again_command(row) or "not by a command: what it ran was made in Python, or published"
    except NotImported:
        command = "told with --trust alone"
    except MissingFile as error:
        command = f"told where the file is alone: {error}"
    return "\n".join([*lines, "", f"again      {command}"])


def _asked(row: Mapping[str, Any]) -> list[str]:
    library = " ".join(str(row[name]) for name in ("library", "library_version") if isinstance(row[name], str))
    budget = _whole(row["budget"])
    target = f", target {row['target']:g}" if _is_told(row["target"]) else ""
    return [
        f"problem    {row['problem']} {_readable(row['problem_options'])}",
        f"optimizer  {row['optimizer']} {_readable(row['optimizer_options'])}  ({library.rstrip()})",
        f"asked      repetition {row['repetition']}, {_text(row['start'])} start, budget {budget}{target}",
        f"code       {_text(row['code_digest'])}",
    ]


def _ended(row: Mapping[str, Any]) -> list[str]:
    ended = ", ".join(dict.fromkeys(_text(row[name]) for name in ("status", "stop_reason")))
    error = " ".join(str(row[name]) for name in ("error_type", "error") if isinstance(row[name], str))
    seconds = f", {plain(row['wall_s'], 3)} s" if _is_told(row["wall_s"]) else ""
    lines = [
        f"ended      {ended} {error}".rstrip(),
        f"cost       {row['evaluations']} evaluations, {_whole(row['jacobian_evaluations'])} Jacobians: "
        f"{row['charged']} charged of {_whole(row['budget'])}{seconds}",
    ]
    changes = row.get("process_changes")
    if changes is not None and len(changes):
        lines.append(f"process    {', '.join(changes)}: changed by the run, put back after it")
    if _is_told(row["restarts"]) and row["restarts"]:
        lines.append(f"restarts   {_whole(row['restarts'])}")
    if _is_told(row["non_finite"]) and row["non_finite"]:
        lines.append(f"not finite {_whole(row['non_finite'])} of the values")
    if _is_told(row["non_finite_slopes"]) and row["non_finite_slopes"]:
        lines.append(f"not finite {_whole(row['non_finite_slopes'])} entries of gradients and Jacobians, read as 0")
    return lines


def _answer(row: Mapping[str, Any]) -> list[str]:
    unit = _unit(row)
    lines = [
        f"best       {row['best_value']:.6g}{unit} at evaluation {row['best_evaluation']}"
        if row["best_evaluation"]
        else "best       no finite value was found"
    ]
    if _is_told(row["judged_evaluations"]):
        fresh = int(row["judged_evaluations"])
        how = f"mean of {fresh} fresh evaluations" if fresh else "without noise"
        lines.append(f"judged     {row['judged_value']:.6g}{unit} ({how})")
    if _is_told(row["minimum"]):
        gap = f": {plain(row['best_value'] - row['minimum'], 4)} above it" if row["best_evaluation"] else ""
        lines.append(f"minimum    {row['minimum']:.6g}{unit}, as the problem declares{gap}")
    if _is_told(row["kmrmse"]):
        lines.append(
            f"merit      kmrmse {plain(row['kmrmse'], 4)} mm, modulo the gauge {plain(row['kmrmse_aligned'], 4)} mm, "
            f"phi {plain(row['gauge_phi'], 4)} rad"
        )
    if isinstance(row["merit"], str):
        told = json.loads(row["merit"]).items()
        lines.append("merit      " + ", ".join(f"{k} {v:.6g}" if type(v) is float else f"{k} {v}" for k, v in told))
    if row["best_evaluation"] and _is_told(row["inside_box"]):
        bounds = ", ".join(row["at_bound"]) or "none"
        lines.append(f"box        {'inside' if row['inside_box'] else 'outside'}; at a bound: {bounds}")
    return lines


def _readable(options: str) -> str:
    """Return options as JSON with letters beyond ASCII as they are."""
    return json.dumps(json.loads(options), separators=(",", ":"), ensure_ascii=False)


def _targets(row: Mapping[str, Any]) -> list[str]:
    """Return the targets that were reached, at most so many of them, and the first that was not."""
    levels = [float(level) for level in row["targets"]]
    if not levels:
        return []
    reached = [
        (level, int(hit), int(charged))
        for level, hit, charged in zip(levels, row["hits"], row["hits_charged"], strict=True)
        if hit is not None and hit == hit
    ]
    missed = [level for level in levels if level not in {level for level, _, _ in reached}]
    places = sorted({round(place) for place in np.linspace(0, len(reached) - 1, _TARGETS)}) if reached else []
    shown = [reached[place] for place in places]
    some = f", {len(shown)} of them" if len(shown) < len(reached) else ""
    lines = ["", f"targets    {len(reached)} of {len(levels)} reached{some}:"]
    lines += [f"  {level:12.6g}  at evaluation {hit} ({charged} charged)" for level, hit, charged in shown]
    return lines + ([f"  {missed[0]:12.6g}  not reached"] if missed else [])


def _parameters(row: Mapping[str, Any]) -> list[str]:
    """Return the physical parameters, with unit, truth and standard error where the problem knows them."""
    if row["parameter_values"] is None:
        return []
    parameters, errors, said = _known(row)
    lines = [""]
    names = list(row["parameter_names"])
    widest = max(6, *map(len, names))
    units = {name: each.unit for name, each in parameters.items()}
    room = max([0, *(len(unit) + 1 for unit in units.values() if unit)])
    for name, value in zip(names, row["parameter_values"], strict=True):
        error = errors.get(name)
        spread = "" if name not in errors else "  not determined" if error is None else f"  ± {error:11.3g}   "
        known = parameters[name].true if name in parameters else None
        unit = f" {units.get(name, '')}".ljust(room) if room else ""
        true = "" if known is None else f"   true {_fixed(known):>12s}"
        lines.append(f"  {name:{widest}s} {_fixed(value):>14s}{unit}{spread}{true}".rstrip())
    return [*lines, *said]


def _fixed(value: float) -> str:
    """Return a value with six digits after the point; with a power of ten where these would not tell it."""
    return f"{value:.6f}" if not value or 1e-4 <= abs(value) < 1e7 else f"{value:.6e}"


def _known(row: Mapping[str, Any]) -> tuple[dict[str, Parameter], dict[str, float | None], list[str]]:
    """Return parameters by name, standard errors at the answer (None: the data do not tell it), and what is said."""
    try:
        problem = problem_of(row)
        parameters = {p.name: p for p in parameters_of(problem)}
    except (ValueError, AttributeError):  # somebody's own, or without parameters
        return {p.name: p for p in parameters_in(row)}, {}, []
    try:
        found = problems.identify(problem, np.array(row["best_x"], dtype=float))
    except (ValueError, AttributeError, ArithmeticError):  # without a Jacobian nothing is said
        return parameters, {}, []
    errors = found.to_dict()["standard_errors"]
    said = (
        f"  ±: one standard error at this answer, for independent noise of {found.noise:g} {found.noise_unit} a reading"
    )
    return parameters, errors, [said, f"  {found.sentence()}"]


def _is_told(value: Any) -> bool:
    return value is not None and bool(value == value)


def _text(value: Any) -> str:
    return value if isinstance(value, str) and value else "not known"


def _whole(value: Any) -> str:
    return str(int(value)) if _is_told(value) else "?"


def _unit(row: Mapping[str, Any]) -> str:
    return f" {row['unit']}" if isinstance(row["unit"], str) and row["unit"] else ""
