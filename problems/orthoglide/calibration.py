"""`orthoglide6`: joint offsets and leg lengths of an Orthoglide from leg parallelism (Pashkevich et al. 2008).

Unknown are drho_x drho_y drho_z dL_x dL_y dL_z [mm], or three of them (free=rho|L). Gauges tell how far each leg stands
from where it stood at the Zero posture: the paper's measured sets, a user's own table, or a simulated plan. The
residuals are modelled minus measured deviations of the legs. `exact` is the machine itself, `linear` its tangent at the
nominal machine, which for the paper's readings is the system (11).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar, Literal, final, get_args

import numpy as np

from calibench.core.options import FilePath
from calibench.problems import constants, instances
from calibench.problems.base import Array, Number, Parameter, frozen, line_of, numbers_of, registry, table_of
from calibench.problems.compiled_problem import CompiledProblem, hold, itself, passed
from calibench.problems.fitting import best_of, least_of_instance, levels_above_minimum, value_of_noise, worst_errors
from calibench.problems.orthoglide import plans
from calibench.problems.orthoglide.kinematics import AXES, NAMES, PAPER, direct_kinematics, geometry, inverse_kinematics
from calibench.problems.orthoglide.plans import Plan, PlanName

FreeName = Literal["full", "rho", "L"]
_FAMILY = "orthoglide6"
OrthoglideInstance = instances.Drawn[None, Plan]  # what is wrong with the machine is in the box
_FREE = {"full": NAMES, "rho": NAMES[:3], "L": NAMES[3:]}
_BOX = 10.0  # mm: the full set's answers go to 6 mm (its standard errors are 8), a single set's to 2
_FINEST = 1e-4  # mm: the readings that an instance without noise is held to


@final
@dataclass(frozen=True, eq=False)
class Orthoglide:
    """Minimise the sum of squared deviations [mm^2] over the free errors [mm] of an Orthoglide.

    A call takes x of shape (dim,) in the order of `parameters`; ``problem(x) == r @ r`` with ``r =
    problem.residuals(x)``, of shape (m,), mm, in the order of `plan`. `deviations`, shape (m,), mm, are the measured.
    `drawn` is the instance of the family; None for the paper's problem. `readings`, shape (m, 7), is the table: leg,
    direction, axis (0 1 2 for x y z), gauge_position, level_mm, against_mm, deviation [mm].
    """

    options: Mapping[str, Any]
    parameters: tuple[Parameter, ...]
    plan: Plan
    deviations: Array
    model: Literal["exact", "linear"]
    drawn: OrthoglideInstance | None = field(default=None, kw_only=True, repr=False)
    coordinates: tuple[Parameter, ...] = field(init=False, repr=False)
    lower: Array = field(init=False, repr=False)
    upper: Array = field(init=False, repr=False)
    start: Array = field(init=False, repr=False)  # the nominal machine
    truth: Array | None = field(init=False, repr=False)
    readings: Array = field(init=False, repr=False)
    data_id: str = field(init=False, repr=False)
    _compiled: CompiledProblem = field(init=False, repr=False)

    name: ClassVar[str] = "orthoglide6"
    noise_unit: ClassVar[str] = "mm"
    unit: ClassVar[str] = "mm²"  # of the sum of squared deviations
    said_if_chosen: ClassVar[tuple[str, ...]] = ("instance",)  # options that rows name only where they were chosen
    budgets: ClassVar[Mapping[str, int]] = {"ci": 5_000, "paper": 100_000}

    __repr__ = line_of
    _repr_html_ = table_of

    @property
    def typical_noise(self) -> float:
        """Return section 3.4's standard deviation of a gauge reading, mm."""
        return constants.column(PAPER, "text.section34")["sigma"]

    def __post_init__(self) -> None:
        # Here, as listing the names must not load the compiler.
        from calibench.problems.orthoglide import _kernels as kernels

        m, dim = len(self.plan), len(self.parameters)
        # postures: the Zero one first, then each level of an axis; rows are leg, direction and two postures
        places: dict[tuple[str, float], int] = {}
        rows = []
        for r in self.plan:
            now, then = (
                0 if level == 0 else places.setdefault((r.axis, level), len(places) + 1)
                for level in (r.level_mm, r.against_mm)
            )
            rows.append((AXES.index(r.leg), AXES.index(r.direction), now, then))
        points = [np.zeros(3), *(level * np.eye(3)[AXES.index(axis)] for axis, level in places)]
        joints = inverse_kinematics(np.array(points))  # as commanded
        free = np.array([NAMES.index(p.name) for p in self.parameters], dtype=np.int64)
        gauge = np.array([r.gauge_position for r in self.plan])
        of_readings, deviations = np.array(rows, dtype=np.int64), np.array(self.deviations)
        machine = (free, geometry().length, joints, of_readings, gauge, deviations)
        constants = (*machine, False, np.zeros(m), np.zeros((m, dim)))
        if self.model == "linear":
            nominal = np.zeros(dim)
            tangent = kernels.residuals(nominal, *constants), kernels.jacobian(nominal, *constants)  # eq. (11)
            constants = (*machine, True, *tangent)
        at = [(AXES.index(r.leg), AXES.index(r.direction), AXES.index(r.axis)) for r in self.plan]
        where = [(*axes, r.gauge_position, r.level_mm, r.against_mm) for axes, r in zip(at, self.plan, strict=True)]
        readings = frozen(np.column_stack([np.array(where, dtype=float), self.deviations]))
        hold(self, self.parameters, kernels, constants, data=readings.tobytes(), readings=readings)

    __call__ = passed(CompiledProblem.cost)
    batch = passed(CompiledProblem.batch)
    residuals = passed(CompiledProblem.residuals)
    jacobian = passed(CompiledProblem.jacobian)
    physical = itself
    compile = passed(CompiledProblem.compile)
    compile_values = passed(CompiledProblem.compile_values)

    def residual_covariance(self, x: Array) -> Array:
        """Return the covariance of the residuals, shape (m, m), for noise of 1 mm on every gauge reading, eq. (14)."""
        return plans.covariance(self.plan)

    def merit(self, x: Array) -> dict[str, float]:
        """Return the errors of an answer where the truth is known: the worst parameter's and the tool's rms [mm].

        kmrmse is the rms distance of the tool centre point from where the true machine brings it, at the nominal joints
        of 27 points of the workspace, 80 mm apart.
        """
        if self.truth is None:
            return {}
        steps = np.array([-80.0, 0.0, 80.0]) - 20.0  # the strokes reach from -100 to 60
        joints = inverse_kinematics(np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3))
        errors = np.zeros((2, 6))
        errors[:, self._compiled.constants[0]] = x, self.truth
        gap = direct_kinematics(joints, errors[0]) - direct_kinematics(joints, errors[1])
        return {"kmrmse": float(np.sqrt((gap**2).sum(axis=1).mean())), **worst_errors(self, x)}

    best = cached_property(best_of)
    minimum = cached_property(least_of_instance)  # f* [mm^2]
    targets = levels_above_minimum
    as_good_as_noise = value_of_noise(lambda self: _FINEST**2 * np.trace(self.residual_covariance(self.start)))


