"""Parts of a sweep that run apart, and folders that become one."""

import json
import re
from pathlib import Path

import pandas as pd
import pytest

from calibench.bench.commands import study
from calibench.bench.statistics.summary import summary
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep import carry_out
from calibench.core import own_state
from calibench.core.process_state import KINDS
from tests.same_rows import rows

pytestmark = pytest.mark.usefixtures("one_process", "undrawn")

SWEEP = "run -m problem=sensor_zero,full12 optimizer=de,lm budget=60 seeds=6"


@pytest.mark.parametrize("folders", ["apart", pytest.param("in one", marks=pytest.mark.slow)])
def test_shards_are_a_sweep(run_bench, folders):
    counts = []
    for i in (1, 2, 3):
        to = f"shard{i}" if folders == "apart" else "together"
        before = len(rows("together/adhoc")) if folders == "in one" and i > 1 else 0
        assert run_bench(f"{SWEEP} shard={i}/3 results={to}")[0] == 0
        counts.append(len(rows(f"{to}/adhoc")) - before)
    assert run_bench(f"{SWEEP} results=whole")[0] == 0
    assert sum(counts) == len(rows("whole/adhoc")) == 19
    assert min(counts) > 0
    if folders == "apart":
        code, out, _ = run_bench("merge shard1/adhoc shard2/adhoc shard3/adhoc --to together/adhoc")
        assert (code, out) == (0, "19 runs in together/adhoc/runs.parquet, traces.parquet\n")
    pd.testing.assert_frame_equal(rows("together/adhoc"), rows("whole/adhoc"))
    together, whole = ResultStore("together/adhoc"), ResultStore("whole/adhoc")
    pd.testing.assert_frame_equal(together.traces(), whole.traces())
    assert together.manifest()["planned"] == whole.manifest()["planned"]
    assert len(together.manifest()["commands"]) == 3
    assert "(19 done before)" in run_bench(f"{SWEEP} results=together")[1]


@pytest.mark.slow
def test_a_shard_that_is_missing_from_a_merge_is_told(run_bench):
    """Two of three shards are no whole study, and nothing else in it says so: each did all that it had planned."""
    parts = {}
    for i in (1, 2, 3):
        run_bench(f"{SWEEP} shard={i}/3 results=shard{i}")
        parts[i] = set(rows(f"shard{i}/adhoc")["run_id"])
    told = f"{len(parts[3])} runs of this sweep belong to other shards and are not here"
    code, out, _ = run_bench("merge shard1/adhoc shard2/adhoc --to two")
    assert code == 0
    assert told in out
    assert set(ResultStore("two").manifest()["other_shards"]) == parts[3]
    assert told in run_bench("status two")[1]
    run_bench("report two")
    page = Path("two/report.html").read_text()
    assert "of other shards, not here" in page
    assert "other shards" not in run_bench("merge two shard3/adhoc --to three")[1]
    assert "other shards" not in run_bench("status three")[1]
    run_bench("report three")
    assert "of other shards" not in Path("three/report.html").read_text()
    run_bench(f"{SWEEP} results=shard1")
    assert "other shards" not in run_bench("status shard1/adhoc")[1]


def test_shards_of_two_versions_of_the_code_are_told_where_they_are_merged(run_bench):
    for name, digest in (("a", "p.o.g"), ("b", "p.other.g")):
        run_bench(
            f"run problem=sensor_zero optimizer=de budget=60 seeds=4 shard={'12'['ab'.index(name)]}/2 results={name}"
        )
        store = ResultStore(f"{name}/adhoc")
        made, traces = store.runs().assign(code_digest=digest), store.traces()
        assert len(made)
        ResultStore(f"{name}/made").fill(made, traces)
    code, out, _ = run_bench("merge a/made b/made --to c")
    assert code == 0
    assert "1 of 1 cells hold runs of more than one version of the code" in out


def test_what_is_merged_twice_is_taken_once_and_the_sources_stay(run_bench):
    run_bench(f"{SWEEP} results=a")
    run_bench(f"{SWEEP} results=b shard=1/2")
    before = (rows("a/adhoc"), rows("b/adhoc"))
    code, out, _ = run_bench("merge a/adhoc b/adhoc --to c")
    assert code == 0
    assert f"{len(before[1])} runs stood in several folders" in out
    assert set(ResultStore("c").runs()["study"]) == {"c"}
    pd.testing.assert_frame_equal(rows("c"), before[0])
    pd.testing.assert_frame_equal(rows("a/adhoc"), before[0])
    pd.testing.assert_frame_equal(rows("b/adhoc"), before[1])


