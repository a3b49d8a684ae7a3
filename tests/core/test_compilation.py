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


@pytest.fixture
def copied(tmp_path):
    """Return a folder with a copy of the three packages whose sources name the cache, as an installation has them."""
    home = tmp_path / "src" / "calibench"
    for package in ("core", "calibration", "problems", "optimizers"):
        shutil.copytree(ROOT / package, home / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "calibench" / "__init__.py", home / "__init__.py")
    return home


def cache_folder(source, root):
    (line,) = python(CACHE, source.parent, PYTHONPATH=str(source.parent), XDG_CACHE_HOME=str(root))
    return Path(line)


def test_the_cache_folder_is_named_by_a_digest_of_the_sources(copied, tmp_path):
    folder = cache_folder(copied, tmp_path / "cache")
    assert folder.parent == tmp_path / "cache" / "calibench"
    assert re.fullmatch(r"[0-9a-f]{16}", folder.name)
    assert folder.is_dir()
    assert list(folder.iterdir()) == []  # the probe of its being writable is gone
    assert cache_folder(copied, tmp_path / "cache") == folder
    assert cache_folder(copied, tmp_path / "elsewhere").name == folder.name


@pytest.mark.parametrize(
    "edited",
    few(1, ["problems/planar/_closed_loop_kernels.py", "problems/base.py", "core/compilation/compiled.py"]),
)
def test_an_edit_of_any_source_gives_another_cache(copied, tmp_path, edited):
    before = cache_folder(copied, tmp_path)
    with (copied / edited).open("a") as file:
        file.write("# another line\n")
    assert cache_folder(copied, tmp_path) != before


def test_a_new_source_gives_another_cache_and_other_files_do_not(copied, tmp_path):
    before = cache_folder(copied, tmp_path)
    (copied / "problems" / "data" / "notes.txt").write_text("no source")
    (copied / "elsewhere").mkdir()
    (copied / "elsewhere" / "mine.py").write_text("x = 1\n")
    assert cache_folder(copied, tmp_path) == before
    (copied / "optimizers" / "new_one.py").write_text("x = 1\n")
    assert cache_folder(copied, tmp_path) != before


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


def test_numba_is_told_that_folder_and_keeps_what_it_compiles_there(tmp_path):
    code = (
        "import numba, calibench.core.compilation.compiled as c\n"
        "from calibench.problems.planar import _closed_loop_kernels as k\n"
        "print(numba.config.CACHE_DIR == str(c.cache_folder()))\n"
        "print(k._reach_and_link(1.0, 1.0, 2.0).hex())\n"
        "print(len(list(c.cache_folder().rglob('*_reach_and_link*.nbi'))))\n"
        "told = k._reach_and_link.targetoptions\n"
        "print(told.get('fastmath', False), told['error_model'])\n"
    )  # fmt: skip
    told, value, kept, options = python(code, XDG_CACHE_HOME=str(tmp_path), NUMBA_DISABLE_JIT="0")
    assert told == "True"
    assert float.fromhex(value) == pytest.approx(5**0.5 + 2)
    assert kept == "1"
    assert options == "False numpy"


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


def test_an_edit_or_a_move_of_a_source_deep_in_a_room_gives_another_cache(copied, tmp_path):
    deep = copied / "problems" / "planar" / "kernels" / "_deep.py"
    deep.parent.mkdir(parents=True)
    deep.write_text("x = 1\n")
    before = cache_folder(copied, tmp_path)
    deep.write_text("x = 2\n")
    edited = cache_folder(copied, tmp_path)
    deep.rename(deep.parent.parent / "_deep.py")
    assert len({before, edited, cache_folder(copied, tmp_path)}) == 3


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
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
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
