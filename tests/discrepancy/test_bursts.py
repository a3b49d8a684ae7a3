"""Of rows that stand out those are told that were misread, and none that a fit or carried noise bends beside them."""

from __future__ import annotations

import numpy as np
import pytest

from calibench.discrepancy import Instrument, Joint, MeasuredData, Predicted, Roles, explain
from calibench.problems.base import Parameter
from tests.independent import mount

pytestmark = pytest.mark.usefixtures("at_one_noise", "without_formula")


class CoreXY:
    name = "corexy"

    def formulate(self, data):
        def nozzle(q):
            x, y = (q["a"] + q["b"]) / 2 * q["sx"], (q["a"] - q["b"]) / 2 * q["sy"]
            x = x + q["skew"] * y
            return np.stack([q["x0"] + x - q["turn"] * y, q["y0"] + y + q["turn"] * x], axis=-1)

        free = [Parameter(name, "1", 1.0, 0.9, 1.1) for name in ("sx", "sy")]
        free += [Parameter(name, "rad", 0.0, -0.05, 0.05) for name in ("skew", "turn")]
        free += [Parameter(name, "mm", 0.0, -5.0, 5.0) for name in ("x0", "y0")]
        motors = tuple(Joint(f"motor {m}", m, "sliding", direction=f"dir_{m}", period=40.0) for m in "ab")
        roles = Roles(motors, time="t_s", temperature="temp_C", instruments=(Instrument("camera", ("x", "y")),))
        return Predicted(data, nozzle, tuple(free), {"x": 0.02, "y": 0.02}, inputs=("a", "b"), roles=roles)


def printed():
    rng = np.random.default_rng(553)
    x, y = rng.uniform(10, 280, (2, 120))
    a, b, t = x + y, x - y, 9.0 * np.arange(120)
    columns = {"a": a, "b": b, "dir_a": np.sign(np.diff(a, prepend=0)), "dir_b": np.sign(np.diff(b, prepend=0))}
    seen_x, seen_y = 1.001 * x + 0.002 * y + 0.4, 0.9985 * y - 0.3
    columns |= {"x": seen_x - 0.003 * seen_y, "y": seen_y + 0.003 * seen_x, "t_s": t}
    columns |= {"temp_C": 22 + 10 * (1 - np.exp(-t / 400))}
    columns |= {name: columns[name] + 0.02 * rng.standard_normal(120) for name in "xy"}
    columns["x"][40:44] += 0.8
    return CoreXY(), MeasuredData(columns, "corexy")


def watched():
    night = mount.case(0, only="", altaz=False, base=46000)
    stars = {name: night.columns[name].copy() for name in ("star_ha", "star_dec")}
    for star in stars.values():
        star[30:34] += np.radians(0.3)
    return "mount", MeasuredData(night.columns | stars, "mount", night.stated)


@pytest.mark.parametrize(("told", "rows"), [(printed, "41 to 44"), (watched, "31 to 34")], ids=["corexy", "mount"])
def test_rows_beside_a_burst_are_not_blamed_with_it(told, rows):
    [note] = [note for note in explain(*told()).notes if "stand out" in note.text]
    assert note.text.startswith(f"rows {rows} stand out"), note.text
