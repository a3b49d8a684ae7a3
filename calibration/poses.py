"""Which poses to measure next, when more poses no longer help, and how far a calibration carries beyond its poses.

The value of a pose is what it adds to the information, in units of usual errors (1 mm, 1 mrad). Poses are chosen
greedily, then exchanged (Fedorov 1972), for the determinant (D) or the least eigenvalue (E). What is told badly counts
as off by `OFF`.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, final

import numpy as np

from calibench.calibration.arm import Arm
from calibench.calibration.determined import information_of, is_length, order_of, select_determined
from calibench.calibration.dh import DhArm
from calibench.calibration.fit import Fit, fit_arm
from calibench.calibration.kinematics import Chain, forward, nominal
from calibench.calibration.loci import PLANE
from calibench.calibration.model import ArmModel, model_of
from calibench.calibration.normal import normal_blocks, root_of
from calibench.calibration.rigid import Array, Index, Mask, shift
from calibench.calibration.start import Start
from calibench.calibration.walk import BASE, READING, TOOL, quantities, walk
from calibench.core.notes import Code, DataError, Note
from calibench.core.process import one_thread

By = Literal["D", "E"]
_PRIOR = 1e-4  # information [1 / unit^2] before any reading: a parameter is within 100 mm, 100 mrad
_PASSES = 6
_BETTER = 1e-6
_BEYOND = (2, 3, 5, 10, 20)  # times as many poses as are chosen
_PAYS = 3.0  # times below the scatter: with parameters so well known, more poses change nothing


@final
@dataclass(frozen=True, eq=False)
class Chosen:
    """`places` in the pool by value, `error` [mm] before any and after each, criteria D (`logdet`) and E (`least`).

    `beyond` has (poses, error) of more poses that are worth as much as these on average.
    """

    places: tuple[int, ...]
    error: Array
    logdet: float
    least: float
    beyond: tuple[tuple[int, float], ...] = ()

    @property
    def curve(self) -> tuple[tuple[int, float], ...]:
        """Return (poses, error [mm]) from none on."""
        return (*enumerate(self.error.tolist()), *self.beyond)

    def enough(self, sigma: float) -> int | None:
        """Return the number of poses after which the error is small relative to a scatter `sigma` [mm]."""
        return next((n for n, error in self.curve if error <= np.sqrt(3.0) * sigma / _PAYS), None)


def choose(
    pool: Array, before: Array, workspace: Array, count: int, by: By = "D", known: Array | float = _PRIOR
) -> Chosen:
    """Return `count` poses of a whitened `pool` (m, c, k), beside `before` (k, k), for `workspace` (w, 3, k) [mm].

    `known` is the information of numbers that nothing was read of, (k,), from which errors go down.
    """
    start = before + _PRIOR * np.eye(before.shape[0])
    places = _greedy(pool, start, count)

    # each is exchanged for the best of the pool, until nothing gets better
    information = start + sum(pool[place].T @ pool[place] for place in places)
    for _ in range(_PASSES):
        settled = list(places)
        for k, place in enumerate(places):
            rest = information - pool[place].T @ pool[place]
            if by == "D":
                worth = _gains(pool, rest)
            else:
                worth = np.asarray(np.linalg.eigvalsh(rest + pool.swapaxes(1, 2) @ pool)[:, 0])
            worth[[other for other in places if other != place]] = -np.inf
            best = int(np.argmax(worth))
            if best != place and worth[best] > worth[place] + _BETTER * (1 + abs(worth[place])):
                places[k] = best
                information = rest + pool[best].T @ pool[best]
        if places == settled:
            break

    def error_of(added: Array) -> float:
        inverse = np.linalg.inv(before + known * np.eye(len(before)) + added)
        return float(np.sqrt(np.einsum("wci,ij,wcj->w", workspace, inverse, workspace).mean()))

    ordered = _greedy(pool, start, count, places)
    gained = np.cumsum([np.zeros_like(before), *(pool[place].T @ pool[place] for place in ordered)], axis=0)
    design = start + gained[-1]
    return Chosen(
        tuple(ordered), np.array([error_of(added) for added in gained]), float(np.linalg.slogdet(design)[1]),
        float(np.linalg.eigvalsh(design)[0]),
        tuple((times * len(ordered), error_of(times * gained[-1])) for times in _BEYOND),
    )  # fmt: skip


def _greedy(pool: Array, start: Array, count: int, among: Sequence[int] | None = None) -> list[int]:
    information, places, free = start, [], list(range(len(pool)) if among is None else among)
    for _ in range(min(count, len(free))):
        gains = _gains(pool[free], information)
        best = free.pop(int(np.argmax(gains)))
        places.append(best)
        information = information + pool[best].T @ pool[best]
    return places


def _gains(rows: Array, information: Array) -> Array:
    """Return by how much each pose raises the logarithm of the determinant, (m,)."""
    inverse = np.linalg.inv(information)
    inner = np.eye(rows.shape[1]) + rows @ inverse @ rows.swapaxes(1, 2)
    return np.asarray(np.linalg.slogdet(inner)[1])


OFF = 0.5  # mm, or mrad: by as much a placement of an arm differs from its table
_DRAWN = 300  # drawn at random in each of the two ranges


def foretold(fit: Fit) -> tuple[float, float]:
    """Return the standard error of the target's place [mm], rms over poses within the ranges read, and all limits."""
    model, p, distinct = fit.model, fit.p, fit.kept
    rows = root_of(normal_blocks(model, p, distinct, fit.weights).gram[0])
    unsure = np.sqrt(information_of(replace(model, tolerance=min(OFF, model.tolerance)))[distinct])
    triangle = np.asarray(np.linalg.qr(np.vstack([rows, np.diag(unsure)]), mode="r"))
    rng, errors_of = np.random.default_rng(0), []
    for low, high in ranges(model):
        joints = low + (high - low) * rng.random((_DRAWN, len(low)))
        slopes = at_joints(model, joints).jacobian(p, distinct, np.ones(_DRAWN))[0][:, :3] * model.sigma[0]
        errors = np.linalg.solve(triangle.T, slopes.reshape(-1, len(distinct)).T)
        errors_of.append(float(np.sqrt((errors**2).sum() / _DRAWN)))
    return errors_of[0], errors_of[1]


