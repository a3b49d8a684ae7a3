"""`read_urdf`: a robot's links and joints from its URDF (without meshes), and the chain between two of its links.

The file is read as the parsers of the field read it (tinyxml2), and what is wrong with a link or a joint is kept with
it: the chain refuses what stands on it, and what stands `beside` it is a note. Lengths are mm here, metres there. What
cannot be used is a `UrdfError` in one line. Source: wiki.ros.org/urdf/XML (link, joint), for `quat_xyzw` its version
1.2. `with_origins` writes new origins into the user's own file.
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from html import unescape
from pathlib import Path
from typing import final
from xml.etree.ElementTree import Element, TreeBuilder

import numpy as np

from calibench.calibration.kinematics import Chain, ChainError, ChainJoint, Kind, Mimic
from calibench.calibration.rigid import Array, quaternion, rpy, rpy_of, shift
from calibench.core.notes import Code, Note
from calibench.core.options import suggest
from calibench.core.tables.data_file import MEGABYTE, read_whole
from calibench.core.words import shortened

_MM = 1000.0
_LONGEST = 1e5  # mm, of all links of an arm together
_HUGE = 1e9  # of any number but a limit, which is written as 1e308 where there is none
_LARGEST = 20 * MEGABYTE  # that of a humanoid has .2
_MOST_LINKS = 2_000  # and as many joints: a hall of ten robots has 500
_MOST_TAGS = 100_000  # that of a humanoid has 5 000
_MOST_TOLD = 5  # faults in the text of a note
_KINDS: dict[str, Kind] = {"revolute": "rotary", "continuous": "rotary", "prismatic": "sliding"}
_MOVING = (*_KINDS, "floating", "planar")


class UrdfError(ChainError):
    """A URDF that cannot be used; the message is one line that says what to do."""


@final
@dataclass(frozen=True, eq=False)
class Link:
    """One link: its mass [kg] and the centre of it (3,) [mm] in the link's frame; None where there is no <inertial>.

    `fault` is why an arm with it cannot be used.
    """

    name: str
    mass: float | None = None
    centre: Array | None = None
    fault: str = ""


@final
@dataclass(frozen=True, eq=False)
class Joint:
    """One joint as the URDF has it (its `type` there); `origin`, (4, 4) [mm], from parent to child at zero.

    `fault` is why an arm with it cannot be used; its numbers are not those of the file then.
    """

    name: str
    type: str
    parent: str
    child: str
    origin: Array
    axis: Array
    lower: float
    upper: float
    mimic: Mimic | None = None
    fault: str = ""

    @property
    def moves(self) -> bool:
        """Tell whether the joint moves."""
        return self.type != "fixed"


@final
@dataclass(frozen=True, eq=False)
class Robot:
    """Links and joints; `source` is what error messages call them.

    `option` is what stands before base= and tip= where its user writes them: "machine." or "problem.". `left_over` are
    words of the file that a parser of URDFs passes over, each with what it is; `xacro` tells that some are of xacro.
    """

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    source: str = "the URDF"
    option: str = ""
    left_over: tuple[str, ...] = ()
    xacro: bool = False

    @cached_property
    def _above(self) -> dict[str, Joint]:
        """Return the joint that leads to each link, the first where there are several."""
        return {joint.child: joint for joint in reversed(self.joints)}

    @cached_property
    def _behind(self) -> dict[str, list[Joint]]:
        """Return the joints that hang on each link; a link hangs on one joint, so that no circle begins at a root."""
        behind: dict[str, list[Joint]] = {}
        for joint in self.joints:
            if self._above[joint.child] is joint:
                behind.setdefault(joint.parent, []).append(joint)
        return behind

    @cached_property
    def root(self) -> str:
        """Return the one link that no joint leads to and that a moving joint hangs on."""
        roots = [name for name in dict.fromkeys(j.parent for j in self.joints) if name not in self._above]
        arms = [root for root in roots if any(j.moves for j in self._below(root))]
        if len(arms) > 1:
            raise self._broken(
                f"{len(arms)} links hang on nothing ({', '.join(arms)}); join them by a fixed joint, or take "
                f"{self.option}base={arms[0]}"
            )
        if not arms and any(joint.moves for joint in self.joints):
            raise self._broken(next((j.fault for j in self.joints if j.fault), "no joint that moves hangs on a link"))
        if not arms:
            raise self._broken("no joint of it moves; give the whole arm's URDF")
        return arms[0]

    def chain(self, base: str = "", tip: str = "") -> Chain:
        """Return the chain from the link `base` (the root) to the link `tip`.

        Without `tip` it is the leaf that most moving joints lead to; where several leaves hang on the same moving
        joints, the last link that leads to all of them. A `UrdfError` lists several arms with as many joints.
        """
        names = list(dict.fromkeys([*(link.name for link in self.links), *(joint.child for joint in self.joints)]))
        for what, link in (("base", base), ("tip", tip)):
            if link and link not in names:
                raise self._broken(f"{self.option}{what}={link!r} is no link of it; {suggest(link, names)}")
        base = base or self.root
        leaves = sorted(set(names) - {joint.parent for joint in self.joints}, key=names.index)
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
                raise self._broken(f"no joint moves behind {base!r}; take {self.option}base={self.root}")
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
        if fault := next((one.fault for one in self._on(path, base) if one.fault), ""):
            raise UrdfError(f"{self.source}: {fault}")
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
            raise self._broken(
                f"no joint moves between {base!r} and {tip!r}; take {self.option}tip= one of "
                f"{', '.join(sorted(leaves))}"
            )
        length = sum(float(np.linalg.norm(origin[:3, 3])) for origin in (*(j.origin for j in joints), held))
        if length > _LONGEST:
            raise UrdfError(
                f"{self.source}: its links are {length / 1e3:.0f} m long together: a URDF is in metres, and these look "
                "like mm; divide each xyz by 1000"
            )
        return Chain(tuple(joints), held, self.name, base, tip)

    def beside(self, chain: Chain) -> tuple[Note, ...]:
        """Return what is wrong in the file and not on the chain, as one note at most."""
        on = {id(one) for one in self._on(self._path(chain.base, chain.tip), chain.base)}
        joined = {joint.parent for joint in self.joints} | set(self._above)
        loose = [f"link {link.name!r} hangs on no joint" for link in self.links if link.name not in joined]
        every: tuple[Link | Joint, ...] = (*self.links, *self.joints)
        faults = [one.fault for one in every if one.fault and id(one) not in on]
        if not (beside := [*dict.fromkeys([*faults, *loose, *self.left_over])]):
            return ()
        more = f"; and {len(beside) - _MOST_TOLD} more" if len(beside) > _MOST_TOLD else ""
        text = (
            f"{Path(self.source).name}: not read, as it stands beside the arm: {'; '.join(beside[:_MOST_TOLD])}{more}"
        )
        return (Note(Code.BESIDE_THE_ARM, text, values={"faults": beside}),)

    def _on(self, path: list[Joint], base: str) -> Iterator[Link | Joint]:
        """Return the links and joints of a path, with others of the same name or place."""
        names, children = {joint.name for joint in path}, {joint.child for joint in path}
        yield from (joint for joint in self.joints if joint.name in names or joint.child in children)
        yield from (link for link in self.links if link.name == base or link.name in children)

    def _broken(self, text: str) -> UrdfError:
        """Return the refusal of a file without an arm; what xacro has not expanded is its likely cause."""
        return UrdfError(f"{self.source}: {_expand(self.source) if self.xacro else text}")

    def _below(self, link: str) -> Iterator[Joint]:
        below = [link]
        while below:
            for joint in self._behind.get(below.pop(), ()):
                yield joint
                below.append(joint.child)

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
            if known[of].fault:
                raise UrdfError(f"{self.source}: joint {at.name!r} mimics {of!r}: {known[of].fault}")
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
        path, at = list[Joint](), tip
        while at != base:
            if at not in self._above or len(path) > len(self.joints):
                raise self._broken(f"{tip!r} does not hang on {base!r}; take {self.option}base={self.root}")
            path.append(self._above[at])
            at = self._above[at].parent
        return path[::-1]

    def _carried(self, link: str, path: set[str]) -> tuple[float | None, Array | None]:
        """Return mass and centre of all that hangs on `link` but the arm's own next joints; fingers stand at zero."""
        masses: list[tuple[float, Array]] = []
        known = {each.name: each for each in self.links}
        below = [(link, np.eye(4))]
        while below:
            name, at = below.pop()
            one = known.get(name, Link(name))
            if one.mass is not None and one.centre is not None:
                masses.append((one.mass, at[:3, :3] @ one.centre + at[:3, 3]))
            hanging = (j for j in self._behind.get(name, ()) if not j.fault and not (j.moves and j.name in path))
            below += [(joint.child, at @ joint.origin) for joint in hanging]
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
    whole = text.encode() if isinstance(text, str) else text
    tree, _ = _scan(whole, source)
    for kind in ("link", "joint"):
        if (count := len(tree.findall(kind))) > _MOST_LINKS:
            raise UrdfError(f"{source}: has {count} {kind}s, and at most {_MOST_LINKS} are read; give the arm alone")
    links = tuple(_link(each, source) for each in tree.findall("link"))
    joints = tuple(_joint(each, source) for each in tree.findall("joint"))

    # what is wrong between them: names and ends that are there twice, or missing
    names, titles = Counter(link.name for link in links), Counter(joint.name for joint in joints)
    leading: dict[str, list[Joint]] = {}
    for joint in joints:
        leading.setdefault(joint.child, []).append(joint)
    above = {child: into[0].parent for child, into in leading.items()}

    def fault(joint: Joint) -> str:
        if titles[joint.name] > 1:
            return f"two joints are named {joint.name!r}; give each a name of its own"
        for end in (joint.parent, joint.child):
            if end not in names:
                return f'joint {joint.name!r} names the link {end!r}, which is missing; add <link name="{end}"/>'
        if len(into := leading[joint.child]) > 1:
            return (
                f"the joints {into[0].name!r} and {into[1].name!r} both lead to {joint.child!r}, a closed loop; an arm "
                "is a tree, so leave one of them out"
            )
        at, steps = joint.parent, 0
        while at in above and steps <= len(above):
            at, steps = above[at], steps + 1
        return f"the joint {joint.name!r} leads back to itself; an arm has no cycle" if at in above else ""

    twice = {link: f"two links are named {link!r}; give each a name of its own" for link in names if names[link] > 1}
    links = tuple(replace(link, fault=link.fault or twice.get(link.name, "")) for link in links)
    joints = tuple(replace(joint, fault=joint.fault or fault(joint)) for joint in joints)

    tags = dict.fromkeys(each.tag for each in tree.iter())
    declared = [word.partition(":")[2] for each in tree.iter() for word in each.attrib if word.startswith("xmlns")]
    prefixes = {tag: tag.partition(":")[0] for tag in tags if ":" in tag}
    unknown = [tag for tag, prefix in prefixes.items() if prefix not in ("xacro", *declared)]
    left = [f"<{tag}> has a prefix that nothing declares" for tag in unknown]
    left += [f"<{tag}> is left over from xacro" for tag in tags if tag.startswith("xacro:")]
    left += ["${...} is left over from xacro"] if b"${" in whole else []
    left += ["a name space is declared for all of it"] if "xmlns" in tree.attrib else []
    xacro = b"${" in whole or any(tag.startswith("xacro:") for tag in tags)
    return Robot(tree.get("name", "robot"), links, joints, source, option, tuple(left), xacro)


