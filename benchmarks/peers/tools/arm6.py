"""An arm of six joints for those who calibrate arms: its URDF, and what a tracker saw of its tool in 300 poses.

The placement of each joint is off by errors that are drawn (half a millimetre, a milliradian); positions have no noise.
"""

from __future__ import annotations

import numpy as np

# a joint: where it stands in the frame of the one before (m), and the axis it turns about
JOINTS = (
    ((0, 0, 0.13), (0, 0, 1)), ((0, 0.18, 0), (0, 1, 0)), ((0, -0.14, 0.61), (0, 1, 0)),
    ((0, 0, 0.57), (0, 1, 0)), ((0, 0.12, 0), (0, 0, 1)), ((0, 0, 0.12), (0, 1, 0)),
)  # fmt: skip
TOOL = (0.05, 0.09, 0.1)


def urdf():
    """Return the nominal arm as URDF."""
    links = "".join(f'<link name="l{i}"/>' for i in range(8))
    joints = "".join(
        f'<joint name="j{i + 1}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="{" ".join(map(str, at))}" rpy="0 0 0"/><axis xyz="{" ".join(map(str, axis))}"/>'
        '<limit lower="-3" upper="3" effort="100" velocity="3"/></joint>'
        for i, (at, axis) in enumerate(JOINTS)
    )
    at = " ".join(map(str, TOOL))
    tool = f'<joint name="t" type="fixed"><parent link="l6"/><child link="l7"/><origin xyz="{at}"/></joint>'
    return f'<robot name="arm6">{links}{joints}{tool}</robot>'


def positions(errors, q):
    """Return where the tool stands, (n, 3) m, with placement errors (6, 6) [m, rad] at joint angles (n, 6)."""
    turn, at = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
    for i, (place, axis) in enumerate(JOINTS):
        at = at + turn @ (np.array(place) + errors[i, :3])
        for angle, about in zip(errors[i, 3:], np.eye(3), strict=True):
            turn = turn @ _turned(np.full(len(q), angle), about)
        turn = turn @ _turned(q[:, i], np.array(axis, float))
    return at + turn @ np.array(TOOL)


def _turned(angle, axis):
    c, s = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return c * np.eye(3) + s * cross + (1 - c) * np.outer(axis, axis)


def seen(poses=300):
    """Return joint angles (n, 6) and the positions that were measured (n, 3)."""
    rng = np.random.default_rng(20)
    errors = rng.normal(size=(6, 6)) * ([5e-4] * 3 + [1e-3] * 3)
    q = rng.uniform(-2, 2, (poses, 6))
    return q, positions(errors, q)
