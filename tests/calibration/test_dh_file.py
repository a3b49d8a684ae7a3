"""Tables of Denavit and Hartenberg from files: published arms, spellings, units, conventions, and what is refused."""

from math import pi

import numpy as np
import openpyxl
import pytest

from calibench.calibration.dh import DhArm, DhRow, DhTable, read_dh, text_of_dh, urdf_of_dh
from calibench.calibration.kinematics import ChainError, forward, parameter_units
from calibench.calibration.urdf import parse_urdf, read_urdf
from calibench.problems.arm.families import shipped
from tests.dh_by_hand import PUMA, PUMA_CRAIG, STANFORD, UR5, UR10, as_csv, modified, reached, standard

ARMS = {
    "ur5": (UR5, standard), "ur10": (UR10, standard), "puma": (PUMA, standard), "craig": (PUMA_CRAIG, modified),
    "stanford": (STANFORD, standard),
}  # fmt: skip


def postures(rows, n=20, seed=1):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-2.5, 2.5, n) if r[4] == "r" else rng.uniform(0.3, 1.2, n) for r in rows])


def nominal(arm):
    return np.array([1.0 if name.startswith("gain_") else 0.0 for name in arm.names])


def in_mm(rows, q):
    return q * np.where([row[4] == "r" for row in rows], 1.0, 1000.0)


def flange(chain, q):
    found = forward(chain, {}, q)
    return found[:, :3, 3] / 1000, found[:, :3, :3]


def test_published_arms_reach_where_the_textbook_s_product_says(tmp_path):
    for name, (rows, of) in ARMS.items():
        (tmp_path / f"{name}.csv").write_text(as_csv(rows))
        table = read_dh(tmp_path / f"{name}.csv", "standard" if of is standard else "craig")
        q = postures(rows)
        place, turned = flange(table.chain, in_mm(rows, q))
        wanted = reached(rows, q, of)
        np.testing.assert_allclose(place, wanted[:, :3, 3], atol=1e-12)
        np.testing.assert_allclose(turned, wanted[:, :3, :3], atol=1e-12)
        again = parse_urdf(urdf_of_dh(table)).chain()
        np.testing.assert_allclose(flange(again, in_mm(rows, q))[0], place, atol=1e-10)
        assert again.driven == table.chain.driven == tuple(f"axis_{k}" for k in range(1, 7))


def test_the_maker_s_table_of_a_ur10_is_the_arm_of_its_urdf(tmp_path):
    (tmp_path / "ur10.csv").write_text(as_csv(UR10))
    q = postures(UR10)
    of_urdf = flange(read_urdf(shipped("ur10.urdf")).chain(), q)
    of_table = flange(read_dh(tmp_path / "ur10.csv", "standard").chain, q)
    np.testing.assert_allclose(of_table[0], of_urdf[0], atol=1e-12)
    np.testing.assert_allclose(of_table[1], of_urdf[1], atol=1e-12)


def test_one_arm_in_both_conventions_is_one_arm(tmp_path):
    shifted = [(0, 0), *((a, alpha) for a, alpha, *_ in UR5)]
    lines = ["joint,type,a_{i-1} [m],alpha_{i-1} [deg],d_i [mm],theta_i [rad]"]
    for k, (a, alpha) in enumerate(shifted):
        d, kind = (UR5[k][2], "r") if k < 6 else (0, "fixed")
        lines.append(f"{k + 1},{kind},{a},{np.rad2deg(alpha)},{1000 * d},0")
    (tmp_path / "craig.csv").write_text("\n".join(lines))
    (tmp_path / "paul.csv").write_text(as_csv(UR5))
    q = postures(UR5)
    one, other = (read_dh(tmp_path / f"{name}.csv", said) for name, said in (("craig", ""), ("paul", "classical")))
    assert one.form == "modified"
    assert one.chain.driven == tuple(f"joint_{k}" for k in range(1, 7))
    np.testing.assert_allclose(flange(one.chain, q)[0], flange(other.chain, q)[0], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "note"),
    [
        (
            "i;a;α;d;θ\n1;0;-90°;412;q1\n2;0;90°;154;q2\n3;20,3;0;q3;-90°\n4;0;-90;0;q4\n5;0;90;0;q5\n6;0;0;263;q6\n",
            "mm",
        ),
        (
            "Joint,Theta,d,r,twist\n1,θ1,0.412,0,-pi/2\n2,θ2,0.154,0,pi/2\n3,-π/2,d3,0.0203,0\n"
            "4,θ4,0,0,-pi/2\n5,θ5,0,0,pi/2\n6,θ6 + 0,0.263,0,0\n",
            "links of 0.8493 together are m",
        ),
        (
            "# a Stanford arm\nname,sigma,a_i,alpha_i (deg),d_i,offset (deg)\nA,0,0,-90,0.412,0\nB,0,0,90,0.154,0\n"
            "C,1,0.0203,0,0,0\nD,0,0,-90,0,90\nE,0,0,90,0,0\nF,0,0,0,0.263,0\n",
            "together are m",
        ),
    ],
)
def test_a_table_is_read_as_it_is_printed(tmp_path, text, note):
    (tmp_path / "table.csv").write_text(text)
    table = read_dh(tmp_path / "table.csv", "standard")
    assert any(note in said for said in table.notes), table.notes
    assert [row.kind for row in table.rows] == ["rotary"] * 2 + ["sliding"] + ["rotary"] * 3
    rows = list(STANFORD)
    if "offset" in text:  # the third row's theta is left out, and joint 4 has a zero of 90 degrees
        rows[2] = (*rows[2][:3], 0, "p")
        rows[3] = (*rows[3][:3], pi / 2, "r")
        assert table.form == "standard"
    q = postures(rows)
    np.testing.assert_allclose(flange(table.chain, in_mm(rows, q))[0], reached(rows, q)[:, :3, 3], atol=1e-12)


