"""The ledger as one page that needs nothing else: counts, findings in sentences, and a table for each printed table.

A verdict has a mark and a word besides its colour, so it reads in black and white and to the colour-blind.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import final

from calibench.bench.papers.files import kept, read_rows
from calibench.bench.papers.row import KINDS, VERDICTS, Row, Verdict
from calibench.bench.provenance.environment import provenance
from calibench.bench.report.shared.page import Head, Inline, Macros, Table, drawing_inside, macros, render
from calibench.problems.constants import document

_MARKS = {
    "reproduced": ("✓", "ok"),
    "reproduced in kind": ("≈", "kind"),
    "misprint, corrected": ("✎", "misprint"),
    "artefact of the stopping tolerance": ("◐", "kind"),
    "depends on plan or release": ("⇄", "kind"),
    "not reproduced": ("✗", "no"),
    "open at this budget": ("…", "open"),
    "not checkable": ("?", "open"),
}
_CLAIMS: dict[Verdict, str] = {
    "not reproduced": "Said or implied, and does not hold",
    "artefact of the stopping tolerance": "Holds by the stopping tolerance",
    "depends on plan or release": "Depends on the release of fmincon",
    "reproduced in kind": "Holds in kind",
    "reproduced": "Holds",
    "misprint, corrected": "Misprinted",
    "open at this budget": "Open at this budget",
    "not checkable": "Open",
}
_HEADS = [
    *(Head(title) for title in ("quantity", "kind")),
    *(Head(title, "n") for title in ("printed", "ours")),
    *(Head(title) for title in ("within", "verdict")),
    Head("why and how", "told"),
]
NONE = "–"
_BELOW = ("kmrmse", "iterations", "rms", "average", "residual")  # what stands below the values, or after them
KIND_MEANINGS = (
    "Input: the paper is given it. Setting: it chooses it. Result: it finds it, and it is computed here anew. "
    "Consistency: it finds it, and only other numbers that it found can be held against it: the print agrees with "
    "itself, or does not. Claim: a sentence. Erratum: a slip of the print. An input that is reproduced agrees with "
    "another print of itself, or with what follows from it."
)
_MEANINGS = {
    "reproduced": "ours agrees to what is printed, or the sentence holds by its rule",
    "reproduced in kind": "not to the digit: order, decade or bound agree, by a tolerance that is stated",
    "misprint, corrected": "the print is wrong, and the computation gives what to read",
    "artefact of the stopping tolerance": "it holds with every absolute stop of fmincon and not with a relative one",
    "depends on plan or release": "some sampling plans or releases of fmincon give it; which were taken is not printed",
    "not reproduced": "the computation contradicts the print",
    "open at this budget": "a search that is said of more evaluations than were made here",
    "not checkable": "what it takes is not published",
}


@final
@dataclass(frozen=True)
class Kept:
    """The kept run at the papers' own budget: its rows by paper and key, and its address from the page."""

    rows: Mapping[tuple[str, str], Row]
    address: str


def write_page(
    rows: Sequence[Row], budget: str, path: Path, drawings: Mapping[str, Sequence[Path]] | None = None
) -> Path:
    """Write the page and return its path; `drawings` are SVG files of the papers' figures, by paper."""
    ledger, readme = kept("ledger.parquet"), kept("README.md")
    known = None
    if ledger and readme:
        by_key = {(row.paper, row.key): row for row in read_rows(ledger)}
        known = Kept(by_key, Path(os.path.relpath(readme, path.parent)).as_posix())
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page(rows, budget, drawings, known), encoding="utf-8")
    return path


