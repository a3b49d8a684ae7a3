"""An Orthoglide at work with one thing hidden: a table as its owner would send it, and the truth apart from it.

The physics are this file's own. The tool is found by Newton's method where the three legs' ends meet; play is followed
along the path of every joint; a loaded leg stretches by the force of the real triangle of legs; gauges are lines in
space that meet the bar. Nothing is linearised, and nothing comes from the rooms this puts to the test.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
L, UP, DOWN, SIGMA = 310.25, 60.0, -100.0, 0.01
LETTERS = "xyz"
PAIRS = [(i, j) for i in range(3) for j in range(3) if i != j]
PLANS = ("paper", "cross", "loaded")
OFF = (0.05, 0.15)  # rms by which a bent form is off, drawn between
_RUN = 7200.0  # s, about what a plan takes


@dataclass(frozen=True)
class Wave:
    """How a fault's size goes with x, an angle: 1 + share * sqrt(2) sin(waves x + phase); its rms is off by `share`."""

    share: float = 0.0
    waves: int = 1
    phase: float = 0.0

    def __call__(self, x: Array) -> Array:
        """Return the size at x, of the shape of x."""
        return np.asarray(1 + self.share * np.sqrt(2) * np.sin(self.waves * x + self.phase))

    def along(self, joints: Array) -> Array:
        """Return the size at joints [mm]: what a screw, a rail or a bar does goes with where its carriage stands."""
        return self(np.pi * (joints - L) / (UP - DOWN))

    def during(self, t: Array) -> Array:
        """Return the size at times [s]: what gauges and temperatures do goes with the part of the run."""
        return self(np.pi * t / _RUN)


@dataclass(frozen=True)
class Fault:
    """What is wrong beside the six parameters; everything zero is the perfect machine. mm, rad, N, s, K."""

    lean: Array = field(default_factory=lambda: np.zeros((3, 3)))  # axis i turned towards j
    aside: Array = field(default_factory=lambda: np.zeros((3, 3)))  # axis i carried along j
    skew: Array = field(default_factory=lambda: np.zeros((3, 3)))  # bar of leg i ends off along j
    pitch: Array = field(default_factory=lambda: np.zeros(3))  # screw i advances (1 + pitch) of what it should
    play: Array = field(default_factory=lambda: np.zeros(3))
    growth: Array = field(default_factory=lambda: np.zeros(3))  # mm / K of leg i
    give: float = 0.0  # mm / N of a leg
    creep: Array = field(default_factory=lambda: np.zeros(3))  # mm / s of the gauges at leg i
    misread: Array = field(default_factory=lambda: np.zeros((3, 3)))  # zero of the gauge at leg i reading j
    roll: Array = field(default_factory=lambda: np.zeros((3, 3)))
    dip: Array = field(default_factory=lambda: np.zeros((3, 3)))
    place: Array = field(default_factory=lambda: np.zeros((3, 3)))
    form: Wave = field(default_factory=Wave)


@dataclass(frozen=True)
class Stop:
    """One place where the gauges of a leg are read, both at once, and the Zero before it."""

    leg: int
    share: float
    axis: int
    level: float
    arrives: int
    zero_arrives: int
    payload: float
    repeat: int
    t: float
    t_zero: float
    path: Array  # tool positions sent, (k, 3), the last is here
    path_zero: Array
    hold: bool


@dataclass(frozen=True)
class Case:
    columns: dict[str, NDArray[Any]]
    metadata: dict[str, Any]
    truth: dict[str, Any]


def case(
    seed: int, family: str = "", target: str = "", lam: float | None = None, plan: str = "cross", bent: bool = False
) -> Case:
    """Draw a machine and its table; `family` hides an effect of visible size `lam` (drawn from 1 to 4) at `target`.

    `bent`: its size goes up and down with the travel, the force or the time, by 5 to 15 % rms: no catalogue has that.
    """
    rng = np.random.default_rng(np.random.SeedSequence([seed, *(family + plan).encode()]))
    stops, world = _shop(plan, rng)
    truth = {"seed": seed, "family": family or "none", "target": "", "lambda": 0.0, "parameters": world.own}
    fault = Fault()
    if family:
        target = target or str(rng.choice(TARGETS[family]))
        unit, largest = _draw(family, target, rng)
        if bent:
            forms = np.random.default_rng(np.random.SeedSequence([seed, *b"form"]))
            wave = Wave(float(forms.uniform(*OFF)), int(forms.integers(1, 4)), float(forms.uniform(-np.pi, np.pi)))
            unit = replace(unit, form=wave)
            truth |= {"off": wave.share}
        lam = float(np.exp(rng.uniform(0, np.log(4)))) if lam is None else lam
        size, seen = _sized(stops, world, unit, lam, largest, 3 if plan == "paper" else 6)
        fault = _times(unit, size)
        truth |= {"target": target, "lambda": seen, "amplitude": size}
    return _table(stops, world, fault, truth, rng)


