"""The laws of a problem: its box, its value, and that residuals, batch and Jacobian tell the same story.

A problem needs `lower`, `upper`, `start` and a call. A law about anything else holds where the problem has it.
"""

from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise
from typing import Any

import numpy as np

from calibench.bench.execution.request import check_extras, is_stochastic, minimum_of, seeded
from calibench.problems.base import Array, coordinates_of, extra_of
from calibench.testing._law import MOST_NUMBERS, TIME_LIMIT, Checks, checks_of, keep_all, require

BATCH_SIZES = (1, 7, 33, 64, 65, 150)
_STEPS = 10.0 ** np.arange(-8, -1)  # of central differences, in parts of a coordinate's scale
_COLUMNS = 200  # of a Jacobian that are compared with differences, from the first to the last
_ROUNDING = 1e-11  # of a value, in a slope by the scale of its coordinate
_PRINTED = 1e-10  # of a minimum that is rounded to ten digits, as certified ones are


def check_problem(problem: Any, *, time_limit: float = TIME_LIMIT) -> None:
    """Raise `AssertionError`, one line, for the first law that `problem` breaks."""
    keep_all(lambda: problem_checks(problem), time_limit)


def problem_checks(problem: Any) -> Checks:
    """Return (name, check) for every law of a problem."""
    return checks_of(PROBLEM_LAWS, problem)


def box_is_sane(problem: Any) -> None:
    """Bounds and start are arrays of one shape (dim,) of numbers, and no side of the box is turned round."""
    if isinstance(problem, type):
        require(False, "a problem is an object", f"the class {problem.__name__}", f"give {problem.__name__}(...)")
    for key in ("lower", "upper", "start"):
        require(hasattr(problem, key), f"a problem has {key}", f"no {key}", "give it an array of shape (dim,)")
    require(callable(problem), "a problem is called with x", "no __call__", "write __call__(self, x) -> float")
    lower, upper, start = (np.asarray(getattr(problem, key), dtype=float) for key in ("lower", "upper", "start"))
    shapes = (lower.shape, upper.shape, start.shape)
    require(
        lower.ndim == 1 and lower.size and len(set(shapes)) == 1,
        "lower, upper and start have one shape (dim,)", shapes, "make them arrays of one length",
    )  # fmt: skip
    wrong = np.flatnonzero(~(lower <= upper))
    require(
        not wrong.size, "lower <= upper", [(int(i), lower[i], upper[i]) for i in wrong[:1]],
        "exchange the bounds, or put numbers where they are nan",
    )  # fmt: skip
    require((lower < upper).any(), "some coordinate is free", "lower == upper", "widen the box")


def start_and_truth_lie_in_the_box(problem: Any) -> None:
    """The start, and the truth where it is known, lie between the bounds."""
    lower, upper = np.asarray(problem.lower), np.asarray(problem.upper)
    for key in ("start", "truth"):
        x = getattr(problem, key, None)
        if x is not None:
            inside = np.shape(x) == lower.shape and bool(((lower <= x) & (x <= upper)).all())
            require(inside, f"{key} lies in the box", np.asarray(x).tolist(), f"move {key} or widen the box")


def what_it_says_of_itself_is_right(problem: Any) -> None:
    """Targets, minimum, names, unit, noise: what a run would refuse at the door is refused here."""
    try:
        check_extras(problem, type(problem).__name__)
    except ValueError as error:
        require(False, "what a problem says of itself is right", error, "mend that attribute, or leave it out")


def value_is_one_finite_number_at_the_start(problem: Any) -> None:
    """A call returns one number, and at the start it is finite."""
    value = seeded(problem, "law", 0)(np.array(problem.start, dtype=float))
    single = np.ndim(value) == 0 and np.asarray(value).dtype.kind in "fiu"
    require(single, "a call returns one number", repr(value), "return float(...)")
    require(
        np.isfinite(value), "the value at the start is finite", value, "choose a start where the problem is defined"
    )


def same_point_has_the_same_value(problem: Any) -> None:
    """A value depends on x alone (of a noisy problem: on x and on its generator)."""
    first = [seeded(problem, "law", 0)(x) for x in inner_points(problem, 5)]
    again = [seeded(problem, "law", 0)(x) for x in inner_points(problem, 5)]
    require(
        np.array_equal(first, again, equal_nan=True), "the same x has the same value", f"{first}, then {again}",
        "keep no state between calls; draw noise from self.rng and say stochastic = True",
    )  # fmt: skip


