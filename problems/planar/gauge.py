"""The gauge of the GPM2002: the moves of the whole machine that angle readings cannot see.

Turn the whole machine by phi about A_1, scale it by s, and add phi to the three sensor offsets: every reading stays as
it was. Fixing three base coordinates leaves one such curve through every machine: with x_a2 (section 4) or y_a2
(section 3 of Cong et al. 2008) held, s follows from phi. So "12 parameters" are 11 and a free choice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from calibench.problems.base import Array


@dataclass(frozen=True, slots=True)
class Gauge:
    """The one-parameter family that keeps x_a1, y_a1 and the `held` coordinate of A_2."""

    held: Literal["xa2", "ya2"]

    def scale(self, machine: Array, phi: float) -> float:
        """Return s(phi) for the 15-vector `machine`: that which keeps the held coordinate."""
        dx, dy = machine[2] - machine[0], machine[3] - machine[1]
        if self.held == "xa2":
            return float(dx / (dx * np.cos(phi) - dy * np.sin(phi)))
        return float(dy / (dy * np.cos(phi) + dx * np.sin(phi)))

    def move(self, machine: Array, phi: float) -> Array:
        """Return the machine, shape (15,), that has the same readings and offsets larger by `phi` [rad]."""
        s, c, d = self.scale(machine, phi), np.cos(phi), np.sin(phi)
        moved = machine.copy()
        for base in (0, 2, 4):
            dx, dy = machine[base] - machine[0], machine[base + 1] - machine[1]
            moved[base] = machine[0] + s * (c * dx - d * dy)
            moved[base + 1] = machine[1] + s * (d * dx + c * dy)
        moved[6:12] *= s
        moved[12:15] += phi
        return moved

    def align(self, machine: Array, positions: Array, true_positions: Array) -> tuple[float, Array]:
        """Return (phi, aligned machine): where on its curve `machine` brings its end-effectors nearest to the truth.

        The scale s is positive. `positions` and `true_positions` have shape (n, 2). phi is the gauge angle of `machine`
        seen from the truth.
        With u = tan(turn), the held coordinate gives s cos(turn) = h / (h - k u), so that the sum of squares over the
        positions is a ratio of polynomials in u whose derivative has one root: no search is needed.
        """
        anchor = machine[:2]
        h, k = machine[2] - machine[0], machine[3] - machine[1]
        if self.held == "ya2":
            h, k = k, -h
        arm, wanted = positions - anchor, true_positions - anchor
        size = np.sum(arm * arm)
        along, across = np.sum(arm * wanted), np.sum(arm[:, 0] * wanted[:, 1] - arm[:, 1] * wanted[:, 0])
        lever = h * across + k * along
        up, down = h * (lever - k * size), h * h * size + k * lever
        turn = float(np.arctan2(up, down))
        return -turn, self.move(machine, turn)
