"""The carrier of a Dask cluster: packs go out, each run comes home as it ends, this process keeps the journals.

A pack goes to a worker by its address, so that it is known here who was lost with what; workers may come and go. What a
run can do to its process stays in the worker's seat (`bench.workers.dask_seat`); a worker that is lost costs the runs
it was at, which go alone to another; where three are lost with a run, its row says so. Runs come home over a queue of
the scheduler, which holds few messages. Whatever goes wrong with the scheduler is one line, a `ClusterError`.
"""

from __future__ import annotations

import asyncio
import json
import logging
import pickle
import sys
import tempfile
import warnings
from collections import Counter, deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future, wait
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from secrets import token_hex
from time import monotonic
from typing import Any, final

from calibench.bench.execution.in_progress import Progress, to_files, was_silent
from calibench.bench.execution.standing import lost_run
from calibench.bench.gate.processes import Child
from calibench.bench.provenance.environment import Provenance
from calibench.bench.store.journal import Journal
from calibench.bench.workers.carrier import Job, Notice, Pack, Packs
from calibench.bench.workers.dask_seat import WENT_ON, Made, home_of, made
from calibench.core.words import print_plain as print

_LOOK = 0.5  # seconds between two looks at who is there, and at whether we are closed
_TO_AGREE = 30.0  # seconds for workers that are there to compare their code with ours before others begin
_STRIKES = 3  # the site may end two workers in a row; what a run itself does is mostly a row at the second
_NOBODY = 10.0  # seconds without a worker after which that is told
_MESSAGES = 64  # on their way, after which workers wait for us
_LOGGERS = ("distributed", "dask", "tornado", "asyncio")
_NOTHING = logging.Filter("no logger is called so")
_HOST = "127.0.0.1"
_EARLY = 5.0  # seconds: a worker that ends by itself sooner could not begin
_TRIES = 3
_END = 10.0  # seconds for a worker to end by itself


class ClusterError(ValueError):
    """A Dask cluster cannot be used, or not any longer."""


@final
@dataclass(frozen=True)
class Dask:
    """Carries out runs by so many workers of this machine, or by those of the scheduler at `address`."""

    folder: Path
    study: str
    workers: int
    address: str | None = None

    def carry(self, packs: Packs) -> Generator[Notice, None, None]:
        """Do all runs, each notice as its run comes home.

        Raises `ClusterError`: before anything runs where `distributed` is missing, no scheduler answers, or a worker
        has other versions or other code; later where the scheduler is lost.
        """
        if not len(packs):
            return
        with cluster(self.workers, self.address) as found:
            sweep = _Sweep(packs, found, self.folder, self.study)
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
class _Member:
    """A worker: how many packs it takes at once, and whether it has our code. The first flight asks it."""

    threads: int
    agreed: bool = False
    flights: set[int] = field(default_factory=set)


