"""The only way from measured data to a formulation that is searched: `validate`.

First the table itself, whatever the machine: valid, split, poses and visits, time. Then what the machine makes of it:
copies, wild readings, and a cell far from all others of its column (a code for "no value", a lost comma). A wild
reading is seen by its misfit; that is not possible for a column that only an effect may depend on, nor for an angle,
whose sine is never large. An object that is no machine is refused, and so is a statement that nothing reads.
"""

import difflib
import inspect
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.special import pdtrc

from calibench.core.notes import Code, Note
from calibench.core.options import suggest
from calibench.core.tables.cells import split_rows, valid_rows
from calibench.core.words import as_columns, listed, plain
from calibench.discrepancy.checks.wild import formulated, refuse_wild, without_wild, without_wild_rows
from calibench.discrepancy.model.formulations import Constraints
from calibench.discrepancy.model.machine import Formulation, Machine
from calibench.discrepancy.model.measured import PLACE, DataError, MeasuredData, kinds_of, number_visits
from calibench.discrepancy.model.roles import columns_of, inputs_of, roles_of, unknown_noise_of, words_of
from calibench.discrepancy.registries import description_of, descriptions, families

_OF_ANY = ("pose_id", "visit_id", "repeat", "split", "valid", "t_s")  # columns that are read whatever the machine
_LIKE = 0.75  # of difflib: how much alike the name of a column and that of an unread one are
_LISTED = 6  # names that a note lists
NOT_HELD_OUT = "no rows are held out: the gap on unseen poses is by cross-validation"


def looked_at(machine: Machine, data: MeasuredData) -> Formulation:
    """Return the formulation of readings that are not searched yet, such as those of a plan; rows may be copies."""
    refuse_no_machine(machine)
    data = entered(data)
    return _tame(_without_stopped(machine, data, formulated(machine, data)))


def refuse_mistaken(machine: Machine, data: MeasuredData) -> None:
    """Raise `DataError` where data, of which a search could not name all, fit far better without a mistake."""
    formulated(machine, _in_order(entered(data)), unnamed=True)


