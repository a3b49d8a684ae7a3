"""One run in a terminal: `find_run` looks it up, `show_run` describes it, `again_command` repeats it.

Its curve is one line of blocks over the logarithm of the cost; the height is the logarithm of the value above the
declared minimum, or zero where no value is below it, else the value itself.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibench import optimizers, problems
from calibench.bench.provenance.run_id import UNSEEN, chosen_options, given_options
from calibench.bench.statistics.tables import OF_THE_DATA, parameters_in, problem_of
from calibench.bench.store.manifest import StoreError, read_notes, studies_in
from calibench.bench.store.runs import ResultStore
from calibench.core.registry import MissingFile, NotImported, names_of_files
from calibench.core.words import listed, plain
from calibench.problems.base import Array, parameters_of

_TARGETS = 12  # that are listed
_NAMED = ("problem", "optimizer", "repetition", "status")  # of a candidate
_LISTED = 8  # candidates that are named
_BLOCKS = "█▇▆▅▄▃▂▁"  # the worst value first
_WIDTH = 60
_ROWS = 9
_PLAIN = re.compile(r"[A-Za-z_][\w./:+-]*")
_BEFORE_QUOTE = re.compile(r"\\+(?='|\Z)")  # where Hydra takes two backslashes for one; elsewhere each is itself
_WORDS = {"true", "false", "null", "nan", "inf"}


def show_run(run: Found) -> str:
    """Return the run as text."""
    row = run.row
    unit = f" {row['unit']}" if isinstance(row["unit"], str) and row["unit"] else ""
    lines = [f"run {row['run_id']}  (study {row['study']}, {run.folder})", *_asked_and_ended(row)]
    lines += [f"note       {' '.join(text.split())}" for text in read_notes(run.folder).of_run(row["run_id"])]
    best = "no finite value was found"
    if row["best_evaluation"]:
        best = f"{row['best_value']:.6g}{unit} at evaluation {row['best_evaluation']}"
    lines.append(f"best       {best}")
    if pd.notna(row["judged_evaluations"]):
        fresh = int(row["judged_evaluations"])
        how = f"mean of {fresh} fresh evaluations" if fresh else "without noise"
        lines.append(f"judged     {row['judged_value']:.6g}{unit} ({how})")
    if pd.notna(row["minimum"]):
        gap = f": {plain(row['best_value'] - row['minimum'], 4)} above it" if row["best_evaluation"] else ""
        lines.append(f"minimum    {row['minimum']:.6g}{unit}, as the problem declares{gap}")
    if pd.notna(row["kmrmse"]):
        raw, aligned, phi = (plain(row[name], 4) for name in ("kmrmse", "kmrmse_aligned", "gauge_phi"))
        lines.append(f"merit      kmrmse {raw} mm, modulo the gauge {aligned} mm, phi {phi} rad")
    if isinstance(row["merit"], str):
        merits = json.loads(row["merit"]).items()
        lines.append("merit      " + ", ".join(f"{k} {v:.6g}" if type(v) is float else f"{k} {v}" for k, v in merits))
    if row["best_evaluation"] and pd.notna(row["inside_box"]):
        bounds = ", ".join(row["at_bound"]) or "none"
        lines.append(f"box        {'inside' if row['inside_box'] else 'outside'}; at a bound: {bounds}")
    finite = run.trace[np.isfinite(run.trace["best_value"].to_numpy(dtype=float))]
    if not finite.empty:  # the curve is drawn from the first finite value on
        charged, values, restarts = (finite[key].to_numpy(dtype=float) for key in ("charged", "best_value", "restart"))
        restarts = np.nan_to_num(restarts)
        again = bool(restarts.any())
        line = sparkline(charged, values, float(row["minimum"]) if pd.notna(row["minimum"]) else None)
        lines += [
            "", "curve, over the logarithm of what was charged:",
            f"  {plain(values[0], 4)}{unit} {line} {plain(values[-1], 4)}{unit}",
            f"  {'charged':>9s}  {'best value':>12s}" + ("  restarts" if again else ""),
        ]  # fmt: skip
        marks: Array = np.unique(np.round(np.geomspace(max(charged[0], 1.0), max(charged[-1], 1.0), _ROWS)))
        for at, i in zip(marks, _steps(charged, marks), strict=True):
            lines.append(f"  {at:9.0f}  {values[i]:12.6g}" + (f"  {restarts[i]:8.0f}" if again else ""))
    hits = list(zip(map(float, row["targets"]), row["hits"], row["hits_charged"], strict=True))
    if hits:
        reached = [(level, int(hit), int(charged)) for level, hit, charged in hits if pd.notna(hit)]
        missed = [level for level, _, _ in hits if level not in {level for level, _, _ in reached}]
        places = sorted({round(place) for place in np.linspace(0, len(reached) - 1, _TARGETS)}) if reached else []
        some = f", {len(places)} of them" if len(places) < len(reached) else ""
        lines += ["", f"targets    {len(reached)} of {len(hits)} reached{some}:"]
        shown = (reached[place] for place in places)
        lines += [f"  {level:12.6g}  at evaluation {hit} ({charged} charged)" for level, hit, charged in shown]
        lines += [f"  {missed[0]:12.6g}  not reached"] if missed else []
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


def _asked_and_ended(row: Mapping[str, Any]) -> list[str]:
    library = " ".join(str(row[name]) for name in ("library", "library_version") if isinstance(row[name], str))
    target = f", target {row['target']:g}" if pd.notna(row["target"]) else ""
    # options as JSON with letters beyond ASCII as they are
    problem, optimizer = (
        json.dumps(json.loads(row[f"{of}_options"]), separators=(",", ":"), ensure_ascii=False)
        for of in ("problem", "optimizer")
    )
    budget, jacobians = (
        str(int(row[name])) if pd.notna(row[name]) else "?" for name in ("budget", "jacobian_evaluations")
    )
    texts = (row[name] for name in ("status", "stop_reason", "start", "code_digest"))
    status, reason, start, code = (text if isinstance(text, str) and text else "not known" for text in texts)
    ended = status if reason == status else f"{status}, {reason}"
    error = " ".join(str(row[name]) for name in ("error_type", "error") if isinstance(row[name], str))
    seconds = f", {plain(row['wall_s'], 3)} s" if pd.notna(row["wall_s"]) else ""
    lines = [
        f"problem    {row['problem']} {problem}", f"optimizer  {row['optimizer']} {optimizer}  ({library.rstrip()})",
        f"asked      repetition {row['repetition']}, {start} start, budget {budget}{target}",
        f"code       {code}", f"ended      {ended} {error}".rstrip(),
        f"cost       {row['evaluations']} evaluations, {jacobians} Jacobians: "
        f"{row['charged']} charged of {budget}{seconds}",
    ]  # fmt: skip
    changes = row.get("process_changes")
    if changes is not None and len(changes):
        lines.append(f"process    {', '.join(changes)}: changed by the run, put back after it")
    for name, before, after in (
        ("restarts", "restarts  ", ""),
        ("non_finite", "not finite", " of the values"),
        ("non_finite_slopes", "not finite", " entries of gradients and Jacobians, read as 0"),
    ):
        if pd.notna(row[name]) and row[name]:
            lines.append(f"{before} {int(row[name])}{after}")
    return lines


def _parameters(row: Mapping[str, Any]) -> list[str]:
    """Return the physical parameters, with unit, truth and standard error where the problem knows them."""
    if row["parameter_values"] is None:
        return []
    parameters = {p.name: p for p in parameters_in(row)}
    errors: Mapping[str, float | None] = {}  # standard errors at the answer; None: the data do not tell it
    notes: list[str] = []
    with suppress(ValueError, AttributeError, ArithmeticError):  # somebody's own; without parameters, or a Jacobian
        truths = "" if any(p.true is not None for p in parameters.values()) else "true values; "
        problem = problem_of(row, truths + OF_THE_DATA)
        parameters = {p.name: p for p in parameters_of(problem)}
        known = problems.identify(problem, np.array(row["best_x"], dtype=float))
        errors = known.to_dict()["standard_errors"]
        scale = f"for independent noise of {known.noise:g} {known.noise_unit} a reading"
        notes = [f"  ±: one standard error at this answer, {scale}", f"  {known.sentence()}"]
    lines = [""]
    names = list(row["parameter_names"])
    widest = max(6, *map(len, names))
    units = {name: each.unit for name, each in parameters.items()}
    room = max([0, *(len(unit) + 1 for unit in units.values() if unit)])
    for name, value in zip(names, row["parameter_values"], strict=True):
        error = errors.get(name)
        spread = "" if name not in errors else "  not determined" if error is None else f"  ± {error:11.3g}   "
        true = parameters[name].true if name in parameters else None
        unit = f" {units.get(name, '')}".ljust(room) if room else ""
        said = "" if true is None else f"   true {_fixed(true):>12s}"
        lines.append(f"  {name:{widest}s} {_fixed(value):>14s}{unit}{spread}{said}".rstrip())
    return [*lines, *notes]


def _fixed(value: float) -> str:
    """Return a value with six digits after the point; with a power of ten where these would not tell it."""
    return f"{value:.6f}" if not value or 1e-4 <= abs(value) < 1e7 else f"{value:.6e}"


@final
@dataclass(frozen=True)
class Found:
    """A run where it was found: its row, its trace (evaluations, charged, best_value, restart), its study's folder."""

    row: dict[str, Any]
    trace: pd.DataFrame
    folder: Path


