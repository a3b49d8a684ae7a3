"""`delta9`: nine errors of a linear delta printer, from heights at the probe and distances by caliper.

Unknown are what endstops a b c, the radius, the angles of towers a and b, and rods a b c are wrong by, mm and rad. The
angle of tower c is held: all three together turn the printer, and neither bed nor caliper sees that. Heights alone
leave radius and rods almost inseparable; how much a plan tells is what `bench identify problem=delta9` prints.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, Literal, final

import numpy as np

from calibench.problems.base import Array, Parameter, frozen, registry
from calibench.problems.delta.instances import HALF, WEIGHT, DeltaInstance, Machine, delta_instance
from calibench.problems.delta.plans import Places, places
from calibench.problems.delta.probing import DeltaProbing
from calibench.problems.instances import check_instance, refuse_drawn

NAMES = (
    "endstop_a", "endstop_b", "endstop_c", "radius", "angle_a", "angle_b", "rod_a", "rod_b", "rod_c",
)  # fmt: skip
_UNITS = ("mm", "mm", "mm", "mm", "rad", "rad", "mm", "mm", "mm")
_TRUTH = (1.412, -0.873, 2.106, 1.927, 0.006283, -0.004712, 1.233, -0.418, 0.852)  # simulated: as large as printers'


def _declared(
    plan: Literal["object", "rings", "rich"] = "object",
    sigma: float = 0.0,
    seed: int = 0,
    instance: int | None = None,
) -> None:
    """Declare the options of `delta9`: where it is measured, and sigma [mm], the noise of a height, with its seed."""


@final
class DeltaFamily:
    """Endstops, radius, angles and rods of a linear delta, from heights of the bed and a printed object."""

    name = "delta9"
    said_if_chosen = ("instance",)

    def __call__(self, **options: Any) -> DeltaProbing:
        """Build the problem with `options` (those of ``bench list problems``)."""
        options = registry.check(self.name, options)
        if options.get("instance") is not None:
            return _drawn(tuple(sorted(options.items())))
        chosen = _chosen(options)
        if chosen["sigma"] < 0:
            raise ValueError(f"delta9.sigma={chosen['sigma']:g}: a standard deviation [mm] cannot be negative")
        if chosen["seed"] < 0:
            raise ValueError(f"delta9.seed={chosen['seed']}: must be 0 or above")
        machine, half = Machine(), np.array(HALF)
        sides = (np.zeros(len(NAMES)), -half, half, np.array(_TRUTH))
        return _measured(chosen, machine, places(chosen["plan"], machine.bed_radius), sides, chosen)


delta9 = DeltaFamily()
registry.register("delta9", options=_declared)(delta9)


def _chosen(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return checked options with the defaults; without `instance` where there is none."""
    bound = inspect.signature(_declared).bind(**options)
    bound.apply_defaults()
    return {key: value for key, value in bound.arguments.items() if key != "instance" or value is not None}


@lru_cache(maxsize=256)  # a problem is a value, and drawing it takes a hundred times as long as a call
def _drawn(given: tuple[tuple[str, Any], ...]) -> DeltaProbing:
    """Return the problem that the instance draws: another machine, plan, noise and box."""
    chosen = _chosen(dict(given))
    instance: int = chosen["instance"]
    check_instance("delta9", instance)
    drawn = delta_instance(instance, _without_noise)
    refuse_drawn("delta9", instance, dict(given), drawn.options)
    return _taken(chosen | dict.fromkeys(drawn.options), drawn, drawn.options)


def _without_noise(drawn: DeltaInstance) -> DeltaProbing:
    """Return the problem of the machine that is read without noise, to be looked at before it is taken."""
    return _taken({}, drawn, drawn.options | {"sigma": 0.0})


def _taken(says: dict[str, Any], drawn: DeltaInstance, noise: Mapping[str, Any]) -> DeltaProbing:
    sides = (np.zeros(len(NAMES)), drawn.box.lower, drawn.box.upper, drawn.box.truth)
    return _measured(says, drawn.machine, drawn.places, sides, noise, drawn)


def _measured(
    says: dict[str, Any], machine: Machine, at: Places, sides: tuple[Array, ...], noise: Mapping[str, Any],
    drawn: DeltaInstance | None = None,
) -> DeltaProbing:  # fmt: skip
    """Take the heights and distances that the true machine gives, with noise."""
    rows = zip(NAMES, _UNITS, *(side.tolist() for side in sides), strict=True)
    parameters = tuple(Parameter(*row) for row in rows)
    silent = DeltaProbing(says, parameters, machine, at, frozen(np.zeros(len(at))), drawn=drawn)
    weight = np.where(at.between == 1, WEIGHT, 1.0)
    draw = np.random.default_rng(noise["seed"]).standard_normal(len(at))
    seen = (silent.residuals(sides[3]) + noise["sigma"] * draw) / weight
    return replace(silent, measured=frozen(seen))
