"""The meaning of the best point of a run: its place in the box, physical parameters, merit, judged value.

Figures of merit of the machines have columns of their own; all others of a problem are JSON in the one text column
`merit`, so that the columns are the same for every problem. `offered` makes number columns ``merit.KEY`` of them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from calibench.bench.execution.request import Pair, is_stochastic, judged
from calibench.bench.execution.run_row import COLUMNS
from calibench.bench.gate.endings import frames_of, text_of
from calibench.bench.gate.time_limit import JUDGING, Ending
from calibench.core import own_state
from calibench.core.seeds import begin_generators, seed_sequence
from calibench.problems.base import extra_of

if TYPE_CHECKING:
    import pandas as pd

_OTHERS = "merit"  # the column of all that has none of its own
NO_MERIT: Mapping[str, Any] = dict.fromkeys(column.name for column in COLUMNS if column.group == "merit")
PREFIX = "merit."
_INFINITE = ("inf", "-inf")


def merit_of(found: Any) -> dict[str, Any]:
    """Return the result of ``merit(x)`` as columns of a row; raise `TypeError` for what is no number, flag or text.

    A number that is not finite is null there, as JSON has none; of the others an infinite one is its text.
    """
    if not isinstance(found, Mapping):
        raise TypeError(f"merit(x) returned {type(found).__name__}: names and numbers are needed, {{name: number}}")
    columns = dict(NO_MERIT)
    others: dict[str, Any] = {}
    for key, given in found.items():
        value = given
        if key in columns and key != _OTHERS:
            try:
                columns[key] = None if value is None else float(value)
            except (TypeError, ValueError):
                raise TypeError(
                    f"merit(x) gave {key}={value!r:.60}: a number is needed, as a column of that name has"
                ) from None
            continue
        if isinstance(value, np.ndarray | np.generic):
            value = value.item() if np.size(value) == 1 else value.tolist()
        if isinstance(value, float) and not np.isfinite(value):
            value = None if np.isnan(value) else str(value)
        if value is not None and not isinstance(value, str | bool | int | float):
            raise TypeError(f"merit(x) gave {key}={value!r:.60}: a number, True or False, or text is needed")
        others[str(key)] = value
    columns[_OTHERS] = json.dumps(others, sort_keys=True, ensure_ascii=False) if others else None
    return columns


def offered(runs: pd.DataFrame) -> pd.DataFrame:
    """Return `runs` with a column ``merit.KEY`` for each key of their column `merit`: flags, floats, or text."""
    import pandas as pd

    texts = runs["merit"].dropna()
    if texts.empty:
        return runs
    read = {index: json.loads(text) for index, text in texts.items()}
    columns = {}
    for key in dict.fromkeys(key for each in read.values() for key in each):
        values = [read.get(index, {}).get(key) for index in runs.index]
        known = [value for value in values if value is not None]
        if all(value in _INFINITE or type(value) in (int, float) for value in known):
            values = [float(value) if value in _INFINITE else value for value in values]
            known = [value for value in values if value is not None]
        if known and all(isinstance(value, bool) for value in known):
            column = pd.Series(values, runs.index, dtype="boolean")
        elif all(isinstance(value, int | float) for value in known):
            column = pd.Series([np.nan if v is None else float(v) for v in values], runs.index, dtype=float)
        else:
            column = pd.Series([None if v is None else str(v) for v in values], runs.index, dtype="str")
        columns[PREFIX + key] = column
    return pd.concat([runs, pd.DataFrame(columns)], axis=1)


def heading(key: str) -> str:
    """Return the title of a column of figures of merit of a cell (`bench.statistics.summary`).

    >>> heading("merit.overshoot_median"), heading("merit.stable_share")
    ('overshoot, median', 'stable, share')
    """
    name, _, what = key.removeprefix(PREFIX).rpartition("_")
    return f"{name}, {what}"


Array = NDArray[np.float64]


@final
@dataclass(frozen=True)
class Answer:
    """The best point as the problem reads it; for a run without one all fields are empty."""

    inside_box: bool = False
    at_bound: list[str] = field(default_factory=list)
    parameter_names: list[str] | None = None
    parameter_values: list[float] | None = None
    parameter_units: list[str] | None = None
    parameter_starts: list[float] | None = None
    parameter_truths: list[float | None] | None = None
    judged_value: float | None = None  # without noise; None where nothing is noisy
    judged_evaluations: int | None = None  # fresh ones that gave it; 0: it is exact
    merit: Mapping[str, Any] = field(default_factory=lambda: NO_MERIT)


def place_of_answer(pair: Pair, x: Array | None) -> dict[str, Any]:
    """Return the fields of an `Answer` x, shape (dim,), that need no call of the problem: its place in the box."""
    if x is None:
        return {}
    lower, upper, above_lower, below_upper = pair.box
    at_bound = (x <= above_lower) | (x >= below_upper)
    return {
        "inside_box": bool(((lower <= x) & (x <= upper)).all()),
        "at_bound": [name for name, at in zip(pair.coordinate_names, at_bound, strict=True) if at],
    }


def asks(problem: Any) -> bool:
    """Tell whether an answer calls the problem: for its parameters, figures of merit, or value without noise."""
    return bool(extra_of(problem, "physical") or extra_of(problem, "merit") or is_stochastic(problem))


def answer_of(pair: Pair, x: Array | None, ending: Ending, repetition: int) -> tuple[Answer, Ending]:
    """Return what the answer x, shape (dim,), means, and the ending: a failure where the problem fails in this."""
    problem = pair.problem
    known: dict[str, Any] = {}  # kept, whatever the figures of merit do
    if own_state.UNDER_WAY.get() and asks(problem):  # a fork begins `random` anew
        begin_generators(seed_sequence(pair.problem_word, "judging", repetition=repetition))
    try:
        if x is not None:
            parameters = pair.parameters
            values = np.asarray(problem.physical(x) if extra_of(problem, "physical") else x, float)
            if values.shape != (len(parameters),):
                raise TypeError(f"physical(x) returned shape {values.shape} for {len(parameters)} parameters")
            read: dict[str, Any] = {
                "parameter_names": [each.name for each in parameters], "parameter_values": values.tolist(),
            }  # fmt: skip
            if getattr(problem, "parameters", None) is not None:  # so that who reads the row need not build the problem
                read["parameter_units"] = [each.unit for each in parameters]
                read["parameter_starts"] = [float(each.start) for each in parameters]
                read["parameter_truths"] = [None if each.true is None else float(each.true) for each in parameters]
            known |= place_of_answer(pair, x) | read
            if extra_of(problem, "merit"):
                known["merit"] = merit_of(problem.merit(np.array(x)))
        value, evaluations = judged(problem, x, pair.problem_word, repetition)
        return Answer(**known, judged_value=value, judged_evaluations=evaluations), ending
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit too
        said = f"{JUDGING}{text_of(error)}"
        failed = replace(ending, error_type=type(error).__name__, error=said, traceback=frames_of(error))
        return Answer(**known), ending if ending.error_type else failed
