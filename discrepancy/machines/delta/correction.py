"""The correction in the form that the user of a printer enters: lines for printer.cfg, with Klipper's signs and zeros.

Klipper's `position_endstop` is the height of the nozzle with all carriages at their switches, computed with the rods
and the radius of the same file; so other rods or another radius change every endstop. Its angles are in degrees. Tower
c keeps its angle, because all three together only turn the print. A comment tells what printer.cfg has no number for.
"""

from __future__ import annotations

from math import degrees, sqrt
from typing import Any

import numpy as np

from calibench.discrepancy.labels import effect_label
from calibench.discrepancy.machines.delta.kinematics import TOWERS
from calibench.discrepancy.model.description import Correction
from calibench.discrepancy.report import Report

_HEAD = (
    "# Lines for printer.cfg. They replace those of the same name: at the end of the file with #*# before each, where",
    "# SAVE_CONFIG wrote them, else in the sections above. Then FIRMWARE_RESTART, home, and probe again.",
)
_WRITTEN = ("delta_radius", "tower_angle", "rod_length", "single_rod", "belt_scale")  # families with lines of their own


def corrected(report: Report) -> Correction | None:
    """Return the calibrated machine with the first name of each set, as lines for printer.cfg; None without a fit."""
    if report.fitted is None:
        return None
    lines = [*_HEAD]
    if report.verdict == "unknown":
        lines.append(
            "# Something is missing that has no name: these endstops are the best that these numbers alone can do."
        )
    q = geometry(report)
    lines += [f"# {_doubt(report, f.effect)}" for f in report.findings if len(f.set) > 1]
    lines += ["", "[printer]", f"delta_radius = {q['delta_radius']:.6f}"]
    for tower in TOWERS:
        lines += ["", f"[stepper_{tower}]"]
        lines += [f"{key} = {q[f'{key}_{tower}']:.6f}" for key in ("angle", "arm_length", "position_endstop")]
        factor = q[f"belt_{tower}"]
        if factor != 1 and f"rotation_distance_{tower}" in q:
            lines.append(f"rotation_distance = {q[f'rotation_distance_{tower}'] * factor:.6f}")
        elif factor != 1:
            lines.append(f"# rotation_distance: {factor:.6f} times what it is now")
    other = [f for f in report.findings if f.family not in _WRITTEN]
    lines += [""] if other else []
    lines += [f"# printer.cfg has no number for: {effect_label(report.machine, f.family, f.target)}" for f in other]
    return Correction(".cfg", "\n".join(lines) + "\n")


def geometry(report: Report) -> dict[str, float]:
    """Return the numbers of printer.cfg by key, mm and degrees; a tower's letter is at the end of its key.

    `belt_a` is the factor for rotation_distance.
    """
    fitted = report.model
    q = {name: _one(value) for name, value in fitted.model.quantities(fitted.best)[1].items() if np.ndim(value) < 2}
    radius = q["radius"] + q["d_radius"]
    found = {"delta_radius": radius}
    stated = fitted.model.formulation.data.metadata.get("rotation_distance")
    turned = q["d_angle_c"]
    for i, tower in enumerate(TOWERS):
        rod = q[f"arm_{tower}"] + q["d_rod"] + q[f"d_rod_{tower}"]
        at_switch = q[f"endstop_{tower}"] + sqrt(q[f"arm_{tower}"] ** 2 - q["radius"] ** 2)
        found[f"angle_{tower}"] = degrees(q[f"angle_{tower}"] + q[f"d_angle_{tower}"] - turned)
        found[f"arm_length_{tower}"] = rod
        found[f"position_endstop_{tower}"] = at_switch - sqrt(rod**2 - radius**2)
        found[f"belt_{tower}"] = 1 + q["scale"] + q[f"scale_{tower}"]
        if isinstance(stated, list | tuple) and len(stated) == len(TOWERS):
            found[f"rotation_distance_{tower}"] = float(stated[i])
    return found


def _one(value: Any) -> float:
    """Return a number that is the same in all rows; of a reading, that of the first."""
    first = np.ravel(value)[0]
    return float(first)


def _doubt(report: Report, effect: str) -> str:
    [found] = [f for f in report.findings if f.effect == effect]
    others = ", ".join(effect_label(report.machine, r.family, r.target) for r in found.set if r.effect != effect)
    return f"{effect_label(report.machine, found.family, found.target)} is taken; as likely by these data: {others}"
