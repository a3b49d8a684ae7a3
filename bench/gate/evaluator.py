"""The gate: every candidate of every optimiser passes here, and nowhere else is anything counted.

One evaluation is one pass over all samples, whether it returns residuals or their sum. One Jacobian or gradient is
charged `dimension`. A call that would bring ``charged = evaluations + dimension * jacobian_evaluations`` above the
budget is refused. Values that are not finite are worst, slopes that are not finite are read as 0; both are counted. The
first exception of the problem is kept in `raised`, and every later call is refused, whoever swallows exceptions.

Several threads may call it at once. CPython changes threads at calls and backward jumps only, so nothing is called
between reading the count and writing it; all other changes are made under a lock. A forked process is refused.
"""

from __future__ import annotations

import os
from collections.abc import Callable, MutableSequence, Sequence
from functools import cache
from math import inf
from threading import RLock
from time import perf_counter
from typing import Any, NoReturn, final
from weakref import WeakSet

import numpy as np

from calibench.bench.gate.calls import Calls, calls_of
from calibench.bench.gate.endings import ByGate
from calibench.optimizers.base import Array, BudgetExhausted, ObjectiveFailed, Stop, TargetReached, TimeUp

__all__ = ["BudgetExhausted", "Evaluator", "TargetReached", "TimeUp"]

TracePoint = tuple[int, int, float, int]  # evaluations, charged, best value, restarts so far

_MARKS_PER_DECADE = 16
_EVERY_IMPROVEMENT_UNTIL = 64  # evaluations; later ones must gain a tenth to be worth a point of the trace
_GAIN = 0.1
_ARRAY = np.ndarray
_NONE, _NOT_FINITE = -1, -2  # results of the scan of a batch besides an index
_MOST_ATTEMPTS = 20  # different ones that a row names
_LARGE_RESIDUAL = 1e100  # replaces a residual that is not finite: its square is still finite


