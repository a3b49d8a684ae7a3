"""GPM2002, the redundant planar 2-dof manipulator: its calibration problems (Cong et al. 2008, sections 3 and 4).

A problem is a set of free parameters, a plan of end-effector positions, and the encoder readings which the true machine
would give there (or a user's own readings). `Planar` is that value; the functions below name the papers' cases.
"""

from __future__ import annotations

import csv
import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from typing import Any, Literal, final

import numpy as np

from problems import constants
from problems.base import Array, Parameter, registry
from problems.gauge import Gauge
from problems.plans import PlanName, plan_points

NAMES = (
    "xa1", "ya1", "xa2", "ya2", "xa3", "ya3", "la1", "la2", "la3", "lb1", "lb2", "lb3", "z1", "z2", "z3",
)  # fmt: skip
ErrorName = Literal["J1", "J2", "J3"]
_UNITS = ("mm",) * 12 + ("rad",) * 3
_OFFSETS = ("z1", "z2", "z3")
_LENGTHS = ("la1", "la2", "la3", "lb1", "lb2", "lb3")
_PAPER = "cong2008"


@final
@dataclass(frozen=True, eq=False)
class Planar:
    """A GPM2002 calibration problem: minimise J1, J2 or J3 over the free parameters, given encoder readings.

    `readings` has shape (n, 3), rad. A call takes x of shape (dim,) in `coordinates` and returns mm^2 (J1) or mm^4
    (J2, J3); ``problem(x) == r @ r`` with ``r = problem.residuals(x)``, of shape (n,), or (3n,) for J1.
    `true_positions`, shape (n, 2), are the end-effectors the readings were taken at; None for a user's readings.
    """

    name: str
    options: Mapping[str, Any]
    parameters: tuple[Parameter, ...]
    coordinates: tuple[Parameter, ...]
    readings: Array
    error: ErrorName
    noise: float
    gauge: Gauge | None
    true_positions: Array | None
    default_start: Literal["nominal", "random"]
    lower: Array = field(init=False)
    upper: Array = field(init=False)
    start: Array = field(init=False)
    truth: Array | None = field(init=False)
    _template: Array = field(kw_only=True, repr=False)
    _arguments: tuple[Any, ...] = field(init=False, repr=False)
    _kernels: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        from problems import _planar_kernels  # here, as listing the names must not load the compiler

        set_ = functools.partial(object.__setattr__, self)
        for key in ("lower", "upper", "start"):
            set_(key, _frozen([getattr(c, key) for c in self.coordinates]))
        known = all(c.true is not None for c in self.coordinates)
        set_("truth", _frozen([c.true for c in self.coordinates]) if known else None)
        trig = [f(self.readings[:, i]) for i in range(3) for f in (np.cos, np.sin)]
        free = np.array([NAMES.index(p.name) for p in self.parameters])
        polar, legs = self.error != "J3", self.error == "J1"
        set_("_kernels", _planar_kernels)
        set_("_arguments", (_frozen(np.column_stack(trig)), self._template, free, polar, legs))

    def __call__(self, x: Array) -> float:
        """Return the error of the candidate x, shape (dim,)."""
        value: float = self._kernels.cost(_vector(x), *self._arguments)
        return value

    def batch(self, points: Array) -> Array:
        """Return the errors, shape (k,), of candidates of shape (k, dim): the same bits as one call for each."""
        result: Array = self._kernels.batch(_vector(points), *self._arguments)
        return result

    def residuals(self, x: Array) -> Array:
        """Return sqrt(3) g_j [mm^2], shape (n,), or for J1 the leg errors |P - B_i| - l_b [mm], shape (3n,)."""
        result: Array = self._kernels.residuals(_vector(x), *self._arguments)
        return result

    def jacobian(self, x: Array) -> Array:
        """Return the analytic derivative of the residuals in the coordinates of x, shape (m, dim)."""
        result: Array = self._kernels.jacobian(_vector(x), *self._arguments)
        return result

    def positions(self, x: Array) -> Array:
        """Return the calibrated end-effectors, eq. (33), shape (n, 2), mm."""
        result: Array = self._kernels.positions(_vector(x), *self._arguments[:4])
        return result

    def residual_noise(self, x: Array) -> Array:
        """Return the standard deviation of each residual for 1 rad of independent noise on every reading, shape (m,).

        It is |dr_j / d reading|, as a reading acts like its sensor offset.
        """
        samples, legs = self._arguments[0], self._arguments[4]
        machine, every = self._machine(x), np.arange(len(NAMES))
        slopes = self._kernels.jacobian(machine, samples, machine, every, True, legs)[:, 12:15]
        return np.asarray(np.sqrt((slopes**2).sum(axis=1)))

    def physical(self, x: Array) -> Array:
        """Return the physical parameters of x, shape (dim,), in the order of `parameters`."""
        machine = self._machine(x)
        return np.array([machine[NAMES.index(p.name)] for p in self.parameters])

    def merit(self, x: Array) -> dict[str, float]:
        """Return the figures of merit of an answer against the truth; empty where the truth is not known.

        kmrmse [mm], eq. (40); kmrmse_aligned after the best move along the gauge; gauge_phi [rad], the angle of that
        move seen from the truth (0 where there is no gauge); the worst parameter errors as found and aligned, mm, rad.
        """
        if self.truth is None or self.true_positions is None:
            return {}
        machine, true = self._machine(x), self._machine(self.truth)
        reached = self.positions(x)
        if not np.isfinite(reached).all():
            return {}
        merit = {"kmrmse": _rms_distance(reached, self.true_positions), **self._worst(machine, true, "")}
        phi, aligned = 0.0, machine
        if self.gauge is not None:
            phi, aligned = self.gauge.align(machine, reached, self.true_positions)
        polar = self.error != "J3"
        moved = self.positions(self._from_machine(aligned) if not polar else aligned[self._arguments[2]])
        merit["kmrmse_aligned"] = _rms_distance(moved, self.true_positions)
        merit["gauge_phi"] = phi
        return merit | self._worst(aligned, true, "_aligned")

    @property
    def targets(self) -> tuple[float, ...]:
        """Error levels whose first crossing is recorded; the last is the level of success without noise.

        J2 and J3 round to about 1e-19 at the truth, J1 to 5e-25; nothing below the last target is ever ranked.
        """
        return tuple(10.0**k for k in (range(-1, -24, -2) if self.error == "J1" else range(4, -19, -2)))

    @property
    def budgets(self) -> dict[str, int]:
        """Evaluations meant by the words `ci` and `paper` (section 4.4 stops at 5e7)."""
        return {"ci": 20_000, "paper": int(constants.column(_PAPER, "section44")["evaluations"])}

    @property
    def gauge_tangent(self) -> Array | None:
        """Return the direction in `coordinates` at the truth (or start) that no reading can see; None without gauge."""
        if self.gauge is None:
            return None
        machine = self._machine(self.start if self.truth is None else self.truth)
        tangent = self.gauge.tangent(machine)
        if self.error == "J3":
            la, z, dla, dz = machine[6:9], machine[12:15], tangent[6:9].copy(), tangent[12:15].copy()
            tangent[6:9] = dla * np.cos(z) - la * np.sin(z) * dz
            tangent[12:15] = dla * np.sin(z) + la * np.cos(z) * dz
        return np.asarray(tangent[self._arguments[2]])

    @property
    def gauge_curve(self) -> Callable[[float], Array]:
        """Return phi [rad] -> physical parameters on the gauge curve through the truth (or start), shape (dim,)."""
        if self.gauge is None:
            raise ValueError(f"{self.name} has no gauge: all its parameters can be seen in the readings")
        machine, gauge = self._machine(self.start if self.truth is None else self.truth), self.gauge
        free = self._arguments[2]
        return lambda phi: np.array(gauge.move(machine, phi)[free])

    @property
    def data_id(self) -> str:
        """Return a digest of the readings: the same data, the same id."""
        return blake2b(self.readings.tobytes(), digest_size=8).hexdigest()

    def compile(self) -> None:
        """Compile (or load from the cache) what an optimiser will call, so that no clock sees it."""
        points = self.start[None].copy()
        self(points[0]), self.batch(points), self.residuals(points[0]), self.jacobian(points[0])

    def _machine(self, x: Array) -> Array:
        """Return the 15 physical numbers of x."""
        machine = self._template.copy()
        machine[self._arguments[2]] = x
        return machine if self.error != "J3" else _to_polar(machine)

    def _from_machine(self, machine: Array) -> Array:
        return np.array(_to_cartesian(machine)[self._arguments[2]])

    def _worst(self, machine: Array, true: Array, suffix: str) -> dict[str, float]:
        gap, free = np.abs(machine - true), self._arguments[2]
        worst = {unit: [gap[i] for i in free if _UNITS[i] == unit] for unit in ("mm", "rad")}
        return {f"parameter_error_{unit}{suffix}": float(max(gaps)) for unit, gaps in worst.items() if gaps}


