"""The GPM2002 as a measured machine (Cong et al. 2008): three legs that must meet in one point.

Angles only: one constraint a reading, the power of the radical centre of the three distal circles, eqs. (32)-(33); a
planar similarity is invisible, so 11 of 15 numbers are free. With a tracker's x, y each leg closes on its own, and all
15 are free. The encoder offsets to begin from are scanned over the turn, as a fit from elsewhere may end in another
configuration. What makes a fit meaningless is a `DataError`; what only costs something is a note.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, final

import numpy as np

from calibench.core.notes import Code
from calibench.core.options import shown, suggest
from calibench.core.words import plain
from calibench.discrepancy.checks.validate import NOT_HELD_OUT, entered
from calibench.discrepancy.model import measured
from calibench.discrepancy.model.machine import WORKSPACE, Formulation, Numbers, Quantities, as_is
from calibench.discrepancy.model.measured import DataError, MeasuredData, MisfitError, Sensor
from calibench.discrepancy.model.roles import Instrument, Joint, Length, Roles
from calibench.discrepancy.registries import machines
from calibench.problems.base import Array, Parameter
from calibench.problems.planar.gpm2002 import NAMES, UNITS, makers_machine

LEGS = (1, 2, 3)
JOINTS = ("joint 1", "joint 2", "joint 3")
_GAUGE = ("xa1", "ya1", "xa2", "ya2")  # held where nothing but angles is read
_OFFSETS = ("z1", "z2", "z3")
_FAR = 40.0  # mm: nominal legs that miss each other by more at the best offsets are not those of the data
_SCALE = 488.0  # turns a power in mm^2 into about the miss of the point in mm: twice the nominal distal link


@machines.register("gpm2002")
@final
@dataclass(frozen=True)
class Gpm2002:
    """The planar 2-dof manipulator with three driven legs."""

    name: str = field(default="gpm2002", init=False)

    def formulate(self, data: MeasuredData) -> Formulation:
        """Return the closure of the three legs, with the tracker's x, y where those columns are there."""
        data = _validated(data)
        stated, fixed = measured.nominal_numbers(data, NAMES), data.metadata.get("fixed_parameters") or ()
        if not isinstance(fixed, str | Sequence | Mapping):
            rule = "names, or names with values, are needed"
            raise DataError(f"{data.name}: metadata fixed_parameters={fixed!r}: {rule}")
        held = (fixed,) if isinstance(fixed, str) else tuple(fixed)
        for name in held:
            if name not in NAMES:
                word = shown(name)
                raise DataError(f"{data.name}: metadata fixed_parameters names {word!r}; {suggest(word, NAMES)}")
        if len(set(held)) == len(NAMES):
            every = "holds all parameters: nothing is left to calibrate"
            raise DataError(f"{data.name}: metadata fixed_parameters {every}")
        if isinstance(fixed, Mapping):
            stated |= {name: measured.finite(data, name, value) for name, value in fixed.items()}

        tracked = data.has("x", "y")
        nominal = dict(zip(NAMES, makers_machine().tolist())) | stated
        if not tracked:
            # hold so many besides that, where only angles are read, every move can be observed
            moves = np.zeros((len(NAMES), 4))
            for k, name in enumerate(NAMES):
                if name[:2] in ("xa", "ya"):
                    other = nominal[("y" if name[0] == "x" else "x") + name[1:]]
                    moves[k] = (name[0] == "x", name[0] == "y", -other if name[0] == "x" else other, nominal[name])
                else:
                    moves[k] = (0, 0, 1, 0) if name[0] == "z" else (0, 0, 0, nominal[name])
            moves /= np.linalg.norm(moves, axis=0)

            chosen, rank = list(held), -1
            for name in ("", *_GAUGE, *NAMES):
                tried = [*chosen, name] if name else chosen
                rows = moves[[NAMES.index(one) for one in tried]]
                seen = int(np.linalg.matrix_rank(rows, tol=1e-6)) if tried else 0
                if seen > rank:
                    chosen, rank = tried, seen
            held = (*held, *chosen[len(held) :])
        closure = LegClosure(data, (), {name: nominal[name] for name in held}, tracked)
        offsets = tuple(name for name in _OFFSETS if name not in held)
        sample = closure.on(data.rows(np.unique(np.linspace(0, len(data) - 1, min(60, len(data))).round().astype(int))))
        found, miss = _closing_offsets(sample, nominal, offsets, all(name in stated for name in offsets))
        if not miss < _FAR:
            raise MisfitError(
                f"{data.name}: the legs of the nominal machine miss each other by {plain(miss, 3)} mm at the best "
                "offsets: are the angles in radians, lengths in mm, and is metadata nominal that of this machine?"
            )
        start, wide = nominal | found, {"mm": 10.0, "rad": 0.4}
        free = [(name, unit, start[name], wide[unit]) for name, unit in zip(NAMES, UNITS) if name not in held]
        return replace(closure, parameters=tuple(Parameter(n, unit, at, at - w, at + w) for n, unit, at, w in free))


