"""`bench calibrate`: from its words to a calibration, and the files of it: description, readings, JSON and a page.

`bench design machine=arm plan.n=N`: to the poses whose measurement is worth most for this arm. Files of a measurement
are one table: those with the same columns follow each other, others with as many rows are joined row by row. A folder
of folders with hole_0.csv ... (or socket_K) is one place of a tool with sockets each, named by its path.
"""

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np

from calibench.bench.calibration.words import transforms_text
from calibench.bench.measured.files import pairs_of, read_sockets, socket_files, write_columns
from calibench.bench.measured.sources import OF_A_CALIBRATION, joined, sets
from calibench.bench.provenance.environment import made_by
from calibench.bench.store.atomic_file import write_whole
from calibench.bench.verbs import CalibrateWords, HandEyeWords, PosesWords
from calibench.bench.words import RequestError, check_study, read
from calibench.calibration import columns
from calibench.calibration.arm import read_arm
from calibench.calibration.calibrate import Calibration, calibrate_arm
from calibench.calibration.hand_eye_start import Setup
from calibench.calibration.model import KNOWN_TO
from calibench.calibration.poses import Design, design_poses
from calibench.calibration.readings import Table, columns_of
from calibench.calibration.rigid import Array
from calibench.calibration.start import HowRead
from calibench.core.notes import DataError, once
from calibench.core.plain import json_of
from calibench.core.tables import csv_table
from calibench.core.tables.columns import Columns, Declared, Quantity, columns_of as csv_columns

MOST_BOXES = 20


@final
@dataclass(frozen=True, kw_only=True)
class CalibrateRequest:
    """The words that were given, how the data are read, and what is `stated` of them before their own metadata.

    `path` is the arm's description; `camera` is how a board was seen, None where none was.
    """

    given: CalibrateWords
    path: Path
    how: HowRead
    stated: Mapping[str, Any]
    camera: Setup | None
    folder: Path
    command: str

    def carry_out(self) -> Calibration:
        """Return the calibration. Raises `ValueError`, in one line."""
        given, arm = self.given, None
        if given.dh is None:  # what cannot be used of a URDF is said before the data are read
            arm = read_arm(self.path, table=False, base=given.base, tip=given.tip)
        table = read_table(given.data, self.stated)
        if arm is None:
            arm = read_arm(self.path, table=True, convention=given.convention, option="", data=table, how=self.how)
        return calibrate_arm(
            arm, table, how=self.how, distance=given.distance or 0.0, level=given.level, resamples=given.resamples,
            sigma_distance=given.sigma_distance or KNOWN_TO, camera=self.camera,
            priors=read_priors(given.priors) if given.priors else None,
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
    path = file_of_arm(given, "")
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
        given=given, path=path, how=HowRead(given.observe or "", given.rotation, given.limits), camera=camera,
        stated=statements_of(given) | ({} if given.gap is None else {"gap": given.gap}),
        folder=Path(given.results).expanduser() / given.study, command=shlex.join(["bench", "calibrate", *words]),
    )  # fmt: skip


def write_calibration(answer: Calibration, request: CalibrateRequest) -> Calibration:
    """Write everything of one calibration into its folder; return it with the files' names."""
    folder = request.folder / answer.case
    folder.mkdir(parents=True, exist_ok=True)
    written = answer.written(request.given.data) if answer.chosen != "frames" else {}
    files = {kind: str(write_whole(folder / name, content)) for kind, (name, content) in written.items()}
    columns, units, stated = columns_of(answer.readings, request.given.distance or 0.0)
    readings = Columns(columns, stated, units=units)
    files["readings"] = str(write_columns(readings, ARM, folder / OF_A_CALIBRATION))
    if answer.camera is not None and answer.board is not None:
        head = f"bench calibrate hand_eye=... with {answer.source}, {answer.case}: {answer.poses} poses"
        text = transforms_text(head, (answer.camera, answer.board))
        files["ros"] = str(write_whole(folder / "static_transforms.yaml", text.encode()))
    answer = replace(answer, files=files)
    if request.given.page:
        from calibench.bench.calibration.page import write_page  # drawings take half a second to load

        files["page"] = str(write_page(answer, folder))
    files["json"] = str(folder / "calibration.json")
    content = answer.to_dict() | {"provenance": made_by(request.command)}
    write_whole(Path(files["json"]), json.dumps(content, indent=1, allow_nan=False).encode())
    return answer


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
    from calibench.bench.calibration.page import gain_chart
    from calibench.bench.report.shared.drawing import save

    slides = {joint.name for joint in design.chain.joints if joint.kind == "sliding"}
    heads = [f"{name} [{'mm' if name in slides else 'rad'}]" for name in design.chain.driven]
    lines = [",".join(heads), *(",".join(f"{value:.6f}" for value in pose) for pose in design.joints)]
    targets = to.with_name(f"{to.stem}_targets.json")
    write_whole(to, ("\n".join(lines) + "\n").encode())
    write_whole(targets, (json.dumps(list(design.targets), indent=1) + "\n").encode())
    return to, targets, *save(f"{to.stem}_gain", gain_chart(design), to.parent)


