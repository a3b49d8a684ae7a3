"""The ledger: rows, the functions of numbers that give them their verdicts, the printed numbers, and the file.

A verdict is never written by hand: a row is made from what is printed (`Printed`, by the key of its quantity in the
data file), what to read, what a rerun or recomputation gave, and a tolerance with its reason; `judge` says what
follows. `Evidence` holds the runs. The file is Parquet with an explicit schema, and CSV with the same columns.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from decimal import Decimal
from functools import cache
from importlib.resources import files
from math import inf, isfinite, log10, nan
from pathlib import Path
from typing import Any, Literal, final, get_args

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from calibench import problems
from calibench.bench.provenance.environment import provenance
from calibench.bench.statistics.summary import QUARTILES, quantiles
from calibench.bench.store.atomic_file import write_whole
from calibench.problems.constants import Column, Constant, column

Array = NDArray[np.float64]
Verdict = Literal[
    "reproduced", "reproduced in kind", "misprint, corrected", "artefact of the stopping tolerance",
    "depends on plan or release", "not reproduced", "open at this budget", "not checkable",
]  # fmt: skip
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
# what the paper does with a number: it is given it, chooses it, or finds it; a found number that can only be held
# against others that the paper found; a sentence; a slip of the print
Kind = Literal["input", "setting", "result", "consistency", "claim", "erratum"]
KINDS: tuple[Kind, ...] = get_args(Kind)
# what `tolerance` means: a distance from what is printed or to be read, or a limit of the number that is judged
# (in every release: a claim judged in each variant of fmincon, whose verdicts are made into one; in half of them: a
# cell judged in every plan and release, by the number that half of them come as near as)
Rule = Literal["near", "at most", "at least", "at most, in every release", "near, in half of plans and releases"]
_FEW = 0.05  # of plans and releases: where no more than so many give the print, they contradict it
_NEARNESS: tuple[Verdict, ...] = ("reproduced", "misprint, corrected", "reproduced in kind", "not reproduced")


@final
@dataclass(frozen=True)
class Ours:
    """What we computed: median and quartiles of n numbers. Those that are not finite are left out; n may be 0."""

    median: float
    q1: float
    q3: float
    n: int

    @staticmethod
    def of(values: Ours | Iterable[float] | float) -> Ours:
        """Return the summary of one number or many; NaN was not measured, infinite is a search that failed."""
        if isinstance(values, Ours):
            return values
        numbers = np.atleast_1d(np.asarray(values if isinstance(values, float | int) else list(values), dtype=float))
        numbers = numbers[~np.isnan(numbers)]
        if not numbers.size:
            return NOTHING
        q1, median, q3 = quantiles(numbers, QUARTILES).tolist()
        return Ours(median, q1, q3, int(numbers.size))


NOTHING = Ours(nan, nan, nan, 0)


@final
@dataclass(frozen=True)
class Tolerance:
    """How near is the same number (`exact`), the same in kind (`in_kind`: an absolute distance, or with `decades` one
    of decimal logarithms of the distances from `origin`), and why."""

    exact: float
    why: str
    in_kind: float = nan
    decades: bool = False
    origin: float = 0.0

    def same_in_kind(self, ours: float, other: float) -> bool:
        """Tell whether two numbers are the same in kind; never where no such tolerance was given."""
        if not isfinite(self.in_kind):
            return False
        if not self.decades:
            return abs(ours - other) <= self.in_kind
        if self.origin:
            ours, other = abs(ours - self.origin), abs(other - self.origin)
        return decades_between(ours, other) <= self.in_kind


NO_TOLERANCE = Tolerance(nan, "nothing to compare with")


@final
@dataclass(frozen=True)
class Ruling:
    """A verdict with what it follows from: the number judged, its limit, that in kind, and `share` as in `Row`."""

    verdict: Verdict
    judged: float
    rule: Rule
    limit: float
    in_kind: float = nan
    decades: bool = False
    share: float = nan


@final
@dataclass(frozen=True, kw_only=True)
class Row:
    """A row of the ledger. Its fields are the columns of ``ledger.parquet``.

    `about` names the printed numbers (keys, a space between) that this row passes a verdict on, its own for a cell that
    stands alone; `differs` says why the verdict is another than theirs, empty where it is not. `share` is the part of
    all plans and releases that is within the band, NaN where a row is not judged over them.
    """

    paper: str
    key: str
    kind: Kind
    about: str
    place: str
    quantity: str
    unit: str
    printed: float
    read: float
    ours_median: float
    ours_q1: float
    ours_q3: float
    n: int
    judged: float
    rule: Rule
    tolerance: float
    tolerance_in_kind: float
    tolerance_in_decades: bool
    tolerance_origin: float
    share: float
    why_tolerance: str
    verdict: Verdict
    reason: str
    differs: str
    method: str


def judge(printed: float, read: float, ours: float, tolerance: Tolerance) -> Verdict:
    """Return the verdict on a printed number, NaN where nothing legible stands; a misprint agrees with `read` alone."""
    if not isfinite(ours):
        return "not checkable"
    if abs(ours - printed) <= tolerance.exact:
        return "reproduced"
    if printed != read and abs(ours - read) <= tolerance.exact:
        return "misprint, corrected"
    if tolerance.same_in_kind(ours, printed):
        return "reproduced in kind"
    return "misprint, corrected" if printed != read and tolerance.same_in_kind(ours, read) else "not reproduced"


def judge_near(printed: float, read: float, ours: float, tolerance: Tolerance) -> Ruling:
    """Return `judge`'s verdict with the numbers it follows from."""
    verdict = judge(printed, read, ours, tolerance)
    return Ruling(verdict, ours, "near", tolerance.exact, tolerance.in_kind, tolerance.decades)


