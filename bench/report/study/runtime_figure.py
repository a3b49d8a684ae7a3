"""The figure of how fast targets fall: runtime ECDF of every method over the problems of a group, or over all."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

from calibench.bench.provenance.run_id import digest
from calibench.bench.report.shared.drawing import COLOURS, DASHES, STYLE, Drawing, entitle
from calibench.bench.report.study.figures import Drawable, file_name
from calibench.bench.statistics.cells import METHOD, PROBLEM, SETTING
from calibench.bench.statistics.names.labels import method_labels
from calibench.bench.statistics.names.order import looks_of
from calibench.bench.statistics.runtime import ecdf
from calibench.core.counted import counted

_NAMED = 12  # methods that get a colour; the others are a grey background
_QUANTITY = "gap"


def ecdf_figures(runs: pd.DataFrame, hits: pd.DataFrame, groups: pd.Series) -> Iterator[tuple[str, str, Drawable]]:
    """Yield (name, caption, how it is drawn) of the whole study and of each of several `groups`, by index of `runs`.

    Nothing where no gap to a best value is known. With one problem a group there is only the whole.
    """
    targets = hits[hits["quantity"] == _QUANTITY]
    if targets.empty:
        return
    total = len(runs[PROBLEM].drop_duplicates())
    yield "ecdf", f"Runtime ECDF, {counted(total, 'problem')}", partial(runtime_ecdf, runs, targets, "All problems")
    parts = {str(name): mine for name, mine in runs.groupby(groups.to_numpy(), sort=False)}
    if not 1 < len(parts) < total:
        return
    for name, mine in parts.items():
        some = targets[targets["run_id"].isin(set(mine["run_id"]))]
        title = f"Group {name}"
        caption = f"Runtime ECDF, {title}, {counted(len(mine[PROBLEM].drop_duplicates()), 'problem')}"
        label = f"ecdf_{file_name(name)}"
        yield (
            label if label != "ecdf_" else f"ecdf_{digest(name)[:6]}",
            caption,
            partial(runtime_ecdf, mine, some, title),
        )


def runtime_ecdf(runs: pd.DataFrame, hits: pd.DataFrame, title: str = "") -> Drawing:
    """Draw the share of (run, target) pairs that each method reached, over charged evaluations; the numbers beside it.

    `hits` are of one quantity. A problem counts as much as any other.
    """
    numbers = ecdf(hits, runs)
    keys = [*METHOD, *SETTING]
    labels = method_labels(runs)
    called = runs[keys].assign(method=labels).drop_duplicates().rename(columns={"target": "target_value"})
    numbers = numbers.merge(called, on=[*METHOD, "start", "budget", "target_value"], how="left")
    ends = numbers.groupby("method", sort=False)["share"].last().sort_values(ascending=False, kind="stable")
    looks = looks_of(runs.assign(method=labels), list(ends.index))
    with rc_context(STYLE):
        figure = Figure(figsize=(4.4 + 0.068 * max(map(len, ends.index)), 3.7), layout="constrained")
        axes = figure.subplots()
        for i, method in reversed(list(enumerate(ends.index))):
            mine = numbers[numbers["method"] == method]
            named, k = i < _NAMED, looks[method]
            look = (
                {"color": COLOURS[k % len(COLOURS)], "linestyle": DASHES[(k + k // len(COLOURS)) % len(DASHES)]}
                if named
                else {"color": "0.8", "lw": 0.7}
            )
            axes.step(mine["cost"], mine["share"], where="post", label=method if named else None, **look)
        axes.set(xscale="log", ylim=(0, 1), xlabel="charged evaluations", ylabel="share of (run, target) pairs")
        handles, names = axes.get_legend_handles_labels()
        if handles:
            figure.legend(handles[::-1], names[::-1], loc="outside right center", fontsize=8)
        count = hits["target"].nunique()
        entitle(figure, f"{title}: {counted(count, 'target')} above the best value" if title else "")
    return figure, numbers.assign(share=np.asarray(numbers["share"], dtype=float))
