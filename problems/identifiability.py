"""Identifiability of a calibration problem: rank, null directions, condition number and standard errors.

Angles are converted to millimetres (times a link length) before singular values are taken, so that they compare. The
accuracy of identified parameters is by Pashkevich et al. 2008, section 3.4, which holds for every least squares fit:
(12) with the covariance of the residuals, which need not be independent (13)-(14).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench.core.process import one_thread
from calibench.problems.base import Array, coordinates_of, extra_of
from calibench.problems.fitting import checked_covariance, fit, gauss_newton

_ANGLE_ARM = 244.0  # mm: an offset of 1 rad moves the joint B by a link length


@final
@dataclass(frozen=True, eq=False)
class Identifiability:
    """Rank, singular values and null directions of a problem's Jacobian at `x`.

    `singular_values` tell how much the readings change for a move of the parameters [rad/mm]. `null_space` has shape
    (dim - rank, dim), each row of unit length in the scaled coordinates and given back in mm and rad. `condition` is
    that of the identifiable part. `standard_errors`, shape (dim,), are the best reachable at `noise` (`noise_unit` a
    reading): infinite for a parameter that takes part in a null direction.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    x: Array
    rank: int
    singular_values: Array
    null_space: Array
    condition: float
    noise: float
    standard_errors: Array
    noise_unit: str = "rad"

    @property
    def dimension(self) -> int:
        """Return the number of unknowns."""
        return len(self.names)

    def null_vectors(self) -> list[dict[str, float]]:
        """Return each null direction as {parameter: share}, scaled so that its largest angle (or length) is 1."""
        vectors = []
        for direction in self.null_space:
            angles = [abs(v) for v, unit in zip(direction, self.units, strict=True) if unit == "rad"]
            direction = direction / (max(angles) if angles and max(angles) > 0 else np.abs(direction).max())
            direction = direction * np.sign(direction[np.abs(direction).argmax()])
            vectors.append({name: float(v) for name, v in zip(self.names, direction, strict=True)})
        return vectors

    def sentence(self) -> str:
        """Return the finding in one sentence."""
        dim = self.dimension
        lost = dim - self.rank
        if not lost:
            seen = f"all {dim} parameters" if dim > 1 else "the only parameter"
            return f"{seen} can be seen in the data (condition {self.condition:.3g})"
        moved = [f"{name} {share:+.4g}" for name, share in self.null_vectors()[0].items() if abs(share) > 1e-9]
        many = (
            "direction that no optimiser can find" if lost == 1 else "directions that no optimiser can find, the first"
        )
        return f"{self.rank} of {dim} parameters can be seen; {lost} {many}: {', '.join(moved)}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers for JSON; infinite standard errors become None."""
        errors = [float(s) if np.isfinite(s) else None for s in self.standard_errors]
        return {
            "dimension": self.dimension, "rank": self.rank, "condition": self.condition,
            "singular_values": self.singular_values.tolist(), "null_vectors": self.null_vectors(), "noise": self.noise,
            "standard_errors": dict(zip(self.names, errors, strict=True)),
        }  # fmt: skip


