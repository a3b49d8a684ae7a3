"""The tables of a verdict's page: the set of each finding, and the calibrated parameters.

On a small screen a row becomes a block of lines with the heads of its columns, so that nothing is cut off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

from calibench.bench.discovery.page.words import FEW_NAMES, amplitude_words, by_weight, coefficients_of, size_of
from calibench.bench.report.shared.page import Head, Table
from calibench.bench.report.shared.templating import macros
from calibench.core.counted import plain
from calibench.discrepancy.labels import effect_label, quantity_of
from calibench.discrepancy.report import Finding, ParameterChange, Report, Rival


def set_table(report: Report, causes: Mapping[str, tuple[str, str]]) -> Table:
    """Return the shortlists of all findings, the most likely first; no row without findings.

    The first of a list has the finding's size and coefficients; where a list has many members, each has its weight.
    `causes` are family -> what it is in words, and its formula.
    """
    rows = [_rival(report.machine, f, rival, causes) for f in report.findings for rival in _ranked(f)]
    if not any(len(f.set) > FEW_NAMES for f in report.findings):
        return table_of(("effect", "what it is", "size"), rows, "wide")
    weights = [_weight(rival) for f in report.findings for rival in _ranked(f)]
    weighted = [[row[0], weight, *row[1:]] for row, weight in zip(rows, weights, strict=True)]
    return table_of(("effect", "weight", "what it is", "size"), weighted, "wide", right=("weight",))


def score_table(report: Report) -> Table:
    """Return the decisive numbers: the weight of each member of a shortlist, and the gain of its first."""
    rows = [
        [
            effect_label(report.machine, rival.family, rival.target),
            _weight(rival),
            _gain(f.gain) if (rival.family, rival.target) == (f.family, f.target) else "",
        ]
        for f in report.findings
        for rival in _ranked(f)
    ]
    return table_of(("effect", "weight", "gain"), rows, "fit", right=("weight", "gain"))


def parameter_table(report: Report, units: Mapping[str, str], moved: bool) -> Table:
    """Return the parameters before, after and how far they moved; where nothing was added, their values."""
    heads = ("before", "after", "standard error", "moved", "in standard errors") if moved else (
        "value", "standard error")  # fmt: skip
    rows = [_parameter(report.machine, name, units.get(name, ""), p, moved) for name, p in report.parameters.items()]
    return table_of(("parameter", *heads), rows, "fit", right=heads)


def _rival(machine: str, finding: Finding, rival: Rival, causes: Mapping[str, tuple[str, str]]) -> list[str]:
    first = (rival.family, rival.target) == (finding.family, finding.target)
    cause, formula = causes.get(rival.family, ("", ""))
    name = f"{'●' if first else '◐'} {effect_label(machine, rival.family, rival.target)}"
    return [
        _cell().strong(name) if first else name,
        _cell().cause(cause, formula),
        _cell().cause(size_of(finding), coefficients_of(finding)) if first else _size_if_it(rival),
    ]


def _size_if_it(rival: Rival) -> str:
    told = "" if rival.amplitude is None else amplitude_words(rival.amplitude)
    return f"{told} if it is this" if told else ""


def _cell() -> Any:
    """Return the macros of cells that are more than text."""
    return macros("discovery/page/templates/cells.html.j2")


def _ranked(finding: Finding) -> list[Rival]:
    rivals = finding.set or (Rival(finding.effect, finding.family, finding.target, 1.0),)
    return by_weight(rivals)


def _weight(rival: Rival) -> str:
    return f"{100 * rival.weight:.0f} %" if isfinite(rival.weight) else ""


def _gain(gain: float) -> str:
    return "–" if not isfinite(gain) else f"{gain:.0f}" if abs(gain) >= 20 else f"{gain:.1f}"


def _parameter(machine: str, name: str, unit: str, p: ParameterChange, moves: bool) -> list[str]:
    told = _cell().parameter(f"{name} [{unit}]" if unit else name, quantity_of(machine, name).label)
    error = "–" if not isfinite(p.sd) else plain(p.sd, 2) if p.sd >= 10 else f"{p.sd:#.2g}"
    if not moves:
        return [told, _fixed(p.before, p.sd), error]
    moved = p.after - p.before
    in_sd = moved / p.sd if isfinite(moved) and isfinite(p.sd) and p.sd else None
    shift, far = _fixed(moved, p.sd, "+"), in_sd is not None and abs(in_sd) > 2
    return [
        told, _fixed(p.before, p.sd), _fixed(p.after, p.sd), error, _cell().strong(shift) if far else shift,
        "" if in_sd is None else _unsigned_zero(f"{in_sd:+.1f}"),
    ]  # fmt: skip


def _fixed(value: float, sd: float, sign: str = "") -> str:
    """Return a value with the digits its standard error allows, and one more."""
    if not isfinite(value):
        return "–"
    places = 6
    if sd and isfinite(sd):
        places = next((k for k in range(9) if sd * 10**k >= 3), 9)
    return _unsigned_zero(f"{value:{sign}.{places}f}")


def _unsigned_zero(number: str) -> str:
    return number.lstrip("+-") if not number.strip("+-0.") else number


def table_of(heads: Sequence[str], rows: Sequence[Sequence[str]], kind: str, right: Sequence[str] = ()) -> Table:
    """Return the table of these cells, with the numbers to the `right`; on a small screen a row is a block of lines."""
    return Table([Head(head, "n" if head in right else "") for head in heads], rows, kind, blocks=True)
