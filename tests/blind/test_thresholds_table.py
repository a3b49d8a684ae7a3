"""The table of thresholds: half and twice each value, the same cases, and what changes."""

from dataclasses import replace

import pytest

from benchmarks.thresholds.table import head, main, rates, rows, scaled, searched, verified
from calibench.discrepancy.thresholds import about


def test_half_and_twice_stay_values_of_their_kind():
    for told in about().values():
        for factor in (0.5, 2.0):
            value = scaled(told.default, factor)
            assert type(value) is type(told.default)
            assert value > 0
            assert not 0.5 < told.default < 1 or value < 1


NAMES = ["matters", "floors_left", "close", "visible"]
SEEDS = range(900_001, 900_002)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Return a file with the answers of the cases."""
    path = tmp_path_factory.mktemp("thresholds") / "answers.jsonl"
    list(searched(NAMES, SEEDS, kept=path))
    return path


def test_the_table_has_a_line_for_each_value_and_counts_what_changes(kept):
    cases = list(searched(NAMES, SEEDS, kept=kept))
    first, *lines = rows(NAMES, cases)
    assert (first[0], first[4]) == ("defaults", "0")
    assert [line[:3] for line in lines[:2]] == [("matters", "0.15", "0.075"), ("matters", "0.15", "0.3")]
    assert len(lines) == 2 * len(NAMES)
    for line in lines:
        assert 0 <= int(line[4]) <= int(line[3]) <= len(SEEDS)
    assert any(line[4] != "0" for line in lines)
    assert any(line[3] == "0" for line in lines)


@pytest.mark.slow
def test_a_file_of_answers_goes_on_where_it_ends(kept):
    before = kept.read_text()
    [case] = searched(NAMES, SEEDS[:1], kept=kept)
    assert kept.read_text() == before
    assert [case] == list(searched(NAMES, SEEDS[:1]))
    with pytest.raises(ValueError, match="answers of other thresholds"):
        list(searched(["close"], SEEDS, kept=kept))


def test_decisions_are_counted_without_searching_again(kept):
    [case] = searched(NAMES, SEEDS, kept=kept)
    [counted] = searched(NAMES, SEEDS, again=0)
    assert head([case, counted])[3:5] == ("decided otherwise (of 2)", "changed (of 1)")
    assert (counted.plain, counted.otherwise, counted.others) == (case.plain, case.otherwise, None)
    assert [line[3:5] for line in rows(NAMES, [counted])][1:] == [(line[3], "0") for line in rows(NAMES, [case])][1:]


@pytest.mark.slow  # eight searches
def test_a_search_from_the_start_answers_what_the_table_says(kept):
    cases = list(searched(NAMES, SEEDS, kept=kept))
    assert verified(NAMES, cases, 100).startswith("8 searches from the start")
    assert verified(NAMES, cases, 100).endswith("0 answers differ")
    [case, *rest] = cases
    wrong = [replace(case, others={key: replace(case.plain, verdict="luck") for key in case.otherwise}), *rest]
    assert not verified(NAMES, wrong, 100).endswith("0 answers differ")


@pytest.mark.slow  # some minutes
def test_searches_from_the_start_at_any_value_answer_the_same():
    names = list(about())
    cases = list(searched(names, range(900_004, 900_007)))
    assert verified(names, cases, 60).endswith("0 answers differ")


def test_rates_of_no_cases_are_empty():
    assert rates([], []).alarms is None


def test_a_threshold_there_is_not_is_refused(capsys):
    with pytest.raises(SystemExit):
        main(["--names", "luck", "--cases", "1"])
    assert "luck: no threshold; choices: repeat_pairs" in capsys.readouterr().err
