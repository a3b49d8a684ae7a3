"""kinhec: the reference solvers of its data set of cameras on hands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import pairs40
from answering import answer, timed


def _motions(flanges: Any, boards: Any) -> Any:
    from itertools import combinations

    steps = list(combinations(range(len(flanges)), 2))
    a = np.array([np.linalg.inv(flanges[j]) @ flanges[i] for i, j in steps])
    b = np.array([boards[j] @ np.linalg.inv(boards[i]) for i, j in steps])
    return a, b


def _closed(flanges: Any, boards: Any) -> Any:
    from kinhec import solvers

    return solvers.park_martin(*_motions(flanges, boards))


def _shah(flanges: Any, boards: Any) -> Any:
    from kinhec import solvers

    seen = np.linalg.inv(boards)
    x, y = solvers.shah(flanges, seen)
    return solvers.refine_lm_axyb(flanges, seen, x, y)[0]


def _refined(flanges: Any, boards: Any) -> Any:
    from kinhec import solvers

    a, b = _motions(flanges, boards)
    return solvers.refine_lm(a, b, solvers.park_martin(a, b))


def _hand_eye(solve: Callable[[Any, Any], Any], wild: bool, work: Mapping[str, Any]) -> dict[str, Any]:
    found, (flanges, boards) = [], pairs40.pairs(wild)

    def calibrated() -> int:
        found.append(np.asarray(solve(flanges, boards)))
        return 1

    return {**timed(calibrated), "note": pairs40.told(found[0], solve)}


def _robust(flanges: Any, boards: Any) -> Any:
    from kinhec.solvers.robust import ransac_axxb

    return ransac_axxb(*_motions(flanges, boards), np.random.default_rng(0))[0]


_SOLVERS = {
    "kinhec, park_martin": _closed, "kinhec, park_martin and refine_lm": _refined, "kinhec, shah and lm": _shah,
    "kinhec, ransac_axxb": _robust,
}  # fmt: skip
LINES = {
    table: {name: partial(_hand_eye, solve, wild) for name, solve in _SOLVERS.items()}
    for table, wild in (("hand_eye", False), ("hand_eye_wild", True))
}

if __name__ == "__main__":
    answer(LINES)
