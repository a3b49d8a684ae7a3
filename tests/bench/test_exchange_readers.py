"""What is exported, read by those it is for: cocopp, iohinspector and MLflow. Skipped where they are not installed."""

import json
import os
import shutil
import warnings
from collections import defaultdict

import numpy as np
import pytest

from calibench import optimizers, problems
from calibench.bench.cli import main
from calibench.bench.execution.run import execute
from calibench.bench.statistics.names import method_labels
from calibench.bench.store.manifest import Notes, read_notes, write_notes
from calibench.bench.store.runs import ResultStore
from calibench.problems.suites.black_box import COCO_GAPS
from tests.bench.exchange_studies import mixed_study, suite_study

pytestmark = pytest.mark.filterwarnings("default")  # what others' packages say as they are loaded is theirs


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    """Return a study of 5 instances, three times each: what cocopp takes for a whole experiment."""
    return suite_study(tmp_path_factory.mktemp("suite") / "s", instances=range(1, 6), seeds=range(3), budget=120).folder


@pytest.fixture(scope="module")
def mixed(tmp_path_factory):
    return mixed_study(tmp_path_factory.mktemp("mixed") / "m").folder


def bench(*words):
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    assert ended.value.code == 0


def test_cocopp_reads_it_without_a_warning_and_its_expected_running_times_are_ours(suite, tmp_path):
    pytest.importorskip("cocopp", reason="cocopp is not installed")
    from cocopp import pproc

    bench("export", "coco", suite, "--to", tmp_path / "out")
    runs = ResultStore(suite).runs()
    ours = defaultdict(list)
    for options, optimizer, charged, hits in zip(
        runs["problem_options"], runs["optimizer"], runs["charged"], runs["hits_charged"], strict=True
    ):
        told = json.loads(options)
        ours[optimizer, told["function"], told["dimension"]].append((charged, list(hits)))
    compared = finite = 0
    for algorithm in sorted(os.listdir(tmp_path / "out")):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            read = pproc.DataSetList(str(tmp_path / "out" / algorithm))
        for data in read:
            mine = ours[algorithm, data.funcId, data.dim]
            assert data.nbRuns() == len(mine) == 15
            theirs = data.detERT(list(COCO_GAPS))
            for i, found in enumerate(theirs):
                spent = sum(charged if hits[i] is None else hits[i] for charged, hits in mine)
                reached = sum(hits[i] is not None for _, hits in mine)
                expected = spent / reached if reached else np.inf
                assert found == pytest.approx(expected, rel=1e-9)
                compared += 1
                finite += bool(reached)
    assert compared == 2 * 3 * 51
    assert finite > 100


def test_iohinspector_lists_the_same_runs_evaluations_and_best_values(suite, mixed, tmp_path):
    pytest.importorskip("iohinspector", reason="iohinspector is not installed")
    from iohinspector import DataManager

    for folder in (suite, mixed):
        to = tmp_path / folder.name
        bench("export", "ioh", folder, "--to", to)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            manager = DataManager()
            manager.add_folder(str(to))
            overview = manager.overview
            data = manager.load(monotonic=False)
        runs = ResultStore(folder).runs()
        minimum = runs["minimum"].fillna(0.0)
        ours = zip(method_labels(runs), runs["charged"], runs["best_value"] - minimum, strict=True)
        theirs = overview.select("algorithm_name", "evals", "best_y").rows()
        assert sorted(theirs) == sorted(ours)
        last = data.group_by("data_id").agg([column("raw_y").min(), column("evaluations").min()])
        assert len(last) == len(runs)
        assert set(last["evaluations"]) == {1}
        assert sorted(last["raw_y"]) == sorted(overview["best_y"])


def column(name):
    import polars

    return polars.col(name)


