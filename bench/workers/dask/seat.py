"""A seat: the process beside a cluster's worker in which runs are executed, by a child that it forks.

A Dask worker has threads, and must outlive whatever a run does. So it starts a seat, a fresh process of one thread: the
libraries of linear algebra are told to use one thread before they are loaded, the kernels are loaded once, and a child
that a run has ended is replaced by another fork at once. The seat itself executes nothing of a user's. It ends when the
worker does, when it is told to, and after some idle time.

It is given a `Home`, then packs. What it says begins with a letter: ``A`` it agrees to work; ``X`` why it does not;
``B`` it can begin with a pack, and does when it hears anything; ``P`` how far a run is, JSON; ``R`` a run has ended,
pickled with its seconds; ``E`` the pack has, with [status, why] where the child was lost.
"""

from __future__ import annotations

import importlib
import json
import pickle
import signal
import tempfile
import threading
from multiprocessing.connection import Connection, wait
from pathlib import Path
from time import monotonic

from calibench.bench.execution.in_progress import publishing
from calibench.bench.execution.kernels import load_kernels
from calibench.bench.execution.run import Run
from calibench.bench.gate.processes import exit_of, forked, prepare
from calibench.bench.workers.child import Child, too_late
from calibench.bench.workers.dask.home import OURS, Home, difference, moved, settle
from calibench.bench.workers.packs import Pack
from calibench.bench.workers.worker import do_pack

AGREED, REFUSED, READY, WENT_ON, RAN, ENDED = b"A", b"X", b"B", b"P", b"R", b"E"
IDLE = 10.0  # seconds without a pack after which a seat goes
PROGRESS_EVERY = 2.0  # seconds between two words of how far a long run is
_LOOK = 0.25  # seconds between two looks at the child


def sit(descriptor: int) -> None:
    """Do the packs that come over the socket `descriptor` until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the worker ends us
    worker = Connection(descriptor)
    child = Child(_work)
    with tempfile.TemporaryDirectory(prefix="calibench-") as folder:
        try:
            home = pickle.loads(worker.recv_bytes())
            for module in OURS:
                importlib.import_module(module)
            prepare()
            places = settle(home, Path(folder))
            why = _difference(home)
            if why:
                worker.send_bytes(REFUSED + why.encode())
                return
            worker.send_bytes(AGREED)
            while worker.poll(IDLE):
                pack = moved(pickle.loads(worker.recv_bytes()), places)
                load_kernels((job.spec for job in pack.jobs), fork=False)  # others of this machine do so beside it
                worker.send_bytes(READY)
                worker.recv_bytes()
                lost = _do(pack, child, worker)
                worker.send_bytes(ENDED + (json.dumps(lost).encode() if lost else b""))
        except (EOFError, ConnectionError):  # the worker is gone, or has no more for us
            pass
        finally:
            child.end()


def _do(pack: Pack, child: Child, worker: Connection) -> tuple[str, str] | None:
    """Do a pack, passing on each run as it ends; return status and reason where the child was lost with one."""
    if child.is_gone:  # it ended after its last run
        child.end()
    if not child.is_there:
        child.start([worker])
    child.send(pack)
    for_run = iter(pack.jobs)
    job = next(for_run, None)
    heard = monotonic()
    while job is not None:
        if worker in wait([worker, child.connection], _LOOK):  # there is nothing to say to a seat at work
            raise EOFError
        why = child.why_lost()  # before it is heard: what it told last must not be missed
        for told in child.told():
            worker.send_bytes(told)
            if told[:1] == RAN:
                job, heard = next(for_run, None), monotonic()
        if job is None:
            break
        why = why or too_late(job.spec.time_limit, heard)
        if why is not None:
            child.end()
            return why
    return None


def _difference(home: Home) -> str:
    """Return what is otherwise here, told by a child: a user's modules are not loaded into the seat."""
    with forked(lambda theirs: theirs.send(difference(home))) as (child, ours):
        try:
            return str(ours.recv())
        except EOFError:
            child.join()
            names = ", ".join(module for module in home.code if module not in OURS)
            return f"a process that imports {names or 'calibench'} ends with {exit_of(child.exitcode)}"


def _work(theirs: Connection) -> None:
    """Do the packs that come until there is none, or this process can do no more."""
    lock = threading.Lock()  # progress is told by a thread

    def say(words: bytes) -> None:
        with lock:
            theirs.send_bytes(words)

    def keep(run: Run, seconds: float) -> None:
        say(RAN + pickle.dumps((run, seconds), pickle.HIGHEST_PROTOCOL))

    with publishing(lambda progress: say(WENT_ON + json.dumps(progress).encode()), PROGRESS_EVERY):
        while do_pack(theirs.recv(), keep, lambda notices: None):
            pass
