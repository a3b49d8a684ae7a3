"""The GPM2002, a redundant planar manipulator with two degrees of freedom (Cong et al. 2008), and its problems.

`gpm2002` is the machine, `gauge` what angle readings cannot see of it, `plans` where readings are taken, `settings` the
true and the nominal machine of each section; `closed_loop` and `tracking` are the two errors, `calibration` the named
problems.
"""

from calibench.problems.planar.calibration import full11, full12, link_length, sensor_zero
from calibench.problems.planar.closed_loop import Planar
from calibench.problems.planar.tracking import Tracking, tracking_zero

__all__ = ["Planar", "Tracking", "full11", "full12", "link_length", "sensor_zero", "tracking_zero"]
