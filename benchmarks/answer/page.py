"""The page of the answer, docs/answer.md, made from the compact table alone: no number of it is written by hand."""

from __future__ import annotations

import numpy as np
import pandas as pd

from benchmarks.answer.compact import BLOCK, KNOWS
from benchmarks.answer.standing import ert_bounds, leading, ranked, standing, winners
from calibench import optimizers
from calibench.bench.report.shared.page import bullets, table, text
from calibench.bench.statistics.ranking import LEVEL, Ranked

_LISTED = 3  # methods of each kind in the tables
_MOSTLY = 0.5  # of a family's answers in the box: a family below is named
_WORDS = {"residuals": "with residuals", "gradient": "with the gradient", "values": "with values alone"}


def page(runs: pd.DataFrame) -> str:
    """Return the page of these rows (`compact`)."""
    budgets = sorted(int(b) for b in runs["budget"].unique())
    blocks = [
        "# Which optimiser for robot calibration?",
        bullets(*(_answer(runs[runs["budget"] == budget], budget) for budget in budgets)),
        text(
            "*As good as the noise*: the value is at most what the true machine leaves of the noisy readings (where an"
            " instance has no noise, what readings of 1 µrad or .1 µm would leave). A Jacobian, and a gradient, is"
            " charged as many evaluations as there are parameters, which is what forward differences cost. SciPy's"
            " Newton methods make their Hessian out of the Jacobian of the residuals, and stand with those that know"
            " them."
        ),
        text(_worth(runs)),
        "![Share of the instances brought to the noise, over the evaluations](images/answer.png)",
        "## What was compared",
        text(_compared(runs)),
        text(
            "Tables have the three that lead of each kind, of a local method its better way to end. ERT: all charges"
            " until the level was reached, over how many reached it. Errors are medians over all instances, after the"
            " move along the gauge where there is one; an angle counts times 244 mm. Of mean ranks 1 is best."
        ),
        "```text\nbench run study=calibration24 results=results\n"
        "python -m benchmarks.answer results/calibration24   # the compact table, then this page and its pictures\n"
        "python -m benchmarks.answer                         # the page and the pictures from the table that is kept\n"
        "```",
    ]
    for budget in budgets:
        blocks += _section(runs[runs["budget"] == budget], budget)
    blocks += [
        text(
            f"The mean ranks of the four leading methods of each kind at {budgets[-1]} evaluations. They were chosen on"
            " the same runs, so the diagram shows them, and proves less than it seems:"
        ),
        "![Mean ranks of the leading methods, with the critical difference](images/answer_ranks.png)",
    ]
    blocks += ["## Does the choice hold?", *_holds(runs), "## What would overturn it", _overturned(runs)]
    return "\n\n".join(blocks) + "\n"


def _answer(runs: pd.DataFrame, budget: int) -> str:
    found = leading(runs, len(runs)).set_index("name")
    families = {str(family): standing(mine).set_index("name") for family, mine in runs.groupby("family", sort=False)}
    told = []
    for kind, name in winners(runs).items():
        reached = {family: float(rows.loc[name, "reached"]) for family, rows in families.items()}
        inside = {family: float(rows.loc[name, "inside"]) for family, rows in families.items()}
        nowhere = ", ".join(f"`{family}`" for family, count in reached.items() if not count)
        said = f"{_WORDS[kind]} **`{name}`** ({_reached(found.loc[name])}"
        said += f", none of {nowhere}" if nowhere else ""
        within = found[(found["knows"] == kind) & (found["inside"] == 1)]
        if found.loc[name, "inside"] < 1 and len(within):  # it knows no bounds
            low = ", ".join(f"{share:.0%} of `{family}`" for family, share in inside.items() if share < _MOSTLY)
            said += f", {found.loc[name, 'inside']:.0%} of its answers in the box{low and f' ({low})'}; of those that"
            said += " never leave it"
            also = f" (alike {_quoted(within.iloc[0]['alike'])})" if within.iloc[0]["alike"] else ""
            said += f" `{within.index[0]}`{also}: {_reached(within.iloc[0])}"
        told.append(f"{said})")
    return f"At {budget} evaluations, to be as good as the noise of the readings: {'; '.join(told)}."


def _reached(row: pd.Series) -> str:
    return f"{row['reached']:g} of {row['blocks']} instances, {_ert(row)} evaluations each"


def _worth(runs: pd.DataFrame) -> str:
    """Return what an answer as good as the noise is worth in the user's terms."""
    there = runs[runs["reached_at"].notna()]
    half, most = there["position_error_mm"].dropna().quantile([0.5, 0.95])
    away = runs[runs["reached_at"].isna()]["position_error_mm"].dropna().median()
    return (
        f"What it is worth: the machine calibrated so errs in its positions by {_length(half)} mm in the median of the"
        f" {len(there)} runs that got there, 95 % of them by less than {_length(most)} mm; of the runs that did not get"
        f" there the median is {_length(away)} mm."
    )


