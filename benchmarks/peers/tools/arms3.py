"""Three arms of makers for those who calibrate arms: files as a user has them, fresh poses that judge, odd files.

`benchmarks.peers.data` writes them: NAME.urdf, its joints [rad] and the tool's places [m] in NAME_seen.csv, and without
noise in NAME_fresh.csv. The base stands in the tracker's frame and the tool is known to a few millimetres.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

NAMES = ("UR5e", "Panda", "IRB 120")


def read(folder, name, what="seen"):
    """Return joints (n, j) and the tool's places (n, 3) [m] of a file."""
    rows = np.loadtxt(Path(folder) / f"{name}_{what}.csv", delimiter=",", skiprows=1)
    return rows[:, :-3], rows[:, -3:]


def positions(urdf, errors, q, tool):
    """Return where the tool stands, (n, 3) [m], with errors of placements (j, 6) and of the tool (3,) [m, rad]."""
    turn, at, k = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3)), 0
    for joint in ElementTree.parse(urdf).getroot().findall("joint"):
        place, angles = (np.array(joint.find("origin").get(word).split(), dtype=float) for word in ("xyz", "rpy"))
        at = at + turn @ place
        for angle, axis in zip(angles[::-1], np.eye(3)[::-1], strict=True):
            turn = turn @ _about(np.full(len(q), angle), axis)
        if joint.get("type") == "fixed":
            continue
        at = at + turn @ errors[k, :3]
        for angle, axis in zip(errors[k, 3:], np.eye(3), strict=True):
            turn = turn @ _about(np.full(len(q), angle), axis)
        turn = turn @ _about(q[:, k], np.array(joint.find("axis").get("xyz").split(), dtype=float))
        k += 1
    return at + turn @ tool


def _about(angle, axis):
    c, s = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return c * np.eye(3) + s * cross + (1 - c) * np.outer(axis, axis)


def measure(folder: Any, calibrate: Callable[[Any, str], Any], opened: Callable[[str], Any] | None) -> dict[str, Any]:
    """Return the time of calibrating all arms, with the true error of each, and which odd files `opened` refuses.

    `calibrate` is the user's code: it takes the folder and an arm's name, and returns where that arm has the tool at
    joints (n, j): (n, 3) [m].
    """
    from answering import timed  # beside this file, where a tool runs

    found: dict[str, Any] = {}

    def calibrated() -> int:
        for name in NAMES:
            try:
                found[name] = calibrate(folder, name)
            except Exception as error:
                found[name] = error
        return len(NAMES)

    taken, parts = timed(calibrated), []
    for name in NAMES:
        q, true = read(folder, name, "fresh")
        try:
            if isinstance(found[name], Exception):
                raise found[name]
            off = found[name](q) - true
            parts.append(f"{name} {1e3 * np.sqrt((off**2).sum(axis=1).mean()):.3f} mm")
        except Exception as error:
            parts.append(f"{name} fails ({' '.join(str(error).split())[:60] or type(error).__name__})")
    lines = len(inspect.getsource(calibrate).splitlines()) - 1
    text = f"true error {', '.join(parts)}; {lines} lines of the user's"
    if opened is None:
        return {**taken, "note": f"{text}; reads no URDF by itself"}
    odd, refused = sorted(Path(folder).glob("odd_*.urdf")), []
    for path in odd:
        try:
            opened(str(path))
        except BaseException:
            refused.append(path.stem.removeprefix("odd_"))
    ending = f"{len(refused)} of {len(odd)} odd files refused{': ' if refused else ''}{', '.join(refused)}"
    return {**taken, "note": f"{text}; {ending}"}
