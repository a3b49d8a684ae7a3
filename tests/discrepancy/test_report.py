"""A report that was written and read back says the same, and only its fitted model is gone."""

from __future__ import annotations

import json

import pytest

from benchmarks.blind.gpm2002.simulate import case
from calibench.bench.discovery.page.words import gap_sentence, headline, next_sentences
from calibench.discrepancy import MeasuredData, Report, explain


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


def test_what_was_not_measured_is_no_number_and_null_in_json() -> None:
    bare = Report.from_dict({"case": "run 7", "machine": "arm", "verdict": "none"})
    assert bare.gap.noise_floor != bare.gap.noise_floor
    assert bare.to_dict()["gap"]["held_out_ci95"] == [None, None]


def test_a_verdict_there_is_not_is_refused() -> None:
    with pytest.raises(ValueError, match="verdict 'maybe'"):
        Report.from_dict({"case": "run 7", "machine": "arm", "verdict": "maybe"})
