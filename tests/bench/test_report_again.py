"""`bench report` once more: what is still true is not made again, and whatever has changed is."""

import json
import os
import subprocess
import sys

import pytest

from calibench.bench.gate.processes import CAN_FORK
from calibench.bench.report.shared.kept import RECORD, Kept, code, state_of
from calibench.bench.report.study import write
from tests.bench.conftest import empty_drawings

_SWEEP = "run -m problem=sensor_zero,link_length optimizer=lm seeds=2 budget=60 start=random study=s results=."


@pytest.fixture
def study(run_bench, tmp_path, one_process):
    assert run_bench(_SWEEP)[0] == 0
    return tmp_path / "s"


@pytest.fixture
def blank():
    """Let drawings be empty: which are written, and when, is asked here."""
    with empty_drawings():
        yield


def _times(folder):
    return {path.name: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}


@pytest.mark.usefixtures("blank")
def test_nothing_new_is_said_again_and_nothing_is_written(run_bench, study, monkeypatch):
    first = run_bench("report s")
    before = _times(study)
    said = f"{first[1]}nothing has changed since these were written\n"
    assert run_bench("report s")[:2] == (0, said)
    monkeypatch.chdir(study)
    assert run_bench("report .")[1] == said.replace("\ns/", "\n")  # paths are as one stands
    assert _times(study) == before

    whole = {name: (study / name).read_bytes() for name in ("report.html", "figures/ecdf.svg", "summary.csv")}
    (study / "report.html").write_text("edited")
    (study / "summary.csv").write_text("edited")
    (study / "figures" / "ecdf.svg").unlink()
    monkeypatch.chdir(study.parent)
    run_bench("report s")
    assert {name: (study / name).read_bytes() for name in whole} == whole


@pytest.mark.usefixtures("blank")
def test_a_run_more_draws_the_figures_of_its_problem_alone(run_bench, study):
    run_bench("report s")
    page, before = (study / "report.html").read_text(), _times(study / "figures")
    run_bench("run problem=sensor_zero optimizer=lm seeds=3 budget=60 start=random study=s results=.")
    assert run_bench("report s")[0] == 0
    assert (study / "report.html").read_text() != page
    drawn = {name.partition(".")[0] for name, time in _times(study / "figures").items() if before.get(name) != time}
    assert drawn == {"ecdf", "convergence_sensor_zero", "target_sensor_zero"}


@pytest.mark.usefixtures("blank")
def test_a_report_is_the_same_where_a_process_beside_it_builds_the_problems(run_bench, study, monkeypatch):
    made = []
    for can_fork in (CAN_FORK, False):
        monkeypatch.setattr(write, "CAN_FORK", can_fork)
        assert run_bench("report s")[0] == 0
        files = [path for path in study.rglob("*") if path.suffix in (".html", ".csv", ".svg", ".png")]
        made.append({path.relative_to(study): path.read_bytes() for path in files})
        for path in (*files, study / RECORD):
            path.unlink()
    assert made[0] == made[1]


def test_a_record_that_is_damaged_or_of_other_code_is_none(tmp_path):
    for text in ("", "[]", json.dumps({"other": 1}), json.dumps({"code": "another", "text": "all is well"})):
        (tmp_path / RECORD).write_text(text)
        assert Kept.read(tmp_path) == Kept()
    Kept(code=code(), text="all is well").write(tmp_path)
    assert Kept.read(tmp_path).is_current(tmp_path)


def test_a_file_that_runs_name_is_looked_at_too(tmp_path):
    (tmp_path / "study").mkdir()
    arm = tmp_path / "arm.urdf"
    arm.write_text("an arm")
    kept = Kept(code=code(), text="all is well", files=state_of(tmp_path / "study", [str(arm)]))
    assert kept.is_current(tmp_path / "study")
    arm.write_text("another arm")
    assert not kept.is_current(tmp_path / "study")


def test_another_process_knows_the_code_by_the_same_digest():
    command = [sys.executable, "-c", "from calibench.bench.report.shared.kept import code; print(code())"]
    environments = ({**os.environ, "PYTHONHASHSEED": seed} for seed in "12")
    first, second = (subprocess.run(command, env=one, check=True, capture_output=True).stdout for one in environments)
    assert first == second
