"""What an arm is described by, a URDF or a table of Denavit and Hartenberg, and what is written of it in the end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, final

from calibench.bench.calibration.dh.errors import error_of_table, fits
from calibench.bench.calibration.files import Table, read_table
from calibench.bench.calibration.fit import Fit
from calibench.bench.calibration.report.diff import changes_of_tip, origins_of
from calibench.bench.calibration.report.result import Change
from calibench.bench.calibration.report.urdf_text import calibrated
from calibench.bench.calibration.request import CalibrateRequest
from calibench.discrepancy import DataError
from calibench.problems.arm.chains.chain import Chain
from calibench.problems.arm.chains.dh import FORMS
from calibench.problems.arm.chains.dh_file import DhError, read_dh, text_of_dh
from calibench.problems.arm.chains.dh_table import DhTable
from calibench.problems.arm.chains.dh_urdf import urdf_of_dh
from calibench.problems.arm.chains.urdf import Robot, parse_urdf, urdf_text
from calibench.problems.base import Array

Written = Mapping[str, tuple[str, bytes]]  # what a file is -> its name and content


class Described(Protocol):
    """A description of an arm: the chain that it makes, and the files of the calibrated arm."""

    @property
    def path(self) -> Path:
        """Return the file that it came from."""

    @property
    def chain(self) -> Chain:
        """Return the chain from base to tip."""

    @property
    def table(self) -> DhTable | None:
        """Return the table whose numbers are calibrated; None where the placements of a URDF's joints are."""

    @property
    def notes(self) -> Sequence[str]:
        """Return what was found in the description, and not stated."""

    def more_changes(self, fit: Fit, draws: Array) -> tuple[Change, ...]:
        """Return changes beside those of the joints, with the intervals that the `draws` (b, k) give."""

    def written(self, fit: Fit, changes: Sequence[Change], said: str) -> Written:
        """Return the files of the calibrated arm, with a comment that says `said`."""


def described_by(request: CalibrateRequest) -> Described:
    """Return the description that `request` names. Raises `ValueError`, in one line, for what cannot be used.

    Where a table's convention is not stated, the refusal says as which one the readings fit.
    """
    if request.dh is None:
        assert request.urdf is not None
        text = urdf_text(request.urdf)
        robot = parse_urdf(text, str(request.urdf), "machine.")
        return OfUrdf(request.urdf, text, robot, robot.chain(request.base, request.tip), request.tip)
    try:
        return OfTable(request.dh, read_dh(request.dh, request.convention))
    except DhError as error:
        fits = [form for form in FORMS if "convention is not stated" in str(error) and _fits(request, form)]
        if len(fits) == 1:
            raise DhError(f"{error}; the readings fit the arm as {fits[0]} only") from None
        raise


def table_told(arm: Described, data: Table, request: CalibrateRequest) -> str:
    """Return with which one change of the arm's table the readings fit, where they do not as it stands; else ""."""
    found = "" if arm.table is None else error_of_table(arm.table, data, request)
    return f"{arm.path.name}: the readings fit the arm {found}" if found else ""


def _fits(request: CalibrateRequest, convention: str) -> bool:
    assert request.dh is not None
    try:
        return fits(read_dh(request.dh, convention), read_table(request.data, request.stated), request)
    except (DataError, DhError):
        return False


@final
@dataclass(frozen=True, eq=False)
class OfUrdf:
    """The arm of a URDF's `text`; its joints' origins are written anew, and all else stays."""

    path: Path
    text: bytes
    robot: Robot
    chain: Chain
    tip: str
    table: None = None
    notes: tuple[str, ...] = ()

    def more_changes(self, fit: Fit, draws: Array) -> tuple[Change, ...]:
        """Return the shift and turn of the fixed joint before a stated tip."""
        return changes_of_tip(self.robot, fit, self.tip, draws)

    def written(self, fit: Fit, changes: Sequence[Change], said: str) -> Written:
        """Return the calibrated URDF."""
        origins = origins_of(self.robot, fit, self.tip)
        text = calibrated(self.text, origins, said) if origins else self.text
        return {"urdf": (f"{self.path.stem}_calibrated.urdf", text)}


@final
@dataclass(frozen=True, eq=False)
class OfTable:
    """The arm of a `table`, which is written with its new numbers and their standard errors, and as a URDF."""

    path: Path
    table: DhTable

    @property
    def chain(self) -> Chain:
        """Return the chain from base to flange."""
        return self.table.chain

    @property
    def notes(self) -> tuple[str, ...]:
        """Return which units its sizes told."""
        return tuple(f"{self.path.name}: {note}" for note in self.table.notes)

    def more_changes(self, fit: Fit, draws: Array) -> tuple[Change, ...]:
        """Return nothing: a table has no place for the target."""
        return ()

    def written(self, fit: Fit, changes: Sequence[Change], said: str) -> Written:
        """Return the calibrated table, with standard errors of what was determined, and the same arm as a URDF."""
        assert fit.model.rows is not None
        new = fit.model.rows.corrected(fit.p)
        errors = {change.parameter: change.sd for change in changes if not change.parameter.startswith("gain_")}
        stem = f"{self.path.stem}_calibrated"
        ways = zip(fit.model.joints.min(axis=0).tolist(), fit.model.joints.max(axis=0).tolist(), strict=True)
        used = dict(zip(self.chain.driven, ways, strict=True))
        return {
            "dh": (f"{stem}.csv", text_of_dh(new, said, errors).encode()),
            "urdf": (f"{stem}.urdf", urdf_of_dh(new, said, used).encode()),
        }
