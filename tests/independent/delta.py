"""A linear delta printer with physics of its own, for cases that the catalogue did not make.

Nothing here comes from the machine that searches: the nozzle is found by iterating on the three rods, the firmware's
steps by its own inverse. What is wrong has the form that nature gives it, which is nobody's formula: a cause that the
catalogue spreads evenly over three towers is off by 5 to 15 % on each, and what it takes for straight, round or
constant is a little bent.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

STEPS = 80.0  # per mm
ANGLES = np.deg2rad([210.0, 330.0, 90.0])
NAMED = (
    "delta_radius all", "rod_length all", "belt_scale all", "bed_dome all", "caliper_offset all", "shrinkage all",
    *(f"{family} tower {t}" for family in ("tower_angle", "tower_radius", "single_rod", "belt_scale") for t in "abc"),
)  # fmt: skip
FOREIGN = ("saddle", "wavy_belt", "sagging_rim")  # in nobody's catalogue


@dataclass(frozen=True)
class Firmware:
    """What the firmware believes [mm, rad]: a radius, angles, rods, endstops (height of the nozzle at the switches)."""

    radius: float = 160.0
    angles: np.ndarray = field(default_factory=lambda: ANGLES.copy())
    rods: np.ndarray = field(default_factory=lambda: np.full(3, 340.0))
    endstops: np.ndarray = field(default_factory=lambda: np.full(3, 400.0))
    mm_per_step: np.ndarray = field(default_factory=lambda: np.full(3, 1 / STEPS))

    def steps(self, points):
        """Return the steps down from the endstops that bring the nozzle to points (n, 3), by its geometry, (n, 3)."""
        towers = self.radius * np.stack([np.cos(self.angles), np.sin(self.angles)], axis=-1)
        away = ((points[:, None, :2] - towers) ** 2).sum(axis=2)
        carriage = points[:, 2:] + np.sqrt(self.rods**2 - away)
        return (self.endstops + np.sqrt(self.rods**2 - self.radius**2) - carriage) / self.mm_per_step


@dataclass(frozen=True)
class Printer:
    """What the printer truly is: towers (3, 2), rods, carriages at their switches [mm], mm a step, and what bends."""

    towers: np.ndarray
    rods: np.ndarray
    switches: np.ndarray
    mm_per_step: np.ndarray
    wave: np.ndarray = field(default_factory=lambda: np.zeros(3))  # mm, once every 20 mm of belt
    bed: tuple = ()  # (kind, size, exponent, centre)
    bed_radius: float = 140.0
    caliper: tuple = (0.0, 0.0)  # offset, and its growth with distance
    shrink: tuple = (0.0, 0.0)  # along x and y

    def nozzle(self, steps):
        """Return where the nozzle hangs, (n, 3), found by correcting a guess until all three rods have their length."""
        way = steps * self.mm_per_step
        height = self.switches - way + self.wave * np.sin(2 * np.pi * way / 20.0)
        p = np.tile([0.0, 0.0, 0.0], (len(steps), 1))
        p[:, 2] = height.min(axis=1) - 0.8 * self.rods.min()
        for _ in range(30):
            away = np.dstack([p[:, None, :2] - self.towers, p[:, 2:] - height])
            length = np.sqrt((away**2).sum(axis=2))
            short = self.rods - length
            p = p + np.linalg.solve(away / length[:, :, None], short[:, :, None])[:, :, 0]
            if np.abs(short).max() < 1e-12:
                break
        return p

    def bed_height(self, x, y):
        """Return the bed's height [mm]."""
        if not self.bed:
            return np.zeros_like(x)
        kind, size, exponent, (cx, cy) = self.bed
        if kind == "saddle":
            return size * ((x - cx) * (y - cy)) / self.bed_radius**2
        out = np.hypot(x - cx, y - cy) / self.bed_radius
        return size * (1 - out**exponent) if kind == "dome" else -size * np.maximum(out - 0.6, 0.0) ** 2 / 0.16

    def distance(self, one, other):
        """Return what a caliper shows between two places (n, 3) of a print."""
        gap = (other - one) * [1 - self.shrink[0], 1 - self.shrink[1], 1.0]
        length = np.sqrt((gap**2).sum(axis=1))
        return length + self.caliper[0] * (1 + self.caliper[1] * length)


