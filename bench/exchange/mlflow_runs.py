"""A study as MLflow runs: an experiment a study, a parent run a cell, under it a run of MLflow for each of ours.

A run of ours is known by its id and by when it began, and written once: a second export adds nothing, one that was
stopped half-way is done again, and a run that was done again takes the place of what stood there.
"""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

import pandas as pd

from calibench.bench.exchange.studies import Study, course_of, gap_of_level, records, traces_by_run
from calibench.bench.statistics.cells import CELL
from calibench.bench.statistics.names import method_labels, problem_titles
from calibench.bench.store.manifest import read_notes
from calibench.core.seeds import digest
from calibench.core.words import counted

_RUN, _CELL, _DONE, _PARENT = "calibench.run_id", "calibench.cell", "calibench.done", "mlflow.parentRunId"
_NOTE = "mlflow.note.content"  # which MLflow shows as the description
_STATUS = {"ok": "FINISHED", "timeout": "KILLED"}  # MLflow's words; any other run failed
_BATCH = 900  # metrics in a request; MLflow takes 1000 entities
_LONGEST = 5000  # characters of a parameter or tag; MLflow's limits are 6000 and more
_ASKED = ("problem", "optimizer", "dimension", "start", "budget", "target", "repetition", "seed", "data_id")
_OF_A_RUN = ("repetition", "seed")
_MEASURED = (
    "best_value", "evaluations", "jacobian_evaluations", "charged", "non_finite", "non_finite_slopes",
    "restarts", "wall_s", "cpu_s", "kmrmse", "kmrmse_aligned", "parameter_error_mm", "parameter_error_rad",
    "parameter_error_mm_aligned", "parameter_error_rad_aligned", "judged_value",
)  # fmt: skip
_TAGS = (
    "status", "stop_reason", "error_type", "error", "library", "library_version", "code_digest", "git_commit", "unit",
    "platform",
)  # fmt: skip


def write_mlflow(study: Study, to: str) -> list[str]:
    """Write the runs of `study` to `to`, a folder or the address of a tracking server; return what is to be said."""
    client = _client(to)
    runs = study.runs
    there = client.get_experiment_by_name(study.store.study)
    experiment = str(client.create_experiment(study.store.study) if there is None else there.experiment_id)
    began: dict[str, int | None] = {  # milliseconds
        row["run_id"]: int(row["started_at"].timestamp() * 1000) if pd.notna(row["started_at"]) else None
        for row in records(runs[["run_id", "started_at"]])
    }
    # half-written and outdated runs go; what stays are the ids of ours, and parents by cell
    known: dict[str, str] = {}  # its number there
    parents: dict[str, str] = {}
    replaced = 0
    token: str | None = ""
    while token is not None:
        page = client.search_runs([experiment], max_results=1000, page_token=token or None)
        for run in page:
            found = run.data.tags
            if found.get(_DONE) != "true":
                if _RUN in found:
                    client.delete_run(run.info.run_id)
            elif _CELL in found:
                parents[found[_CELL]] = run.info.run_id
            elif _RUN in found:
                if began.get(found[_RUN]) not in (None, run.info.start_time):
                    client.delete_run(run.info.run_id)
                    replaced += 1
                else:
                    known[found[_RUN]] = run.info.run_id
        token = page.token or None
    names, titles = method_labels(runs), problem_titles(runs)
    traces = traces_by_run(study.traces)
    added = 0
    for key, cell in runs.groupby(CELL, sort=False, dropna=False):
        new = [row for row in records(cell) if row["run_id"] not in known]
        if not new:
            continue
        first = cell.index[0]
        name = f"{titles[first]} · {names[first]}"
        mark = digest(*[None if part != part else part for part in key])
        if mark not in parents:
            marks, asked = {_CELL: mark, _DONE: "true"}, _asked(new[0], of_run=False)
            parents[mark] = _add(client, experiment, name, marks, asked)
            client.set_terminated(parents[mark])
        for row in new:
            points = [(p.charged, p.value) for p in course_of(row, traces.get(row["run_id"]))]
            tags = {f"calibench.{n}": str(row[n])[:_LONGEST] for n in _TAGS if pd.notna(row[n]) and row[n] != ""}
            marks = {_RUN: row["run_id"], _PARENT: parents[mark]}
            number = _add(
                client, experiment, f"{name} #{row['repetition']}", marks, _asked(row, of_run=True),
                began=began[row["run_id"]], metrics=list(_metrics(row, points)), tags=tags,
            )  # fmt: skip
            client.set_tag(number, _DONE, "true")
            client.set_terminated(number, status=_STATUS.get(row["status"], "FAILED"))
            known[row["run_id"]] = number
            added += 1
    # tags and notes as they are now: those of the study to the experiment, those of a run to the run
    noted = read_notes(study.store.folder)
    client.set_experiment_tag(experiment, "calibench.tags", " ".join(noted.tags))
    client.set_experiment_tag(experiment, _NOTE, "\n\n".join(noted.of_run(""))[:_LONGEST])
    for run_id in {note.run_id for note in noted.notes} & known.keys():
        client.set_tag(known[run_id], _NOTE, "\n\n".join(noted.of_run(run_id))[:_LONGEST])
    again = f", {replaced} of them done again since the last export" if replaced else ""
    where = f"{to}, experiment {study.store.study}"
    return [f"{counted(added, 'run')} added to {where}{again}; {len(runs) - added} stood there"]


