"""`Roles`: the parts of a machine, so that the search for errors does not depend on the names of its columns.

A machine declares its joints, its lengths, its clock, its thermometer, its instruments and its further columns. The
general families of effects ask only for roles, so a machine is searched for the errors of the parts that it has.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Literal, TypeVar, final

import numpy as np

from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured import DataError

ALL = "all"  # the target that is every part of one role together
RATE = "rate of "  # before a column: its derivative in time


@final
@dataclass(frozen=True)
class Joint:
    """A driven joint: `reading` is the quantity that says where it stands, in `unit`; the others are columns.

    `kind` is rotary (a reading in rad repeats with its turn) or sliding. `direction` says which way it moved last
    (-1, 1), `velocity` and `torque` (of a sliding joint its force) what it met, `temperature` that of its own. `teeth`
    is how often an error of its gear repeats in a turn, of a sliding joint `period` the length it repeats with: a
    number, 0 for unknown. `label` is what it is in words, its name where none is given. `told` is the unit in which its
    errors are told (arcsec), that of the reading where none is given.
    """

    name: str
    reading: str
    kind: Literal["rotary", "sliding"] = "rotary"
    unit: str = ""
    direction: str = ""
    velocity: str = ""
    torque: str = ""
    temperature: str = ""
    teeth: float = 0.0
    period: float = 0.0
    label: str = ""
    told: str = ""

    def __post_init__(self) -> None:
        if self.kind not in ("rotary", "sliding"):
            raise DataError(f"{self.name}: kind {self.kind!r}: rotary or sliding")
        for key, number in (("teeth", self.teeth), ("period", self.period)):
            if not (isinstance(number, int | float) and 0 <= number < inf):
                raise DataError(f"{self.name}: {key} {number!r}: a number above 0, or 0 for unknown, is needed")
        if not self.unit:
            object.__setattr__(self, "unit", "rad" if self.kind == "rotary" else "mm")


@final
@dataclass(frozen=True)
class Length:
    """A member whose length is the number `quantity`, in `unit`; `temperature` and `force` (tension) are columns."""

    name: str
    quantity: str
    temperature: str = ""
    force: str = ""
    unit: str = "mm"
    label: str = ""


@final
@dataclass(frozen=True)
class Instrument:
    """An outside measurement: its measured `columns`, and the columns of their velocities where there are any.

    `frame`: the columns are coordinates of one frame that may move during the run. `span` [s] is that of a trial
    where it is a process whose own time tells how late a reading may be.
    """

    name: str
    columns: tuple[str, ...]
    velocity: tuple[str, ...] = ()
    frame: bool = True
    label: str = ""
    span: float = 0.0

    def __post_init__(self) -> None:
        refuse_word(f"{self.name}: columns", self.columns)
        refuse_word(f"{self.name}: velocity", self.velocity)
        if self.velocity and len(self.velocity) != len(self.columns):
            raise DataError(f"{self.name}: a velocity for each of {', '.join(self.columns)}, or none")


_Part = TypeVar("_Part", bound="Joint | Length | Instrument")


@final
@dataclass(frozen=True)
class Roles:
    """What a machine is made of. `time` [s] and `temperature` [K] are columns of all readings, "" where there are none.

    `columns` are further columns that an error may follow, as a polynomial or in cycles. `parameters` are numbers of
    the machine that may be others in other readings: over a column, a temperature or the time.
    Raises `DataError` where two parts have one name.
    """

    joints: tuple[Joint, ...] = ()
    lengths: tuple[Length, ...] = ()
    time: str = ""
    temperature: str = ""
    instruments: tuple[Instrument, ...] = ()
    columns: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for argument, given in (("joints", self.joints), ("lengths", self.lengths), ("instruments", self.instruments)):
            if not isinstance(given, tuple | list):
                raise DataError(
                    f"roles: {argument} is one {type(given).__name__}; a tuple is needed: {argument}=(..., )"
                )
        refuse_word("roles: columns", self.columns)
        refuse_word("roles: parameters", self.parameters)
        parts: tuple[Joint | Length | Instrument, ...] = (*self.joints, *self.lengths, *self.instruments)
        names = [ALL, *(part.name for part in parts)]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise DataError(f"roles: {', '.join(twice)} twice; each part has a name of its own, none is called {ALL!r}")

    def __or__(self, other: Roles) -> Roles:
        """Return the parts of both, those of one name once."""
        return Roles(
            _union(self.joints, other.joints), _union(self.lengths, other.lengths), self.time or other.time,
            self.temperature or other.temperature, _union(self.instruments, other.instruments),
            tuple(dict.fromkeys((*self.columns, *other.columns))),
            tuple(dict.fromkeys((*self.parameters, *other.parameters))),
        )  # fmt: skip

    def refuse_unknown(self, formulation: Formulation) -> None:
        """Raise `DataError` for a quantity that the formulation does not have."""
        read = {*formulation.readings, *inputs_of(formulation)}
        numbers = {*(p.name for p in formulation.parameters), *formulation.fixed}
        asked = [(one.name, one.reading, read, "reading or input") for one in self.joints]
        asked += [(one.name, one.quantity, numbers, "parameter or held number") for one in self.lengths]
        asked += [("parameters", name, numbers, "parameter or held number") for name in self.parameters]
        measured = {*formulation.readings}
        asked += [(one.name, name, measured, "measured column") for one in self.instruments for name in one.columns]
        for part, name, known, what in asked:
            if known is measured and name in inputs_of(formulation):
                raise DataError(
                    f"{part}: {name!r} is no measured column but an input, which is taken to be exact; a machine whose "
                    "instrument reads its inputs is stated by Constraints"
                )
            if name not in known:
                raise DataError(f"{part}: {name!r} is no {what}; there are {', '.join(sorted(known)) or 'none'}")


def refuse_word(argument: str, names: object) -> None:
    """Raise `DataError` for a word in the place of a tuple of words: its letters would be taken for names."""
    if isinstance(names, str):
        raise DataError(f"{argument}: {names!r} is one word; a tuple of columns is needed: ({names!r},)")


def roles_of(formulation: Formulation) -> Roles:
    """Return the roles that a formulation declares; empty roles where it declares none."""
    roles = getattr(formulation, "roles", None)
    return roles if isinstance(roles, Roles) else Roles()


def columns_of(roles: Roles) -> tuple[str, ...]:
    """Return the columns that an error may follow: time, temperature, what each part met, and the further ones."""
    named = [roles.time, roles.temperature]
    for joint in roles.joints:
        named += [joint.direction, joint.velocity, joint.torque, joint.temperature]
    for length in roles.lengths:
        named += [length.temperature, length.force]
    for one in roles.instruments:
        named += one.velocity
    return tuple(dict.fromkeys(name for name in (*named, *roles.columns) if name))


def drifts_of(roles: Roles) -> tuple[str, ...]:
    """Return the columns over which a parameter may be another one: no part of the machine is read by them."""
    return tuple(dict.fromkeys(c for c in (*roles.columns, roles.temperature, roles.time) if c))


def is_clock(column: str, formulation: Formulation) -> bool:
    """Return whether a column tells when in its run a row was read: time that goes on, or a number that counts rows."""
    data = formulation.data
    if column not in data or column == roles_of(formulation).time:
        return column in data
    u = np.asarray(data[column])
    counts = u.dtype.kind in "iuf" and not np.ptp(u - data.row_numbers)
    return bool(counts or (data.units.get(column) == "s" and np.all(np.diff(u) > 0)))


def words_of(roles: Roles) -> dict[str, str]:
    """Return column or quantity -> its name in words, by the roles: `direction of joint 2`."""
    meanings = {roles.time: "time", roles.temperature: "temperature"}
    speeds = {True: "rate", False: "velocity"}  # of a column that was computed it is the word of its name
    for joint in roles.joints:
        rotary = joint.kind == "rotary"
        each = {joint.reading: "angle" if rotary else "position", joint.direction: "direction",
                joint.velocity: speeds[joint.velocity.startswith(RATE)], joint.torque: "torque" if rotary else "force",
                joint.temperature: "temperature"}  # fmt: skip
        each.pop(joint.name, None)  # a joint that is called as its column needs no words
        of = joint.label or joint.name
        meanings |= {name: f"{word} of {of}" for name, word in each.items() if name not in meanings}
    for length in roles.lengths:
        each = {length.quantity: "length of", length.force: "force along", length.temperature: "temperature of"}
        member = length.label or length.name
        meanings |= {name: f"{word} {member}" for name, word in each.items() if name not in meanings}
    for one in roles.instruments:
        for name, column in zip(one.velocity, one.columns):
            meanings.setdefault(name, f"{speeds[name.startswith(RATE)]} of {column}")
    return {name: words for name, words in meanings.items() if name}


def inputs_of(formulation: Formulation) -> tuple[str, ...]:
    """Return the columns of a formulation that are quantities without noise; () where it states none."""
    return tuple(getattr(formulation, "inputs", ()))


def unknown_noise_of(formulation: Formulation) -> tuple[str, ...]:
    """Return the readings whose `sigma` is an estimate from their own residuals; () where all noise is stated."""
    return tuple(getattr(formulation, "unknown_noise", ()))


def _union(some: tuple[_Part, ...], others: tuple[_Part, ...]) -> tuple[_Part, ...]:
    own = {part.name for part in some}
    return some + tuple(part for part in others if part.name not in own)
