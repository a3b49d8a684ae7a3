"""The only way from measured data to a formulation that is searched: `validate`.

First the table itself, whatever the machine: valid, split, poses and visits, time. Then what the machine makes of it:
copies, wild readings, and a cell far from all others of its column (a code for "no value", a lost comma). A wild
reading is seen by its misfit; that is not possible for a column that only an effect may depend on, nor for an angle,
whose sine is never large, so such a cell is found by its distance relative to the range of the others.

Refused in one line: an object that is no machine, and a statement that nothing reads, because its user wanted to change
something and nothing changed. A machine declares its statements, or what its code looks up is recorded.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench.core.notes import Code
from calibench.core.options import suggest
from calibench.core.tables.cells import valid_rows
from calibench.core.words import plain
from calibench.discrepancy.checks.copies import copied_rows
from calibench.discrepancy.checks.wild import formulated, refuse_wild, without_wild, without_wild_rows
from calibench.discrepancy.model.formulations import Constraints
from calibench.discrepancy.model.machine import Formulation, Machine
from calibench.discrepancy.model.measured import DataError, MeasuredData, number_visits, with_split
from calibench.discrepancy.model.roles import columns_of, inputs_of, roles_of, unknown_noise_of, words_of
from calibench.discrepancy.registries import description_of, descriptions

NOT_HELD_OUT = "no rows are held out: the gap on unseen poses is by cross-validation"


def looked_at(machine: Machine, data: MeasuredData) -> Formulation:
    """Return the formulation of readings that are not searched yet, such as those of a plan.

    Copied rows are allowed.
    """
    refuse_no_machine(machine)
    return _tame(formulated(machine, entered(data)))


def _as_they_are(data: MeasuredData) -> MeasuredData:
    return data


def validate(
    machine: Machine, data: MeasuredData, ordered: Callable[[MeasuredData], MeasuredData] = _as_they_are
) -> Formulation:
    """Return the formulation of `data` after all checks.

    Where some rows or columns are left out, its data carry a note. `ordered` puts rows into another order before they
    are formulated. Raises `DataError`, in one line that names the column or the rows, what is wrong with them, and what
    to do.
    """
    refuse_no_machine(machine)
    rows, data = np.flatnonzero(_marked(data)) + 1, entered(data)
    formulation = formulated(machine, ordered(data))
    copies, note = copied_rows(data, rows, formulation)
    if copies.any():
        formulation = machine.formulate(ordered(data.rows(~copies)))
    if note is not None:
        formulation = formulation.on(replace(formulation.data, notes=(*formulation.data.notes, note)))
    # only predictions are the same at the same inputs; constraints need not be
    predicts = not isinstance(formulation, Constraints)
    with_visits = visits_at(formulation.data, inputs_of(formulation) if predicts else ())
    formulation = formulation if with_visits is formulation.data else formulation.on(with_visits)
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
    apart, text = rows_apart(formulation)
    if text:
        data = formulation.data
        formulation = formulation.on(data.rows(~apart).with_note(Code.ROWS_WILD, text, rows=data.labels(apart)))
    return without_wild_rows(formulation)


def _remarked(machine: Machine, formulation: Formulation) -> Formulation:
    """Return the formulation with remarks that its noise is not stated, that nothing is held out, and what it lacks.

    A machine that ships makes its own remarks on the last two.
    """
    data = formulation.data
    if unknown := unknown_noise_of(formulation):
        text = f"the noise is not stated: that of {', '.join(unknown)} is learned from what the model leaves"
        data = data.with_note(Code.NOISE_LEARNED, text, unknown)
        formulation = formulation.on(data)
    if machine.name in descriptions():
        return formulation
    roles, read = roles_of(formulation), (*formulation.readings, *inputs_of(formulation))
    others = [name for name in data.in_file if name not in read]
    for name in columns_of(roles):
        if name not in data:
            what = words_of(roles).get(name, name)
            text = f"no column {name}: what depends on the {what} is not looked for; {suggest(name, others)}"
            data = data.with_note(Code.COLUMN_MISSING, text, (name,))
    if "split" not in data or not (data["split"] == "hold").any():
        data = data.with_note(Code.NOT_HELD_OUT, NOT_HELD_OUT)
    return formulation.on(data)


_FORMULATE = "formulate(data), which returns Predicted(...) or Constraints(...)"


def refuse_no_machine(machine: object, called: str = "") -> None:
    """Raise `DataError` for an object without `name` or without a `formulate` that takes data.

    `told` is what the user wrote.
    """
    if isinstance(machine, type):
        raise DataError(
            f"{called or 'machine'}: {machine.__name__} is a class; {machine.__name__}(), one of it, is needed"
        )
    called = called or f"machine: {type(machine).__name__}"
    formulate = getattr(machine, "formulate", None)
    if not callable(formulate):
        raise DataError(f"{called}: it has no {_FORMULATE}")
    try:
        inspect.signature(formulate).bind(None)
    except TypeError:
        raise DataError(f"{called}: formulate{inspect.signature(formulate)} does not take the data; "
                        f"def formulate(self, data) is needed") from None  # fmt: skip
    except ValueError:
        pass  # the signature of a function in C cannot be read
    if not isinstance(name := getattr(machine, "name", None), str) or not name:
        raise DataError(f'{called}: it has no name; name = "..." in the class says what a page calls it')


_ALWAYS = ("machine", "schema_version", "columns", "units")


@final
class Asked(dict[str, Any]):
    """Metadata that record which of their keys are looked up.

    `__iter__` records as well, because a merge reads all keys.
    """

    def __init__(self, of: Mapping[str, Any]) -> None:
        super().__init__(of)
        self.read: set[str] = set()

    def __getitem__(self, key: str) -> Any:
        """Return what is stated under `key`, and record that it was looked up."""
        self.read.add(key)
        return super().__getitem__(key)

    def get(self, key: str, default: Any = None) -> Any:
        """Return what is stated under `key`, or `default`, and record that it was looked up."""
        self.read.add(key)
        return super().get(key, default)

    def __iter__(self) -> Iterator[str]:
        return super().__iter__()


def listen(data: MeasuredData) -> tuple[MeasuredData, Asked]:
    """Return the data with metadata that record what is read of them, and these metadata."""
    asked = Asked(data.metadata)
    return replace(data, metadata=asked), asked


def refuse_unused(machine: str, data: MeasuredData, asked: Asked) -> None:
    """Raise `DataError` for a key that was stated beside the file and that neither the machine nor its effects read."""
    declared = [one.key for one in description_of(machine).stated]
    known = declared or sorted(asked.read)
    for key in sorted(data.stated):
        if key in _ALWAYS or key in declared or (not declared and key in asked.read):
            continue
        raise DataError(f"{data.name}: {key}= is stated, and nothing of {machine} reads it; {_way_out(key, known)}")


def _way_out(key: str, known: list[str]) -> str:
    choices = [one for one in known if one not in _ALWAYS]
    return suggest(key, choices) if choices else "leave it out"


_FAR = 20.0  # ranges of the rest of the column
_FEW = 0.01  # of the rows; two may be in any file
_LEAST = 20  # rows that are needed to tell what is usual
_DIFFERENT = 8  # values of the rest: fewer are levels that somebody chose
_ANGLES = ("rad", "deg")


def rows_apart(formulation: Formulation) -> tuple[NDArray[np.bool_], str]:
    """Return which rows hold a cell far from all others of its column, (n,), and a note on them.

    The note is "" where there is no such row.
    """
    data = formulation.data
    out, cells = np.zeros(len(data), dtype=bool), []
    for name in _looked_at(formulation):
        column = np.asarray(data[name], dtype=float)
        apart = _apart(column)
        if apart.any():
            out |= apart
            rest = column[~apart & np.isfinite(column)]
            lie = f"all others lie between {plain(rest.min())} and {plain(rest.max())}"
            cells.append(f"{name} is {column[apart][0]:.6g}, {lie}")
    if not cells:
        return out, ""
    rows, them = formulation.data.rows_named(out), "them" if out.sum() > 1 else "it"
    return out, f"{rows} left out: {'; '.join(cells)}; correct {them}, or mark {them} valid=0"


def _apart(column: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which cells of a column are far from all others, (n,): few cells, many ranges of the others away."""
    apart = np.zeros(len(column), dtype=bool)
    finite = np.flatnonzero(np.isfinite(column))
    few = max(2, int(_FEW * len(column)))
    if len(finite) < _LEAST + few:
        return apart
    order = finite[np.argsort(np.abs(column[finite] - np.median(column[finite])), kind="stable")]
    for k in range(1, few + 1):  # the k outermost values, against the rest
        rest, others = column[order[:-k]], column[order[-k:]]
        away = np.maximum(rest.min() - others, others - rest.max())
        if (away > _FAR * np.ptp(rest)).all() and len(np.unique(rest)) >= _DIFFERENT:
            apart[order[-k:]] = True
            return apart
    return apart