def ranges(model: ArmModel) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return the lowest and the highest value of each joint among the poses that were read, and by its limits."""
    low, high = model.joints.min(axis=0), model.joints.max(axis=0)
    lower, upper = stops(model.chain)
    ends = np.isfinite(upper - lower)
    return (low, high), (np.where(ends, np.minimum(low, lower), low), np.where(ends, np.maximum(high, upper), high))


def stops(chain: Chain) -> tuple[Array, Array]:
    """Return the limits of each joint [rad, mm], half a turn to each side at most; inf of a slide without."""
    there = {joint.name: joint for joint in chain.joints}
    low, high = np.empty(len(chain.driven)), np.empty(len(chain.driven))
    for k, name in enumerate(chain.driven):
        joint = there.get(name)
        edge = np.pi if joint is None or joint.kind == "rotary" else np.inf  # a turn to either side tells all
        low[k], high[k] = (-edge, edge) if joint is None else (max(-edge, joint.lower), min(edge, joint.upper))
    return low, high


def at_joints(model: ArmModel, joints: Array) -> ArmModel:
    """Return the model at other joints; the readings there do not affect its Jacobian."""
    poses = forward(model.chain, nominal(model.chain), joints)
    turns = None if model.turns is None else poses[:, :3, :3]
    none = np.full(len(joints), -1, dtype=np.int64)
    loci = None if model.loci is None else model.loci.points(len(joints))
    return replace(
        model, joints=joints, position=poses[:, :3, 3], turns=turns, socket=none, place=none, target=None, loci=loci,
        scatter=None, torque=None if model.torque is None else np.zeros_like(joints),
    )  # fmt: skip


_POOL, _WORKSPACE = 600, 200  # random poses: to choose from, and to compute the arm's error over
_SLIDE = 1000.0  # mm to each side, of a joint that slides without limits
_USUAL = (0.05, 0.0005)  # mm, rad: the noise of a reading where nothing tells it
Limits = Literal["urdf", "table", "data"]


@final
@dataclass(frozen=True)
class Gain:
    """What the written arm is off by after so many more `poses`, rms over the workspace [mm]: by its numbers alone,

    and `left_mm` with what no number explains, which a reading of a fresh pose shows.
    """

    poses: int
    error_mm: float
    left_mm: float


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Design:
    """Poses to measure: `joints` (n, j), where the target is then (n, 3) [mm] in the base, and what they are worth.

    `measured` poses were there before, `numbers` of the arm are determined, `sigma` [mm] is the noise of a reading,
    `limits` says whose they are: data, urdf, table, or none. `scatter` [mm] is what a fit left of a coordinate, or the
    noise where nothing was read: no number of poses brings less.
    """

    chain: Chain
    joints: Array
    target: Array
    chosen: Chosen
    sigma: float
    measured: int
    numbers: int
    limits: str
    scatter: float
    notes: tuple[Note, ...] = ()

    def __repr__(self) -> str:
        error = f"error {self.gain[0].error_mm:.3g} -> {self.chosen.error[-1]:.3g} mm over the workspace"
        return (
            f"<design of {len(self.joints)} poses beside {self.measured}, {self.numbers} numbers of the arm, {error}>"
        )

    @property
    def gain(self) -> tuple[Gain, ...]:
        """Return how many poses bring how much, from none on."""
        left = float(np.sqrt(3.0) * self.scatter)
        return tuple(Gain(n, error, float(np.hypot(error, left))) for n, error in self.chosen.curve)

    @property
    def targets(self) -> tuple[dict[str, float], ...]:
        """Return the poses as targets of joints by name, in the units of ROS: rad, and m of a joint that slides."""
        slides = {joint.name for joint in self.chain.joints if joint.kind == "sliding"}
        unit = [1e-3 if name in slides else 1.0 for name in self.chain.driven]
        return tuple(dict(zip(self.chain.driven, (pose * unit).tolist(), strict=True)) for pose in self.joints)

    def to_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "schema_version": 1, "machine": "arm", "joints": list(self.chain.driven), "poses": self.joints.tolist(),
            "targets": list(self.targets), "gain": [asdict(one) for one in self.gain], "scatter_mm": self.scatter,
            "target": self.target.tolist(), "measured": self.measured, "numbers": self.numbers,
            "error_mm": self.chosen.error.tolist(), "enough": self.chosen.enough(self.sigma),
            "logdet": self.chosen.logdet, "least_eigenvalue": self.chosen.least, "sigma_mm": self.sigma,
            "limits": self.limits, "notes": [note.to_dict() for note in self.notes],
        }  # fmt: skip


@one_thread()
def design_poses(
    arm: Arm, count: int, *, start: Start | None = None, by: By = "D", sigma: float | None = None,
    sigma_rotation: float | None = None, rotations: bool = False, target: Sequence[float] = (0.0, 100.0, 100.0),
    limits: Limits | None = None, box: Array | None = None, keep_out: Sequence[Array] = (), off: float = OFF,
    seed: int = 0,
) -> Design:  # fmt: skip
    """Return the `count` poses of `arm` that are worth most to measure, beside those of `start` where some were.

    `sigma` [mm] and `sigma_rotation` [rad] are the noise of a reading to come; None for the one that the readings have
    shown, or a usual one. Without readings the target sits at `target` [mm] on the tip, and with `rotations` its
    rotation is read as well. `limits` are those of the description, or the ranges of the data. The tip stays within
    `box`, (3, 2) [mm] in the base; joints, tip, target and the straight lines between them stay out of each box of
    `keep_out`. A number of the arm that nothing was read of is off by `off` [mm, mrad]. Raises `DataError` for what
    goes not together.
    """
    chain, table = arm.chain, arm.table
    rng = np.random.default_rng(np.random.SeedSequence([seed, 7]))
    fit, notes = None, tuple[Note, ...]()
    if start is not None:
        if start.readings.position is None:
            raise DataError("data=: holds a ball in sockets; poses are proposed for a measured position or pose")
        if (loci := start.readings.loci) is not None and (loci.kind == PLANE).any():
            raise DataError(
                "data=: holds planes that are touched, and of poses at large few touch them; none are proposed"
            )
        model = model_of(chain, start.readings, start.base, start.tool, table=table)
        fit, notes = fit_arm(model, order_of(model.names, "geometry", model.sliding)), start.readings.notes
        if fit.undetermined:
            raise DataError(fit.undetermined)
    shown = _USUAL if fit is None else fit.model.sigma
    noise = (shown[0] if sigma is None else sigma, shown[1] if sigma_rotation is None else sigma_rotation)
    limits = limits or ("urdf" if fit is None else "data")
    if limits == "data" and fit is None:
        raise DataError("plan.limits=data: goes with data=FILE, whose joints' ranges are kept to")
    on_tip = chain.tool @ shift(*target) if fit is None else fit.model.chain.tool
    pool = _random_poses(chain.placed(None, on_tip), fit if limits == "data" else None, rng, box, keep_out)
    if fit is not None:
        model, p, kept = replace(fit.model, sigma=noise), fit.p, fit.kept
    else:
        nothing, placed = np.zeros(0, dtype=np.int64), chain.placed(np.eye(4), on_tip)
        model = ArmModel(  # with the observations of a measurement to come
            chain=placed, joints=np.empty((0, len(chain.driven))), position=np.zeros((0, 3)),
            turns=np.zeros((0, 3, 3)) if rotations else None, socket=nothing, place=nothing, sigma=noise,
            rows=None if table is None else DhArm(table, placed.mount, placed.tool),
        )  # fmt: skip
        p, there = model.start, at_joints(model, pool)
        kept = select_determined(there, p, order_of(model.names, "geometry", model.sliding), np.ones(len(pool)))
    scale = np.array([1.0 if is_length(model.names[k], model.sliding) else 1e-3 for k in kept])
    of_joints = np.array([not model.names[k].startswith(("base_", "tool_")) for k in kept])
    before = np.zeros((len(kept), len(kept)))
    if fit is not None:
        measured = fit.model.jacobian(p, kept, fit.weights)[0] * scale  # by the noise that they have shown
        good = measured[~fit.wild].reshape(-1, len(kept))
        before = good.T @ good
    rows = _as_read(model, p, pool, kept)
    workspace = at_joints(model, pool[_POOL:]).jacobian(p, kept, np.ones(len(pool) - _POOL))[0][:, :3]
    workspace = workspace * scale * noise[0] * of_joints
    chosen = choose(rows[:_POOL] * scale, before, workspace, count, by, np.where(of_joints, 1 / off**2, _PRIOR))
    joints = pool[list(chosen.places)]
    endless = [joint for joint in chain.joints if not np.isfinite(joint.upper - joint.lower)]
    more = []
    if limits != "data" and (open_ := [joint for joint in endless if joint.mimic is None]):
        wide = {"±180°" if joint.kind == "rotary" else "±1 m": None for joint in open_}
        names = [joint.name for joint in open_]
        text = f"{', '.join(names)}: no limits in the {chain.source}, {' and '.join(wide)} are taken"
        more.append(Note(Code.NO_LIMITS, text, values={"joints": names}))
    known = "what stands outside keep_out, how thick the arm is" if len(keep_out) else "collisions"
    text = f"{known} and the line of sight are not known here: leave out what cannot be reached"
    more.append(Note(Code.NOT_CHECKED, text))
    return Design(
        chain=chain, joints=joints,
        target=forward(chain.placed(np.eye(4), model.chain.tool), nominal(chain), joints)[:, :3, 3], chosen=chosen,
        sigma=noise[0], scatter=noise[0] if fit is None else shown[0],
        measured=0 if fit is None else int((~fit.wild).sum()), numbers=int(of_joints.sum()),
        limits="data" if limits == "data" else "none" if len(endless) == len(chain.joints) else chain.source.lower(),
        notes=(*notes, *more),
    )  # fmt: skip


def _as_read(model: ArmModel, p: Array, joints: Array, kept: Index) -> Array:
    """Return the whitened slopes of poses to come, (n, c, k), each read in all ways in which poses were read."""
    there, rows = at_joints(model, joints), []
    if (loci := model.loci) is None:
        return there.jacobian(p, kept, np.ones(len(joints)))[0]
    assert model.position is not None
    assert there.position is not None
    for k in np.unique(loci.fixture):
        axes = np.isfinite(model.position[loci.fixture == k]).any(axis=0)
        way = replace(
            there, position=np.where(axes, there.position, np.nan),
            loci=replace(loci.points(len(joints)), fixture=np.full(len(joints), k)),
            scatter=np.full(len(joints), float(np.median(model.of_rows[loci.fixture == k])) / model.sigma[0]),
        )  # fmt: skip
        rows.append(way.jacobian(p, kept, np.ones(len(joints)))[0])
    return np.concatenate(rows, axis=1)


def _random_poses(
    chain: Chain, fit: Fit | None, rng: np.random.Generator, box: Array | None, keep_out: Sequence[Array]
) -> Array:
    """Return random poses inside the limits, or the ranges of `fit`, (count, j): in the box, out of the others."""
    count, (low, high) = _POOL + _WORKSPACE, stops(chain)
    endless = ~np.isfinite(high - low)
    low[endless], high[endless] = np.maximum(low[endless], -_SLIDE), np.minimum(high[endless], _SLIDE)
    if fit is not None:
        low, high = fit.model.joints.min(axis=0), fit.model.joints.max(axis=0)
    poses = np.empty((0, len(low)))
    for _ in range(200):
        tried = low + (high - low) * rng.random((count, len(low)))
        if box is not None or len(keep_out):
            # joints, tip and target in the base, (n, J + 2, 3) [mm]
            q = {READING + name: tried[:, k] for k, name in enumerate(chain.driven)}
            way = walk(chain, np.eye(3), quantities(chain) | dict.fromkeys((*BASE, *TOOL), 0.0) | q)
            turn, at_tip = way.flange
            places = [*(place for _, place in way.frames), at_tip, at_tip + turn @ chain.tool[:3, 3]]
            along = np.stack([np.broadcast_to(place, at_tip.shape) for place in places], axis=1)
            good = np.ones(len(tried), dtype=bool)
            if box is not None:
                tip = along[:, -2]
                good &= ((tip >= box[:, 0]) & (tip <= box[:, 1])).all(axis=1)
            for one in keep_out:
                good &= ~_pass_through(along, one)
            tried = tried[good]
        poses = np.vstack([poses, tried])
        if len(poses) >= count:
            return poses[:count]
    if not len(keep_out):
        raise DataError("plan.box=: hardly any pose of the arm has its tip inside; x0,x1,y0,y1,z0,z1 [mm] in the base")
    inside = "" if box is None else " and the tip in plan.box="
    raise DataError(f"plan.keep_out=: hardly any pose of the arm stays out of it{inside}; make it smaller")


def _pass_through(along: Array, box: Array) -> Mask:
    """Return which polylines (n, m, 3) touch the `box`, (3, 2): a piece is in it where it is between all six faces."""
    first, way = along[:, :-1, :, None], np.diff(along, axis=1)[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.sort((box - first) / way, axis=-1)  # parts of the way at which the faces are met
    level = (way == 0)[..., 0]
    between = ((first >= box[:, :1]) & (first <= box[:, 1:]))[..., 0]
    into = np.where(level, np.where(between, -np.inf, np.inf), ends[..., 0]).max(axis=-1)
    out = np.where(level, np.where(between, np.inf, -np.inf), ends[..., 1]).min(axis=-1)
    return np.asarray((np.maximum(into, 0.0) <= np.minimum(out, 1.0)).any(axis=1))
