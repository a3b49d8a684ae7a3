"""Which parameters of an arm the readings determine: the rest is held at its nominal value.

A turn of a placement about the joint's own axis is the joint's zero; a shift along it may as well be made by the next
placement; the base's pose and the first joint's placement are one. So of 12 + 8 J parameters fewer than half are seen.
All rules here take parameters in an order of preference, and keep each if it moves the readings in a way that those
before it do not (`independent_columns`). Where two axes are parallel their common normal is anywhere, so a shift along
the axis tells nothing that the neighbour's does not, and a tilt does: what is kept there is Hayati's choice. (Hayati
1983; Everett, Driels and Mooring 1987 count 4 R + 2 P + 6 for poses.)

`gauge` decides before anything is fitted, at the nominal arm, without noise: for problems. `select_determined` and
`select_by_name` hold as well what the noise leaves unsure by more than `WORST` (`well_determined`): for calibrations,
whose order begins with the frames, then zeros, lengths, angles, so that a shift of a millimetre is not reported as some
degrees about a short link; and for searches, whose numbers have names.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from calibench.calibration import compared as of
from calibench.calibration.compared import Compared, constants
from calibench.calibration.kinematics import PLACEMENT, Chain, nominal, parameter_names, parameter_units
from calibench.calibration.model import ArmModel, stacked, stacked_residuals
from calibench.calibration.rigid import Array, Index

_ROUNDING = 1e-9  # of the largest column
MIDDLE = 0.6745  # of a standard deviation: the median of |noise|
WORST = 2.0  # mm, or mrad: a number that readings tell with a larger standard error keeps its nominal value
DISTINCT = 0.02  # sine of the angle to what is kept already: below it a parameter is called seen by those

ALIKE = 5e-3  # part of a column: less than this beside the others may only come from the arm's other errors
LEVELS = ("frames", "zeros", "geometry", "gains")
_RANK = {
    "base": 0, "tool": 1, "zero": 2, "x": 3, "y": 3, "z": 5, "rx": 4, "ry": 4, "rz": 6, "gain": 7,
    "theta": 2, "a": 3, "alpha": 4, "beta": 5, "d": 6,
}  # fmt: skip  # of a URDF, and of a table
_OF_SLIDING = {"d": 2, "theta": 4}  # the zero of a joint that slides is a length
_PLACES = {f"{frame}_{axis}" for frame in ("base", "tool") for axis in "xyz"}
_UP_TO = {"frames": 1, "zeros": 2, "geometry": 6, "gains": 7}


@final
@dataclass(frozen=True)
class Gauge:
    """The names kept, in the order of the parameter vector, and those held at their nominal values."""

    kept: tuple[str, ...]
    held: tuple[str, ...]


def gauge(chain: Chain, readings: Compared, among: Sequence[str] = (), distinct: float = DISTINCT) -> Gauge:
    """Return which of the parameters `among` (all but the gains) the readings determine at the nominal arm.

    Where nothing outside the arm was measured (sockets, distances, pairs) neither the base nor where the first joint
    stands is offered: they move all alike. Slopes at an arm that misses its sockets would not say so by themselves.
    """
    names, first = parameter_names(chain), chain.joints[0].name
    offered = [n for n in preferred(chain) if (n in among if among else not n.startswith("gain_"))]
    if not outside(readings):
        alike = {f"{one}_{first}" for one in (*PLACEMENT, "zero")} | {f"base_{one}" for one in PLACEMENT}
        offered = [n for n in offered if n not in alike]
    scaled = _slopes(chain, readings, offered)
    kept = {offered[k] for k in independent_columns(scaled, distinct)}
    return Gauge(tuple(n for n in names if n in kept), tuple(n for n in names if n not in kept))


def independent_columns(columns: Array, distinct: float) -> list[int]:
    """Return which of `columns`, (m, k), first come first kept, leave more than `distinct` of themselves beside
    those kept. A column that is nothing but rounding beside the largest is not kept.
    """
    basis = np.zeros((len(columns), 0))
    kept: list[int] = []
    sizes = np.linalg.norm(columns, axis=0)
    for k, (column, size) in enumerate(zip(columns.T, sizes, strict=True)):
        rest = column - basis @ (basis.T @ column)
        rest = rest - basis @ (basis.T @ rest)  # a second projection removes what rounding left
        length = np.linalg.norm(rest)
        if size <= _ROUNDING * sizes.max() or length <= distinct * size:
            continue
        basis = np.column_stack([basis, rest / length])
        kept.append(k)
    return kept


def well_determined(columns: Array, distinct: float, worst: Array, noise: float = 1.0) -> list[int]:
    """Return which of `columns`, (m, k), are independent and have numbers that rows with this `noise` tell well.

    While a standard error is above its `worst`, (k,), the column that is furthest above goes, which parts others again:
    to take them in their order of preference would keep a number that is told badly, and leave out all beside it.
    """
    kept = independent_columns(columns, distinct)
    while len(kept):
        over = noise * standard_errors(columns[:, kept]) / worst[kept]
        if over.max() <= 1.0:
            break
        kept.pop(int(np.argmax(over)))
    return kept


def standard_errors(columns: Array) -> Array:
    """Return the standard error of the number of each of independent `columns`, (m, k), where rows have noise of 1."""
    sizes = np.linalg.norm(columns, axis=0)
    return np.asarray(np.linalg.norm(np.linalg.inv(np.linalg.qr(columns / sizes, mode="r")), axis=1) / sizes)


def unexplained(columns: Array, residuals: Array) -> Array:
    """Return what `columns`, (m, k), leave of residuals (m,), as large as where they explained none of the noise."""
    sizes = np.linalg.norm(columns, axis=0)
    basis, weights, _ = np.linalg.svd(columns[:, sizes > 0] / sizes[sizes > 0], full_matrices=False)
    basis = basis[:, weights > _ROUNDING * weights.max(initial=0.0)]
    rest = residuals - basis @ (basis.T @ residuals)
    return np.asarray(rest * np.sqrt(len(rest) / max(len(rest) - basis.shape[1], 1)))


def preferred(chain: Chain) -> tuple[str, ...]:
    """Return all parameters in the order in which they are kept."""
    order = [f"{end}_{one}" for end in ("base", "tool") for one in ("x", "y", "z", "rx", "ry", "rz")]
    order += [f"zero_{joint.name}" for joint in chain.joints]
    across, along = [], []
    for joint in chain.joints:
        main = "xyz"[int(np.argmax(np.abs(joint.axis)))]
        rest = [c for c in "xyz" if c != main]
        across += [f"{c}_{joint.name}" for c in rest] + [f"r{c}_{joint.name}" for c in rest]
        along += [f"{main}_{joint.name}", f"r{main}_{joint.name}"]
    return (*order, *across, *along, *(f"gain_{joint.name}" for joint in chain.joints))


def observability(jacobian: Array) -> dict[str, float]:
    """Return the observability indices O1 to O5 of a Jacobian, (m, dim), with its columns in comparable units.

    With singular values s_1 >= .. >= s_L of m rows: O1 (s_1 .. s_L)^(1/L) / sqrt(m), O2 s_L / s_1, O3 s_L, O4 s_L^2 /
    s_1, O5 1 / (1/s_1 + .. + 1/s_L); larger is better. (Borm and Menq 1991; Driels and Pathre 1990; Nahvi et al. 1994;
    Nahvi and Hollerbach 1996; Sun and Hollerbach 2008.)
    """
    s = np.linalg.svd(jacobian, compute_uv=False)
    if not s[-1] > 0 or len(jacobian) < jacobian.shape[1]:
        return dict.fromkeys(("O1", "O2", "O3", "O4", "O5"), 0.0)
    return {
        "O1": float(np.exp(np.log(s).mean()) / np.sqrt(len(jacobian))),
        "O2": float(s[-1] / s[0]),
        "O3": float(s[-1]),
        "O4": float(s[-1] ** 2 / s[0]),
        "O5": float(1.0 / (1.0 / s).sum()),
    }


def _slopes(chain: Chain, readings: Compared, offered: Sequence[str]) -> Array:
    # here, as listing the problems must not load the compiler
    from calibench.calibration import _kernels as kernels

    names, units = parameter_names(chain), parameter_units(chain)
    free = np.array([names.index(n) for n in offered], dtype=np.int64)
    template = np.concatenate([nominal(chain), np.zeros(3 * len(readings.planes))])
    extra = np.arange(len(names), len(template))
    every = np.concatenate([free, extra])
    arguments = constants(chain, readings, template, every, np.inf)
    slopes = kernels.jacobian(template[every], *arguments)
    arm = max(reach(chain), 1.0)
    scale = np.array([1.0 if units[k] == "mm" else 1.0 / arm for k in free])
    seen = slopes[:, : len(free)] * scale
    if extra.size:  # a plane's tilt and height are nobody's business here: they take their part first
        taken = np.linalg.qr(slopes[:, len(free) :])[0]
        seen = seen - taken @ (taken.T @ seen)
    return np.asarray(seen)


def reach(chain: Chain) -> float:
    """Return about how far the arm reaches [mm]: what a turn of its placements is told apart by."""
    lengths = [np.linalg.norm(j.origin[:3, 3]) for j in chain.joints[1:]]
    return float(sum(lengths) + np.linalg.norm((chain.tail @ chain.tool)[:3, 3]))


def outside(readings: Compared) -> bool:
    """Tell whether anything was measured in a frame that does not move with the arm."""
    return bool(np.isin(readings.groups[:, 0], (of.POSITION, of.POSE, of.PLANE)).any())


def order_of(names: Sequence[str], level: str, sliding: Collection[str] = ()) -> list[int]:
    """Return which parameters a level frees, in the order in which similar ones are kept.

    `frames` are base and tool, which must be found even for a perfect arm; `zeros` are the joints' zeros beside them,
    `geometry` lengths and angles as well, `gains` the scale of each joint's reading too. Of a table's offsets d along
    axes that are parallel the last is kept, as Hayati and Mirmirani have it. `sliding` names the joints that slide.
    """
    ranks = []
    for k, name in enumerate(names):
        kind, _, joint = name.partition("_")
        rank = _OF_SLIDING.get(kind, _RANK[kind]) if joint in sliding else _RANK[kind]
        ranks.append((rank, -k if kind == "d" else k, k))
    return [k for rank, _, k in sorted(ranks) if rank <= _UP_TO[level]]


def select_determined(model: ArmModel, p: Array, order: Sequence[int], weights: Array, first: bool = False) -> Index:
    """Return which of the parameters in `order` the readings determine, as places in p, sorted.

    What all of `order` leave of the residuals gives the noise: far from the solution, residuals are what the parameters
    explain. `first` does not take the noise of the model for the least. Of a model with `every`, all of them. None
    where no number of the frames is told.
    """
    order = list(order)
    if model.every:
        return np.array(sorted(order), dtype=np.int64)
    rows = stacked(*model.jacobian(p, np.array(order, dtype=np.int64), weights), weights)
    residuals = stacked_residuals(*model.residuals(p, weights), weights)
    used = rows.any(axis=1)  # not the wild ones
    noise = float(np.median(np.abs(unexplained(rows[used], residuals[used])))) / MIDDLE
    noise = noise if first else max(1.0, noise)
    bounds = np.array([bound_of(model, place) for place in order])
    frames = np.array([model.names[place].startswith(("base_", "tool_")) for place in order])
    seats = independent_columns(rows[:, frames], ALIKE)
    errors = noise * standard_errors(rows[:, frames][:, seats])
    if (errors > bounds[frames][seats]).all():  # not even by themselves
        return np.zeros(0, dtype=np.int64)
    taken = well_determined(rows, ALIKE, np.where(frames, np.inf, bounds), noise)  # nobody states a frame
    return np.array(sorted(order[k] for k in taken), dtype=np.int64)


def distinct_of(model: ArmModel, p: Array, order: Sequence[int], weights: Array) -> Index:
    """Return which of the parameters in `order` the readings tell apart, however well, as places in p, sorted."""
    rows = stacked(*model.jacobian(p, np.array(order, dtype=np.int64), weights), weights)
    return np.array(sorted(order[k] for k in independent_columns(rows, ALIKE)), dtype=np.int64)


def bound_of(model: ArmModel, place: int) -> float:
    """Return the largest standard error of a number that is calibrated, in mm or rad."""
    return WORST if is_length(model.names[place], model.sliding) else 1e-3 * WORST


def is_length(name: str, sliding: Collection[str] = ()) -> bool:
    """Return whether a parameter is a length [mm], as the zero of a joint in `sliding` is, and no angle or gain."""
    kind, _, of = name.partition("_")
    return kind in ("x", "y", "z", "a", "d") or (of in sliding if kind == "zero" else name in _PLACES)


def is_gain(name: str) -> bool:
    """Return whether a parameter is the scale of a joint's reading."""
    return name.startswith("gain_")


