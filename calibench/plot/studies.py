"""Drawings of runs: convergence, runtime ECDF, performance profile, mean ranks, and every method on every problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import pandas as pd
import pyarrow as pa
from matplotlib.axes import Axes

from calibench.bench.execution.run import Run
from calibench.bench.report.shared.drawing import axes_in, entitle, explain_lines, figure_of, put_legend
from calibench.bench.report.study import figures, runtime_figure
from calibench.bench.report.study.critical_difference import draw_ranks, ranks_of, ranks_size
from calibench.bench.statistics.comparison.many_methods import blocks_of, friedman
from calibench.bench.statistics.names.labels import method_labels, problem_titles
from calibench.bench.statistics.names.order import looks_of
from calibench.bench.statistics.optimum import optimum_of
from calibench.bench.statistics.targets import levels_of
from calibench.bench.store.hits import columns_for, hit_tables
from calibench.bench.store.runs import FOLDER_OF, ResultStore
from calibench.bench.store.schema import HITS_SCHEMA, RUNS_SCHEMA, TRACES_SCHEMA, to_pandas
from calibench.core.counted import counted
from calibench.core.options import suggest
from calibench.plot.numbers import with_data
from calibench.problems.suites.gaps import COCO_GAPS

Source = ResultStore | str | Path | pd.DataFrame | Run | Sequence[Run]


def _convergence(source: Source, *, problem: str | None = None, traces: pd.DataFrame | None = None) -> pd.DataFrame:
    """Return the bands of each method on each problem: problem, method, charged, q1, median, q3, runs."""
    found = _read(source, problem, traces)
    titles = problem_titles(found.runs)
    named = found.runs.assign(method=method_labels(found.runs))
    drawn = [
        figures.convergence_bands(mine, found.traces()).assign(problem=title)
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
    found = _read(source, problem, traces)
    titles = problem_titles(found.runs)
    if titles.nunique() > 1:
        raise ValueError(f"convergence draws one problem, and there are {titles.nunique()}: {_choice(titles, '')}")
    runs = found.runs.assign(method=method_labels(found.runs))
    named = figures.named_methods(runs)
    drawn = figures.convergence_bands(runs, found.traces())
    with axes_in(ax, 4.4 + 0.068 * max(map(len, named)), 3.7) as axes:
        figures.draw_convergence(axes, drawn, optimum_of(runs), named, looks_of(runs, named))
        _finish(axes, ax, f"{titles.iloc[0]}: {figures.spread_told(runs)}")
    return axes


def _ecdf(source: Source, *, problem: str | None = None, traces: pd.DataFrame | None = None) -> pd.DataFrame:
    """Return the runtime ECDF: the columns of `bench.statistics.runtime.ecdf`, and method."""
    found = _read(source, problem, traces)
    return runtime_figure.ecdf_of(found.runs, found.hits())


@with_data(_ecdf)
def ecdf(
    source: Source, ax: Axes | None = None, *, problem: str | None = None, traces: pd.DataFrame | None = None
) -> Axes:
    """Draw the share of (run, target) pairs that each method reached within a number of charged evaluations.

    Of all problems together, each counts the same, or of one `problem`. Targets are COCO's 51 above the best value.
    """
    found = _read(source, problem, traces)
    hits = found.hits()
    numbers = runtime_figure.ecdf_of(found.runs, hits)
    with axes_in(ax, runtime_figure.share_width(numbers), 3.7) as axes:
        runtime_figure.draw_ecdf(axes, numbers, found.runs)
        _finish(axes, ax, f"{found.told()}: {counted(hits['target'].nunique(), 'target')} above the best value")
    return axes


def _profile(source: Source, *, problem: str | None = None, traces: pd.DataFrame | None = None) -> pd.DataFrame:
    """Return the steps of the performance profile: method, optimizer, optimizer_options, ratio, share, tasks."""
    found = _read(source, problem, traces)
    return runtime_figure.profile_of(found.runs, found.hits())


@with_data(_profile)
def profile(
    source: Source, ax: Axes | None = None, *, problem: str | None = None, traces: pd.DataFrame | None = None
) -> Axes:
    """Draw the share of (problem, target) pairs that a method reaches within so many times the best method's cost.

    The performance profile of Dolan and More (2002), of expected running times (ERT) to the targets of `ecdf`.
    """
    found = _read(source, problem, traces)
    numbers = runtime_figure.profile_of(found.runs, found.hits())
    with axes_in(ax, runtime_figure.share_width(numbers), 3.7) as axes:
        runtime_figure.draw_profile(axes, numbers, found.runs)
        _finish(axes, ax, f"{found.told()}: {counted(int(numbers['tasks'].max()), 'pair')}")
    return axes


def _ranks(source: Source) -> pd.DataFrame:
    """Return the mean ranks, best first: method, mean_rank, and the p-values against the best."""
    return ranks_of(friedman(blocks_of(_read(source).runs)))


@with_data(_ranks)
def ranks(source: Source, ax: Axes | None = None) -> Axes:
    """Draw the mean rank of each method over the problems; a bar joins those that no test tells apart (Demsar, 2006).

    Raises `ValueError` where there are fewer than three methods, or than ten problems on which all were run.
    """
    ranked = friedman(blocks_of(_read(source).runs))
    ranks_of(ranked)  # it raises where there is no test
    with axes_in(ax, *ranks_size(ranked)) as axes:
        draw_ranks(axes, ranked)
    return axes


def _heatmap(source: Source, *, problem: str | None = None) -> pd.DataFrame:
    """Return a row for each method and problem, best methods first: `bench.statistics.tables.overview`, and names."""
    return figures.field_of(_read(source, problem).runs)


@with_data(_heatmap)
def heatmap(source: Source, ax: Axes | None = None, *, problem: str | None = None) -> Axes:
    """Draw a row for each method, best first, and a column for each problem; the colour is the place on that problem.

    In a cell stands how many runs reached the goal, where one is known.
    """
    table = figures.field_of(_read(source, problem).runs)
    order, columns = list(dict.fromkeys(table["method"])), figures.columns_of(table)
    width, height = figures.field_size(order, columns, len(order))
    with axes_in(ax, 0.9 + width, height, figures.FIELD_STYLE) as axes:
        image = figures.draw_field(axes, table, order, columns, len(order))
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


@final
@dataclass(frozen=True)
class _Runs:
    """The runs to draw, and where their traces are: a store, or a table."""

    runs: pd.DataFrame
    of: ResultStore | pd.DataFrame | None

    def traces(self) -> pd.DataFrame:
        if self.of is None:
            raise ValueError(
                "traces: this table of runs does not know its folder; give traces=store.traces(), or the store itself"
            )
        return self.of if isinstance(self.of, pd.DataFrame) else self.of.traces()

    def hits(self) -> pd.DataFrame:
        """Return when each run reached each target above the best value known."""
        traces = self.traces()
        levels = levels_of(self.runs, {"gap": COCO_GAPS})
        if levels.empty:
            raise ValueError("no run found a value inside the box: there is no best value to set targets above")
        names = columns_for(["gap"])
        place = {run_id: i for i, run_id in enumerate(self.runs["run_id"])}
        mine = traces[traces["run_id"].isin(place)]
        mine = mine.iloc[mine["run_id"].map(place).argsort(kind="stable")]
        rows = _arrow(self.runs, pa.schema([RUNS_SCHEMA.field(name) for name in names]))
        found = list(hit_tables(rows, [_arrow(mine, TRACES_SCHEMA)], levels))
        return to_pandas(pa.concat_tables([HITS_SCHEMA.empty_table(), *found]))

    def told(self) -> str:
        titles = problem_titles(self.runs).unique()
        return str(titles[0]) if len(titles) == 1 else counted(len(titles), "problem")


def _arrow(table: pd.DataFrame, schema: pa.Schema) -> pa.Table:
    whole = pa.Table.from_pandas(table[schema.names], schema, preserve_index=False)
    return whole.replace_schema_metadata(None)  # that of pandas names types which it cannot read back


def _read(source: Source, problem: str | None = None, traces: pd.DataFrame | None = None) -> _Runs:
    """Return the runs of `source`, or those on `problem`. Raises `ValueError` where there are none."""
    if isinstance(source, str | Path):
        source = ResultStore(source)
    found: pd.DataFrame
    of: ResultStore | pd.DataFrame | None
    if isinstance(source, ResultStore):
        found, of = source.runs(), source
    elif isinstance(source, pd.DataFrame):
        missing = [name for name in RUNS_SCHEMA.names if name not in source]
        if missing:
            raise ValueError(f"this is no table of runs: it has no column {missing[0]!r}; store.runs() returns one")
        found, of = source, ResultStore(source.attrs[FOLDER_OF]) if FOLDER_OF in source.attrs else None
    else:
        several = [source] if isinstance(source, Run) else list(source)
        wrong = next((one for one in several if not isinstance(one, Run)), None)
        if wrong is not None:
            raise TypeError(f"a store, its path, a table of runs or runs are needed, not {type(wrong).__name__}")
        found = to_pandas(pa.Table.from_pylist([one.row | {"study": ""} for one in several], RUNS_SCHEMA))
        of = pd.concat([one.trace.assign(run_id=one.run_id) for one in several]) if several else None
    if found.empty:
        raise ValueError(
            f"{source.folder if isinstance(source, ResultStore) else 'the table'}: there is no run to draw"
        )
    found = found.reset_index(drop=True)
    if problem is not None:
        titles = problem_titles(found)
        names = found["problem"]  # of a class of the user's own also without its file
        mine = (titles == problem) | (names == problem) | (names.str.rpartition(":")[2] == problem)
        if not mine.any():
            raise ValueError(f"problem={problem!r}: there is none; {_choice(titles, problem)}")
        found = found[mine].reset_index(drop=True)
    return _Runs(found, of if traces is None else traces)


def _choice(titles: pd.Series, name: str) -> str:
    return f"problem= takes one of them; {suggest(name, dict.fromkeys(titles))}"
