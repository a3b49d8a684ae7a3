"""Laws over the catalogue: identity at zero, derivatives that are derivatives, twins, and what cannot be tested."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.discrepancy import MeasuredData, machines
from calibench.discrepancy.design.detectability import WhitenedDesign
from calibench.discrepancy.effects import catalogue, families
from calibench.discrepancy.effects.general.lengths import warmth
from calibench.discrepancy.machines.gpm2002.description import planned
from calibench.discrepancy.model.effect import ChangePoint, Effect, finer, name_of
from calibench.discrepancy.thresholds import THRESHOLDS
from calibench.problems.base import Array

FAMILIES = {
    "eccentricity", "second_harmonic", "angle_error", "gear", "cyclic", "slip", "drift", "quantisation", "outlier",
    "heavy_tails", "backlash", "lag", "tracker_lag", "compliance", "proximal_bending", "axial_compliance", "clearance",
    "thermal_links", "thermal_leg", "thermal_base", "base_shift",
}  # fmt: skip
NOISE = {"quantisation", "outlier", "heavy_tails"}


def a_view(tracked: bool, n: int = 40, **options: object) -> WhitenedDesign:
    return WhitenedDesign(machines.make("gpm2002").formulate(planned(n=n, tracked=tracked, **options)))  # type: ignore[arg-type]


VIEWS = {tracked: a_view(tracked) for tracked in (False, True)}
EFFECTS = {tracked: catalogue(view.formulation).candidates for tracked, view in VIEWS.items()}


def one_of_each(tracked: bool) -> dict[str, Effect]:
    """Return one candidate a name, the last of several forms."""
    return {name_of(effect): effect for effect in EFFECTS[tracked]}


def cosine(left: Array, right: Array) -> float:
    """Return the cosine of the largest angle between two subspaces, given by orthonormal columns."""
    return float(np.linalg.svd(left.T @ right, compute_uv=False)[-1])


def test_the_catalogue_has_the_agreed_names() -> None:
    assert {family.name for family in families("gpm2002")} == FAMILIES
    named = {effect.family for effect in EFFECTS[True]}
    assert named == FAMILIES - NOISE
    targets = {effect.target for effect in EFFECTS[True]}
    assert targets == {f"{kind} {i}" for kind in ("joint", "leg", "base") for i in (1, 2, 3)} | {"all", "tracker"}


@pytest.mark.parametrize("tracked", [False, True])
def test_declared_twins_leave_the_same_trace_and_others_do_not(tracked: bool) -> None:
    view, effects = VIEWS[tracked], one_of_each(tracked)
    declared = {name: set(effect.twins) for name, effect in effects.items()}
    seen = [name for name, effect in effects.items() if view.rest(effect).fraction >= THRESHOLDS.invisible]
    rests = {name: view.rest(effects[name]).directions for name in seen}
    for name in seen:
        for other in seen:
            if name >= other or rests[name].shape[1] != rests[other].shape[1]:
                continue
            twins = other in declared[name]
            assert twins == (name in declared[other]), (name, other)
            alike = cosine(rests[name], rests[other])
            assert (alike > 1 - 1e-6) == twins, (name, other, alike)


def test_twins_depend_on_what_is_read() -> None:
    angles, tracked = one_of_each(False), one_of_each(True)
    assert angles["thermal_links all"].twins == ("thermal_base all",)
    assert tracked["thermal_links all"].twins == ()
    assert angles["compliance joint 2"].twins == tracked["compliance joint 2"].twins == ("proximal_bending leg 2",)
    assert tracked["lag all"].twins == ("tracker_lag tracker",)


def test_angles_only_do_not_see_encoders_that_are_late_together() -> None:
    assert VIEWS[False].rest(one_of_each(False)["lag all"]).fraction < THRESHOLDS.invisible
    assert VIEWS[True].rest(one_of_each(True)["lag all"]).fraction > 0.1


def test_angles_only_do_not_see_everything_grow() -> None:
    view, effects = VIEWS[False], one_of_each(False)
    links, base = (view.signature(effects[name]) for name in ("thermal_links all", "thermal_base all"))
    assert np.linalg.norm(links + base) < 1e-6 * np.linalg.norm(links)
    tracked, effects = VIEWS[True], one_of_each(True)
    links, base = (tracked.signature(effects[name])[:, :1] for name in ("thermal_links all", "thermal_base all"))
    assert np.linalg.norm(links + base) > 0.1 * np.linalg.norm(links)


@pytest.mark.parametrize(
    ("family", "column"),
    [
        ("slip", "t_s"), ("drift", "t_s"), ("base_shift", "t_s"), ("backlash", "dir"), ("lag", "vel"),
        ("compliance", "tau"), ("proximal_bending", "tau"), ("axial_compliance", "axial"), ("clearance", "axial"),
        ("thermal_links", "temp_K"), ("thermal_leg", "temp_K"), ("thermal_base", "temp_K"),
        ("cyclic", "tooth_numbers"), ("tracker_lag", "x"),
    ],
)  # fmt: skip
def test_a_missing_column_makes_its_effects_not_testable_and_names_it(family: str, column: str) -> None:
    without = () if column == "x" else (column,)
    known = catalogue(machines.make("gpm2002").formulate(planned(n=40, without=without)))
    found, gaps = known.candidates, known.untestable
    assert family not in {effect.family for effect in found}
    reasons = [gap.reason for gap in gaps if gap.family == family]
    assert reasons
    assert all(column in reason for reason in reasons)


def test_one_leg_without_its_column_leaves_the_others_testable() -> None:
    known = catalogue(machines.make("gpm2002").formulate(planned(n=40, without=("dir_2",))))
    found, gaps = known.candidates, known.untestable
    assert {e.target for e in found if e.family == "backlash"} == {"joint 1", "joint 3"}
    assert [(gap.target, gap.reason) for gap in gaps if gap.family == "backlash"] == [
        ("joint 2", "needs column dir_2")
    ]  # fmt: skip


def test_a_column_that_does_not_vary_cannot_test_anything() -> None:
    data = planned(n=40)
    still = data.with_columns({"temp_K": np.full(len(data), 3.0), "axial_1": np.abs(data["axial_1"]) + 1})
    known = catalogue(machines.make("gpm2002").formulate(still))
    found, gaps = known.candidates, known.untestable
    reasons = {(gap.family, gap.target): gap.reason for gap in gaps}
    assert "temp_K is constant" in reasons["thermal_base", "all"]
    assert "never changes its sign" in reasons["clearance", "leg 1"]
    assert "axial_compliance leg 1" in {name_of(effect) for effect in found}


@pytest.mark.parametrize("stated", [[40, 48, 56], {"1": 40, "2": 48, "3": 56}, {"joint 2": 48}, 48])
def test_tooth_numbers_are_taken_as_a_list_a_mapping_or_one_number(stated: object) -> None:
    data = planned(n=40)
    data = type(data)(data.columns, data.machine, {**data.metadata, "tooth_numbers": stated}, data.name)
    known = catalogue(machines.make("gpm2002").formulate(data))
    found = known.candidates
    effect = next(e for e in found if name_of(e) == "cyclic joint 2")
    assert effect.coefficients == ("a48", "b48")


def test_an_eccentric_disc_is_exact() -> None:
    """The head is at distance R of the axis O, the disc's centre C at e from it: the angles at C and O differ."""
    turn, e, phase = np.linspace(-3, 3, 50), 0.2, 0.7  # e in radii of the head's circle
    head = np.exp(-1j * turn) - e * np.exp(1j * phase)  # as the disc sees it
    read = -np.angle(head)
    read += 2 * np.pi * np.round((turn - read) / (2 * np.pi))
    [effect] = [x for x in EFFECTS[False] if name_of(x) == "eccentricity joint 1"]
    c = -e * np.array([np.sin(phase), np.cos(phase)])
    change = effect.shift({"enc_1": read}, VIEWS[False].formulation.data, c)["enc_1"]
    assert np.allclose(read + change, turn, atol=1e-12)
    assert effect.amplitude(c) == pytest.approx(e)


