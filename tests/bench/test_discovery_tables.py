"""The tables and the reach of a verdict's page: numbers that do not puzzle, and every section it promises."""

import itertools
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from benchmarks.blind.gpm2002.simulate import case as planar_case
from benchmarks.blind.orthoglide import case
from calibench import discrepancy
from calibench.bench.discovery.page.figures import candidate_chart, gap_chart, residual_chart, where_map, workspace_map
from calibench.bench.discovery.page.page import Page, parameter_table, score_table, set_table, smallest, untested_lines
from calibench.bench.discovery.page.shown import Residuals, series_of
from calibench.bench.discovery.page.words import column_sentence, headline, next_sentences
from calibench.bench.report.shared.page import macros
from calibench.discrepancy.labels import effect_label
from calibench.discrepancy.model.effect import Untestable
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.report import Candidate, Gap, Place
from tests.bench.test_discovery_page import FINDING, GAP, told
from tests.discrepancy.test_form import sprung

pytestmark = pytest.mark.usefixtures("at_one_noise")


def _words(html):
    return re.sub(r"\s+", " ", re.sub("<[^>]+>", " ", html))


def _html(table):
    return macros("report/shared/templates/parts.html.j2").table(table)


def _limits(report):
    page = Page(report).html()
    return page[page.index("What these data could not tell") :]


def _candidate(family, target, fraction, least, unit, span=float("nan")):
    return Candidate(f"{family} {target}", family, target, 1.0, 0.1, fraction, least, unit, span)


def test_the_smallest_size_over_a_column_is_told_per_unit_of_it_as_a_finding_is():
    over = _candidate("parameter_over", "k over temp_K", 0.5, 2.0, "mm", 10.0)
    assert smallest(over) == "0.200 mm per unit of temp_K"
    assert smallest(_candidate("parameter_over", "k over t_s", 0.5, 2.0, "mm", 10.0)) == "0.200 mm per s"
    assert smallest(_candidate("link_length", "la1", 0.5, 2.0, "mm")) == "2.00 mm"


def test_a_parameter_has_its_unit_its_meaning_and_no_negative_zero():
    moves = {"la1": {"before": 244.0, "after": 243.99999, "sd": 0.1}, "z1": {"before": 1.0, "after": 1.1, "sd": 0.01}}
    table = _words(_html(parameter_table(told(parameters=moves), {"la1": "mm", "z1": "rad"}, moved=True)))
    assert "la1 [mm] proximal link 1 244.00 244.00 0.10 0.00 0.0" in table
    assert "z1 [rad] encoder zero of joint 1 1.000 1.100 0.010 +0.100 +10.0" in table


def test_a_large_standard_error_is_told_without_an_exponent():
    moves = {"z1": {"before": 10.0, "after": 5000.0, "sd": 1634.0}, "z2": {"before": 1.0, "after": 70.0, "sd": 23.4}}
    table = _words(_html(parameter_table(told(parameters=moves), {"z1": "arcsec", "z2": "arcsec"}, moved=True)))
    assert "10 5000 1600 +4990 +3.1" in table
    assert "1 70 23 +69 +2.9" in table


def test_cells_know_their_heads_for_a_screen_without_columns():
    report = told(findings=[FINDING])
    tables = set_table(report, {"compliance": ("A drive twists", "enc_i -= kappa tau_i")}), score_table(report)
    heads = [set(re.findall('data-head="([^"]+)"', _html(table))) for table in tables]
    assert "size" in heads[0]
    assert {"weight", "gain"} <= heads[1] - heads[0]


def test_gain_and_weight_stand_behind_a_fold():
    page = Page(told(findings=[FINDING])).html()
    assert "<details>" in page
    inside = page[page.index("<details>") : page.index("</details>")]
    assert "gain" in inside
    assert 'data-head="weight"' in inside
    assert 'data-head="weight"' not in page.replace(inside, "")


def test_a_size_that_no_machine_has_is_none():
    lean = _candidate("axis_orthogonality", "all", 0.9, 3.1, "rad")
    assert "none below 1 rad" in _limits(replace(told(verdict="unknown"), candidates=(lean,)))


