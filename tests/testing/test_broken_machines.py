"""Each law of a machine is broken on purpose by a small fake, and caught in one line."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from calibench import testing
from calibench.discrepancy import Constraints, MeasuredData, Sensor
from calibench.problems import Parameter
from tests.discrepancy.arm import PARAMETERS, Arm, readings

DATA = readings()


class Changed:
    """A formulation of the arm with some of its answers replaced: ``name=function of (formulation, answer)``."""

    def __init__(self, whole: Any, changes: dict[str, Any]) -> None:
        self._whole, self._changes = whole, changes

    def __getattr__(self, name: str) -> Any:
        told = getattr(self._whole, name)
        if name not in self._changes:
            return told
        change = self._changes[name]
        return (lambda *given: change(self._whole, told(*given))) if callable(told) else change(self._whole, told)


@dataclass(frozen=True)
class Fake:
    """The arm, with `changes` in what its formulation answers."""

    changes: Any
    name: str = "arm"

    def formulate(self, data: MeasuredData) -> Any:
        return Changed(Arm().formulate(data), self.changes)


class Refusing(Arm):
    def formulate(self, data):
        return Arm(("enc_1", "elbow")).formulate(data)


class Scribbling(Arm):
    def formulate(self, data):
        if data["x"].flags.writeable:
            data["x"][:] = np.round(data["x"], 1)
        return super().formulate(data)


class InDegrees(Arm):
    def formulate(self, data):
        return super().formulate(data.with_columns({"enc_2": np.rad2deg(data["enc_2"])}))


class InMetres(Arm):
    def formulate(self, data):
        return super().formulate(data.with_columns({"x": data["x"] / 1000}))


class Crashing(Arm):
    def formulate(self, data):
        data.columns["enc_2"]
        return super().formulate(data)


class WithUnseen(Arm):
    """Its base may lie anywhere along x, and so may what the tracker calls zero."""

    def formulate(self, data):
        whole = Arm().formulate(data)
        more = (Parameter("base", "mm", 0.0, -1.0, 1.0), Parameter("tracker", "mm", 0.0, -1.0, 1.0))

        def closure(q):
            rows = whole.closure(q)
            return rows + np.stack([q["base"] - q["tracker"], 0 * q["base"]])

        return Constraints(data, closure, (*PARAMETERS, *more), whole.noise)


class WithModulus(Arm):
    """Its closure takes a modulus, whose complex step is wrong; written past the check at the door."""

    def formulate(self, data):
        whole = Arm().formulate(data)
        rows = lambda q: np.abs(whole.closure(q)) + 0 * whole.closure(q)  # noqa: E731
        return Constraints(data, rows, PARAMETERS, whole.noise, checked=True)


def first_is_moved(_: Any, parameters: Any) -> Any:
    return (replace(parameters[0], start=500.0), *parameters[1:])


MACHINES: list[tuple[str, Any, str]] = [
    ("data_are_formulated_and_left_alone", Arm(name=""), "a machine has a name; found ''"),
    ("data_are_formulated_and_left_alone", Refusing(), "column 'elbow' is missing"),
    ("data_are_formulated_and_left_alone", Scribbling(), "a column was written into"),
    ("a_missing_column_is_no_crash", Crashing(), "are refused by a DataError; found KeyErr"),
    ("parameters_are_named_once_and_start_in_their_box", Fake({"parameters": first_is_moved}), "la=500.0 in 390.0 .."),
    (
        "parameters_are_named_once_and_start_in_their_box",
        Fake({"fixed": lambda _, held: {"la": 400.0}}), r"found \['la'\] twice",
    ),
    ("every_reading_has_its_noise_and_its_sensor", Fake({"sigma": lambda _, s: {**s, "x": 0.0}}), "the noise of x is"),
    ("every_reading_has_its_noise_and_its_sensor", Fake({"sensors": lambda _, s: s[::-1]}), "in the same order"),
    (
        "every_reading_has_its_noise_and_its_sensor",
        Fake({"sensors": lambda _, s: tuple(replace(each, part="tip") for each in s)}), "a part has one sensor",
    ),
    ("constraints_have_a_row_a_reading", Fake({"constraints": lambda _, rows: rows.T}), r"have shape \(n, c\)"),
    ("constraints_have_a_row_a_reading", Fake({"constraints": lambda _, rows: rows * np.nan}), "finite at the start"),
    ("slopes_agree_with_differences", WithModulus(), "slopes agree with differences"),
    (
        "slopes_agree_with_differences",
        Fake({"slopes": lambda _, s: {k: v for k, v in s.items() if k != "x"}}), r"found \['x'\]; add what is missing",
    ),
    (
        "other_rows_have_the_same_constraints",
        Fake({"constraints": lambda whole, rows: rows - np.mean(np.real(rows))}), "keep nothing of the whole in a row",
    ),
    ("decorrelate_is_linear", Fake({"decorrelate": lambda _, rows: rows**2}), "decorrelate is linear"),
    ("readings_determine_every_parameter", WithUnseen(), "base, tracker move together unseen; hold one of them"),
    ("readings_are_near_the_model", InDegrees(), "if enc_2 is multiplied by 0.0174533.*looks like deg"),
    ("readings_are_near_the_model", InMetres(), "if x is multiplied by 1000.*looks like m; state"),
    (
        "covariates_are_columns_of_known_targets",
        Fake({"covariates": lambda _, told: {"wrist": {}}}), "a covariate has a known target; found wrist",
    ),
    (
        "covariates_are_columns_of_known_targets",
        Fake({"covariates": lambda _, told: {"x": {"t_s": np.zeros(3)}}}), r"t_s has shape \(n,\); found \(3,\)",
    ),
]  # fmt: skip
NOT_BY_AN_ARM = {"declared_units_agree"}  # of machines with a description: below


def caught(checks: Any, law: str, said: str) -> None:
    with pytest.raises(AssertionError, match=said) as broken:
        dict(checks)[law]()
    assert "\n" not in str(broken.value)
    assert str(broken.value).count("; ") >= 2  # law; what was found; what to do


def fresh() -> MeasuredData:
    return DATA.with_columns({name: column.copy() for name, column in DATA.columns.items()})


@pytest.mark.parametrize(("law", "machine", "said"), MACHINES, ids=[f"{law}-{said[:12]}" for law, _, said in MACHINES])
def test_a_broken_law_of_machines_is_told_in_one_line(law: str, machine: Any, said: str) -> None:
    caught(testing.machine_checks(machine, fresh()), law, said)


def test_a_check_of_all_laws_ends_at_a_broken_one() -> None:
    with pytest.raises(AssertionError, match=MACHINES[0][2]):
        testing.check_machine(MACHINES[0][1], fresh())


def test_a_unit_that_is_declared_otherwise_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    from calibench.discrepancy import Description
    from calibench.discrepancy.model.machine import Quantity
    from calibench.discrepancy.registries import _descriptions

    told = Arm(instruments=tuple(Sensor(name, "sensor", "mm" if name in "xy" else "rad") for name in (
        "enc_1", "enc_2", "x", "y"
    )))  # fmt: skip
    columns = tuple(Quantity(name, "mm" if name in "xy" else "deg") for name in ("enc_1", "enc_2", "x", "y"))
    own = tuple(Quantity(p.name, p.unit) for p in PARAMETERS)
    monkeypatch.setitem(_descriptions, "two_link", Description(columns, own[:-1]))
    caught(testing.machine_checks(told, DATA), "declared_units_agree", "what is used is declared; found no z2")
    monkeypatch.setitem(_descriptions, "two_link", Description(columns, own))
    caught(testing.machine_checks(told, DATA), "declared_units_agree", "enc_1 has one unit; found 'deg' declared")


def test_a_good_machine_keeps_every_law() -> None:
    testing.check_machine(Arm(), fresh())


def test_what_a_machine_raises_is_told_in_one_line() -> None:
    class Broken(Arm):
        def formulate(self, data):
            raise ZeroDivisionError("division by zero\nin my code")

    with pytest.raises(AssertionError, match=r"ZeroDivisionError: .* test_broken") as broken:
        testing.check_machine(Broken(), DATA)
    assert isinstance(broken.value.__context__, ZeroDivisionError)


def test_every_law_is_broken_once() -> None:
    assert {law for law, _, _ in MACHINES} | NOT_BY_AN_ARM == {law.__name__ for law in testing.MACHINE_LAWS}
