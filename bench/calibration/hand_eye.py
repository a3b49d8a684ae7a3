"""`bench calibrate hand_eye=...`: from its words to the frames of camera and board, and the files of these."""

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from typing import Any, final

import numpy as np

from calibench.bench.calibration.files import read_table
from calibench.bench.calibration.request import statements_of
from calibench.bench.calibration.samples import read_samples
from calibench.bench.calibration.words import transforms_text
from calibench.bench.measured.files import pairs_of
from calibench.bench.provenance.environment import made_by
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.verbs import HandEyeWords
from calibench.bench.words import RequestError, check_study, read
from calibench.calibration.hand_eye import HandEye, calibrate_hand_eye
from calibench.calibration.hand_eye_start import Setup, is_time
from calibench.calibration.readings import Table
from calibench.core.notes import DataError, once
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
    command: str = ""

    def carry_out(self) -> HandEye:
        """Return the frames of camera and board. Raises `ValueError`, in one line."""
        table = read_poses(self.data, self.units)
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
        sigma_rotation=given.sigma_rotation or 0.0, flange=given.flange,
        board_scale=1.0 if given.board_scale == "free" else _scale_of(given.board_scale),
        free_scale=given.board_scale == "free",
    )  # fmt: skip
    folder = Path(given.results).expanduser() / given.study
    command = shlex.join(["bench", "calibrate", *words])
    return HandEyeRequest(data=given.data, setup=setup, folder=folder, command=command, **statements_of(given))


def _scale_of(word: str) -> float:
    try:
        scale = float(word)
    except ValueError:
        scale = 0.0
    if not 0 < scale < inf:
        raise RequestError(
            f"board_scale={word}: the board's true size over that which the camera was told, or free, is needed"
        )
    return scale


def read_poses(named: str, units: Mapping[str, str]) -> Table:
    """Return the table of poses in ``data=named``; of two with a time each, the rows of both. Raises `DataError`."""
    stated = {"units": units} if units else {}
    sources = named.split(",")
    samples = read_samples(Path(named).expanduser(), units)
    if samples is not None:
        return samples
    if len(sources) != 2:
        return read_table(named, stated)
    both = [read_table(source, {}) for source in sources]
    if any(not any(is_time(name) for name in one.columns) for one in both):
        return read_table(named, stated)
    lost = next((name for name in units if not any(name in one.columns for one in both)), None)
    if lost is not None:
        raise DataError(f"units: {lost} is no column of {' or '.join(sources)}")
    both = [
        read_table(source, {"units": {name: unit for name, unit in units.items() if name in one.columns}})
        for source, one in zip(sources, both, strict=True)
    ]
    times = [next(name for name in one.columns if is_time(name)) for one in both]
    first, second = (replace(one, columns=_numbers(one, time)) for one, time in zip(both, times, strict=True))
    unit = [one.units.get(time, time.partition("_")[2]) for one, time in zip(both, times, strict=True)]
    if unit[0] != unit[1]:
        raise DataError(f"{times[0]} of {sources[0]} and {times[1]} of {sources[1]} are in different units of time")
    return stacked(first, second)


def _numbers(table: Table, time: str) -> dict[str, Any]:
    """Return the columns of numbers, that of `time` by the one name that both files have."""
    named = {"time" if name == time else name: column for name, column in table.columns.items()}
    return {name: column for name, column in named.items() if column.dtype.kind in "iuf"}


def stacked(first: Table, second: Table) -> Table:
    """Return the rows of two tables, one after the other, without a value where a table lacks the column."""
    columns = {}
    for name in dict.fromkeys([*first.columns, *second.columns]):
        parts = [
            np.asarray(one.columns[name], dtype=float) if name in one.columns else np.full(len(one), np.nan)
            for one in (first, second)
        ]
        columns[name] = np.concatenate(parts)
    return Table(
        columns=columns, units={**first.units, **second.units}, stated={**first.stated, **second.stated},
        file=np.concatenate([first.file, second.file]), row=np.concatenate([first.row, second.row]),
        name=f"{first.name}_{second.name}", notes=once([*first.notes, *second.notes]),
    )  # fmt: skip


def write_hand_eye(answer: HandEye, request: HandEyeRequest) -> HandEye:
    """Write the frames as JSON and as YAML for ROS into the folder of the case; return them with the files' names."""
    folder = request.folder / answer.case
    folder.mkdir(parents=True, exist_ok=True)
    files = {"ros": folder / "static_transforms.yaml", "json": folder / "hand_eye.json"}
    answer = replace(answer, files={kind: str(path) for kind, path in files.items()})
    head = f"bench calibrate hand_eye={answer.hand_eye}, {answer.case}: {answer.pairs} pairs"
    ros = transforms_text(head, (answer.camera, answer.board))
    content = answer.to_dict() | {"provenance": made_by(request.command)}
    text = json.dumps(content, indent=1, allow_nan=False)
    write_whole(files["ros"], lambda file: file.write(ros.encode()))
    write_whole(files["json"], lambda file: file.write(text.encode()))
    return answer
