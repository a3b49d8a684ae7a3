"""A user's own family of problems from a file: all rows, right dimensions, and an edited class is noticed."""

import json
import os
import subprocess
import sys

import pandas as pd
import pytest

from calibench.bench.cli import main
from calibench.bench.store.runs import ResultStore

pytestmark = pytest.mark.usefixtures("one_process", "undrawn")

BOWL = """
import numpy as np
from offsets import OFFSET


class Bowl:
    def __init__(self, dimension=2):
        n = dimension
        self.lower, self.upper, self.start = -np.ones(n), np.ones(n), np.full(n, 0.5)

    def __call__(self, x):
        return OFFSET + float(x @ x)


class Once:
    def __init__(self, step=0.1):
        self._size = step

    def minimize(self, objective, rng):
        objective(objective.start - self._size)


class Deep:
    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.5)

    def __call__(self, x):
        return self.down(30)

    def down(self, left):
        if not left:
            raise RuntimeError("the encoder fell off")
        return self.down(left - 1)
"""
FAMILY = (
    "run -m problem=./mine.py:Bowl problem.dimension=2,5,10,20 optimizer=de,pso,pygmo_cmaes,nlopt_LN_BOBYQA "
    "budget=60 seeds=5 start=random"
)


@pytest.fixture
def here(fresh):
    (fresh / "mine.py").write_text(BOWL)
    (fresh / "offsets.py").write_text("OFFSET = 0.0\n")
    before = set(sys.modules)
    yield fresh
    for name in {"mine", "offsets"} & (set(sys.modules) - before):
        del sys.modules[name]


@pytest.fixture
def call(here, capsys):
    def run(command):
        with pytest.raises(SystemExit) as ended:
            main(command.split() if isinstance(command, str) else command)
        said = capsys.readouterr()
        return ended.value.code, said.out, said.err

    return run


def rows(here):
    return ResultStore(here / "results" / "adhoc").runs()


def dimensions(runs):
    asked = [json.loads(text)["dimension"] for text in runs["problem_options"]]
    return pd.Series(list(zip(asked, runs["dimension"], strict=True))).value_counts().to_dict()


@pytest.mark.slow
def test_a_family_of_a_plain_class_has_all_rows_and_an_edit_of_it_is_said(call, here):
    assert call(FAMILY)[0] == 0
    first = rows(here)
    assert dimensions(first) == {(n, n): 20 for n in (2, 5, 10, 20)}
    assert set(first["problem"]) == {"mine.py:Bowl"}
    assert first["run_id"].is_unique
    assert "80 runs (80 done before)" in call(FAMILY)[1]

    (here / "offsets.py").write_text("OFFSET = 7.0  # a neighbour that the class imports\n")
    code, out, err = call(FAMILY)
    assert (code, err.count("\n")) == (2, 1)
    assert "runs (" not in out
    assert "80 of 80 finished runs are of other code: 80 of problem mine.py:Bowl; --rerun" in err
    assert rows(here).equals(first)

    more = FAMILY.replace("seeds=5", "seeds=6")
    code, out, err = call(f"{more} --keep")
    assert code == 0
    assert "80 of 80 finished runs are of other code" in err
    assert "they were kept" in out
    kept = rows(here)
    assert (kept.groupby("repetition")["best_value"].min() > 6).tolist() == [False] * 5 + [True]
    assert set(kept["code_digest"].str.split(".").str[0].value_counts()) == {80, 16}

    assert "80 of 96 finished runs" in call(f"{more} --dry-run")[1]
    code, out, err = call(f"{more} --rerun")
    assert "they are done again" in err
    assert "96 runs (16 done before)" in out
    assert (rows(here)["best_value"] > 6).all()
    assert set(rows(here)["run_id"]) == set(kept["run_id"])
    assert "96 runs (96 done before)" in call(more)[1]


