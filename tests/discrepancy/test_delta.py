"""The delta: kinematics against rods held by iteration, Klipper's file, what is named, the lines that go back."""

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibench import discrepancy
from calibench.bench.discovery.page.words import gap_sentence, next_sentences
from calibench.bench.measured.files import read_measured
from calibench.bench.measured.sources import shipped_path
from calibench.discrepancy import DataError, MeasuredData, Model
from calibench.discrepancy.diagnostics.noise import sensor_scales
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting.fit import fit
from calibench.discrepancy.labels import quantity_label
from calibench.discrepancy.machines.delta.description import corrected, planned, read_printer_cfg
from calibench.discrepancy.machines.delta.formulation import IMPERFECTIONS, TOWERS, nozzle
from calibench.discrepancy.model.machine import complex_step_slopes
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.registries import own_families
from tests.few import few
from tests.independent import delta as independent
from tests.independent.write_printer import text

pytestmark = pytest.mark.usefixtures("at_one_noise")

GIVEN = Path(os.environ.get("CALIBENCH_DATA", Path(__file__).parents[3] / "shared" / "data"))
V400 = GIVEN / "delta_v400"
measured_printer = pytest.mark.skipif(
    not V400.is_dir(), reason=f"no measured printer at {V400}; CALIBENCH_DATA names a folder that has delta_v400"
)
SIZE = {"delta_radius all", "rod_length all", "belt_scale all"}  # what heights cannot part


def owner(seed=1, heights=19, distances=12, sigma=(0.02, 0.05), **wrong):
    """Return a printer with causes of given sizes wrong, its firmware, and what its owner measures with it."""
    rng, firmware = np.random.default_rng(seed), independent.Firmware()
    printer = independent.honest(firmware, rng)
    for cause, size in wrong.items():
        printer = independent.spoilt(printer, cause.replace("__", " "), size, rng)
    probed, *ends = independent.places(rng, heights, distances, 140.0)
    columns, metadata = independent.measured(printer, firmware, probed, ends, sigma, rng)
    return printer, firmware, MeasuredData(columns, "delta", metadata, "own")


def named(report):
    return [{rival.effect for rival in finding.set} for finding in report.findings]


def test_no_belt_loses_all_its_length_and_no_tower_lies_down():
    _, _, data = owner()
    found = catalogue(discrepancy.machines.make("delta").formulate(data)).candidates
    largest = {"1": 0.5, "rad": 0.3}
    assert {e.largest for e in found if e.family in ("belt_scale", "shrinkage", "effector_tilt")} == {largest["1"]}
    assert {e.largest for e in found if e.family in ("bed_tilt", "tower_angle", "tower_lean")} == {largest["rad"]}


def test_the_nozzle_hangs_where_the_rods_hold_it():
    printer, _, _ = owner(3, tower_angle__tower__b=0.01)
    printer = replace(printer, rods=printer.rods + np.array([0.4, -0.7, 1.1]), wave=np.zeros(3))
    travel = np.random.default_rng(0).uniform(380, 480, (40, 3))
    q = dict.fromkeys(IMPERFECTIONS, 0.0) | {"radius": 160.0, "bed_radius": 140.0}
    for i, t in enumerate(TOWERS):
        x, y = printer.towers[i]
        q[f"angle_{t}"], q[f"d_radius_{t}"] = np.arctan2(y, x), np.hypot(x, y) - 160.0
        q[f"arm_{t}"] = 340.0
        q[f"d_rod_{t}"] = printer.rods[i] - 340.0
        q[f"endstop_{t}"] = printer.switches[i] - np.sqrt(340.0**2 - 160.0**2)
    expected = printer.nozzle(travel * independent.STEPS)
    assert np.stack(nozzle(q, travel.T), axis=-1) == pytest.approx(expected, abs=1e-9)