@dataclass(frozen=True)
class Case:
    """One printer measured: its data, what is wrong (None: nothing; a foreign cause), and how large that shows."""

    columns: dict
    metadata: dict
    truth: str | None
    visible: float
    printer: Printer
    firmware: Firmware


def honest(firmware, rng):
    """Return a printer that is as the firmware believes, but for endstops, which every owner sets first."""
    towers = firmware.radius * np.stack([np.cos(firmware.angles), np.sin(firmware.angles)], axis=-1)
    switches = firmware.endstops + np.sqrt(firmware.rods**2 - firmware.radius**2) + rng.uniform(-2, 2, 3)
    return Printer(towers, firmware.rods.copy(), switches, firmware.mm_per_step.copy())


def spoilt(printer, cause, size, rng):
    """Return the printer with one thing wrong, of `size` [mm, rad or 1], its form off by 5 to 15 % from any formula."""

    def off(n):  # as much more or less, each in its own way
        return 1 + rng.choice([-1, 1], n) * rng.uniform(0.05, 0.15, n)

    assert cause in (*NAMED, *FOREIGN), cause
    family, _, target = cause.partition(" ")
    own = np.array([float(target == f"tower {t}") for t in "abc"]) if target.startswith("tower") else np.ones(3)
    out = printer.towers / np.linalg.norm(printer.towers, axis=1, keepdims=True)
    side = np.stack([-out[:, 1], out[:, 0]], axis=-1)
    spread = own * off(3) if own.sum() > 1 else own
    little = own * rng.choice([-1, 1], 3) * rng.uniform(0.05, 0.15, 3)  # what goes with it, across
    if family in ("delta_radius", "tower_radius"):
        return replace(printer, towers=printer.towers + size * (spread[:, None] * out + little[:, None] * side))
    if family == "tower_angle":
        reach = np.linalg.norm(printer.towers, axis=1)[:, None]
        return replace(printer, towers=printer.towers + size * reach * (own[:, None] * side + little[:, None] * out))
    if family in ("rod_length", "single_rod"):
        return replace(
            printer, rods=printer.rods + size * spread, towers=printer.towers + 0.3 * size * little[:, None] * side
        )
    if family == "belt_scale":
        return replace(printer, mm_per_step=printer.mm_per_step * (1 + size * spread), wave=size * 20 * little)
    centre = tuple(printer.bed_radius * rng.uniform(-0.1, 0.1, 2))
    if family in ("bed_dome", "saddle", "sagging_rim"):
        kind = {"bed_dome": "dome"}.get(family, family)
        return replace(printer, bed=(kind, size, 2 * off(1)[0], centre))
    if family == "caliper_offset":
        return replace(printer, caliper=(size, 0.1 * rng.choice([-1, 1]) / 100.0))
    if family == "shrinkage":
        return replace(printer, shrink=tuple(size * off(2)))
    return replace(printer, wave=printer.wave + size * off(3))  # wavy_belt


def places(rng, heights, distances, bed):
    """Return probed places (n, 2) and the ends of distances (m, 2) each: rings, and hexagons with spokes."""
    rings = {7: ((6, 0.97),), 19: ((6, 0.5), (12, 0.97)), 37: ((6, 0.33), (12, 0.65), (18, 0.97))}[heights]
    probed = [(0.0, 0.0)]
    for n, share in rings:
        turn = rng.uniform(0, 1)
        probed += [bed * share * np.array([np.cos(a), np.sin(a)]) for a in 2 * np.pi * (np.arange(n) + turn) / n]
    pairs = []
    for share in {0: (), 12: (0.55,), 24: (0.35, 0.75)}[distances]:
        corners = [bed * share * np.array([np.cos(a), np.sin(a)]) for a in 2 * np.pi * np.arange(6) / 6]
        pairs += [(np.zeros(2), c) for c in corners] + [(corners[k], corners[(k + 1) % 6]) for k in range(6)]
    return (
        np.array(probed),
        np.array([p for p, _ in pairs]).reshape(-1, 2),
        np.array([p for _, p in pairs]).reshape(-1, 2),
    )


