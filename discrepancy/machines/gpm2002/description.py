"""What the GPM2002 declares for files, commands and pages: columns, words, what may be stated, plans, what ships."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibench.discrepancy.machines.gpm2002.plan import planned, reachable
from calibench.discrepancy.model.description import Completed, Description, Quantity, Stated
from calibench.discrepancy.model.machine import WORKSPACE, Formulation
from calibench.discrepancy.model.measured.data import MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.registries import describe

_LEGS = (1, 2, 3)
_SIGMA_XY = 0.02  # mm: a usual tracker
_COLUMNS = (
    *(Quantity(f"enc_{i}", "rad", f"angle of joint {i}") for i in _LEGS),
    *(Quantity(f"vel_{i}", "rad/s", f"velocity of joint {i}", f"leg {i}") for i in _LEGS),
    *(Quantity(f"dir_{i}", "", f"direction of joint {i}", f"leg {i}") for i in _LEGS),
    *(Quantity(f"tau_{i}", "N mm", f"torque of joint {i}", f"leg {i}") for i in _LEGS),
    *(Quantity(f"axial_{i}", "N", f"axial force of joint {i}", f"leg {i}") for i in _LEGS),
    Quantity("t_s", "s", "time"),
    Quantity("x", "mm"),
    Quantity("y", "mm"),
    Quantity("load_x", "N", "load along x"),
    Quantity("load_y", "N", "load along y"),
    Quantity("temp_K", "K", "temperature above reference"),
    Quantity("speed", "mm/s"),
    Quantity("heading", "rad"),
    Quantity("pose_id"),
    Quantity("visit_id"),
    Quantity("repeat"),
    Quantity("split", text=True),
)
_PARAMETERS = (
    *(Quantity(f"la{i}", "mm", f"proximal link {i}") for i in _LEGS),
    *(Quantity(f"lb{i}", "mm", f"distal link {i}") for i in _LEGS),
    *(Quantity(f"xa{i}", "mm", f"x of base {i}") for i in _LEGS),
    *(Quantity(f"ya{i}", "mm", f"y of base {i}") for i in _LEGS),
    *(Quantity(f"z{i}", "rad", f"encoder zero of joint {i}") for i in _LEGS),
)


def with_tracker(formulation: Formulation, data: MeasuredData, parameters: Mapping[str, float]) -> Completed | None:
    """Return the data as an external tracker in the same run would complete them; None where there is one."""
    if data.has("x", "y"):
        return None
    there = formulation.on(data)
    q, _ = Model(there).quantities(np.array([parameters[p.name] for p in there.parameters]))
    place = there.covariates(q)[WORKSPACE]
    x, y = (np.real(np.asarray(place[name], dtype=complex)) for name in ("x", "y"))
    nominal = {**dict(data.metadata.get("nominal", {})), **parameters}
    tracked = replace(
        data.with_columns({"x": x, "y": y}), metadata={**data.metadata, "sigma_xy": _SIGMA_XY, "nominal": nominal}
    )
    return Completed(tracked, f"an external tracker in the same run (x, y to {_SIGMA_XY:g} mm)")


describe(
    "gpm2002",
    Description(
        columns=_COLUMNS,
        quantities=_PARAMETERS,
        stated=(
            Stated("sigma_enc", "positive"),
            Stated("sigma_xy", "positive"),
            Stated("encoder_lsb", "positive"),
            Stated("tooth_numbers", "list", "tooth_numbers=[40,48,56]"),
            Stated("fixed_parameters"),
            Stated("nominal", "names", 'nominal={"la1":244}'),
        ),
        helpful=("x", "y"),
        plan=planned,
        pool=reachable,
        completed=with_tracker,
        demonstrations=Path(__file__).resolve().parents[2] / "demo" / "gpm2002",
        targets={"tracker": ""},
        general=False,  # its list is the one whose rates stand in docs/discovery-statistics.md
    ),
)
