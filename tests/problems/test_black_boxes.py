"""`bbob` and `ioh`: their functions are the libraries' own, and the libraries count what we count, cell by cell.

Tests of a suite are skipped where its package is absent: both are extras. What is said then is tested everywhere.
"""

import importlib.metadata
import importlib.util
import json
import multiprocessing
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest

from calibench import bench, optimizers, problems, testing
from calibench.problems.suites.black_box import package

METHODS = ("fmincon", "nlopt_LN_BOBYQA", "nlopt_LD_LBFGS", "de", "pso", "pygmo_cmaes")
IOH = (
    *(("BBOB", f, d, i) for f in range(1, 25) for d in (2, 5) for i in (1, 2)),
    *(("SBOX", f, 3, 2) for f in range(1, 25)),
    *(("CEC2013", f, None, 1) for f in range(1, 21)),
    *(("CEC2022", f, 10, 1) for f in range(1, 13)),
    *(("STAR", f, 3, 1) for f in (30, 39, 40, 59)),
)


def needs(module, distribution):
    found = importlib.util.find_spec(module) is not None
    return pytest.mark.skipif(not found, reason=f"the package {distribution} is not installed: it is an extra")


coco, iohs = needs("cocoex", "coco-experiment"), needs("ioh", "ioh")


def bbob(function=1, dimension=2, instance=1):
    return problems.make("bbob", function=function, dimension=dimension, instance=instance)


def ioh(suite="BBOB", function=1, dimension=None, instance=1):
    return problems.make("ioh", suite=suite, function=function, dimension=dimension, instance=instance)


def counts(problem, method, budget):
    """Return what our row and the library's counter say of one run."""
    before = problem.evaluations
    run = bench.execute(problem, optimizers.make(method), budget=budget)
    assert run.status == "ok", run.row["error"]
    return run.evaluations, problem.evaluations - before


def test_the_suites_are_listed_and_nothing_foreign_is_imported_for_it():
    code = "import sys, problems; print(problems.names()); print({'cocoex', 'ioh'} & set(sys.modules))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "'bbob'" in said
    assert "'ioh'" in said
    assert said.splitlines()[1] == "set()"


def test_an_absent_package_is_told_in_one_line_with_what_to_install():
    way_out = r"problem bbob needs the package coco-experiment.* pip install 'calibench\[bbob\]'"
    with pytest.raises(ValueError, match=way_out):
        package("no_such_module_of_coco", "coco-experiment", "bbob")


@pytest.mark.parametrize("name", ["bbob", "ioh"])
def test_where_the_package_is_absent_the_problem_says_so(name, monkeypatch):
    for module in ("cocoex", "cocoex.bare_problem", "ioh"):
        monkeypatch.setitem(sys.modules, module, None)  # as where it is not installed
    way_out = rf"problem {name} needs the package .*; pip install 'calibench\[{name}\]'"
    with pytest.raises(ValueError, match=way_out) as told:
        problems.make(name)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"function": 25}, "bbob.function=25"),
        ({"dimension": 4}, "bbob.dimension=4"),
        ({"instance": 0}, "bbob.instance=0: must be 1 or more"),
    ],
)
def test_what_bbob_does_not_have_is_refused(options, said):
    with pytest.raises(ValueError, match=said):
        problems.make("bbob", **options)


@coco
@pytest.mark.parametrize("dimension", [2, 3, 5, 10, 20, 40])
def test_bbob_is_coco_s_function_with_coco_s_optimum(dimension):
    from cocoex.bare_problem import BareProblem

    for function in range(1, 25):
        for instance in (1, 5, 71):
            ours, coco = bbob(function, dimension, instance), BareProblem("bbob", function, dimension, instance)
            x = np.random.default_rng(function).uniform(-5, 5, dimension)
            assert ours(x) == coco(x)
            assert ours.minimum == coco.best_value()
            assert ours(ours.truth) == pytest.approx(ours.minimum, rel=0, abs=1e-14)
            assert ours.data_id == coco.id


@coco
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dimension", [2, 10])
def test_coco_counts_what_we_count_cell_by_cell(method, dimension):
    for function in range(1, 25):
        instance = 1 + function % 5
        budget = 160  # a generation of the largest population, and part of the next
        ours, cocos = counts(bbob(function, dimension, instance), method, budget)
        assert ours == cocos
        assert 0 < ours <= budget


@coco
def test_targets_are_coco_s_levels_above_the_optimum():
    problem = bbob(8, 3, 2)
    gaps = np.array(problem.targets) - problem.minimum
    np.testing.assert_allclose(gaps, 10.0 ** np.arange(2, -8.1, -0.2), rtol=1e-4)
    run = bench.execute(problem, optimizers.make("nlopt_LN_BOBYQA"), budget=2000)
    assert run.best_value <= problem.targets[-1]
    assert None not in run.row["hits"]
    assert run.row["minimum"] == problem.minimum


@coco
def test_another_version_of_the_library_is_other_code(monkeypatch):
    from calibench.bench.provenance import code_digest

    run = bench.execute(bbob(), optimizers.make("fmincon"), budget=30)
    assert json.loads(run.row["versions"])["coco-experiment"] == importlib.metadata.version("coco-experiment")
    known = code_digest.code_digest(bbob(), optimizers.make("fmincon"))
    assert run.row["code_digest"] == known
    monkeypatch.setattr(code_digest, "library_version", lambda package: "2.9" if package == "coco-experiment" else "1")
    parts = code_digest.changed_parts(known, code_digest.code_digest(bbob(), optimizers.make("fmincon")))
    assert parts == ["problem", "optimizer"]


