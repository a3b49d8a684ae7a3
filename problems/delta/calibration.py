"""`delta9`: nine errors of a linear delta printer, from heights at the probe and distances by caliper.

Unknown are what endstops a b c, the radius, the angles of towers a and b, and rods a b c are wrong by, mm and rad. The
angle of tower c is held: all three together turn the printer, and neither bed nor caliper sees that. Heights alone
leave radius and rods almost inseparable; how much a plan tells is what `bench identify problem=delta9` prints.

`DeltaProbing`: nine errors of a linear delta from probe heights and caliper distances.

A value is the sum of squared residuals [mm^2], modelled minus measured. A distance has a weight of .4, as a caliper on
plastic is two and a half times as noisy as a probe: so all residuals have the noise of a height.

The places where a delta is measured: on the bed that the probe touches, and in pairs on a printed object.

The object is a hexagon with spokes, as firmwares propose it: six distances from its middle to its corners, and its six
sides. Lengths are shares of the bed's radius.

Instances of `delta9`: another machine, plan, noise and box for each ``instance=K``. Its data are synthetic.

- *nominal machine*: rods of 220 .. 400 mm, towers at .42 .. .52 of that, a bed that reaches to .8 .. .92 of the towers.
- *true machine*: each of the nine errors is wrong as `problems.instances` says of the *box*, with h = 5 mm for
  endstops and radius, .03 rad for angles and 3 mm for rods, to .001 mm and 1e-6 rad.
- *plan*: a part of one of the named plans: each of its rows stays with a chance uniform in .7 .. 1; at least 18 must.
- *noise* of a height: none, or .002 .. .05 mm; that of a distance is two and a half times as large.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache
from hashlib import blake2b
from math import cos, pi, sin
from typing import Any, ClassVar, Literal, final, get_args

import numpy as np
from numpy.typing import NDArray

from calibench.core.options import suggest
from calibench.problems.base import Array, Parameter, frozen, line_of, registry, table_of
from calibench.problems.compiled_problem import CompiledProblem
from calibench.problems.fitting import least_in_box, levels, value_of_noise
from calibench.problems.instances import (
    Box,
    Noise,
    Stream,
    can_be_identified,
    check_instance,
    first_that_fits,
    refuse_drawn,
)


@final
@dataclass(frozen=True, eq=False)
class DeltaProbing:
    """Minimise the sum of squared residuals [mm^2] over what is wrong with a delta's nominal geometry.

    A call takes x of shape (9,), mm and rad, in the order of `parameters`; ``problem(x) == r @ r`` with ``r =
    problem.residuals(x)``, of shape (m,), mm. `measured`, (m,), mm, are heights and distances at `places`. `drawn` is
    the instance of the family; None without one.
    """

    options: Mapping[str, Any]
    parameters: tuple[Parameter, ...]
    machine: Machine
    places: Places
    measured: Array
    drawn: DeltaInstance | None = field(default=None, kw_only=True, repr=False)
    _compiled: CompiledProblem = field(init=False, repr=False)

    name: ClassVar[str] = "delta9"
    default_start: ClassVar[Literal["nominal", "random"]] = "nominal"
    noise_unit: ClassVar[str] = "mm"
    unit: ClassVar[str] = "mm²"
    side_effect_free: ClassVar[bool] = True  # or leaves its arguments alone and returns floats: the gate need not look
    splits_batches: ClassVar[bool] = True  # a value has the same bits alone and in a batch
    said_if_chosen: ClassVar[tuple[str, ...]] = ("instance",)
    typical_noise: ClassVar[float] = 0.02  # mm: a switch probe

    __repr__ = line_of
    _repr_html_ = table_of

    def __post_init__(self) -> None:
        # Here, as listing the names must not load the compiler.
        from calibench.problems.delta import _kernels as kernels

        first, second = (_travels(self.machine, points) for points in (self.places.first, self.places.second))
        weight = np.where(self.places.between == 1, WEIGHT, 1.0)
        m = self.machine
        nominal = np.array([m.radius, m.rod, m.switch])
        constants = (nominal, np.array(ANGLES), first, second, self.places.between, weight, np.array(self.measured))
        object.__setattr__(self, "_compiled", CompiledProblem.of(self.name, self.parameters, kernels, constants))

    def __call__(self, x: Array) -> float:
        """Return the sum of squared residuals [mm^2] of the candidate x, shape (9,)."""
        return self._compiled.cost(x)

    @property
    def lower(self) -> Array:
        """Return the lower bounds of x, shape (9,)."""
        return self._compiled.lower

    @property
    def upper(self) -> Array:
        """Return the upper bounds of x, shape (9,)."""
        return self._compiled.upper

    @property
    def start(self) -> Array:
        """Return the start, shape (9,): the nominal machine."""
        return self._compiled.start

    @property
    def truth(self) -> Array | None:
        """Return the errors that the measurements were simulated with, shape (9,)."""
        return self._compiled.truth

    def batch(self, points: Array) -> Array:
        """Return the sums, shape (k,), of candidates of shape (k, 9): the same bits as one call for each."""
        return self._compiled.batch(points)

    def residuals(self, x: Array) -> Array:
        """Return weighted modelled minus measured heights and distances [mm], shape (m,)."""
        return self._compiled.residuals(x)

    def jacobian(self, x: Array) -> Array:
        """Return the analytic derivative of the residuals, shape (m, 9)."""
        return self._compiled.jacobian(x)

    @property
    def coordinates(self) -> tuple[Parameter, ...]:
        """Return what the vector x holds: the parameters themselves."""
        return self.parameters

    @property
    def readings(self) -> Array:
        """Return the measured table, shape (m, 8): x, y, z of both places [mm], 0 or 1 for a distance, and mm."""
        return np.column_stack([self.places.first, self.places.second, self.places.between, self.measured])

    def physical(self, x: Array) -> Array:
        """Return the physical parameters of x, which are x."""
        return np.array(x, dtype=float)

    def merit(self, x: Array) -> dict[str, float]:
        """Return the errors of an answer: the nozzle's rms over the bed, and the worst length's and angle's.

        kmrmse [mm] is the rms of how far from each other the true and the found machine bring the nozzle, for the
        nominal travels of 19 places on the bed.
        """
        if self.truth is None:
            return {}
        gap = self._nozzles(x) - self._nozzles(self.truth)
        away = np.abs(np.asarray(x) - self.truth)
        angle = np.array([p.unit == "rad" for p in self.parameters])
        return {
            "kmrmse": float(np.sqrt((gap**2).sum(axis=1).mean())),
            "parameter_error_mm": float(away[~angle].max()),
            "parameter_error_rad": float(away[angle].max()),
        }

    @cached_property
    def minimum(self) -> float:
        """Return f*, the least sum of squares [mm^2] in the box, found downhill from the truth; zero without noise."""
        return least_in_box(self) if self._noise > 0 else 0.0

    @property
    def targets(self) -> tuple[float, ...]:
        """Return levels of f whose first crossing is recorded: f* + 1e-1 .. 1e-12 mm^2, as rounding leaves 1e-13.

        Of an instance with noise they end where an answer is as good as the noise.
        """
        exact = tuple(self.minimum + 10.0**k for k in (-1, -2, -3, -4, -5, -6, -8, -10, -12))
        if self.drawn is None or self.as_good_as_noise is None:
            return exact
        return levels(self.as_good_as_noise, self.drawn.noise.level, exact)

    @cached_property
    def as_good_as_noise(self) -> float | None:
        """Return the f at which an answer explains the readings as well as the truth does; None of no instance."""
        if self.drawn is None:
            return None
        return value_of_noise(self, self.drawn.noise.level, FINEST**2 * len(self.places))

    @property
    def budgets(self) -> dict[str, int]:
        """Evaluations meant by the words `ci` and `paper`."""
        return {"ci": 5_000, "paper": 100_000}

    @property
    def data_id(self) -> str:
        """Return a digest of the nominal machine, places and measurements: the same data, the same id."""
        machine = np.array([self.machine.radius, self.machine.rod, self.machine.bed_radius])
        return blake2b(machine.tobytes() + self.readings.tobytes(), digest_size=8).hexdigest()

    def compile(self) -> None:
        """Compile (or load from the cache) what an optimiser will call, so that no clock sees it."""
        self._compiled.compile()

    def compile_values(self) -> None:
        """Compile likewise what methods call that ask for values alone."""
        self._compiled.compile_values()

    @property
    def _noise(self) -> float:
        return float(self.options.get("sigma") or 0.0) if self.drawn is None else self.drawn.noise.level

    def _nozzles(self, x: Array) -> Array:
        """Return where the machine x brings the nozzle, (19, 3): by distances along the axes, from the same kernel."""
        from calibench.problems.delta._kernels import _nozzle, _towers

        points = places("rings", self.machine.bed_radius)
        travel = _travels(self.machine, points.first[points.between == 0])
        towers, found = np.empty((3, 4)), np.empty(travel.shape)
        nominal = np.array([self.machine.radius, self.machine.rod, self.machine.switch])
        _towers(self._compiled.vector(x), nominal, np.array(ANGLES), towers)
        for k in range(len(travel)):
            _nozzle(towers, travel, k, found[k])
        return found


def _travels(machine: Machine, points: Array) -> Array:
    return travels(points, machine.radius, machine.rod, machine.switch, np.array(ANGLES))


Index = NDArray[np.int64]

PlanName = Literal["object", "rings", "rich"]
_RINGS: dict[str, tuple[tuple[int, float], ...]] = {
    "object": ((6, 0.97),),
    "rings": ((6, 0.5), (12, 0.97)),
    "rich": ((6, 0.33), (12, 0.65), (18, 0.97)),
}
_SIDES: dict[str, tuple[float, ...]] = {"object": (0.45,), "rings": (0.45,), "rich": (0.3, 0.6)}
_TOP = 1.0  # mm: what a caliper holds of an object


@final
@dataclass(frozen=True, eq=False)
class Places:
    """The nozzle's places [mm]: `first` and `second`, (m, 3), and `between`, (m,): 0 for a height, 1 for a distance."""

    first: Array
    second: Array
    between: Index

    def __len__(self) -> int:
        return len(self.between)

    def some(self, kept: Index) -> Places:
        """Return the rows at indices `kept`."""
        return Places(self.first[kept], self.second[kept], self.between[kept])


