"""A name whose size may be 0, and with which unseen readings lie no nearer, is no name: the verdict is unknown."""

from math import nan
from types import SimpleNamespace

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.discovery.page.words import gap_sentence, headline
from calibench.bench.measured import read_measured
from calibench.discrepancy.procedure import _carried_by_nothing
from tests.independent.delta import Firmware, honest, measured, places, printer_cfg, spoilt

pytestmark = pytest.mark.usefixtures("at_one_noise")


@pytest.mark.parametrize("seed", [37, 58])
def test_seven_heights_of_a_bed_like_a_saddle_have_no_name(tmp_path, seed) -> None:
    """It was one of twelve names, of a size that might be 0, beside "what was added makes it no smaller"."""
    rng, firmware = np.random.default_rng([7, seed]), Firmware()
    printer = honest(firmware, rng)
    for cause, size in (("single_rod tower b", 0.1), ("tower_angle tower a", 0.001), ("saddle", 0.15)):
        printer = spoilt(printer, cause, size * rng.standard_normal(), rng)
    probed, *ends = places(rng, 7, 0, 140.0)
    columns, _ = measured(printer, firmware, probed, ends, (0.05, 0.05), rng)
    file = tmp_path / "printer.cfg"
    file.write_text(printer_cfg(columns, firmware, firmware.mm_per_step, 140.0))
    report = discrepancy.explain("delta", read_measured(file, "delta"))
    assert (report.verdict, report.findings) == ("unknown", ())
    assert headline(report).startswith("Something is missing that no effect of the catalogue explains")
    assert "makes it no smaller" not in gap_sentence(report)


def found(low, high):
    return SimpleNamespace(amplitude=SimpleNamespace(ci95=(low, high)))


def gap(before, after):
    return SimpleNamespace(held_out_before=before, held_out_after=after)


@pytest.mark.parametrize(
    ("findings", "seen", "nothing"),
    [
        ([found(-1, 1)], gap(2.0, 2.5), True),
        ([found(-1, 1)], gap(2.0, 1.5), False),  # unseen readings are nearer
        ([found(-1, 1)], gap(nan, nan), False),  # nobody looked
        ([found(0.5, 1)], gap(2.0, 2.5), False),
        ([found(0.5, 1)], gap(2.0, 4.5), True),  # unseen readings are far worse
        ([found(-1, 1), found(0.5, 1)], gap(2.0, 2.5), False),
        ([found(nan, nan)], gap(2.0, 2.5), False),
        ([], gap(2.0, 4.5), False),
    ],
)
def test_a_name_goes_that_is_of_no_sure_size_and_no_help_or_does_harm(findings, seen, nothing) -> None:
    assert _carried_by_nothing(findings, seen) is nothing
