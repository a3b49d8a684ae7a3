"""A linear delta printer as a measured machine: probe heights and caliper distances, each with the carriages' travel.

One constraint a row, mm: the modelled value minus the measured one. Rows are of two kinds: `height`, of the nozzle
above the bed where the probe triggers, and `distance`, between two places of a printed object. The three endstops are
free, because every user sets these first. Radius, rods, angles and belts are held at the configured values; an error of
these must be found as an effect.

Check a delta's measured data, once, and turn motor steps into the travel of the carriages.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import pi
from typing import Any, ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from calibench.core.options import shown
from calibench.discrepancy.checks.validate import entered
from calibench.discrepancy.machines.delta.kinematics import IMPERFECTIONS, TOWERS, distance, height, lower_point, nozzle
from calibench.discrepancy.model.machine import WORKSPACE, Formulation, Numbers, Quantities
from calibench.discrepancy.model.measured import (
    DataError,
    MeasuredData,
    Sensor,
    finite,
    nominal_numbers,
    positive,
    with_numbers,
)
from calibench.discrepancy.model.roles import Joint, Roles
from calibench.discrepancy.registries import machines
from calibench.problems.base import Array, Parameter

NOMINAL = (
    "radius", *(f"angle_{i}" for i in TOWERS), *(f"arm_{i}" for i in TOWERS), *(f"endstop_{i}" for i in TOWERS),
    "bed_radius",
)  # fmt: skip
_ANGLES = {"angle_a": 210 * pi / 180, "angle_b": 330 * pi / 180, "angle_c": 90 * pi / 180}  # where towers stand
_CHECKED = "delta_checked"
_KINDS = ("height", "distance")


def accepted(data: MeasuredData) -> MeasuredData:
    """Return the valid rows with travels in mm and one `height` and `distance` column each; raise `DataError`.

    Steps, `steps_a`, are turned with `steps_per_mm`; travels, `travel_a`, are taken as they are. The second end of a
    distance is `steps_a_2` or `travel_a_2`.
    """
    if data.machine.casefold() != "delta":
        raise DataError(f"{data.name}: is data of machine {data.machine}; machine=delta reads a delta printer's")
    data = entered(data)
    kind = _kinds(data)
    data = with_numbers(data.with_columns({"kind": kind}), _needed(data, kind))
    kind = np.asarray(data["kind"])
    columns: dict[str, Any] = {"kind": kind}
    for tower in TOWERS:
        columns[f"travel_{tower}"] = _travel(data, tower, "")
        columns[f"travel_{tower}_2"] = (
            _travel(data, tower, "_2", kind == "distance") if (kind == "distance").any() else np.zeros(len(data))
        )
    columns |= {name: _measured(data, name, kind == name) for name in _KINDS}
    columns |= {name: _direction(data, name, kind == "height") for t in TOWERS if (name := f"direction_{t}") in data}
    return _within_reach(replace(data.with_columns(columns), metadata={**data.metadata, _CHECKED: True}))


def is_accepted(data: MeasuredData) -> bool:
    """Tell whether the data went through `accepted`."""
    return bool(data.metadata.get(_CHECKED)) and all(f"travel_{tower}_2" in data for tower in TOWERS)


def nominal_machine(data: MeasuredData, start: str = "printer") -> dict[str, float]:
    """Return the numbers of `NOMINAL`, mm and rad. Stated numbers override the printer's.

    Towers stand at 210, 330, 90 degrees. `start` names the metadata with the printer's numbers: `printer`, as it was
    designed, or `saved`. A single `arm` or `endstop` stands for all three. Raises `DataError` for one that is missing.
    """
    single = tuple(name for name in ("arm", "endstop"))
    own = data.metadata.get(start) or data.metadata.get("printer") or {}
    given = {**own, **nominal_numbers(data, (*NOMINAL, *single))}
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


def _kinds(data: MeasuredData) -> Any:
    """Return the kind of each row, (n,); without a column `kind`, a row that has a distance is one."""
    if "kind" in data:
        kind = np.char.lower(np.char.strip(np.asarray(data["kind"]).astype(str)))
        for word in sorted(set(kind.tolist()) - set(_KINDS)):
            raise DataError(f"{data.name}: column kind holds {word!r}; height or distance is needed")
        return kind
    if not any(name in data for name in _KINDS):
        raise DataError(
            f"{data.name}: column height is missing; a row needs height or distance, "
            "and the ways of the carriages, travel_a, travel_b and travel_c"
        )
    known = np.isfinite(data["distance"]) if "distance" in data else np.zeros(len(data), dtype=bool)
    return np.where(known, "distance", "height")


def _needed(data: MeasuredData, kind: Any) -> dict[str, Any]:
    """Return the columns that must hold numbers -> in which rows, (n,): those of the other kind have none."""
    probed, printed = kind == "height", kind == "distance"
    ends = {"": probed | printed, "_2": printed}
    ways = {f"{what}_{t}{end}": rows for end, rows in ends.items() for t in TOWERS for what in ("travel", "steps")}
    ways |= {f"direction_{t}": probed for t in TOWERS} | {"height": probed, "distance": printed}
    for tower in TOWERS:
        for end in ends:  # a travel column takes precedence over steps
            ways.pop(f"steps_{tower}{end}" if f"travel_{tower}{end}" in data else "", None)
    return {name: rows for name, rows in ways.items() if name in data and rows.any()}


def _measured(data: MeasuredData, name: str, own: Any) -> Any:
    """Return what was measured of one kind, (n,) [mm], zero in rows of the other."""
    if not own.any():
        return np.zeros(len(data))
    column = np.where(own, np.asarray(data[name], dtype=float), 0.0)
    _all_finite(data, name, column)
    if name == "distance" and not (column[own] > 0).all():
        raise DataError(f"{data.name}: column distance, row {_first(own & ~(column > 0))}: a length is above 0 mm")
    return column


def _direction(data: MeasuredData, name: str, probed: Any) -> Any:
    """Return the direction in which a carriage came, (n,): -1 or 1; 0 in a row of a distance, which has two ends."""
    column = np.asarray(data[name], dtype=float)
    column = np.where(~probed & ~np.isfinite(column), 0.0, column)
    _all_finite(data, name, column)
    return column


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
        column = column / [positive(data, "steps_per_mm", value) for value in each][TOWERS.index(tower)]
    column = column if own is None else np.where(own, column, 0.0)
    _all_finite(data, name, column)
    return column


def _within_reach(data: MeasuredData) -> MeasuredData:
    """Return the data; raise `DataError` where the nominal rods cannot meet: steps or a unit are wrong."""
    for end, own in (("", np.ones(len(data), dtype=bool)), ("_2", data["kind"] == "distance")):
        met = _meet(data, end, own)
        if not met.all():
            row = int(np.flatnonzero(own)[_first(~met) - 1]) + 1
            hint = "check steps_per_mm, arm and radius (steps and ways count down from the endstops)"
            names = [f"travel_{t}{at}" for at in ("", "_2") for t in TOWERS if f"travel_{t}{at}" in data]
            if not any(f"steps_{t}" in data for t in TOWERS) and _meet(data, end, own, 0.001).all():
                hint = "they meet where the ways are in mm: units=" + ",".join(f"{name}:mm" for name in names)
            raise DataError(f"{data.name}: row {row}: rods of this length cannot meet there; {hint}")
    return data


def _meet(data: MeasuredData, end: str, own: Any, size: float = 1.0) -> Any:
    """Return whether the nominal rods meet at one end of rows `own`, with ways `size` times as long."""
    q = nominal_machine(data)
    x, y, h, rod = [], [], [], []
    for t in TOWERS:
        x.append(q["radius"] * np.cos(q[f"angle_{t}"]))
        y.append(q["radius"] * np.sin(q[f"angle_{t}"]))
        rise = np.sqrt(q[f"arm_{t}"] ** 2 - q["radius"] ** 2)
        h.append(finite(data, "endstop", q[f"endstop_{t}"]) + rise - size * data[f"travel_{t}{end}"][own])
        rod.append(np.asarray(q[f"arm_{t}"]))
    with np.errstate(invalid="ignore"):
        return np.isfinite(lower_point(x, y, h, rod)[2])


def _all_finite(data: MeasuredData, name: str, column: Any) -> None:
    if not np.isfinite(column).all():
        row = _first(~np.isfinite(column))
        raise DataError(f"{data.name}: column {name}, row {row}: no finite number; leave that row out")


def _first(wrong: Any) -> int:
    """Return the number of the first row that is wrong, from 1."""
    return int(np.flatnonzero(wrong)[0]) + 1


SIGMA_HEIGHT, SIGMA_DISTANCE = 0.02, 0.05  # mm: a switch probe, a caliper on plastic
_WIDTH = 20.0  # mm: a switch stands within it
_STEP = 1e-30
_PLACES = 12  # heights from which on a disagreement over the bed is looked for: fewer draw no surface


@final
@dataclass(frozen=True)
class Delta:
    """A linear delta printer, of which the endstops are calibrated.

    `start` tells which printer.cfg numbers the machine starts from: its design, or those of SAVE_CONFIG (`saved`).
    """

    name: str = field(default="delta", init=False)
    start: Literal["design", "saved"] = "design"

    def formulate(self, data: MeasuredData) -> Formulation:
        """Return the formulation of the rows; raise `DataError` for data that cannot be a delta's."""
        data = accepted(data)
        nominal = nominal_machine(data, "saved" if self.start == "saved" else "printer")
        names = tuple(f"endstop_{tower}" for tower in TOWERS)
        parameters = tuple(
            Parameter(name, "mm", nominal[name], nominal[name] - _WIDTH, nominal[name] + _WIDTH) for name in names
        )
        held = {name: nominal[name] for name in NOMINAL if name not in names} | dict.fromkeys(IMPERFECTIONS, 0.0)
        measured = Measured(data, parameters, held)
        return replace(measured, surface=int(measured.probed.sum()) >= _PLACES)


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
        stated = self.data.metadata
        return {
            "height": positive(self.data, "sigma_height", stated.get("sigma_height", SIGMA_HEIGHT)),
            "distance": positive(self.data, "sigma_distance", stated.get("sigma_distance", SIGMA_DISTANCE)),
        }

    @cached_property
    def probed(self) -> NDArray[np.bool_]:
        """Return which rows are heights, (n,)."""
        return np.asarray(self.data["kind"] == "height")

    def reads(self, name: str) -> NDArray[np.bool_]:
        """Return in which rows a column is read, (n,)."""
        return self.probed if name == "height" else ~self.probed

    def constraints(self, q: Quantities) -> Numbers:
        """Return modelled minus measured heights and distances, shape (n, 1), mm."""
        probed, data = self.probed, self.data
        first = tuple(data[f"travel_{tower}"] for tower in TOWERS)
        second = tuple(data[f"travel_{tower}_2"] for tower in TOWERS)
        shape = np.broadcast_shapes(*(np.shape(value) for value in q.values()))
        rows = np.zeros(shape, dtype=np.result_type(float, *q.values()))
        if probed.any():
            own = _of(q, probed)
            rows[..., probed] = height(own, [way[probed] for way in first]) - own["height"]
        if not probed.all():
            own = _of(q, ~probed)
            ends = ([way[~probed] for way in first], [way[~probed] for way in second])
            rows[..., ~probed] = distance(own, *ends) - own["distance"]
        return rows[..., None]

    def slopes(self, q: Quantities) -> dict[str, Array]:
        """Return the derivative of the constraints in each quantity, name -> (n, 1), by complex step.

        All quantities step in one call, each in a row of its own: of so few readings a call costs more than its sums.
        """
        stepped = {}
        for k, (name, value) in enumerate(q.items()):
            own = np.zeros((len(q), 1))
            own[k] = _STEP
            stepped[name] = np.asarray(value, dtype=float) + 1j * own
        slopes = np.imag(self.constraints(stepped)) / _STEP
        return dict(zip(q, slopes, strict=True))

    def decorrelate(self, rows: Array) -> Array:
        """Return `rows` as they are: each reading has noise of its own."""
        return rows

    def covariates(self, q: Quantities) -> dict[str, dict[str, Array]]:
        """Return where the bed was probed, NaN in rows of distances; nothing where few places were."""
        if not self.surface:
            return {}
        travel = tuple(self.data[f"travel_{tower}"] for tower in TOWERS)
        x, y, _ = (np.where(self.probed, np.real(at), np.nan) for at in nozzle(q, travel))
        return {"height": {"distance from the middle": np.hypot(x, y)}, WORKSPACE: {"x": x, "y": y}}

    def on(self, data: MeasuredData) -> Measured:
        """Return the same printer over other rows."""
        return replace(self, data=data if is_accepted(data) else accepted(data))


def _of(q: Quantities, rows: NDArray[np.bool_]) -> dict[str, Any]:
    """Return the quantities of some rows; those of the whole machine are the same for all."""
    return {name: value[..., rows] if np.shape(value)[-1:] == rows.shape else value for name, value in q.items()}


machines.register("delta")(Delta)