def places(name: str, bed_radius: float) -> Places:
    """Return the places of a named plan on a bed of `bed_radius` mm; raise `ValueError` that lists the names.

    object: 7 heights, 12 distances. rings: 19 heights, 12 distances. rich: 37 heights, 24 distances.
    """
    if name not in get_args(PlanName):
        raise ValueError(f"delta9.plan={name}: {suggest(name, get_args(PlanName))}")
    heights = [(0.0, 0.0, 0.0)]
    heights += [_at(share * bed_radius, k / n, 0.0) for n, share in _RINGS[name] for k in range(n)]
    pairs: list[tuple[tuple[float, ...], tuple[float, ...]]] = []
    for share in _SIDES[name]:
        corners = [_at(share * bed_radius, k / 6, _TOP) for k in range(6)]
        pairs += [((0.0, 0.0, _TOP), corner) for corner in corners]
        pairs += [(corners[k], corners[(k + 1) % 6]) for k in range(6)]
    first = np.array([*heights, *(a for a, _ in pairs)])
    second = np.array([*heights, *(b for _, b in pairs)])
    return Places(first, second, np.array([0] * len(heights) + [1] * len(pairs), dtype=np.int64))


def travels(points: Array, radius: float, rod: float, switch: float, angles: Array) -> Array:
    """Return how far below `switch` the nominal machine brings its carriages, (m, 3), for nozzle `points`, (m, 3)."""
    x = points[:, :1] - radius * np.cos(angles)
    y = points[:, 1:2] - radius * np.sin(angles)
    return np.asarray(switch - points[:, 2:] - np.sqrt(rod**2 - x**2 - y**2))


