"""Where pygmo has no wheel all else is there: a process from which the package is hidden."""

from __future__ import annotations

import subprocess
import sys

import pytest

HIDDEN = "import sys; sys.modules['pygmo'] = None\n"


def said(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", HIDDEN + code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_package_is_imported_without_pygmo() -> None:
    walk = "import pkgutil, importlib, calibench\n"
    walk += (
        "for room in ('core', 'problems', 'optimizers', 'discrepancy', 'testing', 'bench.gate', 'bench.execution'):\n"
    )
    walk += "    found = importlib.import_module(f'calibench.{room}')\n"
    walk += "    for one in pkgutil.walk_packages(found.__path__, f'calibench.{room}.'):\n"
    walk += "        one.name.endswith('__main__') or importlib.import_module(one.name)\n"
    walk += "print('pygmo' in sys.modules and sys.modules['pygmo'] is None)"
    assert said(walk) == "True\n"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lm", "de", "nlopt_LN_BOBYQA"])
def test_a_method_of_another_library_runs_without_pygmo(name: str) -> None:
    run = "from calibench import bench, optimizers, problems\n"
    run += f"print(bench.execute(problems.make('sensor_zero'), optimizers.make('{name}'), budget=200).status)"
    assert said(run) == "ok\n"


@pytest.mark.slow
def test_a_method_of_pygmo_that_is_asked_for_says_what_is_missing() -> None:
    run = "from calibench import bench, optimizers, problems\n"
    run += "row = bench.execute(problems.make('sensor_zero'), optimizers.make('pygmo_cmaes'), budget=200).row\n"
    run += "print(row['status'], row['error'])"
    told = said(run)
    assert told.startswith("failed")
    assert "pygmo cannot be imported" in told
    assert "choose an optimizer that does not begin with pygmo_" in told


@pytest.mark.slow
def test_a_glob_leaves_the_methods_of_pygmo_out_and_says_so() -> None:
    read = "from calibench.bench.sweep.request import read_request\n"
    read += "asked = ['problem=sensor_zero', 'optimizer=glob([pygmo_s*,lm])', 'budget=50', 'seeds=1']\n"
    read += "request = read_request(asked, True)\n"
    read += "print([spec.optimizer for spec in request.specs.values()], *request.left_out)"
    names = "pygmo_sade, pygmo_sga, pygmo_simulated_annealing, pygmo_sea"
    assert said(read) == f"['lm'] {names} need the package pygmo, which is not installed here: skipped\n"
