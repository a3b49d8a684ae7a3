"""A user's own simulator as a machine: what it is asked, what is kept, and what is found at its inputs and outputs."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from hashlib import blake2b
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calibench import discover, testing
from calibench.bench.cli import main
from calibench.bench.discovery.page.words import amplitude_words, headline, unnamed_sentences
from calibench.bench.measured import read_measured, write_measured
from calibench.core.notes import Code
from calibench.discrepancy import DataError, MeasuredData, explain, machines
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.formula.grammar import Atom, Term
from calibench.discrepancy.machines.simulator.caller import Caller, Names, duration, of_command, of_function
from calibench.discrepancy.machines.simulator.local import LocalModel, Variable
from calibench.discrepancy.model.effect import name_of
from calibench.discrepancy.model.formulations import Predicted
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import Roles, roles_of, words_of
from calibench.discrepancy.report import Place, Report
from calibench.discrepancy.search.finding import amplitude_of
from calibench.problems.base import Parameter
from tests.processes import alive, descendants, wait_for

pytestmark = pytest.mark.usefixtures("at_one_noise")

SPRING = """
import numpy as np

INPUTS = ("u", "t")
PARAMETERS = {"k": (2.0, 1.0, 4.0), "tau": (0.5, 0.2, 1.5), "mass": 0.0}
RNG = np.random.default_rng(5)
OUTPUTS = {"y": 0.002, "z": 0.002}


def answer(inputs, parameters):
    u, t, p = inputs["u"], inputs["t"], parameters
    rise = 1 - np.exp(-t / (p["tau"] + 0.3 * p["mass"]))
    return {"y": u / p["k"] * rise, "z": np.sin(u) * rise + 0.1 * p["k"] * t}


def together(inputs, parameters):
    said = answer(inputs, parameters)
    return {"y": np.cumsum(said["y"]) / 10, "z": said["z"]}


def of_row(u, t, k, tau, mass):
    said = answer({"u": u, "t": t}, {"k": k, "tau": tau, "mass": mass})
    return said["y"], said["z"]


def jumps(inputs, parameters):
    return {name: np.round(y, 5) for name, y in answer(inputs, parameters).items()}


def coarse(inputs, parameters):
    return {name: np.round(y / 0.002) * 0.002 for name, y in answer(inputs, parameters).items()}


def rounded(inputs, parameters):
    return {name: np.round(y / 0.05) * 0.05 for name, y in answer(inputs, parameters).items()}


def stochastic(inputs, parameters):
    return {name: y + 4e-4 * RNG.standard_normal(len(y)) for name, y in answer(inputs, parameters).items()}


def stepped(inputs, parameters):
    return answer({**inputs, "t": np.round(inputs["t"] / 0.005) * 0.005}, parameters)


def still(inputs, parameters):
    return {name: 0 * inputs["u"] for name in ("y", "z")}


def short(inputs, parameters):
    return {name: y[:3] for name, y in answer(inputs, parameters).items()}


def random(inputs, parameters):
    return {name: y + 0.02 * np.random.standard_normal(len(y)) for name, y in answer(inputs, parameters).items()}


def leaves(inputs, parameters):
    raise SystemExit(3)


def narrow(inputs, parameters):
    if parameters["tau"] > 0.5:
        raise ArithmeticError("too slow")
    return answer(inputs, parameters)


def cut(inputs, parameters):
    return {name: y + (np.nan if parameters["tau"] > 0.5 else 0) for name, y in answer(inputs, parameters).items()}


def of_no_parameter(inputs, parameters):
    return answer(inputs, {"k": 2.2, "tau": 0.55, "mass": 0.0})


def of_a_ratio(inputs, parameters):  # with a kink, over which slopes are wide
    k, p = parameters["k"] / parameters["tau"], parameters
    return {"y": k * inputs["u"], "z": np.maximum(p["mass"] / p["tau"] * inputs["t"], 0.9)}


def jumps_in_some_rows(inputs, parameters):
    said, jump = answer(inputs, parameters), 2e-4 * np.sign(np.sin(1e7 * parameters["tau"]))
    return {"y": said["y"] + np.where(inputs["u"] > 1.0, jump, 0.0), "z": said["z"]}


def prints(inputs, parameters):
    print("a step")
    return answer(inputs, parameters)


def broken(inputs, parameters):
    raise ArithmeticError("no equilibrium")
