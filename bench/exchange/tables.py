r"""A study as tables: CSV, with a README that says what each column means, and the summary in LaTeX.

In CSV floats have as many digits as tell them from their neighbours, so that a reader who rounds rightly has the same
bits; lists are JSON in one cell, nothing is an empty cell, infinity is inf. ``summary.tex`` (booktabs, a line a cell,
best first on each problem) is to be taken into a paper by ``\input``; ``document.tex`` shows it alone.
"""

import json
import unicodedata
from math import isfinite
from pathlib import Path
from typing import Any

import pandas as pd

from calibench.bench.exchange.studies import Study
from calibench.bench.execution.run_row import COLUMNS
from calibench.bench.statistics.names import problem_titles, several
from calibench.bench.statistics.ranking import best_first
from calibench.bench.statistics.summary import method_names, summary
from calibench.bench.store.manifest import Notes, read_notes, write_notes
from calibench.core.words import counted

_PAGE = 45  # lines of a table that stands on one page
_SPECIAL = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "%": r"\%", "_": r"\_",
    "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "|": r"\textbar{}", '"': r"\textquotedbl{}", "'": r"\textquotesingle{}", "`": r"\textasciigrave{}",
    "…": r"\ldots{}", "-": r"{-}", "[": "{[}", "]": "{]}",
}  # fmt: skip

_GREEK = {
    "α": "alpha", "β": "beta", "γ": "gamma", "δ": "delta", "ε": "epsilon", "ζ": "zeta", "η": "eta", "θ": "theta",
    "ι": "iota", "κ": "kappa", "λ": "lambda", "μ": "mu", "ν": "nu", "ξ": "xi", "π": "pi", "ρ": "rho", "σ": "sigma",
    "τ": "tau", "υ": "upsilon", "φ": "phi", "χ": "chi", "ψ": "psi", "ω": "omega", "Γ": "Gamma", "Δ": "Delta",
    "Θ": "Theta", "Λ": "Lambda", "Ξ": "Xi", "Π": "Pi", "Σ": "Sigma", "Υ": "Upsilon", "Φ": "Phi", "Ψ": "Psi",
    "Ω": "Omega",
}  # fmt: skip
_SPECIAL |= {sign: rf"\ensuremath{{\{name}}}" for sign, name in _GREEK.items()}
_RAISED = {"<super>": "textsuperscript", "<sub>": "textsubscript"}  # as Unicode takes ⁴ and ₐ apart

_DOCUMENT = r"""\documentclass{article}
\usepackage[T1]{fontenc}
\usepackage[utf8]{inputenc}
\usepackage{textcomp,booktabs,longtable}
\usepackage[a4paper,landscape,margin=15mm]{geometry}
\begin{document}
\input{summary}
\end{document}
"""


def escaped(text: str) -> str:
    r"""Return `text` as LaTeX prints it, sign by sign.

    >>> print(escaped("full12 50% a_b^2 {x} \\ -- $"))
    full12 50\% a\_b\textasciicircum{}2 \{x\} \textbackslash{} {-}{-} \$
    >>> print(escaped("Δx in mm⁴"))
    \ensuremath{\Delta}x in mm\textsuperscript{4}
    """
    signs = []
    for sign in " ".join(text.split()):
        where, _, base = unicodedata.decomposition(sign).partition(" ")
        raised = rf"\{_RAISED[where]}{{{chr(int(base, 16))}}}" if where in _RAISED and " " not in base else sign
        signs.append(_SPECIAL.get(sign, raised))
    return "".join(signs)


def number(value: float, digits: int = 4) -> str:
    r"""Return a number in `digits` significant digits as mathematics; a dash where there is none.

    >>> print(number(1.25e-7), number(120.0), number(float("inf")), number(float("nan")))
    $1.25 \times 10^{-7}$ $120$ $\infty$ --
    """
    if value != value:
        return "--"
    if not isfinite(value):
        return r"$\infty$" if value > 0 else r"$-\infty$"
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    return f"${mantissa} \\times 10^{{{int(exponent)}}}$" if exponent else f"${mantissa}$"


def write_latex(study: Study, folder: Path) -> list[str]:
    """Write the summary of `study` into `folder`; return remarks, a line each."""
    cells = summary(study.runs)
    cells = best_first(cells.assign(method=method_names(cells)))
    errors = [json.loads(text).get("error") for text in cells["problem_options"]]
    titles = problem_titles(cells, but=("error",))
    columns: dict[str, list[str]] = {
        "problem": [escaped(f"{t} {e}" if e else t) for t, e in zip(titles, errors, strict=True)],
        "method": [escaped(name) for name in cells["method"]],
    }
    for name in several(cells):
        columns[name] = [escaped(v) if isinstance(v, str) else number(float(v), 6) for v in cells[name]]
    if cells["goal"].notna().any():
        rows = zip(cells["reached"], cells["runs"], cells["goal"], strict=True)
        columns["reached"] = [f"{won}/{runs}" if goal == goal else "--" for won, runs, goal in rows]
        columns["charged to target"] = [number(value) for value in cells["charged_to_target"]]
    else:
        columns["runs"] = [str(count) for count in cells["runs"]]
    least = cells["minimum"].where(~cells["noisy"].astype(bool) & (cells["minimum"] != 0)).astype(float)
    above = " $- f^*$" if least.notna().any() else ""
    if above:
        columns["$f^*$"] = [number(value) for value in least]
    for name in ("best_q1", "best_median", "best_q3"):
        values = cells[name] - least.fillna(0.0)
        columns[f"{escaped(name.replace('_', ' '))}{above}"] = [number(value) for value in values]
    if (cells["unit"] != "").any():
        columns["unit"] = [escaped(unit) or "--" for unit in cells["unit"]]
    (folder / "summary.tex").write_text(latex_table(pd.DataFrame(columns)), encoding="utf-8")
    (folder / "document.tex").write_text(_DOCUMENT, encoding="utf-8")
    return [f"summary.tex ({counted(len(cells), 'line')}; needs booktabs, textcomp, T1), document.tex"]


def latex_table(table: pd.DataFrame) -> str:
    """Return a table whose cells are LaTeX already."""
    words = [name in ("problem", "method", "start", "unit") for name in table]
    layout = "".join("l" if word else "r" for word in words)
    head = " & ".join(str(name) for name in table) + r" \\"
    body = [" & ".join(row) + r" \\" for row in table.itertuples(index=False)]
    kind, more = ("longtable", [r"\endhead"]) if len(body) > _PAGE else ("tabular", [])
    begin = [rf"\begin{{{kind}}}{{{layout}}}", r"\toprule", head, r"\midrule", *more]
    return "\n".join([*begin, *body, r"\bottomrule", rf"\end{{{kind}}}"]) + "\n"


_README = """# Columns

Read floats with a reader that rounds rightly, as Python's `float` does; pandas before version 3 needs
`read_csv(path, float_precision="round_trip")`. An empty cell is null, `inf` is infinity, a list is JSON.

## runs.csv: a row a run

| column | type | meaning |
| --- | --- | --- |
{runs}

## traces.csv: a row a point of a run's trace

| column | meaning |
| --- | --- |
| run_id | the run |
| evaluations | evaluations so far |
| charged | what they cost: evaluations + dimension x Jacobians |
| best_value | lowest value so far |
| restart | how often the optimizer had begun again |

## hits.csv: a row a run and target

| column | meaning |
| --- | --- |
| run_id | the run |
| target | level of the value |
| evaluations | evaluations at which it was reached first; empty: never |
| charged | the same in charged evaluations |

## summary.csv: a row a cell, the runs that differ in their repetition alone

Medians (`_median`) and quartiles (`_q1`, `_q3`) are over its runs. `goal` is the target of the run, else the last of
the problem's; `reached` of `runs` reached it, `success` is the share with its 95 % Wilson interval, and
`charged_to_target` the median over those that did. Other names are those of `runs.csv`.
"""


def write_csv(study: Study, folder: Path) -> list[str]:
    """Write the tables of `study` into `folder`; return remarks, a line each."""
    runs = study.runs[[column.name for column in COLUMNS]].copy()
    for name in (column.name for column in COLUMNS if column.parquet.startswith("list")):
        texts = [None if value is None or value is pd.NA else json.dumps(list(value)) for value in runs[name]]
        runs[name] = pd.Series(texts, index=runs.index, dtype=object)
    rows: list[tuple[Any, ...]] = []  # a run and target each; null where it was never reached
    columns = (study.runs[name] for name in ("run_id", "targets", "hits", "hits_charged"))
    for run_id, targets, evaluations, charged in zip(*columns, strict=True):
        rows += [(run_id, *row) for row in zip(targets, evaluations, charged, strict=True)]
    hits = pd.DataFrame(rows, columns=["run_id", "target", "evaluations", "charged"])
    tables = {
        "runs": runs, "traces": study.traces,
        "hits": hits.astype({"target": float, "evaluations": "Int64", "charged": "Int64"}),
        "summary": summary(study.runs, study.store.manifest().get("costs", [])),
    }  # fmt: skip
    for name, table in tables.items():
        table.to_csv(folder / f"{name}.csv", index=False, lineterminator="\n")
    if (noted := read_notes(study.store.folder)) != Notes():
        write_notes(folder, noted)
    lines = "\n".join(f"| {column.name} | {column.parquet} | {column.meaning} |" for column in COLUMNS)
    (folder / "README.md").write_text(_README.format(runs=lines), encoding="utf-8")
    return [", ".join(f"{name}.csv ({counted(len(table), 'row')})" for name, table in tables.items())]
