"""Tables for a terminal."""

from __future__ import annotations

import json
from collections.abc import Mapping
from math import isfinite
from typing import Any

import numpy as np
import pandas as pd

from bench.optimum import best_text
from bench.stats import method_names, problem_name


def print_json(value: Any) -> None:
    """Print `value` as JSON that any reader takes: null for what is no finite number, text for what JSON has not."""
    print(json.dumps(_plain(value), indent=1, allow_nan=False, default=str))


def print_summary(table: Any) -> None:
    """Print a summary of cells (`bench.stats.summary`), a line each."""
    columns = [
        "problem",
        "optimizer",
        "runs",
        "reached",
        "best median",
        "quartiles",
        "evaluations to target",
        "kmrmse*",
    ]
    rows = []
    for row in table.assign(optimizer=method_names(table)).to_dict("records"):
        error = json.loads(row["problem_options"]).get("error")
        name = problem_name(row["problem"], row["problem_options"], but=("error",)) + (f" {error}" if error else "")
        rows.append(
            [
                name, row["optimizer"], str(row["runs"]),
                f"{row['reached']}/{row['runs']}" if row["goal"] == row["goal"] else "-",
                best_text(row, "best_median"), f"{best_text(row, 'best_q1')} .. {best_text(row, 'best_q3')}",
                f"{row['charged_to_target']:.0f}" if row["charged_to_target"] == row["charged_to_target"] else "-",
                f"{row['kmrmse_aligned_median']:.1e}" if row["kmrmse_aligned_median"] >= 0 else "-",
            ]
        )  # fmt: skip
    print_table(columns, rows)
    print("reached: the problem's last target (or target=); kmrmse*: mm, median, modulo the gauge\n")


def print_table(columns: list[str], rows: list[list[str]]) -> None:
    """Print rows under their columns, each as wide as its widest cell."""
    widths = [max(len(str(cell)) for cell in column) for column in zip(columns, *rows, strict=True)]
    for cells in [columns, *rows]:
        print("  ".join(str(cell).ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip())


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if value is pd.NA or value is pd.NaT or (isinstance(value, float) and not isfinite(value)):
        return None
    return value
