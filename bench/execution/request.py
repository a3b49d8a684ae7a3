"""The request of a run: checked once, before anything runs, with all that determines its id and its seeds.

A run that has begun raises nothing, so all checks are here; what a property, which is foreign code, raises is reported
in one line. A `Pair` has what is the same in all runs of a problem and an optimiser; those of our own classes are kept.
A user's object is made anew for every run, and its class is first tried in a child process (`probe`).

A problem whose values are noisy says ``stochastic = True`` and draws its noise from ``self.rng``, or has
``seeded(rng)``. Every run works on a copy with a generator seeded by problem and repetition alone. The lowest value
that a run has seen is lucky: the answer is judged by ``noise_free(x)``, or by the mean of `FRESH` evaluations that no
budget pays.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from inspect import getattr_static
from types import FunctionType
from typing import TYPE_CHECKING, Any, Literal, final

import numpy as np
from numpy.typing import NDArray

from calibench import optimizers, problems
from calibench.bench.gate.endings import text_of
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.processes import CAN_FORK, Lost, apart
from calibench.bench.provenance.code_digest import Library, digest_of_method, digest_of_problem, library_of
from calibench.bench.provenance.run_id import canonical, key_of_optimizer, key_of_problem, name_of, options_of, run_id
from calibench.core.options import LARGEST_WHOLE, is_number, shown
from calibench.core.registry import Registry
from calibench.core.seeds import digest, seed_sequence
from calibench.core.sources import is_foreign
from calibench.problems.base import Parameter, coordinates_of, extra_of, parameters_of

if TYPE_CHECKING:
    from calibench.bench.execution.costly import ReplayFolder


@final
@dataclass(frozen=True, eq=False)
class Asked:
    """Problem and optimiser, and the request.

    `start` is the name of the start, `first` the point, shape (dim,); `targets` are the problem's and the run's own.
    """

    pair: Pair
    budget: int
    repetition: int
    start: str
    first: Array
    target: float | None
    targets: list[float]
    inner: int = 1  # processes for its batches
    replay: ReplayFolder | None = None  # where its values are

    @cached_property
    def run_id(self) -> str:
        start = self.first if self.start == "given" else self.start
        pair = self.pair
        return run_id(pair.problem_key, pair.optimizer_key, self.budget, self.repetition, start, self.target)


def read_asked(
    pair: Pair, budget: int, repetition: int, *, start: Start | Array | None = None, target: float | None = None,
    time_limit: float | None = None, inner: int = 1, replay: ReplayFolder | None = None,
) -> Asked:  # fmt: skip
    """Return the request of a run. Raises `ValueError` for a request without meaning."""
    check_numbers(budget, repetition, target, time_limit, pair.problem)
    budget, repetition, target = int(budget), int(repetition), None if target is None else float(target)
    label, first = starting_point(pair.problem, start, pair.problem_word, repetition)
    targets = [*pair.targets]
    if target is not None and target not in targets:
        targets.append(target)
    return Asked(pair, budget, repetition, label, first, target, targets, inner=inner, replay=replay)


_MADE: dict[str, Pair] = {}
_OPTIMIZERS: dict[str, dict[str, Any]] = {}  # what a pair has of an optimiser of ours
_MOST = 64  # of either that a process remembers; a pack is of few


@final
@dataclass(eq=False)
class Pair:
    """Problem and optimiser, their names, options as JSON and keys (what tells them in ids and seeds).

    The words are digests of the keys as numbers; `compiled` says that what comes before a first run has been done.
    """

    problem: Any
    problem_name: str
    problem_options: str
    problem_key: list[Any]
    problem_word: int
    optimizer: Any
    optimizer_name: str
    optimizer_options: str
    optimizer_key: list[Any]
    optimizer_word: int
    parameters: tuple[Parameter, ...]
    coordinate_names: tuple[str, ...]
    targets: tuple[float, ...]
    data_id: str
    unit: str
    problem_group: str
    minimum: float | None
    library: Library
    code_of_problem: str
    code_of_method: str
    foreign_problem: bool
    foreign_optimizer: bool
    may_hang: bool  # the optimiser may loop for ever in foreign code
    compiled: bool = False

    @property
    def code(self) -> str:
        """Return the digest of what runs: `bench.provenance.code_digest`."""
        return f"{self.code_of_problem}.{self.code_of_method}"

    @cached_property
    def box(self) -> tuple[Array, Array, Array, Array]:
        """Return the lower and upper bounds of x, and from where on it is at them: four arrays of shape (dim,)."""
        lower, upper = np.array(self.problem.lower, float), np.array(self.problem.upper, float)
        near = 1e-9 * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
        return lower, upper, lower + near, upper - near


def pair_of(
    problem: Any, optimizer: Any, problem_name: str | None = None, optimizer_name: str | None = None,
    method: dict[str, Any] | None = None,
) -> Pair:  # fmt: skip
    """Raise `ValueError` where the two cannot be run. `method` is what is known of the optimiser, by field."""
    check_pair(problem, optimizer)
    who = name_of(problem) if problem_name is None else problem_name
    problem_key = key_of_problem(problem, who)
    method = _method_of(optimizer, optimizer_name) if method is None else method
    return Pair(
        problem=problem, problem_name=who, problem_options=canonical(options_of(problem)), problem_key=problem_key,
        problem_word=int(digest(problem_key), 16), parameters=parameters_of(problem),
        coordinate_names=tuple(one.name for one in coordinates_of(problem)),
        targets=tuple(extra_of(problem, "targets", ())), data_id=extra_of(problem, "data_id", ""),
        unit=str(extra_of(problem, "unit", "")), problem_group=str(extra_of(problem, "group", "")),
        minimum=minimum_of(problem), code_of_problem=digest_of_problem(problem), foreign_problem=is_foreign(problem),
        **method,
    )  # fmt: skip


def _method_of(optimizer: Any, name: str | None) -> dict[str, Any]:
    """Return what a pair has of its optimiser, by field."""
    name = name_of(optimizer) if name is None else name
    key = key_of_optimizer(optimizer, name)
    return {
        "optimizer": optimizer, "optimizer_name": name, "optimizer_options": canonical(options_of(optimizer)),
        "optimizer_key": key, "optimizer_word": int(digest(key), 16), "library": library_of(optimizer),
        "code_of_method": digest_of_method(optimizer), "foreign_optimizer": is_foreign(optimizer),
        "may_hang": bool(getattr(getattr(optimizer, "traits", None), "may_hang", False)),
    }  # fmt: skip


def foreign_modules(registry: Registry[Any], name: str) -> list[str]:
    """Return the module, loaded, that builds the entry `name`, where it is not ours."""
    factory = registry.factory(name)
    module = getattr(factory, "func", factory).__module__
    return [module] if is_foreign(module) else []


def made_pair(
    problem: str, problem_options: Mapping[str, Any], optimizer: str, optimizer_options: Mapping[str, Any]
) -> Pair:
    """Return the pair of these names and options; where all its code is ours, the one that was made before."""
    word = repr((optimizer, sorted(optimizer_options.items())))
    key = repr((problem, sorted(problem_options.items()), word))
    if key in _MADE:
        return _MADE[key]
    known, made = _OPTIMIZERS.get(word), problems.make(problem, **problem_options)
    by = known["optimizer"] if known else optimizers.make(optimizer, **optimizer_options)
    pair = pair_of(made, by, method=known)
    if pair.foreign_optimizer or foreign_modules(optimizers.registry, optimizer):
        return pair
    _keep(_OPTIMIZERS, word, known or _method_of(by, pair.optimizer_name))
    if not (pair.foreign_problem or is_stochastic(made) or foreign_modules(problems.registry, problem)):
        _keep(_MADE, key, pair)
    return pair


def _keep(what: dict[str, Any], key: str, value: Any) -> None:
    if len(what) >= _MOST:
        what.clear()
    what[key] = value


Array = NDArray[np.float64]
Start = Literal["nominal", "random"]
MOST_EVALUATIONS = 2_000_000_000  # of one run: libraries in C count them by 32 bits, and a run of so many takes hours
_FINITE_BOUNDS = "finite bounds"
LONGEST_TIME = 1e9  # seconds of one run: thirty years; clocks of libraries end before infinity


def check_numbers(budget: Any, seed: Any, target: Any = None, time_limit: Any = None, problem: Any = None) -> None:
    """Raise `ValueError` where one of these cannot be asked of any run, or the target cannot end one on `problem`."""
    if isinstance(budget, bool) or not isinstance(budget, int | np.integer) or budget < 1:
        raise ValueError(f"budget={budget}: a whole number of evaluations, 1 or more, is needed")
    if budget > MOST_EVALUATIONS:
        raise ValueError(f"budget={shown(budget)}: at most {MOST_EVALUATIONS:.0e} evaluations can be counted")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"seed={seed}: a whole number, 0 or more, is needed")
    if seed > LARGEST_WHOLE:
        raise ValueError(f"seed={shown(seed)}: at most {LARGEST_WHOLE} is needed")
    if target is not None and not is_number(target):
        raise ValueError(f"target={shown(target)}: a finite number is needed")
    if time_limit is not None:
        counts = isinstance(time_limit, int | float) and not isinstance(time_limit, bool)
        if not (counts and 0 < time_limit <= LONGEST_TIME):
            raise ValueError(
                f"time_limit={shown(time_limit)}: seconds above 0, at most {LONGEST_TIME:g}, are needed, or null for "
                "no limit"
            )
    if problem is not None and target is not None and is_stochastic(problem):
        raise ValueError(
            f"target={target}: problem {_named(problem)} is stochastic, and a lucky value would end the run; give the "
            "problem targets, which are judged by the answer"
        )


def check_pair(problem: Any, optimizer: Any) -> None:
    """Raise `ValueError` where `optimizer` cannot be run on `problem`, whatever else is asked."""
    for kind, thing, lack in (
        ("problem", problem, "lower, upper, start"), ("optimizer", optimizer, "minimize(objective, rng)"),
    ):  # fmt: skip
        if isinstance(thing, str):
            raise ValueError(f"{kind} {thing!r} is a name and has no {lack}: {kind}s.make({thing!r}) makes the object")
        static = isinstance(thing, type) and getattr_static(thing, "minimize", None)  # needs no object
        if isinstance(thing, type) and not isinstance(static, classmethod | staticmethod):
            raise ValueError(f"{kind} {thing.__name__} is a class, and an object is needed: {thing.__name__}(...)")

    who, method = _named(problem), _named(optimizer)
    _check_readable(problem, f"problem {who}", _OF_A_PROBLEM, ("data_id", "a digest of its data, say"))
    for name in _METHODS:
        if not callable(getattr(problem, name, None) or float):
            raise ValueError(f"problem {who}: {name} is no method")
    kernel = getattr(problem, "kernel", None)
    if kernel is not None and not (isinstance(kernel, tuple) and len(kernel) == 2 and callable(kernel[0])):
        raise ValueError(f"problem {who}: kernel: a function and what it takes beside x, as a pair, are needed")
    _check_readable(optimizer, f"optimizer {method}", _OF_AN_OPTIMIZER, ("library", "the name of a package"))
    traits = getattr(optimizer, "traits", None)
    if traits is not None and not all(hasattr(traits, name) for name in _TRAITS):
        raise ValueError(f"optimizer {method}: traits={traits!r:.60}: an optimizers.base.Traits is needed")
    if not callable(extra_of(optimizer, "compile", float)):
        raise ValueError(f"optimizer {method}: compile is no method")

    missing = [a for a in ("lower", "upper", "start") if not hasattr(problem, a)]
    if missing or not callable(problem):
        raise ValueError(f"problem {who} has no {', '.join(missing) or '__call__'}: lower, upper, start, a call needed")
    numbers = []
    for name in ("lower", "upper", "start"):
        value = getattr(problem, name)
        try:
            numbers.append(np.asarray(value, dtype=float))
        except (TypeError, ValueError):
            raise ValueError(f"problem {who}: {name}={value!r:.60}: numbers are needed, one a coordinate") from None
    lower, upper, start = numbers
    if lower.shape == (0,):
        raise ValueError(f"problem {who}: lower is empty: one parameter or more is needed, and this problem has none")
    if lower.shape == upper.shape == start.shape and lower.ndim != 1:
        raise ValueError(f"problem {who}: lower, upper and start have shape {lower.shape}; one axis is needed, (dim,)")
    if not lower.shape == upper.shape == start.shape:
        raise ValueError(
            f"problem {who}: shapes of lower {lower.shape}, upper {upper.shape}, start {start.shape} differ"
        )
    if not (lower <= upper).all():
        raise ValueError(f"problem {who}: lower[{np.argmin(lower <= upper)}] is above upper, or not a number")
    _check_inside(who, start, lower, upper)
    check_extras(problem, who)

    if not callable(getattr(optimizer, "minimize", None)):
        what = " is a function and" if isinstance(optimizer, FunctionType) else ""
        raise ValueError(f"optimizer {method}{what} has no minimize(objective, rng): make it a method of a class")
    needs = unmet_need(problem, optimizer)
    if needs:
        has = str(np.size(problem.lower))
        if needs == "residuals":
            has = "none; choose another optimizer"
        elif needs == _FINITE_BOUNDS:
            has = f"{_open_side(problem)}; give it two ends, or take a method without the trait needs_finite_bounds"
        raise ValueError(f"{method} needs {needs}, and problem {who} has {has}")


def unmet_need(problem: Any, optimizer: Any) -> str:
    """Return what `optimizer` needs and `problem` lacks, such as "residuals"; '' where it can run."""
    traits = getattr(optimizer, "traits", None)
    if traits is None:
        return ""
    if traits.uses_residuals and getattr(problem, "residuals", None) is None:
        return "residuals"
    least, most, size = traits.minimum_dimension, traits.maximum_dimension, np.size(problem.lower)
    if size < least or (most is not None and size > most):
        return f"{least} or more dimensions" if most is None else f"{least} .. {most} dimensions"
    if getattr(traits, "needs_finite_bounds", False) and _open_side(problem):
        return _FINITE_BOUNDS
    return ""


def repetitions_of(optimizer: Any, start: Start, wanted: range, stochastic: bool = False) -> range:
    """Return the repetitions that can differ: a deterministic method from one start on one set of data runs once.

    That one is repetition 0, whichever are `wanted`. On a problem whose values are noisy (`stochastic`) all differ.
    """
    traits = getattr(optimizer, "traits", None)
    if stochastic or traits is None or traits.stochastic:
        return wanted
    if start == "nominal" or not traits.uses_start:
        return range(1)
    return wanted


def preferred_start(problem: Any, start: Start | None) -> Start:
    """Return `start`, or what the problem prefers."""
    preferred: Start = extra_of(problem, "default_start", "nominal")
    return preferred if start is None else start


def starting_point(problem: Any, start: Start | Array | None, key: Any, repetition: int) -> tuple[str, Array]:
    """Return what the start is called (nominal, random, given) and the point, shape (dim,); `key` names the problem."""
    lower, upper = np.asarray(problem.lower, dtype=float), np.asarray(problem.upper, dtype=float)
    if start is not None and not isinstance(start, str):
        point = np.array(start, dtype=float)
        if point.shape != lower.shape:
            raise ValueError(f"start has shape {point.shape}, the problem {lower.shape}")
        _check_inside(name_of(problem), point, lower, upper)
        return "given", point.clip(lower, upper)
    chosen = preferred_start(problem, start)
    if chosen == "nominal":
        return chosen, np.array(problem.start, dtype=float).clip(lower, upper)
    if chosen != "random":
        raise ValueError(f"start={chosen}: choices: nominal, random")
    if not np.isfinite(upper - lower).all():
        raise ValueError(f"problem {name_of(problem)}: a random start needs finite bounds; take start=nominal")
    rng = np.random.default_rng(seed_sequence(key, "start", repetition=repetition))
    return chosen, np.minimum(lower + rng.random(lower.size) * (upper - lower), upper)


def _named(thing: Any) -> str:
    """Return the name of a problem or optimiser; where its own cannot be read, its class's."""
    try:
        return name_of(thing)
    except Exception:
        return type(thing).__qualname__