def is_frame(name: str) -> bool:
    """Return whether a parameter places the base or the tool."""
    return name.startswith(("base_", "tool_"))


def select_by_name(
    slopes: Mapping[str, Array], order: Sequence[str], residuals: Array, units: Mapping[str, str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of `order` that are kept, and those that are held since the readings tell them too badly.

    `slopes` has name -> (n, m); `residuals` (n, m) are those of the nominal arm, which tell the noise; `units` has the
    unit of each number of a joint. Numbers of base, tool and sockets may be known badly: nobody states them.
    """
    columns = np.stack([np.asarray(slopes[name], dtype=float) for name in order], axis=-1)
    scale = np.ones(residuals.shape[1])
    for _ in range(2):  # two kinds of readings have each a noise of its own
        rows = (columns / scale[:, None]).reshape(-1, len(order))
        rest = unexplained(rows, (residuals / scale).ravel()).reshape(residuals.shape)
        noise = np.median(np.abs(rest), axis=0) / MIDDLE
        scale = scale * np.where(noise > 0, noise, 1.0)
    rows = (columns / scale[:, None]).reshape(-1, len(order))
    bounds = {"mm": WORST, "rad": 1e-3 * WORST}
    kept = well_determined(rows, ALIKE, np.array([bounds[units[name]] if name in units else np.inf for name in order]))
    vague = [order[k] for k in independent_columns(rows, ALIKE) if k not in kept]
    return tuple(order[k] for k in kept), tuple(vague)
