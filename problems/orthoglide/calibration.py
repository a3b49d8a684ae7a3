"""`orthoglide6`: joint offsets and leg lengths of an Orthoglide from leg parallelism (Pashkevich et al. 2008).

Unknown are drho_x drho_y drho_z dL_x dL_y dL_z [mm], or three of them (free=rho|L). Gauges tell how far each leg stands
from where it stood at the Zero posture: the paper's measured sets, a user's own table, or a simulated plan.

`Orthoglide`: the six errors of an Orthoglide from the parallelism of its legs (Pashkevich et al. 2008).

The residuals are modelled minus measured deviations of the legs. `exact` is the machine itself, `linear` its tangent at
the nominal machine, which for the paper's readings is the system (11).

Instances of `orthoglide6`: another machine, plan, noise and box for each ``instance=K``. Its data are synthetic.

- *true machine*: the errors that are free are wrong as `problems.instances` says of the *box*, with h = 5 mm about the
  nominal machine, to .001 mm; those that are held are zero.
- *plan*: a part of one of the named plans (`named_plan`): each of its readings stays with a chance uniform in .6 .. 1,
  and at least twice as many as parameters must stay.
- *noise* of a gauge reading: none, or .001 .. .02 mm. What is read once at Zero is shared, as eq. (13) has it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from hashlib import blake2b
from pathlib import Path
from typing import Any, ClassVar, Literal, final, get_args

import numpy as np

from calibench.core.options import FilePath
from calibench.problems import constants
from calibench.problems.base import Array, Parameter, frozen, line_of, numbers_of, registry, table_of
from calibench.problems.compiled_problem import CompiledProblem
from calibench.problems.fitting import fit, least_in_box, levels, value_of_noise
from calibench.problems.identifiability import Identifiability, identify
from calibench.problems.instances import (
    Box,
    Noise,
    Stream,
    can_be_identified,
    check_instance,
    first_that_fits,
    refuse_drawn,
)
from calibench.problems.orthoglide.kinematics import AXES, NAMES, PAPER, direct_kinematics, geometry, inverse_kinematics
from calibench.problems.orthoglide.measured import check_deviations, measured, read_plan, read_table
from calibench.problems.orthoglide.plans import (
    Plan,
    PlanName,
    check_plan,
    covariance,
    differences,
    named_plan,
    postures,
)


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


NOISES = (1e-3, 2e-2)  # mm
FINEST = 1e-4  # mm: the readings that an instance without noise is held to
_FAMILY = "orthoglide6"
_HALF, _DIGITS = 5.0, 3  # mm


@final
@dataclass(frozen=True, eq=False)
class OrthoglideInstance:
    """What ``instance=K`` of `orthoglide6` draws; `attempts` were drawn until one could be identified.

    `readings` are those of the named `plan` that are taken.
    """

    box: Box
    plan: PlanName
    readings: Plan
    noise: Noise
    attempts: int

    @property
    def options(self) -> dict[str, Any]:
        """Return what the instance decides of the family's options."""
        return {"data": "synthetic", "plan": self.plan, "sigma": self.noise.level, "seed": self.noise.data_seed}


@cache
def orthoglide_instance(free: tuple[str, ...], instance: int, build: Callable[..., Any]) -> OrthoglideInstance:
    """Return the instance whose free errors are `free`; ``build(free, drawn)`` makes its problem without noise."""
    return first_that_fits(_FAMILY, instance, lambda attempt: _attempt(free, instance, attempt, build))


def _attempt(
    free: tuple[str, ...], instance: int, attempt: int, build: Callable[..., Any]
) -> OrthoglideInstance | None:
    streams = {thing: Stream.of(_FAMILY, instance, attempt, thing) for thing in ("box", "plan", "noise")}
    every = np.zeros(6)
    box = Box.drawn(streams["box"], every, np.full(6, _HALF), [_DIGITS] * 6)
    name: PlanName = streams["plan"].one_of(get_args(PlanName))
    chance = streams["plan"].between(0.6, 1)
    readings = tuple(reading for reading in named_plan(name) if streams["plan"].between(0, 1) < chance)
    if len(readings) < 2 * len(free):
        return None
    drawn = OrthoglideInstance(box, name, readings, Noise.drawn(streams["noise"], *NOISES), attempt + 1)
    problem = build(free, drawn)
    if not np.isfinite(problem.deviations).all():
        return None
    return drawn if can_be_identified(problem, len(free), drawn.noise.level) else None


FreeName = Literal["full", "rho", "L"]
_FREE = {"full": NAMES, "rho": NAMES[:3], "L": NAMES[3:]}
_BOX = 10.0  # mm: the full set's answers go to 6 mm (its standard errors are 8), a single set's to 2


