"""The machines and the effects there are, by name; other packages enter theirs through entry points."""

from __future__ import annotations

from bedrock.registry import Registry
from discrepancy.model.effect import Family
from discrepancy.model.machine import Machine

machines: Registry[Machine] = Registry("machine", "calibench.machines")
effects: Registry[Family] = Registry("effect", "calibench.effects")