def test_an_offset_of_a_joint_that_slides_is_a_length(tmp_path):
    (tmp_path / "t.csv").write_text("type,a [mm],alpha [deg],d [mm],offset\nr,100,0,0,90\np,0,0,50,12\n")
    rows = read_dh(tmp_path / "t.csv", "standard").rows
    assert (rows[0].theta, rows[1].d, rows[1].theta) == (pytest.approx(pi / 2), 62.0, 0.0)


def test_an_excel_sheet_is_the_same_table(tmp_path):
    book = openpyxl.Workbook()
    for line in as_csv(PUMA).splitlines():
        book.active.append([float(c) if c[:1] in "-0123456789" else c for c in line.split(",")])
    book.save(tmp_path / "puma.xlsx")
    (tmp_path / "puma.csv").write_text(as_csv(PUMA))
    sheet, text = (read_dh(tmp_path / f"puma.{end}", "standard") for end in ("xlsx", "csv"))
    for one, other in zip(sheet.rows, text.rows, strict=True):
        assert (one.name, one.kind) == (other.name, other.kind)
        np.testing.assert_allclose(
            [one.theta, one.d, one.a, one.alpha], [other.theta, other.d, other.a, other.alpha], rtol=1e-14
        )  # a sheet keeps fifteen digits


def test_limits_are_kept_in_the_table_and_in_the_urdf(tmp_path):
    (tmp_path / "t.csv").write_text(
        "joint,type,a [mm],alpha [deg],d [mm],lower [deg],upper [deg]\n"
        "swing,r,300,0,100,-120,150\nram,p,0,180,0,10,250\nhand,r,0,0,20,,\n"
    )
    table = read_dh(tmp_path / "t.csv", "standard")
    assert [(round(r.lower, 4), round(r.upper, 4)) for r in table.rows[:2]] == [(-2.0944, 2.618), (10, 250)]
    joints = parse_urdf(urdf_of_dh(table)).chain().joints
    assert [j.kind for j in joints] == ["rotary", "sliding", "rotary"]
    for joint, row in zip(joints, table.rows, strict=True):
        assert (joint.lower, joint.upper) == pytest.approx((row.lower, row.upper), abs=1e-9)
    (tmp_path / "again.csv").write_text(text_of_dh(table))
    assert [(r.lower, r.upper) for r in read_dh(tmp_path / "again.csv").rows] == [
        pytest.approx((r.lower, r.upper)) for r in table.rows
    ]


def test_a_joint_that_slides_without_a_stop_may_slide_in_the_urdf(tmp_path):
    path = tmp_path / "stanford.csv"
    path.write_text(as_csv(STANFORD))
    text = urdf_of_dh(read_dh(path, "standard"))
    assert text.count("the table has no limits of axis_3: 1 m either way stand for them") == 1
    assert text.count('<limit lower="-1" upper="1"') == 1


def test_a_joint_that_slides_without_a_stop_goes_in_the_urdf_as_far_as_it_was_used(tmp_path):
    path = tmp_path / "stanford.csv"
    path.write_text(as_csv(STANFORD))
    text = urdf_of_dh(read_dh(path, "standard"), used={"axis_3": (12.6, 1956.7), "axis_1": (-1.0, 1.0)})
    assert "the table has no limits of axis_3: the range of its readings stands for them" in text
    joint = parse_urdf(text).chain().joints[2]
    assert (joint.lower, joint.upper) == pytest.approx((12, 1957))
    assert text.count("<limit ") == 1


