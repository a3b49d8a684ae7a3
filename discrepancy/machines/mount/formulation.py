"""`Mount`: the measured columns are how far each star was from where the axes said it was.

The mount's terms predict them. Two components on the sky, in arcsec: along the circle of the first axis, weighted by
the cosine of the second (`dX`, `dS`), and along the second (`dDec`, `dEl`). The axes are inputs without noise of their
own. Seeing, centring and play together are the noise. Nobody states it, so `noise` estimates it from the data.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Literal, final

import numpy as np

from calibench.core.counted import counted, plain
from calibench.discrepancy.machines.mount.effects import own_effects
from calibench.discrepancy.machines.mount.geometry import ARCSEC, TURNS, Kind, Numbers, pointing, tangents
from calibench.discrepancy.machines.mount.noise import left_by_all
from calibench.discrepancy.machines.mount.validate import AXES, ERRORS, FRAME, NAMED, accepted
from calibench.discrepancy.model.formulations.predicted import Predicted
from calibench.discrepancy.model.machine import Quantities
from calibench.discrepancy.model.measured.data import UNSTATED, MeasuredData
from calibench.discrepancy.model.measured.sensor import Sensor
from calibench.discrepancy.model.measured.stated import positive
from calibench.discrepancy.model.roles import Joint, Roles
from calibench.discrepancy.registries import machines
from calibench.problems.base import Parameter

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
            few = f"{UNSTATED}: {counted(len(seen.data), 'star')} cannot tell it, and 1 arcsec is taken"
            return predicted(seen.data.with_note(f"{few}; sigma_arcsec= states it"), noise)
        left = left_by_all(there, own_effects(there))
        note = (
            f"{UNSTATED}: {plain(left, 3)} arcsec in each component is what all terms of the field together "
            "leave; sigma_arcsec= states it"
        )
        return predicted(seen.data.with_note(note), left)


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
