"""Where no effect of the catalogue fits, a formula over the columns is found, told, added, and written as an effect."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.linalg import cho_factor

from benchmarks.blind.gpm2002.simulate import case
from benchmarks.formulas.machines import case as formula_case
from calibench.bench.discovery.page.words import formula_sentences, gap_sentence, headline
from calibench.discrepancy import Constraints, Joint, MeasuredData, Roles, explain
from calibench.discrepancy.diagnostics.score import signatures
from calibench.discrepancy.diagnostics.smooth_term import products
from calibench.discrepancy.fitting.fit import fit, thinned
from calibench.discrepancy.formula.grammar import Atom, FormulaEffect, Run, Term, lag, play, side, slip
from calibench.discrepancy.formula.search import _Search
from calibench.discrepancy.registries import effects
from calibench.discrepancy.report import Report
from calibench.discrepancy.search.smoother import _SIZES, _beside
from calibench.discrepancy.thresholds import THRESHOLDS, using
from calibench.problems.base import Array, Parameter

pytestmark = pytest.mark.usefixtures("at_one_noise")

SIGMA = 1e-5
ROLES = Roles(
    (Joint("circle", "hz", torque="pull"), Joint("arm", "vt", torque="push")), time="clock", temperature="warm"
)


class Circles:
    """Two circles that read known angles."""

    name = "circles"

    def formulate(self, data: MeasuredData) -> Constraints:
        """Return the readings less the angles."""
        zeros = tuple(Parameter(f"zero_{k}", "rad", 0.0, -0.1, 0.1) for k in ("hz", "vt"))

        def closure(q: Any) -> Any:
            return np.stack([q[k] + q[f"zero_{k}"] - q[f"true_{k}"] for k in ("hz", "vt")], axis=-1)

        return Constraints(data, closure, zeros, {"hz": SIGMA, "vt": SIGMA}, inputs=("true_hz", "true_vt"), roles=ROLES)


def measured(error: Any, seed: int = 3, n: int = 240) -> MeasuredData:
    """Return readings of two circles, a third held out, of which the first errs by `error` of what was met."""
    rng = np.random.default_rng(seed)
    met = {
        "true_hz": rng.uniform(0, 2 * np.pi, n), "true_vt": rng.uniform(0, 2 * np.pi, n),
        "clock": np.sort(rng.uniform(0, 3600, n)), "pull": rng.normal(0, 40, n), "push": rng.normal(0, 40, n),
        "warm": rng.uniform(2, 9, n),
    }  # fmt: skip
    read = {k: met[f"true_{k}"] + 0.01 + SIGMA * rng.standard_normal(n) for k in ("hz", "vt")}
    read["hz"] = read["hz"] + error(met)
    split = np.where(rng.random(n) < 0.33, "hold", "train")
    return MeasuredData({**met, **read, "split": split}, "circles", {}, "run")


def product(met: dict[str, Array]) -> Array:
    return 1.2e-6 * np.sin(2 * met["true_vt"]) * met["push"]


def hysteresis(met: dict[str, Array]) -> Array:
    out, at = [], met["pull"][0]
    for force in met["pull"]:
        at = min(max(at, force - 30.0), force + 30.0)
        out.append(force - at)
    return 2e-6 * np.array(out)


@cache
def told(which: str) -> Report:
    return explain(Circles(), measured({"product": product, "hysteresis": hysteresis, "sound": nothing}[which]))


def nothing(met: dict[str, Array]) -> Array:
    return np.zeros(len(met["pull"]))


def test_a_product_that_no_effect_has_is_told_with_its_size_and_interval() -> None:
    report = told("product")
    assert report.verdict == "unknown"
    formula = report.formula
    assert formula is not None
    assert formula.structure == (("hz", "u push", "sin vt"),)
    [size] = formula.intervals
    assert size.unit == "rad/(N mm)"
    assert size.value == pytest.approx(-1.2e-6, rel=0.1)  # what is true less what is read
    assert size.ci95[1] - size.ci95[0] < 0.2e-6
    assert headline(report).endswith("explains; a formula does: hz += a sin(2 vt) push.")
    assert formula_sentences(report)[0].startswith("No cause of the catalogue; hz += a sin(2 vt) push: a = -1.1")
    assert "with the formula" in gap_sentence(report)


def test_the_formula_is_in_the_model_and_brings_unseen_readings_to_the_noise() -> None:
    report = told("product")
    assert any(isinstance(effect, FormulaEffect) for effect in report.model.model.effects)
    assert report.gap.held_out_before > 2.2
    assert report.gap.held_out_after < 1.15 * report.gap.noise_floor
    new = measured(product, seed=8, n=60)
    left = report.model.predict(new)
    assert np.sqrt(np.mean(left**2)) < 1.2
    assert np.sqrt(np.mean(report.before.predict(new) ** 2)) > 2.0


def test_a_formula_is_read_back_from_a_report_as_it_was_written() -> None:
    report = told("product")
    assert Report.from_dict(report.to_dict()).formula == report.formula


def test_hysteresis_is_found_over_the_rows_in_their_order_held_out_ones_too() -> None:
    report = told("hysteresis")
    assert report.formula is not None
    assert ("hz", "slip pull") in report.formula.structure or ("hz", "play pull") in report.formula.structure
    assert report.gap.held_out_after < 1.2 * report.gap.noise_floor


def test_a_sound_machine_gets_no_formula() -> None:
    report = told("sound")
    assert report.formula is None
    assert not any(isinstance(effect, FormulaEffect) for effect in report.model.model.effects)


@pytest.mark.parametrize("which", ["product", "hysteresis"])
def test_the_lines_of_its_effect_run_and_name_the_cause_with_the_same_gap(
    which: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    report = told(which)
    assert report.formula is not None
    for kept in ("_factories", "_options", "_order"):  # what is entered is gone with the test
        monkeypatch.setattr(effects, kept, getattr(effects, kept).copy())
    for _ in range(2):  # as a cell of a notebook is
        exec(compile(report.formula.to_effect(), "formula.py", "exec"), {})
    with pytest.raises(ValueError, match="registered twice; give one of them another name"):
        exec(report.formula.to_effect().replace("What the formula says", "Another cause"), {})
    again = explain(Circles(), measured({"product": product, "hysteresis": hysteresis}[which]))
    assert again.verdict == "named"
    # a slip is its force less a play: on some machines it is found as compliance and a formula of the play
    before = [f.family for f in report.findings]
    assert sorted(f.family for f in again.findings) == sorted([*before, "found_formula"])
    assert again.gap.held_out_after == pytest.approx(report.gap.held_out_after, rel=0.02)


def test_a_cause_of_a_foreign_simulator_is_written_down() -> None:
    """A drive that errs with the square of the load, in a simulator that shares nothing with the grammar."""
    blind = case(962, xy=False, family="load_squared", lam=2.0, noise="gauss")
    report = explain("gpm2002", MeasuredData(blind.columns, "gpm2002", blind.metadata, "case"))
    assert report.verdict == "unknown"
    assert report.formula is not None
    assert {"square load_x", "square load_y"} == {factors[1] for factors in report.formula.structure}
    assert report.gap.held_out_after < 1.1 * report.gap.noise_floor


def test_a_recorded_direction_is_told_and_no_sign_of_a_velocity() -> None:
    made = formula_case("gpm2002", 936201)
    report = explain("gpm2002", MeasuredData(made.columns, "gpm2002", made.metadata, "case"))
    assert report.formula is not None
    assert report.formula.structure == (made.truth,) == (("enc_1", "u dir_1", "abs tau_1"),)


def test_operators_follow_their_definitions() -> None:
    u = np.array([0.0, 1.0, 2.0, 1.0, -1.0, -1.5])
    assert play(u, 0.5).tolist() == [0.0, 0.5, 1.5, 1.5, -0.5, -1.0]
    assert slip(u, 0.5).tolist() == [0.0, 0.5, 0.5, -0.5, -0.5, -0.5]
    assert side(u, 0.6).tolist() == [0.0, 1.0, 1.0, -1.0, -1.0, -1.0]
    t = np.array([0.0, 10.0, 20.0])
    np.testing.assert_allclose(lag(np.array([0.0, 1.0, 1.0]), t, 10.0), [0, 1 - np.exp(-1), 1 - np.exp(-2)])


def test_units_of_a_size_make_a_term_one_of_its_quantity() -> None:
    force, angle = Atom("tau", "signed square", unit="N mm"), Atom("q", "sin", 2.0, unit="rad")
    assert Term("enc", (angle, force)).unit_of("rad") == "rad/(N mm)^2"
    assert Term("enc", (angle,)).unit_of("rad") == "rad"
    assert Term("x", (Atom("T", "u", unit="K"), Atom("v", "u", unit="rad/s"))).unit_of("mm") == "mm/(K (rad/s))"


def test_the_effect_has_the_derivative_of_its_shift() -> None:
    data = measured(nothing, n=40)
    formulation = Circles().formulate(data)
    terms = (Term("hz", (Atom("vt", "wave", 2.3, unit="rad"), Atom("pull", "tanh", 30.0, unit="N mm"))),)
    effect = FormulaEffect(terms, Run.of(formulation), ("rad", "rad"), ((0, 0), (0, 1)))
    q, c = {name: data[name] for name in ("hz", "vt")}, np.array([1e-4, -2e-4, 0.02, -0.05])
    basis = effect.basis(q, data, c)["hz"]
    for k in range(4):
        step = np.eye(4)[k] * 1e-6
        moved = (effect.shift(q, data, c + step)["hz"] - effect.shift(q, data, c - step)["hz"]) / 2e-6
        np.testing.assert_allclose(basis[:, k], moved, atol=1e-7)
    assert not effect.shift(q, data, np.zeros(4))["hz"].any()


def test_rows_of_the_run_know_what_came_between_them() -> None:
    formulation = Circles().formulate(measured(nothing, n=50))
    data = formulation.data
    placed = data.with_columns({"reading_place": np.arange(len(data))})
    run = Run.of(formulation.on(placed))
    whole = run.play(placed["pull"], "pull", placed, 20.0)
    some = placed.rows(np.arange(0, 50, 3))
    np.testing.assert_allclose(run.play(some["pull"], "pull", some, 20.0), whole[::3])
    new = replace(data, columns=dict(data.columns))
    np.testing.assert_allclose(run.play(new["pull"], "pull", new, 20.0), play(new["pull"], 20.0))


def test_a_part_of_very_many_rows_is_the_fit_at_these_rows() -> None:
    found = told("product").before.fit
    n, c = found.at.misclosure.shape
    with using(replace(THRESHOLDS, drawn_rows=40 * c)):
        part = thinned(found)
    some = np.unique(np.linspace(0, n - 1, 40).round().astype(int))
    assert part.r.reshape(-1, c) == pytest.approx(found.r.reshape(n, c)[some])
    assert part.J.reshape(40, c, -1) == pytest.approx(found.J.reshape(n, c, -1)[some])
    assert thinned(found) is found


@pytest.mark.parametrize("carried", [0.0, 0.4])
def test_terms_explain_what_their_whitened_columns_do_however_noise_is_carried_on(carried: float) -> None:
    before = told("product").before.fit
    at = fit(before.model, replace(before.noise, autocorrelation=carried), before.x)
    search = _Search(at, at.model.formulation)
    on, quantity, rng = search.first, "hz", np.random.default_rng(1)
    T, ranks, _ = search.everything(on, rng.standard_normal((len(on.y), 3)))[quantity]
    assert search._weights(quantity)[0].size == at.at.misclosure.size  # no matrix of rows by rows
    for k in rng.choice(len(search.own[quantity]), 40, replace=False):
        value = products(map(search.value, search.products[search.own[quantity][k]]))
        column = signatures(at, {quantity: value})[:, 0]
        left = column - on.Q @ (on.Q.T @ column)
        assert T[k] == pytest.approx((left @ on.y) ** 2 / (left @ left) if ranks[k] else 0.0, rel=1e-6)


def test_a_smooth_function_is_as_likely_as_by_the_whole_covariance() -> None:
    rng = np.random.default_rng(5)
    seen, y, B = rng.standard_normal((80, 12)), rng.standard_normal(80) * 3, rng.standard_normal((80, 5))
    lengths = np.exp(-np.outer([0.1, 0.5, 2.0], np.arange(12.0)))
    gain, variances = _beside(seen, seen.T @ seen, lengths, B, y, cho_factor(np.eye(5) + B.T @ B), 70, 1.0)
    chosen, gains = np.eye(80) + B @ B.T, []
    for of_weights in (variances, *(size**2 * one for size in _SIZES for one in lengths)):
        V = chosen + (seen * of_weights) @ seen.T
        left, total = (float(y @ np.linalg.solve(one, y)) for one in (V, chosen))
        noise, wide = max(1.0, left / 70), np.linalg.slogdet(V)[1] - np.linalg.slogdet(chosen)[1]
        gains.append(-0.5 * (70 * np.log(noise) + left / noise - total + wide))
    assert gain == pytest.approx(gains[0], rel=1e-9)
    assert gain == pytest.approx(max(gains), rel=1e-9)
