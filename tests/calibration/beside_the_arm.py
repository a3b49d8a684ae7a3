"""URDFs of one arm with something beside it that a strict reader stops at; pinocchio 4.1 (urdfdom 6) reads `READ`.

Each is the arm of three joints of `ARM` with a piece put before `</robot>`, or a text exchanged.
"""

ARM = """<?xml version="1.0"?>
<robot name="arm">
  <!-- three joints -->
  <link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="tool"/>
  <joint name="j1" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0 0 .3"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="j2" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0 .1 .1" rpy="0 .2 0"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="j3" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0 0 .5"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="flange" type="fixed"><parent link="c"/><child link="tool"/><origin xyz="0 0 .1"/></joint>
</robot>
"""
_PAN = (
    '<link name="cam"/><joint name="pan" type="{kind}"><parent link="{on}"/><child link="cam"/>{inside}'
    '<axis xyz="{axis}"/><limit {limit} effort="1" velocity="1"/></joint>'
)


def _pan(kind="revolute", on="base", inside="", axis="0 0 1", limit='lower="-1" upper="1"'):
    return _PAN.format(kind=kind, on=on, inside=inside, axis=axis, limit=limit)


def _fixed(inside):
    return (
        f'<link name="cam"/><joint name="mount" type="fixed"><parent link="base"/><child link="cam"/>{inside}</joint>'
    )


READ = {
    # prefixes that nothing declares
    "a sensor of gazebo": '<gazebo reference="c"><sensor:camera name="c"><rate>20</rate></sensor:camera></gazebo>',
    "a controller of gazebo": "<gazebo><controller:gazebo_ros_p3d name='p'/></gazebo>",
    "an attribute with a prefix": '<gazebo xsi:type="x"/>',
    "a prefix in a link": '<link name="w"><body:thing/></link>' + _pan().replace('"cam"', '"w"').replace(
        '<link name="w"/>', ""),
    "a prefix beside links": "<drake:diagram/>",
    # what xacro left
    "a macro": "<xacro:grey/>",
    "a property": '<xacro:property name="x" value="${pi}"/>',
    "a macro that is not called": '<xacro:macro name="m" params="p"><link name="${p}"/></xacro:macro>',
    "a condition round nothing": '<xacro:if value="${sim}"><gazebo/></xacro:if>',
    "a declared xacro": ("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" '),
    "a macro in a link": ('<link name="base"/>', '<link name="base"><xacro:look/></link>'),
    # axes of joints that are fixed
    "a misspelt axis": _fixed('<axis xzy="0 0 1"/>'),
    "an axis of two": _fixed('<axis xyz="0 1"/>'),
    "an axis of 0": _fixed('<axis xyz="0 0 0"/>'),
    "an axis in words": _fixed('<axis xyz="up"/>'),
    "limits of a fixed joint": _fixed('<limit lower="2" upper="-2" effort="1" velocity="1"/>'),
    "a fixed joint of the arm": ('<origin xyz="0 0 .1"/>', '<origin xyz="0 0 .1"/><axis xzy="0 0 1"/>'),
    # joints off the chain
    "limits exchanged": _pan(limit='lower="2.7" upper="-2.7"'),
    "a slide with limits exchanged": _pan("prismatic", limit='lower=".2" upper="-.2"'),
    "an axis of 0 beside": _pan(axis="0 0 0"),
    "a place that is far": _pan(inside='<origin xyz="1e30 0 0"/>'),
    "a finger on the tool": _pan("prismatic", on="tool", limit='lower=".2" upper="-.2"'),
    "limits without numbers": _pan("continuous", limit='lower="" upper=""'),
    "a floating cart": _pan("floating"),
    "a planar cart": _pan("planar"),
    # ${} in words that no number is
    "a plugin": '<gazebo><plugin name="p"><robotNamespace>${ns}</robotNamespace></plugin></gazebo>',
    "an attribute of a plugin": '<gazebo><plugin name="${ns}" filename="$(find x)/y"/></gazebo>',
    "a transmission": '<transmission name="t${k}"><joint name="j1"/></transmission>',
    "a mesh": ('<link name="base"/>', '<link name="base"><visual><mesh filename="${m}"/></visual></link>'),
    # name spaces
    "a default name space": ("<robot ", '<robot xmlns="http://www.ros.org" '),
    "a name space of a block": '<gazebo xmlns="http://sdf"><plugin/></gazebo>',
    "a prefix declared": ("<robot ", '<robot xmlns:sensor="http://s" xmlns:controller="http://c" '),
    # text that XML forbids, and parsers of URDFs do not mind
    "a comment with dashes": "<!-- ------ gripper ------ -->",
    "a letter of Latin-1": "<!-- für -->",
    "an ampersand": "<gazebo><plugin name='a&b'>x & y</plugin></gazebo>",
    "an entity that is not declared": "<gazebo><plugin name='p'>&nbsp;</plugin></gazebo>",
    "a line before the declaration": ("<?xml", "\n<?xml"),
    "text behind the robot": ("</robot>", "</robot>\nsaved by hand"),
    "an encoding that is none": ('<?xml version="1.0"?>', '<?xml version="1.0" encoding="klingon"?>'),
    "an attribute twice": '<gazebo reference="a" reference="b"/>',
    # masses and looks
    "a colour of words": '<material name="grey"><color rgba="x"/></material>',
    "a link that weighs less than nothing": '<link name="cam"><inertial><mass value="-1"/><inertia ixx="1" ixy="0" '
    'ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>' + _pan().replace('<link name="cam"/>', ""),
    "a loose link": '<link name="table"/>',
    "a joint from nowhere": _fixed("").replace('parent link="base"', 'parent link="nowhere"'),
    "two ways to a camera": _pan() + '<joint name="way" type="fixed"><parent link="a"/><child link="cam"/></joint>',
    "two links of a name": '<link name="cam"/>' + _pan(),
    "a word for a kind of joint": _pan("hinge"),
    "a mimic of nothing": _pan(inside='<mimic joint="nobody"/>'),
}  # fmt: skip


def urdf(change):
    """Return the text of the arm with a piece of `READ`."""
    old, new = change if isinstance(change, tuple) else ("</robot>", f"{change}\n</robot>")
    assert old in ARM
    return ARM.replace(old, new, 1).encode("latin-1")
