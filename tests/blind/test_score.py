"""The scorer on reports made by hand, where the right table is known."""

import json

import pytest

from benchmarks.blind.claims import first_right, in_sets, true_names
from benchmarks.blind.score import main, score, table


def truth(stem="a", kind="one", lam=2.0, family="slip", target="joint 2", xy=False, noise="gauss", **more):
    effects = [
        {"family": family, "target": target, "lambda": lam, "amplitude": 1e-4, "unit": "rad", "invisible": False}
    ]
    machine = {f"{link}{i}": 244.0 for link in ("la", "lb") for i in (1, 2, 3)}
    return {
        "case": stem, "kind": kind, "xy": xy, "noise": noise, "effects": [] if kind == "none" else effects,
        "withheld": False, "parameters": machine,
    } | more  # fmt: skip


def report(*names, verdict="named", ci=(0.5e-4, 1.5e-4), after=1.0):
    findings = [
        {"effect": f"{family} {target}", "family": family, "target": target, "set": list(rivals),
         "amplitude": {"value": 1e-4, "unit": "rad", "ci95": list(ci)}}
        for family, target, rivals in names
    ]  # fmt: skip
    gap = {"noise_floor": 1.0, "held_out_after": after, "held_out_ci95": [0.9, 1.1], "excess_shrink": 0.9}
    found = {f"{link}{i}": {"before": 244.5, "after": 244.1, "sd": 0.1} for link in ("la", "lb") for i in (1, 2, 3)}
    return {"case": "a", "verdict": verdict, "findings": findings, "gap": gap, "parameters": found, "seconds": 0.1}


def row(rows, what, data="all"):
    [found] = [r for r in rows if r.what == what and r.data == data]
    return found


RIVAL = {"effect": "drift joint 2", "family": "drift", "target": "joint 2", "weight": 0.4}


def test_a_true_name_among_the_rivals_is_inside_the_set_but_not_first():
    told = report(("drift", "joint 2", [{**RIVAL, "family": "slip"}]))
    [true] = true_names(truth())
    assert in_sets(true, told, lenient=False)
    assert not first_right(true, told, lenient=False)
    assert not in_sets(("slip", "1"), told, lenient=True)


def test_an_unresolved_angle_error_counts_for_an_eccentric_disc_only_leniently_and_on_its_joint():
    told = report(("angle_error", "joint 2", []))
    assert in_sets(("eccentricity", "2"), told, lenient=True)
    assert not in_sets(("eccentricity", "2"), told, lenient=False)
    assert not in_sets(("eccentricity", "1"), told, lenient=True)
    assert not in_sets(("gear", "2"), told, lenient=True)
    assert not in_sets(("eccentricity", "2"), report(("second_harmonic", "joint 2", [])), lenient=True)


def test_rates_have_the_clopper_pearson_interval_and_the_bar_is_read_from_it():
    good = [(report(("slip", "joint 2", [])), truth())] * 19
    bad = [(report(verdict="none"), truth())]
    found = row(score(good + bad), "truth in the set, strict, lambda 1.5-2.5")
    assert (found.n, found.value) == (20, 0.95)
    assert found.low == pytest.approx(0.7513, abs=1e-4)
    assert found.high == pytest.approx(0.9987, abs=1e-4)
    assert found.reached
    worse = row(score(good + bad * 20), "truth in the set, strict, lambda 1.5-2.5")
    assert not worse.reached


def test_alarms_are_counted_by_noise_law_and_their_bar_is_from_above():
    quiet = [(report(verdict="none"), truth(kind="none"))] * 300
    loud = [(report(verdict="unknown"), truth(kind="none", noise="ar1"))] * 3
    rows = score(quiet + loud)
    assert row(rows, "alarm on nothing, gauss").value == 0.0
    assert row(rows, "alarm on nothing, gauss").reached
    assert row(rows, "alarm on nothing, ar1").value == 1.0
    assert not row(rows, "alarm on nothing, ar1").reached


def test_withheld_and_invisible_effects_are_no_misses():
    blind = truth(withheld=True)
    hidden = truth()
    hidden["effects"][0]["invisible"] = True
    rows = score([(report(verdict="none"), blind), (report(verdict="none"), hidden)])
    assert row(rows, "truth in the set, strict, lambda 1.5-2.5").n == 0


def test_two_effects_count_only_when_both_are_found():
    two = truth(kind="two")
    two["effects"] = [*two["effects"], {**two["effects"][0], "family": "gear", "target": "joint 1"}]
    both = report(("slip", "joint 2", []), ("gear", "joint 1", []))
    half = report(("slip", "joint 2", []))
    found = row(score([(both, two), (half, two)]), "both effects in sets, strict, lambda >= 1")
    assert (found.n, found.value) == (2, 0.5)


def test_twins_have_no_first_name_to_get_right():
    twin = truth(family="proximal_bending", target="leg 2")
    told = report(("compliance", "joint 2", [{**RIVAL, "family": "proximal_bending", "target": "leg 2"}]))
    rows = score([(told, twin)])
    assert row(rows, "first name right where one is given, strict, no twins, lambda >= 1").n == 0
    assert row(rows, "truth in the set, strict, lambda 1.5-2.5").value == 1.0
    assert row(rows, "mean set size, lambda >= .6").value == 2.0


def test_intervals_and_lengths_are_held_against_the_truth():
    bent = truth(family="gear")
    bent["effects"][0] |= {"unit": "rad"}
    told = report(("gear", "joint 2", []))
    rows = score([(told, bent), (report(verdict="none"), truth(kind="none"))])
    assert row(rows, "link error after gear or eccentricity, over no-effect's").value == pytest.approx(1.0)
    assert row(rows, "95 % interval of the amplitude covers").value == 1.0
    missed = report(("gear", "joint 2", []), ci=(2e-4, 3e-4))
    assert row(score([(missed, bent)]), "95 % interval of the amplitude covers").value == 0.0


def test_the_command_reads_lines_and_prints_the_table(tmp_path, capsys):
    (tmp_path / "blind").mkdir()
    for stem in ("a", "b"):
        (tmp_path / "blind" / f"{stem}.json").write_text(json.dumps(truth(stem)))
    lines = tmp_path / "reports.jsonl"
    lines.write_text(json.dumps(report(("slip", "joint 2", []))) + "\n")
    main(["--reports", str(lines), "--sealed", str(tmp_path / "blind")])
    printed = capsys.readouterr().out
    assert "truth in the set" in printed
    assert "1 truths without a report: b" in printed
    main(["--reports", str(lines), "--sealed", str(tmp_path / "blind"), "--json"])
    assert json.loads(capsys.readouterr().out)["unanswered"] == ["b"]
    lines.write_text(json.dumps({"case": "a", "error": "no column enc_2", "gap": None}) + "\n")
    main(["--reports", str(lines), "--sealed", str(tmp_path / "blind"), "--misses"])
    assert "slip joint 2 (2.00)  ->  refused" in capsys.readouterr().out
    lines.write_text("\n")
    with pytest.raises(ValueError, match="holds no report"):
        main(["--reports", str(lines), "--sealed", str(tmp_path / "blind")])
    lines.write_text(json.dumps({**report(), "case": "z"}) + "\n")
    with pytest.raises(ValueError, match="no truth"):
        main(["--reports", str(lines), "--sealed", str(tmp_path / "blind")])


def test_an_empty_group_is_a_line_without_numbers():
    assert " - " in table(score([(report(verdict="none"), truth(kind="none"))]))
