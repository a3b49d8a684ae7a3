"""`ArmCalibration`: the errors of the placements of an arm's joints, from postures and what was measured in them.

Free are the parameters that the readings determine (`gauge`), each an error of the nominal arm: places [mm], tilts and
zeros [rad], base and tool. A value is the sum of squared residuals [mm^2]; a turn counts as `readings.ARM` mm a radian.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import blake2b
from typing import Any, ClassVar, Literal, final

import numpy as np

from calibench.calibration.compared import GAP, Compared, constants
from calibench.calibration.determined import observability, reach
from calibench.calibration.kinematics import Chain, nominal, parameter_names
from calibench.problems.base import Array, Parameter, frozen, line_of, table_of
from calibench.problems.compiled_problem import CompiledProblem
from calibench.problems.fitting import fit, least_in_box, levels, value_of_noise

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
    _compiled: CompiledProblem = field(init=False, repr=False)

    default_start: ClassVar[Literal["nominal", "random"]] = "nominal"
    noise_unit: ClassVar[str] = "mm"
    unit: ClassVar[str] = "mm²"
    side_effect_free: ClassVar[bool] = True  # or leaves its arguments alone and returns floats: the gate need not look
    splits_batches: ClassVar[bool] = True  # a value has the same bits alone and in a batch
    said_if_chosen: ClassVar[tuple[str, ...]] = ("instance", "dh", "convention")
    typical_noise: ClassVar[float] = 0.02  # mm: a laser tracker

    __repr__ = line_of
    _repr_html_ = table_of

    def __post_init__(self) -> None:
        # imported here, because listing the names must not load the compiler
        from calibench.calibration import _kernels as kernels

        arguments = self._arguments(self.seen)
        object.__setattr__(self, "_compiled", CompiledProblem.of(self.name, self.parameters, kernels, arguments))

    def __call__(self, x: Array) -> float:
        """Return the sum of squared residuals [mm^2] of the candidate x, shape (dim,)."""
        return self._compiled.cost(x)

    @property
    def lower(self) -> Array:
        """Return the lower bounds of x, shape (dim,)."""
        return self._compiled.lower

    @property
    def upper(self) -> Array:
        """Return the upper bounds of x, shape (dim,)."""
        return self._compiled.upper

    @property
    def start(self) -> Array:
        """Return the start, shape (dim,): the nominal arm, with base and tool where it comes nearest."""
        return self._compiled.start

    @property
    def truth(self) -> Array | None:
        """Return the errors that the readings were simulated with, shape (dim,); None where they are measured."""
        return self._compiled.truth

    def batch(self, points: Array) -> Array:
        """Return the sums, shape (k,), of candidates of shape (k, dim): the same bits as one call for each."""
        return self._compiled.batch(points)

    def residuals(self, x: Array) -> Array:
        """Return modelled minus measured readings [mm], shape (m,)."""
        return self._compiled.residuals(x)

    def jacobian(self, x: Array) -> Array:
        """Return the analytic derivative of the residuals, shape (m, dim)."""
        return self._compiled.jacobian(x)

    @property
    def coordinates(self) -> tuple[Parameter, ...]:
        """Return what the vector x holds: the parameters themselves."""
        return self.parameters

    @property
    def readings(self) -> Array:
        """Return the postures, shape (n, columns) [rad, mm]."""
        return self.seen.q

    def physical(self, x: Array) -> Array:
        """Return the physical parameters of x, which are x."""
        return np.array(x, dtype=float)

    def full(self, x: Array) -> Array:
        """Return all parameters of the chain, (P,): x, and the nominal ones that are held (`kinematics`)."""
        values = nominal(self.chain)
        values[self._free[self._free < len(values)]] = np.asarray(x, dtype=float)[self._free < len(values)]
        return values

    def targets_at(self, x: Array) -> Array:
        """Return where the arm x brings the target in each posture, (n, 3) [mm]."""
        from calibench.calibration import _kernels as kernels

        c = self._compiled.constants
        return np.asarray(kernels.targets(self._compiled.vector(x), *c[:6])[:, :3])

    def merit(self, x: Array) -> dict[str, float]:
        """Return the errors of an answer.

        With a truth: kmrmse, the rms distance [mm] of the targets from where the true arm brings them, over the
        postures, and the worst length's and angle's error. Measured: held_out, the rms distance [mm] of the readings
        kept back (of a ball in sockets: from its mean place), and gap, the rms error of known distances there.
        """
        if self.truth is None:
            return self._held_out(x)
        away = np.abs(np.asarray(x, dtype=float) - self.truth)
        turns = np.array([p.unit == "rad" for p in self.parameters])
        apart = self.targets_at(x) - self.targets_at(self.truth)
        return {
            "kmrmse": float(np.sqrt((apart**2).sum(axis=1).mean())),
            "parameter_error_mm": float(away[~turns].max()),
            "parameter_error_rad": float(away[turns].max()),
        }

    def _held_out(self, x: Array) -> dict[str, float]:
        if self.held is None:
            return {}
        from calibench.calibration import _kernels as kernels

        arguments = list(self._arguments(self.held))
        arguments[-2] = np.inf  # held-out readings are judged by plain squares
        r = kernels.residuals(self._compiled.vector(x), *arguments)
        known = self.held.groups[:, 0] == GAP
        rows = self.held.rows
        places = np.array([r[row : row + 3] for row in rows[~known]])
        errors = {"held_out": float(np.sqrt((places**2).sum(axis=1).mean()))}
        if known.any():
            gaps = r[rows[known]] / self.held.weight[known, 0]
            errors["gap"] = float(np.sqrt((gaps**2).mean()))
        return errors

    @cached_property
    def best(self) -> Array:
        """Return the least squares answer from the nominal arm, shape (dim,), by Gauss-Newton, box or not."""
        return frozen(fit(self))

    @cached_property
    def minimum(self) -> float:
        """Return f* [mm^2]: at `best`, because measured data never reach zero; of an instance the least in its box."""
        if self.truth is None:
            return self(self.best)
        return least_in_box(self) if self.noise > 0 else 0.0

    @property
    def targets(self) -> tuple[float, ...]:
        """Return levels of f whose first crossing is recorded: f* + 1e2 .. 1e-7 mm^2, as rounding leaves 1e-9.

        Of an instance with noise they end where an answer is as good as the noise.
        """
        exact = tuple(self.minimum + 10.0**k for k in (2, 1, 0, -1, -2, -3, -4, -5, -6, -7))
        if self.drawn is None or self.as_good_as_noise is None:
            return exact
        return levels(self.as_good_as_noise, self.noise, exact)

    @cached_property
    def as_good_as_noise(self) -> float | None:
        """Return the f at which an answer explains the readings as well as the truth does; None of no instance."""
        if self.drawn is None:
            return None
        return value_of_noise(self, self.noise, FINEST**2 * self.seen.size)

    @property
    def observability(self) -> dict[str, float]:
        """Return the observability indices O1 to O5 at the best answer (the truth), turns times the arm's reach."""
        scale = np.array([1.0 / reach(self.chain) if p.unit == "rad" else 1.0 for p in self.parameters])
        return observability(self.jacobian(self.best if self.truth is None else self.truth) * scale)

    @property
    def budgets(self) -> dict[str, int]:
        """Evaluations meant by the words `ci` and `paper`."""
        return {"ci": 5_000, "paper": 100_000}

    @property
    def data_id(self) -> str:
        """Return a digest of the nominal arm, postures and readings: the same data, the same id."""
        parts = [np.ascontiguousarray(part) for part in self._compiled.constants if isinstance(part, np.ndarray)]
        return blake2b(b"".join(part.tobytes() for part in parts), digest_size=8).hexdigest()

    def compile(self) -> None:
        """Compile (or load from the cache) what an optimiser will call, so that no clock sees it."""
        self._compiled.compile()

    def compile_values(self) -> None:
        """Compile likewise what methods call that ask for values alone."""
        self._compiled.compile_values()

    @cached_property
    def _free(self) -> Any:
        names = (*parameter_names(self.chain), *plane_names(len(self.seen.planes)))
        return np.array([names.index(p.name) for p in self.parameters], dtype=np.int64)

    def _arguments(self, readings: Compared) -> tuple[Any, ...]:
        template = np.concatenate([nominal(self.chain), np.zeros(3 * len(readings.planes))])
        return constants(self.chain, readings, template, self._free, self.robust)


def plane_names(planes: int) -> tuple[str, ...]:
    """Return the names of the planes' parameters: two tilts [rad] and a height [mm] each."""
    return tuple(f"{one}_plane{k}" for k in range(planes) for one in ("tilt", "lean", "height"))
