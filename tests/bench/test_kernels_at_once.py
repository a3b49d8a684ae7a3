"""What was never compiled is compiled in several processes, once, before the runs begin."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import pytest

from calibench import optimizers, problems
from calibench.bench.execution import kernels
from calibench.bench.execution.run import Spec, compile_parts
from calibench.bench.gate import processes
from calibench.core.compilation import compiled, shipped
from calibench.core.sources import module_digest

SPECS = [Spec(name, {}, method, {}, 10, 0) for name in ("sensor_zero", "orthoglide6") for method in ("de", "lm")]


@pytest.fixture
def book(tmp_path, monkeypatch):
    """The lines that each compilation writes, of a machine that has compiled nothing yet."""
    book = tmp_path / "book"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(processes.os, "cpu_count", lambda: 2)
    compiled.cache_folder.cache_clear()

    def make(name, **options):
        def compile(part=""):
            with book.open("a") as file:
                file.write(f"{name}{part} {os.getpid()}\n")

        traits = SimpleNamespace(uses_residuals=name == "lm", uses_gradient=name == "lm")
        return SimpleNamespace(compile=compile, compile_values=lambda: compile("'s values"), traits=traits)

    monkeypatch.setattr(problems.registry, "make", make)
    monkeypatch.setattr(optimizers.registry, "make", make)
    yield lambda: [line.rsplit(maxsplit=1) for line in book.read_text().splitlines()]
    compiled.cache_folder.cache_clear()


def test_what_is_new_is_compiled_in_other_processes_and_then_loaded_here(book):
    kernels.load_kernels(SPECS)
    lines = book()
    assert sorted(name for name, _ in lines) == sorted(["sensor_zero", "orthoglide6", "de", "lm"] * 2)
    assert {name for name, pid in lines if pid == str(os.getpid())} == {"sensor_zero", "orthoglide6", "de", "lm"}
    assert len({pid for _, pid in lines}) == 3


def test_what_was_compiled_before_is_loaded_and_no_process_begins(book):
    kernels.load_kernels(SPECS)
    before = len(book())
    kernels.load_kernels(SPECS)
    assert {pid for _, pid in book()[before:]} == {str(os.getpid())}


def test_what_came_with_the_installation_is_loaded_and_no_process_begins(book, monkeypatch):
    factories = [problems.registry.factory("sensor_zero"), optimizers.registry.factory("de")]
    came = frozenset(module_digest(str(one.__module__)) for one in factories)
    monkeypatch.setattr(shipped, "modules", lambda: came)
    kernels.load_kernels(SPECS[:1])
    assert {pid for _, pid in book()} == {str(os.getpid())}


def test_residuals_are_compiled_in_no_process_before_a_method_asks_for_them(book):
    kernels.load_kernels(SPECS[::2])
    names = {name for name, _ in book()}
    assert names == {"sensor_zero's values", "orthoglide6's values", "de"}
    kernels.load_kernels(SPECS)
    assert {name for name, pid in book() if pid != str(os.getpid())} == names | {"sensor_zero", "orthoglide6", "lm"}


def test_compiling_is_told_where_a_kernel_is_compiled_and_not_where_it_is_loaded():
    """In a process of its own, with a cache that is empty at first, as numba keeps what it loaded."""
    code = (
        "from calibench.core.compilation.compiled import heard, njit\n"
        "from one import kernel\n"
        "told = []\n"
        "with heard(lambda: told.append(1)):\n"
        "    njit()(kernel)(2.0)\n"
        "print(len(told))\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "one.py").write_text("def kernel(x):\n    return x + 1.0\n")
        there = os.environ | {"XDG_CACHE_HOME": folder, "PYTHONPATH": str(Path(__file__).parents[2])}
        told = [
            subprocess.run([sys.executable, "-c", code], env=there, check=True, capture_output=True, text=True,
                           cwd=folder).stdout.strip()
            for _ in range(2)
        ]  # fmt: skip
    assert told == ["1", "0"]


def test_where_it_may_not_fork_it_compiles_here(book):
    kernels.load_kernels(SPECS, fork=False)
    assert {pid for _, pid in book()} == {str(os.getpid())}


class Traits:
    stochastic, uses_residuals, uses_start, minimum_dimension, maximum_dimension = True, False, True, 1, None


@pytest.mark.parametrize(
    ("more", "called"),
    [({}, "compile"), ({"uses_gradient": True}, "compile"), ({"uses_gradient": False}, "compile_values")],
)
def test_derivatives_are_compiled_unless_a_method_says_that_it_asks_for_none(more, called):
    calls = []
    problem = SimpleNamespace(
        compile=lambda: calls.append("compile"), compile_values=lambda: calls.append("compile_values")
    )
    method = SimpleNamespace(traits=type("Own", (Traits,), more)())
    assert compile_parts(problem, method) is None
    assert calls == [called]


@pytest.mark.parametrize(("options", "times"), [({}, 0), ({"early_abandon": True}, 1)])
def test_what_gives_up_sums_early_is_compiled_for_methods_that_ask_for_it_alone(options, times, monkeypatch):
    problem, calls = problems.make("sensor_zero"), []
    monkeypatch.setattr(type(problem), "batch_below", lambda _, points, limits: calls.append(len(points)))
    assert compile_parts(problem, optimizers.make("de", **options)) is None
    problem.compile()
    assert calls == [1] * times
