"""A sweep from Python: the words of ``bench run -m``, the same store, the same resume."""

from __future__ import annotations

import warnings
from contextlib import nullcontext
from typing import TYPE_CHECKING

from calibench.bench.statistics.cells import PROBLEM
from calibench.bench.statistics.summary import key_of_costs
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.carry_out import Way, carry_out, tell_of_costs
from calibench.bench.sweep.progress import progress as shown_progress
from calibench.bench.sweep.remarks import ONE_RUN, remarks_on_rows
from calibench.bench.sweep.request import read_request
from calibench.bench.words import RequestError

if TYPE_CHECKING:
    import pandas as pd


def sweep(*arguments: str, way: Way = "ask", progress: bool = False) -> pd.DataFrame:
    """Carry out ``bench run -m`` with `arguments`; return the rows of its runs, those that were done before too.

    Finished runs of other code are refused, done again or kept, as `way` says: "ask", "rerun", "keep". With `progress`
    a bar tells how far it is, in a terminal and in a notebook, and lines do elsewhere; else nothing is printed. What
    the command line remarks on a sweep and its runs is a `UserWarning` each. Raises `RequestError` for a request that
    makes no sense, before anything runs.

    ``sweep("problem=full11,full12", "optimizer=lm,de", "budget=2000", "seeds=5", "study=mine")``
    """
    try:
        request = read_request(arguments, multirun=True)
    except RequestError as error:
        raise error.with_traceback(None) from None  # it says what is wrong with the words: no frame of ours helps
    for line in (*request.left_out, *request.copies, *request.remarks):
        warnings.warn(line, stacklevel=2)
    with shown_progress(request.folder) if progress else nullcontext(lambda done, of, label: None) as report:
        outcome = carry_out(request, report, way=way, tell=lambda line: None)
    store = ResultStore(request.folder)
    runs = store.runs()
    mine = runs[runs["run_id"].isin(outcome.asked)].reset_index(drop=True)
    asked = set(zip(*(mine[name] for name in PROBLEM)))
    costs = [record for record in store.manifest().get("costs", ()) if key_of_costs(record) in asked]
    said: list[str] = []
    tell_of_costs(costs, said.append)
    in_vain = request.seeds > 1 and len(request.specs) + len(request.other_shards) == len(request.budgets)
    for line in (*said, *remarks_on_rows(mine), *([ONE_RUN] if in_vain else [])):
        warnings.warn(line, stacklevel=2)
    return mine