@dataclass(frozen=True)
class Setting:
    """The machine of one of the papers' sections: 15 numbers each. `actual` is None for a user's own machine."""

    actual: Array | None
    nominal: Array
    start: Array
    lower: Array
    upper: Array


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
        self._case = case

    def __call__(self, **options: Any) -> Planar:
        """Build the problem with `options` (those of ``bench list problems``)."""
        options = registry.check(self.name, options)
        bound = inspect.signature(self._case).bind(**options)
        bound.apply_defaults()
        chosen = dict(bound.arguments)
        case = self._case(**chosen)
        chosen["n"] = case.samples
        if chosen["readings"] is not None:
            _refuse_plan_options(self.name, options)
            return self._measured(case, chosen, _read_csv(chosen["readings"]))
        return _simulate(self.name, case, chosen)

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
        table = _read_csv(readings) if isinstance(readings, str | Path) else np.array(readings, dtype=float)
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
        _check_readings(readings)
        setting = _own_machine(nominal or {}, box or {}, chosen["at_home"])
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
    readings: str | None = None,
    at_home: tuple[float, ...] | None = None,
) -> Case:
    """Three sensor offsets, geometry known (section 3.3 A, Table 2). With n=3 there are several exact zeros."""
    return Case(_OFFSETS, _section3("table2", own_lengths=False), n)


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
    readings: str | None = None,
    at_home: tuple[float, ...] | None = None,
) -> Case:
    """Offsets and six link lengths, bases known (section 3.3 B, Table 3)."""
    return Case(_OFFSETS + _LENGTHS, _section3("table3"), n)


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
    readings: str | None = None,
    at_home: tuple[float, ...] | None = None,
) -> Case:
    """All that angle readings can see: 11 parameters, A_1 and A_2 held (Table 5, or Table 4 with paper_section=3)."""
    names = (*_OFFSETS, *_LENGTHS, "xa3", "ya3")
    if paper_section == 3:
        return Case(names, _section3("table4"), 31 if n is None else n)
    return Case(names, _section4(), 50 if n is None else n, default_start="random")


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
    readings: str | None = None,
    at_home: tuple[float, ...] | None = None,
) -> Case:
    """The papers' 12 parameters, of which readings see 11: section 4 holds x_a2 (Table 5), section 3 y_a2 (Table 4)."""
    if gauge == "ya2":
        names = (*_OFFSETS, *_LENGTHS, "xa2", "xa3", "ya3")
        return Case(names, _section3("table4"), 31 if n is None else n, Gauge("ya2"))
    names = ("ya2", "xa3", "ya3", *_LENGTHS, *_OFFSETS)
    return Case(names, _section4(), 50 if n is None else n, Gauge("xa2"), default_start="random")


