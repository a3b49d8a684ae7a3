"""Results on disk: whole or not at all, collected the same whoever finished first, never lost."""

import json
import os
import platform
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.store import collection
from calibench.bench.store.files.atomic_file import write_whole
from calibench.bench.store.files.journal import Journal, JournalReader, last_ids
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.runs import ResultStore
from calibench.bench.store.schema import RUNS_SCHEMA, TRACES_SCHEMA

pytestmark = pytest.mark.usefixtures("one_process")


@pytest.fixture
def runs():
    p = problems.make("sensor_zero")
    return [bench.execute(p, optimizers.make("de"), budget=200, seed=seed) for seed in range(3)]


@pytest.fixture
def store(tmp_path):
    store = ResultStore(tmp_path / "study")
    store.open()
    return store


def test_what_is_written_is_read_before_and_after_collecting(store, runs):
    for run in runs:
        store.write(run)
    before_runs, before_traces = store.runs(), store.traces()
    assert store.collect() == []
    pd.testing.assert_frame_equal(store.runs(), before_runs)
    pd.testing.assert_frame_equal(store.traces(), before_traces)
    assert set(store.runs()["run_id"]) == {run.run_id for run in runs} == store.finished()
    trace = store.traces().query("run_id == @runs[1].run_id").drop(columns="run_id").reset_index(drop=True)
    pd.testing.assert_frame_equal(trace, runs[1].trace)


READS = {
    "runs": ResultStore.runs,
    "traces": ResultStore.traces,
    "tables": ResultStore.tables,
    "finished": ResultStore.finished,
    "collected": ResultStore.collected,
    "survey": ResultStore.survey,
    "rows_not_ok": lambda store: store.rows_not_ok(["error"]),
    "collect": ResultStore.collect,
    "forget": lambda store: store.forget(store.finished()),
}


@pytest.mark.parametrize("forgotten", [False, True])
@pytest.mark.parametrize("name", READS)
def test_an_operation_reads_the_manifest_once(store, runs, name, forgotten, monkeypatch):
    for run in runs:
        store.write(run)
    if forgotten:
        store.forget([runs[0].run_id])
    read, text_of = [], Path.read_text

    def read_text(path, *args, **options):
        if path.name == "manifest.json":
            read.append(path)
        return text_of(path, *args, **options)

    monkeypatch.setattr(Path, "read_text", read_text)
    READS[name](store)
    assert len(read) == (2 if name == "forget" else 1)  # its caller asks what is finished first


def test_the_tables_do_not_depend_on_who_finished_first(tmp_path, runs):
    tables = []
    for order in (runs, runs[::-1]):
        store = ResultStore(tmp_path / str(len(tables)) / "study")
        store.open()
        for run in order:
            store.write(run)
            store.collect()
        tables.append((store.runs(), store.traces()))
    pd.testing.assert_frame_equal(tables[0][0], tables[1][0])
    pd.testing.assert_frame_equal(tables[0][1], tables[1][1])


def test_schemas_are_explicit_and_no_column_holds_objects(store, runs):
    for run in runs:
        store.write(run)
    store.collect()
    assert pq.read_schema(store.folder / "runs.parquet").equals(RUNS_SCHEMA)
    assert pq.read_schema(store.folder / "traces.parquet").equals(TRACES_SCHEMA)
    assert b"calibench" in pq.read_schema(store.folder / "runs.parquet").metadata
    assert not [c for c, kind in store.runs().dtypes.items() if pd.api.types.is_object_dtype(kind)]
    plain = pd.read_parquet(store.folder / "runs.parquet")
    lists = {f.name for f in RUNS_SCHEMA if pa.types.is_list(f.type)}
    assert {c for c, kind in plain.dtypes.items() if pd.api.types.is_object_dtype(kind)} <= lists


def test_a_column_of_nulls_keeps_its_type(store):
    class Bowl:
        lower, upper, start = [-1.0], [1.0], [0.5]

        def __call__(self, x):
            return float("nan")

    store.write(bench.execute(Bowl(), optimizers.make("de"), budget=5))
    store.collect()
    assert pq.read_schema(store.folder / "runs.parquet").equals(RUNS_SCHEMA)
    assert store.runs()["kmrmse"].isna().all()


