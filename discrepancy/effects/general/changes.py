"""Errors that change during the run: a joint's zero drifts or slips, an instrument's frame moves evenly or once.

A drift is linear, along a curve, or along a curve that settles (forms of one name). A frame of two or three coordinates
may turn as it moves, about the middle of what it measured: an example is a stand that sinks on one foot.
"""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.effects.general.joints import largest_error, told_in
from calibench.discrepancy.effects.general.recipe import (
    Built,
    declared,
    each_instrument,
    each_joint,
    instrument_of,
    joints_of,
    recipe,
    unit_of,
)
from calibench.discrepancy.model.change_point import ChangePoint, change_times
from calibench.discrepancy.model.family import EffectFamily, needs
from calibench.discrepancy.model.linear import LinearEffect, size
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.model.roles import Joint, roles_of
from calibench.problems.base import Array

_TERMS = ("even", "bend", "turn")
_AXES = {2: ("turn",), 3: ("turn x", "turn y", "turn z")}  # turns of a frame, by its number of coordinates


def run_terms(s: Array) -> Array:
    """Return the terms at the part s of the run, (n, 3): a line, a parabola and a cubic, none above 1."""
    return np.stack([s, 4 * s * (1 - s), 6 * np.sqrt(3) * s * (1 - s) * (1 - 2 * s)], axis=-1)


def _drift(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [joint] = joints_of(formulation, target)
    clock = _clock(formulation)
    t = formulation.data[clock]
    return tuple(
        _drift_of(family, target, joint, clock, float(t.min()), float(np.ptp(t)), _TERMS[:k]) for k in (1, 2, 3)
    )


def _drift_of(
    family: EffectFamily, target: str, joint: Joint, clock: str, origin: float, span: float, names: tuple[str, ...]
) -> LinearEffect:
    """Return the drift over the run that began at `origin` and took `span` [s]; other rows share that clock."""
    unit, one = told_in(joint)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {joint.reading: one * run_terms((data[clock] - origin) / span)[:, : len(names)]}

    def largest(c: Array) -> float:
        """Return the range of the drift over the run, with the sign of its end where it is even."""
        if len(c) == 1:
            return float(c[0])
        return float(np.ptp(run_terms(np.linspace(0, 1, 65))[:, : len(c)] @ c))

    return LinearEffect(
        family.name, target, family.formula, "reading", (clock,), names, (unit,) * len(names), unit, changes,
        measure=largest, largest=largest_error(joint) / one,
    )  # fmt: skip


def _slip(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [joint] = joints_of(formulation, target)
    unit, one = told_in(joint)
    most = largest_error(joint) / one
    return _steps(family, formulation, target, "reading", (joint.reading,), ("step",), unit, most, one)


def _frame_drift(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    clock = _clock(formulation)
    columns = instrument_of(formulation, target).columns
    unit = unit_of(formulation, *columns)
    t = formulation.data[clock]
    origin, span = float(t.min()), float(np.ptp(t))
    middle = np.array([float(np.mean(formulation.data[name])) for name in columns])
    reach = np.stack([formulation.data[name] for name in columns], axis=-1) - middle

    def form(turns: bool) -> LinearEffect:
        def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
            part = ((data[clock] - origin) / span)[:, None]
            apart = np.stack([np.asarray(q[name], dtype=float) for name in columns], axis=-1) - middle
            return {name: -part * moved for name, moved in zip(columns, _motion(apart, turns))}

        def farthest(c: Array) -> float:
            """Return how far the reading that moves most has moved at the end of the run."""
            moved = np.stack([one @ c for one in _motion(reach, turns)], axis=-1)
            return float(np.max(np.linalg.norm(moved, axis=-1)))

        names = (*(f"d{name}" for name in columns), *(_AXES[len(columns)] if turns else ()))
        units = (unit,) * len(columns) + ("rad",) * (len(names) - len(columns))
        return LinearEffect(
            family.name, target, family.formula, "prediction", (clock, *columns), names, units, unit, changes,
            measure=farthest if turns else size,
        )  # fmt: skip

    return (form(False), form(True)) if len(columns) in _AXES else (form(False),)


def _motion(apart: Array, turns: bool) -> list[Array]:
    """Return the displacement of points by a unit of each coefficient, for each coordinate.

    `apart` (n, m) is from the middle. Shapes (n, k): k is m shifts and, where the frame `turns`, one turn in the plane
    or three in space [rad].
    """
    n, m = apart.shape
    shifts = [np.tile(np.eye(m)[k], (n, 1)) for k in range(m)]
    if not turns:
        return shifts
    zero = np.zeros(n)
    if m == 2:
        turned = [-apart[:, 1:2], apart[:, 0:1]]
    else:
        x, y, z = apart.T  # columns of w x apart for w along x, y, z
        turned = [np.stack(row, axis=-1) for row in ((zero, z, -y), (-z, zero, x), (y, -x, zero))]
    return [np.concatenate(pair, axis=1) for pair in zip(shifts, turned)]


def _frame_shift(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    columns = instrument_of(formulation, target).columns
    names = tuple(f"d{name}" for name in columns)
    unit = unit_of(formulation, *columns)
    return _steps(family, formulation, target, "prediction", columns, names, unit, np.inf)


def _steps(
    family: EffectFamily, formulation: Formulation, target: str, channel: str, quantities: tuple[str, ...],
    names: tuple[str, ...], unit: str, most: float, one: float = 1.0,
) -> Built:  # fmt: skip
    """Return a step of the quantities, `one` for a coefficient of 1, at each time at which a step is tried."""
    clock = _clock(formulation)
    times = change_times(formulation.data[clock])
    return tuple(
        ChangePoint(
            family.name, target, family.formula, channel, quantities, names, unit, float(at), len(times), (clock,), (),
            most, clock, one,
        )
        for at in times
    )  # fmt: skip


def _clock(formulation: Formulation) -> str:
    clock = declared(roles_of(formulation).time, "the machine", "time")
    needs(formulation.data, clock)
    return clock


def _frames(formulation: Formulation) -> tuple[str, ...]:
    return tuple(name for name in each_instrument(formulation) if instrument_of(formulation, name).frame)


drift = recipe(
    "drift", "The zero of a joint drifts during the run",
    "reading_i += even s, + bend 4 s (1 - s), + turn 10.4 s (1 - s) (1 - 2 s); s from 0 to 1 over the run", "reading",
    ("the time",), "that of the joint", "each joint", each_joint, _drift,
)  # fmt: skip
slip = recipe(
    "slip", "The reading of a joint slips once during the run", "reading_i += step from a time on", "reading",
    ("the time",), "that of the joint", "each joint", each_joint, _slip,
)  # fmt: skip
frame_drift = recipe(
    "frame_drift", "The frame of an instrument moves evenly during the run, and may turn",
    "measured -= d s, or (d + w x (measured - middle)) s; s from 0 to 1 over the run", "prediction",
    ("the time",), "that of the measurement",
    "each instrument with a frame", _frames, _frame_drift, label="moving frame",
)  # fmt: skip
frame_shift = recipe(
    "frame_shift", "An instrument, or the machine, is displaced once during the run", "measured += d from a time on",
    "prediction", ("the time",), "that of the measurement", "each instrument with a frame", _frames, _frame_shift,
    label="displaced frame",
)  # fmt: skip
