"""What many runs say together: quartiles, success with its interval, convergence bands."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import optimizers
import problems
from bench.identity import chosen_options
from bench.merit import medians
from bench.stochastic import answers, said_by_the_problem

Array = NDArray[np.float64]
CELL = ["problem", "problem_options", "optimizer", "optimizer_options", "start", "budget", "target"]


def summary(runs: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each cell (problem, optimiser, start, budget): medians, quartiles, success, failures.

    `success` is the share of all runs, failed ones included, that reached the `goal`: the run's target, or where it had
    none the last of the problem's; its 95 %
    interval is Wilson's. `charged_to_target` is the median over the runs that did: read it beside `success`. Where
    values are noisy best_* are of the answers as judged (`bench.stochastic`), and `seen_median` is what the runs saw.
    """
    rows = []
    for key, cell in runs.groupby(CELL, sort=False, dropna=False):
        best = answers(cell).to_numpy(dtype=float)
        reached = goal_hits(cell).to_numpy(dtype=float)
        count, won = len(cell), int(np.isfinite(reached).sum())
        low, high = wilson(won, count)
        rows.append(
            dict(zip(CELL, key if isinstance(key, tuple) else (key,), strict=True))
            | {
                "runs": count,
                "failed": int((cell["status"] != "ok").sum()),
                "goal": goal(cell["target"].iloc[0], cell["targets"].iloc[0]),
                "reached": won,
                "success": won / count,
                "success_low": low,
                "success_high": high,
                "best_q1": float(np.quantile(best, 0.25, method="nearest")),
                "best_median": float(np.quantile(best, 0.5, method="nearest")),
                "best_q3": float(np.quantile(best, 0.75, method="nearest")),
                "seen_median": float(np.quantile(cell["best_value"].to_numpy(dtype=float), 0.5, method="nearest")),
                "charged_median": float(cell["charged"].median()),
                "charged_to_target": float(np.median(reached[np.isfinite(reached)])) if won else np.nan,
                "inside_box": int(cell["inside_box"].sum()),
                "restarts": int(cell["restarts"].sum()),
                "kmrmse_median": float(cell["kmrmse"].median()),
                "kmrmse_aligned_median": float(cell["kmrmse_aligned"].median()),
                "parameter_error_mm_median": float(cell["parameter_error_mm"].median()),
                "gauge_phi_spread": float(cell["gauge_phi"].max() - cell["gauge_phi"].min()),
                "wall_s_median": float(cell["wall_s"].median()),
            }
            | said_by_the_problem(cell)
            | medians(cell)
        )
    return pd.DataFrame(rows)


def method_names(table: pd.DataFrame) -> pd.Series:
    """Return what each row's method is called: the optimiser, and of its variants here what sets them apart.

    A variant is named by its options that are not the declared default, the first of them if that is enough.
    """
    pairs = table[["optimizer", "optimizer_options"]].drop_duplicates().to_numpy().tolist()
    names: dict[tuple[str, str], str] = {}
    for optimizer, text in pairs:
        said = [f"{k}={v}" for k, v in chosen_options(optimizers.registry, optimizer, json.loads(text)).items()]
        alone = sum(other == optimizer for other, _ in pairs) == 1
        names[optimizer, text] = optimizer if alone or not said else f"{optimizer} ({', '.join(said)})"
    short = {pair: name.partition(",")[0] + ", …)" if "," in name else name for pair, name in names.items()}
    chosen = short if len(set(short.values())) == len(pairs) else names
    return pd.Series(
        [chosen[pair] for pair in zip(table["optimizer"], table["optimizer_options"], strict=True)],
        index=table.index,
        dtype=str,
    )


def problem_name(problem: str, options: str, but: Sequence[str] = ()) -> str:
    """Return what a problem is called beside others: its name and the options that are not the declared default."""
    declared = problems.registry.options(problem) if problem in problems.registry.names() else {}
    said = [
        f"{key}={value}"
        for key, value in sorted(chosen_options(problems.registry, problem, json.loads(options)).items())
        if value is not None
        and key not in but
        and not (key == "n" and key in declared and declared[key].default is None)
    ]
    return " ".join([problem, *said])


def wilson(successes: int, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a proportion (Wilson 1927); (0, 1) of nothing."""
    if not count:
        return 0.0, 1.0
    z = 1.959963984540054
    share, shrink = successes / count, 1 + z**2 / count
    middle = (share + z**2 / (2 * count)) / shrink
    half = z * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2)) / shrink
    return max(0.0, float(middle - half)), min(1.0, float(middle + half))


def convergence(traces: Iterable[pd.DataFrame], at: Array) -> pd.DataFrame:
    """Return median and quartiles of the best value after `at` charged evaluations, over runs.

    A run that has ended keeps its last value; before its first evaluation it has none, and the band begins where all
    runs have begun.
    """
    curves = []
    for trace in traces:
        charged = trace["charged"].to_numpy()
        index = np.searchsorted(charged, at, side="right") - 1
        values = trace["best_value"].to_numpy(dtype=float)[np.maximum(index, 0)]
        curves.append(np.where(index >= 0, values, np.nan))
    stack = np.array(curves)
    with np.errstate(invalid="ignore"):
        low, middle, high = np.quantile(stack, [0.25, 0.5, 0.75], axis=0, method="nearest")
    return pd.DataFrame({"charged": at, "q1": low, "median": middle, "q3": high, "runs": len(curves)}).dropna()


def goal(target: float | None, targets: Sequence[float]) -> float:
    """Return the level that counts as success: the run's own target, else the last of the problem's, else NaN."""
    if target is not None and target == target:
        return float(target)
    levels = list(targets)
    return float(levels[-1]) if levels else float("nan")


def goal_hits(runs: pd.DataFrame) -> pd.Series:
    """Return for each run the charged evaluations at which its goal was reached; NaN where it never was."""
    found = []
    for target, targets, hits in zip(runs["target"], runs["targets"], runs["hits_charged"], strict=True):
        levels, listed = list(targets), list(hits)
        level = goal(target, levels)
        hit = listed[levels.index(level)] if level in levels else None
        found.append(float("nan") if hit is None else float(hit))
    return pd.Series(found, index=runs.index, dtype=float)
