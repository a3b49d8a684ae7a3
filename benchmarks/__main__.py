"""``python -m benchmarks [NAME ...]``: run the benchmarks, print them, keep them as Parquet, write the page.

Every module of this folder with a function `rows` is a benchmark: ``rows() -> DataFrame`` with the columns of `rounds`.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import platform
import re
import sys
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any

import pandas as pd

import benchmarks
from benchmarks import statistics, thresholds
from calibench.bench.provenance.environment import provenance

_UNITS = ((1e9, "s"), (1e6, "ms"), (1e3, "µs"), (1.0, "ns"))


def main() -> None:
    """Run what the command line names, or all; the page keeps the sections of the others."""
    if sys.argv[1:2] == ["thresholds"]:  # rates of the search, and no times
        thresholds.main(sys.argv[2:])
        return
    if sys.argv[1:2] == ["statistics"]:  # what intervals and tests promise
        statistics.main(sys.argv[2:])
        return
    if sys.argv[1:2] == ["peers"]:  # other tools, each in an environment of its own
        from benchmarks.peers import measured

        measured.main(sys.argv[2:])
        return
    known = known_names()
    parser = argparse.ArgumentParser(prog="benchmarks", description="Time kernels, gate, start-up and optimisers.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(known)}; all without one")
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"), help="folder of the Parquet files")
    parser.add_argument("--page", type=Path, default=Path("docs/benchmarks.md"), help="page to write")
    chosen = parser.parse_args()
    if unknown := sorted(set(chosen.names) - set(known)):
        parser.error(f"{', '.join(unknown)}: no benchmark; choices: {', '.join(known)}")
    chosen.out.mkdir(parents=True, exist_ok=True)
    for name in chosen.names or known:
        module = import_module(f"benchmarks.{name}")
        table: pd.DataFrame = module.rows().assign(about=(module.__doc__ or "").strip(), **_circumstances())
        print(table[["benchmark", "contestant", "ns_per_evaluation", "ratio", "rounds"]].to_string(index=False))
        table.to_parquet(chosen.out / f"{name}.parquet", index=False)
    before = chosen.page.read_text(encoding="utf-8") if chosen.page.exists() else ""
    tables = [pd.read_parquet(chosen.out / f"{name}.parquet") for name in chosen.names or known]
    chosen.page.write_text(page(tables, before), encoding="utf-8")


def known_names() -> list[str]:
    """Return the names of the benchmarks: the modules of this folder that define `rows`; none of them is imported."""
    [folder] = benchmarks.__path__
    return sorted(file.stem for file in Path(folder).glob("*.py") if "\ndef rows(" in file.read_text(encoding="utf-8"))


def page(tables: Sequence[pd.DataFrame], before: str = "") -> str:
    """Return the page of results: a section a file, a table a benchmark.

    Sections of the page `before` that are not measured again stay as they are, where their benchmark is still there.
    """
    sections = dict(re.findall(r"^## (.+)\n((?:(?!## ).*\n?)*)", before, re.MULTILINE)) | dict(map(_section, tables))
    usual = _usual_versions(before, sections)
    parts = [
        "# Benchmarks\n\n"
        "`make bench` measures this page anew and writes the same rows to `results/benchmarks/*.parquet`. Times are\n"
        "CPU times an evaluation: medians, with quartiles, over rounds in which all lines of a table take turns. A\n"
        "ratio is the median over the rounds of a time over that of the table's first line in the same round: it\n"
        "holds on a shared machine, where the times do not.\n\n"
        f"Versions, where a section names no others: {usual}.\n\n"
        "Other tools on the same work, each in an environment of its own: "
        "[peers, measured in one run](peers-measured.md).\n"
    ]
    titles = [_title(name) for name in known_names()]
    parts += [f"## {title}\n{sections[title].rstrip()}\n" for title in titles if title in sections]
    return "\n".join(parts)


def _usual_versions(before: str, sections: dict[str, str]) -> str:
    """Return the versions that most sections were measured with; only sections with others keep theirs."""
    stated = re.search(r"^Versions, where a section names no others: (.+)\.$", before, re.MULTILINE)
    line = re.compile(r"^(\d{4}-\d\d-\d\d, (?:(?!, python ).)+?)(?:, (python .+))?\.$", re.MULTILINE)
    found = {title: match for title, text in sections.items() if (match := line.search(text))}
    told = {title: match[2] or (stated[1] if stated else "") for title, match in found.items()}
    usual = Counter(told.values()).most_common(1)[0][0] if told else ""
    for title, match in found.items():
        own = "" if told[title] == usual else f", {told[title]}"
        sections[title] = f"{match.string[: match.start()]}{match[1]}{own}.{match.string[match.end() :]}"
    return usual


def _title(name: str) -> str:
    """Return the first sentence of a benchmark, which is not imported for it."""
    [folder] = benchmarks.__path__
    told = ast.get_docstring(ast.parse((Path(folder) / f"{name}.py").read_text(encoding="utf-8"))) or name
    return told.splitlines()[0].rstrip(".")


def _section(table: pd.DataFrame) -> tuple[str, str]:
    """Return the title of a section and what stands below it."""
    first = table.iloc[0]
    title, *rest = first["about"].splitlines()
    parts = [""]
    if told := " ".join(rest).strip():
        parts.append(f"{told}\n")
    parts.append(f"{first['date']}, {first['machine']}, {first['versions']}.\n")
    for name, rows in table.groupby("benchmark", sort=False):
        lines = [f"| {name} | time | quartiles | ratio |", "|---|---|---|---|"]
        lines += [_line(row) for row in rows.to_dict("records")]
        parts.append("\n".join(lines) + "\n")
    return title.rstrip("."), "\n".join(parts)


def _line(row: dict[Any, Any]) -> str:
    size, unit = next(((s, u) for s, u in _UNITS if abs(row["ns_per_evaluation"]) >= s), _UNITS[-1])
    time, low, high = (row[key] / size for key in ("ns_per_evaluation", "ns_q1", "ns_q3"))
    quartiles = "" if pd.isna(low) else f"{low:.3g} .. {high:.3g}"
    ratio = "" if pd.isna(row["ratio"]) else f"{row['ratio']:.3g}"
    return f"| {row['contestant']} | {time:.3g} {unit} | {quartiles} | {ratio} |"


def _circumstances() -> dict[str, str]:
    """Return date, machine and versions, as the page tells them."""
    versions = json.loads(provenance()["versions"])
    told = ("python", "numpy", "numba", "scipy", "nlopt", "pygmo")
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "machine": f"{processor()}, {os.cpu_count()} cores",
        "versions": ", ".join(f"{name} {versions[name]}" for name in told if versions.get(name)),
    }


def processor() -> str:
    """Return the processor's name; the architecture where the system does not tell it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.machine()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


if __name__ == "__main__":
    main()
