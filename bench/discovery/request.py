"""The requests of `bench discover` and `bench design`: a machine, data, statements on them, and the result folder."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, final

from calibench.bench.measured.files import pairs_of
from calibench.bench.provenance.run_id import canonical
from calibench.bench.sweep.words import RequestError, check_study, read_workers
from calibench.core.options import Option, coerce, declared_options, read_option, read_word, suggest
from calibench.discrepancy.checks.validate import refuse_no_machine
from calibench.discrepancy.model.machine import Machine, Stated
from calibench.discrepancy.registries import description_of, descriptions, machines

_PLAIN = ("machine", "data", "study", "results", "pages", "execution", "execution.n_jobs")
_DESIGN = ("machine", "data", "plan", "size", "rivals", "next")
_OF_COLUMNS = ("columns", "units")  # what the owner of a file says of its columns
_LARGEST_SIZE = 1e6  # sigma: beyond it, and below its inverse, squares lose their digits
Pages = Literal["auto", "all", "none"]


@final
@dataclass(frozen=True)
class DiscoverRequest:
    """A search in one or more sets of data; `stated` overrides the files' own metadata."""

    machine: str
    machine_options: Mapping[str, Any]
    data: str
    stated: Mapping[str, Any]
    folder: Path = field(default=Path("results/discover"))
    pages: Pages = "auto"
    workers: int = 1

    @property
    def options(self) -> str:
        """Return all that decides the verdict besides the data, as canonical JSON."""
        return canonical({"machine": {"name": self.machine, **self.machine_options}, "stated": dict(self.stated)})

    def build_machine(self) -> Machine:
        """Return the machine with its options."""
        return _made(self.machine, self.machine_options)


def read_discover(words: Sequence[str]) -> DiscoverRequest:
    """Return the search that `words` ask for. Raises `RequestError` or `ValueError`."""
    given, stated, options = _parted(words, _PLAIN)
    study, pages = given.get("study", "discover"), given.get("pages", "auto")
    check_study(study)
    execution = given.get("execution", "serial")
    choices = ("serial", "processes", "joblib")
    if execution not in choices:
        raise RequestError(f"execution={execution}: {suggest(execution, choices)}")
    n_jobs = read_workers(read_word(given.get("execution.n_jobs", "-1"), int))
    if execution == "serial" and "execution.n_jobs" in given:
        raise RequestError("execution.n_jobs: execution=serial is one process; add execution=processes")
    return DiscoverRequest(
        machine=given["machine"],
        machine_options=options,
        data=_needed(given, "data", "a file, a glob, a folder or a name, such as data=run7.parquet"),
        stated=stated,
        folder=Path(given.get("results", "results")).expanduser() / study,
        pages=coerce("pages", pages, Pages),
        workers=1 if execution == "serial" else (os.cpu_count() or 1) if n_jobs == -1 else n_jobs,
    )


@final
@dataclass(frozen=True)
class DesignRequest:
    """A question about data or a plan before anything is fitted.

    Effects are of `size` sigma; `further` is the number of readings to propose that split `rivals` (or the first class
    of names that look alike).
    """

    machine: str
    machine_options: Mapping[str, Any]
    data: str
    plan: str
    plan_options: Mapping[str, Any]
    stated: Mapping[str, Any]
    size: float
    rivals: tuple[str, ...]
    further: int

    def build_machine(self) -> Machine:
        """Return the machine with its options."""
        return _made(self.machine, self.machine_options)


def read_design(words: Sequence[str]) -> DesignRequest:
    """Return the question that `words` ask. Raises `RequestError` or `ValueError`."""
    plan_words = [word.removeprefix("plan.") for word in words if word.startswith("plan.")]
    others = [word for word in words if not word.startswith("plan.")]
    given, stated, options = _parted(others, _DESIGN)
    if ("data" in given) == ("plan" in given):
        raise RequestError("one of data=FILE and plan=NAME is needed")
    plan = description_of(given["machine"]).plan
    declared = declared_options(plan) if plan else {}
    of_plan = _read({key: text for key, _, text in (word.partition("=") for word in plan_words)}, declared)
    further = read_option("next", given.get("next", "4"), int)
    size = read_option("size", given.get("size", "1"), float)
    if not 0 <= further <= 50:
        raise RequestError(f"next={further}: a number of readings from 0 to 50 is needed")
    if not 1 / _LARGEST_SIZE <= size <= _LARGEST_SIZE:
        raise RequestError(f"size={size:g}: a visible size above 0 sigma, at most {_LARGEST_SIZE:g}, is needed")
    rivals = tuple(part.strip() for part in given.get("rivals", "").split(",") if part.strip())
    if len(rivals) == 1:
        raise RequestError(f"rivals={rivals[0]}: two or more names are needed, with a comma between them")
    return DesignRequest(
        machine=given["machine"], machine_options=options, data=given.get("data", ""), plan=given.get("plan", ""),
        plan_options=of_plan, stated=stated, size=size,
        rivals=rivals, further=further,
    )  # fmt: skip


