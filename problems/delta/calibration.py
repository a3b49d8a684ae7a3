"""`delta9`: nine errors of a linear delta printer, from heights at the probe and distances by caliper.

Unknown are what endstops a b c, the radius, the angles of towers a and b, and rods a b c are wrong by, mm and rad; all
three angles together turn the printer, so that of tower c is held. A value is the sum of squared residuals [mm^2]; a
distance has a weight of .4, so all residuals have the noise of a height. Distances are those of a printed hexagon with
spokes: from its middle to its corners, and its sides. Lengths are shares of the bed's radius.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache, partial
from math import cos, pi, sin
from typing import Any, ClassVar, Literal, final, get_args

import numpy as np
from numpy.typing import NDArray

from calibench.core.options import suggest
from calibench.problems import instances
from calibench.problems.base import Array, Number, Parameter, frozen, line_of, registry, table_of
from calibench.problems.compiled_problem import CompiledProblem, hold, itself, passed
from calibench.problems.fitting import least_in_box, levels_above_minimum, value_of_noise, worst_errors

Index = NDArray[np.int64]
PlanName = Literal["object", "rings", "rich"]

_FAMILY = "delta9"
ANGLES = (7 * pi / 6, 11 * pi / 6, pi / 2)  # of the towers, rad: 210, 330 and 90 degrees
WEIGHT = 0.4  # of a distance: a caliper on plastic has two and a half times the noise of a probe
_FINEST = 1e-4  # mm: the readings that an instance without noise is held to
_ABOVE = 50.0  # mm: of the carriages at their endstops over where they stand with the nozzle on the bed's middle
_TOP = 1.0  # mm: what a caliper holds of an object
_RINGS: dict[str, tuple[tuple[int, float], ...]] = {
    "object": ((6, 0.97),),
    "rings": ((6, 0.5), (12, 0.97)),
    "rich": ((6, 0.33), (12, 0.65), (18, 0.97)),
}
_SIDES: dict[str, tuple[float, ...]] = {"object": (0.45,), "rings": (0.45,), "rich": (0.3, 0.6)}
_ERRORS = (  # name, unit, half-width of its box, decimals of an instance, true value: as large as printers'
    ("endstop_a", "mm", 5.0, 3, 1.412),
    ("endstop_b", "mm", 5.0, 3, -0.873),
    ("endstop_c", "mm", 5.0, 3, 2.106),
    ("radius", "mm", 5.0, 3, 1.927),
    ("angle_a", "rad", 0.03, 6, 0.006283),
    ("angle_b", "rad", 0.03, 6, -0.004712),
    ("rod_a", "mm", 3.0, 3, 1.233),
    ("rod_b", "mm", 3.0, 3, -0.418),
    ("rod_c", "mm", 3.0, 3, 0.852),
)
_NAMES, _UNITS, _HALF, _DIGITS, _TRUTH = zip(*_ERRORS)


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
class Places:
    """The nozzle's places [mm]: `first` and `second`, (m, 3), and `between`, (m,): 0 for a height, 1 for a distance."""

    first: Array
    second: Array
    between: Index


def places(name: str, bed_radius: float) -> Places:
    """Return the places of a named plan on a bed of `bed_radius` mm; raise `ValueError` that lists the names.

    object: 7 heights, 12 distances. rings: 19 heights, 12 distances. rich: 37 heights, 24 distances.
    """
    if name not in get_args(PlanName):
        raise ValueError(f"delta9.plan={name}: {suggest(name, get_args(PlanName))}")
    return ring_places(_RINGS[name], _SIDES[name], bed_radius, _TOP)


def ring_places(
    rings: Sequence[tuple[int, float]], sides: Sequence[float], bed_radius: float, top: float = 0.0
) -> Places:
    """Return the bed's middle and `rings` of places, and hexagons with spokes of these `sides` at the height `top`."""
    around = [(share * bed_radius, k / n) for n, share in rings for k in range(n)]
    heights = [(0.0, 0.0, 0.0), *((out * cos(2 * pi * turn), out * sin(2 * pi * turn), 0.0) for out, turn in around)]
    pairs: list[tuple[tuple[float, ...], tuple[float, ...]]] = []
    for share in sides:
        out = share * bed_radius
        corners = [(out * cos(2 * pi * (k / 6)), out * sin(2 * pi * (k / 6)), top) for k in range(6)]
        pairs += [((0.0, 0.0, top), corner) for corner in corners]
        pairs += [(corners[k], corners[(k + 1) % 6]) for k in range(6)]
    first = np.array([*heights, *(a for a, _ in pairs)])
    second = np.array([*heights, *(b for _, b in pairs)])
    return Places(first, second, np.array([0] * len(heights) + [1] * len(pairs), dtype=np.int64))


