"""What a model is missing, from Python: a file or measured data in, a report out; nothing is written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from calibench.bench.measured.files import read_measured
from calibench.discrepancy import MeasuredData, Report, explain


def discover(machine: str, data: str | Path | MeasuredData, **stated: Any) -> Report:
    """Return what `data` say is missing from the model of `machine`, a registered name or ``FILE.py:Class``.

    `data` is a file (docs/measured-data.md says which are read), or data that are read already. `stated` is what the file should say and does not
    (``sigma_enc=5e-5``, in the units of docs/discover.md). Raises `DataError` in one line for what cannot be used.
    """
    if not isinstance(data, MeasuredData):
        data = read_measured(data, machine, stated)
    elif stated:
        raise TypeError(f"discover: {', '.join(stated)} goes with a file; data that are read already have their own")
    return explain(machine, data)
