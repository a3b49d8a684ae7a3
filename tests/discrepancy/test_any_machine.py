"""The search asks a machine what its sensors are, and reads nothing off the names of columns, targets or machines."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from calibench import discrepancy, testing
from calibench.bench.measured.sources import sources
from calibench.core.plain import finite
from calibench.discrepancy import explain, machines
from calibench.discrepancy.design.detectability import design
from calibench.discrepancy.machines.gpm2002.description import planned
from calibench.discrepancy.machines.orthoglide.kinematics import printed
from calibench.discrepancy.model.measured import DataError, Sensor, sensor_of
from calibench.discrepancy.registries import description_of
from tests.discrepancy.arm import Arm, readings

pytestmark = pytest.mark.usefixtures("at_one_noise")

ROOT = Path(__file__).resolve().parents[2]
NAMES = [("enc_1", "enc_2"), ("shoulder", "elbow")]


@pytest.mark.parametrize("angles", NAMES)
def test_wild_readings_of_one_sensor_are_blamed_on_it_whatever_its_column_is_called(angles: tuple[str, str]) -> None:
    report = explain(Arm(angles), readings(angles, wild=0.06))
    [found] = report.findings
    assert report.verdict == "noise"
    assert (found.family, found.target) == ("outlier", angles[1])
    assert found.amplitude.ci95[0] < 40 * 2e-5 < 1.3 * found.amplitude.ci95[1]


def test_a_verdict_does_not_depend_on_the_names_of_columns() -> None:
    one, other = (explain(Arm(angles), readings(angles, wild=0.06)) for angles in NAMES)
    assert one.verdict == other.verdict
    assert finite(one.gap) == finite(other.gap)
    assert [f.amplitude for f in one.findings] == [f.amplitude for f in other.findings]


@pytest.mark.parametrize("angles", NAMES)
def test_an_arm_that_reads_as_stated_lacks_nothing(angles: tuple[str, str]) -> None:
    assert explain(Arm(angles), readings(angles)).verdict == "none"


def test_what_is_said_of_a_sensor_is_what_a_finding_says() -> None:
    told = tuple(Sensor(name, "encoder", "rad", f"joint {k}") for k, name in enumerate(NAMES[1], start=1))
    [found] = explain(Arm(NAMES[1], told), readings(NAMES[1], wild=0.06)).findings
    assert (found.target, found.amplitude.unit) == ("joint 2", "rad")


def test_a_sensor_without_stated_noise_is_refused() -> None:
    with pytest.raises(DataError, match="sensor wrist"):
        Arm(instruments=(Sensor("wrist", "encoder"),)).formulate(readings())


def test_every_reading_has_its_sensor_and_every_target_a_sensor_that_shows_it() -> None:
    formulations = [machines.make("gpm2002").formulate(planned(n=40, tracked=tracked)) for tracked in (False, True)]
    formulations += [machines.make("orthoglide").formulate(printed("exp2")), Arm().formulate(readings())]
    for formulation in formulations:
        assert tuple(sensor.column for sensor in formulation.sensors) == formulation.readings
        parts = [sensor.part for sensor in formulation.sensors if sensor.part]
        assert len(set(parts)) == len(parts)
        assert all(sensor_of(formulation.sensors, part).part == part for part in parts)


ALL_COLUMNS = {
    "gpm2002": lambda: planned(n=40, tracked=True),
    "orthoglide": lambda: printed("exp2"),
    "mount": lambda: sources("demo_still", "mount")[0].read({}),
    "delta": lambda: sources("printer", "delta")[0].read({}),
    "arm": lambda: sources("demo_play", "arm")[0].read({}),
}


OF_OWNERS = ("table", "simulator")  # whose model is its owner's


@pytest.mark.parametrize("name", [name for name in machines.names() if name not in OF_OWNERS])
def test_a_machine_that_ships_declares_a_unit_or_words_for_every_parameter(name: str) -> None:
    formulation = machines.make(name).formulate(ALL_COLUMNS[name]())
    for parameter in formulation.parameters:
        known = description_of(name).quantity(parameter.name)
        assert known is not None
        assert (known.unit, bool(known.label)) == (parameter.unit, True)


def test_the_former_names_that_scripts_import_still_work() -> None:
    assert (discrepancy.Cause, discrepancy.Linear) == (discrepancy.EffectFamily, discrepancy.LinearEffect)


GENERIC = [
    path
    for room in ("discrepancy", "bench/discovery", "bench/measured")
    for path in sorted((ROOT / room).rglob("*.py"))
    if "machines" not in path.relative_to(ROOT).parts[1:2]
]
LITERALS = re.compile(r"\benc(_|\b)|\bleg |\bjoint \d|gpm2002|orthoglide", re.IGNORECASE)


def _spelt(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield the line and text of every string that is no docstring, and of every last letter that is taken."""
    quiet = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            quiet.add(id(node.body[0].value))  # type: ignore[attr-defined]
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in quiet:
            yield node.lineno, node.value
        if isinstance(node, ast.Subscript) and ast.unparse(node).endswith(("target[-1]", "name[-1]", "encoder[-1]")):
            yield node.lineno, "enc_ by its last letter"
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("number", "family.number"):
            yield node.lineno, "enc_ by the number in a target"
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node.lineno, ast.unparse(node)


def test_the_scan_looks_at_the_generic_rooms() -> None:
    assert len(GENERIC) > 50
    found = [
        text for _, text in _spelt(ast.parse('x = f"enc_{i}"\ny = effect.target[-1]\nz = "leg 2"\nw = number(target)'))
    ]
    assert sum(bool(LITERALS.search(text)) for text in found) == 4


@pytest.mark.parametrize("path", GENERIC, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_generic_code_spells_a_column_a_target_or_a_machine(path: Path) -> None:
    spelt = [(line, text) for line, text in _spelt(ast.parse(path.read_text())) if LITERALS.search(text)]
    assert spelt == []


class _Bare:
    """A class that is no machine: it has what is given, and nothing else."""

    def __init__(self, **members: object) -> None:
        self.__dict__.update(members)


NO_MACHINES = [
    (_Bare(), "it has no formulate"),
    (None, "it has no formulate"),
    (Arm, "Arm is a class; Arm()"),
    (_Bare(name="x", formulate=5), "it has no formulate"),
    (_Bare(name="x", formulate=lambda: None), "does not take the data"),
    (_Bare(formulate=lambda data: None), "it has no name"),
    (_Bare(name=3, formulate=lambda data: None), "it has no name"),
    (_Bare(name="x", formulate=lambda data: "mine"), "formulate(data) returned str"),
]


@pytest.mark.parametrize(("machine", "said"), NO_MACHINES)
@pytest.mark.parametrize("asked", [explain, design])
def test_what_is_no_machine_is_told_in_a_line(asked: Any, machine: Any, said: str) -> None:
    with pytest.raises(DataError, match=re.escape(said)) as told:
        asked(machine, readings())
    assert "\n" not in str(told.value)


def test_the_laws_say_what_is_no_machine() -> None:
    for machine, said in ((Arm, "is a class"), (_Bare(name="x", formulate=lambda data: None), "returned NoneType")):
        with pytest.raises(AssertionError, match=said):
            testing.check_machine(machine, readings())  # type: ignore[arg-type]
