"""A row of ``runs.parquet``: every column is declared here, once, with its type and its meaning.

Execution makes a `RunRow`, `bench.store.arrays` makes the Arrow schema of it, and a test holds the list of columns in
``docs/results.md`` to it. A field that may be None is null where a run, or a published one, has no such value.
"""

from dataclasses import dataclass
from datetime import datetime
from types import NoneType
from typing import Annotated, Any, Literal, final, get_args, get_origin, get_type_hints

from calibench.bench.gate.endings import STOP_REASONS

SCHEMA_VERSION = 3

Group = Literal["identity", "cost", "ending", "answer", "merit", "targets", "code", "origin"]
_PARQUET = {str: "string", int: "int64", float: "double", bool: "bool", datetime: "timestamp[us, tz=UTC]"}


@final
@dataclass(frozen=True)
class Says:
    """Metadata of a column besides its name and type."""

    group: Group
    meaning: str


@final
@dataclass(frozen=True, kw_only=True)
class RunRow:
    """One run as a row, its fields in the order of the columns. None is null: this run has no such value."""

    run_id: Annotated[str, Says("identity", "digest of what the run is: the same run, the same id")]
    study: Annotated[str, Says("identity", "the folder it is kept in; empty before it is stored")]
    problem: Annotated[str, Says("identity", "name in the registry, or where the class stands")]
    problem_options: Annotated[str, Says("identity", "all its options, as JSON")]
    data_id: Annotated[str, Says("identity", "digest of the readings; empty where there are none")]
    dimension: Annotated[int, Says("identity", "coordinates searched")]
    optimizer: Annotated[str, Says("identity", "name in the registry, or where the class stands")]
    optimizer_options: Annotated[str, Says("identity", "all its options, as JSON")]
    library: Annotated[str, Says("identity", "package whose code searches")]
    library_version: Annotated[str, Says("identity", "its version; empty where it is not installed as a package")]
    repetition: Annotated[int, Says("identity", "which of the seeds, from 0")]
    seed: Annotated[str, Says("identity", "digest of problem, optimizer and repetition")]
    start: Annotated[str, Says("identity", "nominal, random, or given")]
    budget: Annotated[int, Says("identity", "the most that may be charged")]
    target: Annotated[float | None, Says("identity", "value that ends the run; null: none")]
    evaluations: Annotated[int, Says("cost", "passes over all samples, however they were used")]
    jacobian_evaluations: Annotated[int, Says("cost", "derivatives of the residuals or of the value")]
    charged: Annotated[int, Says("cost", "evaluations + dimension x jacobian_evaluations")]
    non_finite: Annotated[int, Says("cost", "values that were not finite")]
    batch_evaluations: Annotated[int | None, Says("cost", "of the evaluations those in batches")]
    residual_evaluations: Annotated[int | None, Says("cost", "of the evaluations those of residuals")]
    restarts: Annotated[int, Says("cost", "how often the optimizer began again")]
    status: Annotated[str, Says("ending", "ok, failed or timeout")]
    stop_reason: Annotated[str, Says("ending", f"{', '.join(STOP_REASONS[:-1])} or {STOP_REASONS[-1]}")]
    error_type: Annotated[str, Says("ending", "class of the exception; empty: none")]
    error: Annotated[str, Says("ending", "its text")]
    best_value: Annotated[float, Says("answer", "lowest value seen; infinite where none was finite")]
    best_evaluation: Annotated[int, Says("answer", "evaluation that gave it; 0: none")]
    best_x: Annotated[list[float] | None, Says("answer", "its coordinates as searched; null where there is none")]
    inside_box: Annotated[bool, Says("answer", "whether lower <= best_x <= upper")]
    at_bound: Annotated[list[str], Says("answer", "coordinates that ended at a bound")]
    parameter_names: Annotated[list[str] | None, Says("answer", "physical parameters; null without an answer")]
    parameter_values: Annotated[list[float] | None, Says("answer", "their values [mm, rad]")]
    gauge_phi: Annotated[
        float | None, Says("merit", "move along the gauge that brings the answer next to the truth [rad]")
    ]
    kmrmse: Annotated[float | None, Says("merit", "rms position error of the calibrated machine [mm]")]
    kmrmse_aligned: Annotated[float | None, Says("merit", "the same after that move [mm]")]
    parameter_error_mm: Annotated[float | None, Says("merit", "largest error of a length [mm]")]
    parameter_error_rad: Annotated[float | None, Says("merit", "largest error of an angle [rad]")]
    parameter_error_mm_aligned: Annotated[float | None, Says("merit", "largest error of a length after that move [mm]")]
    parameter_error_rad_aligned: Annotated[
        float | None, Says("merit", "largest error of an angle after that move [rad]")
    ]
    targets: Annotated[list[float], Says("targets", "levels, largest first")]
    hits: Annotated[list[int | None], Says("targets", "evaluations at which each was reached; null: never")]
    hits_charged: Annotated[list[int | None], Says("targets", "the same in charged evaluations")]
    wall_s: Annotated[float, Says("cost", "time of the search, compilation left out [s]")]
    cpu_s: Annotated[float, Says("cost", "time of the processor [s]")]
    git_commit: Annotated[str, Says("origin", "commit of this package's checkout; empty: none")]
    git_dirty: Annotated[bool, Says("origin", "whether tracked files differed from it")]
    versions: Annotated[str, Says("origin", "versions of Python and the packages, as JSON")]
    platform: Annotated[str, Says("origin", "operating system and processor")]
    started_at: Annotated[datetime, Says("origin", "when the search began, UTC")]
    schema_version: Annotated[int, Says("origin", "version of these columns")]
    code_digest: Annotated[str | None, Says("code", "digests of the code that ran: problem.optimizer.gate")]
    traceback: Annotated[str | None, Says("ending", "last frames of the error")]
    merit: Annotated[str | None, Says("merit", "figures of merit that have no column, as JSON")]
    unit: Annotated[str | None, Says("answer", "unit of the value; empty: not said")]
    minimum: Annotated[float | None, Says("answer", "least value that the problem declares; null: none")]
    judged_value: Annotated[float | None, Says("answer", "value of the answer without noise; null: no noise")]
    judged_evaluations: Annotated[int | None, Says("answer", "fresh evaluations that judged it; 0: exact")]
    outside_evaluations: Annotated[
        int | None, Says("cost", "those outside the box or not finite; null: known not to ask for any")
    ]
    tampering: Annotated[str | None, Says("ending", "what the optimizer tried at the gate; empty: nothing")]
    problem_group: Annotated[str | None, Says("identity", "group of the suite that the problem declares; empty: none")]
    parameter_units: Annotated[
        list[str] | None, Says("answer", "units of the parameters; null where the problem declares none")
    ]
    parameter_starts: Annotated[list[float] | None, Says("answer", "their values at the start")]
    parameter_truths: Annotated[list[float | None] | None, Says("answer", "their true values; null: not known")]
    chance: Annotated[bool | None, Says("identity", "whether another repetition can differ; null: not known")]
    non_finite_slopes: Annotated[
        int | None, Says("cost", "entries of gradients and Jacobians that were not finite, and read as 0")
    ]
    process_changes: Annotated[
        list[str] | None, Says("ending", "what the run changed in its process, and was put back")
    ]
    gradient_evaluations: Annotated[int | None, Says("cost", "of the jacobian_evaluations those of the value")]
    joint_evaluations: Annotated[int | None, Says("cost", "of the evaluations those that gave their gradient too")]


@final
@dataclass(frozen=True)
class Column:
    """A column of ``runs.parquet``: `parquet` is its Arrow type by name."""

    name: str
    parquet: str
    group: Group
    meaning: str


def _parquet_type(kind: Any) -> str:
    """Return the name of the Arrow type for values of this Python type; a value, or an item of a list, may be None.

    >>> _parquet_type(float | None), _parquet_type(list[int | None])
    ('double', 'list<int64>')
    """
    if get_origin(kind) is list:
        return f"list<{_parquet_type(get_args(kind)[0])}>"
    if kind in _PARQUET:
        return _PARQUET[kind]
    (known,) = (part for part in get_args(kind) if part is not NoneType)
    return _parquet_type(known)


_DECLARED = {name: get_args(hint) for name, hint in get_type_hints(RunRow, include_extras=True).items()}
COLUMNS = tuple(Column(name, _parquet_type(kind), says.group, says.meaning) for name, (kind, says) in _DECLARED.items())
