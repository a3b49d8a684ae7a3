"""Options of one's own that are objects: typed by their fields, told by their fields, and asked for where they lack."""

import json

import numpy as np
import pytest

from calibench.bench.cli import main
from calibench.bench.report.one_run import again_command
from calibench.bench.statistics.names import problem_titles
from calibench.bench.statistics.tables import problem_of
from calibench.bench.store.columns import typed
from calibench.bench.store.runs import ResultStore
from tests.few import few

pytestmark = pytest.mark.usefixtures("one_process")

RIG = """
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

import numpy as np


class Loss(Enum):
    L1 = "absolute"
    L2 = "squared"


@dataclass(frozen=True)
class Noise:
    sigma: float = 0.25
    seed: int = 3


@dataclass(frozen=True)
class Rig:
    data: Path
    loss: Loss = Loss.L2
    noise: Noise = field(default_factory=Noise)

    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.5)

    def __call__(self, x):
        return float(x @ x) + self.noise.sigma


class Tuned:
    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.5)

    def __init__(self, loss: Callable[[float], float] = abs):
        self.loss = loss

    def __call__(self, x):
        return float(sum(self.loss(value) for value in x))


class Walker:
    def __init__(self, noise: Noise = Noise()):
        self.noise = noise

    def minimize(self, objective, rng):
        for _ in range(5):
            objective(objective.start)
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Return the file of the classes above, one for all tests: a process takes a name from one place."""
    path = tmp_path_factory.mktemp("options") / "options_rig.py"
    path.write_text(RIG)
    return path


@pytest.fixture
def rig(tmp_path, monkeypatch, file):
    """Stand in an empty folder; return the words that all commands share."""
    monkeypatch.chdir(tmp_path)
    return [f"problem={file}:Rig", f"optimizer={file}:Walker", "budget=5", "seeds=1", "study=s"]


def bench(*words):
    with pytest.raises(SystemExit) as ended:
        main(list(words))
    return ended.value.code or 0


def test_fields_of_an_option_are_swept_and_stand_in_columns_of_their_own(rig, capsys):
    swept = ["problem.data=d.csv", "problem.noise.sigma=0.5,1", "problem.loss=L1,L2", "opt.Walker.noise.seed=1,2"]
    assert bench("run", "-m", *rig, *swept) == 0
    runs = ResultStore("results/s").runs(options=True)
    assert len(runs) == 8
    assert {*runs["prob.noise.sigma"]} == {0.5, 1.0}
    assert {*runs["prob.loss"]} == {"L1", "L2"}
    assert {*runs["opt.noise.seed"]} == {1, 2}
    assert "prob.noise" not in runs
    assert (runs["best_value"] == 0.5 + runs["prob.noise.sigma"]).all()
    assert json.loads(runs["problem_options"].iloc[0])["noise"].keys() == {"class", "sigma", "seed"}
    titles = {*problem_titles(runs)}
    assert len(titles) == 4
    assert any("loss=L1" in title and "noise.sigma=0.5" in title for title in titles)
    assert not any("options_rig:" in title for title in titles)
    printed = capsys.readouterr().out
    assert "noise.sigma=0.5" in printed
    assert "noise.seed=2" in printed


@pytest.mark.slow
def test_a_part_and_the_whole_name_one_run(rig):
    assert bench("run", *rig, "problem.data=d", "problem.noise.sigma=0.5") == 0
    assert bench("run", *rig, "problem.data=d", "problem.noise={sigma: 0.5, seed: 3}") == 0
    assert bench("run", *rig, "problem.data=d", "problem.noise={sigma: 0.5}") == 0
    assert len(ResultStore("results/s").runs()) == 1


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "options_rig.py:Rig needs data (no default); add problem.data=..."),
        (["problem.data=d", "problem.noise.sgma=1"], "Rig.noise has no option 'sgma'; did you mean 'sigma'?"),
        (["problem.data=d", "problem.loss.x=1"], "no option 'loss.x', as loss is one value"),
        (
            ["problem.data=d", "problem.noise.sigma=1", "problem.noise={seed: 2}"],
            "problem.noise is given as a whole and in part",
        ),
    ],
)
def test_what_is_wrong_with_them_is_told_in_one_line(rig, capsys, words, told):
    assert bench("run", *rig, *words) == 2
    err = capsys.readouterr().err.strip()
    assert told in err
    assert "\n" not in err


def test_a_word_for_a_function_is_refused_before_it_runs_and_the_default_is_built_again(rig, file, capsys):
    own = [f"problem={file}:Tuned", *rig[1:]]
    assert bench("run", *own, "problem.loss=abs") == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "Tuned.loss=abs: a function, which can be handed over in Python alone" in told
    assert bench("run", *own) == 0
    row = ResultStore("results/s").runs().iloc[0]
    assert json.loads(row["problem_options"]) == {"loss": "builtins:abs"}
    assert problem_of(row)(np.ones(2)) == 2.0, "the function, and not the word that the row has for it"
    assert "loss" not in again_command(row)


CLOSED = """
import numpy as np


class Closed:
    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.5)
    splits_batches = True

    def __init__(self, scale: float = 2.0):
        self.value = lambda x: scale * float(x @ x)

    def __call__(self, x):
        return self.value(x)

    def batch(self, points):
        return np.array([self.value(x) for x in points])


def local(scale: float = 2.0):
    class Inner(Closed):
        pass

    return Inner(scale)
"""


@pytest.fixture(scope="module")
def closed(tmp_path_factory):
    path = tmp_path_factory.mktemp("closed") / "closed_over.py"
    path.write_text(CLOSED)
    return path


@pytest.mark.parametrize(
    "way", few(1, ["processes execution.n_jobs=2", "processes execution.inner=2", "serial time_limit=60"])
)
def test_what_cannot_be_pickled_runs_in_other_processes(closed, tmp_path, monkeypatch, way):
    monkeypatch.chdir(tmp_path)
    problems = f"problem={closed}:Closed,{closed}:local"
    words = [problems, "optimizer=de", "optimizer.population=8", "budget=40", "seeds=2"]
    assert bench("run", "-m", *words, *f"execution={way}".split()) == 0
    runs = ResultStore("results/adhoc").runs()
    assert (len(runs), {*runs["status"]}, {*runs["evaluations"]}) == (4, {"ok"}, {40})


def test_a_text_with_a_colon_and_a_dot_is_no_member_of_an_enumeration():
    assert [typed(text) for text in ("rig:Loss.L1", "a.rig:Rig._Loss.low")] == ["L1", "low"]
    assert [typed(text) for text in ("data:run.csv", "tcp:host.local", "C:run.csv", "a:b:Loss.L1")] == [
        "data:run.csv", "tcp:host.local", "C:run.csv", "a:b:Loss.L1",
    ]  # fmt: skip
