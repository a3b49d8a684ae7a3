"""``bench choose STUDY_DIR``: the best setting of a sweep, with the optimism of choosing it."""

from dataclasses import asdict

from calibench import optimizers
from calibench.bench.commands.console import print_json, print_table
from calibench.bench.statistics.choosing import NEEDED, Chosen, choose
from calibench.bench.store.runs import ResultStore
from calibench.bench.verbs import ChooseWords
from calibench.bench.words import read, split_flags
from calibench.core.options import suggest
from calibench.core.words import counted, plain, print_plain as print

_LONG = 12  # settings that are listed
_ABOUT = {
    "value": "mean log10 gap above the declared minimum (or of the value, where none is declared), lower is better",
    "goal": "expected evaluations to the goal (ERT), lower is better",
}
_OF_CHOICE = ("optimizer", "by", "over", "units", "runs", "without_answer", "left_out")
_OF_NESTED = ("best", "default", "apparent", "nested", "optimism", "optimism_interval", "gain", "gain_interval")


def run(argv: list[str]) -> int:
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
    """Print a table of the settings, best first, and four lines on what choosing is worth."""
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
    low, high = interval
    if chosen.by == "goal":
        return f"factor {_factor(value)} [{_factor(low)}, {_factor(high)}] in evaluations"
    least, middle, most = (f"{round(number, 3) + 0.0:.3f}" for number in (low, value, high))  # no -0.000
    return f"{middle} [{least}, {most}], a factor {_factor(value)} in the gap"


def _factor(value: float) -> str:
    return f"{plain(10**value, 3)}" if value < 300 else "inf"
