"""Machines and effects that ship, and a user's arm, keep the laws of `calibench.testing`."""

from __future__ import annotations

from typing import Any

import pytest

from calibench import testing
from calibench.bench.measured.sources import sources
from calibench.discrepancy import Machine, MeasuredData, machines
from calibench.discrepancy.effects import families
from calibench.discrepancy.machines.gpm2002.description import planned
from calibench.discrepancy.machines.orthoglide.kinematics import printed
from calibench.discrepancy.model.effect import name_of
from calibench.discrepancy.registries import machines as registry
from tests.discrepancy.arm import Arm, readings

CASES: dict[str, tuple[Machine, MeasuredData]] = {
    "gpm2002": (machines.make("gpm2002"), planned(n=40)),
    "gpm2002 with a tracker": (machines.make("gpm2002"), planned(n=40, tracked=True)),
    "orthoglide": (machines.make("orthoglide"), printed("exp1")),
    "orthoglide, both passes": (machines.make("orthoglide"), printed("exp2")),
    "mount": (machines.make("mount"), sources("demo_still", "mount")[0].read({})),
    "delta": (machines.make("delta"), sources("printer", "delta")[0].read({})),
    "table": (machines.make("table"), sources("demo_enso", "table")[0].read({})),
    "arm": (machines.make("arm"), sources("demo_play", "arm")[0].read({})),
    "an arm": (Arm(), readings()),
}

AS_WELL = "orthoglide, both passes"  # keeps what the single pass keeps
LONG = [(testing.machine.slopes_agree_with_differences, name) for name in ("arm", "orthoglide")]  # two seconds each


@pytest.mark.parametrize(
    ("law", "case"),
    [
        pytest.param(law, c, id=f"{law.__name__}-{c}", marks=[pytest.mark.slow] if slow else [])
        for law in testing.MACHINE_LAWS
        for c in CASES
        for slow in [c == AS_WELL or (law, c) in LONG]
    ],
)
def test_a_machine_keeps_the_laws_of_a_users_own(law: Any, case: str) -> None:
    law(*CASES[case])


def test_every_machine_that_ships_is_held_to_them() -> None:
    of_a_file = {"simulator"}  # test_simulator.py writes one, and holds it to them
    assert {machine.name for machine, _ in CASES.values()} == {*machines.names(), "two_link"} - of_a_file


@pytest.mark.parametrize("name", machines.names())
def test_the_name_of_a_machine_that_ships_is_no_option(name: str) -> None:
    assert "name" not in registry.options(name)
    with pytest.raises(ValueError, match=f"{name} has no option 'name'"):
        machines.make(name, name="mine")


def test_a_family_is_checked_candidate_by_candidate() -> None:
    machine, data = CASES["gpm2002"]
    [gear] = [family for family in families("gpm2002") if family.name == "gear"]
    named = {name_of(effect) for effect in gear.candidates(machine.formulate(data)).candidates}
    checks = [name for name, _ in testing.effect_checks(gear, machine, data)]
    assert len(checks) == len(testing.FAMILY_LAWS) + len(named) * len(testing.EFFECT_LAWS)
