"""Is the error that is told that of the file that is written, and is the file as good as its readings allow?

Forty arms of twenty makers, by published lengths; each with every placement off by a normal error, a base and a
target anywhere, and noisy positions read at random poses. The kinematics here is of this file alone. The written URDF
is judged on fresh poses, beside a fit of this file: the best by held-out error of {zeros, lengths too, angles too} x
{no prior, .1, .5, 2 mm}. Base and target are fitted to the poses that were read, for both.

    python -m benchmarks.arms.honest OUT.jsonl            # the fixed tenth, 360 fits; goes on where it was stopped
    python -m benchmarks.arms.honest OUT.jsonl --all      # 3600
    python -m benchmarks.arms.honest OUT.jsonl --ours 4405:4410   # the intervals alone, all 3600 cases of other seeds
    python -m benchmarks.arms.honest OUT.jsonl --table
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, final
from xml.etree import ElementTree

import numpy as np
import pandas as pd

from calibench.calibration.api import calibrate
from calibench.calibration.calibrate import Calibration
from calibench.core.process import one_thread
from calibench.problems.base import Array

SEEDS, POSES, SIZES = range(4400, 4405), (24, 60, 120), (0.1, 0.4, 1.5)  # of a placement [mm, mrad]; zeros 5 times
NOISE, FRESH = 0.03, 300  # mm a coordinate; poses that judge
PRIORS = (None, 2.0, 0.5, 0.1)
_NARROW = 0.4  # rad to either side, mm/250 of a joint that slides
_FOLDS, _STEPS, _RANK = 10, 5, 1e-7
_TARGET = np.array([60.0, 20.0, 110.0])
_ACROSS = np.array(
    [[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], dtype=float
)
# six: d1 a1 a2 a3 d4 d6 of an upright arm; cobot: d1 a2 a3 d4 d5 d6, standard table; seven: heights d1 d3 d5 d7 and
# sideways e; modified and standard: rows of a, alpha [deg], d; small: shoulder, x, upper arm, forearm, wrist
ROBOTS: dict[tuple[str, str], tuple[str, Any]] = {
    ("Universal Robots", "UR3"): ("cobot", (151.9, 243.65, 213.25, 112.35, 85.35, 81.9)),
    ("Universal Robots", "UR5"): ("cobot", (89.159, 425, 392.25, 109.15, 94.65, 82.3)),
    ("Universal Robots", "UR10"): ("cobot", (127.3, 612, 572.3, 163.941, 115.7, 92.2)),
    ("Universal Robots", "UR5e"): ("cobot", (162.5, 425, 392.2, 133.3, 99.7, 99.6)),
    ("Universal Robots", "UR16e"): ("cobot", (180.7, 478.4, 360, 174.15, 119.85, 116.55)),
    ("Techman", "TM5-900"): ("cobot", (145.2, 429, 411.5, 122.2, 106, 114.4)),
    ("Techman", "TM12"): ("cobot", (165.2, 636.1, 557.9, 156.3, 106, 113.15)),
    ("Aubo", "i5"): ("cobot", (98.5, 408, 376, 121.5, 102.5, 94)),
    ("Dobot", "CR5"): ("cobot", (147, 427, 357, 141, 116, 105)),
    ("KUKA", "KR 6 R900"): ("six", (400, 25, 455, 35, 420, 80)),
    ("KUKA", "KR 10 R1100"): ("six", (400, 25, 560, 35, 515, 90)),
    ("KUKA", "KR 5 arc"): ("six", (400, 180, 600, 120, 620, 115)),
    ("KUKA", "KR 16"): ("six", (675, 260, 680, -35, 670, 158)),
    ("KUKA", "KR 210 R2700"): ("six", (675, 350, 1150, -41, 1200, 240)),
    ("KUKA", "LBR iiwa 7"): ("seven", (340, 400, 400, 126, 0)),
    ("KUKA", "LBR iiwa 14"): ("seven", (360, 420, 400, 126, 0)),
    ("ABB", "IRB 120"): ("six", (290, 0, 270, 70, 302, 72)),
    ("ABB", "IRB 140"): ("six", (352, 70, 360, 0, 380, 65)),
    ("ABB", "IRB 1600"): ("six", (486.5, 150, 475, 0, 600, 65)),
    ("ABB", "IRB 2400"): ("six", (615, 100, 705, 135, 755, 85)),
    ("Fanuc", "LR Mate 200iD"): ("six", (330, 50, 330, 35, 335, 80)),
    ("Fanuc", "M-10iA"): ("six", (450, 150, 600, 200, 640, 100)),
    ("Fanuc", "M-20iA"): ("six", (525, 150, 790, 250, 835, 100)),
    ("Yaskawa", "GP7"): ("six", (330, 40, 445, 40, 440, 80)),
    ("Yaskawa", "GP12"): ("six", (450, 155, 614, 200, 640, 100)),
    ("Staubli", "TX90"): ("six", (478, 50, 425, 0, 425, 100)),
    ("Doosan", "M1013"): ("six", (152.5, 0, 620, 0, 559, 121)),
    ("Doosan", "M0609"): ("six", (135, 0, 411, 0, 368, 121)),
    ("Denso", "VS-068"): ("six", (395, 30, 340, -20, 340, 80)),
    ("Denso", "VP-6242"): ("six", (280, 0, 210, -75, 210, 70)),
    ("Mitsubishi", "RV-2F"): ("six", (295, 0, 230, 50, 270, 70)),
    ("Kinova", "Gen3"): ("seven", (284.8, 420.8, 314.3, 167.4, 12.0)),
    ("uFactory", "xArm7"): ("modified", (
        (0, 0, 267), (0, -90, 0), (0, 90, 293), (52.5, 90, 0), (77.5, 90, 342.5), (0, 90, 0), (76, -90, 97),
    )),
    ("uFactory", "Lite 6"): ("six", (243.3, 0, 200, 87, 227.6, 61.5)),
    ("Franka", "Panda"): ("modified", (
        (0, 0, 333), (0, -90, 0), (0, 90, 316), (82.5, 90, 0), (-82.5, -90, 384), (0, 90, 0), (88, 90, 107),
    )),
    ("Rethink", "Sawyer"): ("standard", (
        (81, -90, 317), (0, 90, 192.5), (0, -90, 400), (0, 90, -168.5), (0, -90, 400), (0, 90, 136.3), (0, 0, 133.75),
    )),
    ("Unimation", "Puma 560"): ("standard", (
        (0, 90, 671.8), (431.8, 0, 0), (20.3, -90, 150.05), (0, 90, 431.8), (0, -90, 0), (0, 0, 56.25),
    )),
    ("Trossen", "ViperX 300"): ("small", (127, 60, 300, 300, 65)),
    ("Trossen", "WidowX 250"): ("small", (110, 50, 250, 250, 65)),
    ("Epson", "LS6"): ("scara", (325, 275)),
}  # fmt: skip
_LIMITS = {
    "six": (2.8, 1.6, 1.9, 2.8, 2.0, 2.8), "cobot": (2.8,) * 6, "seven": (2.8, 1.9, 2.8, 1.9, 2.8, 1.9, 2.8),
    "modified": (2.7, 1.7, 2.7, 1.6, 2.7, 1.8, 2.7), "standard": (2.6, 1.9, 2.4, 2.6, 1.8, 2.6, 2.6),
    "small": (2.8, 1.6, 1.6, 1.8, 2.8), "scara": (2.2, 2.4, 100.0, 2.8),
}  # fmt: skip


@final
@dataclass(frozen=True, eq=False)
class Chain:
    """Origins (J, 4, 4) [mm], axes (J, 3), which joints slide, limits to either side, and the flange (4, 4)."""

    origins: Array
    axes: Array
    slides: Array
    limits: Array
    flange: Array


def across(v: Array) -> Array:
    """Return the matrices (..., 3, 3) whose product with w is v x w, of v (..., 3)."""
    return np.asarray(v @ _ACROSS).reshape(*v.shape, 3)


def about(turns: Array) -> Array:
    """Return rotations (..., 3, 3) of rotation vectors (..., 3)."""
    angle = np.sqrt((turns**2).sum(axis=-1))[..., None]
    K = across(turns / np.where(angle > 0, angle, 1.0))
    angle = angle[..., None]
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K))


def frame(place: Any, turns: Any = (0, 0, 0)) -> Array:
    """Return frames (..., 4, 4) at places [mm] (..., 3), turned by rotation vectors."""
    place = np.array(place, dtype=float)
    made = np.zeros((*place.shape[:-1], 4, 4))
    made[..., :3, :3], made[..., :3, 3], made[..., 3, 3] = about(np.array(turns, dtype=float)), place, 1.0
    return made


def chain_of(kind: str, numbers: Any) -> Chain:
    """Return the arm of one entry of `ROBOTS`."""
    z, y, x = (0, 0, 1), (0, 1, 0), (1, 0, 0)
    if kind in ("cobot", "standard", "modified"):
        rows = numbers
        if kind == "cobot":
            d1, a2, a3, d4, d5, d6 = numbers
            rows = ((0, 90, d1), (-a2, 0, 0), (-a3, 0, 0), (0, 90, d4), (0, -90, d5), (0, 0, d6))
        if kind == "modified":
            ways = [frame((a, 0, 0), (np.deg2rad(alpha), 0, 0)) @ frame((0, 0, d)) for a, alpha, d in rows]
            origins, flange = ways, np.eye(4)
        else:
            ways = [frame((a, 0, d), (np.deg2rad(alpha), 0, 0)) for a, alpha, d in rows]
            origins, flange = [np.eye(4), *ways[:-1]], ways[-1]
        axes = [z] * len(rows)
    else:
        end: tuple[float, float, float] = (0, 0, 0)
        if kind == "six":
            d1, a1, a2, a3, d4, d6 = numbers
            axes = [z, y, y, x, y, x]
            ways, end = [(0, 0, d1), (a1, 0, 0), (0, 0, a2), (0.3 * d4, 0, a3), (0.7 * d4, 0, 0), (0, 0, 0)], (d6, 0, 0)
        elif kind == "seven":
            d1, d3, d5, d7, e = numbers
            axes = [z, y, z, y, z, y, z]
            ways = [(0, 0, d1 / 2), (0, e, d1 / 2), (0, e, d3 / 2), (0, -e, d3 / 2), (0, e, d5 / 2), (0, 0, d5 / 2)]
            ways, end = [*ways, (0, e, d7 / 2)], (0, 0, d7 / 2)
        elif kind == "small":
            shoulder, forward, upper, fore, wrist = numbers
            axes, end = [z, y, y, y, x], (60, 0, 0)
            ways = [(0, 0, shoulder - 40), (0, 0, 40), (forward, 0, upper), (fore, 0, 0), (wrist, 0, 0)]
        else:
            axes, ways = [z, z, z, z], [(0, 0, 200), (numbers[0], 0, 0), (numbers[1], 0, 0), (0, 0, -50)]
        origins, flange = [frame(way) for way in ways], frame(end)
    slides = (kind == "scara") & (np.arange(len(axes)) == 2)
    return Chain(np.array(origins), np.array(axes, dtype=float), slides, np.array(_LIMITS[kind][: len(axes)]), flange)


def moved(chain: Chain, small: Array) -> Chain:
    """Return the arm with every placement off by six numbers (J, 7) [mm, rad], and every zero by the last."""
    zeros, slides = small[:, 6:] * chain.axes, chain.slides[:, None]
    off = frame(small[:, :3], small[:, 3:6]) @ frame(np.where(slides, zeros, 0.0), np.where(slides, 0.0, zeros))
    return Chain(chain.origins @ off, chain.axes, chain.slides, chain.limits, chain.flange)


def walk(chain: Chain, q: Array, tool: Array) -> tuple[Array, Array]:
    """Return the target (n, 3) [mm] in the base, and its slopes (n, 3, 7 J + 3) in placements, zeros and tool."""
    at, turn, steps = np.zeros((len(q), 3)), np.tile(np.eye(3), (len(q), 1, 1)), []
    for origin, axis, slide, angle in zip(chain.origins, chain.axes, chain.slides, q.T, strict=True):
        at, turn = at + turn @ origin[:3, 3], turn @ origin[:3, :3]
        steps.append((at, turn, turn @ axis, slide))
        if slide:
            at = at + angle[:, None] * (turn @ axis)
        else:
            turn = turn @ about(angle[:, None] * axis)
    at, turn = at + turn @ chain.flange[:3, 3], turn @ chain.flange[:3, :3]
    at = at + turn @ tool
    slopes = []
    for foot, way, along, slide in steps:
        lever = -across(at - foot)
        slopes += [way, lever @ way, along[:, :, None] if slide else lever @ along[:, :, None]]
    return at, np.concatenate([*slopes, turn], axis=2)


@final
@dataclass(frozen=True, eq=False)
class Found:
    """An arm with its frames: where the base stands (4, 4), and the target on the flange (3,), after steps `off`."""

    chain: Chain
    base: Array
    tool: Array
    off: Array

    def target(self, q: Array) -> tuple[Array, Array]:
        """Return the target (n, 3) in the tracker, and its slopes (n, 3, 6 + 7 J + 3)."""
        at, slopes = walk(self.chain, q, self.tool)
        away = at @ self.base[:3, :3].T
        body = np.concatenate([np.tile(np.eye(3), (len(q), 1, 1)), -across(away)], axis=2)
        return away + self.base[:3, 3], np.concatenate([body, self.base[:3, :3] @ slopes], axis=2)

    def stepped(self, step: Array) -> Found:
        """Return it after a step of all numbers, to first order the same step of `target`."""
        base = self.base.copy()
        base[:3, :3], base[:3, 3] = about(step[3:6]) @ base[:3, :3], base[:3, 3] + step[:3]
        return Found(moved(self.chain, step[6:-3].reshape(-1, 7)), base, self.tool + step[-3:], self.off + step)


def placed(chain: Chain, q: Array, seen: Array) -> Found:
    """Return the arm with the frames that fit what was seen."""
    nothing = np.zeros(9 + 7 * len(chain.axes))
    found = Found(chain, np.eye(4), _TARGET, nothing)
    for _ in range(3):
        at = walk(chain, q, found.tool)[0]
        u, _, v = np.linalg.svd((at - at.mean(axis=0)).T @ (seen - seen.mean(axis=0)))
        turn = v.T @ np.diag([1, 1, np.linalg.det(v.T @ u.T)]) @ u.T
        base = np.eye(4)
        base[:3, :3], base[:3, 3] = turn, seen.mean(axis=0) - turn @ at.mean(axis=0)
        found = fit(Found(chain, base, found.tool, nothing), q, seen, "frames", None, 4)
    return found


def columns(chain: Chain, level: str) -> Array:
    """Return which numbers a level frees, and the unit that they are compared in, as places and sizes."""
    joints = np.arange(7 * len(chain.axes)).reshape(-1, 7) + 6
    ways = {"frames": [], "zeros": [6], "lengths": [0, 1, 2, 6], "all": list(range(7))}[level]
    return np.concatenate([np.arange(6), joints[:, ways].ravel(), joints.size + 6 + np.arange(3)]).astype(int)


def solved(chain: Chain, J: Array, r: Array, free: Array, prior: float | None, off: Array) -> Array:
    """Return the step that takes residuals r (m,) away; `off` are all numbers so far, which a `prior` wants at 0."""
    size = np.full(9 + 7 * len(chain.axes), 1.0)
    size[3:6] = 1e-3
    of_joints = size[6:-3].reshape(-1, 7)
    of_joints[:, 3:6] = 1e-3
    of_joints[:, 6] = np.where(chain.slides, 1.0, 1e-3)
    A, wanted = J[:, free] * size[free], r
    if prior is not None:
        held = np.zeros(len(size), dtype=bool)
        held[6:-3].reshape(-1, 7)[:, :6] = True
        noise = np.sqrt(r @ r / max(len(r) - len(free), len(r) // 4))
        rows = np.diag(np.where(held[free], noise / prior, 1e-9))
        A, wanted = np.vstack([A, rows]), np.concatenate([wanted, -rows @ (off / size)[free]])
    step = np.zeros(len(size))
    step[free] = np.linalg.lstsq(A, wanted, rcond=_RANK if prior is None else 1e-12)[0] * size[free]
    return step


def fit(found: Found, q: Array, seen: Array, level: str, prior: float | None, steps: int = _STEPS) -> Found:
    """Return the arm after steps of Gauss and Newton."""
    free = columns(found.chain, level)
    for _ in range(steps):
        at, slopes = found.target(q)
        step = solved(found.chain, slopes.reshape(-1, slopes.shape[2]), (seen - at).ravel(), free, prior, found.off)
        found = found.stepped(step)
    return found


def best(nominal: Found, q: Array, seen: Array) -> tuple[Found, str]:
    """Return the fit that predicts poses left out best, and its name."""
    fold, tried = np.random.default_rng(0).permutation(len(q)) % _FOLDS, []
    for level, prior in product(("zeros", "lengths", "all"), PRIORS):
        left = 0.0
        found = fit(nominal, q, seen, level, prior)
        for k in range(_FOLDS):
            one = fit(found, q[fold != k], seen[fold != k], level, prior, 2)
            left += float(((one.target(q[fold == k])[0] - seen[fold == k]) ** 2).sum())
        tried.append((left, f"{level} {prior}", found))
    return min(tried, key=lambda one: one[0])[2], min(tried, key=lambda one: one[0])[1]


def urdf_of(chain: Chain) -> str:
    """Return the arm as a URDF; its joints are j1, j2, ..."""
    lines, above = ['<robot name="arm"><link name="base"/>'], "base"
    for k, (origin, axis) in enumerate(zip([*chain.origins, chain.flange], [*chain.axes, None]), start=1):
        R = origin[:3, :3]
        rpy = (
            np.arctan2(R[2, 1], R[2, 2]),
            np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])),
            np.arctan2(R[1, 0], R[0, 0]),
        )
        name, kind, more = "flange", "fixed", ""
        if axis is not None:
            slide, far = chain.slides[k - 1], chain.limits[k - 1]
            name, kind, far = f"j{k}", "prismatic" if slide else "revolute", far / 1000 if slide else far
            more = f'<axis xyz="{_text(axis)}"/><limit lower="{-far}" upper="{far}" effort="1" velocity="1"/>'
        at = f'<origin xyz="{_text(origin[:3, 3] / 1000)}" rpy="{_text(rpy)}"/>'
        lines.append(f'<link name="l{k}"/><joint name="{name}" type="{kind}">{at}{more}')
        lines.append(f'<parent link="{above}"/><child link="l{k}"/></joint>')
        above = f"l{k}"
    return "\n".join([*lines, "</robot>\n"])


def _text(values: Any) -> str:
    return " ".join(f"{value:.12g}" for value in values)


def read_back(path: Path, chain: Chain) -> Chain:
    """Return the arm of a written URDF, by its own numbers."""
    origins = []
    for joint in ElementTree.parse(path).getroot().findall("joint"):
        place = joint.find("origin")
        assert place is not None
        r, p, y = (float(v) for v in place.get("rpy", "0 0 0").split())
        turn = about(np.array([0, 0, y])) @ about(np.array([0, p, 0])) @ about(np.array([r, 0, 0]))
        origins.append(frame([1000 * float(v) for v in place.get("xyz", "0 0 0").split()]))
        origins[-1][:3, :3] = turn
    return Chain(np.array(origins[:-1]), chain.axes, chain.slides, chain.limits, origins[-1])


Case = tuple[int, int, int, str, float]


def cases(every: bool, seeds: range = SEEDS) -> list[Case]:
    """Return all cases in one order drawn beforehand, or the first tenth of them."""
    whole = list(product(range(len(ROBOTS)), seeds, POSES, ("wide", "narrow"), SIZES))
    order = np.random.default_rng(44).permutation(len(whole))
    return [whole[k] for k in (order if every else order[: len(whole) // 10])]


def readings_of(case: Case) -> tuple[Chain, Found, Array, Array, Array]:
    """Return an arm by its table and as it is, poses that are read and fresh ones, and what is read, (n, 3) [mm]."""
    robot, seed, n, width, size = case
    chain = chain_of(*list(ROBOTS.values())[robot])
    rng = np.random.default_rng([seed, robot, n, width == "wide", round(10 * size)])
    scale = size * np.array([1, 1, 1, 1e-3, 1e-3, 1e-3, 5e-3])
    small = rng.normal(size=(len(chain.axes), 7)) * scale
    small[chain.slides, 6] *= 1000 / 5
    base = frame(rng.uniform(-2000, 2000, 3), rng.normal(size=3))
    true = Found(moved(chain, small), base, _TARGET + rng.uniform(-20, 20, 3), np.zeros(0))
    reach = np.where(chain.slides, 250 * _NARROW, _NARROW) if width == "narrow" else chain.limits
    reach = np.minimum(reach, chain.limits)
    middle = rng.uniform(-1, 1, len(reach)) * (chain.limits - reach)
    q, fresh = (middle + reach * rng.uniform(-1, 1, (m, len(reach))) for m in (n, FRESH))
    return chain, true, q, fresh, true.target(q)[0] + rng.normal(0, NOISE, (n, 3))


def calibrated(chain: Chain, q: Array, seen: Array, folder: Path) -> Calibration:
    """Return what `bench calibrate` makes of the arm's URDF and the readings."""
    (folder / "arm.urdf").write_text(urdf_of(chain))
    table = {f"j{k + 1}": values for k, values in enumerate(q.T)} | dict(zip("xyz", seen.T, strict=True))
    units = dict.fromkeys("xyz", "mm") | {f"j{k + 1}": "mm" if s else "rad" for k, s in enumerate(chain.slides)}
    return calibrate(folder / "arm.urdf", table, units=units, resamples=20)


