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


def lines(rows, header=None):
    """Return the rows as CSV, with all digits."""
    cells = [",".join(repr(float(v)) if isinstance(v, float) else str(v) for v in row) for row in rows]
    return "\n".join([*([] if header is None else [header]), *cells]) + "\n"


def write(path, rows, header=None):
    """Write the rows as CSV and return the path."""
    path.write_text(lines(rows, header), encoding="utf-8")
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

READINGS = problems.make("full11").readings
HEADER = "enc_1,enc_2,enc_3"


def refused(match, call):
    with pytest.raises(ValueError, match=match) as caught:
        call()
    assert "\n" not in str(caught.value)


def changed(row, column, cell):
    """Return the readings as lists, one cell of them another."""
    rows = READINGS.tolist()
    rows[row][column] = cell
    return rows


@pytest.mark.parametrize(("said", "readings", "options"), [
    (r"readings: row 7 is not finite \(1 such rows\)", np.array(changed(6, 1, np.nan)), {}),
    ("look like degrees, radians are needed", np.degrees(READINGS), {}),
    (r"full11\.n=10", READINGS[:10], {}),
    (r"readings have shape \(50, 2\)", READINGS[:, :2], {}),
    (r"readings have shape \(50, 4\)", np.tile(READINGS, 2)[:, :4], {}),
    (r"readings have shape \(3,\)", READINGS[0], {}),
    ("readings", np.empty((0, 3)), {}),
    ("readings: an array of numbers", [["a", "b", "c"]], {}),
    ("full11 has no option 'eror'; did you mean 'error'", "nowhere.csv", {"eror": "J2"}),
    (r"start la1=244 lies outside its box 250 \.\. 260", READINGS, {"box": {"la1": (250, 260)}}),
    (r"start la1=260 lies", READINGS, {"nominal": {"la1": 260}, "box": {"la1": (239, 249)}}),
    ("lies outside its box", READINGS, {"box": {"la1": (249, 239)}}),
    ("nominal: unknown parameter 'la4'; did you mean 'la", READINGS, {"nominal": {"la4": 244.0}}),
    ("box: unknown parameter 'la4'; did you mean 'la", READINGS, {"box": {"la4": (239, 249)}}),
    *(("box", READINGS, {"box": {"la1": bounds}}) for bounds in ((239, 244, 249), 5.0, ("low", "high"))),
    *((r"at_home=.*three readings", READINGS, {"at_home": some}) for some in ([1.0, 2.0], [1.0, 2.0, 3.0, 4.0], [])),
    *(("la1", READINGS, {"nominal": {"la1": length}}) for length in (float("nan"), -244.0)),
    ("la1", READINGS, {"nominal": {"la1": 10.0}, "at_home": [0.0] * 3}),
])  # fmt: skip
def test_what_is_no_set_of_readings_is_refused_in_one_line(said, readings, options):
    refused(said, lambda: full11.from_readings(readings, **options))


@pytest.mark.parametrize(("said", "content"), [
    ("row 4 is not finite", lines(changed(3, 0, float("nan")), HEADER)),
    ("row 1 is not finite", lines(READINGS[:, :2].tolist())),
    *(("row 2 is not finite", lines(changed(1, 2, f'"{cell}"'), HEADER)) for cell in ("n/a", "")),
    ("column enc_3, reading 2: '1,5' is no number", lines(changed(1, 2, '"1,5"'), HEADER)),
    ("no column enc_1, enc_2; the header has theta_1", lines(READINGS.tolist(), "theta_1,theta_2,enc_3")),
    ("the file is empty", ""),
    ("a header and no readings", f"{HEADER}\n"),
    ("cannot be read", b"\x89PNG\r\n\x1a\n\xff\xfe"),
    *(("column enc_[12]: unit '' cannot be turned into rad", lines(READINGS.tolist(), header))  # nor scales it others
      for header in ("enc_1 [deg],enc_2 [],enc_3 [deg]", "enc_1 [],enc_2 [],enc_3 []")),
    ("mine.csv", '1,2,3\n"a\nb",2,3\n'),
    ("mine.csv", '"a\nb",2,3\n'),
    ("mine.csv", "1" * 200_000),
    ("column enc_3, reading 1: 'x' is no number", "# taken on Monday\n\nenc_1,enc_2,enc_3\n1,2,x\n"),
])  # fmt: skip
def test_what_is_no_file_of_readings_is_refused_in_one_line(tmp_path, said, content):
    path = tmp_path / "mine.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    refused(said, lambda: full11.from_readings(path))


def test_a_missing_file_is_named_and_a_folder_is_none(tmp_path):
    path = str(tmp_path / "nowhere.csv")
    refused(r"readings=.*nowhere\.csv: cannot be read", lambda: full11.from_readings(path))
    refused(r"readings=.*nowhere\.csv: cannot be read", lambda: problems.make("full11", readings=path))
    refused("cannot be read", lambda: full11.from_readings(tmp_path))


def test_decimal_commas_beside_points_are_refused(tmp_path):
    rows = [f"{';'.join(map(repr, row))};20.5" for row in READINGS.tolist()]
    rows[2] = "0,5;0,25;0,125;20.5"
    (tmp_path / "mine.csv").write_text("\n".join(["enc_1;enc_2;enc_3;room", *rows]) + "\n")
    said = "column enc_1, reading 3: '0,5' has a decimal comma, and column enc_1, reading 1: .* a decimal point"
    refused(said, lambda: full11.from_readings(tmp_path / "mine.csv"))


@pytest.mark.parametrize(("key", "value"), [
    ("plan", "disc"), ("radius", 100.0), ("n", 50), ("noise", 0.0), ("data_seed", 0),
])  # fmt: skip
def test_options_that_simulate_readings_clash_with_given_ones(tmp_path, key, value):
    path = write(tmp_path / "mine.csv", READINGS.tolist())
    match = rf"full11\.{key}: simulates readings"
    refused(match, lambda: full11.from_readings(READINGS, **{key: value}))
    refused(match, lambda: problems.make("full11", readings=str(path), **{key: value}))


def test_other_doors_refuse_in_our_words_too():
    refused("readings: an array of numbers", lambda: orthoglide6.from_readings(["0,1"] * 12, "paper"))
    refused("at_home", lambda: problems.make("full11", at_home=[0.0, 0.0, 0.0]))


@pytest.mark.parametrize("header", ["enc_1,enc_2,enc_3", None])
def test_a_csv_as_spreadsheets_write_it_is_read(tmp_path, simulated, header):
    path = write(tmp_path / "mine.csv", simulated.readings.tolist(), header)
    path.write_text(path.read_text(encoding="utf-8"), encoding="utf-8-sig")
    assert full11.from_readings(path).data_id == simulated.data_id


def test_j3_gives_back_offsets_in_the_turn_of_their_box():
    table1 = entries("table1.experiment1_result")
    angles = inverse_kinematics(vector(nominal_machine()), home()[None])[0]
    at_home = [float(angle - table1[z]) for angle, z in zip(angles, ("z1", "z2", "z3"))]
    mine = full11.from_readings(problems.make("full11").readings, error="J3", at_home=at_home)
    assert mine.parameters[2].start == pytest.approx(table1["z3"])
    np.testing.assert_allclose(mine.physical(mine.start), [p.start for p in mine.parameters], rtol=1e-12)