def _declared(
    free: FreeName = "full",
    model: Literal["exact", "linear"] = "exact",
    data: Literal["exp1", "exp2", "exp2_t1", "exp3_t1", "exp3_t2", "synthetic"] = "exp2",
    plan: str = "paper",
    sigma: float = 0.0,
    seed: int = 0,
    readings: FilePath | None = None,
    instance: int | None = None,
) -> None:
    """Declare the options of `orthoglide6`: plan (a name or a CSV file), sigma [mm] and seed are for data=synthetic."""


@final
class OrthoglideFamily:
    """Joint offsets and leg lengths of the Orthoglide, from how parallel its legs stay.

    Call it with options, or with `from_readings` for measured deviations.
    """

    name = "orthoglide6"
    said_if_chosen = ("instance",)  # so that the rows of the paper's problem stay as they were

    def __call__(self, **options: Any) -> Orthoglide:
        """Build the problem with `options` (those of ``bench list problems``)."""
        options = registry.check(self.name, options)
        chosen = _chosen(options)
        if options.get("instance") is not None:
            return _drawn(tuple(sorted(options.items())))
        if chosen["readings"] is not None:
            return self._own(chosen["readings"], None, options)
        if chosen["data"] == "synthetic":
            return _simulate(chosen)
        _refuse(options, ("plan", "sigma", "seed"), f"data={chosen['data']} is measured; take data=synthetic")
        plan, deviations = measured(chosen["data"])
        chosen |= {"plan": None, "sigma": None, "seed": None}
        return _assemble(chosen, plan, deviations, f"data={chosen['data']}")

    def from_readings(
        self, readings: str | Path | Sequence[float] | Array, plan: Plan | str | None = None, **options: Any
    ) -> Orthoglide:
        """Build the problem from measured deviations [mm]: a CSV file, or an array of shape (m,) with its plan.

        `plan` is a tuple of `Reading`s or the name of a plan; a CSV file carries its own. Raises `ValueError` for a
        missing cell, a wrong unit, a posture out of reach, or too few readings for the free parameters.
        """
        return self._own(readings, plan, registry.check(self.name, options))

    def survey(self, plan: Plan | str, free: FreeName = "full", sigma: float = 0.01) -> Identifiability:
        """Tell what a plan could find before anything is measured: rank, condition, standard errors at `sigma` [mm].

        `plan` is a tuple of `Reading`s, the name of a plan, or a CSV file. `sigma` is the noise of one gauge reading;
        each Zero is read once and shared. A plan that cannot see all parameters is told, not refused.

        >>> [round(float(orthoglide6.survey(plan).standard_errors.max()), 2) for plan in ("paper", "cross", "rich")]
        [0.73, 0.3, 0.1]
        """
        rows = _plan(plan) if isinstance(plan, str) else tuple(plan)
        check_plan(rows)
        if not rows:
            raise ValueError("plan: it has no readings")
        chosen = registry.check(self.name, {"free": free}) | {"model": "exact"}
        return identify(_problem(chosen, rows, np.zeros(len(rows))), noise=sigma)

    def _own(self, readings: Any, plan: Plan | str | None, options: dict[str, Any]) -> Orthoglide:
        drawn_or_simulated = ("data", "plan", "sigma", "seed", "instance")
        _refuse(options, drawn_or_simulated, "the readings are measured; leave one of the two out")
        chosen = _chosen(options) | {"data": None, "plan": None, "sigma": None, "seed": None, "readings": None}
        if isinstance(readings, str | Path):
            if plan is not None:
                raise ValueError(f"plan: {readings} carries its own plan; leave it out")
            rows, deviations = read_table(readings)
            chosen["readings"] = str(readings)
            return _assemble(chosen, rows, deviations, f"readings={readings}")
        if plan is None:
            raise ValueError("plan: an array of deviations needs the plan it was read with, such as plan='paper'")
        rows = named_plan(plan) if isinstance(plan, str) else tuple(plan)
        deviations = numbers_of(readings)
        if deviations.shape != (len(rows),):
            raise ValueError(
                f"readings have shape {deviations.shape}: ({len(rows)},) is needed, one for each of the plan"
            )
        check_plan(rows)
        check_deviations(deviations)
        return _assemble(chosen, rows, deviations, "readings")


orthoglide6 = OrthoglideFamily()
registry.register("orthoglide6", options=_declared)(orthoglide6)


