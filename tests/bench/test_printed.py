"""What the runs of a sweep print: beside the results, run by run, and not between the lines of progress."""

from __future__ import annotations

from pathlib import Path

import pytest

from calibench import optimizers, problems
from calibench.bench.cli import main
from calibench.bench.gate.processes import CAN_FORK
from calibench.bench.store.runs import ResultStore
from calibench.bench.workers import processes
from calibench.core import user_file

LOUD = """
import ctypes, os, sys
from dataclasses import dataclass
import numpy as np

class Bowl:
    lower, upper, start = np.full(3, -1.0), np.full(3, 1.0), np.zeros(3)

    def __call__(self, x):
        return float(np.sum((x - 0.2) ** 2))

@dataclass(frozen=True)
class Loud:
    how: str = "print"

    def minimize(self, objective, rng):
        for step in range(20):
            value = objective(rng.uniform(-1, 1, 3))
            if self.how == "print":
                print(f"step {step}: {value:.3f}")
        if self.how == "print":
            ctypes.CDLL(None).printf(b"a word from C\\n")
            ctypes.CDLL(None).fflush(None)
            os.system("echo a word from a shell")
            print("an error", file=sys.stderr)
        if self.how == "die" and os.path.exists("alive"):
            os.remove("alive")
            print("last words", flush=True)
            os.kill(os.getpid(), 9)
        if self.how == "close":
            print("last words")
            sys.stdout.close()
"""
RUN = ["run", "-m", "problem=./loud.py:Bowl", "optimizer=./loud.py:Loud", "budget=50"]
pytestmark = pytest.mark.skipif(not CAN_FORK, reason="runs are made in the process of the sweep itself")


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(user_file, "LOADED", {})
    for registry in (problems.registry, optimizers.registry):  # as in a new process
        monkeypatch.setattr(registry, "_places", {})
        monkeypatch.setattr(registry, "_by_path", {})
    Path("loud.py").write_text(LOUD)


def _bench(*words):
    with pytest.raises(SystemExit) as ended:
        main(list(words))
    return ended.value.code


def _texts():
    return [path.read_text() for path in sorted(processes.printed_files(Path("results/adhoc")))]


def test_a_sweep_keeps_what_its_runs_print_beside_the_rows_and_says_where_once(capfd):
    assert _bench(*RUN, "seeds=3") == 0
    said = capfd.readouterr()
    assert "step" not in said.out + said.err
    assert "from C" not in said.out
    assert said.err.count("an error") == 3
    [text] = _texts()
    [path] = processes.printed_files(Path("results/adhoc"))
    assert said.out.count(f"what runs printed stands in {path}") == 1
    runs = ResultStore("results/adhoc").runs()
    parts = text.split("-- printed by run ")
    assert len(parts) == 4
    for row, before, behind in zip(runs.sort_values("repetition").to_dict("records"), parts, parts[1:], strict=False):
        assert before.count("step ") == 20
        assert before.index("step 19") < before.index("a word from C") < before.index("a word from a shell")
        signed = f"{row['run_id']}, loud.py:Loud on loud.py:Bowl, repetition {row['repetition']}"
        assert behind.partition("\n")[0] == signed


@pytest.mark.slow
def test_runs_in_a_process_of_their_own_and_of_two_workers_print_there_too(capfd):
    assert _bench(*RUN, "seeds=4", "time_limit=60", "execution=processes", "execution.n_jobs=2") == 0
    assert "step" not in capfd.readouterr().out
    assert sum(text.count("step 19") for text in _texts()) == 4
    assert sum(text.count("-- printed by run ") for text in _texts()) == 4


def test_a_single_run_prints_on_the_terminal_and_a_quiet_sweep_leaves_no_file(capfd):
    assert _bench(*RUN, "seeds=1") == 0
    assert "step 19" in capfd.readouterr().out
    assert _bench(*RUN, "optimizer.how=nothing", "seeds=3") == 0
    assert "printed" not in capfd.readouterr().out
    assert not Path("results/adhoc/printed").exists()


def test_a_run_that_closes_its_output_costs_no_row():
    _bench(*RUN, "optimizer.how=close", "seeds=3")
    runs = ResultStore("results/adhoc").runs()
    assert runs["evaluations"].tolist() == [20] * 3


def test_what_a_killed_run_printed_is_not_signed_by_the_next():
    Path("alive").touch()
    _bench(*RUN, "optimizer.how=die", "seeds=3")
    [text] = _texts()
    assert text == "last words\n\n-- printed by a run whose process ended\n"
    assert len(ResultStore("results/adhoc").runs()) == 3


def test_what_a_problem_prints_as_its_cost_is_measured_is_not_on_the_terminal(capfd):
    says = "print('a value', flush=True)\n        ctypes.CDLL(None).puts(b'of C')\n        return float(np.sum("
    Path("loud.py").write_text(
        LOUD.replace("return float(np.sum(", says, 1).replace('how: str = "print"', 'how: str = ""')
    )
    assert _bench(*RUN, "seeds=2") == 0
    said = capfd.readouterr()
    assert "a value" not in said.out + said.err
    assert "of C" not in said.out + said.err
    assert sum(text.count("a value\n") for text in _texts()) == 2 * 20
    print("the terminal is there again")
    assert capfd.readouterr().out == "the terminal is there again\n"
