"""What may be wrong with a linear delta beside its endstops: towers, rods, belts, effector, bed, and the caliper.

All stay constant during the measurement: a constant is added to the quantities of each target.
"""

from collections.abc import Mapping

import numpy as np

from calibench.discrepancy.machines.delta.formulation import TOWERS
from calibench.discrepancy.model.effect import Built, EffectFamily, NotTestable
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.thresholds import thresholds

Targets = Mapping[str, tuple[str, ...]]  # target -> the quantities that it changes, each by a coefficient of its name
SIZE = ("delta_radius", "rod_length", "belt_scale", "bed_dome")  # all four bow the probed bed alike
OBJECT = "a printed object: distances measured by caliper, which DELTA_ANALYZE takes in"


def each_tower(quantity: str) -> dict[str, tuple[str, ...]]:
    """Return the targets `tower a` to `tower c`, one coefficient each."""
    return {f"tower {t}": (f"{quantity}_{t}",) for t in TOWERS}


_BOUNDS = {"1": "largest_scale", "rad": "largest_angle", "mm": "largest_ratio"}  # by the unit of a size; mm: of a rod


def constant(
    name: str, cause: str, formula: str, channel: str, unit: str, targets: Targets, *,
    of: str = "", twins: str = "", same: Mapping[str, tuple[str, ...]] | None = None, label: str = "",
    label_of_all: str = "",
) -> EffectFamily:  # fmt: skip
    """Enter the family with these `targets`; `of` is the kind of row that it needs, "" for either.

    `same` are the declared twins of a target. Where only heights were measured, those of `SIZE` are twins too.
    """

    bound = _BOUNDS[unit]

    def build(formulation: Formulation, target: str) -> Built:
        kind = np.asarray(formulation.data["kind"])
        if of and not (kind == of).any():
            raise NotTestable(f"needs rows of kind {of}", ("kind",))
        rows = dict(zip(targets[target], np.eye(len(targets[target]))))
        rod = formulation.fixed["arm_a"] if unit == "mm" else 1.0
        alike = (same or {}).get(target, ())
        if target == "all" and name in SIZE and not (kind == "distance").any():
            alike = tuple(f"{twin} all" for twin in SIZE if twin != name)
        return family.linear(
            target, (), dict.fromkeys(rows, unit),
            lambda q, data: {quantity: np.tile(row, (len(data), 1)) for quantity, row in rows.items()}, twins=alike,
            largest=getattr(thresholds(), bound) * rod,
        )  # fmt: skip

    family = EffectFamily(
        name, "delta", cause, formula=formula, channel=channel, columns=(), unit=unit, targets=tuple(targets),
        build=build, twins=twins, label=label, label_of_all=label_of_all, parted_by=OBJECT if name in SIZE else "",
        bounds=(bound,),
    )  # fmt: skip
    return family.enter()


bed_tilt = constant(
    "bed_tilt", "The bed is not square to the towers", "z of the bed is tx x + ty y", "base", "rad",
    {"all": ("bed_x", "bed_y")}, of="height",
    twins="nearly: the endstops tilt the print with the bed", label_of_all="bed tilt",
)  # fmt: skip
dome = constant(
    "bed_dome", "The bed stands higher in its middle than at its rim, or lower",
    "z of the bed is d (1 - (x^2 + y^2) / bed_radius^2)", "base", "mm", {"all": ("dome",)}, of="height",
    twins="nearly, by heights alone: delta_radius, rod_length, belt_scale", label_of_all="domed bed",
)  # fmt: skip
caliper = constant(
    "caliper_offset", "The caliper reads, or the extruded line adds, the same length at every object",
    "distance + c", "prediction", "mm", {"all": ("caliper",)}, of="distance",
    twins="where all objects are of one length: shrinkage", label_of_all="caliper offset",
)  # fmt: skip
shrink = constant(
    "shrinkage", "The printed object shrank as it cooled", "distance (1 - s)", "prediction", "1",
    {"all": ("shrink",)}, of="distance", twins="for objects that lie flat: effector_tilt outward",
    same={"all": ("effector_tilt outward",)}, label_of_all="shrinkage of the print",
)  # fmt: skip


radius = constant(
    "delta_radius", "Towers stand further from the middle than stated, or the effector is smaller",
    "R = delta_radius + dR", "link", "mm", {"all": ("d_radius",)},
    twins="nearly, by heights alone: rod_length, belt_scale", label="delta radius", label_of_all="delta radius",
)  # fmt: skip
tower_radius = constant(
    "tower_radius", "One tower stands further out than the others", "R_i = delta_radius + dR_i", "link", "mm",
    each_tower("d_radius"), twins="nearly: tower_lean of the same tower", label="tower radius",
)  # fmt: skip
angle = constant(
    "tower_angle", "A tower stands at another angle about the middle than stated", "angle_i + da_i", "link", "rad",
    each_tower("d_angle"), twins="always, all three by the same angle: the printer turned as a whole",
    label="tower angle",
)  # fmt: skip
rod_length = constant(
    "rod_length", "The rods are all longer or shorter than stated", "L_i = arm_length + dL", "link", "mm",
    {"all": ("d_rod",)}, twins="nearly, by heights alone: delta_radius, belt_scale", label="rod length",
    label_of_all="rod length",
)  # fmt: skip
single_rods = constant(
    "single_rod", "The rods of one tower differ in length from the others", "L_i = arm_length + dL_i", "link", "mm",
    each_tower("d_rod"), label="single rod length",
)  # fmt: skip
lean = constant(
    "tower_lean", "A tower leans outward or to the side", "the carriage stands lean_i h_i off its line", "base", "rad",
    {f"tower {t}": (f"lean_{t}_out", f"lean_{t}_side") for t in TOWERS},
    twins="nearly: tower_radius and tower_angle of the same tower", label="tower lean",
)  # fmt: skip
scale = constant(
    "belt_scale", "The belts move another way per step than stated: pulley, pitch or tension",
    "travel_i (1 + s)", "reading", "1", {"all": ("scale",)} | each_tower("scale"),
    twins="nearly, by heights alone: delta_radius, rod_length", label="belt scale", label_of_all="belt scale",
)  # fmt: skip
tilt = constant(
    "effector_tilt", "The effector tilts as it goes outward, so its nozzle does not stand under its middle",
    "x, y of the nozzle times 1 + k, or sheared", "link", "1",
    {"outward": ("tilt_out",), "skewed": ("tilt_skew_x", "tilt_skew_y")}, of="distance",
    twins="outward, for objects that lie flat: shrinkage", same={"outward": ("shrinkage all",)},
    label="effector tilt",
)  # fmt: skip
