"""Results on disk: whole or not at all, collected the same whoever finished first, never lost."""

import errno
import json
import os
import platform
import re
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
from calibench.bench.store import collection, manifest
from calibench.bench.store.arrays import RUNS_SCHEMA, TRACES_SCHEMA
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.store.journal import Journal, JournalReader, claim, kept_by, line_of
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.runs import ResultStore

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
    read, whole_of = [], manifest.read_whole

    def read_whole(path, *args):
        read.append(path)
        return whole_of(path, *args)

    monkeypatch.setattr(manifest, "read_whole", read_whole)
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
    (path,) = (store.folder / "journal").glob("*.journal")
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
    store.writer().append(runs[2])
    assert store.finished() == {run.run_id for run in runs}
    assert store.collect() == []
    assert len(store.runs()) == 3


@pytest.mark.parametrize("place", [0, 5, 60, -1])
@pytest.mark.parametrize("number", [0, 1, 4])
def test_damage_to_one_line_costs_at_most_the_run_of_that_line(store, runs, number, place):
    """Two of the five lines are headers. The last byte is the newline itself."""
    for run in runs:
        store.write(run)
    path = journal_of(store)
    lines = path.read_bytes().splitlines(keepends=True)
    bad = bytearray(lines[2 * number + 1])  # each follows an empty one
    bad[place] ^= 1
    lines[2 * number + 1] = bytes(bad)
    path.write_bytes(b"".join(lines))
    left = {run.run_id for i, run in enumerate(runs, start=2) if i != number}
    assert store.finished() == left
    assert store.damaged() == ([] if (number, place) == (4, -1) else [path])  # a last line without its end was cut
    assert store.collect() == [store.folder / "quarantine" / path.name for path in [path] if (number, place) != (4, -1)]
    assert set(store.runs()["run_id"]) == left
    for run in runs:
        store.write(run)
    assert store.collect() == []
    assert len(store.runs()) == 3


def test_what_another_program_writes_into_a_journal_costs_no_run(store, runs):
    for run in runs:
        store.write(run)
        with journal_of(store).open("ab") as file:
            file.write(b"not ours, and without an end")
    assert store.finished() == {run.run_id for run in runs}
    assert len(store.collect()) == 1
    assert len(store.runs()) == 3


def test_who_writes_goes_on_in_a_new_journal_when_the_one_before_is_collected(store, runs):
    living = store.writer()
    for run in runs:
        living.append(run)
        assert store.collect() == []
        assert not (store.folder / "journal").exists()
    assert store.collected() == {run.run_id for run in runs}


@pytest.mark.parametrize("moment", ["before the line", "after the line"])
def test_a_line_that_comes_as_its_journal_is_collected_is_kept(store, runs, monkeypatch, moment):
    """The collector has read the journal when the line is written, which then is in a file that nobody reads again."""
    living, write = store.writer(), os.write
    living.append(runs[0])

    def collected_meanwhile(file, data):
        monkeypatch.setattr(os, "write", write)
        if moment == "before the line":
            store.collect()
        written = write(file, data)
        if moment == "after the line":
            store.collect()
        return written

    monkeypatch.setattr(os, "write", collected_meanwhile)
    living.append(runs[1])
    assert store.finished() == {runs[0].run_id, runs[1].run_id}
    store.collect()
    assert store.runs()["run_id"].is_unique
    assert store.collected() == {runs[0].run_id, runs[1].run_id}


def test_what_a_killed_collector_had_claimed_is_seen_and_collected_by_the_next(store, runs):
    for run in runs[:2]:
        store.write(run)
    (reader,) = claim(store.folder)
    assert reader.path.suffix == ".claimed"
    store.writer().append(runs[2])
    assert store.finished() == set(store.runs()["run_id"]) == {run.run_id for run in runs}
    assert store.collect() == []
    assert store.collected() == {run.run_id for run in runs}
    assert not (store.folder / "journal").exists()


def test_who_reads_a_journal_finds_it_under_the_name_that_it_has_now(store, runs):
    for run in runs:
        store.write(run)
    reader = JournalReader(journal_of(store))
    claim(store.folder)
    assert [record.run_id for record in reader] == [state.run_id for state in reader.states()]
    assert len(list(reader)) == 3
    store.collect()
    assert list(reader) == []  # its runs stand in the tables


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


def test_lines_that_were_made_elsewhere_are_kept_at_once_and_headers_stand_between(store, runs):
    journal = store.writer()
    for first in range(0, 600, 60):
        made = [replace(runs[0].record, run_id=f"{i:016x}", repetition=i) for i in range(first, first + 60)]
        journal.append_lines([line_of(replace(runs[0], record=record)) for record in made])
    journal.append(runs[1])
    assert len({*store.runs()["run_id"]}) == 601
    assert journal.path.read_bytes().count(b"\tH\t") == 2 + 2  # two at the beginning, then one after 300 runs each
    assert journal.path.read_bytes().count(b"\tR\t") == 601


