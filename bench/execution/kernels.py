"""What the runs of a pack need, worked out once before processes are forked that all need it.

These are the kernels of our own problems and methods and of the gate, the digests of their code, and the versions of
the libraries: together about a second of processor time, and nothing in a fork that comes after, such as that which
takes the place of a worker that a run has ended.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from calibench import optimizers, problems
from calibench.bench.execution.request import foreign_modules
from calibench.bench.execution.run import Spec, asks_slopes, compile_problem
from calibench.bench.gate.evaluator import Evaluator, scans
from calibench.bench.gate.face import looks
from calibench.bench.gate.processes import ProcessDied, at_once
from calibench.bench.gate.time_limit import stays_inside
from calibench.bench.provenance.code_digest import digest_of, gate_digest
from calibench.bench.provenance.environment import provenance
from calibench.bench.provenance.run_id import canonical
from calibench.core.compilation.compiled import heard, load_compiler, seen, tell_compiling, unseen
from calibench.core.own_state import kept
from calibench.core.registry import Registry
from calibench.core.sources import module_digest
from calibench.problems.base import extra_of

_LOADED: set[tuple[str, ...]] = set()  # what problems and the optimisers beside them need that this process has
Part = tuple[Registry[Any], str, Mapping[str, Any]]


def load_kernels(specs: Iterable[Spec], fork: bool = True, compiling: Callable[[], None] = lambda: None) -> None:
    """Load what the runs `specs` need of our own problems and methods; of a user's nothing: it may end a process.

    What was never compiled is first compiled in a process for each core, if this one may `fork`. What libraries set as
    they are loaded is put back. `compiling` is called whenever something is compiled, and not only loaded.
    """
    # one of each cell: its runs share the options
    cells = {(s.problem, id(s.problem_options), s.optimizer, id(s.optimizer_options)): s for s in specs}
    with kept(), heard(compiling):
        parts: dict[str, Part] = {}
        beside: dict[str, list[str]] = {}  # problem -> the optimisers that run on it
        for spec in cells.values():
            problem, method = _parts_of(spec)
            parts[_word(problem)], parts[_word(method)] = problem, method
            beside.setdefault(_word(problem), []).append(_word(method))
        needed = {word: _needed(part) for word, part in parts.items()}
        _LOADED.update((needed[problem], needed[method]) for problem, methods in beside.items() for method in methods)
        made: dict[str, Any] = {}
        for word, (registry, name, options) in parts.items():
            with suppress(Exception):  # the rows of its runs will have the error
                made[word] = registry.make(name, **options) if is_own(registry, name) else None
        if fork:  # what no process has compiled yet: each module's parts in a process of their own, which keeps it
            from calibench.core.compilation.shipped import modules  # it loads numba

            own = {
                word: str(parts[word][0].factory(parts[word][1]).__module__)
                for word, part in made.items()
                if part is not None
            }
            asked = {word: [made.get(method) for method in beside.get(word, ())] for word in own}
            digests = {word: module_digest(module) for word, module in own.items()}
            noted = {
                f"{word} {asks_slopes(asked[word])} {digest}": word
                for word, digest in digests.items()
                if digest not in modules()  # what came with the installation
            }
            new = unseen(noted)
            by_module: dict[str, list[tuple[Any, list[Any]]]] = {}
            for word in map(noted.__getitem__, new):
                by_module.setdefault(own[word], []).append((made[word], asked[word]))
            if len(by_module) > 1:
                if any(extra_of(made[noted[word]], "compile") for word in new):
                    tell_compiling()
                    load_compiler()  # once for all of them
                with suppress(ProcessDied):  # compiled here, then
                    at_once([partial(_compile, some) for some in by_module.values()])
            seen(new)
        for word, part in sorted(made.items()):  # optimisers first
            with suppress(Exception):  # as above
                of_methods = parts[word][0] is optimizers.registry
                if of_methods and (part is None or not stays_inside(part)):
                    looks()
                if part is None:
                    continue
                digest_of(part)
                _compile([(part, [made.get(method) for method in beside.get(word, ())])])
        gate_digest()
        provenance()
        if not all(is_own(registry, name) for registry, name, _ in parts.values()):
            looks(), scans()
            load_compiler()  # a user's own code may compile in every child; ours is kept


def load_new_kernels(spec: Spec) -> bool:
    """Load what one run needs where this process has not done so yet; tell whether it had to."""
    needed = tuple(map(_needed, _parts_of(spec)))
    if needed in _LOADED:
        return False
    load_kernels([spec], fork=False)
    return True


def _parts_of(spec: Spec) -> tuple[Part, Part]:
    return (
        (problems.registry, spec.problem, spec.problem_options),
        (optimizers.registry, spec.optimizer, spec.optimizer_options),
    )


def _word(part: Part) -> str:
    registry, name, options = part
    return f"{registry.kind} {name} {canonical(options)}"


def _needed(part: Part) -> str:
    """Return a word for what a part needs to be loaded; of a class by its path nothing is."""
    registry, name, _ = part
    return _word(part) if is_own(registry, name) else "" if ":" in name else name


def _compile(parts: Sequence[tuple[Any, Sequence[Any]]]) -> None:
    """Load problems, with the methods that run on each and all that a run needs beside its calls, and optimisers."""
    for part, methods in parts:
        with suppress(Exception):  # the rows of its runs will have the error
            if methods:
                compile_problem(part, *methods)
                Evaluator(part, 1).close()  # what looks through a batch
                if extra_of(part, "merit"):
                    part.merit(part.start)
            elif extra_of(part, "compile"):
                part.compile()


def is_own(registry: Registry[Any], name: str) -> bool:
    """Tell whether a name is one of ours, and not a user's or another package's."""
    return ":" not in name and name in registry and not foreign_modules(registry, name)