_DEMONSTRATIONS = Path(__file__).resolve().parents[2] / "discrepancy" / "demo" / "arm"
ARM = replace(columns.ARM, demonstrations=_DEMONSTRATIONS)
_PRIORS = Declared("", (Quantity("name", text=True),))


def read_table(named: str, stated: Mapping[str, Any], part: bool = False) -> Table:
    """Return the table of ``data=named``: a file, a glob, files parted by commas, or a folder. Raises `DataError`.

    Of a `part` of a table `stated` may name columns that other files hold.
    """
    path = Path(named).expanduser()
    if named and path.is_dir():
        # the postures of all sockets of all places below a folder
        if not socket_files(path):
            raise DataError(
                f"{path}: holds no hole_0.csv, hole_1.csv or socket_0.csv in folders by place; name a file of readings"
            )
        by_label, note = read_sockets(path, ARM, stated)
        whole = one_after_the_other([_of_one(label, content) for label, content in by_label.items()])
        return replace(whole, name=path.name, notes=(note, *whole.notes))
    named_sets = sets(named, ARM, stated)
    several = len(named_sets) > 1
    contents = [one.columns(ARM, stated, part=several or part) for one in named_sets]
    read = [_of_one(one.case, content) for one, content in zip(named_sets, contents, strict=True)]
    if not several:
        return read[0]
    first = set(read[0].columns)
    if all(set(one.columns) == first for one in read):
        return one_after_the_other(read)
    return _of_one(read[0].name, joined(dict(zip([one.name for one in read], contents, strict=True)), stated))


def read_priors(named: str) -> dict[str, tuple[float, float]]:
    """Return what ``priors=`` states, name -> value and sd: a table with these columns, or JSON. Raises `DataError`."""
    try:
        if named.lstrip().startswith("{"):
            rows = [(name, *pair) for name, pair in json_of(named).items()]
        else:
            table = csv_columns(csv_table.read_table(Path(named).expanduser()), _PRIORS).columns
            rows = list(zip(*(table[key].tolist() for key in ("name", "value", "sd")), strict=True))
        return {str(name): (float(value), float(sd)) for name, value, sd in rows}
    except KeyError as error:
        raise DataError(f"priors={named}: has no column {error}; name, value and sd are needed") from None
    except OSError as error:
        raise DataError(f"priors={named}: {error.strerror}") from None
    except (AttributeError, TypeError, ValueError) as error:
        raise DataError(f"priors={named}: {error}; name, value and sd are needed, in mm and rad") from None


def _of_one(name: str, content: Columns) -> Table:
    return Table.of(content.columns, name, units=content.units, stated=content.metadata, notes=content.notes)


def one_after_the_other(tables: Sequence[Table]) -> Table:
    """Return the rows of all tables, without a value where a table lacks a column. Raises `DataError`."""
    first, *others = tables
    for one in others:
        other = {name for name in one.units if name in first.columns and one.units[name] != first.units.get(name)}
        if other:
            raise DataError(f"{one.name}: column {min(other)} is in another unit than in {first.name}")
    columns = {
        name: np.concatenate([one.columns.get(name, np.full(len(one), np.nan)) for one in tables])
        for name in dict.fromkeys(name for one in tables for name in one.columns)
    }
    file, row = (np.concatenate([getattr(one, key) for one in tables]) for key in ("file", "row"))
    units = {name: unit for one in reversed(tables) for name, unit in one.units.items()}
    name = "_".join(one.name for one in tables) if len(tables) <= 3 else first.name
    notes = once(note for one in tables for note in one.notes)
    return Table(columns=columns, units=units, stated=first.stated, file=file, row=row, name=name, notes=notes)
