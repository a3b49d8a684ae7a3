"""The mistakes that people make in a file of an arm's readings, tried one by one, and the cure of each.

Joints in degrees, in rad where degrees are stated, rails in another unit, one coordinate in another unit, rows out of
step by one, a joint that counts the other way or from another zero, two joints exchanged: each leaves a pattern between
the nominal arm and the readings that no base and no target explain (`frames`). A mistake is named if the readings fit
the arm without it. Of kinds that are alike the one that leaves least is taken; how far a zero is off is found by a scan
of a turn.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any, final

import numpy as np
from scipy.optimize import minimize_scalar

from calibench.calibration.frames import Frames, ball_in_sockets, frames_of_positions, linear_misfit
from calibench.calibration.kinematics import Chain, forward, nominal
from calibench.calibration.readings import Readings
from calibench.calibration.rigid import Array
from calibench.core.notes import Code, Note
from calibench.core.words import as_columns, plain

UNITS = {"mm": 1.0, "m": 1e3, "cm": 10.0, "inch": 25.4, "um": 1e-3}
_RAILS = (  # what a rail is really in, and what it was taken for
    ("m", "mm"), ("mm", "m"), ("cm", "mm"), ("mm", "cm"), ("inch", "mm"), ("mm", "inch"), ("m", "cm"), ("cm", "m"),
)  # fmt: skip
NEAR = 0.2  # part of a unit: few poses of an arm that is not calibrated tell it no better
APART = 0.08  # part of the arm's reach: readings further off are not of this arm
_LEAST_APART = 1.0  # mm, of a ball in sockets
_SCAN = np.deg2rad(np.arange(-165, 181, 15))  # of a joint's zero
_SCANNED = 200  # rows that a scan looks at
_WHOLE = 0.3  # degrees: a zero that is nearer to a whole number of them is one


@final
@dataclass(frozen=True, eq=False)
class Trial:
    """Readings as they would be without a mistake; its `code`, its cure as the end of a sentence, what it is about."""

    code: Code
    text: str
    joints: Array
    readings: Readings
    columns: tuple[str, ...] = ()
    values: Mapping[str, Any] = field(default_factory=dict)


def unit_of(frames: Frames) -> str | None:
    """Return the unit in which the readings fit the arm; None where there is none."""
    return next((unit for unit, size in UNITS.items() if abs(frames.scale / size - 1) < NEAR), None)


def reach_of(poses: Array) -> float:
    """Return the spread of nominal places, rms [mm], of poses (n, 4, 4)."""
    return float(np.sqrt(((poses[:, :3, 3] - poses[:, :3, 3].mean(axis=0)) ** 2).sum(axis=1).mean()))


def most_apart(reach: float, sockets: bool) -> float:
    """Return how far readings and nominal arm may lie apart [mm] to be of one arm."""
    return max(APART * reach, _LEAST_APART) if sockets else APART * reach


def misfit(chain: Chain, joints: Array, readings: Readings) -> tuple[float, bool]:
    """Return how far nominal arm and readings lie apart at `joints` [mm], and whether so little is the arm's own."""
    poses = forward(chain, nominal(chain), joints)
    if readings.position is None:
        apart, reach, has_unit = ball_in_sockets(poses, readings.socket)[2], reach_of(poses), True
    else:
        frames = frames_of_positions(poses, readings.position)
        apart, reach, has_unit = frames.apart, frames.reach, unit_of(frames) is not None
    return apart, has_unit and apart < 0.5 * most_apart(reach, readings.position is None)


def mistake_in(readings: Readings, chain: Chain) -> Note | None:
    """Return the mistake without which `readings` fit the arm, as the end of a sentence that says so; None for none."""
    for trials in _trials(readings, chain):
        results = [(*misfit(chain, trial.joints, trial.readings), trial) for trial in trials]
        apart, fits, trial = min(results, key=lambda one: one[0])
        if fits:
            return Note(trial.code, f"{plain(apart, 2)} mm {trial.text}", trial.columns, values=trial.values)
    return None


def _trials(readings: Readings, chain: Chain) -> Iterator[Sequence[Trial]]:
    """Yield what is tried, in groups: of a group the best is taken, and a group comes before the later ones."""
    columns = readings.matched.joints
    turning = [k for k, name in enumerate(chain.driven) if name not in readings.sliding]
    sliding = [k for k, name in enumerate(chain.driven) if name in readings.sliding]

    def scaled(places: Sequence[int], factor: float) -> Array:
        joints = readings.joints.copy()
        joints[:, places] *= factor
        return joints

    angles = tuple(columns[chain.driven[k]] for k in turning)
    stated = bool({*angles} & {*readings.table.units})
    for unit, factor in (("deg", np.pi / 180), ("rad", 180 / np.pi)):
        if turning and (unit == "deg" or stated):
            really = {"deg": "degrees", "rad": "rad, and not in degrees as the file states"}[unit]
            text = f"with joints in {really}: units={','.join(f'{one}:{unit}' for one in angles)}"
            yield [
                Trial(
                    code=Code.JOINT_UNIT,
                    text=text,
                    joints=scaled(turning, factor),
                    readings=readings,
                    columns=angles,
                    values={"unit": unit},
                )
            ]
    rails = tuple(columns[chain.driven[k]] for k in sliding)
    for really, taken in _RAILS if rails else ():
        text = f"with {', '.join(rails)} in {really}: units={','.join(f'{one}:{really}' for one in rails)}"
        joints = scaled(sliding, UNITS[really] / UNITS[taken])
        yield [
            Trial(
                code=Code.JOINT_UNIT,
                text=text,
                joints=joints,
                readings=readings,
                columns=rails,
                values={"unit": really},
            )
        ]
    if readings.position is not None:
        yield from _of_rows(readings)
    yield [*_of_a_joint(readings, chain, scaled), *_exchanged(readings, chain)]
    if readings.position is not None:
        yield list(_of_a_coordinate(readings))


