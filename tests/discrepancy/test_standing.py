"""Names that stand by themselves: beside an unnamed rest, against shuffled rows, within what a machine can have."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.bench.discovery.page.words import control_sentences
from calibench.bench.measured.sources import sources
from calibench.discrepancy import MeasuredData, Report, explain
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting.fit import fit
from calibench.discrepancy.model.effect import is_possible, name_of
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.registries import machines
from calibench.discrepancy.report import Shuffled
from calibench.discrepancy.search import stepwise
from calibench.discrepancy.search.select import Option, fit_with, run_tests
from calibench.discrepancy.search.shuffle import _draws, shuffled
from calibench.discrepancy.search.standing import left_scale, renewed
from calibench.problems.base import Array
from tests.discrepancy.empty_runs import empty_run
from tests.discrepancy.test_general_families import Arm, readings

pytestmark = pytest.mark.usefixtures("at_one_noise", "without_formula")

Columns = dict[str, Array]


def _worn(q: Columns, d: Columns) -> Columns:
    """Return the joints of an arm whose shoulder has .4 mrad of play and whose elbow winds up by .3 mrad."""
    wound = 3e-4 * d["load_b"] / np.max(np.abs(d["load_b"]))
    return {"a": q["a"] - 2e-4 * d["side_a"], "b": q["b"] - wound}


def _bent(d: Columns, xyz: Array) -> Array:
    """Return places that err by smooth functions of the joints that no catalogue has, 10 sigma, and by scatter."""
    rng = np.random.default_rng(901)
    waves = [np.sin(4.0 * d["b"] + 1), np.sin(3.2 * d["a"] + 2), np.sin(2.1 * d["a"])]
    return np.asarray(xyz + 0.3 * np.stack(waves, axis=-1) + 0.08 * rng.standard_normal(xyz.shape))


def _mixed(data: MeasuredData, *columns: str) -> MeasuredData:
    order = np.random.default_rng(5).permutation(len(data))
    return data.with_columns({name: np.asarray(data[name])[order] for name in columns})


@pytest.fixture(scope="module")
def worn() -> MeasuredData:
    return readings(1, _worn, _bent)


@pytest.fixture(scope="module")
def told(worn: MeasuredData) -> Report:
    return explain(Arm(), worn)


def test_clear_play_and_compliance_keep_their_names_though_the_rest_has_none(told: Report) -> None:
    assert told.verdict == "partly"
    found = {f.effect: f for f in told.findings}
    assert {*found} == {"backlash shoulder", "compliance elbow"}
    low, high = found["backlash shoulder"].amplitude.ci95
    assert low < 4e-4 < high
    assert told.left is not None
    assert told.left.times > 5


def test_a_name_of_direction_tells_how_many_shuffles_explain_as_much(told: Report) -> None:
    controls = {f.effect: f.shuffled for f in told.findings}
    assert controls == {"backlash shoulder": Shuffled("direction", 0, 99, 0.01), "compliance elbow": None}
    [sentence] = control_sentences(told)
    assert "With the direction shuffled" in sentence
    assert "explained in 0 of 99 cases" in sentence
    assert Report.from_dict(told.to_dict()).findings == told.findings


def test_shuffled_sides_and_loads_name_neither(worn: MeasuredData) -> None:
    report = explain(Arm(), _mixed(worn, "side_a", "load_b"))
    assert not {"backlash shoulder", "compliance elbow"} & {f.effect for f in report.findings}


def test_a_rest_that_no_catalogue_has_names_nothing_by_itself() -> None:
    report = explain(Arm(), readings(1, measured=_bent))
    assert (report.verdict, report.findings) == ("unknown", ())


@pytest.mark.parametrize(("name", "columns"), [("backlash shoulder", ("side_a",)), ("drift shoulder", ("clock",))])
def test_the_control_loses_a_name_with_its_order_and_not_without(name: str, columns: tuple[str, ...]) -> None:
    """The noise is ten times the stated one, so that chance alone gains what names gain."""

    def off(q: Columns, d: Columns) -> Columns:
        run = d["clock"] / np.max(d["clock"])
        return {"a": q["a"] + (-1e-3 * d["side_a"] if name.startswith("backlash") else 2e-3 * run)}

    data = readings(2, off, lambda d, xyz: xyz + 0.2 * np.random.default_rng(3).standard_normal(xyz.shape))
    for there, loses in ((data, False), (_mixed(data, *columns), True)):
        formulation = Arm().formulate(there)
        known = catalogue(formulation).candidates
        effect = next(e for e in known if name_of(e) == name)
        at = fit_with(fit(Model(formulation), Noise()), [effect])
        control = shuffled(at, effect, effect, [e for e in known if e.family == effect.family])
        assert control is not None
        assert (control.p > 0.05) == loses


@pytest.mark.parametrize("true", [True, False])
def test_beside_a_slow_rest_a_slow_column_is_a_name_where_it_must_be_this_column(true: bool) -> None:
    def wound(q: Columns, d: Columns) -> Columns:
        return {"b": q["b"] + 1e-3 * d["warm"]} if true else {}

    def waving(d: Columns, xyz: Array) -> Array:
        turns = d["clock"] / np.ptp(d["clock"]) * 2 * np.pi
        return np.asarray(xyz + 0.3 * np.stack([np.sin(f * turns + f) for f in (0.8, 1.1, 1.3)], axis=-1))

    formulation = Arm().formulate(readings(6, wound, waving))
    known = catalogue(formulation).candidates
    warm = next(e for e in known if name_of(e) == "thermal_zero elbow")
    plain = fit(Model(formulation), Noise())
    at = fit_with(plain, [warm])
    assert at.noise.gained(plain.cost, at.cost, at.degrees) > 30  # chance gains what names gain
    family = [e for e in known if e.family == warm.family]
    assert shuffled(at, warm, warm, family) is None  # it lives on no order
    control = shuffled(at, warm, warm, family, along=True)
    assert control is not None
    assert (control.p <= 0.05) == true


def test_a_shuffle_exchanges_whole_visits_of_one_class() -> None:
    visits = [np.array(rows) for rows in ([4, 5], [0, 1, 2], [3], [6, 7, 8, 9])]  # each in the order of reading
    kinds = np.array([1, 0, 0, 1])
    for seed in range(20):
        source = next(_draws(visits, kinds, np.random.default_rng(seed)))
        taken = [next(k for k, own in enumerate(visits) if source[to[0]] in own) for to in visits]
        assert sorted(taken) == [0, 1, 2, 3]
        assert (kinds[taken] == kinds).all()
        for to, by in zip(visits, taken):  # where the other visit is shorter, its last reading again
            other = visits[by]
            assert (source[to] == other[np.minimum(np.arange(len(to)), len(other) - 1)]).all()


def test_a_rival_in_the_place_of_a_refused_name_is_not_named_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    base = fit(Model(machines.make("gpm2002").formulate(empty_run(np.random.default_rng(3), poses=40))), Noise())
    effects = [e for e in catalogue(base.model.formulation).candidates if e.family == "gear"][:2]
    one, other = (Option(e, fit_with(base, [e]), 50.0, 1) for e in effects)
    tests = run_tests(base, effects, (), None)
    both = fit_with(base, effects)
    selection = stepwise.Selection(both, both, ((one, other), (other,)), (), tests, tests, 0.0, True, 1.0, False)
    told = iter([[{one.name: Shuffled("time", 50, 99, 0.5)}, {}], [{}]])
    monkeypatch.setattr(stepwise, "controls", lambda *_: next(told))
    left, _ = stepwise.held_by_order(selection, base, effects, ())
    assert [[o.name for o in own] for own in left.sets] == [[other.name]]


def test_a_name_that_was_found_is_no_rival_of_another() -> None:
    base = fit(Model(machines.make("gpm2002").formulate(empty_run(np.random.default_rng(3), poses=40))), Noise())
    effects = [e for e in catalogue(base.model.formulation).candidates if e.family == "gear"][:2]
    one, other = (Option(e, fit_with(base, [e]), 50.0, 1) for e in effects)
    sets = renewed(((one, other), (other,)), fit_with(base, effects), effects)
    assert [[o.name for o in own] for own in sets] == [[one.name], [other.name]]


def test_play_does_not_pass_for_an_error_over_the_way_that_the_side_goes_with() -> None:
    """Who comes to a far place comes from the near side: a bend of the shoulder's reading looks like play."""
    rng = np.random.default_rng(4)

    def sided(q: Columns, d: Columns) -> Columns:
        d["side_a"] = np.where(rng.random(len(d["a"])) < 0.5 + 0.45 * np.tanh(2 * d["a"] - 1), 1.0, -1.0)
        return {"a": q["a"] - 2e-3 * np.tanh(2 * d["a"] - 1)}

    formulation = Arm().formulate(readings(3, sided))
    known = catalogue(formulation).candidates
    play = next(e for e in known if name_of(e) == "backlash shoulder")
    at = fit_with(fit(Model(formulation), Noise()), [play])
    assert at.noise.gained(fit(Model(formulation), Noise()).cost, at.cost, at.degrees) > 100
    control = shuffled(at, play, play, [e for e in known if e.family == "backlash"])
    assert control is not None
    assert control.p > 0.05


def test_sizes_that_no_machine_has_are_no_candidates() -> None:
    formulation = machines.make("arm").formulate(sources("demo_play", "arm")[0].read({}))
    most = {}
    for effect in catalogue(formulation).candidates:
        most[effect.family] = max(most.get(effect.family, 0.0), float(getattr(effect, "largest", np.inf)))
        if effect.family == "compliance":
            assert is_possible(effect, 9e-8)  # .09 mrad/(N m), of a drive that holds
            assert not is_possible(effect, 1.6e-5)  # 16 mrad/(N m)
    assert most["backlash"] == pytest.approx(0.05)
    assert most["bending"] < 1e-5


def test_an_interval_is_as_wide_as_what_is_left(worn: MeasuredData) -> None:
    formulation = Arm().formulate(worn)
    at = fit(Model(formulation), Noise())
    assert left_scale(at) == pytest.approx(np.sqrt(at.cost / at.degrees))
    assert left_scale(fit(Model(formulation), Noise(scale=50.0))) == 1.0
