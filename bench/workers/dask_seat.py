"""A seat: the process beside a cluster's worker in which runs are executed, by a child that it forks.

A Dask worker must outlive whatever a run does. So it starts a seat, a process of one thread (fresh, or forked before
the worker of this machine has others), which executes nothing of a user's itself. What it says begins with a letter:
``X`` why it does not work; ``B`` it can begin with a pack, and does when it hears anything; ``T`` what its child says,
pickled: ``P`` how far a run is, JSON, and ``R`` a run has ended, a `Made` pickled; ``E`` the pack has, with [status,
why] where the child was lost.

A `Home` is what the sweep's own machine has and every worker must have: versions and digests of code, by which a worker
that differs is refused, and the sources of a user's classes, which are sent along.
"""

import importlib
import json
import pickle
import signal
import sys
import tempfile
import threading
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from pathlib import Path
from time import monotonic, sleep
from typing import Any, NamedTuple, final

from calibench.bench.execution.in_progress import publishing
from calibench.bench.execution.kernels import load_kernels
from calibench.bench.execution.run import Run, Spec
from calibench.bench.gate.processes import Child, exit_of, forked, load_prctl
from calibench.bench.provenance.code_digest import GATE
from calibench.bench.provenance.environment import Provenance, provenance
from calibench.bench.store.journal import line_of
from calibench.bench.workers.carrier import Pack, do_pack, too_late
from calibench.core import sources, user_file

REFUSED, READY, WENT_ON, RAN, TOLD, ENDED = b"X", b"B", b"P", b"R", b"T", b"E"
IDLE = 10.0  # seconds without a pack after which a seat goes
PROGRESS_EVERY = 2.0  # seconds between two words of how far a long run is
_LOOK = 0.25  # seconds between two looks at the child
_TOGETHER = 0.01  # seconds in which runs that end are passed on as one; their child can say more than that unread
_NOT_IN_RUNS = ("python", "pandas", "pyarrow", "hydra-core")  # they compose and keep, and are no part of a run
OURS = (  # what a run goes through
    *("calibench.problems", "calibench.optimizers", "calibench.bench.execution.run", "calibench.bench.store.journal"),
    *GATE,
)


def enter(descriptor: int) -> None:
    """Be a seat, whose worker has the other end of the socket `descriptor`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the worker ends us
    sit(Connection(descriptor))


def sit(worker: Connection) -> None:
    """Do the packs that come from the `worker` until it hangs up."""
    child = Child(_work)
    with tempfile.TemporaryDirectory(prefix="calibench-") as folder:
        try:
            home = pickle.loads(worker.recv_bytes())
            for module in OURS:
                importlib.import_module(module)
            load_prctl()
            places = settle(home, Path(folder))
            # a child tells what is otherwise here: a user's modules are not loaded into the seat
            with forked(lambda theirs: theirs.send(difference(home))) as (asked, ours):
                try:
                    why = str(ours.recv())
                except EOFError:
                    asked.join()
                    names = ", ".join(module for module in home.code if module not in OURS)
                    why = f"a process that imports {names or 'calibench'} ends with {exit_of(asked.exitcode)}"
            if why:
                worker.send_bytes(REFUSED + why.encode())
                return
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
    if child.process is None:
        child.start([worker])
    child.send(pack)
    for_run = iter(pack.jobs)
    job = next(for_run, None)
    heard = monotonic()
    while job is not None:
        if worker in wait([worker, child.connection], _LOOK):  # there is nothing to say to a seat at work
            raise EOFError
        if job is not pack.jobs[-1]:
            sleep(_TOGETHER)  # to be woken takes as long as a short run
        why = child.why_lost()  # before it is heard: what it sent last must not be missed
        said = child.messages()
        if said:
            worker.send_bytes(TOLD + pickle.dumps(said))
        for words in said:
            if words[:1] == RAN:
                job, heard = next(for_run, None), monotonic()
        if job is None:
            break
        why = why or too_late(job.spec.time_limit, heard)
        if why is not None:
            child.end()
            return why
    return None


class Made(NamedTuple):
    """A run that has ended: its line for a journal, of rows that were made in such a place."""

    run_id: str
    status: str
    seconds: float
    place: tuple[Any, ...]
    line: bytes


def made(run: Run, seconds: float) -> Made:
    place = tuple(getattr(run.record, key) for key in Provenance.__annotations__)
    return Made(run.run_id, run.status, seconds, place, line_of(run))


def _work(theirs: Connection) -> None:
    lock = threading.Lock()  # progress is told by a thread

    def say(words: bytes) -> None:
        with lock:
            theirs.send_bytes(words)

    with publishing(lambda progress: say(WENT_ON + json.dumps(progress).encode()), PROGRESS_EVERY):
        while do_pack(
            theirs.recv(),
            lambda run, seconds: say(RAN + pickle.dumps(made(run, seconds), pickle.HIGHEST_PROTOCOL)),
            lambda notices: None,
        ):
            pass


@final
@dataclass(frozen=True)
class SourceFile:
    """A file of a user's: absolute path, the folder from which it is imported, what rows call it, its content."""

    path: str
    root: str
    name: str | None  # where it stands in our own folder; None elsewhere
    content: bytes