"""


@pytest.fixture
def spring(tmp_path, own_cache) -> Path:
    name = (
        f"spring_{blake2b(str(tmp_path).encode(), digest_size=4).hexdigest()}"  # one file of a name is known at a time
    )
    file = tmp_path / f"{name}.py"
    file.write_text(SPRING)
    return file


def readings(seed: int = 0, n: int = 120, **hidden: float) -> MeasuredData:
    """Return what a spring of k = 2.2, tau = .55 answers, with what is hidden at its inputs and outputs."""
    rng = np.random.default_rng(seed)
    u, t = rng.uniform(-1.5, 1.5, n), rng.uniform(0.2, 2.0, n)
    box, side = rng.integers(0, 2, n).astype(float), rng.choice([-1.0, 1.0], n)
    true = u - hidden.get("play", 0.0) / 2 * side
    later = t + hidden.get("late", 0.0)
    rise = 1 - np.exp(-later / (0.55 + 0.3 * hidden.get("mass", 0.0) * box))
    y = true / 2.2 * rise * (1 + hidden.get("scale", 0.0))
    z = np.sin(true) * rise + 0.22 * later
    z = z * (1 + hidden.get("warm", 0.0) * box)
    columns = {"u": u, "t": t, "u_dir": side, "box": box, "y": y, "z": z}
    columns |= {name: columns[name] + 0.002 * rng.standard_normal(n) for name in ("y", "z")}
    split = np.where(np.arange(n) % 3 == 0, "hold", "train")
    return MeasuredData({**columns, "split": split}, "simulator", {}, "spring")


def simulator(file: Path, function: str = "answer", **options: object):
    return machines.make("simulator", call=f"{file}:{function}", workers=1, **options)


@pytest.mark.parametrize(
    ("hidden", "name"),
    [
        ({"play": 0.03}, "backlash u"),
        ({"late": 0.01}, "input_offset t"),
        ({"mass": 0.1}, "parameter_over mass over box"),
        ({"scale": 0.03}, "instrument_scale y"),
        ({"warm": 0.03}, "output_gain z over box"),
    ],
)
def test_what_is_hidden_at_inputs_parameters_and_outputs_is_named_and_closes_the_gap(spring, hidden, name):
    report = explain(simulator(spring), readings(**hidden))
    named = [{rival.effect for rival in finding.set} | {finding.effect} for finding in report.findings]
    assert any(name in names for names in named), (report.verdict, named)
    assert report.gap.held_out_after < 1.25 * report.gap.noise_floor < report.gap.held_out_before
    assert ("per unit of box" in headline(report)) == ("over box" in name)


def test_a_parameter_that_changes_back_and_forth_is_told_as_that_and_not_as_an_input(spring):
    rng, n = np.random.default_rng(1), 240
    u, t, run = rng.uniform(-1.5, 1.5, n), rng.uniform(0.2, 2.0, n), np.linspace(0, 1, n)
    k, rise = 2.2 + 0.04 * np.sign(np.sin(5 * np.pi * run + 0.3)), 1 - np.exp(-t / 0.55)
    y, z = u / k * rise, np.sin(u) * rise + 0.1 * k * t
    columns = {"u": u, "t": t, "t_s": 60.0 * np.arange(n), "y": y, "z": z}
    columns |= {name: columns[name] + 0.002 * rng.standard_normal(n) for name in ("y", "z")}
    split = np.where(np.arange(n) % 3 == 0, "hold", "train")
    report = explain(simulator(spring), MeasuredData({**columns, "split": split}, "simulator", {}, "wanders"))
    assert report.verdict == "unknown"
    assert (report.unnamed[0].quantity, report.unnamed[0].covariate) == ("k", "t_s")
    assert report.gap.excess_shrink > 0.8
    assert any(line.startswith("k errs over") for line in unnamed_sentences(report))


def test_parameters_that_may_change_are_numbers_of_the_machine():
    with pytest.raises(DataError, match="parameters: 'mass' is no parameter or held number; there are a"):
        Roles(parameters=("mass",)).refuse_unknown(Predicted(
            MeasuredData({"u": np.arange(3.0), "y": np.arange(3.0)}, "table"), lambda q: q["a"] * q["u"],
            (Parameter("a", "", 1.0, 0.0, 2.0),), measured={"y": 0.1}, inputs=("u",),
        ))  # fmt: skip


@pytest.mark.parametrize(("low", "high"), [(10.0, 40.0), (-40.0, -10.0), (-10.0, 40.0)])
def test_a_size_over_a_column_is_told_per_unit_of_it_wherever_its_mean_is(spring, low, high):
    box = low + (high - low) * (1 - np.linspace(1, 0, 120) ** 4)  # its mean is near the high end
    formulation = simulator(spring).formulate(readings().with_columns({"box": box}))
    effects = {name_of(effect): effect for effect in catalogue(formulation).candidates}
    effect, q = effects["parameter_over k over box"], Model(formulation).quantities(np.array([2.0, 0.5]))[0]
    size = amplitude_of(effect, np.array([0.06]), np.eye(1) * 1e-6, 2.0)
    slopes = np.diff(effect.shift(q, formulation.data, np.array([0.06]))["k"]) / np.diff(box)
    np.testing.assert_allclose(slopes, size.value / size.span, rtol=1e-6)
    assert amplitude_words(size, effect.target, brief=True) == f"{slopes[0]:#.3g} per unit of box"


@pytest.mark.parametrize("law", testing.MACHINE_LAWS, ids=lambda law: law.__name__)
def test_a_simulator_keeps_the_laws_of_a_users_own_machine(spring, law):
    law(simulator(spring), readings())


def test_of_parameters_of_which_the_ratio_alone_is_told_one_is_held_and_none_has_a_standard_error(spring):
    rng, u, t = np.random.default_rng(1), *np.random.default_rng(0).uniform(0.2, 2.0, (2, 120))
    y, z = (2.2 / 0.6 * u, np.maximum(0.6 / 0.6 * t, 0.9)) + 0.002 * rng.standard_normal((2, 120))
    bounds = {"k": (2.0, 1.0, 4.0), "tau": (0.5, 0.2, 1.5), "mass": (0.45, 0.2, 1.5)}
    data = MeasuredData({"u": u, "t": t, "y": y, "z": z}, "simulator", {}, "ratio")
    found = explain(simulator(spring, "of_a_ratio", parameters=bounds), data).parameters
    assert all(np.isnan(p.sd) for p in found.values())
    assert any(found[name].after == bounds[name][0] for name in found)
    assert found["k"].after / found["tau"].after == pytest.approx(2.2 / 0.6, rel=1e-3)
    assert found["mass"].after / found["tau"].after == pytest.approx(1.0, rel=1e-3)


def test_a_sound_simulator_misses_nothing(spring):
    assert explain(simulator(spring), readings()).verdict == "none"


def test_two_mappings_may_stand_before_arguments_that_keep_their_defaults():
    names = Names(("u", "t"), ("k",), ("y",))
    u = np.array([[1.0, 2.0], [3.0, 4.0]])

    def of_mappings(inputs, parameters, steps=200):
        return {"y": inputs["u"] * parameters["k"] + steps}

    def by_name(u, t, k=1.0):
        return {"y": u * k + t}

    for function, expected in ((of_mappings, [[205.0], [215.0]]), (by_name, [[7.0], [19.0]])):
        assert of_function(function, names, one=False)(u, np.array([5.0])).tolist() == expected


def test_from_python_options_are_keywords_or_the_machine_is_an_object(spring, tmp_path):
    file = write_measured(readings(play=0.03), tmp_path / "play.csv")
    call = f"{spring}:answer"
    reports = [
        discover("simulator", file, call=call, workers=1), discover("simulator", file, **{"machine.call": call}),
        discover(simulator(spring), file), explain(simulator(spring), read_measured(file, simulator(spring))),
    ]  # fmt: skip
    assert len({(report.verdict, report.findings[0].effect) for report in reports}) == 1
    for word in ("machine_call", "cal"):
        with pytest.raises(DataError, match=f"{word}= is no option of simulator, .*did you mean 'call'"):
            discover("simulator", file, **{word: call})
    with pytest.raises(DataError, match="machine: dict: a machine, or the name of one"):
        read_measured(file, {})


def test_data_may_be_a_table_of_pandas_with_the_heads_of_a_file(spring, tmp_path):
    data = readings(play=0.03)
    file = write_measured(replace(data, units={"u": "s", "y": "m"}), tmp_path / "play.csv")
    table = pd.read_csv(file, comment="#")
    assert {"u [s]", "y [m]"} <= {*table}
    call = f"{spring}:answer"
    read, told = read_measured(table, "simulator"), discover("simulator", file, call=call, time="t")
    assert (read["split"].tolist(), dict(read.units)) == (data["split"].tolist(), {"u": "s", "y": "m"})
    assert discover("simulator", table, call=call, time="t").findings == told.findings
    assert discover("simulator", dict(table.rename(columns={"u [s]": "x"})), call=call, time="t", columns={"u": "x"})
    with pytest.raises(DataError, match=r"^data: is a list: .* a DataFrame or a mapping is needed"):
        discover("simulator", [1.0, 2.0], call=call)
    with pytest.raises(ValueError, match=r"simulator.call: a function in memory; .* FILE.py:NAME"):
        discover("simulator", table, call=readings)


def _far(rows: np.ndarray, held: bool) -> MeasuredData:
    """Return sound readings, of which `rows` of z are off by 15 standard deviations, up and down in turn."""
    data = readings()
    z = np.array(data["z"])
    z[rows] += 0.03 * np.where(np.arange(len(rows)) % 2, 1.0, -1.0)
    columns = {name: data[name] for name in data.columns if held or name != "split"}
    return MeasuredData({**columns, "z": z}, "simulator", {}, "spring")


@pytest.mark.parametrize(("count", "held"), [(2, True), (2, False), (12, False)])
def test_readings_far_off_anywhere_are_noise_without_repeats_and_told_by_row(spring, count, held):
    rows = np.sort(np.random.default_rng(43).permutation(120)[:count])  # of two both are held out
    report = explain(simulator(spring), _far(rows, held))
    assert report.verdict == "noise"
    assert [f.effect for f in report.findings] == ["outlier z"] * (count > 2)  # two are rows, and no law
    assert all(f.amplitude.ci95[0] < 0.03 < f.amplitude.ci95[1] for f in report.findings)
    [note] = [note for note in report.notes if note.code is Code.ROWS_STAND_OUT]
    assert (note.rows, note.columns) == (tuple(str(row + 1) for row in rows), ("z",))


def test_readings_far_off_in_a_run_or_at_one_end_of_an_input_are_no_noise_that_is_anywhere(spring):
    for rows in (np.arange(70, 82), np.argsort(readings()["u"])[-12:]):
        report = explain(simulator(spring), _far(rows, True))
        assert not any(f.family == "outlier" for f in report.findings), report.verdict


def test_the_general_families_are_looked_for_without_a_word_of_a_simulator(spring):
    found = {effect.family for effect in catalogue(simulator(spring).formulate(readings())).candidates}
    assert {"gear", "backlash", "instrument_scale", "free_number", "power", "periodic_error"} <= found
    names = {name_of(effect) for effect in catalogue(simulator(spring).formulate(readings())).candidates}
    assert {"input_offset u", "output_offset z", "parameter_over k over box", "free_number mass"} <= names


def test_nobody_is_told_to_write_the_joints_of_a_simulator(spring):
    reasons = {one.reason for one in catalogue(simulator(spring).formulate(readings())).untestable}
    assert "nobody states the period of u" in reasons
    assert not any("Joint(" in reason for reason in reasons)


def test_a_size_at_an_input_without_a_unit_names_the_input(spring):
    candidates = catalogue(simulator(spring).formulate(readings())).candidates
    assert {effect.unit for effect in candidates if effect.family == "backlash"} == {"units of u"}
    assert Term("u", (Atom("t", "u", unit="units of t"),)).unit_of("units of u") == "units of u/(units of t)"


@pytest.mark.parametrize("function", ["answer", "jumps"])
def test_the_local_model_is_the_simulator_wherever_a_search_goes(spring, function):
    formulation = simulator(spring, function).formulate(readings())
    local, rng = formulation.of_rows.local, np.random.default_rng(1)
    n = len(formulation.data)
    rows = np.arange(n)
    recorded = {name: np.asarray(formulation.data[name], dtype=float) for name in ("u", "t")}
    for size in (0.001, 0.01, 0.1, 0.5):
        q = {name: value + size * rng.standard_normal(n) for name, value in recorded.items()}
        q |= {"k": np.asarray(2.2 + 0.3 * size), "tau": np.asarray(0.55 - 0.2 * size), "mass": 0.1 * size * np.ones(n)}
        [true] = local.caller.ask(
            [
                (
                    np.stack([q["u"], q["t"]], axis=-1),
                    np.stack([q["k"] * np.ones(n), q["tau"] * np.ones(n), q["mass"]], axis=-1),
                )
            ]
        )
        off = (local.predict(rows, q) - true) / local.scale
        assert np.sqrt(np.mean(off**2)) < 0.1, size


def test_what_lies_between_two_calls_costs_none(spring):
    formulation = simulator(spring).formulate(readings())
    local, rows = formulation.of_rows.local, np.arange(len(formulation.data))
    q = {name: np.asarray(formulation.data[name], dtype=float) for name in ("u", "t")}
    q |= dict(zip(("k", "tau", "mass"), map(np.asarray, local.parameters)))
    before = local.caller.rows
    for step in (1e-5, 1e-4, 1e-3):
        local.predict(rows, {**q, "u": q["u"] + step})
        local.slopes_at(rows, {**q, "k": q["k"] + step})
    assert local.caller.rows == before


def noisy(level: float):
    """Return a simulator whose solver's tolerance makes errors of `level`, the same for the same numbers."""

    def answer(inputs, parameters):
        x = inputs["x"]
        error = np.sin(1e12 * (x + parameters["a"])) * np.sqrt(2)
        return {"y": np.sin(x) * parameters["a"] + level * error}

    return answer


