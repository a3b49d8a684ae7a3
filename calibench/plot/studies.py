"""Drawings of runs: convergence, runtime ECDF, performance profile, mean ranks, and every method on every problem.

A drawing is a function; the numbers behind it are its attribute `data`.
"""

from collections.abc import Callable
from typing import Generic, ParamSpec, Protocol, cast

import pandas as pd
from matplotlib.axes import Axes

from calibench.bench.report.from_python import Source, read_source
from calibench.bench.report.shared.drawing import axes_in, entitle, explain_lines, figure_of, put_legend
from calibench.bench.report.study import figures
from calibench.bench.statistics.names import method_labels, problem_titles
from calibench.bench.statistics.optimum import optimum_of
from calibench.bench.statistics.ranking import blocks_of, friedman, looks_of
from calibench.bench.statistics.summary import method_names
from calibench.core.options import suggest
from calibench.core.words import counted

Draw = ParamSpec("Draw")
Data = ParamSpec("Data")


class _Drawing(Protocol, Generic[Draw, Data]):
    """A function that draws, and `data`, which returns the numbers that it draws."""

    __call__: Callable[Draw, Axes]
    data: Callable[Data, pd.DataFrame]


def with_data(data: Callable[Data, pd.DataFrame]) -> Callable[[Callable[Draw, Axes]], _Drawing[Draw, Data]]:
    """Let a function that draws have the numbers of its drawing as the attribute `data`."""

    def give(draw: Callable[Draw, Axes]) -> _Drawing[Draw, Data]:
        drawing = cast("_Drawing[Draw, Data]", draw)
        drawing.data = data
        return drawing

    return give


def _convergence(source: Source, *, problem: str | None = None, traces: pd.DataFrame | None = None) -> pd.DataFrame:
    """Return the bands of each method on each problem: problem, method, charged, q1, median, q3, runs."""
    chosen = read_source(source, problem, traces)
    titles = problem_titles(chosen.runs)
    named = chosen.runs.assign(method=method_labels(chosen.runs))
    drawn = [
        figures.convergence_bands(mine, chosen.traces()).assign(problem=title)
        for title, mine in named.groupby(titles, sort=False)
    ]
    return pd.concat(drawn, ignore_index=True)[["problem", "method", "charged", "q1", "median", "q3", "runs"]]


@with_data(_convergence)
def convergence(
    source: Source, ax: Axes | None = None, *, problem: str | None = None, traces: pd.DataFrame | None = None
) -> Axes:
    """Draw the best value over charged evaluations on one problem: median and quartiles of each method's runs.

    `problem` chooses one of several, by its name or as the page calls it. `traces` are needed beside a table of runs
    that does not know its folder. Raises `ValueError` where there are several problems and none is chosen.
    """
    chosen = read_source(source, problem, traces)
    titles = problem_titles(chosen.runs)
    if titles.nunique() > 1:
        choice = f"problem= takes one of them; {suggest('', dict.fromkeys(titles))}"
        raise ValueError(f"convergence draws one problem, and there are {titles.nunique()}: {choice}")
    runs = chosen.with_looks().assign(method=method_labels(chosen.runs))
    named = figures.named_methods(runs)
    drawn = figures.convergence_bands(runs, chosen.traces())
    with axes_in(ax, 4.4 + 0.068 * max(map(len, named)), 3.7) as axes:
        figures.draw_convergence(axes, drawn, optimum_of(runs), named, looks_of(runs, named))
        _finish(axes, ax, f"{titles.iloc[0]}: {figures.spread_text(runs)}")
    return axes


def _ecdf(source: Source, *, problem: str | None = None, traces: pd.DataFrame | None = None) -> pd.DataFrame:
    """Return the runtime ECDF: the columns of `bench.statistics.fixed_target.ecdf`, and method."""
    chosen = read_source(source, problem, traces)
    return figures.ecdf_of(chosen.runs, chosen.hits())


