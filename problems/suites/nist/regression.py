"""`nist`: one of NIST's certified nonlinear regressions as a problem, from one of its two starts.

Values are sums of squared residuals, in the square of the response's unit; truth and minimum are what NIST certifies.
The box is the smallest interval that holds both starts and the certified value, longer by half of itself below and by
twice itself above, so that this is in no middle. ``data/NAME.toml`` is made from NIST's NAME.dat, every number with the
digits of the print; the data sets are works of the United States government and in the public domain.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from hashlib import blake2b
from importlib.resources import files
from typing import Any, ClassVar, Literal, final

import numpy as np

from calibench.problems.base import Array, Parameter, frozen, line_of, registry, table_of
from calibench.problems.compiled_problem import itself, vector_of, vectors_of
from calibench.problems.suites.nist.models import MODELS

Name = Literal[
    "Misra1a", "Chwirut2", "Chwirut1", "Lanczos3", "Gauss1", "Gauss2", "DanWood", "Misra1b",
    "Kirby2", "Hahn1", "Nelson", "MGH17", "Lanczos1", "Lanczos2", "Gauss3", "Misra1c", "Misra1d", "Roszman1", "ENSO",
    "MGH09", "Thurber", "BoxBOD", "Rat42", "MGH10", "Eckerle4", "Rat43", "Bennett5",
]  # fmt: skip  # NIST's order: lower, average, higher difficulty
_BELOW, _ABOVE = 0.5, 2.0  # of the interval of the three printed values, how far the box reaches beyond it
_LARGEST = 1e150  # of a residual
_CERTIFIED = 11.0  # digits that NIST certifies
_EPS = float(np.finfo(float).eps)


@final
@dataclass(frozen=True, eq=False)
class NistRegression:
    """Minimise the sum of squared residuals of a regression: a call takes x, shape (dim,), in NIST's order b1, b2, ...

    ``problem(x) == r @ r`` with ``r = problem.residuals(x)``, shape (m,): model minus reading. Where the model is not
    defined at x the value is not finite. `table` is what NIST prints.
    """

    options_tell_all: ClassVar[bool] = True  # what else it is follows from the options
    options: Mapping[str, Any]
    table: Table
    parameters: tuple[Parameter, ...]
    coordinates: tuple[Parameter, ...]
    lower: Array
    upper: Array
    start: Array
    truth: Array  # the certified values
    minimum: float  # the certified residual sum of squares, f*
    typical_noise: float  # the certified standard deviation of the residuals
    group: str  # NIST's level of difficulty
    data_id: str
    _response: Array = field(repr=False)

    name: ClassVar[str] = "nist"
    noise_unit: ClassVar[str] = "unit of y"
    budgets: ClassVar[Mapping[str, int]] = {"ci": 5_000, "paper": 50_000}

    __repr__ = line_of
    _repr_html_ = table_of
    physical = itself

    def __call__(self, x: Array) -> float:
        """Return the sum of squared residuals of the candidate x, shape (dim,)."""
        r = self.residuals(x)
        with np.errstate(all="ignore"):
            return float(r @ r)

    def residuals(self, x: Array) -> Array:
        """Return model minus reading, shape (m,); of a response that NIST fits as its logarithm, likewise."""
        b = vector_of(self, x)
        with np.errstate(all="ignore"):  # far from the starts a model overflows: not finite is its value there
            r = MODELS[self.options["name"]].value(b, self.table.x) - self._response
        return np.where(np.abs(r) > _LARGEST, np.inf, r)  # what has no finite square is as bad, and warns nobody

    @property
    def jacobian(self) -> Callable[[Array], Array] | None:
        """Return the analytic derivative of the residuals, x -> (m, dim); None where differences are asked for."""
        return self._slopes if self.options["jacobian"] == "analytic" else None

    def batch(self, points: Array) -> Array:
        """Return the values, shape (k,), of candidates of shape (k, dim): the same bits as one call for each."""
        return np.array([self(x) for x in vectors_of(self, points)], dtype=float)

    @cached_property
    def targets(self) -> tuple[float, ...]:
        """Return levels of f whose first crossing is recorded, the same from both starts.

        They are f* plus 1e-1, 1e-2, ... of the gap at NIST's start 1, down to the last: f* plus 1e-9 of itself, or plus
        what rounding leaves where that is more. So near, the parameters agree in about half as many digits.
        """
        last = max(1e-9 * self.minimum, self._rounding)
        first = self(self.table.starts[0]) - self.minimum
        gaps = [first * 10.0**-k for k in range(1, 40)]
        return tuple(self.minimum + gap for gap in [*(gap for gap in gaps if gap > last), last])

    def merit(self, x: Array) -> dict[str, float]:
        """Return how many certified digits an answer has: of its worst parameter, and of its sum of squares."""
        return {
            "certified_digits": certified_digits(x, self.truth),
            "certified_digits_of_sum": certified_digits(np.array([self(x)]), np.array([self.minimum])),
        }

    def _slopes(self, x: Array) -> Array:
        b = vector_of(self, x)
        with np.errstate(all="ignore"):
            return MODELS[self.options["name"]].slopes(b, self.table.x)

    @property
    def _rounding(self) -> float:
        """Return how far rounding can move the least sum: of a model as large as the readings, to a few units each."""
        each = 4 * _EPS * np.abs(self._response)
        return float(2 * np.sqrt(self.minimum) * np.linalg.norm(each) + each @ each)


def certified_digits(found: Array, certified: Array) -> float:
    """Return the log relative error -log10(|x - c| / |c|) of the worst entry, between 0 and the 11 certified digits.

    >>> certified_digits(np.array([1.0001, 2.0]), np.array([1.0, 2.0]))
    4.0
    """
    with np.errstate(all="ignore"):
        gap = float(np.max(np.abs(np.asarray(found) - certified) / np.abs(certified)))
    if not gap < 1:
        return 0.0
    return round(min(_CERTIFIED, float(-np.log10(gap))) if gap else _CERTIFIED, 9)


@registry.register("nist")
def nist(
    name: Name = "Misra1a", from_start: Literal[1, 2] = 2, jacobian: Literal["analytic", "differences"] = "analytic"
) -> NistRegression:
    """One of NIST's 27 certified nonlinear regressions, from its start 1 (far) or 2 (near).

    With jacobian=differences the problem shows no derivative, and who needs one pays for differences.
    """
    printed = table(name)
    three = np.vstack([printed.starts, printed.certified])
    least, most = three.min(axis=0), three.max(axis=0)
    lower, upper = least - _BELOW * (most - least), most + _ABOVE * (most - least)
    start = printed.starts[from_start - 1]
    sides = zip(printed.names, start, lower, upper, printed.certified, strict=True)
    parameters = tuple(Parameter(name, "", *map(float, four)) for name, *four in sides)
    return NistRegression(
        options={"name": name, "from_start": from_start, "jacobian": jacobian}, table=printed, parameters=parameters,
        coordinates=parameters, lower=frozen(lower), upper=frozen(upper), start=frozen(start),
        truth=printed.certified, minimum=printed.sum_of_squares, typical_noise=printed.residual_deviation,
        group=printed.difficulty, data_id=printed.data_id, _response=frozen(MODELS[name].response(printed.y)),
    )  # fmt: skip


Difficulty = Literal["lower", "average", "higher"]


@final
@dataclass(frozen=True, eq=False)
class Table:
    """One data set: readings `y`, shape (m,), predictors `x`, shape (k, m), and what NIST certifies.

    `starts`, shape (2, dim), are NIST's start 1 (far) and start 2 (near); `certified` and `deviations`, shape (dim,),
    the certified parameters and their standard deviations; `sum_of_squares` and `residual_deviation` those of the
    residuals. `model` is the formula as NIST prints it, `difficulty` NIST's level. `data_id` is a digest of the
    readings as printed.
    """

    difficulty: Difficulty
    model: str
    names: tuple[str, ...]
    starts: Array
    certified: Array
    deviations: Array
    sum_of_squares: float
    residual_deviation: float
    y: Array
    x: Array
    data_id: str


@cache
def table(name: str) -> Table:
    """Return the data set `name`. Raises `FileNotFoundError` where there is none of that name."""
    text = files("calibench.problems.suites.nist").joinpath(f"data/{name}.toml").read_text(encoding="utf-8")
    said = tomllib.loads(text)
    columns, rows = said["data"]["columns"].split(), said["data"]["rows"].split()
    readings = frozen(rows).reshape(-1, len(columns)).T
    printed = np.array([[float(number) for number in four] for four in said["parameters"].values()]).T
    return Table(
        difficulty=said["difficulty"], model=said["model"], names=tuple(said["parameters"]), starts=frozen(printed[:2]),
        certified=frozen(printed[2]), deviations=frozen(printed[3]),
        sum_of_squares=float(said["residual_sum_of_squares"]),
        residual_deviation=float(said["residual_standard_deviation"]), y=frozen(readings[0]), x=frozen(readings[1:]),
        data_id=blake2b(" ".join([said["name"], *rows]).encode(), digest_size=8).hexdigest(),
    )  # fmt: skip