def test_rows_of_one_run_that_differ_are_not_merged_unless_the_first_is_asked_for(run_bench):
    run_bench("run problem=sensor_zero optimizer=de budget=60 seeds=2 results=a")
    other = ResultStore("b/adhoc")
    mine = ResultStore("a/adhoc")
    other.fill(mine.runs().assign(best_value=1.0), mine.traces())
    code, _, err = run_bench("merge a/adhoc b/adhoc --to c")
    assert code == 2
    assert "2 runs stand in several folders with rows that differ" in err
    assert "best_value" in err
    assert not ResultStore("c").folder.exists()
    assert run_bench("merge a/adhoc b/adhoc --to c --keep-first")[0] == 0
    pd.testing.assert_frame_equal(rows("c"), rows("a/adhoc"))


def test_a_run_that_nobody_collected_is_merged_too(run_bench):
    run_bench("run problem=sensor_zero optimizer=de budget=60 seeds=2 results=a")
    store = ResultStore("b/adhoc")
    store.open()
    from calibench import bench, optimizers, problems

    store.write(bench.execute(problems.make("sensor_zero"), optimizers.make("de"), budget=60, seed=7))
    assert run_bench("merge a/adhoc b/adhoc --to c")[1].startswith("3 runs in c/")
    assert len(store.runs()) == 1
    assert not (store.folder / "runs.parquet").exists()


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("merge a --to a", "stands among what is to be merged"),
        ("merge a", "folders and where to are needed"),
        ("merge nowhere --to c", "there is no such study folder"),
        ("merge a budget=60 --to c", "merge takes no budget=; it takes folders, --to and --keep-first"),
        (f"{SWEEP} shard=0/3", "I/N is needed"),
        (f"{SWEEP} shard=4/3", "I/N is needed"),
        (f"{SWEEP} shard=half", "I/N is needed"),
        (f"{SWEEP} shard=1/2,2/2", "shard=1/2,2/2"),
        (f"{SWEEP} stop_after=0", "1 or more"),
        (f"{SWEEP} stop_after=1,2", "one value is needed"),
        (f"{SWEEP} replay=perhaps", "true, false or null"),
        (f"{SWEEP} execution=ray", "shard=I/N"),
        (f"{SWEEP} execution.name=slurm", "execution=dask execution.address"),
        (f"{SWEEP} execution.address=tcp://here:1", "execution.address"),
        (f"{SWEEP} execution=processes execution.inner=0", "1 to"),
    ],
)
def test_a_mistake_is_one_line_and_nothing_is_written(run_bench, tmp_path, command, message):
    if command.startswith("merge a"):
        run_bench("run problem=sensor_zero optimizer=de budget=60 seeds=1 results=. study=a")
    before = sorted(tmp_path.rglob("*"))
    code, _, err = run_bench(command)
    assert code == 2
    assert err.count("\n") == 1
    assert message in err
    assert sorted(tmp_path.rglob("*")) == before


def test_a_sweep_stops_after_so_many_failures_and_goes_on_when_asked(run_bench, tmp_path):
    (tmp_path / "mine.py").write_text(
        "import numpy as np\nclass Bad:\n    lower, upper, start = -np.ones(2), np.ones(2), np.zeros(2)\n"
        "    def __call__(self, x):\n        raise OSError('the arm is switched off')\n"
    )
    sweep = "run problem=mine.py:Bad optimizer=de budget=60 seeds=50"
    code, out, _ = run_bench(f"{sweep} stop_after=3")
    assert code == 1
    ended = rows("results/adhoc")
    assert set(ended["error_type"]) == {"OSError"}
    done = len(ended)
    assert f"(stop_after=3): {50 - done} of 50 runs left" in out
    assert 3 <= done < 50
    code, out, _ = run_bench(sweep)
    assert code == 1
    assert f"50 runs ({done} done before)" in out
    assert out.count("the arm is switched off") == 1  # 50 runs, one reason
    told = run_bench("status results/adhoc")[1]
    assert told.splitlines()[0] == "results/adhoc: 50 done (50 failed), 0 left"
    assert "50 failed: OSError: the arm is switched off" in told


def test_a_failed_run_is_none_that_ran_out_of_time(run_bench, tmp_path):
    begin = "import time\n\n\nclass {}:\n    lower, upper, start = [-1.0], [1.0], [0.5]\n\n    def __call__(self, x):\n"
    for name, does in (("Raises", "raise ArithmeticError('off')"), ("Sleeps", "return time.sleep(0.3) or 1.0")):
        (tmp_path / f"{name.lower()}.py").write_text(f"{begin.format(name)}        {does}\n")
    words = "-m problem=raises.py:Raises,sleeps.py:Sleeps optimizer=de budget=5 seeds=1 time_limit=0.2"
    code, out, _ = run_bench(f"run {words} --rerun")
    assert code == 1
    assert "\n1 failed, 1 out of time:\n" in out
    assert "the same command with --retry-failed runs them again, and --rerun what other code made\n" in out
    head, *cells = (re.split(r"  +", line) for line in out.splitlines()[-20:] if re.match(r"problem|\w+\.py", line))
    counts = [(cell[head.index("failed")], cell[head.index("out of time")]) for cell in cells[:2]]
    assert sorted(counts) == [("-", "1"), ("1", "-")]
    assert "2 done (1 failed, 1 out of time)" in run_bench("status results/adhoc")[1]
    store = ResultStore("results/adhoc")
    assert summary(store.runs())[["failed", "timeouts"]].values.tolist() == [[1, 0], [0, 1]]
    assert "<th>failed</th><th>out of time</th>" in store._repr_html_()


