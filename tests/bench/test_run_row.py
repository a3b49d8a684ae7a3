"""The columns of runs.parquet are declared once: file, documents and statistics hold to the declaration."""

import ast
import itertools
import re
import types
from dataclasses import fields
from datetime import datetime
from pathlib import Path
from typing import get_args, get_origin, get_type_hints

import pyarrow as pa
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.execution.answer import NO_MERIT
from calibench.bench.execution.run_row import COLUMNS, RunRow
from calibench.bench.report.one_run import Found, show_run
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM, SETTING
from calibench.bench.store.arrays import PART_SCHEMA, RUNS_SCHEMA

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "results.md"
NAMES = [column.name for column in COLUMNS]
FROZEN = """
run_id string, study string, problem string, problem_options string, data_id string, dimension int64,
optimizer string, optimizer_options string, library string, library_version string, repetition int64, seed string,
start string, budget int64, target double, evaluations int64, jacobian_evaluations int64, charged int64,
non_finite int64, batch_evaluations int64, residual_evaluations int64, restarts int64, status string,
stop_reason string, error_type string, error string, best_value double, best_evaluation int64,
best_x list<item: double>, inside_box bool, at_bound list<item: string>, parameter_names list<item: string>,
parameter_values list<item: double>, gauge_phi double, kmrmse double, kmrmse_aligned double,
parameter_error_mm double, parameter_error_rad double, parameter_error_mm_aligned double,
parameter_error_rad_aligned double, targets list<item: double>, hits list<item: int64>,
hits_charged list<item: int64>, wall_s double, cpu_s double, git_commit string, git_dirty bool, versions string,
platform string, started_at timestamp[us; tz=UTC], schema_version int64, code_digest string, traceback string,
merit string, unit string, minimum double, judged_value double, judged_evaluations int64,
outside_evaluations int64, tampering string, problem_group string, parameter_units list<item: string>,
parameter_starts list<item: double>, parameter_truths list<item: double>, chance bool, non_finite_slopes int64,
process_changes list<item: string>,
gradient_evaluations int64, joint_evaluations int64
"""


class Noisy:
    """A bowl with noise, no bounds worth the name, and a figure of merit of its own."""

    lower, upper, start, stochastic, minimum, unit = [-1.0], [1.0], [0.5], True, 0.0, "mm"

    def __call__(self, x):
        return float(x[0] ** 2 + 1e-3 * self.rng.standard_normal())

    def merit(self, x):
        return {"kmrmse": abs(x[0]), "smooth": True}


class Broken:
    lower, upper, start = [-1.0], [1.0], [0.5]

    def __call__(self, x):
        raise RuntimeError("no value")


@pytest.fixture(scope="module")
def runs():
    asked = [(problems.make("full12"), "lm"), (problems.make("sensor_zero"), "de"), (Noisy(), "de"), (Broken(), "de")]
    return [bench.execute(problem, optimizers.make(method), budget=60) for problem, method in asked]


def fits(value, kind):
    """Tell whether `value` is one of the declared type."""
    if get_origin(kind) is list:
        return type(value) is list and all(fits(item, get_args(kind)[0]) for item in value)
    if get_origin(kind) is types.UnionType:
        return any(fits(value, part) for part in get_args(kind))
    return isinstance(value, datetime) if kind is datetime else type(value) is kind


def test_the_schema_of_the_file_is_what_it_was():
    frozen = [tuple(column.strip().split(" ", 1)) for column in FROZEN.split(",")]
    assert [(f.name, str(f.type).replace(",", ";")) for f in RUNS_SCHEMA] == frozen


def test_every_value_of_a_row_is_of_its_declared_type(runs):
    hints = get_type_hints(RunRow)
    assert [field.name for field in fields(RunRow)] == NAMES
    for run in runs:
        assert list(run.row) == NAMES
        assert {name: value for name, value in run.row.items() if not fits(value, hints[name])} == {}
    assert [run.status for run in runs] == ["ok", "ok", "ok", "failed"]
    assert runs[2].record.kmrmse == abs(runs[2].best_x[0])
    assert (runs[2].record.merit, runs[2].record.judged_evaluations) == ('{"smooth": true}', 30)


def test_each_merit_of_the_machines_has_its_column():
    assert list(NO_MERIT) == [c.name for c in COLUMNS if c.group == "merit"]
    assert set(problems.make("full12").merit(problems.make("full12").start)) <= set(NO_MERIT)


def test_the_document_lists_the_columns_as_they_are_declared():
    lines = [f"| `{c.name}` | {c.parquet} | {c.meaning} |" for c in COLUMNS]
    text = DOCUMENT.read_text(encoding="utf-8")
    assert [
        line for line in text.splitlines() if re.match(r"\| `\w+` \| (string|int64|double|bool|list|time)", line)
    ] == [*lines]


TABLES_OF_RUNS = ("runs", "mine", "failed")  # what such tables are called there
MADE_THERE = {"instance", "_method"}  # columns that statistics add for themselves


def test_statistics_and_sweeps_name_no_column_that_is_not_declared():
    rooms = [DOCUMENT.parents[1] / "bench" / room for room in ("statistics", "sweep", "commands")]
    parsed = [ast.walk(ast.parse(path.read_text(encoding="utf-8"))) for room in rooms for path in room.rglob("*.py")]
    asked = {
        node.slice.value
        for node in itertools.chain.from_iterable(parsed)
        if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name) and node.value.id in TABLES_OF_RUNS
        if isinstance(node.slice, ast.Constant)
    }
    assert len(asked) > 10
    assert asked <= {*NAMES, *MADE_THERE}


def test_cells_and_the_page_of_a_run_ask_for_declared_columns(runs, tmp_path):
    assert set(CELL) == {*PROBLEM, *METHOD, *SETTING} <= set(NAMES)
    for run in runs:
        row = pa.Table.from_pylist([run.row], RUNS_SCHEMA).to_pandas().to_dict("records")[0]
        assert run.run_id in show_run(Found(row, run.trace, tmp_path))
    assert PART_SCHEMA.names == [*NAMES, "trace"]


def test_a_row_says_the_group_that_its_problem_declares():
    class Grouped(Noisy):
        group = "smooth"

    assert bench.execute(Grouped(), optimizers.make("de"), budget=20).row["problem_group"] == "smooth"
    assert bench.execute(Noisy(), optimizers.make("de"), budget=20).row["problem_group"] == ""
