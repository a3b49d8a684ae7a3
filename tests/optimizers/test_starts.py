"""Laws of starting points over the whole registry: who uses the start says so, and all begin again at the same points.

A book in a file, as some methods run in another process: a tag and a point for each evaluation and each restart.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from calibench import bench, optimizers
from calibench.bench.execution.request import Start, repetitions_of
from calibench.bench.gate.evaluator import Evaluator
from calibench.optimizers.base import Optimizer, TimeUp, Traits
from tests.few import one_of_each

NAMES = optimizers.names()
RESTARTED = [n for n in NAMES if "restarts" in optimizers.registry.options(n)]
ENTRY = [("tag", "S1"), ("x", "<f8", (2,))]


class Bowl:
    """A round bowl in two variables, as residuals; each evaluation is a line of the book.

    Round, as COBYLA creeps along a narrow one: 17,000 evaluations and more in one descent, by its last digits.
    """

    lower, upper, start = np.array([-2.0, -1.0]), np.array([2.5, 3.0]), np.array([-1.2, 1.0])
    options: Mapping[str, float] = {}  # the book's number differs from process to process, and would change the seeds

    def __init__(self, book: Path) -> None:
        book.unlink(missing_ok=True)
        self._book = os.open(book, os.O_WRONLY | os.O_APPEND | os.O_CREAT)

    def write(self, tag: bytes, x: np.ndarray) -> None:
        os.write(self._book, tag + np.ascontiguousarray(x, dtype=float).tobytes())

    def residuals(self, x: np.ndarray) -> np.ndarray:
        self.write(b"e", x)
        return np.array([x[0] + x[1] - 0.7, x[0] - x[1] - 0.1])

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        return np.array([[1.0, 1.0], [1.0, -1.0]])

    def __call__(self, x: np.ndarray) -> float:
        r = self.residuals(x)
        return float(r @ r)

    def close(self) -> None:
        os.close(self._book)


def entries(book: Path) -> np.ndarray:
    return np.frombuffer(book.read_bytes(), dtype=ENTRY)


def descents(book: Path, name: str, repetition: int, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """Return where the first two descents after the start begin: the point evaluated next after each restart.

    NEWUOA_BOUND loops in C in some runs, and not in others with the same numbers: who has not begun again twice is
    tried again.
    """
    options = {"initial_tr_radius": 1e-3} if name == "scipy_cobyqa" else {}  # it moves what is nearer to a bound
    method = optimizers.make(name, restarts=True, **options)
    limit = 5.0 if method.traits.may_hang else None
    for _ in range(5):
        found = _descents(book, method, repetition, limit, monkeypatch)
        if len(found) == 2:
            break
    return found


def _descents(
    book: Path, method: Optimizer, repetition: int, limit: float | None, monkeypatch: pytest.MonkeyPatch
) -> np.ndarray:
    problem, restart = Bowl(book), Evaluator.restart

    def noted(gate: Evaluator) -> np.ndarray:
        problem.write(b"r", np.zeros(2))
        if gate.restarts == 2:
            raise TimeUp("two descents are enough")
        return restart(gate)

    monkeypatch.setattr(Evaluator, "restart", noted)
    try:
        bench.execute(problem, method, budget=20_000, seed=repetition, time_limit=limit)
    finally:
        problem.close()
        monkeypatch.undo()
    book_entries = entries(book)
    after = np.flatnonzero(book_entries["tag"] == b"r") + 1
    return np.asarray(book_entries["x"][after[after < len(book_entries)]][:2])


@pytest.mark.parametrize("name", one_of_each(RESTARTED))
def test_the_kth_descent_begins_at_the_same_point_whatever_the_method(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    theirs = descents(tmp_path / "book", name, 3, monkeypatch)
    ours = descents(tmp_path / "book", "lm", 3, monkeypatch)
    assert len(theirs) == len(ours) == 2
    assert np.allclose(theirs, ours, rtol=0, atol=1e-14)  # some compute it out of the unit box
    assert len(np.unique(ours, axis=0)) == 2
    assert ((Bowl.lower <= ours) & (ours <= Bowl.upper)).all()


def test_another_repetition_begins_again_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = (descents(tmp_path / "book", "lm", repetition, monkeypatch) for repetition in (0, 1))
    assert not np.isclose(one, other).any()


def test_restarts_in_an_open_box_are_refused_in_a_line(tmp_path: Path) -> None:
    problem = Bowl(tmp_path / "book")
    problem.upper = np.array([np.inf, 3.0])
    with pytest.raises(ValueError, match=r"upper\[0\]=inf"):
        bench.execute(problem, optimizers.make("lm", restarts=True), budget=100)
    problem.close()


def test_a_restart_of_an_open_box_stays_at_the_start_where_it_is_open(tmp_path: Path) -> None:
    problem = Bowl(tmp_path / "book")
    problem.upper = np.array([np.inf, 3.0])
    again = Evaluator(problem, 10).restart()
    problem.close()
    assert again[0] == -1.2
    assert again[1] != 1.0


def test_the_list_says_who_uses_its_start(capsys: pytest.CaptureFixture[str]) -> None:
    from calibench.bench.cli import main

    for words in (["list", "optimizers"], ["list", "optimizers", "--json"]):
        with pytest.raises(SystemExit):
            main(words)
    text, _, rows = capsys.readouterr().out.partition("\n[\n")
    said = {row["name"]: row["traits"]["uses_start"] for row in json.loads("[" + rows)}
    assert said == {name: optimizers.make(name).traits.uses_start for name in said}
    heads = [line for line in text.splitlines() if not line.startswith(" ")]
    assert {line.split()[0] for line in heads if "uses_start" in line} == {name for name in said if said[name]}


class Fixed:
    """Proposes the same points whatever the start."""

    def __init__(self, traits: Traits) -> None:
        self.traits = traits


@pytest.mark.parametrize(
    ("traits", "start", "runs"),
    [
        (Traits(uses_start=False), "random", 1),
        (Traits(uses_start=False), "nominal", 1),
        (Traits(uses_start=False, stochastic=True), "random", 5),
        (Traits(), "random", 5),
        (Traits(), "nominal", 1),
    ],
)
def test_what_ignores_its_start_and_draws_nothing_runs_once(traits: Traits, start: Start, runs: int) -> None:
    assert len(repetitions_of(Fixed(traits), start, range(5))) == runs
