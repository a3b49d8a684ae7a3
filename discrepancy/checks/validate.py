"""`validated` is the only way from measured data to a formulation that is searched."""

from __future__ import annotations

from collections.abc import Callable

from calibench.core.options import suggest
from calibench.discrepancy.checks.apart import rows_apart
from calibench.discrepancy.checks.copies import copied_rows
from calibench.discrepancy.checks.enter import entered, file_rows, visits_at
from calibench.discrepancy.checks.machine import refuse_no_machine
from calibench.discrepancy.checks.wild import formulated, refuse_wild, wild_rows, wild_words
from calibench.discrepancy.checks.wild_readings import without_wild
from calibench.discrepancy.model.formulations.constraints import Constraints
from calibench.discrepancy.model.machine import Formulation, Machine
from calibench.discrepancy.model.measured.data import LEARNED, UNSTATED, MeasuredData
from calibench.discrepancy.model.roles import columns_of, inputs_of, roles_of, unknown_noise_of, words_of
from calibench.discrepancy.registries import descriptions

CROSSED = "no rows are held out: the gap on unseen poses is by cross-validation"
NOT_CROSSED = (
    "no rows are held out, and without a part of them the rest does not determine what was added: the gap is that of "
    "the fitted readings"
)


def looked_at(machine: Machine, data: MeasuredData) -> Formulation:
    """Return the formulation of readings that are not searched yet, such as those of a plan.

    Copied rows are allowed.
    """
    refuse_no_machine(machine)
    return _tame(formulated(machine, entered(data)))


def _as_they_are(data: MeasuredData) -> MeasuredData:
    return data


def validated(
    machine: Machine, data: MeasuredData, ordered: Callable[[MeasuredData], MeasuredData] = _as_they_are
) -> Formulation:
    """Return the formulation of `data` after all checks.

    Where some rows or columns are left out, its data carry a note. `ordered` puts rows into another order before they
    are formulated. Raises `DataError`, in one line that names the column or the rows, what is wrong with them, and what
    to do.
    """
    refuse_no_machine(machine)
    rows, data = file_rows(data), entered(data)
    formulation = formulated(machine, ordered(data))
    copies, note = copied_rows(data, rows, formulation)
    if copies.any():
        formulation = machine.formulate(ordered(data.rows(~copies)))
    if note:
        formulation = formulation.on(formulation.data.with_note(note))
    # only predictions are the same at the same inputs; constraints need not be
    predicts = not isinstance(formulation, Constraints)
    told = visits_at(formulation.data, inputs_of(formulation) if predicts else ())
    formulation = formulation if told is formulation.data else formulation.on(told)
    formulation = _tame(formulation)
    if machine.name not in descriptions():  # machines that ship have rules of their own for wild readings
        kept = without_wild(formulation, isolated=True)
        formulation = formulation if kept is formulation.data else formulation.on(kept)
    return _remarked(machine, formulation)


def _tame(formulation: Formulation) -> Formulation:
    """Return the formulation without rows that no machine of its kind can give, and a note.

    Refuse data that are far off.
    """
    refuse_wild(formulation)
    apart, note = rows_apart(formulation)
    if note:
        formulation = formulation.on(formulation.data.rows(~apart).with_note(note))
    wild = wild_rows(formulation)
    if wild.any():
        formulation = formulation.on(formulation.data.rows(~wild).with_note(wild_words(formulation, wild)))
    return formulation


def _remarked(machine: Machine, formulation: Formulation) -> Formulation:
    """Return the formulation with remarks that its noise is not stated, that nothing is held out, and what it lacks.

    A machine that ships makes its own remarks on the last two.
    """
    data = formulation.data
    if unknown := unknown_noise_of(formulation):
        data = data.with_note(f"{UNSTATED}: that of {', '.join(unknown)} {LEARNED}")
        formulation = formulation.on(data)
    if machine.name in descriptions():
        return formulation
    roles, read = roles_of(formulation), (*formulation.readings, *inputs_of(formulation))
    others = [name for name in data.in_file if name not in read]
    for name in columns_of(roles):
        if name not in data:
            what = words_of(roles).get(name, name)
            data = data.with_note(
                f"no column {name}: what depends on the {what} is not looked for; {suggest(name, others)}"
            )
    if "split" not in data or not (data["split"] == "hold").any():
        data = data.with_note(CROSSED)
    return formulation.on(data)