@final
@dataclass(frozen=True, eq=False)
class LegClosure:
    """The closure of the legs over one set of data: angles only (n, 1), or with a tracker (n, 3), mm."""

    data: MeasuredData
    parameters: tuple[Parameter, ...]
    fixed: dict[str, float]
    tracked: bool
    unit: str = "mm"

    @property
    def readings(self) -> tuple[str, ...]:
        return tuple(sensor.column for sensor in self.sensors)

    @cached_property
    def sensors(self) -> tuple[Sensor, ...]:
        """Return an encoder at each driven joint, and with a tracker its two coordinates."""
        resolution = float(self.data.metadata.get("encoder_lsb") or 0.0)
        sensors = [
            Sensor(f"enc_{i}", "encoder", "rad", f"joint {i}", (f"leg {i}",), label=f"angle of joint {i}",
                   resolution=resolution, over_place=True) for i in LEGS
        ]  # fmt: skip
        return (*sensors, *(Sensor(name, "tracker", "mm") for name in "xy" if self.tracked))

    @cached_property
    def roles(self) -> Roles:
        """Return what it is made of: driven joints with encoders, six links, a clock, a thermometer, a tracker."""
        joints = tuple(
            Joint(f"joint {i}", f"enc_{i}", direction=f"dir_{i}", velocity=f"vel_{i}", torque=f"tau_{i}",
                  teeth=teeth_of(self.data.metadata, i)) for i in LEGS
        )  # fmt: skip
        proximal = tuple(Length(f"proximal link {i}", f"la{i}") for i in LEGS)
        distal = tuple(Length(f"distal link {i}", f"lb{i}", force=f"axial_{i}") for i in LEGS)
        tracker = (Instrument("tracker", ("x", "y")),) if self.tracked else ()
        return Roles(joints, (*proximal, *distal), "t_s", "temp_K", tracker)

    @property
    def sigma(self) -> dict[str, float]:
        """Return the stated noise of the encoders [rad] and of the tracker [mm]."""
        stated = dict.fromkeys(ENCODERS, float(self.data.metadata["sigma_enc"]))
        return stated | (dict.fromkeys("xy", float(self.data.metadata["sigma_xy"])) if self.tracked else {})

    def constraints(self, q: Quantities) -> Numbers:
        """Return the power of P over 2 * 244 mm: of the radical centre, (n, 1), or of the tracked point, (n, 3)."""
        bx, by = _elbows(q)
        px, py = (q["x"], q["y"]) if self.tracked else _radical_centre(bx, by, q)
        legs = LEGS if self.tracked else LEGS[:1]  # at the radical centre all three powers are equal
        powers = [(px - bx[i - 1]) ** 2 + (py - by[i - 1]) ** 2 - q[f"lb{i}"] ** 2 for i in legs]
        return np.stack(powers, axis=-1) / _SCALE

    def slopes(self, q: Quantities) -> dict[str, Array]:
        bx, by = _elbows(q)
        px, py = (q["x"], q["y"]) if self.tracked else _radical_centre(bx, by, q)
        weights = np.ones((3, len(self.data)))
        if not self.tracked:  # of P in the triangle of the elbows: sum w = 1, sum w_i (P - B_i) = 0
            x, y = [b - px for b in bx], [b - py for b in by]
            areas = np.stack([x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]])
            weights = np.asarray(areas / areas.sum(axis=0))
        slopes: dict[str, Array] = {}
        for i in LEGS:
            away_x, away_y, w = bx[i - 1] - px, by[i - 1] - py, 2 * weights[i - 1] / _SCALE
            theta = q[f"enc_{i}"] + q[f"z{i}"]
            cos, sin = np.cos(theta), np.sin(theta)
            leg = {
                f"xa{i}": w * away_x,
                f"ya{i}": w * away_y,
                f"la{i}": w * (away_x * cos + away_y * sin),
                f"lb{i}": -w * q[f"lb{i}"],
                f"z{i}": w * q[f"la{i}"] * (away_y * cos - away_x * sin),
            }
            leg[f"enc_{i}"] = leg[f"z{i}"]
            for name, value in leg.items():  # in the leg's own constraint, or in the only one
                slopes[name] = np.zeros((len(value), 3)) if self.tracked else value[:, None]
                if self.tracked:
                    slopes[name][:, i - 1] = value
        if self.tracked:
            slopes["x"] = 2 * np.stack([px - x for x in bx], axis=-1) / _SCALE
            slopes["y"] = 2 * np.stack([py - y for y in by], axis=-1) / _SCALE
        return slopes

    decorrelate = as_is

    def covariates(self, q: Quantities) -> dict[str, dict[str, Array]]:
        """Return target -> covariate -> (n,): a leg's own angle, the others' angles, its further columns, the place."""
        met: dict[str, dict[str, Array]] = {}
        for i in LEGS:
            names = (*ENCODERS, *SHARED, *(f"{kind}_{i}" for kind in OWN))
            there = {name: self.data[name] for name in names if name in self.data}
            met[f"leg {i}"] = {name: column for name, column in there.items() if np.ptp(column) > 0}
        x, y = (q["x"], q["y"]) if self.tracked else _radical_centre(*_elbows(q), q)
        return {**met, WORKSPACE: {"x": np.real(x), "y": np.real(y)}}

    def on(self, data: MeasuredData) -> LegClosure:
        return replace(self, data=data)


