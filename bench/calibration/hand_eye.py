"""`bench calibrate hand_eye=...`: from its words to the frames of camera and board, and the files of these."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import BinaryIO, final

from calibench.bench.calibration.files import read_table
from calibench.bench.measured.files import pairs_of
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.sweep.words import RequestError, check_study, read_pairs
from calibench.calibration.hand_eye import HandEye, calibrate_hand_eye
from calibench.calibration.hand_eye_start import Flange, Mounting, Read, Setup
from calibench.core.options import coerce, read_option, suggest

ORDERS = ("rpy", "xyz", "vector")
POSES = ("flange", "board")
_KEYS = {
    "hand_eye": "eye_in_hand", "data": "pairs.csv", "read": "board_in_camera", "rotation": "vector",
    "columns": '{"flange_x":"Weg X"}', "units": "flange_x:m", 
    "flange": "base_in_flange", "board_scale": "0.97", "sigma": "0.3", "sigma_rotation": "0.001",
    "study": "hand_eye", "results": "results",
}  # fmt: skip


@final
@dataclass(frozen=True, kw_only=True)
class HandEyeRequest:
    """A hand-eye calibration from the file `data`; `columns` and `units` go before what the file states of itself."""

    data: str
    setup: Setup
    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    folder: Path = Path("results/hand_eye")

    def carry_out(self) -> HandEye:
        """Return the frames of camera and board. Raises `ValueError`, in one line."""
        table = read_table(self.data, {"units": self.units} if self.units else {})
        return calibrate_hand_eye(table, self.setup, self.columns)


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
    setup = Setup(
        hand_eye=coerce("hand_eye", given["hand_eye"], Mounting), read=coerce("read", given.get("read", ""), Read),
        rotation=_orders(given.get("rotation", "")), sigma=noise["sigma"], sigma_rotation=noise["sigma_rotation"],
        flange=coerce("flange", given.get("flange", "flange_in_base"), Flange), board_scale=scale,
    )  # fmt: skip
    columns, units = (pairs_of(key, given[key]) if key in given else {} for key in ("columns", "units"))
    folder = Path(given.get("results", "results")).expanduser() / study
    return HandEyeRequest(data=given["data"], setup=setup, columns=columns, units=units, folder=folder)


def _orders(word: str) -> dict[str, str]:
    """Return the order of angles of each pose: one word for both, or flange:vector,board:rpy."""
    if not word:
        return {}
    orders = pairs_of("rotation", word) if ":" in word else dict.fromkeys(POSES, word)
    for pose, order in orders.items():
        if pose not in POSES:
            raise RequestError(f"rotation={word}: {pose} is no pose; {suggest(pose, POSES)}")
        if order not in ORDERS:
            raise RequestError(f"rotation={word}: {suggest(order, ORDERS)}")
    return orders


def write_hand_eye(answer: HandEye, request: HandEyeRequest) -> HandEye:
    """Write the frames as JSON and as YAML for ROS into the folder of the case; return them with the files' names."""
    folder = request.folder / answer.case
    folder.mkdir(parents=True, exist_ok=True)
    files = {"ros": folder / "static_transforms.yaml", "json": folder / "hand_eye.json"}
    answer = replace(answer, files={kind: str(path) for kind, path in files.items()})
    texts = {"ros": transforms_yaml(answer), "json": json.dumps(answer.to_dict(), indent=1, allow_nan=False)}
    for kind, text in texts.items():
        write_whole(files[kind], partial(_put, text.encode()))
    return answer


def _put(content: bytes, file: BinaryIO) -> None:
    file.write(content)


def transforms_yaml(answer: HandEye) -> str:
    """Return both frames as YAML, in metres: translation, quaternion x y z w, and the command that publishes each."""
    lines = [
        f"# bench calibrate hand_eye={answer.hand_eye}, {answer.case}: {answer.pairs} pairs; metres",
        "transforms:",
    ]
    for frame in (answer.camera, answer.board):
        x, y, z = (f"{value / 1000 + 0.0:.7f}" for value in frame.position)
        qx, qy, qz, qw = (f"{value + 0.0:.8f}" for value in frame.quaternion)
        lines += [
            f"  - parent: {frame.parent}",
            f"    child: {frame.child}",
            f"    translation: {{x: {x}, y: {y}, z: {z}}}",
            f"    rotation: {{x: {qx}, y: {qy}, z: {qz}, w: {qw}}}",
            f"    command: ros2 run tf2_ros static_transform_publisher --x {x} --y {y} --z {z} --qx {qx} --qy {qy}"
            f" --qz {qz} --qw {qw} --frame-id {frame.parent} --child-frame-id {frame.child}",
        ]
    return "\n".join([*lines, ""])
