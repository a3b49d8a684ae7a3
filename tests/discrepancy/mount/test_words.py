"""What an owner of a mount reads: terms by the field's names, arcsec everywhere, nothing of the other kind of mount."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.commands.discover import design as run
from calibench.bench.discovery.page.words import doubt_sentences, gap_sentence, headline, left_sentence
from calibench.bench.measured import read_measured, shipped_path
from calibench.discrepancy.design.detectability import design
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.labels import effect_label
from calibench.discrepancy.machines.mount import Mount
from calibench.discrepancy.machines.mount.description import planned
from calibench.discrepancy.report import Caution, Doubt, Left, OtherNoise, Place, Report


@cache
def _flexure() -> Report:
    """Return the report of the shipped night, which most of these words are about."""
    return discrepancy.explain("mount", read_measured(shipped_path("demo_flexure", "mount"), "mount"))


def test_a_term_keeps_its_name_in_a_label() -> None:
    assert effect_label("mount", "pier_IH", "mount") == "pier_IH (IH differs between the two sides of the pier)"
    assert effect_label("mount", "CH", "mount") == "CH (the tube is not square to the declination axis)"


def test_two_parts_of_one_circle_have_two_labels() -> None:
    labels = [effect_label("mount", name, "mount") for name in ("HCES", "HCEC")]
    assert labels[0].endswith(", sine)")
    assert labels[1].endswith(", cosine)")


def test_every_size_of_a_mount_is_told_in_arcsec() -> None:
    found = catalogue(Mount().formulate(planned(n=60)))
    assert {"drift", "slip"} <= {effect.family for effect in found.candidates}
    assert all(effect.unit.startswith("arcsec") for effect in found.candidates)


def test_a_slip_has_its_size_in_arcsec() -> None:
    data = planned(n=120)
    late = np.arange(120) >= 70
    slipped = data.with_columns({"dec": data["dec"] - np.radians(500 / 3600) * late})
    first, second = np.radians(np.random.default_rng(0).normal(0, 60, (2, 120)) / 3600)
    slipped = slipped.with_columns({"star_dec": slipped["star_dec"] + first})
    slipped = slipped.with_columns({"star_ha": slipped["star_ha"] + second / np.cos(slipped["star_dec"])})
    report = discrepancy.explain("mount", slipped)
    sizes = {f.family: f.amplitude for f in report.findings}
    assert "slip" in sizes
    assert sizes["slip"].unit == "arcsec"
    assert abs(sizes["slip"].value) == pytest.approx(500, rel=0.2)


def test_terms_of_the_other_kind_are_not_spoken_of() -> None:
    for mount in ("altaz", "equatorial"):
        found = catalogue(Mount().formulate(planned(n=60, mount=mount)))
        assert not any("other kind" in gap.reason for gap in found.untestable)


def test_noise_that_nobody_stated_is_not_called_stated() -> None:
    report = _flexure()
    said = " ".join([gap_sentence(report), *doubt_sentences(report)])
    assert "stated" not in said
    assert "times the noise" in said


def test_a_direction_that_only_rounding_leaves_is_invisible() -> None:
    """Stars at azimuths of 0, 90, 180 degrees: twice the sine is none of them, but for the last digits."""
    found = {sight.family: sight for sight in design("mount", planned("cross", mount="altaz")).candidates}
    assert not found["HSSA2"].visible
    assert not np.isfinite(found["HSSA2"].minimum_detectable)
    assert found["HSCA2"].minimum_detectable < 100


def test_no_size_that_is_printed_before_a_night_is_larger_than_the_sky(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["machine=mount", "plan=cross", "plan.mount=altaz", "next=0"]) == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("HSSA2")]
    assert rows
    assert "invisible" in rows[0]


def _partly(times: float, place: Place | None) -> Report:
    return replace(_flexure(), verdict="partly", left=Left(times, place))


def test_no_page_says_that_one_times_the_noise_is_left() -> None:
    place = Place("dX", "ha", 1e-7)
    assert left_sentence(_partly(0.8, place)) == (
        "What is left is no larger than the noise, but it is not random: clearest at dX "
        "(error on the sky, east-west), over the hour angle."
    )
    assert left_sentence(_partly(1.0, None)) == "What is left is no larger than the noise, but it is not random."
    assert left_sentence(_partly(1.3, None)) == "1.3 times the noise is left, unnamed."


def test_what_would_be_named_at_another_noise_is_said_by_name() -> None:
    report = replace(_partly(1.0, None), verdict="unknown", findings=(), left=None)
    report = replace(report, other_noise=(OtherNoise(2.0, "named", ("TF mount", "drift hour angle axis")),))
    assert "TF (the tube droops, by the sine of the zenith distance) and drift of hour angle axis would be named" in (
        " ".join(doubt_sentences(report))
    )


def test_a_term_is_explained_once_and_called_by_its_code_then() -> None:
    report = _flexure()
    doubt = (Caution(Doubt.FORMULA_ERROR),)
    report = replace(report, findings=tuple(replace(f, caution=doubt) for f in report.findings))
    assert "TF (the tube droops" in headline(report)
    assert doubt_sentences(report) == [
        "TF may be the error of the first formula.",
        "Repeats do not tell the noise. At half the noise, TF would be named, with something left that has no name; at "
        "twice the noise, TF would be named.",
    ]


def test_many_names_are_told_without_intervals_and_not_one_by_one_again() -> None:
    report = _flexure()
    [finding] = report.findings
    four = [replace(finding, effect=f"{code} mount", family=code, set=()) for code in ("TF", "CH", "NP", "HCES")]
    assert "95 %" in headline(replace(report, findings=tuple(four[:3])))
    held = (
        OtherNoise(0.5, "partly", tuple(f.effect for f in four)),
        OtherNoise(2.0, "named", ("TF mount", "NP mount")),
    )
    held = (*held, OtherNoise(4.0, "named", ("TF mount", "CH mount", "NP mount")))
    many = replace(report, findings=tuple(four), other_noise=held, verdict="partly", left=None)
    assert headline(many).startswith("Parts of what is missing have names: TF (the tube droops")
    assert "95 %" not in headline(many)
    assert doubt_sentences(many)[-1] == (
        "Repeats do not tell the noise. At half the noise, all of these names would be found, with something left that "
        "has no name; at twice the noise, TF and NP would be named; at 4 times the noise, all of these names but HCES "
        "would be found."
    )


def test_a_term_that_no_headline_names_is_explained_where_it_comes_first() -> None:
    report = replace(_partly(1.0, None), verdict="none", findings=(), left=None)
    both = (OtherNoise(0.5, "named", ("TF mount",)), OtherNoise(2.0, "named", ("TF mount",)))
    [said] = doubt_sentences(replace(report, other_noise=both))
    assert said.count("the tube droops") == 1
    assert said.endswith("at twice the noise, TF would be named.")


def test_noise_that_too_few_stars_cannot_tell_is_not_called_stated() -> None:
    data = read_measured(shipped_path("demo_flexure", "mount"), "mount")
    report = discrepancy.explain("mount", data.rows(np.arange(4)))
    assert "stated" not in gap_sentence(report)
    assert "the noise is not stated: 4 stars cannot tell it, and 1 arcsec is taken; sigma_arcsec= states it" in (
        map(str, report.notes)
    )