@one_thread()
def identify(problem: Any, x: Array | None = None, noise: float | None = None) -> Identifiability:
    """Analyse `problem` at `x` (its truth, else its start) for independent reading noise of `noise` (rad, or mm).

    Without `noise` it is the problem's `typical_noise`, or 1e-4. What can be seen is a question to the readings of a
    machine that is `x`, not to the errors of those at hand: where the problem can tell (`explained_by`), they are moved
    to readings that `x` explains.

    The problem needs `jacobian`. Residuals are weighted by its `residual_noise`, or where they are
    not independent by its `residual_covariance`; without either, `noise` is the standard deviation of a residual in
    its own unit. Raises `ValueError` where there is no Jacobian.
    """
    if getattr(problem, "jacobian", None) is None:
        who = extra_of(problem, "name", type(problem).__name__)
        raise ValueError(f"{who} has no Jacobian: identifiability needs one, jacobian(x) of shape (residuals, dim)")
    if noise is None:
        noise = float(extra_of(problem, "typical_noise", 1e-4))
    if not noise > 0:
        raise ValueError(f"noise={noise:g}: must be above 0")
    if x is None:
        truth = getattr(problem, "truth", None)
        x = np.asarray(problem.start if truth is None else truth, dtype=float)
    if getattr(problem, "explained_by", None) is not None:
        problem = problem.explained_by(x)
    coordinates = getattr(problem, "coordinates", None) or ()
    if not coordinates or any(isinstance(one, str) for one in coordinates):
        coordinates = coordinates_of(problem)
    scale = np.array([1.0 / _ANGLE_ARM if c.unit == "rad" else 1.0 for c in coordinates])

    # the Jacobian with each residual in units of its noise, and free of the others'
    jacobian, noise_unit = np.asarray(problem.jacobian(x)), "rad"
    if getattr(problem, "residual_covariance", None) is not None:
        jacobian = np.linalg.solve(np.linalg.cholesky(problem.residual_covariance(x)), jacobian)
    elif getattr(problem, "residual_noise", None) is not None:
        redundancy: int = extra_of(problem, "redundancy", 1)
        jacobian = jacobian / (redundancy**0.5 * problem.residual_noise(x))[:, None]
    else:
        noise_unit = "in a residual"
    weighted = jacobian * scale

    few = weighted.shape[0] < weighted.shape[1]  # only then are null directions missing from the thin form
    _, s, vt = np.linalg.svd(weighted, full_matrices=few)
    s = np.pad(s, (0, len(coordinates) - len(s)))
    rank = int((s > s[0] * max(weighted.shape) * np.finfo(float).eps * 10).sum())
    null_space = vt[rank:] * scale
    with np.errstate(divide="ignore"):
        variance = ((vt[:rank] / s[:rank, None]) ** 2).sum(axis=0) if rank else np.zeros(len(s))
    errors = noise * np.sqrt(variance) * scale
    errors[(np.abs(vt[rank:]) > 1e-9).any(axis=0)] = np.inf
    return Identifiability(
        names=tuple(c.name for c in coordinates), units=tuple(c.unit for c in coordinates), x=np.array(x), rank=rank,
        singular_values=s, null_space=null_space, condition=float(s[0] / s[rank - 1]) if rank else float("inf"),
        noise=noise, standard_errors=errors, noise_unit=extra_of(problem, "noise_unit", noise_unit),
    )  # fmt: skip


