"""COCO's folders, as its experiment library logs them and cocopp reads them: a folder an algorithm.

``bbobexp_f1.info`` lists the dimensions and, for each, instance:evaluations|final gap of its runs;
``data_f1/bbobexp_f1_DIM2.dat`` has a line an improvement, and so has ``.tdat``, which cocopp reads as a step between
them. Source: COCO 2.8, data format bbob-new2, and `cocopp.pproc`. A gap is the value above the problem's minimum. What
counts as an evaluation is what was charged.

cocopp knows its own suites and no others: of `bbob` functions 1 to 24 in dimensions 2, 3, 5, 10, 20 and 40. Other
problems are refused, as a function number of theirs would be a false name.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calibench.bench.exchange.folders import file_names
from calibench.bench.exchange.studies import Study, ToldRun, told_runs
from calibench.bench.exchange.targets import gap_of_value
from calibench.core.counted import counted, listed

SUITES = {"bbob": (range(1, 25), (2, 3, 5, 10, 20, 40))}  # functions and dimensions that cocopp has pages for
TOLD = "% calibench "  # begins the comment of an entry, which cocopp keeps and does not read
NOT_FINITE = 3e21  # what COCO logs instead of an infinite value
PRECISION = 1e-8
_HEADER = (
    "% f evaluations | g evaluations | best noise-free fitness - Fopt ({:.16e}) + sum g_i+ | measured fitness | "
    "best measured fitness or single-digit g-values | x1 | x2...\n"
)


def write_coco(study: Study, folder: Path) -> list[str]:
    """Write the runs of `study` into `folder`; return remarks, a line each.

    Raises `ValueError` where the study has a problem that cocopp has no suite for.
    """
    runs = told_runs(study)
    _refuse_foreign(runs)
    told = [run for run in runs if run.row["charged"]]
    names = file_names(sorted({run.algorithm for run in told}))
    entries: dict[tuple[str, int, int], list[ToldRun]] = defaultdict(list)
    for run in told:
        entries[run.algorithm, int(run.options["function"]), int(run.row["dimension"])].append(run)
    lines: dict[Path, list[str]] = defaultdict(list)
    for (algorithm, function, dimension), mine in sorted(entries.items()):
        mine.sort(key=lambda run: (run.row["repetition"], run.options["instance"]))
        home = folder / names[algorithm]
        data = f"data_f{function}/bbobexp_f{function}_DIM{dimension}"
        (home / data).parent.mkdir(parents=True, exist_ok=True)
        for ending in (".dat", ".tdat"):
            (home / f"{data}{ending}").write_text("".join(map(_improvements, mine)), encoding="ascii")
        lines[home / f"bbobexp_f{function}.info"].append(_entry(names[algorithm], function, dimension, data, mine))
    for path, entry in lines.items():
        path.write_text("\n".join(entry) + "\n", encoding="utf-8")
    said = [
        f"{counted(len(told), 'run')} of {counted(len(names), 'algorithm')}: cocopp reads {', '.join(names.values())}"
    ]
    if len(told) < len(runs):
        said.append(
            f"{counted(len(runs) - len(told), 'run')} without an evaluation left out: COCO has no place for them"
        )
    return said


def _refuse_foreign(runs: Sequence[ToldRun]) -> None:
    foreign = sorted({_called(run) for run in runs if not _is_known(run)})
    if foreign:
        raise ValueError(
            f"export coco: cocopp has no suite for {listed(foreign, 5)}; it reads bbob, functions 1 to 24 in "
            "dimensions 2, 3, 5, 10, 20 and 40; ioh takes any problem"
        )


def _is_known(run: ToldRun) -> bool:
    functions, dimensions = SUITES.get(run.row["problem"], ((), ()))
    return (
        run.options.get("function") in functions
        and run.row["dimension"] in dimensions
        and isinstance(run.options.get("instance"), int)
        and run.minimum is not None
    )


def _called(run: ToldRun) -> str:
    if run.row["problem"] not in SUITES:
        return str(run.row["problem"])
    return f"{run.row['problem']} function={run.options.get('function')} dimension={run.row['dimension']}"


def _improvements(run: ToldRun) -> str:
    """Return the lines of a run, the first at evaluation 1 and the last at its end, as COCO has them."""
    minimum = run.minimum or 0.0
    rows = [(point.charged, gap_of_value(point.value, minimum, point.reached), point.value) for point in run.course]
    if not rows or rows[0][0] > 1:
        rows.insert(0, (1, NOT_FINITE, NOT_FINITE))
    if rows[-1][0] < run.row["charged"]:
        rows.append((int(run.row["charged"]), *rows[-1][1:]))
    return _HEADER.format(minimum) + "".join(
        f"{n} 0 {gap:+.16e} {value:+.16e} {value:+.16e}\n" for n, gap, value in rows
    )


def _entry(name: str, function: int, dimension: int, data: str, runs: Sequence[ToldRun]) -> str:
    header = {
        "suite": repr("bbob"), "funcId": function, "DIM": dimension, "Precision": f"{PRECISION:.3e}",
        "algId": repr(name), "coco_version": repr("2.8"), "logger": repr("bbob"), "data_format": repr("bbob-new2"),
    }  # fmt: skip
    results = [f"{run.options['instance']}:{run.row['charged']}|{_final(run):.16e}" for run in runs]
    return "\n".join(
        [
            ", ".join(f"{key} = {value}" for key, value in header.items()),
            TOLD + json.dumps(_told(runs), sort_keys=True),
            ", ".join([f"{data}.dat", *results]),
        ]
    )


def _final(run: ToldRun) -> float:
    if not run.course:
        return NOT_FINITE
    last = run.course[-1]
    return gap_of_value(last.value, run.minimum or 0.0, last.reached)


def _told(runs: Sequence[ToldRun]) -> dict[str, Any]:
    """Return the facts that the runs of an entry share and for which COCO has no field."""
    return {
        name: runs[0].row[name]
        for name in ("optimizer", "optimizer_options", "library", "library_version", "start", "budget")
        if len({run.row[name] for run in runs}) == 1
    }
