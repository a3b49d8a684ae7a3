"""The parts of an answer: errors, changes of numbers, numbers that keep their values, and where the error is."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import isfinite, nan
from typing import final

import numpy as np

from calibench.calibration.arm import Arm, joint_before, targets_of
from calibench.calibration.determined import is_length, order_of
from calibench.calibration.fit import Fit
from calibench.calibration.kinematics import Chain
from calibench.calibration.leave_out import rms
from calibench.calibration.rigid import Array, Mask
from calibench.core.words import plain

SCHEMA_VERSION = 1


@final
@dataclass(frozen=True)
class Error:
    """The error of poses that were not fitted: rms with its 95 % interval, median and largest [mm]; rotation [rad].

    `spans` [mm] is the rms by which two sockets of a place that was not fitted are not at their stated distance.
    """

    level: str
    rms: float
    ci95: tuple[float, float]
    median: float
    largest: float
    rotation: float = nan
    spans: float = nan


@final
@dataclass(frozen=True)
class Change:
    """One number of the arm that the data determine: how far it is off its nominal value, sd and 95 % interval."""

    parameter: str
    joint: str
    what: str
    unit: str
    change: float
    sd: float
    ci95: tuple[float, float]


@final
@dataclass(frozen=True)
class Undetermined:
    """A number that keeps its nominal value: the numbers that act like it, or how uncertain it would be [mm, mrad]."""

    parameter: str
    reason: str
    like: tuple[str, ...] = ()
    known_to: float = nan

    @property
    def needs_poses(self) -> bool:
        """Return whether other poses would tell it: it acts like no other number, and moves what is read."""
        return isfinite(self.known_to)


@final
@dataclass(frozen=True)
class Part:
    """The error of a part of the poses, before and after [mm]: of a region, or of a range of one joint."""

    where: str
    poses: int
    before: float
    after: float


@final
@dataclass(frozen=True)
class OverJoint:
    """The error where a joint stands about `at`, between `low` and `high` [`unit`]: rms before and after [mm]."""

    joint: str
    unit: str
    at: float
    low: float
    high: float
    before: float
    after: float
    poses: int


@final
@dataclass(frozen=True)
class Wild:
    """A wild reading, which the fit did not use: where it stands in the file, and its error [mm]."""

    row: str
    error: float


@final
@dataclass(frozen=True, eq=False)
class Drawn:
    """What the drawings need: joints (n, j) [deg or mm], as `units` say, positions in the base (n, 3) [mm], errors.

    Errors before and after are (n,) [mm]; NaN where a reading is wild.
    """

    joints: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    position: Array
    before: Array
    after: Array


_WORDS = {
    "x": "shift along x", "y": "shift along y", "z": "shift along z", "rx": "turn about x", "ry": "turn about y",
    "rz": "turn about z", "zero": "zero", "gain": "scale of its reading",
    **{number: number for number in ("theta", "d", "a", "alpha", "beta")},
}  # fmt: skip
_SAME = 0.999  # of a column's square that others explain: they look alike
_STILL = 1e-9  # mm or rad: no pose tells a number of the target that moves by less from draw to draw
_TELLS = 0.05  # of a column, below which another's share in it is not told


def changes_of(fit: Fit, draws: Array) -> tuple[Change, ...]:
    """Return the changes of the kept parameters of the joints, with the interval that the `draws` (b, k) give."""
    changes = []
    for k, place in enumerate(fit.kept):
        name = fit.model.names[place]
        kind, _, joint = name.partition("_")
        if kind in ("base", "tool"):
            continue
        nominal = 1.0 if kind == "gain" else 0.0
        low, high = np.quantile(draws[:, k], [0.025, 0.975]) - nominal
        unit = "mm" if is_length(name, fit.model.sliding) else "" if kind == "gain" else "rad"
        sd = float(draws[:, k].std(ddof=1))
        changes.append(
            Change(
                parameter=name,
                joint=joint,
                what=_WORDS[kind],
                unit=unit,
                change=float(fit.p[place] - nominal),
                sd=sd,
                ci95=(float(low), float(high)),
            )
        )
    return tuple(changes)


def undetermined_of(fit: Fit, draws: Array) -> tuple[Undetermined, ...]:
    """Return the parameters of the joints that keep their nominal values, each with the reason."""
    names = fit.model.names
    kept = set(fit.kept.tolist())
    rest = [
        k
        for k in order_of(names, "geometry", fit.model.sliding)
        if k not in kept and not names[k].startswith(("base_", "tool_"))
    ]
    both = np.array([*fit.kept.tolist(), *rest], dtype=np.int64)
    rows = fit.model.jacobian(fit.p, both, fit.weights)[0].reshape(-1, len(both))
    ours, others = rows[:, : len(kept)], rows[:, len(kept) :]
    scale = np.linalg.norm(ours, axis=0) + 1e-12
    shares = np.linalg.lstsq(ours / scale, others, rcond=1e-10)[0]
    left = others - (ours / scale) @ shares
    undetermined = []
    for j, place in enumerate(rest):
        size = float(np.linalg.norm(others[:, j]))
        beyond = float(np.linalg.norm(left[:, j]))
        if size < 1e-9:
            undetermined.append(Undetermined(names[place], "moves no reading"))
        elif beyond**2 <= (1 - _SAME) * size**2:
            order = np.argsort(-np.abs(shares[:, j]))
            like = tuple(names[fit.kept[i]] for i in order[:3] if abs(shares[i, j]) > _TELLS * size)
            undetermined.append(Undetermined(names[place], f"looks like {' with '.join(like)}", like))
        else:
            unit = "mm" if is_length(names[place], fit.model.sliding) else "mrad"
            sd = max((1.0 if unit == "mm" else 1e3) / beyond, 0.01)
            reason = f"these poses would tell it to {plain(sd, 2)} {unit} only"
            undetermined.append(Undetermined(names[place], reason, known_to=sd))
    return tuple(undetermined)


def changes_of_tip(arm: Arm, fit: Fit, draws: Array) -> tuple[Change, ...]:
    """Return the shift and turn of the fixed joint before a stated tip, along and about the axes of its frame.

    Empty without one: the target is then somewhere on the last link, and the URDF has no place for it; nor has a table.
    """
    last = joint_before(arm.robot, arm.tip)
    if last is None:
        return ()
    tools = np.tile(fit.p[len(fit.p) - 6 :], (len(draws) + 1, 1))
    for k, place in enumerate(fit.kept):
        if place >= len(fit.p) - 6:
            tools[1:, place - len(fit.p) + 6] = draws[:, k]
    targets = targets_of(fit, tools)
    changes = []
    for k, kind in enumerate(("x", "y", "z", "rx", "ry", "rz")[: 3 if fit.model.turns is None else 6]):
        at, beside = float(targets[0, k]), targets[1:, k] - targets[0, k]
        if k >= 3:
            beside = (beside + np.pi) % (2 * np.pi) - np.pi
        sd = float(beside.std(ddof=1))
        if sd >= _STILL:
            low, high = at + np.quantile(beside, [0.025, 0.975])
            unit = "mm" if k < 3 else "rad"
            changes.append(
                Change(
                    parameter=f"{kind}_{last.name}",
                    joint=last.name,
                    what=_WORDS[kind],
                    unit=unit,
                    change=at,
                    sd=sd,
                    ci95=(float(low), float(high)),
                )
            )
    return tuple(changes)


_FEWEST = 5  # fewest poses of a part that is reported
_RANGES = 4
_DRAWN = 12  # ranges of a joint in a drawing


def by_region(drawn: Drawn) -> tuple[Part, ...]:
    """Return the error by distance from the base's axis and by height, thirds of the poses each."""
    out = np.hypot(drawn.position[:, 0], drawn.position[:, 1])
    up = drawn.position[:, 2]
    parts = []
    for far, high in np.ndindex(3, 3):
        there = _third(out, far) & _third(up, high)
        words = f"{_range(out, far)} mm out, {_range(up, high)} mm up"
        parts.append(_part(words, drawn, there))
    return tuple(part for part in parts if part.poses >= _FEWEST)


