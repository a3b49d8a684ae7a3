"""A study in the formats of others and back: what is written is exact, what is read is a study."""

import json
import re
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calibench import bench, optimizers
from calibench.bench.commands.compare import _why_none
from calibench.bench.exchange import tables as latex
from calibench.bench.exchange.coco import NOT_FINITE
from calibench.bench.exchange.mlflow_runs import _MEASURED, _metrics
from calibench.bench.exchange.studies import course_of, file_names, gap_of_level, traces_by_run, write_folder
from calibench.bench.execution.run_row import COLUMNS
from calibench.bench.statistics.fixed_target import ecdf
from calibench.bench.statistics.names import method_labels
from calibench.bench.store.runs import ResultStore
from calibench.problems.suites.black_box import COCO_GAPS
from tests.bench.exchange_studies import Falls, Raised, Trembles, mixed_study, suite_study

pytestmark = pytest.mark.usefixtures("one_process", "undrawn")


@pytest.fixture(scope="module")
def studies(tmp_path_factory):
    """Return the folder that holds the studies `suite` and `mixed`; nobody writes into these."""
    parent = tmp_path_factory.mktemp("studies")
    suite_study(parent / "suite")
    mixed_study(parent / "mixed")
    return parent


def hits_of(runs):
    key = runs[["problem", "problem_options", "data_id", "library"]].astype(str).agg("|".join, axis=1)
    columns = zip(key, runs["charged"], runs["hits_charged"], runs["targets"], strict=True)
    return sorted(((k, c, list(h), list(t)) for k, c, h, t in columns), key=str)


def test_a_course_is_exact_at_every_target_though_the_trace_is_thinned():
    problem = Raised(function=2, dimension=3)
    run = bench.execute(problem, optimizers.make("de", population=20), budget=3000, seed=1)
    row = run.row
    trace = run.trace
    held = (trace["charged"].to_numpy(np.int64), trace["best_value"].to_numpy(float))
    best = np.minimum.accumulate(problem.seen)
    first = {level: int(np.argmax(best <= level)) + 1 for level in problem.targets if best[-1] <= level}
    assert len(first) > 20
    course = course_of(row, held)
    told = {level: next(p.charged for p in course if p.value <= level) for level in first}
    assert told == first
    thinned = {level: int(held[0][np.argmax(held[1] <= level)]) for level in first}
    assert thinned != first  # the trace alone would not do
    assert course[-1].value == row["best_value"] == best[-1]
    assert course[-1].charged == row["best_evaluation"]
    assert all(a.charged < b.charged and a.value > b.value for a, b in pairwise(course))


def test_traces_are_taken_apart_by_run(studies):
    store = ResultStore(studies / "mixed")
    traces = store.traces()
    parts = traces_by_run(traces)
    assert parts.keys() == set(traces["run_id"])
    for run_id, (charged, values) in parts.items():
        own = traces[traces["run_id"] == run_id]
        assert charged.tolist() == own["charged"].tolist()
        assert values.tolist() == own["best_value"].tolist()


@pytest.mark.parametrize("minimum", [0.0, 79.48, -1000.0, 394.48])
def test_a_gap_is_told_free_of_the_rounding_of_its_level(minimum):
    assert [gap_of_level(minimum + gap, minimum) for gap in COCO_GAPS] == list(COCO_GAPS)
    assert gap_of_level(minimum + 0.123, minimum) == minimum + 0.123 - minimum


def test_coco_data_reach_each_target_when_the_run_did(studies, run_bench, tmp_path):
    assert run_bench(["export", "coco", studies / "suite", "--to", "out"])[0] == 0
    runs = ResultStore(studies / "suite").runs()
    mine = runs[(runs["optimizer"] == "de") & (runs["dimension"] == 3)]
    text = (tmp_path / "out" / "de" / "data_f1" / "bbobexp_f1_DIM3.dat").read_text()
    blocks = [np.array([line.split()[:3] for line in block.splitlines()[1:]], float) for block in text.split("% f")[1:]]
    mine = mine.assign(instance=[json.loads(o)["instance"] for o in mine["problem_options"]])
    mine = mine.sort_values(["repetition", "instance"])
    assert len(blocks) == len(mine) == 6
    for block, hits, charged in zip(blocks, mine["hits_charged"], mine["charged"], strict=True):
        assert (block[0, 0], block[-1, 0]) == (1, charged)
        first = [int(block[np.argmax(block[:, 2] <= gap), 0]) if block[-1, 2] <= gap else None for gap in COCO_GAPS]
        assert first == list(hits)
    info = (tmp_path / "out" / "de" / "bbobexp_f1.info").read_text().splitlines()
    assert info[0].startswith("suite = 'bbob', funcId = 1, DIM = 2, Precision = 1.000e-08, algId = 'de'")
    assert [part.split(":")[0] for part in info[5].split(", ")[1:]] == ["1", "2", "3"] * 2


