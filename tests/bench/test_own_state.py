"""A run is a function of its id: what one sets in its process does not reach the next, and its row names it."""

from __future__ import annotations

import json
import random
import re
import subprocess
import sys
from collections import deque
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calibench import bench, optimizers
from calibench.bench.execution.run import Run, Spec
from calibench.bench.store.runs import ResultStore
from calibench.bench.workers.carrier import Job, Packs
from calibench.bench.workers.processes import Processes
from calibench.core.process_state import KINDS
from tests.few import few
from tests.same_rows import rows

ACTS = """
import ctypes, decimal, gc, io, locale, logging, multiprocessing, os, platform, resource, signal, socket, sys
import threading, time, warnings
import numpy as np, threadpoolctl

class Finder:
    def find_spec(self, name, path=None, target=None):
        return None

def up():
    return 0x800 if platform.machine() == "x86_64" else 0x400000

def leave_a_thread():
    threading.Thread(target=time.sleep, args=(1.0,), name="left", daemon=True).start()

def few_files(limit=200):
    resource.setrlimit(resource.RLIMIT_NOFILE, (limit, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))

def is_open(number):
    try:
        return bool(os.fstat(number))
    except OSError:
        return False

def umask():
    before = os.umask(0o77)
    os.umask(before)
    return before

ACTS = {  # name of what is set -> how, and whether it is so
    "threads of libraries": (
        lambda: threadpoolctl.threadpool_limits(3, user_api="blas"),
        lambda: any(one["num_threads"] == 3 for one in threadpoolctl.threadpool_info())),
    "threads": (leave_a_thread, lambda: any(one.name == "left" for one in threading.enumerate())),
    "timers": (lambda: signal.setitimer(signal.ITIMER_REAL, 1000), lambda: any(signal.getitimer(signal.ITIMER_REAL))),
    "signals": (lambda: signal.signal(signal.SIGUSR1, signal.SIG_IGN),
                lambda: signal.getsignal(signal.SIGUSR1) == signal.SIG_IGN),
    "np.seterr": (lambda: np.seterr(under="raise"), lambda: np.geterr()["under"] == "raise"),
    "np.seterrcall": (lambda: np.seterrcall(print), lambda: np.geterrcall() is print),
    "np.setbufsize": (lambda: np.setbufsize(16 * 1024), lambda: np.getbufsize() == 16 * 1024),
    "np.set_printoptions": (lambda: np.set_printoptions(precision=2), lambda: np.get_printoptions()["precision"] == 2),
    "warnings filters": (lambda: warnings.filterwarnings("error", "leak"),
                         lambda: any("leak" in str(one[1]) for one in warnings.filters)),
    "warnings.showwarning": (lambda: logging.captureWarnings(True),
                             lambda: "logging" in warnings.showwarning.__module__),
    "working folder": (lambda: os.chdir("/"), lambda: os.getcwd() == "/"),
    "decimal context": (lambda: setattr(decimal.getcontext(), "prec", 3), lambda: decimal.getcontext().prec == 3),
    "decimal.DefaultContext": (lambda: setattr(decimal.DefaultContext, "prec", 4),
                               lambda: decimal.DefaultContext.prec == 4),
    "locale": (lambda: locale.setlocale(locale.LC_COLLATE, "C.UTF-8"),
               lambda: locale.setlocale(locale.LC_COLLATE) == "C.UTF-8"),
    "environment": (lambda: os.environ.update(TZ="Asia/Tokyo") or time.tzset(), lambda: time.tzname[0] == "JST"),
    "umask": (lambda: os.umask(0o77), lambda: umask() == 0o77),
    "recursion limit": (lambda: sys.setrecursionlimit(1777), lambda: sys.getrecursionlimit() == 1777),
    "limit of digits": (lambda: sys.set_int_max_str_digits(5000), lambda: sys.get_int_max_str_digits() == 5000),
    "switch interval": (lambda: sys.setswitchinterval(0.011), lambda: sys.getswitchinterval() > 0.0105),
    "sys.path": (lambda: sys.path.insert(0, "/leak"), lambda: "/leak" in sys.path),
    "sys.argv": (lambda: sys.argv.append("leak"), lambda: "leak" in sys.argv),
    "sys.meta_path": (lambda: sys.meta_path.append(Finder()), lambda: any(type(x) is Finder for x in sys.meta_path)),
    "standard streams": (lambda: setattr(sys, "stdout", io.StringIO()), lambda: isinstance(sys.stdout, io.StringIO)),
    "standard files": (lambda: os.close(1), lambda: not is_open(1)),
    "hooks of sys": (lambda: setattr(sys, "excepthook", print), lambda: sys.excepthook is print),
    "logging": (lambda: logging.basicConfig(level=1, force=True), lambda: logging.root.level == 1),
    "garbage collection": (gc.disable, lambda: not gc.isenabled()),
    "socket timeout": (lambda: socket.setdefaulttimeout(7), lambda: socket.getdefaulttimeout() == 7),
    "start of processes": (lambda: multiprocessing.set_start_method("spawn", force=True),
                           lambda: multiprocessing.get_start_method(allow_none=True) == "spawn"),
    "floating-point environment": (lambda: ctypes.CDLL("libm.so.6").fesetround(up()),
                                   lambda: ctypes.CDLL("libm.so.6").fegetround() == up()),
    "resource limits": (few_files, lambda: resource.getrlimit(resource.RLIMIT_NOFILE)[0] == 200),
}

class Base:
    lower, upper, start = np.full(2, -1.0), np.full(2, 2.0), np.zeros(2)

    def __call__(self, x):
        return float((x[0] - 0.3) ** 2 + (x[1] - 0.2) ** 2)
"""
CODE = """
import random
import numpy as np
from acts import ACTS, Base

class Sets(Base):
    def __init__(self, what: str, where: str):
        self.what, self.where = what, where
        self.act("init")

    def act(self, where):
        if where == self.where:
            self.where = "done"
            ACTS[self.what][0]()

    def __call__(self, x):
        self.act("call")
        return super().__call__(x)

    def merit(self, x):
        self.act("merit")
        return {"still_set": float(ACTS[self.what][1]())}

class Witness(Base):
    found = None  # what is set as the search begins: to look takes longer than the search

    def __call__(self, x):
        if self.found is None:
            self.found = sum(is_set() for _, is_set in ACTS.values())
        return super().__call__(x) + self.found

    def merit(self, x):
        return {"drawn": random.random() + np.random.rand()}

class Draws(Base):
    def __call__(self, x):
        random.seed(1), np.random.seed(1)
        return super().__call__(x)
"""
IMPORT = """
from acts import ACTS, Base
ACTS[{what!r}][0]()

class Sets(Base):
    def merit(self, x):
        return {{"still_set": float(ACTS[{what!r}][1]())}}
"""
LAZY = """
import acts

class Sets(acts.Base):
    def __call__(self, x):
        import sets_{number}
        return super().__call__(x)

    def merit(self, x):
        return {{"still_set": float(acts.ACTS[{what!r}][1]())}}
"""
NOT_TRIED = {"processor affinity"}  # one core may be all there is
NAMES = list(dict.fromkeys(kind.name for kind in KINDS))
AT_IMPORT = [name for name in NAMES if name not in {"threads", "threads of libraries", "timers", *NOT_TRIED}]

