"""The first damage of a study's tables: what no run can have, with its row and column.

A run is known by many columns that must agree. They are looked through column by column where a table is not as its
store wrote it (`bench.store.tables`), so that who has edited it learns where.
"""

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import pyarrow as pa

from calibench import optimizers, problems
from calibench.bench.gate.endings import STOP_REASONS
from calibench.bench.provenance.run_id import chosen_options, run_id
from calibench.bench.store.arrays import Counts, Flags, cast, compute, index_in, lists_of, numbers
from calibench.core.seeds import digest

Found = tuple[str, Flags, str]  # a column, the rows that are wrong there, and the rule
_OBJECTS = ("problem_options", "optimizer_options", "versions", "merit")
_COUNTS = (
    "dimension", "repetition", "evaluations", "jacobian_evaluations", "charged", "non_finite", "batch_evaluations",
    "residual_evaluations", "restarts", "best_evaluation", "outside_evaluations", "judged_evaluations",
)  # fmt: skip
_OF_EVALUATIONS = ("non_finite", "batch_evaluations", "residual_evaluations", "best_evaluation")
_NEEDED = (
    "problem", "problem_options", "optimizer", "optimizer_options", "status", "best_value", "evaluations", "charged",
    "repetition", "dimension", "best_evaluation", "schema_version",
)  # fmt: skip
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
        (False, rows, _in_both(rows, traces, of)),
    ):
        for column, wrong, rule in found:
            if wrong.any():
                at = int(np.argmax(wrong))
                run, value = str(table["run_id"][at].as_py()), table[column][at].as_py()
                return Damage(in_traces, at + 1, run, column, value, rule)
    return None


def _in_rows(rows: pa.Table) -> Iterator[Found]:
    """Yield for each rule of a row what breaks it; a column that is null says nothing."""
    for name in _NEEDED:
        yield name, _null(rows[name]), "is missing"
    for name in ("problem", "optimizer"):
        yield name, _texts(rows[name], lambda text: text == ""), "is empty"
    yield "run_id", _texts(rows["run_id"], lambda text: not _DIGITS.fullmatch(text)), "is no id: 16 digits of 0-9a-f"
    for name in _OBJECTS:
        yield name, _texts(rows[name], _is_no_object), "is no JSON object"
    counts = {name: numbers(rows[name]).astype(np.int64) for name in (*_COUNTS, "budget")}
    for name in _COUNTS:
        yield name, counts[name] < 0, "is a count, and below 0"
    evaluations, charged, dimension = counts["evaluations"], counts["charged"], counts["dimension"]
    paid = evaluations + dimension * counts["jacobian_evaluations"]
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
    unnamed = _texts(rows["error_type"], lambda text: text == "", null=True)
    yield "error_type", failed == unnamed, "does not agree with the status"
    yield "start", _texts(rows["start"], lambda text: text not in _STARTS), "is none of nominal, random, given"
    for name in ("wall_s", "cpu_s"):
        yield name, numbers(rows[name], 0.0) < 0, "is a time, and below 0"
    best = numbers(rows["best_value"])
    yield "best_value", np.isnan(best) | (best == -np.inf), "is no value"
    answered, ours = counts["best_evaluation"] > 0, ~_null(rows["code_digest"])
    yield "best_evaluation", ours & (np.isfinite(best) != answered), "does not agree with best_value: 0 is of none"

    x, targets = lists_of(rows["best_x"]), lists_of(rows["targets"])
    yield "best_x", ~_null(rows["best_x"]) & (x.count != dimension), "has not as many numbers as dimension says"
    yield "best_x", _any(x.row, ~np.isfinite(x.flat), len(rows)), "has a number that is not finite"
    names = [f"parameter_{name}" for name in ("names", "values", "units", "starts", "truths")]
    named, *others = (numbers(compute("list_value_length", rows[name].combine_chunks()), -1) for name in names)
    for name, length in zip(names[1:], others, strict=True):
        yield name, (length >= 0) & (length != named), "has not as many entries as parameter_names"
    falls = np.diff(targets.flat) <= 0
    rises = np.append(~falls & (np.diff(targets.row) == 0), np.zeros(min(1, len(targets.flat)), dtype=bool))
    yield "targets", _any(targets.row, rises, len(rows)), "does not fall"
    for name, most in (("hits", evaluations), ("hits_charged", charged)):
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
    evaluations, charged, restart, best = (
        numbers(traces[name]) for name in ("evaluations", "charged", "restart", "best_value")
    )
    begins = np.flatnonzero(np.diff(run, prepend=-1))
    again = np.zeros(len(run), dtype=bool)
    again[begins] = True
    again[begins[np.unique(run[begins], return_index=True)[1]]] = False
    yield "run_id", again, "has a second trace"
    inside = np.diff(run, prepend=-1) == 0
    for name, values in (("evaluations", evaluations), ("charged", charged), ("restart", restart)):
        yield name, inside & (np.diff(values, prepend=0) < 0), "is below that of the point before"
    yield "charged", charged < evaluations, "is too small"
    yield "restart", restart < 0, "is too small"
    yield "evaluations", evaluations < 0, "is too small"
    yield "best_value", np.isnan(best), "is no value"
    with np.errstate(invalid="ignore"):
        yield "best_value", inside & (best > np.append(np.inf, best[:-1])[: len(best)]), "rises"