def local_of(level: float) -> LocalModel:
    names, x = Names(("x",), ("a",), ("y",)), np.linspace(0.3, 1.2, 60)[:, None]
    caller = Caller(of_function(noisy(level), names, one=False), names, f"noisy{level}", one=False)
    variables = (Variable("x", True, 0, 0.9), Variable("a", False, 0, 2.0, 0.5, 2.5))
    return LocalModel(caller, x, variables, np.array([1.5]), np.array([1e-3]))


def test_a_search_that_strays_calls_no_simulator_outside_its_bounds(spring):
    asked = []

    def bounded(inputs, parameters):
        asked.append((float(parameters["a"]), float(np.max(np.abs(inputs["x"])))))
        if parameters["a"] > 2.3:
            raise ArithmeticError("no equilibrium")
        return {"y": np.sin(inputs["x"]) * parameters["a"] ** 2}

    local = local_of(0.0)
    local.caller = replace(local.caller, simulator=of_function(bounded, local.caller.names, one=False), code="bounded")
    local.prepare()
    local.calibrate(2.25 * np.sin(local.inputs), np.full(60, True), np.array([True]))
    x = local.inputs[:, 0]
    for a, far in ((1.0, 1.0), (2.4, 1.0), (4.0, 1.0), (-6e162, 1.0), (1.5, 1e162), (np.nan, 1.0)):
        local.predict(np.arange(60), {"a": np.array(a), "x": far * x})
    assert all(0.5 <= a <= 2.5 and x < 2.2 for a, x in asked)
    assert local.refused == "ArithmeticError: no equilibrium"


