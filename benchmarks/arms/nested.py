"""Parts of a measured arm are searched again without some of their poses: is it foretold which names carry?

A nested cross-validation: each fold of a part is predicted by a search of the part's other poses, by what that search
named or, where it named nothing, by its calibration. The same fold is predicted by that calibration alone. Poses that
are not in the part tell whether the names of the whole part carry.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np
import pandas as pd

from benchmarks.arms.frames import norms
from benchmarks.arms.parts import drawn
from benchmarks.arms.series import URDF, series
from calibench.calibration.fit import rms
from calibench.discrepancy import MeasuredData, Model, Report, explain
from calibench.discrepancy.machines.arm import Arm
from calibench.problems.base import Array

_SURE = ("named", "ambiguous")


@final
@dataclass(frozen=True, eq=False)
class Nested:
    """A part with names: what they do to the poses that are not in it, and what searches of the part's folds foretell.

    `truth` is the rms error with names over that without, on the other poses of the series. `before` and `after` (n,)
    are squared errors [mm2] of the part's own poses, each by a search without its fold. `again` is the part of the
    folds in which the first of the names, or one that could not be told from it, is told again.
    """

    series: str
    poses: int
    seed: int
    verdict: str
    truth: float
    before: Array
    after: Array
    again: float

    @property
    def ratio(self) -> float:
        """Return the rms error of the poses left out, with what was named over without."""
        return float(np.sqrt(self.after.mean() / self.before.mean()))

    @property
    def worse(self) -> float:
        """Return the part that names predict worse of the poses that they change; .5 where they change none."""
        changed = ~np.isclose(self.after, self.before)
        return float(np.mean(self.after[changed] > self.before[changed])) if changed.any() else 0.5

    @property
    def surely(self) -> float:
        """Return the mean fall of the squared error over its standard error, poses taken as independent."""
        fall = self.before - self.after
        spread = float(fall.std(ddof=1)) / len(fall) ** 0.5
        return float(fall.mean()) / spread if spread > 0 else 0.0

    @property
    def line(self) -> str:
        """Return it as a line."""
        told = f"{self.series} {self.poses} {self.seed}: {self.verdict}, others {self.truth:.3f}"
        left_out = f"left out {self.ratio:.3f}, {self.worse:.2f} of them worse"
        return f"{told}; {left_out}, fall {self.surely:.1f} standard errors, told again {self.again:.2f}"


def nested(
    folder: Path, names: Sequence[str], seeds: Sequence[int], sizes: Sequence[int], folds: int = 5
) -> Iterator[Nested]:
    """Yield each part in which something is named, of every size and seed one from each series."""
    for n in sizes:
        for seed in seeds:
            for name in names:
                data = drawn(series(folder, name), name, n, seed)
                if (found := searched_again(data, folds)) is not None:
                    yield Nested(name, n, seed, *found)


def searched_again(data: MeasuredData, folds: int) -> tuple[str, float, Array, Array, float] | None:
    """Return verdict, truth, squared errors before and after, and the part of the folds that tell a name again.

    None where nothing is named. Rows whose split is hold are never fitted: they tell the truth.
    """
    whole = Arm(URDF).formulate(data).data
    held = np.asarray(whole["split"]) == "hold"
    report = explain(Arm(URDF), data)
    if not report.findings or report.verdict == "unknown":
        return None
    geometry, named = _squared(report, whole.rows(held))
    own = whole.rows(~held)
    fold = np.arange(len(own)) % folds
    before, after, again = np.empty(len(own)), np.empty(len(own)), []
    first = {rival.effect for rival in report.findings[0].set}
    for k in range(folds):
        there = fold == k
        told = explain(Arm(URDF), own.with_columns({"split": np.where(there, "hold", "train")}))
        before[there], after[there] = _squared(told, own.rows(there))
        again.append(any(rival.effect in first for one in told.findings for rival in one.set))
    truth = rms(np.sqrt(named)) / rms(np.sqrt(geometry))
    return report.verdict, truth, before, after, float(np.mean(again))


def table(found: Sequence[Nested]) -> str:
    """Return how each sign parts names that carry from names that do not, and the medians of it in both groups.

    `auc` is the chance that a name which does not carry looks worse by the sign than one that does; a coin has .5.
    """
    frame = pd.DataFrame(
        {
            "poses": [one.poses for one in found],
            "bad": [one.truth > 1 for one in found],
            "rms with names over without": [one.ratio for one in found],
            "share of poses worse": [one.worse for one in found],
            "fall in standard errors": [-one.surely for one in found],
            "not told again": [1 - one.again for one in found],
        }
    )
    lines = [
        "| poses | sign | names that carry | its median | names that do not | its median | auc |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for n, own in frame.groupby("poses"):
        for sign in frame.columns[2:]:
            good, bad = own.loc[~own["bad"], sign].to_numpy(float), own.loc[own["bad"], sign].to_numpy(float)
            turned = -1 if sign.startswith("fall") else 1
            middles = [f"{turned * np.median(group):.2f}" if len(group) else "" for group in (good, bad)]
            chance = f"{auc(good, bad):.2f}" if len(good) and len(bad) else ""
            lines.append(f"| {n} | {sign} | {len(good)} | {middles[0]} | {len(bad)} | {middles[1]} | {chance} |")
    return "\n".join(lines)


def rule(found: Sequence[Nested]) -> str:
    """Return what would come of withholding names where the poses left out are predicted no better with names."""
    lines = []
    for words, own in (("all", list(found)), ("not partly", [one for one in found if one.verdict in _SURE])):
        bad, good = [one for one in own if one.truth > 1], [one for one in own if one.truth <= 1]
        caught, lost = sum(one.ratio >= 1 for one in bad), sum(one.ratio >= 1 for one in good)
        lines.append(f"withheld where left out poses are no better, {words}: {caught} of {len(bad)} that do not carry, "
                     f"{lost} of {len(good)} that carry")  # fmt: skip
    return "\n".join(lines)


def auc(good: Array, bad: Array) -> float:
    """Return the chance that one of `bad` is above one of `good`, ties by half."""
    apart = bad[:, None] - good[None, :]
    return float(np.mean((apart > 0) + 0.5 * (apart == 0)))


def _squared(report: Report, seen: MeasuredData) -> tuple[Array, Array]:
    """Return the squared errors [mm2] of rows by the calibration, and by the names where something is named."""
    plain = report.before
    geometry = norms(Model(plain.model.formulation.on(seen)).residuals(plain.best)) ** 2
    told = report.findings and report.verdict != "unknown"
    return geometry, norms(report.predict(seen).residuals) ** 2 if told else geometry
