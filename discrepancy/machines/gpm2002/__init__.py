"""The GPM2002 (Cong et al. 2008): three legs that meet in one point, read by encoders and perhaps by a tracker."""

from calibench.discrepancy.machines.gpm2002 import description as description, effects as effects
from calibench.discrepancy.machines.gpm2002.formulation import Gpm2002

__all__ = ["Gpm2002"]