@pytest.mark.parametrize("level", [1e-9, 1e-7, 1e-5])
def test_a_step_follows_the_noise_of_the_simulator(level):
    local = local_of(level)
    local.prepare()
    assert level / 4 < local.noise[0] < 4 * level
    x = local.inputs[:, 0]
    local.calibrate(1.5 * np.sin(x)[:, None], np.full(len(x), True), np.array([False]))
    off = local.slopes["x"][:, 0] - 1.5 * np.cos(x)
    # noise over a step, and the third derivative times its square, balance at about three times the noise to 2/3
    assert np.sqrt(np.mean(off**2)) < 10 * level ** (2 / 3)


@pytest.mark.parametrize(
    ("function", "own"), [("answer", 0.0), ("coarse", 0.002 / np.sqrt(12)), ("stochastic", 4e-4), ("stepped", 4e-4)]
)
def test_a_simulator_that_is_rounded_noisy_or_jumps_says_what_a_smooth_one_says(spring, function, own):
    formulation = simulator(spring, function).formulate(readings(late=0.01))
    local = formulation.of_rows.local
    assert bool(local.rough) == (own > 0)
    assert own / 2 <= local.own.max() < 2 * own + 1e-9
    assert formulation.measured["y"] == pytest.approx(np.hypot(0.002, local.own[0]), rel=2e-3)
    t, (k, tau) = np.asarray(formulation.data["t"]), local.parameters[:2]
    true = np.asarray(formulation.data["u"]) / k / tau * np.exp(-t / tau)
    assert np.sqrt(np.mean((local.slopes["t"][:, 0] - true) ** 2 / np.mean(true**2))) < 0.05
    report = explain(simulator(spring, function), readings(late=0.01))
    assert [finding.effect for finding in report.findings] == ["input_offset t"]
    low, high = report.findings[0].amplitude.ci95
    assert low < 0.01 < high < low + 0.004
    [note] = [note for note in report.notes if note.code is Code.SIMULATOR_CALLS]
    assert ("rounded, noisy or jumps" in note.text) == (own > 0)