def find_run(parent: Path, prefix: str) -> Found:
    """Return the run whose id begins with `prefix`, from any study under `parent`."""
    if not parent.is_dir():
        raise StoreError(f"{parent}: there is no such results folder; name one with results=DIR")
    candidates: dict[str, tuple[dict[str, Any], Path]] = {}
    here = parent.resolve()
    for folder in studies_in(parent) or [one for one in studies_in(here.parent) if one == here]:
        runs = ResultStore(folder).runs()
        for row in runs[runs["run_id"].str.startswith(prefix)].to_dict("records"):
            candidates[str(row["run_id"])] = {str(name): value for name, value in row.items()}, folder
    if not candidates:
        raise StoreError(f"{prefix}: no run under {parent} has an id that begins so")
    if len(candidates) > 1:  # by as many digits as tell them apart, each with what it is
        ids = sorted(candidates)
        digits = next(n for n in range(1, len(ids[0]) + 1) if len({name[:n] for name in ids}) == len(ids))
        names = [f"{i[:digits]} ({', '.join(str(candidates[i][0][name]) for name in _NAMED)})" for i in ids]
        some = listed(names, _LISTED)
        raise StoreError(f"{prefix}: {len(candidates)} runs begin so: {some}; give more digits")
    [(run_id, (only, home))] = candidates.items()
    traces = ResultStore(home).traces()
    return Found(only, traces[traces["run_id"] == run_id].reset_index(drop=True), home)


