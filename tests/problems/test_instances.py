"""Instances: drawn by name, so alike everywhere; never centred; within reach; as identifiable as their family."""

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks.answer.drawn import drawn_table, instances
from calibench import bench, optimizers, problems
from calibench.bench.cli import main
from calibench.bench.provenance.run_id import canonical, options_of
from calibench.problems import DeltaProbing, Orthoglide, Planar, identify
from calibench.problems.instances import WORST_CONDITION, WORST_ERROR, Noise, Stream
from calibench.problems.planar.gpm2002 import NAMES, inverse_kinematics

ROOT = Path(__file__).resolve().parents[2]
FAMILIES = ("sensor_zero", "link_length", "full11", "full12", "tracking_zero", "orthoglide6", "delta9")
RANKS = {"full12": 11}  # one direction no reading sees; every other family sees all
each_family = pytest.mark.parametrize("family", FAMILIES)


def made(case, **options):
    family, instance = case
    return problems.make(family, instance=instance, **options)


drawn = cache(instances)  # of a family: 1 to 24


def p_rows(problem):
    """Return how many poses, places or readings the plan of an instance has."""
    return problem.drawn.options.get("n", len(problem.readings))


def test_every_problem_that_simulates_a_machine_is_a_family():
    of_machines = {n for n in problems.names() if {"data_seed", "seed"} & set(problems.registry.options(n))}
    assert of_machines == set(FAMILIES)
    assert all("instance" in problems.registry.options(name) for name in FAMILIES)


def test_without_an_instance_the_rows_of_the_papers_are_what_they_were():
    kept = sorted((ROOT / "results" / "reference").glob("*/runs.parquet"))
    named = ["problem", "problem_options", "data_id"]
    rows = pd.concat([pd.read_parquet(path, columns=named) for path in kept]).drop_duplicates()
    assert len(rows) > 20
    for name, options, data in rows.itertuples(index=False):
        given = {key: value for key, value in json.loads(options).items() if value is not None}
        problem = problems.make(name, **given)
        assert canonical(options_of(problem)) == options
        assert problem.data_id == data


def test_without_an_instance_nothing_new_is_declared():
    for family in set(FAMILIES) - {"orthoglide6", "delta9"}:  # whose data have a minimum
        assert problems.make(family).minimum is None
    assert all(problems.make(family).as_good_as_noise is None for family in FAMILIES)


@each_family
def test_the_truth_is_in_the_box_and_neither_its_centre_nor_the_start(family):
    for p in drawn(family):
        truth, start = (np.array([getattr(c, k) for c in p.parameters]) for k in ("true", "start"))
        lower, upper = (np.array([getattr(c, k) for c in p.parameters]) for k in ("lower", "upper"))
        share, begun = (truth - lower) / (upper - lower), (start - lower) / (upper - lower)
        assert ((share > 0.049) & (share < 0.951)).all(), p.options
        assert ((begun > 0.049) & (begun < 0.951)).all(), p.options
        assert (abs(share - 0.5) > 0.049).all(), p.options
        assert (abs(share - begun) > 0.02).all(), p.options
        assert (np.abs(p.truth) > 1e-3).all(), f"{p.options}: the box favours the origin"


@each_family
def test_every_pose_of_the_plan_is_reached(family):
    for p in drawn(family):
        assert np.isfinite(p.readings).all(), p.options
        assert np.isfinite(p.residuals(p.truth)).all(), p.options
        if isinstance(p, Orthoglide):
            continue
        if isinstance(p, DeltaProbing):
            assert np.isfinite(p.residuals(p.start)).all(), p.options
            continue
        machines = [p.drawn.machine] if family == "tracking_zero" else [p.drawn.machine.actual, p.drawn.machine.nominal]
        points = p.true_positions if isinstance(p, Planar) else p.points
        for machine in machines:
            assert np.isfinite(inverse_kinematics(machine, points)).all(), p.options


@each_family
def test_readings_identify_what_those_of_the_family_do(family):
    for p in drawn(family):
        found = identify(p)
        rank = RANKS.get(family, found.dimension)
        assert found.rank == rank, p.options
        assert found.condition <= 1.01 * WORST_CONDITION, (
            p.options
        )  # at the true machine's readings; noise moves it little
        assert p.drawn.noise.level / found.singular_values[rank - 1] <= 1.01 * WORST_ERROR, p.options