def journal_of(store):
    (path,) = (store.folder / "journal").iterdir()
    return path


def test_a_line_that_was_cut_is_no_run_and_costs_no_other(store, runs):
    for run in runs:
        store.write(run)
    path = journal_of(store)
    whole = path.read_bytes()
    last = whole.rstrip(b"\n").rfind(b"\n") + 1
    for end in (last + 1, last + 9, last + 30, len(whole) - 1):
        path.write_bytes(whole[:end])
        assert store.finished() == {run.run_id for run in runs[:2]}
        assert (store.damaged(), len(store.runs())) == ([], 2)
    journal = store.writer(path.stem)  # who goes on with it cuts that line off
    journal.append(runs[2])
    journal.close()
    assert store.finished() == {run.run_id for run in runs}
    assert store.collect() == []
    assert len(store.runs()) == 3


@pytest.mark.parametrize("place", [0, 5, 12, 60, 400, -20])
def test_a_byte_that_has_changed_costs_the_run_of_its_line(store, runs, place):
    for run in runs:
        store.write(run)
    path = journal_of(store)
    lines = path.read_bytes().splitlines(keepends=True)
    bad = bytearray(lines[2])
    bad[place] ^= 1
    path.write_bytes(b"".join([*lines[:2], bytes(bad), *lines[3:]]))
    assert store.damaged() == [path]
    assert store.finished() == {runs[0].run_id, runs[2].run_id}
    assert store.collect() == [store.folder / "quarantine" / path.name]
    assert set(store.runs()["run_id"]) == {runs[0].run_id, runs[2].run_id}
    store.write(runs[1])
    assert store.collect() == []
    assert len(store.runs()) == 3


def test_a_damaged_header_costs_nothing_where_another_copy_is_left(store, runs):
    for i in range(300):
        store.write(replace(runs[0], record=replace(runs[0].record, run_id=f"{i:016x}")))
    path = journal_of(store)
    text = bytearray(path.read_bytes())
    text[20] ^= 1
    path.write_bytes(bytes(text))
    assert len(store.runs()) == 300
    assert store.damaged() == [path]


def test_a_journal_goes_when_it_is_collected_and_its_writer_is_gone(store, runs):
    mine, killed = store.writer(), store.writer("killed")
    mine.append(runs[0])
    killed.append(runs[1])
    os.close(killed._file)  # as a kill does: no word that it ends
    store.write(runs[2])
    store.collect()
    assert journal_of(store) == mine.path
    assert len(store.runs()) == len(store.collected()) == 3
    mine.append(replace(runs[0], record=replace(runs[0].record, run_id="f" * 16)))
    assert len(store.finished()) == 4
    mine.close()
    store.collect()
    assert not (store.folder / "journal").exists()
    assert len(store.runs()) == 4


def test_reading_changes_nothing_in_a_folder(store, runs):
    def seen():
        return {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in store.folder.rglob("*")}

    store.write(runs[0])
    store.collect()
    store.write(runs[1])
    before = seen()
    reader = ResultStore(store.folder)
    reader.runs(), reader.traces(), reader.finished(), reader.collected(), reader.damaged(), reader.manifest()
    assert seen() == before


def test_what_is_nothing_new_is_not_written_again(store, runs):
    for run in runs:
        store.write(run)
    store.collect()
    before = {path: path.stat().st_mtime_ns for path in store.folder.glob("*.parquet")}
    store.collect()
    assert {path: path.stat().st_mtime_ns for path in store.folder.glob("*.parquet")} == before


@pytest.mark.slow
def test_a_sweep_that_does_not_fit_in_memory_is_collected_as_one_that_does(tmp_path, runs, monkeypatch):
    def collected(folder):
        store = ResultStore(folder / "study")
        store.open()
        for part in range(3):  # each time onto what was collected before
            for i in range(40):
                run = runs[i % 3]
                number = i * 7 % 40 + 40 * part
                store.write(replace(run, record=replace(run.record, run_id=f"{number:016x}", repetition=number)))
            store.collect()
        store.forget([f"{number:016x}" for number in (0, 5, 119)])
        return store.runs(), store.traces(), sorted(path.name for path in store.folder.iterdir())

    whole = collected(tmp_path / "whole")
    for name, value in (("_CHUNK", 7), ("_READ", 3000), ("_PIECE", 4000), ("_BATCH", 2)):
        monkeypatch.setattr(collection, name, value)
    in_pieces = collected(tmp_path / "pieces")
    pd.testing.assert_frame_equal(whole[0], in_pieces[0])
    pd.testing.assert_frame_equal(whole[1], in_pieces[1])
    assert whole[2] == in_pieces[2]
    assert len(whole[0]) == 117
    assert whole[0]["repetition"].is_monotonic_increasing


