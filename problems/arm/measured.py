"""Measured postures of an arm from a CSV file: joints by the chain's names, places, rotations or sockets, and a split.

Columns are named as `columns` matches them. Units stand in brackets in the header (`elbow_joint [deg]`, `x [m]`);
without any, joints are rad (mm where they slide) and places mm, or m under FIGAROH's names (x1, phix1). What no arm can
have read is refused in one line. `shipped` names the tables that come with the package.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from calibench.core.tables.cells import factor_to_base, split_rows, valid_rows
from calibench.core.tables.csv_table import Table, read_table
from calibench.problems.arm.chains.chain import Chain, ChainError
from calibench.problems.arm.chains.kinematics import forward
from calibench.problems.arm.chains.rigid import Rotation, quaternion, turn
from calibench.problems.arm.columns import Matched, match_columns, unit_of
from calibench.problems.arm.frames import Frames, ball_in_sockets, frames_of_positions, tool_rotation
from calibench.problems.arm.stands import moved
from calibench.problems.base import Array

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
FEWEST = 10  # postures: 27 numbers of a six-axis arm from 30 residuals
_FOLDER = Path(__file__).resolve().parents[1] / "data" / "arms"
_BEYOND = 1e-2  # rad or mm, above a limit: controllers stop a little behind it
_APART = 0.1  # of the places' spread: what is left beyond it is of another arm
_X, _Y, _Z = np.eye(3)


@final
@dataclass(frozen=True, eq=False)
class Measured:
    """n postures: joints q (n, columns) [rad, mm] and what was read there; None for what was not.

    `place`, (n, 3) [mm]; `rotation`, (n, 3, 3); `socket`, (n,), counts the sockets of all places from 0, `site`, (n,),
    the places; `held`, (n,), marks rows that are kept back.
    """

    q: Array
    place: Array | None
    rotation: Array | None
    socket: Index | None
    site: Index | None
    held: Mask

    def where(self, keep: Mask) -> Measured:
        """Return the rows that `keep`, a mask, marks."""
        cut = {
            key: value[keep]
            for key in ("q", "place", "rotation", "socket", "site", "held")
            if (value := getattr(self, key)) is not None
        }
        return replace(self, **cut)


def shipped(name: str) -> Path:
    """Return the file of a table or URDF that comes with the package."""
    return _FOLDER / name


def read_measured(path: str | Path, chain: Chain, rotation: Rotation = "") -> Measured:
    """Return what a CSV file tells of `chain`. Raises `ValueError`, one line with the file's name."""
    try:
        table = read_table(path)
        matched = match_columns(table.names, chain.driven, "problem.", chain.told)
        return _measured(table, matched, chain, rotation)
    except (OSError, ValueError) as error:
        raise ValueError(f"data={Path(path).name}: {error}") from None


def found_frames(chain: Chain, measured: Measured) -> Chain:
    """Return the chain with base and tool where the nominal arm comes nearest to what was measured.

    Raises `ChainError` where no base and tool bring it there: other units, other signs, a mirror, another arm.
    """
    tip = forward(chain.placed(np.eye(4), np.eye(4)), {}, measured.q)
    if measured.place is None:
        assert measured.socket is not None
        ball = ball_in_sockets(tip, np.asarray(measured.socket))[0]
        tool = np.eye(4)
        tool[:3, 3] = ball
        return chain.placed(tool=tool)
    found = frames_of_positions(tip, measured.place)
    _check_frames(found, tip, measured.place)
    found = frames_of_positions(tip, measured.place, 1.0)
    far, said = moved(tip, measured.place, found)
    if said:
        raise ChainError(
            f"{far.sum()} of {len(far)} postures, from {np.argmax(far) + 1} on, fit the arm by themselves only: "
            f"{said}; take what was read from one stand"
        )
    tool = found.tool.copy()
    if measured.rotation is not None:
        tool[:3, :3] = tool_rotation(tip[found.near], found.base, measured.rotation[found.near])[0]
    return chain.placed(found.base, tool)


def _check_frames(found: Frames, tip: Array, place: Array) -> None:
    spread = found.reach
    if found.mirrored and frames_of_positions(tip, place * [1.0, 1.0, -1.0]).left < _APART * spread:
        raise ChainError("the measured frame is left-handed: change the sign of x, y or z, and the places fit")
    if found.left > _APART * spread:
        raise ChainError(
            f"no base and tool bring this arm to the places: {found.left:.3g} mm are left of {spread:.3g}; look at the "
            "order, signs and units of the joints, and whether joints and places of a row belong together"
        )
    for factor, unit, words in ((1e3, "m", "metres"), (25.4, "inch", "inches"), (10, "cm", "centimetres")):
        if 0.8 * factor < found.scale < 1.25 * factor:
            raise ChainError(f"the places look like {words}, and mm are needed; write x [{unit}] y [{unit}] z [{unit}]")
    if not 0.8 < found.scale < 1.25:
        raise ChainError(f"the places fit if they are {found.scale:.4g} times as large; state their unit, as x [m]")


