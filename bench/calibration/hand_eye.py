"""`bench calibrate hand_eye=...`: from its words and files to the frames of camera and board, and the files of these.

Files of other tools are read too: samples of MoveIt and easy_handeye (YAML or JSON), arrays of OpenCV (npz,
FileStorage), and CSV rows that begin with hand and eye in turn. Whatever the file, it comes down to one list of poses
for the flange and one for the board, each pose 7 numbers (x y z, x y z w), 16 of a matrix by rows, or a translation and
a rotation. Of two files each may have one side, in the order of the other or with a time.
"""

import csv
import json
import shlex
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from io import BytesIO
from math import inf
from pathlib import Path
from typing import Any, final

import numpy as np
from scipy.spatial.transform import Rotation

from calibench.bench.calibration.request import one_after_the_other, read_table, statements_of
from calibench.bench.calibration.words import transforms_text
from calibench.bench.measured.files import pairs_of
from calibench.bench.provenance.environment import made_by
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.verbs import HandEyeWords
from calibench.bench.words import RequestError, check_study, read
from calibench.calibration.hand_eye import HandEye, calibrate_hand_eye
from calibench.calibration.hand_eye_start import Setup, is_time
from calibench.calibration.readings import Table, table_of
from calibench.calibration.rigid import Array, inverse
from calibench.core.notes import Code, DataError, Note, once
from calibench.core.options import suggest
from calibench.core.plain import check_yaml, json_of
from calibench.core.tables.data_file import LARGEST_OWN, LARGEST_TEXT, MEGABYTE, read_whole, text_of

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
        units = {self.columns.get(name, name): unit for name, unit in self.units.items()}
        return calibrate_hand_eye(read_poses(self.data, units), self.setup, self.columns)


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
    free = given.board_scale == "free"
    try:
        scale = 1.0 if free else float(given.board_scale)
    except ValueError:
        scale = 0.0
    if not 0 < scale < inf:
        needed = "the board's true size over that which the camera was told, or free, is needed"
        raise RequestError(f"board_scale={given.board_scale}: {needed}")
    setup = Setup(
        hand_eye=given.hand_eye, read=given.read or "", rotation=orders, sigma=given.sigma or 0.0,
        sigma_rotation=given.sigma_rotation or 0.0, flange=given.flange, board_scale=scale, free_scale=free,
    )  # fmt: skip
    folder = Path(given.results).expanduser() / given.study
    command = shlex.join(["bench", "calibrate", *words])
    return HandEyeRequest(data=given.data, setup=setup, folder=folder, command=command, **statements_of(given))


def read_poses(named: str, units: Mapping[str, str]) -> Table:
    """Return the table of poses in ``data=named``; of two with a time each, the rows of both. Raises `DataError`."""
    sources, stated = named.split(","), {"units": units} if units else {}
    samples = read_samples(Path(named).expanduser(), units)
    if samples is not None:
        return samples
    if len(sources) != 2:
        return read_table(named, stated)
    sampled = [read_samples(Path(source).expanduser(), units, part=True) for source in sources]
    first, second = both = [
        read_table(source, stated, part=True) if one is None else one
        for source, one in zip(sources, sampled, strict=True)
    ]
    timed = all(any(is_time(name) for name in one.columns) for one in both)
    if not timed and sampled == [None, None]:
        return read_table(named, stated)
    lost = next((name for name in units if not any(name in one.columns for one in both)), None)
    if lost is not None:
        raise DataError(f"units: {lost} is no column of {' or '.join(sources)}")
    if not timed:
        if len(first) != len(second):
            counts = " and ".join(f"{source} has {len(one)}" for source, one in zip(sources, both, strict=True))
            raise DataError(f"poses of two files are joined in their order, or by a time in each, and {counts}")
        return replace(
            first, columns={**first.columns, **second.columns, **first.columns}, units={**second.units, **first.units},
            name=f"{first.name}_{second.name}", notes=once([*first.notes, *second.notes]),
        )  # fmt: skip
    times = [next(name for name in one.columns if is_time(name)) for one in both]
    unit = [one.units.get(time, time.partition("_")[2]) for one, time in zip(both, times, strict=True)]
    if unit[0] != unit[1]:
        raise DataError(f"{times[0]} of {sources[0]} and {times[1]} of {sources[1]} are in different units of time")
    parts = []
    for one, time in zip(both, times, strict=True):  # the columns of numbers, that of time by one name in both
        numbers = {name: column for name, column in one.columns.items() if column.dtype.kind in "iuf"}
        parts.append(replace(one, columns={"time" if name == time else name: numbers[name] for name in numbers}))
    return one_after_the_other(parts)


