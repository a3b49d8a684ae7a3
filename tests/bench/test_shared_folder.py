"""A folder that several processes share: none is refused, no run is lost or stands twice, and what is lost is told."""

import subprocess
import sys
from pathlib import Path

import pytest

from calibench.bench.store.runs import ResultStore
from tests.same_rows import rows

ROOT = Path(__file__).resolve().parents[2]
HOSTILE = """
from pathlib import Path
import numpy as np

class Mine:
    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.3)
    def __init__(self, kind: str = "honest", often: bool = False):
        self.kind, self.often, self.calls = kind, often, 0
    def __call__(self, x):
        self.calls += 1
        journals = list(Path("results/adhoc/journal").glob("*"))
        if self.kind != "honest" and self.calls == 2 and journals and (self.often or not Path("told").exists()):
            Path("told").touch()
            for path in journals:
                getattr(self, self.kind)(path)
        return float(x @ x)
    def writes(self, path):
        with path.open("ab") as file:
            file.write(b"a note of my own")
    def empties(self, path):
        path.write_bytes(b"")
    def deletes(self, path):
        path.unlink()
    def damages(self, path):
        path.write_bytes(path.read_bytes().replace(b"honest", b"hosted"))
"""


@pytest.fixture
def swept(run_bench, fresh):
    """Return a call that sweeps six runs of these kinds, one after the other: exit code, output, errors."""
    (fresh / "mine.py").write_text(HOSTILE)

    def call(kinds, seeds, often="false"):
        words = (
            f"problem.kind={kinds} problem.often={often} optimizer=nlopt_LN_BOBYQA budget=20 seeds={seeds} start=random"
        )
        return run_bench(f"run -m problem=mine.py:Mine {words} execution=serial")

    return call


@pytest.mark.parametrize("rounds", [2, pytest.param(100, marks=pytest.mark.slow)])
def test_processes_begun_at_once_in_one_new_folder_lose_no_run(rounds):
    """Shards and whole sweeps, some killed, clocks that differ; counted is what must not be."""
    most = ["--most", "4"] if rounds < 10 else []
    ended = subprocess.run(
        [sys.executable, "-m", "benchmarks.kills", "at-once", "--rounds", str(rounds), *most],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert f"{rounds} rounds" in ended.stdout


@pytest.mark.parametrize("kind", ["writes", "deletes", "damages"])
def test_what_a_run_does_to_the_rows_of_others_is_told_and_they_are_done_again(swept, kind):
    code, out, err = swept(f"honest,{kind}", 3)
    assert code == 0, out + err
    assert "6 runs (0 done before)" in out
    assert len(rows("results/adhoc")) == 6
    assert ("had ended, and the folder has no row of" in err) == (kind != "writes")


def test_runs_that_have_no_row_in_the_end_are_named_and_are_no_success(swept):
    code, out, err = swept("empties", 6, often="true")
    kept = set(ResultStore("results/adhoc").collected())
    assert code == 1
    assert f"{6 - len(kept)} runs have no row" in out
    assert f"{len(kept)} of 6 runs (0 done before)" in out
    told = out.split("runs have no row")[1]
    planned = ResultStore("results/adhoc").manifest()["planned"]
    assert any(run_id in told for run_id in planned.keys() - kept)
    assert "5 runs had ended, and the folder has no row of them: done once more" in err


def test_a_shard_says_how_many_runs_the_others_still_have(run_bench):
    sweep = "run -m problem=sensor_zero optimizer=de,lm budget=60 seeds=6"
    code, out, _ = run_bench(f"{sweep} shard=1/2")
    others = len(ResultStore("results/adhoc").manifest()["other_shards"])
    assert code == 0
    assert f"{others} runs of this sweep belong to other shards and are not here" in out
    code, out, _ = run_bench(f"{sweep} shard=2/2")
    assert (code, "other shards" in out) == (0, False)


def test_who_makes_a_folder_and_is_killed_leaves_it_to_the_next(tmp_path):
    """A temporary manifest of a process that is gone, or that is just writing it, is no stranger's file."""
    for name in (".lock", ".lock.holder", "manifest.json.77@elsewhere.tmp"):
        (tmp_path / name).touch()
    store = ResultStore(tmp_path)
    store.open()
    assert store.manifest()["planned"] == {}
    store.collect()
    assert {path.name for path in tmp_path.iterdir()} >= {"manifest.json"}
    assert not list(tmp_path.glob("*.tmp"))


def test_plans_of_all_who_share_a_folder_are_one(tmp_path):
    one, other = ResultStore(tmp_path / "study"), ResultStore(tmp_path / "study")
    one.open()
    other.open()
    one.plan({"a": "cell"}, other_shards=["b", "c"])
    other.plan({"b": "cell"}, other_shards=["a", "c"])
    assert one.manifest()["planned"] == {"a": "cell", "b": "cell"}
    assert one.manifest()["other_shards"] == ["c"]
