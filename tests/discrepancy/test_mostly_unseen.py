"""An error of an angle over a short arc: its formula may be hundredfold what the arc shows, and a note says so."""

from dataclasses import replace

import numpy as np
import pytest

from calibench.bench.discovery.page.page import Page
from calibench.bench.discovery.page.words import SIZES
from calibench.core.notes import Code
from calibench.discrepancy import Joint, MeasuredData, Predicted, Roles, explain
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting.fit import fit
from calibench.discrepancy.model.effect import name_of
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.remarks import Search, on_the_findings
from calibench.discrepancy.report import Gap
from calibench.problems.base import Parameter

pytestmark = pytest.mark.usefixtures("at_one_noise")

ROLES = Roles(joints=(Joint("turntable", "angle"),))
PARAMETERS = (Parameter("zero", "rad", 0.0, -0.1, 0.1), Parameter("radius", "mm", 400.0, 390.0, 410.0))
SWING = 4e-4  # rad


class Turntable:
    name = "turntable"

    def formulate(self, data):
        def place(q):
            at = q["angle"] + q["zero"]
            return np.stack([q["radius"] * np.cos(at), q["radius"] * np.sin(at)], axis=-1)

        return Predicted(data, place, PARAMETERS, measured={"x": 0.005, "y": 0.005}, inputs=("angle",), roles=ROLES)


def told(arc, error):
    rng = np.random.default_rng(4)
    angle = np.linspace(-arc / 2, arc / 2, 300)
    at = angle + error(angle) + 0.01
    columns = {"x": 400.5 * np.cos(at), "y": 400.5 * np.sin(at)}
    columns = {name: values + 0.005 * rng.standard_normal(300) for name, values in columns.items()}
    return explain(Turntable(), MeasuredData({"angle": angle, **columns}, "turntable", {}, "made"))


def test_what_the_arc_shows_of_a_larger_formula_is_told() -> None:
    report = told(1.2, lambda angle: SWING * np.sin(2 * np.pi * angle / 1.1))
    [finding] = report.findings
    assert finding.family == "angle_error"
    assert abs(finding.amplitude.value) > 20 * SWING
    [note] = [note for note in report.notes if note.code is Code.MOSTLY_UNSEEN]
    assert note.text.startswith("angle error of turntable: over what was read it goes up and down by ")
    assert [note for note in report.notes if note.code in SIZES] == [note]
    page = Page(report, notes=report.notes).html()
    box = page.partition("<h2>")[0]
    assert page.count("its terms cancel there") == box.count("its terms cancel there") == 1
    assert note.values["swing"] == pytest.approx(SWING, rel=0.25)


def test_over_a_whole_turn_the_size_is_what_is_seen() -> None:
    report = told(2 * np.pi, lambda angle: SWING * np.cos(angle))
    assert [finding.family for finding in report.findings] == ["eccentricity"]
    assert Code.MOSTLY_UNSEEN not in {note.code for note in report.notes}


def test_two_names_that_move_a_joint_against_each_other_are_told() -> None:
    """A scale of 2.7 % and an angle error of 45 mrad stood beside each other, where a joint bent by .6 mrad."""
    report = told(1.2, lambda angle: SWING * np.sin(2 * np.pi * angle / 1.1))
    before = report.fitted.before.fit
    known = {effect.family: effect for effect in catalogue(before.model.formulation).candidates}

    def notes(*families):
        at = fit(Model(before.model.formulation, tuple(known[f] for f in families)), before.noise)
        findings = tuple(replace(report.findings[0], effect=name_of(known[f]), family=f) for f in families)
        search = Search(
            machine="turntable", base=before, final=at, selection=None, verdict="named", findings=findings, gap=Gap(),
            lone=None,
        )  # fmt: skip
        return [note for note in on_the_findings(search) if note.code is Code.AGAINST_EACH_OTHER]

    [note] = notes("angle_error", "gear")
    assert note.text.startswith("angle error of turntable and ")
    assert notes("angle_error") == notes("gear") == []
