"""Stories end to end: blind cases go in, verdicts come out; and the laws that any verdict must keep."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pandas as pd
import pytest

from benchmarks.blind.claims import in_sets, true_names
from benchmarks.blind.gpm2002.simulate import Case, case
from calibench import bench, optimizers
from calibench.discrepancy import DataError, MeasuredData, Report, explain
from tests.few import few

pytestmark = pytest.mark.usefixtures("at_one_noise")


def _told(blind: Case) -> Report:
    return explain("gpm2002", MeasuredData(blind.columns, "gpm2002", blind.metadata, "case"))


@cache
def _hidden(seed: int, xy: bool, family: str, lam: float) -> Case:
    return case(seed, xy=xy, family=family, lam=lam, noise="gauss")


@pytest.mark.parametrize(
    ("seed", "xy", "family"),
    few(
        2,
        [
            (901, False, "slip"),
            (903, False, "thermal_leg"),
            (905, True, "gear"),
            (906, True, "eccentricity"),
            (908, True, "quantisation"),
            (910, False, "outlier"),
        ],
    ),
)
def test_a_hidden_effect_is_in_the_reported_set(seed: int, xy: bool, family: str) -> None:
    blind = _hidden(seed, xy, family, 1.5)
    report = _told(blind)
    assert in_sets(true_names(blind.truth)[0], report.to_dict(), lenient=True)
    if family in ("quantisation", "outlier"):  # nothing is corrected, and no error is smaller
        assert report.verdict == "noise"
        assert report.gap.held_out_after == report.gap.held_out_before
        assert np.isnan(report.gap.excess_shrink)
        return
    assert report.verdict in ("named", "ambiguous")
    assert report.gap.held_out_after < 1.25 * report.gap.noise_floor


@pytest.mark.parametrize(
    ("seed", "lam"),
    [
        (200496, 0.78),  # hardly beyond noise as stated
        (210594, 3.3),  # one wild reading holds most of what is outlying
        (210020, 3.9),  # visits scatter more than pairs, as they may by chance where tails are heavy
    ],
)
def test_shocks_on_all_encoders_are_heavy_tails_of_all(seed: int, lam: float) -> None:
    blind = case(seed, kind="one", xy=False)
    assert blind.truth["effects"][0]["family"] == "heavy_tails"
    assert blind.truth["effects"][0]["lambda"] == pytest.approx(lam, abs=0.05)
    assert [f.effect for f in _told(blind).findings] == ["heavy_tails all"]


@pytest.mark.parametrize(
    ("seed", "effect"),
    [
        (140531, "base_shift base 1"),  # repeats differ while it moves: at one moment, as no wild readings do
        (140162, "outlier joint 1"),  # .66 sigma: the likelier of two accounts, which share their energy
    ],
)
def test_wild_readings_are_told_from_a_move_and_by_whose_they_are(seed: int, effect: str) -> None:
    assert [f.effect for f in _told(case(seed)).findings] == [effect]


@pytest.mark.slow
def test_the_floor_of_wild_readings_lies_in_the_interval_of_the_gap() -> None:
    within = []
    for seed in range(400000, 400016):
        gap = _told(case(seed, kind="one", family="outlier", xy=True, lam=1.5)).gap
        within.append(gap.held_out_ci95[0] <= gap.noise_floor <= gap.held_out_ci95[1])
    assert sum(within) >= 12


@pytest.mark.slow
def test_a_cause_that_no_catalogue_has_is_unknown_and_its_gap_closes_all_the_same() -> None:
    report = _told(case(921, xy=False, family="bump", lam=2.5, noise="gauss"))
    assert report.verdict == "unknown"
    assert report.findings == ()
    assert report.where[0].p < 1e-6
    assert report.gap.train_after < 0.7 * report.gap.train_before


@pytest.mark.parametrize("noise", ["gauss", "t3", "ar1"])
def test_nothing_is_found_where_nothing_is_missing(noise: str) -> None:
    report = _told(case(931, xy=False, kind="none", noise=noise))  # type: ignore[arg-type]
    assert report.verdict == "none"
    assert report.p > 0.01


def test_two_effects_are_both_named() -> None:
    blind = case(1, kind="two", xy=False, lam=1.5, noise="gauss")
    told = _told(blind).to_dict()
    assert all(in_sets(true, told, lenient=True) for true in true_names(blind.truth))


def test_a_report_is_plain_json_and_repeats_itself() -> None:
    blind = _hidden(905, True, "gear", 1.5)
    one, two = (_told(blind).to_dict() for _ in range(2))
    one.pop("seconds"), two.pop("seconds")
    assert json.dumps(one, allow_nan=False) == json.dumps(two, allow_nan=False)
    assert sum(rival["weight"] for rival in one["findings"][0]["set"]) == pytest.approx(1.0)
    low, high = one["findings"][0]["amplitude"]["ci95"]
    assert low < one["findings"][0]["amplitude"]["value"] < high


def test_the_model_of_a_report_is_a_problem_for_the_optimisers() -> None:
    model = _told(_hidden(901, False, "slip", 1.5)).model
    run = bench.execute(model, optimizers.make("lm"), budget=3000, seed=0)
    assert run.best_value <= model(model.best) * (1 + 1e-3)
    assert np.all(model.lower <= model.best)
    assert np.all(model.best <= model.upper)


def test_the_gap_is_cross_validated_where_no_rows_are_held_out() -> None:
    blind = _hidden(901, False, "slip", 1.5)
    columns = {name: values for name, values in blind.columns.items() if name != "split"}
    report = explain("gpm2002", MeasuredData(columns, "gpm2002", blind.metadata, "case"))
    assert report.gap.cross_validated
    assert report.gap.held_out_after < 1.25 * report.gap.noise_floor < report.gap.held_out_before


def test_too_few_rows_for_the_parameters_are_refused_in_one_line() -> None:
    blind = _hidden(901, False, "slip", 1.5)
    few = MeasuredData({name: values[:8] for name, values in blind.columns.items()}, "gpm2002", blind.metadata, "few")
    with pytest.raises(DataError, match="few"):
        explain("gpm2002", few)


def test_columns_may_be_lists_or_a_table_of_pandas() -> None:
    u = np.linspace(-1.0, 1.0, 40)
    columns = {"u": u, "y": 1 + 2 * u + 0.01 * np.random.default_rng(0).standard_normal(40)}
    told = explain("table", MeasuredData(columns, "table")).to_dict()
    for given in ({name: column.tolist() for name, column in columns.items()}, pd.DataFrame(columns)):
        again = explain("table", MeasuredData(given, "table")).to_dict()  # type: ignore[arg-type]
        assert again["findings"] == told["findings"] != []


def test_what_is_no_measured_data_and_a_level_that_is_none_are_told() -> None:
    with pytest.raises(TypeError, match="data is a dict"):
        explain("table", {"y": np.arange(4.0)})  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="level=2"):
        explain("table", MeasuredData({"y": np.arange(4.0)}, "table"), level=2)