@pytest.mark.parametrize(("name_of_format", "study"), [("coco", "suite"), ("ioh", "suite"), ("ioh", "mixed")])
def test_what_is_exported_and_imported_has_the_same_hits(studies, run_bench, name_of_format, study):
    assert run_bench(["export", name_of_format, studies / study, "--to", "there"])[0] == 0
    code, out, _ = run_bench(f"import {name_of_format} there --to back")
    assert code == 0
    before, after = ResultStore(studies / study).runs(), ResultStore("back").runs()
    assert f"{len(before)} published runs of" in out
    names = method_labels(before)
    plain = file_names(sorted(set(names)))
    before = before.assign(library=[plain[name] if name_of_format == "coco" else name for name in names])
    after = after.assign(library=after["optimizer"])
    assert hits_of(before) == hits_of(after)
    assert sorted(after["budget"]) == sorted(before["budget"])
    np.testing.assert_allclose(sorted(after["best_value"]), sorted(before["best_value"]), rtol=1e-15)
    assert after["jacobian_evaluations"].isna().all()  # not told there
    assert after["run_id"].is_unique
    assert set(ResultStore("back").traces()["run_id"]) == set(after["run_id"])


def test_a_budget_that_differs_on_one_problem_names_the_algorithm(studies):
    runs = ResultStore(studies / "mixed").runs()
    assert set(method_labels(runs)) == {"de", "lm, budget 90", "lm, budget 120"}
    other = runs["budget"].where(runs["problem"] == "full12", 77)  # differs from problem to problem alone
    told = method_labels(runs[runs["optimizer"] == "de"].assign(budget=other))
    assert set(told) == {"de"}


def test_a_failed_run_reached_nothing_and_pays(run_bench, tmp_path):
    store = suite_study(tmp_path / "s", instances=(1,), seeds=(0,), methods=("de",))
    store.write(bench.execute(Falls(), optimizers.make("de"), budget=100))
    store.collect()
    for name in ("coco", "ioh"):
        assert run_bench(f"export {name} s --to {name}")[0] == 0
        assert run_bench(f"import {name} {name} --to back_{name}")[0] == 0
        rows = ResultStore(f"back_{name}").runs()
        fallen = rows[rows["problem_options"].str.contains('"function":3')].iloc[0]
        assert fallen["charged"] == 31
        assert (fallen["status"], fallen["error_type"]) == ("failed", "NoFiniteValue")
        assert (rows.drop(index=fallen.name)["status"] == "ok").all()
        assert set(fallen["hits"]) == {None}
    lines = (tmp_path / "coco").rglob("*f3_DIM2.dat")
    values = [float(line.split()[2]) for line in next(lines).read_text().splitlines()[1:]]
    assert values == [NOT_FINITE, NOT_FINITE]


def test_a_noisy_problem_comes_back_with_its_answers_as_they_were_judged(run_bench, tmp_path):
    store = ResultStore(tmp_path / "s")
    store.open()
    for instance in (1, 2):
        problem = Trembles(instance=instance)
        store.write(bench.execute(problem, optimizers.make("de"), budget=60, start="random"))
    store.collect()
    for command in ("export ioh s --to there", "import ioh there --to back"):
        assert run_bench(command)[0] == 0
    before, after = (ResultStore(name).runs().sort_values("data_id") for name in ("s", "back"))
    assert (before["best_value"] < before["judged_value"]).all()
    for name in ("judged_value", "judged_evaluations", "hits_charged"):
        assert after[name].tolist() == before[name].tolist()


