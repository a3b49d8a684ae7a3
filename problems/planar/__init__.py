"""The GPM2002, a redundant planar manipulator with two degrees of freedom (Cong et al. 2008), and its problems.

`gpm2002` is the machine, its gauge, its plans and the papers' settings; `closed_loop` and `tracking` are the two
errors, `calibration` the named problems.
"""

from calibench.problems.planar.calibration import full11, full12, link_length, sensor_zero
from calibench.problems.planar.closed_loop import Planar
from calibench.problems.planar.tracking import Tracking, tracking_zero

__all__ = ["Planar", "Tracking", "full11", "full12", "link_length", "sensor_zero", "tracking_zero"]