def validate(machine: Machine, data: MeasuredData) -> Formulation:
    """Return the formulation of `data` after all checks, its rows in the order of reading and with their places in it.

    Rows keep their places when others are held out, or not searched: noise that is carried on fades in between. Where
    some rows or columns are left out, its data carry a note. Raises `DataError`, in one line that names the column or
    the rows, what is wrong with them, and what to do.
    """
    refuse_no_machine(machine)
    rows, data = np.flatnonzero(_valid(data)) + 1, entered(data)
    if description_of(machine.name).named is None:
        data = with_unread(machine.name, data)
    formulation = formulated(machine, _in_order(data))
    copies, note = copied_rows(data, rows, formulation)
    if copies.any():
        data = data.rows(~copies)
        formulation = machine.formulate(_in_order(data))
    formulation = _without_stopped(machine, data, formulation)
    if note is not None:
        formulation = formulation.on(replace(formulation.data, notes=(*formulation.data.notes, note)))
    # only predictions are the same at the same inputs; constraints need not be
    inputs, shown = inputs_of(formulation), formulation.data
    if not isinstance(formulation, Constraints) and inputs and not (shown.has("visit_id") or shown.has("pose_id")):
        few = [n for n, c in shown.columns.items() if n in inputs or len(np.unique(c)) <= len(shown) // 3]
        pose = np.zeros(len(shown), dtype=np.int64)
        for name in few:
            own = np.unique(shown[name], return_inverse=True)[1].reshape(-1)
            pose = np.unique(pose * (own.max() + 1) + own, return_inverse=True)[1].reshape(-1)
        visit = np.cumsum(np.diff(pose, prepend=pose[:1]) != 0)
        if len(np.unique(visit)) not in (1, len(shown)):
            text = f"rows that follow each other at the same {', '.join(inputs)} are taken as repeats"
            shown = shown.with_columns({"pose_id": pose, "visit_id": visit})
            formulation = formulation.on(shown.with_note(Code.REPEATS_TAKEN, text, inputs))
    formulation = _tame(formulation)
    ships = machine.name in descriptions()  # such machines have rules and remarks of their own
    data = formulation.data if ships else without_wild(formulation, isolated=True)
    if unknown := unknown_noise_of(formulation):
        text = f"the noise is not stated: that of {', '.join(unknown)} is learned from what the model leaves"
        data = data.with_note(Code.NOISE_LEARNED, text, unknown)
    if not ships:
        roles, read = roles_of(formulation), (*formulation.readings, *inputs_of(formulation))
        others = [name for name in data.in_file if name not in read]
        for name in (name for name in columns_of(roles) if name not in data):
            what = words_of(roles).get(name, name)
            text = f"no column {name}: what depends on the {what} is not looked for; {suggest(name, others)}"
            data = data.with_note(Code.COLUMN_MISSING, text, (name,))
        if data.fitted.all():
            data = data.with_note(Code.NOT_HELD_OUT, NOT_HELD_OUT)
    if not data.has(PLACE):  # some machines make a table of their own
        data = data.with_columns({PLACE: np.arange(len(data), dtype=float)})
    return formulation if data is formulation.data else formulation.on(data)


def _in_order(data: MeasuredData) -> MeasuredData:
    data = data.rows(np.argsort(data["t_s"], kind="stable")) if data.has("t_s") else data
    return data.with_columns({PLACE: np.arange(len(data), dtype=float)})


def with_unread(machine: str, data: MeasuredData, read: Collection[str] = ()) -> MeasuredData:
    """Return the data with a note of the columns that neither a machine with declared columns nor its effects read.

    A machine that finds columns whatever they are called has `read` some of them.
    """
    declared = [quantity.name for quantity in description_of(machine).columns]
    known = {*_OF_ANY, *declared, *read, *(column for family in families(machine) for column in family.columns)}
    others = [name for name in data.in_file if name not in known]
    if not declared or not others:
        return data
    meant: dict[str, str] = {}  # a declared column that is not there -> the unread one most like it
    for name in others:
        free = {column.casefold(): column for column in declared if column not in data and column not in meant}
        meant |= {free[near]: name for near in difflib.get_close_matches(name.casefold(), free, n=1, cutoff=_LIKE)}
    way_out = f"; did you mean {', '.join(meant)}? {as_columns(meant)}" if meant else ""
    text = f"not read: {listed(others, _LISTED)}{way_out}"
    return data.with_note(Code.COLUMNS_UNREAD, text, tuple(others))


def _tame(formulation: Formulation) -> Formulation:
    """Return the formulation without rows that no machine of its kind can give; refuse data that are far off."""
    refuse_wild(formulation)
    out, text = rows_apart(formulation)
    if text:
        data = formulation.data
        formulation = formulation.on(data.rows(~out).with_note(Code.ROWS_WILD, text, rows=data.labels(out)))
    return without_wild_rows(formulation)


def _without_stopped(machine: Machine, data: MeasuredData, formulation: Formulation) -> Formulation:
    """Return what the machine makes of the data without the rows of a sensor that has stopped: they tell nothing of it.

    The machine is asked again, as what its parameters are told by depends on its rows.
    """
    out, text = rows_stopped(formulation)
    if not text:
        return formulation
    there = formulation.data
    again = machine.formulate(_in_order(data.rows(~np.isin(data.row_numbers, there.row_numbers[out]))))
    return again.on(again.data.with_note(Code.ROWS_WILD, text, rows=there.labels(out)))


_STOPPED = 5  # poses at the least at which a sensor gives one value, and times as many rows as it does elsewhere


def rows_stopped(formulation: Formulation) -> tuple[NDArray[np.bool_], str]:
    """Return the first or last rows, (n,), in which an instrument kept one value while all else moved; and a note.

    Of the last ones the first is not among them: there the value was read.
    """
    data, reads = formulation.data, getattr(formulation, "reads", None)
    joints = {joint.reading for joint in roles_of(formulation).joints}
    out = np.zeros(len(data), dtype=bool)
    for names in (tuple(sensor.column for sensor in kind) for kind in kinds_of(formulation.sensors)):
        others = [name for name in (*formulation.readings, *inputs_of(formulation)) if name not in names]
        rows = np.flatnonzero(np.all([reads(name) for name in names], axis=0)) if reads else np.arange(len(data))
        if joints & {*names} or not others or len(rows) < _LEAST:
            continue
        read, moves = (np.column_stack([data[name][rows] for name in some]) for some in (names, others))
        same = np.concatenate([[0], np.cumsum((np.diff(read, axis=0) != 0).any(axis=1))])  # numbers of runs
        long = np.bincount(same)
        for run in {0, same[-1]}:
            there, usual = same == run, np.delete(long, run).max(initial=0)
            poses = len(np.unique(moves[there], axis=0))
            if poses < _STOPPED * max(usual, 1) or len(long) < _DIFFERENT:
                continue
            out[rows[np.flatnonzero(there)[1 if run else 0 :]]] = True
            at, are = ", ".join(plain(v, 5) for v in read[there][0]), "stays" if len(names) == 1 else "stay"
            text = f"{', '.join(names)} {are} at {at} while the machine moves, as of a sensor that has stopped"
            return out, f"{data.rows_named(out)} left out: {text}; measure them again, or mark them valid=0"
    return out, ""


_FORMULATE = "formulate(data), which returns Predicted(...) or Constraints(...)"


def refuse_no_machine(machine: object, called: str = "") -> None:
    """Raise `DataError` for an object without a name or a `formulate` that takes data; the user `called` it so."""
    if isinstance(machine, type):
        kind = machine.__name__
        raise DataError(f"{called or 'machine'}: {kind} is a class; {kind}(), one of it, is needed")
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
        self.read.add(key)
        return super().__getitem__(key)

    def get(self, key: str, default: Any = None) -> Any:
        self.read.add(key)
        return super().get(key, default)

    def __iter__(self) -> Iterator[str]:
        return super().__iter__()


def refuse_unused(machine: str, data: MeasuredData, asked: Asked) -> None:
    """Raise `DataError` for a key that was stated beside the file and that neither the machine nor its effects read."""
    stated = description_of(machine).stated
    known = sorted(asked.read) if stated is None else [one.key for one in stated]
    for key in sorted(data.stated):
        if key in _ALWAYS or key in known:
            continue
        choices = [one for one in known if one not in _ALWAYS]
        way_out = suggest(key, choices) if choices else "leave it out"
        raise DataError(f"{data.name}: {key}= is stated, and nothing of {machine} reads it; {way_out}")


_FAR = 20.0  # ranges of the rest of the column
_FEW = 0.01  # of the rows; two may be in any file
_LEAST = 20  # rows that are needed to tell what is usual
_DIFFERENT = 8  # values of the rest: fewer are levels that somebody chose
_ANGLES = ("rad", "deg")


def rows_apart(formulation: Formulation) -> tuple[NDArray[np.bool_], str]:
    """Return which rows hold a cell far from all others of its column, (n,), and a note on them; "" without any."""
    data, roles = formulation.data, roles_of(formulation)
    read = (*formulation.readings, *inputs_of(formulation))
    followed = (*columns_of(roles), *(column.name for column in description_of(data.machine).columns))
    units = {sensor.column: sensor.unit for sensor in formulation.sensors} | dict(data.units)
    units |= {joint.reading: joint.unit for joint in roles.joints}
    names = [name for name in followed if name not in (*read, roles.time, "t_s", *data.computed)]
    names += [name for name in read if units.get(name) in _ANGLES]
    out, cells = np.zeros(len(data), dtype=bool), []
    for name in (name for name in dict.fromkeys(names) if name in data and data[name].dtype.kind in "iuf"):
        column = np.asarray(data[name], dtype=float)
        finite, few = np.flatnonzero(np.isfinite(column)), max(2, int(_FEW * len(column)))
        if len(finite) < _LEAST + few:
            continue
        order = finite[np.argsort(np.abs(column[finite] - np.median(column[finite])), kind="stable")]
        for k in range(1, few + 1):  # the k outermost values, against the rest: few cells, many ranges of it away
            rest, others = column[order[:-k]], column[order[-k:]]
            away = np.maximum(rest.min() - others, others - rest.max())
            if (away > _FAR * np.ptp(rest)).all() and len(np.unique(rest)) >= _DIFFERENT:
                out[order[-k:]] = True
                lie = f"all others lie between {plain(rest.min())} and {plain(rest.max())}"
                cells.append(f"{name} is {column[order[-k:].min()]:.6g}, {lie}")
                break
    if not cells:
        return out, ""
    rows, them = data.rows_named(out), "them" if out.sum() > 1 else "it"
    return out, f"{rows} left out: {'; '.join(cells)}; correct {them}, or mark {them} valid=0"


def entered(data: MeasuredData) -> MeasuredData:
    """Return the rows that are marked as valid, with `split`, poses and visits in one spelling, and notes.

    Where poses are given without visits, rows of one pose that follow each other are one visit. Data that were entered
    before are returned unchanged. Raises `DataError` for unknown words in `valid` and `split`, and for a time that is
    not a number.
    """
    if not len(data):
        raise DataError(f"{data.name}: there are no readings; a row for each is needed")
    valid = _valid(data)
    if not valid.any():
        raise DataError(f"{data.name}: column valid marks no row as valid; mark those that are to be used with 1")
    if not valid.all():
        count = int((~valid).sum())
        text = f"{count} row{'s are' if count > 1 else ' is'} marked as not valid and left out"
        data = data.rows(valid).with_note(Code.ROWS_LEFT_OUT, text, ("valid",), rows=data.labels(~valid))
    if "t_s" in data:
        try:
            time = np.asarray(data["t_s"], dtype=float)
        except (TypeError, ValueError):
            raise DataError(
                f"{data.name}: column t_s holds {str(data['t_s'][0])!r}; seconds, or times such as "
                "2026-03-01T12:30:05, are needed"
            ) from None
        if back := int((np.diff(time) < 0).sum()):
            places = f"{back} place{'s' if back > 1 else ''}"
            text = f"t_s runs backwards at {places}: the rows are taken in the order of t_s"
            data = data.with_note(Code.TIME_BACKWARDS, text, ("t_s",), places=back)
    if "split" in data:  # rows that were kept for checking must not be fitted in silence
        try:
            words = split_rows(data["split"])
        except ValueError as error:
            raise DataError(f"{data.name}: {error}") from None
        empty = words == ""
        words = np.where(empty, "train", words)
        if not (words == "train").any():
            raise DataError(f"{data.name}: column split holds back every row; some must be train, to be fitted")
        data = data.with_columns({"split": words})
        if empty.any():
            text = f"{np.sum(empty)} rows have no split and are fitted"
            data = data.with_note(Code.ROWS_FITTED, text, ("split",), rows=data.labels(empty))
    data = number_visits(data)
    if "visit_id" in data or "pose_id" not in data:
        return data
    order = np.argsort(data["t_s"], kind="stable") if "t_s" in data else np.arange(len(data))
    pose = np.asarray(data["pose_id"])[order]
    if len(np.unique(pose)) in (1, len(pose)):
        return data
    visit = np.empty(len(data), dtype=np.int64)
    visit[order] = np.cumsum(np.diff(pose, prepend=pose[0]) != 0)
    return data.with_columns({"visit_id": visit})


def _valid(data: MeasuredData) -> NDArray[np.bool_]:
    try:
        return valid_rows(data["valid"]) if "valid" in data else np.ones(len(data), dtype=bool)
    except ValueError as error:
        raise DataError(f"{data.name}: {error}") from None


_BOOKKEEPING = ("pose_id", "visit_id", "repeat", "split", "valid", PLACE)
_SAME = "are the same in every column"
_IMPOSSIBLE = 1e-3  # expected number of equal rows, below which an equal row must be a copy
_UNLIKELY = 1e-3
_SHOWN = 4  # pairs in a message
_TELLING = 8  # values by which a column is recognised under another name
_BY_ONE = 0.75  # of the steps of a column that numbers the rows with leaps: the least part that is one
_NUMBERED = re.compile(r"(\D*)(\d{1,18})")
_DAY = 86400.0  # s
_MOST_GAPS = 2000  # differences of a column that are used to find its step


def copied_rows(
    data: MeasuredData, rows: NDArray[np.intp], formulation: Formulation
) -> tuple[NDArray[np.bool_], Note | None]:
    """Return which rows of `data` are copies to be left out, (n,), and a note; none elsewhere.

    `rows` are their numbers in the file. On a scale with steps d two readings of one pose agree by chance with
    probability d / (2 sqrt(pi) sigma), so steps and stated noise give the expected number of equal rows. Raises
    `DataError` with the rows where equal rows cannot be, and where copies make the times of the other rows unsure.
    """
    named = {"t_s", roles_of(formulation).time, *(name for name, unit in data.units.items() if unit == "s")}
    timed = {name for name in named if name in data and np.asarray(data[name]).dtype.kind in "iuf"}
    counters = _counters(data, rows, formulation, timed)
    times = timed - {*counters}
    first, again = _pairs(data, counters, times)
    copies = np.zeros(len(data), dtype=bool)
    if not len(again):
        return copies, None
    pairs = ", ".join(f"{rows[k]} and {rows[i]}" for i, k in list(zip(again, first))[:_SHOWN])
    pairs += f" and {len(again) - _SHOWN} more" if len(again) > _SHOWN else ""
    distinct = np.setdiff1d(np.arange(len(data)), again)
    same = f"{_SAME} but {', '.join(counters)}, which counts them" if len(counters) == 1 else _SAME
    later = any(not np.array_equal(data[name][again], data[name][first]) for name in times)
    same += ", the times of day too" if later else ""
    way_out = "leave out the copies, or state their own time of reading"
    if not later and "t_s" in data and len(np.unique(data["t_s"][distinct])) == len(distinct) > 1:
        raise DataError(f"{data.name}: rows {pairs} {same}, t_s too: copies; {way_out}")
    # pairs of rows at one pose, the number of rows where the data do not tell poses, times the probability that two
    # such agree in all columns that carry noise; a reading that was computed from several has no step in the file
    repeats, compared = len(formulation.data), data.rows(distinct)
    if "visit_id" in formulation.data:
        count = np.unique(formulation.data["visit_id"], return_counts=True)[1]
        repeats = int((count * (count - 1) // 2).sum()) or repeats
    chance = 1.0
    for name in formulation.readings:
        column = None  # of the file, from which the reading comes, perhaps under another name
        if name in compared:
            column = compared[name] if compared[name].dtype.kind in "iuf" else None
        elif name in formulation.data:
            made = formulation.data[name]
            if made.dtype.kind in "iuf" and len(np.unique(made)) >= _TELLING:
                numbers = (other for other in compared.columns.values() if other.dtype.kind in "iuf")
                column = next((other for other in numbers if np.isin(made, other).all()), None)
        if column is not None:
            sigma = float(np.median(np.asarray(formulation.sigma[name])))
            chance *= min(1.0, step_of(column) / (2 * np.sqrt(np.pi) * sigma))
    expected = repeats * chance
    if expected < _IMPOSSIBLE:
        raise DataError(
            f"{data.name}: rows {pairs} {same}, to the last digit, which noise does not allow: copies; {way_out}"
        )
    if pdtrc(len(again) - 1, expected) > _UNLIKELY:
        text = (
            f"rows {pairs} {same}: on a coarse scale chance may do that, and so would copies, "
            "from which too small a noise is learned; leave out what was not read"
        )
        return copies, Note(Code.ROWS_EQUAL, text, rows=tuple(str(row) for row in rows[again]))
    if later:
        raise DataError(
            f"{data.name}: rows {pairs} {same}: copies, at which the times begin another day, and all after them may "
            "be of a wrong one; leave out the copies, or state times with their date"
        )
    copies[again] = True
    text = (
        f"rows {pairs} {same}: {len(again)} copies, more than the {plain(expected, 2)} that chance has, "
        "are left out, and no noise is learned from them"
    )
    labels = tuple(str(row) for row in rows[again])
    return copies, Note(Code.ROWS_COPIED, text, rows=labels, values={"expected": float(expected)})


def step_of(values: NDArray[Any]) -> float:
    """Return the step of the scale that all `values` stand on, 0 where there is none such.

    >>> round(step_of(np.array([0.012, 0.015, 0.021, 0.04])), 6), step_of(np.sqrt(np.arange(9.0)))
    (0.001, 0.0)
    """
    found = np.unique(values[np.isfinite(values)].astype(float))
    if len(found) < 3:
        return np.inf  # two values determine no scale
    gaps = np.sort(np.diff(found))[:_MOST_GAPS]
    tiny = 1e-9 * float(np.ptp(found)) + 16 * float(np.spacing(np.abs(found).max()))
    step = float(gaps[-1])
    for gap in gaps.tolist():
        while gap > tiny:  # the largest number of which both are multiples
            rest = step % gap
            step, gap = gap, rest if gap - rest > tiny else 0.0
        if step < 1e3 * tiny:
            return 0.0
    return step


def _pairs(
    data: MeasuredData, but: Collection[str], times: Collection[str]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows that equal an earlier row, and for each of them that earlier row, two arrays (m,)."""
    rows = np.arange(len(data))
    alike = np.zeros(len(data), dtype=np.int64)
    for name, column in data.columns.items():
        if name in _BOOKKEEPING or name in but:
            continue
        column = np.round(np.mod(column, _DAY), 6) if name in times else column
        own = np.unique(column, return_inverse=True)[1].reshape(-1)
        _, first, alike = np.unique(alike * (own.max() + 1) + own, return_index=True, return_inverse=True)
        alike = alike.reshape(-1)
        if len(first) == len(data):
            return rows[:0], rows[:0]
    if not alike.any():
        return rows[:0], rows[:0]
    again = rows[first[alike] != rows]
    return first[alike][again], again


def _counters(
    data: MeasuredData, rows: NDArray[np.intp], formulation: Formulation, timed: Collection[str]
) -> tuple[str, ...]:
    """Return the columns of whole numbers, or words that end in them (`R17`), that only count `rows` of the file."""
    roles = roles_of(formulation)
    known = {*columns_of(roles), *timed, *(q.name for q in description_of(data.machine).columns)}
    spoken_of = {*formulation.readings, *inputs_of(formulation), *roles.columns, roles.time}  # they may go by one a row
    counters = []
    for name in (name for name in data.columns if name not in spoken_of and name not in _BOOKKEEPING):
        column = data[name]
        if column.dtype.kind not in "iuU" or len(data) < 2:
            continue
        if column.dtype.kind == "U":  # words of one form, such as R17
            found = [word for word in map(_NUMBERED.fullmatch, column.tolist()) if word]
            if len(found) < len(data) or len({word[1] for word in found}) > 1:
                continue
            column = np.array([int(word[2]) for word in found], dtype=np.int64)
        count = column.astype(np.int64)
        steps, apart = np.diff(count), np.diff(rows)
        if name in known or not (steps > 0).all():  # what has a meaning counts the rows only where it does one by one
            counts = (steps == 1).all() and data[name].dtype.kind in "iu"
        else:
            regular = (steps == steps[0]).all() or (steps * apart[0] == steps[0] * apart).all()
            counts = regular or np.mean(steps == 1) >= _BY_ONE
        if counts:
            counters.append(name)
    return tuple(counters)
