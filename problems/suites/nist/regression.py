"""`nist`: one of NIST's certified nonlinear regressions as a problem, from one of its two starts.

Values are sums of squared residuals, in the square of the response's unit. Truth and minimum are what NIST certifies;
the score of an answer is the number of certified digits that it reproduces.

The box is made from what NIST prints, by one rule for every parameter: the smallest interval that holds both starts
and the certified value, longer by half of itself below and by twice itself above. So the certified value lies
in the lower part of every side, and in no middle.

NIST's data sets as they are printed: readings, two starts, certified values with their standard deviations.

One file ``data/NAME.toml`` a data set, made from NIST's NAME.dat; every number stands there with the digits of the
print. The data sets are works of the United States government and in the public domain.
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
from calibench.problems.compiled_problem import vector, vectors
from calibench.problems.suites.nist.models import MODELS, Model

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
    _model: Model = field(repr=False)
    _response: Array = field(repr=False)

    name: ClassVar[str] = "nist"
    default_start: ClassVar[Literal["nominal", "random"]] = "nominal"
    noise_unit: ClassVar[str] = "unit of y"

    __repr__ = line_of
    _repr_html_ = table_of

    @property
    def typical_noise(self) -> float:
        """Return the certified standard deviation of the residuals."""
        return self.table.residual_deviation

    def __call__(self, x: Array) -> float:
        """Return the sum of squared residuals of the candidate x, shape (dim,)."""
        r = self.residuals(x)
        with np.errstate(all="ignore"):
            return float(r @ r)

    def residuals(self, x: Array) -> Array:
        """Return model minus reading, shape (m,); of a response that NIST fits as its logarithm, likewise."""
        b = vector(self.name, x, len(self.parameters))
        with np.errstate(all="ignore"):  # far from the starts a model overflows: not finite is its value there
            r = self._model.value(b, self.table.x) - self._response
        return np.where(np.abs(r) > _LARGEST, np.inf, r)  # what has no finite square is as bad, and warns nobody

    @property
    def jacobian(self) -> Callable[[Array], Array] | None:
        """Return the analytic derivative of the residuals, x -> (m, dim); None where differences are asked for."""
        return self._slopes if self.options["jacobian"] == "analytic" else None

    def batch(self, points: Array) -> Array:
        """Return the values, shape (k,), of candidates of shape (k, dim): the same bits as one call for each."""
        return np.array([self(x) for x in vectors(self.name, points, len(self.parameters))], dtype=float)

    @property
    def group(self) -> str:
        """Return NIST's level of difficulty: lower, average or higher."""
        return self.table.difficulty

    @cached_property
    def lower(self) -> Array:
        """Return the lower bounds of x, shape (dim,)."""
        return frozen([p.lower for p in self.parameters])

    @cached_property
    def upper(self) -> Array:
        """Return the upper bounds of x, shape (dim,)."""
        return frozen([p.upper for p in self.parameters])

    @cached_property
    def start(self) -> Array:
        """Return NIST's start that `from_start` chose, shape (dim,)."""
        return frozen([p.start for p in self.parameters])

    @property
    def truth(self) -> Array:
        """Return the certified values, shape (dim,)."""
        return self.table.certified

    @property
    def coordinates(self) -> tuple[Parameter, ...]:
        """Return what the vector x holds: the parameters themselves."""
        return self.parameters

    @property
    def minimum(self) -> float:
        """Return the certified residual sum of squares, f*."""
        return self.table.sum_of_squares

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

    @property
    def budgets(self) -> dict[str, int]:
        """Evaluations meant by the words `ci` and `paper`."""
        return {"ci": 5_000, "paper": 50_000}

    @property
    def data_id(self) -> str:
        """Return a digest of the data set's name and readings."""
        return self.table.data_id

    def physical(self, x: Array) -> Array:
        """Return the parameters of x, which are x."""
        return np.array(x, dtype=float)

    def merit(self, x: Array) -> dict[str, float]:
        """Return how many certified digits an answer has: of its worst parameter, and of its sum of squares."""
        return {
            "certified_digits": certified_digits(x, self.truth),
            "certified_digits_of_sum": certified_digits(np.array([self(x)]), np.array([self.minimum])),
        }

    def _slopes(self, x: Array) -> Array:
        b = vector(self.name, x, len(self.parameters))
        with np.errstate(all="ignore"):
            return self._model.slopes(b, self.table.x)

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
    name: Name = "Misra1a",
    from_start: Literal[1, 2] = 2,
    jacobian: Literal["analytic", "differences"] = "analytic",
) -> NistRegression:
    """One of NIST's 27 certified nonlinear regressions, from its start 1 (far) or 2 (near).

    With jacobian=differences the problem shows no derivative, and who needs one pays for differences.
    """
    printed, model = table(name), MODELS[name]
    return NistRegression(
        options={"name": name, "from_start": from_start, "jacobian": jacobian},
        table=printed,
        parameters=_boxed(printed, from_start),
        _model=model,
        _response=frozen(model.response(printed.y)),
    )


def _boxed(printed: Table, from_start: int) -> tuple[Parameter, ...]:
    """Return the parameters in the box that the three printed values of each make."""
    three = np.vstack([printed.starts, printed.certified])
    least, most = three.min(axis=0), three.max(axis=0)
    lower, upper = least - _BELOW * (most - least), most + _ABOVE * (most - least)
    start = printed.starts[from_start - 1]
    return tuple(
        Parameter(name, "", *map(float, four))
        for name, *four in zip(printed.names, start, lower, upper, printed.certified, strict=True)
    )


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

    name: str
    difficulty: Difficulty
    model: str
    reference: str
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
        name=said["name"],
        difficulty=said["difficulty"],
        model=said["model"],
        reference=said["reference"],
        names=tuple(said["parameters"]),
        starts=frozen(printed[:2]),
        certified=frozen(printed[2]),
        deviations=frozen(printed[3]),
        sum_of_squares=float(said["residual_sum_of_squares"]),
        residual_deviation=float(said["residual_standard_deviation"]),
        y=frozen(readings[0]),
        x=frozen(readings[1:]),
        data_id=blake2b(" ".join([said["name"], *rows]).encode(), digest_size=8).hexdigest(),
    )
