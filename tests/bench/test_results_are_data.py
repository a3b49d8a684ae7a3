"""Results are data: a name that comes out of a file is never imported by a verb that reads, unless it is trusted."""

import json
import sys
from contextlib import suppress

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from calibench import bench, optimizers, problems
from calibench.bench.report.one_run import again_command
from calibench.bench.statistics.summary import has_chance
from calibench.bench.statistics.tables import calibrated, problem_of
from calibench.bench.store.runs import ResultStore
from calibench.core import user_file
from calibench.core.registry import NotImported, names_of_files

pytestmark = pytest.mark.usefixtures("one_process", "undrawn", "fresh")

OWN = """
import pathlib
import numpy as np
pathlib.Path({sign!r}).touch()

class Bowl:
    lower, upper, start, targets, unit = -np.ones(2), np.ones(2), np.full(2, 0.5), (1e-1,), "mm"
    parameters, truth = ("gain", "offset"), np.array([0.25, 0.0])
    def __init__(self, tilt: float = 0.0):
        self.tilt = tilt
    def residuals(self, x):
        return np.append(np.asarray(x) - self.truth, self.tilt)
    def __call__(self, x):
        return float(self.residuals(x) @ self.residuals(x))

class Half:
    from calibench.optimizers import Traits
    traits = Traits(stochastic=False)
    def __init__(self, share: float = 0.5):
        self.share = share
    def minimize(self, objective, rng):
        x = np.array(objective.start)
        while True:
            objective(x)
            x = x * self.share
"""


@pytest.fixture
def sign(tmp_path):
    """Return the file that appears as soon as ``mine.py`` is imported, which stands in the working folder."""
    found = tmp_path / "imported"
    (tmp_path / "mine.py").write_text(OWN.format(sign=str(found)))
    return found


@pytest.fixture
def forget(monkeypatch, sign):
    """Return what makes this process one in which nobody has typed any class yet."""

    def forget():
        sign.unlink(missing_ok=True)
        monkeypatch.setattr(user_file, "LOADED", {})
        for registry in (problems.registry, optimizers.registry):
            monkeypatch.setattr(registry, "_places", {})
            monkeypatch.setattr(registry, "_by_path", {})
        for name, module in list(sys.modules.items()):
            if str(getattr(module, "__file__", None) or "").endswith("mine.py"):
                monkeypatch.delitem(sys.modules, name)

    return forget


READERS = (
    "status {0}", "collect {0}", "report {0}", "show {1} {0}", "show --json {1} {0}", "compare {0} {0}",
    "compare {0} --methods {2} de", "choose {0} optimizer={2} over=seeds", "export csv {0} --to a",
    "export coco {0} --to b",
    "export ioh {0} --to c", "export latex {0} --to d", "merge {0} --to e", "report e",
)  # fmt: skip


def hostile(*pairs):
    """Return the folder of a study whose rows name these classes, as this store writes it, and an id of each pair."""
    runs = [
        bench.execute(problems.make("sensor_zero"), optimizers.make(name), budget=40, seed=seed)
        for name in ("pso", "de")
        for seed in range(6)
    ]
    own = ResultStore("own")
    own.open()
    for run in runs:
        own.write(run)
    found = own.runs()
    mine = found["optimizer"] == "pso"
    for column, names in zip(("problem", "optimizer"), zip(*pairs)):
        found.loc[mine, column] = np.resize(np.array(names, dtype=object), mine.sum())
    ResultStore("hostile").fill(found, own.traces())
    return "hostile", found.loc[mine, "run_id"].tolist()[: len(pairs)]


def test_no_verb_that_reads_imports_what_a_row_names(run_bench, sign, tmp_path):
    modules = ["mine", f"{tmp_path}/mine.py", f"../{tmp_path.name}/mine.py"]
    methods = [f"{module}:Half" for module in modules]
    folder, run_ids = hostile(*((f"{module}:Bowl", method) for module, method in zip(modules, methods)))
    asked = (words.format(folder, *one) for words in READERS for one in zip(run_ids, methods))
    for words in dict.fromkeys(asked):  # once what names neither a run nor a method
        code, _, err = run_bench(words)
        assert code in (0, 1, 2), words
        assert not sign.exists(), words
        assert "Traceback" not in err, words