def test_slopes_of_all_quantities_at_once_are_those_of_each():
    formulation = discrepancy.machines.make("delta").formulate(planned("rings"))
    q = Model(formulation).quantities(Model(formulation).start + 0.3)[1]
    one_by_one = complex_step_slopes(formulation, q)
    for name, slope in formulation.slopes(q).items():
        assert slope == pytest.approx(one_by_one[name], abs=1e-12), name


def test_a_carriage_may_have_what_any_slide_has():
    searched = catalogue(discrepancy.machines.make("delta").formulate(watched(owner(5)[2])))
    general = {effect.family for effect in searched.candidates} - {family.name for family in own_families("delta")}
    assert general == {"backlash", "drift", "slip", "thermal_zero"}
    assert not searched.untestable


def watched(data, seed=0):
    """Return the data with a clock, a thermometer, and which way each carriage came."""
    rng, n = np.random.default_rng(seed), len(data)
    ways = {f"direction_{t}": np.where(data["kind"] == "height", rng.choice([-1.0, 1.0], n), np.nan) for t in TOWERS}
    return data.with_columns({"t_s": 30.0 * np.arange(n), "temp_K": rng.normal(0, 2, n).cumsum(), **ways})


def test_play_of_a_carriage_is_named_where_its_direction_is_told():
    rng, firmware = np.random.default_rng(7), independent.Firmware()
    probed, *ends = independent.places(rng, 37, 0, 140.0)
    way = rng.choice([-1.0, 1.0], (37, 3))
    printer = independent.honest(firmware, rng)
    printer = replace(printer, switches=printer.switches + 0.5 * 0.15 * way * [1.0, 0.0, 0.0])
    steps = firmware.steps(independent.at_bed(probed))
    height = printer.nozzle(steps)[:, 2] + 0.02 * rng.standard_normal(37)
    _, metadata = independent.measured(independent.honest(firmware, rng), firmware, probed, ends, (0.02, 0.05), rng)
    columns = {"kind": np.full(37, "height"), "height": height}
    columns |= {f"steps_{t}": steps[:, i] for i, t in enumerate(TOWERS)}
    columns |= {f"direction_{t}": way[:, i] for i, t in enumerate(TOWERS)}
    report = discrepancy.explain("delta", MeasuredData(columns, "delta", metadata, "play"))
    assert report.findings[0].effect == "backlash tower a"
    assert abs(report.findings[0].amplitude.value) == pytest.approx(0.15, rel=0.3)


def test_nothing_is_missing_where_nothing_is_wrong():
    assert discrepancy.explain("delta", owner(11)[2]).verdict == "none"


def test_heights_alone_leave_radius_rods_belts_and_a_domed_bed_as_one_set():
    report = discrepancy.explain("delta", owner(2, 37, 0, delta_radius__all=1.0)[2])
    [together] = named(report)
    assert {"delta_radius all", "rod_length all", "belt_scale all"} <= together
    assert "caliper" in report.findings[0].separated_by


@pytest.mark.parametrize(
    ("cause", "size"),
    few(1, [("tower_radius tower c", 0.5), ("belt_scale tower a", 0.003), ("single_rod tower b", 1.5)]),
)
def test_seven_heights_leave_all_that_they_cannot_part_in_the_set(cause, size):
    report = discrepancy.explain("delta", owner(3, 7, 0, **{cause.replace(" ", "__"): size})[2])
    together = set().union(*named(report))
    assert cause in together
    assert len(together) > 2