def drawn_of(joints: Array, chain: Chain, position: Array, before: Array, after: Array) -> Drawn:
    """Return what the drawings need of `joints`, (n, j) [rad or mm]: the angles in degrees."""
    kinds = {joint.name: joint.kind for joint in chain.joints}
    turns = np.array([kinds.get(name, "rotary") == "rotary" for name in chain.driven])
    units = tuple("°" if turn else "mm" for turn in turns)
    return Drawn(
        joints=np.where(turns, np.rad2deg(joints), joints), names=chain.driven, units=units, position=position,
        before=before, after=after,
    )  # fmt: skip


def by_joint(drawn: Drawn) -> tuple[Part, ...]:
    """Return the error by the range of each joint, four ranges of as many poses."""
    parts = []
    for k, name in enumerate(drawn.names):
        values = drawn.joints[:, k]
        edges = np.unique(np.quantile(values, np.linspace(0, 1, _RANGES + 1)))
        for low, high in pairwise(edges):
            there = (values >= low) & ((values < high) | (high == edges[-1]))
            parts.append(_part(f"{name} {low:.0f} to {high:.0f} {drawn.units[k]}", drawn, there))
    return tuple(part for part in parts if part.poses >= _FEWEST)


def over_joints(drawn: Drawn) -> tuple[OverJoint, ...]:
    """Return the error over the place of each joint, in ranges of as many poses: what is drawn of it."""
    known = np.isfinite(drawn.before) & np.isfinite(drawn.after)
    before, after = drawn.before[known], drawn.after[known]
    parts = []
    for name, unit, values in zip(drawn.names, drawn.units, drawn.joints[known].T):
        for part in np.array_split(np.argsort(values, kind="stable"), min(_DRAWN, max(1, len(values) // _FEWEST))):
            if len(part):
                places = values[part]
                place = (float(places.mean()), float(places.min()), float(places.max()))
                parts.append(OverJoint(name, unit, *place, rms(before[part]), rms(after[part]), len(part)))
    return tuple(parts)


def _part(words: str, drawn: Drawn, there: Mask) -> Part:
    known = there & np.isfinite(drawn.before) & np.isfinite(drawn.after)
    return Part(words, int(known.sum()), rms(drawn.before[known]), rms(drawn.after[known]))


def _third(values: Array, k: int) -> Mask:
    low, high = np.quantile(values, [k / 3, (k + 1) / 3])
    return np.asarray((values >= low) & ((values < high) | (k == 2)))


def _range(values: Array, k: int) -> str:
    low, high = np.quantile(values, [k / 3, (k + 1) / 3])
    return f"{low:.0f} to {high:.0f}"
