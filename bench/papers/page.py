"""The ledger as one page that needs nothing else: counts, findings in sentences, and a table for each printed table.

A verdict has a mark and a word besides its colour, so it reads in black and white and to the colour-blind.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from math import isfinite
from pathlib import Path

from calibench.bench.execution.provenance import provenance
from calibench.bench.papers.row import KINDS, VERDICTS, Row
from calibench.bench.report.shared.page import STYLE, whole_page
from calibench.problems.constants import document

_WIDE = ".rows{min-width:66rem}"  # on a small screen the table scrolls, rather than to squeeze its words into a column
_MARKS = {
    "reproduced": ("✓", "ok"),
    "reproduced in kind": ("≈", "kind"),
    "misprint, corrected": ("✎", "misprint"),
    "artefact of the stopping tolerance": ("◐", "kind"),
    "depends on the release": ("⇄", "kind"),
    "not reproduced": ("✗", "no"),
    "open at this budget": ("…", "open"),
    "not checkable": ("?", "open"),
}
NONE = "–"
KINDS_TOLD = (
    "Input: the paper is given it. Setting: it chooses it. Result: it finds it. Claim: a sentence. Erratum: a slip of "
    "the print. An input that is reproduced agrees with another print of itself, or with what follows from it."
)
_MEANINGS = {
    "reproduced": "ours agrees to what is printed, or the sentence holds by its rule",
    "reproduced in kind": "not to the digit: order, decade or bound agree, by a tolerance that is stated",
    "misprint, corrected": "the print is wrong, and the computation gives what to read",
    "artefact of the stopping tolerance": "it holds with every absolute stop of fmincon and not with a relative one",
    "depends on the release": "it turns with what changed between releases of fmincon, and the release is not printed",
    "not reproduced": "the computation contradicts the print",
    "open at this budget": "a search that is said of more evaluations than were made here",
    "not checkable": "what it takes is not published",
}


def write_page(rows: Sequence[Row], budget: str, path: Path) -> Path:
    """Write the page and return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page(rows, budget), encoding="utf-8")
    return path


def page(rows: Sequence[Row], budget: str) -> str:
    """Return the page's HTML: no script, and nothing fetched from anywhere."""
    parts = [
        f"<p class=why>{len(rows)} rows, budget {escape(budget)}, commit"
        f" {provenance()['git_commit'][:10] or 'unknown'}. Every verdict is a function of the numbers beside it.</p>",
        _counts(rows),
        _by_kind(rows),
    ]
    for paper in dict.fromkeys(row.paper for row in rows):
        mine = [row for row in rows if row.paper == paper]
        about = document(paper)["paper"]
        parts.append(f"<h2>{escape(about['title'])}</h2><p>{escape(', '.join(about['authors']))}, {about['year']}</p>")
        parts.append(_tally(mine))
        parts.append(_findings([row for row in mine if row.kind == "claim"]))
        for title, group in _groups(mine).items():
            parts.append(f"<h2>{escape(title)}</h2>{_tally(group)}{_table(group)}")
    heading = "Ledger: what the papers print, and what a rerun gives"
    return whole_page("Ledger", f"{STYLE}{_WIDE}", heading, *parts)


def tag(verdict: str) -> str:
    """Return a verdict with its mark, word and colour."""
    mark, style = _MARKS[verdict]
    return f'<span class="v {style}">{mark} {escape(verdict)}</span>'


def number(value: float, digits: int = 7) -> str:
    """Return a number as the page and the terminal show it; a dash where there is none.

    >>> number(243.5), number(3.5946e-20), number(float("nan"))
    ('243.5', '3.5946e-20', '–')
    """
    return f"{value:.{digits}g}" if isfinite(value) else "–"


def _counts(rows: Sequence[Row]) -> str:
    bar, lines = [], []
    for verdict in VERDICTS:
        count = sum(row.verdict == verdict for row in rows)
        mark, style = _MARKS[verdict]
        if count:
            bar.append(f'<span class="{style}" style="flex:{count}" title="{escape(verdict)}">{mark} {count}</span>')
        lines.append(f"<tr><td>{tag(verdict)}</td><td class=n>{count}</td><td>{_MEANINGS[verdict]}</td></tr>")
    return f"<div class=bar>{''.join(bar)}</div><table>{''.join(lines)}</table>"


def _by_kind(rows: Sequence[Row]) -> str:
    """Return how many rows of each kind have each verdict: a given number that agrees with itself is no finding."""
    heads = "".join(f"<th>{escape(kind)}</th>" for kind in KINDS)
    lines = "".join(
        f"<tr><td>{tag(verdict)}</td>{''.join(f'<td class=n>{count or NONE}</td>' for count in counts.values())}</tr>"
        for verdict, counts in by_kind(rows).items()
    )
    return f"<table><tr><th></th>{heads}</tr>{lines}</table><p class=why>{escape(KINDS_TOLD)}</p>"


