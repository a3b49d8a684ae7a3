"""Reading a URDF: what it says of joints, masses and tips, and one line for what cannot be used."""

import re

import numpy as np
import pytest

from calibench.calibration import UrdfError, parse_urdf, read_urdf
from calibench.calibration.urdf import with_origins
from calibench.core.notes import Code
from calibench.problems.arm.families import shipped
from tests.calibration.beside_the_arm import ARM, READ, urdf
from tests.calibration.test_kinematics import ODD


def joint(name, parent, child, kind="revolute", inside='<axis xyz="0 0 1"/>'):
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'


def robot(*joints, links="abcd"):
    return f'<robot name="r">{"".join(f"<link name={each!r}/>" for each in links)}{"".join(joints)}</robot>'


def test_joints_have_their_limits_axes_and_followers():
    chain = parse_urdf(ODD).chain()
    rail, swing, echo = chain.joints
    assert (rail.kind, rail.lower, rail.upper) == ("sliding", -400, 600)
    assert rail.axis == pytest.approx([1 / 3, 2 / 3, -2 / 3])
    assert (swing.kind, swing.lower, swing.upper) == ("rotary", -np.inf, np.inf)
    assert (echo.mimic.joint, echo.mimic.gain, echo.mimic.offset) == ("swing", -0.5, 0.2)
    assert chain.driven == ("rail", "swing")
    assert (chain.base, chain.tip) == ("ground", "claw")
    assert chain.tail[:3, 3] == pytest.approx([10, 20, 30])
    assert chain.positions(np.array([[5.0, 1.0]])) == pytest.approx(np.array([[5.0, 1.0, -0.3]]))


def test_an_axis_left_out_is_x_as_the_specification_says():
    chain = parse_urdf(robot(joint("j", "a", "b", inside=""), links="ab")).chain()
    assert chain.joints[0].axis.tolist() == [1, 0, 0]


def test_masses_of_links_bolted_on_are_one_with_the_link_that_moves():
    heavy = '<inertial><origin xyz="{}"/><mass value="{}"/></inertial>'
    text = (
        '<robot name="r"><link name="a"/><link name="b">' + heavy.format(".1 0 0", 3) + '</link><link name="c">'
        + heavy.format("0 0 .2", 1) + "</link>" + joint("turn", "a", "b")
        + joint("bolt", "b", "c", "fixed", '<origin xyz="0 .4 0"/>') + "</robot>"
    )  # fmt: skip
    [moving] = parse_urdf(text).chain().joints
    assert moving.mass == 4.0
    assert moving.centre == pytest.approx([75, 100, 50])


def test_masses_are_those_of_the_urdf_or_none():
    assert all(joint.mass is None for joint in read_urdf(shipped("panda.urdf")).chain().joints)
    assert sum(joint.mass for joint in read_urdf(shipped("ur10.urdf")).chain().joints) == pytest.approx(28.435)


def test_leaves_bolted_to_one_link_are_no_choice_to_make():
    text = robot(joint("j", "a", "b"), joint("f", "b", "c", "fixed", ""), joint("g", "b", "d", "fixed", ""))
    assert parse_urdf(text).chain().tip == "b"
    assert parse_urdf(text).chain(tip="d").tip == "d"


def test_two_arms_are_listed_for_a_choice():
    text = robot(joint("left", "a", "b"), joint("right", "a", "c"), links="abc")
    with pytest.raises(UrdfError, match=r"\(b, c\); take one as tip="):
        parse_urdf(text).chain()
    assert parse_urdf(text).chain(tip="c").driven == ("right",)
    with pytest.raises(UrdfError, match=r"machine\.tip=a"):
        parse_urdf(text, option="machine.").chain()
    with pytest.raises(UrdfError, match=r"'a' does not hang on 'b'; take problem\.base=a"):
        parse_urdf(text, option="problem.").chain("b", "a")


def test_a_joint_that_follows_a_follower_follows_the_joint_that_is_read():
    echo = joint("echo", "b", "c", inside='<axis xyz="0 0 1"/><mimic joint="swing" multiplier="2" offset=".1"/>')
    last = joint("last", "c", "d", inside='<axis xyz="0 0 1"/><mimic joint="echo" multiplier="-3" offset=".2"/>')
    chain = parse_urdf(robot(joint("swing", "a", "b"), echo, last)).chain()
    assert chain.driven == ("swing",)
    assert chain.positions(np.array([[0.5]])) == pytest.approx(np.array([[0.5, 1.1, -3.1]]))