def at_bed(points, z=0.0):
    """Return points (n, 2) as (n, 3), at a height."""
    return np.column_stack([points, np.full(len(points), z)])


def measured(printer, firmware, probed, ends, sigma, rng):
    """Return columns and metadata as an owner has them: heights and distances, with the firmware's own steps."""
    steps = firmware.steps(at_bed(probed))
    seen = printer.nozzle(steps)
    height = seen[:, 2] - printer.bed_height(seen[:, 0], seen[:, 1]) + sigma[0] * rng.standard_normal(len(probed))
    both = [firmware.steps(at_bed(one, 1.0)) for one in ends]
    gone = [printer.nozzle(s) if len(s) else np.zeros((0, 3)) for s in both]
    distance = printer.distance(*gone) + sigma[1] * rng.standard_normal(len(ends[0]))
    n, m = len(height), len(distance)
    columns = {
        "kind": np.array(["height"] * n + ["distance"] * m),
        "height": np.r_[height, np.full(m, np.nan)],
        "distance": np.r_[np.full(n, np.nan), distance],
    }
    for i, t in enumerate("abc"):
        columns[f"steps_{t}"] = np.r_[steps[:, i], both[0][:, i]]
        columns[f"steps_{t}_2"] = np.r_[np.full(n, np.nan), both[1][:, i]]
    nominal = {"radius": firmware.radius, "bed_radius": printer.bed_radius}
    for i, t in enumerate("abc"):
        nominal |= {
            f"arm_{t}": firmware.rods[i],
            f"endstop_{t}": firmware.endstops[i],
            f"angle_{t}": firmware.angles[i],
        }
    metadata = {
        "machine": "delta", "nominal": {k: float(v) for k, v in nominal.items()},
        "steps_per_mm": [float(1 / mm) for mm in firmware.mm_per_step],
        "rotation_distance": [float(3200 * mm) for mm in firmware.mm_per_step],
        "sigma_height": sigma[0], "sigma_distance": sigma[1],
    }  # fmt: skip
    return columns, metadata


def shown(printer, bare, firmware, probed, ends, sigma):
    """Return how large the difference of two printers shows: rms in sigma, once three endstops took up their part."""

    def rows(one):
        seen = one.nozzle(firmware.steps(at_bed(probed)))
        gone = [one.nozzle(firmware.steps(at_bed(p, 1.0))) if len(p) else np.zeros((0, 3)) for p in ends]
        height = seen[:, 2] - one.bed_height(seen[:, 0], seen[:, 1])
        return np.r_[height / sigma[0], one.distance(*gone) / sigma[1]]

    r = rows(printer) - rows(bare)
    taken = [(rows(replace(bare, switches=bare.switches + 1e-4 * e)) - rows(bare)) / 1e-4 for e in np.eye(3)]
    J = np.stack(taken, axis=-1)
    left = r - J @ np.linalg.lstsq(J, r, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))


def case(seed, base=20261122):
    """Return case `seed`: one in four with nothing wrong, one in eight with a cause that is in no catalogue."""
    rng = np.random.default_rng([base, seed])
    rod = rng.uniform(220, 400)
    radius = rod * rng.uniform(0.43, 0.5)
    firmware = Firmware(radius=radius, rods=np.full(3, rod), endstops=np.full(3, rng.uniform(250, 450)))
    heights, distances = (
        int(rng.choice([7, 19, 37], p=[0.2, 0.4, 0.4])),
        int(rng.choice([0, 12, 24], p=[0.2, 0.4, 0.4])),
    )
    sigma = (float(rng.uniform(0.01, 0.04)), float(rng.uniform(0.03, 0.08)))
    bed = radius * rng.uniform(0.8, 0.9)
    probed, *ends = places(rng, heights, distances, bed)
    bare = replace(honest(firmware, rng), bed_radius=bed)
    draw, printer, truth, visible = rng.uniform(), bare, None, 0.0
    if draw > 0.25:
        choices = (
            FOREIGN
            if draw > 0.875
            else [n for n in NAMED if distances or n.split()[0] not in ("caliper_offset", "shrinkage")]
        )
        truth = str(rng.choice(choices))
        wanted = float(np.exp(rng.uniform(np.log(0.5), np.log(20))))
        form = rng.bit_generator.state  # the form of a cause is drawn once: its size alone is set to be seen
        size = 1e-3
        for _ in range(6):
            rng.bit_generator.state = form
            printer = spoilt(bare, truth, size, rng)
            visible = shown(printer, bare, firmware, probed, ends, sigma)
            size *= wanted / max(visible, 1e-12)
        size *= rng.choice([-1, 1])
        rng.bit_generator.state = form
        printer = spoilt(bare, truth, size, rng)
        visible = shown(printer, bare, firmware, probed, ends, sigma)
    columns, metadata = measured(printer, firmware, probed, ends, sigma, rng)
    return Case(columns, metadata, truth, visible, printer, firmware)


