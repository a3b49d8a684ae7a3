"""What may be wrong with a delta's towers, rods, belts and effector."""

from __future__ import annotations

from calibench.discrepancy.machines.delta.effects.constant import (
    OBJECT,
    SIZE,
    TOWERS,
    constant,
    each_tower,
)

radius = constant(
    "delta_radius", "Towers stand further from the middle than stated, or the effector is smaller",
    "R = delta_radius + dR", "link", "mm", {"all": {"d_radius": {"d_radius": 1.0}}},
    twins="nearly, by heights alone: rod_length, belt_scale", same_by_heights=SIZE, parted_by=OBJECT,
    label="delta radius", label_of_all="delta radius",
)  # fmt: skip
tower_radius = constant(
    "tower_radius", "One tower stands further out than the others", "R_i = delta_radius + dR_i", "link", "mm",
    each_tower("d_radius"), twins="nearly: tower_lean of the same tower",
    label="tower radius",
)  # fmt: skip
angle = constant(
    "tower_angle", "A tower stands at another angle about the middle than stated", "angle_i + da_i", "link", "rad",
    each_tower("d_angle"),
    twins="always, all three by the same angle: the printer turned as a whole", label="tower angle",
)  # fmt: skip
rod_length = constant(
    "rod_length", "The rods are all longer or shorter than stated", "L_i = arm_length + dL", "link", "mm",
    {"all": {"d_rod": {"d_rod": 1.0}}}, twins="nearly, by heights alone: delta_radius, belt_scale",
    same_by_heights=SIZE, parted_by=OBJECT, label="rod length", label_of_all="rod length",
)  # fmt: skip
single_rods = constant(
    "single_rod", "The rods of one tower differ in length from the others", "L_i = arm_length + dL_i", "link", "mm",
    each_tower("d_rod"), label="single rod length",
)  # fmt: skip
lean = constant(
    "tower_lean", "A tower leans outward or to the side", "the carriage stands lean_i h_i off its line", "base", "rad",
    {
        f"tower {t}": {f"lean_{t}_{way}": {f"lean_{t}_{way}": 1.0} for way in ("out", "side")}
        for t in TOWERS
    },
    twins="nearly: tower_radius and tower_angle of the same tower", label="tower lean",
)  # fmt: skip
scale = constant(
    "belt_scale", "The belts move another way per step than stated: pulley, pitch or tension",
    "travel_i (1 + s)", "reading", "1",
    {"all": {"scale": {"scale": 1.0}}} | each_tower("scale"),
    twins="nearly, by heights alone: delta_radius, rod_length", same_by_heights=SIZE, parted_by=OBJECT,
    label="belt scale", label_of_all="belt scale",
)  # fmt: skip
tilt = constant(
    "effector_tilt", "The effector tilts as it goes outward, so its nozzle does not stand under its middle",
    "x, y of the nozzle times 1 + k, or sheared", "link", "1",
    {
        "outward": {"tilt_out": {"tilt_out": 1.0}},
        "skewed": {"tilt_skew_x": {"tilt_skew_x": 1.0}, "tilt_skew_y": {"tilt_skew_y": 1.0}},
    },
    of="distance", twins="outward, for objects that lie flat: shrinkage", same={"outward": ("shrinkage all",)},
    label="effector tilt",
)  # fmt: skip
