"""The effects that a simulator has under its own names: offsets, and a parameter that is another in other readings."""

from collections.abc import Callable
from functools import partial

import numpy as np

from calibench.discrepancy.effects.general import columns
from calibench.discrepancy.effects.general.joints import largest_error
from calibench.discrepancy.effects.general.lengths import time_constants, warmth
from calibench.discrepancy.effects.general.recipe import Built, named, of_joints, recipe, unit_of
from calibench.discrepancy.model.effect import EffectFamily, NotTestable, needs
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import drifts_of, roles_of
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array


def _input_offset(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    [joint] = named(roles_of(formulation).joints, target)
    return family.linear(
        target, (), {"c": joint.unit}, lambda q, data: {joint.reading: np.ones((len(data), 1))},
        largest=largest_error(joint),
    )  # fmt: skip


def _output_gain(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    output, _, column = target.partition(" over ")
    needs(formulation.data, column)
    follows, span = _course(formulation.data, column)
    return family.linear(
        target, (output, column), {"k": "1"},
        lambda q, data: {output: -np.asarray(q[output] * follows(np.asarray(data[column], dtype=float)))[:, None]},
        largest=thresholds().largest_scale, span=span,
    )  # fmt: skip


def _course(run: MeasuredData, column: str) -> tuple[Callable[[Array], Array], float]:
    """Return what a column is from its mean, or from 0 where it has both signs, over the largest in `run`; and that."""
    values = np.asarray(run[column], dtype=float)
    zero = 0.0 if values.min() <= 0.0 <= values.max() else float(values.mean())
    size = float(np.max(np.abs(values - zero)))
    return lambda u: (u - zero) / size, size


def _over(family: EffectFamily, formulation: Formulation, target: str) -> Built:
    """Return a parameter that follows a column, of a temperature also late."""
    parameter, _, column = target.partition(" over ")
    run, roles = formulation.data, roles_of(formulation)
    needs(run, column)
    if not np.any(formulation.slopes(Model(formulation).quantities()[0])[parameter]):
        raise NotTestable(f"no prediction depends on {parameter}")
    (course, span), warm = _course(run, column), (roles.temperature, *(j.temperature for j in roles.joints))

    def changes(late: float, q: Quantities, data: MeasuredData) -> dict[str, Array]:
        return {parameter: course(warmth(data, late, column, roles.time, run))[:, None]}

    return tuple(
        family.linear(target, (column,), {"c": ""}, partial(changes, late), span=span)
        for late in (time_constants(run, roles.time) if column in warm else (0.0,))
    )


FAMILIES = (
    columns.power.enter("simulator"),
    of_joints(
        "input_offset", "An input is off by a constant", "u += c", columns=("the input",), unit="that of the input",
        targets="each input", make=_input_offset, label="offset",
    ).enter("simulator"),
    recipe(
        "output_offset", "What is measured is off by a constant", "measured += c", channel="prediction", columns=(),
        unit="that of the measurement", targets="each measured column", targets_in=lambda f: tuple(f.readings),
        label="offset", make=lambda family, formulation, target: family.linear(
            target, (), {"c": unit_of(formulation, target)}, lambda q, data: {target: -np.ones((len(data), 1))}
        ),
    ).enter("simulator"),
    recipe(
        "parameter_over", "A parameter is another one where a column is", "p += c u / max|u|, u from its mean or 0",
        channel="link", columns=("the column",), unit="that of the parameter", targets="parameters over columns",
        targets_in=lambda f: tuple(f"{p} over {c}" for p in roles_of(f).parameters for c in drifts_of(roles_of(f))),
        make=_over, label="change",
    ).enter("simulator"),
    recipe(
        "output_gain", "An instrument's scale changes with a column", "measured -= k measured u / max|u|, u from its "
        "mean or 0", channel="prediction", columns=("the column",), unit="1", targets="measured columns over columns",
        targets_in=lambda f: tuple(f"{y} over {c}" for y in f.readings for c in drifts_of(roles_of(f))),
        make=_output_gain, label="change of scale", bounds=("largest_scale",),
    ).enter("simulator"),
    columns.frame_drift.enter(
        "simulator", name="output_drift", cause="What is measured drifts evenly during the run", label="drift",
        formula="measured -= d s; s from 0 to 1 over the run",
    ),
    columns.frame_shift.enter(
        "simulator", name="output_step", cause="What is measured steps once during the run", label="step",
    ),
)  # fmt: skip