def _declared(
    free: FreeName = "full", model: Literal["exact", "linear"] = "exact",
    data: Literal["exp1", "exp2", "exp2_t1", "exp3_t1", "exp3_t2", "synthetic"] = "exp2", plan: str = "paper",
    sigma: instances.Sigma = 0.0, seed: instances.Seed = 0, readings: FilePath | None = None,
    instance: Number = None,
) -> None:  # fmt: skip
    """Declare the options of `orthoglide6`: plan (a name or a CSV file), sigma [mm] and seed are for data=synthetic."""


@final
class OrthoglideFamily:
    """Joint offsets and leg lengths of the Orthoglide, from how parallel its legs stay.

    Call it with options, or with `from_readings` for measured deviations.
    """

    name = _FAMILY

    def __call__(self, **options: Any) -> Orthoglide:
        """Build the problem with `options` (those of ``bench list problems``)."""
        options = registry.check(self.name, options)
        chosen = registry.complete(self.name, options)
        if chosen.pop("instance") is not None:
            return _drawn(tuple(sorted(options.items())))
        if chosen["readings"] is not None:
            return self._own(chosen["readings"], None, options)
        if chosen["data"] != "synthetic":
            _refuse(options, ("plan", "sigma", "seed"), f"data={chosen['data']} is measured; take data=synthetic")
            plan, deviations = plans.measured(chosen["data"])
            chosen |= {"plan": None, "sigma": None, "seed": None}
            return _seen(chosen, plan, deviations, f"data={chosen['data']}")

        # the deviations that a machine with Table 3's errors gives, with noise on every gauge reading, Zero too
        name = chosen["plan"]
        try:
            is_file = name not in get_args(PlanName) and Path(name).is_file()
            plan = plans.read_table(name, deviations=False)[0] if is_file else plans.named_plan(name)
        except ValueError as error:
            raise ValueError(f"orthoglide6.{error}") from None
        column = constants.column(PAPER, f"table3.exp2_{chosen['free']}")
        true = {p: column[p] for p in _FREE[chosen["free"]]}
        quiet = _seen(chosen, plan, np.zeros(len(plan)), f"plan={chosen['plan']}", true)
        deviations = _read(quiet, quiet.start if quiet.truth is None else quiet.truth, chosen)
        return replace(quiet, deviations=frozen(deviations))

    def from_readings(
        self, readings: str | Path | Sequence[float] | Array, plan: Plan | str | None = None, **options: Any
    ) -> Orthoglide:
        """Build the problem from measured deviations [mm]: a CSV file, or an array of shape (m,) with its plan.

        `plan` is a tuple of `Reading`s or the name of a plan; a CSV file carries its own. Raises `ValueError` for a
        missing cell, a wrong unit, a posture out of reach, or too few readings for the free parameters.
        """
        return self._own(readings, plan, registry.check(self.name, options))

    def _own(self, readings: Any, plan: Plan | str | None, options: dict[str, Any]) -> Orthoglide:
        drawn_or_simulated = ("data", "plan", "sigma", "seed", "instance")
        _refuse(options, drawn_or_simulated, "the readings are measured; leave one of the two out")
        chosen = registry.complete(self.name, options)
        del chosen["instance"]
        chosen |= dict.fromkeys(("data", "plan", "sigma", "seed", "readings"))
        if isinstance(readings, str | Path):
            if plan is not None:
                raise ValueError(f"plan: {readings} carries its own plan; leave it out")
            rows, deviations = plans.read_table(readings)
            chosen["readings"] = str(readings)
            return _seen(chosen, rows, deviations, f"readings={readings}")
        if plan is None:
            raise ValueError("plan: an array of deviations needs the plan it was read with, such as plan='paper'")
        rows = plans.named_plan(plan) if isinstance(plan, str) else tuple(plan)
        deviations = numbers_of(readings)
        if deviations.shape != (len(rows),):
            raise ValueError(
                f"readings have shape {deviations.shape}: ({len(rows)},) is needed, one for each of the plan"
            )
        plans.check_plan(rows)
        plans.check_deviations(deviations)
        return _seen(chosen, rows, deviations, "readings")


