"""A search that was killed in its middle: the next one reads the dear steps that were done, and says the same."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from calibench.bench.cli import main
from calibench.bench.measured import write_measured
from calibench.bench.measured.sources import sources
from calibench.discrepancy.fitting import journal
from calibench.discrepancy.fitting.journal import Journal, keeping_steps, kept_step

_WRITTEN = 16  # steps, after which a search is killed
_KILLED = f"""
import os, signal, sys
from calibench.bench.cli import main
from calibench.discrepancy.fitting import journal

journal._LONG = journal._DEAR = 0.0
write, written = journal.Journal.write, []

def killing(self, *record):
    write(self, *record)
    written.append(record)
    if len(written) == {_WRITTEN}:
        print(self.path, flush=True)
        os.kill(os.getpid(), signal.SIGKILL)

journal.Journal.write = killing
main(sys.argv[1:])
"""


@pytest.fixture
def words(tmp_path: Path) -> list[str]:
    data = tmp_path / f"killed_{os.getpid()}.csv"  # whose case no other process searches
    write_measured(sources("demo_flexure", "mount")[0].read({}), data)
    return ["discover", "machine=mount", f"data={data}", "pages=none", "--json"]


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[Journal]:
    """Return the journals that are begun; every step is dear, and every search long."""
    journals: list[Journal] = []
    begin = Journal.__init__

    def noted(self: Journal, path: Path) -> None:
        begin(self, path)
        journals.append(self)

    monkeypatch.setattr(Journal, "__init__", noted)
    for limit in ("_LONG", "_DEAR"):
        monkeypatch.setattr(journal, limit, 0.0)
    return journals


def said(words: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    with pytest.raises(SystemExit):
        main(words)
    line: dict[str, Any] = json.loads(capsys.readouterr().out)
    del line["seconds"]
    return line


def test_a_killed_search_replays_its_steps_and_reports_the_same(
    words: list[str], begun: list[Journal], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = [*words, f"results={tmp_path}/killed"]
    killed = subprocess.run([sys.executable, "-c", _KILLED, *asked], capture_output=True, text=True)
    assert killed.returncode == -signal.SIGKILL
    path = Path(killed.stdout.strip())
    whole = path.read_bytes()
    path.write_bytes(whole + whole[:100])  # a record that the kill cut off
    again = said(asked, capsys)
    undisturbed = said([*words, f"results={tmp_path}/undisturbed"], capsys)
    assert [one.replayed > _WRITTEN / 4 for one in begun] == [True, False]
    assert again == undisturbed
    assert not path.exists()


def test_a_short_search_writes_nothing_and_an_error_leaves_nothing(tmp_path: Path, begun: list[Journal]) -> None:
    def failing() -> None:
        with keeping_steps(tmp_path / "failed"):
            assert kept_step(lambda: 1.5, ("number",)) == 1.5
            assert (tmp_path / "failed").exists()
            raise ValueError

    with pytest.raises(ValueError, match=r"^$"):
        failing()
    with pytest.MonkeyPatch.context() as patch, keeping_steps(tmp_path / "short"):
        patch.setattr(journal, "_LONG", 5.0)
        kept_step(lambda: 1.5, ("number",))
        assert not (tmp_path / "short").exists()
    assert not list(tmp_path.iterdir())


def test_a_step_of_other_numbers_is_made_anew(tmp_path: Path, begun: list[Journal]) -> None:
    def interrupted(number: float) -> float:
        with keeping_steps(tmp_path / "steps"):
            kept_step(lambda: number, ("number", number))
            raise KeyboardInterrupt

    for number in (1.0, 1.0, 2.0):
        with pytest.raises(KeyboardInterrupt):
            interrupted(number)
    assert [one.replayed for one in begun] == [0, 1, 0]
    with keeping_steps(tmp_path / "steps", anew=True) as beginning:
        assert kept_step(lambda: 3.0, ("number", 1.0)) == 3.0
    assert beginning.replayed == 0