def write_hand_eye(answer: HandEye, request: HandEyeRequest) -> HandEye:
    """Write the frames as JSON and as YAML for ROS into the folder of the case; return them with the files' names."""
    folder = request.folder / answer.case
    folder.mkdir(parents=True, exist_ok=True)
    files = {"ros": folder / "static_transforms.yaml", "json": folder / "hand_eye.json"}
    answer = replace(answer, files={kind: str(path) for kind, path in files.items()})
    head = f"bench calibrate hand_eye={answer.hand_eye}, {answer.case}: {answer.pairs} pairs"
    ros = transforms_text(head, (answer.camera, answer.board))
    content = answer.to_dict() | {"provenance": made_by(request.command)}
    write_whole(files["ros"], ros.encode())
    write_whole(files["json"], json.dumps(content, indent=1, allow_nan=False).encode())
    return answer


_LARGEST_YAML = 5 * MEGABYTE  # of samples: 8000 pairs of MoveIt
_NAMES = {  # of one side's poses: the side, whether they are the other way round, and their unit of length
    "effector_wrt_world": ("flange", False, "m"), "object_wrt_sensor": ("board", False, "m"),  # MoveIt
    "robot": ("flange", False, "m"), "tracking": ("board", False, "m"), "optical": ("board", False, "m"),
    "hand_world_samples": ("flange", False, "m"), "camera_marker_samples": ("board", False, "m"),  # easy_handeye
    "gripper2base": ("flange", False, ""), "base2gripper": ("flange", True, ""),  # OpenCV
    "rvec tvec": ("board", False, ""), "rvecs tvecs": ("board", False, ""),
    "target2cam": ("board", False, ""), "cam2target": ("board", True, ""), "world2cam": ("board", False, ""),
    "hand": ("flange", False, ""), "eye": ("board", False, ""),
}  # fmt: skip
_PARTS = {name: {*name.split()} if " " in name else {f"R_{name}", f"t_{name}"} for name in _NAMES}  # by OpenCV
_AXES = ("x", "y", "z", "qx", "qy", "qz", "qw")
_OFF = 1e-2  # by which a rotation's matrix may differ from one, in three digits


def read_samples(path: Path, units: Mapping[str, str], part: bool = False) -> Table | None:
    """Return the pairs of poses in a file of another tool in the stated `units`; None where it is a table.

    A `part` may have the poses of one side alone. Raises `DataError`, in one line.
    """
    kind = path.suffix.lower()
    readers: dict[str, Callable[[Path], Any]] = {
        ".yaml": _yaml, ".yml": _yaml, ".json": lambda path: json_of(text_of(read_whole(path, LARGEST_OWN))),
        ".npz": _arrays, ".csv": _rows, ".txt": _rows,
    }  # fmt: skip
    reader = readers.get(kind)
    if reader is None or not path.is_file():
        return None
    try:
        content = reader(path)
        if content is None:
            return None
        content = _by_name(content)
        sides = _sides(content, part)
        # places and quaternions of both, in metres where the tool that wrote them has metres
        columns: dict[str, Any] = {name: _numbers(name, content[name]).ravel() for name in content if is_time(name)}
        own: dict[str, str] = {}
        for side, (called, poses) in sides.items():
            turns = poses[:, :3, :3]
            off = np.abs(turns @ turns.swapaxes(1, 2) - np.eye(3)).reshape(-1, 9).max(axis=1, initial=0.0)
            wrong = np.flatnonzero(~((off < _OFF) & (np.linalg.det(turns) > 0)))
            if len(wrong):
                raise ValueError(
                    f"pose {wrong[0] + 1} of {called} has a matrix that is no rotation ({len(wrong)} of {len(off)})"
                )
            numbers = np.column_stack([poses[:, :3, 3], Rotation.from_matrix(turns).as_quat()])
            columns |= {f"{side}_{axis}": column for axis, column in zip(_AXES, numbers.T, strict=True)}
            unit = _NAMES[called][2]
            own |= {f"{side}_{axis}": unit for axis in "xyz" if unit}
        own |= {name: unit for name, unit in units.items() if not part or name in columns}
        meant = {"flange": "the flange in the base", "board": "the board in the camera"}
        text = ", ".join(f"{called} is {meant[side]}" for side, (called, _) in sides.items())
        table = table_of(columns, units=own, name=path.stem)
        return replace(table, notes=(*table.notes, Note(Code.FILE, text)))
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise DataError(f"{path}: {' '.join(str(error).split())}") from None


