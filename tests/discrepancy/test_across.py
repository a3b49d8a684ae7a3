"""Several sets of one machine: a cause is in all of them, what chance made is in one, and what was mended is gone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calibench.bench.discovery.page.page import across_table
from calibench.bench.discovery.page.words import across_sentences, doubt_sentences, headline
from calibench.discrepancy import Joint, MeasuredData, Report, Roles, carried, explain
from calibench.discrepancy.report import Caution, Doubt
from tests.discrepancy.test_general_families import Arm, readings

pytestmark = pytest.mark.usefixtures("at_one_noise")

BARE = Roles((Joint("shoulder", "a"), Joint("elbow", "b")))


def _play(size):
    return lambda q, d: {"b": q["b"] + size * d["side_b"]}


def _wave(phase=0.0, order=17.0):
    return lambda q, d: {"b": q["b"] + 6e-4 * np.sin(order * q["b"] + 1.0 + phase)}


def _day(seed, change=lambda q, d: {}, name="", **others):
    return replace(readings(seed, change, **others), name=name or f"day {seed}")


@cache
def _of_play():
    return explain(Arm(), _day(1, _play(3e-4)))


@cache
def _of_wave():
    return explain(Arm(BARE), _day(1, _wave()))


def _only(report, *others):
    report = carried(report, others)
    assert [row.effect for row in report.across] == [f.effect for f in report.findings for _ in others]
    return report, report.across[0]


def test_a_backlash_of_the_machine_carries_to_its_other_set():
    report, row = _only(_of_play(), _day(2, _play(3e-4)))
    assert [f.effect for f in report.findings] == ["backlash elbow"]
    assert (row.case, row.verdict, row.why, row.agrees) == ("day 2", "carries", "", True)
    low, high = row.there.ci95
    assert low < row.size.value < high
    assert row.apart < 2.5
    assert min(row.gain, row.held_out_gain) > 100
    assert "carries to day 2 (" in across_sentences(report)[0]


def test_a_backlash_that_was_mended_does_not_carry():
    report, row = _only(_of_play(), _day(2))
    assert (row.verdict, row.why) == ("does not carry", "nothing of it shows")
    assert row.there.ci95[0] < 0 < row.there.ci95[1]
    assert row.gain < 0
    assert "does not carry to day 2 (nothing of it shows" in across_sentences(report)[0]


def test_a_backlash_that_was_halved_is_another_one():
    _, row = _only(_of_play(), _day(2, _play(1.5e-4)))
    assert (row.verdict, row.why, row.agrees) == ("does not carry", "another size is there", False)
    assert row.apart > 5


def test_a_size_that_no_machine_has_is_none_there_either():
    report, row = _only(_of_play(), _day(2, _play(0.5)))
    assert (row.verdict, row.why) == ("not testable there", "the size that fits there is one that no machine has")
    assert not np.isfinite(row.there.value)
    assert "no machine has" in across_sentences(report)[0]


def test_each_set_answers_by_itself_in_the_order_of_the_findings():
    report = carried(_of_play(), [_day(2), _day(3, _play(3e-4))])
    assert [(row.case, row.verdict) for row in report.across] == [("day 2", "does not carry"), ("day 3", "carries")]
    table = across_table(report)
    assert [row[1] for row in table.rows] == ["day 2", "day 3"]
    assert "<b>carries</b>" in str(table.rows[1][2])
    assert not across_table(_of_play()).rows


def test_what_another_set_cannot_test_is_said_with_the_reason():
    bare = _day(2, _play(3e-4))
    bare = MeasuredData({n: c for n, c in bare.columns.items() if n != "side_b"}, bare.machine, name=bare.name)
    _, row = _only(_of_play(), bare)
    assert row.verdict == "not testable there"
    assert "side_b" in row.why


def test_readings_too_few_for_a_size_do_not_deny_it():
    small, few = explain(Arm(), _day(1, _play(2.5e-5))), np.arange(240) < 16
    for change in (_play(2.5e-5), lambda q, d: {}):
        _, row = _only(small, _day(2, change).rows(few))
        assert (row.effect, row.verdict) == ("backlash elbow", "not testable there")
        assert "too few to show" in row.why
    assert _only(small, _day(2))[1].verdict == "does not carry"


def test_what_happened_once_in_a_run_is_of_that_run():
    slip = explain(Arm(), _day(1, lambda q, d: {"b": q["b"] + 6e-4 * (d["clock"] > 2000)}))
    _, row = _only(slip, _day(2))
    assert (row.effect, row.verdict) == ("slip elbow", "not testable there")
    assert "time of its run" in row.why


def test_a_run_of_its_own_slip_does_not_spoil_what_carries():
    def both(at):
        return lambda q, d: {"b": q["b"] + 3e-4 * d["side_b"] + 6e-4 * (d["clock"] > at)}

    report = carried(explain(Arm(), _day(1, both(2000))), [_day(2, both(3400))])
    verdicts = {row.effect: row for row in report.across}
    assert set(verdicts) == {"backlash elbow", "slip elbow"}
    row = verdicts["backlash elbow"]
    assert row.verdict == "carries"
    assert row.there.ci95[1] - row.there.ci95[0] < 1.5 * (row.size.ci95[1] - row.size.ci95[0])


def test_a_wave_is_periodic_over_its_readings_until_another_set_has_it():
    report = _of_wave()
    assert [(f.effect, f.caution) for f in report.findings] == [("periodic_error elbow", (Caution(Doubt.UNCONFIRMED),))]
    assert report.verdict == "named"
    assert "is periodic over these readings" in doubt_sentences(report)[0]
    assert ", periodic over these readings: period 369." in headline(report)
    confirmed, row = _only(report, _day(2, _wave()))
    assert row.verdict == "carries"
    assert row.period == pytest.approx(report.findings[0].period, rel=0.01)
    assert [f.caution for f in confirmed.findings] == [()]
    assert ", period 369." in headline(confirmed)


def test_the_doubt_of_several_waves_is_one_sentence():
    [wave] = _of_wave().findings
    other = replace(wave, effect="periodic_error shoulder", target="shoulder")
    [said] = doubt_sentences(replace(_of_wave(), findings=(wave, other), other_noise=()))
    assert "elbow" in said
    assert "shoulder: each is periodic over these readings; another set" in said


@pytest.mark.parametrize("other", [None, _wave(phase=np.pi / 2), _wave(order=21.4)], ids=["none", "phase", "period"])
def test_a_wave_that_another_set_does_not_have_is_of_its_readings_alone(other):
    report, row = _only(_of_wave(), _day(2, *[other] * (other is not None)))
    assert row.verdict == "does not carry"
    assert report.findings[0].caution == (Caution(Doubt.NOT_ELSEWHERE, cases=("day 2",)),)
    assert "periodic over these readings, and not over those of day 2." in doubt_sentences(report)[0]


def test_other_sets_are_one_sentence_however_many_findings_there_are():
    report = carried(_of_play(), [_day(2)])
    [row], [play] = report.across, report.findings
    second = replace(play, effect="slip elbow", family="slip")
    both = replace(report, findings=(play, second), across=(row, replace(row, effect="slip elbow", gain=-0.2)))
    [said] = across_sentences(both)
    assert said.count("Of other sets") == 1
    assert said.count("does not carry to day 2") == 2
    assert across_table(both).rows[1][-2] == "0"


def test_other_sets_go_into_the_report_and_come_back():
    report = carried(_of_play(), [_day(2)])
    assert Report.from_dict(report.to_dict()).across == report.across
    assert carried(explain(Arm(), _day(5)), [_day(2)]).across == ()


def test_only_measured_data_are_other_sets():
    with pytest.raises(TypeError, match="others: a str: MeasuredData"):
        carried(_of_play(), ["day2.csv"])