def test_what_all_but_vanishes_is_told_beside_what_does():
    gear, backlash = (
        _candidate("gear", "joint 2", 0.002, 0.004, "1"),
        _candidate("backlash", "joint 1", 0.9, 5e-5, "rad"),
    )
    lost = {"effect": "lag all", "family": "lag", "target": "all", "visible_fraction": 0.0, "minimum_detectable": None}
    section = _limits(replace(told(invisible=[lost]), candidates=(gear, backlash)))
    hidden = _words(section[section.index("Invisible") : section.index("<details>")])
    assert "timing lag of all encoders 0 % none: no size shows" in hidden
    assert "gear-ratio error of joint 2 0.2 % 0.400 %" in hidden
    assert "backlash" not in hidden
    assert "50.0 µrad" in section
    assert "<details open>" in _limits(replace(told(verdict="none"), candidates=(gear,)))
    nothing = _limits(replace(told(), candidates=(backlash,)))
    assert "Every effect of the catalogue could be tested." in nothing
    assert "Nothing was invisible" in nothing


def test_columns_that_were_not_recorded_are_asked_for():
    untested = [Untestable("backlash", f"joint {i}", "no direction", (f"dir_{i}",), missing=True) for i in (1, 2)]
    untested += [
        Untestable(f, "all", "no thermometer", ("temp_K",), missing=True) for f in ("thermal_links", "thermal_base")
    ]
    untested.append(Untestable("gravity", "all", "needs columns that vary", ("payload_N",)))
    report = replace(told(verdict="unknown"), not_testable=tuple(untested))
    assert column_sentence(report) == (
        "columns that would let more effects be tested: dir_1, dir_2 (backlash); temp_K (thermal growth)."
    )
    assert len(next_sentences(report)) == 2
    assert next_sentences(replace(report, verdict="named")) == []
    assert "dir_1, dir_2 (backlash)" in Page(replace(report, verdict="none")).html()


def test_targets_that_lack_the_same_are_one_line():
    lacking = [
        Untestable("lag", f"joint {i}", f"joint {i} declares no velocity: with a column of it this could be tested", ())
        for i in (1, 2)
    ]
    assert untested_lines("gpm2002", lacking) == [
        "timing lag of joint 1, 2: each of them declares no velocity: with a column of it this could be tested"
    ]
    assert untested_lines("gpm2002", lacking[1:]) == [f"timing lag of joint 2: {lacking[1].reason}"]


def test_few_values_have_a_tick_each_only_where_their_labels_have_room():
    def ticks(values):
        each = np.repeat(np.asarray(values, dtype=float), 4)
        like = Residuals("play", "way [um]", "error [um]", each, np.sin(each), np.cos(each), np.ones(len(each)))
        figure, _ = residual_chart(like)
        return figure.axes[0].get_xticks().tolist()

    assert ticks([-1, 0, 1]) == [-1, 0, 1]
    crowded = [-104.3, -86.1, -84.8, -59.7, 22.9, 29.4, 38.0, 71.8, 74.3, 119.1]
    assert 71.8 not in ticks(crowded)
    assert len(ticks(crowded)) > 3


def test_names_of_candidates_do_not_overlap():
    """Names of several lines: the rows are as high as the highest of them."""
    names = [f"an error in the hour angle that comes back twice in a turn of axis {k}" for k in range(6)]
    table = pd.DataFrame({"family": names, "target": "", "gain": 9.0, "in_set": False, "chosen": False})
    figure, _ = candidate_chart("none such", table)
    FigureCanvasAgg(figure).draw()
    boxes = [label.get_window_extent() for label in figure.axes[0].get_yticklabels()]
    assert all("\n" in label.get_text() for label in figure.axes[0].get_yticklabels())
    assert all(below.y1 <= above.y0 for below, above in itertools.pairwise(boxes))


def test_gains_of_rounding_errors_have_no_scale_of_their_own():
    table = pd.DataFrame({"family": ["a", "b"], "target": "", "gain": [0.0, -1e-17], "in_set": False, "chosen": False})
    figure, _ = candidate_chart("none such", table)
    assert np.ptp(figure.axes[0].get_xlim()) > 1


def test_a_cycle_is_drawn_over_the_period_that_was_found():
    across = np.arange(200.0)
    wave = 3 * np.sin(2 * np.pi * across / 11.3)
    noise = 0.3 * np.random.default_rng(4).standard_normal(200)
    data = MeasuredData({"month": across, "y": wave + noise}, "table", {})
    report = discrepancy.explain("table", data)
    assert [finding.family for finding in report.findings] == ["cycle"]
    (drawn,) = series_of(report).residuals
    assert drawn.label == "month within one period"
    assert 10.5 < drawn.values.max() < 11.5


def test_the_bar_of_the_gap_has_its_interval_in_numbers():
    """The number stands at the whisker's end: alone it reads as that end."""
    gap = Gap(1.44, 30.0, 30.0, 20.09, 20.09, (10.45, 38.6))
    figure, _ = gap_chart(gap, ("without", "with"))
    assert "20.09 (10.45 to 38.60)" in [text.get_text() for text in figure.axes[0].texts]


