"""Which reading of its ambiguous words brings GA and PSO nearest to Table 6 of Cong et al. 2008.

A reading of the study cong2008_readings is named by the options that differ from the default. Its distance from a
printed level is that of decimal logarithms; from a column of Table 6, the mean over J1, J2 and J3.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import final

import numpy as np

from calibench import optimizers
from calibench.bench.papers.evidence import Array, Evidence, found
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import (
    NOTHING,
    Ours,
    Row,
    Tolerance,
    at_budget,
    decades_between,
    judge_level,
    judge_limit,
)
from calibench.bench.provenance.run_id import options_of

_ERRORS = ("J1", "J2", "J3")
_STUDY = "cong2008_readings"
_SECTIONS = {"ga": "4.1", "pso": "4.2"}
_DEFAULT = "as read by default"


@final
@dataclass(frozen=True)
class Reading:
    """A reading: its name, and the best values of its runs under each error function."""

    name: str
    best: Mapping[str, Array]

    def distance(self, error: str, printed: float) -> float:
        """Return the decades between the median and what is printed; infinite where nothing was run."""
        best = self.best[error]
        return decades_between(float(np.median(best)), printed) if len(best) else np.inf

    def may_come_to(self, error: str, level: float) -> bool:
        """Tell whether more evaluations may bring it within a decade of what is printed: it is not too low yet."""
        return bool(len(self.best[error])) and float(np.median(self.best[error])) >= level / 10

    def too_low(self, levels: Mapping[str, float]) -> float:
        """Return by how many decades it is below what is printed, under the error where that is most; 0 if above."""
        return max(
            self.distance(error, level) if len(best) and np.median(best) < level else 0.0
            for error, level in levels.items() for best in [self.best[error]]
        )  # fmt: skip


def rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield for each method the nearest reading over its column of Table 6, and for each of its cells."""
    for method in _SECTIONS:
        readings = readings_of(evidence, method)
        yield _column(printed, evidence, method, readings)
        for error in _ERRORS:
            yield _cell(printed, evidence, method, error, readings)


def readings_of(evidence: Evidence, method: str) -> list[Reading]:
    """Return the readings that were run, that by default first."""
    runs = evidence.runs[(evidence.runs["study"] == _STUDY) & (evidence.runs["optimizer"] == method)]
    default = json.loads(json.dumps(dict(options_of(optimizers.make(method)))))
    texts = sorted(set(runs["optimizer_options"]), key=lambda text: json.loads(text) != default)
    return [_reading(evidence, method, json.loads(text), default) for text in texts]


def _reading(evidence: Evidence, method: str, options: Mapping[str, object], default: Mapping[str, object]) -> Reading:
    changed = [f"{key}={value}" for key, value in options.items() if value != default[key]]
    best = {e: found(evidence.of(_STUDY, "full12", method, {"error": e}, options), "best_value") for e in _ERRORS}
    return Reading(" ".join(changed).replace("False", "false") or _DEFAULT, best)


def _column(printed: Printed, evidence: Evidence, method: str, readings: list[Reading]) -> Row:
    levels = {error: printed.column(f"table6.{method}")[error.lower()] for error in _ERRORS}
    far = {r.name: float(np.mean([r.distance(error, levels[error]) for error in _ERRORS])) for r in readings}
    order = sorted(far, key=lambda name: far[name])
    nearest = far[order[0]] if order else np.nan
    told = "; ".join(f"{name} {far[name]:.2f}" for name in order)
    # more evaluations only lower a level: what a reading is too low by already is the least it can come to
    least = min((r.too_low(levels) for r in readings), default=np.nan)
    ruling = judge_limit(nearest, 0.0, 1.0)
    if not least > 1.0:
        ruling = at_budget(ruling, _budget(evidence), printed.column("section44")["evaluations"])
    return printed.claim(
        f"reading_{method}", f"Section {_SECTIONS[method]}, Table 6",
        f"some reading of the open words gives the printed levels of {method.upper()}",
        nearest if np.isfinite(nearest) else NOTHING, ruling,
        "true at no distance, in kind within a decade, over J1, J2 and J3; with less than the printed budget it is "
        "open until each reading is a decade too low under one of them",
        f"least mean distance of {len(readings)} readings from the column of Table 6, decades of medians",
        f"nearest: {order[0] if order else 'none was run'}. Decades from it: {told}. The reading that is least too low "
        f"is so by {least:.2f} decades under its worst error", "decades", printed=0.0,
    )  # fmt: skip


def _cell(printed: Printed, evidence: Evidence, method: str, error: str, readings: list[Reading]) -> Row:
    level = printed.column(f"table6.{method}")[error.lower()]
    order = sorted(readings, key=lambda reading: reading.distance(error, level))
    ours = Ours.of(order[0].best[error]) if order else NOTHING
    budget = _budget(evidence)
    decade = Tolerance(0.0, "in kind within a decade", 1.0, decades=True)
    ruling = judge_level(level, ours, budget, printed.column("section44")["evaluations"], decade)
    if any(reading.may_come_to(error, level) for reading in readings):
        ruling = at_budget(ruling, budget, printed.column("section44")["evaluations"])
    default = next((r.distance(error, level) for r in readings if r.name == _DEFAULT), np.nan)
    return printed.claim(
        f"reading_{method}_{error}", f"Table 6, {method.upper()} under {error}",
        f"the reading of {method.upper()} that comes nearest under {error}", ours, ruling,
        "in kind within a decade; with less than the printed budget not reproduced where all are lower, else open",
        f"best {error}, the nearest of {len(readings)} readings, full12 (gauge=xa2), random plan",
        f"nearest: {order[0].name}, {order[0].distance(error, level):.2f} decades after {budget:.3g} evaluations; "
        f"{_DEFAULT} {default:.2f}; farthest: {order[-1].name}, {order[-1].distance(error, level):.2f}"
        if order else "none was run", "mm^2" if error == "J1" else "mm^4", printed=level,
        about=f"table6.{method}.{error.lower()}",
        differs="it is the nearest of all readings after its own budget, the cell the reading by default after another",
    )  # fmt: skip


def _budget(evidence: Evidence) -> float:
    budgets = evidence.runs.loc[evidence.runs["study"] == _STUDY, "budget"]
    return float(budgets.max()) if len(budgets) else np.nan
