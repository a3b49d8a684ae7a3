"""Which readings to take next, so that data tell rivals for one disagreement apart.

For rivals a and b let D be what is left, in sigma squared, of an effect a when calibration and b imitate it as well as
they can. A further reading adds to D the squared error of the best imitation at that reading, over the variance with
which the imitation predicts it. Readings are chosen one by one from a pool, each time the one after which the smallest
D of all pairs is largest.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from calibench.core.options import suggest
from calibench.core.plain import finite
from calibench.discrepancy.checks.validate import looked_at
from calibench.discrepancy.design.detectability import WhitenedDesign, calibrated
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.model.effect import Effect, name_of
from calibench.discrepancy.model.machine import WORKSPACE, Machine
from calibench.discrepancy.model.measured import DataError, MeasuredData
from calibench.discrepancy.registries import description_of, machines
from calibench.problems.base import Array

_HELPS = 0.05  # sigma: what readings gain less than that is rounding, or the curvature between twins


class NoPoses(ValueError):
    """Raised where a machine has no readings to choose from, or a rival changes no mean that these data can test."""


@final
@dataclass(frozen=True, eq=False)
class NextPoses:
    """The chosen readings, in order, and how well they separate the rivals.

    `separation` is the root of the smallest D, in sigma, before and after each reading, (k + 1,), for rivals of `size`
    sigma rms in the data so far. It stays at zero for twins, which no reading separates. `positions` are (k, 2) [mm],
    or (k, 0) for a machine that has no map of its workspace.
    """

    rivals: tuple[str, ...]
    readings: MeasuredData
    positions: Array
    separation: Array
    size: float

    @property
    def helps(self) -> bool:
        return bool(self.separation[-1] > self.separation[0] + _HELPS)

    def to_dict(self) -> dict[str, Any]:
        rows = []
        for k, place in enumerate(self.positions):
            cells = {name: finite(np.asarray(column)[k].item()) for name, column in self.readings.columns.items()}
            rows.append({**dict(zip("xy", map(float, place))), **cells})
        return {"rivals": list(self.rivals), "size": self.size, "poses": rows, "separation": self.separation.tolist()}


def next_poses(
    machine: str | Machine, data: MeasuredData, rivals: Sequence[str], k: int = 5, size: float = 1.0,
    pool: MeasuredData | None = None,
) -> NextPoses:  # fmt: skip
    """Return the `k` readings of `pool` (by default any in reach) that best split `rivals`, names of candidates.

    `pool` has all columns that the machine reads, in its own units: of readings that are only planned, the measured
    ones as they are foretold (`report.predict`). Raises `ValueError` for an unknown rival, fewer than two, or a machine
    of which no pool can be made, and `DataError` for data that cannot be of this machine, or a pool below `k`.
    """
    made = machines.make(machine) if isinstance(machine, str) else machine
    formulation = looked_at(made, data)
    forms: dict[str, list[Effect]] = {}
    for effect in catalogue(formulation).candidates:
        forms.setdefault(name_of(effect), []).append(effect)
    if len(set(rivals)) < 2:
        raise ValueError(f"rivals={list(rivals)}: two or more different names are needed")
    for name in rivals:
        if name not in forms:
            raise NoPoses(f"rivals: {name!r} is not among what these data can test; {suggest(name, forms)}")
    effects = [forms[name][len(forms[name]) // 2] for name in rivals]  # of several places the middle one
    here = WhitenedDesign(formulation, calibrated(formulation))
    if pool is None:
        make = description_of(formulation.data.machine).pool
        if make is None:
            raise NoPoses(
                f"machine={made.name}: no readings can be made up for it; in Python, next_poses(..., pool=readings) of "
                "calibench.discrepancy.design.next_poses chooses among those that you hand it: MeasuredData in the "
                "machine's own units, with the measured columns as they are foretold for each"
            )
        pool = make(formulation, here.q)
    if not isinstance(pool, MeasuredData):
        raise TypeError(f"pool is a {type(pool).__name__}: MeasuredData(columns, machine) is needed")
    unknown = [name for name in formulation.readings if name in pool and not np.isfinite(pool[name]).all()]
    if unknown:
        raise DataError(f"{pool.name}: {', '.join(unknown)}: of each reading to choose from all numbers are needed")
    if not 0 < k <= len(pool):
        raise DataError(f"k={k}: from 1 to the {len(pool)} readings of the pool")
    there = WhitenedDesign(formulation.on(pool), here.x)
    pairs = [_Pair(here, there, a, b, size, len(pool)) for a in effects for b in effects if a is not b]
    chosen: list[int] = []
    separation = [min(pair.distance for pair in pairs)]
    for _ in range(k):
        after = np.min([pair.distance + pair.gains() for pair in pairs], axis=0)
        total = np.sum([pair.gains() for pair in pairs], axis=0)  # breaks ties, as between twins
        after[chosen] = -1.0
        best = int(np.lexsort((total, after))[-1])
        chosen.append(best)
        for pair in pairs:
            pair.take(best)
        separation.append(min(pair.distance for pair in pairs))
    places = there.formulation.covariates(there.q).get(WORKSPACE, {}).values()
    positions = np.stack([place[chosen] for place in places], axis=1) if places else np.empty((k, 0))
    return NextPoses(tuple(rivals), pool.rows(np.array(chosen)), positions, np.sqrt(np.maximum(separation, 0)), size)


class _Pair:
    """Effect a, imitated by calibration and b: the distance D so far, and the contribution of each reading of the pool.

    It changes as readings are taken: the inverse information and the imitation are updated, not computed again.
    """

    def __init__(self, here: WhitenedDesign, there: WhitenedDesign, a: Effect, b: Effect, size: float, n: int) -> None:
        *_, right = np.linalg.svd(here.rest(a).projected, full_matrices=False)
        c = right[0]  # the most visible direction
        visible = float(np.linalg.norm(here.rest(a).projected @ c))
        c = c * (size * np.sqrt(here.rows) / visible) if visible > 0 else 0 * c
        mimic = np.concatenate([here.jacobian, here.signature(b)], axis=1)
        lengths = np.linalg.norm(mimic, axis=0)
        lengths = np.where(lengths > 0, lengths, 1.0)
        mimic, signal = mimic / lengths, here.signature(a) @ c
        normal = mimic.T @ mimic + 1e-12 * np.eye(mimic.shape[1])
        self.inverse = np.asarray(np.linalg.pinv(normal, hermitian=True), dtype=float)
        self.mimicry = self.inverse @ (mimic.T @ signal)
        rest = signal - mimic @ self.mimicry
        self.distance = float(rest @ rest)
        # of the pool: (n, c, p), (n, c)
        pool = np.concatenate([there.jacobian, there.signature(b)], axis=1) / lengths
        self.mimic, self.signal = pool.reshape(n, -1, pool.shape[1]), (there.signature(a) @ c).reshape(n, -1)

    def gains(self) -> Array:
        """Return what each reading of the pool would add to the distance, (n,)."""
        missed = self.signal - self.mimic @ self.mimicry
        spread = np.eye(missed.shape[1]) + self.mimic @ self.inverse @ self.mimic.transpose(0, 2, 1)
        return np.asarray((missed * np.linalg.solve(spread, missed[:, :, None])[:, :, 0]).sum(axis=1))

    def take(self, k: int) -> None:
        mimic = self.mimic[k]
        missed = self.signal[k] - mimic @ self.mimicry
        reach = self.inverse @ mimic.T
        steered = np.linalg.solve(np.eye(len(missed)) + mimic @ reach, np.column_stack([missed, reach.T]))
        self.distance += float(missed @ steered[:, 0])
        self.mimicry = self.mimicry + reach @ steered[:, 0]
        self.inverse = self.inverse - reach @ steered[:, 1:]
