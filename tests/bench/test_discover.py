"""`bench discover` as a user meets it: a verdict a set, one line of JSON a set, tables, pages, resumed searches."""

import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from jsonschema import Draft202012Validator

from benchmarks.blind.gpm2002.record import table_of
from benchmarks.blind.gpm2002.simulate import case
from benchmarks.blind.malformed import SPOILED
from calibench import bench, discrepancy, optimizers
from calibench.bench.cli import main
from calibench.bench.discovery import batch
from calibench.bench.discovery.batch import with_advice
from calibench.bench.discovery.store import FINDINGS_SCHEMA, GAPS_SCHEMA
from calibench.bench.measured.files import read_measured
from calibench.bench.measured.sources import sources
from calibench.bench.store.arrays import to_pandas
from calibench.bench.store.runs import ResultStore
from calibench.discrepancy.design.detectability import WhitenedDesign
from calibench.discrepancy.machines.gpm2002.description import planned, reachable
from tests.few import few

CONTRACT = {
    "schema_version", "case", "machine", "verdict", "findings", "gap", "where", "not_testable", "invisible",
    "parameters", "seconds",
}  # fmt: skip
ORIGIN = ["git_commit", "git_dirty", "versions", "platform", "started_at", "seconds"]


def call(words, capsys):
    """Run a command in this process; return its exit code, what it printed, and what it complained of."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        main(words.split())
    out = capsys.readouterr()
    return ended.value.code, out.out, out.err


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two sets that can be read and one that cannot."""
    folder = tmp_path_factory.mktemp("data")
    for name in ("demo_backlash", "demo_nothing"):
        shutil.copy(sources(name, "gpm2002")[0].path, folder)
    (folder / "broken.parquet").write_bytes(b"no parquet")
    return folder


@pytest.fixture(scope="module")
def results(folder, tmp_path_factory):
    """The results of searching them, with pages."""
    results = tmp_path_factory.mktemp("results")
    with pytest.raises(SystemExit) as ended:
        main(f"discover machine=gpm2002 data={folder} results={results} pages=all".split())
    assert ended.value.code == 1
    return results


def test_the_verdict_is_a_sentence_with_size_interval_and_unit(results, folder, capsys):
    code, out, _ = call(f"discover machine=gpm2002 data={folder} results={results}", capsys)
    assert code == 1
    assert re.search(r"backlash of joint 2, 0\.2\d+ mrad \(95 %: 0\.2\d+ to 0\.2\d+ mrad; 0\.01\d+°\)", out)
    assert "Nothing is missing from the model that these data could show." in out
    assert "broken.parquet: is no Parquet file that can be read" in out
    assert "demo_backlash (gpm2002, searched before, 20" in out
    assert "1 searched, 2 searched before (--retry searches again), 1 failed" in out


