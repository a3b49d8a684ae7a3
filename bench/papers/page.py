"""The ledger as one page that needs nothing else: counts, findings in sentences, and a table for each printed table.

A verdict has a mark and a word besides its colour, so it reads in black and white and to the colour-blind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, final

from calibench.bench.papers.row import KINDS, VERDICTS, Row, Verdict
from calibench.bench.provenance.environment import provenance
from calibench.bench.report.shared.page import Head, Table
from calibench.bench.report.shared.templating import macros, render
from calibench.problems.constants import document

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
_CLAIMS: dict[Verdict, str] = {
    "not reproduced": "Said or implied, and does not hold",
    "artefact of the stopping tolerance": "Holds by the stopping tolerance",
    "depends on the release": "Depends on the release of fmincon",
    "reproduced in kind": "Holds in kind",
    "reproduced": "Holds",
    "misprint, corrected": "Misprinted",
    "open at this budget": "Open at this budget",
    "not checkable": "Open",
}
_HEADS = [
    *(Head(title) for title in ("where", "kind", "quantity")),
    *(Head(title, "n") for title in ("printed", "read", "ours", "quartiles", "n")),
    *(Head(title) for title in ("within", "verdict", "why and how")),
]
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
    return render(
        "papers/templates/ledger.html.j2",
        title="Ledger",
        size=len(rows),
        budget=budget,
        commit=provenance()["git_commit"][:10] or "unknown",
        verdicts=[_Tag(verdict, sum(row.verdict == verdict for row in rows)) for verdict in VERDICTS],
        kinds=_by_kind(rows),
        kinds_told=KINDS_TOLD,
        papers=[_paper(key, [row for row in rows if row.paper == key]) for key in dict.fromkeys(r.paper for r in rows)],
    )


@final
@dataclass(frozen=True)
class _Tag:
    """A verdict with its mark, colour and meaning, and how many rows have it."""

    verdict: Verdict
    count: int = 0

    @property
    def mark(self) -> str:
        return _MARKS[self.verdict][0]

    @property
    def style(self) -> str:
        return _MARKS[self.verdict][1]

    @property
    def meaning(self) -> str:
        return _MEANINGS[self.verdict]


@final
@dataclass(frozen=True)
class _Group:
    """Rows that stand together, under a title."""

    title: str
    rows: Sequence[Row]

    @property
    def size(self) -> int:
        return len(self.rows)

    @property
    def tally(self) -> str:
        return "; ".join(f"{n} {v}" for v in VERDICTS if (n := sum(row.verdict == v for row in self.rows)))

    @property
    def table(self) -> Table:
        return Table(_HEADS, [_cells(row) for row in self.rows], kind="rows")


@final
@dataclass(frozen=True)
class _Finding:
    """The claims of one verdict, as sentences."""

    verdict: _Tag
    title: str
    claims: Sequence[_Claim]
    open: bool


@final
@dataclass(frozen=True)
class _Claim:
    told: str
    reason: str


@final
@dataclass(frozen=True)
class _Paper:
    """The part of one paper."""

    title: str
    authors: str
    year: int
    all: _Group
    findings: Sequence[_Finding]
    groups: Sequence[_Group]


def _paper(key: str, rows: Sequence[Row]) -> _Paper:
    about = document(key)["paper"]
    return _Paper(
        about["title"],
        ", ".join(about["authors"]),
        about["year"],
        _Group("", rows),
        _findings([row for row in rows if row.kind == "claim"]),
        [_Group(title, group) for title, group in _groups(rows).items()],
    )


def number(value: float, digits: int = 7) -> str:
    """Return a number as the page and the terminal show it; a dash where there is none.

    >>> number(243.5), number(3.5946e-20), number(float("nan"))
    ('243.5', '3.5946e-20', '–')
    """
    return f"{value:.{digits}g}" if isfinite(value) else "–"


def _cell() -> Any:
    """Return the macros of cells that are more than text."""
    return macros("papers/templates/cells.html.j2")


def _by_kind(rows: Sequence[Row]) -> Table:
    """Return how many rows of each kind have each verdict: a given number that agrees with itself is no finding."""
    lines = [
        [_cell().tag(_Tag(verdict)), *(str(count or NONE) for count in counts.values())]
        for verdict, counts in by_kind(rows).items()
    ]
    return Table([Head(""), *(Head(kind, "n") for kind in KINDS)], lines)


def by_kind(rows: Sequence[Row]) -> dict[Verdict, dict[str, int]]:
    """Return verdict -> kind -> number of rows."""
    return {v: {k: sum(row.verdict == v and row.kind == k for row in rows) for k in KINDS} for v in VERDICTS}


def _findings(claims: Sequence[Row]) -> list[_Finding]:
    """Return the claims as sentences, what does not hold first."""
    return [
        _Finding(_Tag(verdict), title, mine, verdict == "not reproduced")
        for verdict, title in _CLAIMS.items()
        if (mine := [_Claim(_sentence(row), row.reason) for row in claims if row.verdict == verdict])
    ]


def _sentence(row: Row) -> str:
    unit = "" if row.unit == "1" else f" {row.unit}"
    said = f"printed {number(row.printed)}{unit}, " if isfinite(row.printed) else ""
    return f"“{row.quantity}” ({row.place}). {row.method}: {said}ours {number(row.ours_median, 4)}{unit}."


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


def _cells(row: Row) -> list[str]:
    read = number(row.read) if row.read != row.printed and isfinite(row.read) else ""
    spread = f"{row.ours_q1:.4g} .. {row.ours_q3:.4g}" if row.n > 1 else ""
    side = "" if row.rule == "near" else f"{row.rule} "
    within = f"{side}{row.tolerance:.2g}" if isfinite(row.tolerance) else ""
    if isfinite(row.tolerance_in_kind):
        decades = " decades" if row.tolerance_in_decades else ""
        within += f"; in kind {side}{row.tolerance_in_kind:.2g}{decades}"
    unit = "" if row.unit == "1" else f" [{row.unit}]"
    numbers = [number(row.printed), read, number(row.ours_median), spread, str(row.n)]
    named = [row.place.replace("column ", ""), row.kind, row.quantity + unit]
    return [*named, *numbers, within, _cell().tag(_Tag(row.verdict)), _cell().why(row)]
