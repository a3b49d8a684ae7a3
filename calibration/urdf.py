"""`read_urdf`: a robot's links and joints from its URDF (without meshes), and the chain between two of its links.

Lengths are mm here, metres there. What cannot be used is a `UrdfError` in one line. Source: wiki.ros.org/urdf/XML
(link, joint), for `quat_xyzw` its version 1.2. `with_origins` writes new origins into the user's own file.
"""

import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import final
from xml.parsers import expat

import numpy as np

from calibench.calibration.kinematics import Chain, ChainError, ChainJoint, Kind, Mimic
from calibench.calibration.rigid import Array, quaternion, rpy, rpy_of, shift
from calibench.core.options import suggest
from calibench.core.tables.data_file import MEGABYTE, read_whole
from calibench.core.words import shortened

_MM = 1000.0
_LONGEST = 1e5  # mm, of all links of an arm together
_HUGE = 1e9  # of any number but a limit, which is written as 1e308 where there is none
_LARGEST = 20 * MEGABYTE  # that of a humanoid has .2
_MOST_LINKS = 2_000  # and as many joints: a hall of ten robots has 500
_KINDS: dict[str, Kind] = {"revolute": "rotary", "continuous": "rotary", "prismatic": "sliding"}
_MOVING = (*_KINDS, "floating", "planar")


class UrdfError(ChainError):
    """A URDF that cannot be used; the message is one line that says what to do."""


@final
@dataclass(frozen=True, eq=False)
class Link:
    """One link: its mass [kg] and the centre of it (3,) [mm] in the link's frame; None where there is no <inertial>."""

    name: str
    mass: float | None = None
    centre: Array | None = None


@final
@dataclass(frozen=True, eq=False)
class Joint:
    """One joint as the URDF has it (its `type` there); `origin`, (4, 4) [mm], from parent to child at zero."""

    name: str
    type: str
    parent: str
    child: str
    origin: Array
    axis: Array
    lower: float
    upper: float
    mimic: Mimic | None = None

    @property
    def moves(self) -> bool:
        """Tell whether the joint moves."""
        return self.type in _MOVING