def _of_rows(readings: Readings) -> Iterator[Sequence[Trial]]:
    n = len(readings)
    for lag, where in ((1, "below"), (-1, "above")):
        kept = readings.where(np.arange(n) != (0 if lag > 0 else n - 1))
        text = f"if the readings of each row's joints stand in the row {where}"
        joints = readings.joints[max(-lag, 0) : n - max(lag, 0)]
        yield [Trial(Code.ROWS_OUT_OF_STEP, text, joints, kept, values={"rows": lag})]


def _of_a_joint(readings: Readings, chain: Chain, scaled: Any) -> Iterator[Trial]:
    for k, name in enumerate(chain.driven):
        column, slides = readings.matched.joints[name], name in readings.sliding
        cure = "turn its axis, or its readings"
        if chain.source == "table":
            cure = "change the sign of its column, or the alphas that point its axis"
        text = f"if joint {name} {'slides' if slides else 'turns'} the other way than in the {chain.source}: {cure}"
        yield Trial(
            code=Code.JOINT_REVERSED, text=text, joints=scaled([k], -1.0), readings=readings, columns=(column,),
            values={"joint": name},
        )  # fmt: skip
        if slides:
            continue
        degrees = _zero_of(readings, chain, k)
        text = f"if {degrees:g}° are added to joint {name}: its zero is not that of the {chain.source}"
        joints = readings.joints.copy()
        joints[:, k] += np.deg2rad(degrees)
        values = {"joint": name, "degrees": degrees}
        yield Trial(
            code=Code.JOINT_SHIFTED, text=text, joints=joints, readings=readings, columns=(column,), values=values
        )


def _exchanged(readings: Readings, chain: Chain) -> Iterator[Trial]:
    for a, b in combinations(range(len(chain.driven)), 2):
        order = list(range(len(chain.driven)))
        order[a], order[b] = b, a
        one, other = chain.driven[a], chain.driven[b]
        columns = readings.matched.joints[other], readings.matched.joints[one]
        or_names = ", or their names in the table" if chain.source == "table" else ""
        text = (
            f"if the columns of joints {one} and {other} are exchanged{or_names}: "
            f"{as_columns({f'q_{one}': columns[0], f'q_{other}': columns[1]})}"
        )
        values = {"joints": [one, other]}
        yield Trial(
            code=Code.JOINTS_EXCHANGED, text=text, joints=readings.joints[:, order], readings=readings, columns=columns,
            values=values,
        )  # fmt: skip


def _of_a_coordinate(readings: Readings) -> Iterator[Trial]:
    for k, (axis, column) in enumerate(readings.matched.position.items()):
        for unit, other in (("m", "mm"), ("mm", "m"), ("inch", "mm"), ("mm", "inch")):
            position = np.array(readings.position)
            position[:, k] *= UNITS[unit] / UNITS[other]
            text = f"if {column} is in {unit} where the others are in {other}: units={column}:{unit}"
            changed = replace(readings, position=position)
            yield Trial(
                code=Code.POSITION_UNIT, text=text, joints=readings.joints, readings=changed, columns=(column,),
                values={"axis": axis, "unit": unit},
            )  # fmt: skip


def _zero_of(readings: Readings, chain: Chain, k: int) -> float:
    """Return by how many degrees joint k has to be turned for the readings to be nearest to the nominal arm."""
    some = readings.where(np.unique(np.linspace(0, len(readings) - 1, _SCANNED).astype(int)))

    def apart(angle: float) -> float:
        joints = some.joints.copy()
        joints[:, k] += angle
        poses = forward(chain, nominal(chain), joints)
        if some.position is None:
            return ball_in_sockets(poses, some.socket)[2]
        return linear_misfit(poses, some.position)

    best = _SCAN[int(np.argmin([apart(angle) for angle in _SCAN]))]
    step = float(_SCAN[1] - _SCAN[0])
    zero = minimize_scalar(apart, bounds=(best - step, best + step), method="bounded", options={"xatol": 1e-4}).x
    degrees = float(np.rad2deg(zero))
    degrees = degrees - 360 if degrees > 180 + _WHOLE else degrees
    return float(round(degrees)) if abs(degrees - round(degrees)) < _WHOLE else float(plain(degrees, 4))
