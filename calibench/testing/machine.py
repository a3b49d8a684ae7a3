"""The laws of a machine (columns, sensors, constraints and their slopes) and of an effect on one (zero, rows, slopes).

An effect acts on a machine, so it is checked on one: ``check_effect(sag, Arm(), data)``, where `sag` is one `Effect` or
a whole `EffectFamily`, of which every candidate that the data can test is checked.
"""

import numpy as np

from calibench.discrepancy.checks.validate import refuse_no_machine
from calibench.discrepancy.checks.wild import formulated, refuse_wild
from calibench.discrepancy.model.effect import Effect, EffectFamily, name_of
from calibench.discrepancy.model.machine import WORKSPACE, Formulation, Machine, Quantities
from calibench.discrepancy.model.measured import DataError, MeasuredData
from calibench.discrepancy.model.model import Model, signature
from calibench.discrepancy.registries import description_of
from calibench.problems.base import Array
from calibench.testing._law import TIME_LIMIT, Checks, checks_of, keep_all, require

_STEPS = 10.0 ** np.arange(-9, -2)  # of central differences, in parts of a quantity's size
_UNSEEN = 1e-7  # of the largest singular value: a direction of the parameters that moves no constraint


def check_machine(machine: Machine, data: MeasuredData, *, time_limit: float = TIME_LIMIT) -> None:
    """Raise `AssertionError`, one line, for the first law that `machine` breaks on `data`, a set of its readings."""
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
            fewer = machine.formulate(MeasuredData(rest, data.machine, data.metadata, data.name))
        except DataError:
            continue
        except Exception as error:
            require(
                False, f"without column {column} the data are refused by a DataError",
                f"{type(error).__name__}: {error}", "take columns by data[name], or ask `name in data` before",
            )  # fmt: skip
        there = column not in fewer.readings or column in fewer.data  # it may be computed from others
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
        declared, remedy = known.unit if known else "", "declare the unit that is used"
        require(declared == unit, f"{name} has one unit", f"{declared!r} declared, {unit!r} used", remedy)


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
    for name, slope in slopes.items():
        gap, size = np.inf, float(np.abs(slope).max())
        for h in max(1.0, float(np.max(np.abs(q[name])))) * _STEPS:
            up, down = (np.asarray(formulation.constraints({**q, name: q[name] + side})) for side in (h, -h))
            gap = min(gap, float(np.abs((up - down) / (2 * h) - slope).max()))
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
    whole = np.asarray(formulation.decorrelate(2 * one - other))
    parts = 2 * np.asarray(formulation.decorrelate(one)) - np.asarray(formulation.decorrelate(other))
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
    return formulation, _quantities(formulation, 1e-3)


def _quantities(formulation: Formulation, away: float = 0.0) -> Quantities:
    """Return the quantities where a model begins, or `away` from there."""
    model = Model(formulation)
    return model.quantities(model.start + away)[0]


_DIFFERENCE = 1e-5
_SAME = 1e-9  # of a change: sums of fewer numbers round otherwise


def check_effect(
    effect: Effect | EffectFamily, machine: Machine, data: MeasuredData, *, time_limit: float = TIME_LIMIT
) -> None:
    """Raise `AssertionError`, one line, for the first law that `effect` breaks on readings `data` of `machine`."""
    keep_all(lambda: effect_checks(effect, machine, data), time_limit)


def effect_checks(effect: Effect | EffectFamily, machine: Machine, data: MeasuredData) -> Checks:
    """Return (name, check) for every law, of a family for every law of every candidate of another name."""
    formulation = machine.formulate(data)
    if not isinstance(effect, EffectFamily):
        return checks_of(EFFECT_LAWS, effect, formulation)
    checks = checks_of(FAMILY_LAWS, effect, machine, data)
    try:
        candidates = effect.candidates(formulation).candidates
    except Exception:  # a law of families says so
        return checks
    for name, each in {name_of(candidate): candidate for candidate in candidates}.items():
        checks += [(f"{law} ({name})", check) for law, check in checks_of(EFFECT_LAWS, each, formulation)]
    return checks


def it_is_named_and_has_units(effect: Effect, formulation: Formulation) -> None:
    """Family, target, formula and unit are text; every coefficient has a name of its own and a unit."""
    for key in ("family", "target", "formula", "unit"):
        stated = getattr(effect, key, None)
        require(
            isinstance(stated, str) and (stated or key == "unit"), f"an effect states its {key}", repr(stated), "say it"
        )
    names, units = effect.coefficients, effect.units
    once = len(names) > 0 and len(set(names)) == len(names) == len(units)
    require(once, f"{name_of(effect)}: every coefficient has its unit", f"{names} and {units}", "list as many units")
    zero = effect.amplitude(np.zeros(len(names)))
    require(zero == 0, f"{name_of(effect)}: the amplitude of zero is zero", zero, "return a length or a coefficient")


