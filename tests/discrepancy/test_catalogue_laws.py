"""Every candidate of every machine that ships: zero changes nothing, slopes are slopes, words and units are known.

A machine is held to it with the readings of `test_laws` and with more of its own, so that each of its families has a
candidate somewhere; one that has none is told by name.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from benchmarks.blind import orthoglide as blind
from benchmarks.blind.gpm2002.simulate import case
from calibench import testing
from calibench.core.tables.cells import is_unit
from calibench.discrepancy import Machine, MeasuredData, machines
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.labels import effect_label
from calibench.discrepancy.machines.mount import Mount
from calibench.discrepancy.machines.mount.description import planned as stars
from calibench.discrepancy.model.effect import Effect, name_of
from calibench.discrepancy.registries import own_families
from tests.discrepancy.test_laws import CASES

_WHOLE = blind.case(3, plan="loaded")
_RUN = case(9, xy=True)
_NAMED = re.compile(r"pier_|(?<=gauge [xyz])_(?=[xyz])")  # names that the field, and the chapter, write so
_FIELD = re.compile(r"^[A-Z]{2,4}\d?$|^pier_[A-Z]{2}$")  # the field's names for pointing terms


def _moved(data: MeasuredData) -> MeasuredData:
    """Return stars with what a mount's owner may log besides: from which side each axis came, and how warm it was."""
    rng = np.random.default_rng(0)
    more = {f"dir_{axis}": rng.choice([-1.0, 1.0], len(data)) for axis in ("ha", "dec", "az", "el") if axis in data}
    return data.with_columns({**more, "temp_K": np.linspace(3, -3, len(data)) ** 2})


def _timed(data: MeasuredData) -> MeasuredData:
    n, stated = len(data), {**data.metadata, "periods": {"month": 12.0}}
    return replace(data, metadata=stated).with_columns({"t_s": 10.0 * np.arange(n), "load": np.sin(np.arange(n) ** 2)})


MORE: dict[str, tuple[Machine, MeasuredData]] = {
    "gpm2002, a blind run": (machines.make("gpm2002"), MeasuredData(_RUN.columns, "gpm2002", _RUN.metadata, "run")),
    "orthoglide, loaded": (
        machines.make("orthoglide"),
        MeasuredData({n: c[::7] for n, c in _WHOLE.columns.items()}, "orthoglide", _WHOLE.metadata, "loaded"),
    ),
    "orthoglide, lengths held": (
        machines.make("orthoglide", free="rho"),
        MeasuredData({n: c[::7] for n, c in _WHOLE.columns.items()}, "orthoglide", _WHOLE.metadata, "loaded"),
    ),
    "table, in time": (machines.make("table", model="line", inputs=("load",)), _timed(CASES["table"][1])),
    "mount, two errors calibrated": (Mount(base="index"), _moved(stars(n=60))),
    "mount, altazimuth": (Mount(base="index"), _moved(stars(n=60, mount="altaz"))),
}
ALL = {name: (machine, data) for name, (machine, data) in {**CASES, **MORE}.items() if machine.name in machines.names()}

LONG = ("orthoglide", "orthoglide, both passes", "orthoglide, lengths held")  # the loaded one has all their families


@cache
def _candidates() -> tuple[tuple[str, Machine, MeasuredData, list[Effect]], ...]:
    found = []
    for name, (machine, data) in ALL.items():
        known = catalogue(machine.formulate(data))
        effects = (*known.candidates, *(beside.effect for beside in known.alternatives))
        found.append((name, machine, data, list({name_of(effect): effect for effect in effects}.values())))
    return tuple(found)


@pytest.mark.parametrize(
    "name",
    [pytest.param(one, marks=[pytest.mark.slow] if one in LONG else []) for one in ALL],
)
def test_every_candidate_of_every_machine_keeps_the_laws_of_an_effect(name: str) -> None:
    [(machine, data, found)] = [(m, d, c) for n, m, d, c in _candidates() if n == name]
    formulation = machine.formulate(data)
    assert not [said for effect in found for said in _broken(testing.EFFECT_LAWS, effect, formulation)]


def _broken(laws: Iterable[Callable[..., None]], *of: Any) -> Iterator[str]:
    for law in laws:
        try:
            law(*of)
        except AssertionError as error:
            yield f"{law.__name__}: {error}"


def test_every_family_of_every_machine_has_a_candidate_somewhere() -> None:
    served = {(machine.name, effect.family) for _, machine, _, found in _candidates() for effect in found}
    asked = {(machine.name, family.name) for machine, _ in ALL.values() for family in own_families(machine.name)}
    noise = {(m, family.name) for m, _ in asked for family in own_families(m) if family.channel == "noise"}
    assert asked - served <= noise  # general ones: test_general_families


@pytest.mark.parametrize("name", ["gpm2002 with a tracker", "delta"])
def test_every_family_keeps_the_laws_of_a_family(name: str) -> None:
    machine, data = ALL[name]
    formulation = machine.formulate(data)
    able = [one for one in own_families(machine.name) if one.candidates(formulation).candidates]
    assert len(able) > 5
    assert not [said for family in able for said in _broken(testing.FAMILY_LAWS, family, machine, data)]


@pytest.mark.parametrize("name", ALL)
def test_every_label_is_words_that_no_other_name_has(name: str) -> None:
    [(machine, data, found)] = [(m, d, c) for n, m, d, c in _candidates() if n == name]
    told = {name_of(effect): effect_label(machine.name, effect.family, effect.target) for effect in found}
    assert len(set(told.values())) == len(told)
    for label in told.values():
        for column in data.columns:
            label = re.sub(rf"\b{column}\b", "it", label)  # its owner calls it so
        words = label.split(" (")[0]
        assert "_" not in _NAMED.sub(" ", label), label
        assert _FIELD.match(words) or words[:1].islower() or " of " in words, label
        assert not re.search(r"\b(\w+) \1\b|None|\{|\}", label), label


@pytest.mark.parametrize("name", ALL)
def test_every_unit_is_known(name: str) -> None:
    [found] = [c for n, _, _, c in _candidates() if n == name]
    odd = {(name_of(e), unit) for e in found for unit in (e.unit, *e.units) if not _known(unit)}
    assert not odd


def _known(unit: str) -> bool:
    """Return whether a unit is one that files may state, or a ratio of such; a count has none."""
    above, _, below = unit.partition("/")
    parts = [above, *([below.strip("()")] if below else [])]
    return unit == "" or is_unit(unit) or all(is_unit(part) for part in parts)
