"""A suite of one's own, run as one runs it: with data files, crashes, units and names that are not ours."""

import json
import re
import shlex
import shutil
import sys
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

import pandas as pd
import pytest

from calibench import bench, optimizers, problems, testing
from calibench.bench.cli import main
from calibench.bench.exchange import tables as latex
from calibench.bench.exchange.studies import file_name
from calibench.bench.provenance import code_digest
from calibench.bench.provenance.code_digest import changed_parts, digest_of_files
from calibench.bench.report.study import figures
from calibench.bench.report.study.write import write_report
from calibench.bench.statistics.summary import summary
from calibench.bench.store.columns import with_options
from calibench.bench.store.runs import ResultStore
from calibench.core import user_file

pytestmark = pytest.mark.usefixtures("one_process", "undrawn")

SUITE = """
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path

import numpy as np
from calibench import optimizers
from calibench.problems import Parameter


@dataclass(frozen=True)
class Reader:
    delimiter: str = ";"
    skip: tuple[float, ...] = ()


@dataclass(frozen=True)
class Fit:
    data: Path = Path("readings.csv")
    reader: Reader = field(default_factory=Reader)
    raises: bool = False
    limit: float | None = None
    width: float | tuple[float, ...] | None = 1.0

    unit = "mg²/L²"
    lower, upper, start = np.full(1, -9.0), np.full(1, 9.0), np.zeros(1)

    def __post_init__(self):
        read = np.loadtxt(self.data, delimiter=self.reader.delimiter, ndmin=1)
        object.__setattr__(self, "read", read)

    def __call__(self, x):
        if self.raises and x[0] > 0:
            raise ArithmeticError(f"too large: {x[0]:.3f} λ")
        return float(np.sum((self.read - x[0]) ** 2))


class Rare:
    unit = "dB"
    lower, upper, start = np.full(1, -3.0), np.full(1, 9.0), np.zeros(1)

    def __call__(self, x):
        return float(x[0]) if x[0] < 0 else float("nan")


@dataclass(frozen=True)
class Wave:
    λ: float = 0.5
    Δt: float = 0.1


@dataclass(frozen=True)
class Greek:
    σ: float = 1.0
    μ_0: tuple[float, ...] = (1.0, 2.0)
    wave: Wave = field(default_factory=Wave)

    lower, upper, start = -np.ones(2), np.ones(2), np.zeros(2)

    def __call__(self, x):
        return float(self.σ * (x @ x) + self.wave.λ + self.wave.Δt * self.μ_0[0])


class Decay:
    parameters = (
        Parameter("kₐ absorption", "1/h", 0.5, 0.0, 1.0), Parameter("charge", "C", 2e-9, 1e-9, 3e-9, 2.5e-9), "plain",
    )
    lower, upper, start = np.array([0.0, 1e-9, 0.0]), np.array([1.0, 3e-9, 1.0]), np.array([0.5, 2e-9, 0.5])

    def __call__(self, x):
        return float(np.sum(x**2))


class Slope:
    lower, upper, start = np.full(1, -4.5), np.full(1, 5.5), np.zeros(1)

    def __call__(self, x):
        return float(x[0])


class Stay:
    def minimize(self, objective, rng):
        objective(objective.start)


class Away:
    def minimize(self, objective, rng):
        objective(objective.upper)


class Kind(Enum):
    ONE = 1
    TWO = 2


@dataclass(frozen=True)
class Guided:
    kind: Kind = Kind.ONE
    reader: Reader = field(default_factory=Reader)

    def minimize(self, objective, rng):
        objective(np.full(1, -self.kind.value))


@dataclass(frozen=True)
class Climb:
    step: float = 0.5
    back: bool = True
    least: float = 1e-9
    label: str = "climb"
    traits: object = optimizers.Traits()

    def minimize(self, objective, rng):
        x, step = objective.start, self.step
        best = objective(x)
        while step > self.least:
            y = np.clip(x + step, objective.lower, objective.upper)
            value = objective(y)
            x, best, step = (y, value, step) if value < best else (x, best, -step / 2 if self.back else step / 2)
"""


@pytest.fixture
def here(fresh):
    (fresh / "own_suite.py").write_text(SUITE, encoding="utf-8")
    (fresh / "readings.csv").write_text("1.0\n2.0\n")
    yield fresh
    sys.modules.pop("own_suite", None)


@pytest.fixture
def call(here, capsys):
    def run(*words):
        with pytest.raises(SystemExit) as ended:
            main(list(words))
        said = capsys.readouterr()
        return ended.value.code or 0, said.out, said.err

    return run