@pytest.mark.parametrize(
    ("word", "kind"),
    [("Drehgelenk", "rotary"), ("rotatorisch", "rotary"), ("Schub", "sliding"), ("fest", "fixed"), ("fisso", "fixed")],
)
def test_kinds_of_joints_have_words_of_other_languages(tmp_path, word, kind):
    (tmp_path / "t.csv").write_text(HEAD + f"one,{word},0.3,0,0,0\ntwo,r,0.3,0,0,0\n")
    assert read_dh(tmp_path / "t.csv", "standard").rows[0].kind == kind


def test_joints_may_be_called_as_the_links_that_a_urdf_needs():
    table = DhTable((DhRow("flange_joint", a=300.0), DhRow("base", a=200.0)))
    again = parse_urdf(urdf_of_dh(table)).chain()
    assert again.driven == table.chain.driven
    q = np.array([[0.3, -0.8]])
    np.testing.assert_allclose(flange(again, q)[0], flange(table.chain, q)[0], atol=1e-10)


def test_a_table_that_was_written_is_read_again_with_its_convention_and_numbers(tmp_path):
    for name, (rows, of) in ARMS.items():
        (tmp_path / "t.csv").write_text(as_csv(rows, "joint,type,a [mm],alpha [deg],d [mm],theta [deg]", None,
                                               (1000, 180 / pi, 1000, 180 / pi)))  # fmt: skip
        table = read_dh(tmp_path / "t.csv", "standard" if of is standard else "modified")
        (tmp_path / "again.csv").write_text(text_of_dh(table, "kept", {"a_axis_2": 0.01}))
        again = read_dh(tmp_path / "again.csv")
        assert (again.form, again.length, again.angle) == (table.form, "mm", "deg"), name
        for one, other in zip(again.rows, table.rows, strict=True):
            assert (one.name, one.kind) == (other.name, other.kind)
            np.testing.assert_allclose(
                [one.theta, one.d, one.a, one.alpha], [other.theta, other.d, other.a, other.alpha], atol=1e-7
            )


@pytest.mark.parametrize("name", list(ARMS))
def test_the_slopes_of_a_table_s_numbers_are_those_of_differences(name):
    rows, _ = ARMS[name]
    table = _table(name)
    rng = np.random.default_rng(4)
    mount, tool = np.eye(4), np.eye(4)
    mount[:3, 3], tool[:3, 3] = [300, -200, 50], [40, 10, 90]
    arm = DhArm(table, mount, tool)
    p, q = nominal(arm) + rng.normal(0, 1e-2, len(arm.names)), in_mm(rows, postures(rows, 5))
    slopes, turned = arm.jacobian(p, q), arm.forward(p, q)[:, :3, :3]
    for k in range(len(p)):
        step = 1e-6 * (np.arange(len(p)) == k)
        ahead, behind = arm.forward(p + step, q), arm.forward(p - step, q)
        w = (ahead - behind)[:, :3, :3] / 2e-6 @ turned.swapaxes(1, 2)
        wanted = np.column_stack([(ahead - behind)[:, :3, 3] / 2e-6, w[:, 2, 1], w[:, 0, 2], w[:, 1, 0]])
        np.testing.assert_allclose(slopes[:, :, k], wanted, atol=2e-5, err_msg=arm.names[k])


def test_numbers_of_a_table_say_all_that_placements_say():
    """4 R + 2 P + 6 (Everett, Driels and Mooring 1987), as the placements of the same chain have it."""
    for name, (rows, _) in ARMS.items():
        table = _table(name)
        arm = DhArm(table, np.eye(4), _lifted())
        q = in_mm(rows, postures(rows, 60))
        slopes = np.asarray(arm.jacobian(nominal(arm), q)).reshape(-1, len(arm.names))
        of = [k for k, one in enumerate(arm.names) if not one.startswith("gain_")]
        lengths = np.array([one.startswith(("a_", "d_")) or one in _PLACES for one in np.array(arm.names)[of]])
        scaled = slopes.reshape(60, 6, -1)[:, :, of] * np.where(lengths, 1.0, 1e-3)
        scaled[:, 3:] *= 1e3
        sizes = np.linalg.svd(scaled.reshape(360, -1), compute_uv=False)
        turning = sum(row[4] == "r" for row in rows)
        assert int((sizes > 1e-9 * sizes[0]).sum()) == 4 * turning + 2 * (6 - turning) + 6, name
        assert set(parameter_units(table.chain)) & set(arm.names) >= {"base_x", "tool_rz"}