@final
class _Sweep:
    """Packs in the air, and the workers that have them."""

    def __init__(self, packs: Packs, cluster: Cluster, folder: Path, study: str) -> None:
        self._packs, self._cluster, self._folder, self._study = packs, cluster, folder, study
        self._name = f"calibench-{token_hex(8)}"
        self._workers: dict[str, _Member] = {}
        self._flights: dict[int, _Flight] = {}
        self._strikes: Counter[str] = Counter()  # how often a run was in flight where something was lost
        self._count = 0
        self._since = self._seen = monotonic()  # when the sweep began, and a worker was last seen
        self._looked = float("-inf")
        self._begun = False
        self._journals: dict[tuple[Any, ...], Journal] = {}  # rows say where they were made: one a kind of machine
        self._publish = to_files(folder)
        self._running: dict[str, Progress] = {}  # how far the long runs are
        from distributed import Queue

        make: Any = Queue  # it has no types
        self._queue = make(self._name, client=cluster.client, maxsize=_MESSAGES)
        self._arriving: Future[Mapping[str, Any]] | None = None  # the next message
        self._is_silent = True  # nothing has come of late
        self._home = pickle.dumps(home_of(job.spec for job in (*packs.alone, *packs.waiting)))

    def run(self) -> Iterator[Notice]:
        while len(self._packs) or any(flight.pack.jobs for flight in self._flights.values()):
            if monotonic() - self._looked > _LOOK:
                yield from self._look()
            # the workers that have the least get packs, once those that were there at first have agreed
            agreed = [member for member in self._workers.values() if member.agreed]
            if not self._begun and (len(agreed) == len(self._workers) or monotonic() - self._since > _TO_AGREE):
                self._begun = bool(agreed)
            while self._begun:
                room = {w: t for w, t in self._workers.items() if t.agreed and len(t.flights) <= t.threads}
                pack = self._packs.take() if room else None
                if pack is None:
                    break
                self._fly(min(room, key=lambda worker: len(room[worker].flights) / room[worker].threads), pack)
            try:
                if self._arriving is None:
                    get, loop = self._queue.get(asynchronous=True), self._cluster.client.loop.asyncio_loop
                    self._arriving = asyncio.run_coroutine_threadsafe(get, loop)
                self._is_silent = not wait([self._arriving], _LOOK).done
                message = None if self._is_silent else self._arriving.result()
            except (Exception, CancelledError) as error:
                raise self._cluster.lost(error) from None
            if message is not None:
                self._arriving = None
                yield from self._hear(message)

    def close(self) -> None:
        client = self._cluster.client
        with suppress(Exception):
            client.cancel([flight.future for flight in self._flights.values()], force=True)
        with suppress(Exception):
            if self._arriving is not None:
                self._arriving.cancel()
            self._queue.close()
        if self._cluster.local is None and client.status == "running":
            from calibench.bench.workers.dask_worker import close_seats

            with suppress(Exception):
                client.run(close_seats, self._name, on_error="ignore")
        for run_id in list(self._running):  # nothing runs any more
            self._forget(run_id)

    def _refusal(self, worker: str, why: str) -> ClusterError:
        return ClusterError(f"{self._cluster.name}: the worker {worker} cannot do these runs: {why}; install the same")

    def _look(self) -> Iterator[Notice]:
        present = self._cluster.workers()
        self._looked = now = monotonic()
        for worker in set(self._workers) - set(present):
            del self._workers[worker]
        for worker in set(present) - set(self._workers):
            self._workers[worker] = _Member(present[worker])
            self._fly(worker, Pack(()))
        self._packs.workers = sum(member.threads for member in self._workers.values())
        if present:
            self._seen = now
        elif now - self._seen > _NOBODY and self._cluster.local is None:
            print(f"bench: {self._cluster.name}: has no worker; waiting for one", file=sys.stderr)
            self._seen = float("inf")
        for number, flight in list(self._flights.items()):
            # why the pack will not come home, "" where it may; raise what no other worker will do better
            member, why = self._workers.get(flight.worker), ""
            status = "" if member is None or number not in member.flights else flight.future.status
            error = flight.future.exception() if status == "error" else None
            if not status or type(error).__name__ == "KilledWorker":
                why = f"the Dask worker {flight.worker} was lost"
            elif status == "error":
                raise self._refusal(flight.worker, f"{type(error).__name__}: {' '.join(str(error).split())[:300]}")
            elif status in ("cancelled", "lost"):
                raise self._cluster.lost(OSError("it has forgotten our runs"))
            elif status == "finished":
                why = f"the Dask worker {flight.worker} gave it up"
            if not why:
                flight.missed = None
            elif flight.missed is None:
                flight.missed = now  # what it told last may still be on its way
            elif now - flight.missed > _LOOK and self._is_silent:
                yield from self._end(number, ("failed", why))

    def _fly(self, worker: str, pack: Pack) -> None:
        from calibench.bench.workers.dask_worker import do_flight

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
        place, ended = message["first"], list[Made]()
        for words in message["words"]:
            if words[:1] == WENT_ON:
                progress = json.loads(words[1:])
                if progress["ended"]:
                    self._forget(progress["run_id"])
                    continue
                self._running[progress["run_id"]] = progress
                with suppress(OSError):  # no run is lost by it
                    self._publish(progress)
                continue
            if place == len(flight.pack.jobs) - len(flight.rest):  # else the pack is done again, by whomever
                run: Made = pickle.loads(words[1:])
                job = flight.rest.popleft()
                if run.run_id != job.run_id:
                    why = f"its id was {run.run_id} on the Dask worker {flight.worker}: it is another run there"
                    run = made(lost_run(job.spec, job.run_id, "ProcessDied", why), run.seconds)
                self._packs.note_time(job, run.seconds)
                ended.append(run)
            place += 1
        yield from self._keep(ended)
        if message["ended"] is not None:
            yield from self._end(number, json.loads(message["ended"] or "null"))

    def _end(self, number: int, why: Sequence[str] | None) -> Iterator[Notice]:
        """Take back what a pack that has ended leaves; `why` is the status and reason where something was lost."""
        flight = self._flights.pop(number)
        member = self._workers.get(flight.worker)
        if member is not None:
            member.flights.discard(number)
            member.agreed = member.agreed or why is None
        rest = tuple(flight.rest)
        if why is None or not rest:
            return
        if not flight.begun:
            (self._packs.alone if flight.pack.alone else self._packs.waiting).extendleft(reversed(rest))
            return
        first = rest[0].run_id
        hung = was_silent(self._folder, first)  # somebody has ended it for that; from here on it does not run
        self._forget(first)
        self._strikes[first] += 1
        if flight.pack.alone and not hung and self._strikes[first] < _STRIKES:
            self._packs.alone.extendleft(reversed(rest))
            return
        at_fault = self._packs.return_lost(rest, flight.pack.alone or hung)
        if at_fault is not None:
            late = why[0] == "timeout"
            run = lost_run(at_fault.spec, at_fault.run_id, "ProcessDied", why[1], timed_out=late)
            yield from self._keep([made(run, 0.0)])

    def _keep(self, runs: Sequence[Made]) -> Iterator[Notice]:
        for place, some in groupby(runs, lambda run: run.place):
            if place not in self._journals:
                origin = dict(zip(Provenance.__annotations__, place, strict=True))
                self._journals[place] = Journal(self._folder, self._study, origin=origin)
            self._journals[place].append_lines([run.line for run in some])
        for run in runs:
            self._forget(run.run_id)
            yield Notice(run.run_id, run.status, run.seconds)

    def _forget(self, run_id: str) -> None:
        progress = self._running.pop(run_id, None)
        if progress is not None:
            with suppress(OSError):
                self._publish({**progress, "ended": True})