orthoglide6 = OrthoglideFamily()
registry.register(_FAMILY, options=_declared)(orthoglide6)


@lru_cache(maxsize=256)  # a problem is a value, and drawing it takes a hundred times as long as a call
def _drawn(given: tuple[tuple[str, Any], ...]) -> Orthoglide:
    chosen = registry.complete(_FAMILY, dict(given))
    instance: int = chosen["instance"]

    if chosen["readings"] is not None:
        raise ValueError(f"{_FAMILY}.instance={instance}: draws a machine, but its readings are given; leave one out")
    drawn = instances.first_that_fits(_FAMILY, instance, partial(_attempt, chosen["free"], instance))
    instances.refuse_drawn(_FAMILY, instance, dict(given), dict(drawn.options))
    return _taken({**chosen, **drawn.options}, drawn)


@cache
def _attempt(free: str, instance: int, attempt: int) -> OrthoglideInstance | None:
    """Return what an attempt draws; None where it cannot be built or not identified."""
    things = ("box", "plan", "noise")
    streams = {thing: instances.Stream.of(_FAMILY, instance, attempt, thing) for thing in things}
    box = instances.Box.drawn(streams["box"], np.zeros(6), np.full(6, 5.0), [3] * 6)
    name: PlanName = streams["plan"].one_of(get_args(PlanName))
    chance = streams["plan"].between(0.6, 1)
    readings = tuple(reading for reading in plans.named_plan(name) if streams["plan"].between(0, 1) < chance)
    if len(readings) < 2 * len(_FREE[free]):
        return None
    noise = instances.Noise.drawn(streams["noise"], 1e-3, 2e-2)  # mm
    options = {"data": "synthetic", "plan": name, "sigma": noise.level, "seed": noise.data_seed}
    drawn = OrthoglideInstance(None, box, readings, noise, options, attempt + 1)
    problem = _taken({"free": free, "model": "exact", **options, "sigma": 0.0}, drawn)
    if not np.isfinite(problem.deviations).all():
        return None
    return drawn if instances.can_be_identified(problem, len(_FREE[free]), noise.level) else None