@pytest.mark.parametrize("name", ["os:system", "mine.py", "mine", "mine:", ":Bowl", "subprocess:run", "mine.py:"])
def test_no_reading_function_imports_what_a_row_names(sign, tmp_path, name):
    folder, (run_id,) = hostile((name, name))
    runs = ResultStore(folder).runs()
    row = runs[runs["run_id"] == run_id].iloc[0].to_dict()
    with pytest.raises(ValueError):  # noqa: PT011  # not imported, or no name at all
        problem_of(row)
    assert isinstance(has_chance(runs[runs["optimizer"] == name]), bool)
    with suppress(NotImported):
        again_command(row)
    assert not sign.exists()


def test_a_journal_an_archive_and_a_manifest_name_nothing_that_is_imported(run_bench, sign, tmp_path):
    run_bench("run problem=sensor_zero optimizer=de budget=60 seeds=2 study=mine")
    run_bench("export ioh results/mine --to archive")
    for path in (tmp_path / "archive").rglob("*.json"):
        told = json.loads(path.read_text())
        told["calibench"]["problem"] = "mine:Bowl"
        told["function_name"] = told["suite"] = "mine:Bowl"
        told["algorithm"]["name"] = "mine:Half"
        path.write_text(json.dumps(told))
    assert run_bench("import ioh archive --to theirs")[0] == 0
    manifest = json.loads((tmp_path / "theirs/manifest.json").read_text())
    manifest |= {"files": {"mine.py:Bowl": str(tmp_path / "mine.py")}, "commands": ["bench run problem=mine:Bowl"]}
    (tmp_path / "theirs/manifest.json").write_text(json.dumps(manifest))
    for words in ("status theirs", "report theirs", "compare theirs theirs", "export coco theirs --to coco"):
        assert run_bench(words)[0] in (0, 1, 2)
    assert not sign.exists()
    assert set(ResultStore("theirs").runs()["problem"]) == {"mine:Bowl"}


def test_a_sweep_that_goes_on_in_a_folder_imports_what_was_typed_and_nothing_else(run_bench, sign, tmp_path):
    hostile("mine:Bowl", "mine:Half")
    sweep = "run problem=sensor_zero optimizer=de budget=40 seeds=2 results=. study=hostile"
    assert run_bench(sweep)[0] == 0
    manifest = json.loads((tmp_path / "hostile/manifest.json").read_text())
    assert len(manifest["cells"]) == 1
    assert run_bench(f"{sweep} --dry-run")[0] == 0
    assert not sign.exists()


def test_a_file_of_data_names_no_machine_that_is_imported(run_bench, sign, tmp_path):
    for machine, code in (("mine:Bowl", 2), (f"{tmp_path}/mine.py:Bowl", 2)):
        pd.DataFrame({"pose_id": [1.0, 2.0], "enc_1": [0.1, 0.2]}).to_parquet(tmp_path / "x.parquet")
        table = pq.read_table(tmp_path / "x.parquet")
        told = {"measured_data": json.dumps({"schema_version": 1, "machine": machine, "nominal": {}})}
        pq.write_table(table.replace_schema_metadata(told), tmp_path / "x.parquet")
        for words in ("discover machine=gpm2002 data=x.parquet", "design machine=gpm2002 data=x.parquet"):
            found, _, err = run_bench(words)
            assert (found, "Traceback" in err) == (code, False), words
            assert machine in err
    assert not sign.exists()


def test_a_truth_that_a_row_does_not_hold_is_told_as_left_out(run_bench, forget, tmp_path):
    own = tmp_path / "mine.py"
    own.write_text(own.read_text().replace('parameters, truth = ("gain", "offset"), ', "truth = "))
    assert run_bench("run problem=mine.py:Bowl optimizer=de budget=20 seeds=1 study=s")[0] == 0
    forget()
    _, out, err = run_bench(f"show {ResultStore('results/s').runs()['run_id'].iloc[0]}")
    assert "true" not in out
    assert "Left out: true values; what its data can tell" in err


