"""One reading that bends the whole fit is told by its numbers; a missing effect is not taken for one."""

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.discovery.page.words import first_notes
from calibench.discrepancy import MeasuredData
from calibench.discrepancy.diagnostics.one_reading import ALONE, one_reading
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


def test_a_reading_that_went_round_is_told_before_the_verdict() -> None:
    """The verdict was "nothing is missing", and nothing said why the error was 14 times the noise."""
    u, y = encoder()
    data, machine = line_of(u, y)
    report = discrepancy.explain(machine, data)
    [note] = [note for note in report.notes if ALONE in note]
    assert note.startswith(f"one reading (u {u[-1]:.0f}, y {y[-1]:.2f})")
    assert note in first_notes(report)


def test_what_is_told_is_what_a_fit_without_the_reading_leaves() -> None:
    u, y = encoder()
    [note] = one_reading(at(u, y))
    whole = np.std(y - np.polyval(np.polyfit(u, y, 1), u))
    left = np.std(y[:-1] - np.polyval(np.polyfit(u[:-1], y[:-1], 1), u[:-1]))
    assert f"lie {whole / left:.0f} times nearer" in note


@pytest.mark.parametrize("seed", range(20))
def test_noise_and_a_missing_cube_are_no_such_reading(seed: int) -> None:
    rng = np.random.default_rng(seed)
    u = rng.uniform(-1, 1, 12)
    assert one_reading(at(u, u + 0.1 * rng.standard_t(3, 12))) == ()
    assert one_reading(at(u, u + u**3 + 0.001 * rng.standard_normal(12))) == ()


def test_a_reading_that_alone_determines_a_parameter_tells_nothing_of_itself() -> None:
    u = np.array([0.0] * 9 + [1.0])
    y = np.append(0.1 * np.random.default_rng(2).standard_normal(9), 50.0)
    assert one_reading(at(u, y)) == ()
