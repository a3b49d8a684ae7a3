"""Read a Klipper printer.cfg: the machine it describes, and what DELTA_CALIBRATE measured and saved at its end.

Lines that begin with ``#*#`` are Klipper's own block, which SAVE_CONFIG writes; a line in the upper part that it
replaced stands there with a ``#`` before it, and tells what the printer was designed or first set to. Read by
`configparser` and by numbers alone: nothing in a file is ever run. Macros and sections of other hardware are skipped.

Steps count down from each endstop. mm per step = rotation_distance / (full_steps_per_rotation * microsteps * gears).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from configparser import Error, RawConfigParser
from math import radians
from typing import Any

import numpy as np

from calibench.core.words import shortened
from calibench.discrepancy.machines.delta.kinematics import TOWERS
from calibench.discrepancy.model.description import Foreign
from calibench.discrepancy.model.measured.data import DataError

_SAVED = re.compile(r"^#\*# ?")
_REPLACED = re.compile(r"^\s*#\s*([a-z_]+)\s*[:=]\s*([-+0-9.eE]+)\s*(?:[#;].*)?$")
_SECTION = re.compile(r"^\s*\[\s*([^\]]+?)\s*\]")
_GEOMETRY = ("delta_radius", "angle", "arm_length", "position_endstop")
_ANGLES = {"a": 210.0, "b": 330.0, "c": 90.0}  # Klipper's defaults [deg]
_FULL_STEPS = 200.0
_HUGE = 1e12  # steps, mm or degrees, of no printer

Config = Mapping[str, Mapping[str, str]]


def read_printer_cfg(text: str) -> Foreign:
    """Return probe heights and distances of a printer.cfg, with its geometry as stated metadata.

    Raises `DataError` for a file that describes no delta, or in which nothing was measured.
    """
    saved_lines = [_SAVED.sub("", line) for line in text.splitlines() if _SAVED.match(line)]
    opens = next((k for k, line in enumerate(saved_lines) if _SECTION.match(line)), len(saved_lines))
    saved_lines = saved_lines[opens:]  # the lines before are a comment by Klipper
    upper_lines = [line for line in text.splitlines() if not _SAVED.match(line)]
    upper, saved = _parsed("\n".join(upper_lines)), _parsed("\n".join(saved_lines))
    if upper.get("printer", {}).get("kinematics", "").strip().lower() != "delta":
        raise DataError("[printer] has no kinematics: delta; this machine reads a linear delta's printer.cfg")
    replaced = _replaced(upper_lines)
    now, first = _layered(upper, saved), _layered(_where_silent(saved, upper, replaced), upper, replaced)
    columns = _measurements(now.get("delta_calibrate", {}))
    bed = _number(now, "delta_calibrate", "radius", _number(now, "printer", "print_radius", 0.0))
    of_bed = {"bed_radius": bed} if bed > 0 else {}
    metadata: dict[str, Any] = {
        "machine": "delta",
        "steps_per_mm": [_steps_per_mm(now, tower) for tower in TOWERS],
        "printer": _geometry(first) | of_bed,
        "saved": _geometry(now) | of_bed,
    }
    if all("rotation_distance" in now.get(f"stepper_{tower}", {}) for tower in TOWERS):
        metadata["rotation_distance"] = [_number(now, f"stepper_{tower}", "rotation_distance") for tower in TOWERS]
    included = sorted(name for name in upper if name.startswith("include "))
    notes = (f"{', '.join(included)}: included files are not read",) if included else ()
    return Foreign(columns, metadata, notes)


def _parsed(text: str) -> dict[str, dict[str, str]]:
    parser = RawConfigParser(strict=False, inline_comment_prefixes=(";", "#"), interpolation=None, default_section="")
    try:
        parser.read_string(text)
    except Error as error:
        told = shortened(" ".join(str(error).split()))
        raise DataError(f"is no configuration that Klipper would read: {told}") from None
    return {section: dict(parser.items(section)) for section in parser.sections()}


def _replaced(lines: list[str]) -> dict[str, dict[str, str]]:
    """Return the numbers of the geometry that stand behind a `#`, by section."""
    found: dict[str, dict[str, str]] = {}
    section = ""
    for line in lines:
        if opened := _SECTION.match(line):
            section = opened[1]
        elif (told := _REPLACED.match(line)) and told[1] in _GEOMETRY:
            found.setdefault(section, {})[told[1]] = told[2]
    return found


def _where_silent(saved: Config, *first: Config) -> dict[str, dict[str, str]]:
    """Return what was saved of the keys that no section said before: tower b was as tower a, where a said it alone."""
    said = {key for layer in first for values in layer.values() for key in values}
    return {section: {k: v for k, v in values.items() if k not in said} for section, values in saved.items()}


def _layered(*layers: Config) -> dict[str, dict[str, str]]:
    """Return the sections of all layers, the later above the earlier."""
    whole: dict[str, dict[str, str]] = {}
    for layer in layers:
        for section, values in layer.items():
            whole[section] = {**whole.get(section, {}), **values}
    return whole


def _geometry(config: Config) -> dict[str, float]:
    """Return the numbers of the machine, mm and rad; towers b and c are as tower a where nothing else is said."""
    found = {"radius": _number(config, "printer", "delta_radius")}
    for tower in TOWERS:
        section = f"stepper_{tower}"
        found[f"angle_{tower}"] = radians(_number(config, section, "angle", _ANGLES[tower]))
        for name, key in (("arm", "arm_length"), ("endstop", "position_endstop")):
            of_a = found.get(f"{name}_a")
            found[f"{name}_{tower}"] = _number(config, section, key, of_a)
    return found


def _steps_per_mm(config: Config, tower: str) -> float:
    section = f"stepper_{tower}"
    if "step_distance" in config.get(section, {}):  # the key of older files
        return 1 / _above_zero(config, section, "step_distance")
    steps = _number(config, section, "full_steps_per_rotation", _FULL_STEPS) * _above_zero(
        config, section, "microsteps"
    )
    for pair in config[section].get("gear_ratio", "").split(","):
        if pair.strip():
            over, _, under = pair.partition(":")
            try:
                steps *= float(over) / float(under)
            except (ValueError, ZeroDivisionError):
                raise DataError(f"[{section}] gear_ratio: {shortened(pair)!r}; such as 57:11 is needed") from None
    return steps / _above_zero(config, section, "rotation_distance")


def _measurements(block: Mapping[str, str]) -> dict[str, Any]:
    """Return a row a height and a row a distance, with their steps."""
    heights = [key for key in block if re.fullmatch(r"(manual_)?height\d+", key)]
    distances = [key for key in block if re.fullmatch(r"distance\d+", key)]
    if not heights and not distances:
        raise DataError(
            "[delta_calibrate] holds no height and no distance: run DELTA_CALIBRATE, or DELTA_ANALYZE with a printed "
            "object, then SAVE_CONFIG"
        )
    keys = (*heights, *distances)
    kind = np.array(["height"] * len(heights) + ["distance"] * len(distances))
    first = [_steps(block, f"{key}_pos") for key in heights] + [_steps(block, f"{key}_pos1") for key in distances]
    second = [(np.nan,) * 3] * len(heights) + [_steps(block, f"{key}_pos2") for key in distances]
    values = np.array([_real(block[key], f"[delta_calibrate] {key}") for key in keys])
    columns: dict[str, Any] = {"kind": kind}
    columns |= {name: np.where(kind == name, values, np.nan) for name in ("height", "distance")}
    for i, tower in enumerate(TOWERS):
        columns[f"steps_{tower}"] = np.array([row[i] for row in first])
        columns[f"steps_{tower}_2"] = np.array([row[i] for row in second])
    return columns


def _steps(block: Mapping[str, str], key: str) -> tuple[float, ...]:
    if key not in block:
        raise DataError(f"[delta_calibrate] {key} is missing: the steps at which it was measured")
    parts = block[key].split(",")
    if len(parts) != len(TOWERS):
        raise DataError(f"[delta_calibrate] {key}: {shortened(block[key])!r}; the steps of three towers are needed")
    return tuple(_real(part, f"[delta_calibrate] {key}") for part in parts)


def _number(config: Config, section: str, key: str, default: float | None = None) -> float:
    text = config.get(section, {}).get(key)
    if text is None:
        if default is None:
            raise DataError(f"[{section}] {key} is missing")
        return default
    return _real(text, f"[{section}] {key}")


def _above_zero(config: Config, section: str, key: str) -> float:
    value = _number(config, section, key)
    if not value > 0:
        raise DataError(f"[{section}] {key}: {value:g}; a number above 0 is needed")
    return value


def _real(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < _HUGE:
        raise DataError(f"{where}: {shortened(text.strip())!r} is no number of a printer")
    return value