@final
@dataclass(frozen=True)
class Home:
    """Versions, digests of modules by name, a user's files, and Python's path of the sweep's own process."""

    versions: Mapping[str, str]
    code: Mapping[str, str]
    files: tuple[SourceFile, ...]
    path: tuple[str, ...]


def home_of(specs: Iterable[Spec]) -> Home:
    """Return what the runs `specs` need of this machine. Their classes were loaded here."""
    names = {name for spec in specs for name in (spec.problem, spec.optimizer) if ":" in name}
    modules = {name.partition(":")[0] for name in names if not user_file.is_file_path(name)}

    # the user's files, the local ones that they import, and the __init__.py of the packages that these stand in
    paths: set[Path] = set()
    left = [user_file.place_of(name) for name in names if user_file.is_file_path(name)]
    while left:
        for path in sources.closure(left.pop()) - paths:
            if sources.is_ours(path):
                continue
            paths.add(path)
            folder = path.parent
            while (folder / "__init__.py").is_file() and folder != folder.parent:
                left.append(folder / "__init__.py")
                folder = folder.parent
    files = tuple(
        SourceFile(str(path), str(sources.root_of(path)), sources.name_at_home(path), path.read_bytes())
        for path in sorted(paths)
    )
    code = {module: _digest(module) for module in (*OURS, *sorted(modules))}
    return Home(_versions(), code, files, tuple(sys.path))


def difference(home: Home) -> str:
    """Return in words what this process has otherwise than `home`; "" where nothing. To be called after `settle`."""
    here = _versions()
    for package, wanted in home.versions.items():
        if wanted and here.get(package) != wanted:
            return f"it has {package} {here.get(package) or '(none)'}, here it is {wanted}"
    for module, wanted in home.code.items():
        try:
            found = _digest(module)
        except Exception as error:  # whatever a user's module raises as it is loaded
            return f"it cannot import {module}: {type(error).__name__}: {error}"
        if found != wanted:
            return f"its code of {module} is another than here"
    return ""


def settle(home: Home, folder: Path) -> dict[str, str]:
    """Put the user's files under `folder`, where they are not in place; return {path at home: path here}."""
    places: dict[str, str] = {}
    called: dict[Path, str] = {}
    roots = list(dict.fromkeys(file.root for file in home.files))
    settled = []
    for number, root in enumerate(roots):
        mine = [file for file in home.files if file.root == root]
        in_place = False
        with suppress(OSError):
            in_place = all(Path(file.path).read_bytes() == file.content for file in mine)
        top = Path(root) if in_place else (folder / str(number)).resolve()
        settled.append(str(top))
        for file in mine:
            path = top / Path(file.path).relative_to(root)
            places[file.path] = str(path)
            if in_place:
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(file.content)
            if file.name is not None:
                called[path] = file.name
    sources.call(called)
    sys.path[:] = dict.fromkeys([*sys.path, *settled, *(entry for entry in home.path if entry not in roots)])
    return places


def moved(pack: Pack, places: Mapping[str, str]) -> Pack:
    def here(name: str) -> str:
        file = str(user_file.place_of(name)) if user_file.is_file_path(name) else ""
        return f"{places[file]}:{name.rpartition(':')[2]}" if file in places else name

    specs = [replace(j.spec, problem=here(j.spec.problem), optimizer=here(j.spec.optimizer)) for j in pack.jobs]
    return replace(pack, jobs=tuple(replace(job, spec=spec) for job, spec in zip(pack.jobs, specs, strict=True)))


def _versions() -> dict[str, str]:
    found = json.loads(provenance()["versions"])
    python = f"{sys.version_info.major}.{sys.version_info.minor}"  # rows are the same within a minor version
    return {"Python": python, **{name: version for name, version in found.items() if name not in _NOT_IN_RUNS}}


def _digest(module: str) -> str:
    with user_file.no_bytecode():
        importlib.import_module(module)
    return sources.module_digest(module)
