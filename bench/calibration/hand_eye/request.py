"""The request of `bench calibrate hand_eye=...`: where the camera is, a table of pairs of poses, statements on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, final

from calibench.bench.measured.files import pairs_of
from calibench.bench.sweep.words import RequestError, check_study, read_pairs
from calibench.core.options import coerce, read_option, suggest

Mounting = Literal["eye_in_hand", "eye_to_hand"]
Flange = Literal["flange_in_base", "base_in_flange"]
Read = Literal["", "board_in_camera", "camera_in_board"]
ORDERS = ("rpy", "xyz", "vector")
POSES = ("flange", "board")
_KEYS = {
    "hand_eye": "eye_in_hand", "data": "pairs.csv", "read": "board_in_camera", "rotation": "vector",
    "columns": '{"flange_x":"Weg X"}', "units": "flange_x:m", 
    "flange": "base_in_flange", "board_scale": "0.97", "sigma": "0.3", "sigma_rotation": "0.001",
    "study": "hand_eye", "results": "results",
}  # fmt: skip


@final
@dataclass(frozen=True)
class HandEyeRequest:
    """A calibration of a camera on the hand, or beside the robot; `stated` goes before the data's own metadata.

    `read` is what the camera's columns hold, "" where their names say it; `flange` what the robot's do. `board_scale`
    is how many times as far as the file says the board is. `rotation` is the order of angles of the
    poses of `flange` and `board`, where it is stated. `sigma` [mm] and `sigma_rotation` [rad] are the noise of the
    board's pose on each axis; 0 where it is to be learned from the data.
    """

    hand_eye: Mounting
    data: str
    read: Read = ""
    rotation: Mapping[str, str] = field(default_factory=dict)
    stated: Mapping[str, Any] = field(default_factory=dict)
    sigma: float = 0.0
    sigma_rotation: float = 0.0
    folder: Path = Path("results/hand_eye")
    flange: Flange = "flange_in_base"
    board_scale: float = 1.0


def read_hand_eye(words: Sequence[str]) -> HandEyeRequest:
    """Return the calibration that `words` ask for. Raises `RequestError` or `ValueError`."""
    given = read_pairs("calibrate", words, _KEYS)
    if not given.get("data"):
        raise RequestError("data= is missing: a file of poses of flange and board, such as data=pairs.csv")
    study = given.get("study", "hand_eye")
    check_study(study)
    noise = {key: read_option(key, given.get(key, "0"), float) for key in ("sigma", "sigma_rotation")}
    for key, unit in (("sigma", "mm"), ("sigma_rotation", "rad")):
        if key in given and not 0 < noise[key] < float("inf"):
            raise RequestError(f"{key}={given[key]}: the noise of the board's pose [{unit}], above 0, is needed")
    scale = read_option("board_scale", given.get("board_scale", "1"), float)
    if not 0 < scale < float("inf"):
        raise RequestError(
            f"board_scale={given['board_scale']}: the board's true size over that which the camera was told, above 0, "
            "is needed"
        )
    return HandEyeRequest(
        coerce("hand_eye", given["hand_eye"], Mounting),
        given["data"],
        coerce("read", given.get("read", ""), Read),
        _orders(given.get("rotation", "")),
        {key: pairs_of(key, given[key]) for key in ("columns", "units") if key in given},
        noise["sigma"],
        noise["sigma_rotation"],
        Path(given.get("results", "results")).expanduser() / study,
        coerce("flange", given.get("flange", "flange_in_base"), Flange),
        scale,
    )


def _orders(said: str) -> dict[str, str]:
    """Return the order of angles of each pose: one word for both, or flange:vector,board:rpy."""
    if not said:
        return {}
    found = pairs_of("rotation", said) if ":" in said else dict.fromkeys(POSES, said)
    for pose, order in found.items():
        if pose not in POSES:
            raise RequestError(f"rotation={said}: {pose} is no pose; {suggest(pose, POSES)}")
        if order not in ORDERS:
            raise RequestError(f"rotation={said}: {suggest(order, ORDERS)}")
    return found