def test_rows_that_jump_make_no_parameter_surer_where_the_first_that_are_looked_at_do_not(spring):
    data = readings()
    few = np.unique(np.linspace(0, 119, 8).astype(int))  # on which noise and steps are told
    u = np.array(data["u"])
    u[few] = np.clip(u[few], -1.0, 0.9)
    rise = 1 - np.exp(-data["t"] / 0.55)
    noise = 0.002 * np.random.default_rng(4).standard_normal((2, 120))
    data = data.with_columns(
        {"u": u, "y": u / 2.2 * rise + noise[0], "z": np.sin(u) * rise + 0.22 * data["t"] + noise[1]}
    )
    sure, jumping = (explain(simulator(spring, f), data).parameters["tau"] for f in ("answer", "jumps_in_some_rows"))
    assert jumping.sd == pytest.approx(sure.sd, rel=0.1)
    assert jumping.after == pytest.approx(sure.after, abs=sure.sd)


def test_rows_that_depend_on_each_other_are_simulated_as_a_whole(spring):
    data = readings(n=60)
    rng = np.random.default_rng(3)
    columns = {**data.columns, "y": np.cumsum(data["y"]) / 10 + 0.002 * rng.standard_normal(60)}
    formulation = simulator(spring, "together").formulate(MeasuredData(columns, "simulator", {}, "spring"))
    assert not formulation.roles.joints
    assert Code.SIMULATOR_ROWS in [note.code for note in formulation.data.notes]
    part = formulation.on(formulation.data.rows(np.arange(60) % 2 == 0))
    q = {name: np.asarray(part.data[name]) for name in ("u", "t", "y", "z")} | {"mass": np.asarray(0.0)}
    q |= {p.name: np.asarray(p.start) for p in part.parameters}
    assert np.sqrt(np.mean(part.constraints(q)[:, 1] ** 2)) < 0.01


def test_a_function_of_one_row_says_what_a_function_of_all_says(spring):
    both = [simulator(spring, "of_row", rows=rows).formulate(readings()) for rows in ("all", "one")]
    both.append(simulator(spring).formulate(readings()))
    start = [[p.start for p in one.parameters] for one in both]
    np.testing.assert_allclose(start[0], start[1], rtol=1e-6)
    np.testing.assert_allclose(start[0], start[2], rtol=1e-6)


COMMAND = """
import math, sys
u, t, k, tau, mass = map(float, sys.argv[1:])
rise = 1 - math.exp(-t / (tau + 0.3 * mass))
print("a word before")
print(u / k * rise, math.sin(u) * rise + 0.1 * k * t)
"""


def test_a_command_is_a_simulator(spring, tmp_path):
    (tmp_path / "sim.py").write_text(COMMAND)
    given = {"inputs": ("u", "t"), "measured": ("y", "z"), "sigma": 0.002}
    given["parameters"] = {"k": (2.0, 1.0, 4.0), "tau": (0.5, 0.2, 1.5), "mass": 0.0}
    names = Names(("u", "t"), ("k", "tau", "mass"), ("y", "z"))
    from calibench.discrepancy.machines.simulator.caller import of_command

    u = np.array([[1.0, 0.5], [-0.3, 1.5]])
    said = of_command(f"{sys.executable} -S {tmp_path / 'sim.py'} {{args}}", names)(u, np.array([2.0, 0.5, 0.0]))
    named = of_command(f"{sys.executable} -S {tmp_path / 'sim.py'} {{u}} {{t}} {{k}} {{tau}} {{mass}}", names)
    rise = 1 - np.exp(-u[:, 1] / 0.5)
    np.testing.assert_allclose(said[:, 0], u[:, 0] / 2 * rise, rtol=1e-12)
    np.testing.assert_array_equal(said, named(u, np.array([2.0, 0.5, 0.0])))
    with pytest.raises(DataError, match=r"exit code 1.*2 numbers \(y, z\)"):
        of_command(f"{sys.executable} {tmp_path / 'sim.py'} 1", names)(u, np.array([2.0, 0.5, 0.0]))
    with pytest.raises(DataError, match="No such file"):
        of_command("./not_there {args}", names)(u, np.array([2.0, 0.5, 0.0]))