def test_a_study_is_reported_where_the_files_that_its_problems_read_are_not(call, here):
    assert call("run", "problem=./own_suite.py:Fit", "optimizer=de", "budget=20", "seeds=2", "study=s")[0] == 0
    (here / "readings.csv").unlink()
    code, out, err = call("report", "results/s")
    assert code == 0, err
    (here / "own_suite.py").write_text("import sys\n\nsys.exit('the licence server is not here')\n")
    for registry in (problems.registry, optimizers.registry):  # as in a new process
        registry._places.clear()
        registry._by_path.clear()
    user_file.LOADED.clear()
    sys.modules.pop("own_suite", None)
    code, out, err = call("report", "results/s")
    assert code == 0, err
    assert "report.html" in out


def test_a_study_is_reported_whose_optimiser_keeps_its_traits_in_a_field(here):
    sys.path.insert(0, str(here))
    import own_suite

    store = ResultStore(here / "s")
    store.open()
    for step in (0.5, 0.25):
        store.write(bench.execute(own_suite.Fit(), own_suite.Climb(step=step), budget=20))
    assert summary(store.runs())["runs"].tolist() == [1, 1]
    assert write_report(store)[-1].name == "report.html"


@pytest.mark.parametrize("text", ["λ" * 200, "配" * 200, "a" * 200])
def test_a_files_name_is_bounded_in_bytes(text):
    assert len(file_name(text).encode()) < 150
    assert len(figures.file_name(text).encode()) < 150
    assert figures.file_name(text) != figures.file_name(text + text[0])


def test_a_change_of_a_file_of_data_is_noticed_when_a_sweep_goes_on(call, here):
    words = ("run", "problem=./own_suite.py:Fit", "optimizer=de", "budget=20", "seeds=2", "study=s")
    assert call(*words)[0] == 0
    code, out, _ = call(*words)
    assert code == 0
    assert "(2 done before)" in out
    (here / "readings.csv").write_text("1.0\n3.0\n")
    code, _, err = call(*words)
    assert code == 2
    assert "2 of problem own_suite.py:Fit, whose file of data was another (where it writes it: a str)" in err
    before = ResultStore("results/s").runs()["best_value"].max()
    assert call(*words, "--rerun")[0] == 0
    assert ResultStore("results/s").runs()["best_value"].min() > before + 1


def test_rows_from_before_files_were_told_are_not_of_other_code():
    assert changed_parts("a.b.c", "a-f.b.c") == []
    assert changed_parts("a-e.b.c", "a-f.b.c") == ["files"]
    assert changed_parts("d-e.b.c", "a-e.b.g") == ["problem", "gate"]


def test_a_file_of_data_is_the_same_from_any_folder_and_inside_other_options(here, monkeypatch):
    (here / "far").mkdir()
    (here / "far" / "own_files.py").write_text(
        "from dataclasses import dataclass\nfrom pathlib import Path\n\n\n@dataclass(frozen=True)\nclass Source:\n"
        "    file: Path = Path('own.csv')\n\n\n@dataclass(frozen=True)\nclass Holds:\n    source: Source = Source()\n"
    )
    (here / "far" / "own.csv").write_text("1\n")
    sys.path.insert(0, str(here / "far"))
    import own_files

    told = digest_of_files(own_files.Holds())
    assert len(told) == 12
    monkeypatch.chdir(here / "far")
    assert digest_of_files(own_files.Holds()) == told
    (here / "far" / "own.csv").write_text("12\n")
    assert digest_of_files(own_files.Holds()) not in ("", told)
    assert digest_of_files(own_files.Holds(own_files.Source(Path("no.csv")))) == ""
    del sys.modules["own_files"]


def digest_of(*paths):
    return digest_of_files(Given(*paths))


@dataclass(frozen=True)
class Given:
    one: Path
    other: Path | None = None


