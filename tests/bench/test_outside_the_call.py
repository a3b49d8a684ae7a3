"""Foreign code that crashes, hangs or answers nonsense outside its call: a row or one line, and the others go on."""

from __future__ import annotations

import ctypes
import faulthandler
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibench import bench, optimizers
from calibench.bench.cli import main
from calibench.bench.execution import request as probe
from calibench.bench.execution.run import Spec
from calibench.bench.execution.standing import lost_run
from calibench.bench.gate import time_limit
from calibench.bench.sweep.request import read_request
from calibench.problems.base import registry
from tests.few import few

CODE = """
import ctypes, os, sys, time
import numpy as np

class Rig:
    def __init__(self, kind: str = "ok"):
        if kind == "segfault":
            ctypes.string_at(0)
        if kind == "hang":
            time.sleep(60)
        if kind == "exit":
            sys.exit(0)
        if kind == "killed once" and not os.path.exists("killed"):
            open("killed", "w").close()
            os.kill(os.getpid(), 9)
        self.lower, self.upper, self.start = -np.ones(2), np.ones(2), np.full(2, 0.3)
    def __call__(self, x):
        return float(x @ x)

class Method:
    def __init__(self, kind: str = "ok"):
        Rig(kind)
    def minimize(self, objective, rng):
        objective(objective.start)
"""


class Bowl:
    lower, upper, start = np.full(2, -1.0), np.full(2, 1.0), np.full(2, 0.5)

    def __call__(self, x: np.ndarray) -> float:
        return float(x @ x)


def with_attribute(name: str, value: object) -> Any:
    return type("Bowl", (Bowl,), {name: value})()


def raises(*_: Any) -> Any:
    raise SystemExit(3)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("targets", 3), ("data_id", 5), ("data_id", b"a"), ("lower", "low"), ("lower", None),
        ("batch", 5), ("residuals", [1.0]), ("compile", 1), ("physical", 2), ("kernel", 3), ("merit", 4),
        ("unit", property(raises)), ("data_id", property(raises)), ("kernel", property(raises)),
        ("default_start", 7),
    ],
)  # fmt: skip
def test_a_problem_that_says_nonsense_is_refused_in_one_line(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name if name != "default_start" else "start=7") as refused:
        bench.execute(with_attribute(name, value), optimizers.make("de"), budget=20)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "value"), [("library", 5), ("traits", 5), ("compile", 5), ("library", property(raises))]
)
def test_an_optimiser_that_says_nonsense_is_refused_in_one_line(name: str, value: object) -> None:
    class Method:
        def minimize(self, objective: Any, rng: Any) -> Any:
            objective(objective.start)

    with pytest.raises(ValueError, match=name):
        bench.execute(Bowl(), type("Method", (Method,), {name: value})(), budget=20)


def crash(*_: Any) -> Any:
    faulthandler.disable()  # what it prints is of this test, and looks like a fault of pytest's
    ctypes.string_at(0)


def leave(*_: Any) -> Any:
    os._exit(3)


def hang(*_: Any) -> Any:
    time.sleep(60)


@pytest.mark.parametrize("way", [crash, leave])
@pytest.mark.parametrize("where", ["compile", "merit", "physical", "noise_free"])
def test_a_crash_outside_the_call_of_a_watched_run_is_a_failed_row(where: str, way: Any) -> None:
    problem = with_attribute(where, way)
    if where == "noise_free":
        type(problem).stochastic = True
    run = bench.execute(problem, optimizers.make("de"), budget=20, time_limit=20)
    assert (run.status, run.row["error_type"]) == ("failed", "ProcessDied")
    assert run.row["error"].startswith("before the first" if where == "compile" else "in judging the answer: ")
    assert run.evaluations == (0 if where == "compile" else 20)
    assert run.row["inside_box"] is (where != "compile")


@pytest.mark.parametrize(("where", "status"), [("compile", "timeout"), ("merit", "failed")])
def test_the_time_limit_counts_outside_the_call_too(where: str, status: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_limit, "GRACE", 0.1)
    bench.execute(with_attribute("unit", ""), optimizers.make("de"), budget=20)  # kernels are loaded, and take no time
    run = bench.execute(with_attribute(where, hang), optimizers.make("de"), budget=20, time_limit=0.3)
    assert run.status == status
    assert run.row["error_type"] == ("" if where == "compile" else "TimeoutError")


@pytest.mark.parametrize("where", ["compile", "merit"])
@pytest.mark.parametrize("limit", [None, 20.0])
def test_an_exit_outside_the_call_is_a_failed_row(where: str, limit: float | None) -> None:
    run = bench.execute(with_attribute(where, raises), optimizers.make("de"), budget=20, time_limit=limit)
    assert (run.status, run.row["error_type"]) == ("failed", "SystemExit")


