"""The ledger as one page that needs nothing else: counts, findings in sentences, and a table for each printed table.

A verdict has a mark and a word besides its colour, so it reads in black and white and to the colour-blind.
"""

import os
import re
from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any

from calibench.bench.papers.ledger import KINDS, VERDICTS, Row, Verdict, kept, read_rows
from calibench.bench.provenance.environment import provenance
from calibench.bench.report.shared.page import Head, Inline, Table, drawing_inside, macros, render
from calibench.bench.report.study.html_tables import number
from calibench.problems.constants import document

_CELLS = "papers/templates/cells.html.j2"
_MARKS: dict[Verdict, tuple[str, str, str]] = {  # mark, style, meaning
    "reproduced": ("✓", "ok", "ours agrees to what is printed, or the sentence holds by its rule"),
    "reproduced in kind": (
        "≈", "kind", "not to the digit: order, decade or bound agree, by a tolerance that is stated"
    ),
    "misprint, corrected": ("✎", "misprint", "the print is wrong, and the computation gives what to read"),
    "artefact of the stopping tolerance": (
        "◐", "kind", "it holds with every absolute stop of fmincon and not with a relative one"
    ),
    "depends on plan or release": (
        "⇄", "kind", "some sampling plans or releases of fmincon give it; which were taken is not printed"
    ),
    "not reproduced": ("✗", "no", "the computation contradicts the print"),
    "open at this budget": ("…", "open", "a search that is said of more evaluations than were made here"),
    "not checkable": ("?", "open", "what it takes is not published"),
}  # fmt: skip
_CLAIMS: dict[Verdict, str] = {
    "not reproduced": "Said or implied, and does not hold",
    "artefact of the stopping tolerance": "Holds by the stopping tolerance",
    "depends on plan or release": "Depends on the release of fmincon", "reproduced in kind": "Holds in kind",
    "reproduced": "Holds", "misprint, corrected": "Misprinted", "open at this budget": "Open at this budget",
    "not checkable": "Open",
}  # fmt: skip
_HEADS = [
    *(Head(title) for title in ("quantity", "kind")), *(Head(title, "n") for title in ("printed", "ours")),
    *(Head(title) for title in ("within", "verdict")), Head("why and how", "told"),
]  # fmt: skip
NONE = "–"
_BELOW = ("kmrmse", "iterations", "rms", "average", "residual")  # what stands below the values, or after them
_KIND_MEANINGS = (
    "Input: the paper is given it. Setting: it chooses it. Result: it finds it, and it is computed here anew. "
    "Consistency: it finds it, and only other numbers that it found can be held against it: the print agrees with "
    "itself, or does not. Claim: a sentence. Erratum: a slip of the print. An input that is reproduced agrees with "
    "another print of itself, or with what follows from it."
)


Kept = Mapping[tuple[str, str], Row]  # rows of the kept run at the papers' own budget, by paper and key


def write_page(
    rows: Sequence[Row], budget: str, path: Path, drawings: Mapping[str, Sequence[Path]] | None = None
) -> Path:
    """Write the page and return its path; `drawings` are SVG files of the papers' figures, by paper."""
    ledger, readme = kept("ledger.parquet"), kept("README.md")
    known, address = {}, ""
    if ledger and readme:
        known = {(row.paper, row.key): row for row in read_rows(ledger)}
        address = Path(os.path.relpath(readme, path.parent)).as_posix()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page(rows, budget, drawings or {}, known, address), encoding="utf-8")
    return path


def page(
    rows: Sequence[Row], budget: str, drawings: Mapping[str, Sequence[Path]] = MappingProxyType({}),
    known: Kept = MappingProxyType({}), address: str = "",
) -> str:  # fmt: skip
    """Return the page's HTML: no script, and nothing fetched from anywhere. `address` leads to the kept run."""
    cell = macros(_CELLS)
    papers = dict.fromkeys(row.paper for row in rows)
    figures = {key: [drawing_inside(path, path.stem) for path in drawings.get(key, ())] for key in papers}
    return render(
        "papers/templates/ledger.html.j2",
        title="Ledger",
        size=len(rows),
        budget=budget,
        commit=provenance()["git_commit"][:10] or "unknown",
        verdicts=[_tag(verdict) | {"count": sum(row.verdict == verdict for row in rows)} for verdict in VERDICTS],
        # a given number that agrees with itself is no finding
        kinds=Table(
            [Head(""), *(Head(kind, "n") for kind in KINDS)],
            [
                [cell.tag(_tag(verdict)), *(str(count or NONE) for count in counts.values())]
                for verdict, counts in by_kind(rows).items()
            ],
        ),
        kind_meanings=_KIND_MEANINGS,
        kept=address,
        papers=[_paper(key, [row for row in rows if row.paper == key], figures[key], known) for key in papers],
    )


def by_kind(rows: Sequence[Row]) -> dict[Verdict, dict[str, int]]:
    """Return verdict -> kind -> number of rows."""
    return {v: {k: sum(row.verdict == v and row.kind == k for row in rows) for k in KINDS} for v in VERDICTS}


