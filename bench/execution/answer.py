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

from calibench.bench.execution.request import Pair
from calibench.bench.execution.run_row import COLUMNS
from calibench.bench.execution.stochastic import Judged, hits_of_the_answer, is_stochastic, judged
from calibench.bench.gate.endings import frames_of, text_of
from calibench.bench.gate.evaluator import Evaluator
from calibench.bench.gate.time_limit import JUDGING, Ending
from calibench.core import own_state
from calibench.core.seeds import begin_generators, seed_sequence
from calibench.problems.base import extra_of

if TYPE_CHECKING:
    import pandas as pd

_OTHERS = "merit"  # the column of all that has none of its own
_OWN = tuple(column.name for column in COLUMNS if column.group == "merit" and column.name != _OTHERS)
PREFIX = "merit."
_INFINITE = ("inf", "-inf")


@final
@dataclass(frozen=True)
class Merit:
    """Figures of merit: of each column of the machines' its number, None where there is none; all others as JSON."""

    columns: Mapping[str, float | None] = field(default_factory=lambda: dict.fromkeys(_OWN))
    others: str | None = None


def merit_of(found: Any) -> Merit:
    """Return the result of ``merit(x)`` as columns of a row.

    A number that is not finite is null there, as JSON has none; of the others an infinite one is the text "inf" or
    "-inf". Raises `TypeError` for a value that is not a number,
    flag or text.
    """
    if not isinstance(found, Mapping):
        raise TypeError(f"merit(x) returned {type(found).__name__}: names and numbers are needed, {{name: number}}")
    own = {key: _number(key, value) for key, value in found.items() if key in _OWN}
    others = {str(key): _plain(key, value) for key, value in found.items() if key not in _OWN}
    text = json.dumps(others, sort_keys=True, ensure_ascii=False) if others else None
    return Merit(dict.fromkeys(_OWN) | own, text)


def offered(runs: pd.DataFrame) -> pd.DataFrame:
    """Return `runs` with a column ``merit.KEY`` for each key of their column `merit`; without any, as they are.

    A key whose values are flags in all runs is a column of flags, one of numbers a column of floats, NaN where a run
    has none; any other is text.
    """
    import pandas as pd

    texts = runs["merit"].dropna()
    if texts.empty:
        return runs
    read = {index: json.loads(text) for index, text in texts.items()}
    keys = list(dict.fromkeys(key for each in read.values() for key in each))
    columns = {}
    for key in keys:
        columns[PREFIX + key] = _column([read.get(index, {}).get(key) for index in runs.index], runs.index)
    return pd.concat([runs, pd.DataFrame(columns)], axis=1)


def medians(cell: pd.DataFrame) -> dict[str, float]:
    """Return of each ``merit.KEY`` over the runs of a cell the median, or of flags the share.

    Keys are ``merit.KEY_median`` and ``merit.KEY_share``; text has none. NaN where no run of this cell has the key.
    """
    import pandas as pd

    found = {}
    for key in (key for key in cell.columns if key.startswith(PREFIX)):
        if pd.api.types.is_bool_dtype(cell[key]):
            found[f"{key}_share"] = float("nan") if cell[key].isna().all() else float(cell[key].mean())
        elif pd.api.types.is_float_dtype(cell[key]):
            found[f"{key}_median"] = float(cell[key].median())
    return found


def heading(key: str) -> str:
    """Return the title of a column of `medians`.

    >>> heading("merit.overshoot_median"), heading("merit.stable_share")
    ('overshoot, median', 'stable, share')
    """
    name, _, what = key.removeprefix(PREFIX).rpartition("_")
    return f"{name}, {what}"


def _column(values: list[Any], index: pd.Index) -> pd.Series:
    import pandas as pd

    known = [value for value in values if value is not None]
    if all(value in _INFINITE or type(value) in (int, float) for value in known):
        values = [float(value) if value in _INFINITE else value for value in values]
        known = [value for value in values if value is not None]
    if known and all(isinstance(value, bool) for value in known):
        return pd.Series(values, index, dtype="boolean")
    if all(isinstance(value, int | float) for value in known):
        return pd.Series([np.nan if v is None else float(v) for v in values], index, dtype=float)
    return pd.Series([None if v is None else str(v) for v in values], index, dtype="str")


