"""The bars, on fresh blind cases: minutes long, so in the slow suite.

A rate reaches its bar where the bar lies inside its 95 % interval or on the safe side of it. Medians and means of fewer
than ten cases say nothing and are left to longer runs (`docs/discovery-statistics.md`); seconds are left to benchmarks.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pytest

from benchmarks.blind import laws
from benchmarks.blind.claims import Name, named_set
from benchmarks.blind.gpm2002.simulate import Case, case
from benchmarks.blind.score import Pair, Row, score, table
from calibench.discrepancy import MeasuredData, explain

pytestmark = pytest.mark.slow
_FEW = 10


def _pairs(cases: Iterable[Case]) -> list[Pair]:
    pairs = []
    for blind in cases:
        data = MeasuredData(blind.columns, "gpm2002", blind.metadata, f"case_{blind.truth['seed']}")
        pairs.append((explain("gpm2002", data).to_dict(), blind.truth))
    return pairs


def _missed(rows: Iterable[Row]) -> list[str]:
    judged = [row for row in rows if row.bar and row.n >= _FEW and not row.what.startswith("seconds")]
    print(table(judged))
    return [f"{row.what} ({row.data}): {row.value}, {row.bar}" for row in judged if row.reached is False]


def test_all_bars_are_reached_on_fresh_cases() -> None:
    missed = _missed(score(_pairs(case(seed) for seed in range(70_000, 70_400))))
    assert not missed, missed


@pytest.mark.parametrize(("noise", "cases"), [("gauss", 200), ("t3", 60), ("ar1", 60)])
def test_alarms_on_nothing_hold_their_level(noise: str, cases: int) -> None:
    empty = (case(seed, kind="none", noise=noise) for seed in range(80_000, 80_000 + cases))  # type: ignore[arg-type]
    missed = _missed(row for row in score(_pairs(empty)) if row.what == f"alarm on nothing, {noise}")
    assert not missed, missed


def _verdict(blind: Case, labels: Sequence[int] = (1, 2, 3)) -> tuple[str, set[frozenset[Name]]]:
    """Return the verdict and its sets, each target under the label that it had as leg `labels[k]`."""
    [(report, _)] = _pairs([blind])
    old = {str(new): str(was) for new, was in enumerate(labels, start=1)}
    sets = {frozenset((family, old.get(target, target)) for family, target in named_set(f)) for f in report["findings"]}
    return report["verdict"], sets


def test_verdicts_follow_labels_frame_clock_and_order() -> None:
    for seed in range(71_000, 71_030):
        blind = case(seed)
        here = _verdict(blind)
        for other in (
            laws.rotated(blind, 0.7, (30.0, -12.0)),
            laws.delayed(blind, 1000.0),
            laws.repeats_permuted(blind, 3),
            laws.rows_shuffled(blind, 2),
        ):
            assert _verdict(other) == here, seed
        assert _verdict(laws.relabelled(blind, [2, 3, 1]), [2, 3, 1]) == here, seed
