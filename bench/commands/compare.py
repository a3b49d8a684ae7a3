"""``bench compare A B``: where the second study is better or worse than the first, for people and for CI.

``bench choose STUDY_DIR``: the best setting of a sweep, with the optimism of choosing it.
"""

from dataclasses import asdict
from math import isfinite
from pathlib import Path

import pandas as pd

from calibench import optimizers
from calibench.bench.commands.cells import best_texts
from calibench.bench.commands.console import print_json, print_table
from calibench.bench.execution.standing import name_in_rows
from calibench.bench.provenance.code_digest import changed_parts
from calibench.bench.statistics.choosing import NEEDED, Chosen, choose
from calibench.bench.statistics.names import method_titles, problem_titles, several
from calibench.bench.statistics.summary import method_names
from calibench.bench.statistics.two_studies import Compared, Verdict, compare
from calibench.bench.store.runs import ResultStore
from calibench.bench.verbs import ChooseWords, CompareWords
from calibench.bench.words import read, split_flags
from calibench.core.options import suggest
from calibench.core.words import counted, plain, print_plain as print, shortened

_VERDICTS: tuple[Verdict, ...] = ("worse", "better", "undecided", "equal")


def compare_studies(argv: list[str]) -> int:
    """Print a line a shared cell and the counts; return 1 where the second is worse in some cell, else 0."""
    words, methods = list(argv), None
    if "--methods" in words:
        at = words.index("--methods")
        named = words[at + 1 : at + 3]
        if len(named) < 2:
            raise ValueError("compare: --methods needs two optimizers: bench compare DIR --methods lm trf")
        if named[0] == named[1]:
            raise ValueError(
                f"compare: --methods names {named[0]} twice: sweep its settings into two studies and compare those"
            )
        del words[at : at + 3]
        methods = name_in_rows(named[0]), name_in_rows(named[1])
    with_key = [word for word in words if "=" in word and word.partition("=")[0].isidentifier()]
    keyed = [word for word in with_key if not Path(word).is_dir()]
    by = read(CompareWords, "compare", keyed).by
    flags, folders = split_flags([word for word in words if word not in keyed], ("--json", "--methods"))
    if len(folders) != 2 and not (methods and len(folders) == 1):
        raise ValueError("compare: two folders are needed, bench compare A B, or one with --methods M1 M2")
    sides = [ResultStore(Path(folder)).runs() for folder in folders]
    for folder, runs in zip(folders, sides, strict=True):
        if runs.empty:
            raise ValueError(f"{folder}: holds no finished run yet")
    first, second = sides[0], sides[-1]
    if methods is not None:
        first, second = _of_method(first, methods[0]), _of_method(second, methods[1])
    compared = compare(first, second, by, methods)
    if compared.cells.empty:
        settings = [sorted(set(method_names(runs))) for runs in (first, second)] if methods else []
        if swept := [name for names in settings if len(names) > 1 for name in names]:
            several = ", ".join(map(repr, swept))
            raise ValueError(f"compare: these have several settings: name one of each side: {several}")
        raise ValueError(f"compare: there is no cell in both: {_why_none(first, second, methods is not None)}")
    changed = _changed_problems(first, second)
    if "--json" in flags:
        counts = {verdict: compared.count(verdict) for verdict in _VERDICTS}
        only = {"only_first": compared.only_first, "only_second": compared.only_second}
        print_json({"cells": compared.cells.to_dict("records"), **counts, **only, "changed_problems": changed})
    else:
        _print(compared, methods)
        for name in changed:
            print(f"{name} is of other code, or other data, in B than in A: what differs may be the problem")
    return 1 if compared.count("worse") else 0


def _changed_problems(first: pd.DataFrame, second: pd.DataFrame) -> list[str]:
    """Return the problems that are of other code, or other data, in every run of the second than of the first."""
    codes = [runs[runs["code_digest"].str.len() > 0].groupby("problem")["code_digest"] for runs in (first, second)]
    a, b = (groups.agg(set).to_dict() for groups in codes)
    parts = {n: [{*changed_parts(one, other)} for one in a[n] for other in b[n]] for n in a if n in b}
    return [str(name) for name, each in parts.items() if all({"problem", "files"} & some for some in each)]


def _of_method(runs: pd.DataFrame, name: str) -> pd.DataFrame:
    mine = runs[(runs["optimizer"] == name) | (method_names(runs) == name)]
    if mine.empty:
        known = sorted({*runs["optimizer"], *method_names(runs)})
        raise ValueError(f"compare: no run of {name!r} there; {suggest(name, known)}")
    return mine


