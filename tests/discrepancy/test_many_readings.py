"""Of very many readings some are searched, by sums; the others tell the error of what was found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.blind.gpm2002.simulate import case
from calibench.core.notes import Code
from calibench.discrepancy import MeasuredData, explain
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting.fit import fit, step_by_sums
from calibench.discrepancy.model.effect import name_of
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.procedure import searched
from calibench.discrepancy.registries import machines
from calibench.discrepancy.search.select import Option, _in_order, energy_of, light
from calibench.discrepancy.search.stepwise import is_calm, select_stepwise
from calibench.discrepancy.thresholds import THRESHOLDS, using

pytestmark = pytest.mark.usefixtures("at_one_noise")


@pytest.mark.parametrize("damping", [0.0, 1e-3])
@pytest.mark.parametrize("t_degrees", [4.0, np.inf])
def test_a_step_by_sums_is_the_step_by_rows(damping: float, t_degrees: float) -> None:
    rng, noise = np.random.default_rng(2), Noise(scale=1.7, t_degrees=t_degrees)
    J, r = (
        rng.normal(size=(900, 5)) @ np.triu(rng.normal(size=(5, 5)) + 3 * np.eye(5)) * 10.0 ** np.arange(5),
        rng.normal(size=900),
    )
    root = np.sqrt(noise.weights(r))
    A, b = J * root[:, None], -root * r
    size = np.linalg.norm(A, axis=0)
    rows = np.vstack([A / size, np.sqrt(damping) * np.eye(5)])
    expected = np.linalg.lstsq(rows, np.concatenate([b, np.zeros(5)]), rcond=None)[0] / size
    by_sums = step_by_sums(r, J, root, damping)
    assert by_sums is not None
    assert np.allclose(by_sums, expected, rtol=1e-9, atol=0)


def test_columns_that_are_nearly_alike_take_no_step_by_sums() -> None:
    rng = np.random.default_rng(3)
    first = rng.normal(size=900)
    J = np.column_stack([first, first + 1e-6 * rng.normal(size=900)])
    assert step_by_sums(rng.normal(size=900), J, np.ones(900), 0.0) is None


@pytest.mark.parametrize("told", [True, False])
def test_of_very_many_rows_some_are_searched_spread_over_the_run_and_what_hangs_together_stays(told: bool) -> None:
    n, most = 3000, 400
    pose = np.arange(n) // 3
    data = MeasuredData({"t_s": np.arange(n) * 1.0} | ({"pose_id": pose} if told else {}), "gpm2002")
    fitted = np.arange(n) < 2460
    with using(replace(THRESHOLDS, searched_rows=most)):
        some = searched(data, fitted)
        few = searched(data, fitted & (np.arange(n) < most))
    assert not np.any(some & ~fitted)
    assert np.array_equal(few, fitted & (np.arange(n) < most))
    assert 0.9 * most < some.sum() <= most
    assert np.diff(np.flatnonzero(some)).max() < 200
    whole = pose if told else np.arange(n) // 20
    each = np.bincount(whole[some])
    assert np.all(np.isin(each, [0, 3 if told else 20]))


def test_what_is_found_in_some_rows_is_tried_on_all_the_others() -> None:
    blind = case(6, kind="one", family="compliance", xy=True, lam=1.5, noise="gauss", poses=300)
    data = MeasuredData(blind.columns, "gpm2002", blind.metadata, "many")
    report = explain("gpm2002", data, thresholds=replace(THRESHOLDS, searched_rows=400))
    assert [f.effect for f in report.findings] == [f"compliance {blind.truth['effects'][0]['target']}"]
    [note] = [note for note in report.notes if note.code is Code.ROWS_THINNED]
    assert report.model is not None
    fitted = len(report.model.model.formulation.data)
    assert note.values["kept"] == fitted <= 400 < note.values["rows"]
    assert not report.gap.cross_validated
    assert Code.NOT_HELD_OUT not in [note.code for note in report.notes]
    assert report.gap.held_out_after < 1.1 * report.gap.noise_floor < report.gap.held_out_before
    # its size and interval are those of all rows, and the model has that size
    size, of_some = report.findings[0].amplitude, report.model.fit
    assert report.model.best[-1] == pytest.approx(size.value)
    part = np.ptp(size.ci95) / (2 * of_some.reach * np.sqrt(of_some.covariance()[-1, -1]))
    assert part == pytest.approx(np.sqrt(fitted / note.values["rows"]), rel=0.1)


def test_a_calm_noise_is_told_by_the_first_test_alone_and_its_draws_are_kept() -> None:
    for kind, calm in (("none", True), ("one", False)):
        blind = case(6, kind=kind, xy=True, lam=1.5, noise="gauss", poses=40)  # type: ignore[arg-type]
        formulation = machines.make("gpm2002").formulate(MeasuredData(blind.columns, "gpm2002", blind.metadata))
        at, rng = fit(Model(formulation), Noise()), np.random.default_rng(0)
        known, before = catalogue(formulation).candidates, rng.bit_generator.state
        assert is_calm(at, known, (), rng, 0.01) == calm
        assert rng.bit_generator.state == before
        assert select_stepwise(at, known, (), rng, 0.01).alarm != calm


def test_rounding_does_not_choose_which_of_two_twins_leads_a_set() -> None:
    blind = case(3, kind="one", family="compliance", xy=True, lam=2.0, noise="gauss", poses=40)
    at = fit(Model(machines.make("gpm2002").formulate(MeasuredData(blind.columns, "gpm2002", blind.metadata))), Noise())
    names = {name_of(e): e for e in catalogue(at.model.formulation).candidates}
    twins = [names["compliance joint 3"], names["proximal_bending leg 3"]]
    leads = {
        _in_order([Option(e, at, 500.0 + wrong * sign, 1) for e, sign in zip(twins, signs)])[0].name
        for wrong in (0.0, 1e-10)
        for signs in ((1, -1), (-1, 1))
    }
    assert leads == {"compliance joint 3"}


def test_an_option_without_its_rows_tells_the_size_of_what_it_moves() -> None:
    blind = case(3, kind="one", family="compliance", xy=True, lam=2.0, noise="gauss", poses=40)
    at = fit(Model(machines.make("gpm2002").formulate(MeasuredData(blind.columns, "gpm2002", blind.metadata))), Noise())
    effect = next(e for e in catalogue(at.model.formulation).candidates if e.family == "compliance")
    found = fit(at.model.with_effects(effect), at.noise)
    whole = Option(effect, found, 1.0, 1)
    bare = light(whole, at)
    assert (len(bare.fit.r), bare.fit.J.shape) == (0, (0, len(found.x)))
    assert energy_of(light(bare, at)) == energy_of(bare) == energy_of(whole) > 0
