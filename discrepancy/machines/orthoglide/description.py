"""What the Orthoglide declares for files, commands and pages: columns, words, what may be stated, plans, what ships."""

from functools import partial
from typing import get_args

import numpy as np

from calibench.discrepancy.machines.orthoglide.formulation import Orthoglide
from calibench.discrepancy.machines.orthoglide.kinematics import IMPERFECTIONS, printed
from calibench.discrepancy.model.machine import Description, Quantity, Stated
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.registries import describe
from calibench.problems.orthoglide.kinematics import AXES
from calibench.problems.orthoglide.plans import PlanName, SetName, named_plan


def planned(plan: PlanName, sigma: float = 0.01, repeats: int = 1) -> MeasuredData:
    """Return the deviations that a nominal machine shows on a named plan, without noise; `sigma` [mm] is stated."""
    rows = [(r, repeat) for repeat in range(repeats) for r in named_plan(plan)]
    called = {"posture": "axis", "pass": "approach"}
    set_up = ("leg", "direction", "posture", "gauge_position", "level_mm", "pass", "payload_N")
    columns = {key: np.array([getattr(r, called.get(key, key)) for r, _ in rows]) for key in set_up}
    columns |= {"repeat": np.array([float(repeat) for _, repeat in rows]), "deviation": np.zeros(len(rows))}
    empty = MeasuredData(columns, "orthoglide", {"machine": "orthoglide", "sigma": sigma}, plan)
    model = Model(Orthoglide().formulate(empty))
    q = model.quantities(np.zeros(model.size))[1]
    read = np.asarray(model.formulation.constraints(q)[:, 0], dtype=np.float64)
    return empty.with_columns({"deviation": np.round(read, 9)})  # a parallel leg reads 0, not rounding


_COLUMNS = (
    Quantity("leg", text=True),
    Quantity("direction", text=True),
    Quantity("posture", text=True),
    Quantity("level_mm", "mm"),
    Quantity("against_mm", "mm"),
    Quantity("pass", text=True),
    Quantity("zero_pass", text=True),
    Quantity("payload_N", "N", "payload"),
    Quantity("deviation", "mm", "the reading"),
    Quantity("t_s", "s", "time"),
    Quantity("zero_t_s", "s"),
    Quantity("temp_K", "K", "temperature above reference"),
    Quantity("zero_temp_K", "K"),
)
_ANGLES = ("tilt_", "gauge_roll", "gauge_pitch")
_QUANTITIES = (
    *(Quantity(f"drho_{axis}", "mm", f"joint offset of leg {axis}") for axis in AXES),
    *(Quantity(f"dL_{axis}", "mm", f"length of leg {axis}, above nominal") for axis in AXES),
    *(Quantity(name, "rad" if name.startswith(_ANGLES) else "mm") for name in IMPERFECTIONS),
    *(Quantity(f"move along {axis}", "mm") for axis in AXES),
    Quantity("payload", "N"),
    Quantity("time", "s"),
    Quantity("temperature", "K"),
)

describe(
    "orthoglide",
    Description(
        columns=_COLUMNS,
        quantities=_QUANTITIES,
        stated=(
            Stated("sigma", "positive"),
            Stated("free"),
            Stated("nominal", "names", 'nominal={"drho_x":0.1}'),
            Stated("gravity"),
            Stated("moving_weight_N"),
        ),
        plan=planned,
        printed={name: partial(printed, name) for name in get_args(SetName)},
        part_of=lambda target: target[-1],
        targets={word: f"{word} in the three axes" for word in ("common", "cyclic", "mirrored")},
        # its roles allow the scale of the gauge, which leaves nearly what `scale all` does: with both, blind cases
        # that have one name would have a set; its rates are those of its own list
        general=False,
    ),
)