def test_steps_are_looked_for_between_readings_and_then_more_finely() -> None:
    data = planned(n=300, visits=2)
    known = catalogue(machines.make("gpm2002").formulate(data)).candidates
    slips = [e for e in known if isinstance(e, ChangePoint) and name_of(e) == "slip joint 2"]
    assert 30 <= len(slips) <= 40
    t, edge = np.sort(data["t_s"]), len(data) // 25
    assert all(t[edge - 1] < e.at < t[-edge] for e in slips)
    assert {e.positions for e in slips} == {len(slips)}
    first = slips[10]
    near = finer(first, data)
    assert {name_of(e) for e in near} == {"slip joint 2"}
    assert len(near) > 5
    assert all(abs(e.at - first.at) < slips[12].at - first.at for e in near if isinstance(e, ChangePoint))
    assert finer(one_of_each(False)["gear joint 1"], data) == ()


def test_shifting_the_clock_changes_no_trace() -> None:
    data = planned(n=40)
    late = data.with_columns({"t_s": data["t_s"] + 1e6})
    for now, then in zip(
        *(catalogue(machines.make("gpm2002").formulate(d)).candidates for d in (data, late)), strict=True
    ):
        if now.family in ("slip", "drift", "base_shift"):
            c = np.ones(len(now.coefficients))
            q = VIEWS[False].q
            a, b = now.shift(q, data, c), then.shift(q, late, c)
            assert all(np.allclose(a[name], b[name], atol=1e-9) for name in a), name_of(now)


def test_a_family_with_nothing_to_test_says_so() -> None:
    formulation = machines.make("gpm2002").formulate(planned(n=40))
    [family] = [f for f in families("gpm2002") if f.name == "tracker_lag"]
    known = family.candidates(formulation)
    assert known.candidates == ()
    [told] = known.untestable
    assert (told.reason, told.columns, told.missing) == ("needs columns x, y", ("x", "y"), True)


def test_tracks_of_unequal_gain_are_exact() -> None:
    """The angle of ((1 - a) cos x, (1 + a) sin x) is not x: the catalogue takes it back to x."""
    turn, a = np.linspace(-3, 3, 50), 0.15
    read = np.unwrap(np.arctan2((1 + a) * np.sin(turn), (1 - a) * np.cos(turn)))
    known = catalogue(machines.make("gpm2002").formulate(planned(n=50)))
    found = known.candidates
    effect = next(e for e in found if name_of(e) == "second_harmonic joint 1")
    error = effect.shift({"enc_1": read}, planned(n=50), np.array([0.0, -a]))["enc_1"]
    assert np.allclose(np.exp(1j * (read + error)), np.exp(1j * turn))


def test_members_follow_the_thermometer_by_the_lag_of_first_order() -> None:
    t = np.sort(np.random.default_rng(7).uniform(0, 1000, 200))
    data = MeasuredData({"t_s": t, "temp_K": 0.01 * (t - t[0])}, "gpm2002")
    late = 45.0
    exact = 0.01 * (t - t[0] - late * -np.expm1(-(t - t[0]) / late))  # of a ramp
    assert np.allclose(warmth(data, late, "temp_K", "t_s", data), exact, atol=0.002)
