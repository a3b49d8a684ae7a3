"""One run: a problem, an optimiser, a budget and a repetition make one row, whatever happens.

Converged, exhausted, on target or crashed: the row says which. Compilation happens before the clock starts.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from math import inf
from typing import TYPE_CHECKING, Any, TypeVar, cast, final

import numpy as np

from calibench import optimizers, problems
from calibench.bench.execution import request as asking
from calibench.bench.execution.answer import Answer, answer_of, asks, merit_of, place_of_answer
from calibench.bench.execution.costly import ReplayFolder, around, check_costly
from calibench.bench.execution.in_progress import Name, followed
from calibench.bench.execution.request import Array, Asked, Start, is_stochastic, seeded
from calibench.bench.execution.run_row import SCHEMA_VERSION, RunRow
from calibench.bench.gate import time_limit as limits
from calibench.bench.gate.endings import StopReason, frames_of, text_of
from calibench.bench.gate.evaluator import Evaluator, TracePoint, scans
from calibench.bench.gate.face import looks
from calibench.bench.gate.processes import CAN_FORK
from calibench.bench.gate.time_limit import Cut, Ending, Mirror, Phase, Runner, Watch, run_here
from calibench.bench.provenance.environment import provenance
from calibench.core.own_state import Kept, kept
from calibench.core.process import STATED, libraries, one_thread
from calibench.core.seeds import begin_generators, digest, global_generators, seed_sequence
from calibench.core.sources import is_foreign
from calibench.core.words import counted, html_table
from calibench.problems.base import extra_of

if TYPE_CHECKING:
    import pandas as pd

T = TypeVar("T")
_BUILDING = seed_sequence("building", repetition=0)
_PATIENCE = 60.0  # seconds for judging an answer where a run is watched and has no limit of its own


@final
@dataclass(frozen=True)
class Spec:
    """What a run is, in values: enough to do it anywhere, and to know whether it has been done.

    Options are those given; names are those of the registries, as a process anywhere finds them. `time_limit` is no
    part of what a run is: a run that ends in time is the same to the last bit.
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
            with self.asked(inner, replay) as (asked, state):
                if not (asked.pair.may_hang and CAN_FORK):
                    watch = None if self.time_limit is None else Watch(Mirror(), self.time_limit)
                    return make_run(asked, state, watch)
        from calibench.bench.execution.standing import run_apart  # it makes the rows of lost runs, which are `Run`s

        return run_apart(self, inner, replay, run_id)

    @contextmanager
    def asked(self, inner: int, replay: ReplayFolder | None) -> Iterator[tuple[Asked, Kept | None]]:
        """Yield the request of this run, built, and what is kept of the process's state while the block lasts."""
        both = ((problems.registry, self.problem), (optimizers.registry, self.optimizer))
        foreign = [module for registry, name in both for module in asking.foreign_modules(registry, name)]
        with one_thread(), _own_state(foreign) as state:
            pair = asking.made_pair(self.problem, self.problem_options, self.optimizer, self.optimizer_options)
            check_costly(pair.problem, pair.optimizer, inner, replay)
            yield asking.read_asked(
                pair, self.budget, self.repetition, start=self.start, target=self.target, time_limit=self.time_limit,
                inner=inner, replay=replay,
            ), state  # fmt: skip


def _column(name: str, kind: Callable[..., T]) -> T:
    """Return what reads a column of a run's record, of that kind."""
    return cast(T, property(lambda run: getattr(run.record, name)))


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

    run_id = _column("run_id", str)
    """The id that names this run: a digest of what it is."""
    best_value = _column("best_value", float)
    """The best value found; infinite where no finite value was."""
    evaluations = _column("evaluations", int)
    """The number of evaluations."""
    charged = _column("charged", int)
    """Evaluations and `dimension` for each Jacobian."""
    status = _column("status", str)
    """ok, failed or timeout."""
    stop_reason = _column("stop_reason", str)
    """converged, budget, target, failed or timeout."""
    error_type = _column("error_type", str)
    """The class of what a failed run raised; '' where nothing did."""
    error = _column("error", str)
    """Its text."""

    @property
    def best_x(self) -> Array | None:
        """Return the best point found, shape (dim,); None where no finite value was."""
        return None if self.record.best_x is None else np.array(self.record.best_x)

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
        import pandas as pd

        return pd.DataFrame(self.points, columns=["evaluations", "charged", "best_value", "restart"])


