"""What the delta declares for files, commands and pages: columns, words, what may be stated, plans, files.

A correction is lines for printer.cfg with Klipper's signs: `position_endstop` is the nozzle's height with all carriages
at their switches, computed with the rods and radius of the same file; tower c keeps its angle [deg], as all three only
turn the print. A printer.cfg is read by numbers alone: lines with ``#*#`` are what SAVE_CONFIG wrote, and one that it
replaced stands above with a ``#`` before it, and tells what the printer was first set to. Steps count down from each
endstop; mm per step = rotation_distance / (full_steps_per_rotation * microsteps * gears).
"""

import re
from collections.abc import Mapping
from configparser import Error, RawConfigParser
from math import degrees, radians, sqrt
from typing import Any, Literal

import numpy as np

from calibench.core.notes import Code, Note
from calibench.core.tables.columns import Columns, Quantity
from calibench.core.words import shortened
from calibench.discrepancy.effects.general.harmonics import PERIODIC
from calibench.discrepancy.labels import effect_label
from calibench.discrepancy.machines.delta.formulation import IMPERFECTIONS, NOMINAL, TOWERS
from calibench.discrepancy.model.machine import Correction, Description, Stated
from calibench.discrepancy.model.measured import DataError, MeasuredData
from calibench.discrepancy.registries import describe
from calibench.discrepancy.report import Report
from calibench.problems.delta.calibration import ring_places

PlanName = Literal["heights", "object", "rings", "rich"]
_RINGS: dict[str, tuple[tuple[int, float], ...]] = {
    "heights": ((6, 1.0),),
    "object": ((6, 1.0),),
    "rings": ((6, 0.5), (12, 1.0)),
    "rich": ((6, 0.33), (12, 0.67), (18, 1.0)),
}
_SIDES: dict[str, tuple[float, ...]] = {"heights": (), "object": (0.45,), "rings": (0.45,), "rich": (0.3, 0.6)}
_DEGREES = {"a": 210.0, "b": 330.0, "c": 90.0}  # where towers stand, Klipper's defaults
_MARGIN = 0.98  # of the rods' length, that a bed may reach


def planned(
    plan: PlanName = "object", radius: float = 160.0, arm: float = 340.0, bed_radius: float = 140.0,
    endstop: float = 400.0, sigma_height: float = 0.02, sigma_distance: float = 0.05,
) -> MeasuredData:  # fmt: skip
    """Return the noiseless heights and distances of a nominal delta [mm].

    heights: 7 heights, as firmwares probe. object: these, and the twelve distances of a printed hexagon with spokes.
    rings: 19 heights and 12 distances. rich: 37 and 24. Raises `DataError` for a bed that the rods do not reach.
    """
    if not 0 < radius < arm or not 0 < bed_radius < _MARGIN * arm - radius:
        rods = f"rods of {arm:g} mm at a radius of {radius:g} mm"
        raise DataError(f"plan.bed_radius={bed_radius:g}: {rods} do not reach it")
    there = ring_places(_RINGS[plan], _SIDES[plan], bed_radius)
    apart = there.between == 1
    columns = {
        "kind": np.where(apart, "distance", "height"),
        "height": np.where(apart, np.nan, 0.0),
        "distance": np.where(apart, np.linalg.norm(there.second - there.first, axis=1), np.nan),
    }
    for end, places in (("", there.first), ("_2", there.second)):
        for tower in TOWERS:
            angle = np.deg2rad(_DEGREES[tower])
            x, y = places[:, 0] - radius * np.cos(angle), places[:, 1] - radius * np.sin(angle)
            columns[f"travel_{tower}{end}"] = endstop + np.sqrt(arm**2 - radius**2) - np.sqrt(arm**2 - x**2 - y**2)
    nominal = {"radius": radius, "arm": arm, "endstop": endstop, "bed_radius": bed_radius}
    noise = {"sigma_height": sigma_height, "sigma_distance": sigma_distance}
    return MeasuredData(columns, "delta", {"machine": "delta", "nominal": nominal, **noise}, plan)


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
        doubt = "Something is missing that has no name: these endstops are the best that these numbers alone can do."
        lines.append(f"# {doubt}")
    for f in report.findings:
        if len(f.set) > 1:
            others = ", ".join(effect_label(report.machine, r.family, r.target) for r in f.set if r.effect != f.effect)
            label = effect_label(report.machine, f.family, f.target)
            lines.append(f"# {label} is taken; as likely by these data: {others}")

    # the calibrated numbers; of a number that differs from reading to reading, that of the first
    fitted = report.model
    numbers = fitted.model.quantities(fitted.best)[1].items()
    q = {name: float(np.ravel(value)[0]) for name, value in numbers if np.ndim(value) < 2}
    stated = fitted.model.formulation.data.metadata.get("rotation_distance")
    distances = stated if isinstance(stated, list | tuple) and len(stated) == len(TOWERS) else (None,) * len(TOWERS)
    radius, turned = q["radius"] + q["d_radius"], q["d_angle_c"]
    lines += ["", "[printer]", f"delta_radius = {radius:.6f}"]
    for tower, distance in zip(TOWERS, distances, strict=True):
        rod = q[f"arm_{tower}"] + q["d_rod"] + q[f"d_rod_{tower}"]
        at_switch = q[f"endstop_{tower}"] + sqrt(q[f"arm_{tower}"] ** 2 - q["radius"] ** 2)
        entries = {
            "angle": degrees(q[f"angle_{tower}"] + q[f"d_angle_{tower}"] - turned),
            "arm_length": rod,
            "position_endstop": at_switch - sqrt(rod**2 - radius**2),
        }
        lines += ["", f"[stepper_{tower}]", *(f"{key} = {value:.6f}" for key, value in entries.items())]
        factor = 1 + q["scale"] + q[f"scale_{tower}"]
        if factor != 1 and distance is not None:
            lines.append(f"rotation_distance = {float(distance) * factor:.6f}")
        elif factor != 1:
            lines.append(f"# rotation_distance: {factor:.6f} times what it is now")

    other = [f for f in report.findings if f.family not in _WRITTEN]
    lines += [""] if other else []
    lines += [f"# printer.cfg has no number for: {effect_label(report.machine, f.family, f.target)}" for f in other]
    return Correction(".cfg", "\n".join(lines) + "\n")