def _elbows(q: Quantities) -> tuple[list[Numbers], list[Numbers]]:
    """Return x and y of the elbows B_i, each (n,), mm."""
    theta = [q[f"enc_{i}"] + q[f"z{i}"] for i in LEGS]
    x = [q[f"xa{i}"] + q[f"la{i}"] * np.cos(theta[i - 1]) for i in LEGS]
    y = [q[f"ya{i}"] + q[f"la{i}"] * np.sin(theta[i - 1]) for i in LEGS]
    return x, y


def _radical_centre(bx: list[Numbers], by: list[Numbers], q: Quantities) -> tuple[Numbers, Numbers]:
    """Return the radical centre of the distal circles, eqs. (32)-(33), in coordinates centred at B_1."""
    x2, y2, x3, y3 = bx[1] - bx[0], by[1] - by[0], bx[2] - bx[0], by[2] - by[0]
    d2 = (x2**2 + y2**2 - q["lb2"] ** 2 + q["lb1"] ** 2) / 2  # eq. (32), the squares lost in print restored
    d3 = (x3**2 + y3**2 - q["lb3"] ** 2 + q["lb1"] ** 2) / 2
    twice_area = x2 * y3 - x3 * y2
    return bx[0] + (d2 * y3 - d3 * y2) / twice_area, by[0] + (d3 * x2 - d2 * x3) / twice_area


