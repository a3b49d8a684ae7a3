"""Compilation changes no bit, and its cache cannot be stale.

Both sides of each comparison are processes of their own, as the switch `NUMBA_DISABLE_JIT` is read when numba loads.
"""

import os
import re
import shutil
import struct
import subprocess
import sys
import types
from importlib.machinery import SourceFileLoader
from pathlib import Path

import numba
import pytest

from calibench.core.compilation import compiled as compiled_
from calibench.core.compilation.loading import keep
from tests.few import few

ROOT = Path(__file__).resolve().parents[2]

VALUES = """
import warnings
warnings.simplefilter("error")
import numpy as np
from calibench import problems
from calibench.problems.planar import _closed_loop_kernels
print("compiled", hasattr(_closed_loop_kernels.cost, "py_func"))
cases = [("sensor_zero", {}), ("full11", {"paper_section": 3}), ("full12", {"n": 12}), ("full12", {"gauge": "ya2"})]
for name, options in cases:
    for error in ("J1", "J2", "J3"):
        if name == "sensor_zero" and error == "J3":
            continue
        p = problems.make(name, error=error, noise=1e-4, **options)
        points = p.lower + (p.upper - p.lower) * np.random.default_rng(0).random((3, len(p.lower)))
        label = f"{name}-{error}-{p.data_id}"
        print(label, "cost", *(float(p(x)).hex() for x in points))
        print(label, "batch", p.batch(points).tobytes().hex())
        print(label, "residuals", p.residuals(points[0]).tobytes().hex())
        print(label, "jacobian", p.jacobian(points[0]).tobytes().hex())
        print(label, "positions", p.positions(points[0]).tobytes().hex())
"""


def python(code, folder=ROOT, **environment):
    """Run `code` in a new process; return its lines."""
    inherited = {key: value for key, value in os.environ.items() if key not in ("NUMBA_DISABLE_JIT", "PYTHONPATH")}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env=inherited | environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def compiled():
    """Return the lines that compiled kernels print."""
    return python(VALUES, NUMBA_DISABLE_JIT="0", PYTHONHASHSEED="1")


def test_kernels_are_right_with_the_decorator_removed_to_the_last_bit(compiled):
    plain = python(VALUES, NUMBA_DISABLE_JIT="1", PYTHONHASHSEED="2")
    assert (compiled[0], plain[0]) == ("compiled True", "compiled False")
    assert len(plain) == 1 + 11 * 5
    for ours, theirs in zip(compiled[1:], plain[1:], strict=True):
        assert ours == theirs


def test_batch_and_cost_agree_in_that_process_too(compiled):
    # the same law as in-process, here on what was printed, so that neither side can be empty or constant
    lines = [line.split() for line in compiled[1:]]
    costs = {words[0]: words[2:] for words in lines if words[1] == "cost"}
    assert len(costs) == 11
    for label, kind, *values in lines:
        if kind == "batch":
            stored = bytes.fromhex(values[0])
            assert len(stored) == 3 * 8
            assert len(set(costs[label])) == 3
            assert [value.hex() for value in struct.unpack("3d", stored)] == costs[label]


CACHE = "from calibench.core.compilation.compiled import cache_folder; print(cache_folder())"
KERNELS = """
from pathlib import Path
from calibench.core.compilation.compiled import kernel_folder
from calibench.optimizers.own import _random_kernels as one
from calibench.problems.planar import _closed_loop_kernels as other
print(*(kernel_folder(Path(module.__file__).resolve()) for module in (one, other)), sep="\\n")
"""


@pytest.fixture(scope="module")
def copied(tmp_path_factory):
    """Return a folder with a copy of the packages that have kernels, as an installation has them."""
    home = tmp_path_factory.mktemp("copied") / "src" / "calibench"
    for package in ("core", "calibration", "problems", "optimizers"):
        shutil.copytree(ROOT / package, home / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "calibench" / "__init__.py", home / "__init__.py")
    return home


def kernel_folders(source):
    """Return where kernels of the random numbers and of the GPM2002 are kept by the sources of a copy."""
    home = source.parent
    lines = python(KERNELS, home, PYTHONPATH=str(home), XDG_CACHE_HOME=str(home / "cache"))
    return [Path(line) for line in lines]


@pytest.fixture(scope="module")
def before(copied):
    return kernel_folders(copied)


def test_the_folder_of_kernels_is_named_by_what_their_sources_mean(copied, before):
    assert {folder.parent for folder in before} == {copied.parent / "cache" / "calibench" / "kernels"}
    assert re.fullmatch(r"_random_kernels-[0-9a-f]{12}", before[0].name)
    with (copied / "core" / "compilation" / "compiled.py").open("a") as file:
        file.write("# another line\n")
    (copied / "optimizers" / "own" / "new_one.py").write_text("x = 1\n")
    assert kernel_folders(copied) == before


