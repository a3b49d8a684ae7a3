"""The runs of the study `calibration24` as one compact table: what the answer needs of each run, and no more.

It is kept in the repository, so that the page can be made again without the runs.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from calibench import optimizers
from calibench.bench.statistics.cells import METHOD, PROBLEM
from calibench.bench.statistics.summary import endings
from calibench.bench.statistics.tables import problem_of
from calibench.optimizers.scipy import SETTINGS

STORED = Path("results/reference/calibration24/answer.parquet")
KNOWS = ("residuals", "gradient", "values")
BLOCK = ["family", "instance"]
_ARM = 244.0  # mm: an angle moves the joint B by a link length
_ORDER = ["budget", *BLOCK, "knows", "method", "ends", "repetition"]


def compact(runs: pd.DataFrame) -> pd.DataFrame:
    """Return a row a run of the problems that have an instance.

    family, instance, noise: the problem, and the deviation of a reading [rad or mm]. method, ends ("stops", "restarts"
    or ""), knows: what the method is told beside values, by its traits. budget, repetition, status, inside_box.
    reached_at: charged evaluations at which the value was as good as the noise, NaN: never. charged: all of them.
    excess: best value over that level. position_error_mm: the rms position error after the move along the gauge, of
    `tracking_zero` the error of the place; parameter_error_mm: the largest error, angles times 244 mm. Both NaN where
    the problem does not tell.
    """
    told = {key: _told(mine.iloc[0]) for key, mine in runs.groupby(PROBLEM, sort=False)}
    known = {key: _knows(*key) for key in runs[METHOD].drop_duplicates().itertuples(index=False, name=None)}
    problem = [told[key] for key in zip(*(runs[column] for column in PROBLEM), strict=True)]
    level = np.array([each["level"] for each in problem])
    millimetres = runs["parameter_error_mm_aligned"].fillna(runs["parameter_error_mm"])
    radians = runs["parameter_error_rad_aligned"].fillna(runs["parameter_error_rad"]) * _ARM
    aligned = runs["kmrmse_aligned"].fillna(runs["kmrmse"])
    table = pd.DataFrame(
        {
            "family": runs["problem"],
            "instance": [each["instance"] for each in problem],
            "noise": [each["noise"] for each in problem],
            "method": runs["optimizer"],
            "ends": endings(runs),
            "knows": [known[key] for key in zip(*(runs[column] for column in METHOD), strict=True)],
            "budget": runs["budget"],
            "repetition": runs["repetition"],
            "status": runs["status"],
            "inside_box": runs["inside_box"],
            "reached_at": [
                _hit(*row) for row in zip(level, runs["targets"], runs["hits_charged"], runs["status"], strict=True)
            ],
            "charged": runs["charged"],
            "excess": runs["best_value"].to_numpy() / level,
            "position_error_mm": aligned.fillna(runs["parameter_error_mm"].where(runs["problem"] == "tracking_zero")),
            "parameter_error_mm": np.fmax(millimetres, radians),
        }
    )
    return table.sort_values(_ORDER, ignore_index=True)


def store(table: pd.DataFrame, path: Path = STORED) -> None:
    """Write the table, its errors to four digits, small and alike on every machine."""
    path.parent.mkdir(parents=True, exist_ok=True)
    small = table.assign(
        **{name: _rounded(table[name]) for name in ("excess", "position_error_mm", "parameter_error_mm")}
    )
    pq.write_table(pa.Table.from_pandas(small, preserve_index=False), path, compression="zstd")


def joined(kept: pd.DataFrame, drawn: pd.DataFrame) -> pd.DataFrame:
    """Return the rows that were kept, with those of `drawn` in the place of the same families."""
    others = kept[~kept["family"].isin(drawn["family"].unique())]
    return pd.concat([others, drawn]).sort_values(_ORDER, ignore_index=True)


def stored(path: Path = STORED) -> pd.DataFrame:
    """Return the table that is kept."""
    return pd.read_parquet(path)


def _told(row: pd.Series) -> dict[str, Any]:
    problem = problem_of(row)
    instance = json.loads(row["problem_options"]).get("instance")
    if instance is None:
        raise ValueError(f"{row['problem']}: has no instance; the answer is of the study calibration24")
    return {"instance": instance, "level": problem.as_good_as_noise, "noise": problem.drawn.noise.level}


def _knows(optimizer: str, options: str) -> str:
    chosen = {key: value for key, value in json.loads(options).items() if value is not None}
    traits: Any = optimizers.make(optimizer, **chosen).traits
    setting = SETTINGS.get(optimizer.removeprefix("scipy_")) if optimizer.startswith("scipy_") else None
    if setting is not None and setting.hessian is not None:
        return "residuals"  # their Hessian is 2 J'J of the residuals
    return "residuals" if traits.uses_residuals else "gradient" if traits.uses_gradient else "values"


def _hit(level: float, targets: Any, hits: Any, status: str) -> float:
    """Return the charge at which `level`, one of the targets, was reached; NaN: never, or by a run that failed."""
    place = int(np.argmin(np.abs(np.log(np.asarray(targets, dtype=float) / level))))
    if not np.isclose(targets[place], level, rtol=1e-9):
        raise ValueError(f"the level {level:g} is no target of its run: {list(targets)}")
    return float("nan") if status == "failed" or hits[place] is None or np.isnan(hits[place]) else float(hits[place])


def _rounded(values: pd.Series) -> pd.Series:
    return values.map(lambda value: float(f"{value:.4g}"))
