"""What a model is missing, from Python: a file or measured data in, a report out; nothing is written."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from calibench.bench.discovery.batch import others_of
from calibench.bench.measured.sources import sets
from calibench.discrepancy import DataError, MeasuredData, Report, carried, explain

Readings = str | Path | MeasuredData


def discover(machine: str, data: Readings, *, across: Readings | Sequence[Readings] = (), **stated: Any) -> Report:
    """Return what is missing from the model of `machine`, a registered name or ``FILE.py:Class``, according to `data`.

    `data` is what ``data=`` names on the command line (a file, or a set that ships), or data that are read already.
    `across` are other sets of the same machine, in the same forms: `report.across` says which findings they carry.
    `stated` is what the file should state and does not (``sigma_enc=5e-5``, in the units of docs/discover.md). Raises
    `DataError` in one line for data that cannot be used.
    """
    if not isinstance(data, MeasuredData):
        found = sets(str(data), machine, stated)
        if len(found) > 1:
            raise DataError(f"discover: {data} names {len(found)} sets of data; one is needed")
        data = found[0].read(stated)
    elif stated:
        raise TypeError(f"discover: {', '.join(stated)} goes with a file; data that are read already have their own")
    others: list[MeasuredData] = []
    for one in [across] if isinstance(across, str | Path | MeasuredData) else across:
        if isinstance(one, MeasuredData):
            others.append(one)
        else:
            others += [replace(o.read(stated), name=o.case) for o in others_of(str(one), machine)]
    report = explain(machine, data)
    return carried(report, others) if others else report