def test_a_refused_retry_of_failed_runs_loses_none_of_their_rows(call, here):
    (here / "mine.py").write_text(
        BOWL + "class Half(Bowl):\n    def __call__(self, x):\n        return 1 / (x @ x < 1)\n"
    )
    command = "run problem=./mine.py:Half optimizer=./mine.py:Once,de -m budget=50 seeds=2"
    assert call(command)[0] == 1
    before = rows(here)
    failed = set(before.loc[before["status"] == "failed", "run_id"])
    assert 0 < len(failed) < len(before)
    (here / "offsets.py").write_text("OFFSET = 7.0  # other code\n")
    code, _, err = call(f"{command} --retry-failed")
    assert code == 2
    sound = len(before) - len(failed)
    assert f"{sound} of {sound} finished run" in err
    assert "nothing was run" in err
    assert rows(here).equals(before)
    call(f"{command} --retry-failed --keep")
    after = rows(here)
    assert set(after["run_id"]) == set(before["run_id"])
    again = after["code_digest"] != before["code_digest"]
    assert set(after.loc[again, "run_id"]) == failed


def test_comments_and_docstrings_are_not_the_code(call, here):
    command = "run problem=./mine.py:Bowl optimizer=./mine.py:Once budget=5 seeds=1"
    call(command)
    (here / "mine.py").write_text('"""Mine."""\n# a remark\n' + BOWL.replace("class Bowl:", "class Bowl:  # round"))
    assert "1 run (1 done before)" in call(command)[1]


def test_both_ways_at_once_are_refused(call, here):
    code, _, err = call("run problem=./mine.py:Bowl optimizer=de budget=5 --rerun --keep")
    assert code == 2
    assert "give one of the two" in err


def test_an_optimisers_options_and_code_count_too(call, here):
    command = (
        "run -m problem=./mine.py:Bowl optimizer=./mine.py:Once,de opt../mine.py:Once.step=0.1,0.2 budget=5 seeds=1"
    )
    assert call(command)[0] == 0
    found = rows(here).set_index("optimizer")
    assert sorted(found.loc["mine.py:Once", "optimizer_options"]) == ['{"step":0.1}', '{"step":0.2}']
    assert found.loc["mine.py:Once", "best_value"].nunique() == 2


def test_an_option_goes_to_a_class_of_a_file_by_the_name_of_the_class(call, here):
    words = "run -m problem=./mine.py:Bowl optimizer=./mine.py:Once,de opt.Once.step=0.1,0.2 budget=5 seeds=1"
    assert call(words)[0] == 0
    found = rows(here).set_index("optimizer")
    assert sorted(found.loc["mine.py:Once", "optimizer_options"]) == ['{"step":0.1}', '{"step":0.2}']
    code, _, err = call(words.replace("opt.Once", "opt.Twice"))
    assert code == 2
    assert "opt.Twice: Twice is not in this sweep" in err


def test_a_file_is_the_same_problem_from_any_folder_and_in_any_process(call, here, monkeypatch):
    deep = here / "v1.2" / "a b"
    deep.mkdir(parents=True)
    call(["run", "problem=./mine.py:Bowl", "optimizer=de", "budget=5", "seeds=4"])
    monkeypatch.chdir(deep)
    for path in ("../../mine.py", str(here / "mine.py")):
        command = f"run problem={path}:Bowl optimizer=de budget=5 seeds=4 results=../../results"
        assert "4 runs (4 done before)" in call(command)[1]
    other = "execution=processes execution.n_jobs=2 study=other"
    assert call(f"run problem=../../mine.py:Bowl optimizer=de budget=5 seeds=4 results=../../results {other}")[0] == 0
    there, here_ = ResultStore(here / "results" / "other").runs(), rows(here)
    assert there["run_id"].tolist() == here_["run_id"].tolist()
    assert there["best_value"].tolist() == here_["best_value"].tolist()
    assert there["code_digest"].tolist() == here_["code_digest"].tolist()


def test_a_path_may_have_folders_dots_and_spaces(call, here):
    folder = here / "my models v1.2"
    folder.mkdir()
    (folder / "bowl-2.py").write_text(BOWL.replace("offsets", "its_offsets"))
    (folder / "its_offsets.py").write_text("OFFSET = 1.0\n")
    assert call(["run", "problem='./my models v1.2/bowl-2.py:Bowl'", "optimizer=de", "budget=5", "seeds=1"])[0] == 0
    assert rows(here)["problem"].tolist() == ["bowl-2.py:Bowl"]


