"""GPM2002, the redundant planar 2-dof manipulator: its calibration problems (Cong et al. 2008, sections 3 and 4).

A problem is a set of free parameters, a plan of end-effector positions, and the encoder readings which the true machine
would give there, or a user's own readings, which are validated once. The functions below name the papers' cases.
"""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, final

import numpy as np

from calibench.core.options import FilePath, suggest
from calibench.core.tables.columns import Declared, Quantity
from calibench.problems import instances
from calibench.problems.base import Array, Number, Parameter, frozen, numbers_of, registry
from calibench.problems.instances import Radians, Seed
from calibench.problems.planar import gpm2002
from calibench.problems.planar.closed_loop import ErrorName, Planar
from calibench.problems.planar.gpm2002 import NAMES, UNITS, Gauge, PlanName, Setting

_MOST_CONFIGURATIONS = 1_000_000  # one evaluation takes some 20 ms there, its Jacobian 300 MB
_READ = Declared(columns=tuple(Quantity(f"enc_{i}", "rad", needed=True) for i in "123"))
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

    def __init__(self, case: Callable[..., Case]) -> None:
        functools.update_wrapper(self, case)
        self.name = case.__name__
        self.case = case

    def __call__(self, **options: Any) -> Planar:
        """Build the problem with `options` (those of ``bench list problems``)."""
        options = registry.check(self.name, options)
        if options.get("instance") is not None:
            return _drawn(self, tuple(sorted(options.items())))
        if options.get("readings") is not None:
            return self.from_readings(options.pop("readings"), **options)
        chosen = registry.complete(self.name, options)
        case = self.case(**chosen)
        del chosen["instance"]  # the paper's problem says nothing of it
        if chosen["at_home"] is not None:
            raise ValueError(f"{self.name}.at_home: goes with measured readings, and there are none (readings=FILE)")
        return _simulate(self.name, case, chosen | {"n": case.samples}, gpm2002.home())

    def from_readings(
        self, readings: str | Path | Array | Sequence[Sequence[float]], *,
        nominal: Mapping[str, float] | None = None, box: Mapping[str, tuple[float, float]] | None = None,
        **options: Any,
    ) -> Planar:  # fmt: skip
        """Build the problem from measured encoder readings: an array of shape (n, 3) [rad], or a CSV file.

        The CSV has a header with enc_1, enc_2, enc_3, or three bare columns. Held parameters keep their `nominal`
        values (mm, rad; those not named are the maker's). `box` widens or moves bounds by name. ``at_home=[a, b, c]``,
        the readings with the end-effector at the home position, sets the start of the offsets (section 3.2, step 3);
        without it the encoders are taken to read joint angles to within .2 rad.

        Raises `ValueError` for readings that are not finite radians of shape (n, 3), too few of them, an unknown name,
        or a start outside the box.
        """
        options = registry.check(self.name, options)
        for key in ("plan", "radius", "n", "noise", "data_seed"):
            if key in options:
                raise ValueError(
                    f"{self.name}.{key}: simulates readings, but readings are given; leave one of the two out"
                )
        chosen = registry.complete(self.name, options)
        if chosen.pop("instance") is not None:
            raise ValueError(f"{self.name}.instance: draws a machine, but its readings are given; leave one out")
        is_file = isinstance(readings, str | Path)
        if isinstance(readings, str | Path):  # columns enc_1..3, or three columns without header
            columns = _READ.read(readings, f"readings={readings}", bare=True).columns
            table = np.column_stack([columns[name] for name in _READ.units]).astype(float)
        else:
            table = numbers_of(readings)
        if table.ndim != 2 or table.shape[1] != 3 or not len(table):
            raise ValueError(f"readings have shape {table.shape}: (n, 3) is needed, a column for each encoder")
        bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
        if bad.size:
            raise ValueError(f"readings: row {bad[0] + 1} is not finite ({bad.size} such rows); leave them out")
        if np.abs(table).max() > 4 * np.pi:
            raise ValueError(f"readings reach {np.abs(table).max():.4g}: they look like degrees, radians are needed")

        chosen |= {"readings": str(readings) if is_file else None}
        case = self.case(**chosen)
        setting = gpm2002.own_machine(nominal or {}, box or {}, chosen["at_home"])
        chosen |= {"n": len(table), "plan": None, "radius": None, "noise": None, "data_seed": None}
        return _assemble(self.name, Case(case.free, setting, len(table), case.gauge, "nominal"), chosen, table, None)


