"""What the delta declares for files, commands and pages: columns, words, what may be stated.

Plans of heights and distances, before anything is measured: what `bench design machine=delta plan=...` looks at.

The correction in the form that the user of a printer enters: lines for printer.cfg, with Klipper's signs and zeros.

Klipper's `position_endstop` is the height of the nozzle with all carriages at their switches, computed with the rods
and the radius of the same file; so other rods or another radius change every endstop. Its angles are in degrees. Tower
c keeps its angle, because all three together only turn the print. A comment tells what printer.cfg has no number for.

Read a Klipper printer.cfg: the machine it describes, and what DELTA_CALIBRATE measured and saved at its end.

Lines that begin with ``#*#`` are Klipper's own block, which SAVE_CONFIG writes; a line in the upper part that it
replaced stands there with a ``#`` before it, and tells what the printer was designed or first set to. Read by
`configparser` and by numbers alone: nothing in a file is ever run. Macros and sections of other hardware are skipped.

Steps count down from each endstop. mm per step = rotation_distance / (full_steps_per_rotation * microsteps * gears).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from configparser import Error, RawConfigParser
from math import degrees, radians, sqrt
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calibench.core.notes import Code, Note
from calibench.core.words import shortened
from calibench.discrepancy.effects.general.harmonics import PERIODIC
from calibench.discrepancy.labels import effect_label
from calibench.discrepancy.machines.delta.formulation import NOMINAL
from calibench.discrepancy.machines.delta.kinematics import IMPERFECTIONS, TOWERS
from calibench.discrepancy.model.machine import Correction, Description, Foreign, Quantity, Stated
from calibench.discrepancy.model.measured import DataError, MeasuredData
from calibench.discrepancy.registries import describe
from calibench.discrepancy.report import Report

PlanName = Literal["heights", "object", "rings", "rich"]
_RINGS: dict[str, tuple[tuple[int, float], ...]] = {
    "heights": ((6, 1.0),),
    "object": ((6, 1.0),),
    "rings": ((6, 0.5), (12, 1.0)),
    "rich": ((6, 0.33), (12, 0.67), (18, 1.0)),
}
_SIDES: dict[str, tuple[float, ...]] = {"heights": (), "object": (0.45,), "rings": (0.45,), "rich": (0.3, 0.6)}
_TOWER_ANGLES = {"a": 210.0, "b": 330.0, "c": 90.0}  # degrees
_MARGIN = 0.98  # of the rods' length, that a bed may reach


def planned(
    plan: PlanName = "object",
    radius: float = 160.0,
    arm: float = 340.0,
    bed_radius: float = 140.0,
    endstop: float = 400.0,
    sigma_height: float = 0.02,
    sigma_distance: float = 0.05,
) -> MeasuredData:
    """Return the noiseless heights and distances of a nominal delta [mm].

    heights: 7 heights, as firmwares probe. object: these, and the twelve distances of a printed hexagon with spokes.
    rings: 19 heights and 12 distances. rich: 37 and 24. Raises `DataError` for a bed that the rods do not reach.
    """
    if not 0 < radius < arm or not 0 < bed_radius < _MARGIN * arm - radius:
        raise DataError(
            f"plan.bed_radius={bed_radius:g}: rods of {arm:g} mm at a radius of {radius:g} mm do not reach it"
        )
    heights = [(0.0, 0.0), *(_at(share * bed_radius, k / n) for n, share in _RINGS[plan] for k in range(n))]
    pairs: list[tuple[tuple[float, float], tuple[float, float]]] = []
    for share in _SIDES[plan]:
        corners = [_at(share * bed_radius, k / 6) for k in range(6)]
        pairs += [((0.0, 0.0), corner) for corner in corners]
        pairs += [(corners[k], corners[(k + 1) % 6]) for k in range(6)]
    n, m = len(heights), len(pairs)
    first = np.array([*heights, *(one for one, _ in pairs)])
    second = np.array([*heights, *(other for _, other in pairs)])
    columns = {
        "kind": np.array(["height"] * n + ["distance"] * m),
        "height": np.array([0.0] * n + [np.nan] * m),
        "distance": np.array([np.nan] * n + [float(np.hypot(*np.subtract(b, a))) for a, b in pairs]),
    }
    for end, places in (("", first), ("_2", second)):
        for tower in TOWERS:
            angle = np.deg2rad(_TOWER_ANGLES[tower])
            x, y = places[:, 0] - radius * np.cos(angle), places[:, 1] - radius * np.sin(angle)
            columns[f"travel_{tower}{end}"] = endstop + np.sqrt(arm**2 - radius**2) - np.sqrt(arm**2 - x**2 - y**2)
    printer: Mapping[str, float] = {"radius": radius, "arm": arm, "endstop": endstop, "bed_radius": bed_radius}
    metadata = {
        "machine": "delta", "nominal": dict(printer), "sigma_height": sigma_height, "sigma_distance": sigma_distance,
    }  # fmt: skip
    return MeasuredData(columns, "delta", metadata, plan)


def _at(out: float, turn: float) -> tuple[float, float]:
    return out * float(np.cos(2 * np.pi * turn)), out * float(np.sin(2 * np.pi * turn))


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


_SAVED = re.compile(r"^#\*# ?")
_COMMENTED_OUT = re.compile(r"^\s*#\s*([a-z_]+)\s*[:=]\s*([-+0-9.eE]+)\s*(?:[#;].*)?$")
_SECTION = re.compile(r"^\s*\[\s*([^\]]+?)\s*\]")
_GEOMETRY = ("delta_radius", "angle", "arm_length", "position_endstop")
_KLIPPER_ANGLES = {"a": 210.0, "b": 330.0, "c": 90.0}  # Klipper's defaults [deg]
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
    notes = (Note(Code.FILE, f"{', '.join(included)}: included files are not read"),) if included else ()
    return Foreign(columns, metadata, notes)


def _parsed(text: str) -> dict[str, dict[str, str]]:
    parser = RawConfigParser(strict=False, inline_comment_prefixes=(";", "#"), interpolation=None, default_section="")
    try:
        parser.read_string(text)
    except Error as error:
        reason = shortened(" ".join(str(error).split()))
        raise DataError(f"is no configuration that Klipper would read: {reason}") from None
    return {section: dict(parser.items(section)) for section in parser.sections()}


def _replaced(lines: list[str]) -> dict[str, dict[str, str]]:
    """Return the numbers of the geometry that stand behind a `#`, by section."""
    found: dict[str, dict[str, str]] = {}
    section = ""
    for line in lines:
        if opened := _SECTION.match(line):
            section = opened[1]
        elif (entry := _COMMENTED_OUT.match(line)) and entry[1] in _GEOMETRY:
            found.setdefault(section, {})[entry[1]] = entry[2]
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
        found[f"angle_{tower}"] = radians(_number(config, section, "angle", _KLIPPER_ANGLES[tower]))
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


_ENDS = ("", "_2")
_COLUMNS = (
    Quantity("kind", text=True),
    Quantity("height", "mm", "height at the probe's trigger"),
    Quantity("distance", "mm", "distance by caliper"),
    *(Quantity(f"travel_{t}{end}", "mm", f"travel of tower {t}") for end in _ENDS for t in TOWERS),
    *(Quantity(f"steps_{t}{end}", "1", f"steps of tower {t}") for end in _ENDS for t in TOWERS),
    *(Quantity(f"direction_{t}", "", f"direction of tower {t}", f"tower {t}") for t in TOWERS),
    Quantity("t_s", "s", "time"),
    Quantity("temp_K", "K", "temperature above reference"),
)
_ANGLES = ("angle", "d_angle", "lean", "bed_x", "bed_y")
# belt_scale, and of each number that is held a family of its own; a belt has no turn
_REPLACED = (
    "gear",
    "free_number",
    "eccentricity",
    "screw_error",
    "second_harmonic",
    "angle_error",
    "position_error",
    "cyclic",
    *PERIODIC,
    "lag",
    "compliance",
)
_SHARES = ("scale", "tilt", "shrink")


_WORDS = {
    "radius": "delta radius", "arm": "rod length", "endstop": "endstop", "bed_radius": "radius of the bed",
    "angle": "angle", "d_radius": "delta radius", "d_rod": "rod length", "scale": "belt scale", "zero": "zero",
    "tilt_out": "effector tilt, outward", "tilt_skew_x": "effector tilt, skewed along x",
    "tilt_skew_y": "effector tilt, skewed along y", "bed_x": "tilt of the bed along x",
    "bed_y": "tilt of the bed along y", "dome": "height of the dome", "caliper": "caliper offset",
    "shrink": "shrinkage of the print",
}  # fmt: skip
_OF_A_TOWER = {**_WORDS, "d_radius": "radius", "d_angle": "angle", "lean": "lean"}
_WAYS = {"out": " outward", "side": " to the side"}


def _words(name: str) -> str:
    """Return a number of the printer in words: `angle of tower b`, `lean of tower a outward`."""
    if name in _WORDS:
        return _WORDS[name]
    head, _, way = name.rpartition("_") if name.endswith(tuple(_WAYS)) else (name, "", "")
    what, _, tower = head.rpartition("_")
    return f"{_OF_A_TOWER[what]} of tower {tower}{_WAYS.get(way, '')}"


def _unit(name: str) -> str:
    return "rad" if name.startswith(_ANGLES) else "1" if name.startswith(_SHARES) else "mm"


describe(
    "delta",
    Description(
        columns=_COLUMNS,
        quantities=tuple(Quantity(name, _unit(name), _words(name)) for name in (*NOMINAL, *IMPERFECTIONS)),
        stated=(
            Stated("sigma_height", "positive"),
            Stated("sigma_distance", "positive"),
            Stated("steps_per_mm"),
            Stated("nominal", "names", 'nominal={"radius":161.75,"arm":345}'),
        ),
        files={".cfg": read_printer_cfg},
        replaced=_REPLACED,
        corrected=corrected,
        plan=planned,
        demonstrations=Path(__file__).resolve().parents[2] / "demo" / "delta",
        targets={"outward": "outward", "skewed": "skewed"},
    ),
)