def test_two_files_of_one_name_are_not_taken_for_one(call, here):
    for folder in ("a", "b"):
        (here / folder).mkdir()
        (here / folder / "same.py").write_text(BOWL.replace("offsets", f"offsets_{folder}"))
        (here / folder / f"offsets_{folder}.py").write_text("OFFSET = 0.0\n")
    code, _, err = call("run -m problem=./a/same.py:Bowl,./b/same.py:Bowl optimizer=de budget=5")
    assert code == 2
    assert "same.py:Bowl is also" in err
    assert not (here / "results").exists()


def test_two_files_of_one_name_in_two_packages_are_two_problems(call, here):
    for folder, offset in (("first_pack", 1), ("second_pack", 2)):
        (here / folder).mkdir()
        (here / folder / "__init__.py").write_text("")
        (here / folder / "levels.py").write_text(f"OFFSET = {offset}\n")
        (here / folder / "same.py").write_text(BOWL.replace("from offsets", "from .levels"))
    names = "./first_pack/same.py:Bowl,./second_pack/same.py:Bowl"
    assert call(f"run -m problem={names} optimizer=de budget=30 seeds=1")[0] == 0
    found = rows(here).set_index("problem")["best_value"]
    assert found["first_pack/same.py:Bowl"] < 2 < found["second_pack/same.py:Bowl"]


def test_another_file_of_the_name_in_a_later_command_is_noticed(call, here):
    call("run problem=./mine.py:Bowl optimizer=de budget=5 seeds=1")
    manifest = json.loads((here / "results/adhoc/manifest.json").read_text())
    assert manifest["files"] == {"mine.py:Bowl": str(here / "mine.py")}
    (here / "elsewhere.py").write_text(BOWL)
    manifest["files"] = {"mine.py:Bowl": str(here / "elsewhere.py")}
    (here / "results/adhoc/manifest.json").write_text(json.dumps(manifest))
    code, _, err = call("run problem=./mine.py:Bowl optimizer=de budget=5 seeds=1")
    assert code == 2
    assert f"whose file was {here / 'elsewhere.py'}" in err
    os.unlink(here / "elsewhere.py")  # a file that has moved is the same
    assert "1 run (1 done before)" in call("run problem=./mine.py:Bowl optimizer=de budget=5 seeds=1")[1]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("problem=./mime.py:Bowl", "did you mean 'mine.py'?"),
        ("problem=./mine.py:Bow", "did you mean 'Bowl'?"),
        ("problem=./no/mine.py:Bowl", "mine.py; nor is its folder there; give its path from here"),
        ("problem=./broken.py:Bowl", "SyntaxError"),
        ("problem=./mine.py:Bowl problem.dimensions=3", "did you mean 'dimension'?"),
    ],
)
def test_a_misspelt_file_class_or_option_is_one_line(call, here, words, message):
    (here / "broken.py").write_text("class Bowl(:\n")
    code, _, err = call(f"run {words} optimizer=de budget=5")
    assert (code, err.count("\n")) == (2, 1)
    assert message in err
    assert not (here / "results").exists()


def test_cells_of_one_id_are_refused_by_name(call, here, monkeypatch):
    monkeypatch.setattr("calibench.bench.provenance.run_id.digest", lambda *parts: "0" * 16)
    code, _, err = call("run -m problem=./mine.py:Bowl problem.dimension=2,5 optimizer=de budget=5 seeds=1")
    assert code == 2
    assert "mine.py:Bowl (dimension=2)" in err
    assert "mine.py:Bowl (dimension=5)" in err


def test_a_failure_keeps_its_last_frames_and_the_list_names_its_options(call, here):
    code, out, _ = call("run -m problem=./mine.py:Deep optimizer=de opt.de.population=20 budget=50 seeds=1")
    assert code == 1
    assert "de population=20" in out
    [row] = rows(here).to_dict("records")
    assert row["traceback"].count("in down") == 10
    assert "left out" in row["traceback"]
    assert row["traceback"].rstrip().endswith('raise RuntimeError("the encoder fell off")')
    shown = call(f"show {row['run_id']}")[1]
    assert "the last frames:" in shown
    assert 'raise RuntimeError("the encoder fell off")' in shown


