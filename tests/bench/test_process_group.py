"""A worker and all that it starts end as one, whoever ends first; nobody waits for a pipe that a grandchild holds."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibench import bench
from calibench.bench.gate.processes import CAN_FORK, Lost, apart, forked

pytestmark = pytest.mark.skipif(not CAN_FORK or sys.platform != "linux", reason="the death signal is Linux's")


def sleeper() -> int:
    """Start a process that sleeps and holds all that it was given."""
    child = os.fork()
    if child == 0:
        time.sleep(60)
        os._exit(0)
    return child


def daemon() -> int:
    """Start one in a session of its own, whose parent ends at once."""
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        os.setsid()
        os.write(theirs, str(sleeper()).encode())
        os._exit(0)
    os.waitpid(child, 0)
    return int(os.read(ours, 20))


def ends(pid: int) -> bool:
    """Tell whether a process ends within five seconds; a dead one that nobody has waited for has ended."""
    for _ in range(500):
        try:
            if Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX":
                return True
        except OSError:
            return True
        time.sleep(0.01)
    return False


def hear(ours: Any) -> list[Any]:
    heard = []
    try:
        while True:
            heard.append(ours.recv())
    except EOFError:
        return heard


@pytest.mark.parametrize("start", [sleeper, daemon])
def test_what_a_child_leaves_ends_with_it_and_keeps_nobody_waiting(start: Callable[[], int]) -> None:
    with forked(lambda theirs: theirs.send(start())) as (child, ours):
        (left,) = hear(ours)
    assert child.exitcode == 0
    assert ends(left)


@pytest.mark.parametrize("start", [sleeper, daemon])
def test_what_a_child_has_started_is_killed_with_it(start: Callable[[], int]) -> None:
    def work(theirs: Any) -> None:
        theirs.send(start())
        time.sleep(60)

    with forked(work) as (child, ours):
        left = ours.recv()
    assert child.exitcode == -signal.SIGKILL
    assert ends(left)


def test_what_a_child_that_dies_leaves_in_its_group_is_killed() -> None:
    def work(theirs: Any) -> None:
        theirs.send(sleeper())
        os.kill(os.getpid(), signal.SIGSEGV)

    with forked(work) as (child, ours):
        (left,) = hear(ours)
    assert child.exitcode == -signal.SIGSEGV
    assert ends(left)


def test_a_child_that_dies_before_its_second_message_ends_the_line() -> None:
    def work(theirs: Any) -> None:
        theirs.send("whole")
        sleeper()
        os._exit(3)

    with forked(work) as (child, ours):
        assert hear(ours) == ["whole"]
    assert child.exitcode == 3


def test_a_long_message_comes_whole() -> None:
    message = os.urandom(5_000_000)
    with forked(lambda theirs: [theirs.send(message) for _ in range(3)]) as (_, ours):
        assert hear(ours) == [message] * 3


STUCK = """
import ctypes, os, sys, time
sys.path[:0] = {path!r}
from calibench.bench.gate.processes import forked

def work(theirs):
    print(os.getpid(), flush=True)
    ctypes.PyDLL(None).sleep(60)  # in C, with the lock of the interpreter held: no thread of Python runs

with forked(work) as (child, ours):
    ours.poll(60)
"""


def test_a_child_that_is_stuck_in_c_ends_with_its_killed_parent(tmp_path: Path) -> None:
    script = tmp_path / "stuck.py"
    script.write_text(STUCK.format(path=sys.path))
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        stuck = int(parent.stdout.readline())
        parent.kill()
    assert ends(stuck)


def test_work_apart_gives_its_result_or_says_how_it_was_lost() -> None:
    assert apart(lambda: {"a": np.arange(3).tolist()}, 20) == {"a": [0, 1, 2]}
    for work, error_type, timed_out in (
        (lambda: 1 / 0, "ZeroDivisionError", False),
        (lambda: sys.exit(3), "SystemExit", False),
        (lambda: os._exit(3), "ProcessDied", False),
        (lambda: time.sleep(60), "TimeoutError", True),
        (lambda: (sleeper(), 1 / 0), "ZeroDivisionError", False),
    ):
        with pytest.raises(Lost) as lost:
            apart(work, 0.3 if timed_out else 20)
        assert (lost.value.error_type, lost.value.timed_out) == (error_type, timed_out)


class Leaves:
    """A bowl whose first call leaves a process behind that holds everything open."""

    lower, upper, start = np.full(2, -1.0), np.full(2, 1.0), np.full(2, 0.5)

    def __init__(self, note: Path, start: Callable[[], int]) -> None:
        self.options = {"start": start.__name__}
        self._note, self._begin = note, start

    def __call__(self, x: np.ndarray) -> float:
        if not self._note.exists():
            self._note.write_text(str(self._begin()))
        return float(x @ x)


class Fixed:
    def minimize(self, objective: Any, rng: np.random.Generator) -> Any:
        for _ in range(3):
            objective(objective.start)


@pytest.mark.parametrize("start", [sleeper, daemon])
def test_a_run_that_leaves_a_process_behind_is_a_row_and_the_process_ends(
    tmp_path: Path, start: Callable[[], int]
) -> None:
    note = tmp_path / "pid"
    run = bench.execute(Leaves(note, start), Fixed(), budget=10, time_limit=20)
    assert (run.status, run.evaluations) == ("ok", 3)
    assert run.row["wall_s"] < 10
    assert ends(int(note.read_text()))
