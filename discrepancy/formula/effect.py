"""The effect that a formula becomes, and the dozen lines with which its owner enters it into a catalogue."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np

from calibench.discrepancy.formula.grammar import LETTERS, Run, Term, formula_text
from calibench.discrepancy.model.effect import size
from calibench.discrepancy.model.machine import Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.problems.base import Array

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
            values.append((term.quantity, " * ".join(f"({one})" for one in shown)))
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