def test_without_a_name_heights_still_ask_for_the_readings_that_part_what_came_nearest():
    """Of seven rough heights nothing is named; radius, rods and belts, which came nearest, take a printed object."""
    data = owner(7, 7, 0, delta_radius__all=0.5)[2]
    rough = data["height"] + 0.3 * np.random.default_rng(7).standard_normal(len(data))
    report = discrepancy.explain("delta", data.with_columns({"height": rough}))
    assert report.verdict == "unknown"
    assert next_sentences(report)[0].startswith("a printed object: distances measured by caliper")
    assert discrepancy.Report.from_dict(report.to_dict()).parted_by == report.parted_by
    far = owner(1, 19, 24, delta_radius__all=0.5)[2]  # distances are there: nothing more to ask for
    rough = far["height"] + np.random.default_rng(1).standard_normal(len(far))
    report = discrepancy.explain("delta", far.with_columns({"height": rough}))
    assert (report.verdict, report.parted_by) == ("unknown", ())


def test_so_few_heights_that_the_others_predict_none_are_not_left_out_of_a_fit():
    report = discrepancy.explain("delta", owner(2, 7, 0, delta_radius__all=1.4, single_rod__tower__b=1.2)[2])
    assert not report.gap.cross_validated
    assert "On the fitted readings (none were held out)" in gap_sentence(report)
    assert report.gap.train_after < report.gap.train_before


@pytest.mark.parametrize("size", [*(pytest.param(size, marks=pytest.mark.slow) for size in (0.5, 2.0)), 8.0])
def test_large_errors_in_heights_are_not_taken_for_another_unit(size):
    data = owner(2, 19, 24, caliper_offset__all=size)[2]
    assert discrepancy.explain("delta", data).findings


def test_distances_part_them():
    report = discrepancy.explain("delta", owner(2, 37, 24, delta_radius__all=1.0)[2])
    assert {"delta_radius all"} in named(report)


@pytest.mark.slow
def test_the_lines_for_printer_cfg_leave_noise_only():
    wrong = {"rod_length__all": 1.2, "tower_angle__tower__b": 0.004}
    printer, firmware, data = owner(4, 37, 24, (0.01, 0.03), **wrong)
    assert residual_heights(printer, firmware) > 0.5
    again = independent.firmware_of(corrected(discrepancy.explain("delta", data)).text)
    assert residual_heights(printer, again) < 3 * 0.01
    columns, metadata = independent.measured(printer, again, *probed_again(), (0.01, 0.03), np.random.default_rng(9))
    assert discrepancy.explain("delta", MeasuredData(columns, "delta", metadata, "again")).verdict == "none"


def probed_again():
    probed, *ends = independent.places(np.random.default_rng(8), 37, 24, 140.0)
    return probed, ends


def residual_heights(printer, firmware):
    """Return the rms height over the bed [mm] at which the nozzle hangs where the firmware means it to touch."""
    points = independent.at_bed(probed_again()[0])
    return float(np.sqrt(np.mean(printer.nozzle(firmware.steps(points))[:, 2] ** 2)))


def test_a_belt_s_scale_goes_back_as_rotation_distance():
    rng, firmware = np.random.default_rng(6), independent.Firmware()
    printer = independent.honest(firmware, rng)
    printer = replace(printer, mm_per_step=printer.mm_per_step * [1.004, 1.0, 1.0])
    columns, metadata = independent.measured(printer, firmware, *probed_again(), (0.01, 0.03), rng)
    report = discrepancy.explain("delta", MeasuredData(columns, "delta", metadata, "belt"))
    assert "belt_scale tower a" in named(report)[0]
    again = independent.firmware_of(corrected(report).text)
    assert again.mm_per_step * independent.STEPS == pytest.approx([1.004, 1.0, 1.0], abs=8e-4)


def test_the_file_that_ships_is_the_one_that_is_written():
    assert shipped_path("printer", "delta").read_text() == text()


def test_a_printer_cfg_is_read_with_its_saved_block():
    data = read_measured(shipped_path("printer", "delta"), "delta")
    assert (data["kind"] == "height").sum() == 19
    assert (data["kind"] == "distance").sum() == 12
    assert data.metadata["steps_per_mm"] == [80.0, 80.0, 80.0]
    assert data.metadata["printer"]["arm_b"] == 340.0


