"""What a new user meets first: tables in order, labels that are whole, failures that reached nothing, clear lines."""

import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calibench
from calibench import bench, optimizers, problems
from calibench.bench.cli import main
from calibench.bench.gate.endings import frames_of
from calibench.bench.report.shared.drawing import save
from calibench.bench.report.study.answer import answer_of
from calibench.bench.report.study.figures import convergence, target_chart
from calibench.bench.report.study.page import headline
from calibench.bench.report.study.write import write_report
from calibench.bench.statistics import summary
from calibench.bench.statistics.optimum import Optimum
from calibench.bench.store.runs import ResultStore
from calibench.core import user_file

pytestmark = pytest.mark.usefixtures("one_process")

MINE = """
import numpy as np


class Bowl:
    targets = (1e-1, 1e-2)

    def __init__(self, dimension: int = 2, shift: float | None = 0.25, broken: bool = False):
        self.lower, self.upper, self.start = -np.ones(dimension), np.ones(dimension), np.full(dimension, 0.5)
        self._at, self._broken = shift or 0.0, broken

    def __call__(self, x):
        return float((x - self._at) @ (x - self._at))

    def merit(self, x):
        if self._broken:
            raise RuntimeError("the gauge is not plugged in")
        return {}


class Cup(Bowl):
    pass


class Least(Bowl):
    minimum = 0.0


class Walk:
    def __init__(self, steps: int = 9):
        self._steps = steps

    def minimize(self, objective, rng):
        for t in np.linspace(0, 1, self._steps):
            objective((1 - t) * objective.start)
"""


@pytest.fixture
def call(fresh, capsys):
    (fresh / "mine.py").write_text(MINE)

    def run(*words):
        with pytest.raises(SystemExit) as ended:
            main(list(words))
        out = capsys.readouterr()
        return ended.value.code, out.out, out.err

    yield run
    sys.modules.pop("mine", None)


WORDS = ("problem=./mine.py:Bowl", "optimizer=./mine.py:Walk", "budget=50", "seeds=1")


def sweep(call, *words):
    return call("run", "-m", *WORDS, *words)


@pytest.mark.slow
def test_options_stand_in_the_order_of_their_numbers(call, tmp_path):
    _, out, _ = sweep(call, "problem.dimension=10,2,5")
    rows = [line for line in out.splitlines() if line.startswith("mine.py:Bowl")]
    assert [row.split("dimension=")[1].split()[0] for row in rows] == ["2", "5", "10"]
    page = write_report(ResultStore(tmp_path / "results" / "adhoc"))[-1].read_text()
    assert page.index("dimension=2 ") < page.index("dimension=5 ") < page.index("dimension=10 ")


def test_a_column_of_numbers_has_one_precision(call):
    code = "import numpy as np\nclass Level:\n    def __init__(self, height: float = 1.0):\n        self._h = height\n"
    code += "        self.lower, self.upper, self.start = -np.ones(2), np.ones(2), np.zeros(2)\n"
    code += "    def __call__(self, x):\n        return self._h\n"
    for heights, shown in (
        ("12.5,0.25", ["0.250000", "12.5000"]),
        ("1e-9,12.5", ["1.00000e-09", "1.25000e+01"]),
        ("1e-9,2e-9", ["1.00e-09", "2.00e-09"]),
    ):
        with open("level.py", "w") as file:
            file.write(code)
        _, out, _ = call(
            "run", "-m", "problem=./level.py:Level", f"problem.height={heights}", "optimizer=./mine.py:Walk",
            "budget=50", "seeds=1", f"study={shown[0]}",
        )  # fmt: skip
        assert sorted(line.split()[-1] for line in out.splitlines() if line.startswith("level.py")) == shown
    sys.modules.pop("level", None)


@pytest.mark.slow
def test_a_run_that_failed_in_judging_reached_nothing_anywhere(call, tmp_path):
    code, out, _ = sweep(call, "problem.broken=true", "problem.shift=0.0")
    assert code == 1
    assert "0/1" in next(line for line in out.splitlines() if "broken=True" in line)
    store = ResultStore(tmp_path / "results" / "adhoc")
    runs = store.runs()
    assert runs["hits_charged"].iloc[0][-1] is not None  # what the search passed is kept
    [cell] = summary.summary(runs).to_dict("records")
    assert (cell["failed"], cell["reached"], cell["success"]) == (1, 0, 0.0)
    assert target_chart(runs)[1]["hit"].isna().all()
    page = write_report(store)[-1].read_text()
    assert "✗ 1/1 failed" in page
    assert "reached nothing" in page
    assert "none; lowest median" in page


