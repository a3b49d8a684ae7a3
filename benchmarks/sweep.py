"""Sweeps of many short runs: what the harness takes beside the optimisers, how that grows, and the tables afterwards.

`bench run` of one problem and one optimiser, budget 60, on two processes. Times are of a run: the CPU time of all
processes, less what the optimisers took (`cpu_s` of the rows) and start-up.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.rounds import COLUMNS
from calibench.bench.store.runs import ResultStore

_SIZES = (1_000, 100_000)
_WORDS = ("problem=sensor_zero", "optimizer=de", "budget=60", "execution=processes", "execution.n_jobs=2")


def rows() -> pd.DataFrame:
    """Return a row for each size and step."""
    name = "bench run, budget 60, 2 processes"
    table: list[tuple[Any, ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        base, _ = _sweep(Path(folder) / "ten", 10)
        for count in _SIZES:
            place = Path(folder) / str(count)
            cpu, memory = _sweep(place, count)
            store = ResultStore(place / "adhoc")
            own = float(store.runs(["cpu_s"])["cpu_s"].sum())
            harness = (cpu - base - own) / count * 1e9
            steps = {
                "optimiser": own / count * 1e9,
                "harness": harness,
                "bench status, in all": _wall("status", store.folder) * 1e9,
                "read runs, in all": _time(lambda store=store: pd.read_parquet(store.folder / "runs.parquet")) * 1e9,
                "ResultStore.runs, in all": _time(store.runs) * 1e9,
            }
            files = sum(1 for path in store.folder.rglob("*") if path.is_file())
            for step, ns in steps.items():
                label = f"{step} ({memory:.0f} MB, {files} files)" if step == "harness" else step
                table.append((f"{name}, {count} runs", label, ns, ns, ns, ns / harness, 1))
    return pd.DataFrame(table, columns=list(COLUMNS))


def _sweep(results: Path, count: int) -> tuple[float, float]:
    """Carry out a sweep; return the CPU seconds of all its processes and the peak memory of the first [MB]."""
    command = [sys.executable, "-m", "bench", "run", *_WORDS, f"seeds={count}", f"results={results}"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    peak = 0.0
    while process.poll() is None:
        peak = max(peak, _memory(process.pid))
        time.sleep(0.05)
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)}: exit code {process.returncode}")
    times = os.times()
    cpu = times.children_user + times.children_system
    spent = cpu - _SPENT[0]
    _SPENT[0] = cpu
    return spent, peak


_SPENT = [0.0]  # CPU seconds of children before


def _memory(pid: int) -> float:
    """Return the largest resident memory of a process so far, in MB; 0 where the system does not tell."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        return float(next(line.split()[1] for line in lines if line.startswith("VmHWM"))) / 1024
    except (OSError, StopIteration):
        return 0.0


def _wall(verb: str, folder: Path) -> float:
    def call() -> None:
        subprocess.run([sys.executable, "-m", "bench", verb, str(folder)], check=True, stdout=subprocess.DEVNULL)

    seconds = _time(call)
    times = os.times()
    _SPENT[0] = times.children_user + times.children_system
    return seconds


def _time(step: Any) -> float:
    before = time.perf_counter()
    step()
    return time.perf_counter() - before