def _taken(chosen: dict[str, Any], drawn: OrthoglideInstance) -> Orthoglide:
    """Take the deviations that the drawn machine gives, with noise on every gauge reading, Zero too."""
    place = [NAMES.index(p) for p in _FREE[chosen["free"]]]
    sides = (drawn.box.lower[place], drawn.box.upper[place], drawn.box.truth[place])
    rows = zip(_FREE[chosen["free"]], *(side.tolist() for side in sides))
    parameters = tuple(Parameter(p, "mm", 0.0, *side) for p, *side in rows)
    says = chosen | dict.fromkeys(drawn.options)  # the instance says it all
    silent = Orthoglide(says, parameters, drawn.plan, frozen(np.zeros(len(drawn.plan))), chosen["model"])
    deviations = _read(silent, drawn.box.truth[place], chosen)
    return replace(silent, deviations=frozen(deviations), drawn=drawn)


def _read(silent: Orthoglide, truth: Array, chosen: Mapping[str, Any]) -> Array:
    """Return the deviations that the machine `truth` gives, with noise, eq. (13)."""
    taken = plans.differences(silent.plan)
    noise = chosen["sigma"] * np.random.default_rng(chosen["seed"]).standard_normal(taken.shape[1])
    return np.asarray(silent.residuals(truth) + taken @ noise)


def _seen(
    chosen: dict[str, Any], plan: Plan, deviations: Array, what: str, true: Mapping[str, float] | None = None
) -> Orthoglide:
    """Make the problem's value; raise `ValueError` where the readings cannot see the free parameters."""
    names = _FREE[chosen["free"]]
    if len(plan) < len(names):
        raise ValueError(f"orthoglide6: {what} has {len(plan)} rows; {len(names)} parameters need {len(names)} or more")
    parameters = tuple(Parameter(p, "mm", 0.0, -_BOX, _BOX, None if true is None else true[p]) for p in names)
    problem = Orthoglide(chosen, parameters, plan, frozen(deviations), chosen["model"])
    s = np.linalg.svd(problem.jacobian(problem.start), compute_uv=False)
    rank = int((s > 1e-9 * s[0]).sum())
    if rank < len(names):
        kind, remedy = "rows", "more postures, or free=rho or free=L"
        if all(r.against_mm for r in plan):
            kind = "differences of Max and Min"
            remedy = "free=rho or free=L, or twelve deviations against Zero such as data=exp2"
        raise ValueError(
            f"orthoglide6.free={chosen['free']}: the {len(plan)} {kind} of {what} see {rank} of {len(names)} "
            f"parameters; take {remedy}"
        )
    return problem


def _refuse(options: Mapping[str, Any], keys: Sequence[str], why: str) -> None:
    for key in keys:
        if options.get(key) is not None:
            raise ValueError(f"orthoglide6.{key}={options[key]}: {why}")
