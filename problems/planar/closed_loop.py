"""`Planar`: a calibration problem of the GPM2002, from encoder readings to an error and its figures of merit.

The end-effector is eliminated, so the error is a function of the parameters alone (Cong et al. 2008, section 3).
Values are computed by calls that take the caller's array as it is, as a copy costs a third of a call. Such a kernel
refuses what is no C-ordered float64 array of the right length (`REFUSED`), and is then called with a copy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any, ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from calibench.core.compilation.compiled import exact
from calibench.problems import constants
from calibench.problems.base import Array, Parameter, frozen, line_of, table_of
from calibench.problems.compiled_problem import CompiledProblem, hold, passed
from calibench.problems.fitting import least_of_instance, levels, value_of_noise
from calibench.problems.planar import gpm2002
from calibench.problems.planar.gpm2002 import NAMES, Gauge, PlanarInstance

REFUSED = (TypeError, ValueError)
_NEWTON_STEPS = 20
_ROUNDING = 1e-13  # rad: readings are rounded by 2e-16, and what follows from them by some hundred times that
ErrorName = Literal["J1", "J2", "J3"]


@final
@dataclass(frozen=True, eq=False)
class Planar:
    """A GPM2002 calibration problem: minimise J1, J2 or J3 over the free parameters, given encoder readings.

    `readings` has shape (n, 3), rad. A call takes x of shape (dim,) in `coordinates` and returns mm^2 (J1) or mm^4
    (J2, J3); ``problem(x) == r @ r`` with ``r = problem.residuals(x)``, of shape (n,), or (3n,) for J1.
    `true_positions`, shape (n, 2), are the end-effectors the readings were taken at; None for a user's readings.
    `drawn` is the instance of the family; None for the paper's problem.
    """

    options_tell_all: ClassVar[bool] = True  # what else it is follows from the options
    name: str
    options: Mapping[str, Any]
    parameters: tuple[Parameter, ...]
    coordinates: tuple[Parameter, ...]
    readings: Array
    error: ErrorName
    noise: float
    gauge: Gauge | None
    true_positions: Array | None
    default_start: Literal["nominal", "random"]
    drawn: PlanarInstance | None = field(default=None, kw_only=True, repr=False)
    _template: Array = field(kw_only=True, repr=False)
    _turn: Array = field(kw_only=True, repr=False)
    lower: Array = field(init=False, repr=False)
    upper: Array = field(init=False, repr=False)
    start: Array = field(init=False, repr=False)
    truth: Array | None = field(init=False, repr=False)
    data_id: str = field(init=False, repr=False)
    unit: str = field(init=False, repr=False)  # of a sum of squared lengths, or of their differences' squares
    redundancy: int = field(init=False, repr=False)  # residuals that carry one number: three leg errors, or 1
    _compiled: CompiledProblem = field(init=False, repr=False)
    _exact: SimpleNamespace = field(init=False, repr=False)  # what a value asks for, by kernels that copy nothing

    said_if_chosen: ClassVar[tuple[str, ...]] = ("instance",)  # options that rows name only where they were chosen

    __repr__ = line_of
    _repr_html_ = table_of

    def __post_init__(self) -> None:
        # Here, as listing the names must not load the compiler.
        from calibench.problems.planar import _closed_loop_kernels as kernels

        packed = kernels.pack(self.readings, self._template, self._free, self.error != "J3", self.error == "J1")
        unit, redundancy = ("mm²", 3) if self.error == "J1" else ("mm⁴", 1)
        for kernel in (kernels.residuals, kernels.jacobian, kernels.positions):
            exact(kernel, 1, 2)  # with the types of `cost`, so that they share their parts
        calls = SimpleNamespace(
            packed=packed, screen=kernels.screen(packed), cost=exact(kernels.cost, 1, 2),
            batch=exact(kernels.batch, 2, 2), batch_below=exact(kernels.batch_below, 2, 1, 2, 2),
        )  # fmt: skip
        hold(
            self, self.coordinates, kernels, (packed,), data=self.readings.tobytes(), unit=unit, redundancy=redundancy,
            _exact=calls,
        )  # fmt: skip

    compile = passed(CompiledProblem.compile)
    compile_values = passed(CompiledProblem.compile_values)
    residuals = passed(CompiledProblem.residuals)  # sqrt(3) g_j [mm^2], (n,), or for J1 |P - B_i| - l_b [mm], (3n,)
    jacobian = passed(CompiledProblem.jacobian)

    def __call__(self, x: Array) -> float:
        """Return the error of the candidate x, shape (dim,)."""
        calls = self._exact
        try:
            return calls.cost(x, calls.packed)  # type: ignore[no-any-return]
        except REFUSED:
            return calls.cost(self._compiled.vector(x), calls.packed)  # type: ignore[no-any-return]

    @property
    def kernel(self) -> tuple[Any, Array]:
        """Return the compiled cost and the array that goes with x, for who calls it often: ``cost(x, packed)``."""
        return self._exact.cost, self._exact.packed

    def batch(self, points: Array) -> Array:
        """Return the errors, shape (k,), of candidates of shape (k, dim): the same bits as one call for each."""
        calls = self._exact
        try:
            result: Array = calls.batch(points, calls.packed)
        except REFUSED:
            result = calls.batch(self._compiled.vectors(points), calls.packed)
        return result

    def batch_below(self, points: Array, limits: Array) -> Array:
        """Return the errors, shape (k,), that are below `limits`, shape (k,), to the last bit those of `batch`.

        Of any other candidate the value only tells that it is not below its limit: its sum may have been given up.
        Raises `ValueError` for limits of another shape.
        """
        if limits.shape != (len(points),):
            raise ValueError(f"{self.name}: limits have shape {limits.shape}, ({len(points)},) is needed")
        calls = self._exact
        try:
            result: Array = calls.batch_below(points, limits, calls.packed, calls.screen)
        except REFUSED:
            taken = self._compiled.vectors(points), np.array(limits, dtype=np.float64)
            result = calls.batch_below(*taken, calls.packed, calls.screen)
        return result

    def positions(self, x: Array) -> Array:
        """Return the calibrated end-effectors, eq. (33), shape (n, 2), mm."""
        result: Array = self._compiled.kernels.positions(self._compiled.vector(x), self._exact.packed)
        return result

    def residual_noise(self, x: Array) -> Array:
        """Return the standard deviation of each residual for 1 rad of independent noise on every reading, shape (m,).

        It is |dr_j / d reading|, as a reading acts like its sensor offset.
        """
        machine, every, kernels = self._machine(x), np.arange(len(NAMES)), self._compiled.kernels
        packed = kernels.pack(self.readings, machine, every, True, self.error == "J1")
        return np.asarray(np.sqrt((kernels.jacobian(machine, packed)[:, 12:15] ** 2).sum(axis=1)))

    def explained_by(self, x: Array) -> Planar:
        """Return the problem with readings that x explains without error: these, moved as little as it takes."""
        machine, every, kernels = self._machine(x), np.arange(len(NAMES)), self._compiled.kernels
        readings, moved = self.readings.copy(), np.full(len(self.readings), np.inf)
        for _ in range(_NEWTON_STEPS):
            packed = kernels.pack(readings, machine, every, True, False)
            slopes = kernels.jacobian(machine, packed)[:, 12:15]
            with np.errstate(all="ignore"):  # a sample that is nowhere near becomes NaN, and is left out
                shift = (kernels.residuals(machine, packed) / (slopes**2).sum(axis=1))[:, None] * slopes
            moved = np.abs(shift).max(axis=1)
            if not (moved > _ROUNDING).any():
                break
            readings -= np.where(moved > _ROUNDING, 1, 0)[:, None] * shift
        found = moved <= _ROUNDING
        if np.array_equal(readings, self.readings) or found.sum() < len(x):
            return self
        points = None if self.true_positions is None else frozen(self.true_positions[found])
        return replace(self, readings=frozen(readings[found]), true_positions=points)

    def physical(self, x: Array) -> Array:
        """Return the physical parameters of x, shape (dim,), in the order of `parameters`."""
        return self._machine(x)[self._free]

    def merit(self, x: Array) -> dict[str, float]:
        """Return the figures of merit of an answer against the truth; empty where the truth is not known.

        kmrmse [mm], eq. (40); kmrmse_aligned after the best move along the gauge; gauge_phi [rad], the angle of that
        move seen from the truth (0 where there is no gauge); the worst parameter errors as found and aligned, mm, rad.
        """
        if self.truth is None or self.true_positions is None:
            return {}
        reached = self.positions(x)
        if not np.isfinite(reached).all():
            return {}
        phi, machines, places = 0.0, {"": self._machine(x)}, {"": reached}
        if self.gauge is not None:
            phi, aligned = self.gauge.align(machines[""], reached, self.true_positions)
            machines["_aligned"] = aligned
            places["_aligned"] = self.positions(
                (aligned if self.error != "J3" else gpm2002.to_cartesian(aligned))[self._free]
            )

        merit: dict[str, float] = {}
        true, turns = self._machine(self.truth), self._free >= NAMES.index("z1")
        for which, machine in machines.items():
            squares = np.add.reduce((places[which] - self.true_positions) ** 2, axis=1)
            merit[f"kmrmse{which}"] = float(np.sqrt(np.add.reduce(squares) / len(squares)))  # eq. (40)
            gap = np.abs(machine - true)[self._free]
            worst = {unit: float(gap[at].max()) for unit, at in (("mm", ~turns), ("rad", turns)) if at.any()}
            merit |= {"gauge_phi": phi} if which else {}
            merit |= {f"parameter_error_{unit}{which}": value for unit, value in worst.items()}
        if self.gauge is None:
            merit |= {f"{name}_aligned": value for name, value in merit.items()} | {"gauge_phi": 0.0}
        return merit

    # J2 and J3 round to about 1e-19 at the truth, J1 to 5e-25; the last target is the level of success without noise
    targets = levels(
        lambda self: tuple(10.0**k for k in (range(-1, -24, -2) if self.error == "J1" else range(4, -19, -2)))
    )
    as_good_as_noise = value_of_noise(lambda self: ((gpm2002.FINEST * self.residual_noise(self.truth)) ** 2).sum())
    minimum = cached_property(least_of_instance)

    @property
    def budgets(self) -> dict[str, int]:
        """Evaluations meant by the words `ci` and `paper` (section 4.4 stops at 5e7)."""
        return {"ci": 20_000, "paper": int(constants.column(gpm2002.PAPER, "section44")["evaluations"])}

    @property
    def gauge_curve(self) -> Callable[[float], Array]:
        """Return phi [rad] -> physical parameters on the gauge curve through the truth (or start), shape (dim,).

        Raises `ValueError` for a problem without a gauge.
        """
        if self.gauge is None:
            raise ValueError(f"{self.name} has no gauge: all its parameters can be seen in the readings")
        machine, gauge = self._machine(self.start if self.truth is None else self.truth), self.gauge
        return lambda phi: gauge.move(machine, phi)[self._free]

    @cached_property
    def _free(self) -> NDArray[np.int64]:
        """Return which of the 15 numbers of a machine are free, shape (dim,)."""
        return np.array([NAMES.index(p.name) for p in self.parameters])

    def _machine(self, x: Array) -> Array:
        machine = self._template.copy()
        machine[self._free] = self._compiled.vector(x)
        return machine if self.error != "J3" else gpm2002.to_polar(machine, self._turn)
