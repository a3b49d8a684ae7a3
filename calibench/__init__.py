"""Benchmark optimisers under one exact budget; calibrate machines and find what their models lack.

>>> import calibench
>>> run = calibench.execute(calibench.problems.make("sensor_zero"), calibench.optimizers.make("trf"), budget=1000)
>>> run.status, bool(run.best_value < 1e-18)
('ok', True)
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from calibench import bench, calibration, discrepancy, optimizers, plot, problems, testing
    from calibench.bench.discovery.batch import discover
    from calibench.bench.execution.run import execute
    from calibench.bench.report.from_python import answer
    from calibench.bench.store.runs import ResultStore
    from calibench.bench.sweep.carry_out import sweep
    from calibench.calibration.api import calibrate, design, hand_eye
    from calibench.problems.identifiability import identify

__all__ = [
    "ResultStore", "answer", "bench", "calibrate", "calibration", "design", "discover", "discrepancy", "execute",
    "hand_eye", "identify", "optimizers", "plot", "problems", "sweep", "testing",
]  # fmt: skip

_HOMES = {
    "ResultStore": "calibench.bench.store.runs",
    "answer": "calibench.bench.report.from_python",
    **dict.fromkeys(("calibrate", "design", "hand_eye"), "calibench.calibration.api"),
    "discover": "calibench.bench.discovery.batch",
    "execute": "calibench.bench.execution.run",
    "identify": "calibench.problems.identifiability",
    "sweep": "calibench.bench.sweep.carry_out",
}

if not (_folder := Path(__file__).parent).joinpath("bench").is_dir():  # a clone without links, as Windows makes them:
    __path__.append(str(_folder.parent))  # `calibench.bench` is found at ../bench; never so of what is installed


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for: ``calibench list`` must not wait for Arrow."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    if name in __all__:
        return import_module(f"calibench.{name}")
    if name == "__version__":
        from importlib.metadata import version

        return version("calibench")
    raise AttributeError(f"module 'calibench' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
