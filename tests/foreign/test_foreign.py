"""The generator of foreign cases: sizes are what is seen, and its judge counts what it says."""

from pathlib import Path

import numpy as np
import pytest

from calibench.discrepancy.checks.validate import validate
from calibench.discrepancy.fitting.fit import reading_order
from calibench.discrepancy.registries import machines
from tests.foreign.causes import FOREIGN, noise
from tests.foreign.machines import MACHINES
from tests.foreign.run import case, handed, main, plainly, told, wilson


@pytest.mark.parametrize("words", [(), ("--help",), ("run", "foreign")])
def test_the_command_without_a_batch_tells_how_it_is_called(
    words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    main(*words)
    assert "python -m tests.foreign.run run foreign 910000 910060 OUT.jsonl" in capsys.readouterr().out


@pytest.mark.parametrize("machine", sorted(MACHINES))
def test_each_cause_errs_on_each_machine(machine: str) -> None:
    sound = case("sound", 7, machine=machine, rows=90)
    for cause in sorted(FOREIGN):
        drawn = case("foreign", 7, cause=cause, machine=machine, rows=90, visible=3.0)
        assert drawn.visible in (0.0, 3.0), cause
        assert set(drawn.columns) == set(sound.columns), cause
        assert all(np.isfinite(c).all() for c in drawn.columns.values() if c.dtype.kind == "f"), cause


@pytest.mark.parametrize("machine", sorted(MACHINES))
def test_what_calibration_takes_up_leaves_nothing(machine: str) -> None:
    m = MACHINES[machine](np.random.default_rng(1), 200)
    offset = np.zeros_like(m.day.q)
    offset[:, 0] = 1e-4  # the zero of an encoder
    none = np.zeros((len(m.day.t), m.push.shape[-1]))
    assert np.abs(m.left(offset, none)).max() < 1e-3 * np.abs(m.angle).max() * 1e-4


@pytest.mark.parametrize("law", ["gauss", "t3", "t4", "mixed", "carried", "patchy"])
def test_noise_of_every_law_is_of_unit_size(law: str) -> None:
    day = MACHINES["mount"](np.random.default_rng(2), 4000).day
    middle = np.median([np.sqrt(np.mean(noise(np.random.default_rng(s), day, 1, law) ** 2)) for s in range(9)])
    assert middle == pytest.approx(1.0, abs=0.08)


def test_a_name_with_a_caution_is_not_plain() -> None:
    name = {"family": "drift", "caution": [], "form": ""}
    assert plainly({"verdict": "named", "findings": [name]})
    assert not plainly({"verdict": "named", "findings": [name | {"caution": ["other_cause"]}]})
    assert not plainly({"verdict": "partly", "findings": [name]})
    assert plainly({"verdict": "named", "findings": [name | {"form": "size depends"}]}, strict=True)


def test_the_interval_of_none_of_many_is_narrow() -> None:
    low, high = wilson(0, 1000)
    assert low == pytest.approx(0, abs=1e-12)
    assert high < 0.004


@pytest.mark.parametrize("name", sorted(MACHINES))
def test_rows_keep_their_place_in_the_order_of_reading_when_others_are_left_out(name: str, tmp_path: Path) -> None:
    machine, data = handed(case("sound", 7, machine=name, rows=60), tmp_path)
    whole = validate(machines.make(machine) if isinstance(machine, str) else machine, data).data
    kept = np.arange(len(whole)) % 4 < 2
    np.testing.assert_array_equal(reading_order(whole.rows(kept)), np.flatnonzero(kept))


def test_one_far_reading_among_those_held_out_is_no_alarm() -> None:
    assert told("sound", 962097)["verdict"] == "none"


def test_noise_that_is_larger_for_a_while_is_no_drift() -> None:
    said = told("sound", 963007, rows=4704)
    assert (said["law"], said["verdict"]) == ("patchy", "none")
