"""A tool in its own environment, asked in JSON: one that stays and answers again, or a process for each request."""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from threading import Timer
from typing import Any

from benchmarks.peers.environments import Environment

_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "POLARS_MAX_THREADS"), "1")
_LONGEST = 900.0  # seconds for one answer


class ToolError(Exception):
    """What a tool could not do; the text is its own."""


@dataclass(frozen=True)
class Taken:
    """What a line took once: CPU and wall seconds of `count` evaluations (runs, poses, ...)."""

    cpu_s: float
    wall_s: float
    count: int = 1
    note: str = ""


class Staying:
    """A tool's process that stays between requests: loaded and warm."""

    def __init__(self, environment: Environment) -> None:
        self._command = [str(environment.python), str(environment.script)]
        self._process: subprocess.Popen[str] | None = None

    def ask(self, request: Mapping[str, Any], longest: float = _LONGEST) -> Mapping[str, Any]:
        """Return the answer; raise `ToolError` with the tool's own words where there is none."""
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
                env=surroundings(),
            )  # fmt: skip
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        timer = Timer(longest, process.kill)
        timer.start()
        try:
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        finally:
            timer.cancel()
        return read(line)

    def take(self, request: Mapping[str, Any]) -> Taken:
        """Return what the tool measured."""
        told = self.ask(request)
        return Taken(told["cpu_s"], told["wall_s"], told.get("count", 1), told.get("note", ""))

    def end(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for pipe in (self._process.stdin, self._process.stdout):
                if pipe is not None:
                    pipe.close()


def once(environment: Environment, request: Mapping[str, Any], caches: Path | None = None) -> Taken:
    """Return what a fresh process took for one request, its children too; `caches` is its home for what tools keep.

    Where the tool has measured a part of it, that part.
    """
    with open(os.devnull, "wb") as nothing:
        began = time.perf_counter()
        process = subprocess.Popen(
            [str(environment.python), str(environment.script), json.dumps(request)],
            stdout=subprocess.PIPE, stderr=nothing, env=surroundings(caches),
        )  # fmt: skip
        timer = Timer(_LONGEST, process.kill)
        timer.start()
        before = os.times()
        try:
            output, _ = process.communicate()
        finally:
            timer.cancel()
        wall, after = time.perf_counter() - began, os.times()
    told = read(output.decode())
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return Taken(told.get("cpu_s", cpu), told.get("wall_s", wall), told.get("count", 1), told.get("note", ""))


def read(line: str) -> Mapping[str, Any]:
    """Return the answer that a line of JSON holds; raise `ToolError` where it is none, or tells of an error."""
    try:
        told: Mapping[str, Any] = json.loads(line)
    except ValueError:
        raise ToolError("ended without an answer") from None
    if "error" in told:
        raise ToolError(told["error"])
    return told


def surroundings(caches: Path | None = None) -> dict[str, str]:
    """Return the environment variables of a tool: one thread each, and a home of its own where `caches` is given."""
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    own = {"HOME": str(caches), "XDG_CACHE_HOME": str(caches), "MPLCONFIGDIR": str(caches)} if caches else {}
    return {**kept, **_ONE_THREAD, "MPLBACKEND": "Agg", "PYTHONWARNINGS": "ignore", **own}