_PLACES = {f"{end}_{axis}" for end in ("base", "tool") for axis in "xyz"}


def _lifted():
    tool = np.eye(4)
    tool[:3, 3] = [60, 20, 110]
    return tool


def _table(name):
    rows, of = ARMS[name]
    made = tuple(
        DhRow(f"axis_{k}", "rotary" if kind == "r" else "sliding", theta, 1000 * d, 1000 * a, alpha)
        for k, (a, alpha, d, theta, kind) in enumerate(rows, start=1)
    )
    return DhTable(made, "standard" if of is standard else "modified")


HEAD = "joint,type,a [m],alpha [rad],d [m],theta [rad]\n"


@pytest.mark.parametrize(
    ("text", "convention", "said"),
    [
        (as_csv(UR5), "", "the convention is not stated, and the same numbers are two arms"),
        (as_csv(UR5), "deadly", "convention=deadly: choices: standard, modified (modified is Craig's)"),
        (as_csv(UR5).replace("alpha", "tilt"), "standard", "no column alpha among joint, type, a, tilt, d, theta"),
        (as_csv(UR5, scale=(1000, 1, 1000, 1)), "standard", "1193 m long together: these look like mm; write a [mm]"),
        (
            as_csv(UR5, "joint,type,a [mm],alpha [rad],d [mm],theta [rad]"),
            "standard",
            "1.19 mm long together: these look like m; write a [m] and d [m]",
        ),
        (as_csv(UR5, scale=(1, 180 / pi, 1, 1)), "standard", "alpha is stated in rad and reaches 90: degrees? then"),
        (as_csv(UR5, "joint,type,a [m],alpha [deg],d [m],theta"), "standard", "1.5708 is a quarter turn in rad: write"),
        (HEAD.replace(" [rad]", "") + "one,r,0.3,0.7,0,0\n", "standard", "no unit is stated, and 0.7 may be rad or"),
        (HEAD + "one,r,0.3,0,0,0\none,r,0.3,0,0,0\n", "standard", "rows 1 and 2 are both named 'one'; give each a"),
        (HEAD, "standard", "holds a header and no rows; a row for each joint is needed"),
        (HEAD.replace("alpha [rad]", "alpha [deg]") + "one,r,0.3,-1.5708,0,0\ntwo,r,0.3,1.13,0,0\n", "standard",
         "1.5708 is a quarter turn in rad: write alpha [rad]"),
        ("one,r,0.3,0,0,0\ntwo,r,0.3,0,0,0\n", "standard", "holds the number 0 twice, so it is no header; write the"),
        (HEAD + "one,hinge,0.3,0,0,0\n", "standard", "row 1: type 'hinge'; "),
        (HEAD + "one,r,0.3,0,q1,0\n", "standard", "row 1: d is q1, and the joint is rotary; correct its type"),
        (HEAD + "one,r,0.3,wide,0,0\n", "standard", "row 1 (line 2): alpha is 'wide'; a number such as 0.5, pi/2"),
        (HEAD + "one,r,0.3,0,0,-q1\n", "standard", "row 1 (line 2): theta is '-q1'"),
        (HEAD + "one,fixed,0.3,0,0,0\n", "standard", "no joint moves"),
        (HEAD.replace("a [m]", "a [furlong]") + "one,r,0.3,0,0,0\n", "standard", "column a: unit 'furlong' is unknown"),
        (HEAD[:-1] + ",lower,upper\none,r,0.3,0,0,0,1,-1\n", "standard", "row 1 has lower above upper; exchange them"),
        (HEAD[:-1] + ",lower,upper\none,r,0.3,0,0,0,-180,180\n", "standard", "row 1: lower is -180 rad; it looks"),
        (HEAD[:-1] + ",A [m]\none,r,0.3,0,0,0,1\n", "standard", "columns a and A are both a; leave one out"),
        ("", "standard", "the file is empty"),
    ],
)  # fmt: skip
def test_a_table_that_cannot_be_used_is_one_line_that_says_what_to_do(tmp_path, text, convention, said):
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(ChainError) as told:
        read_dh(tmp_path / "table.csv", convention)
    assert said in str(told.value)
    assert str(told.value).startswith("table.csv: ")
    assert "\n" not in str(told.value)


def test_a_file_that_is_not_there_is_told():
    with pytest.raises(ChainError, match=r"dh=nowhere\.csv"):
        read_dh("nowhere.csv")
