"""What each threshold of the search costs: ``python -m benchmarks thresholds --cases 500 [--names close,matters]``.

Every threshold is set to half and to twice its value, one at a time, and the same blind cases are searched again. A
line tells in how many cases some decision of the search was another one, how many verdicts or names changed, and the
rates that the search is judged by. (Of a part near 1, such as .97, what is left to 1 is halved and doubled.)

A case is searched again only from the first decision that differs, and not at all at values at which none does
(`alternatives`); ``--verify 300`` searches a random 300 of all cases and values from the start, and tells how many
answers are not the same. ``--answers FILE`` keeps the answers of each case as it is done: the same command goes on.
``--again 100`` searches the first 100 cases again, and of the others counts the decisions: little more than one search.
"""

from __future__ import annotations

import argparse
import json
import random
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, final

from benchmarks.blind.claims import first_right, in_sets, named_set, true_names
from benchmarks.blind.gpm2002.simulate import case
from benchmarks.thresholds.alternatives import answers, decisions

_FACTORS = (0.5, 2.0)
_HEAD = ("threshold", "value", "at", "decided otherwise", "changed", "alarms on nothing", "truth in the set",
         "first name right", "unknown outside the catalogue", "mean set", "meaning", "chosen")  # fmt: skip
_VERIFIED = 20261123  # seed of the pairs of a case and a value that are searched from the start

Key = tuple[str, float]


@final
@dataclass(frozen=True)
class Told:
    """What one search said of one case, and what was true: all that the rates are made of."""

    kind: str
    verdict: str
    sets: tuple[tuple[tuple[str, str], ...], ...]
    inside: bool
    first: bool


@final
@dataclass(frozen=True)
class Rates:
    """Rates over all cases; None where no case tells one. `changed`: cases told otherwise than by the defaults."""

    changed: int
    alarms: float | None
    inside: float | None
    first: float | None
    unknown: float | None
    size: float | None


