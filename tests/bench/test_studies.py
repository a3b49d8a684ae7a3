"""The catalogue finds every study below a folder, from an index that anybody may delete; notes stand beside tables."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from calibench import bench
from calibench.bench.store.manifest import NOTES, StoreError, read_notes, write_notes
from calibench.bench.store.runs import ResultStore, merge
from calibench.bench.store.tables import write_tables
from calibench.bench.tracking import catalogue as of
from calibench.bench.tracking.catalogue import catalogue
from calibench.bench.tracking.pack import delete
from calibench.bench.tracking.tables import dataset, query
from tests.bench.tracked import run_of, study

OURS = '"kind": "calibench study"'
SLY = '{"tags": ["<b>"], "archived": false, "notes": []}'
DEEP = "[" * 100_000 + "]" * 100_000


@pytest.fixture(autouse=True)
def cache(own_cache, monkeypatch):
    """Return the user's cache folder, with files that count as settled at once."""
    monkeypatch.setattr(of, "_FRESH", -5.0)
    return own_cache


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    study(folder / "one", day=1)
    study(folder / "deeper" / "two", "link_length", "de", day=8)
    arm = folder / "calibrate" / "arm7"
    arm.mkdir(parents=True)
    found = {"schema_version": 1, "case": "arm7", "urdf": "six.urdf", "chosen": "zeros", "before": 3.0, "after": 0.5}
    (arm / "calibration.json").write_text(json.dumps(found))
    return folder


@pytest.fixture
def results(made, tmp_path):
    return Path(shutil.copytree(made, tmp_path / "results"))


def names(results, *words):
    return [entry.study for entry in catalogue(results, words)]


def test_all_that_lies_below_a_folder_is_listed_newest_first(results):
    assert names(results, "kind=runs") == ["deeper/two", "one"]
    assert len(names(results)) == 3
    entry = next(entry for entry in catalogue(results) if entry.study == "one")
    assert (entry.problem, entry.optimizer, entry.budget, entry.status) == (("sensor_zero",), ("lm",), (160,), "ok")
    assert entry.when.startswith("2026-11-02")
    assert entry.commit == run_of().row["git_commit"]
    assert next(e for e in catalogue(results) if e.kind == "calibration").headline == "3 -> 0.5 mm, zeros"


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["optimizer=de"], ["deeper/two"]), (["problem=sensor*"], ["one"]),
        (["problem=sensor*,link*"], ["deeper/two", "one"]),
        (["kind=runs", "optimizer!=de"], ["one"]), (["since=2026-11-05", "until=2026-11-20"], ["deeper/two"]),
        (["kind=runs", "until=2026-11-05T12:00"], ["one"]), (["kind=runs", "status!=ok"], []),
        (["budget=160"], ["deeper/two", "one"]), (["words=LM sensor"], ["one"]),
        (["kind=runs", "words!=LM"], ["deeper/two"]),
    ],
)  # fmt: skip
def test_filters_speak_in_columns(results, words, found):
    assert names(results, *words) == found


def test_words_are_sought_in_notes_too(results):
    write_notes(results / "one", read_notes(results / "one").with_note("before the Floor was raised"))
    assert names(results, "words=floor raised") == ["one"]


@pytest.mark.parametrize(
    ("words", "advice"),
    [
        (["problem=zero"], "; problem=zero: did you mean 'sensor_zero'? choices: link_length, sensor_zero\n"),
        (["optimizer=de", "status=OK", "since=7d"], "; status=OK: did you mean 'ok'? choices: ok\n"),
        (["optimizer=de", "problem=sensor*"], "keeps to this\n"),
    ],
)  # fmt: skip
def test_where_no_study_keeps_to_a_word_what_is_there_is_said(results, run_bench, words, advice):
    for folder in (str(results), f"results={results}"):
        code, out, _ = run_bench(["studies", folder, *words])
        assert code == 0
        assert out.endswith(advice)


@pytest.mark.parametrize("word", ["optimiser=de", "optimizer=", "since=yesterday", "since!=7d", "until=2026-13-01"])
def test_a_filter_that_makes_no_sense_is_one_line(results, word):
    with pytest.raises(ValueError, match=r"^studies: [^\n]{10,400}$"):
        catalogue(results, [word])


