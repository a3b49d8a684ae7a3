"""A sweep from Python: the words of ``bench run -m``, the same store, the same resume."""

from __future__ import annotations

from typing import TYPE_CHECKING

from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.carry_out import carry_out
from calibench.bench.sweep.request import read_request
from calibench.bench.sweep.stale import Way

if TYPE_CHECKING:
    import pandas as pd


def sweep(*arguments: str, way: Way = "ask") -> pd.DataFrame:
    """Carry out ``bench run -m`` with `arguments`; return the rows of its runs, those that were done before too.

    Finished runs of other code are refused, done again or kept, as `way` says: "ask", "rerun", "keep". Nothing is
    printed. Raises `RequestError` for a request that makes no sense, before anything runs.

    ``sweep("problem=full11,full12", "optimizer=lm,de", "budget=2000", "seeds=5", "study=mine")``
    """
    request = read_request(arguments, multirun=True)
    outcome = carry_out(request, lambda done, of, label: None, way=way, tell=lambda line: None)
    runs = ResultStore(request.folder).runs()
    return runs[runs["run_id"].isin(outcome.asked)].reset_index(drop=True)
