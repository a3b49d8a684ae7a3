"""What Cong et al. 2008 adds to a report: Tables 2 to 7 beside ours, Figs 3 to 5, the gauge curve, and the plans.

Figs 3, 4 and 5 are drawn as they are printed: log10 of J over evaluations, of GA, PSO and DE. The curves of the print
cannot be read from its text; what the text and Table 6 say of them, where each ends, can. That is a dotted line in the
method's colour. One panel is of the runs at hand, the other of the kept run at the paper's own budget
(``results/reference/``), where there is one and the runs at hand are shorter.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibench import problems
from calibench.bench.papers.cong2008.tables import TABLES, runs_of
from calibench.bench.papers.files import kept
from calibench.bench.papers.row import Evidence
from calibench.bench.report.shared.drawing import COLOURS, DASHES, STYLE, Drawing, entitle, look_of, put_legend, save
from calibench.bench.report.study.additions import AddedFigure, Addition, Mark, PrintedTable, TableSection
from calibench.bench.report.study.figures import convergence_bands, spread_text
from calibench.bench.statistics.names import options_seen
from calibench.bench.statistics.summary import problem_name
from calibench.bench.store.runs import ResultStore
from calibench.problems import constants

_PLANS = (("line", 80.0), ("circle", 80.0), ("two_circles", 120.0), ("disc", 100.0))


def gauge() -> Drawing:
    """Draw Table 4's and Table 7's printed 12-parameter results on the gauge curve through the true machine.

    Each line is how far a parameter moves when the machine is turned by phi and scaled so that no reading changes.
    """
    points = gauge_points()
    with rc_context(STYLE):
        figure = Figure(figsize=(10.2, 4.9), layout="constrained")
        for axes, (key, table) in zip(figure.subplots(1, 2), points.groupby("table", sort=False), strict=True):
            _gauge_curves(axes, str(key), table)
        figure.suptitle(
            "The 12-parameter results of Cong et al. 2008 are points of a curve along which no reading changes",
            fontsize=10,
        )
    return figure, points


def _gauge_curves(axes: Any, key: str, table: pd.DataFrame) -> None:
    held = str(table["held"].iloc[0])
    problem = problems.full12(gauge=held)
    fitted = float(table["phi"].iloc[0])
    phi = np.linspace(-0.15 * fitted, 1.25 * fitted, 200)
    names = [p.name for p in problem.parameters]
    moved = np.array([problem.gauge_curve(angle) for angle in phi]) - problem.gauge_curve(0.0)
    true = dict(zip(names, problem.gauge_curve(0.0), strict=True))
    groups = {name: [name] for name in names if name[0] in "xy"}
    groups |= {"six link lengths": [n for n in names if n[0] == "l"]}
    groups |= {"offsets z x 244 mm": [n for n in names if n[0] == "z"]}
    for i, (label, members) in enumerate(groups.items()):
        colour = COLOURS[i]
        columns = [names.index(n) for n in members]
        arm = 244.0 if members[0].startswith("z") else 1.0
        axes.plot(
            1e3 * phi, arm * moved[:, columns].mean(axis=1), color=colour, linestyle=DASHES[i], lw=1.4, label=label
        )
        for _, row in table[table["parameter"].isin(members)].iterrows():
            axes.plot(
                1e3 * fitted, arm * (row["printed"] - true[row["parameter"]]), marker="x" if row["misprint"] else "o",
                ms=6, mfc=colour, mec="#C00000" if row["misprint"] else "white", mew=1.2 if row["misprint"] else 0.8,
            )  # fmt: skip
    sound = table[~table["misprint"] & ~table["parameter"].str.startswith("z")]
    axes.axvline(0, color="0.35", lw=0.8)
    axes.annotate("truth", (0, 0), (3, 4), xycoords=("data", "axes fraction"), textcoords="offset points", fontsize=8)
    number = key.partition(".")[0].removeprefix("table")
    where = {"ya2": "section 3, y_a2 held", "xa2": "section 4, x_a2 held"}[held]
    axes.set(xlabel="gauge angle phi [mrad]", ylabel="parameter minus truth [mm]")
    axes.set_title(
        f"Table {number} ({where}): phi = {1e3 * fitted:.4g} mrad, scale {table['scale'].iloc[0]:.6f}\n"
        f"{len(sound)} lengths printed right lie within {sound['misfit_mm'].abs().max():.1g} mm of the curve",
        fontsize=9,
    )
    axes.plot([], [], "o", color="0.4", label="printed")
    axes.plot([], [], "x", color="#C00000", label="printed wrong (errata)")
    axes.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=3)


def plans(noise: float = 1e-4) -> Drawing:
    """Draw the singular values of `full11` for readings on a line, a circle, two circles and a disc (section 4.5).

    50 configurations each; the standard errors in the legend are the worst of a length at `noise` [rad a reading].
    """
    numbers = []
    with rc_context(STYLE):
        figure = Figure(figsize=(7.6, 3.9), layout="constrained")
        axes = figure.subplots()
        for i, (plan, radius) in enumerate(_PLANS):
            known = problems.identify(problems.make("full11", plan=plan, radius=radius), noise=noise)
            lengths = [float(e) for e, unit in zip(known.standard_errors, known.units, strict=True) if unit == "mm"]
            values = known.singular_values / known.singular_values[0]
            label = (
                f"{plan.replace('_', ' ')} R{radius:g}: condition {known.condition:.1e}, worst {max(lengths):.2g} mm"
            )
            axes.plot(
                range(1, len(values) + 1), values, marker="o", ms=4, color=COLOURS[i], linestyle=DASHES[i], label=label
            )
            numbers.append(
                pd.DataFrame(
                    {
                        "plan": plan, "radius": radius, "index": range(1, len(values) + 1), "singular_value": values,
                        "condition": known.condition, "worst_length_error_mm": max(lengths), "noise_rad": noise,
                    }
                )
            )  # fmt: skip
        axes.set(
            yscale="log", xlabel="singular value", ylabel="relative to the largest", xticks=range(1, 12),
            title="What 50 readings can tell of 11 parameters: on a circle rather than a line, but not on one circle",
        )  # fmt: skip
        axes.title.set_fontsize(10)
        axes.legend(
            fontsize=8, loc="lower left", alignment="left",
            title=f"condition, and worst standard error of a length at {noise:g} rad",
        )  # fmt: skip
    return figure, pd.concat(numbers, ignore_index=True)


def gauge_points() -> pd.DataFrame:
    """Return the printed 12-parameter columns of Tables 4 and 7 on their gauge curve, a row for each parameter.

    phi is fitted over the cells that are printed right; columns: table, held, phi, scale, parameter, printed, read,
    curve, misfit_mm (angles times a link length), misprint.
    """
    from scipy.optimize import least_squares

    rows = []
    cases = (("table4.j3_12", problems.full12(gauge="ya2")), ("table7.de_j3", problems.full12(gauge="xa2")))
    for key, problem in cases:
        column = constants.column("cong2008", key)
        names = [p.name for p in problem.parameters]
        arms = np.array([244.0 if p.unit == "rad" else 1.0 for p in problem.parameters])
        read = np.array([column[name] for name in names])
        sound = np.array([not column.entries[name].is_misprint for name in names])
        fit = sound & np.array([p.unit == "mm" for p in problem.parameters])  # angles are printed to 1e-4 only
        curve = problem.gauge_curve

        def misfit(phi: Any, curve: Any = curve, read: Any = read, fit: Any = fit) -> Any:
            return (curve(float(phi[0])) - read)[fit]

        phi = float(least_squares(misfit, [0.0], method="lm", xtol=1e-15, ftol=1e-15).x[0])
        on_curve = curve(phi)
        scale = float(on_curve[names.index("lb1")] / curve(0.0)[names.index("lb1")])
        for i, name in enumerate(names):
            entry = column.entries[name]
            rows.append(
                {
                    "table": key, "held": problem.options["gauge"], "phi": phi, "scale": scale, "parameter": name,
                    "printed": entry.printed, "read": entry.value, "curve": float(on_curve[i]),
                    "misfit_mm": float((read[i] - on_curve[i]) * arms[i]), "misprint": entry.is_misprint,
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


FIGURES = {"cong2008_fig3": "J1", "cong2008_fig4": "J2", "cong2008_fig5": "J3"}
_STUDY = "cong2008"
_METHODS = ("ga", "pso", "de")


def caption(error: str) -> str:
    """Return the caption of the figure of an error function."""
    number = {"J1": 3, "J2": 4, "J3": 5}[error]
    return f"Fig. {number} of Cong et al. 2008, axes as printed: GA, PSO and DE under {error}; dotted, the printed ends"


def applies(error: str, runs: pd.DataFrame) -> bool:
    """Tell whether these are runs of the figure: of its problem, each method in one setting and to one budget."""
    mine = _of(error, runs)
    settings = mine.groupby("optimizer")["optimizer_options"].nunique()
    return len(settings) == len(_METHODS) and settings.max() == 1 and mine["budget"].nunique() == 1


def draw(error: str, runs: pd.DataFrame, traces: pd.DataFrame) -> Drawing:
    """Draw the figure of an error function, beside it at the paper's budget."""
    panels = [(_of(error, runs), traces)]
    store = kept(_STUDY)
    if store is not None:
        longer = _of(error, ResultStore(store).runs())
        if len(longer) and longer["budget"].max() > panels[0][0]["budget"].max():
            panels.append((longer, ResultStore(store).traces()))
    printed = {method: constants.column("cong2008", f"table6.{method}").entries[error.lower()] for method in _METHODS}
    numbers = []
    with rc_context(STYLE):
        figure = Figure(figsize=(1.9 + 4.0 * len(panels), 3.9), layout="constrained")
        both = list(np.atleast_1d(figure.subplots(1, len(panels), sharey=True)))
        for axes, (mine, points) in zip(both, panels, strict=True):
            numbers.append(_draw_panel(axes, mine, points))
            for i, (method, end) in enumerate(printed.items()):
                label = f"{method.upper()}, printed end {end.printed:g}"
                axes.axhline(np.log10(end.printed), color=look_of(i)["color"], lw=1.1, linestyle=":", label=label)
        both[0].set_ylabel(f"log10 of {error} [{printed['de'].unit.replace('^2', '²').replace('^4', '⁴')}]")
        put_legend(figure, both)
        entitle(figure, caption(error))
    return figure, pd.concat(numbers, ignore_index=True)


