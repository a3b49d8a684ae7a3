"""Run optimisers on problems under one budget, keep what comes of it in Parquet, draw it.

>>> from calibench import bench, optimizers, problems
>>> run = bench.execute(problems.make("sensor_zero"), optimizers.make("trf"), budget=1000)
>>> run.status, bool(run.best_value < 1e-18)
('ok', True)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from calibench._checkout import one_module

if TYPE_CHECKING:
    from calibench.bench.discovery.schema import report_schema
    from calibench.bench.execution.costly import ReplayFolder, forget_replay
    from calibench.bench.execution.in_progress.progress import publishing
    from calibench.bench.execution.run import Run, Spec, execute
    from calibench.bench.gate.evaluator import BudgetExhausted, Evaluator
    from calibench.bench.measured import read_measured, write_measured
    from calibench.bench.store.runs import ResultStore

__all__ = [
    "BudgetExhausted", "Evaluator", "ReplayFolder", "ResultStore", "Run", "Spec", "execute", "forget_replay",
    "publishing", "read_measured", "report_schema", "write_measured",
]  # fmt: skip

_HOMES = {
    "BudgetExhausted": "calibench.bench.gate.evaluator",
    "Evaluator": "calibench.bench.gate.evaluator",
    "ReplayFolder": "calibench.bench.execution.costly",
    "ResultStore": "calibench.bench.store.runs",
    "Run": "calibench.bench.execution.run",
    "Spec": "calibench.bench.execution.run",
    "execute": "calibench.bench.execution.run",
    "forget_replay": "calibench.bench.execution.costly",
    "publishing": "calibench.bench.execution.in_progress.progress",
    "read_measured": "calibench.bench.measured",
    "report_schema": "calibench.bench.discovery.schema",
    "write_measured": "calibench.bench.measured",
}


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for: ``bench list`` must not wait for Arrow."""
    if name not in _HOMES:
        raise AttributeError(f"module 'bench' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


one_module(__name__)