@each_family
def test_a_fit_from_the_truth_ends_as_good_as_the_noise(family):
    for p in (drawn(family)[k - 1] for k in (1, 2, 5, 24)):
        assert p.minimum <= p(p.truth)
        assert p.as_good_as_noise in p.targets
        assert list(p.targets) == sorted(set(p.targets), reverse=True)
        if p.drawn.noise.level:
            assert p.targets[-1] == p.as_good_as_noise == p(p.truth)
            assert 0 < p.minimum < p.as_good_as_noise < p(p.start)
        else:
            assert p(p.truth) <= p.targets[-1] < p.as_good_as_noise < p(p.start)


def test_the_page_of_the_instances_tells_what_was_drawn():
    page = (ROOT / "docs" / "instances.md").read_text(encoding="utf-8")
    assert drawn_table(drawn) in page, "run: python -m benchmarks.answer.drawn"


@pytest.mark.parametrize("case", [("full12", 1), ("full11", 2), ("orthoglide6", 2), ("tracking_zero", 4)], ids=str)
@pytest.mark.slow
def test_nothing_in_the_box_is_found_below_the_minimum(case):
    p = made(case)
    assert p.drawn.noise.level > 0
    for seed in range(2):
        run = bench.execute(p, optimizers.make("trf"), budget=4000, seed=seed, start="random")
        assert run.best_value >= p.minimum * (1 - 1e-9)


def test_the_level_without_noise_is_what_the_finest_readings_leave():
    rng = np.random.default_rng(7)
    p = made(("full11", 1))
    assert p.drawn.noise.level == 0
    from dataclasses import replace

    taken = [
        replace(p, readings=p.readings + 1e-6 * rng.standard_normal(p.readings.shape))(p.truth) for _ in range(300)
    ]
    assert np.mean(taken) == pytest.approx(p.as_good_as_noise, rel=0.05)


def test_two_instances_have_other_data_and_other_runs():
    for family in FAMILIES:
        assert len({p.data_id for p in drawn(family)}) == 24
        assert len({tuple(p.lower) for p in drawn(family)}) == 24
    one, two = (bench.execute(made(("sensor_zero", k)), optimizers.make("lm"), budget=20) for k in (1, 2))
    assert one.run_id != two.run_id


def test_families_and_kinds_of_plan_and_noise_vary():
    for family in FAMILIES:
        kinds = {p.drawn.options["plan"] for p in drawn(family)}
        assert len(kinds) >= (3 if family == "delta9" else 4)
        assert len(set(map(p_rows, drawn(family)))) >= 8
        quiet = sum(p.drawn.noise.level == 0 for p in drawn(family))
        assert 1 <= quiet <= 18


def test_the_error_function_changes_neither_the_machine_nor_its_readings():
    one, two, three = (made(("full11", 3), error=error) for error in ("J1", "J2", "J3"))
    assert one.data_id == two.data_id == three.data_id
    assert [p.true for p in one.parameters] == [p.true for p in three.parameters]


def test_what_a_family_holds_is_known():
    p = made(("link_length", 4))
    free = {c.name for c in p.parameters}
    held = [i for i, name in enumerate(NAMES) if name not in free]
    setting = p.drawn.machine
    np.testing.assert_array_equal(setting.actual[held], setting.nominal[held])
    assert (setting.actual != setting.nominal).sum() == len(free)


def test_all_of_a_problem_can_be_chosen_but_what_the_instance_draws():
    assert made(("full12", 2), gauge="ya2").gauge.held == "ya2"
    assert len(made(("full11", 2), free=("z1", "z2")).truth) == 2
    assert made(("orthoglide6", 2), free="rho", model="linear").truth.shape == (3,)
    again = made(("full11", 2), noise=made(("full11", 2)).noise)
    assert again.data_id == made(("full11", 2)).data_id


