"""The choice of one setting of a method from a sweep, and its value on units that had no part in the choice.

A unit is an instance (a problem with its options and data) or, weaker, a seed. Two scores, the smaller the better:

- ``value``: the mean of log10 gap over the runs of an instance, then over instances. The gap is the answer's value
  above the declared minimum; of a problem that declares none, the value itself, which must be above 0 (never what is
  above the best of the sweep: then one setting's luck would move the score of all). Values below the goal are tied. A
  run without an answer counts as a decade worse than the worst one on its instance, of any setting: were it as good as
  that one, a setting that always fails would be tied with one that never does.
- ``goal``: log10 ERT of the goal, all that the runs were charged until they reached it or in vain, over those that did.

The best score of a sweep is optimistic: the setting was chosen as it did well on just these units. So each unit is left
out once; the setting that is best on the rest is scored on it, and these scores together are the nested score: what the
act of choosing is worth on a unit that had no part in it, with one unit fewer to choose on. Optimism is the nested
score less the apparent one, gain the default's score less the nested one.

Intervals: units are drawn with replacement, and in each resample all of the nested selection is done again, with every
copy of a unit left out together, so that the interval knows that the choice itself could have been another. Folds share
most of their units; an interval from the spread of the folds alone is too narrow. Quantiles are those at which an
interval of a mean has its t-distributed width with so few units.
Sources: Stone, J. R. Stat. Soc. B 36 (1974); Varma and Simon, BMC Bioinformatics 7:91 (2006); Hesterberg, The American
Statistician 69 (2015), section 4 (expanded percentiles).
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, final, get_args

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from calibench import optimizers
from calibench.bench.provenance.run_id import canonical, chosen_options, plain
from calibench.bench.statistics.cells import PROBLEM, SETTING, answers
from calibench.bench.statistics.names import in_order, problem_titles, setting_text
from calibench.bench.statistics.summary import goal, goal_hits, option_text
from calibench.bench.statistics.targets import references
from calibench.bench.store.columns import parts
from calibench.core.options import suggest
from calibench.core.registry import names_of_files
from calibench.core.words import counted

Array = NDArray[np.float64]
By = Literal["value", "goal"]
Over = Literal["instances", "seeds"]
_LEAST = 1e-16  # the gap below which values are tied, where neither a goal nor the minimum says so
_FAILED = 1.0  # decades above the worst answer of an instance, for a run without one
FEWEST = 6  # units: of 5 the sign of every one of them has a two-sided p of 1/16, above 5 %
RESAMPLES = 1999
LEVEL = 0.95
_SEED = (2008, 0x4E455354)
_AT_ONCE = 4_000_000  # numbers held of some resamples


@final
@dataclass(frozen=True)
class Scored:
    """The costs of settings on units: `paid` and `won`, shapes (settings, units); a smaller score is better.

    A score is ``sum(paid) / sum(won)``: a mean, where `won` is 1; with `log` its log10: for an ERT, `paid` is what the
    runs were charged and `won` how many reached the goal.
    """

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

    `chosen`, shape (units,), is the setting that was chosen with each unit left out. `default` is None, and `gain` with
    its interval NaN, where the sweep does not hold the default.
    """

    scores: Array
    best: int
    apparent: float
    nested: float
    optimism: float
    optimism_interval: tuple[float, float]
    chosen: NDArray[np.int64]
    default: int | None
    gain: float
    gain_interval: tuple[float, float]

    @property
    def beats_default(self) -> bool:
        """Tell whether the interval of the gain is above 0."""
        return self.gain_interval[0] > 0


def nest(scored: Scored, default: int | None, resamples: int = RESAMPLES) -> Nested:
    """Return what choosing a setting is worth; of settings that are alike the first is chosen.

    Raises `ValueError` for fewer than two settings or `FEWEST` units.
    """
    settings, units = scored.paid.shape
    if settings < 2 or units < FEWEST:
        raise ValueError(f"{settings} settings on {units} units: 2 settings and {FEWEST} units are needed")
    apparent, nested, gain, chosen = _once(scored, np.ones((1, units)), default)
    scores = scored.of(scored.paid.sum(axis=1), scored.won.sum(axis=1))
    optimism, more = _intervals(scored, default, resamples)
    return Nested(
        scores=scores,
        best=int(np.argmin(scores)),
        apparent=float(apparent[0]),
        nested=float(nested[0]),
        optimism=float(_less(nested, apparent)[0]),
        optimism_interval=optimism,
        chosen=chosen[0],
        default=default,
        gain=float(gain[0]),
        gain_interval=more,
    )


