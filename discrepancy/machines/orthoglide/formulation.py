"""The Orthoglide as a measured machine (Pashkevich et al. 2008): legs that should move parallel to themselves.

One constraint a row: the deviation the machine must show, by its exact kinematics, minus the one that was read, mm.
Free are the joint offsets drho_x, drho_y, drho_z and the leg lengths' errors dL_x, dL_y, dL_z, or one of the two sets.
Readings that were compared with one and the same Zero share its noise, eqs. (13)-(14).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, final

import numpy as np

from calibench.core.notes import Code
from calibench.core.options import shown, suggest
from calibench.discrepancy.diagnostics.confounded import confounded
from calibench.discrepancy.machines.orthoglide import kinematics as orthoglide_model
from calibench.discrepancy.machines.orthoglide.kinematics import Index, accepted, is_accepted, rows_of, share_rows
from calibench.discrepancy.model.machine import Formulation, Numbers, Quantities
from calibench.discrepancy.model.measured import DataError, MeasuredData, Sensor, nominal_numbers, positive
from calibench.discrepancy.model.roles import Instrument, Roles
from calibench.discrepancy.registries import machines
from calibench.problems import constants
from calibench.problems.base import Array, Parameter
from calibench.problems.orthoglide.kinematics import AXES, NAMES, PAPER

FreeName = Literal["auto", "full", "rho", "L"]
_FREE = {"full": NAMES, "rho": NAMES[:3], "L": NAMES[3:]}
_WIDTH = 10.0  # mm


@final
@dataclass(frozen=True)
class Orthoglide:
    """The three-axis parallel manipulator of the chapter; `free` chooses what is calibrated.

    With auto it is what the data's metadata say under "free", or else the full set where the readings can see it.
    """

    name: str = field(default="orthoglide", init=False)
    free: FreeName = "auto"

    def formulate(self, data: MeasuredData) -> Formulation:
        """Return the parallelism of the legs; raise `DataError` for data that cannot be an Orthoglide's."""
        data = accepted(data)
        free = shown(data.metadata.get("free", "auto")) if self.free == "auto" else self.free
        if free not in ("auto", *_FREE):
            raise DataError(f"{data.name}: free={free}: {suggest(free, ('auto', *_FREE))}")
        nominal = nominal_numbers(data, NAMES)
        full = _parallelism(data, "full", nominal)
        seen = full.rank() == len(NAMES)
        if seen and (note := _known_together(full, free)):
            data = data.with_note(Code.UNDETERMINED, note)
        if free != "auto" or seen:
            return _parallelism(data, "full" if free == "auto" else free, nominal)
        note = "the readings cannot tell all six parameters apart: only the joint offsets drho were calibrated"
        return _parallelism(data.with_note(Code.UNDETERMINED, note), "rho", nominal)


