"""What a results folder bears: processes begun at once, kills at random moments, disks that fill, clocks that differ.

    python -m benchmarks.kills at-once --rounds 100       # 2 to 8 processes in one new folder, some killed
    python -m benchmarks.kills kills --rounds 20          # 20 kills of each engine: serial, processes, dask
    unshare -m python -m benchmarks.kills disks           # full, no inodes, read-only (by root, who mounts)

Each part ends with the same commands given again, and compares the tables with those of a sweep that nobody has
disturbed. Printed are counts of what must not be: runs lost or repeated, other rows, processes left running.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from calibench.bench.cli import main as bench
from calibench.bench.store.runs import ResultStore
from calibench.bench.workers import processes  # noqa: F401 (loaded before the forks)

_ADOPTS = 36  # PR_SET_CHILD_SUBREAPER of <linux/prctl.h>: what killed processes leave becomes our child
_DAY = 86_400.0
_OF_THE_PLACE = ["study", "wall_s", "cpu_s", "git_commit", "git_dirty", "versions", "platform", "started_at"]
_BAD = (
    "failed", "failed again", "exit code again", "incomplete", "lost", "repeated", "other tables", "not collected",
    "tracebacks", "left running",
)  # fmt: skip
QUICK = ["problem=sensor_zero", "optimizer=de,lm", "budget=60", "seeds=6"]
SLOW = """
import time
import numpy as np

class Slow:
    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.3)
    def __call__(self, x):
        time.sleep(0.0005)
        return float(x @ x)
"""


@dataclass
class Process:
    """A `bench run` in a forked process, which begins when `let_loose` is called."""

    pid: int
    gate: int
    log: Path
    killed: bool = False

    def let_loose(self) -> None:
        os.close(self.gate)

    def kill(self, *also: int) -> None:
        self.killed = True
        for pid in (self.pid, *also):
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue

    def has_ended(self) -> bool:
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None

    def wait(self) -> int:
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])


def begin(words: Sequence[str], log: Path, clock: float = 0.0, others: Sequence[Process] = ()) -> Process:
    """Fork a process that will run ``bench run -m`` with `words`, its clock wrong by so many seconds."""
    theirs, gate = os.pipe()
    pid = os.fork()
    if pid:
        os.close(theirs)
        return Process(pid, gate, log)
    for fd in (gate, *(other.gate for other in others)):
        os.close(fd)
    out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    os.dup2(out, 1)
    os.dup2(out, 2)
    sys.stdout, sys.stderr = os.fdopen(1, "w", buffering=1), os.fdopen(2, "w", buffering=1)
    real = time.time
    time.time = lambda: real() + clock
    os.read(theirs, 1)
    code: object = 70
    try:
        bench(["run", "-m", *words])
    except SystemExit as ended:
        code = ended.code
    finally:
        sys.stdout.flush()
        os._exit(code if isinstance(code, int) else 70)


def run(words: Sequence[str], log: Path) -> int:
    """Run ``bench run -m`` with `words` and return its exit code."""
    process = begin(words, log)
    process.let_loose()
    return process.wait()


def undisturbed(words: Sequence[str], results: Path) -> Path:
    """Run ``bench run -m`` in this process, which has all loaded then, and its children too; return the study."""
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        try:
            bench(["run", "-m", *words, "execution=serial", f"results={results}"])
        except SystemExit as ended:
            if ended.code:
                raise RuntimeError(f"an undisturbed sweep ended with {ended.code}") from ended
    return results / "adhoc"


def differs(folder: Path, whole: Path) -> bool:
    """Tell whether a study has other rows or traces than that of an undisturbed sweep, or one twice."""
    one, other = ResultStore(folder), ResultStore(whole)
    same = one.runs().drop(columns=_OF_THE_PLACE).equals(other.runs().drop(columns=_OF_THE_PLACE))
    return not (same and one.traces().equals(other.traces()))


def family_of(pid: int) -> list[int]:
    """Return the processes that `pid` has started, and those that these have."""
    try:
        children = [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []
    return [each for child in children for each in (child, *family_of(child))]


def left_running(seconds: float = 10.0) -> int:
    """Return how many processes are left so long after all that were waited for have ended; killed ones are ours."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            if os.waitpid(-1, os.WNOHANG)[0] == 0:
                time.sleep(0.01)
        except ChildProcessError:
            return 0
    return len(family_of(os.getpid()))