def judge_share(printed: float, read: float, values: Sequence[float], tolerance: Tolerance) -> Ruling:
    """Return the ruling over all plans and releases, which are not printed: the best verdict that half of them reach,
    else that it depends on them, or is not reproduced where hardly any (a twentieth) come within the band."""
    nearest_first = sorted(
        (_NEARNESS.index(judge(printed, read, value, tolerance)), abs(value - printed), value) for value in values
    )
    share = sum(rank < len(_NEARNESS) - 1 for rank, _, _ in nearest_first) / len(values)
    ruling = judge_near(printed, read, nearest_first[(len(values) - 1) // 2][2], tolerance)
    verdict = "depends on plan or release" if ruling.verdict == _NEARNESS[-1] and share > _FEW else ruling.verdict
    return replace(ruling, verdict=verdict, rule="near, in half of plans and releases", share=share)


def judge_either(printed: float, values: Sequence[float], tolerance: Tolerance) -> Ruling:
    """Return the ruling on a number that may be of any of several tables: in kind where only some give it."""
    nearest = min(values, key=lambda value: abs(value - printed), default=nan)
    agree = sum(abs(value - printed) <= tolerance.exact for value in values)
    verdict: Verdict = "reproduced in kind" if agree else "not reproduced"
    if agree == len(values):
        verdict = "reproduced" if values else "not checkable"
    return Ruling(verdict, nearest, "near", tolerance.exact)


def judge_limit(ours: float, below: float, below_in_kind: float = nan) -> Ruling:
    """Return the ruling on a claim that holds where a number is at or below `below`, in kind to `below_in_kind`."""
    verdict: Verdict = "not checkable"
    if isfinite(ours):
        verdict = "reproduced" if ours <= below else "reproduced in kind" if ours <= below_in_kind else "not reproduced"
    return Ruling(verdict, ours, "at most", below, below_in_kind)


def judge_at_least(ours: float, above: float, above_in_kind: float = nan) -> Ruling:
    """Return the ruling on a claim that holds where a number is at or above `above`, in kind `above_in_kind`."""
    below = judge_limit(-ours, -above, -above_in_kind)
    return Ruling(below.verdict, ours, "at least", above, above_in_kind)


def at_budget(ruling: Ruling, budget: float, printed_budget: float) -> Ruling:
    """Return the ruling on a search that is said of `printed_budget` evaluations: open with less, whatever it shows."""
    if ruling.verdict == "not checkable" or budget >= printed_budget:
        return ruling
    return replace(ruling, verdict="open at this budget")


def judge_level(printed: float, ours: Ours, budget: float, printed_budget: float, tolerance: Tolerance) -> Ruling:
    """Return the ruling on the level of a search of `printed_budget` evaluations: more only lower it, so one that is
    too low refutes it at any budget, and any other is open until the whole budget was spent."""
    ruling = judge_near(printed, printed, ours.median, tolerance)
    if ruling.verdict == "not reproduced" and ours.median < printed:
        return ruling
    return at_budget(ruling, budget, printed_budget)


def decades_between(a: float, b: float) -> float:
    """Return the distance of two numbers in decades; infinite unless both are above 0."""
    return abs(log10(a / b)) if a > 0 and b > 0 else inf


def median(values: Sequence[float] | Array) -> float:
    """Return the median; NaN of nothing."""
    return float(np.median(values)) if len(values) else nan


@final
@dataclass(frozen=True, eq=False)
class Evidence:
    """The runs of a paper's studies at one budget, and their traces (columns: `bench.store.runs`)."""

    runs: pd.DataFrame
    traces: pd.DataFrame

    def of(
        self, study: str, problem: str, optimizer: str, problem_options: Mapping[str, Any],
        optimizer_options: Mapping[str, Any] | None = None,
    ) -> pd.DataFrame:  # fmt: skip
        """Return the runs with these options, by repetition; an option that is not named may be anything."""
        runs = self.runs
        mine = runs[(runs["study"] == study) & (runs["problem"] == problem) & (runs["optimizer"] == optimizer)]
        for name, wanted in (("problem_options", problem_options), ("optimizer_options", optimizer_options or {})):
            have = [json.loads(text) for text in mine[name]]
            mine = mine[np.array([all(h.get(k) == v for k, v in wanted.items()) for h in have], dtype=bool)]
        return mine.sort_values(["problem_options", "repetition"], kind="stable")


@cache
def problem(name: str, **options: Any) -> Any:
    """Return a problem of the registry, whatever kind it is, made once."""
    return problems.make(name, **options)


def solved_for(misfit: Callable[[float], Array], start: float, scale: float = 1.0) -> tuple[float, Array]:
    """Return the number that makes misfit(number), shape (m,), least in squares, and the slopes there, shape (m,)."""
    from scipy.optimize import least_squares

    solve: Any = least_squares
    tight = dict.fromkeys(("xtol", "ftol", "gtol"), 1e-15)
    fit = solve(lambda x: misfit(float(x[0])), [start], method="lm", x_scale=scale, **tight)
    return float(fit.x[0]), np.asarray(fit.jac[:, 0])


def values_of(runs: pd.DataFrame, column: str) -> Array:
    return runs[column].to_numpy(dtype=float)


Numbers = Ours | Iterable[float] | float


def quantities(paper: str) -> dict[str, Constant]:
    """Return every printed number of `paper` by its key, such as ``table3.j1.la3``, in printed order."""
    numbers: dict[str, Constant] = {}

    def walk(node: Any, path: str) -> None:
        if not isinstance(node, dict):
            return
        if "place" in node:
            for name, constant in column(paper, path).entries.items():
                numbers[f"{path}.{name}"] = constant
        for name, below in node.items():
            if isinstance(below, dict) and "value" not in below:
                walk(below, f"{path}.{name}".lstrip("."))

    walk(_exact(paper), "")
    return numbers


@final
class Printed:
    """The cells of one paper: makes their rows, with a verdict from `judge` unless another is given."""

    def __init__(self, paper: str) -> None:
        self.paper = paper

    def column(self, key: str) -> Column:
        return column(self.paper, key)

    def digit(self, key: str) -> float:
        """Return what one unit of the last printed digit of the cell `key` is worth."""
        node = _exact(self.paper)
        for part in key.split("."):
            node = node[part]
        literal = node.get("printed", node["value"])
        return float(Decimal(1).scaleb(int(literal.as_tuple().exponent))) if isinstance(literal, Decimal) else 1.0

    def cell(
        self, key: str, ours: Numbers, tolerance: Tolerance, method: str, *, reason: str = "",
        ruling: Ruling | None = None, of_print: bool = False,
    ) -> Row:  # fmt: skip
        """Return the row of the cell `key`; with `of_print` ours is made of other numbers that the paper found."""
        name, _, quantity = key.rpartition(".")
        entry, ours = column(self.paper, name).entries[quantity], Ours.of(ours)
        inferred = "" if entry.certain else " (inferred, not seen in another print)"
        ruling = ruling or judge_near(entry.printed, entry.value, ours.median, tolerance)
        kind: Any = "consistency" if of_print else entry.kind
        why = reason, entry.why.strip() + inferred, entry.doubt
        about, differs = key, ""  # of a number that is printed again: where it stands first, why verdicts may differ
        for group in _exact(self.paper).get("one_print", ()):
            if key in group["keys"]:
                about, differs = group["keys"][0], group.get("differs", "")
        return Row(
            paper=self.paper, key=key, kind=kind, about=about, place=entry.place,
            quantity=quantity, unit=entry.unit, printed=float(entry.printed), read=float(entry.value),
            reason=" ".join("; ".join(filter(None, why)).split()), differs=differs, method=method,
            **_judged(ours, tolerance, ruling),
        )  # fmt: skip

    def unknown(self, key: str, reason: str = "", method: str = "none: data not published") -> Row:
        """Return the row of a cell about which nothing can be computed."""
        return self.cell(key, NOTHING, NO_TOLERANCE, method, reason=reason)

    def claim(
        self, key: str, place: str, sentence: str, *, ours: Numbers, ruling: Ruling, rule: str, method: str,
        reason: str = "", unit: str = "1", printed: float = nan, about: str = "", differs: str = "",
        read: float | None = None,
    ) -> Row:  # fmt: skip
        """Return the row of a sentence: `ours` measures it, `rule` says when it is true; `about` names the printed
        numbers that it repeats, `differs` why its verdict may be another than theirs, `read` what is to be read."""
        ours = Ours.of(ours)
        ruling = ruling if ours.n else replace(ruling, verdict="not checkable")
        return Row(
            paper=self.paper, key=f"claim.{key}", kind="claim", about=about, place=place, quantity=sentence, unit=unit,
            printed=float(printed), read=float(printed if read is None else read), reason=" ".join(reason.split()),
            differs=differs, method=method, **_judged(ours, Tolerance(ruling.limit, rule), ruling),
        )  # fmt: skip

    def erratum(
        self, place: str, quantity: str, *, unit: str, printed: float, read: float, ours: Numbers, tolerance: Tolerance,
        method: str, ruling: Ruling | None = None, differs: str = "",
    ) -> Row:  # fmt: skip
        """Return the row of the erratum at `place` in the data file: of a `quantity`, what the computation shows."""
        errata = _exact(self.paper)["erratum"]
        number = [entry["place"] for entry in errata].index(place)
        entry, ours = errata[number], Ours.of(ours)
        inferred = "" if entry["certain"] else " (inferred)"
        ruling = ruling or judge_near(printed, read, ours.median, tolerance)
        reason = f"printed: {entry['printed']}; read: {entry['read']}; {entry['why']}{inferred}"
        return Row(
            paper=self.paper, key=f"erratum.{number + 1}", kind="erratum", about=" ".join(entry.get("about", ())),
            place=place, quantity=quantity, unit=unit, printed=float(printed), read=float(read),
            reason=" ".join(reason.split()), differs=differs, method=method, **_judged(ours, tolerance, ruling),
        )  # fmt: skip

    def in_order(self, errata: Iterable[Row]) -> Iterator[Row]:
        """Yield the rows of all errata in the data file's order. Raises `KeyError` for one without a row."""
        by_place = {row.place: row for row in errata}
        for entry in _exact(self.paper)["erratum"]:
            yield by_place[entry["place"]]


def _judged(ours: Ours, tolerance: Tolerance, ruling: Ruling) -> dict[str, Any]:
    """Return the columns that follow from these: limits are the ruling's numbers and the tolerance's words."""
    return {
        "ours_median": ours.median, "ours_q1": ours.q1, "ours_q3": ours.q3, "n": ours.n, "verdict": ruling.verdict,
        "judged": float(ruling.judged), "rule": ruling.rule, "tolerance": float(ruling.limit),
        "tolerance_in_kind": float(ruling.in_kind), "tolerance_in_decades": ruling.decades,
        "tolerance_origin": float(tolerance.origin), "share": float(ruling.share), "why_tolerance": tolerance.why,
    }  # fmt: skip


@cache
def _exact(paper: str) -> dict[str, Any]:
    """Return the data file with its decimals as they are written: digits are part of what is printed."""
    text = files("calibench.problems").joinpath(f"data/{paper}.toml").read_text(encoding="utf-8")
    return tomllib.loads(text, parse_float=Decimal)


SCHEMA_VERSION = 3
_TYPES = {"int": pa.int64(), "float": pa.float64(), "bool": pa.bool_()}
LEDGER_SCHEMA = pa.schema(
    [*((field.name, _TYPES.get(str(field.type), pa.string())) for field in fields(Row)), ("schema_version", pa.int64())]
)


def to_table(rows: Sequence[Row]) -> pa.Table:
    """Return the rows as an Arrow table; a number that there is not (NaN) is null."""
    lines = [asdict(row) | {"schema_version": SCHEMA_VERSION} for row in rows]
    return pa.Table.from_pylist([{k: None if v != v else v for k, v in line.items()} for line in lines], LEDGER_SCHEMA)


def write_ledger(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write ``ledger.parquet``, with versions and commit in its metadata, and ``ledger.csv``; return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    metadata = {"calibench": json.dumps(provenance() | {"schema_version": SCHEMA_VERSION})}
    table = to_table(rows)
    known = table.replace_schema_metadata(metadata)
    return [
        write_whole(folder / "ledger.parquet", lambda file: pq.write_table(known, file, compression="zstd")),
        write_whole(folder / "ledger.csv", lambda file: pyarrow.csv.write_csv(table, file)),
    ]


def read_rows(path: Path) -> list[Row]:
    """Return the rows of a ledger written by `write_ledger`; a number that there is not is NaN."""
    lines: list[dict[str, Any]] = pq.read_table(path, columns=[field.name for field in fields(Row)]).to_pylist()
    for line in lines:
        line.update({name: nan for name, value in line.items() if value is None})
    return [Row(**line) for line in lines]


def kept(name: str) -> Path | None:
    """Return a file or folder of the reference, the kept run at the papers' own budget; None outside the repository."""
    path = Path(__file__).resolve().parents[2] / "results" / "reference" / name
    return path if path.exists() else None