@registry.register("sensor_zero")
@PlanarFamily
def sensor_zero(
    error: Literal["J1", "J2"] = "J2", plan: PlanName = "grid", radius: float = 60.0, n: int = 9,
    noise: Radians = 0.0, data_seed: Seed = 0, free: tuple[str, ...] | None = None, readings: FilePath | None = None,
    at_home: tuple[float, ...] | None = None, instance: Number = None,
) -> Case:  # fmt: skip
    """Three sensor offsets, geometry known (section 3.3 A, Table 2). With n=3 some plans have further exact zeros."""
    return Case(_OFFSETS, gpm2002.section3("table2"), n)


@registry.register("link_length")
@PlanarFamily
def link_length(
    error: ErrorName = "J2", plan: PlanName = "grid", radius: float = 120.0, n: int = 21, noise: Radians = 0.0,
    data_seed: Seed = 0, free: tuple[str, ...] | None = None, readings: FilePath | None = None,
    at_home: tuple[float, ...] | None = None, instance: Number = None,
) -> Case:  # fmt: skip
    """Offsets and six link lengths, bases known (section 3.3 B, Table 3)."""
    return Case(_OFFSETS + _LENGTHS, gpm2002.section3("table3"), n)


@registry.register("full11")
@PlanarFamily
def full11(
    error: ErrorName = "J2", paper_section: Literal[3, 4] = 4, plan: PlanName = "disc", radius: float = 100.0,
    n: int | None = None, noise: Radians = 0.0, data_seed: Seed = 0, free: tuple[str, ...] | None = None,
    readings: FilePath | None = None, at_home: tuple[float, ...] | None = None, instance: Number = None,
) -> Case:  # fmt: skip
    """All that angle readings can see: 11 parameters, A_1 and A_2 held (Table 5, or Table 4 with paper_section=3)."""
    names = (*_OFFSETS, *_LENGTHS, "xa3", "ya3")
    if paper_section == 3:
        return Case(names, gpm2002.section3("table4"), 31 if n is None else n)
    return Case(names, gpm2002.section4(), 50 if n is None else n, default_start="random")


@registry.register("full12")
@PlanarFamily
def full12(
    error: ErrorName = "J2", gauge: Literal["xa2", "ya2"] = "xa2", plan: PlanName = "disc", radius: float = 100.0,
    n: int | None = None, noise: Radians = 0.0, data_seed: Seed = 0, free: tuple[str, ...] | None = None,
    readings: FilePath | None = None, at_home: tuple[float, ...] | None = None, instance: Number = None,
) -> Case:  # fmt: skip
    """The papers' 12 parameters, of which readings see 11: section 4 holds x_a2 (Table 5), section 3 y_a2 (Table 4)."""
    if gauge == "ya2":
        names = (*_OFFSETS, *_LENGTHS, "xa2", "xa3", "ya3")
        return Case(names, gpm2002.section3("table4"), 31 if n is None else n, Gauge("ya2"))
    names = ("ya2", "xa3", "ya3", *_LENGTHS, *_OFFSETS)
    return Case(names, gpm2002.section4(), 50 if n is None else n, Gauge("xa2"), default_start="random")


@functools.lru_cache(maxsize=256)  # a problem is a value, and drawing it takes a hundred times as long as a call
def _drawn(family: PlanarFamily, given: tuple[tuple[str, Any], ...]) -> Planar:
    """Return the problem that the instance draws: the case's free parameters, another machine, plan, noise and box."""
    name, chosen = family.name, registry.complete(family.name, dict(given))
    case, instance = family.case(**chosen), chosen["instance"]

    if chosen["readings"] is not None or chosen["at_home"] is not None:
        raise ValueError(f"{name}.instance={instance}: draws a machine, but its readings are given; leave one out")
    rank = len(case.free) - (case.gauge is not None)
    drawn = instances.first_that_fits(name, instance, functools.partial(_attempt, name, case.free, rank, instance))
    paper = {"paper_section": 4} if "paper_section" in chosen else {}  # section 3 is another setting of the paper
    instances.refuse_drawn(name, instance, dict(given), {**drawn.options, **paper})
    other = Case(case.free, drawn.machine, drawn.plan.n, case.gauge, case.default_start)
    problem = _simulate(name, other, {**chosen, **drawn.options}, drawn.plan.centre)
    says = dict(problem.options) | dict.fromkeys(drawn.options)  # the instance says it all
    return replace(problem, options=says, drawn=drawn)


