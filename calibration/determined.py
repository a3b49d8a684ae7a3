"""Which parameters of an arm the readings determine, and what is known of them before any reading.

Parameters are kept in an order of preference, if they move the readings as those before do not. Of parallel axes the
tilt is kept (Hayati 1983; Everett, Driels and Mooring 1987). What is kept and told badly stays near its nominal value
by `information_of`; only `select_by_name` holds what the readings leave unsure.
"""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from calibench.calibration import kinematics
from calibench.calibration.model import ArmModel
from calibench.calibration.normal import normal_blocks, root_of
from calibench.calibration.rigid import Array, Index

_ROUNDING = 1e-9  # of the largest column
MIDDLE = 0.6745  # of a standard deviation: the median of |noise|
WORST = 2.0  # mm, or mrad: a number that readings tell with a larger standard error keeps its nominal value
DISTINCT = 0.02  # sine of the angle to what is kept already: below it a parameter is called seen by those

ALIKE = 5e-3  # part of a column: less than this beside the others may only come from the arm's other errors
LEVELS = ("frames", "zeros", "geometry", "gains")
_RANK = {
    "base": 0, "tool": 1, "zero": 2, "x": 3, "y": 3, "z": 4, "rx": 5, "ry": 5, "rz": 6, "gain": 7, "elastic": 8,
    "theta": 2, "a": 3, "alpha": 4, "beta": 5, "d": 6,
}  # fmt: skip  # of a URDF, and of a table
_OF_SLIDING = {"d": 2, "theta": 4}  # the zero of a joint that slides is a length
_FRAMES = ("base_", "tool_")
_GAUGE = 1e-3  # part of a column: what is less than this beside the others takes up .001 mm a mm at most
_MASTERED = 50.0  # mrad, or mm of a joint that slides: as far as a zero is off
_PLACES = {f"{frame}_{axis}" for frame in ("base", "tool") for axis in "xyz"}  # and tool_x_2 of the second target
_UP_TO = {"frames": 1, "zeros": 2, "geometry": 6, "gains": 7, "elastic": 6}


def gauge(chain: kinematics.Chain, readings: kinematics.Compared) -> tuple[str, ...]:
    """Return the parameters, in the order of the vector, that the readings determine at the nominal arm; no gains."""
    # here, as listing the problems must not load the compiler
    from calibench.calibration import _kernels as kernels

    # in the order in which they are kept
    offered = [f"{end}_{one}" for end in ("base", "tool") for one in kinematics.PLACEMENT]
    offered += [f"zero_{joint.name}" for joint in chain.joints]
    along = []
    for joint in chain.joints:
        main = "xyz"[int(np.argmax(np.abs(joint.axis)))]
        rest = [c for c in "xyz" if c != main]
        offered += [f"{c}_{joint.name}" for c in rest] + [f"r{c}_{joint.name}" for c in rest]
        along += [f"{main}_{joint.name}", f"r{main}_{joint.name}"]
    offered += along
    if not np.isin(readings.groups[:, 0], (kinematics.POSITION, kinematics.POSE)).any():
        alike = {f"{one}_{chain.joints[0].name}" for one in (*kinematics.PLACEMENT, "zero")}
        alike |= {f"base_{one}" for one in kinematics.PLACEMENT}
        offered = [name for name in offered if name not in alike]

    units, template = kinematics.parameter_units(chain), kinematics.nominal(chain)
    names = list(units)
    free = np.array([names.index(name) for name in offered], dtype=np.int64)
    slopes = kernels.jacobian(template[free], *kinematics.constants(chain, readings, template, free, np.inf))
    arm = max(reach(chain), 1.0)
    scale = np.array([1.0 if units[name] == "mm" else 1.0 / arm for name in offered])
    kept = {offered[k] for k in independent_columns(slopes * scale, DISTINCT)}
    return tuple(name for name in names if name in kept)


def independent_columns(columns: Array, distinct: float) -> list[int]:
    """Return which of `columns`, (m, k), first come first kept, have more than `distinct` of their own beside those."""
    basis, sizes = np.zeros((len(columns), 0)), np.linalg.norm(columns, axis=0)
    kept: list[int] = []
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
    """Return which of `columns`, (m, k), are independent and known to `worst` with `noise`; the vaguest goes first."""
    kept = independent_columns(columns, distinct)
    while len(kept):
        sizes = np.linalg.norm(columns[:, kept], axis=0)
        inverse = np.linalg.inv(np.linalg.qr(columns[:, kept] / sizes, mode="r"))
        over = noise * (np.linalg.norm(inverse, axis=1) / sizes) / worst[kept]  # standard errors over their bounds
        if over.max() <= 1.0:
            break
        kept.pop(int(np.argmax(over)))
    return kept