def _client(to: str) -> Any:
    try:
        from mlflow.exceptions import MlflowException
        from mlflow.tracking import MlflowClient
    except ImportError:
        raise ValueError("export mlflow: needs mlflow; pip install 'calibench[mlflow]'") from None
    address = to
    if "://" not in to:
        if Path(to).is_file():
            raise ValueError(f"--to {to}: is a file; name a folder, or an address such as http://HOST:PORT")
        os.environ.setdefault("MLFLOW_ALLOW_FILE_STORE", "true")  # newer versions ask that a folder be meant
        address = Path(to).absolute().as_uri()
    try:
        return MlflowClient(tracking_uri=address)
    except (MlflowException, ImportError) as error:
        raise ValueError(f"--to {to}: mlflow does not take it: {str(error).splitlines()[0]}") from None


def _add(
    client: Any, experiment: str, name: str, marks: Mapping[str, str], params: Mapping[str, str],
    began: int | None = None, metrics: Sequence[tuple[str, float, int]] = (), tags: Mapping[str, str] | None = None,
) -> str:  # fmt: skip
    from mlflow.entities import Metric, Param, RunTag

    run = client.create_run(experiment, start_time=began, tags=dict(marks), run_name=name)
    number = str(run.info.run_id)
    labels = [RunTag(*item) for item in (tags or {}).items()]
    client.log_batch(number, params=[Param(*item) for item in params.items()], tags=labels)
    for begin in range(0, len(metrics), _BATCH):
        some = metrics[begin : begin + _BATCH]
        client.log_batch(number, metrics=[Metric(key, value, 0, step) for key, value, step in some])
    return number


def _asked(row: Mapping[str, Any], *, of_run: bool) -> dict[str, str]:
    """Return the parameters: what was asked, the options one by one; those of the run alone where `of_run`."""
    params = {name: str(row[name]) for name in _ASKED if pd.notna(row[name]) and (of_run or name not in _OF_A_RUN)}
    for of in ("problem", "optimizer"):
        for key, value in json.loads(row[f"{of}_options"]).items():
            params[f"{of}.{key}"] = json.dumps(value) if isinstance(value, list | dict) else str(value)
    return {key: value[:_LONGEST] for key, value in params.items()}


def _metrics(row: Mapping[str, Any], points: list[tuple[int, float]]) -> Iterator[tuple[str, float, int]]:
    end = int(row["charged"])
    for charged, value in points:
        yield "best", value, charged
    if points and points[-1][0] < end:
        yield "best", points[-1][1], end
    for name in _MEASURED:
        measured: Any = row.get(name)
        if pd.notna(measured) and isfinite(measured):
            yield name, float(measured), end
    if row["status"] == "failed":  # it reached nothing: it has no answer that was judged
        return
    # the metric of a target is ``charged_to_1e-12``, or above a declared minimum ``charged_to_gap_1e-08``: beside a
    # minimum of 394.48 the levels of small gaps are alike in six digits. Where six are too few to tell the targets
    # apart, all digits are told. MLflow takes no plus sign: 1e+06 is written 1e06
    levels, minimum = [float(level) for level in row["targets"]], row["minimum"]
    gaps = pd.notna(minimum) and minimum != 0
    numbers = [gap_of_level(level, float(minimum)) if gaps else level for level in levels]
    short = [f"{number:.6g}" for number in numbers]
    texts = short if len(set(short)) == len(set(levels)) else [repr(number) for number in numbers]
    for text, hit in zip(texts, row["hits_charged"], strict=True):
        if pd.notna(hit):
            yield ("charged_to_gap_" if gaps else "charged_to_") + text.replace("+", ""), float(hit), end