def test_the_map_says_what_its_columns_and_rows_are():
    figure, _ = where_map("gpm2002", [Place("leg 1", "t_s", 0.01)])
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("residual of", "over")


def test_a_target_is_not_said_twice():
    assert effect_label("gpm2002", "base_shift", "base 2") == "shift of base 2"
    assert effect_label("orthoglide", "gauge_tilt", "gauge x_y") == "tilt of gauge x_y"
    assert effect_label("gpm2002", "base_shift", "") == "base shift"


def test_the_size_of_a_set_is_that_of_its_first():
    assert headline(told(verdict="ambiguous", findings=[FINDING])).endswith(
        "(these data cannot tell which): 20.0 µrad/(N m) (95 %: 18.0 to 22.0 µrad/(N m)) if it is the first."
    )


FAMILIES = ("backlash", "compliance", "encoder_sine", "gear_error")


def _set(*members):
    """Return a report of a set: (family, target, weight) each, of which the first has the size."""
    rivals = [{"effect": f"{f} {t}", "family": f, "target": t, "weight": w} for f, t, w in members]
    first = {key: rivals[0][key] for key in ("effect", "family", "target")}
    return told(verdict="ambiguous", findings=[{**FINDING, **first, "set": rivals}])


def test_a_large_set_is_told_by_its_number_and_its_likeliest():
    members = [("backlash", "joint 1", 0.3), ("thermal_links", "all", 0.1), ("compliance", "joint 2", 0.4),
               ("thermal_base", "all", 0.15), ("proximal_bending", "leg 1", 0.05)]  # fmt: skip
    said = headline(_set(*members))
    assert said.startswith(
        "Missing from the model: one of 5 effects (these data cannot tell which), most likely compliance of joint 2 "
        "(40 %) or backlash of joint 1 (30 %): 20.0 µrad/(N m) (95 %"
    )
    assert said.endswith(" if it is backlash of joint 1.")


def test_of_a_large_set_none_is_likeliest_where_the_next_is_as_likely():
    said = headline(_set(*((f, "joint 2", 0.25) for f in FAMILIES)))
    assert "cannot tell which), such as backlash of joint 2 (25 %), compliance of joint 2 (25 %) or " in said
    assert said.endswith(" if it is the first.")


def test_a_large_set_tells_the_part_or_the_kind_that_its_members_share():
    assert "one of 4 effects of joint 2 (these" in headline(_set(*((f, "joint 2", 0.25) for f in FAMILIES)))
    two = [(f, f"joint {k}", 0.25) for f in FAMILIES[:2] for k in (3, 1)]
    assert "one of 4 effects of joint 3 or joint 1 (these" in headline(_set(*two))
    four = [(f, target, 0.25) for f, target in zip(FAMILIES, ("joint 1", "joint 2", "joint 3", "leg 1"))]
    assert "one of 4 effects of 4 parts (these" in headline(_set(*four))
    one = [("backlash", target, 0.25) for _, target, _ in four]
    assert "one of 4 effects of one kind, backlash (these" in headline(_set(*one))


def test_the_table_of_a_large_set_has_the_weight_of_each_member():
    table = set_table(_set(*((f, "joint 2", weight) for f, weight in zip(FAMILIES, (0.1, 0.2, 0.3, 0.4)))), {})
    assert [head.title for head in table.heads] == ["effect", "weight", "what it is", "size"]
    assert [row[1] for row in table.rows] == ["40 %", "30 %", "20 %", "10 %"]


@pytest.mark.parametrize("verdict", ["none", "negligible", "noise", "named", "ambiguous", "unknown"])
def test_every_page_has_where_gap_next_and_limits(verdict):
    findings = [] if verdict in ("none", "unknown") else [FINDING]
    page = Page(told(verdict=verdict, findings=findings, gap=GAP), {"gap": "<svg/>"}, noise="50 µrad").html()
    heads = re.findall("<h2>(.*?)</h2>", page)
    assert {"Where model and data disagree", "What to measure next", "What these data could not tell"} <= set(heads)
    assert "1 is the stated noise of a reading: 50 µrad." in page
    assert "is anything missing from the model of gpm2002?" in page


def test_the_gap_says_whether_it_was_cross_validated():
    drawn = {"gap": "<svg/>"}
    assert "kept from the fit" in Page(told(verdict="none", gap=GAP), drawn).html()
    crossed = Page(told(verdict="none", gap={**GAP, "cross_validated": True}), drawn).html()
    assert "left out of the fit in turn" in crossed