def _number(key: str, value: Any) -> float | None:
    try:
        return None if value is None else float(value)
    except (TypeError, ValueError):
        raise TypeError(
            f"merit(x) gave {key}={value!r:.60}: a number is needed, as a column of that name has"
        ) from None


def _plain(key: Any, value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        value = value.item() if np.size(value) == 1 else value.tolist()
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return value if np.isfinite(value) else None if np.isnan(value) else str(value)
    raise TypeError(f"merit(x) gave {key}={value!r:.60}: a number, True or False, or text is needed")


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
    merit: Merit = field(default_factory=Merit)
    judged: Judged = field(default_factory=Judged)


def place_of_answer(pair: Pair, x: Array | None) -> Answer:
    """Return what is known of the answer x, shape (dim,), without a call of the problem: its place in the box."""
    return Answer() if x is None else Answer(**_placed(pair, x))


def answer_of(pair: Pair, x: Array | None, ending: Ending, repetition: int) -> tuple[Answer, Ending]:
    """Return what the answer x, shape (dim,), means, and the ending: a failure where the problem fails in judging it.

    The seed of fresh evaluations follows from the problem's key and the `repetition`.
    """
    problem = pair.problem
    known: dict[str, Any] = {}
    if own_state.is_kept():  # a fork begins `random` anew
        begin_generators(seed_sequence(pair.problem_word, "judging", repetition=repetition))
    try:
        if x is not None:
            known |= _read(pair, x)  # kept, whatever the figures of merit do
            if extra_of(problem, "merit"):
                known["merit"] = merit_of(problem.merit(np.array(x)))
        known["judged"] = judged(problem, x, pair.problem_word, repetition)
        return Answer(**known), ending
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit too
        said = f"{JUDGING}{text_of(error)}"
        failed = replace(ending, error_type=type(error).__name__, error=said, traceback=frames_of(error))
        return Answer(**known), ending if ending.error_type else failed


def hits_of(problem: Any, gate: Evaluator, answer: Answer) -> tuple[list[int | None], list[int | None]]:
    """Return what each target cost, in evaluations and charged: as the gate saw it, or by the answer where noisy."""
    if not is_stochastic(problem):
        return gate.hits, gate.hits_charged
    value = answer.judged.value
    return hits_of_the_answer(gate, np.inf if value is None else value)


def _read(pair: Pair, x: Array) -> dict[str, Any]:
    problem, parameters = pair.problem, pair.parameters
    values = np.asarray(problem.physical(x) if extra_of(problem, "physical") else x, float)
    if values.shape != (len(parameters),):
        raise TypeError(f"physical(x) returned shape {values.shape} for {len(parameters)} parameters")
    read = {"parameter_names": [each.name for each in parameters], "parameter_values": values.tolist()}
    return {**_placed(pair, x), **read, **_declared(pair)}


def _declared(pair: Pair) -> dict[str, Any]:
    """Return what the problem says of its parameters, so that who reads the row need not build the problem."""
    if getattr(pair.problem, "parameters", None) is None:
        return {}
    return {
        "parameter_units": [each.unit for each in pair.parameters],
        "parameter_starts": [float(each.start) for each in pair.parameters],
        "parameter_truths": [None if each.true is None else float(each.true) for each in pair.parameters],
    }


def _placed(pair: Pair, x: Array) -> dict[str, Any]:
    """Return the place of x in the box: everything that needs no call of the problem."""
    lower, upper, above_lower, below_upper = pair.box
    at_bound = (x <= above_lower) | (x >= below_upper)
    return {
        "inside_box": bool(((lower <= x) & (x <= upper)).all()),
        "at_bound": [name for name, at in zip(pair.coordinate_names, at_bound, strict=True) if at],
    }