def _why_none(first: pd.DataFrame, second: pd.DataFrame, any_method: bool) -> str:
    for name in ("problem", *(() if any_method else ("optimizer",)), "start", "budget", "target"):
        a, b = (runs[name].astype(object).fillna("not told").astype(str).unique().tolist() for runs in (first, second))
        if not {*a} & {*b}:
            return f"{name} is {shortened(', '.join(a))} in A and {shortened(', '.join(b))} in B"
    return (
        "options differ, and a side has several settings, so that no two belong together (--methods names one of each)"
    )


def _print(compared: Compared, methods: tuple[str, str] | None) -> None:
    cells = compared.cells
    order = cells["verdict"].map(list(_VERDICTS).index)
    cells = cells.iloc[order.argsort(kind="stable")].reset_index(drop=True)
    titles = problem_titles(cells)
    names = method_titles(cells).tolist()
    rows = []
    columns, outside = several(cells), bool((cells["outside_a"] + cells["outside_b"]).any())
    for i, row in enumerate(cells.to_dict("records")):
        interval = f"{row['a12']:.2f} [{row['a12_low']:.2f}, {row['a12_high']:.2f}]"
        runs = counted(row["pairs"], "pair") if row["pairs"] else f"{row['runs_a']}, {row['runs_b']}"
        alone = [f"{row[f'alone_{side}']} of {side.upper()}" for side in "ab" if row[f"alone_{side}"]]
        runs += f" ({', '.join(alone)} without partner)" if alone else ""
        method = f"{methods[0]} -> {methods[1]}" if methods else names[i]
        other = "" if methods or not row["other_options"] else f" ({row['other_options']})"
        # with three digits, or with up to six where they are needed to distinguish them
        ends = row["best_median_a"], row["best_median_b"]
        texts = [tuple(plain(end, digits) for end in ends) for digits in range(3, 7)]
        median = " -> ".join(next((pair for pair in texts if pair[0] != pair[1]), texts[0]))
        median += f" {row['unit']}" if row["unit"] else ""
        if isfinite(row["minimum"]) and row["minimum"]:
            median = " -> ".join(*best_texts([row | {"noisy": False}], "best_median_a", "best_median_b"))
        reached = f"{row['reached_a']}/{row['runs_a']} -> {row['reached_b']}/{row['runs_b']}"
        reached = reached if row["goal"] == row["goal"] else "-"
        costs = [row[f"charged_to_target_{side}"] for side in "ab"]  # medians of those that reached it
        reached += f" after {costs[0]:.0f} -> {costs[1]:.0f}" if all(map(isfinite, costs)) else ""
        settings = [str(row[name]) for name in columns]
        marks = [f"◇ {row[name]}" if row[name] else "-" for name in ("outside_a", "outside_b")]
        box = [" -> ".join(marks)] if outside else []
        result = [runs, interval, reached, *box, median, row["test"], row["why"]]
        rows.append([row["verdict"], titles[i], method + other, *settings, *result])
    head = ["B is", "problem", "optimizer", *columns, "runs", "B beats A in", "reached A -> B"]
    head += ["outside box A -> B"] if outside else []
    print_table([*head, "median A -> B", "test", "why"], rows)
    counts = ", ".join(f"{compared.count(v)} {v}" for v in _VERDICTS)
    print(f"\n{counted(len(cells), 'shared cell')}: B is in {counts}; at 5 % over all cells (Holm)")
    if compared.only_first or compared.only_second:
        print(f"not compared: {counted(compared.only_first, 'cell')} only in A, {compared.only_second} only in B")


_LONG = 12  # settings that are listed
_ABOUT = {
    "value": "mean log10 gap above the declared minimum (or of the value, where none is declared), lower is better",
    "goal": "expected evaluations to the goal (ERT), lower is better",
}
_OF_CHOICE = ("optimizer", "by", "over", "units", "runs", "without_answer", "left_out")
_OF_NESTED = ("best", "default", "apparent", "nested", "optimism", "optimism_interval", "gain", "gain_interval")


