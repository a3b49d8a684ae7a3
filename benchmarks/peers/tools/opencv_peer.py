"""OpenCV: its closed forms of a camera on a hand."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import pairs40
from answering import answer, timed


def _solve(method: str, flanges: Any, boards: Any) -> Any:
    import cv2

    turn, place = cv2.calibrateHandEye(
        list(flanges[:, :3, :3]), list(flanges[:, :3, 3]), list(boards[:, :3, :3]), list(boards[:, :3, 3]),
        method=getattr(cv2, f"CALIB_HAND_EYE_{method}"),
    )  # fmt: skip
    camera = np.eye(4)
    camera[:3, :3], camera[:3, 3] = turn, place.ravel()
    return camera


def _hand_eye(method: str, wild: bool, work: Mapping[str, Any]) -> dict[str, Any]:
    found, (flanges, boards) = [], pairs40.pairs(wild)

    def calibrated() -> int:
        found.append(_solve(method, flanges, boards))
        return 1

    return {**timed(calibrated), "note": pairs40.told(found[0], _solve)}


_METHODS = {"Tsai": "TSAI", "Park": "PARK", "Daniilidis": "DANIILIDIS"}
LINES = {
    table: {f"OpenCV, {name}": partial(_hand_eye, method, wild) for name, method in _METHODS.items()}
    for table, wild in (("hand_eye", False), ("hand_eye_wild", True))
}

if __name__ == "__main__":
    answer(LINES)
