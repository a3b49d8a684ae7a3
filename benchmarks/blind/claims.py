"""What one report claims beside one truth: was the cause in the set, first, alone; how far is the model afterwards.

Strict: the very family and target. Lenient: where the truth is an angle error of some order (eccentricity, second
harmonic, higher), the class "angle_error" on that joint, order unresolved, counts too.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

Report = Mapping[str, Any]
Truth = Mapping[str, Any]
Name = tuple[str, str]

ANGLE_ERRORS = frozenset({"eccentricity", "second_harmonic", "angle_error"})
LENGTHS = ("la1", "la2", "la3", "lb1", "lb2", "lb3")
# Families whose amplitude means the same to the simulator and to the report: the others stiffen, lag or saturate, so
# that the number an engineer quotes depends on where it is taken.
PLAIN = frozenset({"eccentricity", "second_harmonic", "gear", "slip", "lag", "tracker_lag", "base_shift"})


def name(family: str, target: str) -> Name:
    """Return a name in which only the number of the target counts: "joint 2" and "leg 2" are its family's business."""
    number = "".join(letter for letter in str(target) if letter.isdigit())
    return family, number


def true_names(truth: Truth) -> list[Name]:
    """Return what is truly there."""
    return [name(effect["family"], effect["target"]) for effect in truth["effects"]]


def named_set(finding: Mapping[str, Any]) -> list[Name]:
    """Return a finding's name and those of its rivals, the finding first."""
    first = name(finding["family"], finding["target"])
    rivals = [name(rival["family"], rival["target"]) for rival in finding.get("set") or []]
    return [first, *(rival for rival in rivals if rival != first)]


def matches(true: Name, claimed: Name, lenient: bool) -> bool:
    """Return whether a claimed name is the true one."""
    if claimed == true:
        return True
    return lenient and true[0] in ANGLE_ERRORS and claimed == ("angle_error", true[1])


def in_sets(true: Name, report: Report, lenient: bool) -> bool:
    """Return whether some finding has the true name in its set."""
    return any(matches(true, claimed, lenient) for f in report["findings"] for claimed in named_set(f))


def first_right(true: Name, report: Report, lenient: bool) -> bool:
    """Return whether the first finding's own name is the true one."""
    return bool(report["findings"]) and matches(true, named_set(report["findings"][0])[0], lenient)


def is_twin(true: Name, xy: bool) -> bool:
    """Return whether another cause leaves exactly the same trace, so that no first name can be asked for."""
    return true[0] in {"compliance", "proximal_bending"} or (true[0] in {"thermal_links", "thermal_base"} and not xy)


def length_error(report: Report, truth: Truth) -> float | None:
    """Return the rms error of the six links after naming [mm]; None where the report has no such parameters."""
    found = report.get("parameters") or {}
    if any(key not in found for key in LENGTHS):
        return None
    return float(np.sqrt(np.mean([(found[key]["after"] - truth["parameters"][key]) ** 2 for key in LENGTHS])))


def amplitude_covered(report: Report, truth: Truth) -> bool | None:
    """Return whether the first finding's 95 % interval holds the true amplitude; None where they cannot be compared."""
    if not first_right(true_names(truth)[0], report, lenient=False):
        return None
    effect, stated = truth["effects"][0], report["findings"][0].get("amplitude") or {}
    interval = stated.get("ci95")
    if interval is None or effect["family"] not in PLAIN or stated.get("unit") != effect["unit"]:
        return None
    low, high = sorted(interval)
    return bool(low <= effect["amplitude"] <= high or low <= -effect["amplitude"] <= high)


def gap_covered(report: Report) -> bool | None:
    """Return whether the interval of the held-out gap after naming holds the noise floor; None without one."""
    interval, floor = report["gap"].get("held_out_ci95"), report["gap"].get("noise_floor")
    if interval is None or floor is None:
        return None
    return bool(interval[0] <= floor <= interval[1])
