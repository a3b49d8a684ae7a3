"""A reading that was misread ends no search of an own machine: it is left out and told; what a machine does is kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from calibench.discrepancy import Constraints, Joint, MeasuredData, Predicted, Roles, explain
from calibench.discrepancy.checks.wild import without_wild
from calibench.problems.base import Parameter
from tests.few import few

pytestmark = pytest.mark.usefixtures("at_one_noise")

NOISE, ROWS = 0.003, 120
PARAMETERS = (Parameter("zero", "mm", 0.0, -5.0, 5.0), Parameter("gain", "1", 1.0, 0.9, 1.1))
ROLES = Roles(joints=(Joint("rail", "s", "sliding", direction="side", period=10.0),), time="t_s")


def _laser(q):
    return q["zero"] + q["gain"] * q["s"]


@dataclass(frozen=True)
class Rail:
    """A rail and a laser; `noise` of the laser, None: nobody states it."""

    noise: float | None = NOISE
    name: str = "own rail"

    def formulate(self, data: MeasuredData) -> Predicted:
        return Predicted(data, _laser, PARAMETERS, {"laser": self.noise}, inputs=("s",), roles=ROLES)


@dataclass(frozen=True)
class Closed:
    """The same rail as a closure, whose scale is noisy too."""

    name: str = "own closed rail"

    def formulate(self, data: MeasuredData) -> Constraints:
        return Constraints(
            data, lambda q: (q["laser"] - _laser(q))[:, None], PARAMETERS,
            noise={"laser": NOISE, "s": NOISE / 3}, roles=ROLES,
        )  # fmt: skip


def _readings(play: float = 0.0, wild: float = 0.0, rows: slice = slice(70, 71), noise: float = NOISE) -> MeasuredData:
    rng = np.random.default_rng(5)
    s, side = rng.uniform(0, 300, ROWS), rng.choice([-1.0, 1.0], ROWS)
    laser = 0.5 + s - play / 2 * side + noise * rng.normal(size=ROWS)
    laser[rows] += wild
    return MeasuredData({"s": s, "side": side, "laser": laser, "t_s": 10.0 * np.arange(ROWS)}, "own rail")


@pytest.mark.parametrize("machine", [Rail(), Rail(None), Closed()], ids=["stated", "unknown", "closure"])
@pytest.mark.parametrize("times", few(1, [20, 80, 600]))
def test_one_misread_row_is_left_out_and_told_and_the_cause_is_named(machine, times) -> None:
    report = explain(machine, _readings(0.02, times * NOISE))
    assert [f.effect for f in report.findings] == ["backlash rail"]
    [note] = [note for note in report.notes if "wild reading is left out" in note.text]
    assert f"{float(_readings(0.02, times * NOISE)['laser'][70]):.5g}"[:4] in note.text
    assert ": row 71, " in note.text
    clean = explain(machine, _readings(0.02).rows(np.arange(ROWS) != 70))
    assert report.findings[0].amplitude.value == pytest.approx(clean.findings[0].amplitude.value, rel=1e-6)


@pytest.mark.parametrize("machine", [Rail(), Rail(None), Closed()], ids=["stated", "unknown", "closure"])
def test_a_misread_row_is_no_cause(machine) -> None:
    assert explain(machine, _readings(wild=25 * NOISE)).verdict == "none"


def test_what_lies_no_further_than_others_is_kept() -> None:
    assert len(without_wild(Rail().formulate(_readings(wild=4 * NOISE)), isolated=True)) == ROWS
    bump = _readings()
    bump = bump.with_columns({"laser": bump["laser"] + 0.08 * np.exp(-(((bump["s"] - 150) / 12) ** 2))})
    assert len(without_wild(Rail().formulate(bump), isolated=True)) == ROWS


def test_the_end_of_a_trend_is_kept_and_a_misread_pair_beside_it_is_not() -> None:
    """A rail that warms up errs most in its first row."""
    warming = _readings()
    warming = warming.with_columns({"laser": warming["laser"] + 0.05 * np.exp(-np.arange(ROWS) / 3)})
    assert len(without_wild(Rail().formulate(warming))) == ROWS
    assert len(without_wild(Rail().formulate(_readings(wild=40 * NOISE, rows=slice(70, 72))))) == ROWS - 2


def test_what_a_repeat_confirms_is_kept() -> None:
    once = _readings(wild=40 * NOISE)
    twice = {name: np.repeat(value, 2) for name, value in once.columns.items()}
    twice |= {"pose_id": np.repeat(np.arange(ROWS), 2), "t_s": 10.0 * np.arange(2 * ROWS)}
    both = MeasuredData(twice, "own rail")
    assert len(without_wild(Rail().formulate(both), isolated=True)) == 2 * ROWS
    twice["laser"] = twice["laser"].copy()
    twice["laser"][140] -= 40 * NOISE
    kept = without_wild(Rail().formulate(MeasuredData(twice, "own rail")), isolated=True)
    assert len(kept) == 2 * ROWS - 1


def test_many_are_no_accidents_and_exact_readings_have_none() -> None:
    many = _readings(wild=40 * NOISE, rows=slice(0, 120, 20))
    assert len(without_wild(Rail().formulate(many), isolated=True)) == ROWS
    exact = _readings(noise=0.0)
    exact = exact.with_columns({"laser": exact["laser"] + np.where(np.arange(ROWS) > 117, 0.01, 0.0)})
    assert len(without_wild(Rail().formulate(exact), isolated=True)) == ROWS


def test_rows_are_told_as_the_file_counts_them() -> None:
    """Row 5 is marked valid=0, time runs backwards, and a reading has lost its comma: that is row 31 all the same."""
    readings = _readings(0.02)
    columns = {name: np.asarray(readings[name])[::-1].copy() for name in readings.columns}
    columns["valid"] = np.ones(ROWS)
    columns["valid"][4] = 0
    columns["laser"][30] *= 1000
    notes = explain(Rail(), MeasuredData(columns, "own rail")).notes
    assert [note for note in notes if note.text.startswith("row 31 left out")], notes


def test_many_rows_are_named_in_short() -> None:
    data = MeasuredData({"s": np.arange(100.0)}, "own rail").rows(np.arange(10, 100))
    assert data.rows_named(np.array([0])) == "row 11"
    assert data.rows_named(np.arange(90) % 10 == 3) == "rows 14, 24, 34, 44, 54, 64 and 3 more"