_SAVED = re.compile(r"^#\*# ?")
_COMMENTED_OUT = re.compile(r"^\s*#\s*([a-z_]+)\s*[:=]\s*([-+0-9.eE]+)\s*(?:[#;].*)?$")
_SECTION = re.compile(r"^\s*\[\s*([^\]]+?)\s*\]")
_GEOMETRY = ("delta_radius", "angle", "arm_length", "position_endstop")
_FULL_STEPS = 200.0
_HUGE = 1e12  # steps, mm or degrees, of no printer

Config = Mapping[str, Mapping[str, str]]


def read_printer_cfg(text: str) -> Columns:
    """Return probe heights and distances of a printer.cfg, with its geometry as stated metadata."""
    saved_lines = [_SAVED.sub("", line) for line in text.splitlines() if _SAVED.match(line)]
    opens = next((k for k, line in enumerate(saved_lines) if _SECTION.match(line)), len(saved_lines))
    upper_lines = [line for line in text.splitlines() if not _SAVED.match(line)]
    upper, saved = _parsed(upper_lines), _parsed(saved_lines[opens:])  # the lines before are a comment by Klipper
    if upper.get("printer", {}).get("kinematics", "").strip().lower() != "delta":
        raise DataError("[printer] has no kinematics: delta; this machine reads a linear delta's printer.cfg")

    # the numbers of the geometry that stand behind a `#`, which SAVE_CONFIG replaced
    replaced: dict[str, dict[str, str]] = {}
    section = ""
    for line in upper_lines:
        if opened := _SECTION.match(line):
            section = opened[1]
        elif (entry := _COMMENTED_OUT.match(line)) and entry[1] in _GEOMETRY:
            replaced.setdefault(section, {})[entry[1]] = entry[2]

    # what was saved of keys that no section said before: tower b was as tower a, where a said it alone
    said = {key for layer in (upper, replaced) for values in layer.values() for key in values}
    silent = {section: {k: v for k, v in values.items() if k not in said} for section, values in saved.items()}
    now, first = _layered(upper, saved), _layered(silent, upper, replaced)

    # a row a height and a row a distance, with their steps
    block = now.get("delta_calibrate", {})
    heights = [key for key in block if re.fullmatch(r"(manual_)?height\d+", key)]
    distances = [key for key in block if re.fullmatch(r"distance\d+", key)]
    if not heights and not distances:
        raise DataError(
            "[delta_calibrate] holds no height and no distance: run DELTA_CALIBRATE, or DELTA_ANALYZE with a printed "
            "object, then SAVE_CONFIG"
        )
    kind = np.array(["height"] * len(heights) + ["distance"] * len(distances))
    begins = [_steps(block, f"{key}_pos") for key in heights] + [_steps(block, f"{key}_pos1") for key in distances]
    ends = [(np.nan,) * 3] * len(heights) + [_steps(block, f"{key}_pos2") for key in distances]
    values = np.array([_real(block[key], f"[delta_calibrate] {key}") for key in (*heights, *distances)])
    columns: dict[str, Any] = {"kind": kind}
    columns |= {name: np.where(kind == name, values, np.nan) for name in ("height", "distance")}
    for i, tower in enumerate(TOWERS):
        columns[f"steps_{tower}"] = np.array([row[i] for row in begins])
        columns[f"steps_{tower}_2"] = np.array([row[i] for row in ends])

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
    return Columns(columns, metadata, notes)


