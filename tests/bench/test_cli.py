"""The command line as a user meets it: commands that work as printed, a line for each mistake, resumed sweeps."""

import io
import json
import os
import subprocess
import sys

import pandas as pd
import pytest

from calibench.bench import cli
from calibench.bench.cli import main
from calibench.bench.store.runs import ResultStore

pytestmark = pytest.mark.usefixtures("one_process")

REPEATABLE = ["wall_s", "cpu_s", "git_commit", "git_dirty", "versions", "platform", "started_at"]

USER_CODE = """
import numpy as np

class Bowl:
    def __init__(self, n: int = 2, depth: float = 0.0):
        self.n, self.depth = n, depth
        self.lower, self.upper, self.start = -np.ones(n), np.ones(n), np.full(n, 0.5)
        self.options = {"n": n, "depth": depth}
    def __call__(self, x):
        return float(x @ x) + self.depth

class Broken(Bowl):
    def __call__(self, x):
        raise RuntimeError("the encoder fell off")

class Wanderer:
    def minimize(self, objective, rng):
        while True:
            objective(objective.lower + rng.random(objective.dimension) * (objective.upper - objective.lower))
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "users_own.py").write_text(USER_CODE)
    yield tmp_path
    sys.modules.pop("users_own", None)


@pytest.fixture
def run_bench(here, capsys):
    def call(command):
        with pytest.raises(SystemExit) as ended:
            main(command.split() if isinstance(command, str) else command)
        out = capsys.readouterr()
        return ended.value.code, out.out, out.err

    return call


def table(here, study="adhoc"):
    return ResultStore(here / "results" / study).runs()


def test_a_sweep_makes_a_row_a_run(run_bench, here):
    code, out, _ = run_bench("run -m problem=sensor_zero,full12 optimizer=lm,de budget=300 seeds=3")
    assert code == 0
    runs = table(here)
    counts = runs.groupby(["problem", "optimizer"]).size().to_dict()
    # sensor_zero starts at Table 2's values: a deterministic method is run once from there
    assert counts == {("full12", "de"): 3, ("full12", "lm"): 3, ("sensor_zero", "de"): 3, ("sensor_zero", "lm"): 1}
    assert (runs["charged"] <= 300).all()
    assert "10 runs (0 done before)" in out


def test_options_reach_the_member_they_name(run_bench, here):
    code, *_ = run_bench(
        "run -m problem=full11,full12 problem.error=J3 prob.full12.gauge=ya2 optimizer=de,pygmo_de "
        "opt.de.population=20 budget=100 seeds=1"
    )
    assert code == 0
    runs = table(here)
    for _, row in runs.iterrows():
        problem, optimizer = json.loads(row["problem_options"]), json.loads(row["optimizer_options"])
        assert problem["error"] == "J3"
        assert problem.get("gauge") == ("ya2" if row["problem"] == "full12" else None)
        assert optimizer["population"] == (20 if row["optimizer"] == "de" else "min(10d,B/500)")


def test_presets_of_conf_are_choices(run_bench, here):
    assert run_bench("run problem=full12_section3 optimizer=lm_restarts budget=2e2 seeds=2:4")[0] == 0
    runs = table(here)
    assert set(runs["problem"]) == {"full12"}
    assert json.loads(runs["problem_options"].iloc[0])["gauge"] == "ya2"
    assert runs["repetition"].tolist() == [2, 3]
    assert (runs["budget"] == 200).all()


def test_a_finished_run_is_skipped_and_more_seeds_are_added(run_bench, here):
    run_bench("run problem=full12 optimizer=de budget=200 seeds=2")
    first = table(here)
    code, out, _ = run_bench("run problem=full12 optimizer=de budget=200 seeds=4")
    assert code == 0
    assert "4 runs (2 done before)" in out
    both = table(here)
    pd.testing.assert_frame_equal(both[both["repetition"] < 2].reset_index(drop=True), first)


def test_adding_or_reordering_optimisers_leaves_every_other_row(run_bench, here):
    run_bench("run -m problem=link_length optimizer=de,lm budget=300 seeds=2 start=random study=a")
    run_bench("run -m problem=link_length optimizer=pygmo_de,lm,trf,de budget=300 seeds=2 start=random study=b")
    a, b = (table(here, study).drop(columns=[*REPEATABLE, "study"]) for study in "ab")
    shared = b[b["run_id"].isin(a["run_id"])].reset_index(drop=True)
    pd.testing.assert_frame_equal(shared, a)
    assert len(b) == 8


def test_a_users_own_problem_and_optimiser_sweep_like_built_in_ones(run_bench, here):
    code, *_ = run_bench(
        "run -m problem=users_own:Bowl,sensor_zero prob.users_own:Bowl.n=3 optimizer=users_own:Wanderer,de budget=60 "
        "seeds=2 execution=processes execution.n_jobs=2"
    )
    assert code == 0
    runs = table(here)
    assert set(runs["problem"]) == {"users_own:Bowl", "sensor_zero"}
    assert set(runs["optimizer"]) == {"users_own:Wanderer", "de"}
    assert set(runs.loc[runs["problem"] == "users_own:Bowl", "dimension"]) == {3}
    assert (runs["charged"] == 60).all()


def test_an_entry_point_adds_names(here):
    info = here / "users_own-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: users-own\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[calibench.problems]\nbowl = users_own:Bowl\n[calibench.optimizers]\nwanderer = users_own:Wanderer\n"
    )
    command = [sys.executable, "-m", "bench", "run", "problem=bowl", "optimizer=wanderer", "budget=30", "seeds=2"]
    done = subprocess.run(command, cwd=here, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert set(table(here)["optimizer"]) == {"wanderer"}


def test_a_dry_run_writes_nothing(run_bench, here):
    code, out, _ = run_bench("run study=quick --dry-run")
    assert code == 0
    assert "66 runs would go to results/quick" in out
    assert " or more; code that never ran here is compiled first" in out
    assert not (here / "results").exists()


def test_the_target_is_a_column_and_a_stop(run_bench, here):
    assert run_bench("run problem=full12 optimizer=lm budget=2000 seeds=2 target=1e-3")[0] == 0
    runs = table(here)
    assert set(runs["stop_reason"]) == {"target"}
    assert (runs["best_value"] <= 1e-3).all()
    assert all(1e-3 in list(targets) for targets in runs["targets"])


def test_measured_readings_are_a_problem(run_bench, here):
    from calibench import problems

    simulated = problems.make("full11", noise=1e-5)
    readings = simulated.readings
    lines = "\n".join(",".join(repr(v) for v in row) for row in readings.tolist())
    (here / "my readings.csv").write_text("enc_1,enc_2,enc_3\n" + lines)
    code, *_ = run_bench(
        ["run", "problem=full11", "problem.readings=my readings.csv", "optimizer=trf", "budget=2000", "seeds=1"]
    )
    assert code == 0
    row = table(here).iloc[0]
    assert row["data_id"] == problems.full11.from_readings(readings).data_id
    assert row["best_value"] < 1.5 * (1e-5 * simulated.residual_noise(simulated.truth)) @ (
        1e-5 * simulated.residual_noise(simulated.truth)
    )
    found = dict(zip(row["parameter_names"], row["parameter_values"], strict=True))
    assert found["la1"] == pytest.approx(244.1, abs=2)  # held ya2 is 0 for the maker, 0.3 in truth


def test_show_finds_a_run_by_the_first_digits(run_bench, here):
    run_bench("run problem=full12 optimizer=lm budget=500 seeds=1")
    run_id = table(here)["run_id"].iloc[0]
    code, out, _ = run_bench(f"show {run_id[:8]}")
    assert code == 0
    assert f"run {run_id}" in out
    assert "ya2" in out
    assert "true" in out
    assert json.loads(run_bench(f"show {run_id} --json")[1])["run_id"] == run_id


def test_a_damaged_journal_is_one_line_and_costs_the_run_of_its_line(run_bench, here, monkeypatch):
    monkeypatch.setattr(ResultStore, "collect", lambda store, workers: [])
    monkeypatch.setattr(ResultStore, "collected", ResultStore.finished)
    run_bench("run problem=full12 optimizer=de budget=100 seeds=3")
    monkeypatch.undo()
    monkeypatch.chdir(here)
    (journal,) = (here / "results/adhoc/journal").iterdir()
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join([*lines[:-1], lines[-1].replace(b"full12", b"full21")]))
    code, _, err = run_bench("collect results/adhoc")
    assert code == 2
    assert err.count("\n") == 1
    assert "damaged" in err
    assert len(table(here)) == 2
    assert run_bench("collect results/adhoc")[0] == 0
    code, out, _ = run_bench("run problem=full12 optimizer=de budget=100 seeds=3")
    assert code == 0
    assert "3 runs (2 done before)" in out
    assert len(table(here)) == 3


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("", "usage"),
        ("rum problem=full12", "did you mean 'run'"),
        ("compare a b", "there is no such study folder"),
        ("calibrate urdf=a data=b", "urdf=a: cannot be read: No such file"),
        ("discover machine=gpm2002 data=x.csv", "x.csv"),
        ("list problem", "did you mean 'problems'"),
        ("run problem=ful12 optimizer=de", "did you mean 'full12'"),
        ("run problem=full12 optimizer=dee", "did you mean 'de'"),
        ("run problem=orthoglide6 problem.data=exp1 optimizer=de", "see 5 of 6 parameters; take free=rho"),
        ("run problem=full12 problem.eror=J3 optimizer=de", "did you mean 'error'"),
        ("run problem=full12 problem.error=J4 optimizer=de", "choices: J1, J2, J3"),
        ("run problem=sensor_zero problem.error=J3 optimizer=de", "sensor_zero.error=J3: choices: J1, J2"),
        ("run -m problem=sensor_zero,full12 problem.error=J3 optimizer=de", "sensor_zero.error=J3"),
        ("run problem=full12 optimizer=de opt.de.F=3", "de.F=3"),
        ("run problem=full12 optimizer=de opt.pso.F=3", "pso is not in this sweep"),
        ("run problem=full12 problem.n=5 optimizer=de", "full12.n=5"),
        ("run problem=full12 problem.noise=-1e-4 optimizer=de", "noise=-1e-4: must lie in 0 .. 1"),
        ("run problem=full12 problem.radius=500 optimizer=de", "out of reach"),
        ("run problem=full12 problem.readings=no.csv optimizer=de", "cannot be read"),
        ("run problem=full12 optimizer=de budget=0", "budget=0"),
        ("run problem=full12 optimizer=de budget=-7", "budget=-7"),
        ("run problem=full12 optimizer=de budget=plenty", "budget=plenty"),
        ("run problem=users_own:Bowl optimizer=de budget=ci", "does not say what ci means"),
        ("run problem=full12 optimizer=de seeds=0", "seeds=0"),
        ("run problem=full12 optimizer=de seeds=3:1", "seeds=3:1"),
        ("run problem=full12 optimizer=de seeds=1:2:3", "seeds=1:2:3"),
        ("run problem=full12 optimizer=de seeds=some", "seeds=some"),
        ("run problem=full12 optimizer=de start=there", "start=there"),
        ("run problem=full12 optimizer=de target=low", "target=low"),
        ("run problem=full12 optimizer=de buget=10", "did you mean 'budget'"),
        ("run problem=full12 optimizer=de execution=slurm", "shard=I/N"),
        ("run problem=full12 optimizer=de execution=proceses", "did you mean 'processes'"),
        ("run problem=full12 optimizer=de execution=processes execution.n_jobs=0", "n_jobs=0"),
        ("run problem=full12 optimizer=de execution.n_job=2", "n_jobs? add execution=processes or execution=dask"),
        ("run problem=full12 optimizer=de execution=dask execution.n_job=2", "did you mean execution.n_jobs?"),
        ("run problem=full12 optimizer=de --dri-run", "did you mean '--dry-run'"),
        ("run problem=full11,full12 optimizer=de", "add -m"),
        ("run problem=full12", "optimizer=NAME is missing"),
        ("run study=quik", "did you mean 'quick'"),
        ("run problem=users_own:Nothing optimizer=de", "has no 'Nothing'"),
        ("run problem=nowhere:Bowl optimizer=de", "cannot import"),
        ("run problem=users_own:Bowl optimizer=lm budget=10", "needs residuals"),
        ("run problem=full12 optimizer=de results=users_own.py", "users_own.py"),
        ("status results/none", "no such study folder"),
        ("collect .", "no study of ours"),
        ("report", "one STUDY_DIR is needed"),
        ("show 12ab", "no such results folder"),
    ],
)
def test_a_mistake_is_one_clear_line_and_nothing_is_written(run_bench, here, command, words):
    code, out, err = run_bench(command)
    assert code == 2
    assert words in err + out
    assert "Traceback" not in err + out
    assert command == "" or err.count("\n") == 1
    assert not (here / "results").exists()


def test_listing_loads_neither_the_compiler_nor_hydra_nor_arrow():
    for what in ("problems", "optimizers"):
        code = (
            "import sys; from calibench.bench.cli import main\n"
            f"try: main(['list', '{what}', '--json'])\n"
            "except SystemExit: pass\n"
            "print([m for m in ('numba', 'hydra', 'pyarrow', 'pandas', 'scipy', 'matplotlib') if m in sys.modules], "
            "file=sys.stderr)"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert done.stderr.strip() == "[]"
        assert all({"name", "about", "options"} <= row.keys() for row in json.loads(done.stdout))


def test_python_m_bench_is_bench(here):
    done = subprocess.run([sys.executable, "-m", "bench", "list", "studies"], cwd=here, capture_output=True, text=True)
    assert done.returncode == 0
    assert "cong2008" in done.stdout
    assert os.listdir(here) == ["users_own.py"]


NAMED = """
import numpy as np