def test_of_candidates_that_gain_the_same_the_reported_one_comes_first():
    table = pd.DataFrame({"effect": ["a", "b"], "family": ["drift", "gear"], "target": ["joint 1"] * 2,
                          "gain": [9.0000001, 9.0], "in_set": [True, True], "chosen": [False, True]})  # fmt: skip
    figure, numbers = candidate_chart("gpm2002", table)
    assert numbers["effect"].tolist() == ["b", "a"]
    assert "on the shortlist" in figure.axes[0].get_xlabel()
    assert "on the shortlist" not in candidate_chart("gpm2002", table.assign(in_set=False))[0].axes[0].get_xlabel()


def test_no_dot_is_cut_off_without_a_mark():
    rng = np.random.default_rng(1)
    values, before = rng.uniform(size=300), rng.normal(size=300)
    before[7] = 40.0
    figure, _ = residual_chart(Residuals("drift", "time", "error", values, before, 0 * before, np.ones(300)))
    axes = figure.axes[0]
    top = axes.get_ylim()[1]
    inside = next(line for line in axes.lines if line.get_marker() == ".")
    marked = [line for line in axes.lines if line.get_marker() in ("^", "v")]
    beyond = int(np.sum(np.abs(inside.get_ydata()) > top))
    assert 1 <= beyond <= 6
    assert sum(len(line.get_ydata()) for line in marked) == beyond


def test_a_region_without_readings_is_not_one_without_residual():
    rng = np.random.default_rng(2)
    figure, _ = workspace_map(*rng.uniform(size=(2, 100)), rng.normal(size=100))
    assert figure.axes[0].get_facecolor()[:3] != (1.0, 1.0, 1.0)


@pytest.mark.slow
def test_an_effect_that_depends_on_no_column_is_drawn_over_what_it_changes():
    made = case(5, "bar_skew", "leg z", 3.0, "cross")
    report = discrepancy.explain("orthoglide", discrepancy.MeasuredData(made.columns, "orthoglide", made.metadata))
    assert report.findings[0].family == "bar_skew"
    [drawn] = series_of(report).residuals
    assert drawn.label == "what the effect changes of it [µm]"
    assert drawn.error == "error of the reading [µm]"
    slopes = [
        np.polyfit(drawn.values, implied, 1, w=np.sqrt(drawn.weight))[0] for implied in (drawn.before, drawn.after)
    ]
    assert slopes == pytest.approx([1, 0], abs=0.1)


def test_of_two_effects_each_picture_leaves_out_its_own_alone():
    made = planar_case(52, kind="two", xy=False)
    report = discrepancy.explain("gpm2002", discrepancy.MeasuredData(made.columns, "gpm2002", made.metadata))
    assert [finding.family for finding in report.findings] == ["angle_error", "backlash"]
    drawn = series_of(report).residuals
    assert [residuals.effect for residuals in drawn] == ["angle error of joint 3", "backlash of joint 3"]
    _, means = residual_chart(drawn[1])
    means = means.set_index(means["value"].round())
    step = means.loc[1.0] - means.loc[-1.0]
    play = 1e3 * report.findings[1].amplitude.value
    assert abs(step["before"]) == pytest.approx(play, rel=0.35)  # mrad; the other effect does not bury it
    assert abs(step["after"]) < 0.1 * play


def test_an_effect_is_drawn_with_its_form_once_and_over_a_column_with_the_unit_of_the_file():
    [drawn] = series_of(sprung()).residuals
    assert (drawn.effect, drawn.label) == ("compliance of axis", "force of axis [N]")
    assert drawn.error == "error of position of axis [µm]"
    assert np.std(drawn.before) > 2 * np.std(drawn.after)


def test_readings_that_hardly_know_a_quantity_do_not_set_the_scale_of_its_drawing() -> None:
    """Of a stage probed in height, a tilt of 3 mm/m tells where it stands to .7 mm; its distances tell microns."""
    rng = np.random.default_rng(3)
    sigma = np.repeat([0.003, 0.7], [50, 70])
    values = rng.uniform(18, 22, 120)
    before = 0.01 * (values - 20) + sigma * rng.standard_normal(120)
    figure, means = residual_chart(Residuals("thermal_zero", "time", "error", values, before, before, sigma**-2))
    assert figure.axes[0].get_ylim()[1] < 0.06
    assert means["readings"].sum() == 50
