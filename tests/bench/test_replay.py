"""A run that is killed goes on where it was, whatever library searches, and its row is that of a run left alone."""

from __future__ import annotations

import errno
import json
import mmap
import os
import signal
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibench import bench, optimizers
from calibench.bench.execution import costly
from calibench.bench.execution.costly import ReplayFolder, forget_finished, forget_replay
from calibench.bench.gate import replay
from calibench.bench.gate.processes import forked
from calibench.bench.gate.replay import ReplayFile, answer_of, written
from tests.few import few

TIMES = {"wall_s", "cpu_s", "started_at"}


class Valley:
    """Rosenbrock's residuals in three variables; a call takes `sleep` seconds, a Jacobian too."""

    lower, upper, start = np.full(3, -2.0), np.full(3, 2.0), np.array([-1.2, 1.0, 1.0])
    targets = (1.0, 1e-3)
    options: dict[str, Any] = {}  # noqa: RUF012  # how long it takes is no part of what it is

    def __init__(self, sleep: float = 0.0) -> None:
        self.sleep, self._shared = sleep, np.frombuffer(mmap.mmap(-1, 8 * 4096), dtype=np.int64)

    @property
    def calls(self) -> int:  # in all processes
        return int(self._shared.sum())

    def residuals(self, x: np.ndarray) -> np.ndarray:
        self._shared[os.getpid() % 4096] += 1
        time.sleep(self.sleep)
        return np.concatenate([10 * (x[1:] - x[:-1] ** 2), 1 - x[:-1]])

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        time.sleep(self.sleep)
        slopes = np.zeros((3, 4))  # laid out in columns, and handed over turned
        slopes[[0, 1], [0, 1]], slopes[[1, 2], [0, 1]], slopes[[0, 1], [2, 3]] = -20 * x[:-1], 10, -1
        return slopes.T

    def __call__(self, x: np.ndarray) -> float:
        r = self.residuals(x)
        return float(r @ r)


class Holes(Valley):
    """Values that are not finite, the sign of nothing kept."""

    def __call__(self, x: np.ndarray) -> float:
        value = super().__call__(x)
        return [value, np.nan, np.inf, -np.inf, value][int(abs(x[0]) * 9) % 5]


class Noisy(Valley):
    """Values with noise, drawn in the order of the calls."""

    stochastic = True

    def __call__(self, x: np.ndarray) -> float:
        return super().__call__(x) + self.rng.standard_normal()  # type: ignore[attr-defined,no-any-return]


class Together(Valley):
    """All values of a generation in one call."""

    def batch(self, points: np.ndarray) -> np.ndarray:
        return np.array([self(x) for x in points])


def told(run: bench.Run) -> tuple[dict[str, Any], Any]:
    return {k: v for k, v in run.row.items() if k not in TIMES}, run.points


def replay_path(folder: Path, run_id: str) -> Path:
    return folder / "replay" / f"{run_id}.journal"


def journal(folder: Path) -> Path:
    [path] = (folder / "replay").iterdir()
    return path


def killed_in_the_middle(run: Callable[[], Any], folder: Path, enough: int = 3000) -> None:
    """Make a run in a process that is killed by signal 9 as soon as its journal holds so many bytes."""
    with forked(lambda theirs: run()) as (child, _):
        end = time.monotonic() + 60
        while not sum(p.stat().st_size for p in (folder / "replay").glob("*")) > enough:
            assert child.is_alive(), "it ended before it could be killed"
            assert time.monotonic() < end
            time.sleep(0.002)
        assert child.pid is not None
        os.kill(child.pid, signal.SIGKILL)
        child.join()
        assert child.exitcode == -signal.SIGKILL


METHODS = ["de", "pygmo_cmaes", "nlopt_LN_BOBYQA", "lm", "nlopt_LD_SLSQP"]


@pytest.mark.parametrize("name", METHODS)
def test_a_killed_run_goes_on_to_the_same_row(name: str, tmp_path: Path) -> None:
    method, folder = optimizers.make(name), ReplayFolder(tmp_path, always=True)
    uninterrupted = bench.execute(Valley(), method, 160, seed=3)
    killed_in_the_middle(lambda: bench.execute(Valley(0.005), method, 160, seed=3, replay=folder), tmp_path)
    problem = Valley()
    resumed = bench.execute(problem, method, 160, seed=3, replay=folder)
    assert told(resumed) == told(uninterrupted)
    assert 0 < problem.calls < 150 * uninterrupted.evaluations / 160