def its_columns_are_in_the_data(effect: Effect, formulation: Formulation) -> None:
    """A candidate needs only columns that are there: what the data cannot test is `NotTestable`."""
    stated = [column for column in effect.columns if not column.startswith("metadata.")]
    missing = [column for column in stated if column not in formulation.data]
    require(not missing, f"{name_of(effect)}: its columns are there", f"no {missing}", "call needs(data, *columns)")


def it_changes_quantities_of_the_machine(effect: Effect, formulation: Formulation) -> None:
    """`shift` returns (n,) and `basis` (n, k), finite, for quantities that the machine has."""
    q, data, k = _quantities(formulation), formulation.data, len(effect.coefficients)
    for what, shape in ((effect.shift, (len(data),)), (effect.basis, (len(data), k))):
        for name, value in what(q, data, 0.1 * np.ones(k)).items():
            remedy = f"the machine has {', '.join(q)}"
            require(name in q, f"{name_of(effect)}: it changes quantities of the machine", name, remedy)
            right = np.shape(value) == shape and np.isfinite(value).all()
            require(
                right, f"{name_of(effect)}: {name} changes by {shape}", np.shape(value), "a finite number a reading"
            )


def zero_changes_nothing(effect: Effect, formulation: Formulation) -> None:
    """At zero coefficients every change is exactly zero, and the model with the effect is the machine's own."""
    q, data = _quantities(formulation), formulation.data
    change = effect.shift(q, data, np.zeros(len(effect.coefficients)))
    require(change, f"{name_of(effect)}: it changes a quantity", "nothing", "return quantity -> (n,)")
    moved = [name for name, value in change.items() if np.any(value)]
    require(not moved, f"{name_of(effect)}: zero changes nothing", f"a change of {moved}", "multiply by coefficients")
    plain, more = Model(formulation), Model(formulation).with_effects(effect)
    same = np.array_equal(plain.residuals(plain.start), more.residuals(more.start))
    require(same, f"{name_of(effect)}: zero changes nothing", "other residuals", "change no state")


