"""The tables of a verdict's page: the set of each finding, and the calibrated parameters.

Each is a function from plain values, as the report has them, to HTML. On a small screen a row becomes a block of lines
with the heads of its columns, so that nothing is cut off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from math import isfinite
from typing import Any

from bench.discovery.page.words import effect_words, parameter_words, size_of


def set_table(findings: Sequence[Mapping[str, Any]], causes: Mapping[str, tuple[str, str]]) -> str:
    """Return the members of the sets of all findings, the most likely first; empty without findings.

    The first of a set has the finding's size and gain.
    """
    rows = [_rival(f, rival, causes) for f in findings for rival in _ranked(f)]
    return table_of(("effect", "what it is", "size", "weight", "gain"), rows, "wide", right=("weight", "gain"))


def parameter_table(parameters: Mapping[str, Mapping[str, Any]], units: Mapping[str, str], moved: bool) -> str:
    """Return the parameters before, after and how far they moved; where nothing was added, their values."""
    heads = ("before", "after", "standard error", "moved", "in standard errors") if moved else (
        "value", "standard error")  # fmt: skip
    rows = [_parameter(name, units.get(name, ""), p, moved) for name, p in parameters.items()]
    return table_of(("parameter", *heads), rows, "fit", right=heads)


def _rival(finding: Mapping[str, Any], rival: Mapping[str, Any], causes: Mapping[str, tuple[str, str]]) -> list[str]:
    first = (rival.get("family"), rival.get("target")) == (finding.get("family"), finding.get("target"))
    cause, formula = causes.get(str(rival.get("family")), ("", ""))
    name = f"{'●' if first else '◐'} {escape(effect_words(str(rival.get('family')), str(rival.get('target'))))}"
    weight = rival.get("weight")
    return [
        f"<b>{name}</b>" if first else name,
        f"{escape(cause)}{f'<br><small>{escape(formula)}</small>' if formula else ''}",
        escape(size_of(finding)) if first else "",
        "" if weight is None else f"{100 * weight:.0f} %",
        _gain(finding) if first else "",
    ]


def _ranked(finding: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    rivals = finding.get("set") or [finding]
    return sorted(rivals, key=lambda rival: -(rival.get("weight") or 0.0))


def _gain(finding: Mapping[str, Any]) -> str:
    gain = finding.get("gain")
    return "–" if gain is None or not isfinite(gain) else f"{gain:.0f}" if abs(gain) >= 20 else f"{gain:.1f}"


def _parameter(name: str, unit: str, p: Mapping[str, Any], moves: bool) -> list[str]:
    before, after, sd = (p.get(key) for key in ("before", "after", "sd"))
    words = f" <small>{escape(parameter_words(name))}</small>" if parameter_words(name) else ""
    told = f"{escape(name)}{f' [{escape(unit)}]' if unit else ''}{words}"
    error = "–" if sd is None or not isfinite(sd) else f"{sd:#.2g}".rstrip(".")
    if not moves:
        return [told, _fixed(before, sd), error]
    moved = None if before is None or after is None else after - before
    in_sd = moved / sd if moved is not None and sd else None
    shift, far = _fixed(moved, sd, "+"), in_sd is not None and abs(in_sd) > 2
    return [
        told, _fixed(before, sd), _fixed(after, sd), error, f"<b>{shift}</b>" if far else shift,
        "" if in_sd is None else _unsigned_zero(f"{in_sd:+.1f}"),
    ]  # fmt: skip


def _fixed(value: float | None, sd: float | None, sign: str = "") -> str:
    """Return a value with the digits its standard error allows, and one more."""
    if value is None or not isfinite(value):
        return "–"
    places = 6
    if sd and isfinite(sd):
        places = next((k for k in range(9) if sd * 10**k >= 3), 9)
    return _unsigned_zero(f"{value:{sign}.{places}f}")


def _unsigned_zero(number: str) -> str:
    return number.lstrip("+-") if not number.strip("+-0.") else number


def table_of(heads: Sequence[str], rows: Sequence[Sequence[str]], kind: str, right: Sequence[str] = ()) -> str:
    """Return a table of cells that are HTML; each cell knows its head, for a screen too small for columns."""
    if not rows:
        return ""
    side = ["n" if head in right else "" for head in heads]
    top = "".join(f"<th{f' class={s}' if s else ''}>{head}</th>" for head, s in zip(heads, side))
    body = "".join(
        f"<tr>{''.join(_cell(cell, head, s) for cell, head, s in zip(row, heads, side))}</tr>" for row in rows
    )
    return f"<div class=scroll><table class={kind}><tr>{top}</tr>{body}</table></div>"


def _cell(cell: str, head: str, side: str) -> str:
    return f"<td{f' class={side}' if side else ''} data-head='{head}'>{cell}</td>"
