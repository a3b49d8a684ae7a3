"""``bench show``: the story of one run, and the command that does it again."""

import json
import shlex
import sys
from itertools import pairwise

import numpy as np
import pytest

from calibench.bench.report.one_run import again_command, sparkline
from calibench.bench.statistics.tables import problem_of
from calibench.bench.store.runs import ResultStore
from tests.few import few

pytestmark = pytest.mark.usefixtures("one_process")

USER = """
import numpy as np

class Bowl:
    def __init__(self, depth: float = 0.0, name_of: str = "plain"):
        self.depth, self.name_of = depth, name_of
        self.lower, self.upper, self.start = -np.ones(2), np.ones(2), np.full(2, 0.5)
    def __call__(self, x):
        return float(x @ x) + self.depth

class Capped(Bowl):
    truth = np.zeros(2)

    def __init__(self, cap: float | None = 5.0):
        super().__init__()
        self.cap = cap
        self.minimum = 0.0 if cap is None else -cap

class Broken(Bowl):
    def __call__(self, x):
        raise RuntimeError("the encoder fell off")
"""


@pytest.fixture
def run_bench(run_bench, tmp_path):
    (tmp_path / "shown_own.py").write_text(USER)
    yield run_bench
    sys.modules.pop("shown_own", None)


def rows(study="adhoc"):
    return ResultStore(f"results/{study}").runs()


@pytest.mark.parametrize(
    "command",
    few(
        3,
        [
            "problem=sensor_zero problem.n=3 optimizer=lm budget=60 seeds=1",
            "problem=full12 problem.gauge=ya2 optimizer=de optimizer.population=20 budget=60 seeds=2:3 start=random",
            "problem=sensor_zero optimizer=nlopt_LN_BOBYQA budget=80 seeds=1 target=1e-3",
            "problem=shown_own:Bowl problem.depth=0.5 problem.name_of='1e5' optimizer=pso budget=60 seeds=1",
            "problem=shown_own:Bowl problem.name_of='C:\\data\\,\\\\' optimizer=pso budget=60 seeds=1",
            pytest.param(
                "problem=sensor_zero problem.instance=3 optimizer=lm budget=60 seeds=1", marks=pytest.mark.slow
            ),
            "problem=delta9 problem.instance=2 optimizer=lm budget=60 seeds=1",
            "problem=orthoglide6 problem.data=exp1 problem.free=rho optimizer=lm budget=60 seeds=1",
            "problem=sensor_zero optimizer=pygmo_de optimizer.population=null budget=400 seeds=1",
        ],
    ),
)
def test_the_command_it_prints_does_the_same_run_again(run_bench, command):
    assert run_bench(["run", *command.split()])[0] == 0
    [run_id] = rows()["run_id"]
    code, out, _ = run_bench(f"show {run_id}")
    assert code == 0
    [told] = [line.removeprefix("again").strip() for line in out.splitlines() if line.startswith("again")]
    words = shlex.split(told)
    assert words[:2] == ["bench", "run"]
    assert run_bench(words[1:])[0] == 0
    [again], [first] = rows("again").to_dict("records"), rows().to_dict("records")
    assert again["run_id"] == first["run_id"]
    assert again["best_value"] == first["best_value"]


def test_the_problem_of_a_row_is_made_with_none_where_none_was_given(run_bench):
    assert run_bench("run problem=shown_own:Capped problem.cap=null optimizer=pso budget=60 seeds=1")[0] == 0
    [row] = rows().to_dict("records")
    assert problem_of(row).minimum == 0


def test_a_story_has_curve_targets_answer_and_its_standard_errors(run_bench):
    run_bench("run problem=sensor_zero optimizer=lm budget=200 seeds=1 start=random")
    row = rows().iloc[0]
    out = run_bench(f"show {row['run_id'][:6]}")[1]
    assert "targets    12 of 12 reached" in out
    assert f"at evaluation {row['hits'][0]} ({row['hits_charged'][0]} charged)" in out
    assert sum("±" in line for line in out.splitlines()) == 4
    assert "all 3 parameters can be seen" in out
    assert any(set(line) & set("▁▂▃▄▅▆▇█") for line in out.splitlines())
    run_bench("run problem=full12 optimizer=lm budget=200 seeds=1 study=gauge")
    told = run_bench(f"show results/gauge {rows('gauge')['run_id'].iloc[0]}")[1]
    assert "not determined" in told


def test_a_failed_run_tells_its_error_and_its_last_frames(run_bench):
    assert run_bench("run problem=shown_own:Broken optimizer=de budget=20 seeds=1")[0] == 1
    out = run_bench(f"show {rows()['run_id'].iloc[0]}")[1]
    assert "failed RuntimeError the encoder fell off" in out
    assert "shown_own.py" in out
    assert "no finite value was found" in out


def test_restarts_are_told_with_the_curve(run_bench):
    run_bench("run problem=sensor_zero optimizer=lm optimizer.restarts=true budget=200 seeds=1 start=random")
    row = rows().iloc[0]
    assert row["restarts"] > 0
    out = run_bench(f"show {row['run_id']}")[1]
    assert f"restarts   {row['restarts']}" in out
    assert "best value  restarts" in out


def test_digits_that_fit_several_runs_list_them_and_a_folder_may_be_named(run_bench):
    run_bench("run problem=sensor_zero optimizer=de budget=20 seeds=20")
    ids = sorted(rows()["run_id"])
    first = next(a[0] for a, b in pairwise(ids) if a[0] == b[0])
    fitting = [name for name in ids if name.startswith(first)]
    code, out, err = run_bench(f"show {first}")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"{len(fitting)} runs begin so" in err
    assert "(sensor_zero, de, " in err
    listed = err.partition("begin so: ")[2].split(" (")[0]
    assert fitting[0].startswith(listed)
    assert len(listed) > 1
    assert run_bench(f"show {listed} results/adhoc")[0] == 0
    assert run_bench(f"show {listed} results=results")[0] == 0
    assert run_bench(f"show {listed} {listed}")[0] == 2


def test_what_no_command_can_say_has_none():
    row = {"start": "given", "problem": "sensor_zero", "problem_options": "{}", "optimizer": "de"}
    assert again_command(row | {"optimizer_options": "{}"}) is None
    published = row | {"start": "random", "optimizer_options": json.dumps({"published": "coco"})}
    assert again_command(published) is None
    object_of_python = row | {"start": "random", "optimizer_options": "{}", "problem": "__main__:Mine"}
    assert again_command(object_of_python) is None


def test_a_curve_comes_down_from_left_to_right():
    charged = np.arange(1.0, 1001.0)
    line = sparkline(charged, 1e6 / charged**3, None)
    heights = ["▁▂▃▄▅▆▇█".index(block) for block in line]
    assert (heights[0], heights[-1]) == (7, 0)
    assert heights == sorted(heights, reverse=True)
    below = sparkline(charged, -np.log(charged), None)  # values below zero, no minimum
    assert (below[0], below[-1]) == ("█", "▁")
    assert set(sparkline(charged[:3], np.ones(3), 1.0)) == {"█"}
