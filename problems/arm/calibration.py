"""`ArmCalibration`: the errors of the placements of an arm's joints, from postures and what was measured in them.

Free are the parameters that the readings determine (`gauge`), each an error of the nominal arm: places [mm], tilts and
zeros [rad], base and tool. A value is the sum of squared residuals [mm^2]; a turn counts as `readings.ARM` mm a radian.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, final

import numpy as np

from calibench.calibration.determined import observability, reach
from calibench.calibration.kinematics import GAP, Chain, Compared, constants, forward, nominal, parameter_units
from calibench.problems.base import Array, Parameter, line_of, table_of
from calibench.problems.compiled_problem import CompiledProblem, hold, itself, passed
from calibench.problems.fitting import best_of, least_of_instance, levels, value_of_noise, worst_errors

FINEST = 1e-4  # mm: noise that is assumed for an instance without noise


@final
@dataclass(frozen=True, eq=False)
class ArmCalibration:
    """Minimise the sum of squared residuals [mm^2] over the errors of an arm's nominal geometry.

    A call takes x of shape (dim,), mm and rad, in the order of `parameters`; ``problem(x) == r @ r`` with ``r =
    problem.residuals(x)``. `held` are held-out readings: no call sees them, and `merit` judges an answer by them; None
    where there are none. With a finite `robust` [mm] a reading farther off than that counts less. `drawn` is the
    instance; None without one.
    """

    name: str
    options: Mapping[str, Any]
    chain: Chain
    seen: Compared
    parameters: tuple[Parameter, ...]
    held: Compared | None = None
    robust: float = np.inf
    noise: float = 0.0
    drawn: Any = field(default=None, kw_only=True, repr=False)
    coordinates: tuple[Parameter, ...] = field(init=False, repr=False)
    lower: Array = field(init=False, repr=False)
    upper: Array = field(init=False, repr=False)
    start: Array = field(init=False, repr=False)  # the nominal arm, with base and tool where it comes nearest
    truth: Array | None = field(init=False, repr=False)  # of simulated readings
    readings: Array = field(init=False, repr=False)  # the postures, (n, columns) [rad, mm]
    data_id: str = field(init=False, repr=False)
    _compiled: CompiledProblem = field(init=False, repr=False)

    noise_unit: ClassVar[str] = "mm"
    unit: ClassVar[str] = "mm²"
    said_if_chosen: ClassVar[tuple[str, ...]] = ("instance", "dh", "convention")
    typical_noise: ClassVar[float] = 0.02  # mm: a laser tracker
    budgets: ClassVar[Mapping[str, int]] = {"ci": 5_000, "paper": 100_000}

    __repr__ = line_of
    _repr_html_ = table_of

    def __post_init__(self) -> None:
        # imported here, because listing the names must not load the compiler
        from calibench.calibration import _kernels as kernels

        arguments = self._arguments(self.seen, self.robust)
        data = b"".join(np.ascontiguousarray(part).tobytes() for part in arguments if isinstance(part, np.ndarray))
        hold(self, self.parameters, kernels, arguments, data=data, readings=self.seen.q)

    __call__ = passed(CompiledProblem.cost)
    batch = passed(CompiledProblem.batch)
    residuals = passed(CompiledProblem.residuals)
    jacobian = passed(CompiledProblem.jacobian)
    physical = itself
    compile = passed(CompiledProblem.compile)
    compile_values = passed(CompiledProblem.compile_values)

    def merit(self, x: Array) -> dict[str, float]:
        """Return the errors of an answer.

        With a truth: kmrmse, the rms distance [mm] of the targets from where the true arm brings them, over the
        postures, and the worst length's and angle's error. Measured: held_out, the rms distance [mm] of the readings
        kept back (of a ball in sockets: from its mean place), and gap, the rms error of known distances there.
        """
        if self.truth is not None:
            names = [p.name for p in self.parameters]
            there, true = (
                forward(self.chain, dict(zip(names, one.tolist(), strict=True)), self.seen.q)[:, :3, 3]
                for one in (x, self.truth)
            )
            return {"kmrmse": float(np.sqrt(((there - true) ** 2).sum(axis=1).mean())), **worst_errors(self, x)}
        if self.held is None:
            return {}
        from calibench.calibration import _kernels as kernels

        arguments = self._arguments(self.held, np.inf)  # held-out readings are judged by plain squares
        r = kernels.residuals(self._compiled.vector(x), *arguments)
        known, rows = self.held.groups[:, 0] == GAP, self.held.groups[:, 3]
        places = np.array([r[row : row + 3] for row in rows[~known]])
        errors = {"held_out": float(np.sqrt((places**2).sum(axis=1).mean()))}
        if known.any():
            gaps = r[rows[known]] / self.held.weight[known, 0]
            errors["gap"] = float(np.sqrt((gaps**2).mean()))
        return errors

    best = cached_property(best_of)
    minimum = cached_property(least_of_instance)  # f* [mm^2]
    targets = levels(lambda self: tuple(self.minimum + 10.0**k for k in range(2, -8, -1)))  # as rounding leaves 1e-9
    as_good_as_noise = value_of_noise(lambda self: FINEST**2 * self.seen.size)

    @property
    def observability(self) -> dict[str, float]:
        """Return the observability indices O1 to O5 at the best answer (the truth), turns times the arm's reach."""
        scale = np.array([1.0 / reach(self.chain) if p.unit == "rad" else 1.0 for p in self.parameters])
        return observability(self.jacobian(self.best if self.truth is None else self.truth) * scale)

    def _arguments(self, readings: Compared, limit: float) -> tuple[Any, ...]:
        names = [*parameter_units(self.chain)]
        free = np.array([names.index(p.name) for p in self.parameters], dtype=np.int64)
        return constants(self.chain, readings, nominal(self.chain), free, limit)