@pytest.mark.slow
def test_imported_results_stand_beside_ours_and_no_sweep_adds_to_them(studies, run_bench):
    run_bench(["export", "ioh", studies / "mixed", "--to", "there"])
    run_bench("import ioh there --to results/theirs")
    assert ResultStore("results/theirs").manifest()["imported"] == {"format": "ioh", "from": "there", "runs": 12}
    code, _, err = run_bench("run problem=sensor_zero optimizer=lm budget=50 study=theirs")
    assert (code, err.count("\n")) == (2, 1)
    assert "published results" in err
    assert len(ResultStore("results/theirs").runs()) == 12
    assert run_bench(["merge", studies / "mixed", "results/theirs", "--to", "results/both"])[0] == 0
    code, out, _ = run_bench("report results/both")
    assert code == 0
    assert "de (published=ioh)" in out
    assert ResultStore("results/both").runs()["optimizer"].nunique() == 4


COCO_2009 = """funcId = 8, DIM = 2, Precision = 1.000e-08, Fopt = 1.491500000000e+02, algId = 'old one'
% a comment of 2009
data_f8\\bbobexp_f8_DIM2.dat, 1:30|2.0e-01, 2:7|-1.4e-09"""
DATA_2009 = """% function evaluation | noise-free fitness - Fopt (1.491500000000e+02) | best noise-free fitness - Fopt
1 +9.0e+01 +9.000000000e+01 +2.391500000e+02 +2.391500000e+02 -1.0 2.0
12 +3.0e-01 +2.000000000e-01 +1.494500000e+02 +1.493500000e+02 -1.0 2.0
30 +3.0e-01 +2.000000000e-01 +1.494500000e+02 +1.493500000e+02 -1.0 2.0
% function evaluation | noise-free fitness - Fopt (1.491500000000e+02) | best noise-free fitness - Fopt
1 +1.0e+03 +1.000000000e+03 +1.149150000e+03 +1.149150000e+03 -1.0 2.0
7 -1.4e-09 -1.400000000e-09 +1.491500000e+02 +1.491500000e+02 -1.0 2.0
"""


def test_published_coco_data_of_2009_are_read(run_bench, tmp_path):
    (tmp_path / "old" / "data_f8").mkdir(parents=True)
    (tmp_path / "old" / "bbobexp_f8.info").write_text(COCO_2009)
    (tmp_path / "old" / "data_f8" / "bbobexp_f8_DIM2.dat").write_text(DATA_2009)
    code, _, err = run_bench("import coco old --to back")
    assert (code, err) == (0, "")
    rows = ResultStore("back").runs().sort_values("charged")
    assert rows["optimizer"].tolist() == ["old one"] * 2
    assert rows["charged"].tolist() == [7, 30]
    assert rows["data_id"].tolist() == ["bbob_f008_i02_d02", "bbob_f008_i01_d02"]
    assert json.loads(rows["problem_options"].iloc[0]) == {"dimension": 2, "function": 8, "instance": 2}
    first, second = (dict(zip(COCO_GAPS, hits, strict=True)) for hits in rows["hits"])
    assert (first[1e2], first[1e-8]) == (7, 7)
    assert (second[1e2], second[1e1], second[10**-0.6], second[10**-0.8]) == (1, 12, 12, None)
    assert rows["best_value"].tolist() == [149.15 - 1.4e-9, 149.15 + 0.2]
    assert rows[["budget", "wall_s", "kmrmse"]].isna().all().all()


@pytest.mark.slow
def test_published_runs_which_tell_no_budget_and_no_start_have_a_page_alone_and_beside_ours(
    studies, run_bench, tmp_path
):
    for name, last in (("old one", "7 -1.4e-09 -1.400000000e-09"), ("newer", "7 +5.0e-01 +5.000000000e-01")):
        (tmp_path / "old" / name / "data_f8").mkdir(parents=True)
        (tmp_path / "old" / name / "bbobexp_f8.info").write_text(COCO_2009.replace("old one", name))
        data = DATA_2009.replace("7 -1.4e-09 -1.400000000e-09", last)
        (tmp_path / "old" / name / "data_f8" / "bbobexp_f8_DIM2.dat").write_text(data)
    run_bench("import coco old --to results/old")
    code, _, err = run_bench("report results/old")
    assert code == 0, err
    page = Path("results/old/report.html").read_text()
    assert "Of published runs, which tell no budget, old one reaches the goal most: in 1 of 2 runs" in page
    assert "from starts that are not told" in page
    assert "evaluations a run, at most" not in page
    assert run_bench(["merge", studies / "mixed", "results/old", "--to", "results/both"])[0] == 0
    code, _, err = run_bench("report results/both")
    assert code == 0, err
    page = Path("results/both/report.html").read_text()
    assert "and of 4 published runs none told (the answer leaves them out)" in page
    assert "what they spent was counted by those who published them" in page
    store = ResultStore("results/old")
    table = ecdf(store.hits(), store.runs(), by=["problem"])
    assert len(table.merge(store.runs(), on=["optimizer", "start"]))  # the same type of column in both
    code, _, err = run_bench("export ioh results/old --to there")
    assert code == 0, err
    assert "NaN" not in next(Path("there").rglob("*.json")).read_text()
    run_bench("import ioh there --to results/again")
    again = ResultStore("results/again").runs()
    assert again[["start", "budget"]].isna().all().all()
    assert sorted(again["charged"]) == sorted(store.runs()["charged"])
    code, _, err = run_bench(["compare", "results/both", "--methods", "newer", "lm"])
    assert (code, err.count("\n")) == (2, 1)
    assert "problem is" in err


