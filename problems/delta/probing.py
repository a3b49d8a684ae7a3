"""`DeltaProbing`: nine errors of a linear delta from probe heights and caliper distances.

A value is the sum of squared residuals [mm^2], modelled minus measured. A distance has a weight of .4, as a caliper on
plastic is two and a half times as noisy as a probe: so all residuals have the noise of a height.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import blake2b
from typing import Any, ClassVar, Literal, final

import numpy as np

from calibench.problems.base import Array, Parameter, line_of, table_of
from calibench.problems.compiled_problem import CompiledProblem
from calibench.problems.delta.instances import ANGLES, FINEST, WEIGHT, DeltaInstance, Machine
from calibench.problems.delta.plans import Places, travels
from calibench.problems.noise_floor import least_in_box, levels, value_of_noise


@final
@dataclass(frozen=True, eq=False)
class DeltaProbing:
    """Minimise the sum of squared residuals [mm^2] over what is wrong with a delta's nominal geometry.

    A call takes x of shape (9,), mm and rad, in the order of `parameters`; ``problem(x) == r @ r`` with ``r =
    problem.residuals(x)``, of shape (m,), mm. `measured`, (m,), mm, are heights and distances at `places`. `drawn` is
    the instance of the family; None without one.
    """

    options: Mapping[str, Any]
    parameters: tuple[Parameter, ...]
    machine: Machine
    places: Places
    measured: Array
    drawn: DeltaInstance | None = field(default=None, kw_only=True, repr=False)
    _compiled: CompiledProblem = field(init=False, repr=False)

    name: ClassVar[str] = "delta9"
    default_start: ClassVar[Literal["nominal", "random"]] = "nominal"
    noise_unit: ClassVar[str] = "mm"
    unit: ClassVar[str] = "mm²"
    side_effect_free: ClassVar[bool] = True  # or leaves its arguments alone and returns floats: the gate need not look
    splits_batches: ClassVar[bool] = True  # a value has the same bits alone and in a batch
    said_if_chosen: ClassVar[tuple[str, ...]] = ("instance",)
    typical_noise: ClassVar[float] = 0.02  # mm: a switch probe

    __repr__ = line_of
    _repr_html_ = table_of

    def __post_init__(self) -> None:
        # Here, as listing the names must not load the compiler.
        from calibench.problems.delta import _kernels as kernels

        first, second = (_travels(self.machine, points) for points in (self.places.first, self.places.second))
        weight = np.where(self.places.between == 1, WEIGHT, 1.0)
        m = self.machine
        nominal = np.array([m.radius, m.rod, m.switch])
        constants = (nominal, np.array(ANGLES), first, second, self.places.between, weight, np.array(self.measured))
        object.__setattr__(self, "_compiled", CompiledProblem.of(self.name, self.parameters, kernels, constants))

    def __call__(self, x: Array) -> float:
        """Return the sum of squared residuals [mm^2] of the candidate x, shape (9,)."""
        return self._compiled.cost(x)

    @property
    def lower(self) -> Array:
        """Return the lower bounds of x, shape (9,)."""
        return self._compiled.lower

    @property
    def upper(self) -> Array:
        """Return the upper bounds of x, shape (9,)."""
        return self._compiled.upper

    @property
    def start(self) -> Array:
        """Return the start, shape (9,): the nominal machine."""
        return self._compiled.start

    @property
    def truth(self) -> Array | None:
        """Return the errors that the measurements were simulated with, shape (9,)."""
        return self._compiled.truth

    def batch(self, points: Array) -> Array:
        """Return the sums, shape (k,), of candidates of shape (k, 9): the same bits as one call for each."""
        return self._compiled.batch(points)

    def residuals(self, x: Array) -> Array:
        """Return weighted modelled minus measured heights and distances [mm], shape (m,)."""
        return self._compiled.residuals(x)

    def jacobian(self, x: Array) -> Array:
        """Return the analytic derivative of the residuals, shape (m, 9)."""
        return self._compiled.jacobian(x)

    @property
    def coordinates(self) -> tuple[Parameter, ...]:
        """Return what the vector x holds: the parameters themselves."""
        return self.parameters

    @property
    def readings(self) -> Array:
        """Return the measured table, shape (m, 8): x, y, z of both places [mm], 0 or 1 for a distance, and mm."""
        return np.column_stack([self.places.first, self.places.second, self.places.between, self.measured])

    def physical(self, x: Array) -> Array:
        """Return the physical parameters of x, which are x."""
        return np.array(x, dtype=float)

    def merit(self, x: Array) -> dict[str, float]:
        """Return the errors of an answer: the nozzle's rms over the bed, and the worst length's and angle's.

        kmrmse [mm] is the rms of how far from each other the true and the found machine bring the nozzle, for the
        nominal travels of 19 places on the bed.
        """
        if self.truth is None:
            return {}
        gap = self._nozzles(x) - self._nozzles(self.truth)
        away = np.abs(np.asarray(x) - self.truth)
        angle = np.array([p.unit == "rad" for p in self.parameters])
        return {
            "kmrmse": float(np.sqrt((gap**2).sum(axis=1).mean())),
            "parameter_error_mm": float(away[~angle].max()),
            "parameter_error_rad": float(away[angle].max()),
        }

    @cached_property
    def minimum(self) -> float:
        """Return f*, the least sum of squares [mm^2] in the box, found downhill from the truth; zero without noise."""
        return least_in_box(self) if self._noise > 0 else 0.0

    @property
    def targets(self) -> tuple[float, ...]:
        """Return levels of f whose first crossing is recorded: f* + 1e-1 .. 1e-12 mm^2, as rounding leaves 1e-13.

        Of an instance with noise they end where an answer is as good as the noise.
        """
        exact = tuple(self.minimum + 10.0**k for k in (-1, -2, -3, -4, -5, -6, -8, -10, -12))
        if self.drawn is None or self.as_good_as_noise is None:
            return exact
        return levels(self.as_good_as_noise, self.drawn.noise.level, exact)

    @cached_property
    def as_good_as_noise(self) -> float | None:
        """Return the f at which an answer explains the readings as well as the truth does; None of no instance."""
        if self.drawn is None:
            return None
        return value_of_noise(self, self.drawn.noise.level, FINEST**2 * len(self.places))

    @property
    def budgets(self) -> dict[str, int]:
        """Evaluations meant by the words `ci` and `paper`."""
        return {"ci": 5_000, "paper": 100_000}

    @property
    def data_id(self) -> str:
        """Return a digest of the nominal machine, places and measurements: the same data, the same id."""
        machine = np.array([self.machine.radius, self.machine.rod, self.machine.bed_radius])
        return blake2b(machine.tobytes() + self.readings.tobytes(), digest_size=8).hexdigest()

    def compile(self) -> None:
        """Compile (or load from the cache) what an optimiser will call, so that no clock sees it."""
        self._compiled.compile()

    def compile_values(self) -> None:
        """Compile likewise what methods call that ask for values alone."""
        self._compiled.compile_values()

    @property
    def _noise(self) -> float:
        return float(self.options.get("sigma") or 0.0) if self.drawn is None else self.drawn.noise.level

    def _nozzles(self, x: Array) -> Array:
        """Return where the machine x brings the nozzle, (19, 3): by distances along the axes, from the same kernel."""
        from calibench.problems.delta._kernels import _nozzle, _towers
        from calibench.problems.delta.plans import places

        points = places("rings", self.machine.bed_radius)
        travel = _travels(self.machine, points.first[points.between == 0])
        towers, found = np.empty((3, 4)), np.empty(travel.shape)
        nominal = np.array([self.machine.radius, self.machine.rod, self.machine.switch])
        _towers(self._compiled.vector(x), nominal, np.array(ANGLES), towers)
        for k in range(len(travel)):
            _nozzle(towers, travel, k, found[k])
        return found


def _travels(machine: Machine, points: Array) -> Array:
    return travels(points, machine.radius, machine.rod, machine.switch, np.array(ANGLES))