def test_a_class_of_ones_own_is_told_by_what_differs(call, here):
    (here / "many.py").write_text(
        "import numpy as np\n\n\nclass Cup:\n"
        "    def __init__(self, dimension=2, deep=1.0, words=('a', 'b'), kind=1):\n"
        "        self.dimension, self.deep, self.words, self.kind = dimension, deep, words, kind\n"
        "        self.lower, self.upper = -np.ones(dimension), np.ones(dimension)\n"
        "        self.start = np.full(dimension, 0.5)\n\n"
        "    def __call__(self, x):\n        return self.deep * float(x @ x)\n"
    )
    _, out, _ = call("run problem=./many.py:Cup optimizer=de budget=5 seeds=1 study=one")
    assert "many.py:Cup  de" in " ".join(out.split(" ")).replace("   ", "  ")
    _, out, _ = call("run -m problem=./many.py:Cup problem.dimension=2,3 optimizer=de budget=5 seeds=1 study=two")
    assert "many.py:Cup dimension=2 " in out
    assert "deep" not in out


def test_a_class_in_a_file_beside_the_study_is_found_from_anywhere(here, run_bench, monkeypatch):
    sweeps = [["problem=./mine.py:Bowl", "optimizer=de,./mine.py:Once"], ["problem='mine.py:Bowl'", "optimizer=pso"]]
    (here / "own.yaml").write_text(json.dumps({"budget": 60, "seeds": 1, "sweeps": sweeps}))
    away = here / "away from it"
    away.mkdir()
    monkeypatch.chdir(away)
    assert run_bench(["run", "study=../own.yaml"])[0] == 0
    assert run_bench(["run", f"study={here}/own.yaml", "results=again"])[0] == 0
    runs, again = (ResultStore(f"{folder}/own").runs() for folder in ("results", "again"))
    assert set(runs["problem"]) == {"mine.py:Bowl"}
    assert set(runs["optimizer"]) == {"de", "mine.py:Once", "pso"}
    assert runs["run_id"].tolist() == again["run_id"].tolist()


def test_more_seeds_make_no_second_run_of_what_has_no_chance(run_bench):
    words = "run problem=sensor_zero optimizer=lm budget=40"
    _, out, _ = run_bench(f"{words} seeds=3")
    assert "1 run: a deterministic method gives one answer from one start, whatever the seed" in out
    _, out, _ = run_bench(f"{words} seeds=3:6")
    assert "1 run (1 done before)" in out
    assert ResultStore("results/adhoc").runs()["repetition"].tolist() == [0]
    assert "1 run: " not in run_bench(f"{words} seeds=1")[1]


def test_a_study_is_written_as_yaml_is(here, run_bench):
    own = {"budget": 60, "problem": "./mine.py:Bowl", "optimizer": ["de", "./mine.py:Once"], "target": None}
    (here / "own.yaml").write_text(json.dumps(own | {"sweeps": [["seeds=2"]]}))
    code, out, _ = run_bench("run study=own.yaml --dry-run")
    assert code == 0
    assert "2 cells, 4 runs" in out
    (here / "own.yaml").write_text(json.dumps(own | {"sweeps": [["seeds=2"]], "execution": {"n_jobs": 2}}))
    code, _, err = run_bench("run study=own.yaml --dry-run")
    assert (code, err) == (2, "bench: study=own.yaml: execution: one value is needed; write execution.n_jobs: VALUE\n")


def test_a_word_of_a_sweep_replaces_the_one_that_the_sweeps_share(here, run_bench):
    sweeps = [["optimizer=de", "budget=40"], ["optimizer=pso"]]
    (here / "own.yaml").write_text(json.dumps({"budget": [60, 80], "problem": "./mine.py:Bowl", "sweeps": sweeps}))
    code, out, err = run_bench("run study=own.yaml seeds=1 --dry-run")
    assert (code, err) == (0, "")
    told = {line.partition("done  ")[2] for line in out.splitlines() if "0 done  " in line}
    asked = ("de", 40), ("pso", 60), ("pso", 80)
    assert told == {f"{method} on mine.py:Bowl dimension=2, budget {n}" for method, n in asked}


