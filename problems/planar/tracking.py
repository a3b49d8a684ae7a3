"""`tracking_zero`: sensor zero positions from the projected tracking error (Cong et al. 2008, section 2).

By hand the end-effector is put on a reference point O, but it really stands at O + (dx, dy), the unknowns, so the zero
positions taken there are wrong. The machine tracks a circle about O with them; the part of its motors' tracking errors
which no motion explains, eq. (17), tells how wrong: E, eq. (19), is least at (0, 0), and zero without reading errors.
Reading errors delta_j enter only as P_j delta_j (Proposition 1); the minimum stays where these have mean zero
(Proposition 2 asks for more, as P_j changes along the circle).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache, partial
from typing import Any, ClassVar, Literal, final

import numpy as np

from calibench.problems import constants, instances
from calibench.problems.base import Array, Number, Parameter, frozen, line_of, registry, table_of
from calibench.problems.compiled_problem import CompiledProblem, hold, itself, passed
from calibench.problems.fitting import least_of_instance, levels, value_of_noise
from calibench.problems.planar import gpm2002
from calibench.problems.planar.gpm2002 import PlanName, home, makers_machine

_PAPER = "cong2008"
_FAMILY = "tracking_zero"
TrackingInstance = instances.Drawn[Array, gpm2002.DrawnPlan]
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
    coordinates: tuple[Parameter, ...] = field(init=False, repr=False)
    lower: Array = field(init=False, repr=False)
    upper: Array = field(init=False, repr=False)
    start: Array = field(init=False, repr=False)  # what the initial zero positions correspond to
    truth: Array = field(init=False, repr=False)
    commanded: Array = field(init=False, repr=False)  # joint angles along the path, (n, 3), rad
    projectors: Array = field(init=False, repr=False)  # P_j of eq. (15) at the commanded poses, (n, 3, 3)
    readings: Array = field(init=False, repr=False)  # those recorded with the true zero positions, (n, 3), rad
    data_id: str = field(init=False, repr=False)
    _compiled: CompiledProblem = field(init=False, repr=False)

    name: ClassVar[str] = "tracking_zero"
    unit: ClassVar[str] = "rad²"  # of E
    said_if_chosen: ClassVar[tuple[str, ...]] = ("instance",)  # options that rows name only where they were chosen
    budgets: ClassVar[Mapping[str, int]] = {"ci": 20_000, "paper": 100_000}  # the nine-point procedure needs some 120

    __repr__ = line_of
    _repr_html_ = table_of

    def __post_init__(self) -> None:
        from calibench.problems.planar import _settling_kernels, _tracking_kernels

        machine = np.array(self.machine)
        angles, slopes = _tracking_kernels.joint_angles(machine, self.points)
        samples = _settling_kernels.samples_of(machine, np.asarray(self.points))
        transposed = slopes.transpose(0, 2, 1)
        projectors = np.asarray(
            np.eye(3) - slopes @ np.linalg.solve(transposed @ slopes, transposed)
        )  # eq. (15) mended
        commanded, known = frozen(angles), frozen(projectors)
        fixed = (machine, self.reference, self.points, commanded, known, self.reading_errors, samples)
        data = commanded.tobytes() + self.reading_errors.tobytes()
        if self.drawn is not None:
            data += self.drawn.box.truth.tobytes()
        readings = frozen(commanded - self.zero_positions + self.reading_errors)  # eq. (1)
        hold(
            self, self.parameters, _tracking_kernels, tuple(frozen(array) for array in fixed), data=data,
            commanded=commanded, projectors=known, readings=readings,
        )  # fmt: skip

    __call__ = passed(CompiledProblem.cost)  # E; NaN where the machine cannot settle
    batch = passed(CompiledProblem.batch)
    residuals = passed(CompiledProblem.residuals)  # projected errors over sqrt(n), rad, (3n,), three of a pose together
    jacobian = passed(CompiledProblem.jacobian)  # by the implicit function theorem, rad/mm
    physical = itself
    compile = passed(CompiledProblem.compile)
    compile_values = passed(CompiledProblem.compile_values)

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

    def with_reading_errors(self, errors: Array) -> Tracking:
        """Return the problem whose recorded readings are wrong by `errors`, shape (n, 3), rad (section 2.3)."""
        n = len(self.points)
        if np.shape(errors) != (n, 3):
            raise ValueError(f"errors have shape {np.shape(errors)}: ({n}, 3) is needed, a row for a pose")
        return replace(self, reading_errors=frozen(errors))

    def residual_noise(self, x: Array) -> Array:
        """Return the weight of each residual for 1 rad of noise on every reading, shape (3n,), whatever x.

        Taken for independent, residuals of this deviation give the exact standard errors: their covariance is P_j / n,
        and as P_j is a projector that keeps them, weighting by it and by 1 / n is the same.
        """
        n = len(self.points)
        return np.full(3 * n, 1.0 / np.sqrt(n))

    def merit(self, x: Array) -> dict[str, float]:
        """Return the worst error of x [mm] and of the sensor zero positions [rad]; empty where a leg cannot reach."""
        worst = np.abs(self.offset_errors(x)).max()
        if not np.isfinite(worst):
            return {}
        return {"parameter_error_mm": float(np.abs(x - self.truth).max()), "parameter_error_rad": float(worst)}

    # 1e-9 is an error of 1e-4 rad, 1e-26 success without noise
    targets = levels(lambda _: tuple(10.0**k for k in (*range(-4, -11, -1), *range(-12, -27, -2))))
    as_good_as_noise = value_of_noise(  # of three errors a pose, what P_j leaves
        lambda self: gpm2002.FINEST**2 * float(np.trace(self.projectors, axis1=1, axis2=2).mean())
    )
    minimum = cached_property(least_of_instance)


@registry.register("tracking_zero")
def tracking_zero(
    experiment: Literal[1, 2, 3] = 1, plan: PlanName = "circle", radius: float = 80.0, n: int = 60,
    noise: instances.Radians = 0.0, data_seed: instances.Seed = 0, instance: Number = None,
) -> Tracking:  # fmt: skip
    """Sensor offsets from the projected tracking error (section 2), from the start of Table 1's `experiment`.

    The geometry is nominal. `radius` [mm] and `n` of the circle are ours, as the paper prints neither. `noise` [rad] is
    the standard deviation of the errors of the recorded readings. Raises `ValueError` for a value out of range.
    """
    given: dict[str, Any] = {"experiment": experiment, "plan": plan, "radius": radius, "n": n, "noise": noise}
    chosen = registry.check(_FAMILY, {**given, "data_seed": data_seed, "instance": instance})
    number: int | None = chosen.pop("instance")
    if number is not None:
        problem = _made(number)
        assert problem.drawn is not None
        declared = registry.options(_FAMILY)
        given = {key: value for key, value in chosen.items() if value != declared[key].default}
        instances.refuse_drawn(_FAMILY, number, given, {"experiment": 1, **problem.drawn.options})
        return problem
    if chosen["n"] < 2:
        raise ValueError(f"{_FAMILY}.n={chosen['n']}: a pose gives one equation, so 2 parameters need at least 2 poses")
    planned = gpm2002.DrawnPlan(chosen["plan"], chosen["radius"], chosen["n"], home())
    try:
        points, shake = planned.points(chosen["data_seed"])
    except ValueError as error:
        raise ValueError(f"{_FAMILY}.{error}") from None
    errors = chosen["noise"] * shake.standard_normal((len(points), 3))

    # Table 1's resulting zero positions, the (dx, dy) its initial ones correspond to, and what that leaves
    from calibench.problems.planar import _tracking_kernels

    columns = (
        constants.column(_PAPER, f"table1.experiment{chosen['experiment']}_{one}") for one in ("initial", "result")
    )
    initial, results = (np.array([column[z] for z in ("z1", "z2", "z3")]) for column in columns)
    machine, start = makers_machine(), np.zeros(2)
    misfit = initial - results
    for _ in range(20):  # each takes off two decades and more
        _, slopes = _tracking_kernels.joint_angles(machine, (home() + start)[None])
        start = start - np.linalg.lstsq(slopes[0], misfit)[0]  # ddz = -J dx
        misfit = initial - results - _tracking_kernels.offset_errors(start, machine, frozen([*home(), 0.0, 0.0]))
    parameters = tuple(Parameter(p, "mm", s, -_BOX, _BOX, 0.0) for p, s in zip(("dx", "dy"), start.tolist()))
    problem = Tracking(
        options=chosen, parameters=parameters, points=frozen(points), reading_errors=frozen(errors),
        zero_positions=frozen(results), start_misfit=frozen(misfit),
    )  # fmt: skip
    gpm2002.refuse_out_of_reach(_FAMILY, chosen["radius"], points, problem.commanded)
    return problem


@lru_cache(maxsize=256)  # a problem is a value, and drawing it takes a hundred times as long as a call
def _made(instance: int) -> Tracking:
    drawn = instances.first_that_fits(_FAMILY, instance, partial(_attempt, instance))
    return _tracked(instance, drawn, drawn.noise.level)


@cache
def _attempt(instance: int, attempt: int) -> TrackingInstance | None:
    """Return what an attempt draws; None where it cannot be built or not identified."""
    things = ("machine", "box", "plan", "noise")
    streams = {thing: instances.Stream.of(_FAMILY, instance, attempt, thing) for thing in things}
    machine = gpm2002.nominal_machine(streams["machine"])
    start = np.array([round(streams["box"].between(-10, 10), 3) for _ in "xy"])
    box = instances.Box.drawn(streams["box"], start, np.full(2, 10.0), (3, 3))
    plan = gpm2002.DrawnPlan.drawn(streams["plan"], gpm2002.FEWEST_POSES)
    noise = instances.Noise.drawn(streams["noise"], *gpm2002.NOISES)
    options: dict[str, Any] = {"plan": plan.kind, "radius": plan.radius, "n": plan.n}
    options |= {"noise": noise.level, "data_seed": noise.data_seed}
    drawn = TrackingInstance(machine, box, plan, noise, options, attempt + 1)
    if not gpm2002.within_reach(machine, plan.points(noise.data_seed)[0]):
        return None
    return drawn if instances.can_be_identified(_tracked(instance, drawn, 0.0), len(start), noise.level) else None


def _tracked(instance: int, drawn: TrackingInstance, noise: float) -> Tracking:
    """Return the problem of a drawn machine, whose readings have errors of a standard deviation `noise`, rad."""
    plan, box = drawn.plan, drawn.box
    points, shake = plan.points(drawn.noise.data_seed)
    sides = zip(("dx", "dy"), *(a.tolist() for a in (box.start, box.lower, box.upper, box.truth)))
    return Tracking(
        options={"experiment": 1, "instance": instance, **dict.fromkeys(drawn.options)},
        parameters=tuple(Parameter(name, "mm", *side) for name, *side in sides), points=frozen(points),
        reading_errors=frozen(noise * shake.standard_normal((len(points), 3))),
        zero_positions=frozen(drawn.machine[12:15]), start_misfit=frozen(np.zeros(3)), machine=drawn.machine,
        reference=frozen([*plan.centre, *box.truth]), drawn=drawn,
    )  # fmt: skip
