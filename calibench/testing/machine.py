"""The laws of a machine: its columns and sensors, its constraints and their slopes, what its readings determine."""

from __future__ import annotations

import numpy as np

from calibench.discrepancy.checks.machine import refuse_no_machine
from calibench.discrepancy.checks.wild import formulated, refuse_wild
from calibench.discrepancy.model.machine import WORKSPACE, Formulation, Machine, Quantities
from calibench.discrepancy.model.measured.data import DataError, MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.registries import description_of
from calibench.problems.base import Array
from calibench.testing._law import TIME_LIMIT, Checks, checks_of, keep_all, require

_STEPS = 10.0 ** np.arange(-9, -2)  # of central differences, in parts of a quantity's size
_UNSEEN = 1e-7  # of the largest singular value: a direction of the parameters that moves no constraint


def check_machine(machine: Machine, data: MeasuredData, *, time_limit: float = TIME_LIMIT) -> None:
    """Raise `AssertionError`, one line, for the first law that `machine` breaks on `data`, a set of its readings.

    It has `time_limit` seconds for all of them, and a gigabyte: what takes longer or more breaks the law that is tried.
    """
    keep_all(lambda: machine_checks(machine, data), time_limit)


def machine_checks(machine: Machine, data: MeasuredData) -> Checks:
    """Return (name, check) for every law of a machine."""
    return checks_of(MACHINE_LAWS, machine, data)


def data_are_formulated_and_left_alone(machine: Machine, data: MeasuredData) -> None:
    """``formulate(data)`` returns constraints and writes into no column; the machine has a name."""
    name = getattr(machine, "name", "")
    require(isinstance(name, str) and name, "a machine has a name", repr(name), "give it name: str")
    before = {key: column.copy() for key, column in data.columns.items()}
    try:
        refuse_no_machine(machine)
        formulated(machine, data)
    except DataError as error:
        require(False, "its data are formulated", error, "mend what the message names, or give data of this machine")
    same = all(np.array_equal(data[key], column, equal_nan=column.dtype.kind == "f") for key, column in before.items())
    require(same, "data are left alone", "a column was written into", "work on a copy")


def a_missing_column_is_no_crash(machine: Machine, data: MeasuredData) -> None:
    """Without a column the data are refused by a `DataError`, or formulated without it."""
    for column in machine.formulate(data).readings:
        rest = {key: values for key, values in data.columns.items() if key != column}
        try:
            left = machine.formulate(MeasuredData(rest, data.machine, data.metadata, data.name))
        except DataError:
            continue
        except Exception as error:
            require(
                False, f"without column {column} the data are refused by a DataError",
                f"{type(error).__name__}: {error}", "take columns by data[name], or ask `name in data` before",
            )  # fmt: skip
        there = column not in left.readings or column in left.data  # it may be computed from others
        require(there, "readings are columns of the data", f"no {column}", "leave it out")


def parameters_are_named_once_and_start_in_their_box(machine: Machine, data: MeasuredData) -> None:
    """Free parameters have names of their own, none is also held, and each starts between its bounds."""
    formulation = machine.formulate(data)
    names = [*(p.name for p in formulation.parameters), *formulation.fixed, *formulation.readings]
    twice = sorted({name for name in names if names.count(name) > 1})
    require(not twice, "a quantity is free, held or read", f"{twice} twice", "leave one out")
    require(formulation.parameters, "something is calibrated", "no free parameter", "give it parameters")
    for p in formulation.parameters:
        inside = np.isfinite(p.start) and p.lower <= p.start <= p.upper
        require(inside, "a parameter starts in its box", f"{p.name}={p.start} in {p.lower} .. {p.upper}", "move it")


def every_reading_has_its_noise_and_its_sensor(machine: Machine, data: MeasuredData) -> None:
    """Readings are finite columns, with a noise above 0 and a sensor each, in the same order; no part is read twice."""
    formulation = machine.formulate(data)
    for name in formulation.readings:
        column = np.asarray(formulation.data[name])
        numbers = column.dtype.kind in "iuf" and bool(np.isfinite(column).all())
        require(numbers, f"column {name} holds finite numbers", column.dtype, "leave other rows out")
        sigma = np.asarray(formulation.sigma.get(name, np.nan), dtype=float)
        require((sigma > 0).all(), f"the noise of {name} is stated", sigma, "state a standard deviation above 0")
    columns = tuple(sensor.column for sensor in formulation.sensors)
    require(
        columns == tuple(formulation.readings), "every reading has its sensor, in the same order",
        f"{columns} for {tuple(formulation.readings)}", "list sensors as readings are listed",
    )  # fmt: skip
    parts = [sensor.part for sensor in formulation.sensors if sensor.part]
    require(len(set(parts)) == len(parts), "a part has one sensor", parts, "name the parts apart")


def declared_units_agree(machine: Machine, data: MeasuredData) -> None:
    """A machine that has a `Description` declares every parameter and reading, in the unit that it uses."""
    described, formulation = description_of(machine.name), machine.formulate(data)
    if not described.columns:
        return
    units = {p.name: p.unit for p in formulation.parameters}
    units |= {sensor.column: sensor.unit for sensor in formulation.sensors}
    for name, unit in units.items():
        known = described.quantity(name)
        require(known is not None, "what is used is declared", f"no {name}", f"add Quantity({name!r}, {unit!r})")
        told = known.unit if known else ""
        require(
            told == unit, f"{name} has one unit", f"{told!r} declared, {unit!r} used", "declare the unit that is used"
        )


