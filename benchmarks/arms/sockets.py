"""A Panda whose ball sits in two sockets at nine places: how near its points are, at places that no fit saw.

The authors' calibrated URDF was fitted to all nine places, so its figures are of places that it knew. Fair are two
pairs: our fit to all nine beside theirs, and our fit to eight of the ninth beside what theirs has there, knowing it.
Places weigh alike, no posture is left out, a socket's point is the mean of the ball there. Intervals draw the nine
places anew, the same for both. (Franzese, Spahn, Kober, Della Santina: MUKCa;
github.com/platonics-delft/kinematics_calibration.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np

from calibench.bench.calibration.files import read_table
from calibench.bench.calibration.fit import fitted, fitted_from, norms, order_of
from calibench.bench.calibration.judged import rms
from calibench.bench.calibration.model import ArmModel, model_of
from calibench.bench.calibration.readings import read_readings
from calibench.bench.calibration.start import started
from calibench.problems.arm.chains.urdf import read_urdf
from calibench.problems.arm.measured import shipped
from calibench.problems.base import Array

DISTANCE = 50.0  # mm, of the two sockets of the tool
_TIP = "ball_link"
_DRAWS = 2000


@final
@dataclass(frozen=True, eq=False)
class Places:
    """Of each place the rms way [mm] of the ball from its mean point, and the error [mm] of the points' distance."""

    spread: Array
    apart: Array


def rows(folder: Path) -> Sequence[str]:
    """Return the lines of the table, and the intervals of the differences."""
    theirs = as_it_is(_model(folder / "panda_calibrated.urdf", folder))
    model = _model(shipped("panda.urdf"), folder)
    fit = fitted(model, order_of(model.names, "geometry"))
    every = place_by_place(fit.model, [fit.p] * len(np.unique(model.place)))
    order = order_of(model.names, "geometry")
    left_out = place_by_place(
        fit.model, [fitted_from(fit, order, model.place != place) for place in np.unique(model.place)]
    )
    lines = [
        _line("the authors' URDF, fitted to all nine places", theirs),
        _line("ours, fitted to all nine places", every),
        _line("ours, fitted to the other eight", left_out),
    ]
    for name, own in (("all nine", every), ("the other eight", left_out)):
        for what in ("spread", "apart"):
            low, high = difference(getattr(theirs, what), getattr(own, what))
            lines.append(f"  {what}, theirs less ours by {name}: {low:+.3f} to {high:+.3f} mm (95 %)")
    return lines


def as_it_is(model: ArmModel) -> Places:
    """Return what a URDF leaves as it is, its own ball and all."""
    return place_by_place(model, [model.start] * len(np.unique(model.place)))


def place_by_place(model: ArmModel, by_place: Sequence[Array]) -> Places:
    """Return what each place has with the parameters that are given for it."""
    spread, apart = [], []
    for place, p in zip(np.unique(model.place), by_place, strict=True):
        part = model.at(model.place == place).numbered()
        spread.append(rms(norms(part.errors(p))))
        apart.append(float(part.spans(p)[0]) - DISTANCE)
    return Places(np.array(spread), np.array(apart))


def difference(theirs: Array, ours: Array, seed: int = 0) -> tuple[float, float]:
    """Return the 95 % interval of how much larger their rms is, over the same places drawn anew."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, len(ours)]))
    drawn = rng.integers(len(ours), size=(_DRAWS, len(ours)))
    more = np.sqrt((theirs**2)[drawn].mean(axis=1)) - np.sqrt((ours**2)[drawn].mean(axis=1))
    low, high = np.quantile(more, [0.025, 0.975])
    return float(low), float(high)


def _model(urdf: Path, folder: Path) -> ArmModel:
    chain = read_urdf(urdf).chain("", _TIP)
    start = started(read_readings(read_table(str(folder / "panda_2"), {}), chain), chain)
    return model_of(chain, start.readings, start.base, start.tool, DISTANCE)


def _line(name: str, found: Places) -> str:
    return f"| {name} | {rms(found.spread):.3f} | {rms(found.apart):.3f} |"