def calls_leave_x_alone(problem: Any) -> None:
    """No call writes into its argument: an optimiser still needs it."""
    _leave_alone(problem, inner_points(problem, 3, seed=8))
    with suppress(ArithmeticError, ValueError), np.errstate(all="ignore"):  # at a bound it may be undefined
        bounds = np.array([problem.lower, problem.upper], dtype=float)
        corners = np.where(np.isfinite(bounds), bounds, inner_points(problem, 2, seed=8))
        _leave_alone(problem, corners)  # who clips in place is silent inside the box


def _leave_alone(problem: Any, x: Array) -> None:
    before = x.copy()
    ways: dict[str, Any] = {"__call__": x, "residuals": x, "jacobian": x, "batch": (x,)}
    ways |= {"gradient": x, "value_and_gradient": x}
    for name, arguments in ways.items():
        if getattr(problem, name, None) is not None:
            for argument in arguments:
                getattr(seeded(problem, "law", 0), name)(argument)
            require(np.array_equal(x, before), "calls leave x alone", f"x changed by {name}", "work on x.copy()")


def value_is_the_sum_of_squared_residuals(problem: Any) -> None:
    """``problem(x) == r @ r`` with ``r = problem.residuals(x)``, to 12 digits."""
    if getattr(problem, "residuals", None) is None:
        return
    for x in [np.array(problem.start, dtype=float), *inner_points(problem, 20, seed=4)]:
        value, r = seeded(problem, "law", 0)(x), np.asarray(seeded(problem, "law", 0).residuals(x))
        require(r.ndim == 1, "residuals have shape (m,)", r.shape, "return a flat array")
        if np.isfinite(value) and np.isfinite(r).all():
            require(
                abs(value - r @ r) <= 1e-12 * abs(value), "the value is r @ r", f"{value!r} and r @ r = {r @ r!r}",
                "compute the value from the residuals",
            )  # fmt: skip


def batch_has_the_bits_of_single_calls(problem: Any, sizes: tuple[int, ...] = BATCH_SIZES) -> None:
    """``batch(X)[i]`` is ``problem(X[i])`` bit for bit, in any order and however X lies in memory."""
    if getattr(problem, "batch", None) is None or is_stochastic(problem):
        return
    do = "let both run the same code; matrix products sum in another order for another number of rows"
    for size in (size for size in sizes if size == 1 or size * np.size(problem.lower) <= MOST_NUMBERS):
        X = inner_points(problem, size, seed=size)
        single, many = np.array([problem(x) for x in X]), np.asarray(problem.batch(X))
        require(many.shape == (size,), "batch returns shape (k,)", many.shape, "return a value a row")
        wrong = np.flatnonzero(~((single == many) | (np.isnan(single) & np.isnan(many))))
        require(not wrong.size, "a batch has the bits of single calls", _pair(single, many, wrong), do)
    if 66 * np.size(problem.lower) > MOST_NUMBERS:
        return
    X = inner_points(problem, 66, seed=6)
    expected = np.asarray(problem.batch(X))
    wide = np.repeat(np.repeat(X, 2, axis=0), 3, axis=1)
    layouts = {"strided": wide[::2, ::3], "columns first": np.asfortranarray(X), "backwards": X[::-1].copy()[::-1]}
    for name, stored in layouts.items():
        values = np.asarray(problem.batch(stored))
        require(np.array_equal(values, expected, equal_nan=True), "the layout of X changes no bit", name, do)
        alone = [problem(stored[i]) for i in (0, 31, 63, 64, 65)]
        same = np.array_equal(alone, expected[[0, 31, 63, 64, 65]], equal_nan=True)
        require(same, "the layout of x changes no bit", name, do)
    order = np.random.default_rng(0).permutation(len(X))
    shuffled = np.asarray(problem.batch(X[order]))
    require(
        np.array_equal(shuffled, expected[order], equal_nan=True), "a value does not depend on its neighbours",
        _pair(expected[order], shuffled, np.flatnonzero(shuffled != expected[order])), do,
    )  # fmt: skip


