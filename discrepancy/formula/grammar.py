"""The grammar of formulas: a sum of at most three terms, each a size times one or two shapes of columns.

A shape turns a column into numbers: powers, |u|, sign, sin and cos of any number a turn, decay in time, saturation,
dead zone, and operators with a memory of earlier rows: play (a sum of them is the hysteresis of Prandtl and
Ishlinskii), the slip of a Maxwell element, a lag of first order, and the side from which the column came. The size of a
term has the unit that makes it one of the quantity it changes. What is inside sin, tanh and exp has no unit, so the
column is divided there by a number of its own unit, which is fitted. A formula becomes an effect (`FormulaEffect`), and
the dozen lines of Python with which its owner enters it into a catalogue (`class_of`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partialmethod
from math import isfinite, nan
from typing import final

import numpy as np

from calibench.core.words import plain
from calibench.discrepancy.diagnostics.smooth_term import products
from calibench.discrepancy.model.effect import size
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import PLACE, MeasuredData
from calibench.discrepancy.model.roles import columns_of, roles_of
from calibench.problems.base import Array

MEMORY = frozenset({"play", "slip", "lag", "side"})  # shapes that depend on earlier rows
SMOOTH_NUMBERS = frozenset({"sin", "cos", "wave", "exp", "tanh", "fall", "lag"})  # numbers with a derivative everywhere


def play(u: Array, width: float) -> Array:
    """Return the play operator of `u`, (n,): it follows u, always `width` behind where u turns back."""
    at, out = float(u[0]), []
    for value in u.tolist():
        if at < value - width:
            at = value - width
        elif at > value + width:
            at = value + width
        out.append(at)
    return np.asarray(out)


def slip(u: Array, width: float) -> Array:
    """Return the stretch of a Maxwell slip element of `u`, (n,): it follows u up to `width`, and slips beyond."""
    return np.asarray(u - play(u, width))


def lag(u: Array, t: Array, tau: float) -> Array:
    """Return `u`, (n,), as it passes a lag of first order of time constant `tau`, in the unit of t."""
    out = np.empty(len(u))
    at = float(u[0])
    share = -np.expm1(-np.diff(t, prepend=t[0]) / tau)
    for k, (value, part) in enumerate(zip(u.tolist(), share.tolist())):
        at = out[k] = at + part * (value - at)
    return out


def side(u: Array, least: float) -> Array:
    """Return the way in which `u`, (n,), moved last by more than `least`: -1, 1, and 0 before it moved."""
    out, at, way = np.empty(len(u)), float(u[0]), 0.0
    for k, value in enumerate(u.tolist()):
        if abs(value - at) > least:
            way, at = (1.0 if value > at else -1.0), value
        out[k] = way
    return out


@final
@dataclass(frozen=True, eq=False)
class Run:
    """The whole run in the order of its rows, held-out ones as well: what a shape with a memory needs.

    Rows of it are told by their place; other rows are a run of their own, in the order of their time.
    """

    places: Array
    columns: Mapping[str, Array]
    clock: str = ""

    @classmethod
    def of(cls, formulation: Formulation) -> Run:
        data, roles = formulation.data, roles_of(formulation)
        names = [*formulation.readings, *(j.reading for j in roles.joints), *columns_of(roles)]
        there = {n: np.asarray(data[n], dtype=float) for n in names if n in data and data[n].dtype.kind in "iufb"}
        places = np.asarray(data[PLACE], dtype=float) if PLACE in data else np.arange(len(data), dtype=float)
        order = np.argsort(places, kind="stable")
        kept = {name: values[order] for name, values in there.items()}
        return cls(places[order], kept, roles.time if roles.time in there else "")

    def read(self, name: str, q: Quantities, data: MeasuredData) -> Array:
        """Return a column as it is recorded, (n,)."""
        value = np.asarray(q[name] if name in q else data[name]).real
        return np.broadcast_to(np.asarray(value, dtype=float), len(data))

    def remembered(
        self, operator: Callable[[Array, Array, float], Array], u: Array, name: str, data: MeasuredData, number: float
    ) -> Array:
        """Return an operator's value, of a sequence, its times and a number, at the rows whose column `name` is `u`."""
        if PLACE in data and name in self.columns:
            rows = np.searchsorted(self.places, np.asarray(data[PLACE], dtype=float))
            rows = np.minimum(rows, len(self.places) - 1)
            sequence = self.columns[name].copy()
            sequence[rows] = u
            times = self.columns[self.clock] if self.clock else self.places
            return np.asarray(operator(sequence, times, number)[rows])
        times = np.asarray(data[self.clock], dtype=float) if self.clock in data else np.arange(len(u), dtype=float)
        order, out = np.argsort(times, kind="stable"), np.empty(len(u))
        out[order] = operator(np.asarray(u)[order], times[order], number)
        return out

    play = partialmethod(remembered, lambda u, t, width: play(u, width))
    slip = partialmethod(remembered, lambda u, t, width: slip(u, width))
    lag = partialmethod(remembered, lambda u, t, tau: lag(u, t, tau))
    side = partialmethod(remembered, lambda u, t, least: side(u, least))