def travels(points: Array, machine: Machine) -> Array:
    """Return how far below the endstops a nominal machine brings its carriages, (m, 3), for nozzle `points`, (m, 3)."""
    angles = np.array(ANGLES)
    x = points[:, :1] - machine.radius * np.cos(angles)
    y = points[:, 1:2] - machine.radius * np.sin(angles)
    return np.asarray(machine.switch - points[:, 2:] - np.sqrt(machine.rod**2 - x**2 - y**2))


DeltaInstance = instances.Drawn[Machine, Places]


@final
@dataclass(frozen=True, eq=False)
class DeltaProbing:
    """Minimise the sum of squared residuals [mm^2] over what is wrong with a delta's nominal geometry.

    A call takes x of shape (9,), mm and rad, in the order of `parameters`; ``problem(x) == r @ r`` with ``r =
    problem.residuals(x)``, of shape (m,), mm. `measured`, (m,), mm, are heights and distances at `places`. `drawn` is
    the instance of the family; None without one. `readings`, (m, 8), is the table: x, y, z of both places [mm], 0 or 1
    for a distance, and mm.
    """

    options: Mapping[str, Any]
    parameters: tuple[Parameter, ...]
    machine: Machine
    places: Places
    measured: Array
    drawn: DeltaInstance | None = field(default=None, kw_only=True, repr=False)
    coordinates: tuple[Parameter, ...] = field(init=False, repr=False)
    lower: Array = field(init=False, repr=False)
    upper: Array = field(init=False, repr=False)
    start: Array = field(init=False, repr=False)
    truth: Array | None = field(init=False, repr=False)
    readings: Array = field(init=False, repr=False)
    data_id: str = field(init=False, repr=False)
    _compiled: CompiledProblem = field(init=False, repr=False)

    name: ClassVar[str] = "delta9"
    noise_unit: ClassVar[str] = "mm"
    unit: ClassVar[str] = "mm²"
    said_if_chosen: ClassVar[tuple[str, ...]] = ("instance",)
    typical_noise: ClassVar[float] = 0.02  # mm: a switch probe
    budgets: ClassVar[Mapping[str, int]] = {"ci": 5_000, "paper": 100_000}

    __repr__ = line_of
    _repr_html_ = table_of

    def __post_init__(self) -> None:
        # Here, as listing the names must not load the compiler.
        from calibench.problems.delta import _kernels as kernels

        m, at = self.machine, self.places
        nominal = np.array([m.radius, m.rod, m.switch])
        first, second = (travels(points, m) for points in (at.first, at.second))
        weight = np.where(at.between == 1, WEIGHT, 1.0)
        constants = (nominal, np.array(ANGLES), first, second, at.between, weight, np.array(self.measured))
        readings = frozen(np.column_stack([at.first, at.second, at.between, self.measured]))
        data = np.array([m.radius, m.rod, m.bed_radius]).tobytes() + readings.tobytes()
        hold(self, self.parameters, kernels, constants, data=data, readings=readings)

    __call__ = passed(CompiledProblem.cost)
    batch = passed(CompiledProblem.batch)
    residuals = passed(CompiledProblem.residuals)  # weighted
    jacobian = passed(CompiledProblem.jacobian)
    physical = itself
    compile = passed(CompiledProblem.compile)
    compile_values = passed(CompiledProblem.compile_values)

    def merit(self, x: Array) -> dict[str, float]:
        """Return the errors of an answer: the nozzle's rms over the bed, and the worst length's and angle's.

        kmrmse [mm] is the rms of how far from each other the true and the found machine bring the nozzle, for the
        nominal travels of 19 places on the bed.
        """
        if self.truth is None:
            return {}
        from calibench.problems.delta._kernels import _nozzle, _towers

        # distances along the axes, from the same kernel
        points, (nominal, angles, *_) = places("rings", self.machine.bed_radius), self._compiled.constants
        travel = travels(points.first[points.between == 0], self.machine)
        towers, nozzles = np.empty((3, 4)), np.empty((2, *travel.shape))
        for x_or_truth, at in zip((x, self.truth), nozzles, strict=True):
            _towers(self._compiled.vector(x_or_truth), nominal, angles, towers)
            for k in range(len(travel)):
                _nozzle(towers, travel, k, at[k])
        gap = nozzles[0] - nozzles[1]
        return {"kmrmse": float(np.sqrt((gap**2).sum(axis=1).mean())), **worst_errors(self, x)}

    @cached_property
    def minimum(self) -> float:
        """Return f*, the least sum of squares [mm^2] in the box, found downhill from the truth; zero without noise."""
        noise = float(self.options.get("sigma") or 0.0) if self.drawn is None else self.drawn.noise.level
        return least_in_box(self) if noise > 0 else 0.0

    targets = levels_above_minimum
    as_good_as_noise = value_of_noise(lambda self: _FINEST**2 * len(self.places.between))


