"""Readings far off: trusted less and nothing more; no noise where something carries them; told by row in a burst."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.bench.discovery.page.words import gap_sentence, headline
from calibench.core.notes import Code
from calibench.discrepancy import MeasuredData, Report, explain
from calibench.discrepancy.diagnostics.far_readings import pattern_of, standing_rows
from calibench.discrepancy.model.measured import PLACE
from tests.discrepancy.arm import Arm, readings
from tests.discrepancy.test_repeats import _Gantry, _read_from_both_sides
from tests.few import few
from tests.independent.sound import five_bar

pytestmark = pytest.mark.usefixtures("without_formula")


def _rows(report: Report) -> set[int]:
    return {int(row) for note in report.notes if note.code is Code.ROWS_STAND_OUT for row in note.rows}


def test_to_trust_readings_less_closes_no_gap() -> None:
    report = explain(Arm(), readings(wild=0.06))
    assert report.verdict == "noise"
    assert report.gap.held_out_after == report.gap.held_out_before
    assert report.gap.train_after == report.gap.train_before
    assert report.to_dict()["gap"]["excess_shrink"] is None
    assert gap_sentence(report).endswith("these readings are trusted less; no error of the machine was corrected.")


def test_beside_noise_that_is_blamed_what_is_gone_is_what_names_explain() -> None:
    with_wild, without = (explain(_Gantry(), _read_from_both_sides(0.12, wild, 1, poses=80)) for wild in (8, 0))
    assert {f.family for f in with_wild.findings} == {"backlash", "outlier"}
    assert with_wild.gap.held_out_before <= 1.1 * without.gap.held_out_before  # not that of the wild ones as well
    assert with_wild.gap.held_out_after == pytest.approx(without.gap.held_out_after, rel=0.2)


@pytest.mark.parametrize(("rows", "seed"), [(1000, 43008), (3000, 43005)])
def test_repeats_that_return_to_a_place_beside_the_last_are_no_outliers(rows: int, seed: int) -> None:
    assert explain("gpm2002", five_bar(rows, seed, tracked=True, moved=0.03, repeats=2)).verdict == "none"


def test_wild_readings_show_beside_repeats_that_moved() -> None:
    data = five_bar(600, 1, tracked=True, moved=0.03, repeats=2)
    rng = np.random.default_rng(2)
    wild = 2e-3 * rng.normal(size=600) * (rng.random(600) < 0.04)
    report = explain("gpm2002", data.with_columns({"enc_2": data["enc_2"] + wild}))
    assert [f.effect for f in report.findings] == ["outlier joint 2"]


def test_far_readings_at_random_are_noise_and_at_a_time_or_a_place_they_are_not() -> None:
    m, said = 300, 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        columns = {PLACE: np.arange(m, dtype=float), "angle": rng.uniform(-1, 1, m), "side": rng.choice([-1.0, 1.0], m)}
        anywhere = (rng.random(m) < 0.05).astype(float)
        said += pattern_of("joint 1", anywhere, np.ones(m), columns) is not None
    assert said <= 1
    ground = rng.random(m) < 0.5
    crest = ((np.sin(columns[PLACE] / 8) > 0.9) & ground).astype(float)
    assert pattern_of("joint 1", crest, np.ones(m), columns).column == PLACE  # type: ignore[union-attr]
    there = ((columns["angle"] > 0.85) & ground).astype(float)
    assert pattern_of("joint 1", there, np.ones(m), columns).column == "angle"  # type: ignore[union-attr]
    one_side = ((columns["side"] > 0) & (rng.random(m) < 0.15)).astype(float)
    assert pattern_of("joint 1", one_side, np.ones(m), columns).column == "side"  # type: ignore[union-attr]


def test_where_an_error_is_seen_at_some_places_only_that_alone_carries_nothing() -> None:
    m, said = 300, 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        angle = rng.uniform(-1, 1, m)
        chance = np.where(angle > 0.5, 1.0, 0.02)
        seen = (rng.random(m) < 0.2 * chance).astype(float)
        said += pattern_of("joint 1", seen, chance, {PLACE: np.arange(m, dtype=float), "angle": angle}) is not None
    assert said <= 2


def test_wild_readings_at_one_part_of_the_way_are_something_missing() -> None:
    """As of a damaged track: no law of the noise, whose far readings may be anywhere."""
    data = readings()
    rng, angle = np.random.default_rng(3), np.asarray(data["enc_2"])
    there = angle > np.quantile(angle, 0.85)
    wild = 40 * 2e-5 * rng.normal(size=len(data)) * there * (rng.random(len(data)) < 0.5)
    report = explain(Arm(), data.with_columns({"enc_2": angle + wild}))
    assert report.verdict == "unknown"
    assert "outlier" not in {f.family for f in report.findings}
    assert any(place.covariate == "enc_2" for place in report.where)


@pytest.mark.parametrize("law", ["gauss", "t3", "mixture"])
def test_no_row_stands_out_of_noise_whatever_its_law(law: str) -> None:
    told = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        r = rng.standard_t(3, (300, 3)) if law == "t3" else rng.normal(size=(300, 3))
        r = r * np.where(rng.random((300, 1)) < 0.05, 6.0, 1.0) if law == "mixture" else r
        told += len(standing_rows(r, np.ones(300, dtype=bool))) > 0
    assert told <= 1


@pytest.mark.parametrize("tracked", few(1, [False, True]))
def test_a_burst_of_bad_rows_is_told_by_its_rows(tracked: bool) -> None:
    data = five_bar(240, 5, tracked=tracked, moved=0.0, repeats=2)
    bad = np.r_[60:67, 150:156]
    error = np.zeros(240)
    error[bad] = np.where(bad < 100, 1, -1) * 12 * 5e-5
    report = explain("gpm2002", data.with_columns({"enc_2": data["enc_2"] + error}))
    assert report.verdict in ("noise", "unknown")
    assert len(_rows(report) & set((bad + 1).tolist())) >= 0.8 * len(bad)
    assert len(_rows(report)) <= len(bad) + 1
    if report.verdict == "noise":
        assert "rows stand out" in headline(report)


@pytest.mark.parametrize(("first", "verdict"), [(150, "noise"), (234, "unknown")])
def test_a_burst_is_noise_if_it_ends_within_the_run(first: int, verdict: str) -> None:
    data, error = five_bar(240, 5, tracked=True, moved=0.0, repeats=2), np.zeros(240)
    error[first : first + 6] = 12 * 5e-5 * np.array([1, -1, 1, -1, 1, -1])
    report = explain("gpm2002", data.with_columns({"enc_2": data["enc_2"] + error}))
    assert (report.verdict, _rows(report)) == (verdict, {*range(first + 1, first + 7)})


def test_one_wild_row_is_told_where_no_pose_is_read_again() -> None:
    data, error = five_bar(240, 5, tracked=True, moved=0.0, repeats=1), np.zeros(240)
    error[100] = 20 * 5e-5
    report = explain("gpm2002", data.with_columns({"enc_2": data["enc_2"] + error}))
    assert (report.verdict, _rows(report)) == ("noise", {101})


def test_none_is_not_said_of_an_error_of_twice_the_noise() -> None:
    data = five_bar(300, 7, tracked=False, moved=0.0, repeats=1)
    stated = MeasuredData(data.columns, "gpm2002", {**data.metadata, "sigma_enc": 5e-5 / 2.2}, "half")
    assert explain("gpm2002", data).verdict == "none"
    assert explain("gpm2002", stated).verdict == "unknown"


def test_a_law_that_no_reading_could_have_is_none_and_warns_of_nothing():
    sizes = np.where(np.arange(200) % 5 < 3, 1.0, 100.0)[:, None]
    rows = sizes * np.where(np.arange(200) % 2, 1.0, -1.0)[:, None]
    assert not standing_rows(rows, np.full(200, True)).size
