"""One installed name: `calibench`; in a checkout a short name has the same public names, and no copy of a module."""

import importlib
import subprocess
import sys

import pytest

import calibench
from calibench import bench, discrepancy, optimizers, problems


@pytest.mark.parametrize("name", ["bench", "problems", "optimizers", "discrepancy"])
def test_a_short_name_has_the_same_public_names(name):
    short, whole = importlib.import_module(name), importlib.import_module(f"calibench.{name}")
    assert all(getattr(short, public) == getattr(whole, public) for public in whole.__all__)


@pytest.mark.parametrize("name", ["bench.store.runs", "problems.base", "optimizers.base", "core.registry"])
def test_a_module_has_its_whole_name_alone_and_so_no_second_copy(name):
    importlib.import_module(f"calibench.{name}")
    with pytest.raises(ModuleNotFoundError, match=name.rpartition(".")[0].partition(".")[0]):
        importlib.import_module(name)


def test_a_public_name_stays_what_it_is_when_its_module_is_imported():
    importlib.import_module("calibench.discrepancy.procedure")
    assert callable(discrepancy.explain)


def test_measured_data_load_no_search():
    ask = "import sys; from calibench.discrepancy import MeasuredData; print([m for m in sys.modules if 'search' in m])"
    done = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


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