def made_or_found(
    ask: Callable[[Cut | None, Callable[[Name | Run, Mirror, int], None]], Run | Cut],
) -> tuple[Run | Cut, str]:
    """Return the run that ``ask(found, hear)`` makes, asked again for its row where it is cut, and what its id is.

    Where that is cut too, or what builds it is, the first cut is returned. The run is followed from when it is named.
    """
    found, known_id = None, ""
    while True:
        draft: Run | None = None
        with ExitStack() as stack:

            def hear(message: Name | Run, counts: Mirror, pid: int, stack: ExitStack = stack) -> None:
                nonlocal draft, known_id
                if isinstance(message, Run):
                    draft = message  # its row, not judged
                else:
                    known_id = message.run_id
                    stack.enter_context(followed(message, counts, pid))

            run = ask(found, hear)
        if not isinstance(run, Cut):
            return run, known_id
        if draft is not None:  # its process ended as the answer was judged: failed, unless the search had failed before
            kind = "TimeoutError" if run.timed_out else run.ending.error_type
            failed: dict[str, Any] = {"status": "failed", "stop_reason": "failed", "error_type": kind}
            lost = Run(replace(draft.record, error=run.ending.error, **failed), draft.points)
            return draft if draft.error_type else lost, known_id
        if found is not None or run.phase == Phase.BUILDING:
            return found or run, known_id
        found = run


def execute(
    problem: Any, optimizer: Any, budget: int, seed: int = 0, *, start: Start | Array | None = None,
    target: float | None = None, problem_name: str | None = None, optimizer_name: str | None = None,
    time_limit: float | None = None, inner: int = 1, replay: ReplayFolder | None = None,
) -> Run:  # fmt: skip
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
        pair = asking.pair_of(problem, optimizer, problem_name, optimizer_name)
        asked = asking.read_asked(
            pair, budget, seed, start=start, target=target, time_limit=time_limit, inner=inner, replay=replay
        )
        check_costly(problem, optimizer, inner, replay)
        if not CAN_FORK or not (time_limit is not None or pair.may_hang):
            return make_run(asked, state, None if time_limit is None else Watch(Mirror(), time_limit))
        return _run_of_object(asked, state, time_limit)


def _run_of_object(asked: Asked, state: Kept | None, time_limit: float | None) -> Run:
    """Make a run in a child forked for it, which has the objects; where that is cut, its row in another."""
    pair = asked.pair
    if not (pair.foreign_problem or pair.foreign_optimizer):  # ours compile here, once for all runs
        pair.compiled = compile_parts(pair.problem, pair.optimizer) is None
    looks(), scans()  # once here, and not in every child
    limit = inf if time_limit is None else time_limit

    def make(found: Cut | None, watch: Watch) -> tuple[Run, bool]:
        if state is None:
            return make_run(asked, None, watch, found), False
        with kept() as own:  # a child has other streams than its parent from the beginning
            return make_run(asked, own, watch, found), False

    run, _ = made_or_found(lambda found, hear: Runner(make).ask(found, limit, hear))
    if isinstance(run, Cut):  # the row of a run that was cut, without a further call of its problem
        gate = Evaluator(pair.problem, asked.budget, start=asked.first, target=asked.target, targets=asked.targets)
        ending = run.restored(gate)
        gate.close()
        row = row_of(asked, gate, Answer(**place_of_answer(pair, gate.best_x)), ending, run.began)
        return Run(row, tuple(gate.trace))
    if state is None:
        return run
    state.note(run.record.process_changes or ())  # and what has been changed here before that
    return Run(replace(run.record, process_changes=state.put_back()), run.points)


@contextmanager
def _own_state(foreign: Sequence[str]) -> Iterator[Kept | None]:
    """Keep what `foreign` modules do in this process from later runs; its global generators begin alike everywhere."""
    if not foreign:
        yield None
        return
    with kept(*foreign) as state, global_generators(_BUILDING):
        yield state