def test_values_are_read_to_the_last_bit(store, runs):
    odd = [0.1 + 0.2, 5e-324, 1.7976931348623157e308, float("inf"), float("-inf"), -0.0]
    began = datetime(2026, 2, 28, 23, 59, 59, 123457, tzinfo=UTC)
    record = replace(runs[0].record, best_x=odd, best_value=float("nan"), hits=[None, 2**62], targets=[1.0, 1e-18],
                     error="a\ttab, a\nline, \u00b5 \U0001f916", started_at=began)  # fmt: skip
    store.write(replace(runs[0], record=record))
    for _ in range(2):
        row = store.runs().iloc[0]
        assert [struct_of(x) for x in row["best_x"]] == [struct_of(x) for x in odd]
        assert row["best_value"] != row["best_value"]
        assert (list(row["hits"]), list(row["targets"])) == ([None, 2**62], [1.0, 1e-18])
        assert row["error"] == record.error
        assert row["started_at"] == began
        store.collect()


def struct_of(x):
    return float(x).hex()


def test_a_row_that_no_table_can_hold_is_set_aside_and_the_others_are_kept(store, runs):
    store.write(runs[0])
    store.write(replace(runs[1], record=replace(runs[1].record, budget=10**30)))
    store.write(runs[2])
    assert store.collect() == [store.folder / "quarantine" / f"{runs[1].run_id}.json"]
    assert set(store.runs()["run_id"]) == {runs[0].run_id, runs[2].run_id}


def test_the_last_runs_of_a_journal_are_found_at_its_end(store, runs):
    journal = store.writer("one")
    for run in runs:
        journal.append(run)
    assert list(last_ids(store.folder, "one").items()) == [(run.run_id, "ok") for run in runs]
    assert last_ids(store.folder, "two") == {}
    journal.close()
    assert len(list(JournalReader(journal.path))) == 3