@final
@dataclass(frozen=True)
class Cluster:
    """A scheduler with its workers, ours of this machine where they are `local`, and our client of it."""

    client: Any
    name: str
    local: _LocalWorkers | None

    def workers(self) -> dict[str, int]:
        """Return the workers there are, {address: threads}, those of ours refilled. Raises `ClusterError`."""
        try:
            if self.local is not None:
                self.local.refill()
            if self.client.status != "running":
                raise OSError("it hung up")
            return dict(self.client.nthreads())
        except (OSError, TimeoutError) as error:
            raise self.lost(error) from None

    def lost(self, error: BaseException) -> ClusterError:
        words = " ".join(str(error).split()) or type(error).__name__
        return ClusterError(
            f"{self.name}: the scheduler was lost ({words}); finished runs are kept, the same command goes on"
        )


@contextmanager
def cluster(workers: int, address: str | None) -> Iterator[Cluster]:
    """Yield so many `workers` of this machine, or the cluster at `address`. Raises `ClusterError` without one."""
    distributed = _distributed()
    with ExitStack() as stack:
        stack.enter_context(_quiet())
        if address is not None:
            client, local = _client(distributed, address), None
        else:
            scratch = stack.enter_context(
                tempfile.TemporaryDirectory(prefix="calibench-dask-", ignore_cleanup_errors=True)
            )
            local = _LocalWorkers(workers)
            stack.callback(local.close)
            own = distributed.LocalCluster(  # a scheduler in this process, without workers and without a page
                n_workers=0, threads_per_worker=1, processes=True, host=_HOST, silence_logs=False,
                dashboard_address=f"{_HOST}:0",  # at None it takes port 8787, and warns where that is taken
                scheduler_kwargs={"allowed_failures": 0, "dashboard": False},
            )  # fmt: skip
            where = str(stack.enter_context(own).scheduler_address)
            stack.callback(local.close)  # before their scheduler
            local.meet(where, scratch)
            client = _client(distributed, where)
        stack.callback(client.close, timeout=5)
        yield Cluster(client, f"execution.address={address}" if address else "execution=dask", local)