@one_thread()
def measure(case: Case, folder: Path, beside: bool = True) -> dict[str, Any]:
    """Return what one arm's calibration tells, and what is true of it, `beside` a fit of this file."""
    robot, seed, n, width, size = case
    maker, name = list(ROBOTS)[robot]
    chain, true, q, fresh, seen = readings_of(case)
    found: dict[str, Any] = {"maker": maker, "robot": name, "seed": seed, "poses": n, "width": width, "size": size}
    try:
        answer = calibrated(chain, q, seen, folder)
    except ValueError as error:
        return found | {"refused": str(error)}
    written = read_back(answer.write_urdf(folder / "out.urdf"), chain)

    def off(one: Chain) -> float:
        return float(np.sqrt(((placed(one, q, seen).target(fresh)[0] - true.target(fresh)[0]) ** 2).sum(axis=1).mean()))

    if beside:
        theirs, which = best(placed(chain, q, seen), q, seen)
        found |= {"theirs": off(theirs.chain), "which": which}
    return found | {
        "nominal": off(chain), "ours": off(written),
        "told": answer.after.rms, "low": answer.after.ci95[0], "high": answer.after.ci95[1], "chosen": answer.chosen,
        "tolerance": answer.tolerance, "wild": len(answer.wild), "seconds": answer.seconds,
    }  # fmt: skip


