"""Measured runs of a GPM2002 that misses nothing, made from inverse kinematics alone, for the tests of single steps."""

from __future__ import annotations

import numpy as np

from calibench.discrepancy import MeasuredData
from calibench.problems.planar.gpm2002 import NAMES, home, inverse_kinematics, makers_machine


def empty_run(
    rng: np.random.Generator, poses: int = 60, repeats: int = 4, sigma: float = 1e-4, radius: float = 110.0
) -> MeasuredData:
    """Return angles only, each pose read `repeats` times, in visits of two."""
    machine = makers_machine() + np.array([5.0] * 12 + [0.2] * 3) * rng.uniform(-1, 1, 15)
    machine[12:] += 1.0
    r, angle = radius * np.sqrt(rng.random(poses)), rng.uniform(-np.pi, np.pi, poses)
    disc = home() + np.stack([r * np.cos(angle), r * np.sin(angle)], axis=-1)
    angles = inverse_kinematics(machine, np.repeat(disc, repeats, axis=0)) - machine[12:]
    n = len(angles)
    readings = angles + sigma * rng.standard_normal(angles.shape)
    columns = {
        "t_s": 3.0 * np.arange(n),
        "pose_id": np.repeat(np.arange(poses), repeats),
        "visit_id": np.arange(n) // 2,
        "repeat": np.arange(n) % 2,
        "temp_K": 5 * np.sin(7 * np.arange(n) / n),
    }
    columns |= {f"enc_{i}": readings[:, i - 1] for i in (1, 2, 3)}
    nominal = dict(zip(NAMES, machine.tolist()))
    return MeasuredData(columns, "gpm2002", {"sigma_enc": sigma, "tooth_numbers": [40, 50, 60], "nominal": nominal})
