"""The kernels of our own problems, loaded once before processes are forked that all need them."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from typing import Any

from calibench import problems
from calibench.bench.execution.run import Spec
from calibench.bench.provenance.run_id import canonical
from calibench.core.compiler import load_compiler
from calibench.core.sources import file_of, is_ours


def load_kernels(specs: Iterable[Spec]) -> None:
    """Compile (or load) the kernels of the problems of `specs` that are our own; a user's may end a process."""
    load_compiler()
    for spec in {(s.problem, canonical(s.problem_options)): s for s in specs}.values():
        if spec.problem not in problems.registry.names():
            continue
        file = file_of(getattr(problems.registry.factory(spec.problem), "__module__", ""))
        if file is None or not is_ours(file):
            continue
        with suppress(Exception):  # its runs will say what is wrong with it
            problem: Any = problems.make(spec.problem, **spec.problem_options)
            if hasattr(problem, "compile"):
                problem.compile()