def unexplained(columns: Array, residuals: Array) -> Array:
    """Return what `columns`, (m, k), leave of residuals (m,), as large as where they explained none of the noise."""
    sizes = np.linalg.norm(columns, axis=0)
    basis, weights, _ = np.linalg.svd(columns[:, sizes > 0] / sizes[sizes > 0], full_matrices=False)
    basis = basis[:, weights > _ROUNDING * weights.max(initial=0.0)]
    rest = residuals - basis @ (basis.T @ residuals)
    return np.asarray(rest * np.sqrt(len(rest) / max(len(rest) - basis.shape[1], 1)))


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
        "O1": float(np.exp(np.log(s).mean()) / np.sqrt(len(jacobian))), "O2": float(s[-1] / s[0]), "O3": float(s[-1]),
        "O4": float(s[-1] ** 2 / s[0]), "O5": float(1.0 / (1.0 / s).sum()),
    }  # fmt: skip


def reach(chain: kinematics.Chain) -> float:
    """Return about how far the arm reaches [mm]: what a turn of its placements is told apart by."""
    lengths = [np.linalg.norm(j.origin[:3, 3]) for j in chain.joints[1:]]
    return float(sum(lengths) + np.linalg.norm((chain.tail @ chain.tool)[:3, 3]))


def order_of(names: Sequence[str], level: str, sliding: Collection[str] = ()) -> list[int]:
    """Return which parameters a level frees, similar ones in order of preference (of parallel axes the last d)."""
    ranks = []
    for k, name in enumerate(names):
        kind, _, joint = name.partition("_")
        last_first = kind in ("base", "d")  # fixed points and tables, which nobody states, before the base
        ranks.append((({**_RANK, **_OF_SLIDING} if joint in sliding else _RANK)[kind], -k if last_first else k, k))
    return [k for rank, _, k in sorted(ranks) if rank <= _UP_TO[level] or (level == "elastic" and rank == 8)]


def select_determined(model: ArmModel, p: Array, order: Sequence[int], weights: Array) -> Index:
    """Return which of the parameters in `order` move the readings as none before does, as places in p, sorted.

    That is asked of the nominal arm, with the frames of p: no noise and no fit decides it, so that it is the same in
    every part of the readings.
    """
    free = np.array(order, dtype=np.int64)
    at, frames = model.start, [k for k, name in enumerate(model.names) if name.startswith(_FRAMES)]
    at[frames] = p[frames]
    known = np.array([1 / model.priors[name][1] if name in model.priors else 0.0 for name in model.names])[free]
    rows = np.vstack([root_of(normal_blocks(model, at, free, weights).gram[0]), np.diag(known)[known > 0]])
    return np.sort(free[independent_columns(rows, _GAUGE)])


def information_of(model: ArmModel) -> Array:
    """Return what is known of each parameter before any reading, 1 / sd^2, (P,): nothing of base and tool.

    A zero is no matter of the maker's tolerance: whoever masters the joints sets it.
    """
    sd = np.full(len(model.names), np.inf)
    for k, name in enumerate(model.names):
        if not name.startswith(_FRAMES):
            kind, _, joint = name.partition("_")
            mastered = kind == ("d" if joint in model.sliding else "theta") or kind == "zero"
            sd[k] = (_MASTERED if mastered else model.tolerance) * (1.0 if is_length(name, model.sliding) else 1e-3)
        sd[k] = model.priors[name][1] if name in model.priors else sd[k]
    return np.asarray(sd**-2)


def is_length(name: str, sliding: Collection[str] = ()) -> bool:
    """Return whether a parameter is a length [mm], as the zero of a joint in `sliding` is, and no angle or gain."""
    kind, _, of = name.partition("_")
    return kind in ("x", "y", "z", "a", "d") or (of in sliding if kind == "zero" else name[:6] in _PLACES)


def select_by_name(
    slopes: Mapping[str, Array], order: Sequence[str], residuals: Array, units: Mapping[str, str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of `order` that are kept, and those that are held since the readings tell them too badly.

    `slopes` has name -> (n, m); `residuals` (n, m) are those of the nominal arm; `units` has the unit of each number of
    a joint. Numbers of base, tool and sockets may be known badly: nobody states them.
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
