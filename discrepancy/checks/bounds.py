"""Notes on parameters that end outside their bounds, which the fit does not enforce. They precede all other notes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from calibench.problems.base import Parameter

_TOLD = 3  # parameters with their numbers
_NARROW = 1e-300  # bounds that leave no room
BEYOND = "the fit is free of bounds"  # in the note, by which a page knows it


def outside_bounds(parameters: Sequence[Parameter], found: Mapping[str, float]) -> tuple[str, ...]:
    """Return a note for the parameters that end outside their bounds, the furthest first; none where all end inside.

    If there are many, only their names are told: the table of parameters has all numbers.
    """
    out = sorted((p for p in parameters if _beyond(p, found) > 0), key=lambda p: -_beyond(p, found))
    if not out:
        return ()
    many = len(out) > _TOLD + 1
    first, others = (out[:_TOLD], out[_TOLD:]) if many else (out, [])
    told = "; ".join(
        f"{p.name} ends at {found[p.name]:.6g} {p.unit}, outside {p.lower:g} to {p.upper:g}" for p in first
    )
    told += f"; outside theirs are {len(others)} more: {', '.join(p.name for p in others)}" if many else ""
    return (f"{told}: {BEYOND}, and found the machine elsewhere than its owner did; are the "
            "units, the start, and the bounds right?",)  # fmt: skip


def _beyond(p: Parameter, found: Mapping[str, float]) -> float:
    """Return how far a parameter ends outside its bounds, in widths of the box.

    It is 0 inside, and for a parameter without a value.
    """
    at = found.get(p.name, p.lower)
    return 0.0 if p.lower <= at <= p.upper else max(p.lower - at, at - p.upper) / max(p.upper - p.lower, _NARROW)
