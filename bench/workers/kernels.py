"""What the runs of a pack need, worked out once before processes are forked that all need it.

These are the kernels of our own problems and methods and of the gate, the digests of their code, and the versions of
the libraries: together about a second of processor time, and nothing in a fork that comes after, such as that which
takes the place of a worker that a run has ended.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any

from calibench import optimizers, problems
from calibench.bench.execution.run import Spec
from calibench.bench.gate.box import looks
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.time_limit import stays_inside
from calibench.bench.provenance.code_digest import digest_of, gate_digest
from calibench.bench.provenance.environment import provenance
from calibench.bench.provenance.run_id import canonical
from calibench.core.compilation.compiler import load_compiler
from calibench.core.registry import Registry
from calibench.core.sources import file_of, is_ours


def load_kernels(specs: Iterable[Spec]) -> None:
    """Load what the runs `specs` need of our own problems and methods; of a user's nothing: it may end a process."""
    parts: dict[tuple[str, str], tuple[Registry[Any], Mapping[str, Any]]] = {}
    for spec in specs:
        parts[spec.problem, canonical(spec.problem_options)] = problems.registry, spec.problem_options
        parts[spec.optimizer, canonical(spec.optimizer_options)] = optimizers.registry, spec.optimizer_options
    for (name, _), (registry, options) in parts.items():
        with suppress(Exception):  # its runs will say what is wrong with it
            part: Any = registry.make(name, **options) if _is_own(registry, name) else None
            if registry is optimizers.registry and (part is None or not stays_inside(part)):
                looks()
            if part is not None:
                digest_of(part)
            if hasattr(part, "compile"):
                part.compile()
            if part is not None and registry is problems.registry:
                Evaluator(part, 1).close()  # it loads what looks through a batch
                if hasattr(part, "merit"):
                    part.merit(part.start)
    gate_digest()
    provenance()
    load_compiler()


def _is_own(registry: Registry[Any], name: str) -> bool:
    if ":" in name or name not in registry.names():
        return False
    file = file_of(getattr(registry.factory(name), "__module__", None) or "")
    return file is not None and is_ours(file)
