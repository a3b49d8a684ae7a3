"""`orthoglide6`: joint offsets and leg lengths of an Orthoglide from leg parallelism (Pashkevich et al. 2008).

Unknown are drho_x drho_y drho_z dL_x dL_y dL_z [mm], or three of them (free=rho|L). Gauges tell how far each leg stands
from where it stood at the Zero posture: the paper's measured sets, a user's own table, or a simulated plan.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, final, get_args

import numpy as np

from calibench.core.options import FilePath
from calibench.problems import constants
from calibench.problems.base import Array, Parameter, frozen, numbers_of, registry
from calibench.problems.identifiability import Identifiability, identify
from calibench.problems.instances import check_instance, refuse_drawn
from calibench.problems.orthoglide.instances import OrthoglideInstance, orthoglide_instance
from calibench.problems.orthoglide.kinematics import NAMES, PAPER
from calibench.problems.orthoglide.leg_parallelism import Orthoglide
from calibench.problems.orthoglide.measured import check_deviations, measured, read_plan, read_table
from calibench.problems.orthoglide.plans import Plan, PlanName, check_plan, differences, named_plan

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