def table_of(lines: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the bars, and a row for each arm."""
    frame = pd.DataFrame(lines)
    refused = frame["refused"].notna().sum() if "refused" in frame else 0
    frame = frame[frame["ours"].notna()].copy()
    frame["ratio"] = frame["ours"] / frame.get("theirs", np.nan)
    frame["truth"] = np.sqrt(frame["ours"] ** 2 + 3 * NOISE**2)  # what is told is of readings, noise and all
    frame["covered"] = (frame["low"] <= frame["truth"]) & (frame["truth"] <= frame["high"])
    yield f"{len(frame)} fits, {refused} refused; largest ratio {frame['ratio'].max():.2f}"
    for by in (["poses"], ["width"], ["size"], ["poses", "width"], ["poses", "size"]):
        for key, own in [*frame.groupby(by)]:
            yield (
                f"{' '.join(by)} {' '.join(map(str, key))}: {len(own)} fits, {(own['ratio'] <= 1.25).sum()} with ratio "
                f"<= 1.25, largest {own['ratio'].max():.2f}; covered {own['covered'].mean():.1%}, truth below "
                f"{(own['truth'] < own['low']).mean():.1%}; told / true {(own['told'] / own['truth']).median():.3f}"
            )
    if frame["ratio"].isna().all():
        return
    yield "| arm | fits | nominal [mm] | independent [mm] | ours [mm] | largest ratio | covered |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    for (maker, robot), own in frame.groupby(["maker", "robot"]):
        middle = " | ".join(f"{own[one].median():.3f}" for one in ("nominal", "theirs", "ours"))
        yield f"| {maker} {robot} | {len(own)} | {middle} | {own['ratio'].max():.2f} | {own['covered'].sum()} |"


def main() -> None:
    """Measure what is not in the file yet, a line a case, and print the table."""
    parser = argparse.ArgumentParser(prog="benchmarks.arms.honest", description="Is what is told true?")
    parser.add_argument("out", type=Path, help="JSONL; what it holds is not measured again")
    parser.add_argument("--all", action="store_true", help="3600 fits instead of the fixed tenth")
    parser.add_argument("--ours", metavar="FIRST:END", help="our fits alone, all cases of these seeds")
    parser.add_argument("--table", action="store_true", help="measure nothing")
    chosen = parser.parse_args()
    seeds = range(*map(int, chosen.ours.split(":"))) if chosen.ours else SEEDS
    stated = {"seeds": list(seeds), "poses": POSES, "sizes": SIZES, "noise": NOISE, "robots": len(ROBOTS)}
    if not chosen.out.exists():
        chosen.out.write_text(json.dumps(stated) + "\n")
    lines = [json.loads(line) for line in chosen.out.read_text().splitlines()[1:]]
    there = {json.dumps(line["case"]) for line in lines}
    with TemporaryDirectory() as folder, chosen.out.open("a") as file:
        for case in [] if chosen.table else cases(chosen.all or bool(chosen.ours), seeds):
            if json.dumps(case) not in there:
                lines.append({"case": case, **measure(case, Path(folder), beside=not chosen.ours)})
                file.write(json.dumps(lines[-1]) + "\n")
                file.flush()
    print(*table_of(lines), sep="\n")


if __name__ == "__main__":
    main()