def constraints_have_a_row_a_reading(machine: Machine, data: MeasuredData) -> None:
    """Constraints have shape (n, c) and are finite at the start."""
    formulation, q = _at_start(machine, data)
    rows = np.asarray(formulation.constraints(q))
    right = rows.ndim == 2 and len(rows) == len(formulation.data) and rows.shape[1] > 0
    require(right, "constraints have shape (n, c)", rows.shape, "np.stack([...], axis=-1) makes them")
    require(np.isfinite(rows).all(), "constraints are finite at the start", "nan or inf", "mend start or closure")


def readings_are_near_the_model(machine: Machine, data: MeasuredData) -> None:
    """No column is in another unit, or from another zero, than the constraints take it to be."""
    try:
        refuse_wild(machine.formulate(data))
    except DataError as error:
        require(False, "readings are near the model", error, "bring the column, or the formula, to that unit")


def slopes_agree_with_differences(machine: Machine, data: MeasuredData) -> None:
    """There is a slope for every quantity, and it is the derivative of the constraints."""
    formulation, q = _at_start(machine, data)
    slopes = formulation.slopes(q)
    require(set(slopes) == set(q), "every quantity has its slope", sorted(set(slopes) ^ set(q)), "add what is missing")
    rounding = 1e-12 * max(float(np.abs(slope).max()) for slope in slopes.values())

    def difference(name: str, h: float) -> Array:
        up, down = (np.asarray(formulation.constraints({**q, name: q[name] + side})) for side in (h, -h))
        return np.asarray((up - down) / (2 * h))

    for name, slope in slopes.items():
        steps = max(1.0, float(np.max(np.abs(q[name])))) * _STEPS
        gap = min(float(np.abs(difference(name, h) - slope).max()) for h in steps)
        size = float(np.abs(slope).max())
        require(
            gap <= 1e-6 * size + rounding, "slopes agree with differences",
            f"a gap of {gap:.2g} beside {size:.2g} in {name}",
            "derive that slope again; for complex steps write no abs, norm, hypot, arctan2 or comparison",
        )  # fmt: skip


def other_rows_have_the_same_constraints(machine: Machine, data: MeasuredData) -> None:
    """``on(rows)`` has for each row what the whole has for it, to the last bit, and no other rows."""
    formulation, q = _at_start(machine, data)
    few = formulation.on(formulation.data.rows(np.arange(len(formulation.data)) < min(10, len(formulation.data))))
    n = len(few.data)
    part = {name: value[:n] if np.ndim(value) else value for name, value in q.items()}
    same = np.array_equal(few.constraints(part), np.asarray(formulation.constraints(q))[:n])
    require(same, "other rows have the same constraints", "other numbers", "keep nothing of the whole in a row")


def decorrelate_is_linear(machine: Machine, data: MeasuredData) -> None:
    """``decorrelate`` keeps the shape of rows and is linear: residuals, Jacobian and traces all pass through it."""
    formulation, q = _at_start(machine, data)
    shape, rng = np.asarray(formulation.constraints(q)).shape, np.random.default_rng(0)
    one, other = rng.normal(size=shape), rng.normal(size=shape)
    whole, parts = (
        np.asarray(formulation.decorrelate(2 * one - other)),
        2 * np.asarray(formulation.decorrelate(one)) - np.asarray(formulation.decorrelate(other)),
    )
    require(
        whole.shape == parts.shape and np.allclose(whole, parts, rtol=0, atol=1e-10 * np.abs(parts).max()),
        "decorrelate is linear", "another sum", "return rows as they are, or a matrix times rows",
    )  # fmt: skip


def readings_determine_every_parameter(machine: Machine, data: MeasuredData) -> None:
    """No direction of the free parameters moves no constraint: the calibration would wander along it."""
    formulation = machine.formulate(data)
    model = Model(formulation)
    jacobian: Array = model.jacobian(model.start).reshape(-1, model.size)
    size = np.linalg.norm(jacobian, axis=0)
    names = [name for name, length in zip(model.names, size) if not length > 0]
    require(not names, "readings determine every parameter", f"{names} move nothing", "hold them: held={...}")
    values, directions = np.linalg.svd(jacobian / size, full_matrices=False)[1:]
    unseen = [model.names[i] for i in np.flatnonzero(np.abs(directions[-1]) > 0.1)]
    require(
        values[-1] > _UNSEEN * values[0], "readings determine every parameter",
        f"{', '.join(unseen)} move together unseen", "hold one of them, or read more",
    )  # fmt: skip


def covariates_are_columns_of_known_targets(machine: Machine, data: MeasuredData) -> None:
    """Covariates are told of readings, of targets that sensors state, or of the workspace; each has shape (n,)."""
    formulation, q = _at_start(machine, data)
    known = {*formulation.readings, *(t for sensor in formulation.sensors for t in sensor.targets), WORKSPACE}
    for target, columns in formulation.covariates(q).items():
        require(target in known, "a covariate has a known target", target, f"one of {', '.join(sorted(known))}")
        for name, column in columns.items():
            shape = np.shape(column)
            require(shape == (len(formulation.data),), f"covariate {name} has shape (n,)", shape, "a number a reading")


MACHINE_LAWS = (
    data_are_formulated_and_left_alone, a_missing_column_is_no_crash, parameters_are_named_once_and_start_in_their_box,
    every_reading_has_its_noise_and_its_sensor, declared_units_agree, constraints_have_a_row_a_reading,
    readings_are_near_the_model, slopes_agree_with_differences, other_rows_have_the_same_constraints,
    decorrelate_is_linear, readings_determine_every_parameter, covariates_are_columns_of_known_targets,
)  # fmt: skip


def _at_start(machine: Machine, data: MeasuredData) -> tuple[Formulation, Quantities]:
    """Return the formulation and its quantities where a model begins, moved by a thousandth: nothing vanishes there."""
    formulation = machine.formulate(data)
    model = Model(formulation)
    return formulation, model.quantities(model.start + 1e-3)[0]