def wait_for(condition: Callable[[], bool], seconds: float) -> None:
    """Look until the condition is true; raise where it is not within so many seconds."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError
        time.sleep(0.01)


def at_once(rounds: int, home: Path, seed: int = 0, most: int = 8) -> Counter[str]:
    """Let 2 to `most` processes loose at once into a new folder, `rounds` times; return counts of what came of it.

    Shards or whole sweeps, serial or by processes; a third are killed within 200 ms; clocks and file times differ.
    """
    rng = random.Random(seed)
    found: Counter[str] = Counter()
    whole = undisturbed(QUICK, home / "whole")
    for number in range(rounds):
        count, results = rng.randint(2, most), home / str(number)
        shards = rng.random() < 0.5
        engines = (["execution=serial"], ["execution=processes", "execution.n_jobs=2"])
        parts = [f"shard={i}/{count}" for i in range(1, count + 1)] if shards else [""] * count
        words = [[*QUICK, f"results={results}", *rng.choice(engines), *filter(None, [part])] for part in parts]
        begun: list[Process] = []
        for i, each in enumerate(words):
            clock = rng.choice([-2 * _DAY, 0.0, 2 * _DAY])
            begun.append(begin(each, home / f"log-{number}-{i}", clock, begun))
        kills = sorted((rng.uniform(0, 0.2), process) for process in begun if rng.random() < 1 / 3)[: count - 1]
        for process in begun:
            process.let_loose()
        released = time.monotonic()
        for moment, process in sorted(kills, key=lambda kill: kill[0]):
            time.sleep(max(0.0, released + moment - time.monotonic()))
            process.kill()
        codes = [process.wait() for process in begun]
        found["processes"] += count
        found["killed"] += sum(process.killed for process in begun)
        for process, code in zip(begun, codes, strict=True):
            found["failed"] += code != 0 and not process.killed
            if code != 0 and not process.killed:
                print(process.log.read_text()[-1000:])
        before = ResultStore(results / "adhoc")
        kept = before.finished() if before.is_begun else set()
        if shards and not kills:
            found["incomplete"] += len(kept) != len(ResultStore(whole).finished())
        for path in results.rglob("*"):
            moment = time.time() + rng.choice([-2 * _DAY, 0.0, 2 * _DAY])
            os.utime(path, (moment, moment))
        found["failed again"] += sum(run(each, home / "log-again") != 0 for each in words)
        found["other tables"] += differs(results / "adhoc", whole)
        found["lost"] += len(kept - before.collected())
        found["not collected"] += before.has_journals()
        found["left running"] += left_running()
        found["rounds"] += 1
    return found


def kills(engine: str, count: int, home: Path, seed: int = 0) -> Counter[str]:
    """Kill `count` times the main process, a worker, or all processes of a sweep; return counts of what came of it."""
    rng = random.Random(seed)
    (home / "slow.py").write_text(SLOW)
    words = [f"problem={home / 'slow.py'}:Slow", "optimizer=de,pso", "budget=40", "seeds=20"]
    whole = undisturbed(words, home / "whole")
    words += [f"execution={engine}", *(["execution.n_jobs=2"] if engine != "serial" else [])]
    found: Counter[str] = Counter()
    study = 0
    while found["kills"] < count:
        results = home / f"{engine}{study}"
        seen: dict[str, object] = {}
        store = ResultStore(results / "adhoc")
        while True:
            process = begin([*words, f"results={results}"], home / f"log-{engine}")
            process.let_loose()
            kept = len(seen)
            if rng.random() < 0.8:  # else while it begins
                while not (process.has_ended() or _has_some(store, kept)):
                    time.sleep(0.01)
            time.sleep(rng.uniform(0, 0.3))
            family = family_of(process.pid)
            target = rng.choice(["main", "worker", "all"])
            if found["kills"] < count and not process.has_ended() and (target != "worker" or family):
                found["kills"] += 1
                found[f"kills of {target}"] += 1
                if target == "worker":
                    os.kill(rng.choice(family), signal.SIGKILL)
                else:
                    process.kill(*(family if target == "all" else ()))
            code = process.wait()
            found["left running"] += left_running()
            now = store.runs(["run_id", "started_at"]) if store.is_begun else None
            again = dict(zip(now["run_id"], now["started_at"], strict=True)) if now is not None else {}
            found["lost"] += len(seen.keys() - again.keys())
            found["repeated"] += sum(again[run_id] != seen[run_id] for run_id in seen.keys() & again.keys())
            seen = again
            if not process.killed:
                found["failed"] += code != 0
                break
        found["other tables"] += differs(results / "adhoc", whole)
        found["sweeps"] += 1
        study += 1
    return found


def disks(home: Path) -> Iterator[tuple[str, Counter[str]]]:
    """Yield for each kind of trouble what came of it: a sweep that meets it, and the same command when it is gone."""
    many = [*QUICK[:-1], "seeds=40"]
    whole = undisturbed(many, home / "whole")
    for name, before, after in (
        ("full", "size=48k", "size=8m"),
        ("no inodes", "size=8m,nr_inodes=7", "nr_inodes=1000"),
        ("read-only midway", "size=8m", ""),
    ):
        for engine in ("serial", "processes"):
            found: Counter[str] = Counter()
            words = [*many, f"results={home / 'disk'}", f"execution={engine}"]
            place = str(home / "disk")
            with mounted(home / "disk", before):
                process = begin(words, home / f"log-{name}-{engine}")
                process.let_loose()
                if name.startswith("read-only"):
                    store = ResultStore(home / "disk" / "adhoc")
                    wait_for(partial(_has_some, store), 30)
                    mount("--bind", place, place)  # over it, as files in it are open
                    mount("-o", "remount,bind,ro", place)
                code = process.wait()
                last = process.log.read_text().rstrip().splitlines()[-1:]
                found["exit code"] = code
                found["tracebacks"] = process.log.read_text().count("Traceback")
                store = ResultStore(home / "disk" / "adhoc")
                kept = store.finished() if store.is_begun else set()
                found["kept"] = len(kept)
                if name.startswith("read-only"):
                    subprocess.run(["umount", place], check=True)
                else:
                    mount("-o", f"remount,{after}", place)
                found["exit code again"] = run(words, home / "log-again")
                found["lost"] = len(kept - store.finished())
                found["other tables"] = int(differs(home / "disk" / "adhoc", whole))
            yield f"{name}, {engine}: {' '.join(last)[:200]}", found


def _has_some(store: ResultStore, more_than: int = 2) -> bool:
    return store.is_begun and len(store.finished()) > more_than


@contextmanager
def mounted(place: Path, options: str) -> Iterator[None]:
    """Let a small file system in memory stand at `place`."""
    place.mkdir(exist_ok=True)
    mount("-t", "tmpfs", "-o", options, "calibench", str(place))
    try:
        yield
    finally:
        subprocess.run(["umount", str(place)], check=True)


def mount(*words: str) -> None:
    """Mount, or mount otherwise."""
    subprocess.run(["mount", *words], check=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a part and print its counts; 1 where something was lost, repeated, other than it must be, or failed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kills", description=__doc__)
    parser.add_argument("part", choices=("at-once", "kills", "disks"))
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--most", type=int, default=8, help="processes begun at once")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--engine", choices=("serial", "processes", "dask"), action="append")
    given = parser.parse_args(argv)
    ctypes.CDLL(None).prctl(_ADOPTS, 1, 0, 0, 0)
    bad = 0
    with tempfile.TemporaryDirectory() as home:
        for name, found in _parts(given, Path(home)):
            print(f"{name}: {', '.join(f'{count} {what}' for what, count in found.items())}", flush=True)
            bad += sum(found[what] for what in _BAD)
    return 1 if bad else 0


def _parts(given: argparse.Namespace, home: Path) -> Iterator[tuple[str, Counter[str]]]:
    if given.part == "at-once":
        yield "at once", at_once(given.rounds, home, given.seed, given.most)
    elif given.part == "kills":
        for engine in given.engine or ("serial", "processes", "dask"):
            yield engine, kills(engine, given.rounds, home, given.seed)
    else:
        yield from disks(home)


if __name__ == "__main__":
    sys.exit(main())
