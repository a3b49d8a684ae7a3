"""Output of a search of `fmincon` along the way: lines of its display, and calls of the user's OutputFcn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, final

from calibench.optimizers.base import Array
from calibench.optimizers.fmincon.options import Options
from calibench.optimizers.fmincon.search.state import State


@final
@dataclass(frozen=True, eq=False)
class OptimValues:
    """The argument of an OutputFcn, under MATLAB's names; `stepsize` is the norm of the last step in x.

    `searchdirection`, shape (n,), is the whole d of the line search that led here; None where none did.
    """

    iteration: int
    funccount: int
    fval: float
    constrviolation: float
    stepsize: float
    lssteplength: float
    firstorderopt: float
    gradient: Array
    searchdirection: Array | None = None


def tell(state: State, count: int, options: Options, when: Literal["init", "iter", "done"]) -> bool:
    """Call the OutputFcn, if there is one, after `count` evaluations; return whether it asks to stop.

    Raises `RuntimeError` that says at which iteration, where it raises anything.
    """
    if options.OutputFcn is None:
        return False
    at = state.answer
    values = OptimValues(
        state.iteration, count, at.value, at.violation, state.step, state.step_length, at.first_order,
        at.gradient.copy(), None if state.direction is None else state.direction.copy(),
    )  # fmt: skip
    try:
        return bool(options.OutputFcn(at.x.copy(), values, when))
    except Exception as error:
        raise RuntimeError(
            f"OutputFcn raised {type(error).__name__} at iteration {state.iteration} ({when}): {error}"
        ) from error


def print_header(options: Options) -> None:
    """Print the heads of the columns where Display is iter."""
    if options.Display == "iter":
        print(f"{'':>55}{'':>14}{'Norm of':>14}{'First-order':>14}")
        print(
            f"{'Iter':>5}{'Func-count':>12}{'Fval':>19}{'Feasibility':>15}{'Step length':>14}{'step':>14}"
            f"{'optimality':>14}"
        )


def print_iterate(state: State, count: int, options: Options) -> None:
    """Print the line of the last iterate where Display is iter."""
    if options.Display == "iter":
        at = state.last
        print(
            f"{state.iteration:5d}{count:12d}{at.value:19.6e}{at.violation:15.3e}"
            f"{state.step_length:14.3e}{state.step:14.3e}{at.first_order:14.3e}"
        )


def print_message(message: str, options: Options) -> None:
    """Print how the search ended, unless Display is off."""
    if options.Display != "off":
        print(f"\n{message}")