def inverse_kinematics(machine: Array, positions: Array) -> Array:
    """Return the joint angles, shape (n, 3), rad, in the elbow branch + of all legs, for positions (n, 2), mm.

    That branch is the only one of eight that gives Table 2's initial offsets. Out of reach gives NaN.
    """
    angles = np.empty((len(positions), 3))
    for i in range(3):
        dx, dy = positions[:, 0] - machine[2 * i], positions[:, 1] - machine[2 * i + 1]
        la, lb, reach = machine[6 + i], machine[9 + i], np.hypot(dx, dy)
        cosine = (la**2 + reach**2 - lb**2) / (2 * la * reach)
        with np.errstate(invalid="ignore"):
            angles[:, i] = np.arctan2(dy, dx) + np.arccos(cosine)
    return angles


def home() -> Array:
    """Return the home position of the end-effector, shape (2,), mm."""
    geometry = constants.column(_PAPER, "geometry")
    return np.array([geometry["home_x"], geometry["home_y"]])


def _section3(table: str, own_lengths: bool = True) -> Setting:
    """Return section 3's setting: `table`'s actual machine, the start it prints from (210, 245), boxes of PAPERS."""
    actual = makers_machine()
    column = constants.column(_PAPER, f"{table}.actual")
    for name in NAMES:
        if name in column:
            actual[NAMES.index(name)] = column[name]
    start = makers_machine()
    start[12:15] = _start_offsets(actual)
    lower, upper = start - 10.0, start + 10.0  # bases
    lower[6:12], upper[6:12] = makers_machine()[6:12] - 5.0, makers_machine()[6:12] + 5.0
    lower[12:15], upper[12:15] = 1.0 - 0.2, 1.0 + 0.2
    return Setting(actual, makers_machine(), start, lower, upper)


