"""Identifiability of a calibration problem: rank, null directions, condition number and standard errors.

Angles are converted to millimetres (times a link length) before singular values are taken, so that they can be
compared. No optimiser can find a direction without a singular value.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from calibench.core.one_thread import one_thread
from calibench.problems.base import Array, coordinates_of, extra_of

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
        lost = self.dimension - self.rank
        if not lost:
            seen = f"all {self.dimension} parameters" if self.dimension > 1 else "the only parameter"
            return f"{seen} can be seen in the data (condition {self.condition:.3g})"
        moved = [f"{name} {share:+.4g}" for name, share in self.null_vectors()[0].items() if abs(share) > 1e-9]
        many = (
            "direction that no optimiser can find" if lost == 1 else "directions that no optimiser can find, the first"
        )
        return f"{self.rank} of {self.dimension} parameters can be seen; {lost} {many}: {', '.join(moved)}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers for JSON; infinite standard errors become None."""
        errors = [float(s) if np.isfinite(s) else None for s in self.standard_errors]
        return {
            "dimension": self.dimension,
            "rank": self.rank,
            "condition": self.condition,
            "singular_values": self.singular_values.tolist(),
            "null_vectors": self.null_vectors(),
            "noise": self.noise,
            "standard_errors": dict(zip(self.names, errors, strict=True)),
        }


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
    told = any(getattr(problem, name, None) is not None for name in ("residual_noise", "residual_covariance"))
    scale = np.array([1.0 / _ANGLE_ARM if c.unit == "rad" else 1.0 for c in coordinates])
    weighted = _weighted(problem, x) * scale
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
        names=tuple(c.name for c in coordinates),
        units=tuple(c.unit for c in coordinates),
        x=np.array(x),
        rank=rank,
        singular_values=s,
        null_space=null_space,
        condition=float(s[0] / s[rank - 1]) if rank else float("inf"),
        noise=noise,
        standard_errors=errors,
        noise_unit=extra_of(problem, "noise_unit", "rad" if told else "in a residual"),
    )


def _weighted(problem: Any, x: Array) -> Array:
    """Return the Jacobian with each residual in units of its noise, and free of the others'."""
    jacobian: Array = problem.jacobian(x)
    if getattr(problem, "residual_covariance", None) is not None:
        return np.asarray(np.linalg.solve(np.linalg.cholesky(problem.residual_covariance(x)), jacobian))
    if getattr(problem, "residual_noise", None) is not None:
        redundancy: int = extra_of(problem, "redundancy", 1)
        return np.asarray(jacobian / (redundancy**0.5 * problem.residual_noise(x))[:, None])
    return jacobian
