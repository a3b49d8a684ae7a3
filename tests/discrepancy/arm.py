"""An arm of two links with encoders and a tracker, as a user writes his machine: `docs/own-machine.md`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibench.discrepancy import Constraints, MeasuredData
from calibench.discrepancy.model.measured import Sensor
from calibench.problems.base import Parameter

PARAMETERS = (
    Parameter("la", "mm", 400.0, 390.0, 410.0),
    Parameter("z1", "rad", 0.0, -0.1, 0.1),
    Parameter("lb", "mm", 300.0, 290.0, 310.0),
    Parameter("z2", "rad", 0.0, -0.1, 0.1),
)
SIGMA = {"angle": 2e-5, "place": 0.02}  # rad, mm


@dataclass(frozen=True)
class Arm:
    """The arm with its encoders in columns `angles`; `instruments` are what its author says of them."""

    angles: tuple[str, str] = ("enc_1", "enc_2")
    instruments: tuple[Sensor, ...] = ()
    name: str = "two_link"

    def formulate(self, data: MeasuredData) -> Constraints:
        """Return the arm's closure."""
        first, second = self.angles

        def closure(q):  # type: ignore[no-untyped-def]
            a = q[first] + q["z1"]
            b = a + q[second] + q["z2"]
            x, y = q["la"] * np.cos(a) + q["lb"] * np.cos(b), q["la"] * np.sin(a) + q["lb"] * np.sin(b)
            return np.stack([x - q["x"], y - q["y"]], axis=-1)

        noise = {**dict.fromkeys(self.angles, SIGMA["angle"]), **dict.fromkeys("xy", SIGMA["place"])}
        return Constraints(data, closure, PARAMETERS, noise, instruments=self.instruments)


def readings(angles: Sequence[str] = ("enc_1", "enc_2"), wild: float = 0.0, seed: int = 0) -> MeasuredData:
    """Return sixty poses read three times; a part `wild` of the second encoder's readings is 40 deviations off."""
    rng = np.random.default_rng(seed)
    pose = np.repeat(np.arange(60), 3)
    drive = rng.uniform([-0.6, 0.4], [1.2, 2.0], (60, 2))[pose]
    a, b = drive[:, 0], drive.sum(axis=1)
    n = len(pose)
    x = 401.3 * np.cos(a) + 298.9 * np.cos(b) + SIGMA["place"] * rng.standard_normal(n)
    y = 401.3 * np.sin(a) + 298.9 * np.sin(b) + SIGMA["place"] * rng.standard_normal(n)
    read = drive - [0.013, -0.021] + SIGMA["angle"] * rng.standard_normal((n, 2))
    read[:, 1] += (rng.random(n) < wild) * 40 * SIGMA["angle"] * rng.choice([-1, 1], n)
    columns = {angles[0]: read[:, 0], angles[1]: read[:, 1], "x": x, "y": y, "pose_id": pose, "visit_id": pose}
    return MeasuredData(columns, "two_link", {}, "arm")