def test_the_index_answers_and_nobody_needs_it(results, cache, monkeypatch):
    before = catalogue(results)
    read = []
    monkeypatch.setattr(of, "_read", lambda path, name: read.append(name))
    assert catalogue(results) == before
    assert read == []
    monkeypatch.undo()
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    shutil.rmtree(cache)
    assert catalogue(results) == before


def test_a_change_of_any_file_is_seen(results):
    assert names(results, "optimizer=pso") == []
    study(results / "one", method="pso")
    assert names(results, "optimizer=pso") == ["one"]
    shutil.rmtree(results / "deeper")
    assert names(results, "kind=runs") == ["one"]


def test_a_file_that_has_just_changed_is_not_kept(results, monkeypatch):
    monkeypatch.setattr(of, "_FRESH", 3600.0)
    catalogue(results)
    monkeypatch.setattr(of, "_read", lambda path, name: pytest.fail("read") if name == "kept" else None)
    assert catalogue(results) == []  # all were read again


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path.write_bytes(b"\xffno index"), lambda path: path.write_text("[]"),
        lambda path: _rows(path, []), lambda path: _rows(path, {"study": 3}),
    ],
)  # fmt: skip
def test_a_spoilt_index_is_no_trouble(results, cache, spoil):
    before = catalogue(results)
    [path] = cache.rglob("studies/*.json")
    spoil(path)
    assert catalogue(results) == before
    assert catalogue(results) == before


def _rows(path, row):
    kept = json.loads(path.read_text())
    path.write_text(json.dumps({name: [state, row] for name, (state, _) in kept.items()}))


def test_where_nothing_can_be_written_all_is_read(results, cache, monkeypatch):
    before = catalogue(results)
    shutil.rmtree(cache)
    cache.write_text("a file in the place of the folder")
    assert catalogue(results) == before
    for path in [results, *results.rglob("*")]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    assert catalogue(results) == before
    for path in [results, *results.rglob("*")]:
        path.chmod(0o755 if path.is_dir() else 0o644)


def test_two_lists_at_once_say_the_same(results, cache):
    for k in range(30):
        study(results / f"many_{k}", day=k)
    words = [sys.executable, "-m", "calibench", "studies", str(results), "--json"]
    asked = [subprocess.Popen(words, stdout=subprocess.PIPE) for _ in range(2)]
    told = [one.communicate(timeout=120)[0] for one in asked]
    assert [one.returncode for one in asked] == [0, 0]
    assert told[0] == told[1]
    assert len(json.loads(told[0])) == 33


def _manifest(folder, text):
    folder.mkdir()
    (folder / "manifest.json").write_text(text)