def page(
    rows: Sequence[Row], budget: str, drawings: Mapping[str, Sequence[Path]] | None = None, known: Kept | None = None
) -> str:
    """Return the page's HTML: no script, and nothing fetched from anywhere."""
    papers = dict.fromkeys(row.paper for row in rows)
    figures = {key: [drawing_inside(path, path.stem) for path in (drawings or {}).get(key, ())] for key in papers}
    return render(
        "papers/templates/ledger.html.j2",
        title="Ledger",
        size=len(rows),
        budget=budget,
        commit=provenance()["git_commit"][:10] or "unknown",
        verdicts=[_Tag(verdict, sum(row.verdict == verdict for row in rows)) for verdict in VERDICTS],
        # a given number that agrees with itself is no finding
        kinds=Table(
            [Head(""), *(Head(kind, "n") for kind in KINDS)],
            [
                [_cell().tag(_Tag(verdict)), *(str(count or NONE) for count in counts.values())]
                for verdict, counts in by_kind(rows).items()
            ],
        ),
        kind_meanings=KIND_MEANINGS,
        kept=known.address if known else "",
        papers=[_paper(key, [row for row in rows if row.paper == key], figures[key], known) for key in papers],
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
    title: str
    rows: Sequence[Row]
    known: Kept | None = None

    @property
    def size(self) -> int:
        return len(self.rows)

    @property
    def tally(self) -> str:
        return "; ".join(f"{n} {v}" for v in VERDICTS if (n := sum(row.verdict == v for row in self.rows)))

    @property
    def as_printed(self) -> Table | None:
        """Return a printed table in the print's rows and columns; None where the rows are of no table."""
        return _as_printed(self.rows, self.known) if self.title.startswith("Table") else None

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
    sentence: str
    reason: str


@final
@dataclass(frozen=True, kw_only=True)
class _Paper:
    """The part of one paper."""

    title: str
    authors: str
    year: int
    all: _Group
    findings: Sequence[_Finding]
    figures: Sequence[Inline]
    groups: Sequence[_Group]


def _paper(key: str, rows: Sequence[Row], figures: Sequence[Inline], known: Kept | None) -> _Paper:
    about = document(key)["paper"]
    claims = [row for row in rows if row.kind == "claim"]
    findings = [  # as sentences, what does not hold first
        _Finding(_Tag(verdict), title, mine, verdict == "not reproduced")
        for verdict, title in _CLAIMS.items()
        if (mine := [_Claim(_sentence(row), row.reason) for row in claims if row.verdict == verdict])
    ]
    return _Paper(
        title=about["title"],
        authors=", ".join(about["authors"]),
        year=about["year"],
        all=_Group("", rows),
        findings=findings,
        figures=figures,
        groups=[_Group(title, group, known) for title, group in _groups(rows).items()],
    )


def number(value: float, digits: int = 7) -> str:
    """Return a number as the page and the terminal show it; a dash where there is none.

    >>> number(243.5), number(3.5946e-20), number(float("nan"))
    ('243.5', '3.5946e-20', '–')
    """
    return f"{value:.{digits}g}" if isfinite(value) else "–"


def _cell() -> Macros:
    return macros("papers/templates/cells.html.j2")


def by_kind(rows: Sequence[Row]) -> dict[Verdict, dict[str, int]]:
    """Return verdict -> kind -> number of rows."""
    return {v: {k: sum(row.verdict == v and row.kind == k for row in rows) for k in KINDS} for v in VERDICTS}


def _sentence(row: Row) -> str:
    unit = "" if row.unit == "1" else f" {row.unit}"
    printed = f"printed {number(row.printed)}{unit}, " if isfinite(row.printed) else ""
    return f"“{row.quantity}” ({row.place}). {row.method}: {printed}ours {number(row.ours_median, 4)}{unit}."


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


def _as_printed(rows: Sequence[Row], known: Kept | None) -> Table:
    """Return a table in the print's form: the places are its columns, or its rows where the print calls them so."""
    cells = {}
    for row in rows:  # with what the kept run gives where this one is too short to say, and its verdict
        other = known.rows.get((row.paper, row.key)) if known else None
        longer: tuple[str, _Tag | None] = ("", None)
        if other is not None and row.verdict == "open at this budget" and other.verdict != row.verdict:
            longer = number(other.ours_median, 4), _Tag(other.verdict)
        cells[row.place, row.quantity] = _cell().printed(row, _Tag(row.verdict), *longer)
    units: dict[str, dict[str, None]] = {}
    for row in rows:
        units.setdefault(row.quantity, {})[row.unit] = None
    quantities = sorted(units, key=lambda name: name in _BELOW)
    named = {name: name + ("" if (unit := " or ".join(units[name])) == "1" else f" [{unit}]") for name in quantities}
    places = {row.place: _short_place(row.place) for row in rows}
    if any(re.search(r"\brow '", place) for place in places):
        lines = [[short, *(cells.get((place, q), "") for q in quantities)] for place, short in places.items()]
        return Table([Head(""), *(Head(named[q], "n") for q in quantities)], lines, kind="printed")
    lines = [[named[q], *(cells.get((place, q), "") for place in places)] for q in quantities]
    return Table([Head(""), *(Head(short, "n") for short in places.values())], lines, kind="printed")


def _short_place(place: str) -> str:
    """Return a column or row as it is called inside its table.

    >>> _short_place("Table 2, column 'Results calibrated with J_1', '3 samples'")
    'Results calibrated with J_1, 3 samples'
    """
    return re.sub(r"\b(column|row) ", "", place.partition(", ")[2]).replace("'", "")


def _cells(row: Row) -> list[str]:
    side = "" if row.rule.startswith("near") else f"{row.rule} "
    within = f"{side}{row.tolerance:.2g}" if isfinite(row.tolerance) else ""
    if isfinite(row.tolerance_in_kind):
        decades = " decades" if row.tolerance_in_decades else ""
        within += f"; in kind {side}{row.tolerance_in_kind:.2g}{decades}"
    unit = "" if row.unit == "1" else f" [{row.unit}]"
    read = f"read {number(row.read)}" if row.read != row.printed and isfinite(row.read) else ""
    spread = f"{row.ours_q1:.4g} .. {row.ours_q3:.4g}, n = {row.n}" if row.n > 1 else ""
    beside = _cell().beside
    return [
        beside(row.quantity + unit, row.place.replace("column ", "")), row.kind, beside(number(row.printed), read),
        beside(number(row.ours_median), spread), within, _cell().tag(_Tag(row.verdict)), _cell().why(row),
    ]  # fmt: skip
