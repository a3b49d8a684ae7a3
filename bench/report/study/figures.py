"""Figures from runs: convergence, evaluations to target, a field at a glance, runtime ECDF, profiles, mean ranks.

The critical-difference diagram has the mean ranks of methods on a line, those that no test tells apart joined by a bar:
Demsar, J. Machine Learning Research 7 (2006), figure 1.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibench.bench.report.shared.drawing import COLOURS, Drawing, entitle, figure_of, look_of, new_figure, put_legend
from calibench.bench.report.study.additions import Additions, Mark
from calibench.bench.report.study.explored import bands, traces_of
from calibench.bench.statistics import ranking, summary as stats, tables
from calibench.bench.statistics.cells import CELL, METHOD, PROBLEM, SETTING, TASK, by_cell, parted
from calibench.bench.statistics.fixed_target import Hits, ecdf, ert, performance_profile
from calibench.bench.statistics.names import in_order, method_labels, problem_titles, settings_that_vary
from calibench.bench.statistics.optimum import Optimum, optimum_of
from calibench.bench.statistics.ranking import FEWEST, LEVEL, LOOK, Ranked, blocks_of, friedman, looks_of
from calibench.bench.statistics.summary import endings, method_names
from calibench.bench.store.arrays import lists_of
from calibench.bench.store.columns import name_rows
from calibench.core.seeds import digest
from calibench.core.words import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

_FIELD = 12  # optimisers from which on a study is a field, and wants an overview
_SEEN = 1500  # cells up to which they have room in one drawing; of more the numbers are in ``overview.csv``
_LONGEST = 120  # bytes of a file's name, which some options would fill without end
_HUGE = 1e150  # where values beyond stand, as well as smaller ones than its inverse: margins must not leave the doubles
_LETTER = 0.06  # inches of a letter of a name
_OVER = 5  # dots at one place, which no more of them make darker
_NAMED = 12  # methods that get a colour; the others are a grey background
_QUANTITY = "gap"
_DIAGRAM_LETTER = 0.07  # inches of a letter of a name
_ECDF = ("run_id", *CELL, "charged", LOOK)  # columns that a drawing of shares needs: few are cheap to cut
UNUSED = [
    "best_x", "at_bound", "parameter_names", "parameter_values", "parameter_units", "parameter_starts",
    "parameter_truths", "hits", "error", "error_type", "traceback", "versions", "platform", "git_commit", "git_dirty",
    "code_digest", "library", "library_version", "seed",
]  # fmt: skip  # columns of which no problem says anything: thousands of slices, and digests, of them are dear
_LEAST_P = 1e-300  # p below it is rounding
_TICK = 0.25  # inches between two numbers of the scale, at least
FIELD_STYLE: Any = {"axes.grid": False}
_NOTE: Any = {"fontsize": 7, "color": "0.3"}
Drawable = Callable[[], Drawing]


def drawable(
    runs: pd.DataFrame, traces: pd.DataFrame, additions: Additions = (), problems: int | None = None,
    ranked: Ranked | None = None,
) -> Iterator[tuple[str, Drawable]]:  # fmt: skip
    """Yield (name, how it is drawn) of every figure that these results can fill, of the first `problems` at most."""
    panels = dict(islice(panels_of(runs.drop(columns=UNUSED, errors="ignore")).items(), problems))
    for (title, group), mine in zip(panels.items(), traces_of(traces, [*panels.values()]), strict=True):
        label = file_name(title)
        yield f"convergence_{label}", partial(convergence, group, mine, title=title)
        if lists_of(group["targets"]).count.all():
            marks = [mark for addition in additions for mark in addition.marks(group)]
            yield f"target_{label}", partial(target_chart, group, title=title, marks=marks)
    methods, tasks = (len(runs[columns].drop_duplicates()) for columns in (METHOD, PROBLEM))
    seen = len(runs[CELL].drop_duplicates()) <= _SEEN
    if seen and tasks > 1 and (methods > _FIELD or (methods > 1 and tasks > _FIELD)):  # one column is a table
        yield "overview", partial(overview, runs)
    ranked = ranked_over_tasks(runs) if ranked is None else ranked
    if ranked is not None and not ranked.refused:
        yield "critical_difference", partial(critical_difference, ranked)
    for added in (figure for addition in additions for figure in addition.figures if figure.applies(runs)):
        yield added.name, partial(added.draw, runs, traces)


def ranked_over_tasks(runs: pd.DataFrame) -> Ranked | None:
    """Return Friedman's test of the methods; None where there are too few of them, or too few tasks to ask."""
    if len(runs[METHOD].drop_duplicates()) < 3 or len(runs[TASK[:-1]].drop_duplicates()) < FEWEST:
        return None
    return friedman(blocks_of(runs))