def write(evidence: Evidence, folder: Path) -> list[Path]:
    """Write the figures that the runs of the paper's own study fill; return their SVG files."""
    mine = evidence.runs[evidence.runs["study"] == _STUDY]
    return [
        save(name, draw(error, mine, evidence.traces), folder)[0]
        for name, error in FIGURES.items()
        if applies(error, mine)
    ]


def _draw_panel(axes: Axes, runs: pd.DataFrame, traces: pd.DataFrame) -> pd.DataFrame:
    """Draw medians and quartiles over the evaluations, which the print has on a linear axis."""
    budget = int(runs["budget"].max())
    drawn = convergence_bands(runs.assign(method=runs["optimizer"]), traces).assign(budget=budget)
    for i, method in enumerate(_METHODS):
        band = drawn[drawn["method"] == method]
        low, middle, high = (np.log10(band[name].clip(lower=1e-300)) for name in ("q1", "median", "q3"))
        axes.fill_between(band["charged"], low, high, color=look_of(i)["color"], alpha=0.18, linewidth=0)
        axes.plot(band["charged"], middle, label=f"{method.upper()}, ours", **look_of(i))
    axes.set(xlim=(0, budget), xlabel="evaluations")
    axes.locator_params(axis="x", nbins=5)
    axes.set_title(f"{budget:,} evaluations: {spread_text(runs)}".replace(",", "\u202f"), fontsize=9)
    return drawn


