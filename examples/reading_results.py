"""Reading results in pandas: a small sweep, then its runs, its traces, and its medians with their spread.

python examples/reading_results.py [FOLDER]
"""

from __future__ import annotations

import sys
import tempfile

import calibench

if __name__ == "__main__":
    folder = sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp()
    calibench.sweep(
        "problem=sensor_zero,link_length", "optimizer=trf,de,nlopt_LN_BOBYQA", "budget=600", "seeds=5", "start=random",
        "study=example", f"results={folder}",
    )  # fmt: skip

    store = calibench.ResultStore(f"{folder}/example")
    runs = store.runs()  # a row a run: pandas.read_parquet(f"{folder}/example/runs.parquet") reads the same
    print(runs.groupby(["status", "stop_reason"]).size().to_string(), "\n")

    cells = runs.groupby(["problem", "optimizer"])["best_value"]
    print(cells.quantile([0.25, 0.5, 0.75]).unstack().to_string(float_format="{:.1e}".format), "\n")

    runs["reached"] = [None not in hits for hits in runs["hits"]]  # evaluations at which each target was reached
    print(runs.pivot_table(index="problem", columns="optimizer", values="reached", aggfunc="mean").to_string(), "\n")

    traces = store.traces().merge(runs[["run_id", "problem", "optimizer"]], on="run_id")
    after = traces[traces["evaluations"] <= 100].groupby("run_id").last()
    print("median best value after 100 evaluations")
    print(after.groupby(["problem", "optimizer"])["best_value"].median().to_string(float_format="{:.1e}".format))
