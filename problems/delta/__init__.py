"""A linear delta printer, three carriages on towers with a rod each, and its calibration by probe and caliper.

`plans` says where it is measured, `instances` what is drawn, `probing` is the error, `calibration` the named problem.
"""

from calibench.problems.delta.calibration import DeltaProbing, delta9

__all__ = ["DeltaProbing", "delta9"]
