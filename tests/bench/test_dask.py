"""Runs on Dask: the rows of a serial sweep, whoever dies; what a site's cluster must have; nothing is left running."""

import json
import logging
import multiprocessing
import os
import pickle
import signal
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from time import sleep

import pandas as pd
import pytest

from calibench.bench.cli import main
from calibench.bench.execution.run import Spec
from calibench.bench.gate.processes import Child
from calibench.bench.store.runs import ResultStore
from calibench.bench.workers import dask_seat
from calibench.bench.workers.carrier import Job, Pack
from calibench.bench.workers.dask import ClusterError, cluster
from calibench.bench.workers.dask_seat import Home, difference, home_of
from calibench.bench.workers.dask_worker import _Seat
from tests.few import few
from tests.processes import alive, descendants, wait_for
from tests.same_rows import rows

ROOT = Path(__file__).resolve().parents[2]
CODE = """
import os, signal, time
import numpy as np
import mine_too

class Own:
    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.3)
    def __init__(self, kind: str = "ok"):
        self.kind, self.calls = kind, 0
        if os.environ.get("COUNT"):
            with open(os.environ["COUNT"], "a") as file:
                file.write(f"{os.getpid()}\\n")
    def __call__(self, x):
        self.calls += 1
        if self.kind == "slow":
            time.sleep(0.001)
        if self.kind == "costly":
            time.sleep(0.05)
            if os.environ.get("CALLS"):
                with open(os.environ["CALLS"], "a") as file:
                    file.write("called ")
        if self.calls == 9:
            if self.kind == "parent" and "VECLIB_MAXIMUM_THREADS" in os.environ:  # on a worker, not where it is planned
                os.kill(os.getppid(), signal.SIGKILL)
                time.sleep(60)
        return mine_too.value(x)
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(CODE)
    (tmp_path / "mine_too.py").write_text("def value(x):\n    return float(x @ x)\n")
    return tmp_path


@pytest.fixture
def site(tmp_path_factory):
    """A scheduler and what starts workers of it, as a site would, in a folder where the sweep is not."""
    folder = tmp_path_factory.mktemp("site")
    started = []

    def start(program, *words, path=ROOT):
        environment = {**os.environ, "PYTHONPATH": str(path), "COUNT": os.environ.get("COUNT", "")}
        command = [sys.executable, "-m", f"distributed.cli.dask_{program}", *words, "--no-dashboard"]
        with open(folder / f"{len(started)}.log", "w") as log:
            started.append(subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log))
        return started[-1]

    file = folder / "scheduler.json"
    scheduler = start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
    wait_for(lambda: file.exists() and file.read_text())
    address = json.loads(file.read_text())["address"]

    def worker(threads=1, path=ROOT):
        return start("worker", address, "--no-nanny", "--nthreads", str(threads), path=path)

    yield address, scheduler, worker
    families = [pid for process in started for pid in (process.pid, *descendants(process.pid))]
    for process in reversed(started):
        process.kill()
        process.wait()
    wait_for(lambda: not alive(families), 20)


@pytest.fixture
def bench():
    """What starts `bench run` on dask (of this machine, or of an address), or serially."""
    started = []

    def start(*words, results="results", execution="dask", n=2):
        back_end = {"serial": ["serial"], "dask": ["dask", f"execution.n_jobs={n}"]}
        name, *more = back_end.get(execution, ["dask", f"execution.address={execution}"])
        command = [sys.executable, "-m", "bench", "run", "-m", f"execution={name}", *more, f"results={results}", *words]
        started.append(subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def ended(process, seconds=120):
    out, err = process.communicate(timeout=seconds)
    return process.returncode, out, err


def are_equal(one, other):
    pd.testing.assert_frame_equal(rows(one), rows(other))
    pd.testing.assert_frame_equal(ResultStore(one).traces(), ResultStore(other).traces())


def done(folder="results/adhoc"):
    store = ResultStore(folder)
    return store.finished() if (store.folder / "manifest.json").exists() else set()


@pytest.mark.slow
def test_rows_are_the_same_bits_from_any_number_of_workers_and_from_shards(here, bench):
    words = ["problem=sensor_zero,full12", "optimizer=de,lm,nlopt_LN_BOBYQA,pygmo_cmaes", "budget=60", "seeds=4"]
    assert ended(bench(*words, results="serial", execution="serial"))[0] == 0
    for n in (1, 2):
        assert ended(bench(*words, results=f"dask{n}", n=n))[0] == 0
        are_equal(f"dask{n}/adhoc", "serial/adhoc")
    for i in (1, 2, 3):
        assert ended(bench(*words, f"shard={i}/3", results=f"shard{i}"))[0] == 0
    merge = [sys.executable, "-m", "bench", "merge", *(f"shard{i}/adhoc" for i in (1, 2, 3)), "--to", "merged/adhoc"]
    subprocess.run(merge, check=True, capture_output=True)
    are_equal("merged/adhoc", "serial/adhoc")


@pytest.mark.slow
def test_a_lost_worker_costs_the_run_in_flight_and_the_sweep_goes_on_with_those_that_come(
    here, bench, site, monkeypatch
):
    monkeypatch.setenv("COUNT", str(here / "made"))
    address, _, worker = site
    first = worker()
    process = bench("problem=mine.py:Own", "problem.kind=slow", "optimizer=nlopt_GN_ESCH", "budget=50", "seeds=40",
                    execution=address)  # fmt: skip
    wait_for(lambda: len(done()) >= 5)
    family = descendants(first.pid)
    assert len(family) == 2  # its seat and the child of that
    first.kill()
    wait_for(lambda: not alive(family), 10)
    monkeypatch.delenv("COUNT")
    worker()
    assert ended(process)[0] == 0
    made = len((here / "made").read_text().split())
    assert made <= 40 + 4  # the parent looked at it once; the run in flight, those of the last tenth of a second
    ended(bench("problem=mine.py:Own", "problem.kind=slow", "optimizer=nlopt_GN_ESCH", "budget=50", "seeds=40",
                results="serial", execution="serial"))  # fmt: skip
    are_equal("results/adhoc", "serial/adhoc")


@pytest.mark.parametrize("how", [pytest.param(h, marks=pytest.mark.slow) for h in ("kill", "terminate", "interrupt")])
def test_a_sweep_that_is_ended_leaves_nothing_running_and_goes_on(here, bench, how):
    words = ["problem=mine.py:Own", "problem.kind=slow", "optimizer=nlopt_GN_ESCH", "budget=50", "seeds=60"]
    process = bench(*words)
    wait_for(lambda: len(done()) >= 3)
    family = descendants(process.pid)
    assert len(family) == 6  # two workers, their seats, the children of these
    number = {"kill": signal.SIGKILL, "terminate": signal.SIGTERM, "interrupt": signal.SIGINT}[how]
    process.send_signal(number)
    _, _, err = ended(process)
    assert "Traceback" not in err
    wait_for(lambda: not alive(family), 10)
    before = ResultStore("results/adhoc").runs().set_index("run_id")["started_at"]
    assert 3 <= len(before) < 60
    assert ended(bench(*words))[0] == 0
    after = ResultStore("results/adhoc").runs().set_index("run_id")["started_at"]
    assert len(after) == 60
    pd.testing.assert_series_equal(after[before.index], before)


@pytest.mark.slow
def test_a_run_that_kills_who_started_it_is_a_failed_row_and_a_worker_has_a_child_a_thread(here, bench, site):
    address, _, worker = site
    process = worker(threads=2)
    words = ["problem=mine.py:Own", "problem.kind=parent,slow", "optimizer=nlopt_GN_ESCH", "budget=50", "seeds=6"]
    code, _, err = ended(bench(*words, execution=address))
    assert (code, "Traceback" in err) == (1, False)
    runs = ResultStore("results/adhoc").runs()
    runs["kind"] = runs["problem_options"].str.extract(r'"kind":"(\w+)"')
    assert runs.groupby(["kind", "status"]).size().to_dict() == {("parent", "failed"): 6, ("slow", "ok"): 6}
    failed = runs[runs["kind"] == "parent"]
    assert set(failed["error_type"]) == {"ProcessDied"}
    assert set(failed["error"]) == {"its process ended with exit code -9 (SIGKILL)"}
    assert process.poll() is None
    wait_for(lambda: not descendants(process.pid), 10)  # the seats go with the sweep


@pytest.mark.slow
def test_a_costly_run_tells_how_far_it_is_and_goes_on_where_it_was(here, bench, monkeypatch):
    monkeypatch.setenv("CALLS", str(here / "calls"))
    words = [
        "problem=mine.py:Own",
        "problem.kind=costly",
        "optimizer=nlopt_GN_ESCH",
        "budget=120",
        "seeds=1",
        "replay=true",
    ]
    process = bench(*words, n=1)
    running = Path("results/adhoc/running")
    wait_for(lambda: list(running.glob("*.json")))
    process.kill()
    ended(process)
    before = len((here / "calls").read_text().split())
    process = bench(*words, n=1)
    assert ended(process)[0] == 0
    assert not running.exists()
    assert 10 < before < 120
    assert len((here / "calls").read_text().split()) <= 120 + 10  # what was in flight, and looks at what a call costs
    monkeypatch.delenv("CALLS")
    ended(bench(*words, results="serial", execution="serial"))
    are_equal("results/adhoc", "serial/adhoc")


@pytest.mark.slow
def test_a_scheduler_that_is_lost_ends_the_sweep_in_one_line_and_keeps_what_is_finished(here, bench, site):
    address, scheduler, worker = site
    lost = worker()
    words = ["problem=mine.py:Own", "problem.kind=slow", "optimizer=nlopt_GN_ESCH", "budget=50", "seeds=60"]
    process = bench(*words, execution=address)
    wait_for(lambda: len(done()) >= 3)
    family = descendants(lost.pid)
    scheduler.kill()
    code, _, err = ended(process)
    assert (code, err.count("\nbench:") + err.startswith("bench:")) == (2, 1)
    assert "Traceback" not in err
    assert "the scheduler was lost" in err
    assert len(done()) >= 3
    wait_for(lambda: not alive(family), 20)


@pytest.mark.slow
def test_a_worker_with_another_version_is_refused_before_anything_runs(here, bench, site):
    address, _, worker = site
    other = here / "other" / "calibench-9.9.dist-info"
    other.mkdir(parents=True)
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: calibench\nVersion: 9.9\n")
    worker(path=f"{other.parent}:{ROOT}")
    worker()
    code, _, err = ended(
        bench("problem=mine.py:Own", "optimizer=nlopt_GN_ESCH", "budget=50", "seeds=3", execution=address)
    )
    assert code == 2
    assert "it has calibench 9.9, here it is" in err
    assert len(done()) == 0


@pytest.mark.slow
def test_an_address_where_no_scheduler_is_ends_in_one_line_and_nothing_is_written(here, bench, monkeypatch):
    monkeypatch.setenv("DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT", "1s")
    code, _, err = ended(bench("problem=sensor_zero", "optimizer=nlopt_GN_ESCH", "budget=50", "seeds=1",
                               execution="tcp://127.0.0.1:1"))  # fmt: skip
    assert code == 2
    assert err.startswith("bench: execution.address=tcp://127.0.0.1:1: no Dask scheduler answers there")
    assert err.count("\n") == 1
    assert not Path("results").exists()


def test_a_missing_package_is_named_with_what_installs_it(here, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(SystemExit) as end:
        main(["run", "problem=sensor_zero", "optimizer=nlopt_GN_ESCH", "budget=50", "seeds=1", "execution=dask"])
    assert end.value.code == 2
    assert capsys.readouterr().err == "bench: execution=dask: needs distributed; pip install 'calibench[dask]'\n"
    assert not Path("results").exists()
    with pytest.raises(ClusterError, match="needs distributed"), cluster(1, None):
        pass


def test_nothing_is_said_where_another_dask_has_taken_the_port_of_its_page(capfd, caplog):
    with socket.socket() as taken, suppress(OSError):  # somebody else has it
        taken.bind(("127.0.0.1", 8787))
        taken.listen()
        with cluster(0, None) as there:  # warnings are errors
            assert there.workers() == {}
            logging.getLogger("distributed.core").error("of Dask")
            logging.getLogger("mine").error("of the user")
    assert capfd.readouterr() == ("", "")
    assert [record.message for record in caplog.records if record.levelname == "ERROR"] == ["of the user"]


SETTLE = """
import json, pickle, sys
from pathlib import Path
from calibench.bench.workers.dask_seat import difference, moved, settle
from calibench.bench.workers.carrier import Job, Pack
home, spec = pickle.load(sys.stdin.buffer)
places = settle(home, Path(sys.argv[1]))
spec = moved(Pack((Job("a", spec, "a"),)), places).jobs[0].spec
run = spec.execute()
print(json.dumps([spec.problem, run.run_id, run.record.problem, run.record.code_digest, run.best_value,
                  difference(home)]))