def test_mlflow_holds_each_run_once_under_its_cell(mixed, tmp_path, capsys):
    pytest.importorskip("mlflow", reason="mlflow is not installed")
    from mlflow.tracking import MlflowClient

    to = tmp_path / "mlruns"
    bench("export", "mlflow", mixed, "--to", to)
    bench("export", "mlflow", mixed, "--to", to)
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("12 runs added")
    assert second.startswith("0 runs added")
    client = MlflowClient(tracking_uri=to.as_uri())
    [experiment] = [e for e in client.search_experiments() if e.name == mixed.name]
    found = {run.data.tags.get("calibench.run_id"): run for run in client.search_runs([experiment.experiment_id])}
    parents = [run for run in client.search_runs([experiment.experiment_id]) if "calibench.cell" in run.data.tags]
    assert len(parents) == 6
    rows = ResultStore(mixed).runs().to_dict("records")
    assert found.keys() - {None} == {row["run_id"] for row in rows}
    for row in rows:
        run = found[row["run_id"]]
        assert run.data.metrics["best_value"] == row["best_value"]
        assert run.data.metrics["charged"] == row["charged"]
        assert run.data.params["optimizer"] == row["optimizer"]
        assert run.info.status == {"ok": "FINISHED", "timeout": "KILLED", "failed": "FAILED"}[row["status"]]
        assert run.data.tags["mlflow.parentRunId"] in {parent.info.run_id for parent in parents}
        history = client.get_metric_history(run.info.run_id, "best")
        assert history[-1].value == row["best_value"]
        assert [m.step for m in history] == sorted(m.step for m in history)
    half = found[rows[0]["run_id"]].info.run_id
    client.set_tag(half, "calibench.done", "false")  # as a stopped export leaves it
    bench("export", "mlflow", mixed, "--to", to)
    assert capsys.readouterr().out.startswith("1 run added")


def test_notes_and_tags_go_to_mlflow_as_they_are_now(mixed, tmp_path):
    pytest.importorskip("mlflow", reason="mlflow is not installed")
    from mlflow.tracking import MlflowClient

    folder = shutil.copytree(mixed, tmp_path / mixed.name)
    run_id = ResultStore(folder).runs()["run_id"].iloc[0]
    write_notes(folder, Notes().with_tags(["+draft"]).with_note("for the talk"))
    bench("export", "mlflow", folder, "--to", tmp_path / "mlruns")
    write_notes(folder, read_notes(folder).with_tags(["+paper", "-draft"]).with_note("<b>the best</b>", run_id))
    bench("export", "mlflow", folder, "--to", tmp_path / "mlruns")
    client = MlflowClient(tracking_uri=(tmp_path / "mlruns").as_uri())
    experiment = client.get_experiment_by_name(mixed.name)
    assert experiment.tags == {"calibench.tags": "paper", "mlflow.note.content": "for the talk"}
    noted = {
        run.data.tags["calibench.run_id"]: run.data.tags["mlflow.note.content"]
        for run in client.search_runs([experiment.experiment_id]) if "mlflow.note.content" in run.data.tags
    }  # fmt: skip
    assert noted == {run_id: "<b>the best</b>"}


def test_a_run_that_was_done_again_takes_its_place_in_mlflow(mixed, tmp_path, capsys):
    pytest.importorskip("mlflow", reason="mlflow is not installed")
    from mlflow.tracking import MlflowClient

    folder, to = tmp_path / mixed.name, tmp_path / "mlruns"
    shutil.copytree(mixed, folder)
    bench("export", "mlflow", folder, "--to", to)
    store = ResultStore(folder)
    [old] = store.runs().query("optimizer == 'de'").head(1).to_dict("records")
    store.forget([old["run_id"]])
    problem, optimizer = problems.make(old["problem"]), optimizers.make("de")
    store.write(execute(problem, optimizer, budget=400, seed=old["repetition"], start="random"))
    store.collect()
    bench("export", "mlflow", folder, "--to", to)
    bench("export", "mlflow", folder, "--to", to)
    _, second, third = capsys.readouterr().out.splitlines()
    assert second.startswith("1 run added")
    assert "1 of them done again since the last export; 11 stood there" in second
    assert third.startswith("0 runs added")
    client = MlflowClient(tracking_uri=to.as_uri())
    [experiment] = [e for e in client.search_experiments() if e.name == mixed.name]
    began = ResultStore(folder).runs().set_index("run_id")["started_at"]
    runs = [run for run in client.search_runs([experiment.experiment_id]) if "calibench.run_id" in run.data.tags]
    assert len(runs) == len(began)
    for run in runs:
        assert run.info.start_time == int(began[run.data.tags["calibench.run_id"]].timestamp() * 1000)