def by_kind(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Return verdict -> kind -> number of rows."""
    return {v: {k: sum(row.verdict == v and row.kind == k for row in rows) for k in KINDS} for v in VERDICTS}


def _findings(claims: Sequence[Row]) -> str:
    """Return the claims as sentences, what does not hold first."""
    parts = ["<h2>Findings</h2>"]
    for verdict, title in (
        ("not reproduced", "Said or implied, and does not hold"),
        ("artefact of the stopping tolerance", "Holds by the stopping tolerance"),
        ("depends on the release", "Depends on the release of fmincon"),
        ("reproduced in kind", "Holds in kind"),
        ("reproduced", "Holds"),
        ("misprint, corrected", "Misprinted"),
        ("open at this budget", "Open at this budget"),
        ("not checkable", "Open"),
    ):
        mine = [row for row in claims if row.verdict == verdict]
        if not mine:
            continue
        items = "".join(f"<li>{tag(row.verdict)} {_sentence(row)}</li>" for row in mine)
        shown = " open" if verdict == "not reproduced" else ""
        parts.append(f"<details{shown}><summary><b>{title}</b> ({len(mine)})</summary><ul>{items}</ul></details>")
    return "".join(parts)


def _sentence(row: Row) -> str:
    unit = "" if row.unit == "1" else f" {row.unit}"
    said = f"printed {number(row.printed)}{unit}, " if isfinite(row.printed) else ""
    text = f"“{row.quantity}” ({row.place}). {row.method}: {said}ours {number(row.ours_median, 4)}{unit}."
    return escape(text) + (f" <span class=why>{escape(row.reason)}.</span>" if row.reason else "")


def _groups(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the rows by printed table, then by passage, claims and errata."""
    tables: dict[str, list[Row]] = {}
    others: dict[str, list[Row]] = {}
    for row in rows:
        head = row.key.partition(".")[0]
        if head.startswith("table"):
            tables.setdefault(f"Table {head.removeprefix('table')}", []).append(row)
        else:
            title = {"claim": "Claims", "erratum": "Errata", "geometry": "Geometry", "text": "Figures and text"}
            if head.startswith("equation"):
                title[head] = f"Equation ({head.removeprefix('equation')})"
            name = title.get(head, f"Section {'.'.join(head.removeprefix('section'))}")
            others.setdefault(name, []).append(row)
    return dict(sorted(tables.items())) | others


def _tally(rows: Sequence[Row]) -> str:
    said = [f"{n} {v}" for v in VERDICTS if (n := sum(row.verdict == v for row in rows))]
    return f"<p class=why>{len(rows)} rows: {escape('; '.join(said))}</p>"


def _table(rows: Sequence[Row]) -> str:
    heads = (
        "where",
        "kind",
        "quantity",
        "printed",
        "read",
        "ours",
        "quartiles",
        "n",
        "within",
        "verdict",
        "why and how",
    )
    body = "".join(_line(row) for row in rows)
    return f"<div class=scroll><table class=rows><tr>{''.join(f'<th>{h}</th>' for h in heads)}</tr>{body}</table></div>"


def _line(row: Row) -> str:
    read = number(row.read) if row.read != row.printed and isfinite(row.read) else ""
    spread = f"{row.ours_q1:.4g} .. {row.ours_q3:.4g}" if row.n > 1 else ""
    side = "" if row.rule == "near" else f"{row.rule} "
    within = f"{side}{row.tolerance:.2g}" if isfinite(row.tolerance) else ""
    if isfinite(row.tolerance_in_kind):
        decades = " decades" if row.tolerance_in_decades else ""
        within += f"; in kind {side}{row.tolerance_in_kind:.2g}{decades}"
    unit = "" if row.unit == "1" else f" [{row.unit}]"
    cells = [escape(row.place.replace("column ", "")), row.kind, escape(row.quantity + unit)]
    numbers = [number(row.printed), read, number(row.ours_median), spread, str(row.n)]
    why = (
        escape(row.reason)
        + (" " if row.reason else "")
        + (f"<i>Otherwise than {escape(row.about)}: {escape(row.differs)}.</i> " if row.differs else "")
        + f"<small>{escape(row.method)}. {escape(row.why_tolerance)}.</small>"
    )
    return (
        f"<tr>{''.join(f'<td>{c}</td>' for c in cells)}{''.join(f'<td class=n>{c}</td>' for c in numbers)}"
        f"<td>{within}</td><td>{tag(row.verdict)}</td><td>{why}</td></tr>"
    )
