"""The words and the page of a verdict: every verdict reads, whatever a report lacks, and no name is trusted as HTML."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from benchmarks.blind.gpm2002.simulate import case
from calibench import discrepancy
from calibench.bench.discovery.page import figures, shown
from calibench.bench.discovery.page.figures import candidate_chart, gap_chart, residual_chart, where_map
from calibench.bench.discovery.page.page import Page, drawing
from calibench.bench.discovery.page.shown import Residuals, Series, Shown, shown_by
from calibench.bench.discovery.page.words import chance_sentence, gap_sentence, headline, moved_sentence, next_sentences
from calibench.bench.report.shared.page import inline_svg
from calibench.core.notes import Code, Note
from calibench.core.words import as_sentence
from calibench.discrepancy.model.machine import Correction
from calibench.discrepancy.report import Place, Report

RIVALS = [
    {"effect": "compliance joint 1", "family": "compliance", "target": "joint 1", "weight": 0.5},
    {"effect": "proximal_bending leg 1", "family": "proximal_bending", "target": "leg 1", "weight": 0.5},
]
FINDING = {
    **{key: RIVALS[0][key] for key in ("effect", "family", "target")},
    "amplitude": {"value": 2e-8, "unit": "rad/(N mm)", "ci95": [1.8e-8, 2.2e-8]},
    "gain": 817.0,
    "set": RIVALS,
    "separated_by": "look at the parts",
}
GAP = {"noise_floor": 1.0, "train_before": 2.4, "train_after": 1.0, "held_out_before": 2.5, "held_out_after": 1.02,
       "held_out_ci95": [0.9, 1.1], "excess_shrink": 0.99}  # fmt: skip
BARE = {"case": "run <7>", "machine": "gpm2002", "findings": [], "gap": {}, "where": [], "not_testable": [],
        "invisible": [], "parameters": {}, "seconds": 0.1}  # fmt: skip


def told(**changes):
    """Return a report that lacks all but what is said."""
    return Report.from_dict({**BARE, "verdict": "named", **changes})


@pytest.mark.parametrize(
    ("verdict", "findings", "said"),
    [
        ("none", [], "Nothing is missing from the model that these data could show."),
        ("negligible", [FINDING], "too small to matter against the noise: "),
        ("negligible", [], "too small to matter"),
        ("named", [{**FINDING, "set": RIVALS[:1]}], "model: compliance of joint 1, 20.0 µrad/(N m) (95 %"),
        ("ambiguous", [FINDING], "compliance of joint 1 or proximal bending of leg 1 (these data cannot tell which)"),
        ("unknown", [], "Something is missing that no effect of the catalogue explains."),
        ("unknown", [FINDING], "explains beside compliance of joint 1 or proximal bending"),
    ],
)  # fmt: skip
def test_every_verdict_is_a_sentence_and_a_page(verdict, findings, said):
    for gap in ({}, GAP, {**GAP, "held_out_before": None, "held_out_after": None, "held_out_ci95": [None, None]}):
        report = told(verdict=verdict, findings=findings, gap=gap)
        assert said in headline(report)
        page = Page(report).html()
        assert "run &lt;7&gt;" in page
        assert "<7>" not in page
        assert page.count("<h1>") == 1


def test_the_size_of_the_noise_is_told_where_it_is_one_and_has_a_unit():
    def said(*noises):
        return gap_sentence(told(findings=[FINDING], gap=GAP, reading_noise=list(noises)))

    tracker = {"columns": ["x", "y"], "size": 0.05, "unit": "mm"}
    assert "2.50 times the stated noise of 50.0 µm without the effect" in said(tracker)
    for noises in ((), (tracker, {"columns": ["enc_1"], "size": 2e-5, "unit": "rad"}), ({**tracker, "unit": "1"},)):
        assert "2.50 times the stated noise without the effect" in said(*noises)
    again = told(findings=[FINDING], gap=GAP, reading_noise=[tracker])
    assert Report.from_dict(again.to_dict()).reading_noise == again.reading_noise


def test_the_gap_is_told_on_what_there_was_to_tell_it_on():
    def named(gap):
        return told(findings=[FINDING], gap=gap)

    assert "not fitted the error is 2.50 times the stated noise without the effect and 1.02 (95 %: 0.90 to 1.10)" in (
        gap_sentence(named(GAP))
    )
    assert "of what is more than noise, 99 % (in squares) is gone" in gap_sentence(named(GAP))
    trained = {**GAP, "held_out_before": None, "held_out_after": None, "held_out_ci95": [None, None]}
    assert "On the fitted readings (none were held out) the error is 2.40" in gap_sentence(named(trained))
    assert "left out of the fit in turn" in gap_sentence(named({**GAP, "cross_validated": True}))
    small = {**GAP, "held_out_before": 1.25, "held_out_after": 0.25, "held_out_ci95": (0.2, 0.3)}
    unstated = replace(named(small), notes=(Note(Code.NOISE_UNSTATED, "told by the residuals"),))
    assert "brings the error to 0.20 times what it was (95 %: 0.16 to 0.24); nobody" in gap_sentence(unstated)
    assert "noise alone leaves" not in gap_sentence(unstated)
    assert "noise alone leaves" in gap_sentence(named(small))
    assert gap_sentence(named({})) == "The gap between model and data could not be measured."


def test_an_unknown_cause_still_has_a_place():
    where = [{"target": "leg 2", "covariate": "temp_K", "p": 1e-9}, {"target": "leg 1", "covariate": "t_s", "p": 0.3}]
    report = told(verdict="unknown", where=where)
    assert headline(report).endswith("the clearest sign is at leg 2, over the temperature above reference.")
    assert "spread evenly over the temperature above reference" in next_sentences(report)[0]
    in_time = told(verdict="unknown", where=[{"target": "leg 1", "covariate": "t_s", "p": 1e-9}])
    assert headline(in_time).endswith("the clearest sign is at leg 1, over time.")


OUTLIER = {"effect": "outlier joint 3", "family": "outlier", "target": "joint 3", "gain": 7376.0, "separated_by": None,
           "amplitude": {"value": 1e-3, "unit": "rad", "ci95": [8e-4, 1.4e-3]},
           "set": [{"effect": "outlier joint 3", "family": "outlier", "target": "joint 3", "weight": 1.0}]}  # fmt: skip


def test_noise_that_is_blamed_is_told_apart_from_what_is_missing():
    report = told(findings=[OUTLIER], gap=GAP, p=0.5)
    assert headline(report) == (
        "The noise is not as stated: outlying readings of joint 3, spread 1.00 mrad (95 %: 0.80 to 1.40 mrad; 0.057°)."
    )
    said = gap_sentence(replace(report, verdict="noise"))
    assert said.endswith("and stays so: these readings are trusted less; no error of the machine was corrected.")
    assert "is gone" not in said
    assert chance_sentence(replace(report, verdict="noise")).startswith("Beside this noise nothing missing shows")
    both = headline(told(findings=[FINDING, OUTLIER], verdict="ambiguous"))
    assert both.startswith("Missing from the model: compliance")
    assert "The noise is not as stated: outlying" in both


def test_a_size_without_an_interval_is_told_without_one():
    bare = {**OUTLIER, "amplitude": {"value": 1e-3, "unit": "rad", "ci95": [None, None]}}
    report = told(findings=[bare])
    assert headline(report).endswith("outlying readings of joint 3, spread 1.00 mrad (0.0573°).")
    assert "outlying readings of joint 3" in Page(report).html()


def test_what_makes_the_gap_no_smaller_is_said_to():
    grown = {**GAP, "held_out_after": 3.0, "excess_shrink": -0.3}
    said = gap_sentence(told(verdict="unknown", gap=grown))
    assert "with a smooth correction without a name" in said
    assert said.endswith("what was added makes it no smaller.")


def test_the_parameter_that_moves_furthest_is_named_with_its_unit():
    parameters = {"la1": {"before": 244.0, "after": 244.3, "sd": 0.1}, "z1": {"before": 1.0, "after": 1.01, "sd": 1e-3}}
    report = told(findings=[FINDING], parameters=parameters)
    assert moved_sentence(report, {"la1": "mm", "z1": "rad"}).startswith(
        "Of the calibrated parameters, z1 (encoder zero of joint 1) moves furthest: by 10.0 mrad, 10.0 standard errors"
    )
    assert moved_sentence(replace(report, verdict="none"), {}) == ""


def test_what_goes_back_to_the_machine_stands_on_the_page():
    page = Page(told(findings=[FINDING]), correction=Correction(".cfg", "[printer]\ndelta_radius = 160.7 # < 161\n"))
    assert "delta_radius = 160.7 # &lt; 161" in page.html()
    assert "correction.cfg" in page.html()
    assert "give back to the machine" not in Page(told(findings=[FINDING])).html()


@pytest.mark.parametrize(("p", "said"), [(0.4, "40 of 100"), (2e-3, "1 of 500"), (1e-9, "fewer than 1 of 100 000")])
def test_a_chance_is_told_in_cases(p, said):
    assert said in chance_sentence(told(p=p))


def test_the_map_keeps_each_cell_and_puts_a_legs_own_columns_in_one_row():
    where = [Place(f"leg {i}", f"vel_{i}", 10.0**-i) for i in (1, 2, 3)]
    figure, numbers = where_map("gpm2002", [*where, Place("leg 1", "t_s", 0.5)])
    assert numbers["strength"].tolist() == pytest.approx([1, 2, 3, 0.30103])
    assert [tick.get_text() for tick in figure.axes[0].get_yticklabels()] == ["its own velocity", "time"]


def test_means_of_the_residuals_are_weighted_and_have_their_standard_error():
    n = 400
    rng = np.random.default_rng(0)
    sigma = np.where(np.arange(n) % 2, 0.1, 10.0)
    values = np.repeat([-1.0, 1.0], n // 2)
    drawn = Residuals("backlash joint 1", "direction", "error", values, values + sigma * rng.normal(size=n),
                     sigma * rng.normal(size=n), sigma**-2.0)  # fmt: skip
    _, numbers = residual_chart(drawn)
    assert numbers["readings"].tolist() == [100, 100], "those that know it a hundred times worse tell nothing"
    assert numbers["standard_error"].to_numpy() == pytest.approx(0.1 / np.sqrt(100), rel=1e-3)
    assert np.all(np.abs(numbers["before"] - [-1, 1]) < 4 * numbers["standard_error"])


def test_a_gap_that_nothing_was_added_to_is_one_bar_with_its_interval():
    _, numbers = gap_chart(told(gap={**GAP, "held_out_after": GAP["held_out_before"]}).gap, ("without", "with"))
    assert numbers["model"].tolist() == ["as it is"]
    assert numbers[["low", "high"]].iloc[0].tolist() == [0.9, 1.1]


def test_candidates_are_drawn_best_first_with_the_set_dark():
    table = pd.DataFrame({"effect": ["a", "b"], "family": ["drift", "gear"], "target": ["joint 1"] * 2,
                          "gain": [3.0, 9.0], "in_set": [False, True]})  # fmt: skip
    figure, numbers = candidate_chart("gpm2002", table)
    assert numbers["effect"].tolist() == ["b", "a"]
    dark, light = (bar.get_facecolor() for bar in reversed(figure.axes[0].patches))
    assert dark != light


def test_a_drawing_inside_a_page_has_names_of_its_own():
    svg = '<?xml version="1.0"?><svg a="b"><metadata>x</metadata><g id="p1"/><use xlink:href="#p1"/></svg>'
    assert inline_svg(svg, "gap").svg == 'a="b"><g id="gap-p1"/><use xlink:href="#gap-p1"/></svg>'


def test_a_chart_is_drawn_where_every_reading_is_taken_for_outlying(monkeypatch):
    made = case(14, family="outlier", lam=3.0, xy=False)
    report = discrepancy.explain("gpm2002", discrepancy.MeasuredData(made.columns, "gpm2002", made.metadata))
    all_of_them = SimpleNamespace(weights=np.ones(len(report.model.fit.model.formulation.data)))
    monkeypatch.setattr(shown, "outliers_under", lambda *_: all_of_them)
    [drawn] = [one for one in shown_by(report, Series({})) if one.name == "noise_1"]
    _, table = figures.outliers_in_time(*drawn.values)
    assert table["outlying"].all()


@pytest.mark.parametrize(
    ("notes", "drawn"), [([Note(Code.NOISE_LEARNED, "that of y is learned").to_dict()], False), ([], True)]
)
def test_no_best_possible_error_is_drawn_from_noise_that_held_the_gap(notes, drawn):
    report = told(gap={**GAP, "held_out_before": 0.7, "held_out_after": 0.14}, notes=notes, findings=[FINDING])
    [gap] = [one for one in shown_by(report, Series({})) if one.name == "gap"]
    figure, _ = gap_chart(*gap.values)
    said = [text.get_text() for text in figure.axes[0].texts]
    assert any("best possible" in words for words in said) is drawn


def test_a_process_beside_draws_the_same_and_tells_what_it_could_not(tmp_path):
    report = told(gap=GAP, findings=[FINDING], where=[{"target": "leg 2", "covariate": "temp_K", "p": 1e-9}])
    both = [*shown_by(report, Series({}))]
    written = []
    for beside in (False, True):
        with drawing(beside) as draw:
            paths = draw(both, tmp_path / str(beside))
        assert [path.stem for path in paths] == [one.name for one in both]
        written.append([file.read_bytes() for path in paths for file in sorted(path.parent.glob(f"{path.stem}.*"))])
    assert written[0] == written[1]
    with drawing(beside=True) as draw, pytest.raises(TypeError, match="missing 1 required"):
        draw([Shown("gap", "gap_chart", (report.gap,))], tmp_path)


def test_a_remark_on_a_page_ends_as_it_is_meant_and_keeps_the_names_of_columns():
    assert as_sentence("endstop_a ends at 2 mm; are the units right?") == "endstop_a ends at 2 mm; are the units right?"
    assert as_sentence("no repeats tell the noise") == "No repeats tell the noise."
    assert as_sentence("tu ends at 2 mm", {"tu": 2.0}) == "tu ends at 2 mm."


def test_a_cell_in_which_nothing_disagrees_is_a_plain_nought():
    _, table = where_map("delta", [Place("height", "place", 1.0), Place("height", "t_s", 0.1)])
    assert [f"{strength:.1f}" for strength in table["strength"]] == ["0.0", "1.0"]
