"""The bars, on fresh sealed cases: minutes long, so in the slow suite. Each rate's 95 % interval must reach its bar."""

from __future__ import annotations

import pytest

from discrepancy import MeasuredData, explain
from tests.sealed.score import score, table
from tests.sealed.simulate import case

pytestmark = pytest.mark.slow
_CASES = 600


def test_all_bars_are_reached_on_fresh_cases() -> None:
    pairs = []
    for seed in range(70_000, 70_000 + _CASES):
        sealed = case(seed)
        report = explain("gpm2002", MeasuredData(sealed.columns, "gpm2002", sealed.metadata, f"case_{seed}"))
        pairs.append((report.to_dict(), sealed.truth))
    rows = score(pairs)
    print(table([row for row in rows if row.bar]))
    missed = [
        f"{row.what} ({row.data}): {row.value}" for row in rows if row.reached is False and "strict" not in row.what
    ]
    assert not missed, missed


@pytest.mark.parametrize(("noise", "cases", "bar"), [("gauss", 1000, 0.015), ("t3", 300, 0.03), ("ar1", 300, 0.03)])
def test_alarms_on_nothing_hold_their_level(noise: str, cases: int, bar: float) -> None:
    alarms = 0
    for seed in range(80_000, 80_000 + cases):
        sealed = case(seed, kind="none", noise=noise)  # type: ignore[arg-type]
        report = explain("gpm2002", MeasuredData(sealed.columns, "gpm2002", sealed.metadata, f"case_{seed}"))
        alarms += report.verdict != "none"
    assert alarms <= bar * cases + 2 * (bar * cases) ** 0.5