@final
@dataclass(frozen=True)
class Shape:
    """One way to turn a column into numbers: its value, its text, its Python, and the power of the column's unit."""

    value: Callable[[Array, float], Array]
    text: str
    code: str
    power: float = 1.0


SHAPES: Mapping[str, Shape] = {
    "u": Shape(lambda u, k: u, "{u}", "{u}"),
    "square": Shape(lambda u, k: u**2, "{u}^2", "{u}**2", 2.0),
    "cube": Shape(lambda u, k: u**3, "{u}^3", "{u}**3", 3.0),
    "abs": Shape(lambda u, k: np.abs(u), "|{u}|", "np.abs({u})"),
    "signed square": Shape(lambda u, k: u * np.abs(u), "{u} |{u}|", "{u} * np.abs({u})", 2.0),
    "root": Shape(
        lambda u, k: np.sign(u) * np.sqrt(np.abs(u)), "sign({u}) |{u}|^0.5", "np.sign({u}) * np.sqrt(np.abs({u}))", 0.5
    ),
    "sign": Shape(lambda u, k: np.sign(u), "sign({u})", "np.sign({u})", 0.0),
    "sin": Shape(lambda u, k: np.sin(k * u), "sin({k} {u})", "np.sin({k!r} * {u})", 0.0),
    "cos": Shape(lambda u, k: np.cos(k * u), "cos({k} {u})", "np.cos({k!r} * {u})", 0.0),
    "exp": Shape(lambda u, k: np.exp(-u / k), "exp(-{u} / {k})", "np.exp(-{u} / {k!r})", 0.0),
    "tanh": Shape(lambda u, k: np.tanh(u / k), "tanh({u} / {k})", "np.tanh({u} / {k!r})", 0.0),
    "fall": Shape(
        lambda u, k: np.sign(u) * np.exp(-np.abs(u) / k), "sign({u}) exp(-|{u}| / {k})",
        "np.sign({u}) * np.exp(-np.abs({u}) / {k!r})", 0.0,
    ),
    "dead": Shape(
        lambda u, k: np.sign(u) * np.maximum(np.abs(u) - k, 0.0), "dead zone({u}, {k})",
        "np.sign({u}) * np.maximum(np.abs({u}) - {k!r}, 0.0)",
    ),
    "play": Shape(lambda u, k: u, "play({u}, {k})", 'run.play({u}, {name!r}, data, {k!r})'),
    "slip": Shape(lambda u, k: u, "slip({u}, {k})", 'run.slip({u}, {name!r}, data, {k!r})'),
    "lag": Shape(lambda u, k: u, "lag({u}, {k})", 'run.lag({u}, {name!r}, data, {k!r})'),
    "side": Shape(lambda u, k: u, "side({u})", 'run.side({u}, {name!r}, data, {k!r})', 0.0),
}  # fmt: skip


@final
@dataclass(frozen=True)
class Atom:
    """A shape of a column; `number` is the one inside it, NaN for none; `origin` is taken from the column first.

    A `wave` is a sine and a cosine, each with a size of its own: of any phase.
    """

    column: str
    shape: str
    number: float = nan
    origin: float = 0.0
    unit: str = ""

    @property
    def parts(self) -> tuple[Atom, ...]:
        """Return the shapes that have a size each."""
        return (replace(self, shape="sin"), replace(self, shape="cos")) if self.shape == "wave" else (self,)

    def values(self, q: Quantities, data: MeasuredData, run: Run) -> Array:
        """Return the value of each part at each row, (n, 1 or 2)."""
        u = run.read(self.column, q, data) - self.origin
        if self.shape in MEMORY:
            operators = {"play": run.play, "slip": run.slip, "lag": run.lag, "side": run.side}
            return operators[self.shape](u, self.column, data, self.number)[:, None]
        return np.stack([SHAPES[one.shape].value(u, self.number) for one in self.parts], axis=-1)

    def text(self) -> str:
        """Return it as it is told, a wave without its phase."""
        shape, u = self.parts[0].shape, self.column
        if shape in ("sin", "cos") and self.unit == "rad":
            k = f"{self.number:.4g} " if abs(self.number - 1) > 1e-9 else ""
            return f"{shape}({k}{u})"
        if self.origin:
            u = f"({u} - {plain(self.origin, 6)})"
        if shape in ("sin", "cos"):
            period = f"{plain(2 * np.pi / self.number, 4)} {self.unit}".rstrip()
            return f"{shape}(2 pi {u} / {period})"
        unit = {"side": "", "lag": "s"}.get(self.shape, self.unit)
        k = f"{plain(self.number, 3)} {unit}".rstrip() if isfinite(self.number) else ""
        return SHAPES[shape].text.format(u=u, k=k)

    def code(self, u: str) -> str:
        """Return it as Python, of the variable `u`."""
        bare = f"({u} - {self.origin!r})" if self.origin else u
        return SHAPES[self.shape].code.format(u=bare, name=self.column, k=float(self.number))


