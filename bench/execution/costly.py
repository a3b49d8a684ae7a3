"""The environment of a run with a costly objective: processes for its batches, and the file of its values.

`costly` is entered in the process that makes the run: this one, or the child of a run with a time limit.
"""

from __future__ import annotations

import os
from collections.abc import Container, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from calibench import optimizers
from calibench.bench.execution.in_progress.pulse import looked_at
from calibench.bench.execution.stochastic import is_stochastic
from calibench.bench.gate.calls import Calls, calls_of
from calibench.bench.gate.costly.in_parallel import in_parallel
from calibench.bench.gate.costly.replay_file import ReplayFile
from calibench.bench.gate.costly.replayed import Replayed
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.processes.forked_worker import CAN_FORK
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
        os.unlink(_file_of(folder, run_id))


def values_of(folder: Path | str) -> list[str]:
    """Return the ids of the runs that have values to go on from."""
    return sorted(path.stem for path in (Path(folder) / "replay").glob("*.journal"))


def forget_finished(folder: Path | str, finished: Container[str]) -> None:
    """Delete the values of all runs whose ids are `finished`: a kill may have come between a row and its forgetting."""
    for path in (Path(folder) / "replay").glob("*.journal"):
        if path.stem in finished:
            path.unlink(missing_ok=True)
    with suppress(OSError):  # values of others are there, or none ever were
        (Path(folder) / "replay").rmdir()


def check_inner(problem: Any, optimizer: Any, inner: Any) -> None:
    """Raise `ValueError`, one line, where the batches of this run cannot be evaluated by `inner` processes."""
    if isinstance(inner, bool) or not isinstance(inner, int) or inner < 1:
        raise ValueError(f"inner={inner}: a number of processes, 1 or more, is needed")
    if inner == 1:
        return
    traits, who = getattr(optimizer, "traits", None), name_of(problem)
    if not getattr(traits, "batches", False):
        raise ValueError(
            f"inner={inner}: {name_of(optimizer)} asks for one point at a time; methods with batches: "
            f"{', '.join(with_batches())}"
        )
    if is_stochastic(problem):
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


def check_replay(problem: Any, replay: ReplayFolder | None) -> None:
    """Raise `ValueError`, one line, where `replay` always is asked for and cannot be."""
    if replay is not None and replay.always and _keeps_its_noise(problem):
        raise ValueError(
            f"replay=true: problem {name_of(problem)} is stochastic and keeps its generator itself (seeded), which "
            "cannot be put to where it was; draw from self.rng instead"
        )


def around(
    gate: Evaluator,
    problem: Any,
    run_id: str,
    code: str,
    *,
    inner: int = 1,
    replay: ReplayFolder | None = None,
    time_limit: float | None = None,
) -> AbstractContextManager[Any]:
    """Return the context for the search with `gate` on `problem`; `code` is the digest of their code."""
    if replay is not None and _keeps_its_noise(problem):
        replay = None
    if inner == 1 and replay is None:
        return nullcontext()
    if replay is not None:
        replay = ReplayFolder(os.path.abspath(replay.folder), replay.always)  # the objective may go elsewhere
    return _costly(gate, problem, run_id, code, inner, replay, time_limit)


@contextmanager
def _costly(
    gate: Evaluator,
    problem: Any,
    run_id: str,
    code: str,
    inner: int,
    replay: ReplayFolder | None,
    time_limit: float | None,
) -> Iterator[None]:
    calls = calls_of(problem)
    with in_parallel(calls, inner) if inner > 1 else nullcontext(calls) as calls:
        gate.ask(calls)
        if replay is None:
            yield
        else:
            with _replayed(gate, calls, problem, run_id, code, inner, replay, time_limit):
                yield


@contextmanager
def _replayed(
    gate: Evaluator,
    calls: Calls,
    problem: Any,
    run_id: str,
    code: str,
    inner: int,
    replay: ReplayFolder,
    time_limit: float | None,
) -> Iterator[None]:
    file = ReplayFile(_file_of(replay.folder, run_id), run_id, code)
    if not file.usable:  # another process makes this run too, and has the file
        yield
        return
    noise = problem.rng if is_stochastic(problem) else None
    replayed = Replayed(gate, calls, file, always=replay.always, processes=inner, limit=time_limit, noise=noise)
    replayed.arm()
    try:
        with nullcontext() if replay.always else looked_at(replayed.look, _SLOWLY):
            yield
    finally:
        file.close()
    if replayed.differs is not None:  # and the optimiser did not let it pass
        raise replayed.differs


def _file_of(folder: Path | str, run_id: str) -> str:
    return os.path.join(folder, "replay", f"{run_id}.journal")  # a tenth of the time that Path takes


def _keeps_its_noise(problem: Any) -> bool:
    return is_stochastic(problem) and getattr(problem, "seeded", None) is not None
