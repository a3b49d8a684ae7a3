"""Batches evaluated by several processes: the same row as one process makes, and nothing left of the processes."""

from __future__ import annotations

import faulthandler
import mmap
import os
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.execution.costly import with_batches
from calibench.bench.gate import time_limit
from calibench.bench.gate.endings import ToldError
from calibench.bench.gate.processes import forked
from tests.few import few

TIMES = {"wall_s", "cpu_s", "started_at"}
BATCHED = (
    "de",
    "ga",
    "nine_point",
    "pso",
    "pygmo_cmaes",
    "pygmo_gaco",
    "pygmo_pso_gen",
    "scipy_differential_evolution",
)


class Valley:
    """Rosenbrock's residuals in three variables, called from Python; counts its calls in memory that forks share."""

    lower, upper, start = np.full(3, -2.0), np.full(3, 2.0), np.full(3, -1.2)
    targets = (10.0, 1.0)

    def __init__(self) -> None:
        self._shared = np.frombuffer(mmap.mmap(-1, 8 * 4096), dtype=np.int64)

    @property
    def calls(self) -> int:
        return int(self._shared.sum())

    @property
    def processes(self) -> int:
        return int(np.count_nonzero(self._shared))

    def residuals(self, x: np.ndarray) -> np.ndarray:
        return np.concatenate([10 * (x[1:] - x[:-1] ** 2), 1 - x[:-1]])

    def __call__(self, x: np.ndarray) -> float:
        self._shared[os.getpid() % 4096] += 1
        r = self.residuals(x)
        return float(r @ r)


class Holes(Valley):
    """The same with values that are not finite."""

    def __call__(self, x: np.ndarray) -> float:
        value = super().__call__(x)
        return [value, np.nan, np.inf, -np.inf][int(abs(x[0]) * 7) % 4]


class Fails(Valley):
    """The same; at a place far from the start it does what it was given."""

    def __init__(self, act: Any) -> None:
        super().__init__()
        self._act = act

    @property
    def options(self) -> dict[str, str]:
        return {"act": getattr(self._act, "__name__", "?")}

    def __call__(self, x: np.ndarray) -> float:
        if x[0] > 1.5:
            self._act()
        return super().__call__(x)


