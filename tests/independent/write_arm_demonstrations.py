"""Write the simulated arm that ships as ``data=demo_arm``: ``python -m tests.independent.write_arm_demonstrations``."""

import json
from pathlib import Path

import numpy as np

from calibench import discrepancy
from tests.independent.serial import MAKES
from tests.independent.serial_cases import case

SHIPPED = Path(discrepancy.__file__).resolve().parent / "demo" / "arm"
SETS = {
    "demo_play": {"seed": 20261122, "family": "play", "visible": 2.0},
    "demo_sound": {"seed": 20261123, "kind": "none"},
}
DIGITS = {"x": 4, "y": 4, "z": 4}


def texts() -> dict[str, str]:
    """Return file name -> text: the URDF, and two sets of sixty poses."""
    found = {"six.urdf": MAKES["six"].urdf() + "\n"}
    for name, asked in SETS.items():
        drawn = case(make="six", poses=60, sigma=0.02, **asked)
        stated = {"schema_version": 1, "machine": "arm", "urdf": "six", **drawn.stated}
        columns = {k: v for k, v in drawn.columns.items() if not k.startswith("direction_")}
        lines = [f"# measured_data: {json.dumps(stated)}", ",".join(map(_headed, columns))]
        lines += [",".join(_cell(k, v) for k, v in zip(columns, row)) for row in zip(*columns.values())]
        found[f"{name}.csv"] = "\n".join(lines) + "\n"
    return found


def _headed(name: str) -> str:
    if name in MAKES["six"].joints:
        return f"{name} [rad]"
    return f"{name} [mm]" if name in DIGITS else name


def _cell(name: str, value: object) -> str:
    return str(value) if isinstance(value, str | np.integer) else f"{value:.{DIGITS.get(name, 7)}f}"


if __name__ == "__main__":
    SHIPPED.mkdir(exist_ok=True)
    for name, text in texts().items():
        (SHIPPED / name).write_text(text)
