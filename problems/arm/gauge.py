"""Which parameters of an arm the readings determine: the rest is held, and nothing is lost by it.

A turn of a placement about the joint's own axis is the joint's zero; a shift along it may as well be made by the next
placement; the base's pose and the first joint's placement are one. So of 12 + 8 J parameters fewer than half are seen.
They are taken in an order of preference (base, tool, zeros, then each joint's place and tilt across its axis, then what
lies along it), each kept if it moves the readings in a way that those before it do not. Where two axes are parallel
their common normal is anywhere, so a shift along the axis tells nothing that the neighbour's does not, and a tilt does:
what is kept there is Hayati's choice. (Hayati 1983; Everett, Driels and Mooring 1987 count 4 R + 2 P + 6 for poses.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from calibench.problems.arm import readings as of
from calibench.problems.arm.chains.chain import Chain
from calibench.problems.arm.chains.kinematics import PLACEMENT, nominal, parameter_names, parameter_units
from calibench.problems.arm.compiled.packing import constants
from calibench.problems.arm.readings import Readings
from calibench.problems.base import Array

_ROUNDING = 1e-9  # of the largest column
MIDDLE = 0.6745  # of a standard deviation: the median of |noise|
WORST = 2.0  # mm, or mrad: a number that readings tell with a larger standard error keeps its nominal value
DISTINCT = 0.02  # sine of the angle to what is kept already: below it a parameter is called seen by those


@final
@dataclass(frozen=True)
class Gauge:
    """The names kept, in the order of the parameter vector, and those held at their nominal values."""

    kept: tuple[str, ...]
    held: tuple[str, ...]


def gauge(chain: Chain, readings: Readings, among: Sequence[str] = (), distinct: float = DISTINCT) -> Gauge:
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
    kept = {offered[k] for k in told_apart(scaled, distinct)}
    return Gauge(tuple(n for n in names if n in kept), tuple(n for n in names if n not in kept))


def told_apart(columns: Array, distinct: float) -> list[int]:
    """Return which of `columns`, (m, k), first come first kept, leave more than `distinct` of themselves beside
    those kept. A column that is nothing but rounding beside the largest is not kept.
    """
    basis = np.zeros((len(columns), 0))
    kept: list[int] = []
    sizes = np.linalg.norm(columns, axis=0)
    for k, (column, size) in enumerate(zip(columns.T, sizes, strict=True)):
        left = column - basis @ (basis.T @ column)
        left = left - basis @ (basis.T @ left)  # a second projection removes what rounding left
        length = np.linalg.norm(left)
        if size <= _ROUNDING * sizes.max() or length <= distinct * size:
            continue
        basis = np.column_stack([basis, left / length])
        kept.append(k)
    return kept


def well_told(columns: Array, distinct: float, worst: Array, noise: float = 1.0) -> list[int]:
    """Return which of `columns`, (m, k), are `told_apart` and have numbers that rows with this `noise` tell well.

    While a standard error is above its `worst`, (k,), the column that is furthest above goes, which parts others again:
    to take them in their order of preference would keep a number that is told badly, and leave out all beside it.
    """
    kept = told_apart(columns, distinct)
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
    basis, told, _ = np.linalg.svd(columns[:, sizes > 0] / sizes[sizes > 0], full_matrices=False)
    basis = basis[:, told > _ROUNDING * told.max(initial=0.0)]
    left = residuals - basis @ (basis.T @ residuals)
    return np.asarray(left * np.sqrt(len(left) / max(len(left) - basis.shape[1], 1)))


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


def _slopes(chain: Chain, readings: Readings, offered: Sequence[str]) -> Array:
    # here, as listing the problems must not load the compiler
    from calibench.problems.arm.compiled import _kernels as kernels

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


def outside(readings: Readings) -> bool:
    """Tell whether anything was measured in a frame that does not move with the arm."""
    return bool(np.isin(readings.groups[:, 0], (of.POSITION, of.POSE, of.PLANE)).any())