@pytest.mark.parametrize(
    "change",
    [
        lambda folder: (folder / "deep" / "b.csv").write_text("3\n"),
        lambda folder: (folder / "c.csv").write_text(""),
        lambda folder: (folder / "a.csv").unlink(),
        lambda folder: (folder / "a.csv").rename(folder / "z.csv"),
        lambda folder: (folder / "deep" / "far" / "linked.csv").write_text("9\n"),
    ],
)
def test_a_change_in_a_folder_of_data_is_noticed(tmp_path, change):
    folder = tmp_path / "data"
    (folder / "deep").mkdir(parents=True)
    (folder / "a.csv").write_text("1\n")
    (folder / "deep" / "b.csv").write_text("2\n")
    (tmp_path / "elsewhere").mkdir()
    (folder / "deep" / "far").symlink_to(tmp_path / "elsewhere")
    (folder / "deep" / "round").symlink_to("..")  # a loop
    (folder / "nowhere.csv").symlink_to(tmp_path / "gone.csv")
    before = digest_of(folder)
    assert len(before) == 12
    shutil.copytree(folder, tmp_path / "copy", symlinks=True)
    assert digest_of(tmp_path / "copy") == before
    for hidden in (".notes", ".git", "__pycache__"):
        (folder / "deep" / hidden).mkdir()
        (folder / "deep" / hidden / "x").write_text("no data")
    assert digest_of(folder) == before
    change(folder)
    assert digest_of(folder) not in ("", before)


def test_a_single_file_has_the_digest_of_its_content_and_goes_before_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "own_place.py").write_text("class Given:\n    def __init__(self, one): self.one = one\n")
    (tmp_path / "far" / "own.csv").write_bytes(b"1.0\n")
    (tmp_path / "own.csv").mkdir()  # a folder of the file's name where one works
    monkeypatch.syspath_prepend(tmp_path / "far")
    import own_place

    content = blake2b(b"1.0\n", digest_size=12).hexdigest()
    told = blake2b(content.encode(), digest_size=6).hexdigest()
    assert digest_of_files(own_place.Given(Path("own.csv"))) == told
    del sys.modules["own_place"]


def test_a_folder_of_too_many_files_is_refused_with_a_way_out(tmp_path, monkeypatch):
    monkeypatch.setattr(code_digest, "_MOST", 3)
    for k in range(4):
        (tmp_path / str(k)).write_text("")
    with pytest.raises(ValueError, match=r"more than 3 files.*data_id"):
        digest_of(tmp_path)


def test_a_problem_that_says_what_its_data_are_is_believed(here):
    sys.path.insert(0, str(here))
    import own_suite

    problem = own_suite.Fit()
    assert digest_of_files(problem)
    object.__setattr__(problem, "data_id", "of 1998")
    assert digest_of_files(problem) == ""


def test_no_method_is_called_the_best_where_none_found_a_value_in_half_of_its_runs(call, here):
    methods = "optimizer=./own_suite.py:Away,./own_suite.py:Stay"
    _, out, _ = call(
        "run", "-m", "problem=./own_suite.py:Rare", methods, "budget=9", "seeds=6", "start=random", "study=s"
    )  # fmt: skip
    runs = ResultStore("results/s").runs()
    assert 0 < (runs["status"] == "ok").sum() < 3
    assert out.index("own_suite.py:Stay") < out.index("own_suite.py:Away")  # of ties the fewer failures first
    assert call("report", "results/s")[0] == 0
    page = (here / "results/s/report.html").read_text(encoding="utf-8")
    assert "none: of every method half of the runs or more found no value" in page
    assert "lowest median:" not in page


def test_a_comparison_has_units_digits_that_part_and_no_goal_where_none_is(call, here):
    words = ("run", "-m", "problem=./own_suite.py:Fit", "budget=20", "seeds=6", "start=random")
    assert call(*words, "optimizer=./own_suite.py:Climb,de", "study=a")[0] == 0
    assert call(*words, "optimizer=./own_suite.py:Climb", "optimizer.back=false", "study=b")[0] == 0
    _, out, _ = call("compare", "results/a", "--methods", "own_suite.py:Climb", "de")
    assert call("compare", "results/a", "--methods", "./own_suite.py:Climb", "de")[1] == out  # as it was typed
    [line] = [line for line in out.splitlines() if "own_suite.py:Fit" in line]
    assert "mg²/L²" in line
    assert " - " in line
    assert "0/6" not in line
    assert len({*re.search(r"(\S+) -> (\S+) mg²/L²", line).groups()}) == 2
    _, out, _ = call("compare", "results/a", "results/b")
    assert "  own_suite.py:Climb (back=True -> False)  " in out  # as the table of a run calls it


def test_settings_of_an_option_inside_another_are_compared_as_one_types_them(call, here):
    words = ("run", "-m", "problem=./own_suite.py:Rare", "optimizer=./own_suite.py:Guided", "budget=9", "seeds=6")
    assert call(*words, "study=a")[0] == 0
    assert call(*words, "optimizer.reader.delimiter=x", "optimizer.kind=TWO", "study=b")[0] == 0
    _, out, _ = call("compare", "results/a", "results/b")
    assert "(kind=ONE -> TWO, reader.delimiter=; -> x)" in out
    assert "class" not in out