@pytest.mark.parametrize("circle", ["j", "jk", "jkl"])
def test_a_circle_of_mimics_is_refused(circle):
    inside = '<axis xyz="0 0 1"/><mimic joint="{}"/>'
    ends = zip("abc", "bcd", "jkl", strict=True)
    after = dict(zip(circle, circle[1:] + circle[0], strict=True))
    joints = [joint(name, a, b, inside=inside.format(after[name]) if name in after else "") for a, b, name in ends]
    with pytest.raises(UrdfError, match="mimics 'j'"):
        parse_urdf(robot(*joints)).chain()


def test_more_links_than_an_arm_has_are_refused_before_they_are_looked_at():
    links = [f"l{k}" for k in range(20_000)]
    text = robot(*(joint(f"j{k}", f"l{k}", f"l{k + 1}") for k in range(19_999)), links=links)
    with pytest.raises(UrdfError, match="20000 links"):
        parse_urdf(text)


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/urandom"])
def test_a_urdf_that_never_ends_is_refused(tmp_path, device):
    (tmp_path / "arm.urdf").symlink_to(device)
    with pytest.raises(UrdfError, match=r"arm\.urdf: is a device"):
        read_urdf(tmp_path / "arm.urdf")


def test_a_mimic_of_a_joint_that_is_not_there_is_told():
    text = robot(joint("j", "a", "b", inside='<mimic joint="jay"/>'), joint("jaw", "b", "c"), links="abc")
    with pytest.raises(UrdfError, match="did you mean 'jaw'"):
        parse_urdf(text).chain()


@pytest.mark.parametrize("case", READ)
def test_what_stands_beside_the_arm_changes_nothing_of_it(case):
    plain, robot = parse_urdf(ARM).chain(tip="tool"), parse_urdf(urdf(READ[case]))
    chain = robot.chain(tip="tool")
    for ours, theirs in zip(chain.joints, plain.joints, strict=True):
        assert (ours.name, ours.kind, ours.lower, ours.upper) == (theirs.name, theirs.kind, theirs.lower, theirs.upper)
        assert ours.origin.tolist() == theirs.origin.tolist()
        assert ours.axis.tolist() == theirs.axis.tolist()
    assert chain.tail.tolist() == plain.tail.tolist()


@pytest.mark.parametrize(
    ("case", "fault"),
    [
        ("a macro", "<xacro:grey> is left over"),
        ("a sensor of gazebo", "<sensor:camera> has a prefix"),
        ("a plugin", "${...} is left over"),
        ("limits exchanged", "lower=2.7 above upper=-2.7"),
        ("a loose link", "link 'table' hangs on no joint"),
        ("a default name space", "a name space is declared"),
        ("two ways to a camera", "both lead to 'cam'"),
    ],
)
def test_what_is_wrong_beside_the_arm_is_one_note(case, fault):
    robot = parse_urdf(urdf(READ[case]), "of/my.urdf")
    [note] = robot.beside(robot.chain(tip="tool"))
    assert note.code == Code.BESIDE_THE_ARM
    assert note.text.startswith("my.urdf: ")
    assert fault in note.values["faults"][0]
    assert parse_urdf(ARM).beside(parse_urdf(ARM).chain()) == ()


def test_the_same_fault_on_the_chain_is_refused():
    off = parse_urdf(urdf(READ["limits exchanged"]))
    with pytest.raises(UrdfError, match=r"joint 'pan' has lower=2.7 above upper=-2.7"):
        off.chain(tip="cam")
    with pytest.raises(UrdfError, match=r"both lead to 'cam'"):
        parse_urdf(urdf(READ["two ways to a camera"])).chain(tip="cam")
    with pytest.raises(UrdfError, match=r"two joints are named 'j3'"):
        parse_urdf(ARM.replace('"j1"', '"j3"')).chain()
    with pytest.raises(UrdfError, match=r"xacro my\.urdf > arm\.urdf"):
        parse_urdf(ARM.replace('xyz="0 0 .5"', 'xyz="0 0 ${upper}"'), "my.urdf").chain()


def test_a_cycle_beside_the_arm_is_passed_over():
    cycle = '<link name="p"/><link name="q"/>' + joint("to", "p", "q") + joint("fro", "q", "p")
    robot = parse_urdf(urdf(cycle))
    assert robot.chain().driven == ("j1", "j2", "j3")
    assert "leads back to itself" in robot.beside(robot.chain())[0].text


