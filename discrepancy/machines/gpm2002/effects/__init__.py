"""The catalogue of the GPM2002: a family of effects a file, or families of one physics."""

from __future__ import annotations

from calibench.discrepancy.machines.gpm2002.effects import backlash as backlash
from calibench.discrepancy.machines.gpm2002.effects import base_shift as base_shift
from calibench.discrepancy.machines.gpm2002.effects import drift as drift
from calibench.discrepancy.machines.gpm2002.effects import elastic as elastic
from calibench.discrepancy.machines.gpm2002.effects import gear as gear
from calibench.discrepancy.machines.gpm2002.effects import harmonics as harmonics
from calibench.discrepancy.machines.gpm2002.effects import lag as lag
from calibench.discrepancy.machines.gpm2002.effects import noise as noise
from calibench.discrepancy.machines.gpm2002.effects import slip as slip
from calibench.discrepancy.machines.gpm2002.effects import thermal as thermal
