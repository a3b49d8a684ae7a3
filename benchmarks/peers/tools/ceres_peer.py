"""Ceres by pyceres: a camera on a hand as least squares with two unknown poses, robust or not."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import pairs40
from answering import answer


def _solve(robust: bool, flanges: Any, boards: Any) -> Any:
    import pyceres

    def off(flange: Any, seen: Any, x: Any, y: Any) -> Any:
        there = np.linalg.solve(flange @ pairs40.pose(x[3:], x[:3]), pairs40.pose(y[3:], y[:3]))
        turn = there[:3, :3] @ seen[:3, :3].T
        vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
        return np.concatenate([vector / 0.00175, (there[:3, 3] - seen[:3, 3]) / 0.0003])

    class Pair(pyceres.CostFunction):
        def __init__(self, flange: Any, seen: Any) -> None:
            super().__init__()
            self.set_num_residuals(6)
            self.set_parameter_block_sizes([6, 6])
            self.off = partial(off, flange, seen)

        def Evaluate(self, poses: Any, residuals: Any, slopes: Any) -> bool:  # Ceres calls it so
            residuals[:] = at = self.off(*poses)
            for k in range(2) if slopes is not None else ():
                if slopes[k] is not None:
                    steps = [[pose + step * (k == j) for j, pose in enumerate(poses)] for step in 1e-6 * np.eye(6)]
                    slopes[k][:] = np.array([(self.off(*there) - at) / 1e-6 for there in steps]).T.ravel()
            return True

    first = flanges[0] @ boards[0]
    angle = np.arccos((np.trace(first[:3, :3]) - 1) / 2)
    axis = np.array([first[2, 1] - first[1, 2], first[0, 2] - first[2, 0], first[1, 0] - first[0, 1]])
    camera, board = np.zeros(6), np.concatenate([angle / (2 * np.sin(angle)) * axis, first[:3, 3]])
    problem = pyceres.Problem()
    for flange, seen in zip(flanges, boards, strict=True):
        problem.add_residual_block(
            Pair(flange, seen), pyceres.CauchyLoss(2.0) if robust else pyceres.TrivialLoss(), [camera, board]
        )
    pyceres.solve(pyceres.SolverOptions(), problem, pyceres.SolverSummary())
    return pairs40.pose(camera[3:], camera[:3])


def _hand_eye(robust: bool, wild: bool, work: Mapping[str, Any]) -> dict[str, Any]:
    return pairs40.measured(_solve, wild, robust)


LINES = {
    table: {"Ceres": partial(_hand_eye, False, wild), "Ceres, Cauchy": partial(_hand_eye, True, wild)}
    for table, wild in (("hand_eye", False), ("hand_eye_wild", True))
}

if __name__ == "__main__":
    answer(LINES)
