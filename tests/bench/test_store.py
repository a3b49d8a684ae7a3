"""Results on disk: whole or not at all, collected the same whoever finished first, never lost."""

import json
import os
import platform
import struct
import subprocess
import sys

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.store import runs as store_module
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.runs import ResultStore
from calibench.bench.store.schema import RUNS_SCHEMA, TRACES_SCHEMA


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


def test_a_truncated_part_is_set_aside_and_nothing_else_is_lost(store, runs):
    for run in runs:
        store.write(run)
    part = store.folder / "parts" / f"{runs[1].run_id}.parquet"
    part.write_bytes(part.read_bytes()[:-40])
    assert store.damaged() == [part]
    assert store.finished() == {runs[0].run_id, runs[2].run_id}
    assert store.collect() == [store.folder / "quarantine" / part.name]
    assert store.damaged() == []
    assert set(store.runs()["run_id"]) == {runs[0].run_id, runs[2].run_id}
    store.write(runs[1])
    store.collect()
    assert len(store.runs()) == 3


def test_a_part_truncated_after_collecting_costs_nothing(store, runs):
    for run in runs:
        store.write(run)
    store.collect()
    part = store.folder / "parts" / f"{runs[0].run_id}.parquet"
    part.write_bytes(b"PAR1")
    assert len(store.collect()) == 1
    assert len(store.runs()) == 3


def test_a_half_written_part_is_not_seen(store, runs):
    store.write(runs[0])
    (store.folder / "parts" / "abc.parquet.123.tmp").write_bytes(b"PAR1 half")
    (store.folder / "parts" / "abc.123.tmp").write_bytes(b"PAR1 half")
    assert store.damaged() == []
    assert store.finished() == {runs[0].run_id}


def test_what_is_collected_is_not_read_again(store, runs, monkeypatch):
    for run in runs:
        store.write(run)
    read, opened = [], store_module.read_part
    monkeypatch.setattr(store_module, "read_part", lambda path: read.append(path.stem) or opened(path))
    store.collect()
    assert sorted(read) == sorted(run.run_id for run in runs)  # once each
    assert (len(store.runs()), store.damaged(), len(store.finished()), store.collect()) == (3, [], 3, [])
    assert len(read) == 3


def test_a_byte_that_has_changed_is_noticed(store, runs):
    store.write(runs[0])
    part = store.folder / "parts" / f"{runs[0].run_id}.parquet"
    good = part.read_bytes()
    place = good.index(struct.pack("<d", runs[0].best_value))
    part.write_bytes(good[:place] + bytes([good[place] ^ 1]) + good[place + 1 :])
    assert store.damaged() == [part]
    assert store.finished() == set()


def test_what_killed_processes_left_is_swept_up_and_what_is_being_written_is_not(store, runs):
    child = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    here, parts = platform.node(), store.folder / "parts"
    left = [
        parts / f"a.parquet.{int(child.stdout)}@{here}.tmp",
        parts / "b.parquet.77.tmp",
        parts / "c.1@elsewhere.tmp",
    ]
    kept = [parts / f"d.parquet.{os.getpid()}@{here}.tmp", parts / "e.1@elsewhere.tmp"]
    left.append(store.folder / f"runs.parquet.{int(child.stdout)}@{here}.tmp")
    for path in (*left, *kept):
        path.write_bytes(b"PAR1 half")
    for path in left[1:3]:
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


def test_parts_deleted_after_collecting_are_not_missed(store, runs):
    for run in runs:
        store.write(run)
    store.collect()
    for part in (store.folder / "parts").glob("*.parquet"):
        part.unlink()
    store.collect()
    assert len(store.runs()) == 3
    assert len(store.traces()) == sum(len(run.points) for run in runs)


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
    ],
)
def test_a_manifest_that_is_not_ours_is_refused(store, text, message):
    (store.folder / "manifest.json").write_text(text)
    with pytest.raises(StoreError, match=message):
        store.runs()


def test_a_table_that_is_not_ours_is_refused(store):
    pq.write_table(pa.table({"a": [1]}), store.folder / "runs.parquet")
    with pytest.raises(StoreError, match="has not our columns"):
        store.runs()
    (store.folder / "runs.parquet").write_bytes(b"nonsense")
    with pytest.raises(StoreError, match="cannot be read"):
        store.runs()