def test_a_class_that_is_typed_is_imported_and_its_rows_are_read_without_it(run_bench, sign, forget):
    assert run_bench("run problem=mine.py:Bowl optimizer=mine.py:Half budget=20 seeds=3 study=s")[0] == 0
    assert sign.exists()
    forget()
    runs = ResultStore("results/s").runs()
    table = calibrated(runs).set_index("parameter")
    assert table.loc["gain", "true"] == 0.25
    assert table.loc["offset", "start_value"] == 0.5
    assert not has_chance(runs)
    run_id = runs["run_id"].iloc[0]
    code, out, err = run_bench(f"show {run_id}")
    assert code == 0
    assert "true" in out
    assert "again      told with --trust alone" in out
    assert err == (
        "bench: the problem is mine.py:Bowl, which reading does not import; --trust does. Left out: what its data can "
        "tell\n"
    )
    for words in ("status results/s", "collect results/s", "export csv results/s --to csv", "merge results/s --to m"):
        assert run_bench(words)[::2] == (0, ""), words
    assert not sign.exists()


def test_the_line_on_classes_that_are_not_imported_names_one_of_a_kind(monkeypatch, run_bench):
    classes = {("optimizer", f"published {'x' * 90} {i}"): [] for i in range(5)} | {("problem", "a.py:B"): ["a rest"]}
    monkeypatch.setattr("calibench.core.registry.take_not_imported", lambda: classes)
    ResultStore("s").open()
    line = run_bench("status s")[2].splitlines()[-1]
    assert len(line) < 250
    assert "the problem is a.py:B" in line
    assert " and 4 more, which reading does not import; --trust does. Left out: a rest" in line


def test_a_run_whose_file_is_not_here_says_so(run_bench, sign, forget, tmp_path):
    run_bench("run problem=mine.py:Bowl optimizer=de budget=20 seeds=1 study=s")
    forget()
    (tmp_path / "mine.py").unlink()
    _, out, _ = run_bench(f"show {ResultStore('results/s').runs()['run_id'].iloc[0]} --trust")
    assert "again      told where the file is alone: problem 'mine.py:Bowl': there is no file" in out


@pytest.mark.parametrize(
    ("words", "untold"),
    [
        ("show {0}", ["what its data can tell"]),
        ("report results/s", ["what its data can tell", "the rounding floor in its figure"]),
        ("choose results/s optimizer=mine.py:Half over=seeds", ["which setting is its default"]),
    ],
)
def test_trust_lets_a_verb_that_reads_import_the_class(run_bench, sign, forget, words, untold):
    run_bench(
        "run -m problem=mine.py:Bowl optimizer=mine.py:Half optimizer.share=0.5,0.6 budget=20 seeds=6 study=s "
        "start=random"
    )
    run_id = ResultStore("results/s").runs()["run_id"].iloc[0]
    forget()
    code, out, err = run_bench(words.format(run_id))
    assert not sign.exists()
    assert len(err.splitlines()[-1]) < 250
    said, _, left_out = err.splitlines()[-1].partition("; --trust does. Left out: ")
    assert said.endswith("which reading does not import")
    assert [what for what in untold if what not in left_out] == []
    trusted = run_bench(f"{words.format(run_id)} --trust")
    assert sign.exists()
    assert (trusted[0], "does not import" in trusted[2]) == (code, False)
    assert trusted[1] != out or "report" in words
    assert "problem=mine.py:Bowl" in trusted[1] or "show" not in words


def test_every_verb_that_reads_takes_trust_and_those_that_are_typed_do_not(run_bench):
    run_bench("run problem=sensor_zero optimizer=de budget=60 seeds=1 study=s")
    assert run_bench("status --trust results/s")[0] == 0
    code, _, err = run_bench("run problem=sensor_zero optimizer=de --trust")
    assert (code, "--trust" in err) == (2, True)


def test_within_files_a_registry_knows_what_is_registered_and_what_was_typed(sign):
    with names_of_files():
        assert len(problems.make("sensor_zero").lower) == 3
        for ask in (problems.make, problems.registry.options, problems.registry.factory, problems.registry.place):
            with pytest.raises(NotImported, match=r"mine\.py:Bowl.*--trust"):
                ask("mine.py:Bowl")
        assert not sign.exists()
        with names_of_files(trust=True), names_of_files():
            problems.make("mine.py:Bowl")
    assert sign.exists()
    with names_of_files():
        assert problems.make("mine.py:Bowl").tilt == 0.0
