"""The general families: errors that any joint, member, instrument or further column of any machine may have."""

from __future__ import annotations

from calibench.discrepancy.effects.general import columns, harmonics, lengths
from calibench.discrepancy.effects.general import columns as changes
from calibench.discrepancy.effects.general import columns as shapes
from calibench.discrepancy.effects.general import harmonics as waves
from calibench.discrepancy.effects.general import joints as joints
from calibench.discrepancy.effects.general import lengths as instruments

RECIPES = (
    joints.scale, joints.backlash, joints.compliance, joints.lag, joints.zero,
    harmonics.eccentricity, harmonics.screw_error, harmonics.second_harmonic, harmonics.angle_error,
    harmonics.position_error, harmonics.cyclic,
    changes.drift, changes.slip, changes.frame_drift, changes.frame_shift,
    lengths.growth, lengths.stretch, lengths.clearance, lengths.free_number,
    instruments.scale, instruments.lag, columns.polynomial, columns.cycle, *waves.WAVES,
    shapes.magnitude, shapes.sign, shapes.saturation,
)  # fmt: skip
FAMILIES = tuple(one.enter() for one in RECIPES)