@final
@dataclass(frozen=True, eq=False)
class Robot:
    """A tree of links and joints; `source` is what error messages call it.

    `option` is what stands before base= and tip= where its user writes them: "machine." or "problem.".
    """

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    source: str = "the URDF"
    option: str = ""

    @property
    def root(self) -> str:
        """Return the one link that no joint leads to."""
        children = {joint.child for joint in self.joints}
        return next(link.name for link in self.links if link.name not in children)

    def chain(self, base: str = "", tip: str = "") -> Chain:
        """Return the chain from the link `base` (the root) to the link `tip`.

        Without `tip` it is the leaf that most moving joints lead to; where several leaves hang on the same moving
        joints, the last link that leads to all of them. A `UrdfError` lists several arms with as many joints.
        """
        names = [link.name for link in self.links]
        for what, link in (("base", base), ("tip", tip)):
            if link and link not in names:
                raise UrdfError(f"{self.source}: {self.option}{what}={link!r} is no link of it; {suggest(link, names)}")
        base, parents = base or self.root, {joint.parent for joint in self.joints}
        leaves = [name for name in names if name not in parents]
        if not tip:
            below: dict[str, tuple[str, ...]] = {}
            for leaf in leaves:
                try:
                    path = self._path(base, leaf)
                except UrdfError:
                    continue
                below[leaf] = tuple(joint.name for joint in path if joint.moves)
            most = max(map(len, below.values()), default=0)
            if most == 0:
                raise UrdfError(f"{self.source}: no joint moves behind {base!r}; take {self.option}base={self.root}")
            best = [leaf for leaf, moving in below.items() if len(moving) == most]
            paths = [[base, *(joint.child for joint in self._path(base, leaf))] for leaf in best]
            shared: str = [steps[0] for steps in zip(*paths, strict=False) if len(set(steps)) == 1][-1]
            if len({below[leaf] for leaf in best}) > 1:
                raise UrdfError(
                    f"{self.source}: {len(best)} links have {most} moving joints above them "
                    f"({', '.join(sorted(best))}); take one as {self.option}tip=, or {self.option}tip={shared}, where "
                    "they part"
                )
            tip = shared  # of one leaf it is this
        path = self._path(base, tip)
        held, joints = np.eye(4), []
        for joint in path:
            held = held @ joint.origin
            if not joint.moves:
                continue
            if joint.type not in _KINDS:
                raise UrdfError(
                    f"{self.source}: joint {joint.name!r} is {joint.type}; only revolute, continuous, prismatic and "
                    f"fixed joints make an arm; take {self.option}base={joint.child}"
                )
            mass, centre = self._carried(joint.child, {step.name for step in path})
            joints.append(ChainJoint(
                name=joint.name, kind=_KINDS[joint.type], origin=held, axis=joint.axis, lower=joint.lower,
                upper=joint.upper, mimic=self._followed(joint), mass=mass, centre=centre,
            ))  # fmt: skip
            held = np.eye(4)
        if not joints:
            raise UrdfError(
                f"{self.source}: no joint moves between {base!r} and {tip!r}; take {self.option}tip= one of "
                f"{', '.join(sorted(leaves))}"
            )
        length = sum(float(np.linalg.norm(origin[:3, 3])) for origin in (*(j.origin for j in joints), held))
        if length > _LONGEST:
            raise UrdfError(
                f"{self.source}: its links are {length / 1e3:.0f} m long together: a URDF is in metres, and these look "
                "like mm; divide each xyz by 1000"
            )
        return Chain(tuple(joints), held, self.name, base, tip)

    def _followed(self, joint: Joint) -> Mimic | None:
        """Return which joint that is read `joint` follows, through those that follow others; None where none."""
        known = {one.name: one for one in self.joints}
        mimic, at, passed, scale = None, joint, {joint.name}, 1.0
        while at.mimic is not None:
            of = at.mimic.joint
            if of not in known:
                raise UrdfError(
                    f"{self.source}: joint {at.name!r} mimics {of!r}, which is no joint of it; {suggest(of, known)}"
                )
            if of in passed:
                raise UrdfError(
                    f"{self.source}: joint {at.name!r} mimics {of!r}, which follows it: a circle; leave out one <mimic>"
                )
            mimic = Mimic(of, scale * at.mimic.gain, scale * at.mimic.offset + (mimic.offset if mimic else 0.0))
            scale = mimic.gain
            passed.add(of)
            at = known[of]
        return mimic

    def _path(self, base: str, tip: str) -> list[Joint]:
        """Return the joints from `base` to `tip`."""
        above = {joint.child: joint for joint in self.joints}
        path, at = [], tip
        while at != base:
            if at not in above:
                raise UrdfError(f"{self.source}: {tip!r} does not hang on {base!r}; take {self.option}base={self.root}")
            path.append(above[at])
            at = above[at].parent
        return path[::-1]

    def _carried(self, link: str, path: set[str]) -> tuple[float | None, Array | None]:
        """Return mass and centre of all that hangs on `link` but the arm's own next joints; fingers stand at zero."""
        masses: list[tuple[float, Array]] = []
        known = {each.name: each for each in self.links}
        behind: dict[str, list[Joint]] = {}
        for joint in self.joints:
            behind.setdefault(joint.parent, []).append(joint)
        below = [(link, np.eye(4))]
        while below:
            name, at = below.pop()
            one = known[name]
            if one.mass is not None and one.centre is not None:
                masses.append((one.mass, at[:3, :3] @ one.centre + at[:3, 3]))
            below += [(j.child, at @ j.origin) for j in behind.get(name, ()) if not (j.moves and j.name in path)]
        if not masses:
            return None, None
        whole = sum(mass for mass, _ in masses)
        if whole == 0:
            return 0.0, np.zeros(3)
        return whole, np.asarray(sum(mass * centre for mass, centre in masses) / whole)


def read_urdf(path: str | Path, option: str = "") -> Robot:
    """Return the robot of a URDF file. Raises `UrdfError`, one line, for what is none or cannot be used."""
    path = Path(path)
    return parse_urdf(urdf_text(path), path.name, option)


def urdf_text(path: Path) -> bytes:
    """Return what a URDF file holds. Raises `UrdfError` for what is no file, or too large a one."""
    try:
        return read_whole(path, _LARGEST, "give the URDF of the arm alone")
    except OSError as problem:
        raise UrdfError(f"urdf={path}: cannot be read: {problem.strerror or problem}") from None
    except ValueError as problem:
        raise UrdfError(f"urdf={path}: {problem}") from None


