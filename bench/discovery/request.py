"""The requests of `bench discover` and `bench design`: a machine, data, statements on them, and the result folder."""

import os
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, final

from calibench.bench.measured.files import pairs_of
from calibench.bench.provenance.run_id import canonical
from calibench.bench.verbs import DesignWords, DiscoverWords
from calibench.bench.words import RequestError, check_study, keys_of, read, read_workers
from calibench.core.options import Option, coerce, declared_options, read_word, suggest
from calibench.discrepancy.checks.validate import refuse_no_machine
from calibench.discrepancy.model.machine import Machine
from calibench.discrepancy.registries import description_of, descriptions, machines

Pages = Literal["auto", "all", "none"]


@dataclass(frozen=True)
class _OfMachine:
    machine: str
    machine_options: Mapping[str, Any]

    def build_machine(self) -> Machine:
        """Return the machine with its options; raise `DataError` for a class that is none."""
        machine = machines.make(self.machine, **self.machine_options)
        refuse_no_machine(machine, f"machine={self.machine}")
        return machine


@final
@dataclass(frozen=True)
class DiscoverRequest(_OfMachine):
    """A search in one or more sets of data; `stated` overrides the files' own metadata.

    `across` names further sets of the machine, as `data` does, in which the findings of one set are looked for.
    """

    data: str
    stated: Mapping[str, Any]
    across: str = ""
    folder: Path = field(default=Path("results/discover"))
    pages: Pages = "auto"
    workers: int = 1
    command: str = ""

    @property
    def options(self) -> str:
        """Return all that decides the verdict besides the data, as canonical JSON."""
        across = {"across": self.across} if self.across else {}
        machine = {"name": self.machine, **self.machine_options}
        return canonical({"machine": machine, "stated": dict(self.stated), **across})


def read_discover(words: Sequence[str]) -> DiscoverRequest:
    """Return the search that `words` ask for. Raises `RequestError` or `ValueError`."""
    given = read(DiscoverWords, "discover", words)
    stated, options = _of_the_machine(given)
    if not given.data:
        raise RequestError("data= is missing: a file, a glob, a folder or a name, such as data=run7.parquet")
    check_study(given.study)
    n_jobs = read_workers(-1 if given.n_jobs is None else given.n_jobs)
    if given.execution == "serial" and given.n_jobs is not None:
        raise RequestError("execution.n_jobs: execution=serial is one process; add execution=processes")
    return DiscoverRequest(
        machine=given.machine, machine_options=options, data=given.data, stated=stated, pages=given.pages,
        across=given.across.removeprefix("[").removesuffix("]"), folder=Path(given.results).expanduser() / given.study,
        workers=1 if given.execution == "serial" else (os.cpu_count() or 1) if n_jobs == -1 else n_jobs,
        command=shlex.join(["bench", "discover", *words]),
    )  # fmt: skip


@final
@dataclass(frozen=True)
class DesignRequest(_OfMachine):
    """A question about data or a plan before anything is fitted.

    Effects are of `size` sigma; `further` is the number of readings to propose that split `rivals` (or the first class
    of names that look alike).
    """

    data: str
    plan: str
    plan_options: Mapping[str, Any]
    stated: Mapping[str, Any]
    size: float
    rivals: tuple[str, ...]
    further: int


def read_design(words: Sequence[str]) -> DesignRequest:
    """Return the question that `words` ask. Raises `RequestError` or `ValueError`."""
    given = read(DesignWords, "design", words)
    stated, options = _of_the_machine(given)
    if bool(given.data) == bool(given.plan):
        raise RequestError("one of data=FILE and plan=NAME is needed")
    plan = description_of(given.machine).plan
    rivals = tuple(part.strip() for part in given.rivals.split(",") if part.strip())
    if len(rivals) == 1:
        raise RequestError(f"rivals={rivals[0]}: two or more names are needed, with a comma between them")
    return DesignRequest(
        machine=given.machine, machine_options=options, data=given.data, plan=given.plan,
        plan_options=_read(given.plan_options, declared_options(plan) if plan else {}), stated=stated, size=given.size,
        rivals=rivals, further=given.further,
    )  # fmt: skip


def _of_the_machine(given: DiscoverWords | DesignWords) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what is stated of the data, and the machine's options. Raises `ValueError` for what the machine lacks."""
    machine = given.machine
    known = {one.key: one for each in descriptions().values() for one in each.stated}
    for key in given.stated:
        if key not in known:
            choices = [*keys_of(type(given)), *([one.key for one in description_of(machine).stated] or known)]
            is_option = machine in machines.names() and key in machines.options(machine)
            way_out = f"machine.{key}= is its option" if is_option else suggest(key, [*choices, "machine.OPTION"])
            raise RequestError(f"unknown argument {key!r}; {way_out}")
    if not machine:
        raise RequestError(f"machine= is missing: a machine; {suggest('', machines.names())}")
    options = _read(given.options, machines.options(machine))
    machines.check(machine, options)
    stated: dict[str, Any] = {key: read_word(text) for key, text in (given.of_data | given.stated).items()}
    stated |= {key: pairs_of(key, text) for key in ("columns", "units") if (text := getattr(given, key))}
    read_here = {one.key: one for one in description_of(machine).stated} or known  # one that declares none may read any
    for key, value in stated.items():
        if key in known and key not in read_here:
            is_option = machine in machines.names() and key in machines.options(machine)
            way_out = f"machine.{key}= is its option" if is_option else suggest(key, read_here)
            raise RequestError(f"{key}= is nothing that {machine} reads; {way_out}")
        rule, example = (read_here[key].rule, read_here[key].example) if key in read_here else ("", "")
        if rule == "positive" and not coerce(key, value, float) > 0:
            raise RequestError(f"{key}={value}: a number above 0 is needed")
        if rule == "list" and isinstance(value, str):
            raise RequestError(f"{key}={value}: a number for each joint is needed, such as {example}")
        if rule == "names" and not isinstance(value, dict):
            raise RequestError(f"{key}={value}: a JSON object is needed, such as {example}")
    return stated, options


def _read(typed: Mapping[str, str], declared: Mapping[str, Option]) -> dict[str, Any]:
    """Return the values of options, each read as it is annotated."""
    return {key: read_word(text, declared[key].annotation if key in declared else Any) for key, text in typed.items()}