def test_journals_that_two_processes_read_give_the_same_tables(tmp_path, runs, monkeypatch):
    readers = set()
    monkeypatch.setattr(collection, "_READ", 3000)
    read = collection.part_table

    def noted(records):
        (tmp_path / "readers" / str(os.getpid())).touch()
        return read(records)

    (tmp_path / "readers").mkdir()
    monkeypatch.setattr(collection, "part_table", noted)

    def collected(workers):
        store = ResultStore(tmp_path / str(workers))
        store.open()
        for number in range(30):
            run = runs[number % 3]
            odd = {"evaluations": "many"} if number == 17 else {}
            record = replace(run.record, run_id=f"{number:016x}", repetition=number, **odd)
            store.write(replace(run, record=record))
        aside = store.collect(workers)
        readers.update(path.name for path in (tmp_path / "readers").iterdir())
        return store.runs().drop(columns="study"), store.traces(), [path.name for path in aside]

    alone = collected(1)
    assert readers == {str(os.getpid())}
    pair = collected(2)
    assert len(readers) > 2
    pd.testing.assert_frame_equal(alone[0], pair[0])
    pd.testing.assert_frame_equal(alone[1], pair[1])
    assert alone[2] == pair[2] == [f"{17:016x}.json"]
    assert len(pair[0]) == 29


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


def test_what_a_writer_has_kept_is_found_by_its_name(store, runs):
    store.writer("one-1").append(runs[0])
    store.writer("one-1").append(runs[1])  # the process that took its place
    store.writer("one-10").append(runs[2])
    assert kept_by(store.folder, "one-1") == {run.run_id: "ok" for run in runs[:2]}
    assert kept_by(store.folder, "two") == {}


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
    """Tables are written by who holds the lock, as we do; the age of a file says nothing, as clocks differ."""
    child = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    here, folder = platform.node(), store.folder
    left = [folder / f"hits.parquet.{int(child.stdout)}@{here}.tmp", folder / "runs.parquet.1@elsewhere.tmp"]
    kept = [folder / f"hits.parquet.{os.getpid()}@{here}.tmp", folder / "hits.parquet.1@elsewhere.tmp"]
    for path in (*left, *kept):
        path.write_bytes(b"PAR1 half")
        os.utime(path, (0, 0))
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


def test_a_file_too_large_to_write_is_named(tmp_path):
    def fail(_):
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))

    with pytest.raises(OSError, match="large") as failed:
        write_whole(tmp_path / "file", fail)
    assert failed.value.filename == str(tmp_path / "file")


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


def test_courses_are_the_traces_in_short_collected_or_not(tmp_path, runs):
    for name, run in zip("ab", runs, strict=False):
        one = ResultStore(tmp_path / name)
        one.open()
        one.write(run)
    ResultStore(tmp_path / "a").collect()  # of the other its journal is read
    for folder in (tmp_path / "a", tmp_path):
        whole, short = ResultStore(folder).traces(), ResultStore(folder).courses()
        assert short["run_id"].dtype == "category"
        ids = short["run_id"].astype(whole["run_id"].dtype)
        pd.testing.assert_frame_equal(short.assign(run_id=ids), whole[["run_id", "charged", "best_value"]])


def test_a_run_that_was_forgotten_is_not_found_again_in_the_journal_of_who_is_still_writing(store, runs):
    other = store.writer()
    other.append(runs[0])
    store.forget([runs[0].run_id])
    assert store.finished() == set()
    assert store.runs().empty
    other.append(replace(runs[0], record=replace(runs[0].record, started_at=datetime(1999, 1, 1, tzinfo=UTC))))
    assert store.finished() == {runs[0].run_id}  # whatever the clock of its machine says
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


def test_a_study_named_without_its_folder_is_found_in_results(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ResultStore(Path("results") / "mine").open()
    for name, told in (("mine", "; did you mean results/mine?"), ("mime", "; did you mean 'results/mine'? choices")):
        with pytest.raises(StoreError, match=re.escape(f"{name}: there is no such study folder{told}")):
            ResultStore(Path(name)).runs()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "cannot be read"),
        ("[]", "not a manifest of ours"),
        ('{"kind": "cookbook"}', "not a manifest of ours"),
        (json.dumps({"kind": "calibench study", "schema_version": 99}), "schema 99"),
        ("[" * 100_000 + "]" * 100_000, "nested too deep"),
        (json.dumps({"kind": "calibench study", "schema_version": 3, "study": "a"}), "entry 'planned' is damaged"),
        (
            json.dumps({"kind": "calibench study", "schema_version": 3, "study": "a", "cells": [1]}),
            "entry 'planned' is damaged",
        ),
        (
            json.dumps({"kind": "calibench study", "schema_version": 3, "study": "a", "cells": [], "commands": "x"}),
            "'commands' is",
        ),
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
        "not the mark of bench, so another program .*: put back a copy": good.replace_schema_metadata({}),
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
    with pytest.raises(StoreError, match="delete both tables"):
        store.runs()