@coco
def test_groups_are_those_of_the_suite():
    found = [bbob(function).group for function in range(1, 25)]
    assert found == (
        ["separable"] * 5 + ["moderate"] * 4 + ["ill-conditioned"] * 5 + ["multi-modal"] * 5 + ["weak structure"] * 5
    )


@coco
@pytest.mark.parametrize("law", testing.PROBLEM_LAWS, ids=lambda law: law.__name__)
def test_a_function_of_bbob_keeps_the_laws_of_a_problem(law):
    for function in (1, 5, 7, 16, 24):
        law(bbob(function, 5, 3))


@iohs
@pytest.mark.parametrize("law", testing.PROBLEM_LAWS, ids=lambda law: law.__name__)
def test_a_function_of_ioh_keeps_the_laws_of_a_problem(law):
    for suite, function in (("BBOB", 3), ("SBOX", 22), ("CEC2013", 8), ("CEC2022", 11), ("STAR", 35)):
        law(ioh(suite, function))


@coco
def test_a_pickle_holds_the_options_and_a_child_process_builds_its_own():
    problem = bbob(20, 5, 4)
    value = problem(np.zeros(5))
    again = pickle.loads(pickle.dumps(problem))
    assert again.options == problem.options
    assert again(np.zeros(5)) == value
    with multiprocessing.get_context("fork").Pool(1) as pool:  # forked after it was built and called here
        theirs = pool.apply(_value_and_count, (problem,))
    assert theirs == (value, 1, True)
    assert problem.evaluations == 1


@coco
def test_workers_find_what_one_process_finds(tmp_path):
    found = []
    for execution in ("serial", "processes"):
        words = [
            "-m",
            "problem=bbob",
            "problem.function=1,8,21",
            "problem.dimension=2,3",
            "problem.instance=range(1,3)",
        ]
        code = _bench(["run", *words, "optimizer=de,fmincon", "budget=300", "seeds=1", f"execution={execution}",
                       f"results={tmp_path / execution}"])  # fmt: skip
        assert code == 0
        runs = bench.ResultStore(tmp_path / execution / "adhoc").runs().sort_values("run_id")
        found.append(runs[["run_id", "best_value", "evaluations", "minimum", "data_id"]].to_numpy().tolist())
    assert len(found[0]) == 24
    assert found[0] == found[1]


@iohs
@pytest.mark.parametrize("method", ["fmincon", "nlopt_LN_BOBYQA", "de"])
def test_ioh_counts_what_we_count_cell_by_cell(method):
    for suite, function, dimension, instance in IOH:
        ours, theirs = counts(ioh(suite, function, dimension, instance), method, budget=170)
        assert ours == theirs, (suite, function, dimension, instance)


@iohs
def test_what_ioh_maximises_is_minimised_and_its_optimum_is_the_least_value():
    import ioh as library

    for suite, function, dimension, instance in IOH:
        problem = ioh(suite, function, dimension, instance)
        if suite in ("BBOB", "SBOX", "CEC2022"):
            assert problem(problem.truth) == pytest.approx(problem.minimum, rel=1e-12)
            assert problem.targets[-1] == pytest.approx(problem.minimum + 1e-8, rel=1e-14)
    peaks = library.get_problem(1106, 1, 2, library.ProblemClass.CEC2013)
    ours = ioh("CEC2013", 6)
    assert ours([0.3, -0.2]) == -peaks([0.3, -0.2])
    assert ours(peaks.optimum.x) < ours.targets[-1]
    assert ours.minimum is None
    assert ioh("STAR", 30).targets == ()


@iohs
def test_sbox_and_bbob_are_other_functions_in_the_same_groups():
    x = np.full(5, 0.3)
    assert ioh("BBOB", 1, 5, 2)(x) != ioh("SBOX", 1, 5, 2)(x)
    assert [ioh("BBOB", f, 2).group for f in (1, 6, 24)] == ["separable", "moderate", "weak structure"]


@coco
@iohs
def test_ioh_s_bbob_is_coco_s_to_rounding():
    for function in range(1, 25):
        x = np.random.default_rng(function).uniform(-5, 5, 5)
        for instance in (1, 3, 5):
            assert ioh("BBOB", function, 5, instance)(x) == pytest.approx(bbob(function, 5, instance)(x), rel=1e-11)


@iohs
@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"suite": "PBO"}, "ioh.suite=PBO: choices: BBOB, SBOX, CEC2013, CEC2022, STAR|ioh.suite=PBO: did you mean"),
        ({"suite": "CEC2013", "function": 21}, "ioh.function=21: CEC2013 has 1 to 20"),
        ({"suite": "CEC2013", "function": 4, "dimension": 3}, "function 4 of CEC2013 has 2; leave it out"),
        ({"suite": "CEC2013", "function": 4, "instance": 2}, "CEC2013 has one instance of function 4; take 1"),
        ({"suite": "CEC2022", "dimension": 5}, "CEC2022 has 2, 10, 20"),
        ({"suite": "CEC2022", "function": 6, "dimension": 2}, "hybrid function 6 of CEC2022 needs 10 or 20"),
        ({"dimension": 1}, "BBOB needs 2 or more"),
        ({"instance": 0}, "ioh.instance=0: must be 1 or more"),
    ],
)
def test_what_ioh_does_not_have_is_refused(options, said):
    with pytest.raises(ValueError, match=said):
        problems.make("ioh", **options)


def _value_and_count(problem):
    return problem(np.zeros(5)), problem.evaluations, os.getpid() != os.getppid()


def _bench(words):
    from calibench.bench.cli import main

    with pytest.raises(SystemExit) as ended:
        main(words)
    return ended.value.code
