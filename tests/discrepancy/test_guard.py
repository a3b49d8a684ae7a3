"""A name is a claim: what errs on its part beside it, and waves that one set shows, are told with it."""

import ast
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calibench.discrepancy.report import Doubt
from calibench.discrepancy.search.guard import _Error, _factor, _likely
from tests.foreign import causes, machines
from tests.foreign.run import case, in_a_set, plainly, told

pytestmark = pytest.mark.usefixtures("at_one_noise", "without_formula")


def test_friction_that_falls_with_speed_brings_no_lag() -> None:
    said = told("foreign", 918001, machine="gpm2002", cause="stribeck")
    assert [f["family"] for f in said["findings"]] == ["backlash"]
    assert "velocity" in said["findings"][0]["form"]


def test_a_sag_to_one_side_that_grows_is_no_plain_harmonic() -> None:
    said = told("foreign", 916101, machine="mount")
    assert said["cause"] == "sag"
    assert said["verdict"] == "partly"
    assert all({Doubt.OTHER_CAUSE, Doubt.ONE_CAUSE} & {*f["caution"]} for f in said["findings"])


def test_several_names_that_one_function_explains_are_no_plain_names() -> None:
    said = told("foreign", 920056)
    assert (said["machine"], said["cause"]) == ("mount", "slow_heat")
    assert said["verdict"] == "partly"
    assert any(Doubt.ONE_CAUSE in f["caution"] for f in said["findings"])
    assert not plainly(said)


def test_a_line_in_time_is_no_plain_drift_where_a_free_course_is_likelier() -> None:
    said = told("foreign", 960080)
    assert said["cause"] == "hot"  # a zero that follows the warmth squared
    assert said["findings"][0]["family"] == "drift"
    assert said["verdict"] == "partly"
    assert Doubt.ONE_CAUSE in said["findings"][0]["caution"]


def test_a_series_of_waves_names_nothing_where_a_free_course_is_as_likely() -> None:
    said = told("foreign", 975145)
    assert said["cause"] == "sag"  # to one side only
    assert [f["family"] for f in said["findings"]] == ["angle_error"]
    assert said["verdict"] == "partly"
    assert Doubt.ONE_CAUSE in said["findings"][0]["caution"]


def test_a_series_stands_where_a_simpler_formula_of_its_set_does() -> None:
    said = told("off_form", 971109)
    assert said["cause"] == "eccentricity"
    assert said["findings"][0]["set"][:2] == ["angle_error d", "eccentricity d"]
    assert said["verdict"] == "ambiguous"
    assert not said["findings"][0]["caution"]


def test_several_names_whose_sizes_all_depend_on_another_column_are_no_plain_names() -> None:
    said = told("foreign", 970071)
    assert (said["machine"], said["cause"]) == ("mount", "flex")
    assert said["verdict"] == "partly"
    assert all(Doubt.ONE_CAUSE in f["caution"] for f in said["findings"])


def test_the_form_of_a_sine_is_that_of_its_cosine() -> None:
    said = told("foreign", 975135)
    assert {f["effect"] for f in said["findings"]} == {"ACES mount", "ACEC mount"}
    assert all(f["form"] == "size depends on the azimuth" for f in said["findings"])


def test_the_sine_and_the_cosine_of_a_circle_off_its_centre_are_one_cause() -> None:
    said = told("off_form", 951048)
    assert {"ACES mount", "ACEC mount"} < {f["effect"] for f in said["findings"]}
    assert plainly(said)


def test_noise_that_is_carried_on_is_no_alarm_where_no_pose_is_read_again() -> None:
    said = told("sound", 922044)
    assert (said["law"], said["verdict"]) == ("carried", "none")
    assert "noise_carried" in said["notes"]


def test_waves_of_a_free_period_wait_for_a_second_set() -> None:
    said = told("foreign", 917000, machine="arm")
    assert said["cause"] == "beat"
    assert said["findings"]
    assert all(Doubt.UNCONFIRMED in f["caution"] for f in said["findings"])
    assert not plainly(said)


def test_two_waves_of_nearly_one_period_are_a_beat_and_no_two_causes() -> None:
    said = told("foreign", 980057)
    assert (said["cause"], said["verdict"]) == ("beat", "partly")
    assert [Doubt.ONE_CAUSE in f["caution"] for f in said["findings"]] == [True, True]


def test_two_names_and_a_name_beside_the_error_of_its_form_are_weighed_each_by_itself() -> None:
    assert told("foreign", 1000930)["verdict"] == "partly"  # asks of both in one search


def test_play_whose_size_goes_with_the_velocity_may_be_friction() -> None:
    said = told("foreign", 980042)
    assert (said["cause"], said["verdict"]) == ("stribeck", "partly")
    assert [(f["effect"], f["caution"]) for f in said["findings"]] == [("backlash d", [Doubt.ONE_CAUSE])]


@pytest.mark.parametrize(("machine", "cause"), [("gpm2002", "drift"), ("arm", "backlash"), ("mount", "slip")])
def test_a_cause_in_a_form_of_its_own_keeps_its_name_without_a_caution(machine: str, cause: str) -> None:
    said = told("off_form", 915002, machine=machine, cause=cause)
    assert in_a_set(said)
    assert not any(f["caution"] for f in said["findings"] if f["family"] == cause)


def test_smooth_errors_are_as_likely_together_as_each_by_the_whole_covariance() -> None:
    rng = np.random.default_rng(2)
    y, names = 3 * rng.standard_normal(40), rng.standard_normal((40, 2))
    given, errors, covariances = np.column_stack([y, names]), [], []
    for functions in (3, 1, 12):  # fewer and more than the columns that rounding leaves
        A = rng.standard_normal((40, 8)) @ rng.standard_normal((8, functions))
        variances = rng.uniform(0.1, 1, functions)
        errors.append(_Error.of(*_factor(A.T @ A, A.T @ given), given.T @ given, variances, 1.0))
        covariances.append((A * variances) @ A.T)
    for gain in (1.0, 0.5):  # of the noise, when the same error is asked for again
        part: Any = SimpleNamespace(gain=gain, degrees=40, least=1.0)
        likely = _likely(errors, np.array([0.0, 0.3, 5.0]), part)
        for (j, own), (k, size) in product(enumerate(covariances), enumerate((0.0, 0.3, 5.0))):
            for row, beside in enumerate((0 * names, gain * names)):
                V = np.eye(40) + size**2 * own + beside @ beside.T
                left = gain**2 * float(y @ np.linalg.solve(V, y))
                noise = max(1.0, left / 40)
                exact = -0.5 * (40 * np.log(noise) + left / noise + np.linalg.slogdet(V)[1])
                assert likely[j, row, k] == pytest.approx(exact, rel=1e-9)


def test_the_foreign_machines_share_nothing_with_the_package() -> None:
    for module in (machines, causes):
        tree = ast.parse(Path(str(module.__file__)).read_text())
        names = [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
        names += [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
        assert {name.split(".")[0] for name in names} <= {"__future__", "collections", "dataclasses", "typing", "numpy",
                                                          "tests"}  # fmt: skip


def test_a_foreign_case_is_the_same_every_time() -> None:
    one, other = (case("foreign", 916101).columns for _ in range(2))
    assert all((one[name] == other[name]).all() for name in one)
