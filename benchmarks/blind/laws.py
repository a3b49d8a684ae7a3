"""Laws of a verdict: the same run told in another way, with its truth told the same way.

Nothing of what was measured changes, so that a finding may change its name only as the machine's parts do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.blind.gpm2002.machine import NAMES, Array
from benchmarks.blind.gpm2002.simulate import Case

_LEGWISE = ("enc", "vel", "dir", "tau", "axial")


def relabelled(case: Case, order: Sequence[int]) -> Case:
    """Return the case with the legs in another order: leg k + 1 is what leg order[k] was, legs counted from 1."""
    if sorted(order) != [1, 2, 3]:
        raise ValueError(f"order={list(order)}: the numbers 1, 2, 3 in some order are needed")
    columns = dict(case.columns)
    for quantity in _LEGWISE:
        for new, old in enumerate(order, start=1):
            if f"{quantity}_{old}" in case.columns:
                columns[f"{quantity}_{new}"] = case.columns[f"{quantity}_{old}"]
            else:
                columns.pop(f"{quantity}_{new}", None)

    def moved(numbers: dict[str, float]) -> dict[str, float]:
        return {name: numbers[name[:-1] + str(order[int(name[-1]) - 1])] for name in NAMES}

    now = {old: new for new, old in enumerate(order, start=1)}

    def target(words: str) -> str:
        return f"{words[:-1]}{now[int(words[-1])]}" if words[-1] in "123" else words

    teeth = case.metadata["tooth_numbers"]
    metadata = {**case.metadata, "tooth_numbers": [teeth[old - 1] for old in order]}
    truth = {
        **case.truth,
        "parameters": moved(case.truth["parameters"]),
        "branch": [case.truth["branch"][old - 1] for old in order],
        "effects": [{**effect, "target": target(effect["target"])} for effect in case.truth["effects"]],
        "missing": [target(name) for name in case.truth["missing"]],
    }
    return _surveyed(Case(columns, metadata | {"nominal": moved(case.metadata["nominal"])}, truth))


def rotated(case: Case, angle: float, shift: tuple[float, float] = (0.0, 0.0)) -> Case:
    """Return the case in another frame: all turned by `angle` [rad] about the origin, then moved by `shift` [mm]."""
    columns = dict(case.columns)
    if "x" in columns:
        columns["x"], columns["y"] = (_turned(columns["x"], columns["y"], angle) + np.array(shift)[:, None])[:]
    if "load_x" in columns:
        columns["load_x"], columns["load_y"] = _turned(columns["load_x"], columns["load_y"], angle)
    if "heading" in columns:
        columns["heading"] = np.remainder(columns["heading"] + angle + np.pi, 2 * np.pi) - np.pi

    def moved(numbers: dict[str, float]) -> dict[str, float]:
        out = dict(numbers)
        for i in "123":
            base = _turned(numbers[f"xa{i}"], numbers[f"ya{i}"], angle) + np.array(shift)
            out[f"xa{i}"], out[f"ya{i}"] = (float(v) for v in base)
            out[f"z{i}"] = numbers[f"z{i}"] + angle
        return out

    metadata = {**case.metadata, "nominal": moved(case.metadata["nominal"])}
    truth = {**case.truth, "parameters": moved(case.truth["parameters"])}
    return _surveyed(Case(columns, metadata, truth))


def delayed(case: Case, seconds: float) -> Case:
    """Return the case by a clock that was set `seconds` later."""
    return replace(case, columns={**case.columns, "t_s": case.columns["t_s"] + seconds})


def repeats_permuted(case: Case, seed: int) -> Case:
    """Return the case with the readings of each visit in a random order; times and numbers of repeats stay in place."""
    rng = np.random.default_rng(seed)
    rows = np.arange(len(case.columns["t_s"]))
    for visit in np.unique(case.columns["visit_id"]):
        mine = np.flatnonzero(case.columns["visit_id"] == visit)
        rows[mine] = rng.permutation(mine)
    kept = {"t_s", "repeat"}
    return replace(case, columns={n: v if n in kept else v[rows] for n, v in case.columns.items()})


def rows_shuffled(case: Case, seed: int) -> Case:
    """Return the case with the rows of its file in a random order."""
    rows = np.random.default_rng(seed).permutation(len(case.columns["t_s"]))
    return replace(case, columns={name: values[rows] for name, values in case.columns.items()})


def _surveyed(case: Case) -> Case:
    """Return the case with A_1 and A_2 known where only angles were read: they are held there."""
    if case.truth["xy"]:
        return case
    held = {name: case.truth["parameters"][name] for name in NAMES[:4]}
    nominal: dict[str, Any] = {**case.metadata["nominal"], **held}
    return replace(case, metadata={**case.metadata, "nominal": nominal, "fixed_parameters": held})


def _turned(x: Array | float, y: Array | float, angle: float) -> Array:
    return np.array([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y])