def _check_inside(who: str, start: Array, lower: Array, upper: Array) -> None:
    """Raise `ValueError` for a start beyond a bound by more than one rounding: `starting_point` puts that right."""
    outside = np.flatnonzero(~((np.nextafter(lower, -np.inf) <= start) & (start <= np.nextafter(upper, np.inf))))
    if outside.size:
        i = int(outside[0])
        raise ValueError(f"problem {who}: start[{i}]={start[i]:g} lies outside its box {lower[i]:g} .. {upper[i]:g}")


def _open_side(problem: Any) -> str:
    """Return the first bound without an end, such as "upper[2]=inf"; '' where all parameters have a finite width."""
    lower, upper = np.asarray(problem.lower, dtype=float), np.asarray(problem.upper, dtype=float)
    with np.errstate(over="ignore"):  # two finite ends may lie further apart than a double can say
        wide = np.flatnonzero(~np.isfinite(upper - lower))
    if not wide.size:
        return ""
    i = int(wide[0])
    ends = {"lower": float(lower[i]), "upper": float(upper[i])}
    wrong = {name: end for name, end in ends.items() if np.isinf(end)} or ends
    return ", ".join(f"{name}[{i}]={end:g}" for name, end in wrong.items())


OPTIONAL = (
    "residuals", "jacobian", "gradient", "value_and_gradient", "batch", "targets", "minimum", "unit", "group",
    "parameters", "coordinates", "truth", "budgets", "stochastic",
)  # fmt: skip  # what is read before a run begins
_OUT_OF_SCOPE = {
    "constraints": "constraints are not handled: put a penalty into the value, or choose a box that holds them",
    "integrality": "whole numbers are not handled: every coordinate is real",
    "objectives": "several objectives are not handled: give one number, such as a weighted sum",
    "n_objectives": "several objectives are not handled: give one number, such as a weighted sum",
}


