"""robotkinecal: screw axes by products of exponentials, of robots that Peter Corke's toolbox reads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import arms3
import numpy as np
from answering import answer


def _fitted(folder: str, name: str) -> Any:
    from robotkinecal import SerialRobotKineCal

    q, seen = arms3.read(folder, name)
    found = SerialRobotKineCal(_opened(f"{folder}/{name}.urdf"), f"l{q.shape[1] + 1}")
    found.set_observations(list(q), list(seen))
    found.solve()
    return lambda q: np.array([found.forward_kinematics(found.N_JOINTS + 1, row).t for row in q])


def _opened(path: str) -> Any:
    import roboticstoolbox

    return roboticstoolbox.ERobot.URDF(path)


def _arms(work: Mapping[str, Any]) -> dict[str, Any]:
    return arms3.measure(work["arms"], _fitted, _opened)


LINES = {"arms": {"robotkinecal": _arms}}

if __name__ == "__main__":
    answer(LINES)