def _start_offsets(actual: Array) -> Array:
    """Return the initial offsets of Tables 2-4: the hand stops at (210, 245), taken for the home position."""
    geometry = constants.column(_PAPER, "geometry")
    estimate = np.array([[geometry["estimate_x"], geometry["estimate_y"]]])
    assumed = inverse_kinematics(makers_machine(), home()[None])[0]
    return np.asarray(actual[12:15] + assumed - inverse_kinematics(actual, estimate)[0])


def _section4() -> Setting:
    """Return section 4's setting, Table 5: actual machine, nominal start, box."""
    machines = {}
    for role in ("actual", "nominal", "lower", "upper"):
        machine, column = makers_machine(), constants.column(_PAPER, f"table5.{role}")
        for name in column:
            machine[NAMES.index(name)] = column[name]
        machines[role] = machine
    return Setting(machines["actual"], machines["nominal"], machines["nominal"], machines["lower"], machines["upper"])


def makers_machine() -> Array:
    """Return the maker's machine, shape (15,): nominal bases and lengths, offsets zero."""
    geometry = constants.column(_PAPER, "geometry")
    bases = [geometry[name] for name in NAMES[:6]]
    return np.array(bases + [geometry["link"]] * 6 + [0.0] * 3)


def _own_machine(
    nominal: Mapping[str, float], box: Mapping[str, tuple[float, float]], at_home: Sequence[float] | None
) -> Setting:
    """Return the setting of a user's machine: Table 5's widths about their nominal values."""
    from bedrock.registry import suggest

    table5 = _section4()
    start = makers_machine()
    for name, value in nominal.items():
        if name not in NAMES:
            raise ValueError(f"nominal: unknown parameter {name!r}; {suggest(name, NAMES)}")
        start[NAMES.index(name)] = value
    if at_home is not None:
        if len(at_home) != 3:
            raise ValueError(f"at_home={list(at_home)}: three readings [rad] are needed")
        start[12:15] = inverse_kinematics(start, home()[None])[0] - np.asarray(at_home)
    half = np.maximum((table5.upper - table5.lower) / 2, [5.0] * 12 + [0.0] * 3)
    lower, upper = start - half, start + half
    for name, bounds in box.items():
        if name not in NAMES:
            raise ValueError(f"box: unknown parameter {name!r}; {suggest(name, NAMES)}")
        i = NAMES.index(name)
        lower[i], upper[i] = bounds
        if not lower[i] <= start[i] <= upper[i]:
            raise ValueError(f"start {name}={start[i]:g} lies outside its box {lower[i]:g} .. {upper[i]:g}")
    return Setting(None, start, start, lower, upper)


