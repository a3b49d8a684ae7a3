"""`tracking_zero`: sensor zero positions from the projected tracking error (Cong et al. 2008, section 2).

By hand the end-effector is put on a reference point O, but it really stands at O + (dx, dy), so the zero positions
taken there are wrong. The machine then tracks a circle about O with them; its three motors cannot all be satisfied, and
the part of their tracking errors which no motion explains, eq. (17), tells how wrong. The unknowns are (dx, dy): the
minimum of E, eq. (19), is at (0, 0), where without reading errors E is exactly zero.

What the propositions of section 2.3 need. The reading errors delta_j enter only as P_j delta_j, so those in the
feasible subspace, P_j delta_j = 0, change nothing at all (Proposition 1). The gradient of E at the truth is
-(2/n) J(O)^T sum_j P_j delta_j: it vanishes, and the minimum stays, where the *projected* errors have mean zero. For
Proposition 2 that takes both its conditions: mean(delta) = 0 and each delta_j in span P_j, as P_j delta_j is then
delta_j. Errors of mean zero alone are not enough, since P_j changes along the circle.

Instances of `tracking_zero`: another machine, reference point, path, noise and box for each ``instance=K``.

- *machine*: as the nominal machine of `planar.instances`, and it is known: the geometry is no unknown here.
- *path*: as the plan there, its centre being the reference point O; n poses from 9.
- *box*: as `problems.instances` says, with h = 10 mm about a start uniform in -10 .. 10 mm. The truth is not (0, 0): dx
  and dy are measured from a mark beside O, so that a method which favours the origin gains nothing.
- *noise* of a recorded reading: none, or 1e-6 .. 3e-4 rad.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache
from hashlib import blake2b
from typing import Any, ClassVar, Literal, final

import numpy as np

from calibench.problems import constants
from calibench.problems.base import Array, Parameter, frozen, line_of, registry, table_of
from calibench.problems.compiled_problem import CompiledProblem
from calibench.problems.fitting import least_in_box, levels, value_of_noise
from calibench.problems.instances import (
    Box,
    Noise,
    Stream,
    can_be_identified,
    check_instance,
    first_that_fits,
    refuse_drawn,
)
from calibench.problems.planar.gpm2002 import PlanName, home, makers_machine, plan_points
from calibench.problems.planar.instances import FINEST, NOISES, DrawnPlan, decided, nominal_machine, within_reach

_PAPER = "cong2008"
_OFFSETS = ("z1", "z2", "z3")
_BOX = 15.0  # mm, "several millimeter error" (section 2.1) with room: Table 1's worst start is 11 mm off


@final
@dataclass(frozen=True, eq=False)
class Tracking:
    """Minimise E [rad^2], eq. (19), over the displacement (dx, dy) [mm] of the hand from the reference point.

    A call takes x of shape (2,); ``problem(x) == r @ r`` with ``r = problem.residuals(x)``, of shape (3n,), rad.
    `points`, shape (n, 2), mm, is the commanded path; `reading_errors`, shape (n, 3), rad, are added to the readings
    recorded on it, the same for every candidate. The controller sees none of them, nor does the reading at O + x.
    `zero_positions`, shape (3,), rad, are Table 1's results and stand for the actual machine; E does not depend on
    them. `start_misfit`, shape (3,), rad, is what `start` leaves of the printed initial minus resulting zero positions.
    `machine`, shape (15,), is the known geometry. `reference`, shape (4,), mm, is the reference point O and the
    displacement at which the hand stands on it, the truth: (0, 0) in the paper. `drawn` is the instance of the family;
    None for the paper's problem.
    """

    options: Mapping[str, Any]
    parameters: tuple[Parameter, ...]
    points: Array
    reading_errors: Array
    zero_positions: Array
    start_misfit: Array
    machine: Array = field(default_factory=makers_machine, kw_only=True)
    reference: Array = field(default_factory=lambda: frozen([*home(), 0.0, 0.0]), kw_only=True)
    drawn: TrackingInstance | None = field(default=None, kw_only=True, repr=False)
    _compiled: CompiledProblem = field(init=False, repr=False)

    name: ClassVar[str] = "tracking_zero"
    unit: ClassVar[str] = "rad²"  # of E
    side_effect_free: ClassVar[bool] = True  # or leaves its arguments alone and returns floats: the gate need not look
    splits_batches: ClassVar[bool] = True  # a value has the same bits alone and in a batch
    said_if_chosen: ClassVar[tuple[str, ...]] = ("instance",)  # options that rows name only where they were chosen
    default_start: ClassVar[Literal["nominal", "random"]] = "nominal"

    __repr__ = line_of
    _repr_html_ = table_of

    def __post_init__(self) -> None:
        from calibench.problems.planar import _settling_kernels, _tracking_kernels

        machine = np.array(self.machine)
        angles, slopes = _tracking_kernels.joint_angles(machine, self.points)
        samples = _settling_kernels.samples_of(machine, np.asarray(self.points))
        fixed = (machine, self.reference, self.points, angles, _projectors(slopes), self.reading_errors, samples)
        constants = tuple(frozen(array) for array in fixed)
        compiled = CompiledProblem.of(self.name, self.parameters, _tracking_kernels, constants)
        object.__setattr__(self, "_compiled", compiled)

    def __call__(self, x: Array) -> float:
        """Return E of the displacement x, shape (2,); NaN where the machine cannot settle."""
        return self._compiled.cost(x)

    @property
    def lower(self) -> Array:
        """Return the lower bounds of x, shape (2,), mm."""
        return self._compiled.lower

    @property
    def upper(self) -> Array:
        """Return the upper bounds of x, shape (2,), mm."""
        return self._compiled.upper

    @property
    def start(self) -> Array:
        """Return the displacement that the initial zero positions correspond to, shape (2,), mm."""
        return self._compiled.start

    @property
    def truth(self) -> Array:
        """Return the true displacement, shape (2,), mm: in the paper none."""
        assert self._compiled.truth is not None
        return self._compiled.truth

    @property
    def commanded(self) -> Array:
        """Return the joint angles that the controller commands along the path, shape (n, 3), rad."""
        angles: Array = self._compiled.constants[3]
        return angles

    def batch(self, points: Array) -> Array:
        """Return E, shape (k,), of displacements of shape (k, 2): the same bits as one call for each."""
        return self._compiled.batch(points)

    def residuals(self, x: Array) -> Array:
        """Return the projected tracking errors over sqrt(n), rad, shape (3n,), the three of a pose together."""
        return self._compiled.residuals(x)

    def jacobian(self, x: Array) -> Array:
        """Return the derivative of the residuals, shape (3n, 2), rad/mm, by the implicit function theorem."""
        return self._compiled.jacobian(x)

    def poses(self, x: Array) -> Array:
        """Return where the end-effector really goes along the path, shape (n, 2), mm."""
        inner = self._compiled
        result: Array = inner.kernels.settled(inner.vector(x), *inner.constants[:4], inner.constants[-1])
        return result

    def offset_errors(self, x: Array) -> Array:
        """Return the errors of the sensor zero positions that follow from x, shape (3,), rad, eq. (4)."""
        inner = self._compiled
        result: Array = inner.kernels.offset_errors(inner.vector(x), *inner.constants[:2])
        return result

    def offsets(self, x: Array) -> Array:
        """Return the estimated sensor zero positions, shape (3,), rad: at `start` Table 1's initial estimation."""
        return np.asarray(self.zero_positions + self.offset_errors(x))

    @property
    def readings(self) -> Array:
        """Return the encoder readings recorded with the true zero positions, shape (n, 3), rad, eq. (1)."""
        return np.asarray(self.commanded - self.zero_positions + self.reading_errors)

    @property
    def coordinates(self) -> tuple[Parameter, ...]:
        """Return what the vector x holds: the parameters themselves."""
        return self.parameters

    def with_reading_errors(self, errors: Array) -> Tracking:
        """Return the problem whose recorded readings are wrong by `errors`, shape (n, 3), rad (section 2.3).

        Raises `ValueError` for errors of another shape.
        """
        n = len(self.points)
        if np.shape(errors) != (n, 3):
            raise ValueError(f"errors have shape {np.shape(errors)}: ({n}, 3) is needed, a row for a pose")
        return replace(self, reading_errors=frozen(errors))

    @property
    def projectors(self) -> Array:
        """Return P_j of eq. (15) at the commanded poses, shape (n, 3, 3)."""
        projectors: Array = self._compiled.constants[4]
        return projectors

    def residual_noise(self, x: Array) -> Array:
        """Return the weight of each residual for 1 rad of noise on every reading, shape (3n,), whatever x.

        Taken for independent, residuals of this deviation give the exact standard errors: their covariance is P_j / n,
        and as P_j is a projector that keeps them, weighting by it and by 1 / n is the same.
        """
        n = len(self.points)
        return np.full(3 * n, 1.0 / np.sqrt(n))

    def physical(self, x: Array) -> Array:
        """Return the physical parameters of x, which are x."""
        return np.array(x, dtype=float)

    def merit(self, x: Array) -> dict[str, float]:
        """Return the worst error of x [mm] and of the sensor zero positions [rad]; empty where a leg cannot reach."""
        worst = np.abs(self.offset_errors(x)).max()
        if not np.isfinite(worst):
            return {}
        return {"parameter_error_mm": float(np.abs(x - self.truth).max()), "parameter_error_rad": float(worst)}

    @property
    def targets(self) -> tuple[float, ...]:
        """Levels of E whose first crossing is recorded: 1e-9 is an error of 1e-4 rad, 1e-26 success without noise."""
        exact = tuple(10.0**k for k in (-4, -5, -6, -7, -8, -9, -10, *range(-12, -27, -2)))
        if self.drawn is None or self.as_good_as_noise is None:
            return exact
        return levels(self.as_good_as_noise, self.drawn.noise.level, exact)

    @cached_property
    def as_good_as_noise(self) -> float | None:
        """Return the E at which an answer explains the readings as well as the truth does; None of no instance.

        Without noise it is what readings of `FINEST` [rad] would leave. It is one of the targets.
        """
        if self.drawn is None:
            return None
        kept = float(np.trace(self.projectors, axis1=1, axis2=2).mean())  # of three errors a pose, what P_j leaves
        return value_of_noise(self, self.drawn.noise.level, FINEST**2 * kept)

    @cached_property
    def minimum(self) -> float | None:
        """Return the least E in the box, found downhill from the truth; None of no instance."""
        if self.drawn is None:
            return None
        return least_in_box(self) if self.drawn.noise.level > 0 else 0.0

    @property
    def budgets(self) -> dict[str, int]:
        """Evaluations meant by the words `ci` and `paper`; the nine-point procedure itself needs some 120."""
        return {"ci": 20_000, "paper": 100_000}

    @property
    def data_id(self) -> str:
        """Return a digest of path and reading errors, of an instance also of its truth: the same data, the same id."""
        data = self.commanded.tobytes() + self.reading_errors.tobytes()
        return blake2b(data if self.drawn is None else data + self.truth.tobytes(), digest_size=8).hexdigest()

    def compile(self) -> None:
        """Compile (or load from the cache) what an optimiser will call, so that no clock sees it."""
        self._compiled.compile()

    def compile_values(self) -> None:
        """Compile likewise what methods call that ask for values alone."""
        self._compiled.compile_values()