@final
class Evaluator:
    """Count, remember the best, trace, and refuse call `budget` + 1. Satisfies `optimizers.base.Objective`.

    `targets` are levels whose first crossing is kept in `hits`; reaching `target` ends the run. `restart_seed` is where
    the points come from at which an optimiser begins again. `outside_evaluations` counts where somebody looks
    (`bench.gate.face`), else it is None; `attempts` names what was tried at the counters. `unknown_slopes` are those of
    the last Jacobian that were not finite.
    """

    __slots__ = (
        "__weakref__", "_again", "_ahead", "_asked_by", "_batch", "_below", "_call", "_closed", "_fixed", "_function",
        "_gradient", "_jacobian", "_joint", "_lock", "_mark", "_next_better", "_next_event", "_next_news",
        "_owner", "_publish", "_residuals", "_restart_rng", "_restart_seed", "_rows", "_scan", "_shown", "_traced",
        "attempts", "batch_evaluations", "best_evaluation", "best_value", "best_x", "budget", "deadline", "dimension",
        "earlier", "evaluations", "gradient_evaluations", "has_gradient", "has_jacobian", "has_residuals", "hits",
        "hits_charged", "jacobian_evaluations", "joint_evaluations", "lower", "non_finite", "non_finite_slopes",
        "outside_evaluations", "raised", "residual_evaluations", "restarts", "start", "stopped", "target", "targets",
        "trace", "unknown_slopes", "upper",
    )  # fmt: skip

    def __init__(
        self, problem: Any, budget: int, *, start: Array | None = None, target: float | None = None,
        targets: Sequence[float] = (),
        restart_seed: np.random.SeedSequence | int | Callable[[], np.random.SeedSequence] = 0,
    ) -> None:  # fmt: skip
        self._asked_by: list[Callable[[Calls], None]] = []  # the functions made by `single_call`
        calls = calls_of(problem)
        self.ask(calls)
        self._call = self.single_call()
        self._scan: Any
        self._next_better: Any
        self._scan, self._next_better = scans() if calls.batch or calls.below else (None, None)
        self.has_residuals, self.has_jacobian = self._residuals is not None, self._jacobian is not None
        self.has_gradient = self._gradient is not None
        self.lower, self.upper = _fixed(problem.lower), _fixed(problem.upper)
        self.start = _fixed(problem.start if start is None else start)
        self.dimension = len(self.lower)
        self.budget = budget
        self.target = -inf if target is None else target
        self.targets = sorted(targets, reverse=True)
        self.hits: list[int | None] = [None] * len(self.targets)
        self.hits_charged: list[int | None] = [None] * len(self.targets)
        self.evaluations = self.jacobian_evaluations = self.non_finite = self.restarts = 0
        self.non_finite_slopes = self.unknown_slopes = 0
        self._rows: int | None = None  # of the residuals, when they have been asked
        self.raised: BaseException | None = None
        self.batch_evaluations = self.residual_evaluations = 0  # evaluations of these kinds cost another time each
        self.gradient_evaluations = self.joint_evaluations = 0
        self.best_value, self.best_evaluation = inf, 0
        self.best_x: Array | None = None
        self.stopped: ByGate | None = None
        self._restart_seed = restart_seed
        self._restart_rng: np.random.Generator | None = None  # most runs need none
        self.deadline = inf  # when calls are refused, on the clock of `time.perf_counter`
        self.earlier = 0.0, 0.0  # wall and processor seconds that this run took before this process went on with it
        self._publish: Callable[[Evaluator, int], None] | None = None
        self._shown: MutableSequence[float] = [0.0]
        self.trace: list[TracePoint] = []
        self._traced = inf
        self._mark = 1
        self._next_event = self._next_news = 0
        self.outside_evaluations: int | None = None
        self.attempts: list[str] = []
        self._lock, self._owner, self._closed = RLock(), os.getpid(), False
        self._schedule()
        _OPEN.add(self)

    def __call__(self, x: Array) -> float:
        """Return the value at x, shape (dim,); infinite where it is not finite. Raises `Stop` when no more is left."""
        return self._call(x)

    def single_call(
        self, outside: Callable[[Array, Array], bool] | None = None, box: Array | None = None,
        look: Callable[[Any], Array] = np.array,
    ) -> Callable[[Array], float]:  # fmt: skip
        """Return `__call__` as a plain function, which is faster to call often, because it looks up no attribute.

        Of a point that is `outside` the `box`, or that this does not take (`TypeError`), ``look(x)`` is asked for.
        """
        gate, function, fixed, again = self, self._function, self._fixed, self._again

        def ask(calls: Calls) -> None:
            nonlocal function, fixed, again
            fixed, again, function = calls.fixed, calls.again, calls.value

        def call(x: Array) -> float:
            if outside is not None:
                try:
                    inside = type(x) is _ARRAY and not outside(x, box)  # type: ignore[arg-type]
                except TypeError:  # of another kind of number, or of other strides
                    inside = False
                if not inside:
                    x = look(x)
            n = gate.evaluations + 1
            if n < gate._next_event:
                gate.evaluations = n
            else:
                n = gate._admit(plain=True)
            try:
                value: float = function(x, fixed)
            except Exception:
                try:
                    value = again(x)  # the slow way, as a kernel refuses what is not an array as it takes it
                except BaseException as error:
                    gate._fail(error)
            except BaseException as error:
                gate._fail(error)
            if gate.best_value <= value < inf:  # as nearly all are
                return value
            if -inf < value < gate.best_value:
                gate._improve(n, value, x)
            elif not -inf < value < inf:
                gate._not_finite(1)
                return inf
            return value

        self._asked_by.append(ask)
        return call

    def batch(self, points: Array) -> Array:
        """Return the values, shape (k,), of `points`, shape (k, dim); as many as the budget allows, then `Stop`."""
        return self._ask(self._batch, points)

    def batch_below(self, points: Array, limits: Array) -> Array:
        """Return the values of `points`, shape (k, dim), that are below `limits`, shape (k,); others are not below.

        All else is as `batch`. An abandoned value is never a best; whether it would have been finite is not known.
        """
        if self._below is None:
            return self.batch(points)
        # a limit below the best, or an infinite one: values may change the best
        if self._scan(limits, self.best_value) != _NONE:
            limits = np.maximum(limits, self.best_value)
        return self._ask(self._below, points, limits)

    def _ask(self, function: Any, points: Array, *limits: Array) -> Array:
        """Return `function` of `points` and of their `limits`, if any; `function` is None of a problem without one."""
        shape = points.shape if type(points) is _ARRAY else ()
        is_ours = len(shape) == 2 and shape[1] == self.dimension
        if is_ours and function is not None and (not limits or len(limits[0]) == shape[0]):
            n = self.evaluations + shape[0]
            if n < self._next_event:  # as nearly always
                self.evaluations = n
                self.batch_evaluations += shape[0]
                try:
                    values: Array = function(points, *limits)
                except BaseException as error:
                    self._fail(error)
                found = self._scan(values, self.best_value)
                return values if found == _NONE else self._take(points, values, found, n - shape[0])
        if not is_ours:  # a foreign array
            own = np.array(points, dtype=np.float64)  # of ours, whatever they say of themselves
            points = own.reshape(0, self.dimension) if own.shape == (0,) else own
            if points.ndim != 2 or points.shape[1] != self.dimension:
                raise ValueError(f"batch needs points of shape (k, {self.dimension}), and was given {own.shape}")
        if function is None:
            if self._ahead is not None:
                self._ahead(points[: max(self.remaining, 0)])
            return np.array([*map(self._call, points)])
        if not len(points):
            return np.empty(0)

        with self._lock:
            self._hold(1)
            allowed = min(len(points), self.remaining)
            if self._publish is not None:
                self._publish(self, self.evaluations + allowed)
            self.evaluations += allowed  # before the call, so that a call which raises is charged, too
            self.batch_evaluations += allowed
            n = self.evaluations
        values = self._answer(function, points[:allowed], *(limit[:allowed] for limit in limits))
        with self._lock:
            values = self._take(points, values, self._scan(values, self.best_value), n - allowed)
            self._pass_marks(n)
            self._schedule()
        if allowed < len(points):
            self.stopped = "budget"
            raise BudgetExhausted(f"the budget of {self.budget} evaluations is spent")
        return values

    def residuals(self, x: Array) -> Array:
        """Return the residuals at x, shape (m,): one evaluation, of value r @ r. Not finite ones come back as 1e100."""
        n = self.evaluations + 1
        if n < self._next_event:
            self.evaluations = n
        else:
            n = self._admit()
        self.residual_evaluations += 1
        r = self._answer(self._residuals, x)
        self._rows = len(r)
        value = float(r.dot(r))
        if value < self.best_value:
            self._improve(n, value, x)
        elif not value < inf:
            self._not_finite(1)
            return np.nan_to_num(r, nan=_LARGE_RESIDUAL, posinf=_LARGE_RESIDUAL, neginf=-_LARGE_RESIDUAL)
        return r

    def jacobian(self, x: Array) -> Array:
        """Return the derivative of the residuals at x, shape (m, dim), for `dimension` evaluations; 0 if not finite."""
        self._charge_slopes(self.dimension)
        try:
            slopes: Array = self._jacobian(x)
            rows, columns = self._rows, self.dimension
            if slopes.ndim != 2 or slopes.shape[1] != columns or (rows is not None and len(slopes) != rows):
                needed = f"({'m' if rows is None else rows}, {columns})"
                raise ValueError(
                    f"jacobian(x) has shape {slopes.shape}; {needed} is needed: a row a residual, a column a parameter"
                )
        except BaseException as error:
            self._fail(error)
        return self._finite(slopes)

    def gradient(self, x: Array) -> Array:
        """Return the derivative of the value at x, shape (dim,), for `dimension` evaluations, counted as a Jacobian."""
        self._charge_slopes(self.dimension)
        self.gradient_evaluations += 1
        return self._finite(self._answer(self._gradient, x))

    def value_and_gradient(self, x: Array) -> tuple[float, Array]:
        """Return both, by one call of a problem that gives them at once, for 1 + `dimension` evaluations."""
        if self._joint is None:
            return self(x), self.gradient(x)
        self._charge_slopes(self.dimension + 1)
        n = self._admit()
        self.gradient_evaluations += 1
        self.joint_evaluations += 1
        both = self._answer(self._joint, x)
        value, slopes = float(both[0]), self._finite(both[1:])
        if -inf < value < self.best_value:
            self._improve(n, value, x)
        elif not -inf < value < inf:
            self._not_finite(1)
            return inf, slopes
        return value, slopes

    def _charge_slopes(self, needed: int) -> None:
        """Count derivatives that are about to be asked for; raise `Stop` where less than `needed` is left."""
        with self._lock:
            self._hold(needed)
            self._pass_marks(self.evaluations)  # they are charged as they were before these
            self.jacobian_evaluations += 1
            if self._publish is not None:
                self._publish(self, self.evaluations)
            self._schedule()

    def _finite(self, slopes: Array) -> Array:
        """Return slopes with 0 for those that are not finite, which are counted."""
        self.unknown_slopes = slopes.size - int(np.count_nonzero(np.isfinite(slopes)))
        if self.unknown_slopes:
            with self._lock:
                self.non_finite_slopes += self.unknown_slopes
                if self._publish is not None:
                    self._publish(self, self.evaluations)
        return np.nan_to_num(slopes, posinf=0.0, neginf=0.0)

    def restart(self) -> Array:
        """Note that the optimiser begins again, and return where it may: a uniform random point of the box, (dim,).

        The k-th point is the same for every optimiser. A box without bounds has no such point: it is the start then.
        """
        with self._lock:
            self.restarts += 1
            self.bring_news()
            if self._restart_rng is None:
                seed = self._restart_seed
                self._restart_rng = np.random.default_rng(seed() if callable(seed) else seed)
            drawn = self._restart_rng.random(self.dimension)
        width = self.upper - self.lower
        closed = np.isfinite(width)
        point: Array = np.where(closed, self.lower, self.start) + drawn * np.where(closed, width, 0.0)
        return point.clip(self.lower, self.upper)

    @property
    def charged(self) -> int:
        """Return what the run has cost: evaluations and `dimension` for each Jacobian or gradient."""
        return self.evaluations + self.dimension * self.jacobian_evaluations

    @property
    def remaining(self) -> int:
        """Return the evaluations that are left."""
        return self.budget - self.charged

    def ask(self, calls: Calls) -> None:
        """Ask the problem by `calls` from now on. Another thread may do so too, where `fixed` stays what it was."""
        self._fixed, self._again, self._function = calls.fixed, calls.again, calls.value
        self._batch, self._below, self._ahead = calls.batch, calls.below, calls.ahead
        self._residuals, self._jacobian = calls.residuals, calls.jacobian
        self._gradient, self._joint = calls.gradient, calls.joint
        for ask in self._asked_by:
            ask(calls)

    def close(self) -> None:
        """End the run: code that still holds the gate, in a thread or a later run, gets no further evaluation."""
        with self._lock:
            self._closed, self._next_event, self._next_news = True, 0, 0
        if self.evaluations:  # the last point of the trace
            self._record(self.evaluations)

    def note(self, attempt: str) -> None:
        """Note what was tried at the counters, once each."""
        if attempt not in self.attempts and len(self.attempts) < _MOST_ATTEMPTS:
            self.attempts.append(attempt)
            if self._publish is not None:
                self._publish(self, self.evaluations)

    def note_outside(self, count: int) -> None:
        """Count points outside the box that are about to be evaluated; those that will be refused are not counted."""
        with self._lock:
            if self.stopped is None and self.remaining > 0:
                self.outside_evaluations = (self.outside_evaluations or 0) + count
                self.bring_news()

    def refuse_after(
        self, deadline: float, publish: Callable[[Evaluator, int], None], shown: MutableSequence[float]
    ) -> None:
        """Refuse calls after `deadline` (`perf_counter`); `publish` gets the gate and the evaluations with the next.

        A call before which nothing else has changed only counts, in the first number of `shown`.
        """
        self.deadline, self._publish, self._shown = deadline, publish, shown
        self._schedule()

    def bring_news(self) -> None:
        """Let the next call publish: something else than the count of evaluations has changed."""
        self._next_news = 0

    def __deepcopy__(self, _memo: object = None) -> Evaluator:
        return self  # pygmo copies what it is given; the count must stay one

    __copy__ = __deepcopy__

    def _answer(self, function: Callable[..., Array], *given: Array) -> Array:
        try:
            return function(*given)
        except BaseException as error:
            self._fail(error)

    def _fail(self, error: BaseException) -> NoReturn:
        """Raise what the problem raised, and keep the first such: it ends the run, whoever swallows it."""
        if not isinstance(error, Stop):
            with self._lock:
                self.raised = error if self.raised is None else self.raised
                self._next_event = self._next_news = 0
        raise error

    def _admit(self, plain: bool = False) -> int:
        """Return the number of the next evaluation, after what is due before it; raise `Stop` where there is none.

        A `plain` call changes nothing but the count of evaluations.
        """
        if plain and self._next_news and perf_counter() <= self.deadline:
            n = self.evaluations + 1
            if n < self._next_news:
                self.evaluations = n
                self._shown[0] = self.evaluations  # another thread's count, where that came later
                return n
        with self._lock:
            while True:
                self._hold(1)
                self._pass_marks(self.evaluations)
                self._schedule(plain)
                if self._publish is not None:
                    self._publish(self, self.evaluations + 1)
                n = self.evaluations + 1  # another thread may have counted meanwhile; from here on none can
                if n <= self.budget - self.dimension * self.jacobian_evaluations:
                    self.evaluations = n
                    return n

    def _hold(self, needed: int) -> None:
        """Make all other threads wait for the lock here, and refuse a call that costs `needed` evaluations."""
        self._next_event = self._next_news = 0
        if os.getpid() != self._owner:
            raise RuntimeError("the objective cannot be called in a forked process: nothing would count it")
        if self._closed:
            raise BudgetExhausted("this run is over")
        if self.raised is not None:
            raise ObjectiveFailed(f"the objective has raised {type(self.raised).__name__}") from self.raised
        if self.stopped == "target":
            raise TargetReached(f"the target {self.target:g} is reached")
        if self.remaining < needed:
            self.stopped = "budget"
            raise BudgetExhausted(f"the budget of {self.budget} evaluations is spent")
        if self.deadline < inf and perf_counter() > self.deadline:
            self.stopped = "timeout"
            raise TimeUp("the time allowed has passed")

    def _schedule(self, plain: bool = False) -> None:
        """Say before which evaluation there is something to do; watched, each is such but for `plain` calls."""
        last = self.budget - self.dimension * self.jacobian_evaluations
        is_over = self._closed or self.stopped == "target" or self.raised is not None
        event = 0 if is_over else min(self._mark, last) + 1
        self._next_event = event if self._publish is None else 0
        self._next_news = event if self._publish is not None and plain else 0

    def _pass_marks(self, n: int) -> None:
        while self._mark <= n:
            self._record(self._mark)
            self._mark = max(self._mark + 1, round(self._mark * 10 ** (1 / _MARKS_PER_DECADE)))

    def _not_finite(self, count: int) -> None:
        self.non_finite += count
        if self._publish is not None:
            self._publish(self, self.evaluations)

    def _take(self, points: Array, values: Array, found: int, before: int) -> Array:
        """Note the improvements and marks of a batch in the order of its points, from what the scan `found`."""
        if found == _NOT_FINITE:
            finite = np.isfinite(values)
            values = np.where(finite, values, inf)
            self._not_finite(int(len(values) - finite.sum()))
            found = self._next_better(values, self.best_value, 0)
        while found != _NONE:
            self._pass_marks(before + found)
            self._improve(before + found + 1, float(values[found]), points[found])
            found = self._next_better(values, self.best_value, found + 1)
        return values

    def _improve(self, n: int, value: float, x: Array) -> None:
        with self._lock:
            if not value < self.best_value:  # another thread has kept a better one meanwhile
                return
            self.best_value, self.best_x, self.best_evaluation = value, np.array(x, dtype=float), n
            for i, level in enumerate(self.targets):
                if self.hits[i] is None and value <= level:
                    self.hits[i], self.hits_charged[i] = n, n + self.dimension * self.jacobian_evaluations
            if n <= _EVERY_IMPROVEMENT_UNTIL or self._traced == inf or self._traced - value > _GAIN * abs(self._traced):
                self._record(n)
            if self._publish is not None:
                self._publish(self, self.evaluations)
            if value <= self.target:
                self.stopped = "target"
                self._next_event = self._next_news = 0
                raise TargetReached(f"the target {self.target:g} is reached")

    def _record(self, n: int) -> None:
        n = max(n, self.trace[-1][0]) if self.trace else n  # of threads, one that began earlier may end later
        point = (n, n + self.dimension * self.jacobian_evaluations, self.best_value, self.restarts)
        if self.trace and self.trace[-1][0] == n:
            if self.trace[-1][2] != self.best_value:  # otherwise the point keeps the charge at which it was reached
                self.trace[-1] = point
        else:
            self.trace.append(point)
        self._traced = self.best_value


def _fixed(values: Any) -> Array:
    """Return `values` as an array of which no view can be made writable: Python's bytes hold it."""
    return np.frombuffer(np.array(values, dtype=float).tobytes())


_OPEN: WeakSet[Evaluator] = WeakSet()  # a child that an optimiser forks must not evaluate uncounted


def _after_fork() -> None:
    """Let every call in this child be looked at."""
    for gate in list(_OPEN):
        gate._lock = RLock()  # the thread that may have held it is not here
        gate._next_event = gate._next_news = 0


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


@cache
def scans() -> tuple[Any, Any]:
    """Return the scan of a batch and its helper, compiled before any clock starts."""
    from calibench.bench.gate._scan_kernels import next_better, scan  # a gate for single calls needs no compiler

    values = np.zeros(1)
    scan(values, 1.0), next_better(values, 1.0, 0)
    return scan, next_better