def test_compare_says_of_published_runs_that_their_start_is_not_told(run_bench, tmp_path):
    (tmp_path / "old" / "data_f8").mkdir(parents=True)
    (tmp_path / "old" / "bbobexp_f8.info").write_text(COCO_2009)
    (tmp_path / "old" / "data_f8" / "bbobexp_f8_DIM2.dat").write_text(DATA_2009)
    run_bench("import coco old --to results/old")
    ours = ResultStore("results/old").runs().iloc[:1].assign(optimizer="ours", start="random", budget=30)
    assert _why_none(ResultStore("results/old").runs(), ours, any_method=True) == (
        "start is not told in A and random in B"
    )


@pytest.mark.parametrize("suite", ["unknown_suite", "CEC2022"])
def test_published_functions_of_cec_2022_are_those_of_our_suite(run_bench, tmp_path, suite):
    (tmp_path / "theirs" / "data").mkdir(parents=True)
    runs = [{"instance": 1, "evals": 60, "best": {"evals": 38, "y": 2.5, "x": [0.5] * 10}}]
    scenarios = [{"dimension": 10, "path": "data/f.dat", "runs": runs}]
    told = IOH | {"suite": suite, "function_id": 1001, "function_name": "CEC2022Zakharov", "scenarios": scenarios}
    (tmp_path / "theirs" / "f.json").write_text(json.dumps(told))
    (tmp_path / "theirs" / "data" / "f.dat").write_text("evaluations raw_y\n1 9.0\n38 2.5\n")
    assert run_bench("import ioh theirs --to back")[0] == 0
    row = ResultStore("back").runs().iloc[0]
    assert json.loads(row["problem_options"]) == {"dimension": 10, "function": 1, "instance": 1, "suite": "CEC2022"}
    assert row["data_id"].removesuffix("_gap") == "CEC2022_f1_i1_d10"
    assert row["best_value"] - row["minimum"] == 2.5


def test_data_of_an_earlier_ioh_profiler_are_refused_by_their_format(run_bench, tmp_path):
    (tmp_path / "there" / "EA").mkdir(parents=True)
    told = "suite = 'PBO', funcId = 1, DIM = 100, algId = 'EA'\n%\ndata_f1/IOHprofiler_f1_DIM100_i1.dat, 1:5|1.0e+02\n"
    (tmp_path / "there" / "EA" / "IOHprofiler_f1_i1.info").write_text(told)
    code, _, err = run_bench("import ioh there --to back")
    assert (code, err.count("\n")) == (2, 1)
    assert "IOHprofiler_f1_i1.info: is of an earlier IOHprofiler, whose .info files are not read; JSON is" in err


IOH = {
    "version": "0.3.22", "suite": "unknown_suite", "function_id": 1, "function_name": "Sphere", "maximization": False,
    "algorithm": {"name": "rand", "info": "info"}, "attributes": ["evaluations", "raw_y"],
    "scenarios": [{"dimension": 2, "path": "data_f1_Sphere/IOHprofiler_f1_DIM2.dat", "runs": [
        {"instance": 1, "evals": 60, "best": {"evals": 38, "y": 0.23178725017826438, "x": [-0.5, 0.25]}},
        {"instance": 1, "evals": 9, "best": {"evals": 5, "y": 0.6193441596009968, "x": [-3.5, -2.0]}},
    ]}],
}  # fmt: skip


