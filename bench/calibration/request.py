"""`bench calibrate`: from its words to a calibration, and the files of it: description, readings, JSON and a page.

`bench design machine=arm plan.n=N`: to the poses whose measurement is worth most for this arm.
"""

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from calibench.bench.calibration.files import ARM, read_priors, read_table
from calibench.bench.calibration.words import transforms_text
from calibench.bench.measured.files import pairs_of, write_columns
from calibench.bench.measured.sources import OF_A_CALIBRATION
from calibench.bench.provenance.environment import made_by
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.verbs import CalibrateWords, HandEyeWords, PosesWords
from calibench.bench.words import RequestError, check_study, read
from calibench.calibration.arm import read_arm
from calibench.calibration.calibrate import Calibration, Level, calibrate_arm
from calibench.calibration.hand_eye_start import Setup
from calibench.calibration.model import KNOWN_TO
from calibench.calibration.poses import Design, design_poses
from calibench.calibration.readings import columns_of
from calibench.calibration.rigid import Array
from calibench.calibration.start import HowRead
from calibench.core.tables.columns import Columns

MOST_BOXES = 20


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
    command: str = ""
    priors: str = ""
    camera: Setup | None = None

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
            resamples=self.resamples, priors=read_priors(self.priors) if self.priors else None, camera=self.camera,
        )  # fmt: skip


def file_of_arm(given: CalibrateWords | PosesWords, option: str) -> Path:
    """Return the one file that describes the arm; `option` stands before urdf= and dh=. Raises `RequestError`."""
    if given.urdf and given.dh:
        raise RequestError(f"{option}urdf= and {option}dh= both describe the arm; give one")
    if given.convention and not given.dh:
        raise RequestError(f"{option}convention= is that of a table; state {option}dh= too, or leave it out")
    if given.dh and (given.tip or given.base):
        key = "machine.tip" if given.tip else "machine.base"
        raise RequestError(f"{key}= is a link of a URDF; a table goes from its first row to its last: leave it out")
    path = given.dh or given.urdf
    if path is None:
        raise RequestError(
            f"{option}urdf= is missing: the arm's description, such as {option}urdf=my.urdf, or {option}dh=table.csv "
            "where it has a table of joints"
        )
    return path


def statements_of(given: CalibrateWords | HandEyeWords | PosesWords) -> dict[str, Any]:
    """Return what words state of the columns of a file. Raises `DataError`."""
    words = {"columns": given.columns, "units": given.units}
    return {key: pairs_of(key, text) for key, text in words.items() if text}


def read_calibrate(words: Sequence[str]) -> CalibrateRequest:
    """Return the calibration that `words` ask for. Raises `RequestError` or `ValueError`."""
    given = read(CalibrateWords, "calibrate", words)
    if given.machine not in ("", "arm"):
        raise RequestError(f"machine={given.machine}: bench calibrate is for machine=arm; discover is for the others")
    file_of_arm(given, "")
    check_study(given.study)
    if given.sigma_distance is not None and not given.distance:
        raise RequestError("sigma_distance= says how well distance= is known; state distance= too, or leave it out")
    camera = None
    if given.hand_eye is not None:
        orders = {"board": given.rotation} if given.rotation else {}
        camera = Setup(
            hand_eye=given.hand_eye, read=given.read or "", rotation=orders, board_scale=given.board_scale or 1.0
        )
    elif given.read or given.board_scale:
        key = "read" if given.read else "board_scale"
        raise RequestError(f"{key}= is of a camera; state hand_eye= too, or leave it out")
    return CalibrateRequest(
        urdf=given.urdf, dh=given.dh, convention=given.convention, tip=given.tip, base=given.base, data=given.data,
        how=HowRead(given.observe or "", given.rotation, given.limits),
        stated=statements_of(given) | ({} if given.gap is None else {"gap": given.gap}),
        distance=given.distance or 0.0, sigma_distance=given.sigma_distance or KNOWN_TO, level=given.level,
        resamples=given.resamples, page=given.page, folder=Path(given.results).expanduser() / given.study,
        command=shlex.join(["bench", "calibrate", *words]),
        priors=given.priors,
        camera=camera,
    )  # fmt: skip