_TAG = re.compile(
    rb"""<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>|<(?P<doctype>![A-Za-z][^>]*)>"""
    rb"""|<(?P<end>/?)(?P<name>[^\s/>!?"'=<]+)(?P<rest>(?:[^>"'<]|"[^"]*"|'[^']*')*)>""",
    re.DOTALL,
)
_ATTRIBUTE = re.compile(rb"""\s*([^\s="'/<>]+)\s*=\s*("[^"]*"|'[^']*')""")


def _scan(text: bytes, source: str) -> tuple[Element, dict[Element, tuple[int, int]]]:
    """Return the element <robot> of a file, without texts, and where each tag begins and ends.

    Read as tinyxml2 reads, which most parsers of URDFs stand on: prefixes are part of a name, comments may hold dashes,
    no entity is ever expanded. Tags must close each other and attributes have values between quotation marks.
    """
    if b"\0" in text:
        raise UrdfError(f"{source}: holds NUL bytes, as UTF-16 does; save it as UTF-8")
    stated = re.match(rb"""\s*<\?xml[^>]*encoding\s*=\s*["']([\w.-]+)""", text)
    encoding = stated[1].decode() if stated else "utf-8"
    try:  # what is stated, if it holds ASCII as ASCII
        encoding = encoding if bytes(range(128)).decode(encoding).encode() == bytes(range(128)) else "utf-8"
    except (LookupError, ValueError):
        encoding = "utf-8"
    tree, open_tags = TreeBuilder(), list[str]()
    places, at = dict[Element, tuple[int, int]](), text.find(b"<")
    while at >= 0:
        match = _TAG.match(text, at)
        if match is None or len(places) > _MOST_TAGS:
            raise _no_xml(source, text, at, "a tag that does not end" if match is None else f"above {_MOST_TAGS} tags")
        if b"!ENTITY" in (match["doctype"] or b""):
            raise UrdfError(
                f"{source}: declares entities (<!ENTITY), which no URDF needs; write their text in their place"
            )
        if match["name"] is not None:
            name, rest = match["name"].decode(encoding, "replace"), match["rest"]
            if not places and name != "robot":
                raise UrdfError(f"{source}: no URDF, as it opens with <{shortened(name)}> and not with <robot>")
            if not match["end"]:
                if _ATTRIBUTE.sub(b"", rest).strip() not in (b"", b"/"):
                    raise _no_xml(source, text, at, f"<{shortened(name)}> has a word that is no attribute")
                words = [(one.decode(encoding, "replace") for one in pair) for pair in _ATTRIBUTE.findall(rest)[::-1]]
                attributes = {key: unescape(value[1:-1]) for key, value in words}  # the first of a name
                places[tree.start(name, attributes)] = at, match.end()
                open_tags.append(name)
            if match["end"] or rest.endswith(b"/"):
                if not open_tags or open_tags.pop() != name:
                    raise _no_xml(source, text, at, f"</{shortened(name)}> closes another tag")
                tree.end(name)
                if not open_tags:
                    return tree.close(), places  # what follows the robot is none of it
        at = text.find(b"<", match.end())
    raise _no_xml(source, text, len(text), f"it ends inside <{open_tags[-1]}>" if open_tags else "no tag in it")