@pytest.mark.parametrize(
    ("family", "options", "words"),
    [
        ("full12", {"instance": 0}, "full12.instance=0: must be 1 or more"),
        ("tracking_zero", {"instance": -3}, "tracking_zero.instance=-3: must be 1 or more"),
        ("orthoglide6", {"instance": 0}, "orthoglide6.instance=0: must be 1 or more"),
        ("full12", {"instance": "two"}, "full12.instance=two: a whole number is needed"),
        ("sensor_zero", {"instence": 1}, "did you mean 'instance'?"),
        ("full11", {"instance": 1, "noise": 0.01}, "full11.noise=0.01: instance=1 means noise=0.0; leave one"),
        ("full11", {"instance": 1, "paper_section": 3}, "full11.paper_section=3: instance=1 means paper_section=4"),
        ("tracking_zero", {"instance": 1, "experiment": 2}, "tracking_zero.experiment=2: instance=1 means"),
        ("orthoglide6", {"instance": 1, "data": "exp1"}, "orthoglide6.data=exp1: instance=1 means data=synthetic"),
        ("full11", {"instance": 1, "readings": "x.csv"}, "full11.instance=1: draws a machine, but its readings are"),
        ("orthoglide6", {"instance": 1, "readings": "x.csv"}, "orthoglide6.instance=1: draws a machine"),
    ],
)
def test_a_wrong_request_is_one_clear_line(family, options, words):
    with pytest.raises(ValueError, match=r"\w") as refused:
        problems.make(family, **options)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_the_command_line_knows_instances(capsys):
    assert command("identify", "problem=full12", "problem.instance=3") == 0
    assert capsys.readouterr().out.startswith("full12: 11 of 12 parameters can be seen")
    assert command("list", "problems") == 0
    assert capsys.readouterr().out.count("instance=null (int or null)") >= len(FAMILIES)
    assert command("run", "problem=full12", "problem.instance=0", "optimizer=lm", "budget=10") == 2
    assert capsys.readouterr().err.strip() == "bench: full12.instance=0: must be 1 or more"


def command(*words):
    with pytest.raises(SystemExit) as ended:
        main(list(words))
    return ended.value.code


def test_one_s_own_readings_have_no_instance():
    with pytest.raises(ValueError, match=r"full11\.instance"):
        problems.full11.from_readings(np.zeros((20, 3)), instance=1)


@pytest.mark.slow
def test_an_instance_is_the_same_in_every_process():
    told = (
        "import json; from calibench import problems; print(json.dumps([[p.data_id, p.lower.tolist(), p.targets] for "
        "p in (problems.make(n, instance=7) for n in ('full12', 'tracking_zero', 'orthoglide6'))]))"
    )
    seen = []
    for word in ("1", "4711"):
        environment = os.environ | {"PYTHONHASHSEED": word, "PYTHONPATH": str(ROOT)}
        seen.append(
            subprocess.run([sys.executable, "-c", told], env=environment, capture_output=True, check=True).stdout
        )
    assert seen[0] == seen[1]
    here = [made((family, 7)) for family in ("full12", "tracking_zero", "orthoglide6")]
    assert json.loads(seen[0]) == [[p.data_id, p.lower.tolist(), list(p.targets)] for p in here]


def test_a_thing_that_is_drawn_more_leaves_the_others():
    one, other = (Stream.of("full11", 3, 0, thing) for thing in ("noise", "box"))
    assert one.between(0, 1) != other.between(0, 1)
    again = Stream.of("full11", 3, 0, "noise")
    assert again.between(0, 1) == Stream.of("full11", 3, 0, "noise").between(0, 1)
    assert Stream.of("full11", 3, 1, "noise").between(0, 1) != Stream.of("full11", 3, 0, "noise").between(0, 1)


def test_one_instance_of_four_has_no_noise():
    levels = [Noise.drawn(Stream.of("any", k, 0, "noise"), 1e-6, 1e-3).level for k in range(2000)]
    assert np.mean(np.array(levels) == 0) == pytest.approx(0.25, abs=0.04)
    levels = np.log10([level for level in levels if level])
    assert levels.min() >= -6
    assert levels.max() <= -3
    assert np.median(levels) == pytest.approx(-4.5, abs=0.1)