def quiet(seed: int, fault: Fault, plan: str = "cross") -> Case:
    """Return the table of a drawn machine with `fault`, read without noise."""
    stops, world = _shop(plan, np.random.default_rng(seed))
    return _table(stops, world, fault, {"seed": seed, "parameters": world.own}, None)


def unequal(seed: int, free: str) -> Case:
    """Return the paper's readings of a machine whose legs are off by up to 1 mm, to be calibrated as `free` says."""
    rng = np.random.default_rng(seed)
    stops, world = _shop("paper", rng)
    world = replace(world, own=rng.uniform(-1, 1, 6))
    told = _table(stops, world, Fault(), {"seed": seed, "parameters": world.own}, rng)
    return replace(told, metadata=told.metadata | {"free": free})


TARGETS: dict[str, tuple[str, ...]] = {
    "scale": ("axis x", "axis y", "axis z", "all"),
    "axis_orthogonality": ("axis x", "axis y", "axis z", "pair xy", "pair yz", "pair xz"),
    "axis_intersection": ("axis x", "axis y", "axis z", "pair xy", "pair yz", "pair xz"),
    "bar_skew": ("leg x", "leg y", "leg z"),
    "backlash": ("axis x", "axis y", "axis z", "all"),
    "gravity": ("all",),
    "thermal_legs": ("leg x", "leg y", "leg z", "all"),
    "drift": ("leg x", "leg y", "leg z", "all"),
    "zero_reading": tuple(f"gauge {LETTERS[j]}_{LETTERS[i]}" for i, j in PAIRS),
    "gauge_tilt": tuple(f"gauge {LETTERS[j]}_{LETTERS[i]}" for i, j in PAIRS),
    "gauge_placement": ("leg x", "leg y", "leg z", *(f"gauge {LETTERS[j]}_{LETTERS[i]}" for i, j in PAIRS)),
}

# One size for all three axes: x to y to z to x, or the other way round. They are asked for by name and never drawn.
PATTERNS: dict[str, tuple[str, ...]] = {
    "axis_orthogonality": ("cyclic", "mirrored"),
    "axis_intersection": ("cyclic", "mirrored"),
    "bar_skew": ("cyclic", "mirrored"),
}


def _draw(family: str, target: str, rng: np.random.Generator) -> tuple[Fault, float]:
    """Return the fault at its unit of size, and the largest size such a machine may have."""
    fault, sign = Fault(), float(rng.choice([-1.0, 1.0]))
    some = [LETTERS.index(target[-1])] if target[-1] in LETTERS else [0, 1, 2]
    each = np.zeros(3)
    each[some] = sign
    if family == "scale":
        return replace(fault, pitch=each), 0.05
    if family == "backlash":
        return replace(fault, play=np.abs(each)), 0.16
    if family == "gravity":
        return replace(fault, give=1.0), 0.1
    if family == "thermal_legs":
        return replace(fault, growth=np.abs(each)), 0.5
    if family == "drift":
        return replace(fault, creep=each), 0.01
    table = np.zeros((3, 3))
    if family in ("axis_orthogonality", "axis_intersection", "bar_skew"):
        if target.startswith("pair"):
            i, j = LETTERS.index(target[-2]), LETTERS.index(target[-1])
            k = 3 - i - j
            if family == "axis_orthogonality":
                table[i, j] = table[j, i] = sign / 2
                return replace(fault, lean=table), 0.03
            table[i, k], table[j, k] = sign / 2, -sign / 2
            return replace(fault, aside=table), 8.0
        if target in ("cyclic", "mirrored"):
            for i in range(3):
                table[i, (i + (1 if target == "cyclic" else 2)) % 3] = sign
        else:
            (i,) = some
            angle = rng.uniform(-np.pi, np.pi)
            table[i, (i + 1) % 3], table[i, (i + 2) % 3] = np.cos(angle), np.sin(angle)
        name, largest = {
            "axis_orthogonality": ("lean", 0.03),
            "axis_intersection": ("aside", 8.0),
            "bar_skew": ("skew", 8.0),
        }[family]
        return replace(fault, **{name: table}), largest
    at = [(some[0], j) for j in range(3) if j != some[0]]
    if target.startswith("gauge"):
        at = [(LETTERS.index(target[-1]), LETTERS.index(target[-3]))]
    for i, j in at:
        table[i, j] = sign
    if family == "gauge_tilt":
        angle = rng.uniform(-np.pi, np.pi)
        return replace(fault, roll=table * np.cos(angle), dip=table * np.sin(angle)), 0.2
    return replace(fault, **{"zero_reading": {"misread": table}, "gauge_placement": {"place": table}}[family]), 20.0