@registry.register("tracking_zero")
def tracking_zero(
    experiment: Literal[1, 2, 3] = 1,
    plan: PlanName = "circle",
    radius: float = 80.0,
    n: int = 60,
    noise: float = 0.0,
    data_seed: int = 0,
    instance: int | None = None,
) -> Tracking:
    """Sensor offsets from the projected tracking error (section 2), from the start of Table 1's `experiment`.

    The geometry is nominal. `radius` [mm] and `n` of the circle are ours, as the paper prints neither. `noise` [rad] is
    the standard deviation of the errors of the recorded readings. Raises `ValueError` for a value out of range.
    """
    name = "tracking_zero"
    chosen: dict[str, Any] = {"experiment": experiment, "plan": plan, "radius": radius, "n": n, "noise": noise}
    chosen = registry.check(name, {**chosen, "data_seed": data_seed})
    if instance is not None:
        return _drawn(registry.check(name, {"instance": instance})["instance"], chosen)
    if chosen["noise"] < 0:
        raise ValueError(f"{name}.noise={chosen['noise']:g}: a standard deviation [rad] cannot be negative")
    if chosen["data_seed"] < 0:
        raise ValueError(f"{name}.data_seed={chosen['data_seed']}: must be 0 or above")
    if chosen["n"] < 2:
        raise ValueError(f"{name}.n={chosen['n']}: a pose gives one equation, so 2 parameters need at least 2 poses")
    where, shake = (np.random.default_rng(s) for s in np.random.SeedSequence(chosen["data_seed"]).spawn(2))
    try:
        points = plan_points(chosen["plan"], home(), chosen["radius"], chosen["n"], where)
    except ValueError as error:
        raise ValueError(f"{name}.{error}") from None
    errors = chosen["noise"] * shake.standard_normal((len(points), 3))
    results, start, misfit = _table1(chosen["experiment"])
    problem = Tracking(
        options=chosen,
        parameters=tuple(Parameter(p, "mm", s, -_BOX, _BOX, 0.0) for p, s in zip(("dx", "dy"), start.tolist())),
        points=frozen(points),
        reading_errors=frozen(errors),
        zero_positions=frozen(results),
        start_misfit=frozen(misfit),
    )
    if not np.isfinite(problem.commanded).all():
        bad, leg = np.argwhere(~np.isfinite(problem.commanded))[0]
        x, y = points[bad]
        raise ValueError(
            f"{name}.radius={chosen['radius']:g}: position ({x:.1f}, {y:.1f}) mm is out of reach of leg {leg + 1}; "
            "take a smaller radius"
        )
    return problem


