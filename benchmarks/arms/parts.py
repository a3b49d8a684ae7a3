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
from calibench.bench.calibration.judged import rms
from calibench.discrepancy import MeasuredData


@final
@dataclass(frozen=True)
class Part:
    """What a part of `poses` said, and the rms error [mm] of the poses it had not, by geometry and with names."""

    series: str
    poses: int
    seed: int
    verdict: str
    names: str
    geometry_mm: float
    named_mm: float

    @property
    def line(self) -> str:
        """Return it as a line."""
        told = f"{self.series} {self.poses} {self.seed}: {self.verdict}, {self.geometry_mm:.3f} -> {self.named_mm:.3f}"
        return f"{told} mm{f'; {self.names}' if self.names else ''}"


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
    return Part(name, n, seed, found.report.verdict, names, rms(found.geometry), rms(found.named))