def test_what_save_config_replaced_is_the_design():
    changed = text().replace("#*# delta_radius = 160.000000", "#*# delta_radius = 161.500000")
    changed = changed.replace("#*# arm_length = 340.000000", "#*# arm_length = 341.250000", 1)
    found = read_printer_cfg(changed).metadata
    assert (found["printer"]["radius"], found["saved"]["radius"]) == (160.0, 161.5)
    assert (found["printer"]["arm_a"], found["saved"]["arm_a"]) == (340.0, 341.25)
    data = MeasuredData(read_printer_cfg(changed).columns, "delta", found)
    held = [discrepancy.machines.make("delta", start=s).formulate(data).fixed["radius"] for s in ("design", "saved")]
    assert held == [160.0, 161.5]


def test_macros_are_never_run_and_older_step_distance_is_read():
    changed = text().replace("rotation_distance: 40.000000", "step_distance: 0.0125")
    assert read_printer_cfg(changed).metadata["steps_per_mm"] == pytest.approx([80.0] * 3)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("kinematics: delta", "kinematics: corexy", "no kinematics: delta"),
        ("#*# height3_pos = ", "#*# height3_pos = x", "height3_pos: 'x"),
        ("#*# distance2_pos1", "#*# distance2_gone", "distance2_pos1 is missing"),
        ("microsteps: 16", "microsteps: 0", "microsteps: 0; a number above 0"),
        ("#*# [delta_calibrate]", "#*# [delta_other]", "run DELTA_CALIBRATE"),
        ("[mcu]", "mcu", "is no configuration that Klipper would read"),
    ],
)
def test_a_file_that_is_no_delta_s_is_refused_in_one_line(old, new, said):
    with pytest.raises(DataError) as refused:
        read_printer_cfg(text().replace(old, new))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("metadata", "said"),
    [
        ({"steps_per_mm": 8.0}, "cannot meet there; check steps_per_mm"),
        ({"nominal": {"arm": 340.0}}, "radius is not stated"),
        ({"nominal": {"radius": 160.0, "arm": 100.0, "endstop": 400.0}}, "rods must be longer"),
        ({"nominal": {"radiuss": 160.0}}, "radius"),
    ],
)
def test_numbers_that_no_delta_has_are_refused(metadata, said):
    data = owner(1)[2]
    with pytest.raises(DataError, match=said):
        discrepancy.machines.make("delta").formulate(replace(data, metadata={**data.metadata, **metadata}))


def test_ways_of_the_other_sign_are_not_told_to_be_in_mm_as_they_are():
    data = planned("object")
    with pytest.raises(DataError, match="cannot meet there; check steps_per_mm"):
        discrepancy.machines.make("delta").formulate(data.with_columns({"travel_a": -np.asarray(data["travel_a"])}))


def test_ways_that_were_taken_for_metres_are_told_with_their_unit():
    data = planned("object")
    ways = {name: 1000 * np.asarray(data[name]) for name in data.columns if name.startswith("travel_")}
    said = "the ways are in mm: units=travel_a:mm,travel_b:mm,travel_c:mm,travel_a_2:mm"
    with pytest.raises(DataError, match=said):
        discrepancy.machines.make("delta").formulate(data.with_columns(ways))


@pytest.mark.slow
def test_distances_that_no_delta_reaches_end_in_a_line():
    data = planned("object")
    far = np.where(data["kind"] == "distance", 1000.0, 1.0) * np.asarray(data["distance"])
    with pytest.raises(DataError, match="are all units right"):
        discrepancy.explain("delta", data.with_columns({"distance": far}))


def test_tables_of_other_firmwares_are_read_as_travels():
    formulation = discrepancy.machines.make("delta").formulate(planned("object"))
    model = Model(formulation)
    assert np.abs(model.residuals(model.start)).max() < 1e-9


