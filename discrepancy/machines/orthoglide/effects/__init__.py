"""The catalogue of the Orthoglide: what may be wrong with its axes, gauges, drives and legs, a file each."""

from __future__ import annotations

from discrepancy.machines.orthoglide.effects import axes as axes
from discrepancy.machines.orthoglide.effects import gauges as gauges
from discrepancy.machines.orthoglide.effects import joints as joints
from discrepancy.machines.orthoglide.effects import legs as legs