def test_a_run_whose_time_was_up_keeps_what_it_reached():
    problem, optimizer = problems.make("sensor_zero"), optimizers.make("de")
    row = dict(bench.execute(problem, optimizer, budget=60, target=1e9).row)
    for status, reached in (("ok", 1), ("timeout", 1), ("failed", 0)):
        frame = pd.DataFrame([row | {"status": status}])
        assert int(np.isfinite(summary.goal_hits(frame)).sum()) == reached


def test_a_traceback_is_of_the_users_frames(call, tmp_path):
    sweep(call, "problem.broken=true")
    [text] = ResultStore(tmp_path / "results" / "adhoc").runs()["traceback"]
    first, *rest = [line for line in text.splitlines() if line.strip()]
    assert "left out" in first
    assert [line.strip().rpartition(" ")[2] for line in rest if line.lstrip().startswith("File")] == ["merit"]
    assert "mine.py" in rest[0]


def test_of_ours_the_frame_that_raised_is_kept():
    try:
        problems.make("no such problem")
    except ValueError as error:
        text = frames_of(error)
    assert text.count("File") == 2  # this test, and what raised
    assert "left out" in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["problem.dimension=range(0,1,0)"], "problem.dimension=range(0,1,0): a step other than 0 is needed"),
        (["problem.dimension=${nope:1}"], "problem.dimension=${nope:1}: Unsupported interpolation type nope"),
        (["start=${nope:1}"], "start=${nope:1}: Unsupported interpolation type nope"),
        (["problem.dimension=0"], "problem mine.py:Bowl: lower is empty: one parameter or more is needed"),
    ],
)
def test_the_line_names_the_argument_and_its_value(call, words, message):
    code, out, err = sweep(call, *words)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert message in err


def test_a_file_without_its_class_lists_its_classes(call):
    code, _, err = call("run", "problem=./mine.py", "optimizer=de", "budget=50", "seeds=1")
    assert (code, err.count("\n")) == (2, 1)
    assert "FILE.py:CLASS" in err
    assert "./mine.py:Bowl, ./mine.py:Cup, ./mine.py:Least" in err
    assert "./mine.py:Walk" not in err  # a method is no problem
    _, _, err = call("run", "problem=./mine.py:Bowl", "optimizer=./mine.py:Wakl", "budget=50")
    assert "did you mean 'Walk'? choices: Walk\n" in err


@pytest.mark.slow
def test_an_option_that_is_null_is_shown(call, tmp_path):
    _, out, _ = sweep(call, "problem.shift=null,0.5")
    assert "shift=null" in out
    assert "shift=0.5" in out
    assert "shift=null" in write_report(ResultStore(tmp_path / "results" / "adhoc"))[-1].read_text()


def test_one_run_is_a_run(call):
    _, out, _ = sweep(call, "--dry-run")
    assert "   1 run, 0 done" in out
    assert "1 run would go to" in out
    _, out, err = sweep(call)
    assert "1 run (0 done before)" in out
    assert "1/1 run," in err
    assert "1 runs" not in out + err


def test_the_version_of_other_code_is_said_in_words(call):
    sweep(call)
    with open("mine.py", "w") as file:
        file.write(MINE.replace("(1 - t)", "(1 - t / 2)"))
    sys.modules.pop("mine", None)
    user_file.LOADED.clear()
    code, _, err = sweep(call)
    assert code == 2
    assert "1 of 1 finished run is of other code" in err
    assert "; --rerun does them again, --keep" in err
    assert " then)" not in err
    with pytest.raises(ValueError, match='; way="rerun" does them again, way="keep"'):  # from Python in its words
        calibench.sweep(*WORDS)