def choose_setting(argv: list[str]) -> int:
    """Print for each method that was swept what choosing its best setting is worth; return 0."""
    flags, words = split_flags(argv, ("--json",))
    folders = [word for word in words if "=" not in word]
    given = read(ChooseWords, "choose", [word for word in words if "=" in word])
    if len(folders) != 1:
        raise ValueError("choose: one STUDY_DIR is needed, such as bench choose results/adhoc")
    runs = ResultStore(folders[0]).runs(NEEDED)
    if runs.empty:
        raise ValueError(f"{folders[0]}: holds no finished run yet")
    for column, wanted in (("budget", given.budget), ("start", given.start)):
        if wanted:
            known = [str(value) for value in runs[column].unique()]
            if wanted not in known:
                raise ValueError(f"choose: {column}={wanted}: {suggest(wanted, known)}")
            runs = runs[runs[column].astype(str) == wanted]
    # the runs of each method that has several settings, or of the one that was asked for
    methods = list(dict.fromkeys(runs["optimizer"]))
    if given.optimizer and given.optimizer not in methods:
        raise ValueError(f"choose: no run of {given.optimizer!r} there; {suggest(given.optimizer, methods)}")
    sides = [runs[runs["optimizer"] == name] for name in ([given.optimizer] if given.optimizer else methods)]
    swept = [mine for mine in sides if given.optimizer or mine["optimizer_options"].nunique() > 1]
    if not swept:
        raise ValueError(
            "choose: every method has one setting here; sweep an option: bench run -m optimizer.OPTION=A,B,C ..."
        )
    choices = [choose(mine, given.by, given.over) for mine in swept]
    if "--json" in flags:
        printed = []
        for chosen in choices:
            nested, columns = asdict(chosen.nested), ("name", "options", "score", "times_chosen")
            scores = map(float, chosen.nested.scores)
            of_all = zip(chosen.names, chosen.options, scores, chosen.times_chosen(), strict=True)
            printed.append({
                **{name: getattr(chosen, name) for name in _OF_CHOICE},
                "settings": [dict(zip(columns, values, strict=True)) for values in of_all],
                **{name: nested[name] for name in _OF_NESTED}, "beats_default": chosen.nested.beats_default,
            })  # fmt: skip
        print_json(printed)
        return 0
    for i, chosen in enumerate(choices):
        if i:
            print()
        print_chosen(chosen)
    return 0


def print_chosen(chosen: Chosen) -> None:
    nested, times, unit = chosen.nested, chosen.times_chosen(), chosen.over[:-1]
    weaker = " (a statement on new seeds of these instances alone)" if chosen.over == "seeds" else ""
    print(
        f"{chosen.optimizer}: {counted(len(chosen.names), 'setting')} on {counted(len(chosen.units), unit)}"
        f"{weaker}, {counted(chosen.runs, 'run')}; score: {_ABOUT[chosen.by]}"
    )
    order = nested.scores.argsort(kind="stable").tolist()
    listed = [i for place, i in enumerate(order) if place < _LONG or i == nested.default]
    mark = {nested.default: " (default)"}
    rows = [[chosen.names[i] + mark.get(i, ""), _score(chosen, nested.scores[i]), str(times[i])] for i in listed]
    print_table(["setting", "score", "times chosen"], rows)
    if len(listed) < len(order):
        print(f"and {counted(len(order) - len(listed), 'setting')} more; bench choose --json has all")
    seen = "an instance" if chosen.over == "instances" else "a seed"
    print(f"best on all: {chosen.names[nested.best]}, {_score(chosen, nested.apparent)} (apparent)")
    print(
        f"on {seen} that had no part in the choice: {_score(chosen, nested.nested)} (nested, leaving one {unit} out); "
        f"optimism {_change(chosen, nested.optimism, nested.optimism_interval)}"
    )
    if nested.default is None:
        or_ = "" if chosen.optimizer in optimizers.registry else ", or its class is not here"
        print(f"the default is not among the settings{or_}, so the gain over it is not known; add it to the sweep")
    else:
        says = "whether choosing beats the default is undecided: the interval includes no change"
        if nested.beats_default or nested.gain_interval[1] < 0:
            says = f"choosing {'beats' if nested.beats_default else 'is worse than'} the default"
        print(f"gain over the default: {_change(chosen, nested.gain, nested.gain_interval)}; {says}")
    if chosen.without_answer:
        how = "count as ten times the worst gap of their instance" if chosen.by == "value" else "reached nothing"
        print(f"{counted(chosen.without_answer, 'run')} without an answer {how}")
    if chosen.left_out:
        what = "setting" if len(chosen.left_out) == 1 else "settings"
        print(f"left out, not run on all: {len(chosen.left_out)} {what}, such as {chosen.left_out[0]}")


def _score(chosen: Chosen, value: float) -> str:
    return f"{value:.3f}" if chosen.by == "value" else f"{10**value:.0f}" if value < 300 else "never"


def _change(chosen: Chosen, value: float, interval: tuple[float, float]) -> str:
    powers = interval[0], value, interval[1]
    low, factor, high = (plain(10**power, 3) if power < 300 else "inf" for power in powers)
    if chosen.by == "goal":
        return f"factor {factor} [{low}, {high}] in evaluations"
    least, middle, most = (f"{round(power, 3) + 0.0:.3f}" for power in powers)  # no -0.000
    return f"{middle} [{least}, {most}], a factor {factor} in the gap"
