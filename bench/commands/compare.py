"""``bench compare A B``: where the second study is better or worse than the first, for people and for CI."""

from math import isfinite
from pathlib import Path

import pandas as pd

from calibench.bench.commands.cells import best_texts
from calibench.bench.commands.console import print_json, print_table
from calibench.bench.execution.standing import name_in_rows
from calibench.bench.statistics.names import method_titles, problem_titles, several
from calibench.bench.statistics.summary import method_names
from calibench.bench.statistics.two_studies import Compared, Verdict, compare
from calibench.bench.store.runs import ResultStore
from calibench.bench.verbs import CompareWords
from calibench.bench.words import read, split_flags
from calibench.core.options import suggest
from calibench.core.words import counted, plain, print_plain as print, shortened

_VERDICTS: tuple[Verdict, ...] = ("worse", "better", "undecided", "equal")


def run(argv: list[str]) -> int:
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
    order = [word for word in words if word.startswith("by=")]
    by = read(CompareWords, "compare", order).by
    flags, folders = split_flags([word for word in words if word not in order], ("--json", "--methods"))
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
    if "--json" in flags:
        counts = {verdict: compared.count(verdict) for verdict in _VERDICTS}
        only = {"only_first": compared.only_first, "only_second": compared.only_second}
        print_json({"cells": compared.cells.to_dict("records"), **counts, **only})
    else:
        _print(compared, methods)
    return 1 if compared.count("worse") else 0


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
