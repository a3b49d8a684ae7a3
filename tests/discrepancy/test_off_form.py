"""Formulas that are off: what a form may explain is integrated out, and names survive it."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from benchmarks.blind import orthoglide
from benchmarks.blind.claims import in_sets, true_names
from benchmarks.blind.gpm2002.simulate import Case, case
from calibench.discrepancy import Joint, MeasuredData, Predicted, Roles, explain
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting import fit as fitting
from calibench.discrepancy.fitting.fit import fit
from calibench.discrepancy.model.effect import name_of
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.registries import machines
from calibench.discrepancy.report import Report
from calibench.discrepancy.search.form import (
    ALONG,
    Modulated,
    _least,
    bonus,
    near,
    random_curve,
    residuals_within,
    share,
    slow_along,
)
from calibench.discrepancy.search.select import close, options, run_tests
from calibench.discrepancy.thresholds import THRESHOLDS, Thresholds
from calibench.problems.base import Parameter
from tests.foreign.run import told
from tests.independent import mount

pytestmark = pytest.mark.usefixtures("at_one_noise")


def _told(seed: int) -> tuple[bool, str]:
    blind = case(seed, kind="one", bent=True)
    report = explain("gpm2002", MeasuredData(blind.columns, "gpm2002", blind.metadata, "case"))
    return in_sets(true_names(blind.truth)[0], report.to_dict(), lenient=False), report.verdict


def test_a_curve_that_wins_by_the_error_of_a_form_is_no_unknown() -> None:
    there, verdict = _told(602103)
    assert there
    assert verdict != "unknown"


@pytest.mark.parametrize("seed", [602116, pytest.param(602178, marks=pytest.mark.slow)])
def test_a_rival_that_takes_up_the_error_of_a_form_does_not_shut_the_truth_out(seed: int) -> None:
    """A gear that calibration hides but for 2 %, and an eccentricity: any order, or the second one, fits better."""
    assert _told(seed) == (True, "ambiguous")


@pytest.mark.parametrize("seed", [685151, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (694531, 694567))])
def test_a_formula_met_to_the_letter_does_not_shut_out_one_whose_form_is_off(seed: int) -> None:
    """Gears, beside harmonics and eccentricities that fit to the letter or nearly, but may be off as well."""
    assert _told(seed) == (True, "ambiguous")


@pytest.mark.parametrize(
    ("k", "truth", "rival"), [(179, "PHH", "HCES"), pytest.param(172, "DCES", "PDD", marks=pytest.mark.slow)]
)
def test_without_a_stated_noise_the_error_of_a_form_shuts_no_rival_out(k: int, truth: str, rival: str) -> None:
    """A scale of an axis and a circle off its centre, whose forms are a tenth off: the false one explains more."""
    night = mount.case(k, base=35000)
    report = explain("mount", MeasuredData(night.columns, "mount", night.stated, "night"))
    assert {f"{truth} mount", f"{rival} mount"} <= {one.effect for one in report.findings[0].set}


def test_scores_that_heavy_tails_cut_choose_no_form_of_a_large_effect() -> None:
    said = told("off_form", 971149)  # of time constants of the warmth the cut scores prefer one far too long
    assert (said["law"], said["cause"]) == ("t4", "thermal_zero")
    assert (said["verdict"], [f["effect"] for f in said["findings"]]) == ("named", ["thermal_zero a"])


def test_a_random_curve_has_mean_zero_and_rms_one_where_its_argument_is_known() -> None:
    x = np.append(np.random.default_rng(5).uniform(-3, 4, 200), np.nan)
    long, short = (random_curve(x, length) for length in (0.8, 0.2))
    for parts in (long, short):
        assert not parts[-1].any()
        np.testing.assert_allclose(parts[:-1].mean(axis=0), 0.0, atol=1e-12)
        assert np.sum(parts[:-1] ** 2) / 200 == pytest.approx(1.0)
    waves = np.sin(2 * x[:-1]) - np.sin(2 * x[:-1]).mean()  # two of them
    left = [float(np.linalg.lstsq(parts[:-1], waves, rcond=None)[1][0]) / 200 for parts in (long, short)]
    assert left[0] > 0.1
    assert left[1] < 1e-5


def test_beside_a_best_one_without_a_form_no_rival_comes_near_by_its_own() -> None:
    hidden = case(683002, kind="one", family="backlash", target=2, lam=2.0, xy=False)
    base = fit(_model_of(hidden), Noise())
    found = options(base, run_tests(base, catalogue(base.model.formulation).candidates, (), None))
    assert found[0].name == "backlash joint 2"
    assert {o.name.split()[0] for o in found} & {"gear", "eccentricity", "second_harmonic"}
    assert [o.name for o in near(found)] == [o.name for o in close(found)]


class _Slide:
    """A slide whose place a laser reads, with a clock and a thermometer."""

    name = "slide"

    def formulate(self, data: MeasuredData) -> Predicted:
        roles = Roles((Joint("axis", "s", "sliding"),), time="clock", temperature="warmth")
        parameters = (Parameter("zero", "mm", 0.0, -1.0, 1.0),)
        return Predicted(data, lambda q: q["s"] + q["zero"], parameters, {"laser": 1e-3}, inputs=("s",), roles=roles)


def _grown(seed: int, off: float, thresholds: Thresholds = THRESHOLDS) -> Report:
    """Return the report on a slide that grows as it warms up, bent with the temperature."""
    rng, n = np.random.default_rng(seed), 120
    clock = np.arange(n) * 8.0
    u = clock / clock[-1]
    place = np.repeat(rng.uniform(0, 200, n // 2), 2)
    warmth = 5 * (1 - np.exp(-3 * u)) + 0.6 * np.sin(2 * np.pi * 1.3 * u + seed)
    bend = warmth**2 - warmth * (warmth @ warmth**2) / (warmth @ warmth)
    grown = warmth / np.linalg.norm(warmth) + off * bend / np.linalg.norm(bend)
    laser = place + 4e-3 * np.sqrt(n) * grown + 1e-3 * rng.standard_normal(n)
    columns = {"s": place, "laser": laser, "clock": clock, "warmth": warmth}
    return explain(_Slide(), MeasuredData(columns, "slide"), thresholds=thresholds)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 4))])
def test_a_name_that_is_out_of_reach_of_the_likeliest_does_not_come_first(seed: int) -> None:
    """Where growth bends by a third, a drift of three numbers fits better, and is the less likely by far."""
    first = _grown(seed, 0.3).findings[0]
    assert first.effect == "thermal_zero axis"
    assert first.set[0].weight > 0.05


def test_the_first_of_a_set_is_in_the_fit_where_earlier_picks_are_not_exchanged() -> None:
    report = _grown(0, 0.3, replace(THRESHOLDS, exchanged_at_once=0))
    assert report.findings[0].effect in {name_of(e) for e in report.model.fit.model.effects}


def test_names_whose_columns_go_together_are_parted_by_readings_in_which_they_do_not() -> None:
    [found] = _grown(6, 0.13).findings
    assert {rival.family for rival in found.set} == {"drift", "thermal_zero"}
    assert found.separated_by is not None
    assert re.fullmatch(
        "readings in which (time and temperature|temperature and time) do not go together: here the one tells 9[0-9] % "
        "of the other",
        found.separated_by,
    )


@pytest.mark.slow
def test_a_lean_that_goes_with_its_carriage_is_told_with_what_it_goes_with() -> None:
    """Calibration takes up most of the lean, and nothing of the tenth by which it changes along the way."""
    report = _leaning()
    assert report.verdict == "named"
    assert [f.form for f in report.findings] == [f"size depends on the move along {report.findings[0].target[-1]}"]


@pytest.mark.slow
def test_a_name_far_before_any_smooth_function_is_told_as_a_part() -> None:
    """The same where no form is told: the formula leaves a sixth of the excess, curves far more."""
    report = _leaning(along_share=10.0)
    assert report.verdict == "partly"
    assert [f.form for f in report.findings] == ["form differs"]


@pytest.mark.slow
def test_a_form_that_readings_hardly_determine_shuts_no_name_out() -> None:
    """A leg grows, not as its thermometer: the fitted form is 1.5 times the growth, and a tenth explains as much."""
    hidden = orthoglide.case(665023, "thermal_legs", bent=True)
    report = explain("orthoglide", MeasuredData(hidden.columns, "orthoglide", hidden.metadata, "case"))
    assert report.verdict == "named"
    assert [(f.effect, f.form) for f in report.findings] == [("thermal_legs leg x", "size depends on the time")]


@pytest.mark.parametrize("most", [0.02, pytest.param(0.05, marks=pytest.mark.slow)])
def test_a_form_stays_within_its_bound_and_explains_what_it_can(most: float) -> None:
    hidden = orthoglide.case(660265, "axis_orthogonality", bent=True)
    formulation = machines.make("orthoglide").formulate(MeasuredData(hidden.columns, "orthoglide", hidden.metadata, ""))
    [effect] = [
        e for e in catalogue(formulation).candidates if name_of(e) == f"axis_orthogonality {hidden.truth['target']}"
    ]
    form = Modulated(effect, slow_along(effect, formulation.data, ALONG))
    plain, formed = (fit(Model(formulation, effects), Noise()) for effects in ((effect,), (effect, form)))
    narrow, wide = (float(np.sum(residuals_within(formed, [form], at) ** 2)) for at in (most, 1e6))
    assert share(formed, form) > most
    assert np.sum(formed.r**2) < narrow < np.sum(plain.r**2)
    assert wide == pytest.approx(np.sum(formed.r**2), rel=1e-6)


def _leaning(**changed: float) -> Report:
    hidden = orthoglide.case(660265, "axis_orthogonality", bent=True)
    data = MeasuredData(hidden.columns, "orthoglide", hidden.metadata, "case")
    report = explain("orthoglide", data, thresholds=replace(THRESHOLDS, **changed))
    assert [f.effect for f in report.findings] == [f"axis_orthogonality {hidden.truth['target']}"]
    return report


def test_an_effect_of_many_numbers_gains_nothing_by_its_form() -> None:
    base = fit(_model(601013), Noise())
    tests = run_tests(
        base, [e for e in catalogue(base.model.formulation).candidates if len(e.coefficients) > 2], (), None
    )
    found = options(base, tests)
    assert found
    assert [bonus(o) for o in found] == [0.0] * len(found)


@dataclass(frozen=True)
class _Any:
    """An effect of any size up to the largest."""

    largest: float
    unit = "mm"

    def amplitude(self, c: np.ndarray) -> float:
        return float(np.linalg.norm(c))


@pytest.mark.slow
@pytest.mark.parametrize("k", [1, 2])
@pytest.mark.parametrize("largest", [np.inf, 0.8])
def test_the_form_is_integrated_out_at_the_best_size_that_is_possible(k: int, largest: float) -> None:
    rng = np.random.default_rng(k)
    D, T, c = rng.standard_normal((30, k)), 0.3 * rng.standard_normal((30, 2, k)), rng.uniform(1, 2, k)
    y = D @ c + T @ c @ rng.standard_normal(2) + rng.standard_normal(30)

    def one(at: np.ndarray, off: float) -> float:
        covariance, left = np.eye(30) + off**2 * (T @ at) @ (T @ at).T, y - D @ at
        return float(left @ np.linalg.solve(covariance, left) + np.linalg.slogdet(covariance)[1])

    def dense(at: np.ndarray) -> float:
        at = at * min(1.0, largest / np.linalg.norm(at))
        return float(-2 * np.log(np.mean([np.exp(-one(at, off) / 2) for off in (0.5, 1.0)])))

    found = _least(y, D, T, _Any(largest), c, (0.5, 1.0))
    about = [c + step for step in rng.uniform(-0.5, 0.5, (300, k))]
    assert found <= min(map(dense, about)) + 1e-3
    assert found >= min(map(dense, [c + step for step in rng.uniform(-1, 1, (12_000, k))])) - 0.05


def _model(seed: int) -> Model:
    return _model_of(case(seed, kind="none"))


def _model_of(blind: Case) -> Model:
    machine = machines.make("gpm2002")
    return Model(machine.formulate(MeasuredData(blind.columns, "gpm2002", blind.metadata, "case")))


def test_a_descent_ends_at_the_bottom(monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[int] = []
    linearise = fitting.linearise

    def counted(*asked: object) -> object:
        looked.append(1)
        return linearise(*asked)  # type: ignore[arg-type]

    monkeypatch.setattr(fitting, "linearise", counted)
    assert fit(_model(601013), Noise()).converged
    assert len(looked) < 30


def test_a_fit_about_another_is_the_same_fit() -> None:
    model = _model(601013)
    cold = fit(model, Noise())
    warm = fit(model, Noise(), cold.x + 1e-3, about=cold)
    sd = np.sqrt(np.diag(cold.covariance()))
    assert np.abs(warm.x - cold.x).max() < 1e-3 * sd.max()
    assert warm.cost == pytest.approx(cold.cost, rel=1e-6)