@with_data(_ecdf)
def ecdf(
    source: Source, ax: Axes | None = None, *, problem: str | None = None, traces: pd.DataFrame | None = None
) -> Axes:
    """Draw the share of (run, target) pairs that each method reached within a number of charged evaluations.

    Of all problems together, each counts the same, or of one `problem`. Targets are COCO's 51 above the best value.
    """
    chosen = read_source(source, problem, traces)
    hits, runs = chosen.hits(), chosen.with_looks()
    numbers = figures.ecdf_of(chosen.runs, hits)
    with axes_in(ax, figures.share_width(numbers), 3.7) as axes:
        figures.draw_shares(axes, numbers, runs.assign(method=method_labels(runs)), "cost")
        _finish(axes, ax, f"{chosen.title()}: {counted(hits['target'].nunique(), 'target')} above the best value")
    return axes


def _profile(source: Source, *, problem: str | None = None, traces: pd.DataFrame | None = None) -> pd.DataFrame:
    """Return the steps of the performance profile: method, optimizer, optimizer_options, ratio, share, tasks."""
    chosen = read_source(source, problem, traces)
    return figures.profile_of(chosen.runs, chosen.hits())


@with_data(_profile)
def profile(
    source: Source, ax: Axes | None = None, *, problem: str | None = None, traces: pd.DataFrame | None = None
) -> Axes:
    """Draw the share of (problem, target) pairs that a method reaches within so many times the best method's cost.

    The performance profile of Dolan and More (2002), of expected running times (ERT) to the targets of `ecdf`.
    """
    chosen = read_source(source, problem, traces)
    numbers, runs = figures.profile_of(chosen.runs, chosen.hits()), chosen.with_looks()
    with axes_in(ax, figures.share_width(numbers), 3.7) as axes:
        figures.draw_shares(axes, numbers, runs.assign(method=method_names(runs)), "ratio")
        _finish(axes, ax, f"{chosen.title()}: {counted(int(numbers['tasks'].max()), 'pair')}")
    return axes


def _ranks(source: Source) -> pd.DataFrame:
    """Return the mean ranks, best first: method, mean_rank, and the p-values against the best."""
    return figures.ranks_of(friedman(blocks_of(read_source(source).runs)))


@with_data(_ranks)
def ranks(source: Source, ax: Axes | None = None) -> Axes:
    """Draw the mean rank of each method over the problems; a bar joins those that no test tells apart (Demsar, 2006).

    Raises `ValueError` where there are fewer than three methods, or than ten problems on which all were run.
    """
    ranked = friedman(blocks_of(read_source(source).runs))
    figures.ranks_of(ranked)  # it raises where there is no test
    with axes_in(ax, *figures.ranks_size(ranked)) as axes:
        figures.draw_ranks(axes, ranked)
    return axes


def _heatmap(source: Source, *, problem: str | None = None) -> pd.DataFrame:
    """Return a row for each method and problem, best methods first: `bench.statistics.tables.overview`, and names."""
    return figures.field_of(read_source(source, problem).runs)


@with_data(_heatmap)
def heatmap(source: Source, ax: Axes | None = None, *, problem: str | None = None) -> Axes:
    """Draw a row for each method, best first, and a column for each problem; the colour is the place on that problem.

    In a cell stands how many runs reached the goal, where one is known.
    """
    table = _heatmap(source, problem=problem)
    order, columns = list(dict.fromkeys(table["label"])), figures.columns_of(table)
    width, height, inches = figures.field_size(order, columns, len(order))
    if ax is not None:  # how wide a column is there, beside the names of methods and the scale
        across = ax.get_position().width * figure_of(ax).get_figwidth()
        inches = 0.8 * across / len(columns)  # names stand outside, and the scale takes its part
        if figure_of(ax).get_layout_engine() is not None:  # a layout uses the margins too, and has all inside
            across /= 0.775
            inches = max(across - 0.8 - 0.054 * max(map(len, order)), 0.3 * across) / len(columns)
    with axes_in(ax, 0.9 + width, height, figures.FIELD_STYLE) as axes:
        image = figures.draw_field(axes, table, order, columns, len(order), inches)
        figures.put_scale(image, axes, len(order))
        axes.grid(visible=False)
        if ax is None:
            entitle(figure_of(axes), figures.field_title(table))
    return axes


def _finish(axes: Axes, given: Axes | None, title: str) -> None:
    """Put the legend into the axes that were given; of a figure of its own beside them, and a title over all."""
    if given is not None:
        explain_lines(given)
        return
    put_legend(figure_of(axes), [axes])
    entitle(figure_of(axes), title)
