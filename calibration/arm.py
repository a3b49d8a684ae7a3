"""`Arm`: what an arm is described by, a URDF or a table of Denavit and Hartenberg, and how it is written calibrated.

Of a URDF the origins of its joints are calibrated, and all else of the file stays; of a table its own numbers, which
are written with their standard errors, and as a URDF beside.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import final

import numpy as np

from calibench.calibration.dh import FORMS, DhTable
from calibench.calibration.dh_file import ConventionError, DhError, read_dh, text_of_dh, urdf_of_dh
from calibench.calibration.dh_mistakes import misfit_of_table, mistake_of_table
from calibench.calibration.fit import Fit
from calibench.calibration.kinematics import Chain
from calibench.calibration.readings import Table
from calibench.calibration.rigid import Array, rpy, rpy_of, shift, slide, turn
from calibench.calibration.start import HowRead
from calibench.calibration.urdf import Joint, Robot, parse_urdf, urdf_text, with_origins
from calibench.core.notes import Code, DataError, Note

_TABLES = (".csv", ".tsv", ".txt", ".xlsx", ".xlsm")
Files = Mapping[str, tuple[str, bytes]]  # what a file is -> its name and content


@final
@dataclass(frozen=True, eq=False)
class Arm:
    """The arm of a URDF, `robot` with its `text`, or of a `table`; `chain` goes from base to tip.

    `path` is the file that it came from, `tip` the link that was stated, "" for none, `notes` what was found in the
    description and not stated.
    """

    path: Path
    chain: Chain
    table: DhTable | None = None
    robot: Robot | None = None
    text: bytes = b""
    tip: str = ""

    @property
    def notes(self) -> tuple[Note, ...]:
        """Return which units the sizes of a table told."""
        notes = () if self.table is None else self.table.notes
        return tuple(Note(Code.UNIT, f"{self.path.name}: {text}") for text in notes)

    def mistake(self, table: Table, how: HowRead) -> Note | None:
        """Return with which one change of the arm's own table the readings fit, where they do not as it stands."""
        change = "" if self.table is None else mistake_of_table(self.table, table, how)
        return Note(Code.TABLE_MISTAKE, f"{self.path.name}: the readings fit the arm {change}") if change else None

    def refusal(self, error: DataError, table: Table, how: HowRead) -> DataError:
        """Return the refusal of readings that do not fit the arm, with its table's mistake if one is the cause."""
        mistake = self.mistake(table, how)
        return error if mistake is None else DataError(f"{mistake.text}. As it stands: {error}", mistake)

    def files(self, fit: Fit, comment: str, errors: Mapping[str, float]) -> Files:
        """Return the files of the calibrated arm; `errors` are standard errors of parameters, by name [mm, rad]."""
        stem = f"{self.path.stem}_calibrated"
        if self.robot is not None:
            origins = origins_of(self.robot, fit, self.tip)
            return {"urdf": (f"{stem}.urdf", with_origins(self.text, origins, comment) if origins else self.text)}
        assert fit.model.rows is not None
        table = fit.model.rows.corrected(fit.p)
        ways = zip(fit.model.joints.min(axis=0).tolist(), fit.model.joints.max(axis=0).tolist(), strict=True)
        used = dict(zip(self.chain.driven, ways, strict=True))
        return {
            "dh": (f"{stem}.csv", text_of_dh(table, comment, errors).encode()),
            "urdf": (f"{stem}.urdf", urdf_of_dh(table, comment, used).encode()),
        }


def read_arm(
    path: Path, *, table: bool | None = None, convention: str = "", base: str = "", tip: str = "",
    option: str = "machine.", data: Table | None = None, how: HowRead | None = None,
) -> Arm:  # fmt: skip
    """Return the arm that a file describes: a `table` if that is said, or if the file's ending is one of tables.

    Raises `ChainError`, in one line, for what cannot be used. Where a table's convention is not stated, the refusal
    says as which one the readings `data` fit. `option` is what its user writes before base=, tip= and convention=.
    """
    path = path.expanduser()
    if table is None:
        table = path.suffix.lower() in _TABLES
    if not table:
        text = urdf_text(path)
        robot = parse_urdf(text, str(path), option)
        return Arm(path, robot.chain(base, tip), robot=robot, text=text, tip=tip)
    try:
        rows = read_dh(path, convention, option)
    except ConventionError as error:
        how = HowRead() if how is None else how
        fitting = [form for form in FORMS if data is not None and _fits(path, form, data, how)]
        if len(fitting) != 1:
            raise
        raise ConventionError(f"{error}; the readings fit the arm as {fitting[0]} only") from None
    return Arm(path, rows.chain, table=rows)


def _fits(path: Path, form: str, data: Table, how: HowRead) -> bool:
    try:
        return misfit_of_table(read_dh(path, form), data, how) < inf
    except DhError:
        return False


def origins_of(robot: Robot, fit: Fit, tip: str) -> dict[str, Array]:
    """Return the new origins of the URDF's joints that change, joint -> (4, 4) [mm].

    With a stated `tip` the target is that link, so the fixed joint before it gets the transform to the target.
    """
    joints = {joint.name: joint for joint in robot.joints}
    origins = {}
    for k, joint in enumerate(fit.model.chain.joints):
        values = fit.p[6 + 8 * k : 14 + 8 * k]
        if not (set(range(6 + 8 * k, 13 + 8 * k)) & set(fit.kept.tolist())):
            continue
        zero = (turn if joint.kind == "rotary" else slide)(joint.axis, values[7] * values[6])
        origins[joint.name] = joints[joint.name].origin @ placement(values[:6]) @ zero
    if (last := joint_before(robot, tip)) is not None:
        target = fit.model.chain.tool @ correction(fit, "tool")
        if fit.model.turns is None:  # a position tells no rotation
            target[:3, :3] = np.eye(3)
        origins[last.name] = last.origin @ target
    return origins


def targets_of(fit: Fit, tools: Sequence[Array] | Array) -> Array:
    """Return x y z [mm], roll pitch yaw [rad] of the target on the tip, (b, 6), for corrections `tools` (b, 6)."""
    poses = [fit.model.chain.tool @ placement(tool) for tool in tools]
    return np.array([[*pose[:3, 3], *rpy_of(pose)] for pose in poses])


def joint_before(robot: Robot | None, tip: str) -> Joint | None:
    """Return the fixed joint that leads to a stated `tip`; None where none does."""
    if robot is None or not tip:
        return None
    last = next((joint for joint in robot.joints if joint.child == tip), None)
    return None if last is None or last.moves else last


def correction(fit: Fit, name: str) -> Array:
    """Return the correction of `base` or `tool`, (4, 4)."""
    at = 0 if name == "base" else len(fit.p) - 6
    return placement(fit.p[at : at + 6])


def placement(values: Array) -> Array:
    """Return Trans(x, y, z) Rz(rz) Ry(ry) Rx(rx), (4, 4), of six numbers [mm, rad]."""
    made: Array = shift(values[0], values[1], values[2]) @ rpy(values[3], values[4], values[5])
    return made
