"""What several modules of these tests ask for."""

import sys
from contextlib import contextmanager

import pytest

from calibench import optimizers, problems
from calibench.bench.cli import main
from calibench.bench.execution import request
from calibench.bench.report.shared import drawing as drawn
from calibench.bench.sweep import carry_out, costs
from calibench.core import user_file


@pytest.fixture(scope="session", autouse=True)
def searches_tell_nothing_meanwhile():
    """Let no line that a search goes on stand among what a test reads: on a slow machine some take 5 s."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("calibench.bench.discovery.batch._SOON", 3600.0)
        yield


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    """Return a folder of its own, the working one, with registries and loaded files as in a new process."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(user_file, "LOADED", {})
    for registry in (problems.registry, optimizers.registry):
        monkeypatch.setattr(registry, "_places", {})
        monkeypatch.setattr(registry, "_by_path", {})
    return tmp_path


@pytest.fixture
def run_bench(tmp_path, monkeypatch, capsys):
    """Return a call of `bench` in a folder of its own: words, or a list of them -> exit code, output, errors."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])

    def call(command):
        with pytest.raises(SystemExit) as ended:
            main(command.split() if isinstance(command, str) else [str(word) for word in command])
        out = capsys.readouterr()
        return ended.value.code, out.out, out.err

    return call


@pytest.fixture(scope="module")
def one_process():
    """Let runs and drawings be made in this process, as where a system cannot fork.

    A process that has all tests in it takes longer to fork than most runs of them: for modules that test something else
    than processes.
    """
    with pytest.MonkeyPatch.context() as patch:
        for module in (carry_out, costs, drawn, request):
            patch.setattr(module, "CAN_FORK", False)
        yield


@contextmanager
def empty_drawings():
    """Let reports make their figures and write the numbers, and empty drawings: writing one takes half a second."""

    def save(name, drawing, folder):
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / f"{name}.{ending}" for ending in ("svg", "png", "csv")]
        paths[0].write_text('<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1 1"></svg>')
        paths[1].write_bytes(b"")
        drawing[1].to_csv(paths[2], index=False)
        return paths

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drawn, "save", save)
        yield


@pytest.fixture(scope="module")
def undrawn():
    """Let reports write empty drawings: for modules that ask what a page says."""
    with empty_drawings():
        yield
