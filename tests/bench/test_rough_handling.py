"""What users, their code and killed processes do to a sweep: nothing is lost, nothing is mistaken, nothing raises."""

import os
import signal
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.cli import main
from calibench.bench.execution import request
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.runs import ResultStore

pytestmark = pytest.mark.usefixtures("undrawn")

CODE = """
import sys, os, signal, time
import numpy as np

class Base:
    def __init__(self, kind: str = "ok", opts: dict = {}):
        if kind == "build":
            raise RuntimeError("no hardware")
        self.kind, self.opts = kind, opts
        self.options = {"kind": kind, "opts": opts}
        self.lower, self.upper, self.start = -np.ones(2), np.ones(2), np.full(2, 0.3)
    def __call__(self, x):
        if self.kind == "exit":
            sys.exit(0)
        if self.kind == "die":
            os._exit(7)
        if self.kind == "sleep":
            print('asleep', flush=True)
            time.sleep(60)
        return float(x @ x) + self.opts.get("c", 0)
    def merit(self, x):
        if self.kind == "merit":
            raise KeyError("kmrmse")
        return {}

class Crash:
    def minimize(self, objective, rng):
        objective(objective.start)
        signal.signal(signal.SIGSEGV, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGSEGV)
"""


class Bowl:
    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.5)

    def __call__(self, x):
        return float(x @ x)


@pytest.fixture
def run_bench(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "rough.py").write_text(CODE)
    sys.modules.pop("rough", None)

    def call(command):
        with pytest.raises(SystemExit) as ended:
            main(command.split())
        out = capsys.readouterr()
        return ended.value.code, out.out + out.err

    yield call
    sys.modules.pop("rough", None)


@pytest.fixture
def store(tmp_path):
    store = ResultStore(tmp_path / "study")
    store.open()
    for seed in range(4):
        store.write(bench.execute(problems.make("sensor_zero"), optimizers.make("de"), budget=200, seed=seed))
    return store


@pytest.mark.parametrize("kind", ["exit", "merit"])
def test_code_that_exits_or_fails_in_judging_is_a_failed_row(run_bench, tmp_path, kind):
    code, out = run_bench(f"run -m problem=rough:Base problem.kind={kind},ok optimizer=de budget=20 seeds=2")
    assert code == 1
    assert "2 failed" in out
    runs = ResultStore(tmp_path / "results" / "adhoc").runs()
    assert sorted(runs["status"]) == ["failed", "failed", "ok", "ok"]


def test_a_crash_in_an_optimisers_own_code_is_a_row_with_what_was_found(run_bench, tmp_path):
    code, out = run_bench("run -m problem=rough:Base optimizer=rough:Crash,de budget=20 seeds=1 execution=serial")
    assert code == 1
    assert "ProcessDied" in out
    runs = ResultStore(tmp_path / "results" / "adhoc").runs().set_index("optimizer")
    assert runs["status"].to_dict() == {"rough:Crash": "failed", "de": "ok"}
    assert str(-signal.SIGSEGV) in runs.loc["rough:Crash", "error"]
    assert runs.loc["rough:Crash", "evaluations"] == 1


def test_a_problem_that_cannot_be_built_is_a_wrong_request(run_bench, tmp_path):
    code, out = run_bench("run problem=rough:Base problem.kind=build optimizer=de budget=20 seeds=1")
    assert code == 2
    assert "cannot be built: RuntimeError: no hardware" in out
    assert "(it was given kind=build)" in out  # of a sweep over many settings: which
    assert not (tmp_path / "results").exists()


def test_a_function_that_searches_is_told_what_an_optimiser_is(run_bench, tmp_path):
    (tmp_path / "walks.py").write_text("def walk(objective, rng):\n    objective(objective.start)\n")
    code, out = run_bench("run problem=sensor_zero optimizer=./walks.py:walk budget=20")
    assert code == 2
    assert "returns an optimiser: an object with minimize(objective, rng)" in out


def test_what_an_objective_does_to_its_argument_is_not_seen():
    class Spoiler(Bowl):
        def __call__(self, x):
            value = float(x @ x)
            x *= 0
            return value

    for name in ("de", "nlopt_LN_BOBYQA", "nlopt_LN_COBYLA", "pygmo_cmaes", "ga", "pso", "fmincon"):
        spoilt = bench.execute(Spoiler(), optimizers.make(name), budget=200)
        clean = bench.execute(Bowl(), optimizers.make(name), budget=200)
        assert spoilt.status == "ok"
        assert Bowl()(spoilt.best_x) == spoilt.best_value
        assert clean.status == "ok"


def test_the_target_ends_a_run_that_will_not_stop():
    class Deaf:
        def minimize(self, objective, rng):
            for _ in range(1000):
                try:
                    objective(rng.random(2))
                    objective.batch(rng.random((3, 2)))
                except Exception:
                    continue

    run = bench.execute(Bowl(), Deaf(), budget=500, target=1.5)
    assert run.stop_reason == "target"
    assert run.evaluations < 20
    assert bench.execute(Bowl(), Deaf(), budget=57).charged == 57


def test_reached_is_judged_by_the_target_of_the_run(run_bench, tmp_path):
    for target in ("", "target=1e-5"):
        run_bench(f"run problem=sensor_zero optimizer=trf budget=200 seeds=1 {target}")
    from calibench.bench.statistics import summary as stats

    summary = stats.summary(ResultStore(tmp_path / "results" / "adhoc").runs())
    assert summary["reached"].tolist() == [1, 1]
    assert sorted(summary["goal"]) == [1e-18, 1e-5]


