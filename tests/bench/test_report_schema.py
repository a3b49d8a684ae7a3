"""The JSON schema of a discovery's report: it ships, cannot drift from the classes, and refuses what is no report."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from calibench import bench
from calibench.bench.discovery.store import SearchRecord
from calibench.core.notes import Code, Note
from calibench.discrepancy.model.effect import Untestable
from calibench.discrepancy.report import Amplitude, Finding, Gap, Invisible, ParameterChange, Place, Report, Rival
from tests.bench import write_report_schema

FULL = Report(
    case="run7", machine="gpm2002", verdict="ambiguous", p=1e-9, seconds=0.5, gap=Gap(1.0, 2.0, 1.1),
    notes=(Note(Code.TURNS, "a note", ("q",), ("3",), {"times": 2.5}),),
    findings=(Finding("backlash joint 2", "backlash", "joint 2", Amplitude(1e-4, "rad", (9e-5, float("nan"))), 17.0,
                      (Rival("backlash joint 2", "backlash", "joint 2", 1.0),), None),),
    where=(Place("joint 2", "dir_2", 1e-9),), invisible=(Invisible("lag all", "lag", "all", 0.0, float("inf"), "s"),),
    not_testable=(Untestable("gear", "joint 1", "needs load", ("load",), True),),
    parameters={"la1": ParameterChange(244.0, 244.1, 0.1)},
)  # fmt: skip
RECORD = SearchRecord("a/run7", "gpm2002", "12", "34", "{}", {"git_commit": "", "versions": "{}"}, FULL)


@pytest.fixture(scope="module")
def validator():
    return Draft202012Validator(bench.report_schema())


def test_the_schema_that_ships_is_that_of_the_classes():
    Draft202012Validator.check_schema(bench.report_schema())
    assert bench.report_schema() == write_report_schema.made_schema()


def test_reports_lines_and_failures_are_as_the_schema_says(validator):
    bare = replace(RECORD, report=Report("run7", "gpm2002", "none"))
    failed = replace(RECORD, report=None, error="no such file")
    for record in (RECORD, bare, failed):
        validator.validate(record.to_dict())
        validator.validate(record.line())


@pytest.mark.parametrize(
    "changes",
    [
        {"verdict": "perhaps"}, {"schema_version": 2}, {"seconds": "long"}, {"findings": [{}]}, {"colour": "red"},
        {"gap": {}}, {"error": "and yet it has a verdict"}, {"parameters": {"la1": 3.0}},
    ],
    ids=str,
)  # fmt: skip
def test_what_is_no_report_is_refused(validator, changes):
    assert not validator.is_valid(RECORD.to_dict() | changes)


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"verdict": "perhaps"}, "$.verdict"), ({"seconds": "long"}, "$.seconds"), ({"gap": {}}, "$.gap"),
        ({"parameters": {"la1": 3.0}}, "$.parameters.la1"), ({"where": [{"p": "a"}]}, "$.where[0]"),
    ],
)  # fmt: skip
def test_a_validator_names_the_field_that_is_wrong(validator, changes, where):
    errors = validator.iter_errors(RECORD.to_dict() | changes)
    assert {error.json_path.removesuffix(".p") for error in errors} == {where}


def test_a_validator_names_the_field_of_a_failure_that_is_wrong(validator):
    failed = replace(RECORD, report=None, error="no such file").to_dict()
    [wrong] = validator.iter_errors(failed | {"machine": 5})
    assert wrong.json_path == "$.machine"


@pytest.mark.parametrize("key", RECORD.line())
def test_no_key_of_a_line_may_be_missing(validator, key):
    line = RECORD.line()
    del line[key]
    assert not validator.is_valid(line)


def test_a_field_that_a_class_gains_would_be_seen(monkeypatch):
    @dataclass(frozen=True)
    class Wider(Report):
        colour: str = ""

    monkeypatch.setattr(write_report_schema, "Report", Wider)
    made = write_report_schema.made_schema()
    assert made["$defs"]["Report"]["properties"]["colour"] == {"type": "string"}
    assert made != bench.report_schema()


def test_the_documentation_has_each_code_of_a_note_with_its_meaning():
    page = Path(__file__).parents[2].joinpath("docs", "discover.md").read_text(encoding="utf-8")
    table = page.partition("## The codes of notes")[2]
    rows = [line for line in table.splitlines() if line.startswith("| `")]
    assert rows == [f"| `{code.value}` | {code.meaning} |" for code in Code]


def test_a_note_is_read_back_as_it_was_written():
    [written] = FULL.to_dict()["notes"]
    assert written == {"code": "turns", "text": "a note", "columns": ["q"], "rows": ["3"], "values": {"times": 2.5}}
    assert Report.from_dict(json.loads(json.dumps(FULL.to_dict()))).notes == FULL.notes
