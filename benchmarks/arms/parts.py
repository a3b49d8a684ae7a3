"""Few poses of a measured arm are searched, and all others of the series predicted: how far do names carry?

A part is drawn at random. The error of the other poses is told by the part's geometry, and by its geometry and names.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np
import pandas as pd

from benchmarks.arms.series import series
from benchmarks.arms.within import Within, within
from calibench.calibration.fit import rms
from calibench.discrepancy import MeasuredData, Report
from calibench.discrepancy.fitting.fit import orthonormal

_FULL = 1e-10  # of the largest singular value: a direction below it is rounding
SEEN = 0.2  # part of a name's signature: stated before seeds 100 to 119 were drawn


@final
@dataclass(frozen=True)
class Part:
    """What a part of `poses` said, and the rms error [mm] of the poses it had not, by geometry and with names.

    `seen` is what calibration leaves of the signature of a name, the least of all names; 1 where nothing is named.
    """

    series: str
    poses: int
    seed: int
    verdict: str
    names: str
    geometry_mm: float
    named_mm: float
    seen: float = 1.0

    @property
    def line(self) -> str:
        """Return it as a line."""
        told = f"{self.series} {self.poses} {self.seed}: {self.verdict}, {self.geometry_mm:.3f} -> {self.named_mm:.3f}"
        return f"{told} mm{f'; seen {self.seen:.3f}; {self.names}' if self.names else ''}"


def parts(folder: Path, names: Sequence[str], seeds: Sequence[int], sizes: Sequence[int]) -> Iterator[Part]:
    """Yield what each part says: of every size and seed one from each series."""
    for n in sizes:
        for seed in seeds:
            for name in names:
                yield _part(name, n, seed, within(drawn(series(folder, name), name, n, seed)))


def table(found: Sequence[Part]) -> str:
    """Return a row for each size: verdicts, median errors, and how often names predict worse than geometry alone."""
    frame = pd.DataFrame([vars(one) for one in found])
    frame["worse"] = frame["named_mm"] > frame["geometry_mm"]
    lines = [
        "| poses | parts | named or ambiguous | partly | none or unknown | geometry [mm] | with names [mm] | worse |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for n, own in frame.groupby("poses"):
        sure, partly = own["verdict"].isin(["named", "ambiguous"]), own["verdict"] == "partly"
        counts = [sure.sum(), partly.sum(), (~sure & ~partly).sum()]
        middle = [own[column].median() for column in ("geometry_mm", "named_mm")]
        worse = f"{own['worse'].sum()} (of the sure ones {own.loc[sure, 'worse'].sum()})"
        cells = [n, len(own), *counts, *(f"{m:.3f}" for m in middle), worse]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    named = frame[frame["names"] != ""]
    for words, own in (("predict worse", named[named["worse"]]), ("predict better", named[~named["worse"]])):
        lines.append(f"names that {words}: {len(own)}, of them seen by less than {SEEN}: {(own['seen'] < SEEN).sum()}")
    return "\n".join(lines)


def drawn(data: MeasuredData, name: str, n: int, seed: int) -> MeasuredData:
    """Return the data with n rows to be fitted, and all others kept back."""
    chosen = np.random.default_rng([seed, n, ord(name)]).choice(len(data), n, replace=False)
    split = np.full(len(data), "hold ")
    split[chosen] = "train"
    columns = {column: np.asarray(data[column]) for column in data.columns}
    return MeasuredData(columns | {"split": np.char.strip(split)}, "arm", {}, f"UR10 {name}, {n} poses, seed {seed}")


def _part(name: str, n: int, seed: int, found: Within) -> Part:
    names = ", ".join(" or ".join(rival.effect for rival in one.set) for one in found.report.findings)
    report = found.report
    return Part(name, n, seed, report.verdict, names, rms(found.geometry), rms(found.named), seen(report))


def seen(report: Report) -> float:
    """Return what calibration leaves of the signature of a name as it was fitted: the least part of all names.

    Where that is little, the name and the calibrated numbers nearly cancel at the poses that were fitted.
    """
    plain, final = report.before.fit, report.model.fit
    if not report.findings or report.verdict == "unknown":
        return 1.0
    taken, at, least = orthonormal(plain.J, _FULL), len(plain.x), 1.0
    for _, c in final.model.coefficients(final.x):
        whole = final.J[:, at : at + len(c)] @ c
        at += len(c)
        left = whole - taken @ (taken.T @ whole)
        least = min(least, float(np.linalg.norm(left) / max(np.linalg.norm(whole), 1e-300)))
    return least
