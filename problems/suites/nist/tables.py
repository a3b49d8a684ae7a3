"""NIST's data sets as they are printed: readings, two starts, certified values with their standard deviations.

One file ``data/NAME.toml`` a data set, made from NIST's NAME.dat; every number stands there with the digits of the
print. The data sets are works of the United States government and in the public domain.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from hashlib import blake2b
from importlib.resources import files
from typing import Literal, final

import numpy as np

from calibench.problems.base import Array, frozen

Difficulty = Literal["lower", "average", "higher"]


@final
@dataclass(frozen=True, eq=False)
class Table:
    """One data set: readings `y`, shape (m,), predictors `x`, shape (k, m), and what NIST certifies.

    `starts`, shape (2, dim), are NIST's start 1 (far) and start 2 (near); `certified` and `deviations`, shape (dim,),
    the certified parameters and their standard deviations; `sum_of_squares` and `residual_deviation` those of the
    residuals. `model` is the formula as NIST prints it, `difficulty` NIST's level. `data_id` is a digest of the
    readings as printed.
    """

    name: str
    difficulty: Difficulty
    model: str
    reference: str
    names: tuple[str, ...]
    starts: Array
    certified: Array
    deviations: Array
    sum_of_squares: float
    residual_deviation: float
    y: Array
    x: Array
    data_id: str


@cache
def table(name: str) -> Table:
    """Return the data set `name`. Raises `FileNotFoundError` where there is none of that name."""
    text = files("calibench.problems.suites.nist").joinpath(f"data/{name}.toml").read_text(encoding="utf-8")
    said = tomllib.loads(text)
    columns, rows = said["data"]["columns"].split(), said["data"]["rows"].split()
    readings = frozen(rows).reshape(-1, len(columns)).T
    printed = np.array([[float(number) for number in four] for four in said["parameters"].values()]).T
    return Table(
        name=said["name"],
        difficulty=said["difficulty"],
        model=said["model"],
        reference=said["reference"],
        names=tuple(said["parameters"]),
        starts=frozen(printed[:2]),
        certified=frozen(printed[2]),
        deviations=frozen(printed[3]),
        sum_of_squares=float(said["residual_sum_of_squares"]),
        residual_deviation=float(said["residual_standard_deviation"]),
        y=frozen(readings[0]),
        x=frozen(readings[1:]),
        data_id=blake2b(" ".join([said["name"], *rows]).encode(), digest_size=8).hexdigest(),
    )
