"""A search that knows when it is not done: a part is told as a part, a form as a form, a doubt as a doubt."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.blind.gpm2002.simulate import Case, case
from benchmarks.blind.orthoglide import case as orthoglide
from calibench.bench.discovery.page.words import doubt_sentences, headline
from calibench.discrepancy import MeasuredData, Report, explain
from calibench.discrepancy.diagnostics.score import ProjectedScores, Scored, Subspace
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.report import Doubt
from calibench.discrepancy.search.stepwise import _together
from tests.discrepancy.orthoglide_score import explained
from tests.few import few


def _told(blind: Case, factor: float = 1.0, repeats: bool = True) -> Report:
    kept = {n: v for n, v in blind.columns.items() if repeats or n not in ("visit_id", "repeat", "pose_id")}
    stated = blind.metadata | {
        key: factor * blind.metadata[key] for key in ("sigma_enc", "sigma_xy") if blind.metadata[key]
    }
    if not repeats:  # the first reading of each visit
        first = np.unique(blind.columns["visit_id"], return_index=True)[1]
        kept = {name: values[np.sort(first)] for name, values in kept.items()}
    return explain("gpm2002", MeasuredData(kept, "gpm2002", stated, "case"))


def test_noise_that_is_blamed_is_not_all_where_more_than_one_and_a_half_floors_are_left() -> None:
    report = _told(case(500265))  # coarse steps and another effect, which is not found
    assert report.verdict == "unknown"
    assert [f.effect for f in report.findings] == ["quantisation joint 1"]
    assert "no effect of the catalogue explains beside coarse quantisation of joint 1" in headline(report)


@pytest.mark.parametrize(("off", "form"), few(1, [(0.6, "size depends on the angle of joint 1"), (0.0, "")]))
def test_play_whose_size_goes_with_the_angle_is_like_play_and_not_play(off: float, form: str) -> None:
    report = _told(case(2, xy=True, family="backlash", lam=3.0, noise="gauss", bent=off))
    assert [(f.effect, f.form) for f in report.findings] == [("backlash joint 1", form)]
    assert ("something like" in headline(report)) == bool(form)


def test_a_small_effect_beside_a_large_one_may_be_the_error_of_its_formula() -> None:
    report = _told(case(1, xy=True, family="backlash", lam=6.0, noise="gauss"))
    first, *others = report.findings
    assert (first.effect, first.caution) == ("backlash joint 1", ())
    assert others
    assert all([c.code for c in f.caution] == [Doubt.FORMULA_ERROR] for f in others)
    assert report.verdict == "named"


@pytest.mark.slow
def test_where_nothing_tells_the_noise_names_weights_and_intervals_do_not_hang_on_it() -> None:
    blind = case(5, xy=True, family="gear", lam=2.5, noise="gauss")
    one, other = (_told(blind, factor, repeats=False) for factor in (1.0, 1.3))
    assert [f.effect for f in one.findings] == [f.effect for f in other.findings] == ["gear joint 3"]
    assert one.findings[0].gain == pytest.approx(other.findings[0].gain, rel=1e-3)
    assert one.findings[0].amplitude.ci95 == pytest.approx(other.findings[0].amplitude.ci95, rel=1e-3)
    assert [o.factor for o in one.other_noise] == [0.5, 2.0]
    assert all("gear joint 3" in o.effects for o in one.other_noise)
    assert "At half the stated noise" in doubt_sentences(one)[-1]
    assert _told(blind).other_noise == ()


def test_the_gain_of_a_profiled_noise_is_the_same_in_any_unit_of_it() -> None:
    before, after = 300.0, 200.0
    gains = [Noise(scale, profiled=True).gained(before / scale**2, after / scale**2, 180) for scale in (0.5, 1.0, 2.0)]
    assert gains == pytest.approx([180 * np.log(1.5)] * 3)
    assert Noise(2.0).gained(before, after, 180) == 100.0


def test_the_linear_gain_of_a_pair_is_that_of_all_their_columns_together() -> None:
    rng = np.random.default_rng(0)
    A = rng.standard_normal((80, 4)) @ (np.eye(4) + 0.4)
    y = A @ [3.0, -2.0, 1.0, 1.0] + rng.standard_normal(80)
    on, parts = ProjectedScores(y, np.zeros((80, 0))), [A[:, :1], A[:, 1:3], A[:, 2:]]  # the last two share a column

    class _One:
        positions = 1

    def scored(columns: np.ndarray) -> tuple[Scored, np.ndarray]:
        U, k = np.linalg.qr(columns)[0], columns.shape[1]
        seen = Subspace(np.eye(k), 1.0, np.ones(k), np.ones(k))
        return Scored(_One(), float(np.sum((U.T @ y) ** 2)), k, 1.0, np.zeros(k), seen, 1.0), U  # type: ignore[arg-type]

    gains = _together([scored(columns) for columns in parts], on)
    for i, one in enumerate(parts):
        for j, other in enumerate(parts):
            both = one if i == j else np.column_stack([one, other])
            explained = float(y @ both @ np.linalg.lstsq(both, y, rcond=None)[0])
            assert gains[i, j] == pytest.approx(explained - both.shape[1] * np.log(80))


@pytest.mark.slow
def test_a_name_whose_few_poses_predict_each_other_badly_is_no_part_where_the_fit_leaves_noise() -> None:
    report = explained(orthoglide(600001, "backlash", plan="paper"))
    assert report.gap.cross_validated
    assert report.gap.held_out_after > 1.5 * report.gap.noise_floor > report.gap.held_out_ci95[0]
    assert report.verdict == "named"
    assert report.left is not None
    assert report.left.times < 1.2


@pytest.mark.slow
def test_a_form_of_which_there_is_no_fit_leaves_the_names_as_they_are() -> None:
    """Six leaning axes, each with a slope and a bend of its size: their fit does not come to an end."""
    hidden = orthoglide(661046, "axis_intersection", bent=True)
    report = explained(hidden)
    assert f"axis_intersection {hidden.truth['target']}" in {f.effect for f in report.findings}