def test_powers_of_ten_are_plain_text_and_a_figure_is_laid_out_once(tmp_path):
    runs = pd.DataFrame(columns=["charged", "best_value"])
    assert runs.empty
    row = bench.execute(problems.make("sensor_zero"), optimizers.make("de"), budget=60)
    figure, numbers = convergence(pd.DataFrame([dict(row.row)]), row.trace.assign(run_id=row.run_id))
    count = 0
    engine = figure.get_layout_engine()
    execute = engine.execute

    def counted(of):
        nonlocal count
        count += 1
        execute(of)

    engine.execute = counted
    svg = save("drawn", (figure, numbers), tmp_path)[0].read_text()
    assert count == 1
    assert "10⁰" in svg or "10¹" in svg
    assert not np.isnan(numbers["median"]).any()


def test_values_that_are_not_finite_and_many_cells_are_told_under_the_table(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def run(*words):
        with pytest.raises(SystemExit) as ended:
            main(["run", *words])
        assert ended.value.code == 0
        return capsys.readouterr().out

    Path("holes.py").write_text(
        "import numpy as np\n\n\nclass Holes:\n    def __init__(self, k: int = 0):\n"
        "        self.lower, self.upper, self.start = np.full(2, -1.0), np.full(2, 1.0), np.full(2, 0.5)\n\n"
        "    def __call__(self, x):\n        return float('nan') if x[0] < -0.5 else float(x @ x)\n"
    )
    words = ("problem=holes.py:Holes", "seeds=1", "execution=serial")
    told = run(*words, "budget=60", "optimizer=de")
    (count,) = re.findall(
        r"(\d+) of 60 values were not finite \(NaN or infinite\): \1 of de on holes\.py:Holes\n", told
    )
    assert 0 < int(count) < 60
    told = run("-m", *words, "budget=20", "optimizer=nlopt_LN_COBYLA", "problem.k=range(45)")
    assert "45 cells, more than are printed; the report has all" in told
    assert "nothing is compared" not in told  # one method
    told = run("-m", *words, "optimizer=de,pso", "problem.k=range(3)", "budget=10,20,30,40,50,60,70")
    assert "42 cells, of which the best 12 are printed; the report has all" in told
    assert told.count("holes.py:Holes k=") >= 12


def test_below_a_long_sweep_stands_the_answer_of_its_page_and_both_count_problems_alike(tmp_path, capsys):
    words = ["problem=sensor_zero,link_length", "problem.error=J1,J2", "problem.instance=range(1,5)", "budget=40"]
    with pytest.raises(SystemExit) as ended:
        main(["run", "-m", *words, "optimizer=lm,de,pso", "seeds=1", f"results={tmp_path}", "execution=serial"])
    assert ended.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("48 cells, ")) + 1
    store = bench.ResultStore(tmp_path / "adhoc")
    found = answer_of(store.runs(), store.traces())  # what the page is made with
    assert lines[at : at + 2] == [found.best, found.sure]
    assert "3 methods on 16 problems" in found.compared
    facts = headline(store.runs(), {}, (), "", found)["facts"]
    assert ("16", "problems") in [fact[:2] for fact in facts]


def test_a_target_that_no_run_can_reach_is_told_before_the_runs(call):
    _, out, _ = call(
        "run", "problem=./mine.py:Least", "optimizer=de", "budget=300", "seeds=1", "target=-1", "--dry-run"
    )
    assert "target=-1: no run can reach it, mine.py:Least says that its least value is 0\n" in out
    _, out, _ = call("run", "problem=./mine.py:Least", "optimizer=de", "budget=300", "seeds=1", "target=0", "--dry-run")
    assert "no run can reach it" not in out


def test_a_budget_that_a_first_sample_uses_up_is_told_before_the_runs(call):
    words = ["run", "-m", "problem=sensor_zero", "optimizer=de,pso,lm", "seeds=1", "--dry-run"]
    _, out, _ = call(*words, "budget=100,150,151")
    assert "budget=100: it ends within the first sample of de (150), pso (100), before they propose a point" in out
    assert "budget=150: it ends within the first sample of de (150), before it proposes a point" in out
    assert "budget=151: it ends" not in out
    assert "lm (" not in out


def test_what_is_left_of_a_sweep_that_is_done_is_nothing(call):
    sweep(call)
    _, out, _ = sweep(call, "--dry-run")
    assert "nothing is left to run; nothing was written" in out
    assert "would go to" not in out


