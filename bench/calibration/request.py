"""The request of `bench calibrate`: a URDF or a table, data, statements on them, and the folder of the result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, final

from calibench.bench.calibration.model import KNOWN_TO
from calibench.bench.calibration.readings import OBSERVED
from calibench.bench.measured.files import pairs_of
from calibench.bench.sweep.words import RequestError, check_study, read_pairs
from calibench.core.options import coerce, read_option, suggest

Level = Literal["auto", "frames", "zeros", "geometry", "gains"]
_KEYS = {
    "urdf": "my.urdf", "dh": "my_table.csv", "convention": "standard", "machine.dh": "my_table.csv",
    "machine.convention": "standard", "data": "my.csv", "machine.urdf": "my.urdf", "machine.tip": "tool0",
    "machine.base": "base_link",
    "machine.observe": "position", "machine": "arm", "columns": '{"x":"Weg X"}', "units": "x1:mm", "rotation": "rpy",
    "distance": "50", "sigma_distance": "0.05", "level": "geometry", "limits": "false", "resamples": "200",
    "page": "false", "study": "calibrate", "results": "results",
}  # fmt: skip
_MOST_RESAMPLES = 10_000


@final
@dataclass(frozen=True)
class CalibrateRequest:
    """A calibration of the arm of `urdf`, or of the table `dh`; `stated` goes before the data's own metadata.

    `distance` [mm] is that of the two sockets of a place, 0 where it is not known, `sigma_distance` [mm] how well it is
    known. `level` is how much of the arm is
    calibrated; auto takes what predicts poses best that were not fitted.
    """

    urdf: Path | None
    data: str
    tip: str = ""
    base: str = ""
    observe: str = ""
    stated: Mapping[str, Any] = field(default_factory=dict)
    rotation: str = ""
    distance: float = 0.0
    sigma_distance: float = KNOWN_TO
    level: Level = "auto"
    limits: bool = True
    resamples: int = 200
    page: bool = True
    folder: Path = Path("results/calibrate")
    dh: Path | None = None
    convention: str = ""


def check_description(urdf: str, dh: str, convention: str, given: Mapping[str, str], option: str) -> None:
    """Raise `RequestError` for descriptions of an arm that do not go together. `option` stands before urdf= and dh=."""
    if urdf and dh:
        raise RequestError(f"{option}urdf= and {option}dh= both describe the arm; give one")
    if convention and not dh:
        raise RequestError(f"{option}convention= is that of a table; state {option}dh= too, or leave it out")
    lost = [key for key in ("machine.tip", "machine.base") if dh and key in given]
    if lost:
        raise RequestError(f"{lost[0]}= is a link of a URDF; a table goes from its first row to its last: leave it out")


def read_calibrate(words: Sequence[str]) -> CalibrateRequest:
    """Return the calibration that `words` ask for. Raises `RequestError` or `ValueError`."""
    given = read_pairs("calibrate", words, _KEYS)
    if given.get("machine", "arm") != "arm":
        raise RequestError(
            f"machine={given['machine']}: bench calibrate is for machine=arm; discover is for the others"
        )
    for key in ("urdf", "dh", "convention"):
        if key in given and f"machine.{key}" in given:
            raise RequestError(f"{key}= and machine.{key}= are the same thing; give one")
    urdf, dh, convention = (given.get(key, given.get(f"machine.{key}", "")) for key in ("urdf", "dh", "convention"))
    check_description(urdf, dh, convention, given, "")
    for key, value, what in (
        (
            "urdf",
            urdf or dh,
            "the arm's description, such as urdf=my.urdf, or dh=table.csv where it has a table of joints",
        ),
        ("data", given.get("data", ""), "a file of joints and readings, or a folder of sockets, such as data=my.csv"),
    ):
        if not value:
            raise RequestError(f"{key}= is missing: {what}")
    observe = given.get("machine.observe", "")
    if observe and observe not in OBSERVED:
        raise RequestError(f"machine.observe={observe}: {suggest(observe, OBSERVED)}")
    study = given.get("study", "calibrate")
    check_study(study)
    distance = read_option("distance", given.get("distance", "0"), float)
    if distance < 0:
        raise RequestError(
            f"distance={distance:g}: how far the two sockets of a place are apart [mm], above 0, is needed"
        )
    known_to = read_option("sigma_distance", given.get("sigma_distance", str(KNOWN_TO)), float)
    if not known_to > 0:
        raise RequestError(f"sigma_distance={known_to:g}: how well distance= is known [mm], above 0, is needed")
    if "sigma_distance" in given and not distance:
        raise RequestError("sigma_distance= says how well distance= is known; state distance= too, or leave it out")
    resamples = read_option("resamples", given.get("resamples", "200"), int)
    if not 20 <= resamples <= _MOST_RESAMPLES:
        raise RequestError(f"resamples={resamples}: from 20 to {_MOST_RESAMPLES} draws are needed")
    stated: dict[str, Any] = {key: pairs_of(key, given[key]) for key in ("columns", "units") if key in given}
    return CalibrateRequest(
        Path(urdf).expanduser() if urdf else None, given["data"], given.get("machine.tip", ""),
        given.get("machine.base", ""), observe, stated, given.get("rotation", ""), distance, known_to,
        coerce("level", given.get("level", "auto"), Level),
        read_option("limits", given.get("limits", "true"), bool), resamples,
        read_option("page", given.get("page", "true"), bool),
        Path(given.get("results", "results")).expanduser() / study, Path(dh).expanduser() if dh else None, convention,
    )  # fmt: skip