def _tag(verdict: Verdict) -> dict[str, Any]:
    mark, style, meaning = _MARKS[verdict]
    return {"verdict": verdict, "mark": mark, "style": style, "meaning": meaning}


def _paper(key: str, rows: Sequence[Row], figures: Sequence[Inline], known: Kept) -> dict[str, Any]:
    about = document(key)["paper"]
    findings = []  # claims as sentences, what does not hold first
    for verdict, title in _CLAIMS.items():
        claims = []
        for row in (row for row in rows if row.kind == "claim" and row.verdict == verdict):
            unit = "" if row.unit == "1" else f" {row.unit}"
            printed = f"printed {number(row.printed, 7)}{unit}, " if isfinite(row.printed) else ""
            result = f"{row.method}: {printed}ours {number(row.ours_median, 4)}{unit}."
            claims.append({"sentence": f"“{row.quantity}” ({row.place}). {result}", "reason": row.reason})
        is_open = verdict == "not reproduced"
        findings += [{"verdict": _tag(verdict), "title": title, "claims": claims, "open": is_open}] if claims else []
    tables: dict[str, list[Row]] = {}
    others: dict[str, list[Row]] = {}  # by passage, claims and errata
    titles = {"claim": "Claims", "erratum": "Errata", "geometry": "Geometry", "text": "Figures and text"}
    for row in rows:
        head = row.key.partition(".")[0]
        if head.startswith("table"):
            tables.setdefault(f"Table {head.removeprefix('table')}", []).append(row)
        elif head.startswith("equation"):
            others.setdefault(f"Equation ({head.removeprefix('equation')})", []).append(row)
        else:
            others.setdefault(titles.get(head, f"Section {'.'.join(head.removeprefix('section'))}"), []).append(row)
    groups, cell = [], macros(_CELLS)
    for title, mine in (dict(sorted(tables.items())) | others).items():
        lines = []
        for row in mine:
            side = "" if row.rule.startswith("near") else f"{row.rule} "
            within = f"{side}{row.tolerance:.2g}" if isfinite(row.tolerance) else ""
            if isfinite(row.tolerance_in_kind):
                decades = " decades" if row.tolerance_in_decades else ""
                within += f"; in kind {side}{row.tolerance_in_kind:.2g}{decades}"
            unit = "" if row.unit == "1" else f" [{row.unit}]"
            read = f"read {number(row.read, 7)}" if row.read != row.printed and isfinite(row.read) else ""
            spread = f"{row.ours_q1:.4g} .. {row.ours_q3:.4g}, n = {row.n}" if row.n > 1 else ""
            lines.append([
                cell.beside(row.quantity + unit, row.place.replace("column ", "")), row.kind,
                cell.beside(number(row.printed, 7), read), cell.beside(number(row.ours_median, 7), spread), within,
                cell.tag(_tag(row.verdict)), cell.why(row),
            ])  # fmt: skip
        as_printed = _as_printed(mine, known) if title in tables else None
        table = Table(_HEADS, lines, kind="rows")
        groups.append(_group(mine) | {"title": title, "table": table, "as_printed": as_printed})
    return {
        "title": about["title"], "authors": ", ".join(about["authors"]), "year": about["year"], "all": _group(rows),
        "findings": findings, "figures": figures, "groups": groups,
    }  # fmt: skip


def _group(rows: Sequence[Row]) -> dict[str, Any]:
    counts = ((verdict, sum(row.verdict == verdict for row in rows)) for verdict in VERDICTS)
    return {"size": len(rows), "tally": "; ".join(f"{count} {verdict}" for verdict, count in counts if count)}


def _as_printed(rows: Sequence[Row], known: Kept) -> Table:
    """Return a table in the print's form: the places are its columns, or its rows where the print calls them so."""
    cells: dict[tuple[str, str], str] = {}
    units: dict[str, dict[str, None]] = {}
    for row in rows:  # with what the kept run gives where this one is too short to say, and its verdict
        other = known.get((row.paper, row.key))
        longer: tuple[str, Any] = ("", None)
        if other is not None and row.verdict == "open at this budget" and other.verdict != row.verdict:
            longer = number(other.ours_median, 4), _tag(other.verdict)
        cells[row.place, row.quantity] = macros(_CELLS).printed(row, _tag(row.verdict), *longer)
        units.setdefault(row.quantity, {})[row.unit] = None
    quantities = sorted(units, key=lambda name: name in _BELOW)
    named = {name: name + ("" if (unit := " or ".join(units[name])) == "1" else f" [{unit}]") for name in quantities}
    # a column or row as it is called inside its table
    places = {row.place: re.sub(r"\b(column|row) ", "", row.place.partition(", ")[2]).replace("'", "") for row in rows}
    if any(re.search(r"\brow '", place) for place in places):
        lines = [[short, *(cells.get((place, q), "") for q in quantities)] for place, short in places.items()]
        return Table([Head(""), *(Head(named[q], "n") for q in quantities)], lines, kind="printed")
    lines = [[named[q], *(cells.get((place, q), "") for place in places)] for q in quantities]
    return Table([Head(""), *(Head(short, "n") for short in places.values())], lines, kind="printed")