def make_run(asked: Asked, state: Kept | None, watch: Watch | None = None, found: Cut | None = None) -> Run:
    """Make the run that is asked for in this process, and tell `watch` of it. `state`: None without foreign code.

    Where it was `found` cut by its time limit or a crash, there is no search: this is then its row.
    """
    pair, repetition, replay = asked.pair, asked.repetition, asked.replay
    words = pair.problem_word, pair.optimizer_word
    begin: Callable[[], object] = float  # nothing, as our code draws from rng alone
    if state is not None:
        if not any(name in os.environ for name in STATED):  # a BLAS that was loaded since is held at one thread too
            for library in libraries().lib_controllers:
                if library.user_api == "blas" and library.get_num_threads() != 1:
                    library.set_num_threads(1)
        begin = partial(begin_generators, seed_sequence(*words, "shared", repetition=repetition))
    problem, optimizer = pair.problem, pair.optimizer
    foreign = pair.foreign_problem or pair.foreign_optimizer
    if replay is not None and not replay.always and not pair.foreign_problem:
        replay = None  # an evaluation of ours takes microseconds
    if watch is not None:
        watch.enter(Phase.COMPILING, None if foreign else inf)
    broken = None
    if not (pair.compiled or found):
        begin()
        broken = compile_parts(problem, optimizer)
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
        made_in = around(gate, searched, asked.run_id, pair.code, inner=asked.inner, replay=replay, time_limit=limit)
        stall_limit = limits.STALL_LIMIT if pair.may_hang else inf
        clock: Callable[[], object] = float if watch is None else partial(watch.begin, gate, stall_limit)
        with followed(name, gate):
            ending = run_here(optimizer, gate, rng, clock, begin, made_in)
        if gate.stopped == "timeout":
            ending = replace(ending, error=limits.PASSED)
    gate.close()
    ending = with_an_answer(gate, ending)
    if watch is not None:
        watch.enter(Phase.JUDGING, (watch.limit if watch.limit < inf else _PATIENCE) if pair.foreign_problem else inf)
        if pair.foreign_problem and asks(problem):
            draft = row_of(asked, gate, Answer(**place_of_answer(pair, gate.best_x)), ending, began)
            watch.tell(Run(draft, tuple(gate.trace)))
    answer, ending = answer_of(pair, gate.best_x, ending, repetition)
    process_changes = [] if state is None else state.put_back()
    return Run(row_of(asked, gate, answer, ending, began, process_changes), tuple(gate.trace))


_OF_GATE = (
    "evaluations", "batch_evaluations", "residual_evaluations", "jacobian_evaluations", "gradient_evaluations",
    "joint_evaluations", "charged", "non_finite", "non_finite_slopes", "outside_evaluations", "restarts", "best_value",
    "best_evaluation", "targets",
)  # fmt: skip
_OF_ANSWER = (
    "inside_box", "at_bound", "parameter_names", "parameter_values", "parameter_units", "parameter_starts",
    "parameter_truths", "judged_value", "judged_evaluations",
)  # fmt: skip


def row_of(
    asked: Asked, gate: Evaluator, answer: Answer, ending: Ending, began: datetime, process_changes: Sequence[str] = ()
) -> RunRow:
    """Return the row: the request, the gate's counts, the meaning of the answer and how the run ended."""
    pair = asked.pair
    start: Start = "random" if asked.start == "random" else "nominal"
    can_differ = len(asking.repetitions_of(pair.optimizer, start, range(2), is_stochastic(pair.problem))) > 1
    hits, hits_charged = gate.hits, gate.hits_charged  # what each target cost
    if is_stochastic(pair.problem):  # the lowest value seen may be luck: the answer counts, where it was proposed
        value = np.inf if answer.judged_value is None else answer.judged_value
        after = next((point for point in gate.trace if point[0] >= gate.best_evaluation), None)
        derivatives = 0 if after is None else after[1] - after[0]
        reached = [value <= level for level in gate.targets]
        hits = [gate.best_evaluation if hit else None for hit in reached]
        hits_charged = [gate.best_evaluation + derivatives if hit else None for hit in reached]
    stop_reason = stop_reason_of(gate, ending)
    plainly: dict[str, Any] = {name: getattr(gate, name) for name in _OF_GATE}
    plainly |= {**{name: getattr(answer, name) for name in _OF_ANSWER}, **answer.merit}
    return RunRow(
        run_id=asked.run_id, study="",  # known where it is stored
        problem=pair.problem_name, problem_options=pair.problem_options, data_id=pair.data_id,
        dimension=gate.dimension, optimizer=pair.optimizer_name, optimizer_options=pair.optimizer_options,
        **pair.library, repetition=asked.repetition,
        seed=digest(pair.problem_key, pair.optimizer_key, asked.repetition), start=asked.start, budget=asked.budget,
        target=asked.target, **plainly, status=stop_reason if stop_reason in ("failed", "timeout") else "ok",
        stop_reason=stop_reason, error_type=ending.error_type, error=ending.error, traceback=ending.traceback,
        tampering="; ".join(gate.attempts), process_changes=list(process_changes),
        best_x=None if gate.best_x is None else gate.best_x.tolist(), hits=hits,
        hits_charged=hits_charged, unit=pair.unit, minimum=pair.minimum, problem_group=pair.problem_group,
        chance=can_differ, wall_s=ending.wall_s, cpu_s=ending.cpu_s, started_at=began, code_digest=pair.code,
        schema_version=SCHEMA_VERSION, **provenance(),
    )  # fmt: skip


