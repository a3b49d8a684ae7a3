"""The carrier of a Dask cluster: packs go out, each run comes home as it ends, this process keeps the journals.

The scheduler is one of our own on this machine, or the one at an address. A pack goes to a worker by its address, two
for each of its threads' worth of work, so that it is known here who was lost with what: the scheduler never gives a
pack to another worker by itself. Workers may come and go at any time. What a run can do to its process stays in the
worker's seat (`bench.workers.dask_seat`) and costs that run alone; a worker that is lost costs the runs it was at,
which go alone to another; where three are lost with a run, its row says so.

Runs come home over a queue of the scheduler, which holds few messages: where this process is slower than its workers
they wait, and its memory does not grow. Whatever goes wrong with the scheduler is one line, a `ClusterError`; finished
runs are kept then, and the same command goes on. The terminal stays clean.
"""

from __future__ import annotations

import json
import logging
import pickle
import queue
import subprocess
import sys
import tempfile
import threading
import warnings
from collections import Counter, deque
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from secrets import token_hex
from time import monotonic
from typing import Any, final

from calibench.bench.execution.in_progress import Progress, to_files, was_silent
from calibench.bench.execution.run import Run
from calibench.bench.provenance.environment import Provenance
from calibench.bench.store.journal import Journal
from calibench.bench.workers.carrier import Job, Notice, Pack, Packs, row_of_lost
from calibench.bench.workers.dask_seat import WENT_ON, home_of
from calibench.core.words import print_plain as print

_LOOK = 0.5  # seconds between two looks at who is there, and at whether we are closed
_TO_AGREE = 30.0  # seconds for workers that are there to compare their code with ours before others begin
_STRIKES = 3  # the site may end two workers in a row; what a run itself does is mostly a row at the second
_NOBODY = 10.0  # seconds without a worker after which that is told
_MESSAGES = 64  # on their way, after which workers wait for us
_LOGGERS = ("distributed", "dask", "tornado", "asyncio")
_HOST = "127.0.0.1"
_ENTER = (
    "import sys; sys.path[:] = {path!r}; from calibench.bench.workers.dask_worker import serve; serve(*sys.argv[1:])"
)
_APART = None if sys.platform == "win32" else 0  # a process group of its own: Ctrl-C is for us to handle
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
            sweep = _Sweep(packs, found, _Keeper(self.folder, self.study))
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

    def __init__(self, packs: Packs, cluster: Cluster, keeper: _Keeper) -> None:
        self._packs, self._cluster, self._keeper = packs, cluster, keeper
        self._name = f"calibench-{token_hex(8)}"
        self._workers: dict[str, _Member] = {}
        self._flights: dict[int, _Flight] = {}
        self._strikes: Counter[str] = Counter()  # how often a run was in flight where something was lost
        self._count = 0
        self._since = self._seen = monotonic()  # when the sweep began, and a worker was last seen
        self._looked = float("-inf")
        self._begun = False
        self._inbox = _Inbox(cluster, self._name)
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
            from calibench.bench.workers.dask_worker import close_seats

            with suppress(Exception):
                client.run(close_seats, self._name, on_error="ignore")
        self._keeper.close()

    def _check_versions(self) -> None:
        """Refuse a worker with another calibench, or none: asked by what every Python has."""
        with suppress(OSError, TimeoutError):
            answers = self._cluster.client.run(version, "calibench", on_error="return")
            here = ""
            with suppress(PackageNotFoundError):
                here = version("calibench")
            for worker, answer in answers.items():
                there = "" if isinstance(answer, BaseException) else str(answer)
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
            self._workers[worker] = _Member(present[worker])
            self._fly(worker, Pack(()))
        self._packs.share_among(sum(member.threads for member in self._workers.values()))
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
        member = self._workers.get(flight.worker)
        if member is None or number not in member.flights:
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
        agreed = [member for member in self._workers.values() if member.agreed]
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
        place = message["first"]
        for words in message["words"]:
            if words[:1] == WENT_ON:
                self._keeper.note(json.loads(words[1:]))
                continue
            if place == len(flight.pack.jobs) - len(flight.rest):  # else the pack is done again, by whomever
                run, seconds = pickle.loads(words[1:])
                job = flight.rest.popleft()
                if run.run_id != job.run_id:
                    why = f"its id was {run.run_id} on the Dask worker {flight.worker}: it is another run there"
                    run = row_of_lost(job, "failed", why)
                self._packs.note_time(job, seconds)
                self._keeper.keep(run)
                yield Notice(job.run_id, run.status, seconds)
            place += 1
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
            self._packs.return_unbegun(rest, flight.pack.alone)
            return
        first = rest[0].run_id
        hung = self._keeper.was_silent(first)  # somebody has ended it for that
        self._strikes[first] += 1
        if flight.pack.alone and not hung and self._strikes[first] < _STRIKES:
            self._packs.return_unbegun(rest, alone=True)
            return
        at_fault = self._packs.return_lost(rest, flight.pack.alone or hung)
        if at_fault is not None:
            run = row_of_lost(at_fault, why[0], why[1])
            self._keeper.keep(run)
            yield Notice(at_fault.run_id, run.status, 0.0)


