"""`bench design machine=arm plan.n=N`: from the request to the poses whose measurement is worth most for this arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibench.bench.calibration.files import read_table
from calibench.bench.calibration.request import check_description
from calibench.bench.measured.files import pairs_of
from calibench.bench.sweep.words import RequestError, read_pairs
from calibench.calibration.arm import read_arm
from calibench.calibration.poses import By, Design, Limits, design_poses
from calibench.calibration.rigid import Array
from calibench.calibration.start import HowRead
from calibench.core.options import coerce, read_option

_MOST = 200  # poses
_KEYS = {
    "machine": "arm", "machine.urdf": "my.urdf", "machine.dh": "my_table.csv", "machine.convention": "standard",
    "machine.tip": "tool0", "machine.base": "base_link",
    "machine.observe": "position", "data": "my.csv", "columns": '{"x":"Weg X"}', "units": "x1:mm", "rotation": "rpy",
    "plan.n": "20", "plan.by": "D", "plan.sigma": "0.05", "plan.sigma_rotation": "0.0005", "plan.target": "[0,100,100]",
    "plan.limits": "data", "plan.box": "[300,900,-500,500,0,800]", "plan.seed": "0", "plan.to": "poses.csv",
}  # fmt: skip


def asks_for_poses(words: Sequence[str]) -> bool:
    """Return whether `bench design` is asked which poses of an arm to measure."""
    asked = any(word.startswith("plan.n=") for word in words)
    others = any(word.startswith(("plan=", "data=")) for word in words)
    return "machine=arm" in words and (asked or not others)


def read_design_poses(words: Sequence[str]) -> tuple[Design, Path | None]:
    """Return the poses that `words` ask for, and the file they go to. Raises `ValueError`, in one line."""
    given = read_pairs("design plan.n=", words, _KEYS)
    if "plan.n" not in given:
        raise RequestError(
            "plan.n= is missing: how many poses to propose, such as plan.n=12; data=FILE alone tells what these "
            "readings could show"
        )
    count = read_option("plan.n", given["plan.n"], int)
    if not 1 <= count <= _MOST:
        raise RequestError(f"plan.n={count}: from 1 to {_MOST} poses are needed")
    observe = given.get("machine.observe", "")
    if observe and observe not in ("position", "pose"):
        raise RequestError(
            f"machine.observe={observe}: poses are proposed for position|pose; with a ball in sockets take as many "
            "postures as the arm can reach in each, and places far apart"
        )
    urdf, dh, convention = (given.get(f"machine.{key}", "") for key in ("urdf", "dh", "convention"))
    check_description(urdf, dh, convention, given, "machine.")
    if not urdf and not dh:
        raise RequestError(
            "machine.urdf= is missing: the arm's description, such as machine.urdf=my.urdf, or machine.dh=table.csv "
            "where it has a table of joints"
        )
    arm = read_arm(
        Path(dh or urdf), table=bool(dh), convention=convention, base=given.get("machine.base", ""),
        tip=given.get("machine.tip", ""),
    )  # fmt: skip
    start = None
    if "data" in given:
        stated: dict[str, Any] = {key: pairs_of(key, given[key]) for key in ("columns", "units") if key in given}
        start = HowRead(observe, given.get("rotation", ""), limits=True).start(
            read_table(given["data"], stated), arm.chain
        )
    to = Path(given["plan.to"]).expanduser() if "plan.to" in given else None
    if to is not None and not to.parent.is_dir():
        raise RequestError(f"plan.to={to}: there is no folder {to.parent}")
    design = design_poses(
        arm, count, start=start, by=coerce("plan.by", given.get("plan.by", "D"), By),
        sigma=_noise(given, "plan.sigma", "mm"), sigma_rotation=_noise(given, "plan.sigma_rotation", "rad"),
        rotations=observe == "pose",
        target=read_option("plan.target", given.get("plan.target", "[0,100,100]"), tuple[float, float, float]),
        limits=coerce("plan.limits", given["plan.limits"], Limits) if "plan.limits" in given else None,
        box=_box(given), seed=read_option("plan.seed", given.get("plan.seed", "0"), int),
    )  # fmt: skip
    return design, to


def _noise(given: Mapping[str, str], key: str, unit: str) -> float | None:
    """Return the noise of a reading to come, as it is stated; None where it is not."""
    if key not in given:
        return None
    noise: float = read_option(key, given[key], float)
    if noise <= 0:
        raise RequestError(f"{key}={noise:g}: the noise of a reading [{unit}], above 0, is needed")
    return noise


def _box(given: Mapping[str, str]) -> Array | None:
    if "plan.box" not in given:
        return None
    box = np.array(read_option("plan.box", given["plan.box"], tuple[float, ...]))
    if box.shape != (6,) or (box[::2] >= box[1::2]).any():
        raise RequestError(
            f"plan.box={given['plan.box']}: x0,x1,y0,y1,z0,z1 [mm] in the base, each pair rising, is needed"
        )
    return np.asarray(box.reshape(3, 2))
