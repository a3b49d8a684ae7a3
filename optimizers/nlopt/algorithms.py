"""NLopt's algorithms in the registry, each with the options of its family and the traits of the table.

Methods inside another (`local`) are those that never failed at the rounding floor: a failure there would end the method
around them too.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Literal

from calibench.optimizers.base import registry
from calibench.optimizers.nlopt._table import ALGORITHMS, EXCLUDED
from calibench.optimizers.nlopt.adapter import NLopt
from calibench.optimizers.nlopt.settings import ROUNDING

FreeLocal = Literal["LN_BOBYQA", "LN_COBYLA", "LN_NELDERMEAD", "LN_SBPLX"]
GradientLocal = Literal["LD_SLSQP", "LD_MMA", "LD_CCSAQ"]
AnyLocal = Literal["LD_SLSQP", "LD_MMA", "LD_CCSAQ", "LN_BOBYQA", "LN_COBYLA", "LN_NELDERMEAD", "LN_SBPLX"]


def _global(algorithm: str, scale_value: bool = True) -> NLopt:
    """Search the box until the budget is spent."""
    return NLopt(algorithm, {"scale_value": scale_value})


def _population(algorithm: str, population: int | None = None, scale_value: bool = True) -> NLopt:
    """Search with a `population`; null leaves its size to NLopt."""
    return NLopt(algorithm, {"population": population, "scale_value": scale_value})


def _derivative_free(
    algorithm: str, initial_step: float | None = None, scale_value: bool = True, restarts: bool = False
) -> NLopt:
    """Descend without derivatives; `initial_step` in widths of the box, null leaves it to NLopt."""
    return NLopt(algorithm, {"initial_step": initial_step, "scale_value": scale_value, "restarts": restarts})


def _gradient(algorithm: str, scale_value: bool = True, restarts: bool = False) -> NLopt:
    """Descend along gradients."""
    return NLopt(algorithm, {"scale_value": scale_value, "restarts": restarts})


def _limited_memory(
    algorithm: str, storage: int | None = None, scale_value: bool = True, restarts: bool = False
) -> NLopt:
    """Descend along gradients, remembering `storage` of them; null leaves the number to NLopt."""
    return NLopt(algorithm, {"storage": storage, "scale_value": scale_value, "restarts": restarts})


def _endless(algorithm: str, scale_value: bool = True, restarts: bool = False) -> NLopt:
    """Descend along gradients, without an end unless there are `restarts`."""
    return NLopt(algorithm, {"scale_value": scale_value, "restarts": restarts})


def _mlsl_free(
    algorithm: str,
    local: FreeLocal = "LN_BOBYQA",
    local_tolerance: float = ROUNDING,
    population: int | None = None,
    scale_value: bool = True,
) -> NLopt:
    """Start `local` from the best of `population` (null: 4) new random points, again and again."""
    return _mlsl_any(algorithm, local, local_tolerance, population, scale_value)


def _mlsl_gradient(
    algorithm: str,
    local: GradientLocal = "LD_SLSQP",
    local_tolerance: float = ROUNDING,
    population: int | None = None,
    scale_value: bool = True,
) -> NLopt:
    """Start `local` from the best of `population` (null: 4) new random points, again and again."""
    return _mlsl_any(algorithm, local, local_tolerance, population, scale_value)


def _mlsl_any(
    algorithm: str,
    local: AnyLocal = "LD_SLSQP",
    local_tolerance: float = ROUNDING,
    population: int | None = None,
    scale_value: bool = True,
) -> NLopt:
    """Start `local` from the best of `population` (null: 4) new random points, again and again."""
    chosen = {"local": local, "local_tolerance": local_tolerance, "population": population}
    return NLopt(algorithm, {**chosen, "scale_value": scale_value})


def _auglag_free(
    algorithm: str,
    local: FreeLocal = "LN_BOBYQA",
    local_tolerance: float = ROUNDING,
    scale_value: bool = True,
    restarts: bool = False,
) -> NLopt:
    """Run `local` inside the augmented Lagrangian."""
    return _auglag_any(algorithm, local, local_tolerance, scale_value, restarts)


def _auglag_gradient(
    algorithm: str,
    local: GradientLocal = "LD_SLSQP",
    local_tolerance: float = ROUNDING,
    scale_value: bool = True,
    restarts: bool = False,
) -> NLopt:
    """Run `local` inside the augmented Lagrangian."""
    return _auglag_any(algorithm, local, local_tolerance, scale_value, restarts)


def _auglag_any(
    algorithm: str,
    local: AnyLocal = "LD_SLSQP",
    local_tolerance: float = ROUNDING,
    scale_value: bool = True,
    restarts: bool = False,
) -> NLopt:
    """Run `local` inside the augmented Lagrangian."""
    chosen = {"local": local, "local_tolerance": local_tolerance}
    return NLopt(algorithm, {**chosen, "scale_value": scale_value, "restarts": restarts})


_FAMILIES: dict[str, Callable[..., NLopt]] = {
    "global": _global, "population": _population, "derivative_free": _derivative_free, "gradient": _gradient,
    "limited_memory": _limited_memory, "endless_gradient": _endless, "mlsl_free": _mlsl_free,
    "mlsl_gradient": _mlsl_gradient, "mlsl_any": _mlsl_any, "auglag_free": _auglag_free,
    "auglag_gradient": _auglag_gradient, "auglag_any": _auglag_any,
}  # fmt: skip

for _name, _known in ALGORITHMS.items():
    _entry = functools.partial(_FAMILIES[_known.family], _name)
    _entry.__doc__ = _known.about
    registry.register(f"nlopt_{_name}")(_entry)
for _name, _reason in EXCLUDED.items():
    registry.exclude(f"nlopt_{_name}", _reason)