def _looked_at(formulation: Formulation) -> tuple[str, ...]:
    """Return the columns that an error may depend on: no time, no reading or input that turns, and nothing computed."""
    data, roles = formulation.data, roles_of(formulation)
    read = (*formulation.readings, *inputs_of(formulation))
    followed = (*columns_of(roles), *(column.name for column in description_of(data.machine).columns))
    units = {sensor.column: sensor.unit for sensor in formulation.sensors} | dict(data.units)
    units |= {joint.reading: joint.unit for joint in roles.joints}
    names = [name for name in followed if name not in (*read, roles.time, "t_s", *data.computed)]
    names += [name for name in read if units.get(name) in _ANGLES]
    return tuple(name for name in dict.fromkeys(names) if name in data and data[name].dtype.kind in "iuf")


def entered(data: MeasuredData) -> MeasuredData:
    """Return the rows that are marked as valid, with `split`, poses and visits in one spelling, and notes.

    Where poses are given without visits, rows of one pose that follow each other are one visit. Data that were entered
    before are returned unchanged. Raises `DataError` for unknown words in `valid` and `split`, and for a time that is
    not a number.
    """
    if not len(data):
        raise DataError(f"{data.name}: there are no readings; a row for each is needed")
    data = _timed(_only_valid(data))
    return _with_visits(number_visits(with_split(data)))


