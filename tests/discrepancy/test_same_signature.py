"""What to measure next where no pose parts two names: nobody is sent back for more poses."""

from __future__ import annotations

import re
from dataclasses import dataclass
from types import SimpleNamespace

import pytest

from calibench.discrepancy import Instrument, Joint, Predicted, Roles, explain
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting.fit import fit
from calibench.discrepancy.model.effect import name_of
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.search.finding import _separated_by, same_in_any_pose
from calibench.problems.base import Parameter
from tests.discrepancy import arm as closed_arm
from tests.discrepancy.test_general_families import PARAMETERS, SIGMA, place, readings

pytestmark = pytest.mark.usefixtures("at_one_noise")

ROLES = Roles(
    (Joint("shoulder", "a"), Joint("elbow", "b"), Joint("slide", "s", "sliding")),
    instruments=(Instrument("tracker", ("x", "y", "h")),),
)


@dataclass(frozen=True)
class OneSlide:
    """An arm on a slide; where nobody knows the length of its upper arm, that of its screw is the only length."""

    known: float = 0.0
    name: str = "one slide"

    def formulate(self, data):
        free = () if self.known else (Parameter("upper", "mm", 400.0, 390.0, 410.0),)
        held = {"upper": self.known} if self.known else {}
        return Predicted(data, place, (*PARAMETERS, *free), SIGMA, ("a", "b", "s"), held, roles=ROLES)


def _stretched(seed=1):
    """Readings of a slide whose screw is .4 % too coarse."""
    return readings(seed, lambda q, d: {"s": q["s"] * 1.004})


@pytest.mark.slow
def test_the_scales_of_the_only_slide_and_of_the_tracker_are_parted_by_no_pose():
    [found] = explain(OneSlide(), _stretched()).findings
    assert {rival.effect for rival in found.set} == {"gear slide", "instrument_scale tracker"}
    assert found.separated_by.startswith("a known length, a second instrument, or a reading of another kind;")
    assert found.separated_by.endswith("so more poses do not part them")


def test_a_length_that_is_known_parts_them():
    [found] = explain(OneSlide(400.0), _stretched()).findings
    assert [rival.effect for rival in found.set] == ["gear slide"]
    assert found.separated_by is None


def test_of_three_names_the_two_that_no_pose_parts_are_told_beside_the_third():
    formulation = OneSlide().formulate(_stretched())
    model = Model(formulation)
    at = fit(model, Noise(), model.start)
    known = {name_of(e): e for e in catalogue(formulation).candidates}
    alike = [known["gear slide"], known["instrument_scale tracker"]]
    assert same_in_any_pose(at, [*alike, known["gear elbow"], known["eccentricity elbow"]]) == (tuple(alike),)
    said = _separated_by([SimpleNamespace(effect=e) for e in (*alike, known["gear elbow"])], at)
    assert said.startswith(
        "more readings where their signatures differ; no pose parts scale error of slide from scale "
    )
    assert said.endswith("that takes a known length, a second instrument, or a reading of another kind")
    nothing = SimpleNamespace(J=at.J[:0])
    pair = [SimpleNamespace(effect=known[name], fit=nothing) for name in ("gear elbow", "eccentricity shoulder")]
    apart = _separated_by(pair, at)
    assert re.fullmatch("more readings where their signatures differ, such as over wider ranges of .* and .*", apart)


def test_poses_are_made_up_for_no_machine_whose_closure_is_all_that_is_known():
    data = closed_arm.readings()
    model = Model(closed_arm.Arm().formulate(data))
    at = fit(model, Noise(), model.start)
    assert same_in_any_pose(at, catalogue(model.formulation).candidates) == ()
