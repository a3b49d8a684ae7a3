"""A six-axis arm as its owner would declare it: the maker's table, what is fitted, what is held, and roles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibench.discrepancy import Instrument, Joint, Length, MeasuredData, Predicted, Roles
from calibench.discrepancy.model.machine import Numbers, Quantities
from calibench.problems.base import Parameter

AXES = "SLURBT"
TABLE = {  # offset d [mm], length a [mm], twist al [rad] of each axis; skew b of the two parallel ones is 0
    "S": (127.3, 0.0, np.pi / 2), "L": (0.0, -612.0, 0.0), "U": (0.0, -572.3, 0.0),
    "R": (163.941, 0.0, np.pi / 2), "B": (115.7, 0.0, -np.pi / 2), "T": (92.2, 0.0, 0.0),
}  # fmt: skip
FOOT = {"fx": 2400.0, "fy": -600.0, "fz": 350.0, "fa": 0.4, "fb": -0.3, "fc": 1.1}
TOOL = {"tx": 60.0, "ty": 25.0, "tz": 140.0}
START = FOOT | TOOL | {f"{p}_{j}": v for j, row in TABLE.items() for p, v in zip(("d", "a", "al"), row)}
START |= {f"z_{j}": 0.0 for j in AXES} | {"b_L": 0.0, "b_U": 0.0}
HELD = ("d_S", "z_S", "d_L", "d_U", "d_T", "a_T", "al_T", "z_T")  # foot, tool and parallel axes have them already


def _free(name: str) -> Parameter:
    mm = (name[0] in "da" and name[:2] != "al") or name in ("fx", "fy", "fz", *TOOL)
    wide = 20.0 if mm else 0.1
    return Parameter(name, "mm" if mm else "rad", START[name], START[name] - wide, START[name] + wide)


def _turned(u: Numbers, v: Numbers, angle: Numbers) -> tuple[Numbers, Numbers]:
    c, s = np.cos(angle), np.sin(angle)
    return c * u - s * v, s * u + c * v


def reflector(q: Quantities) -> Numbers:
    """Return where the tracker sees the reflector, (n, 3) [mm]: from the tool down to the foot."""
    x, y, z = q["tx"], q["ty"], q["tz"]
    for j in reversed(AXES):
        if f"b_{j}" in q:
            z, x = _turned(z, x, q[f"b_{j}"])
        y, z = _turned(y, z, q[f"al_{j}"])
        x, y = _turned(x + q[f"a_{j}"], y, q[j] + q[f"z_{j}"])
        z = z + q[f"d_{j}"]
    y, z = _turned(y, z, q["fa"])
    z, x = _turned(z, x, q["fb"])
    x, y = _turned(x, y, q["fc"])
    return np.stack([x + q["fx"], y + q["fy"], z + q["fz"]], axis=-1)


@dataclass(frozen=True)
class SixAxisArm:
    """The arm, its tracker's noise `sigma` [mm] and the `teeth` of its gears."""

    sigma: float = 0.02
    teeth: int = 0
    name: str = "six-axis arm"

    def formulate(self, data: MeasuredData) -> Predicted:
        """Return what the tracker should see of this arm."""
        joints = tuple(
            Joint(f"axis {j}", j, direction=f"from_{j}", velocity=f"pace_{j}", torque=f"Nm_{j}", teeth=self.teeth)
            for j in AXES
        )
        lengths = (Length("upper arm", "a_L"), Length("forearm", "a_U"))
        tracker = Instrument("tracker", ("leica_x", "leica_y", "leica_z"))
        roles = Roles(joints, lengths, time="clock_s", temperature="hall_K", instruments=(tracker,))
        return Predicted(
            data, reflector, tuple(_free(n) for n in START if n not in HELD),
            measured=dict.fromkeys(tracker.columns, self.sigma), inputs=tuple(AXES),
            held={n: START[n] for n in HELD}, roles=roles,
        )  # fmt: skip
