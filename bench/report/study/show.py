"""One run on one page: what it was, how it ended, what it found beside the truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from calibench.bench.statistics.tables import problem_of
from calibench.bench.store.manifest import StoreError, studies_in
from calibench.bench.store.runs import ResultStore
from calibench.problems.base import parameters_of


def find_run(parent: Path, prefix: str) -> dict[str, Any]:
    """Return the row of the run whose id begins with `prefix`, from any study under `parent`.

    `parent` is the folder of the studies, or of one study. Raises `StoreError` where there is none, or more than one.
    """
    if not parent.is_dir():
        raise StoreError(f"{parent}: there is no such results folder; name one with results=DIR")
    found: dict[str, dict[str, Any]] = {}
    here = parent.resolve()
    for folder in studies_in(parent) or [one for one in studies_in(here.parent) if one == here]:
        runs = ResultStore(folder).runs()
        for row in runs[runs["run_id"].str.startswith(prefix)].to_dict("records"):
            found[str(row["run_id"])] = {str(k): v for k, v in row.items()}
    if not found:
        raise StoreError(f"{prefix}: no run under {parent} has an id that begins so")
    if len(found) > 1:
        raise StoreError(f"{prefix}: {len(found)} runs begin so: {', '.join(sorted(found)[:5])}; give more digits")
    return next(iter(found.values()))


def show_run(row: dict[str, Any]) -> str:
    """Return the run as text."""
    unit = f" {row['unit']}" if row["unit"] else ""
    library = f"{row['library']} {row['library_version']}".rstrip()
    ended = ", ".join(dict.fromkeys((row["status"], row["stop_reason"])))
    lines = [
        f"run {row['run_id']}  (study {row['study']})",
        f"problem    {row['problem']} {row['problem_options']}",
        f"optimizer  {row['optimizer']} {row['optimizer_options']}  ({library})",
        f"repetition {row['repetition']}, {row['start']} start",
        f"code       {row['code_digest'] if isinstance(row['code_digest'], str) else 'not known'}",
        f"ended      {ended} {row['error_type']} {row['error']}".rstrip(),
        f"cost       {row['evaluations']} evaluations, {row['jacobian_evaluations']} Jacobians: "
        f"{row['charged']} charged of {row['budget']}, {row['wall_s']:.3g} s",
        f"best       {row['best_value']:.6g}{unit} at evaluation {row['best_evaluation']}"
        if row["best_evaluation"]
        else "best       no finite value was found",
    ]
    if row["judged_evaluations"] == row["judged_evaluations"]:
        fresh = int(row["judged_evaluations"])
        how = f"mean of {fresh} fresh evaluations" if fresh else "without noise"
        lines.append(f"judged     {row['judged_value']:.6g}{unit} ({how})")
    if row["minimum"] == row["minimum"]:
        lines.append(f"minimum    {row['minimum']:.6g}{unit}, as the problem declares")
    if row["kmrmse"] == row["kmrmse"]:
        lines.append(
            f"merit      kmrmse {row['kmrmse']:.4g} mm, modulo the gauge {row['kmrmse_aligned']:.4g} mm, "
            f"phi {row['gauge_phi']:.4g} rad"
        )
    if isinstance(row["merit"], str):
        told = json.loads(row["merit"]).items()
        lines.append("merit      " + ", ".join(f"{k} {v:.6g}" if type(v) is float else f"{k} {v}" for k, v in told))
    if row["best_evaluation"]:
        bounds = ", ".join(row["at_bound"]) or "none"
        lines.append(f"box        {'inside' if row['inside_box'] else 'outside'}; at a bound: {bounds}")
    if isinstance(row["traceback"], str) and row["traceback"]:
        lines += ["", "the last frames:", row["traceback"].rstrip()]
    if row["parameter_values"] is None:
        return "\n".join(lines)
    try:
        true = {p.name: p.true for p in parameters_of(problem_of(row))}
    except (ValueError, AttributeError):
        true = {}
    lines.append("")
    for name, value in zip(row["parameter_names"], row["parameter_values"], strict=True):
        known = true.get(name)
        lines.append(f"  {name:6s} {value:14.6f}" + ("" if known is None else f"   true {known:12.6f}"))
    return "\n".join(lines)
