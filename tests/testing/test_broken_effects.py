"""Each law of an effect and of a family is broken on purpose by a small fake, and caught in one line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from calibench import testing
from calibench.discrepancy import EffectFamily, LinearEffect, MeasuredData, needs
from tests.discrepancy.arm import Arm, readings

DATA = readings()
DATA = DATA.with_columns({"payload_N": np.resize([0.0, 10.0, 20.0], len(DATA))})

PAYLOAD = DATA["payload_N"]


def sag(**changed: Any) -> LinearEffect:
    """Return an effect that keeps every law: the second drive gives way under the payload."""
    fields = {
        "family": "sag", "target": "joint 2", "formula": "enc_2 -= k payload_N", "channel": "reading",
        "columns": ("payload_N",), "coefficients": ("k",), "units": ("rad/N",), "unit": "rad/N",
        "changes": lambda q, data: {"enc_2": -data["payload_N"][:, None]},
    }  # fmt: skip
    return LinearEffect(**{**fields, **changed})


@dataclass(frozen=True)
class Bent:
    """The same, with `shift` or `basis` replaced."""

    whole: Any
    shift: Any = None
    basis: Any = None

    def __getattribute__(self, name: str) -> Any:
        mine = object.__getattribute__(self, "__dict__")
        return mine[name] if mine.get(name) is not None else getattr(mine["whole"], name)


def payload(data: MeasuredData) -> Any:
    return data["payload_N"]


EFFECTS: list[tuple[str, Any, str]] = [
    ("it_is_named_and_has_units", sag(formula=""), "an effect states its formula"),
    ("it_is_named_and_has_units", sag(units=("rad", "N")), "every coefficient has its unit"),
    ("it_is_named_and_has_units", sag(measure=lambda c: 1.0), "the amplitude of zero is zero"),
    ("its_columns_are_in_the_data", sag(columns=("temp_K",)), r"found no \['temp_K'\]"),
    ("zero_changes_nothing", Bent(sag(), shift=lambda q, data, c: {"enc_2": 1e-9 + 0 * payload(data)}), "a change of"),
    ("zero_changes_nothing", sag(changes=lambda q, data: {}), "it changes a quantity; found nothing"),
    (
        "it_changes_quantities_of_the_machine",
        sag(changes=lambda q, data: {"elbow": payload(data)[:, None]}), "found elbow; the machine has la, z1",
    ),
    (
        "it_changes_quantities_of_the_machine",
        Bent(sag(), basis=lambda q, data, c: {"enc_2": -payload(data)}), r"enc_2 changes by \(180, 1\)",
    ),
    (
        "a_row_changes_by_what_stands_in_it",
        sag(changes=lambda q, data: {"enc_2": (payload(data).mean() - payload(data))[:, None]}),
        r"a gap of .* in enc_2 where 2 of 180 rows are given; take a mean",
    ),
    (
        "a_row_changes_by_what_stands_in_it",
        sag(changes=lambda q, data: {"enc_2": np.gradient(payload(data))[:, None]}), "a gap of",
    ),
    (
        "a_row_changes_by_what_stands_in_it",
        sag(changes=lambda q, data: {"enc_2": -PAYLOAD[:, None]}), "a gap of inf",
    ),
    (
        "basis_is_the_derivative_of_shift",
        Bent(sag(), basis=lambda q, data, c: {"enc_2": payload(data)[:, None]}), "basis is the derivative of shift",
    ),
    (
        "signature_is_the_derivative_of_the_residuals",
        Bent(sag(), basis=lambda q, data, c: {"enc_2": -1.001 * payload(data)[:, None]}), "its signature is the deriv",
    ),
]  # fmt: skip


def family(build: Any, **changed: Any) -> EffectFamily:
    fields = {
        "name": "sag", "machine": "two_link", "cause": "A drive gives way", "formula": "enc_2 -= k payload_N",
        "channel": "reading", "columns": ("payload_N",), "unit": "rad/N", "targets": ("joint 2",), "build": build,
    }  # fmt: skip
    return EffectFamily(**{**fields, **changed})


def careful(formulation: Any, target: str) -> Any:
    needs(formulation.data, "payload_N")
    return (sag(target=target),)


def asks_for_warmth(formulation: Any, target: str) -> Any:
    needs(formulation.data, "temp_K")
    return (sag(target=target),)


FAMILIES: list[tuple[str, Any, str]] = [
    ("the_family_is_named", family(careful, cause=""), "a family states its cause"),
    ("the_family_is_named", family(careful, targets=()), "sag: it has targets; found none"),
    ("the_family_is_named", family(careful, name="droop"), "droop: candidates bear its name"),
    ("the_data_can_test_some_of_it", family(asks_for_warmth), "joint 2: needs column temp_K; check it on other data"),
    ("a_missing_column_makes_it_not_testable", family(lambda f, t: (sag(),)), "without payload_N it is not testable"),
    (
        "a_missing_column_makes_it_not_testable",
        family(lambda f, t: (sag(),) if np.ptp(f.data.columns["payload_N"]) else ()), "found KeyError",
    ),
]  # fmt: skip


def caught(checks: Any, law: str, said: str) -> None:
    with pytest.raises(AssertionError, match=said) as broken:
        dict(checks)[law]()
    assert "\n" not in str(broken.value)
    assert str(broken.value).count("; ") >= 2  # law; what was found; what to do


@pytest.mark.parametrize(("law", "effect", "said"), EFFECTS, ids=[f"{law}-{said[:12]}" for law, _, said in EFFECTS])
def test_a_broken_law_of_effects_is_told_in_one_line(law: str, effect: Any, said: str) -> None:
    caught(testing.effect_checks(effect, Arm(), DATA), law, said)


@pytest.mark.parametrize(("law", "broken", "said"), FAMILIES, ids=[f"{law}-{said[:12]}" for law, _, said in FAMILIES])
def test_a_broken_law_of_families_is_told_in_one_line(law: str, broken: Any, said: str) -> None:
    caught(testing.effect_checks(broken, Arm(), DATA), law, said)


def test_a_check_of_all_laws_ends_at_a_broken_one() -> None:
    for broken in (EFFECTS[-1][1], FAMILIES[-1][1]):
        with pytest.raises(AssertionError):
            testing.check_effect(broken, Arm(), DATA)


def test_a_good_effect_and_its_family_keep_every_law() -> None:
    testing.check_effect(sag(), Arm(), DATA)
    testing.check_effect(family(careful), Arm(), DATA)


def test_every_law_is_broken_once() -> None:
    assert {law for law, _, _ in EFFECTS} == {law.__name__ for law in testing.EFFECT_LAWS}
    assert {law for law, _, _ in FAMILIES} == {law.__name__ for law in testing.FAMILY_LAWS}
