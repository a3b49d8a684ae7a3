"""`bench design machine=arm plan.n=N`: from the request to the poses whose measurement is worth most for this arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, final

import numpy as np

from calibench.bench.calibration.carries import at, stops
from calibench.bench.calibration.files import read_table
from calibench.bench.calibration.fit import Fit, determined, fitted, is_length, order_of
from calibench.bench.calibration.model import ArmModel, model_of
from calibench.bench.calibration.poses import By, Chosen, chosen_poses
from calibench.bench.calibration.readings import Index, read_readings
from calibench.bench.calibration.request import check_description
from calibench.bench.calibration.start import started
from calibench.bench.measured.files import pairs_of
from calibench.bench.sweep.words import RequestError, read_pairs
from calibench.core.options import coerce, read_option
from calibench.problems.arm.chains.chain import Chain, ChainJoint
from calibench.problems.arm.chains.dh_arm import DhArm
from calibench.problems.arm.chains.dh_file import read_dh
from calibench.problems.arm.chains.dh_table import DhTable
from calibench.problems.arm.chains.kinematics import forward, nominal
from calibench.problems.arm.chains.urdf import read_urdf
from calibench.problems.base import Array

_POOL, _WORKSPACE = 600, 200  # random poses: to choose from, and to compute the arm's error over
_MOST = 200
_NOT_KNOWN = "collisions and the line of sight are not known here: leave out what cannot be reached"
_SLIDE = 1000.0  # mm to each side, of a joint that slides without limits
Limits = Literal["urdf", "table", "data"]
_KEYS = {
    "machine": "arm", "machine.urdf": "my.urdf", "machine.dh": "my_table.csv", "machine.convention": "standard",
    "machine.tip": "tool0", "machine.base": "base_link",
    "machine.observe": "position", "data": "my.csv", "columns": '{"x":"Weg X"}', "units": "x1:mm", "rotation": "rpy",
    "plan.n": "20", "plan.by": "D", "plan.sigma": "0.05", "plan.sigma_rotation": "0.0005", "plan.target": "[0,100,100]",
    "plan.limits": "data", "plan.box": "[300,900,-500,500,0,800]", "plan.seed": "0", "plan.to": "poses.csv",
}  # fmt: skip


@final
@dataclass(frozen=True, eq=False)
class Planned:
    """Poses to measure: `joints` (n, j), where the target is then (n, 3) [mm] in the base, and what they are worth."""

    chain: Chain
    joints: Array
    target: Array
    chosen: Chosen
    sigma: float
    measured: int
    numbers: int
    limits: str
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "schema_version": 1,
            "machine": "arm",
            "joints": list(self.chain.driven),
            "poses": self.joints.tolist(),
            "target": self.target.tolist(),
            "measured": self.measured,
            "numbers": self.numbers,
            "error_mm": self.chosen.error.tolist(),
            "enough": self.chosen.enough(self.sigma),
            "logdet": self.chosen.logdet,
            "least_eigenvalue": self.chosen.least,
            "sigma_mm": self.sigma,
            "limits": self.limits,
            "notes": list(self.notes),
        }


def asks_for_poses(words: Sequence[str]) -> bool:
    """Return whether `bench design` is asked which poses of an arm to measure."""
    asked = any(word.startswith("plan.n=") for word in words)
    others = any(word.startswith(("plan=", "data=")) for word in words)
    return "machine=arm" in words and (asked or not others)


def planned(words: Sequence[str]) -> tuple[Planned, Path | None]:
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
    chain, table = _described(given)
    rng = np.random.default_rng(np.random.SeedSequence([read_option("plan.seed", given.get("plan.seed", "0"), int), 7]))
    fit, notes = _measured(given, chain, table, observe) if "data" in given else (None, ())
    usual = (0.05, 0.0005) if fit is None else fit.model.sigma
    sigma = _noise(given, "plan.sigma", usual[0], "mm")
    turned = _noise(given, "plan.sigma_rotation", usual[1], "rad")
    limits = coerce("plan.limits", given.get("plan.limits", "urdf" if fit is None else "data"), Limits)
    if limits == "data" and fit is None:
        raise RequestError("plan.limits=data: goes with data=FILE, whose joints' ranges are kept to")
    pool = _random(chain, fit, limits, rng, _POOL + _WORKSPACE, _box(given))
    model, p = _model(given, chain, table, fit, observe, sigma, turned)
    rows, kept = _rows(model, p, pool, fit)
    scale = np.array([1.0 if is_length(model.names[k], model.sliding) else 1e-3 for k in kept])
    joints = np.array([not model.names[k].startswith(("base_", "tool_")) for k in kept])
    before = np.zeros((len(kept), len(kept)))
    if fit is not None:
        measured = _whitened(fit.model, p, fit.model.joints, kept) * scale  # by the noise that they have shown
        good = measured[~fit.wild].reshape(-1, len(kept))
        before = good.T @ good
    workspace = _whitened(model, p, pool[_POOL:], kept)[:, :3] * scale * sigma * joints
    chosen = chosen_poses(
        rows[:_POOL] * scale, before, workspace, count, coerce("plan.by", given.get("plan.by", "D"), By)
    )
    taken = pool[list(chosen.places)]
    target = forward(chain.placed(np.eye(4), model.chain.tool), nominal(chain), taken)[:, :3, 3]
    to = Path(given["plan.to"]).expanduser() if "plan.to" in given else None
    if to is not None and not to.parent.is_dir():
        raise RequestError(f"plan.to={to}: there is no folder {to.parent}")
    return Planned(
        chain, taken, target, chosen, sigma, 0 if fit is None else int((~fit.wild).sum()), int(joints.sum()),
        _source(chain, limits),
        (*notes, *_without_stops(chain, limits), _NOT_KNOWN),
    ), to  # fmt: skip


def _noise(given: Mapping[str, str], key: str, usual: float, unit: str) -> float:
    """Return the noise of a reading to come, as it is stated, or the usual one."""
    found = read_option(key, given[key], float) if key in given else usual
    if found <= 0:
        raise RequestError(f"{key}={found:g}: the noise of a reading [{unit}], above 0, is needed")
    return found


def _without_stops(chain: Chain, limits: Limits) -> list[str]:
    """Return a remark on joints that turn or slide without limits in the URDF."""
    open_ = [joint for joint in chain.joints if _is_open(joint) and joint.mimic is None]
    if limits == "data" or not open_:
        return []
    wide = {"±180°" if joint.kind == "rotary" else "±1 m": None for joint in open_}
    return [f"{', '.join(j.name for j in open_)}: no limits in the {chain.told}, {' and '.join(wide)} are taken"]


def _is_open(joint: ChainJoint) -> bool:
    return not np.isfinite(joint.upper - joint.lower)


def _source(chain: Chain, limits: Limits) -> str:
    """Return what the limits are those of: data, urdf, table, or none where no joint has any."""
    if limits == "data":
        return "data"
    return "none" if all(map(_is_open, chain.joints)) else chain.told.lower()


def _described(given: Mapping[str, str]) -> tuple[Chain, DhTable | None]:
    """Return the chain of the URDF or of the table, and the table."""
    urdf, dh, convention = (given.get(f"machine.{key}", "") for key in ("urdf", "dh", "convention"))
    check_description(urdf, dh, convention, given, "machine.")
    if dh:
        table = read_dh(dh, convention, "machine.")
        return table.chain, table
    if not urdf:
        raise RequestError(
            "machine.urdf= is missing: the arm's description, such as machine.urdf=my.urdf, or machine.dh=table.csv "
            "where it has a table of joints"
        )
    return read_urdf(urdf, "machine.").chain(given.get("machine.base", ""), given.get("machine.tip", "")), None


def _measured(
    given: Mapping[str, str], chain: Chain, table: DhTable | None, observe: str
) -> tuple[Fit, tuple[str, ...]]:
    """Return the calibration of what has been measured, to which poses are added."""
    stated = {key: pairs_of(key, given[key]) for key in ("columns", "units") if key in given}
    start = started(read_readings(read_table(given["data"], stated), chain, observe), chain, given.get("rotation", ""))
    if start.readings.position is None:
        raise RequestError("data=: holds a ball in sockets; poses are proposed for a measured position or pose")
    model = model_of(chain, start.readings, start.base, start.tool, table=table)
    return fitted(model, order_of(model.names, "geometry", model.sliding)), start.readings.notes


def _model(
    given: Mapping[str, str],
    chain: Chain,
    table: DhTable | None,
    fit: Fit | None,
    observe: str,
    sigma: float,
    turned: float,
) -> tuple[ArmModel, Array]:
    """Return a model with the observations of the measurement to come, and the parameters at which it is linearised."""
    if fit is not None:
        return replace(fit.model, sigma=(sigma, turned)), fit.p
    target = read_option("plan.target", given.get("plan.target", "[0,100,100]"), tuple[float, float, float])
    tool = np.eye(4)
    tool[:3, 3] = target
    turns = np.zeros((0, 3, 3)) if observe == "pose" else None
    none = np.zeros(0, dtype=int)
    empty = np.zeros((0, len(chain.driven)))
    placed = chain.placed(np.eye(4), chain.tool @ tool)
    rows = None if table is None else DhArm(table, placed.mount, placed.tool)
    model = ArmModel(placed, empty, np.zeros((0, 3)), turns, none, none, (sigma, turned), rows=rows)
    return model, model.start


def _rows(model: ArmModel, p: Array, pool: Array, fit: Fit | None) -> tuple[Array, Index]:
    """Return the whitened Jacobian of the pool, (m, c, k), and the parameters that its columns belong to."""
    if fit is not None:
        return _whitened(model, p, pool, fit.kept), fit.kept
    there = at(model, pool)
    kept = determined(there, p, order_of(model.names, "geometry", model.sliding), np.ones(len(pool)))
    return _whitened(model, p, pool, kept), kept


def _whitened(model: ArmModel, p: Array, joints: Array, kept: Index) -> Array:
    return at(model, joints).jacobian(p, kept, np.ones(len(joints)))[0]


def _random(
    chain: Chain, fit: Fit | None, limits: Limits, rng: np.random.Generator, count: int, box: Array | None
) -> Array:
    """Return random poses inside the joints' limits, (count, j), whose tip lies in `box` where one is stated."""
    low, high = stops(chain)
    endless = ~np.isfinite(high - low)
    low[endless], high[endless] = np.maximum(low[endless], -_SLIDE), np.minimum(high[endless], _SLIDE)
    if limits == "data" and fit is not None:
        low, high = fit.model.joints.min(axis=0), fit.model.joints.max(axis=0)
    found = np.empty((0, len(low)))
    for _ in range(200):
        tried = low + (high - low) * rng.random((count, len(low)))
        if box is not None:
            tip = forward(chain, nominal(chain), tried)[:, :3, 3]
            tried = tried[((tip >= box[:, 0]) & (tip <= box[:, 1])).all(axis=1)]
        found = np.vstack([found, tried])
        if len(found) >= count:
            return found[:count]
    raise RequestError("plan.box=: hardly any pose of the arm has its tip inside; x0,x1,y0,y1,z0,z1 [mm] in the base")


def _box(given: Mapping[str, str]) -> Array | None:
    if "plan.box" not in given:
        return None
    box = np.array(read_option("plan.box", given["plan.box"], tuple[float, ...]))
    if box.shape != (6,) or (box[::2] >= box[1::2]).any():
        raise RequestError(
            f"plan.box={given['plan.box']}: x0,x1,y0,y1,z0,z1 [mm] in the base, each pair rising, is needed"
        )
    return np.asarray(box.reshape(3, 2))