def test_published_ioh_data_are_read(run_bench, tmp_path):
    (tmp_path / "theirs" / "data_f1_Sphere").mkdir(parents=True)
    (tmp_path / "theirs" / "IOHprofiler_f1_Sphere.json").write_text(json.dumps(IOH))
    data = "evaluations raw_y\n1 2.5590672939\n13 0.8119343852\n38 0.2317872502\n1 99.0\n5 0.6193441596\n"
    (tmp_path / "theirs" / "data_f1_Sphere" / "IOHprofiler_f1_DIM2.dat").write_text(data)
    assert run_bench("import ioh theirs --to back")[0] == 0
    rows = ResultStore("back").runs().sort_values("charged")
    assert rows["charged"].tolist() == [9, 60]
    assert rows["repetition"].tolist() == [1, 0]
    assert rows["best_evaluation"].tolist() == [5, 38]
    np.testing.assert_allclose(
        rows["best_value"] - rows["minimum"], [0.6193441596009968, 0.23178725017826438], rtol=1e-12
    )
    assert dict(zip(COCO_GAPS, rows["hits"].iloc[0], strict=True))[1.0] == 5
    assert json.loads(rows["problem_options"].iloc[0])["suite"] == "BBOB"


def test_csv_gives_back_the_same_bits(studies, run_bench):
    assert run_bench(["export", "csv", studies / "mixed", "--to", "tables"])[0] == 0
    store = ResultStore(studies / "mixed")
    read = {name: pd.read_csv(f"tables/{name}.csv", dtype=str) for name in ("runs", "traces", "hits", "summary")}
    runs = store.runs()
    assert list(read["runs"]) == [column.name for column in COLUMNS]
    for column in COLUMNS:
        told, ours = read["runs"][column.name], runs[column.name]
        if column.parquet.startswith("list"):
            found = [None if value != value else json.loads(value) for value in told]
            assert found == [None if value is None else list(value) for value in ours], column.name
        elif column.parquet in ("double", "int64"):
            np.testing.assert_array_equal(floats(told), ours.to_numpy(float))
        elif column.parquet == "string":
            assert told.fillna("").tolist() == ours.fillna("").tolist()
    np.testing.assert_array_equal(floats(read["traces"]["best_value"]), store.traces()["best_value"])
    charged = [hit for hits in runs["hits_charged"] for hit in hits]
    assert [None if hit != hit else int(hit) for hit in read["hits"]["charged"]] == charged
    assert len(read["summary"]) == 6
    readme = Path("tables/README.md").read_text()
    assert all(f"| {column.name} | {column.parquet} | {column.meaning} |" in readme for column in COLUMNS)


def floats(column):
    return np.array([float(text) if isinstance(text, str) else np.nan for text in column])


def test_latex_prints_every_sign():
    text = latex.escaped("a_b & 50% #1 $x$ {y} ~ ^ \\ <z> |w| \"q\" 'r' `s` [t] -- …")
    bare = text
    for known in set(latex._SPECIAL.values()):
        bare = bare.replace(known, "")
    assert not set(bare) & set("\\{}$&#%_^~<>|\"'`[]…")
    assert latex.escaped("two\nlines") == "two lines"


