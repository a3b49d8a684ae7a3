"""One run: a problem, an optimiser, a budget and a repetition make one row, whatever happens.

Converged, exhausted, on target or crashed: the row says which. Compilation happens before the clock starts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING, Any, final

import numpy as np

from calibench.bench.execution.answer import Answer, answer_of, judged_apart
from calibench.bench.execution.costly import ReplayFolder, around, check_inner, check_replay
from calibench.bench.execution.in_progress.progress import followed
from calibench.bench.execution.outcome import check_merit, compile_parts, with_an_answer
from calibench.bench.execution.request.asked import Asked, read_asked
from calibench.bench.execution.request.checks import Array, Start
from calibench.bench.execution.request.pair import built_by_foreign, made_pair, pair_of
from calibench.bench.execution.row_of import row_of
from calibench.bench.execution.run_row import RunRow
from calibench.bench.execution.stochastic import seeded
from calibench.bench.gate.evaluator import Evaluator, TracePoint
from calibench.bench.gate.guard.foreign_code import is_foreign
from calibench.bench.gate.guard.private_class import private_evaluator
from calibench.bench.gate.time_limit import STALL_LIMIT, Ending, run_here, run_watched
from calibench.bench.provenance.run_id import seed_sequence
from calibench.core.html_table import html_table
from calibench.core.one_thread import hold_new, one_thread
from calibench.core.own_state import Kept, kept
from calibench.core.seeds import begin_generators, global_generators

if TYPE_CHECKING:
    import pandas as pd

_BUILDING = seed_sequence("building", repetition=0)


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

    def execute(self, *, inner: int = 1, replay: ReplayFolder | None = None) -> Run:
        """Build problem and optimiser and run them; neither `inner` nor `replay` changes what the run is."""
        with one_thread(), _own_state(built_by_foreign(self.problem, self.optimizer)) as state:
            pair = made_pair(self.problem, self.problem_options, self.optimizer, self.optimizer_options)
            asked = read_asked(
                pair, self.budget, self.repetition, start=self.start, target=self.target, time_limit=self.time_limit
            )
            return _run(asked, self.time_limit, inner, replay, state)


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
        told, unit = self.record, f" {self.record.unit}" if self.record.unit else ""
        why = f": {told.error_type} {told.error}" if told.error_type or told.error else ""
        return (
            f"<run {told.run_id} of {told.optimizer} on {told.problem}: {told.charged} of {told.budget} charged, "
            f"best {told.best_value:.6g}{unit}, {told.status} ({told.stop_reason}){why}>"
        )

    def _repr_html_(self) -> str:
        """Return the run and its answer, as a notebook shows them."""
        told = self.record
        values = told.best_x or [] if told.parameter_values is None else told.parameter_values
        names = told.parameter_names or [f"x{i}" for i in range(len(values))]
        return html_table(repr(self).strip("<>"), ("parameter", "value"), list(zip(names, values)))

    @property
    def trace(self) -> pd.DataFrame:
        """Return the best value over evaluations: columns evaluations, charged, best_value, restart."""
        import pandas as pd

        return pd.DataFrame(self.points, columns=["evaluations", "charged", "best_value", "restart"])


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
        return _run(asked, time_limit, inner, replay, state)


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


def _run(asked: Asked, time_limit: float | None, inner: int, replay: ReplayFolder | None, state: Kept | None) -> Run:
    """Make the run that is asked for; `state` is that of the process before, where foreign code takes part."""
    pair, repetition = asked.pair, asked.repetition
    words = pair.problem_word, pair.optimizer_word
    begin: Callable[[], object] = float  # nothing, as our code draws from rng alone
    if state is not None:
        hold_new()
        begin = partial(begin_generators, seed_sequence(*words, "shared", repetition=repetition))
    problem, optimizer = pair.problem, pair.optimizer
    check_inner(problem, optimizer, inner)
    check_replay(problem, replay)
    if replay is not None and not replay.always and not pair.foreign_problem:
        replay = None  # an evaluation of ours takes microseconds
    may_hang = getattr(getattr(optimizer, "traits", None), "may_hang", False)
    watched = time_limit is not None or may_hang
    apart = watched and (pair.foreign_problem or pair.foreign_optimizer)  # ours compile here, once for all runs
    broken = None if apart or pair.compiled else _compile(problem, optimizer, begin)
    if not (apart or pair.compiled or broken) and pair.foreign_problem:
        broken = check_merit(problem)
    pair.compiled = pair.compiled or (not apart and broken is None)
    again = partial(seed_sequence, pair.problem_word, "restart", repetition=repetition)  # paired across optimisers
    searched = seeded(problem, pair.problem_word, repetition)
    gate = (private_evaluator() if pair.foreign_optimizer else Evaluator)(
        searched, asked.budget, start=asked.first, target=asked.target, targets=asked.targets, restart_seed=again
    )
    made_in = around(gate, searched, asked.run_id, pair.code, inner=inner, replay=replay, time_limit=time_limit)
    made_in = _begun(begin, made_in)
    rng = np.random.default_rng(seed_sequence(*words, repetition=repetition))
    judge = judged_apart if watched and pair.foreign_problem else answer_of

    def answered(ending: Ending) -> tuple[Answer, Ending]:
        gate.close()
        return judge(pair, gate.best_x, with_an_answer(gate, ending), repetition, time_limit)

    began = datetime.now(UTC)
    with followed(asked, gate) as goes_on:
        if broken is not None:
            answer, ending = answered(broken)
        elif not watched:
            answer, ending = answered(run_here(optimizer, gate, rng, problem, around=made_in))
        else:
            stall_limit = STALL_LIMIT if may_hang else None
            first = partial(_compile, problem, optimizer, begin) if apart else lambda: None
            asked_for = optimizer, gate, rng, time_limit, stall_limit, problem, first, made_in, goes_on
            if pair.foreign_problem:
                answer, ending = run_watched(*asked_for, last=answered)
            else:
                answer, ending = answered(run_watched(*asked_for, last=lambda ending: ending))
    gate.close()
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
