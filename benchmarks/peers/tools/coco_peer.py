"""COCO: its observer counts and logs functions of its own suites, cocopp reads and draws."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

from answering import answer, cost, points_in, timed
from small_runs import search_at_random


@contextmanager
def _standing_in(folder: str) -> Iterator[None]:
    """Work in a folder: COCO writes below where it stands."""
    here = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(here)


class _Box:
    def __init__(self, problem: Any) -> None:
        self.lower, self.upper = problem.lower_bounds, problem.upper_bounds


def _count(work: Mapping[str, Any]) -> dict[str, Any]:
    """Time COCO's own sphere with and without its observer: it takes no function of a user's."""
    import cocoex

    wanted = "function_indices:1 dimensions:10 instance_indices:1"
    with _standing_in(work["folder"]):
        suites = [cocoex.Suite("bbob", "", wanted) for _ in range(2)]  # a problem does not keep its suite alive
        bare, observed = (suite[0] for suite in suites)
        observed.observe_with(cocoex.Observer("bbob", f"result_folder:count{os.getpid()}"))
        taken = cost(bare, observed, points_in(_Box(bare)))
        observed.free()
        bare.free()
    return {**taken, "note": f"bbob's sphere, its own: {taken['note']}"}


def _search(folder: str, name: str, runs: int, budget: int, seed: int = 0) -> None:
    """Search at random on the first `runs` problems of BBOB, observed."""
    import cocoex

    with _standing_in(folder):
        suite = cocoex.Suite("bbob", "instances: 1-15", "dimensions: 2,3,5,10,20")
        observer = cocoex.Observer("bbob", f"result_folder: {name} algorithm_name: {name}")
        for number, problem in enumerate(islice(suite, runs)):
            problem.observe_with(observer)
            search_at_random(problem, problem.lower_bounds, problem.upper_bounds, budget, seed + number)
            problem.free()


def _sweep(work: Mapping[str, Any]) -> dict[str, Any]:
    import cocopp
    import numpy as np

    _search(work["folder"], "small", work["runs"], work["budget"])
    with _standing_in(work["folder"]):
        loaded = cocopp.load("exdata/small")
    for data in loaded:
        print(data.funcId, data.dim, data.detERT([10.0, 1.0, 0.1]), np.median(data.finalfunvals))
    return {"count": sum(len(data.instancenumbers) for data in loaded), "note": "problems of bbob, its own"}


def _plot(work: Mapping[str, Any]) -> dict[str, Any]:
    import cocopp

    _search(work["folder"], "first", 360, work["budget"])
    with _standing_in(work["folder"]):
        cocopp.main("-o first_page exdata/first")
    return {"note": "1 method, dimension 2, 24 functions: all pages of cocopp"}


def prepare(work: Mapping[str, Any]) -> dict[str, Any]:
    """Search at random on all of BBOB: `algorithms` folders of 24 functions, 5 dimensions and 15 instances."""
    for number in range(work["algorithms"]):
        _search(work["folder"], f"random{number}", 1800, work["budget"], number * 10**6)
    return {}


def _report(work: Mapping[str, Any]) -> dict[str, Any]:
    import cocopp

    folders = sorted(str(path) for path in (Path(work["data_coco"]) / "exdata").iterdir())
    with _standing_in(work["folder"]):
        cocopp.main(["-o", "pages", *folders])
    files = [path for path in (Path(work["folder"]) / "pages").rglob("*") if path.is_file()]
    size = sum(path.stat().st_size for path in files) / 1e6
    return {"note": f"{1800 * len(folders)} runs of {len(folders)} methods, {len(files)} files, {size:.2g} MB"}


def _read(work: Mapping[str, Any]) -> dict[str, Any]:
    import cocopp
    import pandas as pd

    def read() -> int:
        rows: list[dict[str, Any]] = []
        for folder in sorted((Path(work["data_coco"]) / "exdata").iterdir()):
            for data in cocopp.load(str(folder)):
                for instance, value, used in zip(data.instancenumbers, data.finalfunvals, data.maxevals, strict=True):
                    rows.append(
                        {
                            "algorithm": data.algId,
                            "function": data.funcId,
                            "dimension": data.dim,
                            "instance": instance,
                            "best_value": value,
                            "evaluations": used,
                        }
                    )
        return len(pd.DataFrame(rows))

    return timed(read)


LINES: dict[str, dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]] = {
    "counting": {"COCO, observer": _count},
    "sweep": {"COCO and cocopp": _sweep},
    "plot": {"COCO and cocopp": _plot},
    "report": {"cocopp": _report},
    "reading": {"cocopp.load, then a DataFrame": _read},
    "prepare": {"coco": prepare},
}

if __name__ == "__main__":
    answer(LINES)
