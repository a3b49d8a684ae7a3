"""Your own machine: a slide read by a scale, checked by a laser; its laws are checked, then play is looked for in it.

python examples/own_machine.py
"""

from dataclasses import dataclass

import numpy as np

import calibench
from calibench.discrepancy import Constraints, EffectFamily, LinearEffect, MeasuredData, Sensor, needs
from calibench.problems import Parameter

PARAMETERS = (Parameter("zero", "mm", 0.0, -5.0, 5.0), Parameter("gain", "1", 1.0, 0.9, 1.1))
SENSORS = (Sensor("scale", "scale", "mm", "slide"), Sensor("laser", "laser", "mm"))


def closure(q):
    """Return what vanishes on a perfect slide: where the scale says it is, less where the laser sees it; (n, 1), mm."""
    return (q["zero"] + q["gain"] * q["scale"] - q["laser"])[:, None]


@dataclass(frozen=True)
class Slide:
    """The slide; the scale reads to 1 µm, the laser to 2 µm."""

    name: str = "slide"

    def formulate(self, data):
        return Constraints(data, closure, PARAMETERS, {"scale": 1e-3, "laser": 2e-3}, instruments=SENSORS)


def build(formulation, target):
    """Return play as a candidate: half of it to this side or to that, by the direction the slide came from."""
    needs(formulation.data, "direction")
    changes = lambda q, data: {"scale": -0.5 * data["direction"][:, None]}  # noqa: E731
    return (LinearEffect("play", target, play.formula, "reading", play.columns, ("b",), ("mm",), "mm", changes),)


play = EffectFamily("play", "slide", "The nut has play", "scale -= b / 2 direction", "reading", ("direction",), "mm",
                    ("slide",), build).enter()  # fmt: skip


def measured(backlash: float, seed: int = 0) -> MeasuredData:
    """Return 60 places read twice, of a slide with `backlash` [mm], as its own scale and the laser see them."""
    rng = np.random.default_rng(seed)
    pose = np.repeat(np.arange(60), 2)
    scale, direction = rng.uniform(0, 300, 60)[pose], rng.choice([-1.0, 1.0], 60)[pose]
    laser = 1.7 + 1.0004 * (scale - backlash / 2 * direction) + 2e-3 * rng.standard_normal(len(pose))
    scale = scale + 1e-3 * rng.standard_normal(len(pose))
    return MeasuredData({"pose_id": pose, "scale": scale, "laser": laser, "direction": direction}, "slide", {}, "slide")


if __name__ == "__main__":
    calibench.testing.check_machine(Slide(), measured(0.05))
    calibench.testing.check_effect(play, Slide(), measured(0.05))
    for backlash in (0.0, 0.05):
        report = calibench.discrepancy.explain(Slide(), measured(backlash))
        found = [f"{f.effect}: {f.amplitude.value:.3f} {f.amplitude.unit}" for f in report.findings]
        print(f"play of {backlash} mm: {report.verdict} {found}")
