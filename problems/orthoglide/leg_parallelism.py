"""`Orthoglide`: the six errors of an Orthoglide from the parallelism of its legs (Pashkevich et al. 2008).

The residuals are modelled minus measured deviations of the legs. `exact` is the machine itself, `linear` its tangent at
the nominal machine, which for the paper's readings is the system (11).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import blake2b
from typing import Any, ClassVar, Literal, final

import numpy as np

from calibench.problems import constants
from calibench.problems.base import Array, Parameter, frozen, line_of, table_of
from calibench.problems.compiled_problem import CompiledProblem
from calibench.problems.fitting import fit
from calibench.problems.noise_floor import least_in_box, levels, value_of_noise
from calibench.problems.orthoglide.instances import FINEST, OrthoglideInstance
from calibench.problems.orthoglide.kinematics import AXES, NAMES, direct_kinematics, geometry, inverse_kinematics
from calibench.problems.orthoglide.plans import Plan, covariance, postures


@final
@dataclass(frozen=True, eq=False)
class Orthoglide:
    """Minimise the sum of squared deviations [mm^2] over the free errors [mm] of an Orthoglide.

    A call takes x of shape (dim,) in the order of `parameters`; ``problem(x) == r @ r`` with ``r =
    problem.residuals(x)``, of shape (m,), mm, in the order of `plan`. `deviations`, shape (m,), mm, are the measured.
    `drawn` is the instance of the family; None for the paper's problem.
    """

    options: Mapping[str, Any]
    parameters: tuple[Parameter, ...]
    plan: Plan
    deviations: Array
    model: Literal["exact", "linear"]
    drawn: OrthoglideInstance | None = field(default=None, kw_only=True, repr=False)
    _compiled: CompiledProblem = field(init=False, repr=False)

    name: ClassVar[str] = "orthoglide6"
    default_start: ClassVar[Literal["nominal", "random"]] = "nominal"
    noise_unit: ClassVar[str] = "mm"
    unit: ClassVar[str] = "mm²"  # of the sum of squared deviations
    side_effect_free: ClassVar[bool] = True  # or leaves its arguments alone and returns floats: the gate need not look
    splits_batches: ClassVar[bool] = True  # a value has the same bits alone and in a batch
    said_if_chosen: ClassVar[tuple[str, ...]] = ("instance",)  # options that rows name only where they were chosen

    __repr__ = line_of
    _repr_html_ = table_of

    @property
    def typical_noise(self) -> float:
        """Return section 3.4's standard deviation of a gauge reading, mm."""
        return constants.column("pashkevich2008", "text.section34")["sigma"]

    def __post_init__(self) -> None:
        # Here, as listing the names must not load the compiler.
        from calibench.problems.orthoglide import _kernels as kernels

        m, dim = len(self.plan), len(self.parameters)
        joints, rows = postures(self.plan)
        free = np.array([NAMES.index(p.name) for p in self.parameters], dtype=np.int64)
        gauge = np.array([r.gauge_position for r in self.plan])
        machine = (free, geometry().length, joints, rows, gauge, np.array(self.deviations))
        constants = (*machine, False, np.zeros(m), np.zeros((m, dim)))
        if self.model == "linear":
            nominal = np.zeros(dim)
            tangent = kernels.residuals(nominal, *constants), kernels.jacobian(nominal, *constants)  # eq. (11)
            constants = (*machine, True, *tangent)
        object.__setattr__(self, "_compiled", CompiledProblem.of(self.name, self.parameters, kernels, constants))

    def __call__(self, x: Array) -> float:
        """Return the sum of squared residuals [mm^2] of the candidate x, shape (dim,)."""
        return self._compiled.cost(x)

    @property
    def lower(self) -> Array:
        """Return the lower bounds of x, shape (dim,), mm."""
        return self._compiled.lower

    @property
    def upper(self) -> Array:
        """Return the upper bounds of x, shape (dim,), mm."""
        return self._compiled.upper

    @property
    def start(self) -> Array:
        """Return the start, shape (dim,), mm: the nominal machine."""
        return self._compiled.start

    @property
    def truth(self) -> Array | None:
        """Return the errors that the deviations were simulated with, shape (dim,), mm; None where they are measured."""
        return self._compiled.truth

    def batch(self, points: Array) -> Array:
        """Return the sums, shape (k,), of candidates of shape (k, dim): the same bits as one call for each."""
        return self._compiled.batch(points)

    def residuals(self, x: Array) -> Array:
        """Return modelled minus measured deviations [mm], shape (m,)."""
        return self._compiled.residuals(x)

    def jacobian(self, x: Array) -> Array:
        """Return the analytic derivative of the residuals, shape (m, dim), mm/mm."""
        return self._compiled.jacobian(x)

    def residual_covariance(self, x: Array) -> Array:
        """Return the covariance of the residuals, shape (m, m), for noise of 1 mm on every gauge reading, eq. (14).

        Readings that share their Zero are not independent. It does not depend on x.
        """
        return covariance(self.plan)

    @property
    def coordinates(self) -> tuple[Parameter, ...]:
        """Return what the vector x holds: the parameters themselves."""
        return self.parameters

    @property
    def readings(self) -> Array:
        """Return the measured table, shape (m, 7), a row a deviation.

        Columns: leg, direction, axis (0 1 2 for x y z), gauge_position, level_mm, against_mm, deviation [mm].
        """
        rows = [
            [AXES.index(r.leg), AXES.index(r.direction), AXES.index(r.axis), r.gauge_position, r.level_mm, r.against_mm]
            for r in self.plan
        ]
        return np.column_stack([np.array(rows, dtype=float), self.deviations])

    def physical(self, x: Array) -> Array:
        """Return the physical parameters of x, which are x."""
        return np.array(x, dtype=float)

    def merit(self, x: Array) -> dict[str, float]:
        """Return the errors of an answer where the truth is known: the worst parameter's and the tool's rms [mm].

        kmrmse is the rms distance of the tool centre point from where the true machine brings it, at the nominal joints
        of 27 points of the workspace, 80 mm apart.
        """
        if self.truth is None:
            return {}
        steps = np.array([-80.0, 0.0, 80.0]) - 20.0  # the strokes reach from -100 to 60
        joints = inverse_kinematics(np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3))
        gap = direct_kinematics(joints, self._errors(x)) - direct_kinematics(joints, self._errors(self.truth))
        kmrmse = float(np.sqrt((gap**2).sum(axis=1).mean()))
        return {"kmrmse": kmrmse, "parameter_error_mm": float(np.abs(np.asarray(x) - self.truth).max())}

    @cached_property
    def best(self) -> Array:
        """Return the least squares answer from the nominal machine, shape (dim,), by Gauss-Newton, box or not."""
        return frozen(fit(self))

    @cached_property
    def minimum(self) -> float:
        """Return f*, the sum of squares [mm^2] at `best`: measured data never reach zero.

        Of an instance it is the least in the box, found downhill from the truth.
        """
        if self.drawn is None:
            return self(self.best)
        return least_in_box(self) if self.drawn.noise.level > 0 else 0.0

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
        """Return the f at which an answer explains the readings as well as the truth does; None of no instance.

        Without noise it is what readings of `FINEST` [mm] would leave. It is one of the targets.
        """
        if self.drawn is None:
            return None
        return value_of_noise(self, self.drawn.noise.level, FINEST**2 * float(np.trace(covariance(self.plan))))

    @property
    def budgets(self) -> dict[str, int]:
        """Evaluations meant by the words `ci` and `paper`."""
        return {"ci": 5_000, "paper": 100_000}

    @property
    def data_id(self) -> str:
        """Return a digest of plan and deviations: the same data, the same id."""
        return blake2b(self.readings.tobytes(), digest_size=8).hexdigest()

    def compile(self) -> None:
        """Compile (or load from the cache) what an optimiser will call, so that no clock sees it."""
        self._compiled.compile()

    def compile_values(self) -> None:
        """Compile likewise what methods call that ask for values alone."""
        self._compiled.compile_values()

    def _errors(self, x: Array) -> Array:
        full = np.zeros(6)
        full[self._compiled.constants[0]] = x
        return full
