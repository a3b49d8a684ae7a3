"""`bench design machine=arm plan.n=N`: from the request to the poses whose measurement is worth most for this arm."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibench.bench.calibration.files import read_table
from calibench.bench.calibration.request import file_of_arm, statements_of
from calibench.bench.verbs import PosesWords
from calibench.bench.words import RequestError, read
from calibench.calibration.arm import read_arm
from calibench.calibration.poses import Design, design_poses
from calibench.calibration.start import HowRead


def asks_for_poses(words: Sequence[str]) -> bool:
    """Return whether `bench design` is asked which poses of an arm to measure."""
    asked = any(word.startswith("plan.n=") for word in words)
    others = any(word.startswith(("plan=", "data=")) for word in words)
    return "machine=arm" in words and (asked or not others)


def read_design_poses(words: Sequence[str]) -> tuple[Design, Path | None]:
    """Return the poses that `words` ask for, and the file they go to. Raises `ValueError`, in one line."""
    given = read(PosesWords, "design plan.n=", words)
    if given.n is None:
        raise RequestError(
            "plan.n= is missing: how many poses to propose, such as plan.n=12; data=FILE alone tells what these "
            "readings could show"
        )
    path = file_of_arm(given, "machine.")
    box = None if given.box is None else np.array(given.box)
    if box is not None and (box.shape != (6,) or (box[::2] >= box[1::2]).any()):
        typed = next(word for word in words if word.startswith("plan.box="))
        raise RequestError(f"{typed}: x0,x1,y0,y1,z0,z1 [mm] in the base, each pair rising, is needed")
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
        box=None if box is None else box.reshape(3, 2), seed=given.seed,
    )  # fmt: skip
    return design, given.to
