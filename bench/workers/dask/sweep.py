"""Runs on the workers of a Dask cluster: packs go out, each run comes home as it ends, this process keeps the journal.

A pack goes to a worker by its address, two for each of its threads' worth of work, so that it is known here who was
lost with what: the scheduler never gives a pack to another worker by itself. Workers may come and go at any time. What
a run can do to its process stays in the worker's seat (`bench.workers.dask.seat`) and costs that run alone; a worker
that is lost costs the runs it was at, which go alone to another; where three are lost with a run, its row says so.
"""

from __future__ import annotations

import json
import pickle
import sys
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from secrets import token_hex
from time import monotonic
from typing import Any, final

from calibench.bench.execution.run import Run
from calibench.bench.workers.dask.cluster import Cluster, ClusterError, cluster
from calibench.bench.workers.dask.home import home_of
from calibench.bench.workers.dask.inbox import Inbox, Keeper
from calibench.bench.workers.packs import Job, Pack, Packs
from calibench.bench.workers.worker import Notice
from calibench.core.words import print_plain as print

Lost = Callable[[Job, str, str], Run]  # (job, status, why) -> the row of a run whose worker was lost too often
_LOOK = 0.5  # seconds between two looks at who is there
_TO_AGREE = 30.0  # seconds for workers that are there to compare their code with ours before others begin
_STRIKES = 3  # the site may end two workers in a row; what a run itself does is mostly a row at the second
_NOBODY = 10.0  # seconds without a worker after which that is told


def run_on_dask(
    packs: Packs, folder: Path, study: str, workers: int, address: str | None, lost: Lost
) -> Generator[Notice, None, None]:
    """Do all that is left in `packs` by `workers` processes of this machine, or by those of the scheduler at `address`.

    Rows go to a journal of the `study` in `folder`, also those of lost runs, which `lost` makes. Closing the iterator
    ends all that was started. Raises `ClusterError`: before anything runs where `distributed` is missing, no scheduler
    answers, or a worker has other versions or other code; later where the scheduler is lost.
    """
    if not len(packs):
        return
    with cluster(workers, address) as there:
        sweep = _Sweep(packs, there, Keeper(folder, study), lost)
        try:
            yield from sweep.run()
        finally:
            sweep.close()


@final
@dataclass
class _Flight:
    """A pack that is with a worker, and what of it has not come home."""

    pack: Pack
    worker: str
    future: Any
    rest: deque[Job]
    begun: bool = False
    missed: float | None = None  # since when its worker is not seen


@final
@dataclass
class _There:
    """A worker: how many packs it takes at once, and whether it has our code. The first flight asks it."""

    threads: int
    agreed: bool = False
    flights: set[int] = field(default_factory=set)


