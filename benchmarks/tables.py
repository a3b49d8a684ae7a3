"""The tables of docs/optimizers.md and docs/effects.md, made from what the adapters obey and the catalogue holds.

``python -m benchmarks.tables`` writes those of docs/optimizers.md, each between ``<!-- begin NAME -->`` and
``<!-- end NAME -->``; the words around them are written by hand. ``python -m benchmarks.tables effects`` prints those
of docs/effects.md, whose rows are put there by hand. Tests hold both pages to them.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path

from calibench.bench.report.shared.page import table
from calibench.discrepancy.model.effect import EffectFamily
from calibench.discrepancy.registries import GENERAL, machines, own_families
from calibench.discrepancy.thresholds import about
from calibench.optimizers.nlopt import ROUNDING, SETTINGS, Setting
from calibench.optimizers.pygmo import RULES
from calibench.optimizers.scipy import SETTINGS as OF_SCIPY

PAGE = Path(__file__).resolve().parents[1] / "docs" / "optimizers.md"
_EXAMPLES = ((2, 1000), (12, 5000), (20, 20_000))  # dimension, budget
_OF_EFFECTS = ("Family", "What goes wrong", "Formula", "Columns", "Unit", "Targets", "Twins")


def nlopt_table() -> str:
    """Return what each NLopt algorithm is given, a row for those that are given the same for the same reason."""
    rows = [
        [
            ", ".join(f"`{name}`" for name in setting.algorithms),
            "matters: divided" if setting.size_matters else "no effect",
            _tolerances(setting),
            setting.memory,
            setting.population,
            setting.why,
        ]
        for setting in SETTINGS
    ]
    return table(["algorithms", "the value's size", "tolerances", "memory", "population", "why"], rows)


def _tolerances(setting: Setting) -> str:
    """Return the tests that may end a search, in words."""
    tests = [f"`{name}` = {value:g}" for name, value in setting.parameters.items()]
    if setting.inner_tolerance is not None:
        tests.append(f"`local_tolerance` = {setting.inner_tolerance:g} (ftol_rel and xtol_rel of the inner method)")
    if setting.step_ends != "never":
        only = " with restarts" if setting.step_ends == "restarted" else ""
        tests.append(f"`xtol_rel` = {ROUNDING:g}{only}")
    return ", ".join(tests) if tests else "none"


def scipy_table() -> str:
    """Return what each method of SciPy is given and why."""
    rows = [
        [
            f"`{name}`",
            setting.word or f"{name}()",
            ", ".join(f"`{option}` = {value}" for option, value in setting.given.items()) or "none",
            setting.why,
        ]
        for name, setting in OF_SCIPY.items()
    ]
    return table(["scipy_", "SciPy's own", "given", "why"], rows)


def pygmo_table() -> str:
    """Return how many members the populations of each method have: its rule, and where that is from."""
    examples = [f"d = {d}, B = {budget}" for d, budget in _EXAMPLES]
    rows = [
        [
            f"`{rule.method}`",
            f"`{rule.name}`{f', at least {rule.least}' if rule.generations else ''}",
            *(str(rule.size(d, budget)) for d, budget in _EXAMPLES),
            f"{rule.source} ({rule.read})" if rule.read else rule.source,
            rule.why,
        ]
        for rule in RULES.values()
    ]
    return table(["algorithm", "members", *examples, "source", "why"], rows)


TABLES = {"scipy": scipy_table, "nlopt": nlopt_table, "pygmo": pygmo_table}


def filled(page: str) -> str:
    """Return the text of the page with its tables made anew. Raises `ValueError` where a table's marks are missing."""
    for name, make in TABLES.items():
        begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
        if begin not in page or end not in page:
            raise ValueError(f"{PAGE.name}: the marks of the table {name} are missing")
        before, _, rest = page.partition(begin)
        page = f"{before}{begin}\n{make()}\n{end}{rest.partition(end)[2]}"
    return page


def effects_table(machine: str) -> str:
    """Return the families entered for one machine as a Markdown table, a row each, in the order of their names.

    A column in which all rows agree stands above the table once; cosine and sine of one cause share a row. A general
    cause that the machine has in its own words, and without twins, is a name, its columns and targets below the table.
    """
    general = () if machine == GENERAL else {_acts(family) for family in own_families(GENERAL)}
    mine = sorted(own_families(machine), key=lambda family: family.name)
    known = [family for family in mine if _acts(family) in general and not family.twins]
    rows = _waves([_row(family) for family in mine if family not in known])
    same = [i for i in range(2, len(_OF_EFFECTS)) if len({row[i] for row in rows}) == 1 and len(rows) > 1]
    head, *shown = ([cell for i, cell in enumerate(line) if i not in same] for line in (_OF_EFFECTS, *rows))
    common = "; ".join(f"{_OF_EFFECTS[i].lower()}: {rows[0][i] or 'none'}" for i in same)
    as_there = "; ".join(f"{name} ({columns}): {targets}" for name, _, _, columns, _, targets, _ in map(_row, known))
    below = f"\n\nAs in [general](#general): {as_there}." if as_there else ""
    return (f"Of all: {common}.\n\n" if common else "") + table(head, shown) + below


def _acts(family: EffectFamily) -> tuple[str, str, int]:
    return family.name, family.channel, len(family.columns)


def bounds_table() -> str:
    """Return the sizes above which no machine has an effect: threshold, value, the families and the reason."""
    bounded: dict[str, list[str]] = {}
    for machine in (GENERAL, *machines.names()):
        for family in sorted(own_families(machine), key=lambda one: one.name):
            for bound in family.bounds:
                bounded.setdefault(bound, []).append(f"`{family.name}`")
    rows = [
        [f"{field.default:g} {field.metadata['unit']}".removesuffix(" 1"), f"`{name}`",
         ", ".join(dict.fromkeys(bounded[name])), field.metadata["meaning"]]
        for name, field in about().items() if name in bounded
    ]  # fmt: skip
    return table(["most", "threshold", "families", "why"], rows)


def _row(family: EffectFamily) -> tuple[str, ...]:
    columns = ", ".join(f"`{column}`" for column in family.columns)
    formula = f"`{family.formula}`".replace("|", "\\|")
    targets: dict[str, list[str]] = {}  # a first word that several share is said once: joint 1, 2; all
    for target in family.targets:
        first, _, rest = target.partition(" ")
        targets.setdefault(first, []).append(rest)
    grouped = "; ".join(f"{first} {', '.join(rest)}".rstrip() for first, rest in targets.items())
    return (f"`{family.name}`", family.cause, formula, columns, family.unit, grouped, family.twins or "")


def _waves(rows: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return the rows with those joined whose causes differ in nothing but an ending "(cos)" or "(sin)"."""
    groups: dict[tuple[str, ...], list[tuple[str, ...]]] = {}
    for row in rows:
        groups.setdefault((re.sub(r" \((cos|sin)\)$", "", row[1]), *row[3:]), []).append(row)
    return [
        (", ".join(row[0] for row in group), cause, ", ".join(row[2] for row in group), *others)
        for (cause, *others), group in groups.items()
    ]


if __name__ == "__main__":
    if sys.argv[1:] == ["effects"]:
        print(f"{bounds_table()}\n")
        for name in (GENERAL, *machines.names()):
            print(f"## {name}\n\n{effects_table(name)}\n")
    else:
        PAGE.write_text(filled(PAGE.read_text()))
