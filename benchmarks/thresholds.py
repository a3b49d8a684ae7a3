"""What each threshold of the search costs: ``python -m benchmarks thresholds --cases 500 [--names close,matters]``.

Every threshold is set to half and to twice its value, one at a time, and the same blind cases are searched again. A
line tells how many verdicts or names changed, and the rates that the search is judged by. One that changes nothing on
many cases is one to take out. (Of a part near 1, such as .97, what is left to 1 is halved and doubled.) One case takes
about a second for each of the 2 x 76 values: name some, or let it run over night with --workers.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, final

from benchmarks.blind.claims import first_right, in_sets, named_set, true_names
from benchmarks.blind.gpm2002.simulate import case

_FACTORS = (0.5, 2.0)
_HEAD = ("threshold", "value", "at", "changed", "alarms on nothing", "truth in the set", "first name right",
         "unknown outside the catalogue", "mean set", "meaning", "chosen")  # fmt: skip


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


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table that the command line asks for, or write it to a file."""
    from calibench.discrepancy.thresholds import about

    parser = argparse.ArgumentParser(prog="python -m benchmarks thresholds", description=__doc__)
    parser.add_argument("--cases", type=int, default=500, help="how many blind cases are searched at each value")
    parser.add_argument("--first", type=int, default=900_000, help="seed of the first of them")
    parser.add_argument("--names", default="", help="thresholds, with commas; all by default")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--to", type=Path, help="file for the table, Markdown")
    asked = parser.parse_args(arguments)
    names = [name for name in asked.names.split(",") if name] or list(about())
    if unknown := sorted(set(names) - set(about())):
        parser.error(f"{', '.join(unknown)}: no threshold; choices: {', '.join(about())}")
    lines = [_line(_HEAD), _line(["---"] * len(_HEAD))]
    for row in rows(names, range(asked.first, asked.first + asked.cases), asked.workers):
        lines.append(_line(row))
        print(lines[-1], flush=True)
    if asked.to:
        asked.to.write_text("\n".join(lines) + "\n", encoding="utf-8")


def rows(names: Sequence[str], seeds: Sequence[int], workers: int = 1) -> Iterator[tuple[str, ...]]:
    """Yield a line for the defaults, and one for each value of each threshold."""
    from calibench.discrepancy.thresholds import about

    plain = _searched({}, seeds, workers)
    yield ("defaults", "", "", *_cells(rates(plain, plain)), "", "")
    for name in names:
        told = about()[name]
        for factor in _FACTORS:
            value = scaled(told.default, factor)
            if value != told.default:
                cells = _cells(rates(_searched({name: value}, seeds, workers), plain))
                meaning = f"{told.metadata['meaning']} [{told.metadata['unit']}]"
                yield (name, f"{told.default:g}", f"{value:g}", *cells, meaning, told.metadata["chosen"])


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


def _searched(changes: Mapping[str, float], seeds: Sequence[int], workers: int) -> list[Told]:
    one = partial(_search, changes=dict(changes))
    if workers == 1:
        return [one(seed) for seed in seeds]
    with ProcessPoolExecutor(workers) as pool:
        return list(pool.map(one, seeds, chunksize=8))


def _search(seed: int, changes: Mapping[str, float]) -> Told:
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


if __name__ == "__main__":
    main()
