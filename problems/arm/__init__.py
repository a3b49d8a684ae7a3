"""Serial arms as problems: a face of `calibration` with one's own readings, those of two real arms, and drawn ones."""

from typing import TYPE_CHECKING

from calibench.core.lazy import loader, public_names
from calibench.problems.arm.families import arm, arm_panda, arm_ur10

if TYPE_CHECKING:
    from calibench.problems.arm.calibration import ArmCalibration

__all__ = ["ArmCalibration", "arm", "arm_panda", "arm_ur10"]

__getattr__ = loader(__name__, {"ArmCalibration": "calibration"})  # as every start lists the names of all that there is
__dir__ = public_names(__all__)