def _simulate(name: str, case: Case, chosen: dict[str, Any]) -> Planar:
    """Take the readings that the actual machine gives at the planned positions, with noise."""
    if chosen["noise"] < 0:
        raise ValueError(f"{name}.noise={chosen['noise']:g}: a standard deviation [rad] cannot be negative")
    if chosen["data_seed"] < 0:
        raise ValueError(f"{name}.data_seed={chosen['data_seed']}: must be 0 or above")
    _check_count(name, case, chosen)
    actual = case.setting.actual
    assert actual is not None
    where, shake = (np.random.default_rng(s) for s in np.random.SeedSequence(chosen["data_seed"]).spawn(2))
    try:
        points = plan_points(chosen["plan"], home(), chosen["radius"], case.samples, where)
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
    setting, error = case.setting, chosen["error"]
    template = setting.nominal.copy() if setting.actual is None else setting.actual.copy()
    parameters = tuple(
        Parameter(
            p, _UNITS[i], setting.start[i], setting.lower[i], setting.upper[i],
            None if setting.actual is None else float(setting.actual[i]),
        )
        for p, i in ((p, NAMES.index(p)) for p in free)
    )  # fmt: skip
    coordinates = parameters
    if error == "J3":
        coordinates = _cartesian_coordinates(parameters)
        template = _to_cartesian(template)
    return Planar(
        name=name,
        options={key: list(value) if isinstance(value, tuple) else value for key, value in chosen.items()},
        parameters=parameters,
        coordinates=coordinates,
        readings=_frozen(readings),
        error=error,
        noise=chosen["noise"] or 0.0,
        gauge=case.gauge if free == case.free else None,
        true_positions=None if points is None else _frozen(points),
        default_start=case.default_start,
        _template=_frozen(template),
    )


def _free_names(name: str, case: Case, chosen: dict[str, Any]) -> tuple[str, ...]:
    """Return the free parameters in the case's order, after `free=` held the others at their known values."""
    from bedrock.registry import suggest

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


def _cartesian_coordinates(parameters: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
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


def _to_cartesian(machine: Array) -> Array:
    la, z = machine[6:9], machine[12:15]
    return np.concatenate([machine[:6], la * np.cos(z), machine[9:12], la * np.sin(z)])


def _to_polar(machine: Array) -> Array:
    lac, las = machine[6:9], machine[12:15]
    return np.concatenate([machine[:6], np.hypot(lac, las), machine[9:12], np.arctan2(las, lac)])  # eq. (44), corrected


def _refuse_plan_options(name: str, options: Mapping[str, Any]) -> None:
    for key in ("plan", "radius", "n", "noise", "data_seed"):
        if key in options:
            raise ValueError(f"{name}.{key}: simulates readings, but readings are given; leave one of the two out")


def _read_csv(path: str | Path) -> Array:
    """Return the readings of a CSV file, shape (n, 3): columns enc_1..3, or three columns without header."""
    try:
        with open(path, newline="", encoding="utf-8") as file:
            rows = [row for row in csv.reader(file) if row and not row[0].lstrip().startswith("#")]
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"readings={path}: cannot be read: {error}") from None
    if not rows:
        raise ValueError(f"readings={path}: the file is empty")
    columns, header = [0, 1, 2], 0
    if any(not _is_float(cell) for cell in rows[0]):
        header, names = 1, [cell.strip() for cell in rows[0]]
        missing = [c for c in ("enc_1", "enc_2", "enc_3") if c not in names]
        if missing:
            raise ValueError(f"readings={path}: no column {', '.join(missing)}; the header has {', '.join(names)}")
        columns = [names.index(c) for c in ("enc_1", "enc_2", "enc_3")]
    table = []
    for line, row in enumerate(rows[header:], start=header + 1):
        try:
            table.append([float(row[c]) for c in columns])
        except (ValueError, IndexError):
            raise ValueError(f"readings={path}: row {line} does not hold three numbers: {','.join(row)}") from None
    return np.array(table)


def _check_readings(readings: Array) -> None:
    if readings.ndim != 2 or readings.shape[1] != 3:
        raise ValueError(f"readings have shape {readings.shape}: (n, 3) is needed, a column for each encoder")
    bad = np.flatnonzero(~np.isfinite(readings).all(axis=1))
    if bad.size:
        raise ValueError(f"readings: row {bad[0] + 1} is not finite ({bad.size} such rows); leave them out")
    if np.abs(readings).max() > 4 * np.pi:
        raise ValueError(f"readings reach {np.abs(readings).max():.4g}: they look like degrees, radians are needed")


def _is_float(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _rms_distance(a: Array, b: Array) -> float:
    return float(np.sqrt(((a - b) ** 2).sum(axis=1).mean()))  # eq. (40)


def _vector(x: Array) -> Array:
    return np.ascontiguousarray(x, dtype=np.float64)


def _frozen(values: Any) -> Array:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array