def test_status_tells_what_is_left_by_cell_and_changes_nothing(run_bench, tmp_path, monkeypatch):
    monkeypatch.setattr(study, "_EVERY", 0.05)
    run_bench(f"{SWEEP} stop_after=1")
    store = ResultStore("results/adhoc")
    labels = store.manifest()["planned"]
    store.forget([run_id for run_id, label in labels.items() if label.startswith("full12")])
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    code, out, _ = run_bench("status results/adhoc")
    assert code == 0
    assert out.splitlines()[0] == "results/adhoc: 7 done (0 failed), 12 left"
    assert sorted(line.split()[0] for line in out.splitlines()[2:]) == ["6", "6"]
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before
    assert run_bench("status --watch results/adhoc")[1].splitlines()[0] == "results/adhoc: 7 done (0 failed), 12 left"


def test_a_dry_run_tells_how_many_and_about_how_long(run_bench, tmp_path):
    code, out, _ = run_bench(f"{SWEEP} --dry-run")
    assert code == 0
    assert "4 cells, 19 runs, 0 done, 19 left" in out
    assert "they take some" in out
    assert list(tmp_path.iterdir()) == []
    run_bench(f"{SWEEP} shard=1/2")
    done = len(rows("results/adhoc"))
    assert f"4 cells, 19 runs, {done} done, {19 - done} left" in run_bench(f"{SWEEP} --dry-run")[1]


def test_a_dry_run_of_many_cells_lists_the_first_and_counts_the_others(run_bench):
    words = SWEEP.replace("budget=60", "budget=20,21,22,23 --dry-run")
    few, every = (run_bench(f"{words}{more}")[1].splitlines() for more in ("", " --all"))
    cells = [line for line in every if " done  " in line]
    assert len(cells) > 12
    assert [line for line in every if line not in few] == cells[10:]
    assert [line for line in few if line not in every] == [
        f"and {len(cells) - 10} cells more; --dry-run --all lists them"
    ]
    assert "give it with --dry-run" in run_bench("run problem=sensor_zero optimizer=de --all")[2]


def test_the_manifest_names_each_run_once(run_bench):
    run_bench(SWEEP)
    manifest = json.loads((ResultStore("results/adhoc").folder / "manifest.json").read_text())
    assert [len(cell["runs"]) for cell in manifest["cells"]] == [6, 1, 6, 6]
    assert "planned" not in manifest


STUDY = """
description: two sweeps
budget: 60
seeds: 2
sweeps:
  - ["problem=sensor_zero,full12", "optimizer=de"]
  - [problem=sensor_zero, optimizer=lm]
"""


@pytest.mark.slow
def test_a_study_in_a_file_of_ones_own(run_bench, tmp_path):
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "mine.yaml").write_text(STUDY)
    assert run_bench("run study=there/mine.yaml shard=1/2")[0] == 0
    assert run_bench("run study=there/mine.yaml shard=2/2")[0] == 0
    runs = ResultStore("results/mine").runs()
    assert (len(runs), set(runs["study"]), set(runs["budget"])) == (5, {"mine"}, {60})
    assert "5 runs (0 done before)" in run_bench("run study=there/mine.yaml budget=30 results=other")[1]
    assert run_bench("report results/mine")[0] == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "there is no file"),
        ("sweeps: [", "cannot be read"),
        ("- a", "sweeps: a list of lists"),
        ("sweeps: [problem=full12]", "sweeps: a list of lists"),
        ("sweeps: [[problem=full21, optimizer=de]]", "did you mean 'full12'"),
    ],
)
def test_a_file_that_is_no_study_is_one_line(run_bench, tmp_path, text, message):
    if text is not None:
        (tmp_path / "mine.yaml").write_text(text)
    code, _, err = run_bench("run study=mine.yaml")
    assert (code, err.count("\n")) == (2, 1)
    assert message in err


def test_where_no_process_can_be_forked_each_run_is_told_of_whatever_lasts(run_bench, monkeypatch):
    number = next(i for i, kind in enumerate(KINDS) if kind.name == "recursion limit")
    monkeypatch.setattr(carry_out, "CAN_FORK", False)
    monkeypatch.setattr(own_state, "_LASTING", [(number, -1)])  # no process can have it
    code, out, err = run_bench("run problem=sensor_zero optimizer=pygmo_de budget=60 seeds=3")
    assert code == 0
    assert "3/3 runs" in err
    assert "3 runs (0 done before)" in out
