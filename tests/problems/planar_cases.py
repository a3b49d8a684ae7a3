"""The registered problems that the laws run over, and the papers' machines as mappings name -> number.

The cases come from the registry: every name, with every choice of its error function, gauge and section. A problem that
is entered tomorrow is held to the same laws.
"""

import functools
import itertools
from typing import get_args

import numpy as np
import pytest

from calibench import problems
from calibench.problems import constants
from calibench.problems.planar.calibration import PlanarFamily

OWN_FILES = ("arm",)  # of a user's URDF and readings: tests/problems/test_arm_problems.py
BLACK_BOXES = ("bbob", "ioh")  # values alone, by packages that may be absent: their laws are in test_black_boxes.py
_VARIED = ("error", "gauge", "paper_section")


def cases():
    """Return (name, options) for every registered problem with residuals and every choice among `_VARIED`."""
    found = []
    for name in problems.names():
        if name in (*BLACK_BOXES, *OWN_FILES):
            continue
        declared = problems.registry.options(name)
        varied = [key for key in _VARIED if key in declared]
        for choice in itertools.product(*(get_args(declared[key].type) for key in varied)):
            found.append((name, tuple(zip(varied, choice, strict=True))))
    return found


@functools.cache
def made(case):
    """Return the problem of a case; problems are values, so one serves all tests."""
    name, options = case
    return problems.make(name, **dict(options))


def label(case):
    """Return the case as on the command line: full12-J3-ya2."""
    return "-".join([case[0], *(str(value) for _, value in case[1])])


def over(chosen):
    """Return the decorator that runs a test, whose argument is `case`, over the chosen cases."""
    return pytest.mark.parametrize("case", chosen, ids=label)


ALL = cases()
PLANAR = [case for case in ALL if isinstance(problems.registry.factory(case[0]), PlanarFamily)]


def points(problem, count, seed=0):
    """Return random points of the problem's box, shape (count, dim)."""
    return inside(problem, np.random.default_rng(seed).random((count, len(problem.lower))))


def inside(problem, unit):
    """Return the points of the box at the fractions `unit`, shape (..., dim), of its sides."""
    return problem.lower + (problem.upper - problem.lower) * unit


def true_machine(case):
    """Return the actual machine of a case as the paper's tables print it: nominal where a table is silent."""
    name, options = case
    table = {"sensor_zero": "table2", "link_length": "table3", "full11": "table5", "full12": "table5"}[name]
    if ("paper_section", 3) in options or ("gauge", "ya2") in options:
        table = "table4"
    return nominal_machine() | entries(f"{table}.actual")


def nominal_machine():
    """Return the maker's machine: bases, link lengths, offsets zero."""
    geometry = entries("geometry")
    bases = {f"{axis}a{i}": geometry[f"{axis}a{i}"] for i in (1, 2, 3) for axis in "xy"}
    links = {f"{link}{i}": geometry["link"] for link in ("la", "lb") for i in (1, 2, 3)}
    return bases | links | {"z1": 0.0, "z2": 0.0, "z3": 0.0}


def entries(key):
    """Return the values of a printed column, errata applied."""
    column = constants.column("cong2008", key)
    return {name: column[name] for name in column}


def vector(machine):
    """Return the machine as the 15-vector of `inverse_kinematics` and `Gauge`."""
    names = [f"{axis}a{i}" for i in (1, 2, 3) for axis in "xy"]
    names += [f"{link}{i}" for link in ("la", "lb", "z") for i in (1, 2, 3)]
    return np.array([machine[name] for name in names])


def named(problem, x):
    """Return x as a mapping from the names of the problem's coordinates."""
    return {c.name: float(value) for c, value in zip(problem.coordinates, x, strict=True)}


def coordinates_of(problem, machine):
    """Return the vector in the problem's coordinates of a machine given by its physical parameters."""
    wanted = {**machine, **_decoupled_pairs(machine)}
    return np.array([wanted[c.name] for c in problem.coordinates])


def _decoupled_pairs(machine):
    pairs = {}
    for i in (1, 2, 3):
        if f"la{i}" in machine and f"z{i}" in machine:
            pairs[f"lac{i}"] = machine[f"la{i}"] * np.cos(machine[f"z{i}"])
            pairs[f"las{i}"] = machine[f"la{i}"] * np.sin(machine[f"z{i}"])
    return pairs
