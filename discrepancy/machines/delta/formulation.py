"""A linear delta printer as a measured machine: probe heights and caliper distances, each with the carriages' travel.

One constraint a row, mm: the modelled `height` of the nozzle above the bed, or `distance` of two places of a print,
minus the measured one. The three endstops are free, because every user sets these first; an error of what is held must
be found as an effect. Carriage i stands at the height that endstop and steps say, and the nozzle is the lower point at
a distance of its rod from each of the three; `radius` is the tower's less the effector's, as firmware has it.

Quantities, mm and rad; i is a, b or c. What the firmware knows: endstop_i, the height of the nozzle when all carriages
stand at their switches in a printer whose three towers are alike; radius, angle_i, arm_i. What it does not know, zero
where nothing is wrong: d_radius, d_radius_i, d_angle_i, d_rod, d_rod_i (added to what is nominal); scale, scale_i (a
belt moves 1 + scale times the stated way); lean_i_out, lean_i_side (tower i leans away from the axis, or to the side of
growing angles, about where its carriage stands with the nozzle on the middle of the bed); zero_i (what a carriage has
gone down beside its way: play, drift); tilt_out, tilt_skew_x, tilt_skew_y (the nozzle goes further by that share as
the effector goes outward); bed_x, bed_y, dome (the bed's slope, and how far its middle stands above its rim); caliper
(added to every distance), shrink (share by which printed distances are too short).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import pi
from typing import Any, ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from calibench.core.options import shown
from calibench.discrepancy.checks.validate import entered
from calibench.discrepancy.model import measured
from calibench.discrepancy.model.machine import TINY, WORKSPACE, Formulation, Numbers, Quantities, as_is
from calibench.discrepancy.model.measured import DataError, MeasuredData, Sensor
from calibench.discrepancy.model.roles import Joint, Roles
from calibench.discrepancy.registries import machines
from calibench.problems.base import Array, Parameter

TOWERS = ("a", "b", "c")
IMPERFECTIONS = (
    "d_radius", *(f"d_radius_{i}" for i in TOWERS), *(f"d_angle_{i}" for i in TOWERS),
    "d_rod", *(f"d_rod_{i}" for i in TOWERS), "scale", *(f"scale_{i}" for i in TOWERS),
    *(f"lean_{i}_{way}" for i in TOWERS for way in ("out", "side")), *(f"zero_{i}" for i in TOWERS),
    "tilt_out", "tilt_skew_x", "tilt_skew_y", "bed_x", "bed_y", "dome", "caliper", "shrink",
)  # fmt: skip
NOMINAL = (
    "radius", *(f"angle_{i}" for i in TOWERS), *(f"arm_{i}" for i in TOWERS), *(f"endstop_{i}" for i in TOWERS),
    "bed_radius",
)  # fmt: skip
_ANGLES = {"angle_a": 210 * pi / 180, "angle_b": 330 * pi / 180, "angle_c": 90 * pi / 180}  # where towers stand
_CHECKED = "delta_checked"
_KINDS = ("height", "distance")
_SIGMA = {"height": 0.02, "distance": 0.05}  # mm: a switch probe, a caliper on plastic
_FAR = 1e4  # mm: no carriage goes so far
_WIDTH = 20.0  # mm: a switch stands within it
_PLACES = 12  # heights from which on a disagreement over the bed is looked for: fewer draw no surface


@machines.register("delta")
@final
@dataclass(frozen=True)
class Delta:
    """A linear delta printer, of which the endstops are calibrated.

    `start` tells which printer.cfg numbers the machine starts from: its design, or those of SAVE_CONFIG (`saved`).
    """

    name: str = field(default="delta", init=False)
    start: Literal["design", "saved"] = "design"

    def formulate(self, data: MeasuredData) -> Formulation:
        data = accepted(data)
        nominal = nominal_machine(data, "saved" if self.start == "saved" else "printer")
        ends = {name: nominal.pop(name) for name in (f"endstop_{tower}" for tower in TOWERS)}
        parameters = tuple(Parameter(name, "mm", end, end - _WIDTH, end + _WIDTH) for name, end in ends.items())
        held = {name: nominal[name] for name in NOMINAL if name in nominal} | dict.fromkeys(IMPERFECTIONS, 0.0)
        return Measured(data, parameters, held, int((data["kind"] == "height").sum()) >= _PLACES)


@final
@dataclass(frozen=True, eq=False)
class Measured:
    """Heights and distances of one printer over one set of data, shape (n, 1), mm.

    `surface`: whether heights enough were probed to look for a disagreement over the bed. Part of the rows keeps it.
    """

    data: MeasuredData
    parameters: tuple[Parameter, ...]
    fixed: Mapping[str, float]
    surface: bool = True

    unit: ClassVar[str] = "mm"
    readings: ClassVar[tuple[str, ...]] = ("height", "distance")
    sensors: ClassVar[tuple[Sensor, ...]] = (
        Sensor("height", "probe", "mm", targets=("height",), label="the probe's height", over_place=True),
        Sensor("distance", "caliper", "mm", targets=("distance",), label="the caliper's distance"),
    )

    @property
    def roles(self) -> Roles:
        """Return the carriages as joints, for the general effects of a slide: play, and a zero that drifts or slips."""
        data = self.data
        carriages = tuple(
            Joint(f"tower {t}", f"zero_{t}", "sliding", direction=f"direction_{t}" if f"direction_{t}" in data else "")
            for t in TOWERS
        )
        return Roles(carriages, time="t_s" if "t_s" in data else "", temperature="temp_K" if "temp_K" in data else "")

    @cached_property
    def sigma(self) -> dict[str, float]:
        """Return the stated noise of a height and of a distance [mm]."""
        stated = {key: self.data.metadata.get(f"sigma_{key}", usual) for key, usual in _SIGMA.items()}
        return {key: measured.positive(self.data, f"sigma_{key}", value) for key, value in stated.items()}

    @cached_property
    def probed(self) -> NDArray[np.bool_]:
        return np.asarray(self.data["kind"] == "height")

    def reads(self, name: str) -> NDArray[np.bool_]:
        return self.probed if name == "height" else ~self.probed

    def constraints(self, q: Quantities) -> Numbers:
        probed, data = self.probed, self.data
        first, second = ([data[f"travel_{tower}{end}"] for tower in TOWERS] for end in ("", "_2"))
        shape = np.broadcast_shapes(*(np.shape(value) for value in q.values()))
        rows = np.zeros(shape, dtype=np.result_type(float, *q.values()))
        for at, name in ((probed, "height"), (~probed, "distance")):
            if not at.any():
                continue
            # the quantities of these rows; those of the whole machine are the same for all
            own = {key: value[..., at] if np.shape(value)[-1:] == at.shape else value for key, value in q.items()}
            x, y, z = nozzle(own, [way[at] for way in first])
            if name == "height":  # of the nozzle above the bed; the dome falls to zero at the radius `bed_radius`
                dome = own["dome"] * (1 - (x**2 + y**2) / own["bed_radius"] ** 2)
                modelled = z - np.asarray(own["bed_x"] * x + own["bed_y"] * y + dome)
            else:  # what a caliper shows between two places of a printed object
                other = nozzle(own, [way[at] for way in second])
                apart = np.sqrt(sum((b - a) ** 2 for a, b in zip((x, y, z), other, strict=True)))
                modelled = apart * (1 - own["shrink"]) + own["caliper"]
            rows[..., at] = modelled - own[name]
        return rows[..., None]

    def slopes(self, q: Quantities) -> dict[str, Array]:
        """Return the derivative of the constraints in each quantity, name -> (n, 1), by complex step.

        All quantities step in one call, each in a row of its own: of so few readings a call costs more than its sums.
        """
        stepped = {}
        for k, (name, value) in enumerate(q.items()):
            own = np.zeros((len(q), 1))
            own[k] = TINY
            stepped[name] = np.asarray(value, dtype=float) + 1j * own
        slopes = np.imag(self.constraints(stepped)) / TINY
        return dict(zip(q, slopes, strict=True))

    decorrelate = as_is

    def covariates(self, q: Quantities) -> dict[str, dict[str, Array]]:
        """Return where the bed was probed, NaN in rows of distances; nothing where few places were."""
        if not self.surface:
            return {}
        travel = tuple(self.data[f"travel_{tower}"] for tower in TOWERS)
        x, y, _ = (np.where(self.probed, np.real(at), np.nan) for at in nozzle(q, travel))
        return {"height": {"distance from the middle": np.hypot(x, y)}, WORKSPACE: {"x": x, "y": y}}

    def on(self, data: MeasuredData) -> Measured:
        checked = data.metadata.get(_CHECKED) and all(f"travel_{tower}_2" in data for tower in TOWERS)
        return replace(self, data=data if checked else accepted(data))


def nozzle(q: Quantities, travel: Sequence[Numbers]) -> tuple[Numbers, Numbers, Numbers]:
    """Return x, y, z of the nozzle, (n,) each, mm, for `travel` of each carriage down from its endstop, likewise."""
    carriages = []
    for tower, way in zip(TOWERS, travel, strict=True):
        middle = np.sqrt(q[f"arm_{tower}"] ** 2 - q["radius"] ** 2)
        h = q[f"endstop_{tower}"] + middle - q[f"zero_{tower}"] - way * (1 + q["scale"] + q[f"scale_{tower}"])
        angle = q[f"angle_{tower}"] + q[f"d_angle_{tower}"]
        out = q["radius"] + q["d_radius"] + q[f"d_radius_{tower}"] + q[f"lean_{tower}_out"] * (h - middle)
        side = q[f"lean_{tower}_side"] * (h - middle)
        cos, sin = np.cos(angle), np.sin(angle)
        rod = q[f"arm_{tower}"] + q["d_rod"] + q[f"d_rod_{tower}"]
        carriages.append((out * cos - side * sin, out * sin + side * cos, h, rod + 0 * h))
    x, y, z = lower_point(*zip(*carriages, strict=True))
    out, skew_x, skew_y = q["tilt_out"], q["tilt_skew_x"], q["tilt_skew_y"]
    return x + out * x + skew_x * x + skew_y * y, y + out * y + skew_y * x - skew_x * y, z


def lower_point(
    x: Sequence[Numbers], y: Sequence[Numbers], h: Sequence[Numbers], rod: Sequence[Numbers]
) -> tuple[Numbers, Numbers, Numbers]:
    """Return the lower point where three spheres meet, about (x, y, h)_i with radii rod_i; NaN where they do not.

    The differences of the spheres' equations are linear, so x and y follow from z; the first sphere then gives z.
    """
    rises, rows = [], []
    for k in (1, 2):
        dx, dy, dh = x[k] - x[0], y[k] - y[0], h[k] - h[0]
        rows.append((dx, dy))
        rises.append(((dx**2 + dy**2 + dh**2 + rod[0] ** 2 - rod[k] ** 2) / 2, dh))
    (ax, ay), (bx, by) = rows
    (ar, ah), (br, bh) = rises
    area = ax * by - ay * bx
    u0, u1 = (ar * by - ay * br) / area, (ah * by - ay * bh) / area  # from the first carriage: x = u0 - u1 z
    v0, v1 = (ax * br - ar * bx) / area, (ax * bh - ah * bx) / area
    a, b, c = 1 + u1**2 + v1**2, u0 * u1 + v0 * v1, u0**2 + v0**2 - rod[0] ** 2
    z = (b - np.sqrt(b**2 - a * c)) / a
    return x[0] + u0 - u1 * z, y[0] + v0 - v1 * z, h[0] + z


def accepted(data: MeasuredData) -> MeasuredData:
    """Return the valid rows with travels in mm and one `height` and `distance` column each; raise `DataError`."""
    if data.machine.casefold() != "delta":
        raise DataError(f"{data.name}: is data of machine {data.machine}; machine=delta reads a delta printer's")
    data = entered(data)

    # the kind of each row; without a column `kind`, a row that has a distance is one
    if "kind" in data:
        kind = np.char.lower(np.char.strip(np.asarray(data["kind"]).astype(str)))
        for word in sorted(set(kind.tolist()) - set(_KINDS)):
            raise DataError(f"{data.name}: column kind holds {word!r}; height or distance is needed")
    elif not any(name in data for name in _KINDS):
        needs = "a row needs height or distance, and the ways of the carriages, travel_a, travel_b and travel_c"
        if not any(name.startswith(("travel_", "steps_")) for name in data.columns):
            needs += "; a mesh of heights in rows and columns does not tell where they were read"
        raise DataError(f"{data.name}: column height is missing; {needs}")
    else:
        known = np.isfinite(data["distance"]) if "distance" in data else np.zeros(len(data), dtype=bool)
        kind = np.where(known, "distance", "height")

    # the columns that must hold numbers, and in which rows: those of the other kind have none
    probed, printed = kind == "height", kind == "distance"
    needed = {}
    for end, rows in {"": probed | printed, "_2": printed}.items():
        for tower in TOWERS:  # a travel column takes precedence over steps
            what = "travel" if f"travel_{tower}{end}" in data else "steps"
            needed[f"{what}_{tower}{end}"] = rows
    needed |= {f"direction_{t}": probed for t in TOWERS} | {"height": probed, "distance": printed}
    needed = {name: rows for name, rows in needed.items() if name in data and rows.any()}
    data = measured.with_numbers(data.with_columns({"kind": kind}), needed)

    kind = np.asarray(data["kind"])
    probed, printed = kind == "height", kind == "distance"
    columns: dict[str, Any] = {"kind": kind}
    for tower in TOWERS:
        columns[f"travel_{tower}"] = _travel(data, tower, "")
        columns[f"travel_{tower}_2"] = _travel(data, tower, "_2", printed) if printed.any() else np.zeros(len(data))
    for name, own in (("height", probed), ("distance", printed)):  # zero in rows of the other kind
        columns[name] = np.zeros(len(data))
        if own.any():
            columns[name] = _finite(data, name, np.where(own, np.asarray(data[name], dtype=float), 0.0))
    long = ~printed | (columns["distance"] > 0)
    measured.refuse_rows(data, long, lambda k: "column distance: a length is above 0 mm")
    for name in (f"direction_{t}" for t in TOWERS):
        if name in data:  # -1 or 1; 0 in a row of a distance, which has two ends
            column = np.asarray(data[name], dtype=float)
            columns[name] = _finite(data, name, np.where(~probed & ~np.isfinite(column), 0.0, column))
    data = replace(data.with_columns(columns), metadata={**data.metadata, _CHECKED: True})

    # refuse data at which the nominal rods cannot meet: steps or a unit are wrong
    for end, own in (("", np.ones(len(data), dtype=bool)), ("_2", printed)):
        met = _meet(data, end, own)
        if not met.all():
            row = data.rows_named(np.flatnonzero(own)[np.flatnonzero(~met)[:1]])
            hint = "check steps_per_mm, arm and radius (steps and ways count down from the endstops)"
            names = [f"travel_{t}{at}" for at in ("", "_2") for t in TOWERS if f"travel_{t}{at}" in data]
            far = all(np.median(np.abs(np.asarray(data[f"travel_{t}{end}"])[own])) > _FAR for t in TOWERS)
            if far and not any(f"steps_{t}" in data for t in TOWERS) and _meet(data, end, own, 0.001).all():
                hint = "they meet where the ways are in mm: units=" + ",".join(f"{name}:mm" for name in names)
            raise DataError(f"{data.name}: {row}: rods of this length cannot meet there; {hint}")
    return data


def nominal_machine(data: MeasuredData, start: str = "printer") -> dict[str, float]:
    """Return the numbers of `NOMINAL`, mm and rad. Stated numbers override the printer's."""
    single = ("arm", "endstop")
    own = data.metadata.get(start) or data.metadata.get("printer") or {}
    given = {**own, **measured.nominal_numbers(data, (*NOMINAL, *single))}
    for name in single:
        if name in given:
            given = {f"{name}_{tower}": given[name] for tower in TOWERS} | given
    given = _ANGLES | given
    for name in (*(f"arm_{t}" for t in TOWERS), "radius"):
        if not given.get(name, 0.0) > 0:
            raise DataError(
                f'{data.name}: {name} is not stated; nominal={{"radius":160,"arm":345,"endstop":415}} states radius, '
                "rod length and endstop position [mm]"
            )
    shortest = min(given[f"arm_{t}"] for t in TOWERS)
    if shortest <= given["radius"]:
        raise DataError(f"{data.name}: arm={shortest:g}: rods must be longer than the radius {given['radius']:g} mm")
    for tower in TOWERS:
        if f"endstop_{tower}" not in given:
            raise DataError(f"{data.name}: endstop_{tower} is not stated; state endstop, as position_endstop has it")
    apart = np.sort(np.mod([given[f"angle_{t}"] for t in TOWERS], 2 * pi))
    if min(np.diff(apart, append=apart[0] + 2 * pi)) < 0.2:
        raise DataError(f"{data.name}: two towers stand at nearly the same angle; angles are in rad here")
    return {"bed_radius": given["radius"]} | {name: given[name] for name in given if name in NOMINAL}


