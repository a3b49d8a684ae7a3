"""What stands first on a study's page: how much was run under which budget, and who got there, problem by problem."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from html import escape

import pandas as pd

from calibench.bench.report.study import figures
from calibench.bench.report.study import html_tables as study_tables
from calibench.bench.report.study import origin as study_origin
from calibench.bench.report.study.html_tables import count
from calibench.bench.statistics import summary as stats
from calibench.bench.statistics.cells import CELL, METHOD, mixed_code
from calibench.bench.statistics.labels import setting_text, several
from calibench.bench.statistics.optimum import optimum_of
from calibench.core.counted import counted, plural

_READING = """<details><summary>How to read the tables</summary><ul>
<li><b>At the goal</b>: how many of <i>all</i> runs, failed ones included, reached the level that counts as success: the
run's own target, or the problem's last; the heading of a table says which, and whether that is the rounding floor,
below which nothing is ranked, as what differs there is rounding. <b>Share</b> draws it with its interval, Wilson's at
95 %: five of five still only says above 57 %. Where chance has no part (a deterministic method from one start) there is
no interval.</li>
<li><b>Evaluations to it</b>: the median over the runs that got there, in charged evaluations. Read it beside the
share.</li>
<li><b>Best, median</b> and <b>quartiles</b> are over all runs, those between two of them interpolated; a run without a
value counts as infinitely bad. <b>Spent</b> is the median charge. f* is the least value, where the problem declares
it. Where values are noisy they are those of the answers as judged, without noise or by fresh evaluations outside the
budget, and only a judged answer reaches a goal.</li>
<li>A <b>cell</b> is one problem with its options, one optimiser with its options, one start, budget and target: every
number is of one cell.</li>
<li>Sorted by the share at the goal, then by what it cost to get there, then by the best value; at the goal and below it
values are tied.</li>
{further}</ul></details>"""
_MERIT = """<li><b>kmrmse*</b> [mm]: how far the calibrated machine stands from the true one, root mean square over
positions, after the one move of the whole machine that no reading can see (the gauge).</li>"""
_CONDITION = """<li><b>Condition</b>: how much worse the worst combination of parameters is seen than the best.</li>"""
_MONEY = """<li><b>Of these the objective's</b> seconds: evaluations x what one takes + Jacobians x what one takes, each
kind of call at its own cost, measured once a problem before the first run, apart from every run's clock. A second
currency: charged are evaluations, and a Jacobian as many as there are parameters, whatever it takes. It is not part of
the seconds measured, so it can be above them where the machine was busy when it was measured.</li>"""


def headline(
    runs: pd.DataFrame,
    problems: int,
    planned: Collection[str],
    about: str,
    condition: bool = False,
    money: bool = False,
) -> str:
    """Return the head of the page: the counts, where the runs come from, and what was compared.

    `planned` are the ids of the runs that the study is to have, `about` is a sentence on a prepared one. `condition`
    and `money` tell whether the page says anything of the one and the other.
    """
    failed = int((runs["status"] != "ok").sum())
    budgets = [count(b) for b in sorted(set(runs["budget"]))]
    cells = runs.groupby(CELL, dropna=False).size()
    seeds = str(cells.max()) if cells.min() == cells.max() else f"{cells.min()} to {cells.max()}"
    left = len(set(planned) - set(runs["run_id"]))
    methods = runs[METHOD].drop_duplicates()
    facts = [
        (count(len(runs)), plural("run", len(runs)), ""), (count(failed), "failed", "bad" if failed else ""),
        (" / ".join(budgets), "evaluations a run, at most", ""),
        (seeds, f"{plural('seed', cells.max())} a cell", ""), (str(problems), plural("problem", problems), ""),
        (str(len(methods)), plural("optimiser", len(methods)), ""),
        (str(len(cells)), plural("cell", len(cells)), ""),
    ]  # fmt: skip
    facts += [(count(left), "planned, not done yet", "bad")] if left else []
    further = (_MERIT if runs["kmrmse_aligned"].notna().any() else "") + (_CONDITION if condition else "")
    further += _MONEY if money else ""
    boxes = "".join(f"<div class='{kind}'><b>{value}</b><span>{what}</span></div>" for value, what, kind in facts)
    told = f"<p class=why>{escape(about)}</p>" if about else ""
    python = " / ".join(study_origin.versions(runs).get("python", []))
    made = {
        "commit": study_origin.commits(runs), "Python": python,
        "on": study_origin.machines(runs), "begun": study_origin.began(runs),
    }  # fmt: skip
    line = " · ".join(f"{key} {escape(value)}" for key, value in made.items() if value)
    return (
        f"{told}<div class=facts>{boxes}</div><p class=why>{line} (<a href=#provenance>all versions</a>)</p>"
        f"<p class=lead>{_told(runs, budgets, failed)} <b>{escape(mixed_code(runs))}</b></p>"
        f"{_READING.format(further=further)}"
    )


def _told(runs: pd.DataFrame, budgets: Sequence[str], failed: int) -> str:
    """Return what was compared, and under which budget, in sentences."""
    one = len(budgets) == 1
    starts = " and ".join(f"the {s}" for s in sorted(set(runs["start"].astype(str))))
    calls = (
        f"Every run had the same budget of {budgets[0]} evaluations"
        if one
        else f"The budgets differ ({', '.join(budgets)} evaluations): compare only within one"
    )
    cells = runs.groupby(CELL, dropna=False).ngroups
    lost = (
        f"{failed} of {counted(len(runs), 'run')} failed; they stay in every table, as runs that reached nothing where "
        "they broke off and with what they had reached where only their time was up, and the "
        "<a href=#failures>reasons</a> are at the end."
        if failed
        else "No run failed."
    )
    return (
        f"{things(cells, 'cell')} of a problem and an optimiser, {things(len(runs), 'run')} in all, from"
        f" {escape(starts)} start{'s' if ' and ' in starts else ''}. {calls}, counted at one gate for all: one "
        "evaluation is one pass over all samples, a Jacobian is charged as many as there are parameters, and the "
        f"call after the last is refused. {lost}"
    )


def contents(
    groups: Mapping[str, pd.DataFrame], names: pd.Series, further: Mapping[str, str], summary: pd.DataFrame
) -> str:
    """Return a row a problem and error, linked to its section; `further` are other links, words -> address.

    `summary` is that of all runs (`bench.statistics.summary.summary`).
    """
    rows = []
    every = pd.concat(list(groups.values()))
    goals = any(pd.notna(stats.goal(t, levels)) for t, levels in zip(every["target"], every["targets"], strict=True))
    for title, runs in groups.items():
        for i, (error, mine) in enumerate(study_tables.by_error(runs)):
            cells = study_tables.ranked(mine, names, summary)
            told = several(cells)
            won = cells[cells["success"] == 1.0].sort_values("charged_to_target", kind="stable")
            optimum, known = optimum_of(mine), cells["goal"].notna().any()
            lowest = cells.sort_values("best_median", kind="stable").iloc[0]
            best = won.iloc[0] if len(won) else lowest
            called = escape(", ".join([best["method"], *(setting_text(c, best[c]) for c in told)]))
            first = (
                f"{called}, {count(best['charged_to_target'])} evaluations"
                if len(won)
                else f"{'none; ' if known else ''}lowest median: {called}, {optimum.told(lowest['best_median'])}"
            )
            failed = int((mine["status"] != "ok").sum())
            rows.append(
                [
                    "" if i else f"<a href='#{anchor(title)}'>{escape(title)}</a>", escape(error or "f"),
                    str(int(mine["dimension"].iloc[0])), str(len(cells[METHOD].drop_duplicates())), str(len(cells)),
                    *([str(len(won)) if known else "–"] if goals else []), first,
                    f"<span class='v no'>✗ {failed}</span>" if failed else "0",
                ]
            )  # fmt: skip
    heads = [
        ("problem", ""), ("error", ""), ("parameters", "n"), ("methods", "n"), ("cells", "n"),
        *([("at the goal in every run", "n")] if goals else []),
        ("fewest evaluations to the goal" if goals else "best", ""), ("failed runs", "n"),
    ]  # fmt: skip
    links = " · ".join(f"<a href='{escape(address)}'>{escape(words)}</a>" for words, address in further.items())
    return f"<h2 id=contents>Problems</h2>{study_tables.table(heads, rows)}<p>Further: {links}</p>"


def anchor(title: str) -> str:
    """Return the name of a problem's section."""
    return f"problem-{figures.file_name(title)}"


def things(n: int, what: str) -> str:
    """Return a count with what is counted."""
    return f"{count(n)} {plural(what, n)}"