@pytest.mark.parametrize("make", few(2, [Valley, Holes, Noisy, Together]))
@pytest.mark.parametrize("how", [{}, {"time_limit": 60}, {"inner": 2}, {"inner": 2, "time_limit": 60}], ids=str)
def test_it_goes_on_in_every_way_of_running(make: Any, how: dict[str, Any], tmp_path: Path) -> None:
    if make in (Noisy, Together) and "inner" in how:
        with pytest.raises(ValueError, match="inner=2"):
            bench.execute(make(), optimizers.make("de"), 100, **how)
        return
    method, folder = optimizers.make("de", population=10), ReplayFolder(tmp_path, always=True)
    uninterrupted = bench.execute(make(), method, 101, seed=1)
    killed_in_the_middle(lambda: bench.execute(make(0.003), method, 101, seed=1, replay=folder, **how), tmp_path, 700)
    problem = make()
    assert told(bench.execute(problem, method, 101, seed=1, replay=folder, **how)) == told(uninterrupted)
    judged = 30 if make is Noisy else 0  # fresh calls that judge the answer
    assert problem.calls < 101 + judged
    again = make()
    assert told(bench.execute(again, method, 101, seed=1, replay=folder)) == told(uninterrupted)
    assert again.calls == judged


class Wanderer:
    """Asks what it is given, in order."""

    traits = optimizers.Traits()
    options: dict[str, Any] = {}  # noqa: RUF012

    def __init__(self, *places: float, how: str = "__call__") -> None:
        self._places, self._how = places, how

    def minimize(self, objective: Any, rng: np.random.Generator) -> Any:
        for place in self._places:
            getattr(objective, self._how)(np.full(3, place))


def test_another_point_than_before_ends_the_run_and_says_so(tmp_path: Path) -> None:
    folder = ReplayFolder(tmp_path, always=True)
    bench.execute(Valley(), Wanderer(0.1, 0.2, 0.3), 100, replay=folder)
    run = bench.execute(Valley(), Wanderer(0.1, np.nextafter(0.2, 1), 0.3), 100, replay=folder)
    assert (run.status, run.row["error_type"], run.evaluations) == ("failed", "ReplayDiffers", 2)
    assert run.row["error"].startswith(
        "evaluation 2 after a kill: the optimiser or its library asks for a value at another point than before"
    )
    assert "same versions?" in run.row["error"]
    run = bench.execute(Valley(), Wanderer(0.1, 0.2, how="residuals"), 100, replay=folder)
    assert (run.status, run.row["error_type"], run.evaluations) == ("failed", "ReplayDiffers", 1)


def test_an_optimiser_that_swallows_the_difference_fails_all_the_same(tmp_path: Path) -> None:
    class Deaf(Wanderer):
        def minimize(self, objective: Any, rng: np.random.Generator) -> Any:
            for _ in range(200):
                try:
                    super().minimize(objective, rng)
                except Exception:
                    continue

    folder = ReplayFolder(tmp_path, always=True)
    bench.execute(Valley(), Wanderer(0.1), 100, replay=folder, optimizer_name="w")
    for places in ((0.2,), (0.1, 0.2)):
        run = bench.execute(Valley(), Deaf(*places), 100, replay=folder, optimizer_name="w")
        differs = places == (0.2,)
        assert run.row["error_type"] == ("ReplayDiffers" if differs else "")


@pytest.mark.parametrize("cut", [1, 7, 40])
def test_a_torn_tail_is_cut(cut: int, tmp_path: Path) -> None:
    method, folder = optimizers.make("lm"), ReplayFolder(tmp_path, always=True)
    whole = bench.execute(Valley(), method, 60, replay=folder)
    path = journal(tmp_path)
    before = path.read_bytes()
    path.write_bytes(before[:-cut])
    problem = Valley()
    assert told(bench.execute(problem, method, 60, replay=folder)) == told(whole)
    assert problem.calls == 1
    assert path.read_bytes().count(b"\n") == before.count(b"\n")


def test_from_a_flipped_bit_on_nothing_is_believed(tmp_path: Path) -> None:
    method, folder = optimizers.make("nlopt_LN_BOBYQA"), ReplayFolder(tmp_path, always=True)
    whole = bench.execute(Valley(), method, 60, replay=folder)
    path = journal(tmp_path)
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 1
    path.write_bytes(raw)
    problem = Valley()
    assert told(bench.execute(problem, method, 60, replay=folder)) == told(whole)
    assert 25 < problem.calls < 35