def told(run: bench.Run) -> tuple[dict[str, Any], Any]:
    return {k: v for k, v in run.row.items() if k not in TIMES}, run.points


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def children() -> list[int]:
    """Return the processes below this one."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent, state = stat.read_text().rpartition(")")[2].split()[1::-1]
        except OSError:
            continue
        if int(parent) == os.getpid() and state != "Z":
            found.append(int(stat.parent.name))
    return found


@pytest.fixture
def nothing_left() -> Iterator[None]:
    before = set(children())
    yield
    assert set(children()) <= before


@pytest.mark.usefixtures("nothing_left")
@pytest.mark.parametrize(
    ("make", "name"),
    [
        *((Valley, name) for name in BATCHED if name not in ("pso", "pygmo_gaco", "pygmo_pso_gen")),  # as ga and cmaes
        *(pytest.param(Holes, name, marks=[pytest.mark.slow] if k > 0 else []) for k, name in enumerate(BATCHED)),
    ],
)
def test_more_processes_change_no_bit(make: Any, name: str) -> None:
    alone = bench.execute(make(), optimizers.make(name), budget=333, seed=2)
    problem = make()
    together = bench.execute(problem, optimizers.make(name), budget=333, seed=2, inner=3)
    assert told(together) == told(alone)
    assert alone.status == "ok"
    assert problem.processes >= 3


@pytest.mark.parametrize("options", [{}, {"early_abandon": True}])
def test_slices_of_a_compiled_batch_change_no_bit(options: dict[str, Any]) -> None:
    problem = problems.make("full12", n=30)
    alone, together = (
        bench.execute(problem, optimizers.make("de", **options), budget=1000, seed=1, inner=inner) for inner in (1, 3)
    )
    assert told(together) == told(alone)
    assert alone.row["batch_evaluations"] == 1000


@pytest.mark.parametrize("budget", few(2, [1, 149, 151, 400]))
def test_the_budget_is_a_wall_for_all_processes_together(budget: int) -> None:
    problem = Valley()
    run = bench.execute(problem, optimizers.make("de"), budget=budget, inner=3)
    assert problem.calls == run.evaluations == budget


def test_a_target_ends_a_run_at_the_same_evaluation() -> None:
    alone, together = (
        bench.execute(Valley(), optimizers.make("de"), budget=3000, target=1.0, inner=inner) for inner in (1, 3)
    )
    assert alone.stop_reason == "target"
    assert told(together) == told(alone)


@pytest.mark.parametrize("name", optimizers.names())
def test_who_says_batches_asks_in_batches(name: str) -> None:
    class Books:
        def __init__(self) -> None:
            self.most = 0
            self.lower, self.upper, self.start = np.full(2, -1.0), np.full(2, 1.0), np.full(2, 0.5)

        def residuals(self, x: np.ndarray) -> np.ndarray:
            return x - 0.3  # type: ignore[no-any-return]

        def __call__(self, x: np.ndarray) -> float:
            return float((x - 0.3) @ (x - 0.3))

        def batch(self, points: np.ndarray) -> np.ndarray:
            self.most = max(self.most, len(points))
            return ((points - 0.3) ** 2).sum(axis=1)  # type: ignore[no-any-return]

    problem, method = Books(), optimizers.make(name)
    least = method.traits.minimum_budget + 2 * method.traits.minimum_budget_per_dimension
    bench.execute(problem, method, budget=2 * least + 50)
    assert (problem.most > 1) is method.traits.batches
    assert (name in BATCHED) is method.traits.batches


def test_each_thread_gets_the_value_of_its_own_point() -> None:
    wrong: list[Any] = []

    class Threaded:
        traits = optimizers.Traits(batches=True)

        def minimize(self, objective: Any, rng: np.random.Generator) -> None:
            batches = rng.uniform(-2, 2, (12, 8, 3))

            def ask(points: np.ndarray) -> None:
                values = objective.batch(points)
                known = [float(r @ r) for r in map(Valley().residuals, points)]
                if values.tolist() != known:
                    wrong.append((values, known))

            with ThreadPoolExecutor(4) as threads:
                list(threads.map(ask, batches))

    run = bench.execute(Valley(), Threaded(), 96, inner=2)
    assert (run.status, run.evaluations, wrong) == ("ok", 96, [])


@pytest.mark.parametrize(
    ("problem", "name", "inner", "said"),
    [
        (Valley(), "lm", 4, "inner=4: lm asks for one point at a time; methods with batches: de, .*pygmo_cmaes"),
        (Valley(), "de", 0, "inner=0: a number of processes, 1 or more, is needed"),
        (Valley(), "de", "2", "inner=2: a number of processes"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(problem: Any, name: str, inner: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said) as refused:
        bench.execute(problem, optimizers.make(name), budget=100, inner=inner)
    assert "\n" not in str(refused.value)
    assert sorted(with_batches()) == sorted(BATCHED)


def test_noise_and_a_batch_that_may_depend_on_its_points_are_refused() -> None:
    class Noisy(Valley):
        stochastic = True

    class Whole(Valley):
        def batch(self, points: np.ndarray) -> np.ndarray:
            return np.array([self(x) for x in points])

    for problem, said in ((Noisy(), "stochastic"), (Whole(), "splits_batches = True")):
        with pytest.raises(ValueError, match=said):
            bench.execute(problem, optimizers.make("de"), budget=100, inner=2)
    Whole.splits_batches = True  # type: ignore[attr-defined]
    alone, together = (bench.execute(Whole(), optimizers.make("de"), budget=400, inner=inner) for inner in (1, 2))
    assert told(together) == told(alone)


def segfault() -> None:
    faulthandler.disable()  # it would print where it happened
    os.kill(os.getpid(), signal.SIGSEGV)


def leave() -> None:
    os._exit(7)


@pytest.mark.usefixtures("nothing_left")
@pytest.mark.parametrize(("act", "said"), [(segfault, "-11 (SIGSEGV)"), (leave, "7")])
def test_a_process_that_dies_is_a_failed_row(act: Any, said: str) -> None:
    run = bench.execute(Fails(act), optimizers.make("de"), budget=1000, inner=2)
    assert (run.status, run.row["error_type"]) == ("failed", "ProcessDied")
    assert run.row["error"] == f"a process that evaluated points ended with exit code {said}"


def divide() -> None:
    _ = 1 / 0


def exit_like_a_script() -> None:
    sys.exit("no licence")


def raise_what_cannot_be_sent() -> None:
    class Local(Exception):
        def __init__(self, a: int, b: int) -> None:
            super().__init__(f"{a} and {b}")

    raise Local(1, 2)


@pytest.mark.usefixtures("nothing_left")
@pytest.mark.parametrize("act", [divide, exit_like_a_script, raise_what_cannot_be_sent])
def test_what_the_objective_raises_is_the_same_row(act: Any) -> None:
    alone, together = (bench.execute(Fails(act), optimizers.make("de"), budget=1000, inner=inner) for inner in (1, 2))
    (one, points), (other, other_points) = told(alone), told(together)
    assert alone.status == "failed"
    where = one.pop("traceback"), other.pop("traceback")
    assert (one, points) == (other, other_points)
    for text in where:
        assert f"in {act.__name__}" in text
        assert "self._act()" in text


def test_an_exception_whose_class_lives_elsewhere_keeps_its_name_and_text() -> None:
    error = ToldError(b"no pickle", "Licence", "is over", "  File x\n").rebuilt()
    assert (type(error).__name__, str(error)) == ("Licence", "is over")


@pytest.mark.usefixtures("nothing_left")
def test_a_time_limit_ends_the_processes_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_limit, "GRACE", 0.2)
    run = bench.execute(Fails(lambda: time.sleep(60)), optimizers.make("de"), budget=1000, inner=2, time_limit=0.8)
    assert run.status == "timeout"
    assert 0 < run.evaluations < 1000


def test_processes_end_with_a_killed_parent(tmp_path: Path) -> None:
    def sleep_and_tell() -> None:
        (tmp_path / str(os.getpid())).touch()
        time.sleep(60)

    with forked(lambda theirs: bench.execute(Fails(sleep_and_tell), optimizers.make("de"), 1000, inner=2)) as (run, _):
        while len(list(tmp_path.iterdir())) < 2:
            assert run.is_alive()
            time.sleep(0.01)
        assert run.pid is not None
        os.kill(run.pid, signal.SIGKILL)
        run.join()
    left = {int(path.name) for path in tmp_path.iterdir()}
    end = time.monotonic() + 10
    while left and time.monotonic() < end:
        left = {pid for pid in left if is_running(pid)}
        time.sleep(0.01)
    assert not left