def test_failures_and_a_dry_run_are_named_by_what_differs(call, here):
    words = (
        "run", "-m", "problem=./own_suite.py:Fit", "problem.raises=true", "optimizer=de,./own_suite.py:Climb",
        "opt.Climb.step=0.5,0.25", "budget=20", "seeds=4", "start=random", "study=s",
    )  # fmt: skip
    code, out, _ = call(*words, "--dry-run")
    assert code == 0
    assert "   4 runs, 0 done  own_suite.py:Climb (step=0.5) on own_suite.py:Fit\n" in out
    code, out, _ = call(*words)
    assert code == 1
    failures = out.partition(" failed:\n")[2]
    assert "own_suite.py:Climb (step=0.25)" in failures
    assert "readings.csv" not in failures
    assert call("report", "results/s")[0] == 0
    page = (here / "results/s/report.html").read_text(encoding="utf-8")
    assert page.count("too large: ") == 3  # one for each method, as only numbers differ


def test_a_class_a_name_or_a_function_in_the_place_of_an_object_is_refused_with_the_way_out(here):
    sys.path.insert(0, str(here))
    from own_suite import Climb, Fit, Rare

    asked = {
        (Rare, Climb()): "problem Rare is a class, and an object is needed: Rare(...)",
        (Fit(), Climb): "optimizer Climb is a class, and an object is needed: Climb(...)",
        (Fit(), "de"): "'de' is a name and has no minimize(objective, rng): optimizers.make('de') makes the object",
        (
            "full11",
            Climb(),
        ): "'full11' is a name and has no lower, upper, start: problems.make('full11') makes the object",
        (Fit(), lambda objective, rng: None): "is a function and has no minimize(objective, rng): make it a method",
    }
    for (problem, optimizer), told in asked.items():
        with pytest.raises(ValueError, match=re.escape(told)):
            bench.execute(problem, optimizer, budget=5)
    with pytest.raises(AssertionError, match=re.escape("give Rare(...)")):
        testing.check_problem(Rare)
    with pytest.raises(AssertionError, match=re.escape("lambda: Climb(...)")):
        testing.check_optimizer(Climb())


def test_a_method_without_self_needs_no_object(here):
    class Static:
        @staticmethod
        def minimize(objective, rng):
            objective(objective.start)

    sys.path.insert(0, str(here))
    from own_suite import Fit

    assert bench.execute(Fit(), Static, budget=5).evaluations == 1


def test_a_run_tells_why_it_failed_and_prints_itself_in_a_line(here):
    sys.path.insert(0, str(here))
    from own_suite import Climb, Fit

    run = bench.execute(Fit(raises=True), Climb(), budget=5)
    assert (run.error_type, run.error) == ("ArithmeticError", "too large: 0.500 λ")
    assert repr(run).endswith("2 of 5 charged, best 5 mg²/L², failed (failed): ArithmeticError too large: 0.500 λ>")


def test_a_table_in_latex_has_the_unit_of_its_values_in_signs_that_latex_knows(call, here):
    assert (
        call("run", "-m", "problem=./own_suite.py:Fit,./own_suite.py:Rare", "optimizer=de", "budget=9", "study=s")[0]
        < 2
    )
    assert call("export", "latex", "results/s", "--to", "tex")[0] == 0
    table = (here / "tex" / "summary.tex").read_text(encoding="utf-8")
    assert r"& unit \\" in table
    assert r"& mg\textsuperscript{2}/L\textsuperscript{2} \\" in table
    assert r"& dB \\" in table
    assert latex.escaped("kₐ λ Σ") == r"k\textsubscript{a} \ensuremath{\lambda} \ensuremath{\Sigma}"
    assert "begin{tabular}{llrrrrl}" in table