def test_values_of_other_code_or_of_another_run_are_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = ReplayFolder(tmp_path, always=True)
    first = bench.execute(Valley(), Wanderer(0.1, 0.2), 100, replay=folder)
    os.rename(replay_path(tmp_path, first.run_id), tmp_path / "kept")
    other = bench.execute(Valley(), Wanderer(0.1, 0.2), 99, replay=folder)
    os.rename(tmp_path / "kept", replay_path(tmp_path, other.run_id))
    problem = Valley()
    bench.execute(problem, Wanderer(0.1, 0.2), 99, replay=folder)
    assert problem.calls == 2
    problem = Valley()
    bench.execute(problem, Wanderer(0.1, 0.2), 99, replay=folder)
    assert problem.calls == 0
    monkeypatch.setattr("calibench.bench.execution.request.digest_of_problem", lambda _: "other")
    bench.execute(problem, Wanderer(0.1, 0.2), 99, replay=folder)
    assert problem.calls == 2


def test_a_run_whose_row_is_kept_is_forgotten(tmp_path: Path) -> None:
    run = bench.execute(Valley(), Wanderer(0.1), 100, replay=ReplayFolder(tmp_path, always=True))
    assert replay_path(tmp_path, run.run_id).exists()
    for _ in range(2):
        forget_replay(tmp_path, run.run_id)
        assert not replay_path(tmp_path, run.run_id).exists()
    one, other = (bench.execute(Valley(), Wanderer(0.1), n, replay=ReplayFolder(tmp_path, always=True)) for n in (1, 2))
    forget_finished(tmp_path, {one.run_id})
    assert journal(tmp_path) == replay_path(tmp_path, other.run_id)


def test_what_costs_little_writes_nothing_and_what_is_dear_does(tmp_path: Path) -> None:
    cheap, dear = (
        bench.execute(Valley(s), Wanderer(*range(8)), 100, replay=ReplayFolder(tmp_path)) for s in (0, 0.021)
    )
    assert cheap.evaluations == dear.evaluations == 8
    assert journal(tmp_path).exists()
    assert not replay_path(tmp_path, "none").exists()


class Steps(Valley):
    """Costs what it is told to, evaluation by evaluation; `asked` is how the gate asks in each."""

    def __init__(self, *sleeps: float) -> None:
        super().__init__()
        self._sleeps = sleeps
        self.gate: Any = None
        self.asked: list[bool] = []

    def __call__(self, x: np.ndarray) -> float:
        self.sleep = self._sleeps[min(self.calls, len(self._sleeps) - 1)]
        self.asked.append("Replayed" in self.gate._function.__qualname__)  # as the functions that were made of it
        return super().__call__(x)


