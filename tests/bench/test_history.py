"""A history tells where a method changed over versions of the code, and says so of none that did not."""

import json

import numpy as np
import pytest

from calibench.bench.tracking.history import Asked, change_point, drawing, histories, page, sentence
from tests.bench.tracked import version

pytestmark = pytest.mark.usefixtures("own_cache")

ASKED = Asked("sensor_zero", "de", "value")


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Return a folder of six versions: the first three alike, the third of other draws, the last three worse."""
    rng = np.random.default_rng(4)
    good, drawn_anew = ((1 + rng.random(10)).tolist() for _ in range(2))
    worse = [(4 + rng.random(10)).tolist() for _ in range(2)]
    folder = tmp_path_factory.mktemp("results")
    for day, values in enumerate([good, good, drawn_anew, worse[0], worse[0], worse[1]]):
        version(folder / f"v{day}", "abcdef"[day], values, day)
    return folder


def test_the_version_that_made_it_worse_is_named(results):
    [one], left_out = histories(results, ASKED)
    assert left_out == []
    assert [version.same for version in one.versions] == [False, True, False, False, True, False]
    assert {i: step.verdict for i, step in one.steps.items()} == {2: "undecided", 3: "worse", 5: "undecided"}
    assert one.change is not None
    assert (one.change.version, one.change.worse) == (3, True)
    assert one.change.p_holm < 0.01
    assert sentence(one).startswith("It became worse with dddd (2026-11-04); p 0.0")


def test_a_goal_that_nobody_reaches_is_drawn_by_value(results):
    [one], _ = histories(results, Asked("nothing,sensor_zero", "de"))
    assert (one.by, one.shown) == ("goal", "value")
    assert "best value" in drawing(one)
    assert one.change is not None
    assert one.change.worse


def test_versions_that_give_the_same_are_no_evidence(tmp_path):
    values = (1 + np.random.default_rng(0).random(10)).tolist()
    for day in range(6):
        version(tmp_path / "results" / f"v{day}", "abcdef"[day], values, day)
    [one], _ = histories(tmp_path / "results", ASKED)
    assert (one.steps, one.change) == ({}, None)
    assert "nothing changed" in sentence(one)


def test_one_change_of_all_draws_is_no_change_however_many_versions_had_each(tmp_path):
    rng = np.random.default_rng(1)
    first, second = (rng.random(10).tolist() for _ in range(2))
    for day in range(10):
        version(tmp_path / "results" / f"v{day}", "abcdefghij"[day], first if day < 5 else second, day)
    [one], _ = histories(tmp_path / "results", ASKED)
    assert len(one.steps) == 1
    assert one.change is not None
    assert one.change.p > 0.05


def test_a_code_that_ran_in_two_studies_is_one_version(tmp_path):
    for name, day in (("first", 0), ("again", 1)):
        version(tmp_path / "results" / name, "a", [1.0 + day, 2.0, 3.0], day)
    [one], _ = histories(tmp_path / "results", ASKED)
    assert [version.studies for version in one.versions] == [("first", "again")]
    assert len(one.versions[0].runs) == 6


@pytest.mark.parametrize("paired", [True, False])
def test_false_alarms_are_as_rare_as_stated_and_changes_are_found(paired):
    rng = np.random.default_rng(20)
    repetitions = [list(range(8)) if paired else list(range(8 * k, 8 * k + 8)) for k in range(6)]

    def alarms(factor, cases):
        found = []
        for case in range(cases):
            values = rng.lognormal(size=(6, 8)) * rng.lognormal(sigma=2.0 if paired else 0.1, size=8)
            values[3:] *= factor
            parts = [np.column_stack([row, np.zeros(8)]) for row in values]
            found.append(change_point(parts, repetitions, seed=case))
        return [(at, worse) for at, p, worse in found if p <= 0.05]

    assert len(alarms(1.0, 200)) <= 20  # of 200 at 5 %: 21 or more have a chance below 0.1 %
    seen = alarms(30.0, 20)
    assert len(seen) >= 18
    assert {worse for _, worse in seen} == {True}


def test_runs_that_a_change_left_alone_are_one_draw():
    rng = np.random.default_rng(21)
    alarms = 0
    for case in range(200):
        values = rng.lognormal(size=(8, 8))
        kept = np.vstack([np.zeros(8, dtype=bool), rng.random((7, 8)) < 0.6])
        for k in range(1, 8):
            values[k, kept[k]] = values[k - 1, kept[k]]
        parts = [np.column_stack([row, np.zeros(8)]) for row in values]
        alarms += change_point(parts, [list(range(8))] * 8, kept, case)[1] <= 0.05
    assert alarms <= 20


def test_continuous_integration_fails_on_a_regression_alone(results, run_bench):
    words = ["history", f"results={results}", "problem=sensor_zero", "optimizer=de", "by=value"]
    code, _, error = run_bench([*words, "--check"])
    assert (code, error.count("\n")) == (2, 1)  # nothing is tagged
    run_bench(["tag", "v0", "+baseline", f"results={results}"])
    code, out, _ = run_bench([*words, "--check", "tag=baseline"])
    assert code == 1
    assert "worse" in out
    run_bench(["tag", "v4", "+release", f"results={results}"])
    assert run_bench([*words, "--check"])[0] == 0  # the last with a tag
    assert run_bench([*words, "--check", "tag=none"])[0] == 2


def test_the_terminal_json_and_page_tell_it(results, run_bench, tmp_path):
    words = ["history", str(results), "problem=sensor*", "optimizer=de", "by=value"]
    code, out, _ = run_bench([*words, f"to={tmp_path / 'h.html'}"])
    assert code == 0
    assert "It became worse with dddd" in out
    text = (tmp_path / "h.html").read_text()
    assert text.count("<circle") == 6
    assert "http" not in text.replace("http://www.w3.org/2000/svg", "")
    [told] = json.loads(run_bench([*words, "--json"])[1])
    assert told["change"]["version"] == 3
    assert [one["same"] for one in told["versions"]] == [False, True, False, False, True, False]
    assert run_bench(["history", str(results), "problem=none", "optimizer=de"])[0] == 2


def test_names_of_a_hostile_study_do_not_leave_their_place(results):
    [one], _ = histories(results, ASKED)
    from dataclasses import replace

    sly = replace(one, problem="</svg><script>alert(1)</script>", optimizer='"onload="x')
    assert "<script>" not in page([sly]) + drawing(sly)
    assert 'label=""' not in drawing(sly)


@pytest.mark.parametrize("by", ["charged", "success"])
def test_every_order_of_runs_has_its_history(results, by):
    [one], _ = histories(results, Asked("sensor_zero", "de", by))
    assert "<svg" in drawing(one)
    assert (3 in one.steps) == (not one.versions[3].same)