def test_a_full_disk_leaves_no_half_line(store, runs, monkeypatch):
    journal, write = Journal(store.folder, store.study, "full"), os.write
    journal.append(runs[0])
    size = journal.path.stat().st_size

    def half(file, data):
        if len(data) < 500:
            raise OSError(28, "No space left on device")
        return write(file, data[: len(data) // 2])

    monkeypatch.setattr(os, "write", half)
    with pytest.raises(OSError, match="No space"):
        journal.append(runs[1])
    monkeypatch.undo()
    assert journal.path.stat().st_size == size
    journal.append(runs[2])
    assert store.finished() == {runs[0].run_id, runs[2].run_id}


def test_what_killed_processes_left_is_removed_and_what_is_being_written_is_not(store, runs):
    child = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    here, folder = platform.node(), store.folder
    left = [folder / f"runs.parquet.{int(child.stdout)}@{here}.tmp", folder / "b.parquet.77.tmp"]
    kept = [folder / f"d.parquet.{os.getpid()}@{here}.tmp", folder / "e.1@elsewhere.tmp"]
    for path in (*left, *kept):
        path.write_bytes(b"PAR1 half")
    os.utime(left[1], (0, 0))
    store.write(runs[0])
    store.collect()
    assert sorted(store.folder.rglob("*.tmp")) == sorted(kept)
    assert len(store.runs()) == 1


def test_a_write_that_fails_leaves_the_file_as_it_was(tmp_path):
    path = write_whole(tmp_path / "file", lambda file: file.write(b"old"))

    def fail(file):
        file.write(b"ne")
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="full"):
        write_whole(path, fail)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_forgotten_runs_are_gone_everywhere(store, runs):
    for run in runs:
        store.write(run)
    store.collect()
    store.forget([runs[0].run_id])
    assert store.finished() == {runs[1].run_id, runs[2].run_id}
    assert runs[0].run_id not in set(store.traces()["run_id"])


def test_the_folder_of_many_studies_reads_as_one_table(tmp_path, runs):
    for study, run in zip("ab", runs, strict=False):
        store = ResultStore(tmp_path / study)
        store.open()
        store.write(run)
    both = ResultStore(tmp_path)
    assert both.runs()["study"].tolist() == ["a", "b"]
    assert set(both.traces()["run_id"]) == {run.run_id for run in runs[:2]}


def test_a_run_that_was_forgotten_is_not_found_again_in_the_journal_of_who_is_still_writing(store, runs):
    other = store.writer()
    other.append(runs[0])
    store.forget([runs[0].run_id])
    assert store.finished() == set()
    assert store.runs().empty
    other.append(replace(runs[0], record=replace(runs[0].record, started_at=datetime.now(UTC))))
    assert store.finished() == {runs[0].run_id}
    other.close()
    store.collect()
    assert len(store.runs()) == 1


def test_traces_that_are_gone_are_missed(store, runs):
    for run in runs:
        store.write(run)
    store.collect()
    (store.folder / "traces.parquet").unlink()
    assert store.finished() == set()
    store.write(runs[1])
    store.collect()
    assert store.finished() == {runs[1].run_id} == set(store.runs()["run_id"])


def test_foreign_folders_are_refused(tmp_path):
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / "thesis.txt").write_text("years of work")
    (tmp_path / "file").write_text("")
    for name, message in (("theirs", "no study of ours"), ("file", "is a file")):
        with pytest.raises(StoreError, match=message):
            ResultStore(tmp_path / name).open()
    assert [p.name for p in (tmp_path / "theirs").iterdir()] == ["thesis.txt"]
    with pytest.raises(StoreError, match="no such study folder"):
        ResultStore(tmp_path / "nowhere").runs()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "cannot be read"),
        ("[]", "not a manifest of ours"),
        ('{"kind": "cookbook"}', "not a manifest of ours"),
        (json.dumps({"kind": "calibench study", "schema_version": 99}), "schema 99"),
        ("[" * 100_000 + "]" * 100_000, "nested too deep"),
        (json.dumps({"kind": "calibench study", "schema_version": 1}), "entry 'planned' is damaged"),
        (json.dumps({"kind": "calibench study", "schema_version": 3, "cells": [1]}), "entry 'planned' is damaged"),
        (json.dumps({"kind": "calibench study", "schema_version": 3, "cells": [], "commands": "x"}), "'commands' is"),
    ],
)
def test_a_manifest_that_is_not_ours_is_refused(store, text, message):
    (store.folder / "manifest.json").write_text(text)
    with pytest.raises(StoreError, match=message):
        store.runs()


def test_a_table_that_is_not_ours_is_refused_and_left_alone(store, runs):
    path = store.folder / "runs.parquet"
    for run in runs:
        store.write(run)
    store.collect()
    good = pq.read_table(path)
    ids = good["run_id"]

    def other(**columns):
        table = good
        for name, column in columns.items():
            table = table.set_column(table.schema.get_field_index(name), name, column)
        return table.replace_schema_metadata(good.schema.metadata)

    wrong = {
        "has not our columns": pa.table({"a": [1]}),
        "is it from another program": good.replace_schema_metadata({}),
        "a run_id that another row has": pa.concat_tables([good, good.slice(0, 1)]),
        "1 rows have no run_id": other(run_id=pa.array([None, *ids.to_pylist()[1:]], pa.string())),
        "run_id is dictionary": other(run_id=ids.dictionary_encode()),
        "evaluations is string": other(evaluations=good["evaluations"].cast(pa.string())),
        "rows of study 'theirs'": other(study=pa.array(["theirs"] * 3)),
        "rows of schema 99": other(schema_version=pa.array([99] * 3, pa.int64())),
    }
    for message, table in wrong.items():
        pq.write_table(table, path)
        before = path.read_bytes()
        for read in (store.runs, store.finished, store.collect):
            with pytest.raises(StoreError, match=message):
                read()
        assert path.read_bytes() == before
    path.write_bytes(b"nonsense")
    with pytest.raises(StoreError, match="cannot be read"):
        store.runs()