def printer_cfg(columns, firmware, mm_per_step, bed_radius):
    """Return a printer.cfg as Klipper leaves it after DELTA_CALIBRATE and DELTA_ANALYZE: steps, heights, distances."""
    lines = ["[mcu]", "serial: /dev/serial/by-id/simulated", "", "[printer]", "kinematics: delta", "max_velocity: 300"]
    lines += [f"print_radius: {bed_radius:g}", f"#delta_radius: {firmware.radius:g}", ""]
    for i, t in enumerate("abc"):
        lines += [f"[stepper_{t}]", "microsteps: 16", f"rotation_distance: {3200 * mm_per_step[i]:.6f}"]
        if i == 0:
            lines += [f"#arm_length: {firmware.rods[0]:g}", f"#position_endstop: {firmware.endstops[0]:g}"]
        lines += [f"#angle: {np.rad2deg(firmware.angles[i]):g}", ""]
    lines += ["[delta_calibrate]", f"radius: {bed_radius:g}", "horizontal_move_z: 20", ""]
    lines += ["[gcode_macro PARK]", "gcode:", "  {% set z = printer.toolhead.position.z %}", "  G28", ""]
    saved = ["<---------------------- SAVE_CONFIG ---------------------->", "DO NOT EDIT THIS BLOCK OR BELOW.", ""]
    saved += ["[printer]", f"delta_radius = {firmware.radius:.6f}", ""]
    for i, t in enumerate("abc"):
        saved += [f"[stepper_{t}]", f"angle = {np.rad2deg(firmware.angles[i]):.6f}"]
        saved += [f"arm_length = {firmware.rods[i]:.6f}", f"position_endstop = {firmware.endstops[i]:.6f}", ""]
    saved.append("[delta_calibrate]")
    count = {"height": 0, "distance": 0}
    for k, kind in enumerate(columns["kind"]):
        name = f"{kind}{count[str(kind)]}"
        count[str(kind)] += 1
        saved.append(f"{name} = {columns[kind][k]:.4f}")
        for end, key in (("", "_pos"),) if kind == "height" else (("", "_pos1"), ("_2", "_pos2")):
            saved.append(f"{name}{key} = " + ",".join(f"{columns[f'steps_{t}{end}'][k]:.3f}" for t in "abc"))
    return "\n".join([*lines, *(f"#*# {line}".rstrip() for line in saved)]) + "\n"


def firmware_of(text):
    """Return the firmware that lines for printer.cfg make, read without any reader of the project's."""
    section, values = "", {}
    for line in text.splitlines():
        if line.startswith("["):
            section = line.strip("[]")
        elif "=" in line and not line.startswith("#"):
            key, _, value = line.partition("=")
            values[section, key.strip()] = float(value)
    each = lambda key, default=None: np.array([values.get((f"stepper_{t}", key), default) for t in "abc"])  # noqa: E731
    turn = each("rotation_distance", 3200 / STEPS)
    return Firmware(
        values["printer", "delta_radius"], np.deg2rad(each("angle")), each("arm_length"), each("position_endstop"),
        turn / 3200,
    )  # fmt: skip
