"""An arm of two links whose tip is tracked while the room warms up, with faults of its joints in other forms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibench.discrepancy import Instrument, Joint, Length, MeasuredData, Predicted, Roles
from calibench.discrepancy.model.machine import Numbers, Quantities
from calibench.problems.base import Array, Parameter

PARAMETERS = (
    Parameter("la", "mm", 400.0, 390.0, 410.0),
    Parameter("z1", "rad", 0.0, -0.1, 0.1),
    Parameter("lb", "mm", 300.0, 290.0, 310.0),
    Parameter("z2", "rad", 0.0, -0.1, 0.1),
)
ROLES = Roles(
    joints=(Joint("joint 1", "enc_1"), Joint("joint 2", "enc_2")), time="t_s", temperature="temp",
    lengths=(Length("upper arm", "la"), Length("forearm", "lb")), instruments=(Instrument("tracker", ("x", "y")),),
)  # fmt: skip
ZEROS = np.array([0.013, -0.021])  # rad


@dataclass(frozen=True)
class WarmArm:
    """The arm; `held` are numbers that are not calibrated, `sigma` the tracker's noise, None where nobody knows it."""

    held: tuple[str, ...] = ()
    sigma: float | None = 0.02
    name: str = "warm_arm"

    def formulate(self, data: MeasuredData) -> Predicted:
        """Return what the tracker is predicted to read."""
        free = tuple(p for p in PARAMETERS if p.name not in self.held)
        held = dict(zip(("z1", "z2"), ZEROS)) if self.held else {}
        noise = {"x": self.sigma, "y": self.sigma}
        return Predicted(data, tip, free, noise, inputs=("enc_1", "enc_2"), roles=ROLES, held=held)


def tip(q: Quantities) -> Numbers:
    """Return where the tip is, (n, 2)."""
    a = q["enc_1"] + q["z1"]
    b = a + q["enc_2"] + q["z2"]
    return np.stack([q["la"] * np.cos(a) + q["lb"] * np.cos(b), q["la"] * np.sin(a) + q["lb"] * np.sin(b)], axis=-1)


def run(seed: int, shift: Array, temp: Array, noise: float = 0.02) -> MeasuredData:
    """Return readings of an arm whose joints stand `shift`, (n, 2) rad, farther than the encoders and zeros say."""
    rng, n = np.random.default_rng(seed), len(temp)
    drive = rng.uniform([-0.6, 0.4], [1.2, 2.0], (n, 2))
    a, b = drive[:, 0], drive.sum(axis=1)
    x = 401.3 * np.cos(a) + 298.9 * np.cos(b) + noise * rng.standard_normal(n)
    y = 401.3 * np.sin(a) + 298.9 * np.sin(b) + noise * rng.standard_normal(n)
    read = drive - ZEROS - shift
    split = np.where(np.arange(n) % 3 == 0, "hold", "train")
    columns = {"enc_1": read[:, 0], "enc_2": read[:, 1], "x": x, "y": y, "t_s": 20.0 * np.arange(n), "temp": temp}
    return MeasuredData({**columns, "split": split}, "warm_arm", {}, f"run {seed}")