def test_a_physical_answer_of_another_shape_is_a_failed_row() -> None:
    run = bench.execute(with_attribute("physical", lambda _, x: [[1.0, 2.0]]), optimizers.make("de"), budget=20)
    assert (run.status, run.row["error_type"]) == ("failed", "TypeError")


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / f"{tmp_path.name}.py"  # results could not tell two of one name apart
    file.write_text(CODE)
    return f"{file}:"


@pytest.mark.parametrize("kind", few(1, ["problem", "optimizer"]))
@pytest.mark.parametrize(("option", "error_type"), [("segfault", "ProcessDied"), ("hang", "TimeoutError")])
def test_a_class_that_cannot_be_built_costs_its_own_runs_only(
    rig: str, kind: str, option: str, error_type: str
) -> None:
    names = {"problem": rig + "Rig", "optimizer": rig + "Method"}
    words = [f"{k}={v}" for k, v in names.items()]
    limit = f"time_limit={20.0 if option == 'segfault' else 0.5}"  # that of building too
    request = read_request([*words, f"{kind}.kind=ok,{option}", "budget=20", "seeds=2", limit], multirun=True)
    broken = {run_id: why for run_id, why in request.broken.items() if why[0] == error_type}
    assert len(request.specs) == 4 if kind == "problem" else 3
    assert len(broken) == len(request.broken) == 2
    for run_id, (kind_of_error, error) in broken.items():
        assert ("within 0.5 s" in error) == (option == "hang")
        run = lost_run(request.specs[run_id], run_id, kind_of_error, error, patience=0.3)
        assert (run.run_id, run.status, run.row["error_type"]) == (run_id, "failed", error_type)
        assert option in run.row[f"{kind}_options"]
        assert run.row["code_digest"] == request.codes[run_id]


def test_a_process_that_is_killed_once_as_a_class_is_built_is_no_fault_of_the_class(rig: str) -> None:
    words = [f"problem={rig}Rig", "problem.kind=killed once", "optimizer=de", "budget=20", "seeds=2"]
    request = read_request(words, multirun=False)
    assert (len(request.specs), request.broken) == (2, {})
    assert Path("killed").exists()


def test_the_id_of_what_cannot_be_built_is_that_of_what_can(rig: str, monkeypatch: pytest.MonkeyPatch) -> None:
    words = [f"problem={rig}Rig", "optimizer=de", "budget=20", "seeds=2"]
    sound = read_request(words, multirun=False)
    monkeypatch.setattr("calibench.bench.execution.request.probe", lambda *_: probe.Lost("ProcessDied", "it died"))
    broken = read_request(words, multirun=False)
    assert list(sound.specs) == list(broken.broken) == list(broken.specs)
    assert (sound.codes, sound.files) == (broken.codes, broken.files)


def test_an_exit_as_a_class_is_built_is_one_line(rig: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["run", f"problem={rig}Rig", "problem.kind=exit", "optimizer=de", "budget=20", "seeds=1"])
    assert ended.value.code == 2
    told = capsys.readouterr().err
    assert "cannot be built: SystemExit" in told
    assert len(told.splitlines()) == 1


def test_a_lost_run_is_the_row_that_the_run_would_have_begun(rig: str) -> None:
    spec = Spec(f"{rig}Rig", {}, "de", {"population": 10}, 50, 3, "random", None, 5.0)
    done = spec.execute()
    lost = lost_run(spec, done.run_id, "ProcessDied", "exit code -9", wall_s=1.5)
    same = ("run_id", "problem", "problem_options", "data_id", "dimension", "optimizer", "optimizer_options", "library",
            "library_version", "repetition", "seed", "start", "budget", "target", "code_digest", "unit")  # fmt: skip
    assert {k: lost.row[k] for k in same} == {k: done.row[k] for k in same}
    assert list(lost.row) == list(done.row)
    assert (lost.status, lost.row["error"], lost.evaluations, lost.row["wall_s"]) == ("failed", "exit code -9", 0, 1.5)
    hung = lost_run(spec, done.run_id, "", "it fell silent", timed_out=True)
    assert (hung.status, hung.stop_reason, hung.row["error_type"]) == ("timeout", "timeout", "")


def test_a_lost_run_of_what_is_gone_is_still_a_row(tmp_path: Path) -> None:
    spec = Spec(f"{tmp_path}/gone.py:Rig", {"n": 2}, "de", {}, 50, 0, "nominal")
    run = lost_run(spec, "0" * 16, "ProcessDied", "exit code -9")
    assert (run.run_id, run.status, run.row["problem"]) == ("0" * 16, "failed", "gone.py:Rig")
    assert (run.row["problem_options"], run.row["dimension"], run.row["data_id"]) == ('{"n":2}', 0, "")


def test_our_own_classes_are_not_probed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probe, "apart", lambda *_: pytest.fail("a child was forked"))
    assert probe.probe(registry, "full12", {}) is None