def _parsed(lines: list[str]) -> dict[str, dict[str, str]]:
    parser = RawConfigParser(strict=False, inline_comment_prefixes=(";", "#"), interpolation=None, default_section="")
    try:
        parser.read_string("\n".join(lines))
    except Error as error:
        reason = shortened(" ".join(str(error).split()))
        raise DataError(f"is no configuration that Klipper would read: {reason}") from None
    return {section: dict(parser.items(section)) for section in parser.sections()}


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
        found[f"angle_{tower}"] = radians(_number(config, section, "angle", _DEGREES[tower]))
        for name, key in (("arm", "arm_length"), ("endstop", "position_endstop")):
            found[f"{name}_{tower}"] = _number(config, section, key, found.get(f"{name}_a"))
    return found


def _steps_per_mm(config: Config, tower: str) -> float:
    section = f"stepper_{tower}"
    if "step_distance" in config.get(section, {}):  # the key of older files
        return 1 / _number(config, section, "step_distance", above_zero=True)
    steps = _number(config, section, "full_steps_per_rotation", _FULL_STEPS)
    steps *= _number(config, section, "microsteps", above_zero=True)
    for pair in config[section].get("gear_ratio", "").split(","):
        if pair.strip():
            over, _, under = pair.partition(":")
            try:
                steps *= float(over) / float(under)
            except (ValueError, ZeroDivisionError):
                raise DataError(f"[{section}] gear_ratio: {shortened(pair)!r}; such as 57:11 is needed") from None
    return steps / _number(config, section, "rotation_distance", above_zero=True)


def _steps(block: Mapping[str, str], key: str) -> tuple[float, ...]:
    if key not in block:
        raise DataError(f"[delta_calibrate] {key} is missing: the steps at which it was measured")
    parts = block[key].split(",")
    if len(parts) != len(TOWERS):
        raise DataError(f"[delta_calibrate] {key}: {shortened(block[key])!r}; the steps of three towers are needed")
    return tuple(_real(part, f"[delta_calibrate] {key}") for part in parts)


def _number(config: Config, section: str, key: str, default: float | None = None, above_zero: bool = False) -> float:
    text = config.get(section, {}).get(key)
    if text is None:
        if default is None:
            raise DataError(f"[{section}] {key} is missing")
        return default
    value = _real(text, f"[{section}] {key}")
    if above_zero and not value > 0:
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


_COLUMNS = (
    Quantity("kind", text=True),
    Quantity("height", "mm", "height at the probe's trigger"),
    Quantity("distance", "mm", "distance by caliper"),
    *(Quantity(f"travel_{t}{end}", "mm", f"travel of tower {t}") for end in ("", "_2") for t in TOWERS),
    *(Quantity(f"steps_{t}{end}", "1", f"steps of tower {t}") for end in ("", "_2") for t in TOWERS),
    *(Quantity(f"direction_{t}", "", f"direction of tower {t}", f"tower {t}") for t in TOWERS),
    Quantity("t_s", "s", "time"),
    Quantity("temp_K", "K", "temperature above reference"),
)
# belt_scale, and of each number that is held a family of its own; a belt has no turn
_REPLACED = ("gear", "free_number", "eccentricity", "screw_error", "second_harmonic", "angle_error", "position_error",
             "cyclic", *PERIODIC, "lag", "compliance")  # fmt: skip
_UNITS = {  # by how a name begins
    **dict.fromkeys(("angle", "d_angle", "lean", "bed_x", "bed_y"), "rad"),
    **dict.fromkeys(("scale", "tilt", "shrink"), "1"),
}
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


def _quantity(name: str) -> Quantity:
    """Return a number of the printer with its unit and words: `angle of tower b`, `lean of tower a outward`."""
    unit = next((unit for begins, unit in _UNITS.items() if name.startswith(begins)), "mm")
    if name in _WORDS:
        return Quantity(name, unit, _WORDS[name])
    head, _, way = name.rpartition("_") if name.endswith(tuple(_WAYS)) else (name, "", "")
    what, _, tower = head.rpartition("_")
    return Quantity(name, unit, f"{_OF_A_TOWER[what]} of tower {tower}{_WAYS.get(way, '')}")


describe(
    "delta",
    Description(
        columns=_COLUMNS,
        quantities=tuple(_quantity(name) for name in (*NOMINAL, *IMPERFECTIONS)),
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
        targets={"outward": "outward", "skewed": "skewed"},
        read_from=tuple(one.name for one in _COLUMNS if one.unit in ("mm", "1")),
    ),
)