def _at(out: float, turn: float, z: float) -> tuple[float, float, float]:
    return out * cos(2 * pi * turn), out * sin(2 * pi * turn), z


ANGLES = (7 * pi / 6, 11 * pi / 6, pi / 2)  # of the towers, rad: 210, 330 and 90 degrees
WEIGHT = 0.4  # of a distance: a caliper on plastic has two and a half times the noise of a probe
NOISES = (2e-3, 5e-2)  # mm
FINEST = 1e-4  # mm: the readings that an instance without noise is held to
FREE = 9
HALF = (5.0, 5.0, 5.0, 5.0, 0.03, 0.03, 3.0, 3.0, 3.0)
DIGITS = (3, 3, 3, 3, 6, 6, 3, 3, 3)
_FAMILY = "delta9"
_ABOVE = 50.0  # mm: of the carriages at their endstops over where they stand with the nozzle on the bed's middle


@final
@dataclass(frozen=True)
class Machine:
    """A nominal delta [mm]: the towers' radius less the effector's, the rods, and the bed's radius."""

    radius: float = 160.0
    rod: float = 340.0
    bed_radius: float = 140.0

    @property
    def switch(self) -> float:
        """Return the height of the carriages at their endstops [mm]."""
        return float(np.sqrt(self.rod**2 - self.radius**2)) + self.rod + _ABOVE