@pytest.mark.slow
def test_a_band_that_goes_below_zero_has_an_axis_that_shows_it(call, here):
    words = ("problem=./own_suite.py:Slope", "optimizer=./own_suite.py:Stay", "budget=9", "seeds=9", "start=random")
    assert call("run", *words, "study=s")[0] == 0
    low, middle = ResultStore("results/s").runs()["best_value"].quantile([0.25, 0.5])
    assert low < 0 < middle
    assert call("report", "results/s")[0] == 0
    page = (here / "results/s/report.html").read_text(encoding="utf-8")
    assert '"scale":"linear"' in page
    assert '"scale":"log"' not in page


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("problem.limit=none", "budget=9"), "limit=none: a finite number is needed, or null"),
        (("problem.width=true", "budget=9"), "width=true: a finite number is needed, or a list, or null"),
        (("problem.data=null", "budget=9"), "null not found. (it was given data=null)"),
        (("problem.reader=null", "budget=9"), "reader=null: names with values are needed; choices: delimiter, skip"),
        (("problem.raises=0", "budget=9"), "raises=0: true or false is needed"),
        (("problem.raises=maybe", "budget=9"), "raises=maybe: true or false is needed"),
        ((), "budget=ci (the default): problem own_suite.py:Fit does not say what ci means; give a number, such as"),
    ],
)
def test_a_message_names_all_that_an_option_takes(call, here, words, told):
    code, _, err = call("run", "problem=./own_suite.py:Fit", "optimizer=de", *words)
    assert code == 2
    assert told in err


@pytest.mark.slow
def test_the_default_of_a_class_of_ones_own_is_known_to_a_choice_of_options(call, here):
    words = ("problem=./own_suite.py:Fit", "problem.limit=range(1,7)", "optimizer=./own_suite.py:Guided", "budget=9")
    swept = ("optimizer.kind=ONE,TWO", "optimizer.reader.delimiter=';',x", "seeds=1", "study=s")
    assert call("run", "-m", *words, *swept)[0] == 0
    code, out, err = call("choose", "results/s")
    assert (code, err) == (0, "")
    assert "kind=ONE, reader.delimiter=; (default)" in out
    assert "gain over the default" in out
    assert "class" not in out
    (here / "own_suite.py").unlink()
    for registry in (problems.registry, optimizers.registry):  # as in a new process
        registry._places.clear()
        registry._by_path.clear()
    user_file.LOADED.clear()
    assert "the default is not among the settings, or its class is not here" in call("choose", "results/s")[1]


@pytest.mark.slow
def test_options_may_have_greek_names(call, here):
    words = ("problem=./own_suite.py:Greek", "optimizer=./own_suite.py:Stay", "budget=9", "seeds=1", "study=s")
    micro = "problem.\N{MICRO SIGN}_0=[3,4]"  # of a keyboard; Python's name has the letter mu
    swept = ("problem.σ=2,3", "problem.wave.λ=1,2", "problem.wave.Δt=0.5", micro)
    assert call("run", "-m", *words, *swept)[0] == 0
    runs = ResultStore("results/s").runs(options=True)
    assert {*zip(runs["prob.σ"], runs["prob.wave.λ"], strict=True)} == {(2, 1), (2, 2), (3, 1), (3, 2)}
    assert runs["best_value"].sort_values().tolist() == [2.5, 2.5, 3.5, 3.5]
    assert call("run", *words, "problem.σ=5")[0] == 0
    code, _, err = call("run", *words, "problem.wave.Δ=1")
    assert code == 2
    assert "did you mean 'Δt'?" in err
    shown = call("show", runs["run_id"].iloc[0])[1]
    assert '"σ":' in shown
    [again] = [line for line in shown.splitlines() if line.startswith("again ")]
    assert "Δt:0.5" in again
    assert call(*shlex.split(again)[2:])[0] == 0
    assert ResultStore("results/again").runs()["run_id"].tolist() == [runs["run_id"].iloc[0]]


def test_a_run_is_shown_with_the_units_of_its_parameters_and_values_of_any_size(call, here):
    assert (
        call("run", "problem=./own_suite.py:Decay", "optimizer=./own_suite.py:Stay", "budget=9", "seeds=1", "study=s")[
            0
        ]
        == 0
    )
    [row] = ResultStore("results/s").runs().to_dict("records")
    lines = call("show", row["run_id"])[1].splitlines()
    assert "  kₐ absorption       0.500000 1/h" in lines
    assert "  charge          2.000000e-09 C     true 2.500000e-09" in lines
    assert "  plain               0.500000" in lines


def test_what_has_no_jacobian_is_named_and_not_printed(call, here):
    code, _, err = call("identify", "problem=./own_suite.py:Decay")
    assert code == 2
    assert "bench: Decay has no Jacobian: identifiability needs one" in err


def test_a_column_of_an_option_that_is_a_mapping_is_read_as_it_was_typed():
    options = [json.dumps({"table": {"α": k}}) for k in (1, 2)]
    runs = pd.DataFrame(
        {"problem": "p", "problem_options": options, "optimizer": "o", "optimizer_options": "{}"}, dtype=object
    )
    assert with_options(runs)["prob.table"].tolist() == ['{"α": 1}', '{"α": 2}']