def _declared(
    plan: PlanName = "object", sigma: instances.Sigma = 0.0, seed: instances.Seed = 0, instance: Number = None
) -> None:
    """Declare the options of `delta9`: where it is measured, and sigma [mm], the noise of a height, with its seed."""


@registry.register(_FAMILY, options=_declared)
def delta9(**options: Any) -> DeltaProbing:
    """Endstops, radius, angles and rods of a linear delta, from heights of the bed and a printed object."""
    options = registry.check(_FAMILY, options)
    if options.get("instance") is not None:
        return _drawn(tuple(sorted(options.items())))
    chosen = registry.complete(_FAMILY, options)
    del chosen["instance"]
    machine, half = Machine(), np.array(_HALF)
    at, box = (
        places(chosen["plan"], machine.bed_radius),
        instances.Box(np.zeros(len(half)), np.array(_TRUTH), -half, half),
    )
    return _measured(chosen, machine, at, box, chosen)


@lru_cache(maxsize=256)  # a problem is a value, and drawing it takes a hundred times as long as a call
def _drawn(given: tuple[tuple[str, Any], ...]) -> DeltaProbing:
    chosen = registry.complete(_FAMILY, dict(given))
    instance: int = chosen["instance"]
    drawn = instances.first_that_fits(_FAMILY, instance, partial(_attempt, instance))
    instances.refuse_drawn(_FAMILY, instance, dict(given), dict(drawn.options))
    says = chosen | dict.fromkeys(drawn.options)
    return _measured(says, drawn.machine, drawn.plan, drawn.box, drawn.options, drawn)


@cache
def _attempt(instance: int, attempt: int) -> DeltaInstance | None:
    """Return what an attempt draws; None where it cannot be built or not identified."""
    things = ("machine", "box", "plan", "noise")
    streams = {thing: instances.Stream.of(_FAMILY, instance, attempt, thing) for thing in things}
    of = streams["machine"]
    rod = round(of.between(220.0, 400.0), 1)
    radius = round(rod * of.between(0.42, 0.52), 1)
    machine = Machine(radius, rod, round(radius * of.between(0.8, 0.92), 0))
    box = instances.Box.drawn(streams["box"], np.zeros(len(_ERRORS)), np.array(_HALF), _DIGITS)
    name: PlanName = streams["plan"].one_of(get_args(PlanName))
    chance = streams["plan"].between(0.7, 1)
    whole = places(name, machine.bed_radius)
    kept = np.array([k for k in range(len(whole.between)) if streams["plan"].between(0, 1) < chance], dtype=np.int64)
    if len(kept) < 2 * len(_ERRORS):
        return None
    some = Places(whole.first[kept], whole.second[kept], whole.between[kept])
    noise = instances.Noise.drawn(streams["noise"], 2e-3, 5e-2)  # mm
    options = {"plan": name, "sigma": noise.level, "seed": noise.data_seed}
    drawn = DeltaInstance(machine, box, some, noise, options, attempt + 1)
    problem = _measured({}, machine, some, box, options | {"sigma": 0.0}, drawn)
    if not np.isfinite(problem.measured).all():
        return None
    return drawn if instances.can_be_identified(problem, len(_ERRORS), noise.level) else None


def _measured(
    says: dict[str, Any], machine: Machine, at: Places, box: instances.Box, noise: Mapping[str, Any],
    drawn: DeltaInstance | None = None,
) -> DeltaProbing:  # fmt: skip
    """Take the heights and distances that the true machine gives, with noise."""
    sides = zip(_NAMES, _UNITS, *(side.tolist() for side in (box.lower, box.upper, box.truth)), strict=True)
    parameters = tuple(Parameter(name, unit, 0.0, *three) for name, unit, *three in sides)
    silent = DeltaProbing(says, parameters, machine, at, frozen(np.zeros(len(at.between))), drawn=drawn)
    weight = np.where(at.between == 1, WEIGHT, 1.0)
    draw = np.random.default_rng(noise["seed"]).standard_normal(len(at.between))
    seen = (silent.residuals(box.truth) + noise["sigma"] * draw) / weight
    return replace(silent, measured=frozen(seen))
