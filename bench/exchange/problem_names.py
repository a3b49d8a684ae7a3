"""What a function of another suite is called here: by all options of our own problem where we have it."""

from __future__ import annotations

from typing import Any

from calibench import problems
from calibench.bench.provenance.run_id import canonical, options_as_asked


def our_options(problem: str, **options: Any) -> str:
    """Return the options of a problem as its rows have them (JSON), all of them where we know the problem."""
    if problem in problems.registry.names():
        try:
            return canonical(options_as_asked(problems.registry, problem, options))
        except ValueError:  # of that name here, and of other options: it is another problem
            pass
    return canonical(options)