class Named:
    def __init__(self, name: str = "near") -> None:
        self.name_of_it = name
        self.options = {"name": name}
        self.goal = {"near": 0.1, "far": 0.9}[name]
        self.lower, self.upper, self.start = np.zeros(2), np.ones(2), np.full(2, 0.5)

    def __call__(self, x):
        return float(np.sum((x - self.goal) ** 2))
"""


def test_an_option_of_a_problem_may_be_called_name(run_bench, here):
    (here / "called.py").write_text(NAMED)
    code, _, _ = run_bench(
        "run -m problem=./called.py:Named problem.name=near,far optimizer=nlopt_LN_BOBYQA budget=60 seeds=1"
    )
    assert code == 0
    runs = table(here)
    assert runs["problem"].unique().tolist() == ["called.py:Named"]
    found = {
        json.loads(o)["name"]: round(x[0], 2) for o, x in zip(runs["problem_options"], runs["best_x"], strict=True)
    }
    assert found == {"near": 0.1, "far": 0.9}


def test_a_full_disk_is_told_with_the_way_out(run_bench, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("calibench.bench.store.journal.Journal.append", full)
    code, _, err = run_bench("run problem=sensor_zero optimizer=lm budget=20 seeds=1")
    assert code == 2
    assert err.endswith("No space left on device; make room and give the same command again: finished runs are kept\n")


def test_a_folder_with_spaces_is_told_as_a_shell_takes_it(run_bench):
    code, out, _ = run_bench(
        ["run", "problem=sensor_zero", "optimizer=lm", "budget=20", "seeds=1", "results=my results"]
    )
    assert code == 0
    assert "`bench report 'my results/adhoc'` draws them" in out


def test_what_a_pipe_cannot_encode_is_escaped(monkeypatch):
    pipe = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", pipe)
    monkeypatch.setattr(cli.process, "at_once", lambda: None)
    monkeypatch.setattr(cli, "main", lambda: print("≥ 2"))
    cli.command()
    pipe.flush()
    assert pipe.buffer.getvalue() == b"\\u2265 2\n"