def test_a_class_of_ones_own_is_listed_with_its_options(call):
    code, out, _ = call("list", "problems", "./mine.py:Bowl", "sensor_zero")
    assert code == 0
    assert out.startswith("mine.py:Bowl\n")
    assert "dimension=" in out
    assert "\nsensor_zero" in out
    code, _, err = call("list", "optimizers", "lmm")
    assert (code, err.count("\n")) == (2, 1)
    assert "did you mean 'lm'?" in err


def test_a_request_without_a_method_names_some_and_where_all_are_listed(call):
    code, _, err = call("run", "problem=sensor_zero")
    assert (code, err.count("\n")) == (2, 1)
    assert "such as de, ga" in err
    assert "`bench list optimizers` lists all" in err
    assert len(err) < 250


def test_a_setting_that_cannot_run_is_named_with_its_options(call):
    code, _, err = call("run", "-m", "problem=./mine.py:Bowl", "problem.dimension=2,0", "optimizer=de", "budget=300")
    assert (code, err.count("\n")) == (2, 1)
    assert "lower is empty" in err
    assert "(mine.py:Bowl dimension=0)" in err


def test_a_misspelt_study_file_is_answered_with_the_near_one(call, fresh):
    (fresh / "terrain.yaml").write_text("sweeps:\n- [problem=sensor_zero, optimizer=lm]\n")
    for asked in ("terain.yaml", "terrian", "terrain.yam"):
        code, _, err = call("run", f"study={asked}")
        assert (code, err.count("\n")) == (2, 1)
        assert "did you mean" in err
        assert "terrain.yaml" in err


def test_what_a_method_did_outside_the_box_and_at_the_gate_is_told_below_the_table(call, fresh):
    (fresh / "out.py").write_text(
        "import numpy as np\n\n\nclass Peek:\n"
        "    def minimize(self, objective, rng):\n"
        "        try:\n            objective.budget = 10**6\n"
        "        except AttributeError:\n            pass\n"
        "        objective(objective.start)\n"
        "        while True:\n            objective(objective.upper + 1.0)\n"
    )
    _, out, _ = call("run", "problem=./mine.py:Bowl", "optimizer=./out.py:Peek", "budget=30", "seeds=2")
    assert "58 points lay outside the box or were not finite: 58 of out.py:Peek\n" in out
    assert re.search(r"out.py:Peek tried in 2 runs what no method may: .*budget.*; the counts are true", out)
    _, out, _ = call("run", "problem=./mine.py:Bowl", "optimizer=de", "budget=200", "seeds=1", "study=inside")
    assert "outside the box" not in out


def test_a_value_below_the_least_one_is_told_as_it_is():
    known = Optimum("f", "", 2.0, None, None, False, None)
    assert known.text(1.773) == "-0.23"
    assert known.text(2.0) == known.text(2.0 - 1e-12) == "2.2e-16"
    assert known.text(2.5) == "0.5"


def test_a_study_compared_and_in_latex_tells_what_is_above_the_least_value(call, fresh):
    high = "\n\nclass High(Bowl):\n    minimum, targets = 2.5, (2.6,)\n\n"
    high += "    def __call__(self, x):\n        return 2.5 + super().__call__(x)\n"
    (fresh / "high.py").write_text(MINE + high)
    words = ["run", "-m", "problem=./high.py:High", "optimizer=nlopt_LN_BOBYQA,./high.py:Walk", "opt.Walk.steps=1"]
    words += ["budget=30", "seeds=2"]
    code, _, err = call(*words, "study=a")
    assert code == 0, err
    code, out, err = call("compare", "results/a", "--methods", "nlopt_LN_BOBYQA", "high.py:Walk")
    assert (code, err) == (0, "")
    assert re.search(r"f\*\+\d\.\de[-+]\d\d -> f\*\+1\.2e-01", out)
    call("export", "latex", "results/a", "--to", "tex")
    table = (fresh / "tex" / "summary.tex").read_text()
    assert "best median $- f^*$" in table
    assert "$2.5$" in table
    assert "$0.125$" in table
    call("run", "problem=./mine.py:Bowl", "optimizer=./mine.py:Walk", "budget=30", "seeds=2", "study=b")
    call("export", "latex", "results/b", "--to", "plain")
    assert "f^*" not in (fresh / "plain" / "summary.tex").read_text()