def check_extras(problem: Any, who: str) -> None:
    """Raise `ValueError`, one line, where an attribute of `problem` is wrong or asks for an unsupported task."""
    for attribute, why in _OUT_OF_SCOPE.items():
        asked = np.asarray(getattr(problem, attribute, None), dtype=object)
        several = asked.size > 1 if attribute == "objectives" else asked.size and np.any(asked)
        if several and not (attribute == "n_objectives" and asked == 1):
            raise ValueError(f"problem {who}: {attribute}: {why}")
    for read in (coordinates_of, parameters_of):
        try:
            read(problem)
        except (TypeError, ValueError) as error:
            raise ValueError(f"problem {who}: {error}") from None
    minimum = getattr(problem, "minimum", None)
    if minimum is not None and not is_number(minimum):
        raise ValueError(
            f"problem {who}: minimum={minimum!r:.60}: a finite number is needed, the least value that can be had"
        )
    targets = extra_of(problem, "targets", ())
    levels = list(targets) if isinstance(targets, tuple | list | np.ndarray) and np.ndim(targets) == 1 else None
    if levels is None or not all(map(is_number, levels)):
        raise ValueError(f"problem {who}: targets={targets!r:.60}: a list of finite numbers is needed, such as (1e-8,)")
    if minimum is not None and minimum < 0 and getattr(problem, "residuals", None) is not None:
        raise ValueError(f"problem {who}: minimum={float(minimum):g}: a sum of squared residuals is never below 0")
    for level in levels:
        if minimum is not None and level < minimum:
            below = f"the target {float(level):g} lies below minimum={float(minimum):g}"
            raise ValueError(f"problem {who}: {below}: no run can reach it")
    for attribute, such in (("unit", "mm"), ("group", "separable")):
        text = extra_of(problem, attribute, "")
        if not isinstance(text, str):
            raise ValueError(f"problem {who}: {attribute}={text!r}: text is needed, such as {such!r}")
    truth = getattr(problem, "truth", None)
    if truth is not None and np.shape(truth) != np.shape(problem.lower):
        raise ValueError(f"problem {who}: truth has shape {np.shape(truth)}, lower {np.shape(problem.lower)}")
    if not isinstance(extra_of(problem, "budgets", {}), Mapping):
        raise ValueError(f"problem {who}: budgets: a mapping from ci and paper to numbers is needed")
    if not callable(extra_of(problem, "merit", dict)):
        raise ValueError(f"problem {who}: merit is no method: merit(x) returns names and numbers")
    # `stochastic` is a flag, and a generator can be given to what has it
    noisy = extra_of(problem, "stochastic", False)
    if not isinstance(noisy, bool | np.bool_):
        raise ValueError(f"problem {who}: stochastic={noisy!r}: True or False is needed")
    if not noisy and getattr(problem, "noise_free", None) is not None:
        raise ValueError(f"problem {who}: noise_free(x) is for stochastic = True, and it is not said")
    if noisy and not callable(extra_of(problem, "noise_free", float)):
        raise ValueError(f"problem {who}: noise_free is no method: noise_free(x) returns the value without noise")
    try:
        if noisy:
            _with_generator(problem, np.random.default_rng(0))
    except Exception as error:
        raise ValueError(f"problem {who}: cannot be given a generator: {type(error).__name__}: {error}") from error


