"""One cell over versions of the code: where its runs became better or worse, by `compare`'s test and a change point.

A version is what one `code_digest` ran, in the order of its first run; versions that gave the same scores follow each
other as one epoch, as nothing changed in between. Neighbouring epochs are tested as two studies are, with Holm's
correction. The change point is one permutation test over all epochs (Pettitt, Appl. Statist. 28, 1979, gives the idea):
the split with the largest difference of mean ranks, beside what exchanged runs give; runs of one repetition share
data and start, so they are exchanged among themselves where every epoch has them all.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import pairwise
from pathlib import Path
from typing import Any, final

import numpy as np
import pandas as pd

from calibench.bench.report.shared.page import macros
from calibench.bench.statistics import summary as stats, two_studies
from calibench.bench.statistics.cells import SETTING, answers
from calibench.bench.statistics.ranking import By, holm, order_of_scores, scores
from calibench.bench.store.arrays import RUNS_SCHEMA, to_pandas
from calibench.bench.store.columns import Array, Flags
from calibench.bench.store.manifest import StoreError
from calibench.bench.tracking.catalogue import Entry, catalogue
from calibench.bench.tracking.tables import LeftOut, folder_of, rows_in
from calibench.core.words import plain

_PERMUTATIONS = 1999
_SAME_RUN = ("best_value", "best_evaluation", "evaluations", "charged")  # alike in all, two runs are one
_AXES = {
    "goal": "charged at the goal", "charged": "charged", "value": "best value", "success": "share that reached the goal"
}  # fmt: skip
_FROM = ("problem", "optimizer", "start", "budget")
_TEMPLATE = "tracking/templates/history.html.j2"
_WIDE, _LEFT, _TOP, _FLOOR = 760, 70, 40, 200  # of a drawing


@final
@dataclass(frozen=True)
class Version:
    """The runs of one cell that one version of the code made; `same`: they score as those of the version before."""

    code: str
    commit: str
    dirty: bool
    began: pd.Timestamp
    studies: tuple[str, ...]
    runs: pd.DataFrame
    same: bool = False


@final
@dataclass(frozen=True)
class Step:
    """From one epoch to the next: the verdict on the later one, Holm's p over all steps of the cell, and why."""

    p: float
    verdict: two_studies.Verdict
    why: str


@final
@dataclass(frozen=True)
class Change:
    """The split of the epochs that explains most: the version that begins the later part, and how likely by chance."""

    version: int
    p: float
    p_holm: float
    worse: bool


@final
@dataclass(frozen=True)
class History:
    """One cell over versions, oldest first; `steps` by the number of the version that begins an epoch."""

    problem: str
    optimizer: str
    options: tuple[str, str]
    setting: tuple[Any, ...]
    by: By
    versions: tuple[Version, ...]
    steps: dict[int, Step]
    change: Change | None = None

    @property
    def called(self) -> str:
        """Return in words which method this is, and on which problem, with their options."""
        row = self.versions[-1].runs.iloc[0]
        method = stats.method_name(row["optimizer"], row["optimizer_options"])
        return f"{method} on {stats.problem_name(row['problem'], row['problem_options'], also=('error',))}"

    @property
    def shown(self) -> By:
        """Return by what its versions are told: by value where half of no version's runs reach the goal."""
        reached = any(np.isfinite(stats.quantiles(measure(one.runs, self.by), (0.5,))[0]) for one in self.versions)
        return self.by if reached else "value"


@final
@dataclass(frozen=True)
class Asked:
    """Which runs a history is of: names, start and budget (globs, commas between), and by what runs are ordered."""

    problem: str
    optimizer: str
    by: By = "goal"
    start: str = "*"
    budget: str = "*"

    def matches(self, name: str, text: str) -> bool:
        """Tell whether a text is one of those that are asked for under a name."""
        return any(fnmatchcase(text, choice) for choice in getattr(self, name).split(","))

    def concerns(self, entry: Entry) -> bool:
        return entry.kind == "runs" and all(
            any(self.matches(name, text) for text in getattr(entry, name)) for name in ("problem", "optimizer")
        )