def test_a_search_has_one_digest_before_and_after_its_code_was_loaded():
    script = (
        "from calibench import discrepancy; from calibench.bench.discovery.batch import search_digest as digest; "
        "machine = discrepancy.machines.make('gpm2002'); first = digest(machine); "
        "import calibench.discrepancy.procedure; assert digest(machine) == first"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_the_digest_of_a_search_is_of_the_code_that_makes_its_effects(monkeypatch):
    modules = set()

    def seen(part):
        modules.add(getattr(part, "__module__", ""))
        return ""

    monkeypatch.setattr(batch, "digest_of", seen)
    batch.search_digest(discrepancy.machines.make("gpm2002"))
    general = {f"calibench.discrepancy.effects.general.{room}" for room in ("joints", "columns")}
    assert modules >= {"calibench.discrepancy.machines.gpm2002.effects", *general}


def test_a_search_that_takes_long_says_on_the_terminal_that_it_goes_on(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(batch, "_SOON", 0.01)
    _, _, err = call(f"discover machine=gpm2002 data=demo_backlash results={tmp_path} pages=none", capsys)
    assert err.startswith("  searching demo_backlash, ")


def test_json_is_a_line_a_file_in_order_and_nothing_else(results, folder, capsys):
    code, out, _ = call(f"discover machine=gpm2002 data={folder} results={results} --json", capsys)
    assert code == 1
    lines = [json.loads(line) for line in out.splitlines()]
    assert [line["case"] for line in lines] == ["broken", "demo_backlash", "demo_nothing"]
    assert set(lines[0]) == {"schema_version", "case", "machine", "error", "seconds"}
    assert set(lines[1]) >= CONTRACT
    [finding] = lines[1]["findings"]
    assert (finding["effect"], finding["family"], finding["target"]) == ("backlash joint 2", "backlash", "joint 2")
    low, high = finding["amplitude"]["ci95"]
    assert low < 0.000242 < high
    assert lines[2]["findings"] == []


def test_every_line_and_every_report_json_is_as_the_schema_says(results, folder, capsys):
    validator = Draft202012Validator(bench.report_schema())
    _, out, _ = call(f"discover machine=gpm2002 data={folder} results={results} --json", capsys)
    reports = [path.read_text() for path in (results / "discover").glob("*/report.json")]
    assert len(reports) == 3
    for text in (*reports, *out.splitlines()):
        validator.validate(json.loads(text))


def test_a_search_is_done_once_for_the_same_data_and_options(folder, tmp_path, capsys):
    shutil.copy(folder / "demo_nothing.csv", tmp_path / "run.csv")
    command = f"discover machine=gpm2002 data={tmp_path}/run.csv results={tmp_path}/results pages=none"
    said = [call(command, capsys)[1] for _ in range(2)]
    said.append(call(f"{command} --retry", capsys)[1])
    said.append(call(f"{command} sigma_enc=1e-4", capsys)[1])
    said.append(call(f"{command} sigma_enc=1e-4", capsys)[1])
    with open(tmp_path / "run.csv", "a") as file:
        file.write("\n")
    said.append(call(f"{command} sigma_enc=1e-4", capsys)[1])
    assert ["searched before" in out for out in said] == [False, True, False, False, True, False]


def test_the_tables_have_a_row_a_finding_and_a_row_a_case(results):
    folder = results / "discover"
    findings, gaps = (to_pandas(pq.read_table(folder / f"{name}.parquet")) for name in ("findings", "gaps"))
    assert gaps["case"].tolist() == ["broken", "demo_backlash", "demo_nothing"]
    assert gaps["status"].tolist() == ["failed", "ok", "ok"]
    assert findings["effect"].tolist() == ["backlash joint 2"]
    report = json.loads((results / "discover" / "demo_backlash" / "report.json").read_text())
    row = findings.iloc[0]
    assert [row["amplitude_low"], row["amplitude_high"]] == report["findings"][0]["amplitude"]["ci95"]
    assert gaps.loc[1, "held_out_after"] == report["gap"]["held_out_after"]
    assert next(iter(row["set"]))["weight"] == pytest.approx(1)
    for name, schema in (("findings", FINDINGS_SCHEMA), ("gaps", GAPS_SCHEMA)):
        table = pq.read_table(results / "discover" / f"{name}.parquet")
        assert table.schema.remove_metadata() == schema
        assert json.loads(table.schema.metadata[b"calibench"])["schema_version"] == 1
    for frame in (findings, gaps):
        assert not [name for name, kind in frame.dtypes.items() if kind == np.dtype(object)]
        assert frame["started_at"].notna().all()


def test_the_rows_are_the_same_with_any_number_of_workers(results, folder, tmp_path, capsys):
    call(f"discover machine=gpm2002 data={folder} results={tmp_path} pages=none execution=processes", capsys)
    for table in ("findings", "gaps"):
        one, two = (pd.read_parquet(r / "discover" / f"{table}.parquet").drop(columns=ORIGIN, errors="ignore")
                    for r in (results, tmp_path))  # fmt: skip
        pd.testing.assert_frame_equal(one, two)


def test_the_page_stands_alone(results):
    text = (results / "discover" / "demo_backlash" / "report.html").read_text()
    outside = re.findall(r'(?:src|href|url)\s*[=(]\s*["\']?(?!#|data:)[^"\')>\s]+', text.replace('xlink:href="#', ""))
    assert not outside, outside
    assert "<script" not in text
    assert "backlash of joint 2, 0.2" in text
    headings = re.findall("<h2>(.*?)</h2>", text)
    assert headings[:5] == [
        "Where model and data disagree", "Which effect", "The residual, before and after",
        "The gap, on readings that were not fitted", "The calibrated parameters",
    ]  # fmt: skip
    assert headings[-2:] == ["What these data could not tell", "Where this comes from"]
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', text))
    assert used <= set(ids)


def test_the_page_of_nothing_missing_says_what_would_have_been_seen(results):
    text = (results / "discover" / "demo_nothing" / "report.html").read_text()
    assert "Nothing is missing from the model that these data could show." in text
    assert "The smallest size that would have been seen" in text


def test_every_drawing_comes_with_its_numbers(results):
    figures = results / "discover" / "demo_backlash" / "figures"
    stems = {path.stem for path in figures.iterdir()}
    assert stems >= {"where", "workspace", "candidates", "residuals_1", "gap"}
    assert {f"{s}.{e}" for s in stems for e in ("svg", "png", "csv")} == {path.name for path in figures.iterdir()}
    report = json.loads((results / "discover" / "demo_backlash" / "report.json").read_text())
    gap = pd.read_csv(figures / "gap.csv")
    assert gap["rms"].tolist() == [report["gap"]["held_out_before"], report["gap"]["held_out_after"]]
    candidates = pd.read_csv(figures / "candidates.csv")
    assert candidates.loc[candidates["in_set"], "effect"].tolist() == ["backlash joint 2"]
    assert candidates["gain"].is_monotonic_decreasing


def test_the_residuals_show_the_play_before_and_nothing_after(results):
    means = pd.read_csv(results / "discover" / "demo_backlash" / "figures" / "residuals_1.csv").set_index("value")
    step = means.loc[1] - means.loc[-1]
    assert abs(step["before"]) == pytest.approx(0.242, rel=0.25)  # mrad; calibration has swallowed a part of it
    assert abs(step["after"]) < 4 * means["standard_error"].max()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("", "machine= is missing: a machine"),
        ("machine=gpm2002", "data= is missing"),
        ("machine=gpm2001 data=x", "did you mean 'gpm2002'?"),
        ("machine=gpm2002 data=nothing.parquet", "nothing.parquet: there is no such file"),
        ("machine=gpm2002 data=demo_backlsh", "did you mean 'demo_backlash'?"),
        ("machine=gpm2002 data=demo_nothing sigma_en=1e-5", "did you mean 'sigma_enc'?"),
        ("machine=gpm2002 data=demo_nothing sigma_enc=-1", "sigma_enc=-1: a number above 0 is needed"),
        ("machine=gpm2002 data=demo_nothing sigma_enc=", "sigma_enc needs a value"),
        ("machine=gpm2002 data=demo_nothing machine.free=rho", "gpm2002 has no option 'free'"),
        ("machine=gpm2002 data=demo_nothing execution=slrum", "execution=slrum"),
        ("machine=gpm2002 data=demo_nothing pages=some", "pages=some"),
        ("machine=gpm2002 data=demo_nothing study=a/b", "study=a/b"),
        ("machine=gpm2002 data=demo_nothing nominal=3", "nominal=3: a JSON object is needed"),
        ("machine=table data=demo_enso sigma=3", "sigma= is nothing that table reads; machine.sigma= is its option"),
        ("machine=table data=demo_enso back=3", "unknown argument 'back'; machine.back= is its option"),
        ("machine=table data=demo_enso machine.back=3 machine.back=4", "machine.back is given twice"),
        ("machine=table data=demo_enso machine.start={c:3}", "constant has no parameter 'c'; choices: b0"),
        ("machine=gpm2002 data=demo_nothing data.sigma_enc=1e-5 data.sigma_enc=2e-5", "data.sigma_enc is given twice"),
        ("machine=gpm2002 data=demo_nothing execution.n_jobs=2", "execution=serial is one process; add"),
        ("machine=gpm2002 data=demo_nothing --jsn", "did you mean '--json'?"),
        ("machine=orthoglide data=demo_nothing", "exp1"),
        ("gpm2002", "'gpm2002' is no argument"),
    ],
)
def test_a_wrong_request_is_one_line_and_writes_nothing(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code, out, err = call(f"discover {words}", capsys)
    assert (code, out) == (2, "")
    assert said in err
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_single_set_that_cannot_be_used_is_a_wrong_request(tmp_path, capsys):
    (tmp_path / "x.csv").write_text("enc_1,enc_2\n1,2\n")
    code, out, err = call(f"discover machine=gpm2002 data={tmp_path}/x.csv results={tmp_path}/r sigma_enc=5e-5", capsys)
    assert (code, out) == (2, "")
    assert "enc_3" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "r").exists()