def minimum_of(problem: Any) -> float | None:
    """Return the least value of the problem where it knows it (of a noisy one, without its noise), else None."""
    minimum = getattr(problem, "minimum", None)
    return None if minimum is None else float(minimum)


_METHODS = (
    "residuals", "jacobian", "gradient", "value_and_gradient", "batch", "batch_below", "compile", "compile_values",
    "physical", "seeded",
)  # fmt: skip
_OF_A_PROBLEM = (
    "lower", "upper", "start", *OPTIONAL, *_METHODS, "side_effect_free", "data_id", "default_start", "kernel",
    "merit", "name", "noise_free", "options",
)  # fmt: skip
_OF_AN_OPTIMIZER = ("traits", "library", "name", "options", "compile", "minimize")
_TRAITS = ("stochastic", "uses_residuals", "uses_start", "minimum_dimension", "maximum_dimension")


def _check_readable(thing: Any, label: str, names: tuple[str, ...], text: tuple[str, str]) -> None:
    """Raise `ValueError` where one of the attributes raises, or the one that should be text is none."""
    for name in names:
        try:
            getattr(thing, name, None)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # SystemExit too
            why = f"{type(error).__name__}: {text_of(error)}"
            raise ValueError(f"{label}: its {name} cannot be read: {why}") from error
    name, such_as = text
    value = getattr(thing, name, None)
    if value is not None and not isinstance(value, str):
        raise ValueError(f"{label}: {name}={value!r:.60}: text is needed, {such_as}")


