"""An error that no formula fits is told so that its owner can act: what errs, over what, by how much, how it looks."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from calibench.bench.discovery.page.page import limits
from calibench.bench.discovery.page.words import headline, left_sentence, shortest_words, unnamed_sentences
from calibench.core.notes import Code
from calibench.discrepancy import Constraints, Joint, MeasuredData, Roles, explain
from calibench.discrepancy.report import Left, Nearest, Place, Report, Shortest, Unnamed
from calibench.discrepancy.search.smoother import _course, _place
from calibench.problems.base import Array, Parameter
from tests.discrepancy.test_probes_of_predicted import Polar, polar_readings

pytestmark = pytest.mark.usefixtures("at_one_noise", "without_formula")

SIGMA = 1e-5
ROLES = Roles((Joint("circle", "hz", told="arcsec"),), time="clock")


@dataclass(frozen=True)
class Circle:
    """A horizontal circle that reads known azimuths."""

    name: str = "circle"
    roles: Roles = ROLES

    def formulate(self, data: MeasuredData) -> Constraints:
        """Return the reading less the azimuth."""
        zero = (Parameter("zero", "rad", 0.0, -0.1, 0.1),)

        def closure(q: Any) -> Any:
            return (q["hz"] + q["zero"] - q["azimuth"])[:, None]

        return Constraints(data, closure, zero, {"hz": SIGMA}, inputs=("azimuth",), roles=self.roles)


@cache
def told(which: str) -> Report:
    """Return what is told of 200 readings with one of `HIDDEN`."""
    rng = np.random.default_rng(3)
    azimuth, clock = rng.uniform(0, 2 * np.pi, 200), np.sort(rng.uniform(0, 3600, 200))
    hz = azimuth + 0.01 + SIGMA * rng.standard_normal(200) + HIDDEN[which](azimuth, clock / 3600)
    return explain(Circle(), MeasuredData({"azimuth": azimuth, "hz": hz, "clock": clock}, "circle", {}, "run"))


HIDDEN: dict[str, Callable[[Array, Array], Array]] = {
    "in time": lambda a, s: 4 * SIGMA * (np.cos(2 * np.pi * 2.3 * s) + np.cos(2 * np.pi * 3.6 * s + 1)),
    "fine": lambda a, s: 3 * SIGMA * np.sin(301 * a),
}


def test_an_error_without_a_name_is_told_with_its_size_and_course() -> None:
    report = told("in time")
    assert report.verdict == "unknown"
    [one] = report.unnamed
    assert (one.quantity, one.covariate, one.unit) == ("hz", "clock", "arcsec")
    assert one.size == pytest.approx(
        np.ptp(HIDDEN["in time"](np.zeros(999), np.linspace(0, 1, 999))) * 206265, rel=0.15
    )
    assert re.search(r"about [3-4](\.5)? waves over the range", one.course)
    assert Report.from_dict(report.to_dict()).unnamed == report.unnamed
    assert Report.from_dict(report.to_dict()).nearest == report.nearest
    assert headline(report).endswith("the clearest sign is at hz (angle of circle), over time.")
    assert unnamed_sentences(report)[0].startswith("hz (angle of circle) errs over time by ")
    assert "shorter" not in " ".join(unnamed_sentences(report))


@pytest.mark.parametrize("middle", [0.45, 0.6])
def test_an_error_at_one_place_is_told_by_that_place(middle: float) -> None:
    rng = np.random.default_rng(4)
    azimuth, clock = rng.uniform(0, 2 * np.pi, 300), np.sort(rng.uniform(0, 3600, 300))
    bump = 12 * SIGMA * np.exp(-(((clock / 3600 - middle) / 0.06) ** 2))
    hz = azimuth + 0.01 + SIGMA * rng.standard_normal(300) + bump
    report = explain(Circle(), MeasuredData({"azimuth": azimuth, "hz": hz, "clock": clock}, "circle", {}, "run"))
    assert report.verdict == "unknown"
    [one] = [one for one in report.unnamed if one.covariate == "clock"]
    low, high = map(float, re.findall(r"most of it at one place, from (\d+) to (\d+)", one.course)[0])
    assert 3600 * (middle - 0.12) < low < 3600 * middle < high < 3600 * (middle + 0.12)
    assert not [note for note in report.notes if note.code is Code.ROWS_STAND_OUT]  # what was found explains them


def test_what_grows_towards_an_end_is_told_as_an_end_and_what_is_everywhere_by_its_shape() -> None:
    grid = np.linspace(0.0, 10.0, 400)
    assert _place(grid, np.exp(-grid / 0.7), "N", 1.0).startswith("most of it at one end, from 0 to ")
    assert _place(grid, np.exp((grid - 10) / 0.7), "", 1.0).endswith(" to 10")
    for everywhere, shape in (
        ((grid - 5) ** 2, "a bend"),
        (grid**3, "a line"),
        (np.sin(9 * grid), "waves over the range"),
    ):
        assert shape in _course(grid, everywhere, 0.0, _place(grid, everywhere, "N", 1.0))


def test_a_ripple_is_no_further_wave() -> None:
    at = np.linspace(0.0, 1.0, 400)
    rippled = np.sin(8 * np.pi * at) + 0.03 * np.sin(90 * np.pi * at)
    assert _course(at, rippled, 0.0, "") == "about 4.5 waves over the range"


def test_waves_that_are_too_short_to_be_looked_for_are_told() -> None:
    report = told("fine")
    assert (report.verdict, report.unnamed) == ("unknown", ())
    assert report.shortest == (Shortest("hz", pytest.approx(2 * np.pi / 64, rel=1e-3), "rad"),)
    said = "Waves shorter than 98.2 mrad over hz (angle of circle) were not looked for"
    said += ": that takes readings closer together"
    assert unnamed_sentences(report)[-1] == f"{said}."
    assert limits(report)["shortest"] == said
    assert shortest_words(Report("run", "circle", "none")) == ""


def test_the_nearest_formula_is_told_where_it_is_a_hint() -> None:
    one = Unnamed("x", "x", 0.02, "mm", "98 % a line")
    report = Report("run", "any", "unknown", unnamed=(one,), nearest=Nearest("gear slide", "gear", "slide", 0.87))
    assert unnamed_sentences(report) == [
        "x errs over its own range by 20.0 µm from its least to its largest: 98 % a line.",
        "Of the formulas scale error of slide is the nearest: it explains 87 % of what is more than noise, and "
        "what it leaves is still no noise. Look there first.",
    ]
    weak = replace(report, nearest=Nearest("gear slide", "gear", "slide", 0.3))
    assert unnamed_sentences(weak)[1].endswith(
        "it explains 30 % of what is more than noise, and what it leaves is still no noise."
    )
    far = Report("run", "any", "unknown", nearest=Nearest("gear slide", "gear", "slide", 0.1))
    assert unnamed_sentences(far) == []
    whole = Report("run", "any", "unknown", nearest=Nearest("gear slide", "gear", "slide", 1.0))
    assert "100 % of what is more than noise, and yet these readings do not tell" in unnamed_sentences(whole)[0]
    assert unnamed_sentences(Report("run", "any", "none", unnamed=(one,))) == []
    left = Report("run", "any", "partly", left=Left(2.0, Place("x", "y", 0.0)))
    assert left_sentence(left) == "2.0 times the noise is left, unnamed: clearest at x, over y."


def test_a_further_column_beside_joints_alone_is_told_to_have_no_names() -> None:
    rng = np.random.default_rng(3)
    azimuth, warm = rng.uniform(0, 2 * np.pi, 60), rng.uniform(0, 9, 60)
    columns = {"azimuth": azimuth, "hz": azimuth + SIGMA * rng.standard_normal(60), "warm": warm}
    with_column = replace(ROLES, time="", columns=("warm",))
    report = explain(Circle(roles=with_column), MeasuredData(columns, "circle", {}, "run"))
    assert any("columns warm: nothing but joints is read" in note.text for note in report.notes)
    assert not any("nothing but joints" in note.text for note in told("fine").notes)


def test_a_few_readings_are_told_to_show_nearly_nothing() -> None:
    azimuth = np.linspace(0, 6, 5)
    report = explain(Circle(), MeasuredData({"azimuth": azimuth, "hz": azimuth, "clock": azimuth}, "circle", {}, "run"))
    assert any("4 equations left after calibration" in note.text for note in report.notes)
    assert not any("equations left" in note.text for note in told("fine").notes)


def test_an_error_of_an_input_is_told_of_its_joint() -> None:
    data = polar_readings()
    s = (data["r"] - 20) / 120
    off = 0.06 * (s + 1.2 * np.sin(5 * s) * s)
    changed = {"x": data["x"] + off * np.cos(data["turn"]), "y": data["y"] + off * np.sin(data["turn"])}
    report = explain(Polar(), data.with_columns(changed))
    assert report.verdict == "unknown"
    assert (report.unnamed[0].quantity, report.unnamed[0].covariate, report.unnamed[0].unit) == ("r", "r", "mm")
    assert unnamed_sentences(report)[0].startswith("r (position of slide) errs over its own range by ")
    assert report.gap.held_out_after < 1.2 < 1.7 < report.gap.held_out_before
    assert np.isfinite(report.predict(data).measured["x"]).all()