def _chosen(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return checked options with the defaults; of the paper's problems without `instance`."""
    bound = inspect.signature(_declared).bind(**options)
    bound.apply_defaults()
    return {key: value for key, value in bound.arguments.items() if key != "instance" or value is not None}


@lru_cache(maxsize=256)  # a problem is a value, and drawing it takes a hundred times as long as a call
def _drawn(given: tuple[tuple[str, Any], ...]) -> Orthoglide:
    """Return the problem that the instance draws: another machine, plan, noise and box."""
    name, chosen = "orthoglide6", _chosen(dict(given))
    instance: int = chosen["instance"]
    check_instance(name, instance)
    if chosen["readings"] is not None:
        raise ValueError(f"{name}.instance={instance}: draws a machine, but its readings are given; leave one out")
    drawn = orthoglide_instance(_FREE[chosen["free"]], instance, _without_noise)
    refuse_drawn(name, instance, dict(given), drawn.options)
    return _taken(chosen | drawn.options, drawn)


def _without_noise(free: tuple[str, ...], drawn: OrthoglideInstance) -> Orthoglide:
    """Return the problem of the exact machine that reads without noise, to be looked at before it is taken."""
    named = next(key for key, names in _FREE.items() if names == free)
    return _taken({"free": named, "model": "exact", **drawn.options, "sigma": 0.0}, drawn)


def _taken(chosen: dict[str, Any], drawn: OrthoglideInstance) -> Orthoglide:
    """Take the deviations that the drawn machine gives, with noise on every gauge reading, Zero too."""
    place = [NAMES.index(p) for p in _FREE[chosen["free"]]]
    sides = (drawn.box.lower[place], drawn.box.upper[place], drawn.box.truth[place])
    rows = zip(_FREE[chosen["free"]], *(side.tolist() for side in sides))
    parameters = tuple(Parameter(p, "mm", 0.0, *side) for p, *side in rows)
    says = chosen | dict.fromkeys(drawn.options)  # the instance says it all
    silent = Orthoglide(says, parameters, drawn.readings, frozen(np.zeros(len(drawn.readings))), chosen["model"])
    taken = differences(drawn.readings)
    noise = chosen["sigma"] * np.random.default_rng(chosen["seed"]).standard_normal(taken.shape[1])
    deviations = silent.residuals(drawn.box.truth[place]) + taken @ noise  # eq. (13)
    return Orthoglide(says, parameters, drawn.readings, frozen(deviations), chosen["model"], drawn=drawn)


def _simulate(chosen: dict[str, Any]) -> Orthoglide:
    """Take the deviations that a machine with Table 3's errors gives, with noise on every gauge reading, Zero too."""
    name, sigma = "orthoglide6", chosen["sigma"]
    if sigma < 0:
        raise ValueError(f"{name}.sigma={sigma:g}: a standard deviation [mm] cannot be negative")
    if chosen["seed"] < 0:
        raise ValueError(f"{name}.seed={chosen['seed']}: must be 0 or above")
    plan = _plan(chosen["plan"])
    column = constants.column(PAPER, f"table3.exp2_{chosen['free']}")
    true = {p: column[p] for p in _FREE[chosen["free"]]}
    quiet = _assemble(chosen, plan, np.zeros(len(plan)), f"plan={chosen['plan']}", true)
    taken = differences(plan)
    noise = sigma * np.random.default_rng(chosen["seed"]).standard_normal(taken.shape[1])
    deviations = quiet.residuals(quiet.start if quiet.truth is None else quiet.truth) + taken @ noise  # eq. (13)
    return _assemble(chosen, plan, deviations, f"plan={chosen['plan']}", true)


def _plan(plan: str) -> Plan:
    """Return a named plan, or that of a CSV file."""
    try:
        return read_plan(plan) if plan not in get_args(PlanName) and Path(plan).is_file() else named_plan(plan)
    except ValueError as error:
        raise ValueError(f"orthoglide6.{error}") from None


def _assemble(
    chosen: dict[str, Any], plan: Plan, deviations: Array, what: str, true: Mapping[str, float] | None = None
) -> Orthoglide:
    """Make the problem's value; raise `ValueError` where the readings cannot see the free parameters."""
    names = _FREE[chosen["free"]]
    if len(plan) < len(names):
        raise ValueError(f"orthoglide6: {what} has {len(plan)} rows; {len(names)} parameters need {len(names)} or more")
    problem = _problem(chosen, plan, deviations, true)
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


def _problem(
    chosen: dict[str, Any], plan: Plan, deviations: Array, true: Mapping[str, float] | None = None
) -> Orthoglide:
    return Orthoglide(
        options=chosen,
        parameters=tuple(
            Parameter(p, "mm", 0.0, -_BOX, _BOX, None if true is None else true[p]) for p in _FREE[chosen["free"]]
        ),
        plan=plan,
        deviations=frozen(deviations),
        model=chosen["model"],
    )


def _refuse(options: Mapping[str, Any], keys: Sequence[str], why: str) -> None:
    for key in keys:
        if options.get(key) is not None:
            raise ValueError(f"orthoglide6.{key}={options[key]}: {why}")