def _compared(runs: pd.DataFrame) -> str:
    families = list(dict.fromkeys(runs["family"]))
    blocks, methods = (len(runs[keys].drop_duplicates()) for keys in (BLOCK, ["method", "ends"]))
    seeds = runs["repetition"].nunique()
    noisy = runs[[*BLOCK, "noise"]].drop_duplicates()
    failed = int((runs["status"] != "ok").sum())
    parts = [f"{runs['method'].nunique()} methods, {methods} with both kinds of the local ones"]
    for budget, mine in runs.groupby("budget"):
        parts.append(f"{len(mine)} runs on {len(mine[BLOCK].drop_duplicates())} instances at {budget} evaluations")
    return (
        f"{'; '.join(parts)}; {seeds} repetition{'s' if seeds > 1 else ''} each. An instance"
        f" ([what is drawn](instances.md)) is a block of the tests: {blocks} of {len(families)} families"
        f" ({', '.join(f'`{f}`' for f in families)}), {int((noisy['noise'] > 0).sum())} of them with noise. All methods"
        f" begin an instance at the same random point of its box. {failed} runs failed or ran out of time: they reached"
        f" nothing and stay in the count.{_later(runs)}"
    )


def _later(runs: pd.DataFrame) -> str:
    """Return which methods have been registered since the runs were made; '' where there are none."""
    names = [f"`{name}`" for name in later(runs)]
    return f" Registered since, and not in it yet: {', '.join(names)}." if names else ""


def later(runs: pd.DataFrame) -> list[str]:
    """Return the methods that are not in the runs, without those of extra packages and the one that hangs."""
    left_out = {*runs["method"], "nlopt_LN_NEWUOA_BOUND"}
    ours = [name for name in optimizers.names() if ":" not in name and name not in left_out]
    return [name for name in ours if optimizers.make(name).traits.package in ("", "pygmo")]


def _section(runs: pd.DataFrame, budget: int) -> list[str]:
    test, lacking = ranked(runs)
    places = dict(zip(test.methods, test.mean_ranks, strict=True))
    rows = []
    for row in leading(runs, _LISTED).to_dict("records"):
        name = row["name"]
        rows.append([
            f"`{name}`{' ¹' if row['alike'] else ''}",
            row["knows"],
            f"{row['reached']:g}/{row['blocks']}",
            f"{row['low']:.0%} .. {row['high']:.0%}",
            _ert(row),
            _bounds(*ert_bounds(runs, name)),
            _length(row["position_error_mm"]),
            _length(row["parameter_error_mm"]),
            f"{row['inside']:.0%}",
            f"{places[name]:.1f}" if name in places else "–",
        ])  # fmt: skip
    head = [
        "method", "knows", "as good as noise", "95 %", "ERT", "95 %", "position error [mm]", "largest error [mm]",
        "in the box", "mean rank",
    ]  # fmt: skip
    return [
        f"## At {budget} evaluations",
        table(head, rows),
        *_alike(leading(runs, _LISTED)),
        _told_apart(runs, test, lacking),
        text("By family, how many instances the first of each kind brings to the noise:"),
        _by_family(runs),
    ]


def _alike(found: pd.DataFrame) -> list[str]:
    told = [f"`{row['name']}`: {_quoted(row['alike'])}" for row in found.to_dict("records") if row["alike"]]
    return [text(f"¹ Alike in every run: {'; '.join(told)}.")] if told else []


def _quoted(names: str) -> str:
    return ", ".join(f"`{name}`" for name in names.replace(", stops", "").replace(", restarts", "").split(", "))


def _told_apart(runs: pd.DataFrame, test: Ranked, lacking: list[str]) -> str:
    verb = "cannot run on all blocks and is" if len(lacking) == 1 else "cannot run on all blocks and are"
    left = f"{', '.join(f'`{name}`' for name in lacking)} {verb} left out." if lacking else ""
    if test.refused:
        return bullets(f"No test: {test.refused}. {left}")
    whole = (
        f"All: Friedman's statistic over {test.blocks} blocks and {len(test.methods)} methods is {test.statistic:.0f},"
        f" p {_p(test.p)}; the best mean rank is that of `{test.methods[0]}`, {test.mean_ranks[0]:.1f}, and Nemenyi's"
        f" critical difference {test.critical_difference:.1f}. {left}"
    )
    kinds = []
    for kind in KNOWS:
        mine, _ = ranked(runs[runs["knows"] == kind])
        if mine.refused:
            kinds.append(f"{_WORDS[kind].capitalize()}: no test: {mine.refused}.")
            continue
        alike = [name for name, p in zip(mine.methods, mine.against_best, strict=True) if p >= LEVEL]
        told = ", ".join(f"`{name}`" for name in alike) or "none"
        kinds.append(
            f"{_WORDS[kind].capitalize()}: of {len(mine.methods)} the best mean rank is that of `{mine.methods[0]}`,"
            f" {mine.mean_ranks[0]:.1f} (p {_p(mine.p)}). Not separated from it by Holm's comparisons at"
            f" {LEVEL:g}: {told}."
        )
    return bullets(whole, *kinds)


