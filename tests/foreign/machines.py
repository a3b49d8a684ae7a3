"""Three machines of plain NumPy, a day of readings each: a planar manipulator, an arm of six axes, an alt-az mount.

Nothing imports the code under test. A machine has a `Day` of what was met, and says to first order what an error of an
encoder, or a displacement, does to what is left after calibration; `exact` readings are those of the whole kinematics.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
HOLD = 5  # every fifth pose is kept back


@dataclass(frozen=True)
class Day:
    """What was met, a row a reading: joint angles `q` (n, J), from where they came, speeds, torques, place, warmth."""

    pose: NDArray[np.int64]
    t: Array
    q: Array
    came: Array
    speed: Array
    torque: Array
    place: Array
    warmth: Array

    @property
    def run(self) -> Array:
        return np.asarray((self.t - self.t[0]) / np.ptp(self.t))

    @property
    def fitted(self) -> NDArray[np.bool_]:
        return np.asarray(self.pose % HOLD != 0)


@dataclass(frozen=True)
class Machine:
    """A built machine and its day; `angle` (n, c, J) and `push` (n, c, d) turn errors into whitened residuals.

    `taken` is an orthonormal basis of what calibration explains of the fitted readings; `table` makes the columns of a
    file from errors of encoders (n, J), displacements (n, d) and unit noise.
    """

    name: str
    day: Day
    angle: Array
    push: Array
    taken: Array
    stated: Mapping[str, Any]
    files: Mapping[str, str]
    joints: tuple[str, ...]
    table: Any
    draws: int  # numbers of noise that a row needs

    def left(self, angle: Array, push: Array) -> Array:
        """Return what calibration leaves of errors on the fitted readings, in sigma, (m,)."""
        off = np.einsum("ncj,nj->nc", self.angle, angle) + np.einsum("ncd,nd->nc", self.push, push)
        y = off[self.day.fitted].ravel()
        return np.asarray(y - self.taken @ (self.taken.T @ y))


def _basis(columns: Array, fitted: NDArray[np.bool_]) -> Array:
    K = columns[fitted].reshape(-1, columns.shape[-1])
    size = np.linalg.norm(K, axis=0)
    left, values, _ = np.linalg.svd(K / np.where(size > 0, size, 1.0), full_matrices=False)
    return np.asarray(left[:, values > 1e-7 * values[0]])


def _warmth(rng: np.random.Generator, run: Array) -> Array:
    rise = rng.uniform(2, 6) * (1 - np.exp(-rng.uniform(1, 4) * run))
    return np.asarray(rise + rng.uniform(0.3, 1.5) * np.sin(2 * np.pi * (rng.uniform(0.6, 2.5) * run + rng.random())))


# --- the planar manipulator (Cong et al. 2008): three legs of two links that meet in one point
_BASES = np.array([[0.0, 250.0], [433.0, 0.0], [433.0, 500.0]])
_HOME = np.array([216.5, 250.0])


def _legs(g: Array, at: Array, bases: Array) -> Array:
    """Return the angles of the driven links, (n, 3), of numbers g: bases (6), la (3), lb (3), zeros (3)."""
    out = []
    for i in range(3):
        d = at - g[2 * i : 2 * i + 2] - bases[:, 2 * i : 2 * i + 2]
        la, lb, far = g[6 + i], g[9 + i], np.hypot(d[:, 0], d[:, 1])
        elbow = np.arccos((la**2 + far**2 - lb**2) / (2 * la * far))
        out.append(np.arctan2(d[:, 1], d[:, 0]) + elbow - g[12 + i])
    return np.stack(out, axis=1)


def planar(rng: np.random.Generator, rows: int) -> Machine:
    """Return a planar manipulator; on a third of the days a tracker reads x, y."""
    tracked, sigma, sigma_xy = bool(rng.random() < 1 / 3), float(rng.choice([2e-5, 5e-5])), 0.02
    g = np.concatenate([
        (_BASES + rng.normal(0, 1.0, (3, 2))).ravel(), 244 + rng.normal(0, 1.0, 6), 1 + rng.normal(0, 0.02, 3),
    ])  # fmt: skip
    poses, none = max(rows // 2, 20), np.zeros((1, 6))
    radius, turn = rng.uniform(70, 110) * np.sqrt(rng.random(poses)), 2 * np.pi * rng.random(poses)
    own = _HOME + np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
    order = np.concatenate([rng.permutation(poses), rng.permutation(poses)])[:rows]  # each is visited twice
    at = own[order]
    n = len(at)
    theta = _legs(g, at, np.zeros((n, 6)))
    slope = np.stack([
        (_legs(g, at + step, none) - _legs(g, at - step, none)) / 2e-3 for step in 1e-3 * np.eye(2)
    ], axis=-1)  # fmt: skip
    way = np.diff(at, axis=0, prepend=_HOME[None])
    way /= np.linalg.norm(way, axis=1, keepdims=True) + 1e-9
    pace = rng.uniform(20, 140, n)
    moved = np.einsum("nij,nj->ni", slope, way * pace[:, None])
    force = rng.normal(0, 60, (n, 2))
    distal, lever = np.empty((n, 3, 2)), np.empty((n, 3))
    for i in range(3):
        beta = theta[:, i] + g[12 + i]
        elbow = g[2 * i : 2 * i + 2] + g[6 + i] * np.stack([np.cos(beta), np.sin(beta)], axis=1)
        distal[:, i] = (at - elbow) / g[9 + i]
        lever[:, i] = g[6 + i] * (-distal[:, i, 0] * np.sin(beta) + distal[:, i, 1] * np.cos(beta))
    inner = np.linalg.inv(np.einsum("nki,nkj->nij", distal, distal))
    axial = np.einsum("nki,nij,nj->nk", distal, inner, force)
    pause = rng.uniform(2, 6, n)
    t = np.cumsum(pause)
    run = (t - t[0]) / np.ptp(t)
    day = Day(order, t, theta, np.sign(moved), moved, axial * lever, at, _warmth(rng, run))

    def numbers(step: float, k: int) -> Array:
        ends = [_legs(g + s * step * (np.arange(15) == k), at, np.zeros((n, 6))) for s in (1, -1)]
        return (ends[0] - ends[1]) / (2 * step)

    own_columns = np.stack([numbers(1e-3 if k < 12 else 1e-6, k) for k in range(15)], axis=-1)
    bases = own_columns[:, :, :6]
    # one combination of the angles does not follow the place; with a tracker all do, under its noise
    if tracked:
        cover = sigma**2 * np.eye(3) + sigma_xy**2 * np.einsum("nij,nkj->nik", slope, slope)
        white = np.linalg.inv(np.linalg.cholesky(cover))
    else:
        white = np.linalg.svd(slope, full_matrices=True)[0][:, :, 2:].transpose(0, 2, 1) / sigma
    columns = np.einsum("nij,njk->nik", white, own_columns)
    taken = _basis(columns, day.fitted)
    second = np.array([np.sum(order[:k] == order[k]) for k in range(n)])

    def table(angle: Array, push: Array, noise: Array) -> dict[str, Any]:
        read = _legs(g, at, push) + angle + sigma * noise[:, :3]
        found: dict[str, Any] = {"t_s": t, "pose_id": order, "visit_id": second, "repeat": np.zeros(n, dtype=int)}
        found["split"] = np.where(day.fitted, "train", "hold")
        found |= {"load_x": force[:, 0], "load_y": force[:, 1], "temp_K": day.warmth, "speed": pace}
        found["heading"] = np.arctan2(way[:, 1], way[:, 0])
        for i in range(3):
            found |= {f"enc_{i + 1}": read[:, i], f"vel_{i + 1}": moved[:, i], f"dir_{i + 1}": day.came[:, i]}
            found |= {f"tau_{i + 1}": day.torque[:, i], f"axial_{i + 1}": axial[:, i]}
        if tracked:
            found |= {"x": at[:, 0] + sigma_xy * noise[:, 3], "y": at[:, 1] + sigma_xy * noise[:, 4]}
        return found

    stated: dict[str, Any] = {"sigma_enc": sigma, "tooth_numbers": rng.integers(30, 90, 3).tolist()}
    if tracked:
        stated["sigma_xy"] = sigma_xy
    return Machine("gpm2002", day, white, np.einsum("nij,njk->nik", white, bases), taken, stated, {},
                   ("joint 1", "joint 2", "joint 3"), table, 5)  # fmt: skip


# --- the arm of six axes, seen by a tracker
_XYZ = np.array([[0, 0, 145.0], [0, 135, 0], [-430, 0, -120], [-395, 0, 95], [0, -98, 0], [0, 90, 0.0]])
_ROLL = np.array([0, np.pi / 2, 0, 0, np.pi / 2, -np.pi / 2])
_LOW = np.array([-2.6, -2.4, 0.3, -2.4, -2.2, -2.8])
_HIGH = np.array([2.6, -0.5, 2.2, 0.7, 2.2, 2.8])
_MASS = np.array([3.7, 8.4, 2.3, 1.2, 1.2, 0.3])
_ARM = tuple("abcdef")


def _rot(axis: int, angle: Array) -> Array:
    c, s, one, zero = np.cos(angle), np.sin(angle), np.ones_like(angle), np.zeros_like(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.zeros((*np.shape(angle), 3, 3))
    R[..., axis, axis] = one
    R[..., i, i] = R[..., j, j] = c
    R[..., i, j], R[..., j, i] = -s, s
    return R + zero[..., None, None]


def _chain(p: Array, q: Array) -> tuple[Array, Array, Array]:
    """Return origins (n, 6, 3), axes (n, 6, 3) and the reflector (n, 3); p: off (6, 6), tool (3), foot (6)."""
    off, tool, foot = p[:36].reshape(6, 6), p[36:39], p[39:45]
    n = len(q)
    R = np.broadcast_to(_rot(2, foot[5]) @ _rot(1, foot[4]) @ _rot(0, foot[3]), (n, 3, 3))
    at = np.broadcast_to(foot[:3], (n, 3))
    origins, axes = [], []
    for k in range(6):
        at = at + R @ (_XYZ[k] + off[k, :3])
        R = R @ (_rot(0, np.array(_ROLL[k])) @ _rot(2, off[k, 5]) @ _rot(1, off[k, 4]) @ _rot(0, off[k, 3]))
        origins.append(at)
        axes.append(R[:, :, 2])
        R = R @ _rot(2, q[:, k])
    return np.stack(origins, axis=1), np.stack(axes, axis=1), at + R @ (np.array([0, 0, 25.0]) + tool)


def _urdf() -> str:
    lines = ['<robot name="own"><link name="l0"/>']
    for k, name in enumerate(_ARM):
        xyz = " ".join(f"{v / 1000:.9g}" for v in _XYZ[k])
        lines.append(
            f'<link name="l{k + 1}"><inertial><origin xyz="0 0 0.05" rpy="0 0 0"/><mass value="{_MASS[k]}"/>'
            '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{name}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
            f'<origin xyz="{xyz}" rpy="{_ROLL[k]:.15g} 0 0"/><axis xyz="0 0 1"/>'
            f'<limit lower="{_LOW[k]}" upper="{_HIGH[k]}" effort="99" velocity="2"/></joint>'
        )
    lines.append('<link name="tip"/><joint name="plate" type="fixed"><parent link="l6"/><child link="tip"/>')
    lines.append('<origin xyz="0 0 0.025" rpy="0 0 0"/></joint></robot>')
    return "\n".join(lines)


def arm(rng: np.random.Generator, rows: int) -> Machine:
    """Return an arm of six axes whose reflector a tracker sees; each pose is read twice in a row."""
    sigma, poses = float(rng.choice([0.02, 0.05])), max(rows // 2, 30)
    p = np.concatenate([np.hstack([rng.normal(0, 0.4, (6, 3)), rng.normal(0, 8e-4, (6, 3))]).ravel(),
                        rng.uniform(-90, 90, 3), rng.uniform(-2000, 2000, 3), 0.02 * rng.normal(size=2),
                        rng.uniform(-3, 3, 1)])  # fmt: skip
    own = rng.uniform(_LOW, _HIGH, (poses, 6))
    pose = np.repeat(np.arange(poses), 2)
    q, step = own[pose], np.diff(own, axis=0, prepend=np.zeros((1, 6)))[pose]
    n = len(q)
    origins, axes, at = _chain(p, q)
    centres = np.concatenate([(origins[:, :-1] + origins[:, 1:]) / 2, at[:, None]], axis=1)
    load = rng.choice([0.0, 2.0, 4.0], poses)[pose]
    torque = np.zeros((n, 6))
    for k in range(6):
        for b in range(k, 6):
            weight = _MASS[b] + (load if b == 5 else 0.0)
            pull = np.cross(centres[:, b] - origins[:, k], np.array([0, 0, -1.0]))
            torque[:, k] += 9.81e-3 * weight * np.einsum("ni,ni->n", pull, axes[:, k])
    t = np.cumsum(np.where(np.arange(n) % 2 == 0, rng.uniform(12, 30, n), 2.0))
    speed = np.sign(step) * rng.uniform(0.02, 0.3, (poses, 6))[pose]
    day = Day(pose, t, q, np.sign(step), speed, torque, at, _warmth(rng, (t - t[0]) / np.ptp(t)))
    # an encoder that reads too much: the arm stands short of what is read, and the model sees it further on
    angle = np.stack([np.cross(axes[:, k], at - origins[:, k]) for k in range(6)], axis=-1) / sigma
    columns = []
    for k in range(45):
        size = 1e-3 if (k < 36 and k % 6 < 3) or 36 <= k < 42 else 1e-6
        ends = [_chain(p + s * size * (np.arange(45) == k), q)[2] for s in (1, -1)]
        columns.append((ends[0] - ends[1]) / (2 * size) / sigma)
    taken = _basis(np.stack(columns, axis=-1), day.fitted)

    def table(err: Array, push: Array, noise: Array) -> dict[str, Any]:
        seen = _chain(p, q)[2] + push + sigma * noise[:, :3]
        found: dict[str, Any] = dict(zip(_ARM, (q + err).T)) | dict(zip("xyz", seen.T))
        found |= {"pose_id": pose, "t_s": t, "payload_kg": load, "temperature_C": 21 + day.warmth}
        found["split"] = np.where(day.fitted, "train", "hold")
        for k, name in enumerate(_ARM):
            found |= {f"direction_{name}": day.came[:, k], f"velocity_{name}": speed[:, k]}
        return found

    push = np.broadcast_to(np.eye(3) / sigma, (n, 3, 3))
    return Machine("arm", day, angle, push, taken, {"sigma_mm": sigma, "teeth": int(rng.integers(40, 120))},
                   {"arm.urdf": _urdf()}, _ARM, table, 3)  # fmt: skip


# --- the alt-az mount, seen by its stars
_ARCSEC = np.pi / 648000


def _tube(p: Array, one: Array, two: Array) -> Array:
    """Return where the tube points (south, east, up); p: index errors, collimation, square, two tilts of an axis."""
    n = len(one)
    v = np.tile(np.array([-np.cos(p[2]), np.sin(p[2]), 0.0]), (n, 1))  # reading zero: north, level
    lift = _rot(1, two + p[1])  # about the east: what looks north rises
    v = np.einsum("nij,nj->ni", lift, v)
    v = v @ _rot(0, np.array(p[3])).T
    v = np.einsum("nij,nj->ni", _rot(2, -(one + p[0])), v)
    return np.asarray(v @ (_rot(0, np.array(p[4])) @ _rot(1, np.array(p[5]))).T)


def mount(rng: np.random.Generator, rows: int) -> Machine:
    """Return an alt-az mount under the sky of one night; each star is seen once."""
    sigma, n = float(np.exp(rng.uniform(np.log(5), np.log(60)))), rows
    p = rng.normal(0, 1, 6) * np.array([3000, 2000, 300, 900, 400, 400]) * _ARCSEC
    one, two = rng.uniform(0, 2 * np.pi, n), np.arcsin(rng.uniform(np.sin(0.38), np.sin(1.45), n))
    t = np.cumsum(rng.uniform(20, 60, n))
    q = np.stack([one, two], axis=1)
    moved = np.diff(q, axis=0, prepend=q[:1] - 0.1)
    day = Day(np.arange(n), t, q, np.sign(moved), moved / 20, np.stack([0 * one, np.cos(two)], axis=1), q,
              -_warmth(rng, (t - t[0]) / np.ptp(t)))  # fmt: skip
    at = _tube(p, one, two)
    side = np.cross(at, np.array([0, 0, 1.0]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    frame = np.stack([side, np.cross(side, at)], axis=1)  # to the side, and up

    def slope(ends: list[Array], size: float) -> Array:
        return np.einsum("nci,ni->nc", frame, (ends[0] - ends[1]) / (2 * size)) / (sigma * _ARCSEC)

    angle = np.stack([
        slope([_tube(p, one + s * 1e-6 * (j == 0), two + s * 1e-6 * (j == 1)) for s in (1, -1)], 1e-6) for j in (0, 1)
    ], axis=-1)  # fmt: skip
    columns = np.stack([
        slope([_tube(p + s * 1e-6 * (np.arange(6) == k), one, two) for s in (1, -1)], 1e-6) for k in range(6)
    ], axis=-1)  # fmt: skip
    taken = _basis(columns, day.fitted)

    def table(err: Array, push: Array, noise: Array) -> dict[str, Any]:
        seen = at + np.einsum("nc,nci->ni", push + sigma * _ARCSEC * noise[:, :2], frame)
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        star = np.arctan2(seen[:, 1], -seen[:, 0]) % (2 * np.pi), np.arcsin(seen[:, 2])
        found: dict[str, Any] = {"az": one + err[:, 0], "el": two + err[:, 1], "star_az": star[0], "star_el": star[1]}
        return found | {"t_s": t, "temp_K": day.warmth, "split": np.where(day.fitted, "train", "hold")}

    push = np.broadcast_to(np.eye(2) / (sigma * _ARCSEC), (n, 2, 2))
    stated = {"mount": "altaz", "latitude_deg": float(rng.uniform(20, 60)), "sigma_arcsec": sigma}
    return Machine("mount", day, angle, push, taken, stated, {}, ("az", "el"), table, 2)


MACHINES = {"gpm2002": planar, "arm": arm, "mount": mount}