REMOVES = """
import os, sys, warnings
import numpy as np

class Removes:
    lower, upper, start = np.full(2, -1.0), np.ones(2), np.full(2, 0.5)

    def __init__(self, what="sys.path"):
        self.what = what

    def __call__(self, x):
        module, _, name = self.what.partition(".")
        setattr(sys.modules[module], name, None)
        return float(x @ x)
"""


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with problems that each set one thing, and a witness whose value tells what is set."""
    home = tmp_path_factory.mktemp("own_state")
    (home / "acts.py").write_text(ACTS)
    (home / "sets_own_state.py").write_text(CODE)
    for number, what in enumerate(AT_IMPORT):
        (home / f"sets_{number}.py").write_text(IMPORT.format(what=what))
        (home / f"lazy_{number}.py").write_text(LAZY.format(what=what, number=number))
    return home


def specs_of(home: Path) -> list[tuple[Spec, list[str]]]:
    """Return runs and what each changes; of every kind at every place, with witnesses between."""
    found = [(spec(home, f"lazy_{number}.py:Sets"), [what]) for number, what in enumerate(AT_IMPORT)]
    found += [(spec(home, f"sets_{number}.py:Sets"), [what]) for number, what in enumerate(AT_IMPORT)]
    for name in NAMES:
        if name not in {"threads", *NOT_TRIED}:  # a thread of ours would go on beside the next
            for where in ("init", "call", "merit"):
                found.append((spec(home, "sets_own_state.py:Sets", what=name, where=where), [name]))
    found += [(spec(home, "sets_own_state.py:Draws"), [])]
    found += [(spec(home, "sets_own_state.py:Witness", repetition=k), []) for k in range(len(found) // 2)]
    random.Random(3).shuffle(found)
    return found


def spec(home: Path, name: str, repetition: int = 0, **options: str) -> Spec:
    return Spec(f"{home / name}", options, "nlopt_GN_DIRECT", {}, 12, repetition)


@pytest.fixture(scope="module")
def made(home: Path) -> list[tuple[Spec, Run, list[str]]]:
    """Return the runs, made one after the other in this process."""
    return [(spec, spec.execute(), changes) for spec, changes in specs_of(home)]


def test_a_row_names_what_its_run_changed(made: list[tuple[Spec, Run, list[str]]]) -> None:
    wrong = [(spec, run.status, run.error, run.row["process_changes"]) for spec, run, changes in made
             if (run.status, run.row["process_changes"]) != ("ok", changes)]  # fmt: skip
    assert not wrong


def test_what_a_run_sets_holds_to_its_end_and_reaches_no_other(made: list[tuple[Spec, Run, list[str]]]) -> None:
    for spec, run, changes in made:
        if changes:
            assert json.loads(run.row["merit"]) == {"still_set": 1.0}, spec
        else:
            assert run.best_value < 1, spec


@pytest.mark.parametrize("workers", few(1, [2, 1]))
def test_rows_are_the_same_in_any_order_and_with_any_number_of_workers(
    made: list[tuple[Spec, Run, list[str]]], workers: int, tmp_path: Path
) -> None:
    store = ResultStore(tmp_path / "pool")
    store.open()
    jobs = [Job(run.run_id, spec, spec.problem) for spec, run, _ in made]
    random.Random(workers).shuffle(jobs)
    list(Processes(store.folder, "pool", workers).carry(Packs(deque(jobs), workers)))
    here = ResultStore(tmp_path / "here")
    here.open()
    for _, run, _ in made:
        here.write(run)
    first, second = (rows(one).sort_values("run_id").reset_index(drop=True) for one in (here, store))
    pd.testing.assert_frame_equal(first, second)


def test_a_worker_with_a_thread_that_goes_on_makes_no_further_run(home: Path, tmp_path: Path) -> None:
    store = ResultStore(tmp_path / "threads")
    store.open()
    left = spec(home, "sets_own_state.py:Sets", what="threads", where="call")
    three = [left, spec(home, "sets_own_state.py:Witness"), left]
    jobs = deque(Job(f"{k}", one, "a") for k, one in enumerate(three))
    assert [notice.status for notice in Processes(store.folder, "threads", 1).carry(Packs(jobs, 1))] == ["ok"] * 3
    changes = dict(zip(store.runs()["best_value"] < 1, store.runs()["process_changes"].map(list), strict=True))
    assert len(store.runs()) == 2
    assert sorted(store.runs()["process_changes"].map(list)) == [[], ["threads"]], changes
    assert (store.runs()["best_value"] < 1).all()


@pytest.mark.slow
def test_rows_are_the_same_on_every_engine_and_in_shards(home: Path, tmp_path: Path) -> None:
    names = ["sets_own_state.py:Witness", "sets_own_state.py:Draws"]
    names += [f"{word}_{number}.py:Sets" for number in range(2, len(AT_IMPORT), 5) for word in ("sets", "lazy")]
    random.Random(5).shuffle(names)
    tables = []
    for study, words in {
        "serial": [],
        "two": ["execution=processes", "execution.n_jobs=2"],
        "dask": ["execution=dask", "execution.n_jobs=2"],
        "shards": ["shard=1/2", "shard=2/2"],
        "limited": ["time_limit=100"],
    }.items():
        parts = [[word] for word in words] if study == "shards" else [words]
        for part, more in enumerate(parts):
            asked = [f"./{name}" for name in (names if study != "two" else names[::-1])]
            command = [sys.executable, "-m", "bench", "run", "-m", f"problem={','.join(asked)}", "budget=12", "seeds=3",
                       "optimizer=nlopt_GN_DIRECT", f"study={study}{part}", f"results={tmp_path}", *more]  # fmt: skip
            done = subprocess.run(command, capture_output=True, text=True, cwd=home)
            assert done.returncode == 0, done.stderr + done.stdout
        tables.append(pd.concat([rows(tmp_path / f"{study}{part}") for part in range(len(parts))]))
    first, *others = (table.sort_values("run_id").reset_index(drop=True) for table in tables)
    for other in others:
        pd.testing.assert_frame_equal(first, other)


def test_our_own_runs_change_nothing_and_a_users_own_process_gets_all_back() -> None:
    class Strict:
        lower, upper, start = np.full(2, -1.0), np.full(2, 2.0), np.zeros(2)

        def __call__(self, x: np.ndarray) -> float:
            np.seterr(all="raise")
            return float(x @ x)

        def merit(self, x: np.ndarray) -> dict[str, float]:
            return {"still_set": float(np.geterr()["over"] == "raise")}

    before = np.geterr()
    run = bench.execute(Strict(), optimizers.make("nlopt_GN_DIRECT"), budget=10)
    assert (run.row["process_changes"], np.geterr()) == (["np.seterr"], before)
    limited = bench.execute(Strict(), optimizers.make("nlopt_GN_DIRECT"), budget=10, time_limit=50)
    assert limited.row["process_changes"] == ["np.seterr"]
    assert run.row["merit"] == limited.row["merit"] == '{"still_set": 1.0}'


@pytest.mark.parametrize(
    "methods",
    few(1, [["lm", "de", "pygmo_de", "scipy_cobyla"], ["trf", "fmincon", "ga", "pso", "nlopt_LD_SLSQP", "scipy_shgo"]]),
    ids=" ".join,
)
def test_no_method_of_ours_is_blamed_on_a_users_problem(methods: list[str]) -> None:
    """Each in a fresh process, where the first run loads the libraries: a fork of one that has none."""
    code = """if True:
        import os, sys
        import numpy as np
        from calibench import bench, optimizers
        class Mine:
            lower, upper, start = np.full(2, -1.0), np.full(2, 2.0), np.zeros(2)
            def __call__(self, x):
                return float(x @ x)
            def residuals(self, x):
                return x
        for method in sys.argv[1:]:
            assert not {"scipy", "numba", "pygmo", "nlopt"} & {*sys.modules}
            if not os.fork():
                for _ in range(2):
                    print(bench.execute(Mine(), optimizers.make(method), budget=60).row["process_changes"])
                break
            assert os.wait()[1] == 0
    """
    done = subprocess.run([sys.executable, "-c", code, *methods], capture_output=True, text=True)
    assert done.stdout.split() == ["[]", "[]"] * len(methods), done.stderr


def test_the_terminal_and_show_tell_what_runs_changed(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from calibench.bench.cli import main

    monkeypatch.chdir(home)
    with pytest.raises(SystemExit):
        main(["run", "problem=sets_3.py:Sets", "optimizer=de", "budget=20", "seeds=2", f"results={tmp_path}"])
    what = AT_IMPORT[3]
    told = capsys.readouterr().out
    assert f"2 runs changed the state of the process, which was put back: {what} by de on sets_3.py:Sets" in told
    (run_id, _) = bench.ResultStore(tmp_path / "adhoc").runs()["run_id"]
    with pytest.raises(SystemExit):
        main(["show", run_id, f"results={tmp_path}"])
    assert re.search(f"process.*{re.escape(what)}", capsys.readouterr().out)


def test_another_generator_behind_np_random_is_gone_after_the_run() -> None:
    class Swaps:
        lower, upper, start = np.full(2, -1.0), np.ones(2), np.full(2, 0.5)

        def __call__(self, x: np.ndarray) -> float:
            np.random.set_bit_generator(np.random.PCG64(1))
            return float(x @ x)

    np.random.seed(3)  # noqa: NPY002
    np.random.standard_normal()  # noqa: NPY002  of two that are drawn at once the second is kept
    expected = np.random.RandomState(3).standard_normal(4)[1:]
    runs = [bench.execute(Swaps(), optimizers.make("de"), budget=20) for _ in range(2)]
    assert [run.row["status"] for run in runs] == ["ok", "ok"]
    assert np.random.standard_normal(3).tolist() == expected.tolist()  # noqa: NPY002


def test_state_that_a_run_puts_beyond_reading_is_named(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from calibench.bench.cli import main

    (home / "removes.py").write_text(REMOVES)
    monkeypatch.chdir(home)
    lists = "problem.what=sys.path,os.environ,warnings.filters,sys.excepthook"
    with pytest.raises(SystemExit) as ended:
        main(
            [
                "run",
                "-m",
                "problem=removes.py:Removes",
                lists,
                "optimizer=de",
                "budget=20",
                "seeds=1",
                f"results={tmp_path}",
            ]
        )
    said = capsys.readouterr()
    assert ended.value.code == 0, said.err
    runs = bench.ResultStore(tmp_path / "adhoc").runs()
    found = {(json.loads(row.problem_options)["what"], *row.process_changes) for row in runs.itertuples()}
    assert found == {
        ("sys.path", "sys.path"), ("os.environ", "environment"),
        ("warnings.filters", "warnings filters"), ("sys.excepthook", "hooks of sys"),
    }  # fmt: skip


def test_whose_a_file_is_is_told_without_an_import() -> None:
    """It is asked as imports end, those of Python's own folders among them, and would ask itself half-way."""
    code = (
        "import builtins; from pathlib import Path; from calibench.core.sources import is_local\n"
        "builtins.__import__ = lambda *_: 1 / 0\n"
        "assert is_local(Path('/somewhere/mine.py'))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