@final
@dataclass(frozen=True, eq=False)
class Estimate:
    """Identified parameters with their covariance, shape (dim, dim), in the squared units of the coordinates.

    `sigma` is the standard deviation of one reading, as given or (`sigma_known` false) from the residuals with
    `degrees_of_freedom`. `weighted` tells whether the residual covariance weights the fit (generalised least squares).
    """

    problem: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    x: Array
    value: float
    covariance: Array
    sigma: float
    sigma_known: bool
    degrees_of_freedom: int
    weighted: bool

    @property
    def standard_errors(self) -> Array:
        """Return the standard error of each parameter, shape (dim,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def correlations(self) -> Array:
        """Return the correlation of each pair of parameters, shape (dim, dim)."""
        errors = self.standard_errors
        return np.asarray(self.covariance / np.outer(errors, errors))

    def intervals(self, level: float = 0.95) -> Array:
        """Return confidence intervals, shape (dim, 2), in the units of the coordinates."""
        if not 0 < level < 1:
            raise ValueError(f"level={level:g}: a probability between 0 and 1 is needed")
        from scipy.stats import norm, t  # here, as listing the problems must not load SciPy

        inside = (1 + level) / 2
        width = norm.ppf(inside) if self.sigma_known else t.ppf(inside, self.degrees_of_freedom)
        half = width * self.standard_errors
        return np.column_stack([self.x - half, self.x + half])

    def of(self, weights: dict[str, float]) -> tuple[float, float]:
        """Return value and standard error of a combination such as ``{"drho_x": 1, "dL_x": -1}``."""
        unknown = [name for name in weights if name not in self.names]
        if unknown:
            raise ValueError(f"{', '.join(unknown)}: no parameter of {self.problem}; it has {', '.join(self.names)}")
        row = np.array([weights.get(name, 0.0) for name in self.names])
        return float(row @ self.x), float(np.sqrt(row @ self.covariance @ row))

    def rows(self, level: float = 0.95) -> list[dict[str, Any]]:
        """Return a row a parameter: parameter, unit, value, standard_error, lower, upper (the interval at `level`)."""
        numbers = np.column_stack([self.x, self.standard_errors, self.intervals(level)]).tolist()
        names = ("parameter", "unit", "value", "standard_error", "lower", "upper")
        return [dict(zip(names, (n, u, *four))) for n, u, four in zip(self.names, self.units, numbers, strict=True)]

    def to_dict(self, level: float = 0.95) -> dict[str, Any]:
        """Return plain numbers for JSON."""
        return {
            "problem": self.problem, "sum_of_squares": self.value, "sigma": self.sigma,
            "sigma_known": self.sigma_known, "degrees_of_freedom": self.degrees_of_freedom, "weighted": self.weighted,
            "level": level, "parameters": self.rows(level), "correlations": self.correlations.tolist(),
        }  # fmt: skip


def estimate(
    problem: Any, x: Array | None = None, *, sigma: float | None = None, covariance: Array | None = None,
    weighted: bool = False,
) -> Estimate:  # fmt: skip
    """Return the parameters with their covariance at `x`, the least squares answer (fitted from the start by default).

    `covariance`, shape (m, m), is E(ds ds^T) / sigma^2 of the residuals, by default the identity; with `weighted` it
    also weights the fit. `sigma` is the standard deviation of a reading; by default the residuals tell it.
    Raises `ValueError` where the data cannot see all the parameters, or leave nothing to tell sigma by.
    """
    if sigma is not None and not sigma > 0:
        raise ValueError(f"sigma={sigma:g}: a standard deviation above 0 is needed")
    if x is None:
        x = fit(problem, covariance=covariance if weighted else None)
    r, j = np.asarray(problem.residuals(x)), np.asarray(problem.jacobian(x))
    m, dim = j.shape
    spread = checked_covariance(covariance, m)
    if weighted:
        half = np.linalg.cholesky(spread)
        r, j, spread = np.linalg.solve(half, r), np.linalg.solve(half, j), np.eye(m)
    _check_rank(problem, j)
    inverse = np.linalg.pinv(j)  # (J^T J)^-1 J^T
    value, unit = float(r @ r), inverse @ spread @ inverse.T  # eq. (12) for sigma = 1
    scale = sigma
    if scale is None:
        left = float(np.trace(spread - j @ inverse @ spread))  # E(r @ r) / sigma^2
        if m <= dim:
            raise ValueError(
                f"{_name(problem)}: {m} residuals and {dim} parameters leave nothing to tell sigma by; give it"
            )
        scale = float(np.sqrt(value / left))
    return Estimate(
        problem=_name(problem), names=tuple(c.name for c in problem.coordinates),
        units=tuple(c.unit for c in problem.coordinates), x=np.array(x, dtype=float), value=value,
        covariance=scale**2 * unit, sigma=scale, sigma_known=sigma is not None, degrees_of_freedom=m - dim,
        weighted=weighted,
    )  # fmt: skip


@final
@dataclass(frozen=True, slots=True)
class FTest:
    """An F test of nested parameter sets: does the larger set explain more than its size alone would?"""

    statistic: float
    added: int
    degrees_of_freedom: int
    p_value: float
    value_small: float
    value_large: float

    def sentence(self, level: float = 0.05) -> str:
        """Return the finding in one sentence."""
        verdict = "are supported by" if self.p_value < level else "are not supported by"
        return (
            f"F({self.added}, {self.degrees_of_freedom}) = {self.statistic:.3g}, p = {self.p_value:.2g}: "
            f"{self.added} more parameters {verdict} the data"
        )


def f_test(small: Any, large: Any, *, covariance: Array | None = None) -> FTest:
    """Test the problem `small` within `large`: the same data, its parameters a part of the other's.

    Both are fitted from their starts, weighted by `covariance`, shape (m, m), if it is given. Raises `ValueError` where
    the sets are not nested or the data differ.
    """
    names_small, names_large = ({c.name for c in p.coordinates} for p in (small, large))
    if not names_small < names_large:
        extra = ", ".join(sorted(names_small - names_large)) or "the same parameters"
        raise ValueError(f"{_name(small)} is not nested in {_name(large)}: {extra}")
    ids = [getattr(p, "data_id", None) for p in (small, large)]
    if ids[0] != ids[1]:
        raise ValueError(f"{_name(small)} and {_name(large)} have different data; an F test needs the same")
    values, rows = [], 0
    for p in (small, large):
        r = np.asarray(p.residuals(fit(p, covariance=covariance)))
        rows = len(r)
        if covariance is not None:
            r = np.linalg.solve(np.linalg.cholesky(checked_covariance(covariance, rows)), r)
        values.append(float(r @ r))
    return f_test_of_sums(values[0], len(names_small), values[1], len(names_large), rows)


def f_test_of_sums(value_small: float, dim_small: int, value_large: float, dim_large: int, rows: int) -> FTest:
    """Return the F test of two sums of squares with their numbers of parameters, from the same number of residuals."""
    added, left = dim_large - dim_small, rows - dim_large
    if added < 1 or left < 1:
        raise ValueError(f"{rows} residuals, {dim_small} and {dim_large} parameters: there is nothing to test")
    from scipy.stats import f  # here, as listing the problems must not load SciPy

    statistic = (value_small - value_large) / added / (value_large / left)
    return FTest(statistic, added, left, float(f.sf(statistic, added, left)), value_small, value_large)


@final
@dataclass(frozen=True, eq=False)
class LeaveOneOut:
    """What each residual does to the answer: fits without it, shape (m, dim), and its prediction error, shape (m,)."""

    names: tuple[str, ...]
    x: Array
    without: Array
    prediction_errors: Array

    @property
    def shifts(self) -> Array:
        """Return how far the answer moves without each residual, shape (m, dim)."""
        return np.asarray(self.without - self.x)

    @property
    def rms(self) -> float:
        """Return the root mean square of the prediction errors, in the unit of the residuals."""
        return float(np.sqrt(np.mean(self.prediction_errors**2)))


def leave_one_out(problem: Any, x: Array | None = None) -> LeaveOneOut:
    """Fit without each residual in turn, from the answer `x` (fitted by default), and predict the one left out."""
    x = fit(problem) if x is None else np.array(x, dtype=float)
    m = len(problem.residuals(x))
    without, errors = [], []
    for k in range(m):
        kept = np.arange(m) != k
        _check_rank(problem, problem.jacobian(x)[kept], f" without residual {k + 1}")
        found = gauss_newton(_rows_of(problem.residuals, kept), _rows_of(problem.jacobian, kept), x)
        without.append(found)
        errors.append(problem.residuals(found)[k])
    names = tuple(c.name for c in problem.coordinates)
    return LeaveOneOut(names, x, np.array(without), np.array(errors))


def _rows_of(function: Callable[[Array], Array], kept: NDArray[np.bool_]) -> Callable[[Array], Array]:
    return lambda p: np.asarray(function(p)[kept])


def _check_rank(problem: Any, j: Array, when: str = "") -> None:
    scale = np.linalg.norm(j, axis=0)
    s = np.linalg.svd(j / np.where(scale > 0, scale, 1.0), compute_uv=False)
    rank, dim = int((s > 1e-10 * s[0]).sum()), j.shape[1]
    if rank < dim:
        raise ValueError(
            f"{_name(problem)}: the data see {rank} of {dim} parameters{when}, so not all have a standard error; "
            "hold some of them, or measure more (problems.identify names the direction)"
        )


def _name(problem: Any) -> str:
    return str(extra_of(problem, "name", type(problem).__name__))
