"""``bench run tuner=optuna ...``: trials as they end, and the worth of choosing the best of them."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable

import pandas as pd

from calibench.bench.commands.choose import print_chosen
from calibench.bench.statistics.choosing import NEEDED, By, choose
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.carry_out import Outcome
from calibench.bench.sweep.request import Request
from calibench.bench.sweep.tuner import Trial, Tuning, check_optuna, first_request, read_tuning, trials
from calibench.core.words import counted
from calibench.core.words import print_plain as print

Carry = Callable[[Request, str], Outcome]  # a request, and the command that the manifest keeps


def tune(words: list[str], command: str, carry: Carry, dry_run: bool) -> int:
    """Run the default and the trials that `words` ask for; 1 where a run failed or has no row."""
    tuning = read_tuning(words)
    check_optuna(tuning)
    first = first_request(tuning)
    if dry_run:
        runs = len(first.specs)
        print(
            f"the default and {counted(tuning.trials, 'trial')} of {counted(runs, 'run')} each, at most "
            f"{counted(runs * (tuning.trials + 1), 'run')}, would go to {first.folder}; nothing was written"
        )
        return 0
    done: list[Trial] = []
    for trial in trials(tuning, lambda request, number: carry(request, "" if number else command)):
        done.append(trial)
        print(_line(trial, done, tuning.trials), flush=True)
    store = ResultStore(first.folder)
    asked = {run_id for trial in done for run_id in trial.request.specs}
    rows = store.runs(NEEDED)
    mine = rows[rows["run_id"].isin(asked)]
    print()
    _print_choice(mine, tuning)
    skipped = sum(trial.outcome.skipped for trial in done)
    print(f"{counted(len(mine), 'run')} in {store.folder}/runs.parquet; {skipped} of those asked for were done before")
    failed, ended = (int((mine["status"] == status).sum()) for status in ("failed", "timeout"))
    if failed or ended or len(mine) < len(asked):
        counts = {"failed": failed, "ended by the time limit": ended, "have no row": len(asked) - len(mine)}
        reasons = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
        print(f"{reasons}; `bench status {shlex.quote(str(store.folder))}` tells why")
        return 1
    return 0


def _line(trial: Trial, done: list[Trial], of: int) -> str:
    texts = (f"{k}={v:.6g}" if isinstance(v, float) else f"{k}={v}" for k, v in trial.values.items())
    name = f"trial {trial.number} of {of}: {', '.join(texts)}" if trial.number else "the default"
    if math.isnan(trial.score):
        return f"{name}: no score (a run without an answer, or none at the goal)"
    best = all(not other.score < trial.score for other in done)
    return f"{name}: score {trial.score:.3f}{' (best so far)' if best and trial.number else ''}"


def _print_choice(mine: pd.DataFrame, tuning: Tuning) -> None:
    by: By = tuning.by
    try:
        print_chosen(choose(mine, by))
    except ValueError as error:
        print(f"what choosing is worth is not told: {error}")
        return
    if tuning.sampler != "random":
        print(
            f"trials were proposed ({tuning.sampler}) by their scores on all instances: the nested score leaves out "
            "that optimism; tuner.sampler=random has none, other instances test the choice"
        )
