"""One run: a problem, an optimiser, a budget and a repetition make one row, whatever happens.

Converged, exhausted, on target or crashed: the row says which. Compilation happens before the clock starts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from numbers import Real
from typing import TYPE_CHECKING, Any, Literal, final

import numpy as np
from numpy.typing import NDArray

from calibench import optimizers, problems
from calibench.bench.execution.code_digest import code_digest, library_of
from calibench.bench.execution.evaluator import Evaluator, TracePoint
from calibench.bench.execution.frames import frames_of
from calibench.bench.execution.merit import merit_columns
from calibench.bench.execution.own_problem import OPTIONAL, check_extras, minimum_of, unit_of
from calibench.bench.execution.provenance import provenance
from calibench.bench.execution.run_id import canonical, chosen_options, digest, name_of, options_of, seed_sequence
from calibench.bench.execution.stochastic import hits_of_the_answer, is_stochastic, judged, seeded
from calibench.bench.execution.time_limit import QUIET, Ending, run_here, run_watched, text_of
from calibench.problems.base import coordinates_of, parameters_of

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
Start = Literal["nominal", "random"]


@final
@dataclass(frozen=True)
class Spec:
    """What a run is, in values: enough to do it anywhere, and to know whether it has been done.

    Options are those given; names are those of the registries, ``pkg.module:Class`` or ``/place/of/file.py:Class``,
    as a process anywhere finds them. `time_limit` is no part
    of what a run is: its id does not hold it, and a run that ends in time is the same to the last bit.
    """

    problem: str
    problem_options: Mapping[str, Any]
    optimizer: str
    optimizer_options: Mapping[str, Any]
    budget: int
    repetition: int
    start: Start | None = None
    target: float | None = None
    time_limit: float | None = None

    def execute(self) -> Run:
        """Build problem and optimiser and run them."""
        return execute(
            problems.make(self.problem, **self.problem_options),
            optimizers.make(self.optimizer, **self.optimizer_options),
            budget=self.budget,
            seed=self.repetition,
            start=self.start,
            target=self.target,
            time_limit=self.time_limit,
        )


@final
@dataclass(frozen=True, eq=False)
class Run:
    """What came of a run. `row` holds every column of ``runs.parquet`` but the study."""

    row: Mapping[str, Any]
    points: tuple[TracePoint, ...]

    @property
    def run_id(self) -> str:
        """Return the id that names this run: a digest of what it is."""
        return str(self.row["run_id"])

    @property
    def best_x(self) -> Array | None:
        """Return the best point found, shape (dim,); None where no finite value was."""
        best = self.row["best_x"]
        return None if best is None else np.array(best)

    @property
    def best_value(self) -> float:
        """Return the best value found; infinite where no finite value was."""
        return float(self.row["best_value"])

    @property
    def evaluations(self) -> int:
        """Return the number of evaluations."""
        return int(self.row["evaluations"])

    @property
    def charged(self) -> int:
        """Return evaluations and `dimension` for each Jacobian."""
        return int(self.row["charged"])

    @property
    def status(self) -> str:
        """Return ok, failed or timeout."""
        return str(self.row["status"])

    @property
    def stop_reason(self) -> str:
        """Return converged, budget, target, failed or timeout."""
        return str(self.row["stop_reason"])

    @property
    def trace(self) -> pd.DataFrame:
        """Return the best value over evaluations: columns evaluations, charged, best_value, restart."""
        import pandas as pd

        return pd.DataFrame(self.points, columns=["evaluations", "charged", "best_value", "restart"])


def execute(
    problem: Any,
    optimizer: Any,
    budget: int,
    seed: int = 0,
    *,
    start: Start | Array | None = None,
    target: float | None = None,
    problem_name: str | None = None,
    optimizer_name: str | None = None,
    time_limit: float | None = None,
) -> Run:
    """Minimise `problem` with `optimizer` within `budget` evaluations; `seed` is the repetition.

    `problem` is any object with `lower`, `upper`, `start` and a call. `start` is "nominal" (the problem's own),
    "random" (uniform in the box, the same for all optimisers), or a point; by default what the problem prefers.
    `time_limit` [s] ends it, as a row of status timeout with all that was found until then; the run then lives in a
    forked child, so that what loops in C ends too, and what the problem changes in memory is not seen here. An
    optimiser that may hang always runs so, and is ended after a minute without an evaluation.
    Raises `ValueError` for a request that makes no sense; a run that has begun never raises, its row tells.
    """
    check_request(problem, optimizer, budget, seed, target, time_limit)
    budget, seed, target = int(budget), int(seed), None if target is None else float(target)
    who = name_of(problem) if problem_name is None else problem_name
    method = name_of(optimizer) if optimizer_name is None else optimizer_name
    problem_options, optimizer_options = options_of(problem), options_of(optimizer)
    problem_key, optimizer_key = key_of_problem(problem, who), key_of_optimizer(optimizer, method)
    label, first = _starting_point(problem, start, problem_key, seed)
    rng = np.random.default_rng(seed_sequence(problem_key, optimizer_key, repetition=seed))
    targets = [*getattr(problem, "targets", ())]
    if target is not None and target not in targets:
        targets.append(target)
    code = code_digest(problem, optimizer)
    broken = _compile(problem, optimizer)
    again = seed_sequence(problem_key, "restart", repetition=seed)  # no part of the optimiser: paired across methods
    asked = seeded(problem, problem_key, seed)
    gate = Evaluator(asked, budget, start=first, target=target, targets=targets, restart_seed=again)
    may_hang = getattr(getattr(optimizer, "traits", None), "may_hang", False)
    began = datetime.now(UTC)
    if broken is not None:
        ending = broken
    elif time_limit is None and not may_hang:
        ending = run_here(optimizer, gate, rng)
    else:
        ending = run_watched(optimizer, gate, rng, time_limit, quiet=QUIET if may_hang else None)
    gate.finish()
    ending = _with_an_answer(gate, ending)
    answer, ending = _judged(problem, gate.best_x, ending, problem_key, seed)
    hits, hits_charged = gate.hits, gate.hits_charged
    if is_stochastic(problem):
        hits, hits_charged = hits_of_the_answer(gate, answer.get("judged_value", np.inf))
    row = {
        "run_id": run_id(problem_key, optimizer_key, budget, seed, label if label != "given" else first, target),
        "problem": who,
        "problem_options": canonical(problem_options),
        "data_id": getattr(problem, "data_id", ""),
        "dimension": gate.dimension,
        "optimizer": method,
        "optimizer_options": canonical(optimizer_options),
        **library_of(optimizer),
        "repetition": seed,
        "seed": digest(problem_key, optimizer_key, seed),
        "start": label,
        "budget": budget,
        "target": target,
        "evaluations": gate.evaluations,
        "batch_evaluations": gate.batch_evaluations,
        "residual_evaluations": gate.residual_evaluations,
        "jacobian_evaluations": gate.jacobian_evaluations,
        "charged": gate.charged,
        "non_finite": gate.non_finite,
        "restarts": gate.restarts,
        "status": "failed" if ending.error_type else "timeout" if gate.stopped == "timeout" else "ok",
        "stop_reason": "failed" if ending.error_type else gate.stopped or _natural_end(gate),
        "error_type": ending.error_type,
        "error": ending.error,
        "traceback": ending.traceback,
        "best_value": gate.best_value,
        "best_evaluation": gate.best_evaluation,
        "best_x": None if gate.best_x is None else gate.best_x.tolist(),
        **answer,
        "targets": gate.targets,
        "hits": hits,
        "hits_charged": hits_charged,
        "unit": unit_of(problem),
        "minimum": minimum_of(problem),
        "wall_s": ending.wall_s,
        "cpu_s": ending.cpu_s,
        "started_at": began,
        "code_digest": code,
        **provenance(),
    }
    return Run(row, tuple(gate.trace))


def key_of_problem(problem: Any, name: str) -> list[Any]:
    """Return what names a problem: its name, the options that differ from the declared ones, and its data."""
    return [name, chosen_options(problems.registry, name, options_of(problem)), getattr(problem, "data_id", "")]


def key_of_optimizer(optimizer: Any, name: str) -> list[Any]:
    """Return what names an optimiser: its name and the options that differ from the declared ones."""
    return [name, chosen_options(optimizers.registry, name, options_of(optimizer))]


def run_id(problem_key: Any, optimizer_key: Any, budget: int, repetition: int, start: Any, target: Any) -> str:
    """Return the content id of a run: what it is, not when or where it was done."""
    if isinstance(start, np.ndarray):
        start = start.tolist()
    return digest(problem_key, optimizer_key, budget, repetition, start, target)


def check_request(
    problem: Any, optimizer: Any, budget: Any, seed: Any, target: Any = None, time_limit: Any = None
) -> None:
    """Raise `ValueError` where this problem and optimiser cannot be run with this budget and repetition."""
    if isinstance(budget, bool) or not isinstance(budget, int | np.integer) or budget < 1:
        raise ValueError(f"budget={budget}: a whole number of evaluations, 1 or more, is needed")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"seed={seed}: a whole number, 0 or more, is needed")
    if target is not None and (
        isinstance(target, bool) or not isinstance(target, Real) or not np.isfinite(float(target))
    ):
        raise ValueError(f"target={target}: a finite number is needed")
    if time_limit is not None and not (_is_number(time_limit) and 0 < time_limit < np.inf):
        raise ValueError(f"time_limit={time_limit}: seconds above 0 are needed, or null for no limit")
    who = name_of(problem)
    for attribute in ("lower", "upper", "start", *OPTIONAL):
        try:
            getattr(problem, attribute, None)
        except Exception as error:
            raise ValueError(
                f"problem {who}: its {attribute} cannot be read: {type(error).__name__}: {text_of(error)}"
            ) from error
    missing = [a for a in ("lower", "upper", "start") if not hasattr(problem, a)]
    if missing or not callable(problem):
        raise ValueError(f"problem {who} has no {', '.join(missing) or '__call__'}: lower, upper, start, a call needed")
    lower, upper, start = (np.asarray(getattr(problem, a), dtype=float) for a in ("lower", "upper", "start"))
    if lower.shape == (0,):
        raise ValueError(f"problem {who}: lower is empty: one parameter or more is needed, and this problem has none")
    if lower.ndim != 1 or lower.shape != upper.shape or lower.shape != start.shape:
        raise ValueError(
            f"problem {who}: shapes of lower {lower.shape}, upper {upper.shape}, start {start.shape} differ"
        )
    if not (lower <= upper).all():
        raise ValueError(f"problem {who}: lower[{np.argmin(lower <= upper)}] is above upper, or not a number")
    _check_inside(who, start, lower, upper)
    check_extras(problem, who)
    if target is not None and is_stochastic(problem):
        raise ValueError(
            f"target={target}: problem {who} is stochastic, and a lucky value would end the run; give the problem "
            "targets, which are judged by the answer"
        )
    if not callable(getattr(optimizer, "minimize", None)):
        raise ValueError(f"optimizer {name_of(optimizer)} has no minimize(objective, rng)")
    needs = unmet_need(problem, optimizer)
    if needs:
        raise ValueError(f"{name_of(optimizer)} needs {needs}, and problem {who} has {_has(problem, needs)}")


def unmet_need(problem: Any, optimizer: Any) -> str:
    """Return what `optimizer` needs and `problem` has not, such as "residuals"; '' where it can run."""
    traits = getattr(optimizer, "traits", None)
    if traits is None:
        return ""
    if traits.uses_residuals and getattr(problem, "residuals", None) is None:
        return "residuals"
    least, most, size = traits.minimum_dimension, traits.maximum_dimension, np.size(problem.lower)
    if size < least or (most is not None and size > most):
        return f"{least} or more dimensions" if most is None else f"{least} .. {most} dimensions"
    return ""


def repetitions_of(optimizer: Any, start: Start, wanted: range, stochastic: bool = False) -> range:
    """Return the repetitions that can differ: a deterministic method from one start on one set of data runs once.

    So does, from whatever start, a deterministic method that ignores it. On a problem whose values are noisy
    (`stochastic`) all of them differ.
    """
    traits = getattr(optimizer, "traits", None)
    if stochastic or traits is None or traits.stochastic:
        return wanted
    if start == "nominal" or not traits.uses_start:
        return wanted[:1]
    return wanted


def preferred_start(problem: Any, start: Start | None) -> Start:
    """Return `start`, or what the problem prefers."""
    preferred: Start = getattr(problem, "default_start", "nominal")
    return preferred if start is None else start


def _starting_point(problem: Any, start: Start | Array | None, key: Any, repetition: int) -> tuple[str, Array]:
    lower, upper = np.asarray(problem.lower, dtype=float), np.asarray(problem.upper, dtype=float)
    if start is not None and not isinstance(start, str):
        point = np.array(start, dtype=float)
        if point.shape != lower.shape:
            raise ValueError(f"start has shape {point.shape}, the problem {lower.shape}")
        _check_inside(name_of(problem), point, lower, upper)
        return "given", point
    chosen = preferred_start(problem, start)
    if chosen == "nominal":
        return chosen, np.array(problem.start, dtype=float)
    if chosen != "random":
        raise ValueError(f"start={chosen}: choices: nominal, random")
    if not np.isfinite(upper - lower).all():
        raise ValueError(f"problem {name_of(problem)}: a random start needs finite bounds; take start=nominal")
    rng = np.random.default_rng(seed_sequence(key, "start", repetition=repetition))
    return chosen, np.minimum(lower + rng.random(lower.size) * (upper - lower), upper)


def _check_inside(who: str, start: Array, lower: Array, upper: Array) -> None:
    outside = np.flatnonzero(~((lower <= start) & (start <= upper)))
    if outside.size:
        i = int(outside[0])
        raise ValueError(f"problem {who}: start[{i}]={start[i]:g} lies outside its box {lower[i]:g} .. {upper[i]:g}")


def _has(problem: Any, needs: str) -> str:
    return "none; choose another optimizer" if needs == "residuals" else str(np.size(problem.lower))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _natural_end(gate: Evaluator) -> str:
    return "budget" if gate.remaining <= 0 else "converged"


def _compile(problem: Any, optimizer: Any) -> Ending | None:
    """Do what should not be timed; return the ending of a run whose problem or optimiser fails in it."""
    for part in (problem, optimizer):
        try:
            if hasattr(part, "compile"):
                part.compile()
        except Exception as error:
            said = f"before the first evaluation: {text_of(error)}"
            return Ending(type(error).__name__, said, 0.0, 0.0, frames_of(error))
    return None


def _with_an_answer(gate: Evaluator, ending: Ending) -> Ending:
    """Return the ending, which is a failure where nothing was asked for, or nothing finite came back."""
    if ending.error_type or gate.stopped == "timeout" or gate.best_x is not None:
        return ending
    if gate.charged == 0:
        why = f": the budget of {gate.budget} is below its first step" if gate.stopped == "budget" else ""
        return replace(ending, error_type="NoEvaluation", error=f"the optimizer made no evaluation{why}")
    said = f"none of {gate.evaluations} values was finite" if gate.evaluations else "no value was asked for"
    return replace(ending, error_type="NoFiniteValue", error=said)


def _judged(problem: Any, x: Array | None, ending: Ending, key: Any, repetition: int) -> tuple[dict[str, Any], Ending]:
    """Return what the answer means, and the ending, which is a failure where the problem fails in judging it."""
    found: dict[str, Any] = {"inside_box": False, "at_bound": []}
    try:
        if x is not None:
            found = _answer(problem, x)  # kept, whatever the figures of merit do
            found |= merit_columns(problem.merit(np.array(x))) if hasattr(problem, "merit") else {}
        return found | judged(problem, x, key, repetition), ending
    except Exception as error:
        said = f"in judging the answer: {text_of(error)}"
        failed = replace(ending, error_type=type(error).__name__, error=said, traceback=frames_of(error))
        return found, ending if ending.error_type else failed


def _answer(problem: Any, x: Array) -> dict[str, Any]:
    """Return what the answer means: inside the box or not, at which bounds, physical parameters."""
    lower, upper = np.asarray(problem.lower), np.asarray(problem.upper)
    names = [c.name for c in coordinates_of(problem)]
    near = 1e-9 * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    at_bound = (x <= lower + near) | (x >= upper - near)
    return {
        "inside_box": bool(((lower <= x) & (x <= upper)).all()),
        "at_bound": [name for name, at in zip(names, at_bound, strict=True) if at],
        "parameter_names": [p.name for p in parameters_of(problem)],
        "parameter_values": np.asarray(problem.physical(x) if hasattr(problem, "physical") else x, float).tolist(),
    }
