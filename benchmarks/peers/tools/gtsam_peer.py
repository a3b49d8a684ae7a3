"""GTSAM: a camera on a hand as a graph of factors with two unknown poses, robust or not; an arm as one factor."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import arms3
import numpy as np
import pairs40
from answering import answer


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
    return pairs40.measured(_solve, wild, robust)


def _fitted(folder: str, name: str) -> Any:
    import gtsam

    (q, seen), urdf = arms3.read(folder, name), f"{folder}/{name}.urdf"
    size = 6 * q.shape[1] + 3  # placements, and the tool that is off by millimetres

    def off(x: Any) -> Any:
        return (_placed(urdf, x, q) - seen).ravel() / 3e-5

    def error(_: Any, values: Any, slopes: Any) -> Any:
        x = values.atVector(0)
        if slopes is not None:
            slopes[0] = np.array([(off(x + step) - off(x - step)) / 2e-6 for step in 1e-6 * np.eye(size)]).T
        return off(x)

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(seen.size), [0], error))
    sigmas = np.array([*[1e-3, 1e-3, 1e-3, 5e-3, 5e-3, 5e-3] * q.shape[1], 0.01, 0.01, 0.01])
    graph.add(gtsam.PriorFactorVector(0, np.zeros(size), gtsam.noiseModel.Diagonal.Sigmas(sigmas)))
    values.insert(0, np.zeros(size))
    x = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize().atVector(0)
    return lambda q: _placed(urdf, x, q)


def _placed(urdf: str, x: Any, q: Any) -> Any:
    return arms3.positions(urdf, x[:-3].reshape(-1, 6), q, x[-3:])


def _arms(work: Mapping[str, Any]) -> dict[str, Any]:
    return arms3.measure(work["arms"], _fitted, None)


LINES = {
    table: {"GTSAM": partial(_hand_eye, False, wild), "GTSAM, Cauchy": partial(_hand_eye, True, wild)}
    for table, wild in (("hand_eye", False), ("hand_eye_wild", True))
} | {"arms": {"GTSAM, prior of 1 mm": _arms}}

if __name__ == "__main__":
    answer(LINES)
