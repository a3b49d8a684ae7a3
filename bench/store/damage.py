"""The first damage of a study's tables: what no run can have, with its row and column.

A run is known by many columns that must agree. They are looked through column by column where a table is not as its
store wrote it (`bench.store.tables`), so that who has edited it learns where.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from calibench import optimizers, problems
from calibench.bench.gate.endings import STOP_REASONS
from calibench.bench.provenance.run_id import chosen_options, run_id
from calibench.bench.store.arrays import cast, dictionary_encode, index_in, list_value_length, lists_of, numbers
from calibench.core.registry import Registry
from calibench.core.seeds import digest

Flags = NDArray[np.bool_]
Found = tuple[str, Flags, str]  # a column, the rows that are wrong there, and the rule
_OBJECTS = ("problem_options", "optimizer_options", "versions", "merit")
_COUNTS = (
    "dimension", "repetition", "evaluations", "jacobian_evaluations", "charged", "non_finite", "batch_evaluations",
    "residual_evaluations", "restarts", "best_evaluation", "outside_evaluations", "judged_evaluations",
)  # fmt: skip
_OF_EVALUATIONS = ("non_finite", "batch_evaluations", "residual_evaluations", "best_evaluation")
_NEEDED = ("problem", "problem_options", "optimizer", "optimizer_options", "status", "best_value", "evaluations")
_NEEDED_COUNTS = ("charged", "repetition", "dimension", "best_evaluation", "schema_version")
_STARTS = ("nominal", "random", "given", "")  # "": of a run that was lost before it was known
_ENDINGS: dict[str, set[str]] = {
    "ok": {reason for reason in STOP_REASONS if reason not in ("failed", "timeout")},
    "failed": {"failed"},
    "timeout": {"timeout"},
}
_IDENTITY = "the row's problem, optimizer, their options, data, budget, repetition, start and target"
_DIGITS = re.compile(r"[0-9a-f]{16}")


@final
@dataclass(frozen=True)
class Damage:
    """A wrong value: whether it is in the traces, its row from 1, the run and the column, the value, and the rule."""

    in_traces: bool
    row: int
    run: str
    column: str
    value: Any
    rule: str


def first_damage(rows: pa.Table, traces: pa.Table) -> Damage | None:
    """Return what is wrong in the rows, or else in the traces."""
    of = index_in(traces["run_id"], rows["run_id"].combine_chunks())
    for in_traces, table, found in (
        (False, rows, _in_rows(rows)),
        (True, traces, _in_traces(traces, of)),
        (False, rows, _in_ends(rows, traces, of)),
        (False, rows, _in_identity(rows)),
    ):
        for column, wrong, rule in found:
            if wrong.any():
                at = int(np.argmax(wrong))
                run, value = str(table["run_id"][at].as_py()), table[column][at].as_py()
                return Damage(in_traces, at + 1, run, column, value, rule)
    return None


def _in_rows(rows: pa.Table) -> Iterator[Found]:
    """Yield for each rule of a row what breaks it; a column that is null says nothing."""
    for name in (*_NEEDED, *_NEEDED_COUNTS):
        yield name, _null(rows[name]), "is missing"
    for name in ("problem", "optimizer"):
        yield name, _texts(rows[name], _is_empty), "is empty"
    yield "run_id", _texts(rows["run_id"], lambda text: not _DIGITS.fullmatch(text)), "is no id: 16 digits of 0-9a-f"
    for name in _OBJECTS:
        yield name, _texts(rows[name], _is_no_object), "is no JSON object"
    counts = {name: numbers(rows[name]).astype(np.int64) for name in (*_COUNTS, "budget")}
    for name in _COUNTS:
        yield name, counts[name] < 0, "is a count, and below 0"
    evaluations, charged = counts["evaluations"], counts["charged"]
    paid = evaluations + counts["dimension"] * counts["jacobian_evaluations"]
    yield "charged", charged != paid, "is not evaluations + dimension x jacobian_evaluations"
    yield "budget", ~_null(rows["budget"]) & (counts["budget"] < 1), "is no budget"
    yield "charged", ~_null(rows["budget"]) & (charged > counts["budget"]), "is above the budget"
    for name in _OF_EVALUATIONS:
        yield name, counts[name] > evaluations, "is above evaluations"
    yield "status", _texts(rows["status"], lambda text: text not in _ENDINGS), f"is none of {', '.join(_ENDINGS)}"
    reasons = _texts(rows["stop_reason"], lambda text: text not in STOP_REASONS)
    yield "stop_reason", reasons, f"is none of {', '.join(STOP_REASONS)}"
    status, reason = rows["status"].to_pylist(), rows["stop_reason"].to_pylist()
    ends = [said is not None and said not in _ENDINGS[how] for how, said in zip(status, reason, strict=True)]
    yield "stop_reason", np.array(ends, dtype=bool), "does not agree with the status"
    failed = np.array([how == "failed" for how in status], dtype=bool)
    yield "error_type", failed != ~_texts(rows["error_type"], _is_empty, null=True), "does not agree with the status"
    yield "start", _texts(rows["start"], lambda text: text not in _STARTS), "is none of nominal, random, given"
    for name in ("wall_s", "cpu_s"):
        yield name, numbers(rows[name], 0.0) < 0, "is a time, and below 0"
    best = numbers(rows["best_value"])
    yield "best_value", np.isnan(best) | (best == -np.inf), "is no value"
    answered, ours = counts["best_evaluation"] > 0, ~_null(rows["code_digest"])
    yield "best_evaluation", ours & (np.isfinite(best) != answered), "does not agree with best_value: 0 is of none"
    yield from _in_lists(rows, counts, best)


def _in_lists(rows: pa.Table, counts: dict[str, NDArray[np.int64]], best: NDArray[np.float64]) -> Iterator[Found]:
    """Yield likewise what breaks the rules of lists: their lengths, their order, what they may hold."""
    x, targets = lists_of(rows["best_x"]), lists_of(rows["targets"])
    said = ~_null(rows["best_x"])
    yield "best_x", said & (x.count != counts["dimension"]), "has not as many numbers as dimension says"
    yield "best_x", _any(x.row, ~np.isfinite(x.flat), len(rows)), "has a number that is not finite"
    length = _lengths(rows["parameter_names"])
    for name in ("parameter_values", "parameter_units", "parameter_starts", "parameter_truths"):
        own = _lengths(rows[name])
        yield name, (own >= 0) & (own != length), "has not as many entries as parameter_names"
    falls = np.diff(targets.flat) <= 0
    rises = np.append(~falls & (np.diff(targets.row) == 0), np.zeros(min(1, len(targets.flat)), dtype=bool))
    yield "targets", _any(targets.row, rises, len(rows)), "does not fall"
    for name, most in (("hits", counts["evaluations"]), ("hits_charged", counts["charged"])):
        hits = lists_of(rows[name])
        yield name, hits.count != targets.count, "has not as many entries as targets"
        with np.errstate(invalid="ignore"):
            outside = (hits.flat < 1) | (hits.flat > most[hits.row])
        yield name, _any(hits.row, outside, len(rows)), "has a count that the run never came to"


def _in_traces(traces: pa.Table, of: pa.ChunkedArray) -> Iterator[Found]:
    """Yield what breaks the rules of points, `of` these rows: one trace a run, its counts rise, its values fall."""
    for name in traces.column_names:
        yield name, _null(traces[name]), "is missing"
    yield "run_id", _null(of), "is of no run in runs.parquet"
    run = numbers(of).astype(np.int64)
    evaluations, charged, restart = (numbers(traces[name]) for name in ("evaluations", "charged", "restart"))
    best = numbers(traces["best_value"])
    begins = np.flatnonzero(np.diff(run, prepend=-1))
    again = np.zeros(len(run), dtype=bool)
    again[begins] = True
    again[begins[np.unique(run[begins], return_index=True)[1]]] = False
    yield "run_id", again, "has a second trace"
    inside = np.diff(run, prepend=-1) == 0
    for name, values in (("evaluations", evaluations), ("charged", charged), ("restart", restart)):
        yield name, inside & (np.diff(values, prepend=0) < 0), "is below that of the point before"
    for name, values, least in (
        ("charged", charged, evaluations),
        ("restart", restart, 0),
        ("evaluations", evaluations, 0),
    ):
        yield name, values < least, "is too small"
    yield "best_value", np.isnan(best), "is no value"
    with np.errstate(invalid="ignore"):
        yield "best_value", inside & (best > np.append(np.inf, best[:-1])[: len(best)]), "rises"


def _in_ends(rows: pa.Table, traces: pa.Table, of: pa.ChunkedArray) -> Iterator[Found]:
    """Yield what differs between a row and the last point of its trace; of published data values may be rounded."""
    run = numbers(of).astype(np.int64)
    last = np.full(len(rows), -1)
    last[run] = np.arange(len(run))
    has = last >= 0
    evaluations = numbers(rows["evaluations"])
    yield "evaluations", ~has & (evaluations > 0), "has no trace in traces.parquet"
    ours = has & ~_null(rows["code_digest"])
    for name in ("evaluations", "charged", "best_value"):
        end, said = np.full(len(rows), -1.0), numbers(rows[name]).astype(float)
        end[has] = numbers(traces[name])[last[has]]
        differs = end > said if name == "charged" else end != said  # a Jacobian may come after the last value
        yield name, ours & differs, "is not that of the last point of its trace"


def _in_identity(rows: pa.Table) -> Iterator[Found]:
    """Yield the runs whose id, or seed, is not the digest of what they are, where that is known here.

    It is not of published data, of a run that was lost before it was known, of a name that no registry here has; and
    the row does not hold a start of one's own.
    """
    names = ("problem", "problem_options", "data_id", "optimizer", "optimizer_options", "repetition", "seed")
    columns = [rows[name].to_pylist() for name in (*names, "run_id", "budget", "start", "target")]
    keys: dict[tuple[str, str, str], list[Any] | None] = {}
    wrong: dict[str, list[bool]] = {"run_id": [], "seed": []}
    for problem, its, data, optimizer, options, repetition, seed, known_id, budget, start, target in zip(
        *columns, strict=True
    ):
        for key in ((problem, its, data), (optimizer, options, "")):
            if key not in keys:
                of: Registry[Any] = problems.registry if key[0] is problem else optimizers.registry
                keys[key] = _key(of, key[0], key[1])
        mine, method = keys[problem, its, data], keys[optimizer, options, ""]
        known = mine is not None and method is not None and bool(seed)
        pair = ([*mine, data], method) if mine is not None else ([], method)
        wrong["seed"].append(known and digest(*pair, repetition) != seed)
        by_name = known and start in ("nominal", "random")
        wrong["run_id"].append(by_name and run_id(*pair, budget, repetition, start, target) != known_id)
    for name, flags in wrong.items():
        yield name, np.array(flags, dtype=bool), f"is not the digest of {_IDENTITY}"


def _key(registry: Registry[Any], name: str, options: str) -> list[Any] | None:
    """Return name and options as an id has them; None of a name that is neither registered nor the place of a class."""
    if name not in registry and ":" not in name:
        return None
    return [name, chosen_options(registry, name, json.loads(options))]


def _texts(column: pa.ChunkedArray, is_wrong: Callable[[str], bool], null: bool = False) -> Flags:
    """Tell for each text whether it is wrong, each different one looked at once; `null` for what is missing."""
    coded = dictionary_encode(column).unify_dictionaries().combine_chunks()
    flags = np.array([*(is_wrong(text) for text in coded.dictionary.to_pylist()), null], dtype=bool)
    codes = numbers(cast(coded.indices, pa.int64()), len(flags) - 1)
    found: Flags = flags[codes]
    return found


def _is_no_object(text: str) -> bool:
    try:
        return not isinstance(json.loads(text), dict)
    except (ValueError, RecursionError):
        return True


def _is_empty(text: str) -> bool:
    return text == ""


def _null(column: pa.ChunkedArray) -> Flags:
    found: Flags = np.asarray(column.is_null().to_numpy(zero_copy_only=False)) if len(column) else np.zeros(0, bool)
    return found


def _lengths(column: pa.ChunkedArray) -> NDArray[np.int64]:
    """Return the length of each list, -1 of a missing one."""
    return numbers(list_value_length(column.combine_chunks()), -1).astype(np.int64)


def _any(of: NDArray[np.int64], flags: Flags, count: int) -> Flags:
    """Tell for each of `count` rows whether one of its entries is flagged."""
    return np.bincount(of[flags], minlength=count).astype(bool)
