"""The calibrated URDF: the user's own file, in which only the origins of some joints have new text.

Comments, meshes, order and spaces stay as they are. An XML parser gives the place of each origin, and only its two
attributes are written anew. A first comment says what was done.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, final
from xml.parsers import expat

import numpy as np

from calibench.problems.base import Array

_MM = 1e-3  # metres


def calibrated(text: bytes, origins: Mapping[str, Array], said: str) -> bytes:
    """Return the URDF `text` with new `origins`, joint -> (4, 4) [mm], and a comment that says `said`.

    Raises `ValueError` for a joint that stands nowhere below the robot.
    """
    places = _places(text)
    lost = [name for name in origins if name not in places]
    if lost:
        raise ValueError(f"joint {lost[0]} stands not in the text of the URDF")
    changes = []
    for name, origin in origins.items():
        place = places[name]
        written = _attributes(origin)
        if place.origin is None:
            changes.append((place.inside, place.inside, b"\n    <origin " + written + b"/>"))
        else:
            start, end = place.origin
            changes.append((start, end, _rewritten(text[start:end], written)))
    robot = places[""].inside
    comment = f"\n  <!-- {said.replace('--', '- -')} -->".encode()
    changes.append((robot, robot, comment))
    for start, end, new in sorted(changes, reverse=True):
        text = text[:start] + new + text[end:]
    return text


def rpy_of(turn: Array) -> tuple[float, float, float]:
    """Return roll, pitch and yaw [rad] of a rotation (3, 3) = Rz(yaw) Ry(pitch) Rx(roll)."""
    pitch = float(np.arctan2(-turn[2, 0], np.hypot(turn[0, 0], turn[1, 0])))
    if np.hypot(turn[0, 0], turn[1, 0]) < 1e-9:  # roll and yaw turn about one line: yaw is taken as 0
        return float(np.arctan2(-turn[1, 2], turn[1, 1])), pitch, 0.0
    return float(np.arctan2(turn[2, 1], turn[2, 2])), pitch, float(np.arctan2(turn[1, 0], turn[0, 0]))


@final
@dataclass
class _Place:
    """Bytes of a joint: where its content begins, and the tag of its origin."""

    inside: int
    origin: tuple[int, int] | None = None


@final
@dataclass
class _Reader:
    """State of the parser: the open elements, and the joints by name ("" is the robot itself)."""

    text: bytes
    parser: Any
    open: list[str] = field(default_factory=list)
    places: dict[str, _Place] = field(default_factory=dict)
    joint: str = ""

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        at = self.parser.CurrentByteIndex
        if self.open == [] and tag == "robot":
            self.places[""] = _Place(_end_of_tag(self.text, at))
        elif self.open == ["robot"] and tag == "joint":
            self.joint = attributes.get("name", "")
            self.places[self.joint] = _Place(_end_of_tag(self.text, at))
        elif self.open == ["robot", "joint"] and tag == "origin":
            self.places[self.joint].origin = (at, _end_of_tag(self.text, at))
        self.open.append(tag)

    def end(self, _: str) -> None:
        self.open.pop()


def _places(text: bytes) -> dict[str, _Place]:
    reader = _Reader(text, expat.ParserCreate())
    reader.parser.StartElementHandler = reader.start
    reader.parser.EndElementHandler = reader.end
    reader.parser.Parse(text, True)
    return reader.places


def _end_of_tag(text: bytes, start: int) -> int:
    """Return the place behind the tag that begins at `start`; a > between quotation marks is no end."""
    found = re.compile(rb"""(?:[^>"']|"[^"]*"|'[^']*')*>""").match(text, start)
    assert found is not None  # the parser has read it
    return found.end()


def _attributes(origin: Array) -> bytes:
    xyz = " ".join(_number(v * _MM) for v in origin[:3, 3])
    rpy = " ".join(_number(v) for v in rpy_of(origin[:3, :3]))
    return f'xyz="{xyz}" rpy="{rpy}"'.encode()


def _number(value: float) -> str:
    """Return a number with the digits of a nanometre and a nanoradian, and no more."""
    return f"{round(value, 9) + 0.0:.9f}".rstrip("0").rstrip(".") or "0"


def _rewritten(tag: bytes, written: bytes) -> bytes:
    """Return the tag of an origin with other numbers."""
    kept = re.sub(rb"""\s+(?:xyz|rpy|quat_xyzw|quat)\s*=\s*(?:"[^"]*"|'[^']*')""", b"", tag)
    return kept.replace(b"<origin", b"<origin " + written, 1)