@final
class _Sweep:
    """Packs in the air, and the workers that have them."""

    def __init__(self, packs: Packs, there: Cluster, keeper: Keeper, lost: Lost) -> None:
        self._packs, self._cluster, self._keeper, self._lost = packs, there, keeper, lost
        self._name = f"calibench-{token_hex(8)}"
        self._workers: dict[str, _There] = {}
        self._flights: dict[int, _Flight] = {}
        self._strikes: Counter[str] = Counter()  # how often a run was in flight where something was lost
        self._count = 0
        self._since = self._seen = monotonic()  # when the sweep began, and a worker was last seen
        self._looked = float("-inf")
        self._begun = False
        self._inbox = Inbox(there, self._name)
        self._home = pickle.dumps(home_of(job.spec for job in packs.jobs()))

    def run(self) -> Iterator[Notice]:
        """Yield a notice of each run as it is kept."""
        self._check_versions()
        while len(self._packs) or any(flight.pack.jobs for flight in self._flights.values()):
            if monotonic() - self._looked > _LOOK:
                yield from self._look()
            self._give()
            message = self._inbox.get(_LOOK)
            if message is not None:
                yield from self._hear(message)

    def close(self) -> None:
        """Call back what is still out, and let the workers end what they started for us."""
        client = self._cluster.client
        with suppress(Exception):
            client.cancel([flight.future for flight in self._flights.values()], force=True)
        self._inbox.close()
        if not self._cluster.is_local and client.status == "running":
            from calibench.bench.workers.dask.task import close_seats

            with suppress(Exception):
                client.run(close_seats, self._name, on_error="ignore")
        self._keeper.close()

    def _check_versions(self) -> None:
        """Refuse a worker with another calibench, or none: asked by what every Python has."""
        with suppress(OSError, TimeoutError):
            told = self._cluster.client.run(version, "calibench", on_error="return")
            here = _version()
            for worker, found in told.items():
                there = "" if isinstance(found, BaseException) else str(found)
                if there != here:
                    raise self._refusal(worker, f"it has calibench {there or '(none)'}, here it is {here or '(none)'}")

    def _refusal(self, worker: str, why: str) -> ClusterError:
        return ClusterError(f"{self._cluster.name}: the worker {worker} cannot do these runs: {why}; install the same")

    def _look(self) -> Iterator[Notice]:
        """See who has come and gone, and what has become of the packs."""
        present = self._cluster.workers()
        self._looked = now = monotonic()
        for worker in set(self._workers) - set(present):
            del self._workers[worker]
        for worker in set(present) - set(self._workers):
            self._workers[worker] = _There(present[worker])
            self._fly(worker, Pack(()))
        self._packs.shared_by(sum(there.threads for there in self._workers.values()))
        if present:
            self._seen = now
        elif now - self._seen > _NOBODY and not self._cluster.is_local:
            print(f"bench: {self._cluster.name}: has no worker; waiting for one", file=sys.stderr)
            self._seen = float("inf")
        for number, flight in list(self._flights.items()):
            why = self._trouble(number, flight)
            if not why:
                flight.missed = None
            elif flight.missed is None:
                flight.missed = now  # what it told last may still be on its way
            elif now - flight.missed > _LOOK and self._inbox.is_empty:
                yield from self._end(number, ("failed", why))

    def _trouble(self, number: int, flight: _Flight) -> str:
        """Return why a pack will not come home, "" where it may; raise what no other worker will do better."""
        there = self._workers.get(flight.worker)
        if there is None or number not in there.flights:
            return f"the Dask worker {flight.worker} was lost"
        status = flight.future.status
        if status == "error":
            error = flight.future.exception()
            if type(error).__name__ == "KilledWorker":
                return f"the Dask worker {flight.worker} was lost"
            raise self._refusal(flight.worker, f"{type(error).__name__}: {' '.join(str(error).split())[:300]}")
        if status in ("cancelled", "lost"):
            raise self._cluster.lost(OSError("it has forgotten our runs"))
        return f"the Dask worker {flight.worker} gave it up" if status == "finished" else ""

    def _give(self) -> None:
        """Give packs to the workers that have the least, once those that were there at first have agreed."""
        agreed = [there for there in self._workers.values() if there.agreed]
        if not self._begun and (len(agreed) == len(self._workers) or monotonic() - self._since > _TO_AGREE):
            self._begun = bool(agreed)
        while self._begun:
            room = {w: t for w, t in self._workers.items() if t.agreed and len(t.flights) <= t.threads}
            pack = self._packs.take() if room else None
            if pack is None:
                return
            self._fly(min(room, key=lambda worker: len(room[worker].flights) / room[worker].threads), pack)

    def _fly(self, worker: str, pack: Pack) -> None:
        """Send a pack to a worker."""
        from calibench.bench.workers.dask.task import do_flight

        number = self._count = self._count + 1
        future = self._cluster.client.submit(
            do_flight, self._name, number, self._home, pickle.dumps(pack), key=f"{self._name}-{number}", pure=False,
            workers=[worker], allow_other_workers=False, retries=0,
        )  # fmt: skip
        self._flights[number] = _Flight(pack, worker, future, deque(pack.jobs))
        self._workers[worker].flights.add(number)

    def _hear(self, message: Mapping[str, Any]) -> Iterator[Notice]:
        """Keep the runs that a worker tells of, and note where a pack has ended."""
        number = message["flight"]
        flight = self._flights.get(number)
        if flight is None:
            return
        if message["refused"]:
            raise self._refusal(flight.worker, message["refused"])
        flight.begun = flight.begun or message["begun"]
        place = message["first"]
        for words in message["told"]:
            if words[:1] == b"P":
                self._keeper.note(json.loads(words[1:]))
                continue
            if place == len(flight.pack.jobs) - len(flight.rest):  # else the pack is done again, by whomever
                run, seconds = pickle.loads(words[1:])
                job = flight.rest.popleft()
                if run.run_id != job.run_id:
                    why = f"its id was {run.run_id} on the Dask worker {flight.worker}: it is another run there"
                    run = self._lost(job, "failed", why)
                self._packs.finished(job, seconds)
                self._keeper.keep(run)
                yield Notice(job.run_id, run.status, seconds)
            place += 1
        if message["ended"] is not None:
            yield from self._end(number, json.loads(message["ended"] or "null"))

    def _end(self, number: int, why: Sequence[str] | None) -> Iterator[Notice]:
        """Take back what a pack that has ended leaves; `why` is the status and reason where something was lost."""
        flight = self._flights.pop(number)
        there = self._workers.get(flight.worker)
        if there is not None:
            there.flights.discard(number)
            there.agreed = there.agreed or why is None
        rest = tuple(flight.rest)
        if why is None or not rest:
            return
        if not flight.begun:
            self._packs.back(Pack(rest, flight.pack.alone))
            return
        first = rest[0].run_id
        hung = self._keeper.was_silent(first)  # somebody has ended it for that
        self._strikes[first] += 1
        if flight.pack.alone and not hung and self._strikes[first] < _STRIKES:
            self._packs.back(Pack(rest, alone=True))
            return
        at_fault = self._packs.lost(rest, flight.pack.alone or hung)
        if at_fault is not None:
            run = self._lost(at_fault, why[0], why[1])
            self._keeper.keep(run)
            yield Notice(at_fault.run_id, run.status, 0.0)


def _version() -> str:
    with suppress(PackageNotFoundError):
        return version("calibench")
    return ""