def _yaml(path: Path) -> Any:
    import yaml

    text = text_of(read_whole(path, _LARGEST_YAML))
    if text.startswith("%YAML:"):  # of OpenCV, which is no directive of YAML
        text = text.partition("\n")[2]
    try:
        check_yaml(text, _LARGEST_YAML)
        return yaml.load(text, Loader=getattr(yaml, "CBaseLoader", yaml.BaseLoader))  # words alone, tags unread
    except yaml.YAMLError as error:
        raise ValueError(f"is no YAML: {error}") from None


def _arrays(path: Path) -> dict[str, Any]:
    try:
        with zipfile.ZipFile(BytesIO(read_whole(path, LARGEST_OWN))) as packed:
            entries = [one for one in packed.infolist() if one.filename.endswith(".npy")]
            if sum(one.file_size for one in entries) > 2 * LARGEST_OWN:
                raise ValueError(f"unpacks to more than {2 * LARGEST_OWN // MEGABYTE} MB; no more are read")
            arrays = {}
            for one in entries:
                with packed.open(one) as file:
                    numbers = np.lib.format.read_array(file, allow_pickle=False)
                if numbers.dtype.kind not in "iuf":
                    raise ValueError(f"an array holds {numbers.dtype}, and numbers are read alone")
                arrays[one.filename.removesuffix(".npy")] = np.asarray(numbers, dtype=float)
            return arrays
    except (zipfile.BadZipFile, zlib.error, RuntimeError, EOFError):
        raise ValueError("is no npz file of NumPy") from None


def _rows(path: Path) -> dict[str, Any] | None:
    """Return the rows of hand and eye; None where the first rows are of neither, as those of a table."""
    with path.open("rb") as file:
        begin = file.read(4096).decode("utf-8-sig", "replace").splitlines()
    begin = [line for line in begin if not line.startswith("#")][:2]  # a heading, and the first row
    if not any(line.partition(",")[0].strip().lower() in ("hand", "eye") for line in begin):
        return None
    lines = text_of(read_whole(path, LARGEST_TEXT)).splitlines()
    called = [
        (k, line[0].strip().lower(), line[1:])
        for k, line in enumerate(csv.reader(lines), start=1)
        if line and not line[0].startswith("#")
    ]
    called = called if called[0][1] in ("hand", "eye") else called[1:]
    found: dict[str, Any] = {"hand": [], "eye": []}
    for i, (k, side, numbers) in enumerate(called):
        if side not in found:
            raise ValueError(f"line {k} begins with {side!r}; rows of hand and eye are read, in turn")
        found[side].append(numbers)
        if i % 2 and len(found["hand"]) != len(found["eye"]):
            raise ValueError(f"line {k} is a second row of {side} for one pair; rows of hand and eye come in turn")
    return found


def _by_name(content: Any) -> Mapping[str, Any]:
    """Return lists by name of what a file holds, one level down too: of samples with the same names, a list of each."""
    if isinstance(content, Mapping) and not _has_poses(content):
        within = [one for one in content.values() if _has_poses(one[0] if isinstance(one, list) and one else one)]
        content = within[0] if len(within) == 1 else content
    if isinstance(content, list) and content and all(isinstance(one, Mapping) for one in content):
        first = content[0]
        for k, one in enumerate(content, start=1):
            if set(one) != set(first):
                raise ValueError(
                    f"sample {k} has {', '.join(map(str, one)) or 'nothing'}, and the first {', '.join(first)}"
                )
        content = {name: [one[name] for one in content] for name in first}
    return {str(name): one for name, one in content.items()} if isinstance(content, Mapping) else {}