HOSTILE = {
    "pipe": lambda folder: (folder.mkdir(), os.mkfifo(folder / "manifest.json")),
    "deep": lambda folder: _manifest(folder, DEEP),
    "planned": lambda folder: _manifest(folder, f'{{{OURS}, "schema_version": 3, "study": "x", "cells": 3}}'),
    "version": lambda folder: _manifest(folder, f'{{{OURS}, "schema_version": "9", "study": "x", "cells": []}}'),
    "footer": lambda folder: (study(folder), (folder / "runs.parquet").write_bytes(b"PAR1" + b"\xff" * 8 + b"PAR1")),
    "cut": lambda folder: (study(folder), os.truncate(folder / "runs.parquet", 900)),
    "notes": lambda folder: (study(folder), (folder / NOTES).write_text(DEEP)),
    "tags": lambda folder: (study(folder), (folder / NOTES).write_text(SLY)),
    "device": lambda folder: (
        study(folder), (folder / "runs.parquet").unlink(), (folder / "runs.parquet").symlink_to("/dev/zero")
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_damaged_study_is_told_and_hides_no_other(results, name):
    HOSTILE[name](results / "spoilt")
    entry = next(entry for entry in catalogue(results) if entry.study == "spoilt")
    assert entry.status == "damaged"
    assert 5 < len(entry.headline) <= 300
    assert "\n" not in entry.headline
    assert "one" in names(results)


def test_links_and_foreign_files_are_no_studies(results, tmp_path):
    elsewhere = study(tmp_path / "elsewhere")
    (results / "link").symlink_to(elsewhere)
    (results / "loop").symlink_to(results)
    _manifest(results / "other", '{"kind": "a web application"}')
    study(results / "other" / "inside")
    assert names(results, "kind=runs") == ["deeper/two", "one", "other/inside"]


def test_sql_reads_all_studies_and_nothing_else(results, tmp_path):
    pytest.importorskip("duckdb")
    assert query(results, "select problem, optimizer from runs order by 1")[1] == [
        ("link_length", "de"),
        ("sensor_zero", "lm"),
    ]
    assert query(results, "select count(*) from runs join traces using (run_id)")[1][0][0] > 2
    assert query(results, "select machine, after from calibrations")[1] == [("six.urdf", 0.5)]
    assert query(results, "select count(*) from findings")[1] == [(0,)]
    assert query(
        results, "select list_contains(problem, 'link_length') from studies where kind = 'runs' order by study"
    )[1] == [(True,), (False,)]
    (tmp_path / "secret.csv").write_text("a\n1\n")
    before = {path: path.read_bytes() for path in results.rglob("*.parquet")}
    for text in (
        f"select * from read_csv('{tmp_path}/secret.csv')", f"select * from '{tmp_path}/secret.csv'", "drop view runs",
        f"copy (select 1) to '{results}/one/runs.parquet'", "install httpfs", "select 1; select 2", "",
        "set memory_limit = '1GB'",
        f"attach '{tmp_path}/a.db'", "select * from results",
    ):  # fmt: skip
        with pytest.raises(ValueError, match=r"^sql: [^\n]+$"):
            query(results, text)
    assert before == {path: path.read_bytes() for path in results.rglob("*.parquet")}


def test_sql_reads_files_of_any_name_and_of_fewer_columns_and_leaves_out_the_damaged(results):
    pytest.importorskip("duckdb")
    study(results / "odd [1]*?", day=3)
    study(results / "odd 1", "link_length", day=4)
    assert query(results, "select count(*) from runs")[1] == [(4,)]
    shutil.copytree(results / "one", results / os.fsdecode(b"no \xff"))
    assert query(results, "select count(*) from studies where kind = 'runs'")[1] == [(5,)]
    shutil.rmtree(results / os.fsdecode(b"no \xff"))
    traces = results / "one" / "traces.parquet"
    table = pq.read_table(traces).drop_columns(["restart"])
    write_tables([table], table.schema, traces)
    asked = "select count(distinct run_id), count(restart) < count(*) from traces"
    assert query(results, asked)[1:] == ([(3, True)], [])
    for runs in results.rglob("runs.parquet"):  # whichever file is first: no value of another is lost
        whole, table = runs.read_bytes(), pq.read_table(runs).drop_columns(["seed"])
        write_tables([table], table.schema, runs)
        assert query(results, "select count(*), count(seed) from runs")[1:] == ([(4, 3)], [])
        runs.write_bytes(whole)
    for spoilt in (b"PAR1" + b"\xff" * 50 + b"PAR1", b"x"):
        (results / "odd 1" / "traces.parquet").write_bytes(spoilt)
        _, rows, [left_out] = query(results, asked)
        assert (rows, left_out.path) == ([(2, True)], (results / "odd 1").absolute())


def test_sql_leaves_out_a_table_with_a_damaged_byte_wherever_it_is(results):
    pytest.importorskip("duckdb")
    path, asked = results / "one" / "traces.parquet", "select count(distinct run_id) from traces"
    query(results, asked)
    whole, read_at = path.read_bytes(), path.stat()
    footer = len(whole) - 8 - int.from_bytes(whole[-8:-4], "little")
    for at in range(footer // 13, footer, footer // 12):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        os.utime(path, ns=(read_at.st_atime_ns, read_at.st_mtime_ns))  # by the disk, not by a program
        _, [(count,)], [left_out] = query(results, asked)
        assert (count, left_out.path) == (1, path.parent.absolute())


def test_a_dataset_reads_what_is_asked_for(results):
    table = dataset(results, "runs", "optimizer=de").to_table(columns=["problem"])
    assert table.to_pydict() == {"problem": ["link_length"]}
    assert len(bench.studies(results, "kind=runs")) == 2
    with pytest.raises(ValueError, match="table=run: did you mean 'runs'"):
        dataset(results, "run")


def test_a_study_is_tagged_noted_and_archived_and_its_tables_stay(results, run_bench):
    tables = {path: path.read_bytes() for path in results.rglob("*.parquet")}
    where = f"results={results}"
    assert run_bench(["note", "one", "best so far", where])[0] == 0
    run_id = run_of().row["run_id"]
    assert run_bench(["note", run_id[:6], "the one = for the paper", where])[0] == 0
    assert run_bench(["tag", "one", "+paper", "+draft", "-draft", where])[1].endswith("paper\n")
    assert names(results, "tag=paper") == ["one"]
    assert [note.run_id for note in read_notes(results / "one").notes] == ["", run_id]
    assert "note       the one = for the paper" in run_bench(["show", run_id[:6], where])[1]
    assert "best so far" in run_bench(["note", "one", where])[1]
    assert run_bench(["archive", "one", where])[0] == 0
    assert "one" not in names(results)
    assert names(results, "archived=*", "kind=runs") == ["deeper/two", "one"]
    assert run_bench(["archive", "--undo", "one", where])[0] == 0
    assert "one" in names(results)
    assert tables == {path: path.read_bytes() for path in results.rglob("*.parquet")}


@pytest.mark.parametrize(
    "words", [["note", "none", "x"], ["tag", "one", "+<b>"], ["tag", "one"], ["note", "../x", "y"], ["note"]]
)
def test_a_note_of_nothing_is_one_line(results, run_bench, words):
    code, out, error = run_bench([*words, f"results={results}"])
    assert (code, out, error.count("\n")) == (2, "", 1)


def test_notes_go_where_the_study_goes(results, tmp_path, run_bench):
    run_bench(["note", "one", "first", f"results={results}"])
    run_bench(["tag", "deeper/two", "+b", f"results={results}"])
    merge([results / "one", results / "deeper" / "two"], tmp_path / "both")
    merge([results / "one"], tmp_path / "both")
    noted = read_notes(tmp_path / "both")
    assert (noted.tags, [note.text for note in noted.notes]) == (("b",), ["first"])
    (results / "one" / NOTES).write_text("{}")
    with pytest.raises(StoreError, match="holds no notes of ours"):
        read_notes(results / "one")


def test_only_what_is_ours_is_deleted(results, tmp_path, run_bench, monkeypatch):
    one, kept = results / "one", tmp_path / "kept.txt"
    kept.write_text("mine")
    (one / "link").symlink_to(tmp_path)
    (one / "mine.py").write_text("mine")
    where = f"results={results}"
    assert run_bench(["delete", "one", where])[0] == 2  # nobody can be asked
    assert (one / "runs.parquet").exists()
    assert run_bench(["delete", str(tmp_path), where])[0] == 2
    code, out, _ = run_bench(["delete", "one", "--yes", where])
    assert code == 0
    assert "mine.py" in out
    assert sorted(path.name for path in one.iterdir()) == ["link", "mine.py"]
    assert kept.read_text() == "mine"
    delete(results / "deeper" / "two")
    assert not (results / "deeper" / "two").exists()
    (results / "sly").symlink_to(study(tmp_path / "away"))
    assert run_bench(["delete", "sly", "--yes", where])[0] == 2
    assert ResultStore(tmp_path / "away").finished()


def test_a_question_is_asked_and_the_name_is_the_answer(results, run_bench, monkeypatch):
    class Typed:
        def __init__(self, text):
            self.text = text

        def isatty(self):
            return True

        def readline(self):
            return self.text

    monkeypatch.setattr(sys, "stdin", Typed("yes\n"))
    assert run_bench(["delete", "one", f"results={results}"])[0] == 1
    assert Path(results / "one").exists()
    monkeypatch.setattr(sys, "stdin", Typed("one\n"))
    assert run_bench(["delete", "one", f"results={results}"])[0] == 0
    assert not Path(results / "one").exists()
