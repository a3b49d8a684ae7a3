"""A user's own encoder readings as a problem: arrays, CSV files, starts taken at home, and what is refused."""

import numpy as np
import pytest
from planar_cases import entries, nominal_machine, vector
from scipy.optimize import least_squares

from calibench import problems
from calibench.problems import full11, full12, link_length, orthoglide6, sensor_zero
from calibench.problems.planar.gpm2002 import home, inverse_kinematics

NEAR_ONE = {"z1": 1.0, "z2": 1.0, "z3": 1.0}


@pytest.fixture
def simulated():
    """Return a problem whose readings play the user's: offsets near zero (Table 5)."""
    return problems.make("full11")


def write(path, rows, header=None):
    """Write the rows as CSV, with all digits, and return the path."""
    lines = [] if header is None else [header]
    lines += [",".join(repr(float(v)) if isinstance(v, float) else str(v) for v in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_an_array_of_readings_is_a_problem(simulated):
    mine = full11.from_readings(simulated.readings, nominal={"ya2": 0.3})
    assert mine.readings.tobytes() == simulated.readings.tobytes()
    assert mine.data_id == simulated.data_id
    assert mine(simulated.truth.copy()) == simulated(simulated.truth.copy())
    assert mine.options["n"] == 50
    assert all(mine.options[key] is None for key in ("plan", "radius", "noise", "data_seed", "readings"))


def test_the_truth_of_own_readings_is_not_known(simulated):
    mine = full11.from_readings(simulated.readings)
    assert mine.truth is None
    assert mine.true_positions is None
    assert {p.true for p in mine.parameters} == {None}
    assert mine.merit(mine.start) == {}


def test_own_readings_start_from_the_makers_machine_in_table_5_widths(simulated):
    mine = full12.from_readings(simulated.readings)
    table5 = problems.make("full12")
    assert mine.start.tolist() == table5.start.tolist()
    np.testing.assert_allclose(mine.lower, table5.lower)
    np.testing.assert_allclose(mine.upper, table5.upper)
    assert mine.default_start == "nominal"


def test_the_users_array_is_copied(simulated):
    readings = simulated.readings.copy()
    mine = full11.from_readings(readings)
    before = mine(mine.start)
    readings[:] = 0.0
    assert mine(mine.start) == before
    assert mine.readings[0, 0] != 0.0


def test_lists_serve_as_well(simulated):
    mine = full11.from_readings(simulated.readings.tolist())
    assert mine.data_id == simulated.data_id


@pytest.mark.parametrize("header", ["enc_1,enc_2,enc_3", " enc_1 , enc_2 , enc_3", None])
def test_a_csv_is_read_with_and_without_header(tmp_path, simulated, header):
    path = write(tmp_path / "mine.csv", simulated.readings.tolist(), header)
    for given in (path, str(path)):
        mine = full11.from_readings(given)
        assert mine.data_id == simulated.data_id
        assert mine.options["readings"] == str(path)


def test_columns_are_found_by_name_among_others(tmp_path, simulated):
    rows = [[i, e3, "train", e1, e2] for i, (e1, e2, e3) in enumerate(simulated.readings.tolist())]
    path = write(tmp_path / "mine.csv", rows, "pose_id,enc_3,split,enc_1,enc_2")
    assert full11.from_readings(path).data_id == simulated.data_id


def test_comments_and_empty_lines_are_passed_over(tmp_path, simulated):
    path = write(tmp_path / "mine.csv", simulated.readings.tolist(), "# taken on Monday\n\nenc_1,enc_2,enc_3")
    assert full11.from_readings(path).data_id == simulated.data_id


@pytest.mark.parametrize("mark", [";", "\t"])
@pytest.mark.parametrize("header", [["enc_1", "enc_2", "enc_3"], []])
def test_decimal_commas_are_read_where_commas_do_not_part_the_cells(tmp_path, simulated, mark, header):
    lines = [mark.join(header)] if header else []
    lines += [mark.join(repr(value).replace(".", ",") for value in row) for row in simulated.readings.tolist()]
    (tmp_path / "mine.csv").write_text("\n".join(lines) + "\n")
    assert full11.from_readings(tmp_path / "mine.csv").data_id == simulated.data_id


def test_columns_that_are_passed_over_may_have_commas_beside_points(tmp_path, simulated):
    lines = [f"{';'.join(map(repr, row))};20,5" for row in simulated.readings.tolist()]
    (tmp_path / "mine.csv").write_text("\n".join(["enc_1;enc_2;enc_3;room", *lines]) + "\n")
    assert full11.from_readings(tmp_path / "mine.csv").data_id == simulated.data_id


def test_readings_are_an_option_of_the_registry(tmp_path, simulated):
    path = write(tmp_path / "mine.csv", simulated.readings.tolist())
    made = problems.make("full11", readings=str(path), error="J3")
    mine = full11.from_readings(path, error="J3")
    assert made.data_id == mine.data_id == simulated.data_id
    assert made.start.tolist() == mine.start.tolist()
    assert made(made.start) == mine(mine.start)
    assert dict(made.options) == dict(mine.options)


def test_nominal_values_hold_what_is_not_free_and_start_what_is(simulated):
    nominal = {"xa2": 433.04, "la1": 245.0}
    mine = full11.from_readings(simulated.readings, nominal=nominal)
    start = dict(zip([p.name for p in mine.parameters], mine.start, strict=True))
    assert start["la1"] == 245.0
    assert start["la2"] == 244.0
    la1 = next(p for p in mine.parameters if p.name == "la1")
    assert (la1.lower, la1.upper) == (240.0, 250.0)
    assert mine(mine.start) != full11.from_readings(simulated.readings, nominal={"la1": 245.0})(mine.start)


def test_where_the_frame_stands_does_not_matter(simulated):
    # A_1 is at x = 0 in every problem of the paper; here the whole machine is moved
    plain = full11.from_readings(simulated.readings)
    bases = {name: value for name, value in nominal_machine().items() if name[:2] in ("xa", "ya")}
    shift = {"x": 31.0, "y": -17.0}
    moved = full11.from_readings(simulated.readings, nominal={n: v + shift[n[0]] for n, v in bases.items()})
    assert moved(moved.start) == pytest.approx(plain(plain.start), rel=1e-12)
    np.testing.assert_allclose(
        moved.positions(moved.start), plain.positions(plain.start) + np.array([31.0, -17.0]), rtol=0, atol=1e-9
    )


def test_a_box_moves_the_bounds_of_the_parameters_it_names(simulated):
    plain = full11.from_readings(simulated.readings)
    mine = full11.from_readings(simulated.readings, box={"lb2": (200.0, 300.0)})
    changed = [p.name for p, q in zip(mine.parameters, plain.parameters, strict=True) if p != q]
    assert changed == ["lb2"]
    lb2 = next(p for p in mine.parameters if p.name == "lb2")
    assert (lb2.lower, lb2.upper) == (200.0, 300.0)


def test_free_works_on_own_readings(simulated):
    mine = full11.from_readings(simulated.readings, free=["z1", "z2"])
    assert [p.name for p in mine.parameters] == ["z1", "z2"]


# A machine whose encoders read an arbitrary zero: offsets near 1 rad, as in section 3. Without the readings at home
# nothing says where to begin; with them, section 3.2's step 3 does.


def unaligned_machine():
    """Return Table 4's machine, and what its encoders read while the hand holds it near home, at (210, 245)."""
    actual = nominal_machine() | entries("table4.actual")
    estimate = np.array([[entries("geometry")["estimate_x"], entries("geometry")["estimate_y"]]])
    return actual, inverse_kinematics(vector(actual), estimate)[0] - vector(actual)[12:15]


def test_readings_taken_at_home_give_the_papers_start_of_the_offsets():
    _, at_home = unaligned_machine()
    simulated = problems.make("full11", paper_section=3)
    mine = full11.from_readings(simulated.readings, at_home=at_home.tolist())
    printed = entries("table4.initial")
    for p in mine.parameters[:3]:
        assert p.start == pytest.approx(printed[p.name], abs=1e-5)
        assert (p.lower, p.upper) == pytest.approx((p.start - 0.2, p.start + 0.2))


@pytest.mark.parametrize("error", ["J1", "J2", "J3"])
def test_a_machine_with_offsets_near_one_radian_is_calibrated_from_its_readings(error):
    actual, at_home = unaligned_machine()
    simulated = problems.make("full11", paper_section=3)
    mine = full11.from_readings(simulated.readings, nominal={"xa2": 433.04}, error=error, at_home=at_home.tolist())
    found = least_squares(mine.residuals, mine.start, mine.jacobian, method="lm", x_scale="jac", xtol=1e-15, ftol=1e-15)
    physical = dict(zip([p.name for p in mine.parameters], mine.physical(found.x), strict=True))
    for name, value in physical.items():
        assert value == pytest.approx(actual[name], abs=1e-7), name
    assert (mine.lower <= found.x).all()
    assert (found.x <= mine.upper).all()


def test_at_home_is_an_option_of_the_registry_too(tmp_path):
    _, at_home = unaligned_machine()
    simulated = problems.make("link_length")
    path = write(tmp_path / "mine.csv", simulated.readings.tolist())
    text = ",".join(repr(float(v)) for v in at_home)
    made = problems.make("link_length", readings=str(path), at_home=[float(v) for v in at_home])
    assert made.start.tolist() == link_length.from_readings(path, at_home=at_home.tolist()).start.tolist()
    assert made.start[0] == pytest.approx(1.0, abs=0.05)
    with pytest.raises(ValueError, match="a finite number is needed"):
        problems.make("link_length", readings=str(path), at_home=text)


def test_without_readings_at_home_the_encoders_are_taken_to_be_aligned():
    mine = sensor_zero.from_readings(problems.make("sensor_zero").readings)
    assert mine.start.tolist() == [0, 0, 0]
    assert mine.lower.tolist() == [-0.2] * 3


def test_home_itself_read_at_home_means_offsets_zero():
    at_home = inverse_kinematics(vector(nominal_machine()), home()[None])[0]
    mine = sensor_zero.from_readings(problems.make("sensor_zero").readings, at_home=at_home.tolist())
    np.testing.assert_allclose(mine.start, 0, atol=1e-15)


# What is refused: the message names what is wrong, where, and the way out, in one line.


def refused(match, call):
    with pytest.raises(ValueError, match=match) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_nan_names_its_row(simulated):
    readings = simulated.readings.copy()
    readings[6, 1] = np.nan
    refused(r"readings: row 7 is not finite \(1 such rows\)", lambda: full11.from_readings(readings))


def test_nan_in_a_csv_is_refused_as_well(tmp_path, simulated):
    rows = simulated.readings.tolist()
    rows[3][0] = float("nan")
    path = write(tmp_path / "mine.csv", rows, "enc_1,enc_2,enc_3")
    refused("row 4 is not finite", lambda: full11.from_readings(path))


def test_degrees_are_noticed(simulated):
    refused("look like degrees, radians are needed", lambda: full11.from_readings(np.degrees(simulated.readings)))


def test_too_few_rows_for_the_parameters(simulated):
    refused(
        r"full11\.n=10: 11 parameters need at least 11 configurations",
        lambda: full11.from_readings(simulated.readings[:10]),
    )


@pytest.mark.parametrize("columns", [2, 4])
def test_readings_have_three_columns(simulated, columns):
    readings = np.tile(simulated.readings, 2)[:, :columns]
    refused(rf"readings have shape \(50, {columns}\): \(n, 3\) is needed", lambda: full11.from_readings(readings))


def test_one_row_as_a_flat_array_is_refused(simulated):
    refused(r"readings have shape \(3,\)", lambda: full11.from_readings(simulated.readings[0]))


def test_a_csv_of_two_columns_names_its_row(tmp_path, simulated):
    path = write(tmp_path / "mine.csv", simulated.readings[:, :2].tolist())
    refused("row 1 does not hold three numbers", lambda: full11.from_readings(path))


def test_a_missing_file_is_named(tmp_path):
    path = str(tmp_path / "nowhere.csv")
    refused(r"readings=.*nowhere\.csv: cannot be read", lambda: full11.from_readings(path))
    refused(r"readings=.*nowhere\.csv: cannot be read", lambda: problems.make("full11", readings=path))


def test_a_folder_and_a_picture_are_no_csv(tmp_path):
    refused("cannot be read", lambda: full11.from_readings(tmp_path))
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    refused("cannot be read", lambda: full11.from_readings(tmp_path / "a.png"))


def test_an_empty_file_is_named_and_one_with_a_header_only_has_no_rows(tmp_path):
    (tmp_path / "empty.csv").write_text("")
    refused("the file is empty", lambda: full11.from_readings(tmp_path / "empty.csv"))
    (tmp_path / "header.csv").write_text("enc_1,enc_2,enc_3\n")
    refused(r"\(n, 3\) is needed", lambda: full11.from_readings(tmp_path / "header.csv"))


def test_a_wrong_header_lists_what_it_has(tmp_path, simulated):
    path = write(tmp_path / "mine.csv", simulated.readings.tolist(), "theta_1,theta_2,enc_3")
    refused("no column enc_1, enc_2; the header has theta_1, theta_2, enc_3", lambda: full11.from_readings(path))


@pytest.mark.parametrize("cell", ["n/a", "", "1,5"])
def test_a_cell_of_text_names_its_row(tmp_path, simulated, cell):
    rows = simulated.readings.tolist()
    rows[1][2] = f'"{cell}"'
    path = write(tmp_path / "mine.csv", rows, "enc_1,enc_2,enc_3")
    refused("row 3 does not hold three numbers", lambda: full11.from_readings(path))


def test_decimal_commas_beside_points_are_refused(tmp_path, simulated):
    rows = [f"{';'.join(map(repr, row))};20.5" for row in simulated.readings.tolist()]
    rows[2] = "0,5;0,25;0,125;20.5"
    (tmp_path / "mine.csv").write_text("\n".join(["enc_1;enc_2;enc_3;room", *rows]) + "\n")
    said = "column enc_1, reading 3: '0,5' has a decimal comma, and column enc_1, reading 1: .* a decimal point"
    refused(said, lambda: full11.from_readings(tmp_path / "mine.csv"))


@pytest.mark.parametrize("header", ["enc_1 [deg],enc_2 [],enc_3 [deg]", "enc_1 [],enc_2 [],enc_3 []"])
def test_an_empty_bracket_is_no_unit_and_scales_no_other_column(tmp_path, simulated, header):
    path = write(tmp_path / "mine.csv", simulated.readings.tolist(), header)
    refused("column enc_[12]: unit '' cannot be turned into rad; write rad", lambda: full11.from_readings(path))


@pytest.mark.parametrize(("key", "value"), [
    ("plan", "disc"), ("radius", 100.0), ("n", 50), ("noise", 0.0), ("data_seed", 0),
])  # fmt: skip
def test_options_that_simulate_readings_clash_with_given_ones(tmp_path, simulated, key, value):
    path = write(tmp_path / "mine.csv", simulated.readings.tolist())
    match = rf"full11\.{key}: simulates readings, but readings are given"
    refused(match, lambda: full11.from_readings(simulated.readings, **{key: value}))
    refused(match, lambda: problems.make("full11", readings=str(path), **{key: value}))


def test_a_start_outside_its_box_is_refused(simulated):
    refused(
        r"start la1=244 lies outside its box 250 \.\. 260",
        lambda: full11.from_readings(simulated.readings, box={"la1": (250, 260)}),
    )
    refused(
        r"start la1=260 lies outside its box 239 \.\. 249",
        lambda: full11.from_readings(simulated.readings, nominal={"la1": 260}, box={"la1": (239, 249)}),
    )


def test_a_box_upside_down_is_refused(simulated):
    refused("lies outside its box", lambda: full11.from_readings(simulated.readings, box={"la1": (249, 239)}))


@pytest.mark.parametrize("keyword", ["nominal", "box"])
def test_an_unknown_parameter_is_named_with_the_nearest(simulated, keyword):
    value = {"la4": 244.0 if keyword == "nominal" else (239, 249)}
    refused(
        f"{keyword}: unknown parameter 'la4'; did you mean 'la",
        lambda: full11.from_readings(simulated.readings, **{keyword: value}),
    )


@pytest.mark.parametrize("at_home", [[1.0, 2.0], [1.0, 2.0, 3.0, 4.0], []])
def test_at_home_are_three_readings(simulated, at_home):
    refused(r"at_home=.*three readings", lambda: full11.from_readings(simulated.readings, at_home=at_home))


def test_an_unknown_option_is_refused_before_the_file_is_opened(tmp_path):
    refused(
        "full11 has no option 'eror'; did you mean 'error'",
        lambda: full11.from_readings(tmp_path / "nowhere.csv", eror="J2"),
    )


@pytest.mark.parametrize("header", ["enc_1,enc_2,enc_3", None])
def test_a_csv_as_spreadsheets_write_it_is_read(tmp_path, simulated, header):
    path = write(tmp_path / "mine.csv", simulated.readings.tolist(), header)
    path.write_text(path.read_text(encoding="utf-8"), encoding="utf-8-sig")
    assert full11.from_readings(path).data_id == simulated.data_id


@pytest.mark.parametrize("text", ['1,2,3\n"a\nb",2,3\n', '"a\nb",2,3\n'])
def test_a_line_break_in_a_cell_does_not_break_the_message(tmp_path, text):
    (tmp_path / "mine.csv").write_text(text)
    refused("mine.csv", lambda: full11.from_readings(tmp_path / "mine.csv"))


def test_a_file_that_is_one_huge_cell_is_refused(tmp_path):
    (tmp_path / "mine.csv").write_text("1" * 200_000)
    refused("mine.csv", lambda: full11.from_readings(tmp_path / "mine.csv"))


def test_the_row_that_is_named_is_the_line_of_the_file(tmp_path):
    (tmp_path / "mine.csv").write_text("# taken on Monday\n\nenc_1,enc_2,enc_3\n1,2,x\n")
    refused("row 4 ", lambda: full11.from_readings(tmp_path / "mine.csv"))


@pytest.mark.parametrize(
    ("nominal", "at_home"), [({"la1": float("nan")}, None), ({"la1": 10.0}, [0.0] * 3), ({"la1": -244.0}, None)]
)
def test_a_nominal_machine_that_is_none_is_refused(simulated, nominal, at_home):
    refused("la1", lambda: full11.from_readings(simulated.readings, nominal=nominal, at_home=at_home))


def test_what_is_no_array_of_numbers_is_refused_in_our_words():
    refused("readings: an array of numbers", lambda: full11.from_readings([["a", "b", "c"]]))


def test_deviations_that_are_words_are_refused_in_our_words():
    refused("readings: an array of numbers", lambda: orthoglide6.from_readings(["0,1"] * 12, "paper"))


def test_an_array_without_rows_is_refused_in_our_words():
    refused("readings", lambda: full11.from_readings(np.empty((0, 3))))


@pytest.mark.parametrize("bounds", [(239, 244, 249), 5.0, ("low", "high")])
def test_bounds_that_are_no_pair_of_numbers_are_refused_in_our_words(simulated, bounds):
    refused("box", lambda: full11.from_readings(simulated.readings, box={"la1": bounds}))


def test_at_home_without_readings_is_refused():
    refused("at_home", lambda: problems.make("full11", at_home=[0.0, 0.0, 0.0]))


def test_j3_gives_back_offsets_in_the_turn_of_their_box():
    table1 = entries("table1.experiment1_result")
    angles = inverse_kinematics(vector(nominal_machine()), home()[None])[0]
    at_home = [float(angle - table1[z]) for angle, z in zip(angles, ("z1", "z2", "z3"))]
    mine = full11.from_readings(problems.make("full11").readings, error="J3", at_home=at_home)
    assert mine.parameters[2].start == pytest.approx(table1["z3"])
    np.testing.assert_allclose(mine.physical(mine.start), [p.start for p in mine.parameters], rtol=1e-12)
