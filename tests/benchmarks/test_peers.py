"""Peers measured in one run: answers in JSON, and what fails stays in the table with its error."""

import os
import sys
from importlib.util import module_from_spec, spec_from_file_location
from itertools import cycle
from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest

from benchmarks.peers import environments
from benchmarks.peers.asking import Staying, Taken, ToolError, once, read
from benchmarks.peers.environments import Environment
from benchmarks.peers.measured import Table, measure
from benchmarks.peers.measured_page import page
from benchmarks.peers.table import _by_size
from benchmarks.peers.turns import Contestant, take_turns

_SCRIPT = """
import sys
sys.path.insert(0, {tools!r})
from answering import answer, timed
def fails(work): raise ValueError("no such thing")
def sums(work):
    print("a tool may print what it likes")
    return {{**timed(lambda: work["runs"]), "note": "summed"}}
answer({{"counting": {{"sums": sums, "fails": fails}}}})
"""


@pytest.fixture
def tool(tmp_path: Path) -> Environment:
    script = tmp_path / "some_peer.py"
    script.write_text(_SCRIPT.format(tools=str(environments.TOOLS)))
    return Environment("some", "some 1.0", Path(sys.executable), script)


def _request(line: str) -> dict[str, object]:
    return {"table": "counting", "line": line, "work": {"runs": 7}}


def test_a_tool_that_stays_answers_again_and_again(tool: Environment) -> None:
    process = Staying(tool)
    try:
        assert process.ask({"table": None}) == {"lines": {"counting": ["sums", "fails"]}}
        assert [process.take(_request("sums")).count for _ in range(2)] == [7, 7]
        with pytest.raises(ToolError, match="ValueError: no such thing"):
            process.take(_request("fails"))
        assert process.take(_request("sums")).note == "summed"
    finally:
        process.end()


def test_a_fresh_process_answers_once(tool: Environment) -> None:
    assert once(tool, _request("sums")).count == 7
    with pytest.raises(ToolError, match="no such thing"):
        once(tool, _request("fails"))


@pytest.mark.parametrize("line", ["", "Segmentation fault\n"])
def test_a_tool_that_ends_without_an_answer_is_an_error(line: str) -> None:
    with pytest.raises(ToolError, match="ended without an answer"):
        read(line)


