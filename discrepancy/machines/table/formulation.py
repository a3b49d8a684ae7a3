"""`Table`: one column is measured, a function of others predicts it, and its residuals may depend on any column.

The inputs carry no noise; that of the measured column is a number, a column, or unknown and estimated. An argument of
the function without a default is a column, one with a default a parameter. The regressions of NIST that ship are known
by NIST's names; of Nelson the measured column is the logarithm, for so NIST fits it. A column may be another one in
other numbers (another unit, or corrected in some rows): what is measured follows such a column of itself better than
any cause, and it is none.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, final

import numpy as np

from calibench.core.notes import Code
from calibench.core.options import shown, suggest
from calibench.core.registry import Registry
from calibench.core.words import counted, plain
from calibench.discrepancy.model.formulations import Predicted, along_clock, numbers_of
from calibench.discrepancy.model.machine import Description, Numbers, Quantities, Stated
from calibench.discrepancy.model.measured import DataError, MeasuredData, Sensor
from calibench.discrepancy.model.roles import RATE, Roles
from calibench.discrepancy.registries import describe, machines
from calibench.problems.base import Array, Parameter
from calibench.problems.suites.nist.models import MODELS
from calibench.problems.suites.nist.regression import table

_WIDTH = 1e9  # of the box about a start: nothing is known of a parameter of any function
_MOST_BACK = 20
Function = Callable[..., Any]
models: Registry[Any] = Registry("model", "calibench.table_models")
_FORMULAS: dict[str, tuple[str, Function]] = {
    "constant": ("y = b0.", lambda b0=0.0: b0),
    "line": ("y = b0 + b1 x.", lambda x, b0=0.0, b1=0.0: b0 + b1 * x),
    "parabola": ("y = b0 + b1 x + b2 x^2.", lambda x, b0=0.0, b1=0.0, b2=0.0: b0 + x * (b1 + x * b2)),
    "cubic": (
        "y = b0 + b1 x + b2 x^2 + b3 x^3.",
        lambda x, b0=0.0, b1=0.0, b2=0.0, b3=0.0: b0 + x * (b1 + x * (b2 + x * b3)),
    ),
    "exponential": ("y = b0 + b1 exp(b2 x).", lambda x, b0=0.0, b1=1.0, b2=-0.1: b0 + b1 * np.exp(b2 * x)),
    "power_law": ("y = b1 x^b2.", lambda x, b1=1.0, b2=1.0: b1 * x**b2),
    "linear": (
        "y = b0 + b1 x1 + b2 x2 + ..., a weight for each column of inputs=.",
        lambda *columns, **weights: (
            weights["b0"] + sum(weights[f"b{k}"] * column for k, column in enumerate(columns, start=1))
        ),
    ),
}


def _of_nist(name: str) -> Function:
    """Return one of NIST's regressions as a function of columns, from NIST's second start."""
    printed, model = table(name), MODELS[name]
    count = len(printed.x)
    columns = ("x",) if count == 1 else tuple(f"x{k + 1}" for k in range(count))

    def function(*given: Any, **b: Any) -> Any:
        values = dict(zip(columns, given)) | b
        return model.value([values[p] for p in printed.names], [values[c] for c in columns])  # type: ignore[arg-type]

    kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
    function.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(c, kind) for c in columns]
        + [inspect.Parameter(p, kind, default=float(s)) for p, s in zip(printed.names, printed.starts[1])]
    )
    function.__doc__ = f"NIST's {name}: {' '.join(printed.model.split())}"
    return function


for _name, (_words, _function) in _FORMULAS.items():
    _function.__doc__, _function.__name__ = _words, _name
    models.register(_name)(_function)
for _name in MODELS:
    models.register(_name)(_of_nist(_name))


@machines.register("table")
@final
@dataclass(frozen=True)
class Table:
    """A table of columns with a base model y = f(x; p).

    `model` is a name or FILE.py:FUNCTION, `measured` the column that it predicts, `inputs` the columns for its
    arguments where they are called otherwise, `sigma` the noise: a number, a column, or None where nobody knows it.
    `start` are other starts of parameters, `held` parameters that are not calibrated. `time` is a column: lag, drift
    and step are looked for along it. `back` adds columns of as many earlier rows, `u_1`, `u_2`, of what is measured and
    of all others. `covariates` are the columns that an error may follow; where none are named, all.
    """

    model: str = "constant"
    measured: str = "y"
    inputs: tuple[str, ...] = ()
    sigma: float | str | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    held: tuple[str, ...] = ()
    time: str = ""
    back: int = 0
    covariates: tuple[str, ...] = ()
    unit: str = ""
    name: str = field(default="table", init=False)

    def formulate(self, data: MeasuredData) -> Predicted:
        known(data, "machine.measured", self.measured)
        back, n = self.back, len(data)
        if back and f"{self.measured}_{back}" not in data:
            # the rows from number `back` on, with `u_1`, `u_2`, ...: the column u one, two, ... rows earlier
            if not 0 <= back <= min(_MOST_BACK, n - 2):
                raise DataError(f"{data.name}: machine.back={back}: 0 to {min(_MOST_BACK, n - 2)} rows can be meant")
            if "valid" in data or "visit_id" in data:
                text = "needs rows that follow each other: no column valid, no visits"
                raise DataError(f"{data.name}: machine.back= {text}")
            ways = range(1, back + 1)
            earlier = {f"{u}_{k}": data[u][back - k : n - k] for u in numbers_of(data) for k in ways}
            taken = sorted({*earlier} & {*data.columns})
            if taken:
                text = f"makes a column {taken[0]}, which there is; rename that one"
                raise DataError(f"{data.name}: machine.back={back} {text}")
            data = data.rows(np.arange(n) >= back).with_columns(earlier)
        try:
            function = models.factory(self.model)
        except ValueError as error:
            raise DataError(f"machine.model={self.model}: {error}") from None
        base = base_of(self.model, function, whole_names(data, self.inputs), self.start, self.measured)
        clock = self.time or ("t_s" if "t_s" in data else "")
        known(data, "machine.inputs", *base.columns)
        covariates = whole_names(data, self.covariates)
        known(data, "machine.covariates", *covariates)
        known(data, "machine.sigma", *((self.sigma,) if isinstance(self.sigma, str) else ()))
        known(data, "machine.time", *(clock,) * bool(clock))
        for name in self.held:
            if name not in base.starts:
                raise DataError(f"machine.held={name}: {base.name} has no such parameter; {suggest(name, base.starts)}")
        if self.measured in base.columns:
            raise DataError(f"machine.measured={self.measured}: it is what is predicted, so it can be no input")
        moving = tuple(c for c in base.columns if c != clock)
        if clock:
            data = data.with_columns(along_clock(data, [c for c in moving if f"{RATE}{c}" not in data], clock))
        if not covariates:
            data, covariates = self._followed(data, base)
        free = {name: at for name, at in base.starts.items() if name not in self.held}
        return Predicted(
            data, base, tuple(Parameter(name, "", at, at - _WIDTH, at + _WIDTH) for name, at in free.items()),
            measured={self.measured: self.sigma}, inputs=base.columns,
            held={name: base.starts[name] for name in self.held}, unit=self.unit,
            instruments=(Sensor(self.measured, "column", self.unit),), roles=Roles(time=clock, columns=covariates),
        )  # fmt: skip

    def _followed(self, data: MeasuredData, base: Base) -> tuple[MeasuredData, tuple[str, ...]]:
        """Return the inputs, and every other column that varies and is none of these in other numbers."""
        noise = self.sigma if isinstance(self.sigma, str) else ""
        others = (c for c in numbers_of(data) if c not in (self.measured, noise) and not c.startswith(RATE))
        varied = tuple(c for c in dict.fromkeys((*base.columns, *others)) if np.ptp(data[c]))
        again: dict[str, str] = {}  # in words that a column is the measured one, or an input, in other numbers
        for column in (c for c in varied if c not in base.columns):
            least = {self.measured: _LEAST_ALIKE, **dict.fromkeys(base.columns, 1.0)}
            words = (said_again(c, data[c], column, data[column], alike) for c, alike in least.items())
            again[column] = next(filter(None, words), "")
        followed = tuple(c for c in varied if not again.get(c))
        if not followed:  # then the line is all that there is to see
            return data, varied
        for column, said in again.items():
            text = f"{said}: {column} is not looked at; machine.covariates= names the columns that are"
            data = data.with_note(Code.COLUMN_NOT_FOLLOWED, text, (column,)) if said else data
        kept = {name: column for name, column in data.columns.items() if not again.get(name)}
        return replace(data, columns=kept), followed


@final
@dataclass(frozen=True, eq=False)
class Base:
    """`function` of `columns` (names in the data, in the order of its arguments) with parameters from `starts`."""

    name: str
    function: Function
    columns: tuple[str, ...]
    starts: Mapping[str, float]
    rows: str = ""

    def __call__(self, q: Quantities) -> Numbers:
        """Return the prediction, (n,); a number that is the same in all rows is repeated as `rows` has them."""
        predicted = np.asarray(self.function(*(q[c] for c in self.columns), **{p: q[p] for p in self.starts}))
        return np.broadcast_to(predicted, np.shape(q[self.rows])) if not predicted.ndim else predicted


def base_of(name: str, function: Function, given: tuple[str, ...], start: Mapping[str, Any], rows: str) -> Base:
    """Return the base model; `given` are the columns for its arguments, in order, where these have other names."""
    columns: list[str] = []
    starts: dict[str, Any] = {}
    for argument in inspect.signature(function).parameters.values():
        if argument.kind is argument.VAR_POSITIONAL:  # a weight for each column
            columns, starts = [*given], {f"b{k}": 0.0 for k in range(len(given) + 1)}
        elif argument.kind is argument.VAR_KEYWORD:
            continue
        elif argument.default is argument.empty:
            columns.append(argument.name)
        else:
            starts[argument.name] = argument.default
    if given and len(given) != len(columns):
        raise DataError(
            f"machine.inputs={','.join(given)}: {name} is a function of {counted(len(columns), 'column')}"
            f"{': ' * bool(columns)}{', '.join(columns)}; name as many, in this order"
        )
    if not starts:
        raise DataError(f"{name}: nothing to fit; give the parameters their starts as defaults, such as b1=0.0")
    for key, value in start.items():
        if key not in starts:
            raise DataError(f"machine.start: {name} has no parameter {key!r}; {suggest(key, starts)}")
        starts[key] = value
    for key, value in starts.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise DataError(f"{name}: {key} starts at {shown(value)}: a finite number is needed")
    return Base(name, function, given or tuple(columns), {k: float(v) for k, v in starts.items()}, rows)


_LEAST_VALUES = 8  # of a column: what has fewer is a setting of the machine
_MOST_OFF = 0.05  # of the measured column's standard deviation: a scale that is coarser tells nothing
_LEAST_ALIKE = 0.75  # of the rows: a correction changes some
_ROUNDED = 0.55  # of the step of the last digit: what rounding moves a number by, and a little
_MOST_DIGITS = 12


def said_again(name: str, y: Array, column: str, c: Array, alike: float = _LEAST_ALIKE) -> str:
    """Return in words that `y` is a line of `c` in the last digits of both, (n,) each; "" where it is none."""
    y, c = np.asarray(y, dtype=float), np.asarray(c, dtype=float)
    if len(np.unique(c)) < _LEAST_VALUES or not (np.ptp(y) and np.all(np.isfinite(c + y))):
        return ""
    order = np.argsort(c, kind="stable")
    low, high = order[: len(c) // 2], order[len(c) - len(c) // 2 :]
    apart = c[high] > c[low]
    slope = float(np.median((y[high] - y[low])[apart] / (c[high] - c[low])[apart])) if apart.any() else 0.0
    zero = float(np.median(y - slope * c))
    steps = []  # of the last digit in which each is told, 0 for more digits than are written
    for values in (y, c):
        digits = (k for k in range(_MOST_DIGITS) if np.array_equal(np.round(values, k), values))
        steps.append(next((float(10.0**-k) for k in digits), 0.0))
    most = _ROUNDED * (steps[0] + abs(slope) * steps[1]) + 1e-9 * float(np.ptp(y))
    many = int(np.count_nonzero(np.abs(y - slope * c - zero) <= most))
    if not slope or most > _MOST_OFF * np.std(y) or many < alike * len(y):
        return ""
    shift = f" {'-' if zero < 0 else '+'} {plain(abs(zero), 4)}" if abs(zero) > most else ""
    rows = "all rows" if many == len(y) else f"{many} of {counted(len(y), 'row')}"
    return f"{name} is {plain(slope, 4)} times {column}{shift} in {rows}, the same in other numbers"


def known(data: MeasuredData, what: str, *names: str) -> None:
    """Raise `DataError` for a name that is no column of numbers."""
    for name in names:
        if name not in numbers_of(data):
            raise DataError(f"{data.name}: {what}={name}: no column of numbers; {suggest(name, numbers_of(data))}")


def whole_names(data: MeasuredData, words: tuple[str, ...]) -> tuple[str, ...]:
    """Return names of columns, joined where words that are none are one with spaces: Raw, Data -> Raw Data."""
    names, rest, there = [], list(words), numbers_of(data)
    while rest:
        ends = range(len(rest), 1, -1) if rest[0] not in there else ()
        end = next((k for k in ends if " ".join(rest[:k]) in there), 1)
        names.append(" ".join(rest[:end]))
        rest = rest[end:]
    return tuple(names)


describe(
    "table",
    Description(
        stated=(Stated("periods", "names", 'periods={"month":12}'),),
        # drift and step are its own, and a trend is told by its powers
        replaced=("polynomial", "instrument_scale", "instrument_lag", "frame_drift", "frame_shift"),
        part_of=str,
        own_units=True,
    ),
)
