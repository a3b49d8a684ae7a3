"""The evidence for the rows of a paper: the runs that were asked for, by name, options and budget."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import least_squares

from calibench import problems

Array = NDArray[np.float64]


@final
@dataclass(frozen=True, eq=False)
class Evidence:
    """The runs of a paper's studies at one budget, and their traces (columns: `bench.store.runs`)."""

    runs: pd.DataFrame
    traces: pd.DataFrame

    def of(
        self,
        study: str,
        problem: str,
        optimizer: str,
        problem_options: Mapping[str, Any],
        optimizer_options: Mapping[str, Any] | None = None,
    ) -> pd.DataFrame:
        """Return the runs with these options, by repetition; an option that is not named may be anything."""
        runs = self.runs
        mine = runs[(runs["study"] == study) & (runs["problem"] == problem) & (runs["optimizer"] == optimizer)]
        chosen = mine["problem_options"].map(lambda text: _has(text, problem_options)).astype(bool)
        chosen &= mine["optimizer_options"].map(lambda text: _has(text, optimizer_options or {})).astype(bool)
        return mine[chosen].sort_values(["problem_options", "repetition"], kind="stable")

    def trace(self, run_id: str) -> pd.DataFrame:
        """Return the trace of a run."""
        return self.traces[self.traces["run_id"] == run_id]


def problem(name: str, **options: Any) -> Any:
    """Return a problem of the registry, whatever kind it is."""
    return problems.make(name, **options)


def solved_for(misfit: Callable[[float], Array], start: float, scale: float = 1.0) -> tuple[float, Array]:
    """Return the number that makes misfit(number), shape (m,), least in squares, and the slopes there, shape (m,)."""

    def of_vector(x: Array) -> Any:
        return misfit(float(x[0]))

    fit: Any = least_squares(of_vector, [start], method="lm", x_scale=scale, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return float(fit.x[0]), np.asarray(fit.jac[:, 0])


def found(runs: pd.DataFrame, quantity: str) -> Array:
    """Return a calibrated parameter, or a column of the runs, one number for each run."""
    if quantity in runs.columns:
        return runs[quantity].to_numpy(dtype=float)
    kept = runs[runs["parameter_values"].notna()]
    return np.array(
        [
            list(values)[list(names).index(quantity)]
            for names, values in zip(kept["parameter_names"], kept["parameter_values"], strict=True)
            if quantity in list(names)
        ]
    )


def _has(text: str, wanted: Mapping[str, Any]) -> bool:
    have = json.loads(text)
    return all(have.get(key) == value for key, value in wanted.items())