SLOW = (
    SPRING
    + """
import time
from pathlib import Path

def slow(u, t, k, tau, mass):
    time.sleep(0.0015 if Path(__file__).with_name("killed").exists() else 0.006)  # kept is a job above 5 ms: 4 rows
    with open(Path(__file__).with_name("called"), "a") as file:
        file.write("x")
    said = answer({"u": u, "t": t}, {"k": k, "tau": tau, "mass": mass})
    return float(said["y"]), float(said["z"])
"""
)


def asked(folder: Path, *words: str) -> list[str]:
    csv = folder / "spring.csv"
    if not csv.exists():
        data = readings(n=20)
        lines = [",".join(data.columns), *(",".join(map(str, row)) for row in zip(*data.columns.values()))]
        csv.write_text("\n".join(lines) + "\n")
    return ["discover", "machine=simulator", f"data={csv}", f"results={folder}/results", "pages=none", *words]


def test_a_killed_search_goes_on_where_it_was(spring, tmp_path):
    """Kill a search among its calls; the next one makes the others, and says what the undisturbed one says."""
    spring.write_text(SLOW)
    words = asked(tmp_path, f"machine.call={spring}:slow", "machine.rows=one", "--json")
    called = tmp_path / "called"
    code = "import sys; from calibench.bench.cli import main; main(sys.argv[1:])"
    process = subprocess.Popen(
        [sys.executable, "-c", code, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    while not (called.exists() and called.stat().st_size > 150):
        assert process.poll() is None
        time.sleep(0.02)
    children = descendants(process.pid)
    process.send_signal(signal.SIGKILL)
    process.wait()
    wait_for(lambda: not alive(children))
    (tmp_path / "killed").touch()
    before = called.stat().st_size
    twice = "import sys, contextlib\nfrom calibench.bench.cli import main\n"
    twice += "for _ in range(2):\n    with contextlib.suppress(SystemExit):\n        main(sys.argv[1:])\n"
    again = subprocess.run([sys.executable, "-c", twice, *words, "--retry"], capture_output=True, text=True)
    lines = [json.loads(line) for line in again.stdout.splitlines()]
    [first], [second] = ([n for n in line["notes"] if n["code"] == "simulator_calls"] for line in lines)
    assert (
        first["values"]["rows"] - first["values"]["run"] > 0.7 * before - 64
    )  # a part of 16 rows of each process is lost
    assert second["values"]["run"] == 0
    assert second["values"]["rows"] == first["values"]["rows"]
    assert lines[0]["verdict"] == lines[1]["verdict"] == "none"


def test_a_long_simulation_says_beforehand_what_it_will_take(spring, tmp_path, monkeypatch, capsys):
    from calibench.discrepancy.machines.simulator import formulation

    monkeypatch.setattr(formulation, "_LONG", 0.0)
    simulator(spring, "answer").formulate(readings(n=30))
    said = capsys.readouterr().err
    assert "times 30 rows" in said
    assert "a command that is killed goes on" in said
    simulator(spring, "answer").formulate(readings(n=30))
    assert not capsys.readouterr().err  # a search formulates more than once
    assert duration(42.4) == "43 s"
    assert duration(5400.0) == "1.5 h"


def test_an_edited_simulator_is_searched_again(spring, tmp_path, capsys):
    words = asked(tmp_path, f"machine.call={spring}:answer")
    with suppress(SystemExit):
        main(words)
    assert "searched before" not in capsys.readouterr().out
    with suppress(SystemExit):
        main(words)
    assert "searched before" in capsys.readouterr().out
    spring.write_text(SPRING.replace("0.1 * p", "0.12 * p"))
    os.utime(spring, ns=(1, 1))
    with suppress(SystemExit):
        main(words)
    assert "searched before" not in capsys.readouterr().out


def test_nothing_that_a_data_file_names_is_run(spring, tmp_path, capsys):
    """A file of data that states a call, a command, or formulas, is data: one line refuses it, or it says nothing."""
    mark = tmp_path / "mark"
    stated = {"machine": "simulator", "call": f"{spring}:answer", "command": f"touch {mark}", "fmu": "x.fmu"}
    (tmp_path / "bad.csv").write_text(f"# measured_data: {json.dumps(stated)}\nu,t,y,z\n" + "1,1,0.4,0.9\n" * 20)
    with pytest.raises(SystemExit) as ended:
        raise SystemExit(main(["discover", "machine=simulator", f"data={tmp_path}/bad.csv", f"results={tmp_path}/r"]))
    assert ended.value.code == 2
    assert "one of machine.call=" in capsys.readouterr().err
    assert not mark.exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "one of machine.call="),
        ({"call": "answer", "command": "./sim"}, "machine.call= and machine.command= is given"),
        ({"call": "answer", "parameters": {"k": (2.0, 3.0, 4.0)}}, "parameter k: .* nominal value, lower and upper"),
        ({"call": "answer", "inputs": ("v", "t")}, "v: no column of numbers"),
        ({"call": "answer", "sigma": {"x": 0.1}}, "machine.sigma: x is not measured"),
        ({"call": "broken"}, r"nominal .* \(k = 2, tau = 0.5, mass = 0\): ArithmeticError: no equilibrium \(spring_"),
        ({"call": "still"}, "the same whatever its inputs and parameters are"),
        ({"call": "short"}, r"returned y of shape \(3,\): 120 rows need as many values"),
        ({"call": "random"}, "the simulator's own noise, .* of y, is larger than that of its readings, 0.002"),
        ({"call": "not_there"}, "not_there"),
        ({"call": "rounded"}, "rounds y to steps of 0.05, far more than its noise, 0.002: let it give more digits"),
        ({"call": "leaves"}, r"\(k = 2, tau = 0.5, mass = 0\): SystemExit: 3 \(spring_"),
        ({"call": "narrow"}, r"failed at k = 2, tau = 0\.5\d*, mass = .*: ArithmeticError: too slow \(spring_"),
        ({"call": "of_no_parameter"}, r"no output depends on a parameter that is calibrated \(k, tau\)"),
        ({"call": "cut"}, "no finite number right beside the nominal parameters"),
        ({"command": "./sim {args}"}, "machine.inputs= is missing"),
    ],
)
def test_what_does_not_fit_is_one_line(spring, options, message):
    if "call" in options:
        options = {**options, "call": f"{spring}:{options['call']}"}
    with pytest.raises((DataError, ValueError), match=message):
        machines.make("simulator", **options).formulate(readings())


