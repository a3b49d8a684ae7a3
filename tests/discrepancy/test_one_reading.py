"""One reading that bends the whole fit is told by its numbers; a missing effect is not taken for one."""

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.discovery.page.words import FIRST
from calibench.core.notes import Code
from calibench.discrepancy import MeasuredData
from calibench.discrepancy.diagnostics.noise import one_reading
from calibench.discrepancy.fitting.fit import fit
from calibench.discrepancy.machines.table import Table
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.noise.whiten import Noise

pytestmark = pytest.mark.usefixtures("at_one_noise")


def line_of(u, y, model="line"):
    return MeasuredData({"u": u, "y": y}, "table", {}, "made"), Table(model=model, inputs=("u",))


def at(u, y, model="line"):
    data, machine = line_of(u, y, model)
    return fit(Model(machine.formulate(data)), Noise())


def encoder(seed=1, n=11):
    """Return counts of an encoder and angles, the last of which is a turn further than the counts say."""
    u = np.linspace(300, 16000, n)
    y = 360 * u / 16384 + 3 * np.random.default_rng(seed).standard_normal(n)
    u[-1] -= 16384 * (u[-1] > 15900)
    return u, y


@pytest.mark.slow
def test_a_reading_that_went_round_is_told_before_the_verdict() -> None:
    """The verdict was "nothing is missing", and nothing said why the error was 14 times the noise."""
    u, y = encoder()
    data, machine = line_of(u, y)
    report = discrepancy.explain(machine, data)
    [note] = [note for note in report.notes if note.code is Code.ONE_READING]
    assert note.rows == ("11",)
    assert note.text.startswith(f"one reading (row 11: u {u[-1]:.0f}, y {y[-1]:.2f})")
    assert note.code in FIRST


def test_what_is_told_is_what_a_fit_without_the_reading_leaves() -> None:
    u, y = encoder()
    row, times = one_reading(at(u, y))
    whole = np.std(y - np.polyval(np.polyfit(u, y, 1), u))
    left = np.std(y[:-1] - np.polyval(np.polyfit(u[:-1], y[:-1], 1), u[:-1]))
    assert row == len(u) - 1
    assert times == pytest.approx(whole / left, rel=0.05)


@pytest.mark.parametrize("seed", range(20))
def test_noise_and_a_missing_cube_are_no_such_reading(seed: int) -> None:
    rng = np.random.default_rng(seed)
    u = rng.uniform(-1, 1, 12)
    assert one_reading(at(u, u + 0.1 * rng.standard_t(3, 12))) is None
    assert one_reading(at(u, u + u**3 + 0.001 * rng.standard_normal(12))) is None


def test_a_reading_that_alone_determines_a_parameter_tells_nothing_of_itself() -> None:
    u = np.array([0.0] * 9 + [1.0])
    y = np.append(0.1 * np.random.default_rng(2).standard_normal(9), 50.0)
    assert one_reading(at(u, y)) is None


def waved(off=0.0, hold=True):
    """Return a line with a wave of period 2.5, a fifth of the rows held back; the ninth of these is `off`."""
    u = np.linspace(0, 10, 80)
    y = 2 * u + 1 + 0.4 * np.sin(2 * np.pi * u / 2.5) + 0.05 * np.random.default_rng(3).standard_normal(80)
    y[42] += off
    split = {"split": np.where(np.arange(80) % 5 == 2, "hold", "train")} if hold else {}
    return discrepancy.explain(
        Table(model="line", inputs=("u",)), MeasuredData({"u": u, "y": y, **split}, "table", {}, "made")
    )


def test_the_one_unseen_reading_that_makes_the_error_is_told_with_what_the_others_say() -> None:
    """The error was 27.4 with the wave and 29.1 without it, and nothing said that one misread row made both."""
    report, sound = waved(6.0), waved()
    [note] = [note for note in report.notes if note.code is Code.ONE_UNSEEN]
    assert note.text.startswith("one reading (row 43: u 5.3165, y 17.896) makes most of the error")
    assert note.values["times"] == pytest.approx(sound.gap.held_out_after / sound.gap.held_out_before, rel=0.1)
    assert report.gap.held_out_after > 0.9 * report.gap.held_out_before


def test_no_unseen_reading_is_told_where_all_are_sound() -> None:
    assert not [note for hold in (True, False) for note in waved(hold=hold).notes if note.code is Code.ONE_UNSEEN]