def _marked(data: MeasuredData) -> NDArray[np.bool_]:
    if "valid" not in data:
        return np.ones(len(data), dtype=bool)
    try:
        return valid_rows(data["valid"])
    except ValueError as error:
        raise DataError(f"{data.name}: {error}") from None


def _only_valid(data: MeasuredData) -> MeasuredData:
    valid = _marked(data)
    if valid.all():
        return data
    if not valid.any():
        raise DataError(f"{data.name}: column valid marks no row as valid; mark those that are to be used with 1")
    count = int((~valid).sum())
    text = f"{count} row{'s are' if count > 1 else ' is'} marked as not valid and left out"
    return data.rows(valid).with_note(Code.ROWS_LEFT_OUT, text, ("valid",), rows=data.labels(~valid))


def _timed(data: MeasuredData) -> MeasuredData:
    if "t_s" not in data:
        return data
    try:
        time = np.asarray(data["t_s"], dtype=float)
    except (TypeError, ValueError):
        raise DataError(
            f"{data.name}: column t_s holds {str(data['t_s'][0])!r}; seconds, or times such as 2026-03-01T12:30:05, "
            "are needed"
        ) from None
    back = int((np.diff(time) < 0).sum())
    text = f"t_s runs backwards at {back} place{'s' if back > 1 else ''}: the rows are taken in the order of t_s"
    return data.with_note(Code.TIME_BACKWARDS, text, ("t_s",), places=back) if back else data


def _with_visits(data: MeasuredData) -> MeasuredData:
    """Return the data with one visit for each run of rows of one pose, in time, where only poses are given."""
    if "visit_id" in data or "pose_id" not in data:
        return data
    order = np.argsort(data["t_s"], kind="stable") if "t_s" in data else np.arange(len(data))
    pose = np.asarray(data["pose_id"])[order]
    if len(np.unique(pose)) in (1, len(pose)):
        return data
    visit = np.empty(len(data), dtype=np.int64)
    visit[order] = np.cumsum(np.diff(pose, prepend=pose[0]) != 0)
    return data.with_columns({"visit_id": visit})


def visits_at(data: MeasuredData, inputs: Sequence[str]) -> MeasuredData:
    """Return the data with poses and visits found from the commanded `inputs`, where no column gives them.

    Successive rows with equal inputs, and with equal words and levels in all columns of few values, are one visit.
    """
    if not inputs or data.has("visit_id") or data.has("pose_id"):
        return data
    few = [n for n, c in data.columns.items() if n in inputs or len(np.unique(c)) <= len(data) // 3]
    pose = np.zeros(len(data), dtype=np.int64)
    for name in few:
        own = np.unique(data[name], return_inverse=True)[1].reshape(-1)
        pose = np.unique(pose * (own.max() + 1) + own, return_inverse=True)[1].reshape(-1)
    visit = np.cumsum(np.diff(pose, prepend=pose[:1]) != 0)
    if len(np.unique(visit)) in (1, len(data)):
        return data
    text = f"rows that follow each other at the same {', '.join(inputs)} are taken as repeats"
    return data.with_columns({"pose_id": pose, "visit_id": visit}).with_note(Code.REPEATS_TAKEN, text, inputs)