@pytest.mark.parametrize("case", READ)
def test_writing_keeps_every_other_byte(case):
    text = urdf(READ[case])
    origins = {each.name: each.origin for each in parse_urdf(ARM).joints}
    changed = with_origins(text, origins, "new")
    of_joints = re.compile(rb"<origin [^>]*/>")
    assert of_joints.split(changed.replace(b"\n  <!-- new -->", b"", 1)) == of_joints.split(text)
    again = parse_urdf(changed)
    assert [each.origin.tolist() for each in again.chain(tip="tool").joints] == [
        each.origin.tolist() for each in parse_urdf(text).chain(tip="tool").joints
    ]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no URDF, as it is not XML"),
        ("<mujoco/>", "opens with <mujoco>"),
        ('<robot xmlns:xacro="http://x"><xacro:arm/></robot>', "is xacro, not URDF; expand it first: xacro"),
        ("<robot><xacro:arm/></robot>", "is xacro, not URDF; expand it first"),
        (robot(joint("j", "a", "b").replace("0 0 1", "${up}")), "is xacro, not URDF; expand it first"),
        (robot(joint("j", "a", "b", "fixed"), links="ab"), "no joint of it moves"),
        (robot(joint("j", "a", "e"), links="ab"), "joint 'j' names the link 'e', which is missing; add <link"),
        (robot(joint("j", "a", "b"), joint("k", "b", "a"), links="ab"), "leads back to itself; an arm has no cycle"),
        (robot(joint("j", "a", "c"), joint("k", "b", "c"), links="abc"), "both lead to 'c', a closed loop"),
        (robot(joint("j", "a", "b"), joint("k", "c", "d")), r"2 links hang on nothing \(a, c\); join them"),
        (robot(joint("j", "a", "b"), joint("k", "e", "c"), links="abc"), r"2 links hang on nothing \(a, e\)"),
        (
            robot(joint("j", "a", "b", inside='<axis xyz="0 0 0"/>'), links="ab"),
            "has the axis 0 0 0; give the direction",
        ),
        (robot(joint("j", "a", "b", inside='<axis xyz="0 1"/>'), links="ab"), "axis: '0 1' is not 3 numbers"),
        (robot(joint("j", "a", "b", "hinge"), links="ab"), "type='hinge'; revolute, continuous, prismatic or fixed"),
        (robot(joint("j", "a", "b"), joint("j", "b", "c"), links="abc"), "two joints are named 'j'"),
        (robot(joint("j", "a", "b", inside='<limit lower="1" upper="-1"/>'), links="ab"), "lower=1 above upper=-1"),
        (robot('<joint name="j" type="revolute"><child link="b"/></joint>', links="ab"), "has no <parent link="),
        (robot(joint("j", "a", "b", inside='<origin quat_xyzw="0 0 0 0"/>'), links="ab"), "0 0 0 0 is no rotation"),
        (robot(joint("j", "a", "b", inside='<axis xyz="1e300 0 0"/>'), links="ab"), "'1e300 0 0' is above 1e"),
        ('<!DOCTYPE robot [<!ENTITY e "ha">]><robot name="&e;"/>', "declares entities"),
        ('<robot><link name="a">', "no URDF, as it is not XML .it ends inside <link>, line 1"),
        ("<robot></link></robot>", "</link> closes another tag"),
        ("</robot>", "</robot> closes another tag"),
        ("<robot><origin xyz=0/></robot>", "<origin> has a word that is no attribute"),
        ("<robot><!-- never ends </robot>", "a tag that does not end"),
        (f"<robot>{'<a>' * 110_000}", "above 100000 tags"),
        ('<robot><joint name="${j}"/></robot>', "is xacro, not URDF; expand it first"),
        (robot(joint("j", "a", "b"), links="ab").encode("utf-16"), "holds NUL bytes, as UTF-16 does; save it as UTF-8"),
    ],
)
def test_what_is_no_arm_is_refused_in_one_line(text, said):
    with pytest.raises(UrdfError, match=said) as refused:
        parse_urdf(text, "my.urdf").chain()
    assert str(refused.value).startswith("my.urdf: ")
    assert "\n" not in str(refused.value)


def test_a_floating_joint_in_the_arm_is_refused_and_the_way_round_it_told():
    text = robot(joint("free", "a", "b", "floating", ""), joint("j", "b", "c"), links="abc")
    with pytest.raises(UrdfError, match=r"'free' is floating; .*base=b"):
        parse_urdf(text).chain()
    assert parse_urdf(text).chain(base="b").driven == ("j",)


def test_a_link_that_is_not_there_is_told_with_the_nearest():
    with pytest.raises(UrdfError, match="did you mean 'wrist_3_link'"):
        read_urdf(shipped("ur10.urdf")).chain(tip="wrist_3_lnk")


def test_a_file_that_is_not_there_is_one_line(tmp_path):
    with pytest.raises(UrdfError, match=r"none\.urdf: cannot be read"):
        read_urdf(tmp_path / "none.urdf")