def batch_below_is_exact_below_its_limits(problem: Any) -> None:
    """Of `batch_below` a value below its limit is that of `batch`; any other is not below its limit.

    Of a noisy problem both draw the same noise, if they draw it in one order; if not, they cannot be compared.
    """
    if getattr(problem, "batch_below", None) is None:
        return
    X = inner_points(problem, 31, seed=31)
    whole, unlimited = _batch(problem, X), np.full(len(X), np.inf)
    if is_stochastic(problem) and not (_batch(problem, X, unlimited) == whole).any():
        return
    for limits in (unlimited, np.zeros(len(X)), whole, np.nextafter(whole, np.inf), np.roll(whole, 1)):
        values = _batch(problem, X, limits)
        kept = np.where(whole < limits, values == whole, values >= limits)
        require(
            kept.all(), "batch_below is exact below its limits, and not below them elsewhere",
            _pair(whole, values, np.flatnonzero(~kept)), "give up a sum only when it has passed its limit",
        )  # fmt: skip


def _batch(problem: Any, X: Array, limits: Array | None = None) -> Array:
    """Return the values of `batch`, or with limits of `batch_below`, of a noisy problem with the same noise.

    It is asked for a point at a time, with its noise begun anew: who gives up a point draws less for the next one.
    """
    step = 1 if is_stochastic(problem) else len(X)
    parts = []
    for k in range(0, len(X), step):
        part, still = slice(k, k + step), seeded(problem, "law", 0)
        parts.append(still.batch(X[part]) if limits is None else still.batch_below(X[part], limits[part]))
    return np.concatenate(parts)


def jacobian_agrees_with_differences(problem: Any, tolerance: float = 1e-7) -> None:
    """``jacobian(x)`` is the derivative of ``residuals(x)``, to `tolerance` of the largest entry of a column."""
    if not (extra_of(problem, "jacobian") and extra_of(problem, "residuals")) or is_stochastic(problem):
        return
    truth = getattr(problem, "truth", None)
    for x in [*inner_points(problem, 3, seed=9), *([] if truth is None else [np.array(truth, dtype=float)])]:
        r, analytic = np.array(problem.residuals(x), dtype=float), np.array(problem.jacobian(x), dtype=float)
        shape = (r.size, x.size)
        require(analytic.shape == shape, "the Jacobian has shape (m, dim)", f"{analytic.shape}, not {shape}", "turn it")
        least = 1e-9 * float(np.abs(analytic).max())
        for column, _, gap, size in _gaps(problem, problem.residuals, x, analytic):
            require(
                gap <= tolerance * max(size, least), "the Jacobian agrees with central differences",
                f"a gap of {gap:.2g} beside {size:.2g} in column {column}",
                "derive that column again: entry [i, j] is d r_i / d x_j",
            )  # fmt: skip


def gradient_agrees_with_differences(problem: Any, tolerance: float = 1e-7) -> None:
    """``gradient(x)`` is the derivative of the value, and `value_and_gradient` returns both of them."""
    ways = [way for way in ("gradient", "value_and_gradient") if getattr(problem, way, None) is not None]
    for way in [] if is_stochastic(problem) else ways:
        for x in inner_points(problem, 3, seed=10):
            value, returned = float(problem(x)), getattr(problem, way)(x.copy())
            if way == "value_and_gradient":
                pair = isinstance(returned, tuple | list) and len(returned) == 2
                require(pair, f"{way} returns a value and an array", type(returned).__name__, "return value, slopes")
                same = abs(float(returned[0]) - value) <= 1e-12 * abs(value)
                require(same, f"the value of {way} is the value", f"{returned[0]!r} and {value!r}", "compute it alike")
                returned = returned[1]
            slopes = np.array(returned, dtype=float)
            require(slopes.shape == x.shape, f"{way} has shape (dim,)", slopes.shape, "return a slope for each of x")
            for entry, scale, gap, size in _gaps(problem, problem, x, slopes):
                require(
                    gap <= max(tolerance * size, _ROUNDING * abs(value) / scale),
                    "the gradient agrees with central differences",
                    f"a gap of {gap:.2g} beside {size:.2g} in entry {entry}",
                    "derive that entry again: d value / d x_j",
                )


