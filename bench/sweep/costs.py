"""The time of one call of a problem, in seconds: a value, a candidate of a batch, residuals, a Jacobian, a gradient.

A Jacobian or gradient is charged `dimension` evaluations, however long it takes. The counts times these costs give the
seconds that the objective itself took in a run: a second currency, which is reported beside the first and never
charged. Costs are measured once for each problem, before its first run and outside every run's clock, and kept in the
study's manifest. Of our own problems, whose other calls would have to be compiled first, methods that ask for values
alone have those measured.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from statistics import median
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from calibench import optimizers, problems
from calibench.bench.execution.request import foreign_modules, is_stochastic, seeded
from calibench.bench.execution.run import asks_slopes, compile_problem
from calibench.bench.gate.processes import CAN_FORK, Sender, forked
from calibench.bench.provenance.environment import provenance
from calibench.bench.provenance.run_id import canonical, name_of, options_of
from calibench.bench.statistics.cells import PROBLEM
from calibench.bench.statistics.summary import KINDS, key_of_costs
from calibench.bench.workers.processes import nothing_printed
from calibench.core.own_state import kept
from calibench.core.sources import is_foreign
from calibench.problems.base import Array, extra_of

if TYPE_CHECKING:
    from calibench.bench.execution.run import Spec

# PROBLEM's columns, dimension, a column of KINDS each [s] (None: not known), platform, measured_at
Record = dict[str, Any]

_MEASURING = 0.1  # seconds a problem, all kinds together, once each has been called
_ALL = 4.0  # seconds of that for all problems of a sweep: of hundreds each gets less
_ROUNDS = 31
_SAMPLE = 5e-5  # seconds: shorter calls are timed several at a time, as the clock itself takes a tenth of a microsecond
_CANDIDATES = 100  # of a batch
_POINTS = 128
UNLIKE = "unlike"  # key of a record: two values of one point
TWO_GOALS = "two_goals"  # key of a record: the value of a point, and the sum of its squared residuals
WRONG_SLOPE = "wrong_slope"  # key of a record: gradient or jacobian, its slope along a line, and that by differences
_STEPS = (1e-7, 1e-5, 1e-3)  # of the box, on both sides
_WRONG = 1e-3  # of the slope's terms: differences of a smooth function are nearer with one of the steps
_QUICK = 0.5  # seconds a call
_ROUNDING = 1e-9  # of a value: threads that add in another order
_SINGLE = 1e-5  # of a value: a sum in single precision
_READY = 120.0  # seconds to build and compile a problem; the run itself has no such limit
_PATIENCE = 5.0  # seconds for its calls: of a problem that takes longer only the kinds that answered are known


def measured(specs: Iterable[Spec], known: Iterable[Mapping[str, Any]] = ()) -> Iterator[Record]:
    """Yield the costs of each problem of `specs` that is not `known`, measured in a child process.

    A problem that takes the child down, or does not answer in time, has the kinds that were measured until then.
    """
    done = {(*key_of_costs(record), kind) for record in known for kind in record if kind in KINDS}
    cells = {(s.problem, id(s.problem_options), s.optimizer, id(s.optimizer_options)): s for s in specs}
    by_problem: dict[tuple[str, str], list[Spec]] = {}
    for spec in cells.values():
        by_problem.setdefault(problem_of(spec), []).append(spec)
    left = list(by_problem.values())
    while left:
        for record in (_in_a_child if CAN_FORK else _here)(list(left), done):
            del left[0]
            if record is not None:
                yield record


def problem_of(spec: Spec) -> tuple[str, str]:
    """Return what tells the problem of a run from others, before it is made."""
    return spec.problem, canonical(spec.problem_options)


def seconds_a_call(
    specs: Iterable[Spec], known: Iterable[Mapping[str, Any]] = ()
) -> dict[tuple[str, str], float | None]:
    """Return by `problem_of` what a value takes (None: no answer); what is not `known` a child process measures."""
    names: dict[tuple[str, str], tuple[str, str, str]] = {}
    records = {key_of_costs(record): record for record in known}
    unknown = []
    for key, spec in {problem_of(spec): spec for spec in specs}.items():
        try:
            with kept(*foreign_modules(problems.registry, spec.problem)):
                problem: Any = problems.make(spec.problem, **spec.problem_options)
            names[key] = name_of(problem), canonical(options_of(problem)), extra_of(problem, "data_id", "")
        except Exception:  # it cannot be built here: no record fits, and the child will find no cost either
            names[key] = "", "", ""
        if names[key] not in records:
            unknown.append(spec)
    records |= {key_of_costs(record): record for record in measured(unknown)}
    return {key: records.get(name, {}).get(KINDS[0]) for key, name in names.items()}


def costs_of(
    problem: Any, tell: Callable[[str, float], None] = lambda _kind, _seconds: None, seconds: float = _MEASURING,
    kinds: Sequence[str] = KINDS,
) -> dict[str, float | None]:  # fmt: skip
    """Return seconds a call, by `kinds`, as medians of interleaved repeats; None where a problem has no such call.

    Each call gets another point than the one before, so that what remembers its last answer pays. The first call of a
    kind may compile and is not counted; `tell` hears of the second.
    """
    problem = seeded(problem, "costs", 0)  # a noisy one draws from a generator that it is given
    calls: dict[str, tuple[Callable[[Any], Any], list[Any], int]] = {}
    points = _points(problem)
    both = "value_and_gradient"
    slope = "gradient" if getattr(problem, "gradient", None) else both  # as the gate asks for a gradient alone
    names = dict(zip(KINDS, ("__call__", "batch", "residuals", "jacobian", slope, both), strict=True))
    for kind in kinds:
        name = names[kind]
        call = getattr(problem, name, None)
        if call is not None:
            given = [np.roll(points, -k, axis=0)[:_CANDIDATES] for k in range(4)] if name == "batch" else list(points)
            calls[kind] = call, given, _CANDIDATES if name == "batch" else 1
    found: dict[str, float | None] = dict.fromkeys(kinds)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        first: dict[str, float] = {}
        for kind, (call, given, each) in calls.items():
            if _sample(call, given[:1]) is not None and (second := _sample(call, given[1:2])) is not None:
                first[kind] = second
                found[kind] = second / each
                tell(kind, second / each)
        times: dict[str, list[float]] = {kind: [] for kind in first}
        end = perf_counter() + seconds
        for turn in range(_ROUNDS):
            for kind, samples in times.items():
                call, given, _ = calls[kind]
                last = max(samples[-1] if samples else first[kind], 1e-9)
                repeats = min(max(1, round(_SAMPLE / last)), len(given))
                if perf_counter() + last >= end:
                    continue
                begin = turn * repeats % len(given)
                took = _sample(call, (given + given)[begin : begin + repeats])
                samples += [] if took is None else [took]
    return found | {kind: median(samples) / calls[kind][2] for kind, samples in times.items() if samples}


def unlike(problem: Any, record: Mapping[str, Any]) -> dict[str, tuple[Any, ...]]:
    """Return what of a problem is none, by the seconds of its calls in `record`; noisy and slow problems are not tried.

    `UNLIKE`: two values of the start that differ by more than rounding; `TWO_GOALS`: its value and the sum of its
    squared residuals likewise; `WRONG_SLOPE`: what a derivative says.
    """
    if is_stochastic(problem) or not _is_quick(record[KINDS[0]]):
        return {}
    start = np.asarray(problem.start, dtype=float)
    try:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            first, second = float(problem(start.copy())), float(problem(start.copy()))
            if abs(first - second) > _ROUNDING * max(abs(first), abs(second)):
                return {UNLIKE: (first, second)}
            slope = _wrong_slope(problem, record)
            if not _is_quick(record.get(KINDS[2])):
                return slope
            squared = float(np.sum(np.square(problem.residuals(start.copy()))))
    except Exception:  # the rows of its runs will have the error
        return {}
    differ = abs(first - squared) > _SINGLE * max(abs(first), abs(squared))
    return slope | ({TWO_GOALS: (first, squared)} if differ else {})


def _wrong_slope(problem: Any, record: Mapping[str, Any]) -> dict[str, tuple[Any, ...]]:
    """Return as `WRONG_SLOPE` a derivative that differs from central differences at each of three points."""
    places = _points(problem)
    middle, width = places.mean(axis=0), np.ptp(places, axis=0)
    inner = middle + 0.9 * (places[1:4] - middle)  # so that no step leaves the box
    line = width * np.where(np.arange(len(width)) % 2, -1.0, 1.0)
    for kind, name in (("gradient", "__call__"), ("jacobian", "residuals")):
        derive, function = getattr(problem, kind, None), getattr(problem, name, None)
        if derive is None or function is None or not _is_quick(record.get(f"{kind}_s")):
            continue
        found, wrong = [], []
        for x in inner:
            slope = np.atleast_2d(np.asarray(derive(x.copy()), dtype=float))
            along, size = slope @ line, float(np.abs(slope @ np.diag(line)).sum())
            ends = [(np.asarray(function(x + h * line)), np.asarray(function(x - h * line)), h) for h in _STEPS]
            there = [(above - below) / (2 * h) for above, below, h in ends]
            gaps = [float(np.abs(one - along).max()) for one in there]
            near = there[min(range(len(gaps)), key=gaps.__getitem__)]
            worst = int(np.argmax(np.abs(near - along)))
            found.append((float(along[worst]), float(np.ravel(near)[worst])))
            wrong.append(float(np.abs(near - along)[worst]) > _WRONG * size)
        if all(wrong):
            return {WRONG_SLOPE: (kind, *found[0])}
    return {}


def _is_quick(seconds: float | None) -> bool:  # None: not known, or there is no such call
    return seconds is not None and seconds <= _QUICK


def _here(cells: Sequence[Sequence[Spec]], done: set[tuple[Any, ...]]) -> Iterator[Record | None]:
    """Yield the costs of each problem, measured in this process; None of one that is known or cannot be made."""
    for specs in cells:
        parts: list[Record] = []
        fails = _measure(specs, done, parts.append, len(cells))
        yield None if fails or not parts else {key: value for part in parts for key, value in part.items()}


def _measure(specs: Sequence[Spec], done: set[tuple[Any, ...]], tell: Callable[[Record], None], count: int) -> bool:
    """Tell of one of `count` problems, part by part, what its calls take, if not `done`; return whether it fails.

    `specs` are of one problem, and of each method that is run on it.
    """
    spec = specs[0]
    try:
        with nothing_printed(), kept(*foreign_modules(problems.registry, spec.problem)):
            problem: Any = problems.make(spec.problem, **spec.problem_options)
            names = (name_of(problem), canonical(options_of(problem)), extra_of(problem, "data_id", ""))
            beside = () if is_foreign(problem) else specs
            methods = [optimizers.make(one.optimizer, **one.optimizer_options) for one in beside]
            kinds = KINDS if asks_slopes(methods) else KINDS[:2]
            if all((*names, kind) in done for kind in kinds):
                return False
            compile_problem(problem, *methods)
            said = {"dimension": len(problem.lower), **dict.fromkeys(kinds), "platform": provenance()["platform"]}
            named = dict(zip(PROBLEM, names, strict=True))
            tell(named | said | {"measured_at": datetime.now(UTC).isoformat()})
            seconds = min(_MEASURING, _ALL / max(1, count))
            known = costs_of(problem, lambda kind, took: tell({kind: took}), seconds, kinds)
            tell(known)
            tell(unlike(problem, known))
    except Exception:  # the rows of its runs will have the error
        return True
    return False


def _in_a_child(cells: Sequence[Sequence[Spec]], done: set[tuple[Any, ...]]) -> Iterator[Record | None]:
    """Yield likewise from one child, until all are done or it is lost."""

    def work(theirs: Sender) -> None:
        for specs in cells:
            _measure(specs, done, theirs.send, len(cells))
            theirs.send(None)

    with forked(work) as (_, ours):
        for _ in cells:
            record: Record | None = None
            end, goes_on = perf_counter() + _READY, False
            with suppress(EOFError):  # the problem ended the child's process
                while ours.poll(max(0.0, end - perf_counter())):
                    message = ours.recv()
                    if message is None:
                        goes_on = True
                        break
                    end = perf_counter() + _PATIENCE if record is None else end
                    record = (record or {}) | message
            yield record
            if not goes_on:
                return


def _sample(call: Callable[[Any], Any], given: list[Any]) -> float | None:
    try:
        began = perf_counter()
        for x in given:
            call(x)
        return (perf_counter() - began) / len(given)
    except Exception:
        return None


def _points(problem: Any) -> Array:
    """Return the start and random points of the box, shape (k, dim); about the start where the box is open."""
    lower, upper, start = (np.asarray(getattr(problem, name), dtype=float) for name in ("lower", "upper", "start"))
    rng = np.random.default_rng(0)
    closed = np.isfinite(upper - lower)
    low = np.where(closed, lower, start - 0.1 * (1 + np.abs(start)))
    width = np.where(closed, upper, start + 0.1 * (1 + np.abs(start))) - low
    drawn = low + rng.random((_POINTS, len(start))) * width
    drawn[0] = start
    points: Array = np.minimum(np.maximum(drawn, lower), upper)
    return points
