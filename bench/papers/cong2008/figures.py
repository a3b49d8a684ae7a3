"""What Cong et al. 2008 adds to a report: Tables 2 to 7 beside ours, Figs 3 to 5, the gauge curve, and the plans.

Figs 3 to 5 are log10 of J over evaluations, dotted where a printed curve ends, beside the kept run at the paper's own
budget (``results/reference/``). The plans are not published, so values agree in kind (ranking, decades), not in digits.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from calibench import problems
from calibench.bench.papers.ledger import Ours, kept
from calibench.bench.provenance.run_id import canonical, options_of
from calibench.bench.report.shared import drawing
from calibench.bench.report.study.additions import AddedFigure, Addition, Mark, PrintedTable, TableSection
from calibench.bench.report.study.figures import convergence_bands, spread_text
from calibench.bench.statistics.cells import CELL
from calibench.bench.statistics.names import options_seen
from calibench.bench.statistics.summary import goal_hits, median_of_reached, problem_name
from calibench.bench.statistics.tables import once
from calibench.bench.store.arrays import lists_of
from calibench.bench.store.runs import ResultStore
from calibench.problems import constants
from calibench.problems.base import Array

FIGURES = {"cong2008_fig3": "J1", "cong2008_fig4": "J2", "cong2008_fig5": "J3"}
_PAPER = "cong2008"
_GAUGE = ("gauge", _PAPER)  # the key under which `once` keeps the gauge curves
_METHODS = ("ga", "pso", "de")
_RED = "#C00000"
_STEPS, _BY = 6, 1e-4  # steps to the angle of a printed result on the gauge curve, and of its slope [rad]
_SCALE = 4 * 244.0**2  # near zero J1 is J2 / (4 l_b^2) where all l_b are 244 mm
# the printed columns of calibrated values, by key: problem and options
COLUMNS: dict[str, tuple[str, dict[str, Any]]] = {
    "table2.j1_n3": ("sensor_zero", {"error": "J1", "n": 3}), "table2.j1_n9": ("sensor_zero", {"error": "J1", "n": 9}),
    "table2.j2_n3": ("sensor_zero", {"error": "J2", "n": 3}), "table2.j2_n9": ("sensor_zero", {"error": "J2", "n": 9}),
    "table3.j1": ("link_length", {"error": "J1"}), "table3.j2": ("link_length", {"error": "J2"}),
    "table3.j3": ("link_length", {"error": "J3"}), "table4.j3_12": ("full12", {"error": "J3", "gauge": "ya2"}),
    "table4.j3_11": ("full11", {"error": "J3", "paper_section": 3}),
}  # fmt: skip
_DE = {"table7.de_j3": ("full12", {"error": "J3", "gauge": "xa2"})}


def _table6(runs: pd.DataFrame) -> pd.DataFrame:
    rows = []
    for method in ("ga", "pso", "de"):
        column = constants.column(_PAPER, f"table6.{method}")
        for error in ("J1", "J2", "J3"):
            mine = runs_of(runs[runs["optimizer"] == method], "full12", {"error": error, "gauge": "xa2"})
            printed = column.entries[error.lower()]
            quantities = [(1.0, error, printed.unit), (_SCALE, "J1 x 4 l_b^2", "mm^4")][: 2 if error == "J1" else 1]
            for _, cell in mine.groupby(CELL, sort=False, dropna=False):
                asked, course = _facts_of(cell)
                rows += [
                    {
                        "table": column.key, **asked, "quantity": quantity, "unit": unit,
                        "printed": printed.printed * scale, "read": printed.value * scale,
                        "why": printed.why or printed.doubt, **asdict(Ours.of(scale * cell["best_value"])), **course,
                    }
                    for scale, quantity, unit in quantities
                ]  # fmt: skip
    return pd.DataFrame(rows)


def _calibrations(table: str, runs: pd.DataFrame) -> pd.DataFrame:
    """Return a table of calibrated values by every method that ran them; with the gauge also moved onto the truth."""
    rows = []
    actual = constants.column(_PAPER, f"{table}.actual")
    for key, (problem, options) in (COLUMNS | _DE).items():
        if not key.startswith(table):
            continue
        column = constants.column(_PAPER, key)
        for _, cell in runs_of(runs, problem, options).groupby(CELL, sort=False, dropna=False):
            ours = {"kmrmse": cell["kmrmse"]}  # of the quantities in print: a row holds no such thing as iterations
            answered = cell[cell["parameter_values"].notna()]
            if not answered.empty:
                names = answered["parameter_names"].iloc[0]
                listed = lists_of(answered["parameter_values"]).table(np.arange(len(answered)))
                values = pd.DataFrame(listed, columns=names)
                ours = {str(name): values[name] for name in values} | ours
            lines = [
                (quantity, entry.unit, actual.get(quantity), entry.printed, entry.value, entry.why or entry.doubt,
                 ours[quantity])
                for quantity, entry in column.entries.items() if quantity in ours
            ]  # fmt: skip
            scale = _SCALE if options["error"] == "J1" else 1.0
            extra = [("best J as mm^4", "mm^4", "not in print: J1 as J1 x 4 l_b^2", scale * cell["best_value"])]
            if problem == "full12":
                extra += [
                    ("kmrmse_aligned", "mm", "not in print: what is left after the gauge is taken out",
                     cell["kmrmse_aligned"]),
                    ("gauge_phi", "rad", "not in print: where on the gauge curve it ended", cell["gauge_phi"]),
                ]  # fmt: skip
            lines += [(quantity, unit, 0.0, np.nan, np.nan, why, values) for quantity, unit, why, values in extra]
            asked, course = _facts_of(cell)
            rows += [
                {
                    "table": key, **asked, "quantity": quantity, "unit": unit, "true": true, "printed": printed,
                    "read": read, "why": why, **asdict(Ours.of(values)), **course,
                }
                for quantity, unit, true, printed, read, why, values in lines
            ]  # fmt: skip
    return pd.DataFrame(rows)


TABLES: Mapping[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    **{table: partial(_calibrations, table) for table in ("table2", "table3", "table4")}, "table6": _table6,
    "table7": lambda runs: _calibrations("table7", runs[runs["optimizer"] == "de"]),
}  # fmt: skip


def runs_of(runs: pd.DataFrame, problem: str, options: Mapping[str, Any]) -> pd.DataFrame:
    """Return the runs of `problem` with these options and all others as they are by default: no noise, its own plan."""
    of_it = runs["problem"] == problem
    have = {text: json.loads(text) for text in runs.loc[of_it, "problem_options"].unique()}
    if not have:  # as in most studies: no problem need be built
        return runs.iloc[:0]
    chosen = canonical(options)
    wanted = once(("options", problem, chosen), lambda: canonical(options_of(problems.make(problem, **options))))
    fits = [text for text, held in have.items() if all(held.get(key, v) == v for key, v in json.loads(wanted).items())]
    return runs[of_it & runs["problem_options"].isin(fits)]


def _facts_of(cell: pd.DataFrame) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the columns that say which runs a row is of, and those that say how they went."""
    names = {"method": "optimizer", "options": "optimizer_options", "start": "start", "target": "target"}
    reached = goal_hits(cell)
    return {name: cell[column].iloc[0] for name, column in names.items()}, {
        "budget": int(cell["budget"].iloc[0]), "failed": int((cell["status"] == "failed").sum()),
        "restarts": int(cell["restarts"].sum()), "reached": int(np.isfinite(reached).sum()),
        "charged_to_target": median_of_reached(reached),
    }  # fmt: skip