PATIENCE = 60.0  # seconds for building, where no time limit is asked for
_READ = ("lower", "upper", "start", "data_id", "name", "options", "traits", "library", *OPTIONAL)


def probe(
    registry: Registry[Any], name: str, options: Mapping[str, Any], time_limit: float | None = None
) -> Lost | None:
    """Return why the entry `name` cannot be built with `options`: its process ended, or took too long; None: it can.

    An exception is not reported here, because building raises it again. A process that ended may have been killed from
    outside: it is at fault the second time. Our own classes are not tried, nor any where a system cannot fork.
    """
    if not CAN_FORK or not foreign_modules(registry, name):
        return None

    def look() -> None:
        built = registry.make(name, **options)
        for attribute in _READ:
            with suppress(Exception):
                getattr(built, attribute, None)

    patience = PATIENCE if time_limit is None else time_limit
    ended: Lost | None = None
    for _ in range(2):
        try:
            apart(look, patience)
        except Lost as lost:
            if lost.timed_out:
                why = f"{registry.kind} {name} was not built within {patience:g} s"
                return Lost(lost.error_type, why, timed_out=True)
            if lost.error_type == "ProcessDied":
                ended = Lost(lost.error_type, f"as {registry.kind} {name} was built, {lost.error}")
                continue
        return None
    return ended