def test_a_word_for_all_runs_that_stands_in_one_sweep_is_refused(here, run_bench):
    own = {"budget": 60, "seeds": 1, "problem": "./mine.py:Bowl"}
    one, other, part = "optimizer=de", "optimizer=pso", "shard=1/2"
    for sweeps in ([one, part], [other]), ([one], [other, part]):
        (here / "own.yaml").write_text(json.dumps(own | {"sweeps": sweeps}))
        code, _, err = run_bench("run study=own.yaml --dry-run")
        told = "bench: shard=1/2: stands in one sweep and is for all of the study; write it beside sweeps:\n"
        assert (code, err) == (2, told)
    same = [["optimizer=de", "results=there"], ["optimizer=pso", "results=there"]]
    (here / "own.yaml").write_text(json.dumps(own | {"sweeps": same}))
    assert "2 runs would go to there/own" in run_bench("run study=own.yaml --dry-run")[1]


def test_an_object_in_the_place_of_a_class_is_one_line_that_says_so(here, run_bench):
    (here / "things.py").write_text(
        f"{BOWL}\nbowl, once = Bowl(), Once()\n\n\ndef height(x):\n    return 1.0\n\n\n"
        "def compass(objective, rng):\n    objective(objective.start)\n\n\n"
        "class Search:\n    minimize = staticmethod(compass)\n"
    )
    needed = "is an object, and what makes one is needed: its class, or a function that returns it"
    for words, told in (
        ("problem=./things.py:bowl optimizer=de", f"problem './things.py:bowl' {needed}"),
        ("problem=./things.py:Bowl optimizer=./things.py:once", f"optimizer './things.py:once' {needed}"),
        ("problem=./things.py:height optimizer=de", "an object with lower, upper, start and a call"),
        (
            "problem=./things.py:Bowl optimizer=./things.py:compass",
            "such as one of class Search: minimize = staticmethod(compass)",
        ),
        ("problem=bowl optimizer=de", "unknown problem 'bowl'; a class of your own is FILE.py:CLASS or MODULE:CLASS"),
    ):
        code, _, err = run_bench(f"run {words} budget=5")
        assert (code, err.count("\n")) == (2, 1)
        assert told in err
    assert run_bench("run problem=./things.py:Bowl optimizer=./things.py:Search budget=5 seeds=1")[0] == 0


@pytest.mark.slow
def test_processes_that_a_problem_starts_and_ends_tell_nothing_of_the_sweep(here):
    (here / "pooled.py").write_text(
        "import multiprocessing\n\nimport numpy as np\n\n\ndef square(v):\n    return v * v\n\n\n"
        "class Pooled:\n    lower, upper, start = -np.ones(2), np.ones(2), np.full(2, 0.5)\n\n"
        "    def __init__(self):\n        self(self.start)\n\n"
        "    def __call__(self, x):\n        with multiprocessing.get_context('fork').Pool(1) as pool:\n"
        "            return float(sum(pool.map(square, list(x))))\n"
    )
    words = ["-m", "calibench", "run", "problem=./pooled.py:Pooled", "optimizer=de", "budget=2", "seeds=1"]
    ended = subprocess.run([sys.executable, *words], capture_output=True, text=True, check=False)
    assert (ended.returncode, "SIGTERM" in ended.stderr) == (0, False)


@pytest.mark.parametrize("key", ["sweep", "Sweeps", "sweps"])
def test_a_misspelt_sweeps_is_told_as_such(run_bench, tmp_path, key):
    (tmp_path / "own.yaml").write_text(f"budget: 5\n{key}:\n  - [problem=sensor_zero, optimizer=de]\n")
    code, _, err = run_bench("run study=own.yaml --dry-run")
    assert (code, err) == (2, f"bench: study=own.yaml: {key}: did you mean sweeps?\n")


@pytest.mark.parametrize("words", ["--config-dir conf study=mine", "study=mine --config-dir=conf"])
def test_a_folder_of_hydras_is_refused_with_the_way_out(run_bench, words):
    code, _, err = run_bench(f"run {words}")
    told = "--config-dir: is not built; words of your own stand in a study file, study=FILE.yaml"
    assert (code, err) == (2, f"bench: {told}\n")