def _travel(data: MeasuredData, tower: str, end: str, own: Any = None) -> Any:
    """Return the way of a carriage down from its endstop, (n,) [mm]; zero in rows that have no such end."""
    way, steps = f"travel_{tower}{end}", f"steps_{tower}{end}"
    if way in data:
        name, column = way, np.asarray(data[way], dtype=float)
    else:
        name = steps if steps in data else way
        column = np.asarray(data[name], dtype=float)
        if "steps_per_mm" not in data.metadata:
            raise DataError(f"{data.name}: column {steps} holds steps; state steps_per_mm, such as steps_per_mm=80")
        # the stated steps per mm of the three belts; one number stands for all
        stated = data.metadata["steps_per_mm"]
        each = list(stated) if isinstance(stated, list | tuple | np.ndarray) else [stated] * 3
        if len(each) != 3:
            raise DataError(f"{data.name}: steps_per_mm={shown(stated)}: one number, or one for each tower, is needed")
        column = column / [measured.positive(data, "steps_per_mm", value) for value in each][TOWERS.index(tower)]
    return _finite(data, name, column if own is None else np.where(own, column, 0.0))


def _meet(data: MeasuredData, end: str, own: Any, size: float = 1.0) -> Any:
    """Return whether the nominal rods meet at one end of rows `own`, with ways `size` times as long."""
    q = nominal_machine(data)
    x, y, h, rod = [], [], [], []
    for t in TOWERS:
        x.append(q["radius"] * np.cos(q[f"angle_{t}"]))
        y.append(q["radius"] * np.sin(q[f"angle_{t}"]))
        rise = np.sqrt(q[f"arm_{t}"] ** 2 - q["radius"] ** 2)
        h.append(measured.finite(data, "endstop", q[f"endstop_{t}"]) + rise - size * data[f"travel_{t}{end}"][own])
        rod.append(np.asarray(q[f"arm_{t}"]))
    with np.errstate(invalid="ignore"):
        return np.isfinite(lower_point(x, y, h, rod)[2])


def _finite(data: MeasuredData, name: str, column: Array) -> Array:
    measured.refuse_rows(data, np.isfinite(column), lambda k: f"column {name}: no finite number; leave that row out")
    return column
