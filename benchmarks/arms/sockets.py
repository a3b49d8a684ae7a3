"""A Panda whose ball sits in two sockets at nine places: how near its points are, at places that no fit saw.

The authors' calibrated URDF was fitted to all nine places, so its figures are of places that it knew. Fair is their
method beside ours (`mukca` is theirs again), each fitted to eight places and asked about the ninth. Places weigh alike,
no posture is left out, a socket's point is the mean of the ball there. Intervals draw the nine places anew, the same
for both. (Franzese, Spahn, Kober, Della Santina: MUKCa; github.com/platonics-delft/kinematics_calibration.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np

from benchmarks.arms import mukca
from benchmarks.arms.mukca import DISTANCE
from calibench.bench.calibration.request import read_table
from calibench.calibration.choose import choose
from calibench.calibration.determined import order_of
from calibench.calibration.fit import Fit, fit_arm, norms, rms
from calibench.calibration.model import ArmModel, model_of
from calibench.calibration.readings import read_readings
from calibench.calibration.start import start_of
from calibench.calibration.urdf import read_urdf
from calibench.problems.arm.families import shipped
from calibench.problems.base import Array

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
    places, nominal, published = (
        mukca.places(folder / "panda_2"),
        shipped("panda.urdf"),
        folder / "panda_calibrated.urdf",
    )
    seen = list(places.values())
    others = [[pair for k, pair in enumerate(seen) if k != out] for out in range(len(seen))]
    all_theirs = _theirs(nominal, [mukca.fitted(nominal, seen)] * len(seen), seen)
    theirs = _theirs(nominal, [mukca.fitted(nominal, some) for some in others], seen)
    model = _model(nominal, folder)
    order = order_of(model.names, "geometry")
    fit = _written(model, order)
    ours = place_by_place(fit.model, [_written(model.at(model.place != p), order).p for p in np.unique(model.place)])
    lines = [
        _line(
            "the authors' URDF, fitted to all nine places",
            _theirs(published, [mukca.origins(published)] * len(seen), seen),
        ),
        _line("their method again, fitted to all nine places", all_theirs),
        _line("ours, fitted to all nine places", place_by_place(fit.model, [fit.p] * len(seen))),
        _line("their method, each place by a fit to the other eight", theirs),
        _line("ours, each place by a fit to the other eight", ours),
    ]
    for what in ("spread", "apart"):
        low, high = difference(getattr(theirs, what), getattr(ours, what))
        lines.append(f"  {what}, theirs less ours by the other eight: {low:+.3f} to {high:+.3f} mm (95 %)")
    return lines


def _theirs(urdf: Path, by_place: Sequence[mukca.Origins], seen: Sequence[tuple[Array, Array]]) -> Places:
    found = [mukca.left(urdf, at, pair) for at, pair in zip(by_place, seen, strict=True)]
    return Places(np.array([spread for spread, _ in found]), np.array([apart for _, apart in found]))


def place_by_place(model: ArmModel, by_place: Sequence[Array]) -> Places:
    """Return what each place has with the parameters that are given for it."""
    spread, apart = [], []
    for place, p in zip(np.unique(model.place), by_place, strict=True):
        part = model.at(model.place == place)
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
    start = start_of(read_readings(read_table(str(folder / "panda_2"), {}), chain), chain)
    return model_of(chain, start.readings, start.base, start.tool, distance=DISTANCE)


def _written(model: ArmModel, order: Sequence[int]) -> Fit:
    """Return what `bench calibrate` writes of lengths and angles, with the tolerance that these places choose."""
    fit = fit_arm(model, order)
    return choose({"geometry": fit}, ("geometry",), fit)[1]["geometry"]


def _line(name: str, found: Places) -> str:
    return f"| {name} | {rms(found.spread):.3f} | {rms(found.apart):.3f} |"