def _by_family(runs: pd.DataFrame) -> str:
    chosen = winners(runs)
    families = list(dict.fromkeys(runs["family"]))
    rows = []
    for kind, name in chosen.items():
        cells = []
        for family in families:
            found = standing(runs[runs["family"] == family]).set_index("name")
            first = winners(runs[runs["family"] == family])[kind]
            told = f"{found.loc[name, 'reached']:g}/{found.loc[name, 'blocks']}"
            better = found.loc[first, "reached"] > found.loc[name, "reached"]
            cells.append(f"{told} (`{first}` {found.loc[first, 'reached']:g})" if better else told)
        rows.append([f"`{name}`", *cells])
    return table(["method", *(f"`{f}`" for f in families)], rows)


def _holds(runs: pd.DataFrame) -> list[str]:
    """Return what becomes of the choice on instances that it was not made on, and without each family."""
    rows = []
    for budget, mine in runs.groupby("budget"):
        odd, even = mine[mine["instance"] % 2 == 1], mine[mine["instance"] % 2 == 0]
        families = list(mine["family"].unique()) if mine["family"].nunique() > 1 else []
        for (kind, name), best in zip(winners(odd).items(), winners(even).values(), strict=True):
            seen = [standing(half).set_index("name") for half in (odd, even)]
            shares = [f"{half.loc[name, 'share']:.0%}" for half in seen]
            others = [f for f in families if winners(mine[mine["family"] != f])[kind] != name]
            rows.append([
                str(budget), kind, f"`{name}`", *shares, f"`{best}` {seen[1].loc[best, 'share']:.0%}",
                ", ".join(f"`{f}`" for f in others) or "none",
            ])  # fmt: skip
    head = [
        "budget", "knows", "chosen on odd instances", "there", "on even ones", "best on even ones",
        "another is first without",
    ]  # fmt: skip
    return [
        text(
            "The best of many methods looks better than it is. So the choice is made on the odd instances and looked at"
            " on the even ones, and made again without each family in turn."
        ),
        table(head, rows),
    ]


def _overturned(runs: pd.DataFrame) -> str:
    largest = runs[runs["budget"] == runs["budget"].max()]
    chosen = winners(largest)
    found = standing(largest).set_index("name")
    kinds = {"with noise": largest[largest["noise"] > 0], "without": largest[largest["noise"] == 0]}
    seen = {words: standing(mine).set_index("name") for words, mine in kinds.items() if len(mine)}
    split = "; ".join(
        f"`{name}` " + ", ".join(f"{rows.loc[name, 'share']:.0%} {words}" for words, rows in seen.items())
        for name in chosen.values()
    )
    local = max((n for n in found.index if n.endswith(", stops")), key=lambda n: (found.loc[n, "share"], n))
    return bullets(
        "*A rougher landscape.* Here one descent from one random point of the box is mostly enough: "
        f"`{local}` reaches the noise in {found.loc[local, 'share']:.0%} of the instances without a restart. Wider "
        "boxes than twice the papers', or machines with several assembly modes in the box, would favour restarts and "
        "populations.",
        f"*Larger budgets.* {largest['budget'].max()} evaluations are few for a population; the papers' are 5e7, where "
        "differential evolution reaches rounding too (docs/ledger.md). The answer is for those who cannot wait.",
        f"*Other noise.* It is Gaussian, independent and of one size here: {split}. Outliers or a wrong model want a "
        "robust loss: `trf` and `dogbox` have several (`loss=`), which were not run here.",
        "*Seconds.* Evaluations are counted. Where one costs microseconds, what a method does in between decides.",
        "*Other machines.* Here are a planar and a spatial parallel machine and two serial arms. A machine with other "
        "singularities, or with joints whose zeros and lengths the readings hardly tell apart, may favour another.",
        "*Other draws.* Widths of the boxes, numbers of poses and noise are drawn as the page on instances says, and "
        "not measured on a population of real machines.",
    )


def _ert(row: pd.Series | dict[str, float]) -> str:
    return f"{row['ert']:.0f}" if np.isfinite(row["ert"]) else "never"


def _bounds(low: float, high: float) -> str:
    return f"{low:.0f} .. {high:.0f}" if np.isfinite(high) else f"{low:.0f} ..." if np.isfinite(low) else "–"


def _length(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else "–"


def _p(value: float) -> str:
    return "< 1e-300" if value < 1e-300 else f"= {value:.2g}"