def _measured(table: Table, matched: Matched, chain: Chain, rotation: Rotation) -> Measured:
    kinds = {name: _kind(chain, name) for name in chain.driven}
    q = np.column_stack([_column(table, matched.joints[n], kinds[n], kinds[n]) for n in chain.driven])
    length = "m" if matched.figaroh else "mm"
    place = turned = None
    if matched.position:
        place = np.column_stack([_column(table, matched.position[a], "mm", length) for a in "xyz"])
        turned = _rotation(table, matched, rotation)
    socket = site = None
    if "socket" in matched.other:
        sites = _words(table, matched.other["place"]) if "place" in matched.other else [""] * len(table.rows)
        both = list(zip(sites, _words(table, matched.other["socket"]), strict=True))
        if "" in {word for _, word in both}:
            raise ValueError(f"a cell of {matched.other['socket']} is empty; every posture stands in a socket")
        order, places = list(dict.fromkeys(both)), list(dict.fromkeys(sites))
        socket = np.array([order.index(one) for one in both], dtype=np.int64)
        site = np.array([places.index(one) for one in sites], dtype=np.int64)
    if place is None and socket is None:
        raise ValueError("no measured x, y, z was found, and no column socket; name the columns so")
    held = np.zeros(len(q), dtype=bool)
    if "split" in matched.other:
        held = np.asarray(split_rows(_words(table, matched.other["split"])) == "hold")
    read = Measured(q, place, None if turned is None else turned[:, :3, :3], socket, site, held)
    whole: Mask = np.asarray(np.isfinite(q).all(axis=1))
    for part in (read.place, None if read.rotation is None else read.rotation.reshape(len(q), -1)):
        if part is not None:
            whole = np.asarray(whole & np.isfinite(part).all(axis=1))
    if "valid" in matched.other:
        whole = whole & valid_rows(_words(table, matched.other["valid"]))
    read = read.where(whole)
    if (~read.held).sum() < FEWEST:
        raise ValueError(
            f"{(~read.held).sum()} postures are too few: {FEWEST} are the least, and some 40 that differ much in every "
            "joint are needed"
        )
    _check_joints(chain, read.q)
    return read


def _check_joints(chain: Chain, q: Array) -> None:
    """Raise `ValueError` for joints in degrees, and for joints beyond their limits."""
    rotary = [k for k, name in enumerate(chain.driven) if _kind(chain, name) == "rad"]
    largest = float(np.abs(q[:, rotary]).max(initial=0.0))
    if largest > 4 * np.pi:
        name = chain.driven[rotary[int(np.argmax(np.abs(q[:, rotary]).max(axis=0)))]]
        raise ValueError(f"{name} reaches {largest:.4g}: it looks like degrees, radians are needed; write {name} [deg]")
    limits = {j.name: (j.lower, j.upper) for j in chain.joints if j.mimic is None}
    for k, name in enumerate(chain.driven):
        low, high = limits.get(name, (-np.inf, np.inf))
        wrong = np.flatnonzero((q[:, k] < low - _BEYOND) | (q[:, k] > high + _BEYOND))
        if wrong.size:
            raise ValueError(
                f"{name} stands at {q[wrong[0], k]:.4g} in reading {wrong[0] + 1} ({wrong.size} such), and its limits "
                f"in the {chain.told} are {low:.4g} .. {high:.4g}; correct the limits, or look at its zero, sign and "
                "unit"
            )


def _kind(chain: Chain, driven: str) -> str:
    own = next(j for j in chain.joints if driven == (j.name if j.mimic is None else j.mimic.joint))
    return "rad" if own.kind == "rotary" else "mm"


def _rotation(table: Table, matched: Matched, rotation: Rotation) -> Array | None:
    if not matched.rotation:
        return None
    columns = matched.rotation
    if "qx" in columns:
        return quaternion(*(_column(table, columns[n], "1", "1") for n in ("qx", "qy", "qz", "qw")))
    a, b, c = (_column(table, columns[n], "rad", "rad") for n in ("rx", "ry", "rz"))
    if max(np.nanmax(np.abs(v), initial=0.0) for v in (a, b, c)) > 2 * np.pi:
        raise ValueError(f"{columns['rx']} and the like look like degrees, radians are needed; write rx [deg]")
    if rotation == "xyz":
        return np.asarray(turn(_X, a) @ turn(_Y, b) @ turn(_Z, c))
    return np.asarray(turn(_Z, c) @ turn(_Y, b) @ turn(_X, a))


def _column(table: Table, name: str, base: str, usual: str) -> Array:
    """Return a column in its base unit; an empty cell is NaN."""
    factor = factor_to_base(name, table.units.get(name) or unit_of(name) or usual, base)[1]
    at, comma = table.names.index(name), table.delimiter != ","
    found = np.empty(len(table.rows))
    for k, (line, cells) in enumerate(table.rows):
        word = cells[at].strip() if at < len(cells) else ""
        try:
            found[k] = float(word.replace(",", ".") if comma else word) if word else np.nan
        except ValueError:
            raise ValueError(f"row {line}: {name} is {word!r}, and a number is needed") from None
    return found * factor


def _words(table: Table, name: str) -> list[str]:
    at = table.names.index(name)
    return [cells[at].strip() if at < len(cells) else "" for _, cells in table.rows]