def parse_urdf(text: str | bytes, source: str = "the URDF", option: str = "") -> Robot:
    """Return the robot of a URDF's text; `source` is what error messages call it, `option` as in `read_urdf`."""
    plain = text if isinstance(text, str) else text.decode("utf-8", "replace")
    expand = f"{source}: this is xacro, not URDF; expand it first: xacro {source} > arm.urdf"
    if "\0" in plain:
        raise UrdfError(f"{source}: holds NUL bytes, as UTF-16 does; save it as UTF-8")
    if "<!ENTITY" in plain:
        raise UrdfError(f"{source}: declares entities (<!ENTITY), which no URDF needs; write their text in their place")
    try:
        tree = ElementTree.fromstring(text)
    except (ElementTree.ParseError, LookupError, ValueError) as problem:  # the latter of encodings
        if "xacro:" in plain:
            raise UrdfError(expand) from problem
        raise UrdfError(f"{source}: no URDF, as it is not XML ({problem}); give the .urdf file itself") from problem
    if tree.tag != "robot":
        raise UrdfError(f"{source}: no URDF, as it opens with <{tree.tag}> and not with <robot>")
    foreign = "{" if "<xacro:" in plain else "\0"  # what a tag of another namespace begins with; a comment says so too
    if any(one.tag.startswith(foreign) or any("${" in word for word in one.attrib.values()) for one in tree.iter()):
        raise UrdfError(expand)
    for kind in ("link", "joint"):
        if (count := len(tree.findall(kind))) > _MOST_LINKS:
            raise UrdfError(f"{source}: has {count} {kind}s, and at most {_MOST_LINKS} are read; give the arm alone")
    links = []
    for each in tree.findall("link"):
        if not (name := each.get("name")):
            raise UrdfError(f"{source}: a <link> has no name; give it one")
        inertial = each.find("inertial")
        weighs, mass, centre = None if inertial is None else inertial.find("mass"), None, None
        if inertial is not None and weighs is not None:
            mass = float(_numbers(weighs.get("value", "0"), 1, f"{source}: link {name!r}, mass")[0])
            if mass < 0:
                raise UrdfError(f"{source}: link {name!r} has a mass of {mass:g} kg; it cannot be negative")
            centre = _placement(inertial.find("origin"), f"{source}: link {name!r}")[:3, 3]
        links.append(Link(name, mass, centre))
    joints = tuple(_joint(each, source) for each in tree.findall("joint"))
    robot = Robot(tree.get("name", "robot"), tuple(links), joints, source, option)
    _check_tree(robot)
    return robot


def _joint(element: ElementTree.Element, source: str) -> Joint:
    name, kind = element.get("name"), element.get("type", "")
    if not name:
        raise UrdfError(f"{source}: a <joint> has no name; give it one")
    where = f"{source}: joint {name!r}"
    if kind not in (*_MOVING, "fixed"):
        raise UrdfError(f"{where} has type={kind!r}; revolute, continuous, prismatic or fixed is needed")
    ends = [end.get("link") if (end := element.find(side)) is not None else None for side in ("parent", "child")]
    if not ends[0] or not ends[1]:
        raise UrdfError(f"{where} has no <{'child' if ends[0] else 'parent'} link=...>; add it")
    turns = element.find("axis")
    axis = np.array([1.0, 0, 0]) if turns is None else _numbers(turns.get("xyz", ""), 3, f"{where}, axis")
    length = float(np.linalg.norm(axis))
    if kind in _KINDS and not length > 0:
        raise UrdfError(f"{where} has the axis 0 0 0; give the direction it turns about or slides along")
    scale, limit, sides = _MM if kind == "prismatic" else 1.0, element.find("limit"), [-np.inf, np.inf]
    if limit is not None and kind in ("revolute", "prismatic"):
        words = [limit.get("lower"), limit.get("upper")]
        for k, one in enumerate(words):
            if one is not None:
                sides[k] = scale * float(_numbers(one, 1, f"{where}, limit", np.inf)[0])
        if sides[0] == sides[1] == 0.0 or (words[0] is None and words[1] is None):
            sides = [-np.inf, np.inf]  # both left out, or 0 and 0: how files say that nobody looked the limits up
        if sides[0] > sides[1]:
            raise UrdfError(f"{where} has lower={words[0]} above upper={words[1]}; exchange them")
    follows, mimic = element.find("mimic"), None
    if follows is not None and follows.get("joint"):
        offset = scale * float(_numbers(follows.get("offset", "0"), 1, f"{where}, mimic")[0])
        gain = float(_numbers(follows.get("multiplier", "1"), 1, f"{where}, mimic")[0])
        mimic = Mimic(str(follows.get("joint")), gain, offset)
    return Joint(
        name=name, type=kind, parent=ends[0], child=ends[1], origin=_placement(element.find("origin"), where),
        axis=axis / (length or 1.0), lower=sides[0], upper=sides[1], mimic=mimic,
    )  # fmt: skip


def _placement(origin: ElementTree.Element | None, where: str) -> Array:
    if origin is None:
        return np.eye(4)
    x, y, z = _MM * _numbers(origin.get("xyz", "0 0 0"), 3, f"{where}, origin xyz")
    if origin.get("quat_xyzw") is not None:
        turned = quaternion(*_numbers(origin.get("quat_xyzw", ""), 4, f"{where}, origin quat_xyzw"))
        if not np.isfinite(turned).all():
            raise UrdfError(f"{where}, origin quat_xyzw: 0 0 0 0 is no rotation; no rotation is 0 0 0 1")
    else:
        turned = rpy(*_numbers(origin.get("rpy", "0 0 0"), 3, f"{where}, origin rpy"))
    return np.asarray(shift(x, y, z) @ turned)