def gauge(*_: pd.DataFrame) -> drawing.Drawing:
    """Draw Table 4's and Table 7's printed 12-parameter results on the gauge curve through the true machine."""
    points, curves = once(_GAUGE, _on_gauge)
    with drawing.new_figure(10.2, 4.9) as figure:
        for axes, (key, table) in zip(figure.subplots(1, 2), points.groupby("table", sort=False), strict=True):
            held, fitted, scale = (table[name].iloc[0] for name in ("held", "phi", "scale"))
            phi, curve, origin = curves[str(key)]
            names, moved = [*table["parameter"]], curve - origin
            true = dict(zip(names, origin, strict=True))
            groups = {name: [name] for name in names if name[0] in "xy"}
            groups |= {"six link lengths": [n for n in names if n[0] == "l"]}
            groups |= {"offsets z x 244 mm": [n for n in names if n[0] == "z"]}
            for (label, members), colour, dashes in zip(groups.items(), drawing.COLOURS, drawing.DASHES):
                arm = 244.0 if members[0].startswith("z") else 1.0
                line = arm * moved[:, [names.index(n) for n in members]].mean(axis=1)
                axes.plot(1e3 * phi, line, color=colour, linestyle=dashes, lw=1.4, label=label)
                for row in table[table["parameter"].isin(members)].to_dict("records"):
                    wrong = row["misprint"]
                    axes.plot(
                        1e3 * fitted, arm * (row["printed"] - true[row["parameter"]]), marker="x" if wrong else "o",
                        ms=6, mfc=colour, mec=_RED if wrong else "white", mew=1.2 if wrong else 0.8,
                    )  # fmt: skip
            sound = table[~table["misprint"] & ~table["parameter"].str.startswith("z")]
            place: Any = {"xytext": (3, 4), "xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
            axes.axvline(0, color="0.35", lw=0.8)
            axes.annotate("truth", (0, 0), fontsize=8, **place)
            number = str(key).partition(".")[0].removeprefix("table")
            where = {"ya2": "section 3, y_a2 held", "xa2": "section 4, x_a2 held"}[held]
            axes.set(xlabel="gauge angle phi [mrad]", ylabel="parameter minus truth [mm]")
            axes.set_title(
                f"Table {number} ({where}): phi = {1e3 * fitted:.4g} mrad, scale {scale:.6f}\n"
                f"{len(sound)} lengths printed right lie within {sound['misfit_mm'].abs().max():.1g} mm of the curve",
                fontsize=9,
            )
            axes.plot([], [], "o", color="0.4", label="printed")
            axes.plot([], [], "x", color=_RED, label="printed wrong (errata)")
            axes.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=3)
        figure.suptitle(
            "The 12-parameter results of Cong et al. 2008 are points of a curve along which no reading changes",
            fontsize=10,
        )
    return figure, points