def _no_xml(source: str, text: bytes, at: int, why: str) -> UrdfError:
    line = 1 + text.count(b"\n", 0, at)
    return UrdfError(f"{source}: no URDF, as it is not XML ({why}, line {line}); give the .urdf file itself")


def _expand(source: str) -> str:
    return f"this is xacro, not URDF; expand it first: xacro {source} > arm.urdf"


def _link(element: Element, source: str) -> Link:
    if not (name := element.get("name")):
        return Link("", fault="a <link> has no name; give it one")
    inertial = element.find("inertial")
    try:
        _refuse_xacro([Element("link", name=name), *([] if inertial is None else inertial.iter())], source)
        weighs = None if inertial is None else inertial.find("mass")
        if inertial is None or weighs is None:
            return Link(name)
        mass = float(_numbers(weighs.get("value", "0"), 1, f"link {name!r}, mass")[0])
        if mass < 0:
            raise UrdfError(f"link {name!r} has a mass of {mass:g} kg; it cannot be negative")
        return Link(name, mass, _placement(inertial.find("origin"), f"link {name!r}")[:3, 3])
    except UrdfError as fault:
        return Link(name, fault=str(fault))


def _joint(element: Element, source: str) -> Joint:
    name, kind = element.get("name", ""), element.get("type", "")
    where = f"joint {name!r}"
    ends = [end.get("link") if (end := element.find(side)) is not None else None for side in ("parent", "child")]
    if not ends[0] or not ends[1]:  # it may be of the arm: nothing tells where it stands
        why = f"{where} has no <{'child' if ends[0] else 'parent'} link=...>; add it"
        raise UrdfError(f"{source}: {_expand(source) if '${' in str(element.attrib) else why}")
    joint = Joint(
        name=name, type=kind, parent=ends[0], child=ends[1], origin=np.eye(4), axis=np.array([1.0, 0, 0]),
        lower=-np.inf, upper=np.inf,
    )  # fmt: skip
    try:
        _refuse_xacro([*element.iter()], source)
        if not name:
            raise UrdfError("a <joint> has no name; give it one")
        if kind not in (*_MOVING, "fixed"):
            raise UrdfError(f"{where} has type={kind!r}; revolute, continuous, prismatic or fixed is needed")
        joint = replace(joint, origin=_placement(element.find("origin"), where))
        if kind not in _KINDS:
            return joint

        # its axis, its limits, and the joint that it follows
        turns = element.find("axis")
        axis = joint.axis if turns is None else _numbers(turns.get("xyz", ""), 3, f"{where}, axis")
        length = float(np.linalg.norm(axis))
        if not length > 0:
            raise UrdfError(f"{where} has the axis 0 0 0; give the direction it turns about or slides along")
        scale, limit, sides = _MM if kind == "prismatic" else 1.0, element.find("limit"), [-np.inf, np.inf]
        if limit is not None and kind != "continuous":
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
        return replace(joint, axis=axis / length, lower=sides[0], upper=sides[1], mimic=mimic)
    except UrdfError as fault:
        return replace(joint, fault=str(fault))