@measured_printer
@pytest.mark.parametrize("nominal", [pytest.param({}, marks=pytest.mark.slow), {"radius": 161.75}])
def test_a_measured_printer_has_its_radius_first(nominal):
    report = discrepancy.explain("delta", read_measured(V400 / "printer.cfg", "delta", {"nominal": nominal}))
    assert report.findings[0].effect == "delta_radius all"
    assert [len(finding.set) > 1 for finding in report.findings[:2]] == [False, True]
    assert report.verdict == "partly" or report.left.times <= 1.5


@measured_printer
@pytest.mark.parametrize(
    ("free", "chi2"),
    [
        ((), 332.6),
        (("d_radius",), 104.2),
        (("d_radius", "d_angle_a", "d_angle_b"), 36.6),
        (("d_radius", "d_angle_a", "d_angle_b", "d_rod"), 15.2),
        (("d_radius", "d_angle_a", "d_angle_b", "d_rod_a", "d_rod_b", "d_rod_c"), 11.5),
    ],
)
def test_a_measured_printer_leaves_what_was_computed_elsewhere(free, chi2):
    data = read_measured(V400 / "printer.cfg", "delta", {"nominal": {"radius": 161.75}})
    formulation = discrepancy.machines.make("delta").formulate(data)
    names = (*(p.name for p in formulation.parameters), *free)
    x = np.array([*(p.start for p in formulation.parameters), *np.zeros(len(free))])
    sigma = np.where(formulation.data["kind"] == "height", 0.02, 0.05)
    for _ in range(30):
        q = {**formulation.fixed, **dict(zip(names, x)), **{n: formulation.data[n] for n in formulation.readings}}
        r = formulation.constraints(q)[:, 0] / sigma
        slopes = formulation.slopes(q)
        x = x - np.linalg.lstsq(np.stack([slopes[n][:, 0] / sigma for n in names], axis=-1), r, rcond=None)[0]
    assert float(r @ r) == pytest.approx(chi2, abs=0.15)


@measured_printer
@pytest.mark.parametrize("radius", [152, 165])
def test_by_heights_alone_a_measured_printer_has_one_set(radius):
    data = read_measured(V400 / "printer.cfg", "delta", {"nominal": {"radius": radius}})
    report = discrepancy.explain("delta", data.rows(data["kind"] == "height"))
    [together] = named(report)
    assert together >= SIZE
    assert report.verdict == "partly"
    assert report.left.times > 1.5


def test_every_number_of_the_printer_has_words_of_its_own():
    told = {name: quantity_label("delta", name) for name in IMPERFECTIONS}
    assert told["d_radius"] == "delta radius"
    assert told["d_angle_b"] == "angle of tower b"
    assert told["lean_a_out"] == "lean of tower a outward"
    assert len(set(told.values())) == len(told)
    assert not [name for name, words in told.items() if words == name.replace("_", " ")]


def test_repeated_heights_say_nothing_of_the_noise_of_distances():
    _, _, data = owner(4, 19, 24)
    probed = np.flatnonzero(np.asarray(data["kind"]) == "height")
    rows = np.sort(np.concatenate([np.arange(len(data)), probed]))
    again = data.rows(rows)
    rng = np.random.default_rng(0)
    heights = np.where(np.asarray(again["kind"]) == "height", again["height"] + rng.normal(0, 0.02, len(again)), 0.0)
    stated = {**again.metadata, "sigma_height": 0.2, "sigma_distance": 0.05}
    told = replace(again.with_columns({"height": heights, "pose_id": rows, "visit_id": rows}), metadata=stated)
    plain = fit(Model(discrepancy.machines.make("delta").formulate(told)), Noise())
    extra, [note] = sensor_scales(plain)
    assert set(extra) == {"height"}
    assert np.sqrt(0.2**2 + extra["height"]) == pytest.approx(0.02, rel=0.4)
    assert re.fullmatch(r"repeats scatter otherwise than the stated noise .height: 0\.\d+ times.; .*", note.text)