@dataclass(frozen=True)
class _World:
    own: Array
    weight: float
    air: tuple[float, float]

    def warmth(self, t: Array | float) -> Array:
        """Temperature of the legs above the reference at t [s], K: the shop warms up after the morning."""
        rise, tau = self.air
        return np.asarray(rise * (1 - np.exp(-np.asarray(t) / tau)))


def _shop(plan: str, rng: np.random.Generator) -> tuple[list[Stop], _World]:
    stops = _stops(plan, rng)
    own = np.concatenate([rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3) * (plan != "paper")])
    air = (8.0 * rng.uniform(0.7, 1.3), 3600.0 * rng.uniform(0.5, 1.5))
    return stops, _World(own, 30.0 if plan == "loaded" else 0.0, air)


def _stops(plan: str, rng: np.random.Generator) -> list[Stop]:
    """Return every stop in the order of time."""
    t, stops = 0.0, []
    both = plan != "paper"
    shares = (0.4, 0.5, 0.65) if both else (0.5,)
    for leg in range(3):
        for share in shares:
            t += 600.0
            for repeat in range(2 if both else 3):
                for load in (0.0, 20.0) if plan == "loaded" else (0.0,):
                    if not both:
                        zero = _ride(leg, 0.0, 1)
                        t_zero = t = t + 20.0
                        for level, sense in ((UP, 1), (DOWN, -1)):
                            t += 20.0
                            path = np.array([[0.0] * 3, _at(leg, level)])
                            stops.append(
                                Stop(leg, share, leg, level, sense, 1, load, repeat, t, t_zero, path, zero, False)
                            )
                        t += 20.0
                        continue
                    for sense in (1, -1):
                        zero, t_zero = _ride(leg, 0.0, sense), t + 20.0
                        t = t_zero
                        for axis in rng.permutation(3):
                            for level in (UP, UP / 2, DOWN / 2, DOWN)[::-sense]:
                                t += 20.0
                                path = _ride(int(axis), level, sense)
                                hold = share == 0.5
                                stops.append(
                                    Stop(
                                        leg,
                                        share,
                                        int(axis),
                                        level,
                                        sense,
                                        sense,
                                        load,
                                        repeat,
                                        t,
                                        t_zero,
                                        path,
                                        zero,
                                        hold,
                                    )
                                )
    return stops


def _at(axis: int, level: float) -> Array:
    return level * np.eye(3)[axis]


def _ride(axis: int, level: float, sense: int) -> Array:
    """Return a way to a level: from the far side of Zero, and the last 12 mm in `sense`."""
    way = [-sense * 60.0, 0.0, level - sense * 12.0, level]
    return np.array([_at(axis, v) for v in way])


def _sent(tool: Array) -> Array:
    """Return the joints a controller that believes in the drawing sends to tools, shape (..., 3), mm."""
    squares = tool**2
    return np.asarray(tool + np.sqrt(L**2 - (squares.sum(axis=-1, keepdims=True) - squares)))


def _carriages(paths: list[Array], play: Array, form: Wave) -> Array:
    """Return where the carriages stand at the ends of the paths, (n, 3): inside their play they stay behind."""
    if not play.any():
        return _sent(np.array([path[-1] for path in paths]))
    ends = []
    for path in paths:
        behind = _sent(path[0])
        for sent in _sent(np.array([a + s * (b - a) for a, b in pairwise(path) for s in np.linspace(0.05, 1, 20)])):
            half = play * form.along(sent) / 2
            behind = np.clip(behind, sent - half, sent + half)
        ends.append(behind)
    return np.array(ends)