@pytest.fixture
def gates(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    seen: list[Any] = []
    begin = replay.Replayed.__init__

    def and_note(self: Any, gate: Any, *given: Any, **named: Any) -> None:
        seen.append(gate)
        begin(self, gate, *given, **named)

    monkeypatch.setattr(replay.Replayed, "__init__", and_note)
    return seen


def places(folder: Path, run: bench.Run) -> list[int]:
    file = ReplayFile(replay_path(folder, run.run_id), run.run_id, run.row["code_digest"])
    found = [place for place, _, _ in file._known]
    file.close()
    return found


class Told(Wanderer):
    """Tells the problem which gate it is asked by."""

    def __init__(self, problem: Any, *places: float) -> None:
        super().__init__(*places)
        self._problem = problem

    def minimize(self, objective: Any, rng: np.random.Generator) -> Any:
        self._problem.gate = self._problem.gates[-1]
        return super().minimize(objective, rng)


def stepping(tmp_path: Path, gates: list[Any], *sleeps: float, calls: int) -> tuple[Any, bench.Run]:
    problem = Steps(*sleeps)
    problem.gates = gates  # type: ignore[attr-defined]
    return problem, bench.execute(problem, Told(problem, *range(calls)), 10_000, replay=ReplayFolder(tmp_path))


def test_after_three_cheap_calls_the_gate_asks_as_without_replay(tmp_path: Path, gates: list[Any]) -> None:
    problem, _ = stepping(tmp_path, gates, 0, calls=12)
    assert problem.asked == [True] * 3 + [False] * 9
    assert not (tmp_path / "replay").exists()


def test_a_first_call_that_only_loads_something_is_not_believed_for_long(tmp_path: Path, gates: list[Any]) -> None:
    problem, run = stepping(tmp_path, gates, 0.03, 0, calls=60)
    assert problem.asked == [True] * 4 + [False] * 56
    assert places(tmp_path, run) == [1]


def test_cheap_calls_between_dear_ones_are_asked_again(tmp_path: Path, gates: list[Any]) -> None:
    sleeps = [0.03, 0.0, 0.021] * 4
    _, run = stepping(tmp_path, gates, *sleeps, calls=12)
    assert places(tmp_path, run) == [1, 3, 4, 6, 7, 9, 10, 12]
    again = Steps(0)
    again.gates = gates  # type: ignore[attr-defined]
    assert told(bench.execute(again, Told(again, *range(12)), 10_000, replay=ReplayFolder(tmp_path))) == told(run)
    assert again.calls == 4


def test_costs_that_grow_later_are_written_from_there_on(
    tmp_path: Path, gates: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(costly, "_SLOWLY", 0.05)
    sleeps = [0.0] * 200 + [0.021]
    _, run = stepping(tmp_path, gates, *sleeps, calls=215)
    known = places(tmp_path, run)
    assert known[-1] == 215
    assert 200 < known[0] < 212
    again = Steps(0)
    again.gates = gates  # type: ignore[attr-defined]
    assert told(bench.execute(again, Told(again, *range(215)), 10_000, replay=ReplayFolder(tmp_path))) == told(run)
    assert again.calls == 215 - len(known)


def test_the_time_limit_counts_the_time_before_the_kill(tmp_path: Path) -> None:
    method, folder = optimizers.make("nlopt_LN_BOBYQA"), ReplayFolder(tmp_path, always=True)
    killed_in_the_middle(
        lambda: bench.execute(Valley(0.02), method, 10**6, replay=folder, time_limit=60), tmp_path, 2500
    )
    file = journal(tmp_path)
    reader = ReplayFile(file, file.stem, bench.execute(Valley(), method, 1).row["code_digest"])
    spent, count = 0.0, 0
    while reader.next is not None:
        spent, count = reader.next.wall_s, count + 1
        reader.passed()
    reader.close()
    assert count > 15
    assert spent > 0.02 * count
    run = bench.execute(Valley(0.02), method, 10**6, replay=folder, time_limit=spent + 0.3)
    assert run.status == "timeout"
    assert spent + 0.29 < run.row["wall_s"] < spent + 2
    assert count < run.evaluations <= count + 16


def test_a_time_limit_is_met_where_it_was_met_before(tmp_path: Path) -> None:
    method, folder = optimizers.make("nlopt_LN_BOBYQA"), ReplayFolder(tmp_path, always=True)
    bench.execute(Valley(0.02), method, 20, replay=folder)
    problem = Valley()
    run = bench.execute(problem, method, 20, replay=folder, time_limit=0.2)
    assert (run.status, problem.calls) == ("timeout", 0), run.row["error"]
    assert 1 <= run.evaluations <= 10


def test_what_the_objective_raises_is_asked_again(tmp_path: Path) -> None:
    class Moody(Valley):
        fails = True

        def __call__(self, x: np.ndarray) -> float:
            if x[0] == 0.2 and self.fails:
                raise OSError("no licence")
            return super().__call__(x)

    class Patient(Wanderer):
        def minimize(self, objective: Any, rng: np.random.Generator) -> Any:
            for place in self._places:
                try:
                    objective(np.full(3, place))
                except OSError:
                    pass

    folder, method = ReplayFolder(tmp_path, always=True), Patient(0.1, 0.2, 0.3)
    first = bench.execute(Moody(), method, 100, replay=folder)
    problem = Moody()
    assert told(bench.execute(problem, method, 100, replay=folder)) == told(first)
    assert (problem.calls, first.evaluations, first.error_type) == (0, 2, "OSError")
    assert places(tmp_path, first) == [1]
    problem.fails = False
    assert bench.execute(problem, method, 100, replay=folder).status == "ok"
    assert problem.calls == 2


def test_a_generator_that_cannot_be_put_back_is_never_replayed(tmp_path: Path) -> None:
    class Own(Noisy):
        def seeded(self, rng: np.random.Generator) -> Any:
            twin = Own(self.sleep)
            twin.rng = rng  # type: ignore[attr-defined]
            return twin

    with pytest.raises(ValueError, match="replay=true"):
        bench.execute(Own(), Wanderer(0.1), 100, replay=ReplayFolder(tmp_path, always=True))
    bench.execute(Own(0.021), Wanderer(0.1), 100, replay=ReplayFolder(tmp_path))
    assert not (tmp_path / "replay").exists()


@pytest.mark.slow
def test_values_that_another_process_writes_are_left_alone(tmp_path: Path) -> None:
    folder = ReplayFolder(tmp_path, always=True)
    slow = lambda theirs: bench.execute(Valley(0.01), Wanderer(*range(10_000)), 20_000, replay=folder)  # noqa: E731
    with forked(slow) as (child, _):
        while not (tmp_path / "replay").exists() or journal(tmp_path).stat().st_size < 500:
            assert child.is_alive()
            time.sleep(0.01)
        problem = Valley()
        assert bench.execute(problem, Wanderer(*range(30)), 20_000, replay=folder).evaluations == 30
        assert problem.calls == 30
    run = bench.execute(Valley(), Wanderer(*range(30)), 20_000, replay=folder)
    assert places(tmp_path, run)[:5] == [1, 2, 3, 4, 5]


def test_a_full_disk_ends_the_journal_and_not_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, method = ReplayFolder(tmp_path, always=True), optimizers.make("nlopt_LN_BOBYQA")
    alone = bench.execute(Valley(), method, 60)
    write, room = os.write, [2000]

    def almost_full(fd: int, data: bytes) -> int:
        room[0] -= len(data)
        if room[0] < -200:
            raise OSError(errno.ENOSPC, "no space")
        return write(fd, data[: max(0, len(data) + min(0, room[0]))])

    monkeypatch.setattr("calibench.bench.gate.replay.os.write", almost_full)
    assert told(bench.execute(Valley(), method, 60, replay=folder)) == told(alone)
    monkeypatch.undo()
    problem = Valley()
    assert told(bench.execute(problem, method, 60, replay=folder)) == told(alone)
    assert 0 < problem.calls < 60


@pytest.mark.parametrize("slow_disk", [False, True])
def test_a_method_that_asks_from_several_threads_is_not_replayed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, slow_disk: bool
) -> None:
    add = ReplayFile.add

    def add_slowly(file: ReplayFile, record: Any) -> None:
        time.sleep(0.05)  # the other threads ask meanwhile
        add(file, record)

    if slow_disk:
        monkeypatch.setattr(ReplayFile, "add", add_slowly)

    class Threaded(Wanderer):
        def minimize(self, objective: Any, rng: np.random.Generator) -> Any:
            with ThreadPoolExecutor(4) as threads:
                list(threads.map(lambda place: objective(np.full(3, place)), self._places))

    for _ in range(2):
        method = Threaded(*np.linspace(-1, 1, 40))
        run = bench.execute(Valley(0.002), method, 100, replay=ReplayFolder(tmp_path, always=True))
        assert (run.status, run.evaluations) == ("ok", 40)
        assert places(tmp_path, run) == []


def test_an_objective_that_goes_elsewhere_does_not_take_the_journal_along(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Roaming(Valley):
        def __call__(self, x: np.ndarray) -> float:
            os.chdir(tmp_path)
            return super().__call__(x)

    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    run = bench.execute(Roaming(), Wanderer(0.1), 100, replay=ReplayFolder(".", always=True))
    assert replay_path(tmp_path / "here", run.run_id).exists()


@pytest.mark.parametrize(
    "answer",
    [
        np.nan, -0.0, np.inf, 5e-324, np.arange(7.0), np.arange(6.0).reshape(2, 3), np.arange(6.0).reshape(2, 3).T,
        np.empty((0, 3)), np.array(3.0),
    ],
    ids=str,
)  # fmt: skip
def test_an_answer_comes_back_with_its_bits_and_its_layout(answer: Any) -> None:
    back = answer_of(json.loads(json.dumps(written(answer))))
    assert np.asarray(back).tobytes() == np.asarray(answer).tobytes()
    if isinstance(answer, np.ndarray):
        assert isinstance(back, np.ndarray)
        assert back.shape == answer.shape
        assert not answer.size or back.strides == answer.strides
    else:
        assert isinstance(back, float)