def tracked(drawn: TrackingInstance, quiet: bool = False) -> Tracking:
    """Return the problem of a drawn machine; `quiet`: with readings that have no noise."""
    plan, box, noise = drawn.plan, drawn.box, 0.0 if quiet else drawn.noise.level
    points, shake = plan.points(drawn.noise.data_seed)
    sides = zip(("dx", "dy"), *(a.tolist() for a in (drawn.start, box.lower, box.upper, box.truth)))
    return Tracking(
        options={"experiment": 1, "instance": drawn.instance, **dict.fromkeys(drawn.options)},
        parameters=tuple(Parameter(name, "mm", *side) for name, *side in sides),
        points=frozen(points),
        reading_errors=frozen(noise * shake.standard_normal((len(points), 3))),
        zero_positions=frozen(drawn.machine[12:15]),
        start_misfit=frozen(np.zeros(3)),
        machine=drawn.machine,
        reference=frozen([*plan.centre, *box.truth]),
        drawn=drawn,
    )


@lru_cache(maxsize=256)  # a problem is a value, and drawing it takes a hundred times as long as a call
def _made(instance: int) -> Tracking:
    return tracked(tracking_instance(instance))


def _drawn(instance: int, chosen: dict[str, Any]) -> Tracking:
    """Return the problem that the instance draws; raise `ValueError` where other options were given than it has."""
    check_instance("tracking_zero", instance)
    problem = _made(instance)
    declared = registry.options("tracking_zero")
    given = {key: value for key, value in chosen.items() if value != declared[key].default}
    refuse_drawn("tracking_zero", instance, given, {"experiment": 1, **tracking_instance(instance).options})
    return problem


