"""One installed name: `calibench`; in a checkout the short names are the same modules, never copies of them."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import calibench
from calibench import bench, discrepancy, optimizers, problems

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("name", ["bench", "problems", "optimizers", "discrepancy", "core", "conf"])
def test_a_short_name_is_the_same_module(name):
    assert importlib.import_module(name) is importlib.import_module(f"calibench.{name}")


@pytest.mark.parametrize("name", ["bench.store.runs", "problems.base", "optimizers.base", "discrepancy.report"])
def test_a_module_of_a_short_name_is_the_same_module(name):
    module = importlib.import_module(f"calibench.{name}")
    assert importlib.import_module(name) is module
    assert module.__spec__.name == module.__name__ == f"calibench.{name}"


def test_a_module_that_is_not_there_is_missed_by_the_name_that_was_asked_for():
    with pytest.raises(ModuleNotFoundError, match=r"bench\.nothing_here"):
        importlib.import_module("bench.nothing_here")


def test_a_public_name_stays_what_it_is_when_a_module_of_that_name_is_imported():
    importlib.import_module("discrepancy.explain")
    assert callable(discrepancy.explain)


def test_the_face_has_what_it_names():
    assert set(calibench.__all__) <= set(dir(calibench))
    assert calibench.execute is bench.execute
    assert calibench.ResultStore is bench.ResultStore
    assert calibench.problems is problems
    assert calibench.optimizers is optimizers
    with pytest.raises(AttributeError, match="no attribute 'nothing_here'"):
        calibench.nothing_here  # noqa: B018


def test_a_sweep_from_python_is_that_of_the_command_line(tmp_path):
    words = ["problem=sensor_zero", "optimizer=lm,trf", "budget=60", "seeds=1", f"results={tmp_path}", "study=mine"]
    rows = calibench.sweep(*words)
    assert sorted(rows["optimizer"]) == ["lm", "trf"]
    assert calibench.sweep(*words).equals(rows)


def test_a_set_that_ships_is_searched_by_its_name_from_python():
    found = calibench.discover("gpm2002", "demo_backlash")
    assert (found.case, found.machine) == ("demo_backlash", "gpm2002")
    with pytest.raises(discrepancy.DataError, match="did you mean 'demo_backlash'"):
        calibench.discover("gpm2002", "demo_backlsh")
    with pytest.raises(discrepancy.DataError, match="names 2 sets of data; one is needed"):
        calibench.discover("orthoglide", "exp1,exp2")


@pytest.mark.slow
def test_a_users_own_files_of_our_names_are_no_hindrance(tmp_path):
    for name in ("optimizers.py", "bench.py", "conf.py"):
        (tmp_path / name).write_text("raise RuntimeError('this is mine')\n")
    (tmp_path / "problems").mkdir()
    (tmp_path / "problems" / "__init__.py").write_text("raise RuntimeError('this is mine')\n")
    (tmp_path / "own.py").write_text(
        "import numpy as np\n\n\nclass Bowl:\n    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, .5)\n\n"
        "    def __call__(self, x):\n        return float(x @ x)\n"
    )
    run = (
        "import sys; sys.path.append(sys.argv[1]); from calibench.bench.cli import main\n"
        "for line in sys.argv[2:]:\n"
        "    try:\n        main(line.split())\n"
        "    except SystemExit as ended:\n        assert ended.code == 0, line\n"
    )
    lines = (
        "--version", "list problems", "run problem=./own.py:Bowl optimizer=de budget=50 seeds=1",
        "status results/adhoc", "run problem=sensor_zero optimizer=lm budget=50 seeds=1",
    )  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", run, str(ROOT), *lines], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
