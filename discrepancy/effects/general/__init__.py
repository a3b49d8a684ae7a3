"""The general families: errors that any joint, member, instrument or further column of any machine may have."""

from calibench.discrepancy.effects.general import columns, harmonics, joints, lengths

RECIPES = (
    joints.scale, joints.backlash, joints.compliance, joints.lag, joints.zero,
    harmonics.eccentricity, harmonics.screw_error, harmonics.second_harmonic, harmonics.angle_error,
    harmonics.position_error, harmonics.cyclic,
    columns.drift, columns.slip, columns.frame_drift, columns.frame_shift,
    lengths.growth, lengths.stretch, lengths.clearance, lengths.free_number,
    lengths.scale, lengths.lag, columns.polynomial, columns.cycle, *harmonics.WAVES,
    columns.magnitude, columns.sign, columns.saturation,
)  # fmt: skip
FAMILIES = tuple(one.enter() for one in RECIPES)
