"""A report that was written and read back says the same, and only its fitted model is gone."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.gpm2002.simulate import case
from calibench.bench.discovery.page.words import gap_sentence, headline, next_sentences
from calibench.core import user_file
from calibench.discrepancy import MeasuredData, Report, explain
from calibench.discrepancy.effects import family_of


@pytest.fixture(scope="module")
def report() -> Report:
    made = case(0, family="compliance", lam=3.0, noise="gauss", xy=False)
    return explain("gpm2002", MeasuredData(made.columns, "gpm2002", made.metadata, "case"))


def test_a_report_is_read_back_as_it_was_told(report: Report) -> None:
    told = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    again = Report.from_dict(told)
    assert again.to_dict() == report.to_dict()
    assert (headline(again), gap_sentence(again), next_sentences(again)) == (
        headline(report),
        gap_sentence(report),
        next_sentences(report),
    )
    assert again.findings == report.findings
    assert again.not_testable == report.not_testable


def test_a_report_from_a_file_has_no_model_and_says_so(report: Report) -> None:
    again = Report.from_dict(report.to_dict())
    with pytest.raises(LookupError, match="search the data again"):
        _ = again.model
    assert report.model.best.size == len(report.model.names)


def test_a_pickled_report_predicts_what_it_predicted(report: Report) -> None:
    again = pickle.loads(pickle.dumps(report))
    assert again.to_dict() == report.to_dict()
    new = {name: [0.1, 0.2] for name in ("enc_1", "enc_2", "enc_3", "tau_1", "tau_2", "tau_3")}
    np.testing.assert_array_equal(again.predict(new).residuals, report.predict(new).residuals)
    [effect] = report.model.model.effects
    assert pickle.loads(pickle.dumps(effect)).amplitude(np.array([2.0])) == 2.0
    family = family_of("gpm2002", effect.family)
    assert family is not None
    assert pickle.loads(pickle.dumps(family)).cause == family.cause


def test_a_report_is_pickled_though_a_file_that_was_loaded_is_no_module_any_more(
    report: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "gone_since.py"
    file.write_text("SIZE = 1.0")
    monkeypatch.setattr(user_file, "LOADED", {})
    assert user_file.load(file).SIZE == 1.0
    del sys.modules["gone_since"]  # another file of this name would take its place
    assert pickle.loads(pickle.dumps(report)).to_dict() == report.to_dict()


OWN = """
import numpy as np
from calibench.discrepancy import Predicted
from calibench.problems.base import Parameter

class Line:
    name = "line_of_a_file"

    def formulate(self, data):
        slope = Parameter("slope", "", 1.0, 0.0, 2.0)
        return Predicted(data, lambda q: q["slope"] * q["u"][:, None], (slope,), {"y": 0.01}, inputs=("u",))
"""


def test_a_report_on_a_machine_of_a_file_is_read_where_the_file_is_not(tmp_path: Path) -> None:
    (tmp_path / "own_line.py").write_text(OWN)
    machine = vars(user_file.load(tmp_path / "own_line.py"))["Line"]()
    u = np.linspace(0.0, 1.0, 40)
    data = MeasuredData({"u": u, "y": 1.5 * u + 0.01 * np.random.default_rng(1).normal(size=40)}, machine.name)
    (tmp_path / "report").write_bytes(pickle.dumps(explain(machine, data)))
    script = "import pickle; print(*pickle.load(open('report', 'rb')).predict({'u': [2.0]}).measured['y'].round(1))"
    (tmp_path / "own_line.py").unlink()
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == "3.0\n"


def test_what_was_not_measured_is_no_number_and_null_in_json() -> None:
    bare = Report.from_dict({"case": "run 7", "machine": "arm", "verdict": "none"})
    assert bare.gap.noise_floor != bare.gap.noise_floor
    assert bare.to_dict()["gap"]["held_out_ci95"] == [None, None]


def test_a_verdict_there_is_not_is_refused() -> None:
    with pytest.raises(ValueError, match="verdict 'maybe'"):
        Report.from_dict({"case": "run 7", "machine": "arm", "verdict": "maybe"})