def _once(scored: Scored, weight: Array, default: int | None) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """Return apparent, nested, gain, shapes (resamples,), and what was chosen, shape (resamples, units).

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
    gain = np.full(len(weight), np.nan) if default is None else _less(scores[:, default], nested)
    return scores.min(axis=1), nested, gain, chosen


def _less(a: Array, b: Array) -> Array:
    """Return a - b; NaN where both are infinite."""
    with np.errstate(invalid="ignore"):
        return a - b


def _intervals(scored: Scored, default: int | None, resamples: int) -> tuple[tuple[float, float], tuple[float, float]]:
    settings, units = scored.paid.shape
    rng = np.random.default_rng(np.random.SeedSequence([*_SEED, units]))
    drawn = rng.multinomial(units, np.full(units, 1 / units), size=resamples).astype(float)
    drawn = drawn[(drawn > 0).sum(axis=1) > 1]  # one unit alone leaves nothing to choose on
    each = max(1, _AT_ONCE // (settings * units))
    optimism, gain = [], []
    for first in range(0, len(drawn), each):
        apparent, nested, more, _ = _once(scored, drawn[first : first + each], default)
        optimism.append(_less(nested, apparent))
        gain.append(more)
    none = (float("nan"), float("nan"))
    return _ends(np.concatenate(optimism), units), none if default is None else _ends(np.concatenate(gain), units)


def _ends(values: Array, units: int) -> tuple[float, float]:
    """Return the expanded percentiles of resampled values, shape (resamples,); one that is not known widens both."""
    from scipy.stats import norm, t

    reach = np.sqrt(units / (units - 1)) * t.ppf((1 + LEVEL) / 2, units - 1)
    tail = float(norm.sf(reach))
    first = int(np.floor(tail * (len(values) - 1)))
    low = np.sort(np.where(np.isnan(values), -np.inf, values))[first]
    high = np.sort(np.where(np.isnan(values), np.inf, values))[len(values) - 1 - first]
    return float(low), float(high)


NEEDED = [
    "run_id", "repetition", *PROBLEM, "optimizer", "optimizer_options", *SETTING, "targets", "status", "minimum",
    "best_value", "inside_box", "judged_value", "judged_evaluations", "hits_charged", "charged", "tampering",
]  # fmt: skip  # columns of runs


@final
@dataclass(frozen=True)
class Chosen:
    """What choosing a setting of `optimizer` is worth: `names` of settings and `units`, in the order of `nested`.

    `options` are those of each setting as JSON. `left_out` names settings that lack a unit.
    """

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
    """Return what choosing a setting is worth, of `runs` (columns `NEEDED`) of one optimiser.

    Raises `ValueError` in one line, with the way out, where that cannot be told.
    """
    for given, known, word in ((by, get_args(By), "by"), (over, get_args(Over), "over")):
        if given not in known:
            raise ValueError(f"{word}={given}: {suggest(given, known)}")
    [optimizer] = runs["optimizer"].unique()
    _check_one_setting(runs)
    rows = runs.reset_index(drop=True)
    names = _names(optimizer, rows["optimizer_options"].unique())
    if len(names) < 2:
        raise ValueError(f"{optimizer}: has one setting here; sweep an option: bench run -m optimizer.OPTION=A,B,C ...")
    unit = problem_titles(rows) if over == "instances" else "seed " + rows["repetition"].astype(str)
    units = sorted(set(unit), key=in_order)
    _check_units(len(units), rows, over)
    paid, won, without = _scores(rows, by)
    kept, left_out = _complete(rows, unit, names, over)
    default = [text for text in kept if _is_default(optimizer, text, list(names))]
    # the default first: of those that are alike the first is chosen
    order = sorted(
        (text for text in names if text in kept), key=lambda text: (text not in default, in_order(names[text]))
    )
    if len(order) < 2:
        raise ValueError(
            f"{optimizer}: fewer than two settings ran on all of {counted(len(units), over[:-1])}; the same bench run "
            "goes on with what is left"
        )
    place = {text: i for i, text in enumerate(order)}
    mine = rows["optimizer_options"].isin(place).to_numpy()
    at = rows["optimizer_options"][mine].map(place).to_numpy(), unit[mine].map(units.index).to_numpy()
    shape = len(order), len(units)
    sums = [np.zeros(shape) for _ in range(3)]
    for table, values in zip(sums, (paid, won, np.ones(len(rows))), strict=True):
        np.add.at(table, at, values[mine])
    scored = Scored(sums[0] / sums[2], np.ones(shape), False) if by == "value" else Scored(sums[0], sums[1], True)
    if by == "goal" and not sums[1].any():
        raise ValueError(f"{optimizer}: no run reached the goal; an easier target=, or by=value")
    return Chosen(
        optimizer=str(optimizer),
        by=by,
        over=over,
        names=tuple(names[text] for text in order),
        options=tuple(order),
        units=tuple(units),
        runs=int(mine.sum()),
        without_answer=int(without[mine].sum()),
        left_out=left_out,
        nested=nest(scored, 0 if default else None),
    )


def score_of(runs: pd.DataFrame, by: By) -> float:
    """Return the score of the one setting of `runs` on all its instances; NaN where it has none."""
    rows = runs.reset_index(drop=True)
    if by == "value" and _without_answer(rows).any():
        return float("nan")
    paid, won, _ = _scores(rows, by)
    if by == "goal":
        return float(np.log10(paid.sum() / won.sum())) if won.any() else float("nan")
    return float(pd.Series(paid).groupby([rows[name] for name in PROBLEM]).mean().mean())


def default_of(optimizer: str, option: str) -> Any:
    """Return the declared default of an option. Raises `ValueError` for one that is not declared."""
    return optimizers.registry.option(optimizer, option).default


def _check_one_setting(runs: pd.DataFrame) -> None:
    for _, mine in runs.groupby(PROBLEM, sort=False):
        for column in SETTING:
            values = mine[column].drop_duplicates().tolist()
            if len(values) > 1:
                settings = ", ".join(setting_text(column, value) for value in values)
                which = f"{column}={values[0]}" if column != "target" else "one study for each target="
                raise ValueError(
                    f"{mine['problem'].iloc[0]}: ran with {settings}; a setting is chosen under one of them, such as "
                    f"{which}"
                )


def _check_units(units: int, rows: pd.DataFrame, over: Over) -> None:
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


def _names(optimizer: str, texts: Iterable[str]) -> dict[str, str]:
    """Return options as JSON -> what the setting is called: the options in which settings differ."""
    read = {text: parts(json.loads(text), classes=False) for text in texts}
    swept = _swept(list(read))
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
    return names


def _swept(texts: list[str]) -> list[str]:
    read = [parts(json.loads(text), classes=False) for text in texts]
    keys = dict.fromkeys(key for held in read for key in held)
    return [key for key in keys if len({canonical({"": held.get(key)}) for held in read}) > 1]


def _is_default(optimizer: str, text: str, texts: list[str]) -> bool:
    """Tell whether a setting has the declared default of every option that is swept."""
    if optimizer not in optimizers.registry:
        held, declared = parts(json.loads(text), classes=False), _own_defaults(optimizer)
        return bool(declared) and all(canonical({"": held.get(k)}) == declared.get(k) for k in _swept(texts))
    chosen = chosen_options(optimizers.registry, optimizer, json.loads(text))
    return not set(chosen) & set(_swept(texts))


def _own_defaults(optimizer: str) -> dict[str, str]:
    """Return the defaults of a class of somebody's own, as JSON; nothing where it is not here, or not imported."""
    try:
        with names_of_files(leaves_out="which setting is its default"):
            declared = optimizers.registry.options(optimizer)
        plainly = {key: plain(option.default) for key, option in declared.items() if not option.required}
    except (Exception, SystemExit):  # whatever its module raises
        return {}
    return {key: canonical({"": value}) for key, value in parts(plainly, classes=False).items()}


def _complete(
    rows: pd.DataFrame, unit: pd.Series, names: dict[str, str], over: Over
) -> tuple[set[str], tuple[str, ...]]:
    """Return the settings that ran on every unit (over seeds: on every instance with each), and who did not."""
    parts = [unit] if over == "instances" else [unit, problem_titles(rows)]
    pairs = pd.concat([rows["optimizer_options"], *parts], axis=1, keys=range(1 + len(parts))).drop_duplicates()
    whole = len(pairs.drop(columns=0).drop_duplicates())
    count = pairs.groupby(0).size()
    return set(count.index[count == whole]), tuple(names[text] for text in count.index[count < whole])


def _without_answer(rows: pd.DataFrame) -> NDArray[np.bool_]:
    return np.asarray(~np.isfinite(answers(rows)) | (rows["status"] == "failed").to_numpy())


def _scores(rows: pd.DataFrame, by: By) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return of each run what it paid, what it won, and whether it has no answer."""
    values, without = answers(rows), _without_answer(rows)
    goals = np.array([goal(t, levels) for t, levels in zip(rows["target"], rows["targets"], strict=True)])
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
