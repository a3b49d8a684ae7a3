"""GPM2002, the redundant planar 2-dof manipulator: its calibration problems (Cong et al. 2008, sections 3 and 4).

A problem is a set of free parameters, a plan of end-effector positions, and the encoder readings which the true machine
would give there (or a user's own readings). The functions below name the papers' cases.

J3's search coordinates: l_a cos z and l_a sin z in place of l_a and z, eq. (44) inverted (Cong et al. 2008).

Measured encoder readings: a CSV file or an array, validated once.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, final

import numpy as np

from calibench.core.options import FilePath, suggest
from calibench.core.tables.cells import factor_to_base, with_points
from calibench.core.tables.csv_table import Table, read_table
from calibench.problems.base import Array, Parameter, frozen, numbers_of, registry
from calibench.problems.instances import check_instance, refuse_drawn
from calibench.problems.planar.closed_loop import ErrorName, Planar
from calibench.problems.planar.gpm2002 import (
    NAMES,
    UNITS,
    Gauge,
    PlanName,
    Setting,
    home,
    inverse_kinematics,
    own_machine,
    plan_points,
    section3,
    section4,
    to_cartesian,
)
from calibench.problems.planar.instances import PlanarInstance, planar_instance


def cartesian_coordinates(parameters: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
    """Return J3's search coordinates: l_a becomes l_a cos z (lac) and z becomes l_a sin z (las), eq. (44) inverted.

    Their box is the bounding box of the sector that the box of (l_a, z) cuts.
    """
    by_name = {p.name: p for p in parameters}
    swapped = []
    for p in parameters:
        if not p.name.startswith(("la", "z")):
            swapped.append(p)
            continue
        la, z = by_name["la" + p.name[-1]], by_name["z" + p.name[-1]]
        side = np.cos if p.name.startswith("la") else np.sin
        low, high = _range_of(side, z.lower, z.upper)
        corners = [radius * trig for radius in (la.lower, la.upper) for trig in (low, high)]
        true = None if la.true is None or z.true is None else la.true * float(side(z.true))
        name = ("lac" if side is np.cos else "las") + p.name[-1]
        swapped.append(Parameter(name, "mm", la.start * float(side(z.start)), min(corners), max(corners), true))
    return tuple(swapped)


def _range_of(side: Callable[[float], float], low: float, high: float) -> tuple[float, float]:
    """Return the least and largest value of cos or sin between two angles."""
    quarter = np.pi / 2
    turns = [k * quarter for k in range(int(np.ceil(low / quarter)), int(np.floor(high / quarter)) + 1)]
    values = [float(side(angle)) for angle in (low, high, *turns)]
    return min(values), max(values)


_COLUMNS = ("enc_1", "enc_2", "enc_3")


def read_csv(path: str | Path) -> Array:
    """Return the readings of a CSV file [rad], shape (n, 3): columns enc_1..3, or three columns without header.

    A unit behind a name (`enc_1 [deg]`) is turned into radians; lines that begin with # and other columns are passed
    over, so a file of measured data is read as well. Decimal commas are read where commas do not part the cells. Raises
    `ValueError` with the file, the row and what is wrong.
    """
    try:
        found = read_table(path, bare=True)
        factors = [factor_to_base(name, found.units.get(name, "rad"), "rad")[1] for name in _COLUMNS]
        cells = _cells(found)
    except (OSError, ValueError) as error:
        raise ValueError(f"readings={path}: cannot be read: {error}") from None
    names = found.names or _COLUMNS
    missing = [name for name in _COLUMNS if name not in names]
    if missing:
        raise ValueError(f"readings={path}: no column {', '.join(missing)}; the header has {', '.join(names)}")
    table = []
    for (line, row), *three in zip(found.rows, *(cells[name] for name in _COLUMNS), strict=True):
        try:
            table.append([float(cell) for cell in three])
        except ValueError:
            raise ValueError(f"readings={path}: row {line} does not hold three numbers: {list(row)!r:.80}") from None
    return np.array(table) * factors if table else np.empty((0, 0))


def _cells(found: Table) -> dict[str, list[str]]:
    """Return the cells of each column that has a name, "" where its row ends before, with decimal points."""
    names = found.names or _COLUMNS
    rows = [row for _, row in found.rows]
    columns = {n: [row[k].strip() if k < len(row) else "" for row in rows] for k, n in enumerate(names) if n}
    own = (cell for name in _COLUMNS for cell in columns.get(name, ()))
    return with_points(columns) if found.delimiter != "," and any("," in cell for cell in own) else columns


_MOST_CONFIGURATIONS = 1_000_000  # one evaluation takes some 20 ms there, its Jacobian 300 MB
_OFFSETS = ("z1", "z2", "z3")
_LENGTHS = ("la1", "la2", "la3", "lb1", "lb2", "lb3")


@dataclass(frozen=True)
class Case:
    """A setting with its free parameters in order: what is left to choose are plan, noise and error function."""

    free: tuple[str, ...]
    setting: Setting
    samples: int
    gauge: Gauge | None = None
    default_start: Literal["nominal", "random"] = "nominal"


@final
class PlanarFamily:
    """A named family of planar problems: call it with options, or with `from_readings` for measured readings."""

    said_if_chosen = ("instance",)  # so that the rows of the papers' problems stay as they were

    def __init__(self, case: Callable[..., Case]) -> None:
        functools.update_wrapper(self, case)
        self.name = case.__name__
        self._case = case

    def __call__(self, **options: Any) -> Planar:
        """Build the problem with `options` (those of ``bench list problems``)."""
        options = registry.check(self.name, options)
        case, chosen = self.chosen(options)
        if chosen["instance"] is not None:
            return _drawn(self, tuple(sorted(options.items())))
        del chosen["instance"]  # the paper's problem says nothing of it
        if chosen["readings"] is not None:
            _refuse_plan_options(self.name, options)
            return self._measured(case, chosen, read_csv(chosen["readings"]))
        if chosen["at_home"] is not None:
            raise ValueError(f"{self.name}.at_home: goes with measured readings, and there are none (readings=FILE)")
        return _simulate(self.name, case, chosen, home())

    def chosen(self, options: Mapping[str, Any]) -> tuple[Case, dict[str, Any]]:
        """Return the case of checked `options`, and all of them with the defaults."""
        bound = inspect.signature(self._case).bind(**options)
        bound.apply_defaults()
        chosen = dict(bound.arguments)
        case = self._case(**chosen)
        return case, chosen | {"n": case.samples}

    def from_readings(
        self,
        readings: str | Path | Array | Sequence[Sequence[float]],
        *,
        nominal: Mapping[str, float] | None = None,
        box: Mapping[str, tuple[float, float]] | None = None,
        **options: Any,
    ) -> Planar:
        """Build the problem from measured encoder readings: an array of shape (n, 3) [rad], or a CSV file.

        The CSV has a header with enc_1, enc_2, enc_3, or three bare columns. Held parameters keep their `nominal`
        values (mm, rad; those not named are the maker's). `box` widens or moves bounds by name. ``at_home=[a, b, c]``,
        the readings with the end-effector at the home position, sets the start of the offsets (section 3.2, step 3);
        without it the encoders are taken to read joint angles to within .2 rad.

        Raises `ValueError` for readings that are not finite radians of shape (n, 3), too few of them, an unknown name,
        or a start outside the box.
        """
        options = registry.check(self.name, options)
        _refuse_plan_options(self.name, options)
        bound = inspect.signature(self._case).bind(**options)
        bound.apply_defaults()
        chosen = dict(bound.arguments)
        if chosen.pop("instance") is not None:
            raise ValueError(f"{self.name}.instance: draws a machine, but its readings are given; leave one out")
        table = read_csv(readings) if isinstance(readings, str | Path) else numbers_of(readings)
        chosen["readings"] = str(readings) if isinstance(readings, str | Path) else None
        return self._measured(self._case(**chosen), chosen, table, nominal, box)

    def _measured(
        self,
        case: Case,
        chosen: dict[str, Any],
        readings: Array,
        nominal: Mapping[str, float] | None = None,
        box: Mapping[str, tuple[float, float]] | None = None,
    ) -> Planar:
        # raise `ValueError` for readings that are not finite radians of shape (n, 3)
        if readings.ndim != 2 or readings.shape[1] != 3 or not len(readings):
            raise ValueError(f"readings have shape {readings.shape}: (n, 3) is needed, a column for each encoder")
        bad = np.flatnonzero(~np.isfinite(readings).all(axis=1))
        if bad.size:
            raise ValueError(f"readings: row {bad[0] + 1} is not finite ({bad.size} such rows); leave them out")
        if np.abs(readings).max() > 4 * np.pi:
            raise ValueError(f"readings reach {np.abs(readings).max():.4g}: they look like degrees, radians are needed")
        setting = own_machine(nominal or {}, box or {}, chosen["at_home"])
        chosen |= {"n": len(readings), "plan": None, "radius": None, "noise": None, "data_seed": None}
        own = Case(case.free, setting, len(readings), case.gauge, "nominal")
        return _assemble(self.name, own, chosen, readings, None)


@registry.register("sensor_zero")
@PlanarFamily
def sensor_zero(
    error: Literal["J1", "J2"] = "J2",
    plan: PlanName = "grid",
    radius: float = 60.0,
    n: int = 9,
    noise: float = 0.0,
    data_seed: int = 0,
    free: tuple[str, ...] | None = None,
    readings: FilePath | None = None,
    at_home: tuple[float, ...] | None = None,
    instance: int | None = None,
) -> Case:
    """Three sensor offsets, geometry known (section 3.3 A, Table 2). With n=3 some plans have further exact zeros."""
    return Case(_OFFSETS, section3("table2"), n)


@registry.register("link_length")
@PlanarFamily
def link_length(
    error: ErrorName = "J2",
    plan: PlanName = "grid",
    radius: float = 120.0,
    n: int = 21,
    noise: float = 0.0,
    data_seed: int = 0,
    free: tuple[str, ...] | None = None,
    readings: FilePath | None = None,
    at_home: tuple[float, ...] | None = None,
    instance: int | None = None,
) -> Case:
    """Offsets and six link lengths, bases known (section 3.3 B, Table 3)."""
    return Case(_OFFSETS + _LENGTHS, section3("table3"), n)


@registry.register("full11")
@PlanarFamily
def full11(
    error: ErrorName = "J2",
    paper_section: Literal[3, 4] = 4,
    plan: PlanName = "disc",
    radius: float = 100.0,
    n: int | None = None,
    noise: float = 0.0,
    data_seed: int = 0,
    free: tuple[str, ...] | None = None,
    readings: FilePath | None = None,
    at_home: tuple[float, ...] | None = None,
    instance: int | None = None,
) -> Case:
    """All that angle readings can see: 11 parameters, A_1 and A_2 held (Table 5, or Table 4 with paper_section=3)."""
    names = (*_OFFSETS, *_LENGTHS, "xa3", "ya3")
    if paper_section == 3:
        return Case(names, section3("table4"), 31 if n is None else n)
    return Case(names, section4(), 50 if n is None else n, default_start="random")


@registry.register("full12")
@PlanarFamily
def full12(
    error: ErrorName = "J2",
    gauge: Literal["xa2", "ya2"] = "xa2",
    plan: PlanName = "disc",
    radius: float = 100.0,
    n: int | None = None,
    noise: float = 0.0,
    data_seed: int = 0,
    free: tuple[str, ...] | None = None,
    readings: FilePath | None = None,
    at_home: tuple[float, ...] | None = None,
    instance: int | None = None,
) -> Case:
    """The papers' 12 parameters, of which readings see 11: section 4 holds x_a2 (Table 5), section 3 y_a2 (Table 4)."""
    if gauge == "ya2":
        names = (*_OFFSETS, *_LENGTHS, "xa2", "xa3", "ya3")
        return Case(names, section3("table4"), 31 if n is None else n, Gauge("ya2"))
    names = ("ya2", "xa3", "ya3", *_LENGTHS, *_OFFSETS)
    return Case(names, section4(), 50 if n is None else n, Gauge("xa2"), default_start="random")


def simulated(name: str, free: tuple[str, ...], drawn: PlanarInstance) -> Planar:
    """Return the J2 problem of the readings that a drawn machine gives, its parameters `free`."""
    chosen = {"error": "J2", "free": None, **drawn.options}
    return _simulate(name, Case(free, drawn.setting, drawn.plan.n), chosen, drawn.plan.centre)


@functools.lru_cache(maxsize=256)  # a problem is a value, and drawing it takes a hundred times as long as a call
def _drawn(family: PlanarFamily, given: tuple[tuple[str, Any], ...]) -> Planar:
    """Return the problem that the instance draws: the case's free parameters, another machine, plan, noise and box."""
    name, (case, chosen) = family.name, family.chosen(dict(given))
    instance: int = chosen["instance"]
    check_instance(name, instance)
    if chosen["readings"] is not None or chosen["at_home"] is not None:
        raise ValueError(f"{name}.instance={instance}: draws a machine, but its readings are given; leave one out")
    drawn = planar_instance(name, case.free, len(case.free) - (case.gauge is not None), instance)
    paper = {"paper_section": 4} if "paper_section" in chosen else {}  # section 3 is another setting of the paper
    refuse_drawn(name, instance, dict(given), drawn.options | paper)
    other = Case(case.free, drawn.setting, drawn.plan.n, case.gauge, case.default_start)
    problem = _simulate(name, other, chosen | drawn.options, drawn.plan.centre)
    says = dict(problem.options) | dict.fromkeys(drawn.options)  # the instance says it all
    return replace(problem, options=says, drawn=drawn)


def _simulate(name: str, case: Case, chosen: dict[str, Any], centre: Array) -> Planar:
    """Take the readings that the actual machine gives at the planned positions, with noise."""
    if not 0 <= chosen["noise"] <= 1:
        rule = "cannot be negative" if chosen["noise"] < 0 else "above 1 rad leaves no reading"
        raise ValueError(f"{name}.noise={chosen['noise']:g}: a standard deviation [rad] {rule}")
    if chosen["data_seed"] < 0:
        raise ValueError(f"{name}.data_seed={chosen['data_seed']}: must be 0 or above")
    _check_count(name, case, chosen)
    actual = case.setting.actual
    assert actual is not None
    where, shake = (np.random.default_rng(s) for s in np.random.SeedSequence(chosen["data_seed"]).spawn(2))
    try:
        points = plan_points(chosen["plan"], centre, chosen["radius"], case.samples, where)
    except ValueError as error:
        raise ValueError(f"{name}.{error}") from None
    readings = inverse_kinematics(actual, points) - actual[12:15]
    if not np.isfinite(readings).all():
        bad, leg = np.argwhere(~np.isfinite(readings))[0]
        x, y = points[bad]
        raise ValueError(
            f"{name}.radius={chosen['radius']:g}: position ({x:.1f}, {y:.1f}) mm is out of reach of leg {leg + 1}; "
            "take a smaller radius"
        )
    readings = readings + chosen["noise"] * shake.standard_normal(readings.shape)
    return _assemble(name, case, chosen, readings, points)


def _assemble(name: str, case: Case, chosen: dict[str, Any], readings: Array, points: Array | None) -> Planar:
    """Make the problem's value out of case, options and readings."""
    _check_count(name, case, chosen)
    free = _free_names(name, case, chosen)
    says = chosen | {"free": None if free == case.free else free}  # one problem is told in one way, however it is asked
    setting, error = case.setting, chosen["error"]
    template = setting.nominal.copy() if setting.actual is None else setting.actual.copy()
    parameters = tuple(
        Parameter(
            p, UNITS[i], setting.start[i], setting.lower[i], setting.upper[i],
            None if setting.actual is None else float(setting.actual[i]),
        )
        for p, i in ((p, NAMES.index(p)) for p in free)
    )  # fmt: skip
    coordinates = parameters
    if error == "J3":
        coordinates = cartesian_coordinates(parameters)
        template = to_cartesian(template)
    return Planar(
        name=name,
        options={key: list(value) if isinstance(value, tuple) else value for key, value in says.items()},
        parameters=parameters,
        coordinates=coordinates,
        readings=frozen(readings),
        error=error,
        noise=chosen["noise"] or 0.0,
        gauge=case.gauge if free == case.free else None,
        true_positions=None if points is None else frozen(points),
        default_start=case.default_start,
        _template=frozen(template),
        _turn=frozen(setting.start[12:15]),
    )


def _free_names(name: str, case: Case, chosen: dict[str, Any]) -> tuple[str, ...]:
    """Return the free parameters in the case's order, after `free=` held the others at their known values."""
    wanted = chosen["free"]
    if wanted is None:
        return case.free
    for parameter in wanted:
        if parameter not in case.free:
            raise ValueError(f"{name}.free: {parameter!r} is no parameter of it; {suggest(parameter, case.free)}")
    if not wanted:
        raise ValueError(f"{name}.free=[]: at least one parameter must stay free")
    if chosen["error"] == "J3":
        for i in "123":
            if (f"la{i}" in wanted) != (f"z{i}" in wanted):
                raise ValueError(
                    f"{name}.free: J3 searches (la{i} cos z{i}, la{i} sin z{i}), so free both or neither; or use J2"
                )
    return tuple(p for p in case.free if p in wanted)


def _check_count(name: str, case: Case, chosen: dict[str, Any]) -> None:
    needed = len(_free_names(name, case, chosen))
    if case.samples < needed:
        raise ValueError(f"{name}.n={case.samples}: {needed} parameters need at least {needed} configurations")
    if case.samples > _MOST_CONFIGURATIONS:
        raise ValueError(f"{name}.n={case.samples}: at most {_MOST_CONFIGURATIONS} configurations are simulated")


def _refuse_plan_options(name: str, options: Mapping[str, Any]) -> None:
    for key in ("plan", "radius", "n", "noise", "data_seed"):
        if key in options:
            raise ValueError(f"{name}.{key}: simulates readings, but readings are given; leave one of the two out")
