"""Hand-eye calibration from beginning to end: read, start, fit, look at what is determined, hold out, write."""

from __future__ import annotations

import json
from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np

from calibench.bench.calibration.fit import Fit, norms
from calibench.bench.calibration.hand_eye.adjust import Adjusted, adjusted, frames_order, model_of_pairs, stands_of
from calibench.bench.calibration.hand_eye.frames import frames_of
from calibench.bench.calibration.hand_eye.pairs import Pairs, read_pairs_of_poses
from calibench.bench.calibration.hand_eye.request import HandEyeRequest
from calibench.bench.calibration.hand_eye.result import HandEye, Left, Outlier, transforms_yaml
from calibench.bench.calibration.hand_eye.scale import scale_of, scale_told
from calibench.bench.calibration.hand_eye.start import arm_poses, started
from calibench.bench.calibration.hand_eye.undetermined import check_determined, check_poses, missing_turns
from calibench.bench.calibration.judged import FOLDS, HeldOut, crossed_out, predicted, rms
from calibench.bench.calibration.model import ArmModel
from calibench.bench.calibration.readings import Mask, poses_of
from calibench.bench.store.atomic_file import write_whole
from calibench.core.process import one_thread
from calibench.core.words import counted
from calibench.discrepancy import DataError
from calibench.problems.base import Array

_LEAST = 5  # different poses: with fewer none can be left out
_FEW = 10  # poses: with fewer the noise is hardly known
_MANY = 0.1  # of the pairs: more outlying ones are no mishaps


@one_thread()
def hand_eye(request: HandEyeRequest) -> HandEye:
    """Return the frames of camera and board. Raises `ValueError`, in one line."""
    pairs = read_pairs_of_poses(request)
    try:
        return _calibrated(pairs, request)
    except ValueError as error:
        also = f" ({pairs.still})" if pairs.still else ""
        raise DataError(f"{pairs.table.name}: {error}{also}") from None


def _calibrated(pairs: Pairs, request: HandEyeRequest) -> HandEye:
    train = np.ones(len(pairs), dtype=bool) if pairs.hold is None else ~pairs.hold
    named = pairs.moved(next(iter(pairs.flange.meanings)))  # one axis is one in any order of angles
    check_poses(named[train], stands_of(named[train]), bool(request.sigma and request.sigma_rotation))
    begin = started(pairs, request.hand_eye, train)
    model = model_of_pairs(begin.arm, begin.seen, begin.mount, begin.tool)
    found = adjusted(model.at(train), (request.sigma, request.sigma_rotation))
    check_determined(found)
    whole = replace(found.fit.model, joints=model.joints, position=model.position, turns=model.turns,
                    socket=model.socket, place=model.place)  # fmt: skip
    fit, poses = found.fit, len(np.unique(poses_of(found.fit.model.joints)))
    unseen, how = _unseen(fit, whole, train, poses)
    camera, board = frames_of(found, request.hand_eye)
    used = np.flatnonzero(train)
    left, turned = _sizes(fit, fit.model)
    outliers = tuple(
        Outlier(pairs.told(int(used[i])), float(left[i]), float(turned[i]))
        for i in sorted(np.flatnonzero(fit.wild), key=lambda i: -left[i])
    )
    kept = ~fit.wild
    scale = scale_of(found, not request.sigma)
    said = [scale_told(scale, request.board_scale)] if scale and scale.told else []
    said += missing_turns(arm_poses(begin.arm, request.hand_eye)[train][kept])
    return HandEye(
        pairs.table.name, request.hand_eye, pairs.read, len(pairs), camera, board,
        Left(int(kept.sum()), rms(left[kept]), rms(turned[kept])), unseen, how, *found.sigma,
        (not request.sigma, not request.sigma_rotation),
        scale.value if scale else nan, scale.se if scale else nan, outliers,
        (*said, *pairs.notes, *begin.notes, *_notes(found, poses)),
    )  # fmt: skip


def _unseen(fit: Fit, whole: ArmModel, train: Mask, poses: int) -> tuple[Left, str]:
    """Return what is left of pairs that were not fitted, and in words how."""
    if not train.all():
        return _left_of(predicted(fit, whole, ~train), ~train), f"{int((~train).sum())} rows that the file holds back"
    if poses < _LEAST:
        return Left(0), f"unknown: {_LEAST} different poses are needed to leave one out"
    how = f"every {'fifth' if poses > FOLDS else 'one'} of {poses} different poses left out in turn"
    return _left_of(crossed_out(fit, frames_order(whole)), ~fit.wild), how


def _left_of(found: HeldOut, known: Mask) -> Left:
    assert found.turned is not None
    return Left(int(known.sum()), rms(found.left[known]), rms(found.turned[known]))


def _sizes(fit: Fit, model: ArmModel) -> tuple[Array, Array]:
    left, turned = model.errors(fit.p)
    assert turned is not None
    return norms((left, None)), np.linalg.norm(turned, axis=1)


def _notes(found: Adjusted, poses: int) -> list[str]:
    said, wild = [], found.fit.wild
    if wild.mean() > _MANY:
        said.append(
            f"{int(wild.sum())} of {len(wild)} pairs are outlying, and that many have a cause: a board that moved, or "
            "poses that were read before the robot stood still"
        )
    if poses < _FEW:
        said.append(f"{counted(poses, 'different pose')} are few, and wide intervals say so: 15 or more are usual")
    return said


def write_hand_eye(found: HandEye, request: HandEyeRequest) -> HandEye:
    """Write the frames as JSON and as YAML for ROS into the folder of the case; return them with the files' names."""
    folder = request.folder / found.case
    folder.mkdir(parents=True, exist_ok=True)
    files = {"ros": folder / "static_transforms.yaml", "json": folder / "hand_eye.json"}
    found = replace(found, files={kind: str(path) for kind, path in files.items()})
    _put(files["ros"], transforms_yaml(found))
    _put(files["json"], json.dumps(found.to_dict(), indent=1, allow_nan=False))
    return found


def _put(path: Path, text: str) -> Path:
    return write_whole(path, lambda file: file.write(text.encode()))
