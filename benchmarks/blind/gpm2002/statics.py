"""Forces in the redundant machine at rest: three motors hold two degrees of freedom against a load.

Distal link i carries the axial force N_i (tension above 0) along u_i = (P - B_i) / lb_i, its motor the torque tau_i.
Power in equals power out, so with a_i = (B_i - A_i) x u_i and G = [u_i / a_i]: theta' = G^T P', G tau = -F,
N_i = -tau_i / a_i.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.blind.gpm2002.machine import DISTAL, Array, bases, elbows, inverse

Law = Callable[[Array], Array]  # forces, shape (n, 3) -> deflections, shape (n, 3)


@dataclass(frozen=True)
class Rest:
    """Where the machine came to rest: P (n, 2) [mm]; link and motor angles (n, 3) [rad]; torques and axial forces."""

    position: Array
    link_angles: Array
    motor_angles: Array
    torque: Array
    axial: Array
    distal: Array


def geometry(machine: Array, position: Array, theta: Array) -> tuple[Array, Array]:
    """Return G, shape (n, 2, 3) [1/mm], and the lever arms a, shape (n, 3) [mm]."""
    b = elbows(machine, theta)
    u = position[:, None, :] - b
    u = u / np.hypot(u[..., 0], u[..., 1])[..., None]
    proximal = b - bases(machine)
    arm = proximal[..., 0] * u[..., 1] - proximal[..., 1] * u[..., 0]
    return np.moveaxis(u / arm[..., None], 1, 2), arm


def shared_torques(g: Array, arm: Array, load: Array, preload: float) -> Array:
    """Return the torques, shape (n, 3), that the controller asks for: least norm, and an internal `preload` [N]."""
    gram = np.einsum("nik,njk->nij", g, g)
    least = -np.einsum("nik,ni->nk", g, _solve(gram, load))
    free = np.cross(g[:, 0], g[:, 1])
    tension = np.abs(free / arm).max(axis=1, keepdims=True)
    return least + preload * free / tension


def settle(
    machine: Array, position: Array, branch: Array, load: Array, preload: float, windup: Law | None, stretch: Law | None
) -> Rest:
    """Let the machine (n, 15), commanded to `position` (n, 2), come to rest under `load` (n, 2) [N].

    The controller shares the load (`shared_torques`) and so holds the inner force; what is left to positions are two
    degrees of freedom, and motors of equal stiffness settle where the squares of their three errors are least. Links
    stand at theta_m - windup(tau), distal links are longer by stretch(N). `ArithmeticError` if that has no end.
    """
    command = inverse(machine, position, branch)
    g, arm = geometry(machine, position, command)
    tau = shared_torques(g, arm, load, preload)
    length = machine[..., DISTAL] + np.zeros_like(command)
    if windup is None and stretch is None:
        return Rest(position, command, command, tau, -tau / arm, length)
    p, theta, deformed = position, command, np.broadcast_to(machine, (len(position), 15)).copy()
    for _ in range(60):
        if stretch is not None:
            deformed[:, DISTAL] = length + stretch(-tau / arm)
        theta = inverse(deformed, p, branch)
        g, arm = geometry(deformed, p, theta)
        tau = shared_torques(g, arm, load, preload)
        motors = theta if windup is None else theta + windup(tau)
        step = -_solve(np.einsum("nik,njk->nij", g, g), np.einsum("nik,nk->ni", g, motors - command))
        axial = -tau / arm
        moved = 0.0 if stretch is None else np.abs(length + stretch(axial) - deformed[:, DISTAL]).max()
        if max(np.abs(step).max(), moved) < 1e-10:
            return Rest(p, theta, motors, tau, axial, deformed[:, DISTAL])
        p = p + step
    raise ArithmeticError(f"the machine does not settle: it still moves by {np.abs(step).max():.1e} mm after 60 steps")


def _solve(matrices: Array, right: Array) -> Array:
    """Solve 2 by 2 systems, shapes (n, 2, 2) and (n, 2)."""
    (a, b), (c, d) = np.moveaxis(matrices, 0, -1)
    x, y = right.T
    return np.stack([d * x - b * y, a * y - c * x], axis=1) / (a * d - b * c)[:, None]