def _has_poses(content: Any) -> bool:
    return isinstance(content, Mapping) and any(n in content or parts <= {*content} for n, parts in _PARTS.items())


def _sides(content: Mapping[str, Any], part: bool) -> dict[str, tuple[str, Array]]:
    """Return the name and the poses (n, 4, 4) of flange and board in what a file holds; a `part` may lack one."""
    sides: dict[str, tuple[str, Array]] = {}
    for name, (side, inverted, _) in _NAMES.items():
        poses = None
        if name in content:
            poses = _poses(name, content[name])
        elif _PARTS[name] <= {*content}:  # rotations, matrices or vectors, beside translations
            parts = sorted(_PARTS[name])
            turned, placed = (_numbers(one, content[one]) for one in parts)
            n, by_vector = len(placed), turned.size == 3 * len(placed)
            if placed.size != 3 * n or turned.size not in (3 * n, 9 * n):
                raise ValueError(
                    f"{' and '.join(parts)} are {turned.shape} and {placed.shape}; (n, 3, 3) and (n, 3) are read"
                )
            poses = np.tile(np.eye(4), (n, 1, 1))
            turns = Rotation.from_rotvec(turned.reshape(n, 3)).as_matrix() if by_vector else turned.reshape(n, 3, 3)
            poses[:, :3, :3], poses[:, :3, 3] = turns, placed.reshape(n, 3)
        if poses is not None:
            if side in sides:
                raise ValueError(f"both {sides[side][0]} and {name} are the poses of the {side}; leave one out")
            sides[side] = name, np.asarray(inverse(poses)) if inverted else poses
    for side in ("flange", "board"):
        if side not in sides and not (part and sides):
            named = [name for name, (of, *_) in _NAMES.items() if of == side]
            there = ", ".join(map(str, list(content)[:8])) or "nothing"
            raise ValueError(f"has no poses of the {side} ({', '.join(named)}; R_ and t_ of OpenCV), but {there}")
    counts = {name: len(poses) for name, poses in sides.values()}
    if len(set(counts.values())) > 1:
        raise ValueError(
            f"poses are joined in their order, and {' and '.join(f'{k} has {n}' for k, n in counts.items())}"
        )
    return sides


def _poses(name: str, found: Any) -> Array:
    """Return poses (n, 4, 4) of what a file has under a name."""
    found = found["transforms"] if isinstance(found, Mapping) and "transforms" in found else found
    if isinstance(found, np.ndarray):
        found = list(found)
    if not isinstance(found, list):
        raise ValueError(f"{name} is no list of poses")
    made = np.tile(np.eye(4), (len(found), 1, 1))
    for k, one in enumerate(found):
        where = f"pose {k + 1} of {name}"
        if isinstance(one, Mapping):
            one = one.get("transform", one)
            try:
                one = [one[of][axis] for of, axes in (("translation", "xyz"), ("rotation", "xyzw")) for axis in axes]
            except (KeyError, TypeError):
                raise ValueError(f"{where} lacks a translation with x, y, z or a rotation with x, y, z, w") from None
        numbers = _numbers(where, one).ravel()
        if numbers.size == 16:
            made[k] = numbers.reshape(4, 4)
        elif numbers.size == 7:
            if not np.linalg.norm(numbers[3:]) > 0:
                raise ValueError(f"{where} has a quaternion without length")
            made[k, :3, :3], made[k, :3, 3] = Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3]
        else:
            raise ValueError(f"{where} has {numbers.size} numbers; 7 (x y z, x y z w) or the 16 of a matrix are read")
    return made


def _numbers(where: str, found: Any) -> Array:
    """Return an array of numbers, of lists or of a matrix as OpenCV writes it."""
    if isinstance(found, Mapping) and "data" in found:
        sizes = found.get("sizes", [found.get("rows"), found.get("cols")])
        shape = tuple(_numbers(where, sizes).astype(int))
        return _numbers(where, found["data"]).reshape(shape)
    if isinstance(found, Sequence) and any(isinstance(one, Mapping) for one in found):
        return np.stack([_numbers(where, one) for one in found])
    try:
        return np.asarray(found, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{where} holds something that is no number, or rows of unlike length") from None
