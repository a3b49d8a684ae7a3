"""The runs in progress of a folder: a small file each in ``FOLDER/running``, written every second, gone at its end.
Beside them stands a file of each sweep, so that one that has no run to tell of yet is seen as well.

What a killed process leaves there is not counted: on its own machine a process that is gone is known to be.
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, final

from calibench.bench.execution.in_progress.progress import Progress, Publish
from calibench.bench.gate.processes.process_group import born, is_gone
from calibench.core.counted import grouped, plain, span
from calibench.core.nested_text import json_of

_SWEEP = ".sweep"  # how the file of a sweep ends
_QUIET = 10.0  # seconds without an evaluation from which on no end is foreseen
SILENT = 600.0  # seconds without an evaluation from which on it is told


def to_files(folder: Path | str) -> Publish:
    """Return what writes each run in progress as a file of `folder`, to be given to `publishing`."""
    home = Path(folder).absolute() / "running"

    def publish(progress: Progress) -> None:
        path = home / f"{progress['run_id']}-{os.getpid()}@{progress['host']}.json"
        if progress["ended"]:
            path.unlink(missing_ok=True)
            return
        home.mkdir(parents=True, exist_ok=True)
        temporary = path.with_suffix(".tmp")  # a name of ours alone: what a kill leaves is written over
        temporary.write_text(json.dumps(progress), encoding="utf-8")
        os.replace(temporary, path)  # whole, but not brought to the disk: it is worth a second

    return publish


@final
@dataclass(frozen=True)
class Running:
    """A run in progress: what its `Progress` said, with `silent_s` up to now."""

    run_id: str
    problem: str
    optimizer: str
    repetition: int
    pid: int
    host: str
    born: str
    began_at: float
    updated_at: float
    evaluations: int
    spent: int
    budget: int
    best_value: float | None
    rate: float
    eta_s: float | None
    silent_s: float

    def line(self) -> str:
        """Return one line for the terminal and the log."""
        best = "no value yet" if self.best_value is None else f"best {plain(self.best_value, 2)}"
        left = "" if self.eta_s is None else f", {span(self.eta_s)} left"
        usual = 1 / self.rate if self.rate > 0 else 0.0  # seconds an evaluation takes
        silent = "" if self.silent_s < max(_QUIET, 5 * usual) else f", silent for {span(self.silent_s)}"
        return (
            f"run {self.run_id[:4]} {self.optimizer} on {self.problem}: {grouped(self.spent)} of "
            f"{grouped(self.budget)} evaluations, {best}, {plain(self.rate, 3)}/s{silent or left}"
        )

    def silent_line(self) -> str | None:
        """Return what to say of a run that has made no evaluation for ten minutes; None of another."""
        if self.silent_s < SILENT:
            return None
        there = "" if self.host == platform.node() else f" on {self.host}"
        return (
            f"run {self.run_id[:4]} {self.optimizer} on {self.problem} has made no evaluation for "
            f"{span(self.silent_s)}; `kill -9 {self.pid}`{there} ends it, it becomes a failed row and the others go "
            "on; time_limit=SECONDS ends such runs by itself"
        )


def running_of(progress: Progress) -> Running:
    """Return a run in progress as it is now: since its last message it has been silent, as far as is known."""
    age = max(0.0, time.time() - progress["updated_at"])
    told: dict[str, Any] = dict(progress)
    known = {field.name: told[field.name] for field in fields(Running)}
    return Running(**known | {"silent_s": progress["silent_s"] + (age if age > 5 else 0.0)})


def read_running(folder: Path | str) -> list[Running]:
    """Return the runs in progress of `folder`, those that began first first. Changes nothing there."""
    found = []
    for path in sorted((Path(folder) / "running").glob("*.json")):
        progress = _read(path)
        if progress is not None and not _is_gone(progress):
            found.append(running_of(progress))
    return sorted(found, key=lambda run: (run.began_at, run.run_id))


@contextmanager
def at_work(folder: Path | str) -> Iterator[None]:
    """Let others see, while the block lasts, that this process carries out a sweep in `folder`."""
    host, pid = platform.node(), os.getpid()
    path = Path(folder).absolute() / "running" / f"{pid}@{host}{_SWEEP}"
    with suppress(OSError):  # no sweep fails by what is told of it
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"host": host, "pid": pid, "born": born(pid)}), encoding="utf-8")
    try:
        yield
    finally:
        with suppress(OSError):
            path.unlink(missing_ok=True)
            path.parent.rmdir()  # where no run is told of


def hosts_at_work(folder: Path | str) -> set[str]:
    """Return the machines on which a sweep or a run is in progress in `folder`; of others than this one, may be."""
    sweeps = [_sweep(path) for path in (Path(folder) / "running").glob(f"*{_SWEEP}")]
    return {host for host, pid, birth in sweeps if not is_gone(host, pid, birth)} | {
        run.host for run in read_running(folder)
    }


def was_silent(folder: Path | str, run_id: str) -> bool:
    """Tell whether a run of `folder` had made no evaluation for ten minutes at its last message, or since then."""
    told = [_read(path) for path in (Path(folder) / "running").glob(f"{run_id}-*.json")]
    return any(running_of(progress).silent_s >= SILENT for progress in told if progress is not None)


def remove_gone(folder: Path | str) -> None:
    """Delete what killed processes of this machine have left."""
    home = Path(folder) / "running"
    for path in home.glob("*.json"):
        progress = _read(path)
        if progress is not None and _is_gone(progress):
            for left in (path, path.with_suffix(".tmp")):
                with suppress(OSError):
                    left.unlink(missing_ok=True)
    for path in home.glob(f"*{_SWEEP}"):
        if is_gone(*_sweep(path)):
            with suppress(OSError):
                path.unlink(missing_ok=True)
    with suppress(OSError):
        home.rmdir()  # where nothing is left


def _read(path: Path) -> Progress | None:
    """Return what a file says; None where it has just gone, or is none of ours."""
    try:
        told: Progress = json_of(path.read_text(encoding="utf-8"))
        running_of(told)
        return told if isinstance(told["pid"], int) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _sweep(path: Path) -> tuple[str, int, str]:
    """Return host, pid and birth of the process that carries out a sweep; of a file that is not whole, no process."""
    try:
        told = json_of(path.read_text(encoding="utf-8"))
        return str(told["host"]), int(told["pid"]), str(told["born"])
    except (OSError, ValueError, KeyError, TypeError):
        return platform.node(), os.getpid(), "-"


def _is_gone(progress: Progress) -> bool:
    return is_gone(progress["host"], progress["pid"], progress["born"])
