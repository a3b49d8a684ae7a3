"""The reference: what is kept of a full run holds to the data files, to its schemas, and to itself."""

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.cli import main
from calibench.bench.papers import pashkevich2008
from calibench.bench.papers.ledger import LEDGER_SCHEMA, Evidence, quantities
from calibench.bench.papers.rerun import check_folder, study_tables, thinned, write_printed, write_reference
from calibench.bench.store.arrays import RUNS_SCHEMA, TRACES_SCHEMA
from calibench.bench.store.manifest import StoreError
from calibench.bench.store.runs import ResultStore
from tests.few import few

COMMITTED = Path(__file__).parents[2] / "results" / "reference"
FOLDERS = ["made now", *(["committed"] if (COMMITTED / "ledger.parquet").exists() else [])]
PAPERS = ("cong2008", "pashkevich2008")


@pytest.fixture(scope="module")
def evidence(tmp_path_factory):
    store = ResultStore(tmp_path_factory.mktemp("results") / "cong2008")
    store.open()
    for error in ("J1", "J2", "J3"):
        for method in ("ga", "pso", "de", "trf"):
            for seed in range(2):
                p = problems.make("full12", error=error)
                store.write(bench.execute(p, optimizers.make(method), budget=3000, seed=seed))
    return Evidence(store.runs(), store.traces())


@pytest.fixture(scope="module")
def rows(evidence):
    return list(pashkevich2008.rows(evidence))


@pytest.fixture(scope="module")
def made(evidence, rows, tmp_path_factory):
    folder = tmp_path_factory.mktemp("kept") / "reference"
    write_reference(rows, [evidence], "budget=3000 seeds=2", folder)
    return folder


@pytest.fixture(params=few(1, FOLDERS))
def folder(request, made):
    return made if request.param == "made now" else COMMITTED


def studies(folder):
    return [ResultStore(path.parent) for path in sorted(folder.glob("*/manifest.json"))]


def test_the_printed_numbers_committed_are_those_of_the_data_files(tmp_path):
    assert (COMMITTED / "printed.csv").read_text() == write_printed(PAPERS, tmp_path / "printed.csv").read_text()


def test_the_ledger_has_its_schema_and_prints_what_the_data_files_do(folder):
    table = pq.read_table(folder / "ledger.parquet")
    assert table.schema.equals(LEDGER_SCHEMA, check_metadata=False)
    ledger = table.to_pandas()
    printed = pd.read_csv(folder / "printed.csv")
    for paper in printed["paper"].unique():
        mine = ledger[(ledger["paper"] == paper) & ~ledger["key"].str.match(r"claim\.|erratum\.")].set_index("key")
        expected = quantities(paper)
        assert sorted(mine.index) == sorted(expected)
        for key, entry in expected.items():
            assert (mine.at[key, "printed"], mine.at[key, "read"]) == (entry.printed, entry.value)
    assert pd.read_csv(folder / "ledger.csv")["key"].tolist() == ledger["key"].tolist()
    told = (folder / "README.md").read_text()
    for verdict, count in ledger["verdict"].value_counts().items():
        assert f"| {verdict} | {count} |" in told


def test_the_rows_have_their_schema_and_no_clock(folder):
    assert studies(folder)
    for store in studies(folder):
        runs = pq.read_table(store.folder / "runs.parquet")
        assert runs.schema.equals(RUNS_SCHEMA, check_metadata=False)
        assert pq.read_table(store.folder / "traces.parquet").schema.equals(TRACES_SCHEMA, check_metadata=False)
        assert all(runs[name].null_count == len(runs) for name in ("wall_s", "cpu_s", "started_at"))
        assert len(set(runs["run_id"].to_pylist())) == len(runs) > 0
        assert set(store.runs()["study"]) == {store.study}


def test_a_trace_ends_where_its_run_does(folder):
    for store in studies(folder):
        runs = store.runs().set_index("run_id")
        ends = store.traces().groupby("run_id").last()
        made_some = runs[runs["evaluations"] > 0]
        assert set(ends.index) == set(made_some.index)
        assert (ends["best_value"] == made_some.loc[ends.index, "best_value"]).all()
        assert (ends["evaluations"] == made_some.loc[ends.index, "evaluations"]).all()


