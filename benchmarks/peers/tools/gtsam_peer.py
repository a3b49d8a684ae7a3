"""GTSAM: a camera on a hand as a graph of factors with two unknown poses, robust or not."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import pairs40
from answering import answer, timed


def _solve(robust: bool, flanges: Any, boards: Any) -> Any:
    import gtsam

    def factor(flange: Any, seen: Any) -> Any:
        def error(_: Any, values: Any, slopes: Any) -> Any:
            camera, board = values.atPose3(0), values.atPose3(1)

            def off(x: Any, y: Any) -> Any:
                return gtsam.Pose3.Logmap(seen.inverse().compose(flange.compose(x).inverse().compose(y)))

            if slopes is not None:
                steps = [gtsam.Pose3.Expmap(step) for step in 1e-6 * np.eye(6)]
                at = off(camera, board)
                slopes[0] = np.array([(off(camera.compose(step), board) - at) / 1e-6 for step in steps]).T
                slopes[1] = np.array([(off(camera, board.compose(step)) - at) / 1e-6 for step in steps]).T
            return off(camera, board)

        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.00175] * 3 + [0.0003] * 3))
        if robust:
            noise = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(2.0), noise)
        return gtsam.CustomFactor(noise, [0, 1], error)

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for flange, seen in zip(flanges, boards, strict=True):
        graph.add(factor(gtsam.Pose3(flange), gtsam.Pose3(seen)))
    values.insert(0, gtsam.Pose3())
    values.insert(1, gtsam.Pose3(flanges[0] @ boards[0]))
    return gtsam.LevenbergMarquardtOptimizer(graph, values).optimize().atPose3(0).matrix()


def _hand_eye(robust: bool, wild: bool, work: Mapping[str, Any]) -> dict[str, Any]:
    found, (flanges, boards) = [], pairs40.pairs(wild)

    def calibrated() -> int:
        found.append(_solve(robust, flanges, boards))
        return 1

    return {**timed(calibrated), "note": pairs40.told(found[0], _solve)}


LINES = {
    table: {"GTSAM": partial(_hand_eye, False, wild), "GTSAM, Cauchy": partial(_hand_eye, True, wild)}
    for table, wild in (("hand_eye", False), ("hand_eye_wild", True))
}

if __name__ == "__main__":
    answer(LINES)
