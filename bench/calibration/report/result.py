"""`Calibration`: what `bench calibrate` found, as plain values for JSON and as what the page draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan
from typing import Any, final

from calibench.core.plain import finite
from calibench.problems.base import Array

SCHEMA_VERSION = 1
UNMOVED = "moves no reading"  # the reason of a number that no reading depends on


@final
@dataclass(frozen=True)
class Error:
    """The error of poses that were not fitted: rms with its 95 % interval, median and largest [mm]; rotation [rad].

    `spans` [mm] is the rms by which two sockets of a place that was not fitted are not at their stated distance.
    """

    level: str
    rms: float
    ci95: tuple[float, float]
    median: float
    largest: float
    rotation: float = nan
    spans: float = nan


@final
@dataclass(frozen=True)
class Change:
    """One number of the arm that the data determine: how far it is off its nominal value, sd and 95 % interval."""

    parameter: str
    joint: str
    what: str
    unit: str
    change: float
    sd: float
    ci95: tuple[float, float]


@final
@dataclass(frozen=True)
class Undetermined:
    """A number that keeps its nominal value: the numbers that act like it, or how uncertain it would be."""

    parameter: str
    reason: str
    like: tuple[str, ...] = ()

    @property
    def told_by_more_poses(self) -> bool:
        """Return whether other poses would tell it: it acts like no other number, and moves what is read."""
        return not self.like and self.reason != UNMOVED


@final
@dataclass(frozen=True)
class Part:
    """The error of a part of the poses, before and after [mm]: of a region, or of a range of one joint."""

    where: str
    poses: int
    before: float
    after: float


@final
@dataclass(frozen=True)
class OverJoint:
    """The error where a joint stands about `at`, between `low` and `high` [`unit`]: rms before and after [mm]."""

    joint: str
    unit: str
    at: float
    low: float
    high: float
    before: float
    after: float
    poses: int


@final
@dataclass(frozen=True)
class Wild:
    """A wild reading, which the fit did not use: where it stands in the file, and its error [mm]."""

    row: str
    error: float


@final
@dataclass(frozen=True, eq=False)
class Drawn:
    """What the drawings need: joints (n, j) [deg or mm], as `units` say, positions in the base (n, 3) [mm], errors.

    Errors before and after are (n,) [mm]; NaN where a reading is wild.
    """

    joints: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    position: Array
    before: Array
    after: Array


@final
@dataclass(frozen=True)
class Calibration:
    """The answer of one calibration of the arm in the file `path`, which is `described` by a "URDF" or a "table".

    `levels` are the errors of poses that were not fitted for each level that was tried; `chosen` is the one that is
    written, fitted to `fitted` of the `poses`: all but those that the file holds back. `frames` are base (in the
    tracker) and target (on the tip): x y z [mm], roll pitch yaw [rad].
    """

    case: str
    path: str
    described: str
    observed: str
    base: str
    tip: str
    joints: tuple[str, ...]
    poses: int
    fitted: int
    folds: str
    chosen: str
    levels: tuple[Error, ...]
    changes: tuple[Change, ...]
    undetermined: tuple[Undetermined, ...]
    wild: tuple[Wild, ...]
    regions: tuple[Part, ...]
    by_joint: tuple[Part, ...]
    frames: Mapping[str, tuple[float, ...]]
    scatter: tuple[float, float]
    notes: tuple[str, ...] = ()
    seconds: float = nan
    files: Mapping[str, str] = field(default_factory=dict)
    drawn: Drawn | None = None
    over_joints: tuple[OverJoint, ...] = ()

    @property
    def before(self) -> Error:
        """Return the error of the nominal arm, its frames fitted."""
        return self.levels[0]

    @property
    def after(self) -> Error:
        """Return the error of the arm that is written."""
        return next(error for error in self.levels if error.level == self.chosen)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        told = {key: finite(getattr(self, key)) for key in _TOLD}
        by = {"URDF": "urdf", "table": "dh"}[self.described]
        return {
            "schema_version": SCHEMA_VERSION,
            "case": self.case,
            by: self.path,
            **told,
            "before": finite(self.before),
            "after": finite(self.after),
        }


_TOLD = (
    "observed", "base", "tip", "joints", "poses", "fitted", "folds", "chosen", "levels", "changes",
    "undetermined", "wild", "regions", "by_joint", "over_joints", "frames", "scatter", "notes", "files", "seconds",
)  # fmt: skip