def _poses(world: _World, fault: Fault, paths: list[Array], payload: Array, t: Array) -> tuple[Array, Array]:
    """Return joint centres (n, 3, 3) and tools (n, 3) at the ends of paths."""
    home = L + DOWN - 5.0  # the switch from which screws count
    carriages = _carriages(paths, fault.play, fault.form)
    size = fault.form.along(carriages)
    joints = home + (carriages - home) * (1 + fault.pitch * size) + world.own[:3]
    axes = np.stack([_turned(i, fault.lean[i] * size[:, i, None]) for i in range(3)], axis=1)
    centres = fault.aside * size[:, :, None] + joints[:, :, None] * axes
    lengths = L + world.own[3:] + fault.growth * (world.warmth(t) * fault.form.during(t))[:, None]
    tools = _meet(centres, lengths)
    for _ in range(6 if fault.give else 0):
        rays = centres - tools[:, None, :]
        rays = rays / np.linalg.norm(rays, axis=2, keepdims=True)
        load = np.stack([0 * payload, 0 * payload, payload + world.weight], axis=1)
        pull = np.linalg.solve(rays.swapaxes(1, 2), load[:, :, None])[:, :, 0]
        pull = pull * fault.form(np.pi * pull / max(float(np.abs(pull).max()), 1e-9))
        tools = _meet(centres, lengths + fault.give * pull)
    return centres, tools


def _turned(i: int, lean: Array) -> Array:
    """Return axis i turned by rotations whose vectors, (n, 3), lean it towards the others, (n, 3)."""
    angle = np.linalg.norm(lean, axis=1, keepdims=True)
    return np.asarray(np.cos(angle) * np.eye(3)[i] + np.sin(angle) * lean / np.where(angle > 0, angle, 1.0))


def _meet(centres: Array, lengths: Array) -> Array:
    tools = np.zeros((len(centres), 3))
    for _ in range(50):
        away = tools[:, None, :] - centres
        miss = (away**2).sum(axis=2) - lengths**2
        step = np.linalg.solve(2 * away, miss[:, :, None])[:, :, 0]
        tools = tools - step
        if np.abs(step).max() < 1e-11:
            return tools
    raise RuntimeError("the legs do not meet")


def _all(stops: list[Stop], world: _World, fault: Fault) -> Array:
    """Return what the two gauges of the leg show at each stop since Zero, in the order of the other letters, (2 n,)."""
    payload, leg, n = np.array([s.payload for s in stops]), np.array([s.leg for s in stops]), np.arange(len(stops))
    t, t_zero = np.array([s.t for s in stops]), np.array([s.t_zero for s in stops])
    centres0, tools0 = _poses(world, fault, [s.path_zero for s in stops], payload, t_zero)
    centres1, tools1 = _poses(world, fault, [s.path for s in stops], payload, t)
    foot0, foot1 = centres0[n, leg], centres1[n, leg]
    skew0, skew1 = (fault.skew[leg] * fault.form.along(foot[n, leg])[:, None] for foot in (foot0, foot1))
    along0, along1 = tools0 + skew0 - foot0, tools1 + skew1 - foot1
    size = fault.form.during(t)
    crept = fault.creep[leg] * size * 7200.0 * (1 - np.exp(-(t - t_zero) / 7200.0))
    e, shown = np.eye(3), np.empty((len(stops), 2))
    for g in range(2):
        reads = np.array([[1, 2], [0, 2], [0, 1]])[leg, g]
        beside = 3 - leg - reads
        share = np.array([s.share for s in stops]) + fault.place[leg, reads] * size / along0[n, leg]
        roll, dip = ((tilt[leg, reads] * size)[:, None] for tilt in (fault.roll, fault.dip))
        probe = np.cos(dip) * (np.cos(roll) * e[reads] + np.sin(roll) * e[beside]) + np.sin(dip) * e[leg]
        blade = np.cos(roll) * e[beside] - np.sin(roll) * e[reads]  # the edge of the tip, lying across the bar
        start = foot0 + share[:, None] * along0
        # start + r probe + s blade lies on the bar, foot1 + m along1
        sides = np.stack([probe, blade, -along1], axis=2)
        shown[:, g] = np.linalg.solve(sides, (foot1 - start)[:, :, None])[:, 0, 0]
        shown[:, g] += crept - fault.misread[leg, reads] * fault.form.during(t_zero)
    return shown.reshape(-1)


