"""What may be wrong with what a delta is measured against: its bed, the printed object, and the caliper."""

from __future__ import annotations

from calibench.discrepancy.machines.delta.effects.constant import OBJECT, SIZE, constant

bed_tilt = constant(
    "bed_tilt", "The bed is not square to the towers", "z of the bed is tx x + ty y", "base", "rad",
    {"all": {"bed_x": {"bed_x": 1.0}, "bed_y": {"bed_y": 1.0}}}, of="height",
    twins="nearly: the endstops tilt the print with the bed", label_of_all="bed tilt",
)  # fmt: skip
dome = constant(
    "bed_dome", "The bed stands higher in its middle than at its rim, or lower",
    "z of the bed is d (1 - (x^2 + y^2) / bed_radius^2)", "base", "mm", {"all": {"dome": {"dome": 1.0}}}, of="height",
    twins="nearly, by heights alone: delta_radius, rod_length, belt_scale", same_by_heights=SIZE,
    parted_by=OBJECT, label_of_all="domed bed",
)  # fmt: skip
caliper = constant(
    "caliper_offset", "The caliper reads, or the extruded line adds, the same length at every object",
    "distance + c", "prediction", "mm", {"all": {"caliper": {"caliper": 1.0}}}, of="distance",
    twins="where all objects are of one length: shrinkage", label_of_all="caliper offset",
)  # fmt: skip
shrink = constant(
    "shrinkage", "The printed object shrank as it cooled", "distance (1 - s)", "prediction", "1",
    {"all": {"shrink": {"shrink": 1.0}}}, of="distance", twins="for objects that lie flat: effector_tilt outward",
    same={"all": ("effector_tilt outward",)}, label_of_all="shrinkage of the print",
)  # fmt: skip