@final
@dataclass(frozen=True)
class Case:
    """One case: `otherwise` has the values at which a decision differs, `others` what was told otherwise at them.

    `others` is None where the case was not searched again.
    """

    seed: int
    plain: Told
    otherwise: tuple[Key, ...]
    others: dict[Key, Told] | None


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table that the command line asks for, or write it to a file."""
    from calibench.discrepancy.thresholds import about

    parser = argparse.ArgumentParser(prog="python -m benchmarks thresholds", description=__doc__)
    parser.add_argument("--cases", type=int, default=500, help="how many blind cases are searched at each value")
    parser.add_argument("--first", type=int, default=900_000, help="seed of the first of them")
    parser.add_argument("--names", default="", help="thresholds, with commas; all by default")
    parser.add_argument("--again", type=int, help="so many of them, the first, are searched again; all by default")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--answers", type=Path, help="file that keeps the answers, a case a line: go on with it")
    parser.add_argument(
        "--verify", type=int, default=0, help="so many cases and values, drawn, searched from the start"
    )
    parser.add_argument("--to", type=Path, help="file for the table, Markdown")
    asked = parser.parse_args(arguments)
    names = [name for name in asked.names.split(",") if name] or list(about())
    if unknown := sorted(set(names) - set(about())):
        parser.error(f"{', '.join(unknown)}: no threshold; choices: {', '.join(about())}")
    seeds = range(asked.first, asked.first + asked.cases)
    cases = list(searched(names, seeds, asked.workers, asked.answers, again=asked.again))
    lines = [_line(cells) for cells in (head(cases), ["---"] * len(_HEAD), *rows(names, cases))]
    print("\n".join(lines))
    if asked.to:
        asked.to.write_text("\n".join(lines) + "\n", encoding="utf-8")
    if asked.verify:
        print(verified(names, cases, asked.verify))


def head(cases: Sequence[Case]) -> tuple[str, ...]:
    """Return the names of the columns, with how many cases the counts are of."""
    again = sum(one.others is not None for one in cases)
    of = {"decided otherwise": f" (of {len(cases)})", "changed": f" (of {again})"}
    return tuple(name + of.get(name, "") for name in _HEAD)


def rows(names: Sequence[str], cases: Sequence[Case]) -> Iterator[tuple[str, ...]]:
    """Yield a line for the defaults, and one for each value of each threshold: rates of the cases searched again."""
    from calibench.discrepancy.thresholds import about

    again = [(one.plain, one.others) for one in cases if one.others is not None]
    plain = [told for told, _ in again]
    yield ("defaults", "", "", "", *_cells(rates(plain, plain)), "", "")
    for name, value in _keys(names):
        stated = about()[name]
        key = (name, value)
        otherwise = sum(key in one.otherwise for one in cases)
        cells = _cells(rates([others.get(key, told) for told, others in again], plain))
        meaning = f"{stated.metadata['meaning']} [{stated.metadata['unit']}]"
        yield (name, f"{stated.default:g}", f"{value:g}", str(otherwise), *cells, meaning, stated.metadata["chosen"])


def searched(
    names: Sequence[str], seeds: Sequence[int], workers: int = 1, kept: Path | None = None, again: int | None = None
) -> Iterator[Case]:
    """Yield each case, in order, the first `again` (all without it) searched again; from the file those which it has.

    Raises ValueError for a file of other thresholds.
    """
    done = _read(kept, names) if kept else {}
    most = len(seeds) if again is None else again
    wanted = dict(zip(seeds, [True] * most + [False] * len(seeds), strict=False))
    left = [s for s in seeds if s not in done or (wanted[s] and done[s].others is None)]
    one = partial(_case, names=tuple(names))
    with ProcessPoolExecutor(workers) if workers > 1 else nullcontext() as pool:
        fresh = (pool.map if pool else map)(one, left, [wanted[s] for s in left])
        for seed in seeds:
            if seed in left:
                done[seed] = next(fresh)
                if kept:
                    _write(kept, done[seed], names)
            yield done[seed]


def verified(names: Sequence[str], cases: Sequence[Case], draws: int) -> str:
    """Search so many pairs of a case and a value from the start, and say how many answers are not those of `cases`.

    Of a case that was not searched again, only values at which no decision differs are drawn.
    """
    pairs = [(one, key) for one in cases for key in _keys(names) if one.others is not None or key not in one.otherwise]
    drawn = random.Random(_VERIFIED).sample(pairs, min(draws, len(pairs)))
    same = sum(key not in one.otherwise for one, key in drawn)
    wrong = [
        f"{one.seed} at {key[0]} = {key[1]:g}"
        for one, key in drawn
        if search(one.seed, {key[0]: key[1]}) != (one.others or {}).get(key, one.plain)
    ]
    return (
        f"{len(drawn)} searches from the start, of which {same} had no decision that differed: "
        f"{len(wrong)} answers differ{': ' if wrong else ''}{', '.join(wrong)}"
    )


def scaled(value: float, factor: float) -> float:
    """Return `factor` times the value of a threshold, whole where it is; of a part near 1, of what is left to 1.

    >>> scaled(6.0, 0.5), scaled(3, 0.5), scaled(0.9, 2.0)
    (3.0, 2, 0.8)
    """
    if isinstance(value, int):
        return max(1, round(value * factor))
    return round(1 - (1 - value) * factor, 12) if 0.5 < value < 1 else value * factor


def rates(told: Sequence[Told], plain: Sequence[Told]) -> Rates:
    """Return the rates over all cases, and how many are told otherwise than in `plain`."""
    known = [t for t in told if t.kind in ("one", "two")]
    sizes = [len(one) for t in known for one in t.sets]
    return Rates(
        changed=sum((a.verdict, a.sets) != (b.verdict, b.sets) for a, b in zip(told, plain, strict=True)),
        alarms=_part([t.verdict != "none" for t in told if t.kind == "none"]),
        inside=_part([t.inside for t in known]),
        first=_part([t.first for t in known if t.sets]),
        unknown=_part([t.verdict == "unknown" for t in told if t.kind == "outside"]),
        size=sum(sizes) / len(sizes) if sizes else None,
    )


def _keys(names: Sequence[str]) -> list[Key]:
    from calibench.discrepancy.thresholds import about

    values = {name: about()[name].default for name in names}
    pairs = [(name, scaled(value, factor)) for name, value in values.items() for factor in _FACTORS]
    return [(name, value) for name, value in pairs if value != values[name]]


def _case(seed: int, again: bool, names: Sequence[str]) -> Case:
    from calibench.discrepancy.thresholds import about

    others: dict[str, tuple[float, ...]] = {}
    for name, value in _keys(names):
        others[name] = (*others.get(name, ()), value)
    plain = {name: about()[name].default for name in names}
    if not again:
        return Case(seed, *decisions(partial(search, seed), plain, others), None)
    found = answers(partial(search, seed), plain, others)
    differing = {key: told for key, told in found.others.items() if told != found.plain}
    return Case(seed, found.plain, tuple(sorted(found.others)), differing)


def search(seed: int, changes: Mapping[str, Any]) -> Told:
    """Search the blind case of a seed with some thresholds changed, and keep what the rates are made of."""
    from calibench.discrepancy import DataError, MeasuredData, explain
    from calibench.discrepancy.thresholds import THRESHOLDS

    hidden = case(seed)
    data = MeasuredData(hidden.columns, "gpm2002", hidden.metadata, f"case_{seed}")
    report: Mapping[str, Any] = {"verdict": "refused", "findings": []}
    try:
        report = explain("gpm2002", data, thresholds=replace(THRESHOLDS, **changes)).to_dict()
    except DataError:
        pass
    true = true_names(hidden.truth)
    return Told(
        kind=str(hidden.truth["kind"]),
        verdict=str(report["verdict"]),
        sets=tuple(tuple(named_set(finding)) for finding in report["findings"]),
        inside=bool(true) and all(in_sets(name, report, lenient=True) for name in true),
        first=bool(true) and any(first_right(name, report, lenient=True) for name in true),
    )


def _part(hits: Sequence[bool]) -> float | None:
    return sum(hits) / len(hits) if hits else None


def _cells(found: Rates) -> tuple[str, ...]:
    parts = (found.alarms, found.inside, found.first, found.unknown)
    size = "" if found.size is None else f"{found.size:.2f}"
    return (str(found.changed), *("" if part is None else f"{100 * part:.1f} %" for part in parts), size)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _write(kept: Path, one: Case, names: Sequence[str]) -> None:
    line = {
        "seed": one.seed, "thresholds": list(names), "plain": asdict(one.plain), "otherwise": one.otherwise,
        "others": None if one.others is None else [(*key, asdict(told)) for key, told in one.others.items()],
    }  # fmt: skip
    with kept.open("a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")


def _read(kept: Path, names: Sequence[str]) -> dict[int, Case]:
    found = {}
    for line in kept.read_text(encoding="utf-8").splitlines() if kept.exists() else ():
        case_ = json.loads(line)
        if case_["thresholds"] != list(names):
            raise ValueError(f"{kept}: answers of other thresholds; give another file")
        read = case_["others"]
        others = None if read is None else {(name, value): _told(told) for name, value, told in read}
        otherwise = tuple((name, value) for name, value in case_["otherwise"])
        found[case_["seed"]] = Case(case_["seed"], _told(case_["plain"]), otherwise, others)
    return found


def _told(read: Mapping[str, Any]) -> Told:
    sets = tuple(tuple((family, target) for family, target in one) for one in read["sets"])
    return Told(**{**read, "sets": sets})
