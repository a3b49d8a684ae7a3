"""`bench calibrate`: from its words to a calibration, and the files of it: description, readings, JSON and a page."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, final

from calibench.bench.calibration.files import read_table
from calibench.bench.measured import write_measured
from calibench.bench.measured.files import pairs_of
from calibench.bench.measured.sources import OF_A_CALIBRATION
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.sweep.words import RequestError, check_study, read_pairs
from calibench.calibration.arm import read_arm
from calibench.calibration.calibrate import Calibration, Level, calibrate_arm
from calibench.calibration.model import KNOWN_TO
from calibench.calibration.readings import OBSERVED, columns_of
from calibench.calibration.start import HowRead
from calibench.core.options import coerce, read_option, suggest
from calibench.discrepancy import MeasuredData

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
@dataclass(frozen=True, kw_only=True)
class CalibrateRequest:
    """A calibration of the arm of `urdf`, or of the table `dh`; `stated` goes before the data's own metadata.

    `distance` [mm] is that of the two sockets of a place, 0 where it is not known, `sigma_distance` [mm] how well it is
    known. `level` is how much of the arm is calibrated; auto takes what predicts poses best that were not fitted.
    """

    urdf: Path | None
    data: str
    tip: str = ""
    base: str = ""
    how: HowRead = field(default_factory=lambda: HowRead(limits=True))
    stated: Mapping[str, Any] = field(default_factory=dict)
    distance: float = 0.0
    sigma_distance: float = KNOWN_TO
    level: Level = "auto"
    resamples: int = 200
    page: bool = True
    folder: Path = Path("results/calibrate")
    dh: Path | None = None
    convention: str = ""

    def carry_out(self) -> Calibration:
        """Return the calibration. Raises `ValueError`, in one line."""
        path = self.dh or self.urdf
        assert path is not None
        arm = None
        if self.dh is None:  # what cannot be used of a URDF is said before the data are read
            arm = read_arm(path, table=False, base=self.base, tip=self.tip)
        table = read_table(self.data, self.stated)
        if arm is None:
            arm = read_arm(path, table=True, convention=self.convention, option="", data=table, how=self.how)
        return calibrate_arm(
            arm, table, how=self.how, distance=self.distance, sigma_distance=self.sigma_distance, level=self.level,
            resamples=self.resamples,
        )  # fmt: skip


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
        urdf=Path(urdf).expanduser() if urdf else None, data=given["data"], tip=given.get("machine.tip", ""),
        base=given.get("machine.base", ""),
        how=HowRead(observe, given.get("rotation", ""), read_option("limits", given.get("limits", "true"), bool)),
        stated=stated, distance=distance, sigma_distance=known_to,
        level=coerce("level", given.get("level", "auto"), Level), resamples=resamples,
        page=read_option("page", given.get("page", "true"), bool),
        folder=Path(given.get("results", "results")).expanduser() / study, dh=Path(dh).expanduser() if dh else None,
        convention=convention,
    )  # fmt: skip


def write_calibration(answer: Calibration, request: CalibrateRequest) -> Calibration:
    """Write everything of one calibration into its folder; return it with the files' names."""
    folder = request.folder / answer.case
    folder.mkdir(parents=True, exist_ok=True)
    files: dict[str, str] = {}
    if answer.chosen != "frames":
        for kind, (name, content) in answer.written(request.data).items():
            files[kind] = str(_put(folder / name, content))
    columns, units, stated = columns_of(answer.readings, request.distance)
    readings = MeasuredData(columns, "arm", stated, answer.readings.table.name, units=units)
    files["readings"] = str(write_measured(readings, folder / OF_A_CALIBRATION))
    answer = replace(answer, files=files)
    if request.page:
        from calibench.bench.calibration.page import write_page  # drawings take half a second to load

        files["page"] = str(write_page(answer, folder))
    files["json"] = str(folder / "calibration.json")
    _put(Path(files["json"]), json.dumps(answer.to_dict(), indent=1, allow_nan=False).encode())
    return answer


def _put(path: Path, content: bytes) -> Path:
    return write_whole(path, lambda file: file.write(content))
