"""`Sensor`: one instrument of a machine. The search takes its kind and part from here, never from a column's name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final


@final
@dataclass(frozen=True)
class Sensor:
    """The column an instrument fills, in `unit`, what kind of instrument it is, and what it reads.

    Sensors of one `kind` are of one make: their noise was stated once, and where that is wrong it is wrong for all.
    `part` is the target of a finding that blames this sensor alone (`joint 2`); one without a part is never blamed.
    `targets` are those of `Formulation.covariates` whose smooth errors this sensor shows, and `over_place` says whether
    one over the workspace is looked for, too. `resolution` is the stated step of its values, 0 where none is stated.
    `label` is what it reads, in words.
    """

    column: str
    kind: str
    unit: str = ""
    part: str = ""
    targets: tuple[str, ...] = ()
    label: str = ""
    resolution: float = 0.0
    over_place: bool = False


def kinds_of(sensors: Sequence[Sensor]) -> list[tuple[Sensor, ...]]:
    """Return the sensors by kind, in the order of their first."""
    kinds = dict.fromkeys(sensor.kind for sensor in sensors)
    return [tuple(sensor for sensor in sensors if sensor.kind == kind) for kind in kinds]


def blamable(sensors: Sequence[Sensor]) -> tuple[Sensor, ...]:
    """Return the sensors that a finding can blame."""
    return tuple(sensor for sensor in sensors if sensor.part)


def sensor_of(sensors: Sequence[Sensor], part: str) -> Sensor:
    """Return the sensor that a finding with target `part` blames. Raises `LookupError` where there is none."""
    for sensor in sensors:
        if sensor.part == part:
            return sensor
    raise LookupError(f"no sensor reads {part!r}; the parts are {', '.join(s.part for s in blamable(sensors))}")