@final
@dataclass(frozen=True, eq=False)
class DeltaInstance:
    """What ``instance=K`` of `delta9` draws; `attempts` were drawn until one could be identified."""

    machine: Machine
    box: Box
    plan: PlanName
    places: Places
    noise: Noise
    attempts: int

    @property
    def options(self) -> dict[str, Any]:
        """Return what the instance decides of the family's options."""
        return {"plan": self.plan, "sigma": self.noise.level, "seed": self.noise.data_seed}


@cache
def delta_instance(instance: int, build: Callable[[DeltaInstance], Any]) -> DeltaInstance:
    """Return the instance; ``build(drawn)`` makes its problem without noise."""
    return first_that_fits(_FAMILY, instance, lambda attempt: _attempt(instance, attempt, build))


def _attempt(instance: int, attempt: int, build: Callable[[DeltaInstance], Any]) -> DeltaInstance | None:
    streams = {thing: Stream.of(_FAMILY, instance, attempt, thing) for thing in ("machine", "box", "plan", "noise")}
    of = streams["machine"]
    rod = round(of.between(220.0, 400.0), 1)
    radius = round(rod * of.between(0.42, 0.52), 1)
    machine = Machine(radius, rod, round(radius * of.between(0.8, 0.92), 0))
    box = Box.drawn(streams["box"], np.zeros(FREE), np.array(HALF), DIGITS)
    name: PlanName = streams["plan"].one_of(get_args(PlanName))
    chance = streams["plan"].between(0.7, 1)
    whole = places(name, machine.bed_radius)
    kept = np.array([k for k in range(len(whole)) if streams["plan"].between(0, 1) < chance], dtype=np.int64)
    if len(kept) < 2 * FREE:
        return None
    noise = Noise.drawn(streams["noise"], *NOISES)
    drawn = DeltaInstance(machine, box, name, whole.some(kept), noise, attempt + 1)
    problem = build(drawn)
    if not np.isfinite(problem.measured).all():
        return None
    return drawn if can_be_identified(problem, FREE, drawn.noise.level) else None