def _of(error: str, runs: pd.DataFrame) -> pd.DataFrame:
    return runs_of(runs[runs["optimizer"].isin(_METHODS)], "full12", {"error": error, "gauge": "xa2"})


_PAPER = "cong2008"
_NOTE = (
    "Ours are medians, quartiles below where there is more than one run, at this study's budget. A printed number that "
    "is wrong is crossed out, and what to read stands beside it. The sampling plans are not published, so values agree "
    "in kind, not in digits."
)


def _column_title(key: str) -> str:
    """Return a printed column in words.

    >>> _column_title("table2.j1_n3"), _column_title("table4.j3_12"), _column_title("table3.j2")
    ('J1, 3 samples', 'J3, 12 parameters', 'J2')
    """
    error, _, rest = key.partition(".")[2].removeprefix("de_").partition("_")
    more = f"{rest[1:]} samples" if rest.startswith("n") else f"{rest} parameters" if rest else ""
    return error.upper() + (f", {more}" if more else "")


def printed_values(name: str, problem: Any) -> Mapping[str, float]:
    """Return the paper's calibrated values for this problem and error function, corrected for misprints."""
    options = getattr(problem, "options", {})  # a user's own has none, and no printed values
    error = str(options.get("error", "")).lower()
    section3 = options.get("gauge") == "ya2" or options.get("paper_section") == 3
    if name == "sensor_zero":
        key = f"table2.{error}_n{options['n']}"
    elif name == "link_length":
        key = f"table3.{error}"
    elif name in ("full11", "full12") and section3:
        key = f"table4.{error}_{name[-2:]}"
    elif name == "full12":
        key = f"table7.de_{error}"
    else:
        return {}
    try:
        column = constants.column(_PAPER, key)
    except KeyError:
        return {}
    return {quantity: column[quantity] for quantity in column}


def where_searches_stopped(runs: pd.DataFrame) -> tuple[Mark, ...]:
    """Mark where GA, PSO and DE stop in section 4, if these runs of its problem went as far."""
    stop = constants.column(_PAPER, "section44")["evaluations"]
    first = runs.iloc[0]
    if problem_name(first["problem"], first["problem_options"], but=("error",)) != "full12":
        return ()
    return (Mark(stop, "where the paper stopped its searches"),) if float(runs["budget"].max()) >= stop else ()


ADDITION = Addition(
    sections=(
        TableSection(
            anchor="papers",
            link="the papers' tables",
            heading="The paper's tables beside ours",
            note=_NOTE,
            tables=tuple(
                PrintedTable(name, f"Table {name.removeprefix('table')} of Cong et al. 2008", build, _column_title)
                for name, build in TABLES.items()
            ),
        ),
    ),
    figures=(
        *(
            AddedFigure(name, caption(error), partial(applies, error), partial(draw, error))
            for name, error in FIGURES.items()
        ),
        AddedFigure(
            "gauge",
            "The printed 12-parameter results on the curve along which no reading changes",
            lambda runs: bool(runs["problem"].eq("full12").any()),
            lambda runs, traces: gauge(),
        ),
        AddedFigure(
            "plans",
            "What sampling plans can tell of 11 parameters",
            lambda runs: len(options_seen(runs, "full11", "plan")) > 1,
            lambda runs, traces: plans(),
        ),
    ),
    printed_values=printed_values,
    marks=where_searches_stopped,
)