def write_calibration(answer: Calibration, request: CalibrateRequest) -> Calibration:
    """Write everything of one calibration into its folder; return it with the files' names."""
    folder = request.folder / answer.case
    folder.mkdir(parents=True, exist_ok=True)
    written = answer.written(request.data) if answer.chosen != "frames" else {}
    files = {kind: str(_put(folder / name, content)) for kind, (name, content) in written.items()}
    columns, units, stated = columns_of(answer.readings, request.distance)
    readings = Columns(columns, stated, units=units)
    files["readings"] = str(write_columns(readings, ARM, folder / OF_A_CALIBRATION))
    if answer.camera is not None and answer.board is not None:
        head = f"bench calibrate hand_eye=... with {answer.source}, {answer.case}: {answer.poses} poses"
        text = transforms_text(head, (answer.camera, answer.board))
        files["ros"] = str(_put(folder / "static_transforms.yaml", text.encode()))
    answer = replace(answer, files=files)
    if request.page:
        from calibench.bench.calibration.page import write_page  # drawings take half a second to load

        files["page"] = str(write_page(answer, folder))
    files["json"] = str(folder / "calibration.json")
    content = answer.to_dict() | {"provenance": made_by(request.command)}
    _put(Path(files["json"]), json.dumps(content, indent=1, allow_nan=False).encode())
    return answer


def _put(path: Path, content: bytes) -> Path:
    return write_whole(path, lambda file: file.write(content))


def read_design_poses(words: Sequence[str]) -> tuple[Design, Path | None]:
    """Return the poses that `words` ask for, and the file they go to. Raises `ValueError`, in one line."""
    given = read(PosesWords, "design plan.n=", words)
    if given.n is None:
        raise RequestError(
            "plan.n= is missing: how many poses to propose, such as plan.n=12; data=FILE alone tells what these "
            "readings could show"
        )
    path = file_of_arm(given, "machine.")
    boxes = _boxes("plan.box", given.box, words, most=1)
    keep_out = _boxes("plan.keep_out", given.keep_out, words)
    arm = read_arm(path, table=given.dh is not None, convention=given.convention, base=given.base, tip=given.tip)
    start = None
    if given.data:
        how = HowRead(given.observe or "", given.rotation, limits=True)
        start = how.start(read_table(given.data, statements_of(given)), arm.chain)
    if given.to is not None and not given.to.parent.is_dir():
        raise RequestError(f"plan.to={given.to}: there is no folder {given.to.parent}")
    design = design_poses(
        arm, given.n, start=start, by=given.by, sigma=given.sigma, sigma_rotation=given.sigma_rotation,
        rotations=given.observe == "pose", target=given.target, limits=given.limits,
        box=boxes[0] if boxes else None, keep_out=keep_out, off=given.off, seed=given.seed,
    )  # fmt: skip
    return design, given.to


def _boxes(key: str, numbers: tuple[float, ...] | None, words: Sequence[str], most: int = MOST_BOXES) -> list[Array]:
    """Return the boxes of a word, (3, 2) [mm] each. Raises `RequestError`."""
    if numbers is None:
        return []
    made = np.array(numbers)
    if len(made) % 6 or not 6 <= len(made) <= 6 * most or (made[::2] >= made[1::2]).any():
        typed = next(word for word in words if word.startswith(f"{key}="))
        raise RequestError(f"{typed}: x0,x1,y0,y1,z0,z1 [mm] in the base, each pair rising, is needed")
    return list(made.reshape(-1, 3, 2))


def write_design(design: Design, to: Path) -> tuple[Path, ...]:
    """Write poses to the CSV `to`, as targets of joints, and the error against their number; return the files."""
    from calibench.bench.calibration.figures import gain_chart
    from calibench.bench.report.shared.drawing import save

    slides = {joint.name for joint in design.chain.joints if joint.kind == "sliding"}
    heads = [f"{name} [{'mm' if name in slides else 'rad'}]" for name in design.chain.driven]
    lines = [",".join(heads), *(",".join(f"{value:.6f}" for value in pose) for pose in design.joints)]
    targets = to.with_name(f"{to.stem}_targets.json")
    _put(to, ("\n".join(lines) + "\n").encode())
    _put(targets, (json.dumps(list(design.targets), indent=1) + "\n").encode())
    return to, targets, *save(f"{to.stem}_gain", gain_chart(design), to.parent)