def test_a_call_without_a_file_asks_for_one():
    with pytest.raises(DataError, match=r"machine\.call=answer: FILE\.py:FUNCTION is needed, such as sim\.py:answer"):
        machines.make("simulator", call="answer").formulate(readings())


def test_what_a_simulator_prints_is_no_answer(spring, capsys):
    simulator(spring, "prints").formulate(readings())
    said = capsys.readouterr()
    assert "a step" in said.err
    assert not said.out


def test_a_computed_rate_has_one_word_in_the_file_and_on_the_page(spring):
    data = readings()
    formulation = simulator(spring, time="t_s").formulate(data.with_columns({"t_s": np.arange(len(data)) * 3.0}))
    rates = {name: words for name, words in words_of(roles_of(formulation)).items() if name.startswith("rate of ")}
    assert {*rates} >= {"rate of u", "rate of t"}
    assert all(name == words for name, words in rates.items())
    place = Place("y", "rate of u", 1e-9)
    assert "over the rate of u" in headline(Report("case", "simulator", "unknown", where=(place,), words=rates))
    own = Place("y", "hours_of_use", 1e-9)  # a user's own column is a name
    assert "over hours of use" in headline(Report("case", "simulator", "unknown", where=(own,), words=rates))


def test_an_input_in_seconds_is_the_time_within_a_trial_unless_another_is_stated(spring):
    data = replace(readings(), units={"t": "s"})
    read = simulator(spring).formulate(data)
    assert {"instrument_lag y", "instrument_lag z"} <= {name_of(effect) for effect in catalogue(read).candidates}
    assert [note.columns for note in read.data.notes if "machine.time=" in note.text] == [("t",)]
    for asked_for, run in (("box", "box"), ("t,box", "box"), ("t", "")):  # the clock of the run may be beside it
        both = simulator(spring, time=asked_for).formulate(data)
        assert roles_of(both).time == run
        assert "instrument_lag y" in {name_of(effect) for effect in catalogue(both).candidates}
    hints = {
        one.reason
        for one in catalogue(simulator(spring).formulate(readings())).untestable
        if one.family == "instrument_lag"
    }
    assert all("machine.time=" in hint for hint in hints)
    assert hints


@pytest.mark.parametrize(
    ("column", "factor"), [("y", 1000.0), ("u", 180 / np.pi), ("z", 0.001), ("y", 10.0), ("z", 6.894757)]
)
def test_a_factor_of_units_between_file_and_simulator_is_named(spring, column, factor):
    data = readings()
    other = data.with_columns({column: np.asarray(data[column]) / factor})
    with pytest.raises(DataError, match=f"near to it if {column} is multiplied by {factor:.6g}: file and simulator"):
        simulator(spring).formulate(other)


@pytest.mark.parametrize(("columns", "unit", "factor"), [("ut", "deg", np.pi / 180), ("z", "gon", np.pi / 200)])
def test_the_unit_that_columns_state_is_told_as_the_one_in_which_they_are(spring, columns, unit, factor):
    data = readings()
    other = data.with_columns({name: np.asarray(data[name]) / factor for name in columns})
    other = replace(other, units=dict.fromkeys(columns, unit))
    with pytest.raises(DataError, match=f"{', '.join(columns)} (is|are) multiplied by {factor:.6g}: file"):
        simulator(spring).formulate(other)


def test_a_simulator_without_a_free_parameter_is_searched_as_it_is(spring):
    held = simulator(spring, parameters={"k": 2.2, "tau": 0.55, "mass": 0.0})
    assert explain(held, readings()).verdict == "none"


def test_a_wave_over_the_clock_is_named_where_the_clock_is_known(spring):
    data = readings().with_columns({"t_s": np.arange(120) * 17.0})
    wave = 0.02 * np.sin(2 * np.pi * data["t_s"] / 410.0)
    [finding] = explain(simulator(spring), data.with_columns({"y": data["y"] + wave})).findings
    assert finding.effect == "cycle t_s in y"
    assert finding.period == pytest.approx(410.0, rel=0.02)


