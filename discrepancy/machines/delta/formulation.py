"""A linear delta printer as a measured machine: probe heights and caliper distances, each with the carriages' travel.

One constraint a row, mm: the modelled value minus the measured one. Rows are of two kinds: `height`, of the nozzle
above the bed where the probe triggers, and `distance`, between two places of a printed object. The three endstops are
free, because every user sets these first. Radius, rods, angles and belts are held at the configured values; an error of
these must be found as an effect.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from calibench.discrepancy.machines.delta.kinematics import IMPERFECTIONS, TOWERS, distance, height, nozzle
from calibench.discrepancy.machines.delta.validate import NOMINAL, accepted, is_accepted, nominal_machine
from calibench.discrepancy.model.machine import WORKSPACE, Formulation, Numbers, Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.model.measured.sensor import Sensor
from calibench.discrepancy.model.measured.stated import positive
from calibench.discrepancy.model.roles import Joint, Roles
from calibench.discrepancy.registries import machines
from calibench.problems.base import Array, Parameter

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