def histories(results: Path, asked: Asked) -> tuple[list[History], list[LeftOut]]:
    """Return the history of each cell that is `asked` for, and which studies could not be read."""
    some, left_out = [], []
    for entry in catalogue(results):
        if entry.kind == "runs" and entry.status == "damaged":
            left_out.append(LeftOut(results / entry.study, entry.headline))
        elif asked.concerns(entry):
            try:
                some.append(_of_study(results, entry, asked))
            except StoreError as error:
                left_out.append(LeftOut(results / entry.study, str(error)))
    some = [part for part in some if len(part)]
    every = pd.concat(some, ignore_index=True) if some else pd.DataFrame(columns=RUNS_SCHEMA.names)
    # the runs of each cell, whatever options its code knew: those that are no defaults tell
    cells: dict[tuple[Any, ...], list[pd.DataFrame]] = {}
    columns = ["problem", "problem_options", "data_id", "optimizer", "optimizer_options", *SETTING]
    for key, mine in every.groupby(columns, sort=False, dropna=False):
        named = dict(zip(columns, key, strict=True))
        setting = tuple(None if named[name] != named[name] else named[name] for name in ("data_id", *SETTING))
        cells.setdefault((named["problem"], named["optimizer"], two_studies.chosen_of(named), setting), []).append(mine)
    found = []
    for (problem, optimizer, options, setting), parts in cells.items():
        runs = pd.concat(parts)
        versions = _versions(runs, asked.by)
        begins = [i for i, version in enumerate(versions) if not version.same]
        pairs = [two_studies.partners(versions[a].runs, versions[b].runs) for a, b in pairwise(begins)]
        tests = [two_studies.two_sides(*pair, asked.by) for pair in pairs]
        steps = {i: Step(*one) for i, one in zip(begins[1:], two_studies.verdicts(tests, asked.by), strict=True)}
        change = None
        if len(begins) > 1 and stats.has_chance(runs):
            epochs = [versions[i].runs for i in begins]
            repetitions = [part["repetition"].tolist() for part in epochs]
            same: Flags | None = None  # which runs of each epoch are those of the epoch before
            if all(each == repetitions[0] for each in repetitions):
                kept = np.array([part[[*_SAME_RUN]].to_numpy(dtype=float) for part in epochs])
                same = np.zeros(kept.shape[:2], dtype=bool)
                same[1:] = ((kept[1:] == kept[:-1]) | (np.isnan(kept[1:]) & np.isnan(kept[:-1]))).all(axis=2)
            at, p, worse = change_point([scores(part, asked.by) for part in epochs], repetitions, same)
            change = Change(begins[at], p, p, worse)
        found.append(History(problem, optimizer, options, setting, asked.by, tuple(versions), steps, change))
    corrected = iter(holm([one.change.p for one in found if one.change is not None]))
    return [
        replace(one, change=replace(one.change, p_holm=float(next(corrected)))) if one.change is not None else one
        for one in found
    ], left_out


def _of_study(results: Path, entry: Entry, asked: Asked) -> pd.DataFrame:
    runs = to_pandas(rows_in(folder_of(results, entry), "runs", RUNS_SCHEMA.names))
    keep = np.ones(len(runs), dtype=bool)
    for name in _FROM:
        texts = runs[name].astype(str)
        keep &= texts.map({text: asked.matches(name, text) for text in texts.unique()}).to_numpy(bool)
    return runs[keep].assign(study=entry.study)