def check_cluster(address: str | None) -> None:
    """Raise `ClusterError` where `cluster` would, before anything is started; of an `address` it asks who is there."""
    distributed = _distributed()
    if address is not None:
        with _quiet():
            _client(distributed, address).close(timeout=5)


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise ClusterError("execution=dask: needs distributed; pip install 'calibench[dask]'") from None
    return distributed


def _client(distributed: Any, address: str) -> Any:
    """Return a client of the scheduler at `address`. Raises `ClusterError` where none answers."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of other versions of Dask; ours are compared one by one
            return distributed.Client(address, set_as_default=False)
    except Exception as error:  # a name that no host has, an unknown protocol, a port where something else answers
        words = " ".join(str(error).split()) or type(error).__name__
        raise ClusterError(f"execution.address={address}: no Dask scheduler answers there: {words}") from None


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the loggers of Dask off the terminal, also those that are made meanwhile."""
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    known = [one for one in list(logging.root.manager.loggerDict.values()) if isinstance(one, logging.Logger)]
    silenced = [one for one in known if one.name.partition(".")[0] in _LOGGERS and not one.disabled]
    handlers = [handler for logger in loggers for handler in logger.handlers]
    for logger in silenced:
        logger.disabled = True
    for handler in handlers:
        handler.addFilter(_NOTHING)
    try:
        yield
    finally:
        for logger in silenced:
            logger.disabled = False
        for handler in handlers:
            handler.removeFilter(_NOTHING)


@final
class _LocalWorkers:
    """So many workers of one thread on this machine, for the scheduler that they `meet`; they end when this one does.

    They are forked with what is loaded here, before that scheduler has its thread.
    """

    def __init__(self, workers: int) -> None:
        from calibench.bench.workers.dask_worker import serve

        self._where: tuple[str, str] | None = None
        self._early = 0
        self._began: dict[Child, float] = {}
        for _ in range(workers):
            self._start(Child(serve))

    def meet(self, address: str, scratch: str) -> None:
        self._where = address, scratch
        for child in self._began:
            child.send(self._where)

    def refill(self) -> None:
        """Replace the workers that have ended. Raises `OSError` where they end as soon as they are started."""
        for child in [child for child in self._began if child.is_gone]:
            lived = monotonic() - self._began.pop(child)
            ending = child.end()
            self._early = self._early + 1 if "SIG" not in ending and lived < _EARLY else 0
            if self._early >= _TRIES:
                raise OSError(f"workers end as soon as they are started, with {ending}")
            self._start(child)
            child.send(self._where)

    def close(self) -> None:
        children, self._began = self._began, {}
        for child in children:
            child.connection.close()
        for child in children:
            if child.process is not None:
                child.process.join(_END)
            child.end()

    def _start(self, child: Child) -> None:
        child.start(other.connection for other in self._began)
        self._began[child] = monotonic()