def _refuse_xacro(elements: list[Element], source: str) -> None:
    """Raise `UrdfError` where numbers or names are yet to be put in, or a part is."""
    for one in elements:
        if one.tag.startswith("xacro:") or any("${" in word for word in one.attrib.values()):
            raise UrdfError(_expand(source))


def _placement(origin: Element | None, where: str) -> Array:
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


def with_origins(text: bytes, origins: Mapping[str, Array], comment: str) -> bytes:
    """Return the URDF `text` with new `origins`, joint -> (4, 4) [mm], and a `comment` at its beginning."""
    robot, places = _scan(text, "the URDF")
    joints = {joint.get("name", ""): joint for joint in robot.findall("joint")}
    lost = [name for name in origins if name not in joints]
    if lost:
        raise ValueError(f"joint {lost[0]} stands not in the text of the URDF")
    _, inside = places[robot]
    changes = [(inside, inside, f"\n  <!-- {comment.replace('--', '- -')} -->".encode())]
    for name, origin in origins.items():
        xyz, rpy = (  # with the digits of a nanometre and a nanoradian
            " ".join(f"{round(v, 9) + 0.0:.9f}".rstrip("0").rstrip(".") or "0" for v in values)
            for values in (origin[:3, 3] / _MM, rpy_of(origin))
        )
        written = f'xyz="{xyz}" rpy="{rpy}"'.encode()
        if (tag := joints[name].find("origin")) is not None:
            start, end = places[tag]
            other = re.sub(rb"""\s+(?:xyz|rpy|quat_xyzw|quat)\s*=\s*(?:"[^"]*"|'[^']*')""", b"", text[start:end])
            changes.append((start, end, other.replace(b"<origin", b"<origin " + written, 1)))
        else:
            _, inside = places[joints[name]]
            changes.append((inside, inside, b"\n    <origin " + written + b"/>"))
    for start, end, new in sorted(changes, reverse=True):
        text = text[:start] + new + text[end:]
    return text