def _versions(runs: pd.DataFrame, by: By) -> list[Version]:
    runs = runs.assign(code_digest=runs["code_digest"].fillna(""))
    begun = runs.groupby(["code_digest", "study"])["started_at"].transform("min")
    runs = runs.assign(begun=begun).sort_values(["begun", "code_digest", "study"])
    # what one code ran in several studies, one after the other, is one version
    number = (runs["code_digest"] != runs["code_digest"].shift()).cumsum()
    versions: list[Version] = []
    for _, mine in runs.groupby(number):
        made_in = tuple(mine["study"].unique())
        mine = mine.drop_duplicates("run_id").sort_values(["repetition", "run_id"]).reset_index(drop=True)
        first = mine.sort_values("started_at").iloc[0]
        same = False
        if versions:  # it is where the runs that both made, of one repetition each, score the same
            a, b, paired = two_studies.partners(versions[-1].runs, mine)
            same = paired and np.array_equal(scores(a, by), scores(b, by)) and np.array_equal(answers(a), answers(b))
        versions.append(
            Version(
                str(mine["code_digest"].iloc[0]), str(first["git_commit"]), bool(first["git_dirty"]),
                first["started_at"], made_in, mine, same,
            )
        )  # fmt: skip
    return versions


def change_point(
    parts: Sequence[Array], repetitions: Sequence[Sequence[int]], kept: Flags | None = None, seed: int = 0
) -> tuple[int, float, bool]:
    """Return the epoch that begins the later part, the p of the test, and whether the later part is worse.

    `parts` are the scores of each epoch's runs, shape (n, 2) each. `kept`, shape (epochs, n), tells which runs are
    those of the epoch before to the last bit: they are one draw, and are exchanged as one.
    """
    sizes = np.array([len(part) for part in parts])
    ranks = order_of_scores(np.concatenate(parts)).astype(float)
    begins = np.r_[0, np.cumsum(sizes)[:-1]]
    rng = np.random.default_rng(seed)
    if all(list(one) == list(repetitions[0]) for one in repetitions) and len(set(repetitions[0])) == sizes[0]:
        sums = np.zeros((_PERMUTATIONS, len(parts)))
        fresh = np.ones((len(parts), sizes[0]), dtype=bool) if kept is None else ~kept
        for of_one, new in zip(ranks.reshape(len(parts), -1).T, fresh.T, strict=True):  # a repetition
            draws = of_one[new]
            sums += rng.permuted(np.tile(draws, (_PERMUTATIONS, 1)), axis=1)[:, np.cumsum(new) - 1]
    else:
        sums = np.add.reduceat(rng.permuted(np.tile(ranks, (_PERMUTATIONS, 1)), axis=1), begins, axis=1)
    seen = _splits(np.add.reduceat(ranks, begins)[None], sizes)[0]
    at = int(np.argmax(np.abs(seen)))
    largest = np.abs(_splits(sums, sizes)).max(axis=1)
    p = (1 + int((largest >= np.abs(seen[at]) * (1 - 1e-12)).sum())) / (1 + _PERMUTATIONS)
    return at + 1, p, bool(seen[at] > 0)


def _splits(sums: Array, sizes: Any) -> Array:
    """Return of sums of ranks, shape (k, epochs), the scaled difference of mean ranks at each split."""
    before, total = np.cumsum(sizes)[:-1], sizes.sum()
    left, whole = np.cumsum(sums, axis=1)[:, :-1], sums.sum(axis=1, keepdims=True)
    difference: Array = ((whole - left) / (total - before) - left / before) * np.sqrt(before * (total - before) / total)
    return difference


def check(results: Path, asked: Asked, tag: str = "") -> tuple[two_studies.Compared, str, str]:
    """Return how the newest study with such runs stands to the last one that has the tag (any, where it is empty)."""
    found = [one for one in catalogue(results) if asked.concerns(one) and one.status != "damaged"]
    if not found:
        raise ValueError(f"history: no run of {asked.optimizer} on {asked.problem} in {results}")
    newest, *older = found
    base = next((one for one in older if (tag in one.tag if tag else one.tag)), None)
    if base is None:
        which = f"the tag {tag}" if tag else "a tag"
        way = "bench tag STUDY +baseline sets one"
        raise ValueError(f"history --check: no study before {newest.study} has {which}; {way}")
    sides = [_of_study(results, one, asked) for one in (base, newest)]
    return two_studies.compare(sides[0], sides[1], asked.by), base.study, newest.study