@final
@dataclass(frozen=True)
class Term:
    """A product of one or two shapes, in the quantity that it changes; a wave in it has two sizes.

    `factor` is -1 for what is measured: there the term is what a reading has more than the model, and is taken off it.
    """

    quantity: str
    atoms: tuple[Atom, ...]
    factor: float = 1.0

    @cached_property
    def parts(self) -> tuple[tuple[Atom, ...], ...]:
        """Return the products that have a size each."""
        found: list[tuple[Atom, ...]] = [()]
        for atom in self.atoms:
            found = [(*before, part) for before in found for part in atom.parts]
        return tuple(found)

    @property
    def sizes(self) -> int:
        """Return the number of its sizes."""
        return 1 << sum(atom.shape == "wave" for atom in self.atoms)

    @property
    def structure(self) -> tuple[str, tuple[tuple[str, str], ...]]:
        """Return what two terms have in common that differ in their numbers alone."""
        return self.quantity, tuple(sorted((atom.column, atom.shape) for atom in self.atoms))

    def values(self, q: Quantities, data: MeasuredData, run: Run) -> Array:
        """Return the change of the quantity by a size of 1 of each part, (n, k)."""
        return self.factor * products(atom.values(q, data, run) for atom in self.atoms)

    def with_numbers(self, numbers: Mapping[int, float]) -> Term:
        """Return the term with other numbers inside its shapes, by the place of the shape."""
        atoms = tuple(replace(a, number=numbers.get(k, a.number)) for k, a in enumerate(self.atoms))
        return replace(self, atoms=atoms)

    def unit_of(self, unit: str) -> str:
        """Return the unit of its size; `unit` is that of the quantity."""
        powers: dict[str, float] = {}
        for atom in self.atoms:
            power = SHAPES[atom.parts[0].shape].power
            if atom.unit and atom.unit != "1" and power:
                powers[atom.unit] = powers.get(atom.unit, 0.0) + power
        below = [f"({one})" if " " in one or "/" in one else one for one in powers]
        shown = [one + (f"^{p:g}" if p != 1 else "") for one, p in zip(below, powers.values())]
        if not shown:
            return unit
        whole, _, below_it = shown[0].strip("()").rpartition("/")
        if len(shown) == 1 and whole == (unit or "1"):  # of a quantity by its rate only the time is left
            return below_it
        return f"{unit or '1'}/{shown[0] if len(shown) == 1 else '(' + ' '.join(shown) + ')'}"


LETTERS = "abcdefgh"


def formula_text(terms: tuple[Term, ...]) -> str:
    """Return a formula with letters for its sizes: `enc_2 += a sin(2 enc_1) tau_2`, or `z = model + a x y`."""
    letters, said = iter(LETTERS), []
    for quantity in dict.fromkeys(term.quantity for term in terms):
        own, sign = [], "+="
        for term in terms:
            for part in term.parts:
                if term.quantity == quantity:
                    sign = "= model +" if term.factor < 0 else sign
                    own.append(" ".join([next(letters), *(atom.text() for atom in part)]))
        said.append(f"{quantity} {sign} {' + '.join(own)}")
    return "; ".join(said)


_STEP = 1e-5  # part of a number, by which its derivative is taken


