"""A linear delta printer, three carriages on towers with a rod each, and its calibration by probe and caliper."""

from calibench.problems.delta.calibration import DeltaProbing, delta9

__all__ = ["DeltaProbing", "delta9"]
