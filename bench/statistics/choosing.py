"""The choice of one setting of a method from a sweep, and its value on units that had no part in the choice.

A unit is an instance (a problem with its options and data) or, weaker, a seed. Each unit is left out once, and the
setting that is best on the rest is scored on it: together the nested score. Optimism is the nested score less the
apparent one, gain the default's less the nested one. Intervals draw units with replacement, and select anew, every copy
of a unit left out together; quantiles are those at which an interval of a mean has its t-distributed width.

Sources: Stone, J. R. Stat. Soc. B 36 (1974); Varma and Simon, BMC Bioinformatics 7:91 (2006); Hesterberg, The American
Statistician 69 (2015), section 4 (expanded percentiles).
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, final, get_args

import numpy as np
import pandas as pd

from calibench import optimizers
from calibench.bench.provenance.run_id import canonical, chosen_options, plain
from calibench.bench.statistics.cells import PROBLEM, SETTING, answers
from calibench.bench.statistics.names import in_order, problem_titles, setting_text
from calibench.bench.statistics.summary import goal_hits, goals_of, option_text
from calibench.bench.statistics.targets import references
from calibench.bench.store.columns import Array, Counts, Flags, parts
from calibench.core.options import suggest
from calibench.core.registry import names_of_files
from calibench.core.words import counted

By = Literal["value", "goal"]
Over = Literal["instances", "seeds"]
_LEAST = 1e-16  # the gap below which values are tied, where neither a goal nor the minimum says so
_FAILED = 1.0  # decades above the worst answer of an instance, for a run without one
FEWEST = 6  # units: of 5 the sign of every one of them has a two-sided p of 1/16, above 5 %
RESAMPLES = 1999
LEVEL = 0.95
_SEED = (2008, 0x4E455354)
_AT_ONCE = 4_000_000  # numbers held of some resamples
NEEDED = [
    "run_id", "repetition", *PROBLEM, "optimizer", "optimizer_options", *SETTING, "targets", "status", "minimum",
    "best_value", "inside_box", "judged_value", "judged_evaluations", "hits_charged", "charged", "tampering",
]  # fmt: skip  # columns of runs


@final
@dataclass(frozen=True)
class Scored:
    """Costs of settings on units, shapes (settings, units): a score is ``sum(paid) / sum(won)``, `log`: its log10."""

    paid: Array
    won: Array
    log: bool

    def of(self, paid: Array, won: Array) -> Array:
        """Return the scores of sums; infinite where nothing was won."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(won > 0, paid / won, np.inf)
            return np.log10(ratio) if self.log else ratio


@final
@dataclass(frozen=True)
class Nested:
    """The value of choosing, in scores: `best` is the setting chosen on all units, with its `apparent` score.

    `chosen`, shape (units,), is that chosen with each unit left out. Without a `default` in the sweep `gain` is NaN.
    """

    scores: Array
    best: int
    apparent: float
    nested: float
    optimism: float
    optimism_interval: tuple[float, float]
    chosen: Counts
    default: int | None
    gain: float
    gain_interval: tuple[float, float]

    @property
    def beats_default(self) -> bool:
        """Tell whether the interval of the gain is above 0."""
        return self.gain_interval[0] > 0


