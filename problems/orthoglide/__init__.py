"""The Orthoglide, a translational parallel machine with three legs (Pashkevich et al. 2008), and its calibration.

`kinematics` is the machine, `plans` what is read on it and was measured, `calibration` the error and the named problem.
"""

from calibench.problems.orthoglide.calibration import Orthoglide, orthoglide6

__all__ = ["Orthoglide", "orthoglide6"]