def teeth_of(metadata: Mapping[str, Any], i: int) -> float:
    """Return the tooth number of joint i: from a list, a mapping (`1`, `joint 1`, `enc_1`) or one number for all."""
    stated = metadata.get("tooth_numbers")
    if isinstance(stated, Mapping):
        stated = next((stated[key] for key in (str(i), f"joint {i}", f"enc_{i}") if key in stated), None)
    elif isinstance(stated, list | tuple | np.ndarray):
        stated = stated[i - 1] if len(stated) >= i else None
    try:
        teeth = float(stated) if stated is not None else 0.0
    except (TypeError, ValueError):
        teeth = 0.0
    return teeth if np.isfinite(teeth) and teeth > 0 else 0.0


_STEPS = (24, 36)  # of the turn, in each offset; the second where the first finds nothing that closes
_ROWS = 7  # that the scan looks at
_TRIED = 80
_CLOSED = 1.0  # mm: offsets that close the nominal legs as well as this are not searched for any longer
_WILD = 150.0  # mm: a miss beyond counts as this much; near-singular readings must not decide
_ROUNDS = 30
_LINK = 244.0  # mm
_STEP = 1e-4  # mm, of differences
_CLEARLY = 0.5  # offsets elsewhere must close this many times better than those near the stated ones


def _closing_offsets(
    formulation: Formulation, nominal: Mapping[str, float], free: tuple[str, ...], stated: bool
) -> tuple[dict[str, float], float]:
    """Return the offsets `free`, rad, with which the nominal machine closes best on the rows, and the misclosure, mm.

    The misclosure is a median over readings. Where the offsets are `stated`, those in `nominal` are a start as well,
    and are kept unless others close clearly better.
    """
    q = {name: np.asarray(value) for name, value in {**formulation.fixed, **nominal}.items()}
    q |= {name: formulation.data[name] for name in formulation.readings}
    begin = np.array([nominal[name] for name in free])
    if not free:
        return {}, float(np.median(np.abs(_missed(formulation, q, free, begin)[0]).max(axis=1)))
    near, miss = _refined(formulation, q, free, begin)
    if not (stated and miss < 3.0):
        far, other, ends = begin, np.inf, list[Array]()
        for place in _places(formulation, q, free, ends):
            end, left = _refined(formulation, q, free, place)
            ends.append(end)
            if left < other:
                far, other = end, left
            if other < _CLOSED:
                break
        if not stated or other < _CLEARLY * miss:
            near, miss = far, other
    turns = 2 * np.pi * np.round((begin - near) / (2 * np.pi))
    return dict(zip(free, (near + turns).tolist())), miss


def _places(
    formulation: Formulation, q: dict[str, Array], free: tuple[str, ...], ends: Sequence[Array]
) -> Iterator[Array]:  # fmt: skip
    """Yield where offsets are looked for; of those that ended last every leg tells its own, where each has a place."""
    for steps in _STEPS:
        yield from _scan(formulation, q, free, steps)
        if len(formulation.readings) > 3:
            missed = np.stack([np.median(np.abs(_missed(formulation, q, free, z)[0]), axis=0) for z in ends[-2:]])
            better = np.argmin(missed, axis=0)
            yield np.array([ends[-2:][better[int(name[1]) - 1]][k] for k, name in enumerate(free)])