def test_the_tables_are_those_of_the_rows(folder, tmp_path):
    for store in studies(folder):
        tables = study_tables(store.runs())
        assert {f"{name}.csv" for name in tables} == {path.name for path in store.folder.glob("*.csv")}
        for name, table in tables.items():
            table.to_csv(tmp_path / "now.csv", index=False)
            kept, now = pd.read_csv(store.folder / f"{name}.csv"), pd.read_csv(tmp_path / "now.csv")
            pd.testing.assert_frame_equal(kept, now, rtol=1e-12, atol=0)


def test_table_6_of_the_ledger_is_the_median_of_its_rows(folder):
    ledger = pd.read_csv(folder / "ledger.csv").set_index("key")
    runs = ResultStore(folder / "cong2008").runs()
    for row in pd.read_csv(folder / "cong2008" / "table6.csv").to_dict("records"):
        if row["quantity"] not in ("J1", "J2", "J3"):
            continue
        chosen = runs[(runs["optimizer"] == row["method"]) & (runs["problem"] == "full12")]
        chosen = chosen[chosen["problem_options"].str.contains(f'"error":"{row["quantity"]}"')]
        chosen = chosen[chosen["problem_options"].str.contains('"gauge":"xa2"')]
        assert row["median"] == pytest.approx(np.median(chosen["best_value"]), rel=1e-12)
        key = f"table6.{row['method']}.{row['quantity'].lower()}"
        assert key not in ledger.index or ledger.at[key, "ours_median"] == pytest.approx(row["median"], rel=1e-12)


def test_a_reference_is_small(folder):
    size = {path: path.stat().st_size for path in folder.rglob("*") if path.is_file()}
    assert sum(size.values()) < 6e6
    assert not [path for path in size if path.suffix in (".svg", ".tmp")]


@pytest.mark.slow
def test_the_same_run_is_kept_as_the_same_files(evidence, rows, made, tmp_path):
    write_reference(rows, [evidence], "budget=3000 seeds=2", tmp_path / "again")
    for path in made.rglob("*"):
        if path.is_file():
            assert (tmp_path / "again" / path.relative_to(made)).read_bytes() == path.read_bytes(), path.name


def test_a_reference_holds_the_figures_the_papers_are_about(made):
    assert {path.name for path in made.rglob("*.png")} == {
        "cong2008_fig3.png", "cong2008_fig4.png", "cong2008_fig5.png", "convergence_full12.png", "target_full12.png",
        "gauge.png",
    }  # fmt: skip


def test_a_figure_of_the_papers_gauge_is_kept_where_a_study_has_another_too(evidence, rows, tmp_path):
    store = ResultStore(tmp_path / "cong2008")
    store.open()
    for gauge in ("xa2", "ya2"):
        store.write(bench.execute(problems.make("full12", gauge=gauge), optimizers.make("trf"), budget=200, seed=0))
    write_reference(rows, [Evidence(store.runs(), store.traces())], "budget=200 seeds=1", tmp_path / "kept")
    kept = {path.name for path in tmp_path.rglob("*.png")}
    assert {"convergence_full12.png", "target_full12.png"} <= kept
    assert not [name for name in kept if "gauge" in name and name != "gauge.png"]


def test_a_thinned_trace_keeps_the_first_and_the_last_and_is_never_ahead(evidence):
    few = thinned(evidence.traces)
    for run_id, whole in evidence.traces.groupby("run_id"):
        mine = few[few["run_id"] == run_id]
        assert mine.iloc[0].tolist() == whole.iloc[0].tolist()
        assert mine.iloc[-1].tolist() == whole.iloc[-1].tolist()
        assert mine.merge(whole).shape == mine.shape  # points of the trace, none between
        eighths = np.floor(8 * np.log10(mine["charged"]))
        assert (eighths.iloc[1:].diff().dropna() > 0).all()
    assert len(few) < len(evidence.traces)


def test_a_folder_of_something_else_is_not_written_over(tmp_path):
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(StoreError, match=r"printed\.csv"):
        check_folder(tmp_path)
    (tmp_path / "empty").mkdir()
    check_folder(tmp_path / "empty")
    check_folder(tmp_path / "new")


def test_a_wrong_folder_is_refused_before_anything_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / "thesis.txt").write_text("years of work")
    with pytest.raises(SystemExit) as ended:
        main(["paper", "--budget", "paper", "to=theirs"])
    assert ended.value.code == 2
    assert "to=theirs: holds something else" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["theirs"]