def _table1(experiment: int) -> tuple[Array, Array, Array]:
    """Return Table 1's resulting zero positions, the (dx, dy) its initial ones correspond to, and what that leaves.

    Initial minus result is dz, three numbers of (dx, dy): theta(O) - theta(O + x) = dz by least squares (Gauss-Newton).
    """
    from calibench.problems.planar import _tracking_kernels

    initial, result = (
        np.array([constants.column(_PAPER, f"table1.experiment{experiment}_{which}")[z] for z in _OFFSETS])
        for which in ("initial", "result")
    )
    machine, x = makers_machine(), np.zeros(2)
    misfit = initial - result
    for _ in range(20):  # each takes off two decades and more
        _, slopes = _tracking_kernels.joint_angles(machine, (home() + x)[None])
        x = x - np.linalg.lstsq(slopes[0], misfit)[0]  # ddz = -J dx
        misfit = initial - result - _tracking_kernels.offset_errors(x, machine, frozen([*home(), 0.0, 0.0]))
    return result, x, misfit


def _projectors(slopes: Array) -> Array:
    """Return P_j, shape (n, 3, 3), of Jacobians J_j, shape (n, 3, 2)."""
    transposed = slopes.transpose(0, 2, 1)
    return np.asarray(np.eye(3) - slopes @ np.linalg.solve(transposed @ slopes, transposed))  # eq. (15), corrected


_FAMILY = "tracking_zero"
_FEWEST_POSES = 9
_HALF = np.array([10.0, 10.0])  # mm


@final
@dataclass(frozen=True, eq=False)
class TrackingInstance:
    """What ``instance=K`` of `tracking_zero` draws; `attempts` were drawn until one could be identified."""

    instance: int
    machine: Array
    start: Array
    box: Box
    plan: DrawnPlan
    noise: Noise
    attempts: int

    @property
    def options(self) -> dict[str, Any]:
        """Return what the instance decides of the family's options."""
        return decided(self.plan, self.noise)


@cache
def tracking_instance(instance: int) -> TrackingInstance:
    """Return the instance of this number."""
    return first_that_fits(_FAMILY, instance, lambda attempt: _attempt(instance, attempt))


def _attempt(instance: int, attempt: int) -> TrackingInstance | None:

    streams = {thing: Stream.of(_FAMILY, instance, attempt, thing) for thing in ("machine", "box", "plan", "noise")}
    machine = nominal_machine(streams["machine"])
    start = np.array([round(streams["box"].between(-10, 10), 3) for _ in "xy"])
    box = Box.drawn(streams["box"], start, _HALF, (3, 3))
    plan, noise = DrawnPlan.drawn(streams["plan"], _FEWEST_POSES), Noise.drawn(streams["noise"], *NOISES)
    drawn = TrackingInstance(instance, machine, start, box, plan, noise, attempt + 1)
    points, _ = plan.points(noise.data_seed)
    if not within_reach(machine, points):
        return None
    return drawn if can_be_identified(tracked(drawn, quiet=True), len(start), noise.level) else None