@final
@dataclass(frozen=True, eq=False)
class Parallelism:
    """The deviations of the legs over one set of data, shape (n, 1), mm."""

    data: MeasuredData
    parameters: tuple[Parameter, ...]
    fixed: dict[str, float]
    unit: str = "mm"
    readings: tuple[str, ...] = ("deviation",)
    sensors: tuple[Sensor, ...] = (
        Sensor("deviation", "gauge", "mm", targets=tuple(f"leg {axis}" for axis in AXES), label="the reading"),
    )

    @property
    def roles(self) -> Roles:
        """Return what can be declared: the gauge, the clock, the thermometer.

        Joints and legs are not: each stands in a constraint at two moments, the posture and its Zero, and families of
        its own change both.
        """
        time, temperature = (name if name in self.data else "" for name in ("t_s", "temp_K"))
        gauge = Instrument("gauge", self.readings, frame=False)
        return Roles(time=time, temperature=temperature, instruments=(gauge,))

    @cached_property
    def sigma(self) -> dict[str, float]:
        """Return the stated noise of one gauge reading [mm], at a posture or at Zero: section 3.4's where none is."""
        stated = self.data.metadata.get("sigma", constants.column(PAPER, "text.section34")["sigma"])
        return {"deviation": positive(self.data, "sigma", stated)}

    def constraints(self, q: Quantities) -> Numbers:
        """Return modelled minus read deviations, shape (n, 1), mm."""
        return (orthoglide_model.deviations(rows_of(self.data), q) - q["deviation"])[:, None]

    def slopes(self, q: Quantities) -> dict[str, Array]:
        """Return the derivative of the constraints in each quantity, name -> (n, 1)."""
        slopes = orthoglide_model.slopes(rows_of(self.data), q)
        slopes["deviation"] = -np.ones(len(self.data))
        return {name: value[:, None] for name, value in slopes.items()}

    def decorrelate(self, rows: Array) -> Array:
        """Return C^-1/2 rows, where sigma^2 C is the covariance of the deviations, eq. (14) for any plan."""
        mixed = np.array(rows)
        for members, root in self._blocks:
            parts = rows[members].reshape(*members.shape, -1)
            mixed[members] = (root @ parts).reshape(rows[members].shape)
        return mixed

    def covariates(self, q: Quantities) -> dict[str, dict[str, Array]]:
        """Return target -> covariate -> (n,): a leg's rows by what was set there, NaN in the rows of other legs."""
        rows = rows_of(self.data)
        common = {"gauge position": rows.share, "payload": rows.payload}
        common |= {
            name: self.data[key] for name, key in (("time", "t_s"), ("temperature", "temp_K")) if key in self.data
        }
        moved = {f"move along {a}": np.where(rows.axis == i, rows.level, 0.0) for i, a in enumerate(AXES)}
        own = {f"leg {axis}": rows.leg == i for i, axis in enumerate(AXES)}
        return {
            leg: {name: np.where(its, value, np.nan) for name, value in (common | moved).items()}
            for leg, its in own.items()
        }

    def on(self, data: MeasuredData) -> Parallelism:
        """Return the same machine over other rows."""
        data = data if is_accepted(data) else accepted(data)
        same = replace(self, data=data)
        if share_rows(data, self.data):
            same.__dict__["_blocks"] = self._blocks  # what readings share does not depend on what they say
        return same

    def rank(self) -> int:
        """Return how many of the free parameters the readings see at the nominal machine."""
        s = np.linalg.svd(self.nominal_slopes, compute_uv=False)
        return int((s > 1e-9 * s[0]).sum()) if len(s) else 0

    @cached_property
    def nominal_slopes(self) -> Array:
        """Return the derivative of the constraints, free of shared noise, in the parameters at the nominal machine."""
        q = {**self.fixed, **{p.name: p.start for p in self.parameters}, "deviation": self.data["deviation"]}
        slopes = self.slopes({name: np.asarray(value) for name, value in q.items()})
        return self.decorrelate(np.concatenate([slopes[p.name] for p in self.parameters], axis=1))

    @cached_property
    def _blocks(self) -> list[tuple[Index, Array]]:
        """Return rows that share a Zero, shape (g, m) for g blocks of m, with C^-1/2 of each, shape (g, m, m)."""
        rows = rows_of(self.data)
        group = rows.zero_group()
        order = np.argsort(group, kind="stable")
        by_size: dict[int, list[Index]] = {}
        for members in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
            by_size.setdefault(len(members), []).append(members)
        blocks = []
        for members_of_size in by_size.values():
            members = np.array(members_of_size)
            after, before = rows.level[members], rows.against[members]
            axis, arrival = rows.axis[members], rows.arrival[members]
            same = [_same(axis, arrival, a, b) for a, b in ((after, after), (before, before), (after, before))]
            covariance = same[0] + same[1] - same[2] - same[2].swapaxes(1, 2)  # D D^T, eq. (13)
            w, v = np.linalg.eigh(covariance)
            root = np.where(w > 1e-9, 1 / np.sqrt(np.maximum(w, 1e-9)), 0.0)
            blocks.append((members, (v * root[:, None, :]) @ v.swapaxes(1, 2)))
        return blocks


def _same(axis: Index, arrival: Array, one: Array, two: Array) -> Array:
    """Return where level `one` of a row and level `two` of another, shapes (g, m), are one reading, shape (g, m, m)."""
    level = one[:, :, None] == two[:, None, :]
    moved = (axis[:, :, None] == axis[:, None, :]) & (arrival[:, :, None] == arrival[:, None, :])
    return np.asarray(level & (moved | (one[:, :, None] == 0.0)), dtype=float)


def _known_together(full: Parallelism, free: str) -> str:
    """Return a remark on offsets and lengths of which these readings determine only a combination.

    It is "" where there are none. Held-out rows count, because the remark is about the plan.
    """
    tied = confounded([p.name for p in full.parameters], full.nominal_slopes, full.sigma["deviation"])
    if not tied:
        return ""
    held = {"rho": "the lengths dL are held, and ", "L": "the offsets drho are held, and "}.get(free, "")
    what = "the offsets take up what they are wrong by: " if free == "rho" else "the lengths take up what is wrong: "
    return (
        f"joint offsets drho and leg lengths dL are not identifiable one beside the other on these readings; {held}"
        f"{what if held else ''}only their differences are known. Standard errors with all free [mm]: "
        + "; ".join(map(str, tied))
    )


def _parallelism(data: MeasuredData, free: str, nominal: dict[str, float]) -> Parallelism:
    values = dict.fromkeys(NAMES, 0.0) | nominal
    parameters = tuple(
        Parameter(name, "mm", values[name], values[name] - _WIDTH, values[name] + _WIDTH) for name in _FREE[free]
    )
    held = {name: values[name] for name in NAMES if name not in _FREE[free]}
    return Parallelism(data, parameters, held | dict.fromkeys(orthoglide_model.IMPERFECTIONS, 0.0))


machines.register("orthoglide")(Orthoglide)