def _on_gauge() -> tuple[pd.DataFrame, dict[str, tuple[Array, Array, Array]]]:
    """Return the printed 12-parameter columns of Tables 4 and 7 on their gauge curve, a row for each parameter.

    And by table angles, shape (k,), the curve there, shape (k, 12), and where it is at 0.
    """
    rows, curves = [], {}
    for key, held in (("table4.j3_12", "ya2"), ("table7.de_j3", "xa2")):
        column, problem = constants.column(_PAPER, key), problems.full12(gauge=held)
        names = [p.name for p in problem.parameters]
        arms = np.array([244.0 if p.unit == "rad" else 1.0 for p in problem.parameters])
        read = np.array([column[name] for name in names])
        fit = np.array([not column.entries[name].is_misprint for name in names]) & (arms == 1.0)  # angles: 1e-4 only
        phi = 0.0
        for _ in range(_STEPS):  # of Gauss and Newton; scipy.optimize takes a third of a second to load
            ahead, here, behind = ((problem.gauge_curve(phi + by) - read)[fit] for by in (_BY, 0.0, -_BY))
            slope = (ahead - behind) / (2 * _BY)
            phi -= float(slope @ here / (slope @ slope))
        on_curve, at = problem.gauge_curve(phi), names.index("lb1")
        origin, angles = problem.gauge_curve(0.0), np.linspace(-0.15 * phi, 1.25 * phi, 200)
        curves[key] = angles, np.array([problem.gauge_curve(angle) for angle in angles]), origin
        scale = float(on_curve[at] / origin[at])
        for i, name in enumerate(names):
            entry = column.entries[name]
            rows.append(
                {
                    "table": key, "held": held, "phi": phi, "scale": scale, "parameter": name,
                    "printed": entry.printed, "read": entry.value, "curve": float(on_curve[i]),
                    "misfit_mm": float((read[i] - on_curve[i]) * arms[i]), "misprint": entry.is_misprint,
                }
            )  # fmt: skip
    return pd.DataFrame(rows), curves


def plans(*_: pd.DataFrame) -> drawing.Drawing:
    """Draw the singular values of `full11` for readings on a line, a circle, two circles and a disc (section 4.5)."""
    noise, numbers = 1e-4, []
    sampled = (("line", 80.0), ("circle", 80.0), ("two_circles", 120.0), ("disc", 100.0))
    with drawing.axes_in(None, 7.6, 3.9) as axes:
        for (plan, radius), colour, dashes in zip(sampled, drawing.COLOURS, drawing.DASHES):
            known = problems.identify(problems.make("full11", plan=plan, radius=radius), noise=noise)
            worst = max(float(e) for e, unit in zip(known.standard_errors, known.units, strict=True) if unit == "mm")
            values = known.singular_values / known.singular_values[0]
            label = f"{plan.replace('_', ' ')} R{radius:g}: condition {known.condition:.1e}, worst {worst:.2g} mm"
            index = range(1, len(values) + 1)
            axes.plot(index, values, marker="o", ms=4, color=colour, linestyle=dashes, label=label)
            line = {"plan": plan, "radius": radius, "index": index, "singular_value": values}
            line |= {"condition": known.condition, "worst_length_error_mm": worst, "noise_rad": noise}
            numbers.append(pd.DataFrame(line))
        axes.set(
            yscale="log", xlabel="singular value", ylabel="relative to the largest", xticks=range(1, 12),
            title="What 50 readings can tell of 11 parameters: on a circle rather than a line, but not on one circle",
        )  # fmt: skip
        axes.title.set_fontsize(10)
        axes.legend(
            fontsize=8, loc="lower left", alignment="left",
            title=f"condition, and worst standard error of a length at {noise:g} rad",
        )  # fmt: skip
    return drawing.figure_of(axes), pd.concat(numbers, ignore_index=True)


