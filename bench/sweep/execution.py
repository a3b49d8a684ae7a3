"""How the runs of a sweep are carried out, and by how many workers: reads ``execution=NAME`` with its options."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, final

from calibench.bench.sweep.words import RequestError, read_inner, read_workers
from calibench.core.options import suggest

_OPTIONS = {
    "serial": ("inner",), "processes": ("n_jobs", "inner"), "dask": ("n_jobs", "address", "inner"),
}  # fmt: skip
_BY_SHARDS = ("slurm", "ray", "kubernetes", "submitit", "pbs", "sge", "lsf", "htcondor")


@final
@dataclass(frozen=True)
class Execution:
    """The back end (serial, processes or dask), how many workers, and how many evaluate the batches of one run.

    `address` names a Dask scheduler that stands already; `workers` are then those that it has.
    """

    name: str
    workers: int
    inner: int = 1
    address: str | None = None


def check_name(name: str) -> str:
    """Return the name of a back end. Raises `RequestError` for another."""
    if name in _BY_SHARDS:
        raise RequestError(
            f"execution={name}: a cluster is used in two ways: shard=I/N, a part of the runs in each job of an array, "
            "then `bench merge`; or execution=dask execution.address=tcp://HOST:PORT, workers that the site starts "
            "(docs/clusters.md)"
        )
    if name not in _OPTIONS:
        raise RequestError(f"execution={name}: {suggest(name, _OPTIONS)}")
    return name


def check_option(name: str, option: str) -> None:
    """Raise `RequestError` for an option that the back end `name` has not."""
    if option not in _OPTIONS[name]:
        every = {each: None for options in _OPTIONS.values() for each in options}
        meant = next(iter(get_close_matches(option, every, n=1)), option)
        who = [other for other, options in _OPTIONS.items() if meant in options]
        near = f"; did you mean execution.{meant}?" if meant != option else ""
        has = (
            f"{near or ';'} add execution={' or execution='.join(who)}, which has it"
            if name not in who and who
            else near
        )
        raise RequestError(
            f"execution.{option}: execution={name} has no such option{has}; choices: {', '.join(_OPTIONS[name])}"
        )


def read_execution(given: Mapping[str, Any]) -> Execution:
    """Return the settings. Raises `RequestError` for an option that is none, or a value that makes no sense."""
    name = check_name(str(given["name"]))
    for key in given.keys() - {"name"}:
        check_option(name, key)
    n_jobs, address = given.get("n_jobs", 1), given.get("address")
    n_jobs, inner = read_workers(n_jobs), read_inner(given.get("inner", 1))
    if address is not None and (not isinstance(address, str) or "://" not in address):
        raise RequestError(f"execution.address={address}: where the scheduler is, such as tcp://HOST:8786, is needed")
    workers = 1 if name == "serial" else (os.cpu_count() or 1) if n_jobs == -1 else n_jobs
    return Execution(name, workers, inner, address)
