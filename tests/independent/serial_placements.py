"""How far calibrated numbers are off, in their own standard errors: ``python -m tests.independent.serial_placements``.

Sound arms of `serial`, the batch ``placements``. What a number should be is what the same readings give without noise:
numbers that say the same thing share what is wrong between them, and which of them are held is a choice. Of each arm
the line tells how many numbers are within 3 standard errors; the last lines tell how many of all, by make and poses.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from calibench.discrepancy import MeasuredData, Model
from calibench.discrepancy.machines.arm import Arm
from calibench.problems.base import Array
from calibench.problems.fitting import gauss_newton
from tests.independent.serial_cases import Case, case
from tests.independent.serial_score import batches

_OFF = 3.0  # standard errors


def standardised(drawn: Case) -> Array:
    """Return how far each calibrated number of a case is off, (p,), in its standard errors."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(drawn.urdf)
        formulation = Arm(str(path)).formulate(MeasuredData(drawn.columns, "arm", drawn.stated, "arm"))
    x, spread = fitted(formulation)
    exact = drawn.exact[-len(formulation.data) :]  # the first row is left out where no column tells directions
    seen = {name: exact[:, k] for k, name in enumerate("xyz")}
    true, _ = fitted(formulation.on(formulation.data.with_columns(seen)))
    return np.asarray((x - true) / (drawn.sigma * spread))


def fitted(formulation: Any) -> tuple[Array, Array]:
    """Return the parameters of least squares, and their standard deviations at a noise of 1 mm."""
    model = Model(formulation)
    x = gauss_newton(
        lambda x: model.residuals(x).ravel(),
        lambda x: model.jacobian(x).reshape(-1, model.size),
        model.start,
        rank_tolerance=1e-10,
    )
    J = model.jacobian(x).reshape(-1, model.size)
    return np.asarray(x), np.asarray(np.sqrt(np.diag(np.linalg.inv(J.T @ J))))


def lines(first: int, last: int, **asked: Any) -> Iterator[str]:
    """Yield a line an arm, then the counts."""
    counts: dict[tuple[str, int], list[int]] = {}
    squares = []
    for seed in range(first, last + 1):
        drawn = case(seed, **asked)
        z = standardised(drawn)
        within = int((np.abs(z) < _OFF).sum())
        there = counts.setdefault((drawn.make, drawn.poses), [0, 0, 0])
        for k, more in enumerate((within, len(z), 1)):
            there[k] += more
        squares.append(z**2)
        yield f"{seed} {drawn.make} {drawn.poses} poses {drawn.sigma} mm: {within} of {len(z)}, rms {rms(z**2):.2f}"
    for (make, poses), (within, of, arms) in sorted(counts.items()):
        yield f"{make}, {poses} poses: {within} of {of} numbers of {arms} arms within {_OFF:g} standard errors"
    within, of = (sum(one[k] for one in counts.values()) for k in (0, 1))
    yield f"all: {within} of {of} ({within / of:.4f}), rms {rms(np.concatenate(squares)):.3f} standard errors"


def rms(squares: Array) -> float:
    """Return the root of the mean."""
    return float(np.sqrt(squares.mean()))


def main(*seeds: str) -> None:
    """Print the lines of the batch, or of the seeds from the first word to the second."""
    [batch] = [one for one in batches() if one["name"] == "placements"]
    first, last = (int(seed) for seed in seeds) if seeds else (batch["first"], batch["last"])
    for line in lines(first, last, **batch["asked"]):
        print(line, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
