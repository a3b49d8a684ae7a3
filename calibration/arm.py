"""`Arm`: what an arm is described by, a URDF or a table of Denavit and Hartenberg, and how it is written calibrated.

Of a URDF the origins of its joints are calibrated, and all else of the file stays; of a table its own numbers, which
are written with their standard errors, and as a URDF beside.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import final

import numpy as np

from calibench.calibration.dh import FORMS, ConventionError, DhError, DhTable, read_dh, text_of_dh, urdf_of_dh
from calibench.calibration.fit import Fit
from calibench.calibration.kinematics import Chain
from calibench.calibration.readings import Table
from calibench.calibration.rigid import Array, rpy, shift, slide, turn
from calibench.calibration.start import HowRead, misfit_of_table, mistake_of_table
from calibench.calibration.urdf import Joint, Robot, parse_urdf, urdf_text, with_origins
from calibench.core.notes import Code, DataError, Note

_TABLES = (".csv", ".tsv", ".txt", ".xlsx", ".xlsm")
Files = Mapping[str, tuple[str, bytes]]  # what a file is -> its name and content


@final
@dataclass(frozen=True, eq=False)
class Arm:
    """The arm of a URDF, `robot` with its `text`, or of a `table`, from the file `path`; `tip` was stated."""

    path: Path
    chain: Chain
    table: DhTable | None = None
    robot: Robot | None = None
    text: bytes = b""
    tip: str = ""

    @property
    def notes(self) -> tuple[Note, ...]:
        """Return what was seen in the arm's own file: units that sizes tell, and what is wrong beside the chain."""
        if self.robot is not None:
            return self.robot.beside(self.chain)
        words = self.table.notes if self.table is not None else ()
        return tuple(Note(Code.UNIT, f"{self.path.name}: {text}") for text in words)

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
        stem, model = f"{self.path.stem}_calibrated", fit.model
        if self.robot is None:
            assert model.rows is not None
            table = model.rows.corrected(fit.p)
            ways = zip(model.joints.min(axis=0).tolist(), model.joints.max(axis=0).tolist(), strict=True)
            used = dict(zip(self.chain.driven, ways, strict=True))
            return {
                "dh": (f"{stem}.csv", text_of_dh(table, comment, errors).encode()),
                "urdf": (f"{stem}.urdf", urdf_of_dh(table, comment, used).encode()),
            }
        known = {joint.name: joint.origin for joint in self.robot.joints}
        origins = {}
        for k, joint in enumerate(model.chain.joints):
            values = fit.p[6 + 8 * k : 14 + 8 * k]
            if set(range(6 + 8 * k, 13 + 8 * k)) & set(fit.kept.tolist()):
                zero = (turn if joint.kind == "rotary" else slide)(joint.axis, values[7] * values[6])
                origins[joint.name] = known[joint.name] @ placement(values[:6]) @ zero
        if (last := self.last) is not None:  # the fixed joint before a stated tip gets the transform to the target
            target = model.chain.tool @ placement(fit.p[-6:])
            if model.turns is None:  # a position tells no rotation
                target[:3, :3] = np.eye(3)
            origins[last.name] = last.origin @ target
        return {"urdf": (f"{stem}.urdf", with_origins(self.text, origins, comment) if origins else self.text)}

    @property
    def last(self) -> Joint | None:
        """Return the fixed joint of a URDF that leads to the stated tip; None where none does."""
        joints = self.robot.joints if self.robot is not None and self.tip else ()
        return next((joint for joint in joints if joint.child == self.tip and not joint.moves), None)


def read_arm(
    path: str | Path | Arm, *, table: bool | None = None, convention: str = "", base: str = "", tip: str = "",
    option: str = "machine.", data: Table | None = None, how: HowRead | None = None,
) -> Arm:  # fmt: skip
    """Return the arm that a file describes: a `table` if that is said, or if the file's ending is one of tables.

    An `Arm` is one. Raises `ChainError`. Where a table's convention is not stated, the refusal says as which one `data`
    fit.
    """
    if isinstance(path, Arm):
        return path
    path = Path(path).expanduser()
    if not (path.suffix.lower() in _TABLES if table is None else table):
        text = urdf_text(path)
        robot = parse_urdf(text, str(path), option)
        return Arm(path, robot.chain(base, tip), robot=robot, text=text, tip=tip)
    try:
        rows = read_dh(path, convention, option)
    except ConventionError as error:
        how, fitting = how or HowRead(), []
        for form in FORMS:
            with suppress(DhError):
                if data is not None and misfit_of_table(read_dh(path, form), data, how) < inf:
                    fitting.append(form)
        if len(fitting) != 1:
            raise
        raise ConventionError(f"{error}; the readings fit the arm as {fitting[0]} only") from None
    return Arm(path, rows.chain, table=rows)


def placement(values: Array) -> Array:
    """Return Trans(x, y, z) Rz(rz) Ry(ry) Rx(rx), (4, 4), of six numbers [mm, rad]."""
    return np.asarray(shift(values[0], values[1], values[2]) @ rpy(values[3], values[4], values[5]))
