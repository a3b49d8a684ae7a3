"""One run: a problem, an optimiser, a budget and a repetition make one row, whatever happens.

Converged, exhausted, on target or crashed: the row says which. Compilation happens before the clock starts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from math import inf
from typing import TYPE_CHECKING, Any, final

import numpy as np

from calibench.bench.execution.answer import answer_of, place_of_answer
from calibench.bench.execution.costly import ReplayFolder, around, check_inner, check_replay
from calibench.bench.execution.in_progress import Name, followed
from calibench.bench.execution.request import (
    Array,
    Asked,
    Pair,
    Start,
    built_by_foreign,
    made_pair,
    pair_of,
    read_asked,
)
from calibench.bench.execution.row_of import check_merit, compile_parts, row_of, with_an_answer
from calibench.bench.execution.run_row import RunRow
from calibench.bench.execution.stochastic import seeded
from calibench.bench.gate.box import looks
from calibench.bench.gate.evaluator import Evaluator, TracePoint, scans
from calibench.bench.gate.processes import CAN_FORK
from calibench.bench.gate.time_limit import PASSED, STALL_LIMIT, Cut, Ending, Mirror, Phase, Runner, Watch, run_here
from calibench.core.own_state import Kept, kept
from calibench.core.process import hold_new, one_thread
from calibench.core.seeds import begin_generators, global_generators, seed_sequence
from calibench.core.sources import is_foreign
from calibench.core.words import html_table

if TYPE_CHECKING:
    import pandas as pd

_BUILDING = seed_sequence("building", repetition=0)
_PATIENCE = 60.0  # seconds for judging an answer where a run is watched and has no limit of its own


@final
@dataclass(frozen=True)
class Way:
    """How a run is made: processes for its batches, where it keeps its values, and the process's state before it.

    `state` is None where no foreign code takes part.
    """

    inner: int
    replay: ReplayFolder | None
    state: Kept | None


@final
@dataclass(frozen=True)
class Found:
    """What is known of a run that was cut, and when it began."""

    cut: Cut
    began: datetime

    def restored(self, gate: Evaluator) -> Ending:
        """Let `gate` be where it was, and return how the run ended."""
        if self.cut.state is not None:
            gate.restore(self.cut.state)
        if self.cut.timed_out:
            gate.stopped = "timeout"
        return self.cut.ending


@final
@dataclass(frozen=True)
class Spec:
    """What a run is, in values: enough to do it anywhere, and to know whether it has been done.

    Options are those given; names are those of the registries, ``pkg.module:Class`` or ``/place/of/file.py:Class``,
    as a process anywhere finds them. `time_limit` is no part
    of what a run is: its id does not hold it, and a run that ends in time is the same to the last bit.
    """

    problem: str
    problem_options: Mapping[str, Any]
    optimizer: str
    optimizer_options: Mapping[str, Any]
    budget: int
    repetition: int
    start: Start | None = None
    target: float | None = None
    time_limit: float | None = None

    def execute(self, *, inner: int = 1, replay: ReplayFolder | None = None, run_id: str = "") -> Run:
        """Build problem and optimiser and run them; neither `inner` nor `replay` changes what the run is.

        With a time limit, or an optimiser that may hang, all of it is done by the standing process of this thread
        (`bench.execution.standing`). `run_id` is for the row of a run whose parts could not be built to ask them.
        """
        if self.time_limit is None or not CAN_FORK:
            with self._asked(inner, replay) as (asked, state):
                if not (asked.pair.may_hang and CAN_FORK):
                    return make_run(asked, Way(inner, replay, state), _watch_here(self.time_limit))
        from calibench.bench.execution.standing import run_apart  # it makes the rows of lost runs, which are `Run`s

        return run_apart(self, inner, replay, run_id)

    def made(self, inner: int, replay: ReplayFolder | None, watch: Watch, found: Found | None) -> Run:
        """Make the run in this process, the one that is watched, or the row of what was `found` before it was cut."""
        with self._asked(inner, replay) as (asked, state):
            return make_run(asked, Way(inner, replay, state), watch, found)

    @contextmanager
    def _asked(self, inner: int, replay: ReplayFolder | None) -> Iterator[tuple[Asked, Kept | None]]:
        with one_thread(), _own_state(built_by_foreign(self.problem, self.optimizer)) as state:
            pair = made_pair(self.problem, self.problem_options, self.optimizer, self.optimizer_options)
            asked = read_asked(
                pair, self.budget, self.repetition, start=self.start, target=self.target, time_limit=self.time_limit
            )
            _check_way(pair, inner, replay)
            yield asked, state


@final
@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """The result of a run: its row of ``runs.parquet`` without the study, and the points of its trace."""

    record: RunRow
    points: tuple[TracePoint, ...]

    @property
    def row(self) -> dict[str, Any]:
        """Return the row by the names of its columns."""
        return vars(self.record).copy()

    @property
    def run_id(self) -> str:
        """Return the id that names this run: a digest of what it is."""
        return self.record.run_id

    @property
    def best_x(self) -> Array | None:
        """Return the best point found, shape (dim,); None where no finite value was."""
        return None if self.record.best_x is None else np.array(self.record.best_x)

    @property
    def best_value(self) -> float:
        """Return the best value found; infinite where no finite value was."""
        return self.record.best_value

    @property
    def evaluations(self) -> int:
        """Return the number of evaluations."""
        return self.record.evaluations

    @property
    def charged(self) -> int:
        """Return evaluations and `dimension` for each Jacobian."""
        return self.record.charged

    @property
    def status(self) -> str:
        """Return ok, failed or timeout."""
        return self.record.status

    @property
    def stop_reason(self) -> str:
        """Return converged, budget, target, failed or timeout."""
        return self.record.stop_reason

    @property
    def error_type(self) -> str:
        """Return the class of what a failed run raised; '' where nothing did."""
        return self.record.error_type

    @property
    def error(self) -> str:
        """Return its text."""
        return self.record.error

    def __repr__(self) -> str:
        """Return the run in a line; `row` has everything."""
        row, unit = self.record, f" {self.record.unit}" if self.record.unit else ""
        why = f": {row.error_type} {row.error}" if row.error_type or row.error else ""
        return (
            f"<run {row.run_id} of {row.optimizer} on {row.problem}: {row.charged} of {row.budget} charged, "
            f"best {row.best_value:.6g}{unit}, {row.status} ({row.stop_reason}){why}>"
        )

    def _repr_html_(self) -> str:
        """Return the run and its answer, as a notebook shows them."""
        row = self.record
        values = row.best_x or [] if row.parameter_values is None else row.parameter_values
        names = row.parameter_names or [f"x{i}" for i in range(len(values))]
        return html_table(repr(self).strip("<>"), ("parameter", "value"), list(zip(names, values)))

    @property
    def trace(self) -> pd.DataFrame:
        """Return the best value over evaluations: columns evaluations, charged, best_value, restart."""
        import pandas as pd

        return pd.DataFrame(self.points, columns=["evaluations", "charged", "best_value", "restart"])


@final
class Heard:
    """What a watched run has told of itself: it is followed from then on; `draft` is its row before it was judged."""

    def __init__(self) -> None:
        self.name: Name | None = None
        self.draft: Run | None = None
        self._stack = ExitStack()

    def __enter__(self) -> Heard:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def hear(self, message: Name | Run, counts: Mirror, pid: int) -> None:
        """Take what the process `pid` tells; `counts` are its own."""
        if isinstance(message, Run):
            self.draft = message
        else:
            self.name = message
            self._stack.enter_context(followed(message, counts, pid))


def as_lost_in_judging(draft: Run, cut: Cut) -> Run:
    """Return a run whose process ended as its answer was judged: failed, unless its search had failed before."""
    if draft.error_type:
        return draft
    kind = "TimeoutError" if cut.timed_out else cut.ending.error_type
    failed: dict[str, Any] = {"status": "failed", "stop_reason": "failed"}
    return Run(replace(draft.record, error_type=kind, error=cut.ending.error, **failed), draft.points)


def execute(
    problem: Any,
    optimizer: Any,
    budget: int,
    seed: int = 0,
    *,
    start: Start | Array | None = None,
    target: float | None = None,
    problem_name: str | None = None,
    optimizer_name: str | None = None,
    time_limit: float | None = None,
    inner: int = 1,
    replay: ReplayFolder | None = None,
) -> Run:
    """Minimise `problem` with `optimizer` within `budget` evaluations; `seed` is the repetition.

    `problem` is any object with `lower`, `upper`, `start` and a call. `start` is "nominal" (the problem's own),
    "random" (uniform in the box, the same for all optimisers), or a point; by default what the problem prefers.
    `time_limit` [s] ends it, as a row of status timeout with all that was found until then; the run then lives in a
    forked child, so that what loops in C ends too, and what the problem changes in memory is not seen here. There a
    ``compile()`` and a ``merit(x)`` of your own have as much time each. An optimiser that may hang always runs so, and
    is ended after a minute without an evaluation.
    `inner` processes evaluate the batches of a method that has them; `replay` is where a run with costly evaluations
    writes its values down and, after a kill, goes on from (docs/costly.md).
    What a class that is not this package's sets in the process (working folder, ``np.seterr``, warnings) is put back at
    the end, and named in the row's ``process_changes``.
    Raises `ValueError` for a request that makes no sense; a run that has begun never raises, its row tells.
    """
    foreign = [type(part).__module__ for part in (problem, optimizer) if is_foreign(part)]
    with one_thread(), _own_state(foreign) as state:
        pair = pair_of(problem, optimizer, problem_name, optimizer_name)
        asked = read_asked(pair, budget, seed, start=start, target=target, time_limit=time_limit)
        _check_way(pair, inner, replay)
        way = Way(inner, replay, state)
        if not CAN_FORK or not (time_limit is not None or pair.may_hang):
            return make_run(asked, way, _watch_here(time_limit))
        return _run_of_object(asked, way, time_limit)


def _run_of_object(asked: Asked, way: Way, time_limit: float | None) -> Run:
    """Make a run in a child forked for it, which has the objects; where that is cut, its row in another."""
    pair = asked.pair
    if not (pair.foreign_problem or pair.foreign_optimizer):  # ours compile here, once for all runs
        pair.compiled = compile_parts(pair.problem, pair.optimizer) is None
    looks(), scans()  # once here, and not in every child
    limit = inf if time_limit is None else time_limit
    began = datetime.now(UTC)

    def make(found: Found | None, watch: Watch) -> tuple[Run, bool]:
        if way.state is None:
            return make_run(asked, way, watch, found), False
        with kept() as state:  # a child has other streams than its parent from the beginning
            return make_run(asked, replace(way, state=state), watch, found), False

    found: Found | None = None
    while True:
        runner = Runner(make, len(asked.first) + 2 * len(asked.targets))
        with Heard() as heard:
            run = runner.ask(found, limit, heard.hear)
        if not isinstance(run, Cut):
            return _with_changes(run, way.state)
        if heard.draft is not None:
            return as_lost_in_judging(heard.draft, run)
        if found is not None:
            return _unjudged(asked, found)
        found = Found(run, began)


def _with_changes(run: Run, state: Kept | None) -> Run:
    """Return a run that a child made, with what has been changed here before that too."""
    if state is None:
        return run
    state.note(run.record.process_changes or ())
    return Run(replace(run.record, process_changes=state.put_back()), run.points)


def _unjudged(asked: Asked, found: Found) -> Run:
    """Return the row of a run that was cut, without a further call of its problem."""
    pair = asked.pair
    gate = Evaluator(pair.problem, asked.budget, start=asked.first, target=asked.target, targets=asked.targets)
    ending = found.restored(gate)
    gate.close()
    answer = place_of_answer(pair, gate.best_x)
    return Run(row_of(asked, gate, answer, ending, found.began), tuple(gate.trace))


@contextmanager
def _own_state(foreign: Sequence[str]) -> Iterator[Kept | None]:
    """Keep what the code of the `foreign` modules does in this process from later runs; ours changes nothing.

    It begins with the same generators of `random` and ``np.random`` in every process.
    """
    if not foreign:
        yield None
        return
    with kept(*foreign) as state, global_generators(_BUILDING):
        yield state


def _check_way(pair: Pair, inner: int, replay: ReplayFolder | None) -> None:
    check_inner(pair.problem, pair.optimizer, inner)
    check_replay(pair.problem, replay)


def _watch_here(time_limit: float | None) -> Watch | None:
    """Return what lets the gate alone watch the clock, where a system cannot fork; None without a limit."""
    return None if time_limit is None else Watch(Mirror(), time_limit)


def make_run(asked: Asked, way: Way, watch: Watch | None = None, found: Found | None = None) -> Run:
    """Make the run that is asked for in this process, and tell `watch` of it.

    Where it was `found` cut by its time limit or a crash, there is no search: this is then its row.
    """
    pair, repetition, state = asked.pair, asked.repetition, way.state
    words = pair.problem_word, pair.optimizer_word
    begin: Callable[[], object] = float  # nothing, as our code draws from rng alone
    if state is not None:
        hold_new()
        begin = partial(begin_generators, seed_sequence(*words, "shared", repetition=repetition))
    problem, optimizer = pair.problem, pair.optimizer
    foreign = pair.foreign_problem or pair.foreign_optimizer
    replay = way.replay
    if replay is not None and not replay.always and not pair.foreign_problem:
        replay = None  # an evaluation of ours takes microseconds
    if watch is not None:
        watch.enter(Phase.COMPILING, None if foreign else inf)
    broken = None if pair.compiled or found else _compile(problem, optimizer, begin)
    if not (pair.compiled or found or broken or watch) and pair.foreign_problem:
        broken = check_merit(problem)  # watched, a merit that hangs or crashes costs no search
    pair.compiled = pair.compiled or (broken is None and not found)
    if watch is not None:
        watch.enter(Phase.COMPILING)  # anew: the problem says where its box is
    again = partial(seed_sequence, pair.problem_word, "restart", repetition=repetition)  # paired across optimisers
    searched = seeded(problem, pair.problem_word, repetition)
    gate = Evaluator(
        searched, asked.budget, start=asked.first, target=asked.target, targets=asked.targets, restart_seed=again
    )
    began = datetime.now(UTC) if found is None else found.began
    name = Name(asked.run_id, pair.problem_name, pair.optimizer_name, repetition, asked.budget)
    if watch is not None:
        watch.mirror.show(gate)
        watch.tell(name)
    if found is not None:
        ending = found.restored(gate)
    elif broken is not None:
        ending = broken
    else:
        rng = np.random.default_rng(seed_sequence(*words, repetition=repetition))
        limit = None if watch is None or watch.limit == inf else watch.limit
        made_in = around(gate, searched, asked.run_id, pair.code, inner=way.inner, replay=replay, time_limit=limit)
        stall_limit = STALL_LIMIT if pair.may_hang else inf
        clock: Callable[[], object] = float if watch is None else partial(watch.begin, gate, stall_limit)
        with followed(name, gate):
            ending = run_here(optimizer, gate, rng, clock, _begun(begin, made_in))
        if gate.stopped == "timeout":
            ending = replace(ending, error=PASSED)
    gate.close()
    ending = with_an_answer(gate, ending)
    if watch is not None:
        watch.enter(Phase.JUDGING, (watch.limit if watch.limit < inf else _PATIENCE) if pair.foreign_problem else inf)
        if pair.foreign_problem:
            draft = row_of(asked, gate, place_of_answer(pair, gate.best_x), ending, began)
            watch.tell(Run(draft, tuple(gate.trace)))
    answer, ending = answer_of(pair, gate.best_x, ending, repetition)
    process_changes = [] if state is None else state.put_back()
    return Run(row_of(asked, gate, answer, ending, began, process_changes), tuple(gate.trace))


def _compile(problem: Any, optimizer: Any, begin: Callable[[], object]) -> Ending | None:
    begin()
    return compile_parts(problem, optimizer)


@contextmanager
def _begun(begin: Callable[[], object], made_in: AbstractContextManager[Any]) -> Iterator[None]:
    """Make the search within `made_in`, after `begin`: in its own process, as a fork begins `random` anew."""
    with made_in:
        begin()
        yield
