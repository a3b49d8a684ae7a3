"""IOHprofiler: IOHexperimenter counts and logs, IOHinspector reads and draws."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from answering import answer, cost, full12, points_in, timed
from small_runs import Sphere, search_at_random


def _count(logged: bool, work: Mapping[str, Any]) -> dict[str, Any]:
    import ioh

    problem = full12()
    own = ioh.wrap_problem(
        problem, name="full12", optimization_type=ioh.OptimizationType.MIN, dimension=12,
        lb=float(problem.lower.min()), ub=float(problem.upper.max()),
    )  # fmt: skip
    logger = ioh.logger.Analyzer(root=work["folder"], folder_name=f"ioh{os.getpid()}")
    if logged:
        own.attach_logger(logger)
    own(problem.truth)  # a good point was seen, as in nearly all calls
    taken = cost(problem, own, points_in(problem))
    if logged:
        own.detach_logger()  # while the logger is there: ioh keeps no reference to it
        logger.close()
    return taken


def _sphere(folder: str, runs: int, budget: int, name: str = "small") -> None:
    import ioh

    sphere = Sphere()
    ioh.problem.wrap_real_problem(sphere, "own sphere", ioh.OptimizationType.MIN, -5.0, 5.0)
    problem = ioh.get_problem("own sphere", instance=1, dimension=5)
    logger = ioh.logger.Analyzer(root=folder, folder_name=name, algorithm_name="random")
    problem.attach_logger(logger)
    for seed in range(runs):
        search_at_random(problem, sphere.lower, sphere.upper, budget, seed)
        problem.reset()
    logger.close()


def _sweep(work: Mapping[str, Any]) -> dict[str, Any]:
    import iohinspector

    _sphere(work["folder"], work["runs"], work["budget"])
    manager = iohinspector.DataManager()
    manager.add_folder(f"{work['folder']}/small")
    print(manager.overview)
    return {"count": len(manager.overview)}


def _plot(work: Mapping[str, Any]) -> dict[str, Any]:
    import iohinspector

    _sphere(work["folder"], 5, work["budget"], "random")
    manager = iohinspector.DataManager()
    manager.add_folder(f"{work['folder']}/random")
    data = manager.load(monotonic=True, include_meta_data=True)
    iohinspector.plot_single_function_fixed_budget(data, file_name=f"{work['folder']}/first.png")
    return {"note": "1 method, 5 seeds, one figure"}


def prepare(work: Mapping[str, Any]) -> dict[str, Any]:
    """Search at random on all of BBOB, logged: `algorithms` folders of 24 functions, 5 dimensions and 15 instances."""
    import ioh

    for number in range(work["algorithms"]):
        logger = ioh.logger.Analyzer(
            root=work["folder"], folder_name=f"random{number}", algorithm_name=f"random{number}"
        )
        for function in range(1, 25):
            for dimension in (2, 3, 5, 10, 20):
                for instance in range(1, 16):
                    problem = ioh.get_problem(function, instance, dimension)
                    problem.attach_logger(logger)
                    seed = number * 10**6 + function * 10**4 + dimension * 100 + instance
                    search_at_random(problem, problem.bounds.lb, problem.bounds.ub, work["budget"], seed)
                    problem.detach_logger()
        logger.close()
    return {}


def _report(work: Mapping[str, Any]) -> dict[str, Any]:
    """Draw what a study wants: ECDF over all, and fixed target and budget of the 24 functions in one dimension."""
    import iohinspector
    import matplotlib.pyplot as plt

    manager = iohinspector.DataManager()
    manager.add_folders([str(path) for path in sorted(Path(work["data_ioh"]).iterdir())])
    data = manager.load(monotonic=True, include_meta_data=True)
    iohinspector.plot_ecdf(data, file_name=f"{work['folder']}/ecdf.png")
    for function in range(1, 25):
        chosen = data.filter((data["function_id"] == function) & (data["dimension"] == 5))
        iohinspector.plot_single_function_fixed_target(chosen, file_name=f"{work['folder']}/target{function}.png")
        plt.close("all")
    return {"note": f"no page of its own: {len(manager.overview)} runs read, one ECDF and 24 figures of running time"}


def _read(work: Mapping[str, Any]) -> dict[str, Any]:
    import iohinspector

    def read() -> int:
        manager = iohinspector.DataManager()
        manager.add_folders([str(path) for path in sorted(Path(work["data_ioh"]).iterdir())])
        return len(manager.overview.to_pandas())

    return timed(read)


LINES = {
    "counting": {
        "ioh, problem without a logger": lambda work: _count(False, work),
        "ioh, Analyzer": lambda work: _count(True, work),
    },
    "sweep": {"ioh and iohinspector": _sweep},
    "plot": {"ioh and iohinspector": _plot},
    "report": {"iohinspector": _report},
    "reading": {"iohinspector, overview": _read},
    "prepare": {"ioh": prepare},
}

if __name__ == "__main__":
    answer(LINES)