"""


def sent(home, spec, to):
    """Return what another process, which has none of the files of home, makes of a run."""
    import pickle

    moved = tuple(replace(file, path=f"/gone{file.path}", root=f"/gone{file.root}") for file in home.files)
    there = replace(spec, problem=f"/gone{spec.problem}")
    got = subprocess.run(
        [sys.executable, "-c", SETTLE, str(to)], input=pickle.dumps((replace(home, files=moved, path=()), there)),
        capture_output=True, cwd="/", env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert got.returncode == 0, got.stderr.decode()
    return json.loads(got.stdout)


@pytest.mark.parametrize("package", few(1, ["", pytest.param("pack", marks=pytest.mark.slow), "pack/inner"]))
def test_a_file_of_ones_own_is_sent_with_what_it_imports_and_is_the_same_code_there(tmp_path, package, monkeypatch):
    folder = tmp_path / "home" / package
    folder.mkdir(parents=True)
    for part in [Path(package), *Path(package).parents] if package else []:
        if part != Path("."):
            (tmp_path / "home" / part / "__init__.py").write_text("import beside\n")
    (tmp_path / "home" / "beside.py").write_text("SCALE = 2.0\n")
    near = "from .near import value" if package else "from near import value"
    (folder / "near.py").write_text("import beside\ndef value(x):\n    return beside.SCALE * float(x @ x)\n")
    (folder / "own.py").write_text(
        f"import numpy as np\n{near}\nclass Own:\n    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, .3)\n"
        "    def __call__(self, x):\n        return value(x)\n"
    )
    monkeypatch.setattr(sys, "path", [*sys.path])
    spec = Spec(f"{folder / 'own.py'}:Own", {}, "nlopt_GN_ESCH", {}, 30, 0)
    run = spec.execute()
    home = home_of([spec])
    assert len(home.files) == 3 + len(Path(package).parts)
    place, *told = sent(home, spec, tmp_path / "there")
    assert place.startswith(str(tmp_path / "there"))
    assert told == [run.run_id, run.record.problem, run.record.code_digest, run.best_value, ""]
    for name in ("beside", "own", "near", "pack"):
        for module in [m for m in sys.modules if m.split(".")[0] == name]:
            del sys.modules[module]


def test_a_file_below_our_own_folder_is_the_same_code_on_a_worker_that_has_it_elsewhere(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    spec = Spec(f"{ROOT / 'examples' / 'own_problem.py'}:Decay", {}, "nlopt_GN_ESCH", {}, 30, 0)
    run = spec.execute()
    _, *told = sent(home_of([spec]), spec, tmp_path)
    assert told == [run.run_id, run.record.problem, run.record.code_digest, run.best_value, ""]


def test_a_seat_passes_on_in_one_message_what_runs_say_that_end_together(monkeypatch):
    words = [dask_seat.RAN + bytes([number]) for number in range(50)]

    def say(theirs):
        theirs.recv()
        for each in words:
            theirs.send_bytes(each)
            sleep(0.002)

    ours, theirs = multiprocessing.Pipe()
    spec = Spec("sensor_zero", {}, "de", {}, 10, 0)
    child = Child(say)
    monkeypatch.setattr(dask_seat, "sleep", lambda seconds: child.process.join(60))  # all end within one such time
    try:
        assert dask_seat._do(Pack(tuple(Job("a run", spec, "its cell") for _ in words)), child, theirs) is None
    finally:
        child.end()
    theirs.close()
    told = []
    with suppress(EOFError):
        while True:
            told.append(ours.recv_bytes())
    assert [each for message in told for each in pickle.loads(message[1:])] == words
    assert len(told) == 1


def test_the_first_seat_of_a_worker_of_this_machine_is_forked_and_loads_nothing_anew():
    mine, before = Path("/proc/self/cmdline").read_bytes(), {*descendants(os.getpid())}
    with cluster(1, None) as there:
        wait_for(there.workers)
        family = [pid for pid in descendants(os.getpid()) if pid not in before]
        assert [Path(f"/proc/{pid}/cmdline").read_bytes() == mine for pid in family] == [True, True]  # worker and seat
    wait_for(lambda: not alive(family), 10)


@pytest.mark.parametrize("fork", [False, True])
def test_a_seat_is_closed_once_where_two_threads_close_it(monkeypatch, fork):
    descriptors = []

    def slowly(self):
        descriptors.append(self._handle)
        sleep(0.2)  # so that the other thread comes while it is not closed yet
        os.close(self._handle)

    seat = _Seat(fork)
    monkeypatch.setattr(Connection, "_close", slowly)
    with ThreadPoolExecutor(2) as threads:
        codes = [each.result() for each in [threads.submit(seat.close) for _ in range(2)]]
    assert len(descriptors) == 1
    assert codes[0] == codes[1]


def test_what_a_worker_has_otherwise_is_told_in_words():
    home = home_of([Spec("sensor_zero", {}, "nlopt_GN_ESCH", {}, 10, 0)])
    assert difference(home) == ""
    assert difference(replace(home, versions={**home.versions, "numpy": "1.0"})).startswith("it has numpy ")
    assert "code of calibench.problems" in difference(replace(home, code={**home.code, "calibench.problems": "0"}))
    assert "cannot import no.such" in difference(Home(home.versions, {"no.such": "0"}, (), ()))
