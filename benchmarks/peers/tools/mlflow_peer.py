"""MLflow: runs, parameters and metrics in a data base (SQLite), found again by `search_runs`."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from answering import answer, timed
from small_runs import Sphere, search_at_random


def _begin(folder: str) -> Any:
    import mlflow

    mlflow.set_tracking_uri(f"sqlite:///{folder}/runs.db")
    mlflow.set_experiment("small")
    return mlflow


def _count(work: Mapping[str, Any]) -> dict[str, Any]:
    mlflow = _begin(work["folder"])
    with mlflow.start_run():
        mlflow.log_metric("value", 1.0, step=0)

        def logged() -> int:
            for step in range(1, 31):
                mlflow.log_metric("value", float(step), step=step)
            return 30

        return {**timed(logged), "note": "log_metric: it logs, and counts nothing by itself"}


def _sweep(work: Mapping[str, Any]) -> dict[str, Any]:
    """Log a tenth of the runs: its client takes tens of milliseconds for each."""
    runs, sphere = work["runs"] // 10, Sphere()
    mlflow = _begin(work["folder"])
    for seed in range(runs):
        best = search_at_random(sphere, sphere.lower, sphere.upper, work["budget"], seed)
        with mlflow.start_run():
            mlflow.log_params({"problem": "sphere", "optimizer": "random", "seed": seed, "budget": work["budget"]})
            mlflow.log_metrics({"best_value": best, "evaluations": work["budget"]})
    table = mlflow.search_runs()
    print(table.groupby("params.optimizer")["metrics.best_value"].describe())
    return {"count": len(table), "note": f"{len(table)} runs, start of the process and of the data base included"}


def _plot(work: Mapping[str, Any]) -> dict[str, Any]:
    import matplotlib.pyplot as plt
    import numpy as np

    mlflow, sphere, rng = _begin(work["folder"]), Sphere(), np.random.default_rng(0)
    from mlflow.entities import Metric

    values = [sphere(rng.uniform(-5, 5, 5)) for _ in range(work["budget"])]
    with mlflow.start_run() as run:
        steps = [Metric("best", float(best), 0, step) for step, best in enumerate(np.minimum.accumulate(values))]
        mlflow.MlflowClient().log_batch(run.info.run_id, metrics=steps)
    kept = mlflow.MlflowClient().get_metric_history(run.info.run_id, "best")
    plt.semilogy([one.step for one in kept], [one.value for one in kept])
    plt.savefig(f"{work['folder']}/first.png")
    return {"note": "1 run, one figure by Matplotlib; its own stands in its server's page"}


def prepare(work: Mapping[str, Any]) -> dict[str, Any]:
    """Write runs with 4 parameters and 3 metrics each into its data base by SQL, after one by its client."""
    mlflow = _begin(work["folder"])
    with mlflow.start_run() as run:
        mlflow.log_params({"problem": "sensor_zero", "optimizer": "de", "seed": 0, "budget": 60})
        mlflow.log_metrics({"best_value": 1.0, "evaluations": 60.0, "wall_s": 0.1})
    first = run.info.run_id
    base = sqlite3.connect(Path(work["folder"]) / "runs.db")
    for table in ("runs", "params", "latest_metrics", "metrics", "tags"):
        names = [column[1] for column in base.execute(f"PRAGMA table_info({table})")]
        like = base.execute(f"SELECT {', '.join(names)} FROM {table} WHERE run_uuid = ?", (first,)).fetchall()
        at = names.index("run_uuid")
        rows = ((*row[:at], f"{number:032x}", *row[at + 1 :]) for number in range(1, work["runs"]) for row in like)
        base.executemany(f"INSERT INTO {table} ({', '.join(names)}) VALUES ({', '.join('?' * len(names))})", rows)
    base.commit()
    return {}


def _read(work: Mapping[str, Any]) -> dict[str, Any]:
    import mlflow

    mlflow.set_tracking_uri(f"sqlite:///{work['data_mlflow']}/runs.db")
    return timed(lambda: len(mlflow.search_runs(experiment_names=["small"], max_results=100_000)))


LINES: dict[str, dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]] = {
    "counting": {"MLflow, log_metric": _count},
    "sweep": {"MLflow": _sweep},
    "plot": {"MLflow": _plot},
    "reading": {"MLflow, search_runs": _read},
    "prepare": {"mlflow": prepare},
}

if __name__ == "__main__":
    answer(LINES)