def _made(name: str, options: Mapping[str, Any]) -> Machine:
    """Return a machine; raise `DataError` for a class that is none."""
    machine = machines.make(name, **options)
    refuse_no_machine(machine, f"machine={name}")
    return machine


def _parted(words: Sequence[str], plain: tuple[str, ...]) -> tuple[dict[str, str], dict[str, Any], dict[str, Any]]:
    """Return plain arguments, what is stated of the data, and the machine's options."""
    given: dict[str, str] = {}
    stated: dict[str, Any] = {}
    typed: dict[str, str] = {}
    known, seen = {one.key: one for machine in descriptions().values() for one in machine.stated}, set()
    for word in words:
        key, equals, value = word.partition("=")
        if not equals:
            raise RequestError(
                f"{word!r} is no argument; write KEY=VALUE, such as machine={machines.names()[0]} data=run7.parquet"
            )
        if not value:
            raise RequestError(f"{key}= has no value")
        if key in seen:
            raise RequestError(f"{key}= is given twice")
        seen.add(key)
        if key in plain:
            given[key] = value
        elif key in known:
            stated[key] = read_word(value)
        elif key in _OF_COLUMNS:
            stated[key] = pairs_of(key, value)
        elif key.startswith("data.") and key != "data.":
            stated[key.removeprefix("data.")] = read_word(value)
        elif key.startswith("machine."):
            typed[key.removeprefix("machine.")] = value
        else:
            machine = next((other.removeprefix("machine=") for other in words if other.startswith("machine=")), "")
            own = [one.key for one in description_of(machine).stated] or known
            choices = [*plain, *own, *_OF_COLUMNS, "machine.OPTION"]
            raise RequestError(f"unknown argument {key!r}; {_of_the_machine(key, machine) or suggest(key, choices)}")
    machine = _needed(given, "machine", f"a machine; {suggest('', machines.names())}")
    options = _read(typed, machines.options(machine))
    machines.check(machine, options)
    read = {one.key: one for one in description_of(machine).stated} or known  # one that declares none may read any
    for key, value in stated.items():
        if key in known and key not in read:
            way_out = _of_the_machine(key, machine) or suggest(key, read)
            raise RequestError(f"{key}= is nothing that {machine} reads; {way_out}")
        if key in read:
            _check_stated(read[key], value)
    return given, stated, options


def _read(typed: Mapping[str, str], declared: Mapping[str, Option]) -> dict[str, Any]:
    """Return the values of options, each read as it is annotated."""
    return {key: read_word(text, declared[key].annotation if key in declared else Any) for key, text in typed.items()}


def _of_the_machine(key: str, machine: str) -> str:
    """Return how to write an option of the machine, where `key` is one; "" for any other."""
    return f"machine.{key}= is its option" if machine in machines.names() and key in machines.options(machine) else ""


def _check_stated(one: Stated, value: Any) -> None:
    if one.rule == "positive" and not coerce(one.key, value, float) > 0:
        raise RequestError(f"{one.key}={value}: a number above 0 is needed")
    if one.rule == "list" and isinstance(value, str):
        raise RequestError(f"{one.key}={value}: a number for each joint is needed, such as {one.example}")
    if one.rule == "names" and not isinstance(value, dict):
        raise RequestError(f"{one.key}={value}: a JSON object is needed, such as {one.example}")


def _needed(given: Mapping[str, str], key: str, what: str) -> str:
    if key not in given:
        raise RequestError(f"{key}= is missing: {what}")
    return given[key]