def test_other_verbs_say_what_a_study_of_discover_is(results, capsys):
    for verb in ("report", "status", "collect"):
        code, _, err = call(f"{verb} {results}/discover", capsys)
        assert code == 2
        assert "is a study of bench discover" in err
    code, _, err = call(f"show 3f results={results}", capsys)
    assert code == 2
    assert "no run" in err


def test_a_folder_of_runs_is_not_taken_for_discoveries(tmp_path, capsys):
    ResultStore(tmp_path / "adhoc").open()
    code, _, err = call(f"discover machine=gpm2002 data=demo_nothing results={tmp_path} study=adhoc", capsys)
    assert code == 2
    assert "is no study of bench discover" in err


def test_the_model_of_a_report_is_a_problem_for_the_optimisers():
    data = sources("demo_backlash", "gpm2002")[0].read({})
    report = discrepancy.explain("gpm2002", data)
    run = bench.execute(report.model, optimizers.make("lm"), budget=2000, seed=0)
    assert run.status == "ok"
    assert run.best_value <= report.model(report.model.best) * (1 + 1e-6)


def test_a_machine_of_ones_own_is_searched_by_its_path(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    home = "calibench.discrepancy.machines.gpm2002.formulation"
    (tmp_path / "my_machine.py").write_text(f"from {home} import Gpm2002 as Mine")
    code, out, err = call("discover machine=my_machine:Mine data=demo_nothing pages=none", capsys)
    sys.modules.pop("my_machine", None)
    assert code == 0, err
    assert "demo_nothing (gpm2002)" in out
    options = json.loads(pq.read_table("results/discover/gaps.parquet")["options"][0].as_py())
    assert options["machine"]["name"] == "my_machine:Mine"


def spoil(folder, names):
    for k, name in enumerate(names):
        spoiled = SPOILED[name](case(3 + k))
        pq.write_table(table_of(spoiled.columns, spoiled.metadata), folder / f"{name}.parquet")


@pytest.mark.slow
@pytest.mark.parametrize(
    "names",
    [
        ["encoder_missing", "degrees", "rows_none", "metadata_missing", "words_for_numbers"],
        pytest.param(list(SPOILED), marks=pytest.mark.slow),
    ],
    ids=["some", "all"],
)
def test_spoilt_files_are_lines_of_json_and_never_a_traceback(names, tmp_path, capsys):
    spoil(tmp_path, names)
    code, out, err = call(
        f"discover machine=gpm2002 data={tmp_path} results={tmp_path}/results pages=none --json", capsys
    )
    assert code == 1
    lines = [json.loads(line) for line in out.splitlines()]
    assert [line["case"] for line in lines] == sorted(names)
    assert "Traceback" not in err
    for line in lines:
        assert ("error" in line) != ("verdict" in line)
        if "error" in line:
            assert line["error"]
            assert "\n" not in line["error"]


def test_the_demonstrations_are_small():
    for name in ("demo_backlash", "demo_twins", "demo_unknown", "demo_nothing", "demo_warm", "demo_warm_tracked"):
        path = sources(name, "gpm2002")[0].path
        assert path.stat().st_size < 60_000
        assert np.isfinite(read_measured(path, "gpm2002")["enc_1"]).all()


@pytest.fixture(scope="module")
def warm(at_one_noise):
    """Return readings of angles alone, of links that grow as they warm, and what is said of them."""
    made = case(0, family="thermal_links", lam=2.0, noise="gauss", xy=False)
    data = discrepancy.MeasuredData(made.columns, "gpm2002", made.metadata)
    return data, discrepancy.explain("gpm2002", data)


def test_rivals_that_a_tracker_would_tell_apart_come_with_that_advice(warm):
    data, report = warm
    first = with_advice(report, data, discrepancy.machines.make("gpm2002")).findings[0]
    assert {rival.family for rival in first.set} == {"thermal_links", "thermal_base"}
    said = r"tracker in the same run \(x, y to 0.02 mm\) would tell .* \(from ([\d.]+) to ([\d.]+) standard deviations"
    told = re.search(said, first.separated_by)
    assert told is not None
    assert float(told[1]) < 1
    assert float(told[2]) > 4


def test_a_machine_that_reaches_no_place_is_told_where_readings_are_to_be_proposed(monkeypatch, warm):
    """An encoder that counted backwards ended the command: the plan of a radius that nobody had stated was refused."""
    machine = discrepancy.machines.make("gpm2002")
    formulation = machine.formulate(planned(n=40))
    with pytest.raises(discrepancy.DataError, match="reaches no place within") as refused:
        reachable(formulation, WhitenedDesign(formulation).q | {"xa1": 1e6})
    monkeypatch.setattr(batch, "next_poses", Mock(side_effect=refused.value))
    data, report = warm
    first = with_advice(report, data, machine).findings[0]
    assert "no further readings could be planned that tell" in first.separated_by
    assert "reaches no place within" in first.separated_by


def test_rivals_of_a_machine_with_options_are_asked_of_that_very_machine():
    read = read_measured(sources("demo_play", "arm")[0].path, "arm")
    told = {name: value for name, value in read.metadata.items() if name != "urdf"}
    data = discrepancy.MeasuredData(read.columns, "arm", told)
    machine = discrepancy.machines.make("arm", urdf="six")  # without its URDF there is no arm
    report = discrepancy.explain(machine, data)
    [finding] = report.findings
    other = replace(finding.set[0], effect="backlash lift", target="lift")
    rivals = replace(report, findings=(replace(finding, set=(*finding.set, other)),))
    assert with_advice(rivals, data, machine).findings[0].set[1] is other


@pytest.mark.parametrize(
    ("family", "seed", "shown"),
    few(
        1,
        [
            ("outlier", 14, "two stated deviations, ±"),
            pytest.param("quantisation", 15, "readings without steps", marks=pytest.mark.slow),
            ("heavy_tails", 16, "Gaussian noise"),
        ],
    ),
)
def test_a_finding_that_blames_the_noise_has_an_interval_a_sentence_and_a_chart(family, seed, shown, tmp_path, capsys):
    made = case(seed, family=family, lam=3.0, xy=False)
    pq.write_table(table_of(made.columns, made.metadata), tmp_path / "run.parquet")
    code, out, _ = call(f"discover machine=gpm2002 data={tmp_path}/run.parquet results={tmp_path}/results", capsys)
    assert code == 0
    assert "The noise is not as stated" in out
    folder = tmp_path / "results/discover/run"
    report = json.loads((folder / "report.json").read_text())
    [finding] = report["findings"]
    assert finding["family"] == family
    low, high = finding["amplitude"]["ci95"]
    assert low <= finding["amplitude"]["value"] <= high
    page = (folder / "report.html").read_text()
    assert "<h2>The noise</h2>" in page
    assert shown in page
    numbers = pd.read_csv(folder / "figures/noise_1.csv")
    if family == "outlier":
        struck = numbers["error_mrad"][numbers["outlying"]].abs()
        assert 0 < len(struck) < 0.25 * len(numbers)
        assert struck.median() > 1e3 * 5 * made.metadata["sigma_enc"]
    elif family == "quantisation":
        assert numbers["readings"].max() == numbers["readings"].sum()  # all at one place between two steps
    else:
        assert numbers["size"].max() > 5


def test_what_is_invisible_is_an_instance_with_its_family():
    plan, rng = planned(n=40), np.random.default_rng(1)
    read = {f"enc_{i}": plan[f"enc_{i}"] + 5e-5 * rng.normal(size=len(plan)) for i in (1, 2, 3)}
    report = discrepancy.explain("gpm2002", plan.with_columns(read)).to_dict()
    assert report["invisible"]
    for hidden in report["invisible"]:
        assert hidden["effect"] == f"{hidden['family']} {hidden['target']}"


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("name = 'nut'", "it has no formulate(data)"),
        ("def formulate(self, data): return None", 'it has no name; name = "..."'),
    ],
)
@pytest.mark.parametrize("command", ["discover", "design"])
def test_a_class_that_is_no_machine_is_told_in_a_line(command, body, said, tmp_path, monkeypatch, capsys):
    stem = f"{command}_half_{len(body)}"  # one process has one file of a name
    (tmp_path / f"{stem}.py").write_text(f"class Half:\n    {body}\n")
    (tmp_path / "run.csv").write_text("x\n1\n2\n")
    monkeypatch.chdir(tmp_path)
    code, out, complaint = call(f"{command} machine={stem}.py:Half data=run.csv", capsys)
    assert (code, out) == (2, "")
    assert said in complaint
    assert len(complaint.splitlines()) == 1


@pytest.mark.parametrize(("verb", "code"), [("discover", 1), ("design", 2)])
def test_a_fault_in_a_machine_of_ones_own_is_told_with_its_line(verb, code, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / f"own_{verb}.py").write_text(
        "class Mine:\n    name = 'mine'\n\n    def formulate(self, data):\n        return self.scale * 2\n"
    )
    (tmp_path / "run.csv").write_text("enc_1,x\n0.5,1.0\n0.6,2.0\n")
    ended, out, err = call(f"{verb} machine=./own_{verb}.py:Mine data=run.csv", capsys)
    assert ended == code
    assert f"AttributeError: 'Mine' object has no attribute 'scale' (own_{verb}.py, line 5)" in out + err
    assert "Traceback" not in out + err
