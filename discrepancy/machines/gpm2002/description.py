"""What the GPM2002 declares for files, commands and pages: columns, words, what may be stated, plans, what ships.

What happens on the way of a plan is stated here, not known: each pose is approached from the one before, at 50 mm/s; a
force of 20 N pulls towards a direction that differs from pose to pose, and the legs share it by least squares; the
machine warms by 6 K, and halfway to that in a quarter of the run.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.discrepancy.machines.gpm2002.formulation import LEGS
from calibench.discrepancy.model.machine import Completed, Description, Formulation, Quantities, Quantity, Stated
from calibench.discrepancy.model.measured import DataError, MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.registries import describe
from calibench.problems.base import Array
from calibench.problems.planar.gpm2002 import NAMES, PlanName, home, makers_machine, plan_points

_MOST_READINGS = 100_000  # of a plan: each is a row of every matrix of the search
_FARTHEST = 1e6  # mm
_SPEED, _FORCE, _WARMING, _PAUSE = 50.0, 20.0, 6.0, 4.0  # mm/s, N, K, s


def planned(
    plan: PlanName = "disc", n: int = 60, radius: float = 120.0, seed: int = 0, visits: int = 2, repeats: int = 2,
    tracked: bool = False, without: Sequence[str] = (), sigma_enc: float = 5e-5, sigma_xy: float = 0.02,
    machine: Mapping[str, float] | None = None, tooth_numbers: Sequence[int] = (40, 48, 56),
    branches: Sequence[float] = (1.0, 1.0, 1.0),
) -> MeasuredData:  # fmt: skip
    """Return the noiseless readings of `n` poses, each visited `visits` times and read `repeats` times.

    `without` leaves columns out, by name or by kind (`vel` for `vel_1..3`); `machine` changes numbers of the maker's;
    `branches` are the signs of the elbows.
    Raises `DataError` for a pose out of reach or more readings than can be planned, `ValueError` for a plan that n
    points cannot make.
    """
    if not min(n, visits, repeats) >= 1 or n * visits * repeats > _MOST_READINGS:
        raise DataError(
            f"plan.n={n}, visits={visits}, repeats={repeats}: 1 or more each and, multiplied, at most {_MOST_READINGS} "
            "readings can be planned"
        )
    if len(branches) != len(LEGS):
        raise DataError(f"plan.branches={list(branches)}: a sign for each of the {len(LEGS)} elbows is needed")
    if seed < 0:
        raise DataError(f"plan.seed={seed}: must be 0 or above")
    for name, value in (machine or {}).items():
        if not abs(value) <= _FARTHEST:
            raise DataError(f"plan.machine: {name}={value:g}: at most {_FARTHEST:g} mm can be meant")
    rng = np.random.default_rng(seed)
    q: dict[str, Any] = dict(zip(NAMES, makers_machine().tolist())) | dict(machine or {})
    points = plan_points(plan, home(), radius, n, rng)
    order = np.concatenate([rng.permutation(n) for _ in range(visits)])
    columns = {**_met(q, points[order], branches, rng), "pose_id": order, "visit_id": np.arange(visits * n)}
    bad = np.flatnonzero(~np.isfinite(columns["enc_1"] + columns["enc_2"] + columns["enc_3"]))
    if len(bad):
        x, y = points[order][bad[0]]
        raise DataError(f"plan={plan}: ({x:.0f}, {y:.0f}) mm is out of reach; choose a radius below {radius:g}")
    columns = {name: np.repeat(column, repeats) for name, column in columns.items()}
    columns["repeat"] = np.tile(np.arange(repeats), visits * n)
    columns["t_s"] = columns["t_s"] + 0.25 * _PAUSE * columns["repeat"]
    gone = [*without, *(() if tracked else ("x", "y"))]
    kept = {name: v for name, v in columns.items() if name not in gone and name.rpartition("_")[0] not in gone}
    metadata = {"machine": "gpm2002", "sigma_enc": sigma_enc, "sigma_xy": sigma_xy, "nominal": q}
    if "tooth_numbers" not in without:
        metadata["tooth_numbers"] = list(tooth_numbers)
    return MeasuredData(kept, "gpm2002", metadata, f"{plan} of {n} poses")


def _met(
    q: Mapping[str, Any], points: Array, branches: Sequence[float], rng: np.random.Generator
) -> dict[str, NDArray[Any]]:
    """Return the columns of one reading at each of `points`, (n, 2), mm, visited in that order by the machine `q`."""
    n = len(points)
    way = np.diff(points, axis=0, prepend=home()[None])
    heading = np.arctan2(way[:, 1], way[:, 0])
    velocity = _SPEED * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    turn = 2 * np.pi * rng.random(n)
    force = _FORCE * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    angle, along, arm = np.empty((n, 3)), np.empty((n, 3, 2)), np.empty((n, 3, 2))
    for k, i in enumerate(LEGS):
        dx, dy, la, lb = points[:, 0] - q[f"xa{i}"], points[:, 1] - q[f"ya{i}"], q[f"la{i}"], q[f"lb{i}"]
        reach = np.hypot(dx, dy)
        with np.errstate(invalid="ignore"):
            cosine = (la**2 + reach**2 - lb**2) / (2 * la * reach)
            theta = np.asarray(np.arctan2(dy, dx) + branches[k] * np.arccos(cosine))
        angle[:, k] = theta - q[f"z{i}"]
        arm[:, k] = q[f"la{i}"] * np.stack([-np.sin(theta), np.cos(theta)], axis=1)  # the elbow's way per radian
        elbow = np.stack([q[f"xa{i}"] + q[f"la{i}"] * np.cos(theta), q[f"ya{i}"] + q[f"la{i}"] * np.sin(theta)], axis=1)
        along[:, k] = (points - elbow) / q[f"lb{i}"]
    lever = (along * arm).sum(axis=2)  # the distal link's pull on the drive, mm
    rate = (along @ velocity[:, :, None])[:, :, 0] / lever
    share = np.linalg.inv(np.nan_to_num(np.einsum("nki,nkj->nij", along, along)) + 1e-12 * np.eye(2))
    axial = np.einsum("nki,nij,nj->nk", along, share, force)  # least squares: the legs pull against the force
    t = _PAUSE * np.arange(n)
    columns: dict[str, NDArray[Any]] = {"t_s": t, "x": points[:, 0], "y": points[:, 1]}
    columns |= {"load_x": force[:, 0], "load_y": force[:, 1], "speed": np.full(n, _SPEED), "heading": heading}
    columns["temp_K"] = _WARMING * (1 - 0.5 ** (4 * t / max(t[-1], 1.0)))
    for k, i in enumerate(LEGS):
        columns |= {f"enc_{i}": angle[:, k], f"vel_{i}": rate[:, k], f"dir_{i}": np.sign(rate[:, k])}
        columns |= {f"axial_{i}": axial[:, k], f"tau_{i}": axial[:, k] * lever[:, k]}
    return columns


def reachable(formulation: Formulation, q: Quantities, n: int = 300, seed: int = 0) -> MeasuredData:
    """Return about `n` readings that could be taken next, anywhere in reach around where the others were taken."""
    data, rng = formulation.data, np.random.default_rng(seed)
    x, y = formulation.covariates(q)["workspace"].values()
    middle = np.array([np.median(x), np.median(y)])
    far = 1.3 * float(np.hypot(x - middle[0], y - middle[1]).max())
    points = middle + far * plan_points("disc", np.zeros(2), 1.0, 2 * n, rng)
    signs = []  # of the legs' elbows, that most of the readings show
    for i in LEGS:
        theta = data[f"enc_{i}"] + q[f"z{i}"]
        turned = (middle[0] - q[f"xa{i}"]) * np.sin(theta) - (middle[1] - q[f"ya{i}"]) * np.cos(theta)
        signs.append(1.0 if np.median(turned) > 0 else -1.0)
    columns = _met({name: float(q[name]) for name in NAMES}, points, signs, rng)
    reached = np.flatnonzero(np.isfinite(np.sum([columns[f"enc_{i}"] for i in LEGS], axis=0)))[:n]
    if not len(reached):
        raise DataError(
            f"the machine, as these readings calibrate it, reaches no place within {far:.3g} mm of the middle of theirs"
        )
    columns = {name: column[reached] for name, column in columns.items() if name in data}
    if "temp_K" in columns:
        low, high = data["temp_K"].min(), data["temp_K"].max()
        columns["temp_K"] = rng.uniform(low, high + 0.2 * (high - low), len(reached))
    if "t_s" in columns:
        columns["t_s"] = columns["t_s"] - columns["t_s"].min() + data["t_s"].max() + _PAUSE
    for kind in ("load", "tau", "axial", "vel", "speed"):  # scaled to what was usual in the data
        there = [name for name in columns if name == kind or name.rpartition("_")[0] == kind]
        if there:
            usual, own = (np.sqrt(np.mean([np.square(of[c]).mean() for c in there])) for of in (data, columns))
            columns |= {name: columns[name] * (usual / own) for name in there}
    return MeasuredData(columns, data.machine, data.metadata, "reachable")


_SIGMA_XY = 0.02  # mm: a usual tracker
_OF_A_JOINT = {
    "vel": ("rad/s", "velocity"), "dir": ("", "direction"), "tau": ("N mm", "torque"), "axial": ("N", "axial force"),
}  # fmt: skip
_COLUMNS = (
    *(Quantity(f"enc_{i}", "rad", f"angle of joint {i}") for i in LEGS),
    *(
        Quantity(f"{kind}_{i}", unit, f"{words} of joint {i}", f"leg {i}")
        for kind, (unit, words) in _OF_A_JOINT.items() for i in LEGS
    ),
    Quantity("t_s", "s", "time"),
    Quantity("x", "mm"),
    Quantity("y", "mm"),
    Quantity("load_x", "N", "load along x"),
    Quantity("load_y", "N", "load along y"),
    Quantity("temp_K", "K", "temperature above reference"),
    Quantity("speed", "mm/s"),
    Quantity("heading", "rad"),
    *(Quantity(name) for name in ("pose_id", "visit_id", "repeat")),
    Quantity("split", text=True),
)  # fmt: skip
_WORDS = {
    "la": "proximal link", "lb": "distal link", "xa": "x of base", "ya": "y of base", "z": "encoder zero of joint",
}  # fmt: skip
_PARAMETERS = tuple(
    Quantity(f"{kind}{i}", "rad" if kind == "z" else "mm", f"{words} {i}")
    for kind, words in _WORDS.items()
    for i in LEGS
)


def with_tracker(formulation: Formulation, data: MeasuredData, parameters: Mapping[str, float]) -> Completed | None:
    """Return the data as an external tracker in the same run would complete them; None where there is one."""
    if data.has("x", "y"):
        return None
    there = formulation.on(data)
    q, _ = Model(there).quantities(np.array([parameters[p.name] for p in there.parameters]))
    place = there.covariates(q)["workspace"]
    x, y = (np.real(np.asarray(place[name], dtype=complex)) for name in ("x", "y"))
    nominal = {**dict(data.metadata.get("nominal", {})), **parameters}
    tracked = replace(
        data.with_columns({"x": x, "y": y}), metadata={**data.metadata, "sigma_xy": _SIGMA_XY, "nominal": nominal}
    )
    return Completed(tracked, f"an external tracker in the same run (x, y to {_SIGMA_XY:g} mm)")


describe(
    "gpm2002",
    Description(
        columns=_COLUMNS,
        quantities=_PARAMETERS,
        stated=(
            Stated("sigma_enc", "positive"),
            Stated("sigma_xy", "positive"),
            Stated("encoder_lsb", "positive"),
            Stated("tooth_numbers", "list", "tooth_numbers=[40,48,56]"),
            Stated("fixed_parameters"),
            Stated("nominal", "names", 'nominal={"la1":244}'),
        ),
        helpful=("x", "y"),
        orders={"speed": "velocity", "heading": "velocity"},
        plan=planned,
        pool=reachable,
        completed=with_tracker,
        targets={"tracker": ""},
        read_from=(*(f"enc_{i}" for i in LEGS), "x", "y"),
        general=False,  # its list is the one whose rates stand in docs/discovery-statistics.md
    ),
)