FRESH = 30


def is_stochastic(problem: Any) -> bool:
    """Tell whether the values of `problem` are noisy."""
    return bool(extra_of(problem, "stochastic", False))


def seeded(problem: Any, key: Any, repetition: int) -> Any:
    """Return `problem`, or where it is noisy its copy with the noise of this repetition; `key` names the problem."""
    if not is_stochastic(problem):
        return problem
    return _with_generator(problem, np.random.default_rng(seed_sequence(key, "noise", repetition=repetition)))


def judged(problem: Any, x: Array | None, key: Any, repetition: int) -> tuple[float | None, int | None]:
    """Return the value of the answer `x` without noise and the fresh evaluations that gave it (0: exact).

    The value is infinite where one of them is not finite. None: nothing is noisy, or there is no answer.
    """
    if not is_stochastic(problem) or x is None:
        return None, None
    known = getattr(problem, "noise_free", None)
    if known is not None:
        value = float(known(np.array(x)))
        return value if np.isfinite(value) else float("inf"), 0
    rng = np.random.default_rng(seed_sequence(key, "judge", repetition=repetition))
    gate = Evaluator(_with_generator(problem, rng), FRESH)
    return float(np.mean([gate(x) for _ in range(FRESH)])), FRESH


def _with_generator(problem: Any, rng: np.random.Generator) -> Any:
    own = getattr(problem, "seeded", None)
    if own is None:
        twin = copy.copy(problem)
        object.__setattr__(twin, "rng", rng)  # also where the class is a frozen dataclass
        return twin
    twin = own(rng)
    if twin is problem or not callable(twin) or not all(hasattr(twin, a) for a in ("lower", "upper", "start")):
        raise TypeError("seeded(rng) must return another problem like this one, whose calls draw from rng")
    return twin
