"""OpenCV: its closed forms of a camera on a hand."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import pairs40
from answering import answer


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
    return pairs40.measured(_solve, wild, method)


def _sequence(work: Mapping[str, Any]) -> dict[str, Any]:
    """Return the frames (4, 4) [m] of what sits on the hand in a sequence, by each method."""
    poses = np.load(f"{work['folder']}/motions.npz")
    found = {}
    for name, method in _METHODS.items():
        made = _solve(method, poses["flange"], poses["seen"])
        found[f"OpenCV, {name}"] = made.tolist() if np.isfinite(made).all() else None
    return {"found": found}


_METHODS = {"Tsai": "TSAI", "Park": "PARK", "Daniilidis": "DANIILIDIS"}
LINES = {
    table: {f"OpenCV, {name}": partial(_hand_eye, method, wild) for name, method in _METHODS.items()}
    for table, wild in (("hand_eye", False), ("hand_eye_wild", True))
} | {"sequences": {"OpenCV": _sequence}}

if __name__ == "__main__":
    answer(LINES)