def test_complex_residuals_and_batches_are_failures():
    class Complex(Bowl):
        def residuals(self, x):
            return x * (1 + 1j)

        def batch(self, points):
            return (points**2).sum(axis=1) * 1j

    for name in ("lm", "de"):
        run = bench.execute(Complex(), optimizers.make(name), budget=50)
        assert (run.status, run.row["error_type"]) == ("failed", "TypeError")


def test_a_batch_that_raises_is_paid_for():
    class Stubborn:
        def minimize(self, objective, rng):
            while True:
                try:
                    objective.batch(rng.random((10, 2)))
                except ZeroDivisionError:
                    continue

    class Broken(Bowl):
        def batch(self, points):
            raise ZeroDivisionError

    run = bench.execute(Broken(), Stubborn(), budget=35)
    assert (run.status, run.error_type, run.evaluations) == ("failed", "ZeroDivisionError", 10)


def test_a_random_start_in_an_open_box_is_refused():
    class Open(Bowl):
        lower, upper = np.full(2, -np.inf), np.full(2, np.inf)

    with pytest.raises(ValueError, match="a random start needs finite bounds"):
        bench.execute(Open(), optimizers.make("fmincon"), budget=10, start="random")


def test_numbers_of_numpy_are_numbers():
    run = bench.execute(Bowl(), optimizers.make("de"), budget=np.int64(20), seed=np.int64(1), target=np.float64(1e-9))
    assert run.run_id == bench.execute(Bowl(), optimizers.make("de"), budget=20, seed=1, target=1e-9).run_id


def test_a_kill_between_the_two_tables_neither_doubles_nor_loses(store, monkeypatch):
    runs, traces = store.runs(), store.traces()
    rename, renamed = os.replace, []

    def killed_at(step):
        def replace(source, target):
            if len(renamed) == step:
                raise KeyboardInterrupt
            renamed.append(target)
            rename(source, target)

        return replace

    for step in range(3):
        renamed.clear()
        monkeypatch.setattr(os, "replace", killed_at(step))
        if step < 2:
            with pytest.raises(KeyboardInterrupt):
                store.collect()
        else:
            store.collect()
        monkeypatch.undo()
        pd.testing.assert_frame_equal(store.runs(), runs)
        pd.testing.assert_frame_equal(store.traces(), traces)
        assert len(store.finished()) == 4


def test_a_study_whose_first_step_was_cut_off_begins_again(tmp_path):
    (tmp_path / "cut" / "journal").mkdir(parents=True)
    store = ResultStore(tmp_path / "cut")
    store.open()
    assert store.manifest()["planned"] == {}


def test_a_manifest_without_its_plan_is_named(store):
    (store.folder / "manifest.json").write_text(
        '{"kind": "calibench study", "schema_version": 3, "study": "a", "planned": [1]}'
    )
    with pytest.raises(StoreError, match="entry 'planned' is damaged"):
        store.manifest()


@pytest.mark.parametrize("study", ["../escaped", "/elsewhere/x", ".", "..", "a/b"])
def test_a_study_stays_inside_its_results(run_bench, tmp_path, study):
    code, out = run_bench(f"run problem=sensor_zero optimizer=de budget=10 seeds=1 study={study}")
    assert code == 2
    assert "the name of one folder inside results=" in out
    assert os.listdir(tmp_path) == ["rough.py"]


def test_a_study_without_any_finite_value_is_reported(run_bench, tmp_path):
    (tmp_path / "rough_nan.py").write_text(CODE.replace("return float(x @ x)", 'return float("nan")'))
    assert run_bench("run problem=rough_nan:Base optimizer=de budget=20 seeds=2")[0] == 1  # both runs failed
    assert run_bench("report results/adhoc")[0] == 0
    assert pq.read_table(tmp_path / "results" / "adhoc" / "runs.parquet")["non_finite"].to_pylist() == [20, 20]


def test_a_word_for_a_flag_that_nobody_annotated_is_refused_as_it_would_count_as_true(run_bench, tmp_path):
    (tmp_path / "lids.py").write_text(
        "import numpy as np\n\nclass Pan:\n    lower, upper, start = -np.ones(2), np.ones(2), np.zeros(2)\n\n"
        "    def __init__(self, lid=False, kind='no'):\n        self.lid, self.kind = lid, kind\n\n"
        "    def __call__(self, x):\n        return float(x @ x) + (1.0 if self.lid else 0.0)\n"
    )
    command = "run problem=./lids.py:Pan optimizer=nlopt_LN_BOBYQA budget=20 problem."
    for word in ("no", "Off"):
        code, out = run_bench(f"{command}lid={word}")
        assert code == 2
        assert f"lid={word}: true or false is needed; a word, whatever it says, counts as true" in out
        assert run_bench(f"{command}kind={word} problem.lid=true")[0] == 0


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timer of the system")
def test_a_module_whose_import_hangs_ends_in_a_line(run_bench, monkeypatch):
    monkeypatch.setattr(request, "PATIENCE", 0.5)
    Path("hangs.py").write_text("import time\ntime.sleep(20)\n")
    code, told = run_bench("run problem=hangs.py:Mine optimizer=de budget=100 seeds=1")
    assert code == 2
    assert "cannot import problem 'hangs.py:Mine': TimeoutError: it did not end within 0.5 s" in told
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