def _numbers(text: str, count: int, where: str, most: float = _HUGE) -> Array:
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.array([np.nan])
    if len(values) != count or not np.isfinite(values).all():
        raise UrdfError(f"{where}: {shortened(text)!r} is not {count} number{'s' if count > 1 else ''}")
    if np.abs(values).max() > most:
        raise UrdfError(f"{where}: {shortened(text)!r} is above {most:g}, which no arm has")
    return values


def _check_tree(robot: Robot) -> None:
    """Raise `UrdfError` where links and joints do not make one tree."""
    source, names = robot.source, dict.fromkeys(link.name for link in robot.links)
    if not any(joint.moves for joint in robot.joints):
        raise UrdfError(f"{source}: no joint of it moves; give the whole arm's URDF")
    for kind, all_of_kind in (("links", robot.links), ("joints", robot.joints)):
        twice, count = max(Counter(one.name for one in all_of_kind).items(), key=lambda of: of[1], default=("", 0))
        if count > 1:
            raise UrdfError(f"{source}: two {kind} are named {twice!r}; give each a name of its own")
    above: dict[str, Joint] = {}
    for joint in robot.joints:
        for end in (joint.parent, joint.child):
            if end not in names:
                raise UrdfError(
                    f'{source}: joint {joint.name!r} names the link {end!r}, which is missing; add <link name="{end}"/>'
                )
        if joint.child in above:
            raise UrdfError(
                f"{source}: the joints {above[joint.child].name!r} and {joint.name!r} both lead to {joint.child!r}, a "
                "closed loop; an arm is a tree, so leave one of them out"
            )
        above[joint.child] = joint
    for name in names:
        at, steps = name, 0
        while at in above:
            at, steps = above[at].parent, steps + 1
            if steps > len(above):
                raise UrdfError(f"{source}: the joint {above[name].name!r} leads back to itself; an arm has no cycle")
    roots = [name for name in names if name not in above]
    joined = {joint.parent for joint in robot.joints}
    if len(roots) > 1:
        loose = next((name for name in roots if name not in joined), None)
        remedy = f"link {loose!r} hangs on no joint: leave it out" if loose else "join them by a fixed joint"
        raise UrdfError(f"{source}: {len(roots)} links hang on nothing ({', '.join(roots)}); {remedy}")


def with_origins(text: bytes, origins: Mapping[str, Array], comment: str) -> bytes:
    """Return the URDF `text` with new `origins`, joint -> (4, 4) [mm], and a `comment` at its beginning."""
    # where the content of each joint begins ("" is the robot), and where the tag of its origin stands
    parser = expat.ParserCreate()
    inside: dict[str, int] = {}
    tags: dict[str, tuple[int, int]] = {}
    names, joint = list[str](), ""  # the open elements, and the last joint
    tag = re.compile(rb"""(?:[^>"']|"[^"]*"|'[^']*')*>""")  # its end; a > between quotation marks is none

    def begin(name: str, attributes: dict[str, str]) -> None:
        nonlocal joint
        at = parser.CurrentByteIndex
        match = tag.match(whole, at)
        assert match is not None  # the parser has read it
        if names == [] and name == "robot":
            inside[""] = match.end()
        elif names == ["robot"] and name == "joint":
            joint = attributes.get("name", "")
            inside[joint] = match.end()
        elif names == ["robot", "joint"] and name == "origin":
            tags[joint] = (at, match.end())
        names.append(name)

    whole = text
    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda _: names.pop()
    parser.Parse(whole, True)
    lost = [name for name in origins if name not in inside]
    if lost:
        raise ValueError(f"joint {lost[0]} stands not in the text of the URDF")
    changes = [(inside[""], inside[""], f"\n  <!-- {comment.replace('--', '- -')} -->".encode())]
    for name, origin in origins.items():
        xyz, rpy = (  # with the digits of a nanometre and a nanoradian
            " ".join(f"{round(v, 9) + 0.0:.9f}".rstrip("0").rstrip(".") or "0" for v in values)
            for values in (origin[:3, 3] / _MM, rpy_of(origin))
        )
        written = f'xyz="{xyz}" rpy="{rpy}"'.encode()
        if name in tags:
            start, end = tags[name]
            other = re.sub(rb"""\s+(?:xyz|rpy|quat_xyzw|quat)\s*=\s*(?:"[^"]*"|'[^']*')""", b"", text[start:end])
            changes.append((start, end, other.replace(b"<origin", b"<origin " + written, 1)))
        else:
            changes.append((inside[name], inside[name], b"\n    <origin " + written + b"/>"))
    for start, end, new in sorted(changes, reverse=True):
        text = text[:start] + new + text[end:]
    return text
