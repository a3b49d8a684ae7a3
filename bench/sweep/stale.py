"""Finished runs that another version of the code made: a resume finds and counts them before anything runs.

Rows without a ``code_digest``, as of a run whose code could not be read, cannot be judged: they are kept and named.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, final

from calibench.bench.provenance.code_digest import changed_parts
from calibench.bench.store.runs import ResultStore
from calibench.bench.sweep.request import Request
from calibench.bench.sweep.words import RequestError
from calibench.core.words import counted

Way = Literal["ask", "rerun", "keep"]  # what to do with rows of other code: stop and say so, replace, or leave


@final
@dataclass(frozen=True)
class Stale:
    """The finished runs of a request that other code made, those nobody can tell of, and what differs, in words."""

    other: frozenset[str]
    unknown: frozenset[str]
    finished: int
    what: tuple[str, ...]

    def told(self) -> str:
        """Return in one line how many rows, and of what; '' where all are of this code."""
        if not self.other:
            return ""
        those = f"{len(self.other)} of {counted(self.finished, 'finished run')}"
        return f"{those} {'is' if len(self.other) == 1 else 'are'} of other code: {'; '.join(self.what)}"

    def told_unknown(self) -> str:
        """Return a line on the rows without a digest; '' where there are none."""
        if not self.unknown:
            return ""
        those = f"{len(self.unknown)} of {counted(self.finished, 'finished run')}"
        return f"{those} {'has' if len(self.unknown) == 1 else 'have'} no code_digest: what made them is not known"


def find_stale(request: Request, store: ResultStore, but: Collection[str] = ()) -> Stale:
    """Return which finished runs of `request`, `but` those that are done again anyway, other code has made."""
    columns = ["run_id", "problem", "optimizer", "library", "library_version", "code_digest"]
    mine = [row for row in store.rows(columns).to_pylist() if row["run_id"] in request.specs]
    mine = [row for row in mine if row["run_id"] not in but]
    moved = _moved(request, store)
    other, unknown, counts = set(), set(), Counter[tuple[str, ...]]()
    for row in mine:
        run_id, before = str(row["run_id"]), row["code_digest"]
        known = isinstance(before, str) and before != ""
        parts = changed_parts(str(before), request.codes[run_id]) if known else []
        problem, optimizer = str(row["problem"]), str(row["optimizer"])
        library = f"{row['library']} {row['library_version']}" if row["library_version"] else ""
        words = {
            "problem": f"problem {problem}",
            "optimizer": f"optimizer {optimizer}" + (f" (the runs were made with {library})" if library else ""),
            "gate": "calibench's evaluator",
            "files": f"problem {problem}, whose file of data was another (where it writes it: a str)",
        }
        named = [words[part] for part in parts]
        what = tuple(dict.fromkeys([*named, *(moved[name] for name in (problem, optimizer) if name in moved)]))
        if what:
            other.add(run_id)
            counts.update([what])
        elif not known:
            unknown.add(run_id)
    what = tuple(f"{n} of {' and of '.join(what)}" for what, n in counts.items())
    return Stale(frozenset(other), frozenset(unknown), len(mine), what)


def settle(stale: Stale, way: Way) -> set[str]:
    """Return the runs to do again. Raises `RequestError` where the user did not decide about rows of other code."""
    if way == "ask" and stale.other:
        raise RequestError(f"{stale.told()}; --rerun does them again, --keep goes on with them; nothing was run")
    return {*stale.other, *stale.unknown} if way == "rerun" else set()


def _moved(request: Request, store: ResultStore) -> dict[str, str]:
    """Return the classes whose file was another in this study, and still is: two files may bear one name."""
    before = store.manifest().get("files", {})
    return {
        name: f"{name}, whose file was {before[name]}"
        for name, file in request.files.items()
        if name in before and before[name] != file and Path(before[name]).is_file()
    }