def _scan(formulation: Formulation, q: dict[str, Array], free: tuple[str, ...], steps: int) -> list[Array]:
    """Return the offsets of the scan with the smallest misclosure, at most `_TRIED`, the best first."""
    turn = np.linspace(0, 2 * np.pi, steps, endpoint=False)
    apart = len(formulation.readings) > 3
    axes = [turn] if apart else [turn] * len(free)
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    few = np.unique(np.linspace(0, len(formulation.data) - 1, _ROWS).round().astype(int))
    at = {name: value[few] if np.ndim(value) else value for name, value in q.items()}
    at |= {name: grid[:, 0 if apart else k, None] for k, name in enumerate(free)}
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        power = formulation.constraints(at)
        spread = np.zeros_like(power)
        for name in formulation.readings:
            step = _STEP / (_LINK if name in ENCODERS else 1.0)
            spread += ((formulation.constraints({**at, name: at[name] + step}) - power) / _STEP) ** 2
        missed = np.minimum(np.nan_to_num(np.abs(power) / np.sqrt(spread), nan=_WILD), _WILD).mean(axis=1)
    if not apart:
        return list(grid[np.argsort(missed[:, 0])[:_TRIED]])
    return list(np.stack([turn[np.argsort(missed[:, int(name[1]) - 1])[:2]] for name in free], axis=1))


@np.errstate(divide="ignore", invalid="ignore", over="ignore")  # elbows in line: a step there is refused by its miss
def _refined(formulation: Formulation, q: dict[str, Array], free: tuple[str, ...], z: Array) -> tuple[Array, float]:
    """Return the offsets after damped Gauss-Newton steps from `z`, and the median over readings of the largest miss."""
    damping, (missed, jacobian) = 1e-2, _missed(formulation, q, free, z)
    for _ in range(_ROUNDS):
        flat, columns = missed.ravel(), jacobian.reshape(-1, len(z))
        normal = columns.T @ columns
        damped = normal + damping * (np.diag(np.diag(normal)) + 1e-12 * np.eye(len(z)))
        trial = z - np.linalg.solve(damped, columns.T @ flat)
        there = _missed(formulation, q, free, trial)
        before, after = float(flat @ flat), float(np.square(there[0]).sum())
        if after < before:
            z, (missed, jacobian), damping = trial, there, damping / 10
            if before - after < 1e-9 * before:
                break
        else:
            damping = max(damping, 1e-6) * 10
            if damping > 1e6:
                break
    return z, float(np.median(np.abs(missed).max(axis=1)))


def _missed(formulation: Formulation, q: dict[str, Array], free: tuple[str, ...], z: Array) -> tuple[Array, Array]:
    """Return the misclosure of the legs, (n, c), in mm of displacement, and its slopes in `free`.

    It is the power over the power's slope in the readings, because the power alone has no meaning where the elbows are
    almost in line and the radical centre is far away.
    """
    at = q | dict(zip(free, z))
    slopes = formulation.slopes(at)
    arms = {name: _LINK if name in ENCODERS else 1.0 for name in formulation.readings}  # a unit in about a mm
    spread = np.sqrt(sum((slopes[name] / arm) ** 2 for name, arm in arms.items()))
    return formulation.constraints(at) / spread, np.stack([slopes[name] / spread for name in free], axis=-1)


ENCODERS = ("enc_1", "enc_2", "enc_3")
SHARED = ("t_s", "temp_K", "speed", "heading", "load_x", "load_y")
OWN = ("vel", "dir", "tau", "axial")
COVARIATES = (*SHARED, *(f"{kind}_{i}" for kind in OWN for i in LEGS))
_NUMBERS = (*ENCODERS, "x", "y", *COVARIATES, "repeat")
_KNOWN = (*_NUMBERS, "pose_id", "visit_id", "split", "valid")
_MOST_TEETH = 1e6  # of a gear: a tooth has an angle that doubles still tell
_SPARE = 0.05  # of the rows may go for the sake of a covariate that is not a number there; beyond, the column goes