@final
class _Keeper:
    """The journals of this process, and how far the long runs are.

    Rows say where they were made, so each kind of machine has a journal of its own.
    """

    def __init__(self, folder: Path, study: str) -> None:
        self._folder, self._study = folder, study
        self._journals: dict[tuple[Any, ...], Journal] = {}
        self._publish = to_files(folder)
        self._running: dict[str, Progress] = {}

    def keep(self, run: Run) -> None:
        """Write a finished run."""
        made = tuple(getattr(run.record, key) for key in Provenance.__annotations__)
        if made not in self._journals:
            origin = dict(zip(Provenance.__annotations__, made, strict=True))
            self._journals[made] = Journal(self._folder, self._study, origin=origin)
        self._journals[made].append(run)
        self._forget(run.run_id)

    def note(self, progress: Progress) -> None:
        """Write how far a run is, where `bench status` looks."""
        if progress["ended"]:
            self._forget(progress["run_id"])
            return
        self._running[progress["run_id"]] = progress
        with suppress(OSError):  # no run is lost by it
            self._publish(progress)

    def was_silent(self, run_id: str) -> bool:
        """Tell whether a run that was lost had made no evaluation for ten minutes; from here on it does not run."""
        silent = was_silent(self._folder, run_id)
        self._forget(run_id)
        return silent

    def _forget(self, run_id: str) -> None:
        progress = self._running.pop(run_id, None)
        if progress is not None:
            with suppress(OSError):
                self._publish({**progress, "ended": True})

    def close(self) -> None:
        """Forget what runs: nothing does any more."""
        for run_id in list(self._running):
            self._forget(run_id)


@final
class _Inbox:
    """The messages that have come over the scheduler's queue; so many at most, then the workers wait."""

    def __init__(self, cluster: Cluster, name: str) -> None:
        from distributed import Queue

        self._cluster = cluster
        make: Any = Queue  # it has no types
        self._queue = make(name, client=cluster.client, maxsize=_MESSAGES)
        self._arrived: queue.Queue[Any] = queue.Queue(_MESSAGES)
        self._closed = False
        threading.Thread(target=self._receive, daemon=True).start()

    @property
    def is_empty(self) -> bool:
        """Tell whether nothing waits to be heard."""
        return self._arrived.empty()

    def get(self, patience: float) -> Mapping[str, Any] | None:
        """Return the next message; None where none comes in so many seconds. Raises `ClusterError`."""
        with suppress(queue.Empty):
            message: Mapping[str, Any] | BaseException = self._arrived.get(timeout=patience)
            if isinstance(message, BaseException):
                raise self._cluster.lost(message)
            return message
        return None

    def close(self) -> None:
        """Hear nothing more."""
        self._closed = True
        with suppress(Exception):
            if self._cluster.client.status == "running":
                self._queue.put(None, timeout=_LOOK)  # it wakes the receiver, else the end of the client does
                self._queue.close()

    def _receive(self) -> None:
        message: Any = None
        while not self._closed:
            try:
                message = self._queue.get()
            except BaseException as error:
                message = error
            while not self._closed:
                with suppress(queue.Full):
                    self._arrived.put(message, timeout=_LOOK)
                    break
            if isinstance(message, BaseException):
                return


