"""The table of thresholds: half and twice each value, the same cases, and what changes."""

import pytest

from benchmarks.thresholds import main, rates, rows, scaled
from calibench.discrepancy.thresholds import about


def test_half_and_twice_stay_values_of_their_kind():
    for told in about().values():
        for factor in (0.5, 2.0):
            value = scaled(told.default, factor)
            assert type(value) is type(told.default)
            assert value > 0
            assert not 0.5 < told.default < 1 or value < 1


@pytest.mark.slow  # some minute
def test_the_table_has_a_line_for_each_value_and_counts_what_changes():
    first, half, twice = rows(["matters"], range(900_000, 900_003))
    assert (first[0], first[3]) == ("defaults", "0")
    assert [half[0], half[2], twice[2]] == ["matters", "0.075", "0.3"]
    assert all(0 <= int(line[3]) <= 3 for line in (half, twice))


def test_rates_of_no_cases_are_empty():
    assert rates([], []).alarms is None


def test_a_threshold_there_is_not_is_refused(capsys):
    with pytest.raises(SystemExit):
        main(["--names", "luck", "--cases", "1"])
    assert "luck: no threshold; choices: repeat_pairs" in capsys.readouterr().err
