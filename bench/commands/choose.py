"""``bench choose STUDY_DIR``: the best setting of a sweep, with the optimism of choosing it."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, cast

import pandas as pd

from calibench import optimizers
from calibench.bench.commands.arguments import split_flags
from calibench.bench.commands.console import print_json, print_table
from calibench.bench.statistics.choosing import NEEDED, By, Chosen, Over, choose
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.words import read_pairs
from calibench.core.options import suggest
from calibench.core.words import counted, plain
from calibench.core.words import print_plain as print

_KNOWN = {"optimizer": "de", "by": "value", "over": "instances", "budget": "2000", "start": "random"}
_LONG = 12  # settings that are listed
_ABOUT = {
    "value": "mean log10 gap above the declared minimum (or of the value, where none is declared), lower is better",
    "goal": "expected evaluations to the goal (ERT), lower is better",
}


def run(argv: list[str]) -> int:
    """Print for each method that was swept what choosing its best setting is worth; return 0."""
    flags, words = split_flags(argv, ("--json",))
    folders = [word for word in words if "=" not in word]
    given = read_pairs("choose", [word for word in words if "=" in word], _KNOWN)
    if len(folders) != 1:
        raise ValueError("choose: one STUDY_DIR is needed, such as bench choose results/adhoc")
    runs = ResultStore(folders[0]).runs(NEEDED)
    if runs.empty:
        raise ValueError(f"{folders[0]}: holds no finished run yet")
    by, over = cast(By, given.get("by", "value")), cast(Over, given.get("over", "instances"))
    choices = [choose(mine, by, over) for mine in _methods(_part(runs, given), given.get("optimizer"))]
    if "--json" in flags:
        print_json([choice_as_dict(chosen) for chosen in choices])
    else:
        for i, chosen in enumerate(choices):
            if i:
                print()
            print_chosen(chosen)
    return 0


def _part(runs: pd.DataFrame, given: dict[str, str]) -> pd.DataFrame:
    for column in ("budget", "start"):
        if column in given:
            known = [str(value) for value in runs[column].unique()]
            if given[column] not in known:
                raise ValueError(f"choose: {column}={given[column]}: {suggest(given[column], known)}")
            runs = runs[runs[column].astype(str) == given[column]]
    return runs


def _methods(runs: pd.DataFrame, optimizer: str | None) -> list[pd.DataFrame]:
    """Return the runs of each method that has several settings, or of the one that was asked for."""
    known = list(dict.fromkeys(runs["optimizer"]))
    if optimizer is not None and optimizer not in known:
        raise ValueError(f"choose: no run of {optimizer!r} there; {suggest(optimizer, known)}")
    sides = [runs[runs["optimizer"] == name] for name in (known if optimizer is None else [optimizer])]
    swept = [mine for mine in sides if optimizer is not None or mine["optimizer_options"].nunique() > 1]
    if not swept:
        raise ValueError(
            "choose: every method has one setting here; sweep an option: bench run -m optimizer.OPTION=A,B,C ..."
        )
    return swept


def choice_as_dict(chosen: Chosen) -> dict[str, Any]:
    """Return the statistics of a choice as plain values."""
    nested = asdict(chosen.nested)
    return {
        **{name: getattr(chosen, name) for name in ("optimizer", "by", "over", "units", "runs", "without_answer")},
        "left_out": chosen.left_out,
        "settings": [
            {"name": name, "options": options, "score": float(score), "times_chosen": times}
            for name, options, score, times in zip(
                chosen.names, chosen.options, chosen.nested.scores, chosen.times_chosen(), strict=True
            )
        ],
        **{name: nested[name] for name in ("best", "default", "apparent", "nested")},
        "optimism": nested["optimism"],
        "optimism_interval": nested["optimism_interval"],
        "gain": nested["gain"],
        "gain_interval": nested["gain_interval"],
        "beats_default": chosen.nested.beats_default,
    }


def print_chosen(chosen: Chosen) -> None:
    """Print a table of the settings, best first, and four lines on what choosing is worth."""
    nested, times, units = chosen.nested, chosen.times_chosen(), len(chosen.units)
    weaker = " (a statement on new seeds of these instances alone)" if chosen.over == "seeds" else ""
    print(
        f"{chosen.optimizer}: {counted(len(chosen.names), 'setting')} on {counted(units, chosen.over[:-1])}"
        f"{weaker}, {counted(chosen.runs, 'run')}; score: {_ABOUT[chosen.by]}"
    )
    order = nested.scores.argsort(kind="stable").tolist()
    listed = [i for place, i in enumerate(order) if place < _LONG or i == nested.default]
    mark = {nested.default: " (default)"}
    rows = [[chosen.names[i] + mark.get(i, ""), _score(chosen, nested.scores[i]), str(times[i])] for i in listed]
    print_table(["setting", "score", "times chosen"], rows)
    if len(listed) < len(order):
        print(f"and {counted(len(order) - len(listed), 'setting')} more; bench choose --json has all")
    for line in _lines(chosen):
        print(line)


def _lines(chosen: Chosen) -> list[str]:
    nested, unit = chosen.nested, chosen.over[:-1]
    seen = "an instance" if chosen.over == "instances" else "a seed"
    lines = [
        f"best on all: {chosen.names[nested.best]}, {_score(chosen, nested.apparent)} (apparent)",
        f"on {seen} that had no part in the choice: {_score(chosen, nested.nested)} (nested, leaving one {unit} out); "
        f"optimism {_change(chosen, nested.optimism, nested.optimism_interval)}",
    ]
    if nested.default is None:
        or_ = "" if chosen.optimizer in optimizers.registry else ", or its class is not here"
        lines.append(
            f"the default is not among the settings{or_}, so the gain over it is not known; add it to the sweep"
        )
    else:
        says = "whether choosing beats the default is undecided: the interval includes no change"
        if nested.beats_default or nested.gain_interval[1] < 0:
            says = f"choosing {'beats' if nested.beats_default else 'is worse than'} the default"
        lines.append(f"gain over the default: {_change(chosen, nested.gain, nested.gain_interval)}; {says}")
    if chosen.without_answer:
        how = "count as ten times the worst gap of their instance" if chosen.by == "value" else "reached nothing"
        lines.append(f"{counted(chosen.without_answer, 'run')} without an answer {how}")
    if chosen.left_out:
        what = "setting" if len(chosen.left_out) == 1 else "settings"
        lines.append(f"left out, not run on all: {len(chosen.left_out)} {what}, such as {chosen.left_out[0]}")
    return lines


def _score(chosen: Chosen, value: float) -> str:
    return f"{value:.3f}" if chosen.by == "value" else f"{10**value:.0f}" if value < 300 else "never"


def _change(chosen: Chosen, value: float, interval: tuple[float, float]) -> str:
    """Return a difference of two scores with its interval, and as a factor."""
    low, high = interval
    if chosen.by == "goal":
        return f"factor {_factor(value)} [{_factor(low)}, {_factor(high)}] in evaluations"
    least, middle, most = (f"{round(number, 3) + 0.0:.3f}" for number in (low, value, high))  # no -0.000
    return f"{middle} [{least}, {most}], a factor {_factor(value)} in the gap"


def _factor(value: float) -> str:
    return f"{plain(10**value, 3)}" if value < 300 else "inf"