def _times(fault: Fault, size: float) -> Fault:
    return replace(fault, **{name: value * size for name, value in vars(fault).items() if name != "form"})


def _sized(stops: list[Stop], world: _World, unit: Fault, lam: float, largest: float, free: int) -> tuple[float, float]:
    """Return the size at which the fault leaves `lam` sigma (rms) that no calibration of the machine removes."""
    used = [stop for stop in stops if not stop.hold]
    still = _all(used, world, Fault())
    slopes = []
    for k in range(free):
        step = 0.01 * np.eye(6)[k]
        up, down = (_all(used, replace(world, own=world.own + s), Fault()) for s in (step, -step))
        slopes.append((up - down) / 0.02)
    white = _whiten(used)
    q, _ = np.linalg.qr(white(np.array(slopes).T))

    def seen(size: float) -> float:
        left = white((_all(used, world, _times(unit, size)) - still)[:, None])[:, 0]
        left = left - q @ (q.T @ left)
        return float(np.sqrt(np.mean(left**2)) / SIGMA)

    size = largest / 20
    now = seen(size)
    for _ in range(4):
        size = float(min(size * lam / max(now, 1e-9), largest))
        now = seen(size)
    return size, now


def _groups(stops: list[Stop]) -> list[list[int]]:
    """Return, a list for each Zero reading of a gauge, the rows that were compared with it."""
    found: dict[tuple[Any, ...], list[int]] = {}
    for n, stop in enumerate(stops):
        for g in range(2):
            found.setdefault((stop.leg, stop.share, g, stop.payload, stop.repeat, stop.t_zero), []).append(2 * n + g)
    return list(found.values())


def _whiten(stops: list[Stop]) -> Any:
    groups = _groups(stops)

    def white(columns: Array) -> Array:
        out = columns.copy()
        for rows in groups:
            m = len(rows)
            spread = np.linalg.cholesky(np.eye(m) + np.ones((m, m)))
            out[rows] = np.linalg.solve(spread, columns[rows])
        return out

    return white


def _table(
    stops: list[Stop], world: _World, fault: Fault, truth: dict[str, Any], rng: np.random.Generator | None
) -> Case:
    deviation = _all(stops, world, fault)
    if rng is not None:
        deviation = deviation + SIGMA * rng.standard_normal(len(deviation))
        for rows in _groups(stops):
            deviation[rows] -= SIGMA * rng.standard_normal()
    twice = [stop for stop in stops for _ in range(2)]
    directions = [LETTERS[j] for stop in stops for j in range(3) if j != stop.leg]
    word = {1: "fwd", -1: "rev"}
    columns: dict[str, NDArray[Any]] = {
        "leg": np.array([LETTERS[s.leg] for s in twice]),
        "direction": np.array(directions),
        "posture": np.array([LETTERS[s.axis] for s in twice]),
        "gauge_position": np.array([s.share for s in twice]),
        "level_mm": np.array([s.level for s in twice]),
        "pass": np.array([word[s.arrives] for s in twice]),
        "zero_pass": np.array([word[s.zero_arrives] for s in twice]),
        "payload_N": np.array([s.payload for s in twice]),
        "repeat": np.array([s.repeat for s in twice]),
        "t_s": np.array([s.t for s in twice]),
        "zero_t_s": np.array([s.t_zero for s in twice]),
        "temp_K": world.warmth(np.array([s.t for s in twice])),
        "zero_temp_K": world.warmth(np.array([s.t_zero for s in twice])),
        "split": np.where([s.hold for s in twice], "hold", "train"),
        "deviation": deviation,
    }
    metadata: dict[str, Any] = {"schema_version": 1, "machine": "orthoglide", "sigma": SIGMA}
    if not world.own[3:].any():
        metadata["free"] = "rho"  # as the chapter calibrates
    if world.weight:
        metadata["moving_weight_N"] = world.weight
    return Case(columns, metadata, truth)