@final
class Cluster:
    """A scheduler with its workers, and our client of it. What it is called stands in `name`."""

    def __init__(self, client: Any, address: str | None, local: _LocalWorkers | None) -> None:
        self.client = client
        self.name = f"execution.address={address}" if address else "execution=dask"
        self._local = local

    @property
    def is_local(self) -> bool:
        """Tell whether the workers are ours."""
        return self._local is not None

    def workers(self) -> dict[str, int]:
        """Return the workers there are, {address: threads}, those of ours refilled. Raises `ClusterError`."""
        try:
            if self._local is not None:
                self._local.refill()
            if self.client.status != "running":
                raise OSError("it hung up")
            return dict(self.client.nthreads())
        except (OSError, TimeoutError) as error:
            raise self.lost(error) from None

    def lost(self, error: BaseException) -> ClusterError:
        """Return the error of a scheduler that is there no longer."""
        words = " ".join(str(error).split()) or type(error).__name__
        return ClusterError(
            f"{self.name}: the scheduler was lost ({words}); finished runs are kept, the same command goes on"
        )


@contextmanager
def cluster(workers: int, address: str | None) -> Iterator[Cluster]:
    """Yield a cluster of `workers` processes of this machine, or the one whose scheduler is at `address`.

    Raises `ClusterError` where `distributed` is missing, or the scheduler cannot be reached.
    """
    distributed = _distributed()
    with ExitStack() as stack:
        stack.enter_context(_quiet())
        local = None
        if address is not None:
            where = address
        else:
            scratch = stack.enter_context(
                tempfile.TemporaryDirectory(prefix="calibench-dask-", ignore_cleanup_errors=True)
            )
            scheduler = stack.enter_context(_own_scheduler(distributed))
            where = str(scheduler.scheduler_address)
            local = _LocalWorkers(where, workers, scratch)
            stack.callback(local.close)
        client = _client(distributed, where)
        stack.callback(client.close, timeout=5)
        yield Cluster(client, address, local)


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


def _own_scheduler(distributed: Any) -> Any:
    """Return a scheduler in this process, without workers and without a page."""
    return distributed.LocalCluster(
        n_workers=0, threads_per_worker=1, processes=True, host=_HOST, silence_logs=False,
        dashboard_address=f"{_HOST}:0",  # at None it takes port 8787, and warns where that is taken
        scheduler_kwargs={"allowed_failures": 0, "dashboard": False},
    )  # fmt: skip


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
        handler.addFilter(_nothing)
    try:
        yield
    finally:
        for logger in silenced:
            logger.disabled = False
        for handler in handlers:
            handler.removeFilter(_nothing)


def _nothing(record: logging.LogRecord) -> bool:
    return False


@final
class _LocalWorkers:
    """So many workers of the scheduler at `address`: processes of one thread, which end when this one does.

    They are started anew and not forked, with Python's path of this process, so that a script needs no guard around
    its main part. Their files are below `scratch`.
    """

    def __init__(self, address: str, workers: int, scratch: str) -> None:
        self._address, self._scratch = address, scratch
        self._early = 0
        self._processes = [self._start() for _ in range(workers)]

    def refill(self) -> None:
        """Replace the workers that have ended. Raises `OSError` where they end as soon as they are started."""
        for place, (process, began) in enumerate(self._processes):
            if process.poll() is None:
                continue
            by_itself = process.returncode is not None and process.returncode >= 0
            self._early = self._early + 1 if by_itself and monotonic() - began < _EARLY else 0
            if self._early >= _TRIES:
                raise OSError(f"workers end as soon as they are started, with exit code {process.returncode}")
            self._processes[place] = self._start()

    def close(self) -> None:
        """End them with all that they have started."""
        for process, _ in self._processes:
            if process.stdin is not None:
                process.stdin.close()
        for process, _ in self._processes:
            try:
                process.wait(_END)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _start(self) -> tuple[subprocess.Popen[bytes], float]:
        command = [sys.executable, "-P", "-c", _ENTER.format(path=sys.path), self._address, self._scratch]
        return subprocess.Popen(command, stdin=subprocess.PIPE, process_group=_APART), monotonic()
