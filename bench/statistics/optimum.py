"""What is known of a problem's least value. It decides what is drawn and reported, and what is called a floor.

Where a `minimum` f* other than 0 is declared, f - f* is drawn, unless a run inside the box falls below it, which the
page says. The value at a `truth` is a line, called the rounding floor only where it is rounding. Else, and where values
are noisy, the value itself is drawn.
"""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any, final

import numpy as np

from calibench.bench.execution.request import is_stochastic, minimum_of
from calibench.bench.statistics.cells import PROBLEM
from calibench.bench.statistics.summary import SAME, lowest_below
from calibench.bench.statistics.tables import once, problem_of
from calibench.bench.store.columns import Array

if TYPE_CHECKING:
    import pandas as pd

_ROUNDING = float(np.finfo(float).eps)  # of the value at the start: a sum of squares falls to its square by rounding
_WIDE = 100.0  # ratio, beyond which values of both signs need a symlog axis


@final
@dataclass(frozen=True)
class Optimum:
    """What is known of the least value in some runs of one problem: `minimum`, or None; values are in `unit`.

    `symbol` is what the value is called (J2, or f); `floor` the value at the truth, `rounding` the level below which
    values are rounding alone; `noisy`: values are random; `below` is the lowest value found below the declared minimum.
    """

    symbol: str
    unit: str
    minimum: float | None
    floor: float | None
    rounding: float | None
    noisy: bool
    below: float | None

    @property
    def is_gap(self) -> bool:
        """Tell whether f - f* is what is drawn and told."""
        return bool(self.minimum) and self.below is None and not self.noisy

    @property
    def least(self) -> float:
        """Return what is subtracted before a value is drawn or told: f*, or 0."""
        return float(self.minimum or 0.0) if self.is_gap else 0.0

    def above(self, values: Any) -> Array:
        """Return values as they are drawn: as they are, or above f*, where half a rounding of f* stands for 0."""
        drawn = np.asarray(values, dtype=float)
        return np.maximum(drawn - self.least, np.spacing(abs(self.least)) / 2) if self.is_gap else drawn

    def scale(self, drawn: Array) -> str:
        """Return the axis for what is `drawn`: log where nothing is below 0, else linear, or symlog if wide."""
        seen = drawn[np.isfinite(drawn)]
        if seen.size and (seen >= 0).all() and (seen > 0).any():
            return "log"
        return "symlog" if seen.size and np.abs(seen).max() > _WIDE else "linear"

    @property
    def quantity(self) -> str:
        """Return the name of what is drawn and told: J2, f, or f - f*."""
        return f"{self.symbol} - {self.symbol}*" if self.is_gap else self.symbol

    @property
    def axis(self) -> str:
        """Return the label of the axis, with its unit."""
        return f"{'lowest noisy' if self.noisy else 'best'} {self.quantity}{f' [{self.unit}]' if self.unit else ''}"

    @property
    def heading(self) -> str:
        """Return what a table is about, with its unit: the name, and how its numbers are to be read."""
        more = ", above the least value" if self.is_gap else ", noisy: the answer as judged" if self.noisy else ""
        return f"{self.quantity}{more}{f' [{self.unit}]' if self.unit else ''}"

    @property
    def floor_text(self) -> str:
        """Return what the line at the value of the truth is."""
        name = "J" if self.symbol.startswith("J") else self.symbol
        return f"rounding floor: {name}(truth)" if self.rounding is not None else f"{name}(truth)"

    def text(self, value: float) -> str:
        """Return a value for a table under `heading`, in two digits where the least value is 0, otherwise six."""
        if not isfinite(value):
            return "–"
        ends_at_zero = self.below is None and not self.noisy and (self.rounding is not None or self.minimum == 0)
        under = self.is_gap and value < self.least - SAME * abs(self.least)  # of an answer outside the box
        return f"{value - self.least if under else self.above(value):.{2 if self.is_gap or ends_at_zero else 6}g}"

    def sentence(self, value: float) -> str:
        """Return a value in a sentence, with what it is and its unit: ``f - f* 1.2e-09 V``."""
        return f"{self.quantity} {self.text(value)}{f' {self.unit}' if self.unit else ''}"

    def level(self, target: float) -> str:
        """Return a level that counts as success: ``f - f* ≤ 1e-12 mm²``, ``f ≤ -3.1 V``."""
        unit = f" {self.unit}" if self.unit else ""
        judged = "judged " if self.noisy else ""
        return f"{judged}{self.quantity} ≤ {target - self.least:.{3 if self.is_gap else 6}g}{unit}"

    def is_floor(self, target: float) -> bool:
        """Tell whether to reach `target` is to be at the rounding floor: only where that is known."""
        return self.floor is not None and self.rounding is not None and self.floor <= target <= self.rounding

    def remark(self) -> str:
        """Return a sentence on a declared minimum that is wrong; '' where nothing is to be said."""
        if self.below is None:
            return ""
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"A run found {self.below:.10g}{unit}, below the minimum of {self.minimum:.10g}{unit} that the problem "
            "declares: the declared one is not believed here, and values are told as they are."
        )


def ends_of(name: str, options: str) -> tuple[float, float] | None:
    """Return the values of a problem at its truth and start, asked once: the first may be a floor. None where a minimum
    is declared or values are noisy, and of a user's that is not here any more."""

    def ask() -> tuple[float, float] | None:
        with suppress(Exception):  # it is not here, or its code has failed: the figure has no such line
            problem = problem_of({"problem": name, "problem_options": options}, "the rounding floor in its figure")
            truth = None if minimum_of(problem) or is_stochastic(problem) else getattr(problem, "truth", None)
            if truth is not None:
                return float(problem(np.array(truth))), float(problem(np.array(problem.start)))
        return None

    found: tuple[float, float] | None = once(("ends", name, options), ask)
    return found


def optimum_of(runs: pd.DataFrame) -> Optimum:
    """Return the `Optimum` of `runs`, all of one problem with its options."""
    name, options = (str(runs[column].iloc[0]) for column in PROBLEM[:2])
    unit, minimum = _of_rows(runs, "unit"), _of_rows(runs, "minimum")
    noisy = _of_rows(runs, "judged_evaluations") is not None
    floor = rounding = None
    ends = None if minimum or noisy else ends_of(name, options)
    if ends is not None and isfinite(ends[0]):
        floor, first = ends
        rounding = _ROUNDING * first if 0 <= floor <= _ROUNDING * first else None
    return Optimum(
        symbol=str(json.loads(options).get("error", "")) or "f",
        unit="" if unit is None else str(unit),
        minimum=None if minimum is None else float(minimum),
        floor=floor,
        rounding=rounding,
        noisy=noisy,
        below=None if minimum is None else lowest_below(runs, float(minimum)),
    )


def _of_rows(runs: pd.DataFrame, column: str) -> Any:
    """Return the value of the rows in `column`, where any has one: the last that was written."""
    if column not in runs:
        return None
    known = runs[column].notna().to_numpy()
    if not known.any():
        return None
    values = runs[column].to_numpy()[known]
    if (values == values[0]).all():
        return values[0]
    return values[np.argsort(runs["started_at"].to_numpy()[known], kind="stable")[-1]]