@final
@dataclass(frozen=True, eq=False)
class FormulaEffect:
    """An `Effect`: a formula. Its coefficients are the sizes, then the numbers inside that are fitted with them.

    Those numbers are told by their departure from where the search left them, in parts of it: at 0 nothing changes.
    `units` are of the sizes. `free`: (term, shape) of each number.
    """

    terms: tuple[Term, ...]
    run: Run
    size_units: tuple[str, ...]
    free: tuple[tuple[int, int], ...] = ()
    family: str = "formula"
    target: str = "all"
    channel: str = "reading"
    twins: tuple[str, ...] = ()
    positions: int = 1
    formula: str = field(init=False)
    columns: tuple[str, ...] = field(init=False)
    coefficients: tuple[str, ...] = field(init=False)
    units: tuple[str, ...] = field(init=False)
    unit: str = field(init=False)

    def __post_init__(self) -> None:
        columns = dict.fromkeys(atom.column for term in self.terms for atom in term.atoms)
        numbers = tuple(f"number of {self.terms[i].atoms[j].text()}" for i, j in self.free)
        vars(self).update(
            formula=formula_text(self.terms), columns=tuple(columns), unit=self.size_units[0],
            coefficients=(*LETTERS[: len(self.size_units)], *numbers),
            units=(*self.size_units, *("1",) * len(numbers)),
        )  # fmt: skip

    def shift(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        found: dict[str, Array] = {}
        at = 0
        for term in self.at(c):
            value = term.values(q, data, self.run)
            change = value @ c[at : at + value.shape[1]]
            found[term.quantity] = found.get(term.quantity, np.zeros(len(data))) + change
            at += value.shape[1]
        return found

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        k, terms, at = len(self.size_units), self.at(c), 0
        found = {term.quantity: np.zeros((len(data), len(self.coefficients))) for term in terms}
        for i, term in enumerate(terms):
            value = term.values(q, data, self.run)
            own = slice(at, at + value.shape[1])
            found[term.quantity][:, own] = value
            for place, (of, atom) in enumerate(self.free):
                if of == i and np.any(c[own]):
                    start = self.terms[i].atoms[atom].number
                    number = term.atoms[atom].number
                    sides = [term.with_numbers({atom: number + s * _STEP * start}) for s in (1, -1)]
                    up, down = (one.values(q, data, self.run) @ c[own] for one in sides)
                    found[term.quantity][:, k + place] = (up - down) / (2 * _STEP)
            at += value.shape[1]
        return found

    def amplitude(self, c: Array) -> float:
        return size(np.asarray(c)[:1])

    def at(self, c: Array) -> tuple[Term, ...]:
        """Return the terms with the numbers of coefficients `c`."""
        moved: dict[int, dict[int, float]] = {}
        for (i, j), part in zip(self.free, c[len(self.size_units) :]):
            start = self.terms[i].atoms[j].number
            moved.setdefault(i, {})[j] = start * (1 + max(float(part), -0.9))
        return tuple(term.with_numbers(moved.get(i, {})) for i, term in enumerate(self.terms))


def class_of(terms: Sequence[Term], units: Sequence[str], machine: str) -> str:
    """Return the Python that enters the formula, with the numbers inside it as they are, into a machine's catalogue."""
    columns = list(dict.fromkeys(atom.column for term in terms for atom in term.atoms))
    variables = [name if name.isidentifier() else f"u{k}" for k, name in enumerate(columns)]
    values: list[tuple[str, str]] = []
    for term in terms:
        for part in term.parts:
            shown = [atom.code(variables[columns.index(atom.column)]) for atom in part]
            values.append((term.quantity, "-" * (term.factor < 0) + " * ".join(f"({one})" for one in shown)))
    rows = []
    for quantity in dict.fromkeys(name for name, _ in values):
        own = ", ".join(code if name == quantity else "0 * " + variables[0] for name, code in values)
        rows.append(f"{quantity!r}: np.stack([{own}], axis=-1)")
    sizes = ", ".join(f'"{letter}": {unit!r}' for letter, unit in zip(LETTERS, units))
    read = ", ".join(f"run.read({name!r}, q, data)" for name in columns)
    listed = ", ".join(map(repr, columns)) + ","
    return f"""import numpy as np
from calibench.discrepancy import EffectFamily, needs
from calibench.discrepancy.formula import Run


def build(formulation, target):
    needs(formulation.data, {listed.rstrip(",")})
    run = Run.of(formulation)

    def changes(q, data):
        {", ".join(variables)}{"," * (len(variables) == 1)} = {read}{"," * (len(variables) == 1)}
        return {{{", ".join(rows)}}}

    return (family.linear(target, ({listed}), {{{sizes}}}, changes),)


family = EffectFamily(
    "found_formula", {machine!r}, "What the formula says", {formula_text(tuple(terms))!r}, "reading",
    ({listed}), {units[0]!r}, ("machine",), build,
).enter()
"""
