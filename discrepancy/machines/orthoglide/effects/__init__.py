"""The catalogue of the Orthoglide: what may be wrong with its axes, gauges, drives and legs, a file each."""

from __future__ import annotations

from calibench.discrepancy.machines.orthoglide.effects import axes as axes
from calibench.discrepancy.machines.orthoglide.effects import gauges as gauges
from calibench.discrepancy.machines.orthoglide.effects import joints as joints
from calibench.discrepancy.machines.orthoglide.effects import legs as legs