def caption(error: str) -> str:
    number = {"J1": 3, "J2": 4, "J3": 5}[error]
    return f"Fig. {number} of Cong et al. 2008, axes as printed: GA, PSO and DE under {error}; dotted, the printed ends"


def applies(error: str, runs: pd.DataFrame) -> bool:
    """Tell whether these are runs of the figure: of its problem, each method in one setting and to one budget."""
    mine = _of(error, runs)
    settings = mine.groupby("optimizer")["optimizer_options"].nunique()
    return len(settings) == len(_METHODS) and settings.max() == 1 and mine["budget"].nunique() == 1


def draw(error: str, runs: pd.DataFrame, traces: pd.DataFrame) -> drawing.Drawing:
    """Draw the figure of an error function, beside it at the paper's budget: medians and quartiles over evaluations."""
    panels = [(_of(error, runs), traces)]
    store = kept(_PAPER)
    if store is not None:
        longer = _of(error, ResultStore(store).runs())
        if len(longer) and longer["budget"].max() > panels[0][0]["budget"].max():
            panels.append((longer, ResultStore(store).traces()))
    printed = {method: constants.column(_PAPER, f"table6.{method}").entries[error.lower()] for method in _METHODS}
    numbers = []
    with drawing.new_figure(1.9 + 4.0 * len(panels), 3.9) as figure:
        both = list(np.atleast_1d(figure.subplots(1, len(panels), sharey=True)))
        for axes, (mine, points) in zip(both, panels, strict=True):
            budget = int(mine["budget"].max())
            drawn = convergence_bands(mine.assign(method=mine["optimizer"]), points).assign(budget=budget)
            numbers.append(drawn)
            for i, method in enumerate(_METHODS):
                band, look = drawn[drawn["method"] == method], drawing.look_of(i)
                low, middle, high = (np.log10(band[name].clip(lower=1e-300)) for name in ("q1", "median", "q3"))
                axes.fill_between(band["charged"], low, high, color=look["color"], alpha=0.18, linewidth=0)
                axes.plot(band["charged"], middle, label=f"{method.upper()}, ours", **look)
            axes.set(xlim=(0, budget), xlabel="evaluations")
            axes.locator_params(axis="x", nbins=5)
            axes.set_title(f"{budget:,} evaluations: {spread_text(mine)}".replace(",", "\u202f"), fontsize=9)
            for i, (method, end) in enumerate(printed.items()):
                label, colour = f"{method.upper()}, printed end {end.printed:g}", drawing.look_of(i)["color"]
                axes.axhline(np.log10(end.printed), color=colour, lw=1.1, linestyle=":", label=label)
        both[0].set_ylabel(f"log10 of {error} [{printed['de'].unit.replace('^2', '²').replace('^4', '⁴')}]")
        drawing.put_legend(figure, both)
        drawing.entitle(figure, caption(error))
    return figure, pd.concat(numbers, ignore_index=True)


def _of(error: str, runs: pd.DataFrame) -> pd.DataFrame:
    return runs_of(runs[runs["optimizer"].isin(_METHODS)], "full12", {"error": error, "gauge": "xa2"})


def _column_title(key: str) -> str:
    """Return a printed column in words.

    >>> _column_title("table2.j1_n3"), _column_title("table4.j3_12"), _column_title("table3.j2")
    ('J1, 3 samples', 'J3, 12 parameters', 'J2')
    """
    error, _, rest = key.partition(".")[2].removeprefix("de_").partition("_")
    more = f"{rest[1:]} samples" if rest.startswith("n") else f"{rest} parameters" if rest else ""
    return error.upper() + (f", {more}" if more else "")


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
            anchor="papers", link="the papers' tables", heading="The paper's tables beside ours",
            note="Ours are medians, quartiles below where there is more than one run, at this study's budget. A "
            "printed number that is wrong is crossed out, and what to read stands beside it. The sampling plans are "
            "not published, so values agree in kind, not in digits.",
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
            "gauge", "The printed 12-parameter results on the curve along which no reading changes",
            # it is worked out in the problems' process
            lambda runs: bool(runs["problem"].eq("full12").any() and once(_GAUGE, _on_gauge)), gauge,
        ),
        AddedFigure(
            "plans", "What sampling plans can tell of 11 parameters",
            lambda runs: len(options_seen(runs, "full11", "plan")) > 1, plans,
        ),
    ),
    marks=where_searches_stopped,
)  # fmt: skip