def _validated(data: MeasuredData) -> MeasuredData:
    stated = data.metadata.get("machine", data.machine)
    if stated != "gpm2002":
        raise DataError(f"{data.name}: these data are of machine {stated!r}; machine=gpm2002 cannot use them")
    missing = [column for column in ENCODERS if column not in data]
    near = {column: name for column in missing if (name := _nearest(column, list(data.in_file)))}
    if len(missing) == len(ENCODERS) and not near:
        raise DataError(
            f"{data.name}: columns {', '.join(missing)} are missing, there are {', '.join(data.in_file)}: "
            "data of another machine? (state it: machine=NAME)"
        )
    if missing:
        near_one = f" (is {missing[0]} called {near[missing[0]]}?)" if missing[0] in near else ""
        raise DataError(
            f"{data.name}: column {', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing{near_one}; there "
            f"are {', '.join(data.in_file)}; rename it in the file, or state its name: "
            f'columns={{"{missing[0]}": "{near.get(missing[0], "NAME")}"}}'
        )
    data = _stated_noise(_usable_rows(entered(data)))

    # refuse statements on the encoders that cannot be right; a missing statement is no error
    resolution, teeth = data.metadata.get("encoder_lsb"), data.metadata.get("tooth_numbers")
    if resolution is not None:
        measured.positive(data, "encoder_lsb", resolution)
    each = list(teeth.values()) if isinstance(teeth, Mapping) else teeth
    numbers = each if isinstance(each, Sequence) and not isinstance(each, str) else [each]
    counts = all(n is None or (isinstance(n, int | float) and 0 <= n <= _MOST_TEETH) for n in numbers)
    if not counts or (numbers is teeth and len(numbers) not in (0, len(ENCODERS))):
        raise DataError(
            f"{data.name}: metadata tooth_numbers={shown(teeth)}: a number for each of the three joints is needed "
            "(null: not known), or one for all"
        )

    equations, free = (3, 15) if data.has("x", "y") else (1, 11)
    sigma = float(data.metadata["sigma_enc"])
    poses = len(np.unique(np.round(np.stack([data[c] for c in ENCODERS]) / (100 * sigma)), axis=1).T)
    if poses * equations < free + 3:
        raise DataError(
            f"{data.name}: {poses} different poses give {poses * equations} equations: too few for {free} parameters; "
            f"measure {-(-2 * free // equations)} poses or more"
        )

    # what costs something and makes no fit meaningless
    if "t_s" in data:
        again = len(data) - len(np.unique(data["t_s"]))
        if again:
            text = f"{again} rows repeat a time stamp; steps in time cannot fall between them"
            data = data.with_note(Code.TIME_REPEATED, text, ("t_s",), count=again)
    repeated = "visit_id" in data and len(np.unique(data["visit_id"])) < len(data)
    if not repeated:
        why = "" if data.has("pose_id", "visit_id") else " can be told without columns pose_id and visit_id"
        text = (
            f"no repeats{why}: the stated noise is taken on trust; "
            "were it larger, noise would be taken for a missing effect"
        )
        data = data.with_note(Code.NO_REPEATS, text)
    if data.fitted.all():
        data = data.with_note(Code.NOT_HELD_OUT, NOT_HELD_OUT)
    needed = [name for name in COVARIATES if name in data and name.partition("_")[0] in ("t", "temp", *OWN)]
    still = [name for name in needed if not np.ptp(data[name]) > 0]
    if still:
        text = f"{', '.join(still)} never varies; effects that need it cannot be tested"
        data = data.with_note(Code.COLUMN_NOT_FOLLOWED, text, still)
    return data


def _nearest(column: str, there: list[str]) -> str:
    """Return the unknown name that is most like that of a column; "" where none is."""
    letters = {"".join(filter(str.isalnum, name.lower())): name for name in there if name not in _KNOWN}
    wanted = "".join(filter(str.isalnum, column.lower()))
    close = difflib.get_close_matches(wanted, list(letters), n=1, cutoff=0.75)
    return letters[close[0]] if close else ""


def _without(data: MeasuredData, columns: tuple[str, ...], why: str) -> MeasuredData:
    kept = {name: column for name, column in data.columns.items() if name not in columns}
    return replace(data, columns=kept).with_note(Code.COLUMN_NOT_USED, why, columns)