def _in_both(rows: pa.Table, traces: pa.Table, of: pa.ChunkedArray) -> Iterator[Found]:
    """Yield what differs between a row and the last point of its trace, and the ids and seeds that are not its own."""
    run = numbers(of).astype(np.int64)
    last = np.full(len(rows), -1)
    last[run] = np.arange(len(run))
    has = last >= 0
    yield "evaluations", ~has & (numbers(rows["evaluations"]) > 0), "has no trace in traces.parquet"
    ours = has & ~_null(rows["code_digest"])  # published values may be rounded
    for name in ("evaluations", "charged", "best_value"):
        end, said = np.full(len(rows), -1.0), numbers(rows[name]).astype(float)
        end[has] = numbers(traces[name])[last[has]]
        differs = end > said if name == "charged" else end != said  # a Jacobian may come after the last value
        yield name, ours & differs, "is not that of the last point of its trace"

    # the runs whose id, or seed, is not the digest of what they are, where that is known here
    names = ("problem", "problem_options", "data_id", "optimizer", "optimizer_options", "repetition", "seed")
    columns = [rows[name].to_pylist() for name in (*names, "run_id", "budget", "start", "target")]
    keys: dict[tuple[bool, str, str], list[Any] | None] = {}
    wrong: dict[str, list[bool]] = {"run_id": [], "seed": []}
    for problem, its, data, optimizer, options, repetition, seed, known_id, budget, start, target in zip(
        *columns, strict=True
    ):
        for key in ((True, problem, its), (False, optimizer, options)):
            registry: Any = problems.registry if key[0] else optimizers.registry
            _, name, text = key
            if key not in keys:  # name and options as an id has them; not of a name that is neither ours nor a class
                known = name in registry or ":" in name
                keys[key] = [name, chosen_options(registry, name, json.loads(text))] if known else None
        mine, method = keys[True, problem, its], keys[False, optimizer, options]
        is_known = mine is not None and method is not None and bool(seed)
        pair = ([*mine, data], method) if mine is not None else ([], method)
        wrong["seed"].append(is_known and digest(*pair, repetition) != seed)
        by_name = is_known and start in ("nominal", "random")
        wrong["run_id"].append(by_name and run_id(*pair, budget, repetition, start, target) != known_id)
    for name, flags in wrong.items():
        yield name, np.array(flags, dtype=bool), f"is not the digest of {_IDENTITY}"


def _texts(column: pa.ChunkedArray, is_wrong: Callable[[str], bool], null: bool = False) -> Flags:
    """Tell for each text whether it is wrong, each different one looked at once; `null` for what is missing."""
    coded = compute("dictionary_encode", column).unify_dictionaries().combine_chunks()
    flags = np.array([*(is_wrong(text) for text in coded.dictionary.to_pylist()), null], dtype=bool)
    found: Flags = flags[numbers(cast(coded.indices, pa.int64()), len(flags) - 1)]
    return found


def _is_no_object(text: str) -> bool:
    try:
        return not isinstance(json.loads(text), dict)
    except (ValueError, RecursionError):
        return True


def _null(column: pa.ChunkedArray) -> Flags:
    found: Flags = np.asarray(column.is_null().to_numpy(zero_copy_only=False)) if len(column) else np.zeros(0, bool)
    return found


def _any(of: Counts, flags: Flags, count: int) -> Flags:
    """Tell for each of `count` rows whether one of its entries is flagged."""
    return np.bincount(of[flags], minlength=count).astype(bool)
