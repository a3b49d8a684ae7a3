"""What several modules of these tests ask for."""

import sys

import pytest

from calibench.bench.cli import main


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