def compile_parts(problem: Any, optimizer: Any) -> Ending | None:
    """Do the work that is not timed; return the ending of a run whose problem or optimiser fails in it."""
    for compile_part in (partial(compile_problem, problem, optimizer), getattr(optimizer, "compile", None)):
        try:
            if compile_part is not None:
                compile_part()
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # SystemExit too
            said = f"{limits.BEFORE}{text_of(error)}"
            return Ending(type(error).__name__, said, 0.0, 0.0, frames_of(error))
    return None


def compile_problem(problem: Any, *optimizers: Any) -> None:
    """Compile what `optimizers` will call; of a problem with `compile_values` the values alone, if they ask no more."""
    if not asks_slopes(optimizers) and extra_of(problem, "compile_values"):
        problem.compile_values()
    elif extra_of(problem, "compile"):
        problem.compile()
    below = None if is_foreign(problem) else extra_of(problem, "batch_below")
    if below and any(getattr(one, "early_abandon", is_foreign(one)) for one in optimizers):
        below(problem.start[None].copy(), np.zeros(1))


def asks_slopes(optimizers: Iterable[Any]) -> bool:
    """Tell whether any of these methods asks for more than values, or does not say so; true too where none is given."""
    traits = [getattr(optimizer, "traits", None) for optimizer in optimizers]
    return not traits or any(
        getattr(one, trait, True) for one in traits for trait in ("uses_residuals", "uses_gradient")
    )


def check_merit(problem: Any) -> Ending | None:
    """Return the ending of a run whose ``merit(x)`` returns what no row can hold, seen at the start; None otherwise.

    It would fail when the budget is spent. What merit raises itself is left to the answer: it may need one.
    """
    if not extra_of(problem, "merit"):
        return None
    try:
        found = problem.merit(np.array(problem.start, dtype=float))
    except KeyboardInterrupt:
        raise
    except BaseException:
        return None
    try:
        merit_of(found)
    except TypeError as error:
        return Ending(type(error).__name__, f"{limits.BEFORE}{error}", 0.0, 0.0)
    return None


def with_an_answer(gate: Evaluator, ending: Ending) -> Ending:
    """Return the ending: a failure where nothing was asked, no value was finite, or the last slopes were not.

    The last: a search that ends by itself by a Jacobian with slopes that were read as 0 has found no minimum.
    """
    if ending.error_type or gate.stopped == "timeout":
        return ending
    if gate.charged == 0:
        why = f": the budget of {gate.budget} is below its first step" if gate.stopped == "budget" else ""
        return replace(ending, error_type="NoEvaluation", error=f"the optimizer made no evaluation{why}")
    if gate.best_x is None:
        said = f"none of {gate.evaluations} values was finite" if gate.evaluations else "no value was asked for"
        return replace(ending, error_type="NoFiniteValue", error=said)
    if gate.unknown_slopes and stop_reason_of(gate, ending) == "converged":
        slopes = counted(gate.unknown_slopes, "slope")
        said = f"it stopped by itself where its last Jacobian had {slopes} not finite, read as 0: that is no minimum"
        return replace(ending, error_type="NonFiniteSlopes", error=said)
    return ending


def stop_reason_of(gate: Evaluator, ending: Ending) -> StopReason:
    """Return failed, or the reason for the end: timeout, target, budget, or converged with budget left."""
    if ending.error_type:
        return "failed"
    return gate.stopped or ("budget" if gate.remaining <= 0 else "converged")
