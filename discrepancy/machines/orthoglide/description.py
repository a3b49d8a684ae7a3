"""What the Orthoglide declares for files, commands and pages: columns, words, what may be stated, plans, what ships."""

from __future__ import annotations

from functools import partial

from calibench.discrepancy.machines.orthoglide.kinematics import IMPERFECTIONS
from calibench.discrepancy.machines.orthoglide.plan import planned
from calibench.discrepancy.machines.orthoglide.printed import names, printed
from calibench.discrepancy.model.description import Description, Quantity, Stated
from calibench.discrepancy.registries import describe
from calibench.problems.orthoglide.kinematics import AXES

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
        printed={name: partial(printed, name) for name in names()},
        part_of=lambda target: target[-1],
        targets={word: f"{word} in the three axes" for word in ("common", "cyclic", "mirrored")},
        # its roles allow the scale of the gauge, which leaves nearly what `scale all` does: with both, blind cases
        # that have one name would have a set; its rates are those of its own list
        general=False,
    ),
)