NAMES = (
    "endstop_a", "endstop_b", "endstop_c", "radius", "angle_a", "angle_b", "rod_a", "rod_b", "rod_c",
)  # fmt: skip
_UNITS = ("mm", "mm", "mm", "mm", "rad", "rad", "mm", "mm", "mm")
_TRUTH = (1.412, -0.873, 2.106, 1.927, 0.006283, -0.004712, 1.233, -0.418, 0.852)  # simulated: as large as printers'


def _declared(
    plan: Literal["object", "rings", "rich"] = "object",
    sigma: float = 0.0,
    seed: int = 0,
    instance: int | None = None,
) -> None:
    """Declare the options of `delta9`: where it is measured, and sigma [mm], the noise of a height, with its seed."""


@final
class DeltaFamily:
    """Endstops, radius, angles and rods of a linear delta, from heights of the bed and a printed object."""

    name = "delta9"
    said_if_chosen = ("instance",)

    def __call__(self, **options: Any) -> DeltaProbing:
        """Build the problem with `options` (those of ``bench list problems``)."""
        options = registry.check(self.name, options)
        if options.get("instance") is not None:
            return _drawn(tuple(sorted(options.items())))
        chosen = _chosen(options)
        if chosen["sigma"] < 0:
            raise ValueError(f"delta9.sigma={chosen['sigma']:g}: a standard deviation [mm] cannot be negative")
        if chosen["seed"] < 0:
            raise ValueError(f"delta9.seed={chosen['seed']}: must be 0 or above")
        machine, half = Machine(), np.array(HALF)
        sides = (np.zeros(len(NAMES)), -half, half, np.array(_TRUTH))
        return _measured(chosen, machine, places(chosen["plan"], machine.bed_radius), sides, chosen)


delta9 = DeltaFamily()
registry.register("delta9", options=_declared)(delta9)


def _chosen(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return checked options with the defaults; without `instance` where there is none."""
    bound = inspect.signature(_declared).bind(**options)
    bound.apply_defaults()
    return {key: value for key, value in bound.arguments.items() if key != "instance" or value is not None}


@lru_cache(maxsize=256)  # a problem is a value, and drawing it takes a hundred times as long as a call
def _drawn(given: tuple[tuple[str, Any], ...]) -> DeltaProbing:
    """Return the problem that the instance draws: another machine, plan, noise and box."""
    chosen = _chosen(dict(given))
    instance: int = chosen["instance"]
    check_instance("delta9", instance)
    drawn = delta_instance(instance, _without_noise)
    refuse_drawn("delta9", instance, dict(given), drawn.options)
    return _taken(chosen | dict.fromkeys(drawn.options), drawn, drawn.options)


def _without_noise(drawn: DeltaInstance) -> DeltaProbing:
    """Return the problem of the machine that is read without noise, to be looked at before it is taken."""
    return _taken({}, drawn, drawn.options | {"sigma": 0.0})


def _taken(says: dict[str, Any], drawn: DeltaInstance, noise: Mapping[str, Any]) -> DeltaProbing:
    sides = (np.zeros(len(NAMES)), drawn.box.lower, drawn.box.upper, drawn.box.truth)
    return _measured(says, drawn.machine, drawn.places, sides, noise, drawn)


def _measured(
    says: dict[str, Any], machine: Machine, at: Places, sides: tuple[Array, ...], noise: Mapping[str, Any],
    drawn: DeltaInstance | None = None,
) -> DeltaProbing:  # fmt: skip
    """Take the heights and distances that the true machine gives, with noise."""
    rows = zip(NAMES, _UNITS, *(side.tolist() for side in sides), strict=True)
    parameters = tuple(Parameter(*row) for row in rows)
    silent = DeltaProbing(says, parameters, machine, at, frozen(np.zeros(len(at))), drawn=drawn)
    weight = np.where(at.between == 1, WEIGHT, 1.0)
    draw = np.random.default_rng(noise["seed"]).standard_normal(len(at))
    seen = (silent.residuals(sides[3]) + noise["sigma"] * draw) / weight
    return replace(silent, measured=frozen(seen))
