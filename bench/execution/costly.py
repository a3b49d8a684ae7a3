"""The surroundings of a run with a costly objective: processes for its batches, and the file of its values.

A problem with a `batch` of its own is given slices of the points, if it says ``splits_batches = True``: the value of a
point has the same bits whatever points stand beside it. Of any other problem each point is one call in some process;
the gate still asks for one value after another, and counts, traces and stops as if it had waited for each.
"""

import os
from collections.abc import Container, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench import optimizers
from calibench.bench.execution.in_progress import looked_at
from calibench.bench.execution.request import is_stochastic
from calibench.bench.gate.calls import Calls, calls_of, raise_again
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.processes import CAN_FORK, WorkerPool
from calibench.bench.gate.replay import Replayed, ReplayFile
from calibench.bench.provenance.run_id import name_of

_SLOWLY = 1.0  # seconds between two looks at what evaluations take


@final
@dataclass(frozen=True)
class ReplayFolder:
    """Where runs write their values, to go on from after a kill: ``FOLDER/replay/<run_id>.journal``.

    Those runs whose evaluations take 20 ms or more; with `always` all of them.
    """

    folder: Path | str
    always: bool = False


def forget_replay(folder: Path | str, run_id: str) -> None:
    """Delete the values of a run whose row is on the disk; where there are none, do nothing."""
    with suppress(FileNotFoundError):
        os.unlink(os.path.join(folder, "replay", f"{run_id}.journal"))  # a tenth of the time that Path takes


def forget_finished(folder: Path | str, finished: Container[str]) -> None:
    """Delete the values of all runs whose ids are `finished`: a kill may have come between a row and its forgetting."""
    for path in (Path(folder) / "replay").glob("*.journal"):
        if path.stem in finished:
            path.unlink(missing_ok=True)
    with suppress(OSError):  # values of others are there, or none ever were
        (Path(folder) / "replay").rmdir()


def check_costly(problem: Any, optimizer: Any, inner: Any, replay: ReplayFolder | None) -> None:
    """Raise `ValueError`, one line, where `inner` processes cannot evaluate the batches of this run, or where `replay`
    always is asked for and cannot be."""
    if isinstance(inner, bool) or not isinstance(inner, int) or inner < 1:
        raise ValueError(f"inner={inner}: a number of processes, 1 or more, is needed")
    who, noisy = name_of(problem), is_stochastic(problem)
    if replay is not None and replay.always and noisy and getattr(problem, "seeded", None) is not None:
        raise ValueError(
            f"replay=true: problem {who} is stochastic and keeps its generator itself (seeded), which cannot be put to "
            "where it was; draw from self.rng instead"
        )
    if inner == 1:
        return
    traits = getattr(optimizer, "traits", None)
    if not getattr(traits, "batches", False):
        raise ValueError(
            f"inner={inner}: {name_of(optimizer)} asks for one point at a time; methods with batches: "
            f"{', '.join(with_batches())}"
        )
    if noisy:
        raise ValueError(f"inner={inner}: problem {who} is stochastic and draws its noise in the order of its calls")
    if getattr(problem, "batch", None) is not None and getattr(problem, "splits_batches", False) is not True:
        raise ValueError(
            f"inner={inner}: problem {who} has a batch of its own; say splits_batches = True if the value of a point "
            "has the same bits whatever points stand beside it, or leave the batch out"
        )
    if not CAN_FORK:
        raise ValueError(f"inner={inner}: this system cannot fork processes")


def with_batches() -> list[str]:
    """Return the names of the optimisers that have batches with their default options."""
    found = []
    for name in optimizers.names():
        try:
            traits = optimizers.make(name).traits
        except (ValueError, TypeError, AttributeError):  # it has an option without a default, or no traits
            continue
        found += [name] if traits.batches else []
    return found


@contextmanager
def around(
    gate: Evaluator, problem: Any, run_id: str, code: str, *, inner: int = 1, replay: ReplayFolder | None = None,
    time_limit: float | None = None,
) -> Iterator[None]:  # fmt: skip
    """Make the search with `gate` on `problem` in this context; `code` is the digest of their code."""
    if replay is not None and is_stochastic(problem) and getattr(problem, "seeded", None) is not None:
        replay = None
    if inner == 1 and replay is None:
        yield
        return
    calls = calls_of(problem)
    with in_parallel(calls, inner) if inner > 1 else nullcontext(calls) as calls:
        gate.ask(calls)
        if replay is None:
            yield
            return
        home = os.path.abspath(replay.folder)  # the objective may go elsewhere
        file = ReplayFile(os.path.join(home, "replay", f"{run_id}.journal"), run_id, code)
        if not file.usable:  # another process makes this run too, and has it
            yield
            return
        noise = problem.rng if is_stochastic(problem) else None
        replayed = Replayed(gate, calls, file, always=replay.always, processes=inner, limit=time_limit, noise=noise)
        try:
            with nullcontext() if replay.always else looked_at(replayed.look, _SLOWLY):
                yield
        finally:
            file.close()
        if replayed.differs is not None:  # and the optimiser did not let it pass
            raise replayed.differs


Array = NDArray[np.float64]
_SLICES = 4  # for each process, so that one slow slice does not keep the others waiting for long


@contextmanager
def in_parallel(calls: Calls, processes: int) -> Iterator[Calls]:
    """Yield `calls` whose batches are evaluated by that many processes, which end with the block."""
    lock = Lock()  # a method may ask from several threads

    def in_slices(what: str, points: Array, *limits: Array) -> Array:
        if not len(points):
            return np.empty(0)
        size = max(1, -(-len(points) // (_SLICES * processes)))
        slices = [slice(i, i + size) for i in range(0, len(points), size)]
        with lock:
            pool.begin([(what, points[s], *(limit[s] for limit in limits)) for s in slices])
            return np.concatenate([pool.take() for _ in slices])

    # without a `batch`: `ahead` begins the values of one; each is then waited for when it is asked for
    awaited: list[Array] = []  # the last one is the next; the processes begin when that is asked for
    begun = False

    def ahead(points: Array) -> None:
        nonlocal begun
        with lock:
            awaited[:] = list(np.array(points, dtype=np.float64))[::-1]
            begun = False

    def value(x: Array, fixed: Any) -> float:
        nonlocal begun
        with lock:
            if awaited and np.array_equal(awaited[-1], x):
                if not begun:
                    pool.begin([("one", point) for point in reversed(awaited)])
                    begun = True
                awaited.pop()
                known: float = pool.take()
                return known
            awaited.clear()
        return calls.one(x)

    with WorkerPool(lambda job: getattr(calls, job[0])(*job[1:]), processes) as pool:
        if calls.batch is None:
            yield replace(calls, value=value, again=raise_again, ahead=ahead)
        else:
            below = calls.below and partial(in_slices, "below")
            yield replace(calls, batch=partial(in_slices, "batch"), below=below)
