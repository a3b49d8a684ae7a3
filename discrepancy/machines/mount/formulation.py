"""`Mount`: the measured columns are how far each star was from where the axes said it was.

The mount's terms predict them. Two components on the sky, in arcsec: along the circle of the first axis, weighted by
the cosine of the second (`dX`, `dS`), and along the second (`dDec`, `dEl`). The axes are inputs without noise of their
own. Seeing, centring and play together are the noise. Nobody states it, so `noise` estimates it from the data.

The noise of a night that nobody states, estimated from the residuals of the richest model of a mount.

That model has all terms of the field, and a slow change with time and with the place as far as the number of stars
allows. So it explains what any single effect could explain, and some more. Its residuals are noise, apart from errors
that no smooth model of a mount describes. An estimate from the residuals of the index errors alone would be ten times
as large, and would hide the terms that cause it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Literal, final

import numpy as np

from calibench.core.notes import Code
from calibench.core.words import counted, plain
from calibench.discrepancy.machines.mount.effects import own_effects
from calibench.discrepancy.machines.mount.geometry import ARCSEC, TURNS, Kind, Numbers, pointing, tangents
from calibench.discrepancy.machines.mount.validate import AXES, ERRORS, FRAME, NAMED, accepted
from calibench.discrepancy.model.effect import Effect
from calibench.discrepancy.model.formulations import Predicted
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData, Sensor, positive
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import Joint, Roles
from calibench.discrepancy.registries import machines
from calibench.problems.base import Array, Parameter
from calibench.problems.fitting import gauss_newton

INDEX: dict[Kind, tuple[str, str]] = {"equatorial": ("IH", "ID"), "altaz": ("IA", "IE")}
Base = Literal["index", "geometry"]
_WIDEST = 90 * 3600.0  # arcsec


@machines.register("mount")
@final
@dataclass(frozen=True)
class Mount:
    """A telescope mount. `base` is what is calibrated: the two index errors, or all six terms of the geometry."""

    base: Base = "geometry"
    name: str = field(default="mount", init=False)

    def formulate(self, data: MeasuredData) -> Predicted:
        """Return the prediction of the errors on the sky; raise `DataError` for data that no mount can give."""
        seen = accepted(data)
        free = INDEX[seen.kind] if self.base == "index" else tuple(TURNS[seen.kind])
        terms = (*TURNS[seen.kind], "TF", "TX")
        sigma = seen.data.metadata.get("sigma_arcsec")
        noise = 1.0 if sigma is None else positive(seen.data, "sigma_arcsec", sigma)

        def predicted(data: MeasuredData, noise: float) -> Predicted:
            return Predicted(
                data,
                partial(_predicted, seen.kind, seen.latitude),
                tuple(Parameter(name, "arcsec", 0.0, -_WIDEST, _WIDEST) for name in free),
                measured=dict.fromkeys(ERRORS[seen.kind], noise),
                inputs=(*AXES[seen.kind], *FRAME),
                held={name: 0.0 for name in terms if name not in free},
                unit="arcsec",
                instruments=tuple(Sensor(name, "star", "arcsec") for name in ERRORS[seen.kind]),
                roles=_roles(seen.kind, seen.data),
            )

        there = predicted(seen.data, noise)
        if sigma is not None:
            return there
        if len(seen.data) <= len(free):
            few = f"the noise is not stated: {counted(len(seen.data), 'star')} cannot tell it, and 1 arcsec is taken"
            return predicted(seen.data.with_note(Code.NOISE_UNSTATED, f"{few}; sigma_arcsec= states it"), noise)
        left = left_by_all(there, own_effects(there))
        text = (
            f"the noise is not stated: {plain(left, 3)} arcsec in each component is what all terms of the field "
            "together leave; sigma_arcsec= states it"
        )
        return predicted(seen.data.with_note(Code.NOISE_UNSTATED, text, sigma_arcsec=left), left)


def _predicted(kind: Kind, latitude: float, q: Quantities) -> Numbers:
    """Return the errors on the sky that the terms in `q` make, shape (n, 2), arcsec."""
    terms = {name: np.asarray(q[name]) for name in (*TURNS[kind], "TF", "TX")}
    roll, pitch = (np.asarray(q[name]) for name in AXES[kind])
    towards = pointing(kind, latitude, roll, pitch, terms)
    return np.stack([np.sum(axis * towards, axis=1) for axis in tangents(*(q[n] for n in FRAME))], axis=-1) / ARCSEC


def _roles(kind: Kind, data: MeasuredData) -> Roles:
    joints = tuple(
        Joint(f"{words} axis", name, "rotary", "rad", f"dir_{name}", told="arcsec")
        for name, words in zip(AXES[kind], NAMED[kind])
    )
    return Roles(joints=joints, time="t_s" if "t_s" in data else "", temperature="temp_K")


_SHARE = 0.35  # of the residuals that the richest model may spend on its numbers
_WILD = 5.0  # robust deviations beyond which a star was misidentified
_MEDIAN = 0.6744897501960817  # of the modulus of a standard Gaussian variable
_ALIKE = 1e-4  # relative size below which a direction of the terms is none: names of one signature


def left_by_all(formulation: Formulation, effects: Sequence[Effect]) -> float:
    """Return the standard deviation of an error on the sky, of either component, in a fit with all `effects` together.

    One value for both components, because one eye sees them; the field's rms on the sky is sqrt(2) times it. Held-out
    rows are not used.
    """
    data = formulation.data
    if data.has("split"):
        formulation = formulation.on(data.rows(np.asarray(data["split"]) != "hold"))
    base = Model(formulation)
    rich = base.with_effects(*effects)
    x = _fitted(base, base.start)
    columns = rich.jacobian(np.concatenate([x, np.zeros(rich.size - base.size)]))
    if rich.size <= _SHARE * columns.shape[0] * columns.shape[1]:
        x = _fitted(rich, np.concatenate([x, np.zeros(rich.size - base.size)]))
        columns = rich.jacobian(x)
        left = np.asarray(rich.residuals(x))
    else:
        left, columns = np.asarray(base.residuals(x)), base.jacobian(x)
    # a cubic of the order of the stars in each component, (n, m, 3m)
    n, m = len(formulation.data), len(formulation.readings)
    order = np.asarray(formulation.data["t_s"]) if formulation.data.has("t_s") else np.arange(n)
    t = 2 * (order - order.min()) / max(float(np.ptp(order)), 1e-300) - 1
    for more in (_each(np.stack([t, t**2, t**3], axis=1), m), _map(formulation)):
        wider = np.concatenate([columns, more], axis=2)
        if wider.shape[2] <= _SHARE * left.size:
            columns = wider
    flat = columns.reshape(left.size, -1)
    flat = flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
    rank = int(np.linalg.matrix_rank(flat, tol=_ALIKE * np.sqrt(flat.shape[1])))
    left = left - (flat @ np.linalg.lstsq(flat, left.ravel(), rcond=_ALIKE)[0]).reshape(left.shape)
    return float(np.sqrt(np.mean([_spread(left[:, k], rank / left.shape[1]) ** 2 for k in range(left.shape[1])])))


def _fitted(model: Model, x: Array) -> Array:
    return gauss_newton(
        lambda x: model.residuals(x).ravel(), lambda x: model.jacobian(x).reshape(-1, model.size), x,
        rank_tolerance=_ALIKE,
    )  # fmt: skip


def _map(formulation: Formulation) -> Array:
    """Return waves over the sky in each component, (n, m, k)."""
    first, second = (np.asarray(formulation.data[name]) for name in FRAME)
    waves = [
        f(k * first + j * second) for k in (0, 1, 2) for j in (-1, 0, 1) if (k, j) > (0, 0) for f in (np.sin, np.cos)
    ]
    return _each(np.stack(waves, axis=1), len(formulation.readings))


def _each(columns: Array, m: int) -> Array:
    return np.concatenate([np.eye(m)[k][None, :, None] * columns[:, None, :] for k in range(m)], axis=2)


def _spread(left: Array, spent: float) -> float:
    """Return the rms of residuals (n,) without wild ones, for a fit of `spent` numbers."""
    core = float(np.median(np.abs(left))) / _MEDIAN
    kept = left[np.abs(left) <= _WILD * max(core, 1e-12)]
    return float(np.sqrt(np.sum(kept**2) / max(len(kept) - spent, 1.0)))
