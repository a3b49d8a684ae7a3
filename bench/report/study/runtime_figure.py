"""The figures of how fast targets fall: runtime ECDF of every method over some problems, and performance profiles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibench.bench.provenance.run_id import digest
from calibench.bench.report.shared.drawing import STYLE, Drawing, entitle, look_of, others, put_legend
from calibench.bench.report.study.figures import Drawable, file_name
from calibench.bench.statistics.cells import METHOD, PROBLEM, SETTING
from calibench.bench.statistics.fixed_target.profiles import performance_profile
from calibench.bench.statistics.names.labels import method_labels, settings_told
from calibench.bench.statistics.names.order import looks_of
from calibench.bench.statistics.runtime import ecdf, ert
from calibench.bench.statistics.summary import method_names
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
    numbers = ecdf_of(runs, hits)
    with rc_context(STYLE):
        figure = Figure(figsize=(share_width(numbers), 3.7), layout="constrained")
        axes = figure.subplots()
        draw_ecdf(axes, numbers, runs)
        put_legend(figure, [axes])
        count = hits["target"].nunique()
        entitle(figure, f"{title}: {counted(count, 'target')} above the best value" if title else "")
    return figure, numbers


def ecdf_of(runs: pd.DataFrame, hits: pd.DataFrame) -> pd.DataFrame:
    """Return `runtime.ecdf` of hits of one quantity, with the name of each row's method (`method_labels`)."""
    runs = runs.copy(deep=False)
    for _, mine in runs.groupby(METHOD, sort=False):  # a method whose start each problem decides is one
        told = settings_told(mine)
        for column in SETTING:
            if column not in told:
                runs.loc[mine.index, column] = mine[column].iloc[0]
    numbers = ecdf(hits, runs)
    called = runs[[*METHOD, *SETTING]].assign(method=method_labels(runs)).drop_duplicates()
    called = called.rename(columns={"target": "target_value"})
    numbers = numbers.merge(called, on=[*METHOD, "start", "budget", "target_value"], how="left")
    return numbers.assign(share=np.asarray(numbers["share"], dtype=float))


def draw_ecdf(axes: Axes, numbers: pd.DataFrame, runs: pd.DataFrame) -> None:
    """Draw the lines of `ecdf_of`."""
    _draw_shares(axes, numbers, "cost", looks_of(runs.assign(method=method_labels(runs)), _best_first(numbers, "cost")))
    axes.set(xlabel="charged evaluations", ylabel=f"share of (run, target) pairs{_over(numbers, 'problem')}")


def profile_of(runs: pd.DataFrame, hits: pd.DataFrame) -> pd.DataFrame:
    """Return `performance_profile` of hits of one quantity, with the name of each row's method."""
    steps = performance_profile(ert(hits, runs, intervals=False))
    called = dict(zip(zip(*(runs[key] for key in METHOD)), method_names(runs)))
    return steps.assign(method=[called[pair] for pair in zip(*(steps[key] for key in METHOD))])


def draw_profile(axes: Axes, numbers: pd.DataFrame, runs: pd.DataFrame) -> None:
    """Draw the lines of `profile_of`."""
    _draw_shares(
        axes, numbers, "ratio", looks_of(runs.assign(method=method_names(runs)), _best_first(numbers, "ratio"))
    )
    shares = f"share of (problem, target) pairs{_over(numbers, 'task')}"
    axes.set(xlabel="expected running time over the least of any method", ylabel=shares)
    axes.set_xlim(left=1)


def _over(numbers: pd.DataFrame, what: str) -> str:
    """Return a line on which problems or tasks the shares are of; "" where all methods were run on all."""
    parts, whole = numbers[f"{what}s"], numbers[f"of_{what}s"]
    if (parts == whole).all():
        return ""
    if parts.nunique() == 1:
        return f"\non the {parts.iloc[0]} of {counted(int(whole.iloc[0]), what)} that all methods were run on"
    return f"\nof each method on its own {what}s: none has all methods"


def share_width(numbers: pd.DataFrame) -> float:
    """Return the width of a figure of these methods' shares with their names beside it [inches]."""
    return 4.4 + 0.068 * max(map(len, numbers["method"]), default=0)


def _best_first(numbers: pd.DataFrame, over: str) -> list[str]:
    """Return the methods by the share at which they end, of equal ones first what has half of it earliest."""
    ends = numbers.groupby("method", sort=False)["share"].max()
    half = numbers[numbers["share"] >= numbers["method"].map(ends) / 2].groupby("method", sort=False)[over].min()
    order = pd.DataFrame({"share": -ends, "half": half}).sort_values(["share", "half"], kind="stable")
    return [str(method) for method in order.index]


def _draw_shares(axes: Axes, numbers: pd.DataFrame, over: str, looks: Mapping[str, int]) -> None:
    """Draw the share of each method over a column, as steps; the best have a colour, and are named in their order."""
    order = _best_first(numbers, over)
    most = float(numbers[over][np.isfinite(numbers[over])].max())  # where all lines end
    for i, method in enumerate(order):
        mine, named = numbers[(numbers["method"] == method) & np.isfinite(numbers[over])], i < _NAMED
        look = look_of(looks[method]) if named else {"color": "0.8", "lw": 0.7}
        label = method if named else others(len(order) - _NAMED) if i == _NAMED else None
        at, share = [1.0, *mine[over], most], [0.0, *mine["share"], mine["share"].max() if len(mine) else 0.0]
        axes.step(at, share, where="post", label=label, zorder=2.5 - 0.001 * i, **look)
    axes.set(xscale="log", ylim=(0, 1.02))