def test_the_table_in_latex_has_a_line_a_cell(studies, run_bench, tmp_path):
    assert run_bench(["export", "latex", studies / "suite", "--to", "tex"])[0] == 0
    lines = (tmp_path / "tex" / "summary.tex").read_text().splitlines()
    body = lines[lines.index(r"\midrule") + 1 : lines.index(r"\bottomrule")]
    assert len(body) == 18
    columns = lines[0].split("{")[-1].rstrip("}")
    assert {line.count(" & ") + 1 for line in body} == {len(columns)}
    assert all(line.endswith(r" \\") for line in body)
    assert r"nlopt\_LN\_BOBYQA" in body[0] + body[1]
    assert latex.latex_table(pd.concat([pd.DataFrame({"problem": ["x"]})] * 46)).startswith(r"\begin{longtable}{l}")
    if shutil.which("pdflatex"):
        subprocess.run(["pdflatex", "-interaction=batchmode", "-halt-on-error", "document.tex"], cwd="tex", check=True)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("export", "--to OUT is needed"),
        ("export csv STUDY", "--to OUT is needed"),
        ("export csv STUDY --to", "--to OUT is needed"),
        ("export csv --to out", "one STUDY_DIR"),
        ("export cvs STUDY --to out", "unknown format 'cvs'"),
        ("export csv nowhere --to out", "no such study folder"),
        ("export csv empty --to out", "no manifest.json"),
        ("export csv STUDY --to full", "not empty"),
        ("export ioh STUDY --to a_file", "is a file"),
        ("export coco STUDY --to out", "no suite for full12, sensor_zero"),
        ("export mlflow STUDY --to out", "calibench[mlflow]"),
        ("export csv STUDY --to out --fast", "unknown flag"),
        ("import coco nowhere --to out", "no such folder"),
        ("import coco empty --to out", "no .info file"),
        ("import ioh empty --to out", "no IOHprofiler description"),
        ("import csv empty --to out", "unknown format 'csv'"),
        ("import coco broken --to out", "line 3: is no line of COCO data"),
        ("import coco absent --to out", "is not there"),
        ("import coco objectives --to out", "several objectives"),
        ("import ioh broken --to out", "is not JSON"),
        ("import coco empty --to full", "not empty"),
    ],
)
def test_a_mistake_is_one_line_and_nothing_is_written(studies, run_bench, tmp_path, monkeypatch, words, said):
    monkeypatch.setitem(sys.modules, "mlflow", None)
    for folder in ("empty", "full/within", "broken/data_f8", "absent", "objectives"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "a_file").write_text("")
    for folder in ("broken", "absent"):
        (tmp_path / folder / "bbobexp_f8.info").write_text(COCO_2009)
    (tmp_path / "broken" / "data_f8" / "bbobexp_f8_DIM2.dat").write_text(DATA_2009.replace("+2.000000000e-01", "+2.0x"))
    (tmp_path / "broken" / "half.json").write_text("{")
    (tmp_path / "objectives" / "a.info").write_text(
        "indicator = 'hyp', function = 1, dim = 2, x = 1\n%\na.dat, 1:3|1.0"
    )
    before = sorted(tmp_path.rglob("*"))
    code, out, err = run_bench([str(studies / "mixed") if word == "STUDY" else word for word in words.split()])
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert said in err
    assert sorted(tmp_path.rglob("*")) == before


def test_an_export_that_breaks_off_leaves_nothing(tmp_path):
    def fill(folder):
        (folder / "half.csv").write_text("1,")
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="full"):
        write_folder(tmp_path / "out", fill)
    assert list(tmp_path.iterdir()) == []


def test_names_of_folders_are_plain_and_differ():
    names = file_names(["de (a=1)", "de [a=1]", "DE_a=1", "ß/../x"])
    assert len({name.lower() for name in names.values()}) == 4
    assert all(name == name.strip("._") and "/" not in name for name in names.values())


def metrics_of_targets(**row):
    told = dict.fromkeys(_MEASURED) | {"charged": 90, "status": "ok", "minimum": None} | row
    return {name: value for name, value, _ in _metrics(told, []) if name.startswith("charged_to_")}


def test_mlflow_gets_a_metric_for_each_target_under_a_name_that_it_takes():
    """Beside a minimum of 394.48 most of COCO's 51 targets have the same six digits; MLflow takes no plus sign."""
    levels = [394.48 + gap for gap in COCO_GAPS]
    hits = list(range(1, len(levels) + 1))
    found = metrics_of_targets(targets=levels, hits_charged=hits, minimum=394.48)
    assert sorted(found.values()) == hits
    assert found["charged_to_gap_1e-08"] == len(levels)
    assert found["charged_to_gap_100"] == 1
    close = metrics_of_targets(targets=[1e6, 79.48000002, 79.48000001], hits_charged=[1, 2, 3])
    assert sorted(close.values()) == [1, 2, 3]
    for name in (*found, *close, *metrics_of_targets(targets=[1e7, 1.0], hits_charged=[1, 2])):
        assert re.fullmatch(r"[\w.\- :/]+", name), name
    assert metrics_of_targets(targets=[1e-12], hits_charged=[7]) == {"charged_to_1e-12": 7}
    assert metrics_of_targets(targets=[1.0], hits_charged=[7], status="failed") == {}, "a failed run reached nothing"
