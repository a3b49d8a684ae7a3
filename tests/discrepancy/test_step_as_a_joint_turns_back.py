"""A dividing head goes round once forward and once back: a slip as it turns back, and play, are the same readings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from calibench.discrepancy import Instrument, Joint, MeasuredData, Predicted, Roles, explain
from calibench.discrepancy.model.machine import Numbers, Quantities
from calibench.problems.base import Array, Parameter
from tests.few import few

pytestmark = pytest.mark.usefixtures("at_one_noise")

ROLES = Roles(
    joints=(Joint("table", "enc", direction="dir"),), time="t_s",
    instruments=(Instrument("autocollimator", ("seen",), frame=False),),
)  # fmt: skip
STOPS = 2 * np.pi * np.arange(72) / 72


def turned(q: Quantities) -> Numbers:
    """Return where the table stands, (n, 1)."""
    return np.asarray(q["enc"] + q["zero"])[:, None]


@dataclass(frozen=True)
class Head:
    """The head."""

    name: str = "dividing_head"

    def formulate(self, data: MeasuredData) -> Predicted:
        """Return what the autocollimator is predicted to see."""
        zero = (Parameter("zero", "rad", 0.0, -0.1, 0.1),)
        return Predicted(data, turned, zero, {"seen": 2e-6}, inputs=("enc",), unit="rad", roles=ROLES)


def _sets(came: Array, slip_at: int) -> list[set[str]]:
    angle = np.concatenate([STOPS, STOPS[::-1]])
    n = len(angle)
    seen = angle + 0.01 + 1.1e-5 * (np.arange(n) >= slip_at) + 2e-6 * np.random.default_rng(8).standard_normal(n)
    data = MeasuredData({"enc": angle, "dir": came, "t_s": 20.0 * np.arange(n), "seen": seen}, "dividing_head")
    return [{rival.effect for rival in finding.set} for finding in explain(Head(), data).findings]


def test_a_slip_as_a_joint_turns_back_is_a_set_with_its_play() -> None:
    once = np.repeat([1.0, -1.0], 72)
    assert _sets(once, 72) == [{"slip table", "backlash table"}]


@pytest.mark.parametrize("at", few(2, [61, 62, 83, 84]))
def test_a_slip_at_another_time_is_none_of_play(at: int) -> None:
    once = np.repeat([1.0, -1.0], 72)
    assert _sets(once, at)[0] == {"slip table"}


def test_a_slip_of_a_joint_that_comes_from_both_sides_is_none_of_play() -> None:
    both = np.tile([1.0, 1.0, -1.0, -1.0], 36)
    assert _sets(both, 72) == [{"slip table"}]
