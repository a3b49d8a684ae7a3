"""Parameters that end outside their bounds: the fit knows none, so what lies beyond them is told, and told first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from calibench.problems.base import Parameter

BEYOND = "the fit is free of bounds"  # in the note, by which a page knows it


def outside_bounds(parameters: Sequence[Parameter], found: Mapping[str, float]) -> tuple[str, ...]:
    """Return a note for the parameters that end outside their bounds; none where all end inside."""
    out = [
        f"{p.name} ends at {found[p.name]:.6g} {p.unit}, outside {p.lower:g} to {p.upper:g}"
        for p in parameters
        if p.name in found and not p.lower <= found[p.name] <= p.upper
    ]
    if not out:
        return ()
    return (f"{'; '.join(out)}: {BEYOND}, and found the machine elsewhere than its owner did; are the "
            "units, the start, and the bounds right?",)  # fmt: skip