def panels_of(runs: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return the runs by what shares a figure, by its title: a problem with all its options but the error function."""
    return parted(runs, problem_titles(runs, but=("error",)))


def convergence(runs: pd.DataFrame, traces: pd.DataFrame, title: str = "") -> Drawing:
    """Draw the best error over charged evaluations, median and quartiles, a panel for each error function."""
    errors = sorted(errors_of(runs).unique())
    runs = runs.assign(method=method_labels(runs))
    named = named_methods(runs)
    looks = looks_of(runs, named)
    numbers = []
    room = 1.0 + 0.068 * max(map(len, named))  # of the legend's widest name
    with new_figure(room + 3.4 * len(errors), 3.7) as figure:
        panels = np.atleast_1d(figure.subplots(1, len(errors), sharex=True))
        for axes, error in zip(panels, errors, strict=True):
            mine = runs[errors_of(runs) == error]
            drawn = convergence_bands(mine, traces)
            draw_convergence(axes, drawn, optimum_of(mine), named, looks)
            numbers.append(drawn.assign(error=error))
        put_legend(figure, panels)
        entitle(figure, f"{title}: {spread_text(runs)}" if title else "")
    return figure, pd.concat(numbers, ignore_index=True)


def named_methods(runs: pd.DataFrame) -> list[str]:
    """Return the methods (column `method`) that have a colour: all, or of a field the best, before a grey rest."""
    methods = list(runs["method"].unique())
    if len(methods) <= _FIELD:
        return methods
    cells = stats.summary(runs)
    called = runs.groupby(CELL, sort=False, dropna=False)["method"].first()  # in the order of `cells`; no target is NaN
    table = pd.DataFrame({"method": called.to_numpy(), "place": ranking.places(cells)})
    mean = table.groupby("method", sort=False)["place"].mean()  # over the panels
    return [str(method) for method in mean.sort_values(kind="stable").index[: _FIELD - 2]]


def convergence_bands(runs: pd.DataFrame, traces: pd.DataFrame) -> pd.DataFrame:
    """Return the band of each method (column `method`) on one problem: method, charged, q1, median, q3, runs."""
    known = optimum_of(runs)
    at = np.unique(np.round(np.geomspace(1, max(10.0, float(runs["charged"].max())), 240)))
    methods = list(runs["method"].unique())
    quartiles = bands(runs.assign(cell=runs["method"].map(methods.index)).reset_index(drop=True), traces, at)
    begun = set(traces["run_id"].unique())
    drawn = [pd.DataFrame(columns=["method", "charged", "q1", "median", "q3", "runs"])]
    for i, method in enumerate(methods):
        ids = runs.loc[runs["method"] == method, "run_id"]
        if not begun.isdisjoint(ids):
            begun_at = ~np.isnan(quartiles[i][1])  # NaN stands before a finite value
            low, middle, high = known.above(np.where(quartiles[i] == np.inf, np.nan, quartiles[i])[:, begun_at])
            band = {"method": method, "charged": at[begun_at], "q1": low, "median": middle, "q3": high}
            drawn.append(pd.DataFrame(band | {"runs": len(ids)}))
    return pd.concat(drawn[1:] or drawn, ignore_index=True)


def draw_convergence(
    axes: Any, drawn: pd.DataFrame, known: Optimum, named: Sequence[str], looks: Mapping[str, int]
) -> None:
    """Draw the bands of `convergence_bands`: those of the `named` methods in their looks, the others grey."""
    methods = list(dict.fromkeys(drawn["method"]))
    values = drawn[["q1", "median", "q3"]].clip(-_HUGE, _HUGE)
    drawn = drawn.assign(**values.mask((values > 0) & (values < 1 / _HUGE), 1 / _HUGE))
    below: list[NDArray[np.float64]] = []  # lower quartiles
    for method in sorted(methods, key=lambda m: m in named):
        band = drawn[drawn["method"] == method]
        if method not in named:
            label = counted(len(methods) - len(named), "other")
            axes.step(band["charged"], band["median"], where="post", color="0.75", lw=0.7, label=label)
            continue
        look = look_of(looks[method])
        below.append(band["q1"][band["median"].notna()].to_numpy(dtype=float))
        shade = {"color": look["color"], "alpha": 0.18, "linewidth": 0}
        axes.fill_between(band["charged"], band["q1"], band["q3"], step="post", **shade)
        axes.step(band["charged"], band["median"], where="post", label=method, **look)
    if known.floor:
        axes.axhline(known.floor, color="0.35", linestyle=":", linewidth=1)
        axes.annotate(
            known.floor_text, (0.02, known.floor), (0, 3), xycoords=("axes fraction", "data"),
            textcoords="offset points", **_NOTE,
        )  # fmt: skip
    lines = np.concatenate([line.get_ydata() for line in axes.get_lines()] or [np.ones(1)])
    seen = lines[np.isfinite(lines)]
    scale = known.scale(np.concatenate([lines, *below]))
    if not seen.size:  # nothing found a value
        axes.set_xlim(1, max([10.0, *drawn["charged"]]))
    axes.set(xscale="log", yscale=scale, xlabel="charged evaluations")
    if scale == "log" and not seen.all():  # zero has no place on such an axis: the line leaves at the bottom
        axes.set_ylim(bottom=seen[seen > 0].min() / 10)
        axes.annotate("a line that leaves here is at 0", (0.02, 0.02), xycoords="axes fraction", **_NOTE)
    axes.set_ylabel(known.axis)


def spread_text(runs: pd.DataFrame) -> str:
    """Return in words what a band shows: the runs of a cell, whether each has as many, or one alone."""
    counts = runs.groupby(CELL, dropna=False).size()
    fewest, most = int(counts.min()), int(counts.max())
    several = counted(most, "run") if fewest == most else f"{fewest} to {most} runs"
    return "one run each" if most == 1 else f"median and quartiles of {several}"


def target_chart(runs: pd.DataFrame, title: str = "", marks: Sequence[Mark] = ()) -> Drawing:
    """Draw what each method paid to the last target: a dot a run, a hollow triangle where it never got there, a panel
    an error function with `marks` as lines; the share that got there stands beside the name."""
    errors = sorted(errors_of(runs).unique())
    table = runs.assign(error=errors_of(runs), method=method_labels(runs), hit=stats.goal_hits(runs))
    table = table[["error", "method", "run_id", "hit", "charged", "status"]]
    room = 3.0 + 0.058 * int(table["method"].map(len).max())  # of a panel and its widest name
    size = (max(6.2, room * len(errors)), 1.5 + 0.26 * table["method"].nunique())
    with new_figure(*size) as figure:
        panels = np.atleast_1d(figure.subplots(1, len(errors), sharex=True))
        for axes, error in zip(panels, errors, strict=True):
            mine = table[table["error"] == error]
            order = mine.groupby("method").agg(
                reached=("hit", "count"), cost=("hit", "median"), spent=("charged", "median"), runs=("hit", "size")
            )
            order["share"] = order["reached"] / order["runs"]
            order = order.sort_values(["share", "cost", "spent"], ascending=[True, False, False])
            for y, (method, row) in enumerate(order.iterrows()):
                dots = mine[mine["method"] == method]
                hit, missed = dots["hit"].dropna(), dots.loc[dots["hit"].isna(), "charged"].clip(lower=1)
                hit, missed = (at[at.groupby(at).cumcount() < _OVER] for at in (hit, missed))
                axes.plot(hit, np.full(len(hit), y), "o", color=COLOURS[0], ms=5, alpha=0.6, mec="none")
                axes.plot(missed, np.full(len(missed), y), ">", mfc="none", mec=COLOURS[1], ms=5)
                if row["reached"]:
                    axes.plot([row["cost"]] * 2, [y - 0.33, y + 0.33], color="black", lw=1.4)
            labels = [f"{method}  {int(row['reached'])}/{int(row['runs'])}" for method, row in order.iterrows()]
            axes.set_yticks(range(len(labels)), labels, fontsize=7.5)
            of_error = runs[errors_of(runs) == error]
            level = optimum_of(of_error).level(list(of_error["targets"].iloc[0])[-1])
            axes.set(xscale="log", xlabel=f"charged evaluations to {level}", ylim=(-0.7, len(labels) - 0.3))
            for mark in marks:
                axes.axvline(mark.at, color="0.35", ls=":", lw=1)
        for axes in panels:
            axes.xaxis.set_minor_formatter("")
            low, high = axes.get_xlim()
            if high < 100 * low:  # label 1, 2, 5 of each decade where there are few, and never what lies between
                axes.xaxis.get_major_locator().set_params(subs=(1, 2, 5))
                axes.xaxis.set_major_formatter("{x:g}")
        panels[0].plot([], [], "o", color=COLOURS[0], label="reached (bar: median)")
        panels[0].plot([], [], ">", mfc="none", mec=COLOURS[1], label="never, spent so much")
        for mark in marks:
            panels[0].plot([], [], color="0.35", ls=":", lw=1, label=mark.label)
        figure.legend(loc="outside lower center", ncols=3, fontsize=8)
        entitle(figure, title)
    return figure, table.drop(columns="run_id")


def overview(runs: pd.DataFrame) -> Drawing:
    """Draw a field at a glance: a row a method, best first, a column a problem, colour for the place, runs at the goal.
    "stops": may end by its own test with budget left; "restarts": begins again there."""
    table = field_of(runs)
    order, columns = list(dict.fromkeys(table["label"])), columns_of(table)
    halves = 1 if len(order) <= 40 or len(columns) > _FIELD else 2
    rows = -(-len(order) // halves)
    width, height, inches = field_size(order, columns, rows)
    with new_figure(0.9 + halves * width, height, FIELD_STYLE) as figure:
        panels = np.atleast_1d(figure.subplots(1, halves))
        for i, axes in enumerate(panels):
            mine = order[i * rows : (i + 1) * rows]
            image = draw_field(axes, table, mine, columns, rows, inches)
        put_scale(image, panels, rows)
        entitle(figure, field_title(table))
    return figure, table


def field_of(runs: pd.DataFrame) -> pd.DataFrame:
    """Return `tables.overview` of these runs, and of what is drawn of it: method, ends, column, and label, its row."""
    table = tables.overview(runs)
    named = table.rename(columns={"options": "optimizer_options"})
    ends, spoken = endings(named), {"": "", "stops": " · stops", "restarts": " · restarts"}
    method = method_labels(named)
    plain = method.str.replace(r" \(restarts=True\)|restarts=True, |, restarts=True", "", regex=True)
    # for each row the problem it is on, its error function last
    titles = problem_titles(named, but=("error",))
    columns = [f"{t} {e}".strip() for t, e in zip(titles, named["error"], strict=True)]
    column = pd.Series(columns, index=named.index)
    return table.assign(method=method, ends=ends, column=column, label=plain + ends.map(spoken))


def columns_of(table: pd.DataFrame) -> list[str]:
    """Return the columns of a drawing of `field_of`, those of few parameters first."""
    dimension = dict(zip(table["column"], table["dimension"], strict=True))
    return sorted(dict.fromkeys(table["column"]), key=lambda column: (int(dimension[column]), in_order(column)))


def field_title(table: pd.DataFrame) -> str:
    """Return what is drawn of `field_of`, in words."""
    known = "runs at the goal" if table["goal"].notna().any() else "no goal is known"
    low, high = int(table["budget"].min()), int(table["budget"].max())
    budgets = f"{low}" if low == high else f"{low} to {high}"
    return f"{counted(table['method'].nunique(), 'method')}, {budgets} evaluations: {known}"


def _is_upright(columns: Sequence[str], inches: float) -> bool:
    return _LETTER * max(len(word) for name in columns for word in name.split()) > inches


def field_size(order: Sequence[str], columns: Sequence[str], rows: int) -> tuple[float, float, float]:
    """Return width and height of a panel of `rows` methods, and the width of a column [inches]."""
    wide = 0.36 if len(columns) > _FIELD or _is_upright(columns, 0.85) else 0.85
    tall = _LETTER * max(map(len, columns)) if _is_upright(columns, wide) else 0.0
    beside = max(2.1, 0.3 + 0.054 * max(map(len, order)))  # names of methods
    return beside + wide * len(columns), 1.4 + max(0.185 * rows, 1.2) + tall, wide


def draw_field(
    axes: Axes, table: pd.DataFrame, labels: Sequence[str], columns: Sequence[str], rows: int, inches: float
) -> AxesImage:
    """Draw a row for each of the `labels` of `field_of`, in the height of `rows`; return the image of the places."""
    cells = {(row["label"], row["column"]): row for row in table.to_dict("records")}
    most = table.groupby("column")["place"].max()
    grid = np.full((rows, len(columns)), np.nan)
    for y, name in enumerate(labels):
        for x, column in enumerate(columns):
            cell = cells.get((name, column))
            if cell is None:
                axes.text(x, y, "–", ha="center", va="center", fontsize=6.5, color="0.5")
                continue
            grid[y, x] = (cell["place"] - 1) / max(most[column] - 1, 1)
            shade = "white" if grid[y, x] < 0.45 else "black"
            goal = f"{cell['reached']}/{cell['runs']}" if cell["goal"] == cell["goal"] else ""
            words = "failed" if cell["failed"] == cell["runs"] else goal
            size = min(6.5, 72 * inches / (0.6 * max(len(words), 1)))
            axes.text(x, y, words, ha="center", va="center", fontsize=size, color=shade)
    image = axes.imshow(grid, aspect="auto", cmap="cividis", vmin=0, vmax=1)
    axes.set_yticks(range(len(labels)), labels, fontsize=7)
    upright = _is_upright(columns, inches)
    titles = columns if upright else [column.replace(" ", "\n") for column in columns]
    axes.set_xticks(range(len(columns)), titles, fontsize=7, rotation=90 if upright else 0)
    axes.tick_params(length=0, top=False, labeltop=True, bottom=False, labelbottom=False)
    axes.set_ylim(rows - 0.5, -0.5)
    axes.spines[:].set_visible(False)
    return image


def put_scale(image: AxesImage, panels: Any, rows: int) -> None:
    """Put the scale of colours of `draw_field` beside its panels."""
    bar = figure_of(image.axes).colorbar(image, ax=panels, shrink=0.8 if rows < 12 else 0.4, aspect=30)
    bar.set_label("place on the problem", fontsize=8)
    bar.set_ticks([0, 1], labels=["first", "last"], fontsize=8)
    bar.ax.invert_yaxis()


def errors_of(runs: pd.DataFrame) -> pd.Series:
    """Return the error function of each run's problem; '' where it has no choice of them."""
    column = "problem_options"
    return name_rows(runs, [column], lambda rows: [str(json.loads(text).get("error", "")) for (text,) in rows])


def file_name(title: str) -> str:
    """Return what the files of a figure of this title end in."""
    text = title.replace("=", "").replace(" ", "_")
    plain = "".join(c if c.isalnum() or c in "._-" else "-" for c in text)
    short = plain.encode()[:_LONGEST].decode(errors="ignore")  # no half of a character
    return plain if short == plain else f"{short}-{digest(title)[:6]}"


def ecdf_figures(runs: pd.DataFrame, hits: Hits, groups: pd.Series) -> Iterator[tuple[str, str, Drawable]]:
    """Yield (name, caption, how it is drawn) of the whole study and of each of several `groups`, by index of `runs`."""
    targets = hits.of_quantity(_QUANTITY)
    if not targets.blocks:
        return
    runs = runs[[name for name in _ECDF if name in runs]]
    total = len(runs[PROBLEM].drop_duplicates())
    yield "ecdf", f"Runtime ECDF, {counted(total, 'problem')}", partial(runtime_ecdf, runs, targets, "All problems")
    parts = parted(runs, groups)
    if not 1 < len(parts) < total:
        return
    for name, mine in parts.items():
        some = targets.of_runs(mine["run_id"])
        if not some.blocks:  # such as a group all of whose runs failed
            continue
        title = f"Group {name}"
        caption = f"Runtime ECDF, {title}, {counted(len(mine[PROBLEM].drop_duplicates()), 'problem')}"
        yield f"ecdf_{file_name(name) or digest(name)[:6]}", caption, partial(runtime_ecdf, mine, some, title)


def runtime_ecdf(runs: pd.DataFrame, hits: Hits, title: str = "") -> Drawing:
    """Draw the share of (run, target) pairs that each method reached, over charged evaluations."""
    numbers = ecdf_of(runs, hits)
    with new_figure(share_width(numbers), 3.7) as figure:
        axes = figure.subplots()
        first = runs.iloc[by_cell(runs).first]
        draw_shares(axes, numbers, first.assign(method=method_labels(first)), "cost")
        put_legend(figure, [axes])
        count = len({level for block in hits.blocks for level in block.level.tolist()})
        entitle(figure, f"{title}: {counted(count, 'target')} above the best value" if title else "")
    return figure, numbers


def ecdf_of(runs: pd.DataFrame, hits: Hits | pd.DataFrame) -> pd.DataFrame:
    """Return `runtime.ecdf` of hits of one quantity, with the name of each row's method (`method_labels`)."""
    cells = by_cell(runs)
    first = runs.iloc[cells.first].reset_index(drop=True)
    for _, mine in first.groupby(METHOD, sort=False):  # a method whose start each problem decides is one
        for column in {*SETTING} - {*settings_that_vary(mine)}:
            first.loc[mine.index, column] = mine[column].iloc[0]
    settings = first[SETTING].take(cells.number).set_axis(runs.index)
    numbers = ecdf(hits, runs.assign(**{str(column): settings[column] for column in settings}))
    called = first[[*METHOD, *SETTING]].assign(method=method_labels(first)).drop_duplicates()
    called = called.rename(columns={"target": "target_value"})
    numbers = numbers.merge(called, on=[*METHOD, "start", "budget", "target_value"], how="left")
    return numbers.assign(share=np.asarray(numbers["share"], dtype=float))


def profile_of(runs: pd.DataFrame, hits: pd.DataFrame) -> pd.DataFrame:
    """Return `performance_profile` of hits of one quantity, with the name of each row's method."""
    steps = performance_profile(ert(hits, runs, intervals=False))
    called = dict(zip(zip(*(runs[key] for key in METHOD)), method_names(runs)))
    return steps.assign(method=[called[pair] for pair in zip(*(steps[key] for key in METHOD))])


def share_width(numbers: pd.DataFrame) -> float:
    """Return the width of a figure of these methods' shares with their names beside it [inches]."""
    return 4.4 + 0.068 * max(map(len, numbers["method"]), default=0)


def draw_shares(axes: Axes, numbers: pd.DataFrame, runs: pd.DataFrame, over: Literal["cost", "ratio"]) -> None:
    """Draw the share of each method (column `method` of `runs`) as steps over the cost (`ecdf_of`), or over the ratio
    (`profile_of`), the best in colour and in order: by the share at the end, then by who has half of it first."""
    ends = numbers.groupby("method", sort=False)["share"].max()
    half = numbers[numbers["share"] >= numbers["method"].map(ends) / 2].groupby("method", sort=False)[over].min()
    best_first = pd.DataFrame({"share": -ends, "half": half}).sort_values(["share", "half"], kind="stable")
    order = [str(method) for method in best_first.index]
    looks = looks_of(runs, order)
    most = float(numbers[over][np.isfinite(numbers[over])].max())  # where all lines end
    for i, method in enumerate(order):
        mine, named = numbers[(numbers["method"] == method) & np.isfinite(numbers[over])], i < _NAMED
        look = look_of(looks[method]) if named else {"color": "0.8", "lw": 0.7}
        label = method if named else counted(len(order) - _NAMED, "other") if i == _NAMED else None
        at, share = [1.0, *mine[over], most], [0.0, *mine["share"], mine["share"].max() if len(mine) else 0.0]
        axes.step(at, share, where="post", label=label, zorder=2.5 - 0.001 * i, **look)
    axes.set(xscale="log", ylim=(0, 1.02))
    if over == "ratio":
        axes.set_xlim(left=1)
    pairs, what, across = {
        "cost": ("(run, target)", "problem", "charged evaluations"),
        "ratio": ("(problem, target)", "task", "expected running time over the least of any method"),
    }[over]
    parts, whole = numbers[f"{what}s"], numbers[f"of_{what}s"]
    of_which = ""  # where all methods were run on all
    if parts.nunique() == 1 and (parts != whole).any():
        of_which = f"\non the {parts.iloc[0]} of {counted(int(whole.iloc[0]), what)} that all methods were run on"
    elif (parts != whole).any():
        of_which = f"\nof each method on its own {what}s: none has all methods"
    axes.set(xlabel=across, ylabel=f"share of {pairs} pairs{of_which}")


def critical_difference(ranked: Ranked) -> Drawing:
    """Return the diagram of `ranked` and its numbers; raises `ValueError` where there is no test (`ranked.refused`)."""
    numbers = ranks_of(ranked)
    with new_figure(*ranks_size(ranked)) as figure:
        draw_ranks(figure.add_subplot(), ranked)
    return figure, numbers


def ranks_size(ranked: Ranked) -> tuple[float, float]:
    """Return width and height of the diagram [inches]."""
    return 3.6 + sum(_beside(ranked)), 1.1 + 0.24 * len(ranked.methods) + 0.12 * len(ranked.groups())


def _beside(ranked: Ranked) -> tuple[float, float]:
    """Return the room for the names at the left and at the right [inches]."""
    half = (len(ranked.methods) + 1) // 2
    left, right = (max(map(len, names), default=0) for names in (ranked.methods[:half], ranked.methods[half:]))
    return _DIAGRAM_LETTER * (left + 8), _DIAGRAM_LETTER * (right + 8)


def draw_ranks(axes: Axes, ranked: Ranked) -> None:
    """Draw the diagram, the names of the methods within the axes: what stands beside them is left alone."""
    count = len(ranked.methods)
    bars = ranked.groups()
    low, high = np.floor(ranked.mean_ranks.min()), np.ceil(ranked.mean_ranks.max())
    span = max(high - low, 1.0)
    inches = axes.get_position().width * figure_of(axes).get_figwidth()
    least, most = _beside(ranked)
    scale = max(inches - least - most, 0.25 * inches)
    size = 8 * min(1.0, (inches - scale) / (least + most))  # of names, which in narrow axes are smaller
    least, most = least * size / 8, most * size / 8
    inch = 1.12 * span / scale  # the lines to the names take 6 % on either side
    for i, (name, rank) in enumerate(zip(ranked.methods, ranked.mean_ranks.tolist(), strict=True)):
        left = i < (count + 1) // 2
        depth = -1.0 - 0.12 * len(bars) * 4 - (i if left else count - 1 - i)
        edge = low - 0.06 * span if left else high + 0.06 * span
        axes.plot([rank, rank, edge], [0, depth, depth], color=COLOURS[6], linewidth=0.8)
        axes.text(edge, depth, f" {name}  {rank:.2f} ", ha="right" if left else "left", va="center", fontsize=size)
    for i, (first, last) in enumerate(bars):
        ends = [ranked.mean_ranks[first] - 0.01 * span, ranked.mean_ranks[last] + 0.01 * span]
        axes.plot(ends, [-0.5 - 0.45 * i] * 2, color=COLOURS[0], linewidth=3, solid_capstyle="butt")
    axes.plot([low, low + ranked.critical_difference], [1.1, 1.1], color=COLOURS[1], linewidth=2)
    axes.text(low, 1.3, f"critical difference {ranked.critical_difference:.2f}", fontsize=8, va="bottom")
    axes.set_ylim(-1.6 - 0.48 * len(bars) - (count + 1) // 2, 2.2)
    axes.set_xlim(low - 0.06 * span - least * inch, high + 0.06 * span + most * inch)
    axes.set_yticks([])
    axes.set_xticks(np.arange(low, high + 1, max(1, np.ceil(span / min(12, scale / _TICK)))))
    axes.spines[["left", "right", "bottom"]].set_visible(False)
    axes.spines["top"].set_visible(True)
    axes.spines["top"].set_position(("data", 0.0))
    axes.spines["top"].set_bounds(low, high)
    axes.xaxis.tick_top()
    axes.grid(False)
    chance = f"= {ranked.p:.2g}" if ranked.p > _LEAST_P else f"< {_LEAST_P:g}"
    title = f"mean rank over {ranked.blocks} blocks, 1 is best; Friedman p {chance}"
    axes.set_title(f"{title}\njoined: not told apart at {LEVEL:g} (Nemenyi)", fontsize=8)


def ranks_of(ranked: Ranked) -> pd.DataFrame:
    """Return the numbers of the diagram; raises `ValueError` where there is no test."""
    if ranked.refused:
        raise ValueError(ranked.refused)
    return pd.DataFrame(
        {
            "method": ranked.methods, "mean_rank": ranked.mean_ranks, "p_against_best_holm": ranked.against_best,
            "p_against_best_nemenyi": ranked.nemenyi[0], "blocks": ranked.blocks,
            "critical_difference": ranked.critical_difference, "friedman_p": ranked.p,
        }
    )  # fmt: skip