def sparkline(charged: Array, heights: Array, minimum: float | None) -> str:
    """Return a block for each of some counts, a constant factor apart; `heights` are the best values, shape (n,)."""
    marks: Array = np.geomspace(max(charged[0], 1.0), max(charged[-1], 1.0), _WIDTH)
    gaps = heights - (0.0 if minimum is None else minimum)
    if (gaps >= 0).all() and (gaps > 0).any():
        heights = np.log10(np.maximum(gaps, gaps[gaps > 0].min() / 10))
    top, bottom = heights.max(), heights.min()
    share = (top - heights) / (top - bottom) if top > bottom else np.zeros(len(heights))
    blocks = np.round(share * (len(_BLOCKS) - 1)).astype(int)
    return "".join(_BLOCKS[blocks[i]] for i in _steps(charged, marks))


def _steps(charged: Array, marks: Array) -> NDArray[np.int64]:
    """Return which point holds at each count: the last that is not later."""
    return np.maximum(np.searchsorted(charged, marks * (1 + 1e-12), side="right") - 1, 0)


def again_command(row: Mapping[str, Any]) -> str | None:
    """Return the `bench run` command of this very run, the same id and seed; None where no command can say it. Raises
    `NotImported` or `MissingFile` where somebody's own class, which knows its options, is not imported or not there."""
    options = {of: json.loads(row[f"{of}_options"]) for of in ("problem", "optimizer")}
    if row["start"] not in ("nominal", "random") or "published" in options["optimizer"]:
        return None
    words = ["bench", "run"]
    for of, registry in (("problem", problems.registry), ("optimizer", optimizers.registry)):
        name = row[of]
        # the command line finds this: by the registry, or in a file or module by its path
        by_path = ":" in name and "<" not in name and not name.startswith("__main__")
        if not (name in registry or by_path) or any(UNSEEN in str(value) for value in options[of].values()):
            return None
        words.append(f"{of}={row[of]}")
        try:
            with names_of_files():
                registry.options(row[of])
                chosen = chosen_options(registry, row[of], given_options(registry, row[of], options[of]))
                registry.check(row[of], chosen)
        except (NotImported, MissingFile):
            raise
        except ValueError:  # a function or an object, for which the row has a word and no command has
            return None
        words += [f"{of}.{key}={value_text(value)}" for key, value in sorted(chosen.items())]
    repetition = int(row["repetition"])
    words += [f"budget={int(row['budget'])}", f"seeds={repetition}:{repetition + 1}", f"start={row['start']}"]
    if row["target"] is not None and row["target"] == row["target"]:
        words.append(f"target={float(row['target'])!r}")
    return " ".join(shlex.quote(word) for word in [*words, "study=again"])


def value_text(value: Any) -> str:
    """Return an option's value as the command line takes it, text that would be read as something else in quotes.

    >>> value_text(None), value_text(True), value_text([1, 2.5]), value_text("ya2"), value_text("12"), value_text("a b")
    ('null', 'true', '[1,2.5]', 'ya2', "'12'", "'a b'")
    """
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    if isinstance(value, list | tuple):
        return f"[{','.join(map(value_text, value))}]"
    if isinstance(value, Mapping):
        return f"{{{','.join(f'{key}:{value_text(item)}' for key, item in value.items())}}}"
    if isinstance(value, str):
        is_plain = _PLAIN.fullmatch(value) and value.lower() not in _WORDS
        doubled = _BEFORE_QUOTE.sub(r"\g<0>\g<0>", value)
        return value if is_plain else "'" + doubled.replace("'", "\\'") + "'"
    return repr(value)