def nest(scored: Scored, default: int | None, resamples: int = RESAMPLES) -> Nested:
    """Return what choosing a setting is worth; of settings that are alike the first is chosen."""
    settings, units = scored.paid.shape
    if settings < 2 or units < FEWEST:
        raise ValueError(f"{settings} settings on {units} units: 2 settings and {FEWEST} units are needed")
    apparent, nested, optimism, gain, chosen = _once(scored, np.ones((1, units)), default)
    scores = scored.of(scored.paid.sum(axis=1), scored.won.sum(axis=1))

    rng = np.random.default_rng(np.random.SeedSequence([*_SEED, units]))
    drawn = rng.multinomial(units, np.full(units, 1 / units), size=resamples).astype(float)
    drawn = drawn[(drawn > 0).sum(axis=1) > 1]  # one unit alone leaves nothing to choose on
    each = max(1, _AT_ONCE // (settings * units))
    some = [_once(scored, drawn[first : first + each], default) for first in range(0, len(drawn), each)]
    optimisms, gains = (np.concatenate([values[k] for values in some]) for k in (2, 3))
    return Nested(
        scores=scores,
        best=int(np.argmin(scores)),
        apparent=float(apparent[0]),
        nested=float(nested[0]),
        optimism=float(optimism[0]),
        optimism_interval=_ends(optimisms, units),
        chosen=chosen[0],
        default=default,
        gain=float(gain[0]),
        gain_interval=(float("nan"), float("nan")) if default is None else _ends(gains, units),
    )


def _once(scored: Scored, weight: Array, default: int | None) -> tuple[Array, Array, Array, Array, Counts]:
    """Return apparent, nested, optimism, gain, shapes (resamples,), and what was chosen, shape (resamples, units).

    `weight`, shape (resamples, units), says how often each unit is there; all its copies are left out together.
    """
    units = np.arange(scored.paid.shape[1])
    paid, won = weight @ scored.paid.T, weight @ scored.won.T  # (resamples, settings)
    left_paid = paid[:, :, None] - weight[:, None, :] * scored.paid
    left_won = won[:, :, None] - weight[:, None, :] * scored.won
    chosen = np.argmin(scored.of(left_paid, left_won), axis=1)
    nested = scored.of(
        (weight * scored.paid[chosen, units]).sum(axis=1), (weight * scored.won[chosen, units]).sum(axis=1)
    )
    scores = scored.of(paid, won)
    apparent = scores.min(axis=1)
    with np.errstate(invalid="ignore"):
        gain = np.full(len(weight), np.nan) if default is None else scores[:, default] - nested
        return apparent, nested, nested - apparent, gain, chosen


def _ends(values: Array, units: int) -> tuple[float, float]:
    """Return the expanded percentiles of resampled values, shape (resamples,); one that is not known widens both."""
    from scipy.stats import norm, t

    reach = np.sqrt(units / (units - 1)) * t.ppf((1 + LEVEL) / 2, units - 1)
    tail = float(norm.sf(reach))
    first = int(np.floor(tail * (len(values) - 1)))
    low = np.sort(np.where(np.isnan(values), -np.inf, values))[first]
    high = np.sort(np.where(np.isnan(values), np.inf, values))[len(values) - 1 - first]
    return float(low), float(high)


@final
@dataclass(frozen=True)
class Chosen:
    """What choosing a setting of `optimizer` is worth; `left_out` names settings that lack a unit."""

    optimizer: str
    by: By
    over: Over
    names: tuple[str, ...]
    options: tuple[str, ...]
    units: tuple[str, ...]
    runs: int
    without_answer: int
    left_out: tuple[str, ...]
    nested: Nested

    def times_chosen(self) -> list[int]:
        """Return how often each setting was chosen with one unit left out."""
        return [int(count) for count in np.bincount(self.nested.chosen, minlength=len(self.names))]


def choose(runs: pd.DataFrame, by: By = "value", over: Over = "instances") -> Chosen:
    """Return what choosing a setting is worth, of `runs` (columns `NEEDED`) of one optimiser, or raise `ValueError`."""
    for given, known, word in ((by, get_args(By), "by"), (over, get_args(Over), "over")):
        if given not in known:
            raise ValueError(f"{word}={given}: {suggest(given, known)}")
    [optimizer] = runs["optimizer"].unique()
    rows = runs.reset_index(drop=True)
    read = {text: parts(json.loads(text), classes=False) for text in rows["optimizer_options"].unique()}
    keys = dict.fromkeys(key for held in read.values() for key in held)
    swept = [key for key in keys if len({canonical({"": held.get(key)}) for held in read.values()}) > 1]
    # what each setting is called: the options in which settings differ
    for digits in (6, 17):
        names = {
            text: ", ".join(
                option_text(key, f"{held[key]:.{digits}g}" if isinstance(held[key], float) else held[key])
                for key in swept
                if key in held
            )
            or optimizer
            for text, held in read.items()
        }
        if len(set(names.values())) == len(names):
            break
    title = problem_titles(rows)
    unit = title if over == "instances" else "seed " + rows["repetition"].astype(str)
    units = sorted(set(unit), key=in_order)
    _check(str(optimizer), rows, len(names), len(units), over)
    paid, won, without = _scores(rows, by)

    # the settings that ran on every unit (over seeds: on every instance with each)
    columns = [rows["optimizer_options"], unit, *([title] if over == "seeds" else [])]
    pairs = pd.concat(columns, axis=1, keys=range(len(columns))).drop_duplicates()
    whole, count = len(pairs.drop(columns=0).drop_duplicates()), pairs.groupby(0).size()
    kept = [text for text in names if count[text] == whole]
    default = {text for text in kept if _is_default(optimizer, text, read[text], swept)}
    # the default first: of those that are alike the first is chosen
    order = sorted(kept, key=lambda text: (text not in default, in_order(names[text])))
    if len(order) < 2:
        raise ValueError(
            f"{optimizer}: fewer than two settings ran on all of {counted(len(units), over[:-1])}; the same bench run "
            "goes on with what is left"
        )
    place = {text: i for i, text in enumerate(order)}
    mine = rows["optimizer_options"].isin(place).to_numpy()
    at = rows["optimizer_options"][mine].map(place).to_numpy(), unit[mine].map(units.index).to_numpy()
    sums = np.zeros((3, len(order), len(units)))
    for table, values in zip(sums, (paid, won, np.ones(len(rows))), strict=True):
        np.add.at(table, at, values[mine])
    if by == "goal" and not sums[1].any():
        raise ValueError(f"{optimizer}: no run reached the goal; an easier target=, or by=value")
    scored = Scored(sums[0], sums[1], True)
    if by == "value":
        scored = Scored(sums[0] / sums[2], np.ones(sums[0].shape), False)
    return Chosen(
        optimizer=str(optimizer),
        by=by,
        over=over,
        names=tuple(names[text] for text in order),
        options=tuple(order),
        units=tuple(units),
        runs=int(mine.sum()),
        without_answer=int(without[mine].sum()),
        left_out=tuple(names[text] for text in count.index[count < whole]),
        nested=nest(scored, 0 if default else None),
    )


def score_of(runs: pd.DataFrame, by: By) -> float:
    """Return the score of the one setting of `runs` on all its instances; NaN where it has none."""
    rows = runs.reset_index(drop=True)
    if by == "value" and (~np.isfinite(answers(rows)) | (rows["status"] == "failed").to_numpy()).any():
        return float("nan")
    paid, won, _ = _scores(rows, by)
    if by == "goal":
        return float(np.log10(paid.sum() / won.sum())) if won.any() else float("nan")
    return float(pd.Series(paid).groupby([rows[name] for name in PROBLEM]).mean().mean())


def _check(optimizer: str, rows: pd.DataFrame, settings: int, units: int, over: Over) -> None:
    """Raise `ValueError` where the runs are under several settings, or are too few to choose on."""
    for _, mine in rows.groupby(PROBLEM, sort=False):
        for column in SETTING:
            values = mine[column].drop_duplicates().tolist()
            if len(values) > 1:
                texts = ", ".join(setting_text(column, value) for value in values)
                which = f"{column}={values[0]}" if column != "target" else "one study for each target="
                raise ValueError(
                    f"{mine['problem'].iloc[0]}: ran with {texts}; a setting is chosen under one of them, such as "
                    f"{which}"
                )
    if settings < 2:
        raise ValueError(f"{optimizer}: has one setting here; sweep an option: bench run -m optimizer.OPTION=A,B,C ...")
    if units >= FEWEST:
        return
    if over == "seeds":
        raise ValueError(
            f"{counted(units, 'seed')}: at least {FEWEST} are needed; run the same sweep with seeds={FEWEST} or more"
        )
    many = rows["repetition"].nunique()
    more = "over=seeds nests over" if many >= FEWEST else f"seeds={FEWEST} or more and over=seeds nest over"
    raise ValueError(
        f"{counted(units, 'instance')}: nothing can be said about other instances from fewer than {FEWEST}; a seed is "
        f"no instance: sweep an option that makes more, such as problem.instance='range(1,{2 * FEWEST + 1})'; or {more}"
        " seeds, which speaks of these instances alone"
    )


def _is_default(optimizer: str, text: str, held: Mapping[str, Any], swept: Sequence[str]) -> bool:
    """Tell whether a setting has the declared default of every option that is swept, as far as that is known."""
    if optimizer in optimizers.registry:
        return not set(chosen_options(optimizers.registry, optimizer, json.loads(text))) & set(swept)
    try:
        with names_of_files(leaves_out="which setting is its default"):
            options = optimizers.registry.options(optimizer)
        plainly = {key: plain(option.default) for key, option in options.items() if not option.required}
    except (Exception, SystemExit):  # whatever its module raises
        return False
    declared = {key: canonical({"": value}) for key, value in parts(plainly, classes=False).items()}
    return bool(declared) and all(canonical({"": held.get(key)}) == declared.get(key) for key in swept)


def _scores(rows: pd.DataFrame, by: By) -> tuple[Array, Array, Flags]:
    """Return of each run what it paid, what it won, and whether it has no answer; the less it pays, the better.

    ``goal``: all that it was charged until the goal or in vain. ``value``: the log10 gap above the declared minimum, or
    where none is declared the value itself (never what is above the best of the sweep: one setting's luck would move
    the score of all). Values below the goal are tied. A run without an answer counts as a decade worse than the worst.
    """
    values, goals = answers(rows), goals_of(rows)
    without: Flags = np.asarray(~np.isfinite(values) | (rows["status"] == "failed").to_numpy())
    if by == "goal":
        if np.isnan(goals).any():
            nameless = rows["problem"][np.isnan(goals)].iloc[0]
            raise ValueError(f"{nameless}: has no goal; give target=, or by=value")
        hits = goal_hits(rows)
        won = np.isfinite(hits)
        return np.where(won, hits, rows["charged"].to_numpy(dtype=float)), won.astype(float), without
    logs = np.full(len(rows), np.nan)
    known = {tuple(row[:3]): (float(row[3]), bool(row[4])) for row in references(rows).itertuples(index=False)}
    for named, mine in rows.groupby(PROBLEM, sort=False):
        key, at = tuple(named), mine.index.to_numpy()
        minimum, declared = known[key]
        least = minimum if declared else 0.0
        some = at[~without[at]]
        if not len(some):
            raise ValueError(f"{key[0]}: no run on one of its instances has an answer; bench status tells why")
        if not declared and (values[some] <= 0).any():
            raise ValueError(
                f"{key[0]}: declares no minimum that holds and has values of 0 or below, so a log10 gap is not known; "
                "by=goal, or declare `minimum`"
            )
        level = goals[at[0]]
        floor = max(level - least if level == level else 0.0, float(np.spacing(abs(least))) / 2, _LEAST)
        logs[some] = np.log10(np.maximum(values[some] - least, floor))
        logs[at[without[at]]] = logs[some].max() + _FAILED
    return logs, np.ones(len(rows)), without
