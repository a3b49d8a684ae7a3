"""A six-axis arm and its readings, written by hand from the definition of a URDF: shares nothing with what it tests."""

from __future__ import annotations

from functools import cache

import numpy as np

PLACES = [(0, 0, 0.30), (0, 0.10, 0.10), (0, 0, 0.60), (0, 0, 0.50), (0.05, 0, 0.10), (0, 0, 0.12)]  # m
AXES = [(0, 0, 1), (0, 1, 0), (0, 1, 0), (0, 0, 1), (0, 1, 0), (0, 0, 1)]
_ONE = np.eye(3)
NAMES = tuple(f"joint_{k}" for k in range(1, 7))
TRUTH = {"z_joint_3": 0.8, "zero_joint_3": 0.0026, "rx_joint_5": 0.0012, "zero_joint_4": -0.0015}  # mm, rad
BASE = (np.array([800.0, -1900.0, 400.0]), 0.7)  # of the arm in the tracker: mm, and a turn about z
TARGET = np.array([60.0, 20.0, 110.0])


def urdf() -> str:
    lines = ['<?xml version="1.0"?>', '<robot name="by_hand">', "  <!-- as drawn -->", '  <link name="base"/>']
    above = "base"
    for k, (place, axis) in enumerate(zip(PLACES, AXES, strict=True), start=1):
        lines += [
            f'  <link name="link_{k}"/>',
            f'  <joint name="joint_{k}" type="revolute">',
            f'    <parent link="{above}"/> <child link="link_{k}"/>',
            f'    <origin   xyz="{" ".join(map(str, place))}"  rpy="0 0 0" />',
            f'    <axis xyz="{" ".join(map(str, axis))}"/> <limit lower="-2.6" upper="2.6" effort="1" velocity="1"/>',
            "  </joint>",
        ]
        above = f"link_{k}"
    tip = (
        '  <link name="ball"/><joint name="ball_joint" type="fixed"><parent link="link_6"/><child link="ball"/></joint>'
    )
    return "\n".join([*lines, tip, "</robot>", ""])


@cache
def _across(axis):
    """Return the matrix of the cross product with `axis`, and its square."""
    x, y, z = axis
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return across, across @ across


def about(axis, angle):
    """Return the turns about `axis` by angles of any shape."""
    across, twice = _across(tuple(axis))
    angle = np.asarray(angle)[..., None, None]
    return _ONE + np.sin(angle) * across + (1 - np.cos(angle)) * twice


_TILTS = [about((1, 0, 0), TRUTH.get(f"rx_{name}", 0.0)) for name in NAMES]


def placed(q, truth=TRUTH, base=BASE, target=TARGET):
    """Return where the target is, (..., 3) [mm], and how it is turned, (..., 3, 3), at joints q (..., 6) [rad]."""
    at, turn = np.array(base[0], dtype=float), about((0, 0, 1), base[1])
    q = np.asarray(q)
    for k, name in enumerate(NAMES):
        shift = 1000 * np.array(PLACES[k], dtype=float)
        shift += [truth.get(f"{axis}_{name}", 0.0) for axis in "xyz"]
        at = at + turn @ shift
        turn = turn @ about((1, 0, 0), truth.get(f"rx_{name}", 0.0))
        turn = turn @ about(AXES[k], q[..., k] + truth.get(f"zero_{name}", 0.0))
    return at + turn @ target, turn


def measured(n, noise=0.03, seed=5, truth=TRUTH, reach=2.4):
    """Return joints (n, 6) [rad], positions (n, 3) [mm] with noise, and rotations (n, 3, 3)."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-reach, reach, (n, 6))
    at, turn = placed(q, truth)
    return q, at + rng.normal(0, noise, (n, 3)), turn


def table(q, seen, heads=("x", "y", "z"), names=NAMES):
    rows = [",".join([*names, *heads])]
    rows += [",".join(f"{v:.7f}" for v in row) for row in np.column_stack([q, seen])]
    return "\n".join(rows) + "\n"


def _held(q, ball):
    """Return where the ball is, (3,) [mm], and how joints move it, (3, 6) [mm/rad], with the base as origin."""
    at, turn, feet, axes = np.zeros(3), np.eye(3), [], []
    for k, name in enumerate(NAMES):
        at = at + turn @ [1000 * v + TRUTH.get(f"{axis}_{name}", 0.0) for v, axis in zip(PLACES[k], "xyz", strict=True)]
        turn = turn @ _TILTS[k]
        feet, axes = [*feet, at], [*axes, turn @ AXES[k]]
        turn = turn @ about(AXES[k], q[k] + TRUTH.get(f"zero_{name}", 0.0))
    at = at + turn @ ball
    return at, np.cross(axes, at - np.array(feet)).T


def _reach(aim, q, ball):
    """Return joints (6,) [rad] near q that hold the ball at `aim` [mm], by Newton's steps; None where they are lost."""
    for _ in range(12):
        at, slopes = _held(q, ball)
        step = np.linalg.pinv(slopes) @ (aim - at)
        q = q + step
        if np.abs(step).max() < 1e-12:
            break
    return q if np.linalg.norm(_held(q, ball)[0] - aim) < 1e-6 and np.abs(q).max() < 2.6 else None


@cache
def _postures(places, postures, apart, noise, seed):
    """Return the joints, (places, 2, postures, 6) [rad], of a ball held in the two sockets of each place."""
    rng = np.random.default_rng(seed)
    ball = np.array([10.0, -15.0, 90.0])
    held = []
    for _ in range(places):
        bent = rng.uniform(-1.2, 1.2, 6)
        bent[2] = rng.uniform(0.8, 1.6)  # the elbow: what is about the point is in reach
        start = _held(bent, ball)[0]
        way = about((0, 0, 1), rng.uniform(0, 6)) @ [apart, 0, 0]
        for socket in (0, 1):
            point, found = start + socket * way, []
            while len(found) < postures:
                q = _reach(point + rng.normal(0, noise, 3), rng.uniform(-2.0, 2.0, 6), ball)
                if q is not None:
                    found.append(q)
            held.append(found)
    return np.reshape(held, (places, 2, postures, 6))


def in_sockets(folder, places=4, postures=16, apart=50.0, noise=0.02, seed=3):
    """Write a folder of places with two sockets, in whose points the ball is held in some postures."""
    for place, of_place in enumerate(_postures(places, postures, apart, noise, seed)):
        (folder / f"place_{place}").mkdir(parents=True)
        for socket, found in enumerate(of_place):
            np.savetxt(folder / f"place_{place}" / f"hole_{socket}.csv", found, delimiter=",")


def texts(answer):
    """Return the words of the notes in an answer of ``--json``."""
    return [note["text"] for note in answer["notes"]]
