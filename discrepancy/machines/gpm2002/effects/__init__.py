"""The catalogue of the GPM2002: a family of effects a file, or families of one physics."""

from __future__ import annotations

from discrepancy.machines.gpm2002.effects import backlash as backlash
from discrepancy.machines.gpm2002.effects import base_shift as base_shift
from discrepancy.machines.gpm2002.effects import drift as drift
from discrepancy.machines.gpm2002.effects import elastic as elastic
from discrepancy.machines.gpm2002.effects import gear as gear
from discrepancy.machines.gpm2002.effects import harmonics as harmonics
from discrepancy.machines.gpm2002.effects import lag as lag
from discrepancy.machines.gpm2002.effects import noise as noise
from discrepancy.machines.gpm2002.effects import slip as slip
from discrepancy.machines.gpm2002.effects import thermal as thermal