def measure(runs: pd.DataFrame, by: By) -> Array:
    """Return what is drawn and told of each run: charged at the goal, value, or 1 where the goal was reached."""
    if by == "value":
        return answers(runs)
    if by == "charged":
        return np.asarray(runs["charged"], dtype=float)
    hits = stats.goal_hits(runs)
    return np.isfinite(hits).astype(float) if by == "success" else np.where(np.isfinite(hits), hits, np.inf)


def summary_of(history: History, version: Version) -> tuple[float, float, float, str]:
    """Return quartiles of the measure, and the middle one as text."""
    values = measure(version.runs, history.shown)
    if history.by == "success":
        share = float(values.mean())
        return share, share, share, f"{int(values.sum())}/{len(values)}"
    low, middle, high = (float(q) for q in stats.quantiles(values, (0.25, 0.5, 0.75)))
    reached = int(np.isfinite(values).sum())
    text = plain(middle) if np.isfinite(middle) else f"not reached by half ({reached}/{len(values)})"
    return low, middle, high, text


def rows_of(history: History) -> list[dict[str, Any]]:
    """Return a row for each version, in words: when, commit, studies, runs, value, and the verdict with its reason."""
    rows = []
    for i, version in enumerate(history.versions):
        step = history.steps.get(i)
        rows.append({
            "when": f"{version.began:%Y-%m-%d %H:%M}", "commit": version.commit[:8] + ("+" if version.dirty else ""),
            "studies": ", ".join(version.studies), "runs": len(version.runs),
            "value": summary_of(history, version)[3], "verdict": step.verdict if step else "",
            "why": step.why if step else "the same values" if version.same else "",
        })  # fmt: skip
    return rows


def drawing(history: History) -> str:
    """Return one history as SVG: a point a version with its quartiles, a line where the change point is."""
    points = [summary_of(history, version) for version in history.versions]
    values = np.array([point[:3] for point in points])
    known = np.isfinite(values)
    finite = values[known] if known.any() else np.zeros(1)
    logarithmic = finite.min() > 0 and finite.max() / finite.min() > 20
    scaled = np.log10(finite) if logarithmic else finite
    low, top = float(scaled.min()), float(scaled.max())
    y = np.full(values.shape, 20.0)  # one that is not finite stands above all others
    y[known] = _FLOOR - (_FLOOR - _TOP) * (scaled - low)[: known.sum()] / ((top - low) or 1.0)
    x = _LEFT + (_WIDE - _LEFT - 30) * (np.arange(len(points)) + 0.5) / len(points)
    change = history.change
    has_changed = change is not None and change.p_holm <= two_studies.LEVEL
    return macros(_TEMPLATE).drawing(
        history, _AXES[history.shown], [text for *_, text in points], x, y,
        at=x[change.version - 1 : change.version + 1].mean() if change is not None and has_changed else None,
        ends=[(plain(10**v if logarithmic else v), place) for v, place in ((low, _FLOOR), (top, _TOP))],
        wide=_WIDE, left=_LEFT, floor=_FLOOR,
    )  # fmt: skip


def page(found: Sequence[History]) -> str:
    """Return a page of its own with the drawing of each history; it opens offline."""
    return macros(_TEMPLATE).page([(one.called, sentence(one), drawing(one)) for one in found]).lstrip()


def sentence(history: History) -> str:
    epochs = sum(not version.same for version in history.versions)
    if len(history.versions) == 1:
        return "One version of the code has run it, so there is nothing to compare."
    if epochs == 1:
        return f"{len(history.versions)} versions of the code gave the same values: nothing changed."
    if history.change is None:
        return "No chance in these runs: what differs between versions, differs."
    version = history.versions[history.change.version]
    p = f"p {history.change.p_holm:.2g}, one test a cell (Holm)"
    if history.change.p_holm > two_studies.LEVEL:
        return f"No change is shown over {epochs} different versions; {p}."
    way = "worse" if history.change.worse else "better"
    return f"It became {way} with {version.commit[:8]} ({version.began:%Y-%m-%d}); {p}."
