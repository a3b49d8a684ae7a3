"""A sweep from Python: the words of ``bench run -m``, the same store, the same resume."""

from __future__ import annotations

from contextlib import nullcontext
from typing import TYPE_CHECKING

from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.carry_out import carry_out
from calibench.bench.sweep.progress import progress as shown_progress
from calibench.bench.sweep.request import read_request
from calibench.bench.sweep.stale import Way

if TYPE_CHECKING:
    import pandas as pd


def sweep(*arguments: str, way: Way = "ask", progress: bool = False) -> pd.DataFrame:
    """Carry out ``bench run -m`` with `arguments`; return the rows of its runs, those that were done before too.

    Finished runs of other code are refused, done again or kept, as `way` says: "ask", "rerun", "keep". With `progress`
    a bar tells how far it is, in a terminal and in a notebook, and lines do elsewhere; else nothing is printed. Raises
    `RequestError` for a request that makes no sense, before anything runs.

    ``sweep("problem=full11,full12", "optimizer=lm,de", "budget=2000", "seeds=5", "study=mine")``
    """
    request = read_request(arguments, multirun=True)
    with shown_progress(request.folder) if progress else nullcontext(_unseen) as report:
        outcome = carry_out(request, report, way=way, tell=lambda line: None)
    runs = ResultStore(request.folder).runs()
    return runs[runs["run_id"].isin(outcome.asked)].reset_index(drop=True)


def _unseen(done: int, of: int, label: str) -> None:
    """Tell nothing."""