def _gaps(problem: Any, function: Any, x: Array, analytic: Array) -> Iterator[tuple[str, float, float, float]]:
    """Yield of some coordinates, from the first to the last: (place and name, scale, gap, size of the slope).

    The gap is how far central differences of `function` by x_c stay from `analytic`, with the best of the steps.
    """
    names, width = coordinates_of(problem), np.asarray(problem.upper, dtype=float) - np.asarray(problem.lower, float)
    scales = np.where(np.isfinite(width) & (width > 0), width, np.maximum(1.0, np.abs(x)))
    for c in np.unique(np.linspace(0, x.size - 1, min(x.size, _COLUMNS)).astype(int)):
        columns = []
        for h in scales[c] * _STEPS:
            there, back = x.copy(), x.copy()
            there[c], back[c] = x[c] + h, x[c] - h
            ahead, behind = (np.array(function(at), dtype=float) for at in (there, back))  # it may fill one array
            columns.append((ahead - behind) / (2 * h))
        # of two steps, ten times apart, also what they tend to: of r = x^3 at 0 every difference alone is above 0
        limits = [fine + (fine - coarse) / 99 for fine, coarse in pairwise(columns)]
        gap = min(float(np.abs(column - analytic[..., c]).max()) for column in columns + limits)
        yield f"{c} ({names[c].name})", scales[c], gap, float(np.abs(analytic[..., c]).max())


def truth_has_the_least_value(problem: Any) -> None:
    """The truth, where it is known, has a lower value than the start and than random points of the box."""
    value = problem if not is_stochastic(problem) else getattr(problem, "noise_free", None)
    truth = getattr(problem, "truth", None)
    if truth is None or value is None:
        return
    least = value(np.array(truth, dtype=float))
    others = [float(value(x)) for x in [np.array(problem.start, dtype=float), *inner_points(problem, 20, seed=11)]]
    require(
        least <= np.nanmin(others), "the truth has the least value",
        f"{least:g} at the truth, {min(others):g} elsewhere", "check the order and the units of truth",
    )  # fmt: skip


def no_value_lies_below_the_minimum(problem: Any) -> None:
    """No value is below the stated `minimum`; that at the truth may be, by as little as ten printed digits leave."""
    value = problem if not is_stochastic(problem) else getattr(problem, "noise_free", None)
    minimum = minimum_of(problem)
    if minimum is None or value is None:
        return
    truth, law = getattr(problem, "truth", None), f"no value is below minimum={minimum:g}"
    least = min(float(value(x)) for x in [np.array(problem.start, dtype=float), *inner_points(problem, 50, seed=12)])
    require(least >= minimum, law, f"{least:g}", "lower it, or leave it out")
    if truth is not None:
        least = float(value(np.array(truth, dtype=float)))
        require(least >= minimum - _PRINTED * abs(minimum), law, f"{least:g} at the truth", "lower it, or leave it out")


PROBLEM_LAWS = (
    box_is_sane, start_and_truth_lie_in_the_box, what_it_says_of_itself_is_right,
    value_is_one_finite_number_at_the_start, same_point_has_the_same_value, calls_leave_x_alone,
    value_is_the_sum_of_squared_residuals, batch_has_the_bits_of_single_calls, batch_below_is_exact_below_its_limits,
    jacobian_agrees_with_differences, gradient_agrees_with_differences, truth_has_the_least_value,
    no_value_lies_below_the_minimum,
)  # fmt: skip


def inner_points(problem: Any, count: int, seed: int = 0) -> Array:
    """Return random points of the box, shape (count, dim); where it is open, of the surroundings of the start."""
    start = np.array(problem.start, dtype=float)
    reach = np.maximum(1.0, np.abs(start))
    lower, upper = (np.array(getattr(problem, key), dtype=float) for key in ("lower", "upper"))
    lower = np.where(np.isfinite(lower), lower, np.minimum(start, upper) - reach)
    upper = np.where(np.isfinite(upper), upper, np.maximum(start, lower) + reach)
    count = max(1, min(count, MOST_NUMBERS // start.size))
    return np.asarray(lower + (upper - lower) * np.random.default_rng(seed).random((count, start.size)))


def _pair(a: Array, b: Array, wrong: Any) -> str:
    return f"{a[wrong[0]]!r} and {b[wrong[0]]!r} at row {wrong[0]}" if len(wrong) else "another shape"