def _usable_rows(data: MeasuredData) -> MeasuredData:
    for name, values in data.columns.items():
        if name in _NUMBERS:
            try:
                data = data.with_columns({name: np.asarray(values, dtype=float)})
            except (TypeError, ValueError):
                raise DataError(f"{data.name}: column {name} holds {str(values[0])!r}: numbers are needed") from None
    if data.has("x") != data.has("y"):
        data = _without(data, ("x", "y"), "x and y go together: one of them is missing, so only the angles are used")

    still = [column for column in ENCODERS if len(data) > 1 and (data[column] == data[column][0]).all()]
    if still and np.isfinite(data[still[0]][0]):
        raise DataError(f"{data.name}: {', '.join(still)} never varies: is the encoder read at all?")
    needed = list(ENCODERS)
    there = np.all([np.isfinite(data[column]) for column in ENCODERS], axis=0)
    if there.any() and data.has("x", "y"):
        tracked = np.isfinite(data["x"]) & np.isfinite(data["y"])
        if tracked[there].mean() < 0.5:
            data = _without(data, ("x", "y"), "x, y are missing in most rows, so only the angles are used")
        else:
            needed += ["x", "y"]
    for name in COVARIATES:
        if name not in data:
            continue
        bad = ~np.isfinite(data[name])
        if bad.mean() > _SPARE:
            data = _without(data, (name,), f"column {name} is not a number in {bad.mean():.0%} of the rows: not used")
        else:
            needed.append(name)
    data = measured.with_numbers(data, dict.fromkeys(needed, np.ones(len(data), dtype=bool)))

    # angles in radians, without whole turns
    turned = []
    for column in ENCODERS:
        reading = data[column]
        if np.ptp(reading) > 2.02 * np.pi:
            raise DataError(
                f"{data.name}: {column} ranges over {np.ptp(reading):.4g}, more than a turn: it looks like degrees; "
                "radians are needed (multiply by pi/180)"
            )
        middle = float(np.angle(np.exp(1j * reading).mean()))
        whole = reading - 2 * np.pi * np.round((reading - middle) / (2 * np.pi))
        if np.ptp(whole) < np.ptp(reading) - np.pi:
            data = data.with_columns({column: whole})
            turned.append(column)
    if "heading" in data and np.ptp(data["heading"]) > 4.04 * np.pi:
        raise DataError(f"{data.name}: heading ranges over {np.ptp(data['heading']):.4g}: radians are needed")
    if turned:
        data = data.with_note(Code.TURNS, f"{', '.join(turned)} jumps by a turn; whole turns are taken out", turned)
    return data


def _stated_noise(data: MeasuredData) -> MeasuredData:
    """Return the data with sigma_enc, and with a tracker sigma_xy, in the metadata: as stated, or from repeats."""
    groups = {"sigma_enc": ENCODERS} | ({"sigma_xy": ("x", "y")} if data.has("x", "y") else {})
    for key, columns in groups.items():
        stated = data.metadata.get(key)
        if stated is not None:
            measured.positive(data, key, stated)
            continue

        # the robust spread of readings that follow each other within a visit over sqrt 2; 0 without ten pairs
        deviation = 0.0
        if "visit_id" in data:
            order = np.argsort(data["visit_id"], kind="stable")
            same = data["visit_id"][order][1:] == data["visit_id"][order][:-1]
            if same.sum() >= 10:
                change = np.concatenate([np.diff(data[column][order])[same] for column in columns])
                deviation = float(np.median(np.abs(change)) / 0.6745 / np.sqrt(2))
        if deviation > 0:
            data = replace(data, metadata={**data.metadata, key: deviation})
            text = f"{key} is not stated; back-to-back repeats give {deviation:.3g}, which is used"
            data = data.with_note(Code.NOISE_OF_REPEATS, text, columns, sigma=deviation)
        elif key == "sigma_xy":
            data = _without(data, ("x", "y"), "sigma_xy is not stated and no repeats tell it: only the angles are used")
        else:
            raise DataError(f"{data.name}: {key} is neither in the metadata nor told by repeats; state it [rad]")
    return data