def test_a_failed_install_is_a_line_with_the_installers_error(
    tmp_path: Path, tool: Environment, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    requirements = tmp_path / "absent.txt"
    requirements.write_text("nothing-of-this-name==1.0\n# what all are given\nnumpy==2.4.6\n")
    error = environments.install(Path(sys.executable), requirements)
    assert "No matching distribution found for nothing-of-this-name==1.0" in error
    absent = Environment("absent", environments.wanted(requirements), Path(sys.executable), tool.script, error)
    rows = measure(Table("counting", "counting", 2, True, {"runs": 7}), [tool, absent], 2, tmp_path)
    assert rows["line"].tolist() == ["sums", "fails", "absent"]
    assert rows["rounds"].tolist() == [2, 0, 0]
    text = page([rows])
    assert "nothing-of-this-name 1.0" in text
    assert "| absent | - |" in text
    assert "| absent | - | - | cannot be installed: " in text
    assert "No matching distribution found for nothing-of-this-name==1.0" in text
    assert "ValueError: no such thing" in text
    assert "not installed" not in text


def test_what_the_installer_says_loses_addresses_and_paths() -> None:
    said = environments._without_places("ERROR: no https://somewhere.org/simple/x, nor /opt/wheels/x.whl")
    assert said == "ERROR: no ..., nor ..."


def _taking(*seconds: float) -> Contestant:
    left = iter(seconds)
    return Contestant("1.0", lambda: Taken(cpu := next(left), 2 * cpu, 10))


def test_a_ratio_is_of_the_same_round() -> None:
    rows = take_turns("x", {"ours": _taking(1, 2, 4), "theirs": _taking(0.5, 1, 2)}, rounds=3, warm=False)
    assert rows["ratio"].tolist() == [1.0, 0.5]
    assert rows["cpu_ns"].tolist() == [2e8, 1e8]
    assert rows["wall_ns"].tolist() == [4e8, 2e8]


def test_a_slow_line_is_asked_once() -> None:
    rows = take_turns("x", {"ours": _taking(1, 1, 1), "slow": _taking(100)}, rounds=3, warm=False)
    assert rows["rounds"].tolist() == [3, 1]
    assert rows["ratio"].tolist() == [1.0, 100.0]


def test_where_a_peer_is_ahead_it_stands_there() -> None:
    rows = take_turns("x", {"ours": _taking(1, 1), "theirs": _taking(0.5, 0.5)}, rounds=2, warm=False)
    told = rows.assign(table="counting", load_before=1.0, load_after=1.0, date="2026-11-22", machine="one")
    assert "**Ahead of us here:** theirs." in page([told])
    behind = pd.concat([told[told["line"] == "ours"], told[told["line"] == "theirs"].assign(ratio_q3=1.5)])
    assert "Ahead of us" not in page([behind])
    assert "Ahead of us" not in page([told[told["line"] == "theirs"]]), "none of ours stands there"


def test_a_counter_that_cannot_be_seen_has_no_ratio_and_none_is_taken_to_it() -> None:
    rows = take_turns("x", {"ours": _taking(1, -1, 1), "less": _taking(-1, -2, 0.5)}, rounds=3, warm=False)
    assert rows["ratio"].tolist()[0] == 1.0
    assert rows["ratio"].isna().tolist() == [False, True]
    told = page([rows.assign(table="counting", load_before=1.0, load_after=1.0, date="2026-11-22", machine="one")])
    assert "| less | below what can be measured | - |" in told
    assert "Ahead of us" not in told
    none = take_turns("x", {"ours": _taking(-1), "theirs": _taking(1)}, rounds=1, warm=False)
    assert none["ratio"].isna().all()


def test_a_machine_that_is_disturbed_most_of_the_time_hides_no_counter(monkeypatch: pytest.MonkeyPatch) -> None:
    answering = _answering()
    clock, disturbed = [0.0], cycle([3.0, 5.0, 0.0, 0.0, 9.0, 8.0])  # the medians differ by 2.25

    def call(takes: float) -> None:
        clock[0] += takes + next(disturbed)

    for name in ("perf_counter", "process_time"):
        monkeypatch.setattr(answering, name, lambda: clock[0])
    taken = answering.cost(lambda x: call(1.0), lambda x: call(1.25), [0], each=5)
    assert (taken["cpu_s"], taken["wall_s"], taken["count"]) == (0.25, 0.25, 5)
    assert taken["note"] == "the call alone 2e+08 ns"


def test_a_search_ends_at_the_level_of_the_noise_or_at_its_last_evaluation() -> None:
    answering = _answering()
    taken = answering.reaching(lambda level, start, seed: level(level.problem.truth if seed % 2 else start), most=3)
    assert (taken["count"], taken["note"]) == (5, "5 of 5 machines, 2 evaluations in the median")
    with pytest.raises(answering.Missed, match="on none of 5 machines within 3 evaluations"):
        answering.reaching(lambda level, start, seed: level.batch(start[None]), most=3)


def _answering() -> ModuleType:
    spec = spec_from_file_location("answering", environments.TOOLS / "answering.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
@pytest.mark.parametrize("line", ["ours, the fit", "ours, `bench calibrate`"])
def test_our_arm_is_calibrated_to_rounding(tmp_path: Path, line: str) -> None:
    taken = once(environments.ours(), {"table": "arm", "line": line, "work": {"folder": str(tmp_path)}})
    assert taken.count == 1
    left = float(taken.note.split()[-2])
    assert 0 < left < 1e-9, taken.note


def test_every_peer_has_a_script_and_pins_what_it_wants() -> None:
    for name in environments.peers():
        assert (environments.TOOLS / f"{name}_peer.py").exists()
        assert environments.wanted(environments.TOOLS / f"{name}.txt"), f"{name}: no package of its own"
        lines = (environments.TOOLS / f"{name}.txt").read_text().splitlines()
        assert all("==" in line for line in lines if not line.startswith("#")), name


def test_cases_are_counted_once_and_stay_in_their_column_where_a_method_lacks_some() -> None:
    rows = [("ours", case, size, 0.5) for case, size in (("a", 0.5), ("b", 0.5), ("c", 2.0))]
    rows += [("other", "a", 0.5, 0.25), ("third", "c", 2.0, 0.75)]
    told = _by_size(pd.DataFrame(rows, columns=["method", "case", "size", "removed"]), ["ours", "other", "third"])
    head, _, ours, other, third = (line.strip("|").split("|") for line in told.splitlines())
    assert [cell.strip() for cell in head[1:3]] == ["0.4-0.6 sigma (n=2)", "1.5-2.5 sigma (n=1)"]
    assert [line[2].split()[0] for line in (ours, other, third)] == ["0.50", "-", "0.75"]
    assert [len(line) for line in (ours, other, third)] == [4, 4, 4]
