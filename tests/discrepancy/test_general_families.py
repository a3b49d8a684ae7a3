"""General families: what roles an arm declares, it is searched for, whatever its columns are called."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calibench import testing
from calibench.bench.discovery.page.words import left_sentence
from calibench.discrepancy import (
    DataError,
    EffectFamily,
    Instrument,
    Joint,
    Length,
    LinearEffect,
    MeasuredData,
    Predicted,
    Roles,
    explain,
)
from calibench.discrepancy.effects import catalogue, families
from calibench.discrepancy.effects.general import FAMILIES
from calibench.discrepancy.effects.general.harmonics import PERIODIC
from calibench.discrepancy.labels import effect_label
from calibench.discrepancy.model.effect import name_of
from calibench.discrepancy.registries import effects
from calibench.discrepancy.report import Left, Place, Report
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Parameter

pytestmark = pytest.mark.usefixtures("at_one_noise")

N = 240
PARAMETERS = (
    Parameter("z1", "rad", 0.0, -0.1, 0.1),
    Parameter("fore", "mm", 300.0, 290.0, 310.0),
    Parameter("z2", "rad", 0.0, -0.1, 0.1),
    Parameter("lift", "mm", 0.0, -5.0, 5.0),
)
ROLES = Roles(
    joints=(
        Joint("shoulder", "a", direction="side_a", velocity="rate_a", torque="load_a", teeth=30),
        Joint("elbow", "b", direction="side_b", velocity="rate_b", torque="load_b", teeth=40),
        Joint("slide", "s", "sliding", direction="side_s", velocity="rate_s", torque="load_s", period=5.0),
    ),
    lengths=(Length("upper arm", "upper", force="pull"), Length("forearm", "fore", force="pull")),
    time="clock",
    temperature="warm",
    instruments=(Instrument("tracker", ("x", "y", "h"), ("vx", "vy", "vh")),),
)
WEATHER = replace(ROLES, columns=("weather",))  # fmt: skip
SIGMA = {"x": 0.02, "y": 0.02, "h": 0.02}


def place(q):
    """The tip of an arm of two links on a slide, mm."""
    first = q["a"] + q["z1"]
    second = first + q["b"] + q["z2"]
    x = q["upper"] * np.cos(first) + q["fore"] * np.cos(second)
    y = q["upper"] * np.sin(first) + q["fore"] * np.sin(second)
    return np.stack([x, y, q["s"] + q["lift"]], axis=-1)


class Arm:
    name = "general_arm"

    def __init__(self, roles=ROLES):
        self.roles = roles

    def formulate(self, data):
        return Predicted(data, place, PARAMETERS, SIGMA, ("a", "b", "s"), {"upper": 400.0}, roles=self.roles)


def readings(seed=0, change=lambda q, d: {}, measured=lambda d, xyz: xyz):
    """Readings of an arm of which `change(true joints, columns)` says what the encoders err by: own physics."""
    rng = np.random.default_rng(seed)
    d = {"a": rng.uniform(-1.5, 2.5, N), "b": rng.uniform(0.3, 2.6, N), "s": rng.uniform(-40, 40, N)}
    for joint in "abs":
        d[f"side_{joint}"] = rng.choice([-1.0, 1.0], N)
        d[f"rate_{joint}"] = rng.normal(size=N) * (20.0 if joint == "s" else 0.2)
        d[f"load_{joint}"] = rng.normal(size=N) * (50.0 if joint == "s" else 2e4)
    d |= {"pull": rng.normal(size=N) * 80, "clock": np.arange(N) * 20.0, "warm": 4 * np.sin(np.arange(N) / 70) + 3}
    d |= {"vx": rng.normal(size=N) * 50, "vy": rng.normal(size=N) * 50, "vh": rng.normal(size=N) * 20}
    d["weather"] = rng.uniform(0, 100, N)
    q = {"z1": 0.01, "fore": 301.0, "z2": -0.02, "lift": 0.7, "upper": 400.0} | {k: d[k] for k in "abs"}
    q |= change(q, d)
    xyz = measured(d, place(q)) + 0.02 * rng.standard_normal((N, 3))
    return MeasuredData(d | dict(zip("xyh", xyz.T)), "general_arm", {}, "arm")


HIDDEN = {
    "gear elbow": (lambda q, d: {"b": q["b"] * 1.002}, 0.002),
    "backlash shoulder": (lambda q, d: {"a": q["a"] - 2e-4 * d["side_a"]}, 4e-4),
    "backlash slide": (lambda q, d: {"s": q["s"] - 0.05 * d["side_s"]}, 0.1),
    "compliance elbow": (lambda q, d: {"b": q["b"] - 1.5e-8 * d["load_b"]}, 1.5e-8),
    "compliance slide": (lambda q, d: {"s": q["s"] - 2e-3 * d["load_s"]}, 2e-3),
    "lag shoulder": (lambda q, d: {"a": q["a"] + 2e-3 * d["rate_a"]}, 2e-3),
    "thermal_zero elbow": (lambda q, d: {"b": q["b"] + 1e-4 * d["warm"]}, 1e-4),
    "eccentricity shoulder": (lambda q, d: {"a": q["a"] + np.arcsin(5e-4 * np.sin(q["a"] + 0.4))}, 5e-4),
    "screw_error slide": (lambda q, d: {"s": q["s"] + 0.04 * np.sin(2 * np.pi * q["s"] / 5 + 0.4)}, 0.04),
    "second_harmonic slide": (lambda q, d: {"s": q["s"] + 0.04 * np.sin(4 * np.pi * q["s"] / 5 + 0.4)}, 0.04),
    "cyclic elbow": (lambda q, d: {"b": q["b"] + 3e-4 * np.sin(40 * q["b"] + 1.0)}, 3e-4),
    "drift elbow": (lambda q, d: {"b": q["b"] + 6e-4 * d["clock"] / np.ptp(d["clock"])}, 6e-4),
    "slip shoulder": (lambda q, d: {"a": q["a"] + 5e-4 * (d["clock"] > 2000)}, 5e-4),
    "thermal_length forearm": (lambda q, d: {"fore": q["fore"] * (1 + 4e-5 * d["warm"])}, 4e-5),
    "axial_compliance forearm": (lambda q, d: {"fore": q["fore"] + 1e-3 * d["pull"]}, 1e-3),
    "clearance upper arm": (lambda q, d: {"upper": q["upper"] + 0.05 * np.sign(d["pull"])}, 0.1),
    "free_number upper": (lambda q, d: {"upper": 400.4}, 0.4),
}  # fmt: skip
OUTSIDE = {
    "instrument_lag tracker": lambda d, xyz: xyz - 1e-3 * np.stack([d["vx"], d["vy"], d["vh"]], axis=-1),
    "frame_drift tracker": lambda d, xyz: (
        xyz + np.array([0.1, -0.05, 0.08]) * (d["clock"] / np.ptp(d["clock"]))[:, None]
    ),
    "frame_shift tracker": lambda d, xyz: xyz + np.array([0.1, -0.05, 0.08]) * (d["clock"] > 2000)[:, None],
    "polynomial weather in x": lambda d, xyz: xyz + np.outer(2e-5 * ((d["weather"] - 50) ** 2 - 833), [1, 0, 0]),
    "cycle weather in y": lambda d, xyz: xyz + np.outer(0.05 * np.sin(2 * np.pi * d["weather"] / 13.3), [0, 1, 0]),
}


@pytest.mark.parametrize(
    "name", [n if k % 12 == 0 else pytest.param(n, marks=pytest.mark.slow) for k, n in enumerate(HIDDEN)]
)
def test_what_is_wrong_with_a_part_is_named_after_it(name):
    change, size = HIDDEN[name]
    report = explain(Arm(), readings(1, change))
    found = report.findings[0]
    assert name in {rival.effect for rival in found.set}
    assert len(found.set) <= 3
    if found.effect == name:
        low, high = sorted(abs(end) for end in found.amplitude.ci95)
        assert low * 0.9 < size < high * 1.1


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [n if k < 2 else pytest.param(n, marks=pytest.mark.slow) for k, n in enumerate(OUTSIDE)]
)
def test_what_is_wrong_with_the_instrument_is_named_after_it(name):
    report = explain(Arm(WEATHER if "weather" in name else ROLES), readings(2, measured=OUTSIDE[name]))
    assert name in {rival.effect for rival in report.findings[0].set}
    assert len(report.findings[0].set) <= 2


@pytest.mark.slow
def test_a_frame_that_turns_as_it_moves_is_named_with_its_turn():
    """A stand that leans over during the run: exact rotations about a foot that is not the middle of the readings."""

    def leaning(d, xyz):
        angle = 4e-4 * d["clock"] / np.ptp(d["clock"])
        foot = np.array([900.0, -400.0, 0.0])
        x, y, h = (xyz - foot).T
        turned = np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle), h], axis=-1)
        return foot + turned

    report = explain(Arm(), readings(3, measured=leaning))
    [found] = report.findings
    assert {rival.effect for rival in found.set} == {"frame_drift tracker"}
    told = {c.name: (c.value, c.sd, c.unit) for c in found.coefficients}
    assert told["turn z"][2] == "rad"
    assert abs(told["turn z"][0] - 4e-4) < 3 * told["turn z"][1] < 1e-4
    assert found.amplitude.unit == "mm"
    assert report.gap.train_after < 1.1


def test_the_scale_of_an_instrument_is_not_looked_for_in_its_own_noise():
    """Readings about zero: each error would be explained by the reading that it is in."""
    y = 0.02 * np.random.default_rng(0).standard_normal(200)
    data = MeasuredData({"u": np.arange(200.0), "y": y}, "gauge at rest", {}, "gauge")

    class AtRest:
        name = "gauge at rest"

        def formulate(self, data):
            mean = Parameter("mean", "mm", 0.0, -1.0, 1.0)
            return Predicted(data, lambda q: q["mean"] + 0 * q["u"], (mean,), {"y": 0.02}, ("u",),
                             roles=Roles(instruments=(Instrument("gauge", ("y",)),)))  # fmt: skip

    report = explain(AtRest(), data)
    assert report.verdict == "none"
    [told] = [u for u in report.not_testable if u.family == "instrument_scale"]
    assert "too near to its noise" in told.reason


def test_a_frame_that_only_shifts_is_told_by_its_shifts():
    report = explain(Arm(), readings(2, measured=OUTSIDE["frame_drift tracker"]))
    assert [c.name for c in report.findings[0].coefficients] == ["dx", "dy", "dh"]


@pytest.mark.slow
def test_columns_are_called_what_the_roles_have_them_for():
    change = HIDDEN["backlash shoulder"][0]
    report = explain(Arm(), readings(1, lambda q, d: {"a": change(q, d)["a"] + 1e-3 * (d["load_b"] > 0)}))
    assert report.words["side_a"] == "direction of shoulder"
    assert report.words["load_s"] == "force of slide"
    assert report.words["pull"] == "force along upper arm"
    place = Place("x", "load_b", 1e-9)
    assert "over the torque of elbow" in left_sentence(replace(report, verdict="partly", left=Left(2.0, place)))
    assert Report.from_dict(report.to_dict()).words == report.words


@pytest.mark.parametrize("seed", [3, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (4, 5))])
def test_an_arm_with_all_roles_that_lacks_nothing_is_told_so(seed):
    assert explain(Arm(), readings(seed)).verdict == "none"


def test_every_general_family_has_a_candidate_of_an_arm_with_all_roles():
    held = Arm(WEATHER).formulate(readings())
    assert {name_of(e).split(" ")[0] for e in catalogue(held).candidates} >= {f.name for f in FAMILIES} - {
        *PERIODIC,
        "sign",
        "magnitude",
    }  # of a joint of unknown period, and of a column that changes its sign


def test_every_general_family_keeps_the_laws_of_an_effect():
    free = Roles((Joint("slide", "s", "sliding"),))
    for family in FAMILIES:
        data = readings().rows(np.arange(0, 180, 4))
        if family.name in ("sign", "magnitude"):
            data = data.with_columns({"weather": data["weather"] - 50.0})
        for _, check in testing.effect_checks(family, Arm(free if family.name in PERIODIC else WEATHER), data):
            check()


@pytest.mark.slow
def test_every_error_of_an_axis_is_told_in_the_unit_that_its_owner_asked_for():
    asked, usual = (tuple(replace(j, told=unit) for j in ROLES.joints[:2]) for unit in ("arcsec", ""))
    arcsec = np.pi / 180 / 3600
    found, as_read = (catalogue(Arm(Roles(joints, time="clock")).formulate(readings())) for joints in (asked, usual))
    rigid = {"gear": "1", "lag": "s"}
    assert {e.family for e in found.candidates} >= {"eccentricity", "second_harmonic", "angle_error", "cyclic"}
    q = {"a": readings()["a"], "b": readings()["b"]}
    both = zip(found.candidates, as_read.candidates, strict=True)
    for one, other in ((one, other) for one, other in both if one.target in ("shoulder", "elbow")):
        assert rigid.get(one.family, "arcsec") == one.unit.partition("/")[0]
        assert {unit for unit in one.units if unit != "1" or one.unit == "1"} == {one.unit}
        if one.unit.startswith("arcsec"):
            c = np.linspace(30.0, 50.0, len(one.units))
            turned = np.where(np.array(one.units) == one.unit, arcsec, 1.0)  # cycles of a wave stay cycles
            here, there = (
                one.shift(q, readings(), c),
                other.shift(q, readings(), c * turned),
            )
            for name, moved in here.items():
                np.testing.assert_allclose(moved, there[name], rtol=1e-12)
            basis, bare = one.basis(q, readings(), c), other.basis(q, readings(), c * turned)
            for name, slope in basis.items():
                np.testing.assert_allclose(slope, turned * bare[name], rtol=1e-12, atol=1e-30)
    free = tuple(Joint(name, reading, told="arcsec") for name, reading in (("shoulder", "a"), ("elbow", "b")))
    waves = [e for e in catalogue(Arm(Roles(free)).formulate(readings())).candidates if e.family in PERIODIC]
    assert {(wave.units, wave.period_unit) for wave in waves} == {(("arcsec", "arcsec", "1"), "rad")}
    assert waves[0].largest == pytest.approx(thresholds().largest_angle / arcsec, rel=1e-9)


def test_what_is_not_declared_is_not_testable_and_says_what_to_declare():
    bare = Roles((Joint("elbow", "b"), Joint("slide", "s", "sliding")), (Length("forearm", "fore"),))
    known = {f"{u.family} {u.target}": u for u in catalogue(Arm(bare).formulate(readings())).untestable}
    assert known["backlash elbow"].reason == "elbow declares no direction: with a column of it this could be tested"
    assert known["compliance slide"].reason.startswith("slide declares no force")
    assert known["cyclic elbow"].reason == "nobody states the number of teeth of elbow: Joint(teeth=...)"
    assert known["screw_error slide"].reason == "nobody states the period of slide: Joint(period=...), in mm"
    assert all(one.missing for name, one in known.items() if name != "clearance")


def test_a_column_that_is_declared_and_not_there_is_named():
    data = readings()
    data = MeasuredData({k: v for k, v in data.columns.items() if k != "side_b"}, data.machine, {}, data.name)
    [told] = [u for u in catalogue(Arm().formulate(data)).untestable if (u.family, u.target) == ("backlash", "elbow")]
    assert (told.reason, told.columns, told.missing) == ("needs column side_b", ("side_b",), True)


def test_a_screw_of_unknown_pitch_gets_its_period():
    free = Roles((Joint("slide", "s", "sliding"),))
    report = explain(Arm(free), readings(4, lambda q, d: {"s": q["s"] + 0.04 * np.sin(2 * np.pi * q["s"] / 7.3)}))
    [found] = report.findings
    assert found.effect == "periodic_error slide"
    [effect] = report.fitted.model.model.effects
    assert effect.period(report.fitted.model.best[-3:]) == pytest.approx(7.3, rel=0.01)


@pytest.mark.slow
def test_cycles_come_one_after_another_until_none_is_left():
    n, u = 168, np.arange(168.0)
    rng = np.random.default_rng(0)
    y = 10 + 3 * np.cos(2 * np.pi * u / 12) + 1.8 * np.sin(2 * np.pi * u / 26.6) + 1.2 * np.cos(2 * np.pi * u / 44)
    data = MeasuredData({"u": u, "y": y + 0.8 * rng.standard_normal(n)}, "table_of_cycles", {}, "table")

    class Table:
        name = "table_of_cycles"

        def formulate(self, data):
            mean = Parameter("mean", "1", 10.0, 0.0, 20.0)
            return Predicted(data, lambda q: q["mean"] + 0 * q["u"], (mean,), {"y": 0.8}, ("u",), unit="",
                             roles=Roles(columns=("u",)))  # fmt: skip

    report = explain(Table(), data)
    model, x = report.fitted.model.model, report.fitted.model.best
    periods = sorted(e.period(x[1 + 3 * k : 4 + 3 * k]) for k, e in enumerate(model.effects))
    np.testing.assert_allclose(periods, [12, 26.6, 44], rtol=0.03)
    assert report.gap.train_after < 1.1


@pytest.mark.slow  # quickly: every law of units of a machine, and every error of an axis in both
def test_degrees_and_radians_are_one_joint():
    data = readings(5, HIDDEN["eccentricity shoulder"][0])
    report = explain(Arm(), data)

    class Degrees:
        name = "general_arm"

        def formulate(self, data):
            roles = Roles((Joint("shoulder", "a", unit="deg"),))
            data = data.with_columns({"a": np.degrees(data["a"])})
            return Predicted(data, lambda q: place(q | {"a": q["a"] * np.pi / 180}), PARAMETERS, SIGMA, ("a", "b", "s"),
                             {"upper": 400.0}, roles=roles)  # fmt: skip

    other = explain(Degrees(), data)
    assert other.findings[0].effect == report.findings[0].effect == "eccentricity shoulder"
    assert np.radians(other.findings[0].amplitude.value) == pytest.approx(report.findings[0].amplitude.value, rel=1e-5)


def test_a_machines_own_family_comes_before_the_general_one(monkeypatch):
    for kept in ("_factories", "_options", "_order"):
        monkeypatch.setattr(effects, kept, dict(getattr(effects, kept)))
    EffectFamily("backlash", "general_arm", "own", "own", "reading", (), "rad", ("elbow",), lambda f, t: ()).enter()
    own = [family for family in families("general_arm") if family.name == "backlash"]
    assert [family.cause for family in own] == ["own"]


def test_a_set_never_holds_a_rival_that_the_catalogue_does_not_have(monkeypatch):
    for kept in ("_factories", "_options", "_order"):
        monkeypatch.setattr(effects, kept, dict(getattr(effects, kept)))

    def build(formulation, target):
        def changes(q, data):
            return {"b": -data["load_b"][:, None]}

        twins = ("bending forearm", "compliance elbow")
        return (
            LinearEffect(
                "twist", target, "b -= k load", "reading", ("load_b",), ("k",), ("rad",), "rad", changes, twins
            ),
        )

    EffectFamily("twist", "general_arm", "own", "own", "reading", (), "rad", ("elbow",), build).enter()
    [twist] = [e for e in catalogue(Arm().formulate(readings())).candidates if e.family == "twist"]
    assert twist.twins == ("compliance elbow",)


def test_a_large_effect_of_unit_1_does_not_vanish(monkeypatch):
    for kept in ("_factories", "_options", "_order"):
        monkeypatch.setattr(effects, kept, dict(getattr(effects, kept)))

    def build(formulation, target):
        def changes(q, data):
            return {"s": 0.3 * np.sin(data["weather"])[:, None]}

        return (LinearEffect("surge", target, "s += k 0.3 sin", "reading", ("weather",), ("k",), ("1",), "1", changes),)

    EffectFamily("surge", "general_arm", "own", "own", "reading", (), "1", ("slide",), build).enter()
    report = explain(Arm(), readings(6, lambda q, d: {"s": q["s"] + 0.3 * 0.9 * np.sin(d["weather"])}))
    assert (report.verdict, report.findings[0].effect) == ("named", "surge slide")
    assert report.findings[0].amplitude.value == pytest.approx(0.9, rel=0.05)


def test_a_wrong_gear_ratio_is_named_however_large():
    report = explain(Arm(), readings(7, lambda q, d: {"s": q["s"] * 1.27}))
    assert report.findings[0].effect == "gear slide"
    assert report.findings[0].amplitude.value == pytest.approx(0.27, rel=0.01)


@pytest.mark.slow
def test_what_is_too_large_to_be_possible_is_told():
    report = explain(Arm(), readings(8, lambda q, d: {"a": q["a"] - 0.2 * d["side_a"]}))
    assert "backlash shoulder" not in {f.effect for f in report.findings}
    told = [note for note in report.notes if note.text.startswith("backlash of shoulder would explain most")]
    assert len(told) == 1
    assert "rad: taken for impossible" in told[0].text


def test_no_column_moves_a_joint_further_than_its_sensor_may_err():
    data = readings()
    q = {"a": data["a"], "b": data["b"], "s": data["s"]}
    follow = [
        e for e in catalogue(Arm().formulate(data)).candidates if e.family in ("compliance", "lag", "thermal_zero")
    ]
    assert {e.family for e in follow if np.isfinite(e.largest)} == {"compliance", "lag", "thermal_zero"}
    t = thresholds()
    most = {"compliance": t.softest_drive, "lag": t.largest_lag, "thermal_zero": t.largest_warm_zero}
    for effect in follow:
        if effect.target == "slide" and effect.family != "lag":
            assert effect.largest == np.inf  # a slide may err by any length
            continue
        assert effect.largest <= most[effect.family]
        if effect.largest == most[effect.family]:
            continue
        moved = effect.shift(q, data, np.array([effect.largest]))
        furthest = max(np.max(np.abs(error)) for name, error in moved.items() if name != "s")
        assert furthest == pytest.approx(t.largest_windup if effect.family == "compliance" else t.largest_angle)


@pytest.mark.slow
def test_a_zero_that_would_turn_with_each_kelvin_is_taken_for_impossible():
    turned = readings(9, lambda q, d: {"a": q["a"] + 0.13 * (d["warm"] - d["warm"].mean())})
    report = explain(Arm(), turned)
    assert "thermal_zero shoulder" not in {f.effect for f in report.findings}
    assert any("thermal shift of the zero of shoulder would explain most" in note.text for note in report.notes)


def test_parts_of_one_name_are_refused():
    with pytest.raises(DataError, match="elbow twice"):
        Roles((Joint("elbow", "a"), Joint("elbow", "b")))
    with pytest.raises(DataError, match="kind 'round'"):
        Joint("elbow", "a", "round")
    with pytest.raises(DataError, match="each of x, y"):
        Instrument("tracker", ("x", "y"), ("vx",))


def test_a_direction_in_three_words_is_told_and_costs_no_row() -> None:
    data = readings()
    named = {"side_b": np.where(data["side_b"] > 0, "auf", "ab").astype(object)}
    named["side_b"][0] = "quer"
    told = Arm().formulate(data.with_columns(named)).data
    assert len(told) == N
    assert any(
        note.text.startswith("column side_b holds words ('ab', 'auf', 'quer'), where numbers are needed")
        for note in told.notes
    )
    built = catalogue(Arm().formulate(data.with_columns(named)))
    reasons = {one.reason for one in built.untestable if (one.family, one.target) == ("backlash", "elbow")}
    assert reasons == {"column side_b holds words: numbers are needed"}


@pytest.mark.parametrize(("down", "up"), [("ab", "auf"), ("-", "+"), ("down ", "up")])
def test_a_direction_in_two_words_is_one_in_signs(down: str, up: str) -> None:
    data = readings()
    told = Arm().formulate(data.with_columns({"side_b": np.where(data["side_b"] > 0, up, down)})).data
    assert np.array_equal(told["side_b"], np.where(data["side_b"] > 0, 1.0, -1.0))
    assert any(note.text.startswith(f"column side_b: {down.strip()!r} is taken for -1") for note in told.notes)


def test_a_smooth_error_is_called_after_what_the_joint_does():
    found = catalogue(Arm().formulate(readings()))
    smooth = {e.target: e.family for e in found.candidates if e.family.endswith("_error") and e.family not in PERIODIC}
    assert smooth == {"shoulder": "angle_error", "elbow": "angle_error", "slide": "position_error"}
    assert effect_label("general_arm", "position_error", "slide") == "position error of slide"


def test_an_axis_that_slides_has_a_screw_and_no_eccentric_disc():
    names = {f"{e.family} {e.target}" for e in catalogue(Arm().formulate(readings())).candidates}
    assert {"screw_error slide", "eccentricity elbow"} <= names
    assert not {"eccentricity slide", "screw_error elbow"} & names
    assert effect_label("any", "screw_error", "slide") == "periodic screw error of slide"
