"""Benchmark optimisers under one exact budget; calibrate machines and find what their models lack.

>>> import calibench
>>> run = calibench.execute(calibench.problems.make("sensor_zero"), calibench.optimizers.make("trf"), budget=1000)
>>> run.status, bool(run.best_value < 1e-18)
('ok', True)
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_PACKAGES = ("bench", "problems", "optimizers", "discrepancy")
_HOMES = {
    "ResultStore": "calibench.bench.store.runs",
    "execute": "calibench.bench.execution.run",
}

__all__ = [*_PACKAGES, *_HOMES]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for."""
    if name in _PACKAGES:
        return import_module(f"calibench.{name}")
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'calibench' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
