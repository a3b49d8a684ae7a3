"""Many studies in a folder, and what lists, filters and SQL over them take.

``python -m benchmarks.tracking.many five RESULTS`` makes thirty studies of five kinds (two kinds of sweeps, one with
failures, discoveries, calibrations) by the commands themselves; ``many RESULTS [N]`` makes N small ones (10 000) of one
run each; ``large RESULTS [N]`` makes 500 with N runs in all (a million), one of them with 10 000. ``time RESULTS``
prints seconds (wall, and of the processor) and megabytes of each question in a process of its own, thrice.
"""

import json
import os
import shutil
import subprocess
import sys
from datetime import timedelta
from pathlib import Path
from time import perf_counter

import numpy as np
import pandas as pd

from calibench import bench, optimizers, problems
from calibench.bench.execution.run import Run
from calibench.bench.store.runs import ResultStore

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "discrepancy" / "demo" / "arm"
QUESTIONS = {
    "list": ["studies", "{0}"], "list --all": ["studies", "{0}", "--all"], "list --json": ["studies", "{0}", "--json"],
    "filter": ["studies", "{0}", "optimizer=de", "problem=sensor*", "since=2020-01-01", "status=ok"],
    "sql, rows": ["sql", "select optimizer, count(*), median(best_value) from runs group by 1", "results={0}"],
    "sql, studies": ["sql", "select kind, count(*) from studies group by 1", "results={0}"],
}  # fmt: skip


def five(results: Path) -> None:
    """Make thirty studies of five kinds, six of each."""
    for k in range(6):
        where = [f"results={results}"]
        sweeps = {
            f"planar_{k}": ["problem=sensor_zero,link_length", "optimizer=lm,de", f"seeds={k}:{k + 3}", "budget=300"],
            f"nist_{k}": ["problem=nist", "optimizer=de,pso", f"seeds={k}:{k + 2}", "budget=200"],
            f"late_{k}": [
                "problem=sensor_zero",
                "optimizer=de",
                f"seeds={k}:{k + 2}",
                "budget=100000",
                "time_limit=0.001",
            ],
        }
        for name, words in sweeps.items():
            _bench(["run", "-m", *words, f"study={name}", *where])
        _bench(["discover", "machine=gpm2002", "data=demo_nothing", f"study=found_{k}", "pages=none", *where])
        arm = [f"urdf={DEMO / 'six.urdf'}", f"data={DEMO / 'demo_sound.csv'}", "resamples=20", "page=false"]
        _bench(["calibrate", *arm, f"study=arm_{k}", *where])


def _runs() -> list[Run]:
    methods = ("de", "lm", "pso", "ga")
    return [
        bench.execute(problems.make(problem), optimizers.make(methods[k % 4]), budget=200, seed=k)
        for problem in ("sensor_zero", "link_length") for k in range(4)
    ]  # fmt: skip


def large(results: Path, total: int) -> None:
    """Make 500 studies of `total` runs in all, one of 10 000; the others are copies of one, as what is in them is."""
    made, rng = _runs(), np.random.default_rng(0)
    first: Path | None = None
    for k, size in enumerate([10_000, *[(total - 10_000) // 499] * 499]):
        folder = results / f"group_{k // 100:03d}" / f"study_{k:05d}"
        if first is not None:
            shutil.copytree(first, folder, dirs_exist_ok=True)
            continue
        of = [made[i % len(made)] for i in range(size)]
        rows = pd.DataFrame([run.row for run in of])
        ids = [f"{k:06x}{i:010x}" for i in range(size)]
        values = rows["best_value"] * rng.lognormal(size=size)
        rows = rows.assign(run_id=ids, repetition=[i // len(made) for i in range(size)], best_value=values)
        traces = pd.concat([run.trace.iloc[[0, -1]].assign(run_id=one) for run, one in zip(of, ids, strict=True)])
        ResultStore(folder).fill(rows, traces)
        first = folder if k else None


def many(results: Path, count: int) -> None:
    """Make `count` studies of one run each: tables of their own, as the store writes them."""
    made = _runs()
    for k in range(count):
        folder = results / f"group_{k // 100:03d}" / f"study_{k:05d}"
        if (folder / "traces.parquet").exists():
            continue
        run = made[k % len(made)]
        row = run.row | {"started_at": run.row["started_at"] - timedelta(minutes=k)}
        ResultStore(folder).fill(pd.DataFrame([row]), run.trace.assign(run_id=row["run_id"]))


def _bench(words: list[str]) -> None:
    subprocess.run([sys.executable, "-m", "calibench", *words], check=False, stdout=subprocess.DEVNULL, cwd=ROOT)


def measure(results: Path) -> None:
    """Print a line a question: seconds of three processes, and the most memory."""
    for name, words in QUESTIONS.items():
        asked = [word.format(results) for word in words]
        seconds, processor, memory = [], [], 0.0
        for _ in range(3):
            began = perf_counter()
            child = subprocess.Popen([sys.executable, "-m", "calibench", *asked], stdout=subprocess.DEVNULL, cwd=ROOT)
            _, status, usage = os.wait4(child.pid, 0)
            seconds.append(round(perf_counter() - began, 2))
            processor.append(round(usage.ru_utime + usage.ru_stime, 2))
            memory = max(memory, usage.ru_maxrss / 1024)
            assert status == 0, asked
        print(json.dumps({"question": name, "seconds": seconds, "cpu_s": processor, "MB": round(memory)}), flush=True)


if __name__ == "__main__":
    way, where, *rest = sys.argv[1:]
    folder = Path(where).absolute()
    if way == "five":
        five(folder)
    elif way == "many":
        many(folder, int(rest[0]) if rest else 10_000)
    elif way == "large":
        large(folder, int(rest[0]) if rest else 1_000_000)
    else:
        measure(folder)