def test_kelvins_are_no_degrees_celsius_of_new_rows(spring):
    report = explain(simulator(spring), replace(readings(), units={"box": "degC"}))
    rows = {"u": [0.5], "t": [1.0], "u_dir": [1], "box [K]": [300.0]}
    with pytest.raises(DataError, match="column box is in K, and in the fit in degC"):
        report.predict(rows)


def test_numbers_of_a_command_stand_behind_their_names_in_any_text():
    text = "print('sim 2.1'); print('y [m] = 0.93 m, z: 9.1e-1 kPa'); print('done after 2000 steps')"
    names = Names(("u",), (), ("y", "z"))
    said = of_command(f'{sys.executable} -c "{text}"', names)(np.ones((1, 1)), np.zeros(0))
    np.testing.assert_allclose(said, [[0.93, 0.91]])


def test_a_unit_that_contradicts_the_head_of_a_column_is_refused(spring, tmp_path):
    (tmp_path / "units.csv").write_text("u,t [s],y [m],z\n" + "1,1,0.4,0.9\n2,2,0.5,0.9\n" * 10)
    with pytest.raises(DataError, match="units: y is in m by its head, and mm here"):
        read_measured(tmp_path / "units.csv", simulator(spring), units={"y": "mm"})
    read_measured(tmp_path / "units.csv", simulator(spring), units={"y": "m"})


def test_an_output_may_be_late_by_the_time_of_its_process_and_a_size_over_its_rate_is_a_time(spring):
    slow = replace(readings(), units={"t": "s", "y": "degC"})
    slow = slow.with_columns({"t": 20 * np.asarray(slow["t"])})
    parameters = {"k": (2.0, 1.0, 4.0), "tau": (10.0, 4.0, 30.0), "mass": 0.0}
    formulation = simulator(spring, parameters=parameters).formulate(slow)
    [lag] = [one for one in catalogue(formulation).candidates if name_of(one) == "instrument_lag y"]
    assert lag.largest == pytest.approx(0.25 * np.ptp(slow["t"]))
    assert formulation.data.units["rate of y"] == "degC/s"
    assert Term("y", (Atom("rate of y", "u", unit="degC/s"),)).unit_of("degC") == "s"


def test_the_report_predicts_new_rows_and_says_how_often_it_called(spring):
    report = explain(simulator(spring), readings())
    [note] = [note for note in report.notes if note.code is Code.SIMULATOR_CALLS]
    assert note.values["rows"] > 120
    assert ("had been kept" in note.text) == (note.values["run"] < note.values["rows"])
    ahead = report.predict({"u": [0.5, -0.5], "t": [1.0, 1.0], "u_dir": [1, 1], "box": [0, 0]})
    np.testing.assert_allclose(ahead.measured["y"], np.array([0.5, -0.5]) / 2.2 * (1 - np.exp(-1 / 0.55)), atol=2e-3)


@pytest.mark.parametrize("clock", ["t", "t_s"])
def test_columns_that_were_computed_for_the_fit_are_computed_for_new_rows(spring, clock):
    data = readings().with_columns({"t_s": np.arange(120.0)})
    fitted = simulator(spring, time=clock).formulate(data).data
    computed = sorted(name for name in fitted.computed if name.startswith(("rate of", "direction of")))
    assert computed == (["rate of y", "rate of z"] if clock == "t" else ["direction of t", "rate of t", "rate of u"])
    of_new = simulator(spring, time=clock).formulate(data).of_new
    for name in computed:
        for new, atol in ((data, 0.0), (data.with_columns({"u": data["u"] + 1e-9}), 1e-6)):
            np.testing.assert_allclose(of_new(new)[name][-len(fitted) :], fitted[name], atol=atol)
        assert of_new(data.with_columns({name: np.ones(120)}))[name].tolist() == [1.0] * 120


def test_a_play_by_the_order_of_a_clock_says_nothing_of_the_first_row(spring):
    data, rng = readings(), np.random.default_rng(3)
    came = np.sign(np.diff(data["u"], prepend=9.0))
    u, columns = data["u"] - 0.03 * came, {n: c for n, c in data.columns.items() if n not in ("u_dir", "split")}
    rise = 1 - np.exp(-data["t"] / 0.55)
    columns |= {"t_s": np.arange(120.0), "y": u / 2.2 * rise, "z": np.sin(u) * rise + 0.22 * data["t"]}
    columns |= {name: columns[name] + 0.002 * rng.standard_normal(120) for name in ("y", "z")}
    report = explain(simulator(spring, time="t,t_s"), MeasuredData(columns, "simulator", {}, "spring"))
    assert (report.verdict, [f.effect for f in report.findings]) == ("named", ["backlash u"])


def test_time_within_a_trial_gives_outputs_a_rate_and_so_a_lag(spring):
    formulation = simulator(spring, time="t").formulate(readings())
    names = {name_of(effect) for effect in catalogue(formulation).candidates}
    assert {"instrument_lag y", "instrument_lag z"} <= names
    assert not any(name.startswith("drift t") for name in names)  # time does not drift over itself
    local, (k, tau) = formulation.of_rows.local, (p.start for p in formulation.parameters)
    u, t = formulation.data["u"], formulation.data["t"]
    np.testing.assert_allclose(formulation.data["rate of y"], u / k / tau * np.exp(-t / tau), atol=1e-6)
    assert local.independent
