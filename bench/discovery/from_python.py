"""What a model is missing, from Python: a file or measured data in, a report out; nothing is written."""

from pathlib import Path
from typing import Any

from calibench.bench.measured.sources import sources
from calibench.discrepancy import DataError, MeasuredData, Report, explain


def discover(machine: str, data: str | Path | MeasuredData, **stated: Any) -> Report:
    """Return what is missing from the model of `machine`, a registered name or ``FILE.py:Class``, according to `data`.

    `data` is what ``data=`` names on the command line (a file, or a set that ships), or data that are read already.
    `stated` is what the file should state and does not (``sigma_enc=5e-5``, in the units of docs/discover.md). Raises
    `DataError` in one line for data that cannot be used.
    """
    if not isinstance(data, MeasuredData):
        found = sources(str(data), machine)
        if len(found) > 1:
            raise DataError(f"discover: {data} names {len(found)} sets of data; one is needed")
        data = found[0].read(stated)
    elif stated:
        raise TypeError(f"discover: {', '.join(stated)} goes with a file; data that are read already have their own")
    return explain(machine, data)
