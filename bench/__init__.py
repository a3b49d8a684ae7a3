"""Run optimisers on problems under one budget, keep what comes of it in Parquet, draw it.

>>> from calibench import bench, optimizers, problems
>>> run = bench.execute(problems.make("sensor_zero"), optimizers.make("trf"), budget=1000)
>>> run.status, bool(run.best_value < 1e-18)
('ok', True)
"""

from typing import TYPE_CHECKING

from calibench.core.lazy import loader, public_names

if TYPE_CHECKING:
    from calibench.bench.discovery.store import report_schema
    from calibench.bench.execution.costly import ReplayFolder, forget_replay
    from calibench.bench.execution.in_progress import publishing
    from calibench.bench.execution.run import Run, Spec, execute
    from calibench.bench.gate.evaluator import BudgetExhausted, Evaluator
    from calibench.bench.measured import read_measured, write_measured
    from calibench.bench.store.runs import ResultStore
    from calibench.bench.tracking.catalogue import studies
    from calibench.bench.tracking.tables import dataset

__all__ = [
    "BudgetExhausted", "Evaluator", "ReplayFolder", "ResultStore", "Run", "Spec", "dataset", "execute",
    "forget_replay", "publishing", "read_measured", "report_schema", "studies", "write_measured",
]  # fmt: skip

_HOMES = {
    "BudgetExhausted": "gate.evaluator", "Evaluator": "gate.evaluator", "ReplayFolder": "execution.costly",
    "ResultStore": "store.runs", "Run": "execution.run", "Spec": "execution.run", "execute": "execution.run",
    "forget_replay": "execution.costly", "publishing": "execution.in_progress", "read_measured": "measured",
    "report_schema": "discovery.store", "write_measured": "measured", "studies": "tracking.catalogue",
    "dataset": "tracking.tables",
}  # fmt: skip


__getattr__ = loader("calibench.bench", _HOMES)  # `bench list` must not wait for Arrow
__dir__ = public_names(__all__)
if __name__ == "bench":  # a short name, in a checkout: public names only, as a module has its whole name alone
    __path__ = [path.removesuffix("bench") + "calibench" for path in __path__]  # `python -m bench` is `calibench`
