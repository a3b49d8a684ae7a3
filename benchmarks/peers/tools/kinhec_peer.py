"""kinhec: the sequences of its data set of cameras on hands, with their truth, and its reference solvers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pairs40
from answering import answer


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
    return pairs40.measured(solve, wild)


def _robust(flanges: Any, boards: Any) -> Any:
    from kinhec.solvers.robust import ransac_axxb

    return ransac_axxb(*_motions(flanges, boards), np.random.default_rng(0))[0]


_SOLVERS = {
    "kinhec, park_martin": _closed, "kinhec, park_martin and refine_lm": _refined, "kinhec, shah and lm": _shah,
    "kinhec, ransac_axxb": _robust,
}  # fmt: skip
_ON_SEQUENCES = (
    "park_martin", "daniilidis", "andreff_scale", "park_martin+lm", "ransac_park_martin", "shah", "shah+lm"
)  # fmt: skip


def _sequence(work: Mapping[str, Any]) -> dict[str, Any]:
    """Write one sequence of a tier as a user has it, and return what is true of it, and what the solvers are off by."""
    from kinhec import Sequence, generate_sequence
    from kinhec.benchmark import evaluate_sequence
    from kinhec.plans import build_plan, load_tier

    every = [config for track in build_plan(load_tier(work["tier"])).values() for config in track]
    made = generate_sequence(every[work["index"]])
    found, folder = Sequence(made.manifest, made.robot_table, made.camera_table), Path(work["folder"])
    offset = None if found.synchronous else found.time_offset
    flange, seen, valid = found.paired_measurements(offset)
    there = np.isfinite(found.camera.T_cam_target_meas).all(axis=(1, 2))
    for name, side, time, poses in (
        ("robot", "flange", found.robot.t, found.robot.T_base_ee_meas),
        ("camera", "board", found.camera.t[there], found.camera.T_cam_target_meas[there]),
    ):
        _write(folder / f"{name}.csv", ["time [s]", *_heads(side)], np.column_stack([time, _numbers(poses)]))
    both = np.column_stack([_numbers(flange[valid]), _numbers(seen[valid])])
    _write(folder / "pairs.csv", [*_heads("flange"), *_heads("board")], both)
    some = slice(None, None, max(1, int(valid.sum()) // 80))
    a, b = found.axyb_poses(time_offset=offset)
    np.savez(folder / "motions.npz", flange=a[some], seen=np.linalg.inv(b[some]))
    sync = "oracle" if found.synchronous else "estimated"
    rows = evaluate_sequence(found, list(_ON_SEQUENCES), sync=sync, rng=np.random.default_rng(work["index"]))
    told = ("sequence_id", "track", "level", "configuration")
    return {
        **{name: found.manifest[name] for name in told}, "synchronous": found.synchronous, "pairs": int(valid.sum()),
        "camera_on_hand": found.X.tolist(), "offset": found.time_offset, "scale": found.scale,
        "theirs": {row["solver"]: row.get("X_trans_err_mm") if row["ok"] else None for row in rows},
    }  # fmt: skip


def _heads(side: str) -> list[str]:
    return [*(f"{side}_{axis} [m]" for axis in "xyz"), *(f"{side}_q{axis}" for axis in "xyzw")]


def _numbers(poses: Any) -> Any:
    from scipy.spatial.transform import Rotation

    return np.column_stack([poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat()])


def _write(path: Path, heads: list[str], numbers: Any) -> None:
    np.savetxt(path, numbers, delimiter=",", header=",".join(heads), comments="", fmt="%.9g")


LINES = {
    table: {name: partial(_hand_eye, solve, wild) for name, solve in _SOLVERS.items()}
    for table, wild in (("hand_eye", False), ("hand_eye_wild", True))
} | {"sequences": {"kinhec": _sequence}}

if __name__ == "__main__":
    answer(LINES)