def a_row_changes_by_what_stands_in_it(effect: Effect, formulation: Formulation) -> None:
    """A reading changes by the same beside few other rows as beside all: held-out rows are told without the others."""
    q, data, rng = _quantities(formulation), formulation.data, np.random.default_rng(4)
    c = 0.1 * rng.normal(size=len(effect.coefficients))
    whole = effect.shift(q, data, c)
    for few in (min(2, len(data)), (len(data) + 1) // 2):
        some = np.zeros(len(data), dtype=bool)
        some[rng.choice(len(data), few, replace=False)] = True
        part = effect.shift({name: value[some] if np.ndim(value) else value for name, value in q.items()},
                            data.rows(some), c)  # fmt: skip
        for name, value in whole.items():
            size, there = float(np.abs(value).max()), np.asarray(part[name])
            gap = float(np.abs(value[some] - there).max()) if there.shape == (few,) else np.inf
            require(
                gap <= _SAME * size, f"{name_of(effect)}: a row changes by what stands in it",
                f"a gap of {gap:.2g} beside {size:.2g} in {name} where {few} of {len(data)} rows are given",
                "take a mean, an extreme or an order of all rows in build(formulation, target), once, as a number",
            )  # fmt: skip


def basis_is_the_derivative_of_shift(effect: Effect, formulation: Formulation) -> None:
    """`basis` is the derivative of `shift` in the coefficients, at zero and elsewhere."""
    q, data, k = _quantities(formulation), formulation.data, len(effect.coefficients)
    for c in (np.zeros(k), 0.1 * np.random.default_rng(2).normal(size=k)):
        basis = effect.basis(q, data, c)
        for j in range(k):
            step = _DIFFERENCE * np.eye(k)[j]
            up, down = effect.shift(q, data, c + step), effect.shift(q, data, c - step)
            require(
                set(up) == set(basis), f"{name_of(effect)}: shift and basis change the same",
                f"{sorted(up)} and {sorted(basis)}", "return both for the same quantities",
            )  # fmt: skip
            for name, column in basis.items():
                gap = np.abs(column[:, j] - (up[name] - down[name]) / (2 * _DIFFERENCE)).max()
                require(
                    gap <= 1e-7 * max(1.0, float(np.abs(column).max())),
                    f"{name_of(effect)}: basis is the derivative of shift",
                    f"a gap of {gap:.2g} in {name}, coefficient {effect.coefficients[j]}", "derive it again",
                )  # fmt: skip


def signature_is_the_derivative_of_the_residuals(effect: Effect, formulation: Formulation) -> None:
    """What the model takes for the trace of a coefficient is the difference that it makes in the residuals."""
    model = Model(formulation).with_effects(effect)
    x, parameters, k = model.start, len(formulation.parameters), len(effect.coefficients)
    q, slopes = _quantities(formulation), formulation.slopes(_quantities(formulation))
    trace = signature(effect, np.zeros(k), q, slopes, formulation)
    rounding = 1e-12 * max(float(np.abs(slope).max()) for slope in slopes.values())
    for j in range(k):
        basis = effect.basis(q, formulation.data, np.zeros(k))
        whole = max(float(np.abs(slopes[name] * part[:, [j]]).max()) for name, part in basis.items())
        size = min(1.0, 1e-4 / max(whole, 1e-300))  # of the coefficient: the residuals change by 1e-4 of their unit
        step = size * np.eye(model.size)[parameters + j]
        slope = (model.residuals(x + step) - model.residuals(x - step)) / (2 * size)
        gap = float(np.abs(trace[:, :, j] - slope).max())
        require(
            gap <= 1e-5 * whole + rounding, f"{name_of(effect)}: its signature is the derivative of the residuals",
            f"a gap of {gap:.2g} beside {whole:.2g} in {effect.coefficients[j]}",
            "let basis be what one unit of the coefficient adds to the quantity",
        )  # fmt: skip


def the_family_is_named(family: EffectFamily, machine: Machine, data: MeasuredData) -> None:
    """A family states its name, machine, cause, formula and targets; its candidates bear its name and targets."""
    for key in ("name", "machine", "cause", "formula"):
        stated = getattr(family, key)
        require(isinstance(stated, str) and stated, f"a family states its {key}", repr(stated), "say it")
    require(family.targets, f"{family.name}: it has targets", "none", "list them, such as ('joint 1',)")
    formulation = machine.formulate(data)
    targets = family.names_in(formulation)
    tested = family.candidates(formulation)
    wrong = [name_of(e) for e in tested.candidates if e.family != family.name or e.target not in targets]
    require(not wrong, f"{family.name}: candidates bear its name and targets", wrong, "take both from the family")


def the_data_can_test_some_of_it(family: EffectFamily, machine: Machine, data: MeasuredData) -> None:
    """There is something to check: the family has a candidate in these data (one of noise has none in any)."""
    tested = family.candidates(machine.formulate(data))
    reasons = "; ".join(f"{gap.target}: {gap.reason}" for gap in tested.untestable)
    some = tested.candidates or tested.alternatives or family.channel == "noise"
    require(some, f"{family.name}: the data can test some of it", reasons or "no candidate", "check it on other data")


def a_missing_column_makes_it_not_testable(family: EffectFamily, machine: Machine, data: MeasuredData) -> None:
    """Without a column that its candidates need, a family has none that needs it; one that it then lacks says why."""
    columns = {column for effect in family.candidates(machine.formulate(data)).candidates for column in effect.columns}
    for column in sorted(columns & set(data.columns)):
        rest = {key: values for key, values in data.columns.items() if key != column}
        law, remedy = f"{family.name}: without {column} it is not testable", "call needs(data, *columns) in build"
        try:
            less = machine.formulate(MeasuredData(rest, data.machine, data.metadata, data.name))
        except DataError:
            continue  # no machine without it
        try:
            tested = family.candidates(less)
        except Exception as error:
            raise AssertionError(f"{law}; found {type(error).__name__}: {error}; {remedy}") from error
        remaining = [name_of(e) for e in tested.candidates if column in e.columns and column not in less.data]
        require(not remaining, law, f"candidates {remaining}", remedy)
        explained = tested.candidates or any(column in gap.reason for gap in tested.untestable)
        require(explained, law, "no reason that names it", remedy)


EFFECT_LAWS = (
    it_is_named_and_has_units, its_columns_are_in_the_data, it_changes_quantities_of_the_machine, zero_changes_nothing,
    a_row_changes_by_what_stands_in_it, basis_is_the_derivative_of_shift, signature_is_the_derivative_of_the_residuals,
)  # fmt: skip
FAMILY_LAWS = (the_family_is_named, the_data_can_test_some_of_it, a_missing_column_makes_it_not_testable)
