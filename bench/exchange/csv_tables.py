"""A study as CSV: runs, traces, hits and the summary, with a README that says what each column means.

Floats are written with as many digits as tell them from their neighbours, so that a reader who rounds rightly has the
same bits. Lists are JSON in one cell. Nothing is an empty cell, infinity is inf.
"""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from calibench.bench.exchange.studies import Study
from calibench.bench.execution.run_row import COLUMNS
from calibench.bench.statistics.summary import summary
from calibench.bench.store.notes import Notes, read_notes, write_notes
from calibench.core.words import counted

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
