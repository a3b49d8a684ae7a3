"""`bench calibrate hand_eye=...`: from its words to the frames of camera and board, and the files of these."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import final

from calibench.bench.calibration.files import read_table
from calibench.bench.calibration.request import statements_of
from calibench.bench.measured.files import pairs_of
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.verbs import HandEyeWords
from calibench.bench.words import RequestError, check_study, read
from calibench.calibration.hand_eye import HandEye, calibrate_hand_eye
from calibench.calibration.hand_eye_start import Setup
from calibench.core.options import suggest

ORDERS = ("rpy", "xyz", "vector")
POSES = ("flange", "board")


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
    given = read(HandEyeWords, "calibrate", words)
    check_study(given.study)
    word, orders = given.rotation, dict[str, str]()  # the order of angles of each pose: one word for both, or each
    if word:
        orders = pairs_of("rotation", word) if ":" in word else dict.fromkeys(POSES, word)
    for pose, order in orders.items():
        if pose not in POSES:
            raise RequestError(f"rotation={word}: {pose} is no pose; {suggest(pose, POSES)}")
        if order not in ORDERS:
            raise RequestError(f"rotation={word}: {suggest(order, ORDERS)}")
    setup = Setup(
        hand_eye=given.hand_eye, read=given.read or "", rotation=orders, sigma=given.sigma or 0.0,
        sigma_rotation=given.sigma_rotation or 0.0, flange=given.flange, board_scale=given.board_scale,
    )  # fmt: skip
    folder = Path(given.results).expanduser() / given.study
    return HandEyeRequest(data=given.data, setup=setup, folder=folder, **statements_of(given))


def write_hand_eye(answer: HandEye, request: HandEyeRequest) -> HandEye:
    """Write the frames as JSON and as YAML for ROS into the folder of the case; return them with the files' names."""
    folder = request.folder / answer.case
    folder.mkdir(parents=True, exist_ok=True)
    files = {"ros": folder / "static_transforms.yaml", "json": folder / "hand_eye.json"}
    answer = replace(answer, files={kind: str(path) for kind, path in files.items()})
    head = f"# bench calibrate hand_eye={answer.hand_eye}, {answer.case}: {answer.pairs} pairs; metres"
    lines = [head, "transforms:"]
    for frame in (answer.camera, answer.board):  # translation, quaternion, and the command that publishes each
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
    ros, text = "\n".join([*lines, ""]), json.dumps(answer.to_dict(), indent=1, allow_nan=False)
    write_whole(files["ros"], lambda file: file.write(ros.encode()))
    write_whole(files["json"], lambda file: file.write(text.encode()))
    return answer