@pytest.mark.parametrize(
    ("edited", "moves"),
    few(
        2,
        [
            ("problems/planar/_closed_loop_kernels.py", [False, True]),
            ("core/compilation/lanes.py", [False, True]),
            ("problems/base.py", [False, True]),
            ("optimizers/own/_random_kernels.py", [True, False]),
            ("core/compilation/loading.py", [True, True]),
        ],
    ),
)
def test_an_edit_moves_the_kernels_that_lead_to_it_and_no_others(copied, before, edited, moves):
    text = (copied / edited).read_text()
    (copied / edited).write_text(text + "another = 1\n")
    assert [one != other for one, other in zip(kernel_folders(copied), before, strict=True)] == moves
    (copied / edited).write_text(text)


def test_a_home_that_cannot_be_written_costs_the_cache_and_nothing_else(copied, tmp_path):
    (tmp_path / "a_file").write_text("in the way")
    (tmp_path / "tmp").mkdir()
    (line,) = python(
        CACHE,
        copied.parent,
        PYTHONPATH=str(copied.parent),
        XDG_CACHE_HOME=str(tmp_path / "a_file"),
        TMPDIR=str(tmp_path / "tmp"),
    )
    assert Path(line).parent == tmp_path / "tmp"
    assert Path(line).is_dir()


def test_kernels_are_kept_in_that_folder_and_loaded_by_another_clone(copied, tmp_path):
    code = (
        "from calibench.core.compilation.compiled import cache_folder\n"
        "from calibench.problems.planar import _closed_loop_kernels as k\n"
        "print(k._reach_and_link(1.0, 1.0, 2.0).hex())\n"
        "print(len(list(cache_folder().glob('_closed_loop_kernels-*/*_reach_and_link*.nbi'))))\n"
        "print(sum(k._reach_and_link.stats.cache_hits.values()))\n"
        "told = k._reach_and_link.targetoptions\n"
        "print(told.get('fastmath', False), told['error_model'])\n"
    )
    for home, hits in ((ROOT, "0"), (copied.parent, "1")):
        value, kept, hit, options = python(
            code, home, PYTHONPATH=str(home), XDG_CACHE_HOME=str(tmp_path), NUMBA_DISABLE_JIT="0"
        )
        assert float.fromhex(value) == pytest.approx(5**0.5 + 2)
        assert (kept, hit, options) == ("1", hits, "False numpy")


def test_listing_names_does_not_load_the_compiler():
    loaded = python("import sys, problems; problems.names(); print('numba' in sys.modules, 'scipy' in sys.modules)")
    assert loaded == ["False False"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["full12", "tracking_zero", "orthoglide6"])
def test_after_compile_a_problems_own_arrays_compile_nothing(name):
    code = (
        "from calibench import problems\n"
        f"p = problems.make({name!r}); p.compile()\n"
        "k = p._compiled.kernels\n"
        "count = lambda: [len(f.signatures) for f in (k.cost, k.batch, k.residuals, k.jacobian)]\n"
        "before = count()\n"
        "p(p.start), p.batch(p.start[None]), p.residuals(p.start), p.jacobian(p.start)\n"
        "print(before == count())\n"
    )
    assert python(code, NUMBA_DISABLE_JIT="0") == ["True"]


def test_a_part_of_kernels_is_called_by_kernels_alone():
    """It has no entrance for Python: a call from there is told, before and after it is compiled, and ends nothing."""
    code = """
import numpy as np
from calibench.problems.orthoglide import _kernels
from calibench import problems
for _ in range(2):
    try:
        _kernels._share(np.zeros(9), np.zeros((9, 3)), np.zeros((9, 3)), 0, 0, 0.5)
    except TypeError as error:
        print(error)
    problems.make("orthoglide6").compile()
"""
    told = "_share is a part of kernels: only they call it, compile it with njit() otherwise"
    assert python(code) == [told, told]


@pytest.mark.parametrize("left", [0.0, 0.5])
@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_a_kernel_whose_file_is_cut_off_is_compiled_anew_and_kept_again(tmp_path, monkeypatch, ending, left):
    monkeypatch.setattr(compiled_, "cache_folder", lambda: tmp_path / "cache")
    (tmp_path / "twice.py").write_text("def twice(x):\n    return 2 * x\n")

    def fresh():
        """Return the kernel as another process has it: with nothing but what is kept."""
        module = SourceFileLoader("twice", str(tmp_path / "twice.py"))
        return keep(numba.njit(module_of(module).twice))

    assert fresh()(3) == 6
    [file] = (tmp_path / "cache").rglob(f"*.{ending}")
    os.truncate(file, int(left * file.stat().st_size))
    for reads in (0, 1):
        kernel = fresh()
        assert kernel(4) == 8
        assert sum(kernel.stats.cache_hits.values()) == reads


def module_of(loader):
    module = types.ModuleType(loader.name)
    module.__file__ = loader.path
    loader.exec_module(module)
    return module