@functools.cache
def _attempt(
    family: str, free: tuple[str, ...], rank: int, instance: int, attempt: int
) -> gpm2002.PlanarInstance | None:
    """Return what an attempt draws; None where it cannot be built or not identified."""
    things = ("machine", "box", "plan", "noise")
    streams = {thing: instances.Stream.of(family, instance, attempt, thing) for thing in things}
    nominal = gpm2002.nominal_machine(streams["machine"])
    table5 = gpm2002.section4()
    half = np.where(np.array(UNITS) == "rad", (table5.upper - table5.lower)[12] / 2, 5.0)
    box = instances.Box.drawn(streams["box"], nominal, half, gpm2002.DIGITS)
    actual = np.where([name in free for name in NAMES], box.truth, nominal)
    setting = Setting(actual, nominal, nominal, box.lower, box.upper)
    plan = gpm2002.DrawnPlan.drawn(streams["plan"], max(gpm2002.FEWEST_POSES, 2 * len(free)))
    noise = instances.Noise.drawn(streams["noise"], *gpm2002.NOISES)
    options: dict[str, Any] = {"plan": plan.kind, "radius": plan.radius, "n": plan.n}
    options |= {"noise": noise.level, "data_seed": noise.data_seed}
    drawn = gpm2002.PlanarInstance(setting, box, plan, noise, options, attempt + 1)
    points, _ = plan.points(noise.data_seed)
    if not (gpm2002.within_reach(actual, points) and gpm2002.within_reach(nominal, points)):
        return None
    quiet = {"error": "J2", "free": None, **drawn.options, "noise": 0.0}
    problem = _simulate(family, Case(free, setting, plan.n), quiet, plan.centre)
    return drawn if instances.can_be_identified(problem, rank, noise.level) else None


def _simulate(name: str, case: Case, chosen: dict[str, Any], centre: Array) -> Planar:
    """Take the readings that the actual machine gives at the planned positions, with noise."""
    _free_names(name, case, chosen)
    actual = case.setting.actual
    assert actual is not None
    plan = gpm2002.DrawnPlan(chosen["plan"], chosen["radius"], case.samples, centre)
    try:
        points, shake = plan.points(chosen["data_seed"])
    except ValueError as error:
        raise ValueError(f"{name}.{error}") from None
    readings = gpm2002.inverse_kinematics(actual, points) - actual[12:15]
    gpm2002.refuse_out_of_reach(name, chosen["radius"], points, readings)
    readings = readings + chosen["noise"] * shake.standard_normal(readings.shape)
    return _assemble(name, case, chosen, readings, points)


def _assemble(name: str, case: Case, chosen: dict[str, Any], readings: Array, points: Array | None) -> Planar:
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
        template = gpm2002.to_cartesian(template)
        # J3's search coordinates: l_a becomes l_a cos z (lac) and z becomes l_a sin z (las), eq. (44) inverted; their
        # box is the bounding box of the sector that the box of (l_a, z) cuts
        by_name, quarter, swapped = {p.name: p for p in parameters}, np.pi / 2, list(parameters)
        for k, p in enumerate(parameters):
            if not p.name.startswith(("la", "z")):
                continue
            la, z = by_name["la" + p.name[-1]], by_name["z" + p.name[-1]]
            side = np.cos if p.name.startswith("la") else np.sin
            turns = range(int(np.ceil(z.lower / quarter)), int(np.floor(z.upper / quarter)) + 1)
            values = [float(side(angle)) for angle in (z.lower, z.upper, *(i * quarter for i in turns))]
            corners = [radius * trig for radius in (la.lower, la.upper) for trig in (min(values), max(values))]
            true = None if la.true is None or z.true is None else la.true * float(side(z.true))
            other = ("lac" if side is np.cos else "las") + p.name[-1]
            swapped[k] = Parameter(other, "mm", la.start * float(side(z.start)), min(corners), max(corners), true)
        coordinates = tuple(swapped)
    return Planar(
        name=name, options={key: list(value) if isinstance(value, tuple) else value for key, value in says.items()},
        parameters=parameters, coordinates=coordinates, readings=frozen(readings), error=error,
        noise=chosen["noise"] or 0.0, gauge=case.gauge if free == case.free else None,
        true_positions=None if points is None else frozen(points), default_start=case.default_start,
        _template=frozen(template), _turn=frozen(setting.start[12:15]),
    )  # fmt: skip


def _free_names(name: str, case: Case, chosen: dict[str, Any]) -> tuple[str, ...]:
    """Return the free parameters in the case's order, after `free=` held the others at their known values."""
    wanted = case.free if chosen["free"] is None else chosen["free"]
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
    free = tuple(p for p in case.free if p in wanted)
    if case.samples < len(free):
        raise ValueError(f"{name}.n={case.samples}: {len(free)} parameters need at least {len(free)} configurations")
    if case.samples > _MOST_CONFIGURATIONS:
        raise ValueError(f"{name}.n={case.samples}: at most {_MOST_CONFIGURATIONS} configurations are simulated")
    return free
