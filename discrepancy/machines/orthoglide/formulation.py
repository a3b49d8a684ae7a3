"""The Orthoglide as a measured machine (Pashkevich et al. 2008): legs that should move parallel to themselves.

One constraint a row: the deviation the machine must show, by its exact kinematics, minus the one that was read, mm.
Free are the joint offsets drho_x, drho_y, drho_z and the leg lengths' errors dL_x, dL_y, dL_z, or one of the two sets.
Readings that were compared with one and the same Zero share its noise, eqs. (13)-(14).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Literal, final, get_args

import numpy as np

from calibench.core.notes import Code
from calibench.core.options import shown, suggest
from calibench.core.words import plain
from calibench.discrepancy.machines.orthoglide import kinematics
from calibench.discrepancy.machines.orthoglide.kinematics import Index, accepted, rows_of
from calibench.discrepancy.model.machine import (
    Description,
    Formulation,
    Numbers,
    Quantities,
    Quantity,
    Stated,
    complex_step_slopes,
)
from calibench.discrepancy.model.measured import DataError, MeasuredData, Sensor, nominal_numbers, positive
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import Instrument, Roles
from calibench.discrepancy.registries import describe, machines
from calibench.problems import constants
from calibench.problems.base import Array, Parameter
from calibench.problems.orthoglide.kinematics import AXES, NAMES, PAPER
from calibench.problems.orthoglide.plans import PlanName, SetName, named_plan

FreeName = Literal["auto", "full", "rho", "L"]
_FREE = {"full": NAMES, "rho": NAMES[:3], "L": NAMES[3:]}
_WIDTH = 10.0  # mm
_TIED = 20.0  # times the standard error of its difference, that of either of two numbers known by this alone


@machines.register("orthoglide")
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

        # the derivative of the constraints, free of shared noise, in the parameters at the nominal machine
        q = {**full.fixed, **{p.name: p.start for p in full.parameters}, "deviation": data["deviation"]}
        each = full.slopes({name: np.asarray(value) for name, value in q.items()})
        slopes = full.decorrelate(np.concatenate([each[p.name] for p in full.parameters], axis=1))
        s = np.linalg.svd(slopes, compute_uv=False)
        seen = len(s) > 0 and int((s > 1e-9 * s[0]).sum()) == len(NAMES)
        tied = []  # axes whose offset and length have wide standard errors and their difference a narrow one, in words
        if seen:  # held-out rows count, because the remark is about the plan
            C = np.linalg.inv(slopes.T @ slopes) * full.sigma["deviation"] ** 2
            offsets, lengths = np.sqrt(np.diag(C)).reshape(2, 3)
            apart = np.sqrt(np.maximum(offsets**2 + lengths**2 - 2 * np.diag(C[:3, 3:]), 0.0))
            tied = [
                f"drho_{a} ± {plain(one, 2)}, dL_{a} ± {plain(other, 2)}, drho_{a} - dL_{a} ± {plain(both, 2)}"
                for a, one, other, both in zip(AXES, offsets.tolist(), lengths.tolist(), apart.tolist())
                if _TIED * both < min(one, other)
            ]
        if tied:
            held = {
                "rho": "the lengths dL are held, and the offsets take up what they are wrong by: ",
                "L": "the offsets drho are held, and the lengths take up what is wrong: ",
            }.get(free, "")
            note = (
                "joint offsets drho and leg lengths dL are not identifiable one beside the other on these readings; "
                f"{held}only their differences are known. Standard errors with all free [mm]: "
            )
            data = data.with_note(Code.UNDETERMINED, note + "; ".join(tied))
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
        return (kinematics.deviations(rows_of(self.data), q) - q["deviation"])[:, None]

    slopes = complex_step_slopes

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
        met = {"gauge position": rows.share, "payload": rows.payload}
        met |= {name: self.data[key] for name, key in (("time", "t_s"), ("temperature", "temp_K")) if key in self.data}
        met |= {f"move along {a}": np.where(rows.axis == i, rows.level, 0.0) for i, a in enumerate(AXES)}
        return {
            f"leg {axis}": {name: np.where(rows.leg == i, value, np.nan) for name, value in met.items()}
            for i, axis in enumerate(AXES)
        }

    def on(self, data: MeasuredData) -> Parallelism:
        data = data if kinematics.ACCEPTED in data else accepted(data)
        same, kept = replace(self, data=data), self.data.columns
        if all(data.columns.get(name) is column for name, column in kept.items() if name != "deviation"):
            kinematics.ROWS[data] = rows_of(self.data)
            same.__dict__["_blocks"] = self._blocks  # what readings share does not depend on what they say
        return same

    @cached_property
    def _blocks(self) -> list[tuple[Index, Array]]:
        """Return rows that share a Zero, shape (g, m) for g blocks of m, with C^-1/2 of each, shape (g, m, m)."""
        rows = rows_of(self.data)
        parts = (rows.leg, rows.direction, rows.share, rows.zero_arrival, rows.payload, rows.repeat)
        key = np.column_stack([np.asarray(part, dtype=float) for part in parts])
        group = np.unique(key, axis=0, return_inverse=True)[1].reshape(-1)  # the Zero that a row was subtracted from
        order = np.argsort(group, kind="stable")
        by_size: dict[int, list[Index]] = {}
        for members in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
            by_size.setdefault(len(members), []).append(members)
        blocks = []
        for members_of_size in by_size.values():
            members = np.array(members_of_size)
            after, before = rows.level[members], rows.against[members]
            axis, arrival = rows.axis[members], rows.arrival[members]
            moved = (axis[:, :, None] == axis[:, None, :]) & (arrival[:, :, None] == arrival[:, None, :])
            same = []  # where level `one` of a row and level `two` of another are one reading, shapes (g, m, m)
            for one, two in ((after, after), (before, before), (after, before)):
                level = one[:, :, None] == two[:, None, :]
                same.append(np.asarray(level & (moved | (one[:, :, None] == 0.0)), dtype=float))
            covariance = same[0] + same[1] - same[2] - same[2].swapaxes(1, 2)  # D D^T, eq. (13)
            w, v = np.linalg.eigh(covariance)
            root = np.where(w > 1e-9, 1 / np.sqrt(np.maximum(w, 1e-9)), 0.0)
            blocks.append((members, (v * root[:, None, :]) @ v.swapaxes(1, 2)))
        return blocks


def _parallelism(data: MeasuredData, free: str, nominal: dict[str, float]) -> Parallelism:
    values = dict.fromkeys(NAMES, 0.0) | nominal
    parameters = tuple(
        Parameter(name, "mm", values[name], values[name] - _WIDTH, values[name] + _WIDTH) for name in _FREE[free]
    )
    held = {name: values[name] for name in NAMES if name not in _FREE[free]}
    return Parallelism(data, parameters, held | dict.fromkeys(kinematics.IMPERFECTIONS, 0.0))


def planned(plan: PlanName, sigma: float = 0.01, repeats: int = 1) -> MeasuredData:
    """Return the deviations that a nominal machine shows on a named plan, without noise; `sigma` [mm] is stated."""
    rows = [(r, repeat) for repeat in range(repeats) for r in named_plan(plan)]
    called = {"posture": "axis", "pass": "approach"}
    set_up = ("leg", "direction", "posture", "gauge_position", "level_mm", "pass", "payload_N")
    columns = {key: np.array([getattr(r, called.get(key, key)) for r, _ in rows]) for key in set_up}
    columns |= {"repeat": np.array([float(repeat) for _, repeat in rows]), "deviation": np.zeros(len(rows))}
    empty = MeasuredData(columns, "orthoglide", {"machine": "orthoglide", "sigma": sigma}, plan)
    model = Model(Orthoglide().formulate(empty))
    q = model.quantities(np.zeros(model.size))[1]
    read = np.asarray(model.formulation.constraints(q)[:, 0], dtype=np.float64)
    return empty.with_columns({"deviation": np.round(read, 9)})  # a parallel leg reads 0, not rounding


_COLUMNS = (
    Quantity("leg", text=True),
    Quantity("direction", text=True),
    Quantity("posture", text=True),
    Quantity("gauge_position"),
    Quantity("level_mm", "mm"),
    Quantity("against_mm", "mm"),
    Quantity("pass", text=True),
    Quantity("zero_pass", text=True),
    Quantity("payload_N", "N", "payload"),
    Quantity("deviation", "mm", "the reading"),
    Quantity("t_s", "s", "time"),
    Quantity("zero_t_s", "s"),
    Quantity("temp_K", "K", "temperature above reference"),
    Quantity("zero_temp_K", "K"),
)
_ANGLES = ("tilt_", "gauge_roll", "gauge_pitch")
_QUANTITIES = (
    *(Quantity(f"drho_{axis}", "mm", f"joint offset of leg {axis}") for axis in AXES),
    *(Quantity(f"dL_{axis}", "mm", f"length of leg {axis}, above nominal") for axis in AXES),
    *(Quantity(name, "rad" if name.startswith(_ANGLES) else "mm") for name in kinematics.IMPERFECTIONS),
    *(Quantity(f"move along {axis}", "mm") for axis in AXES),
    Quantity("payload", "N"),
    Quantity("time", "s"),
    Quantity("temperature", "K"),
)

describe(
    "orthoglide",
    Description(
        columns=_COLUMNS,
        quantities=_QUANTITIES,
        stated=(
            Stated("sigma", "positive"),
            Stated("free"),
            Stated("nominal", "names", 'nominal={"drho_x":0.1}'),
            Stated("gravity"),
            Stated("moving_weight_N"),
        ),
        plan=planned,
        printed={name: partial(kinematics.printed, name) for name in get_args(SetName)},
        part_of=lambda target: target[-1],
        targets={word: f"{word} in the three axes" for word in ("common", "cyclic", "mirrored")},
        # its roles allow the scale of the gauge, which leaves nearly what `scale all` does: with both, blind cases
        # that have one name would have a set; its rates are those of its own list
        general=False,
    ),
)
