"""Write the simulated sets that ship as ``data=demo_...``: ``python -m tests.bench.write_demonstrations``.

The simulator shares no code with the catalogue. ``discrepancy/demo/README.md`` tells what is hidden, the files do not.
"""

from pathlib import Path

import numpy as np

from benchmarks.blind.gpm2002.simulate import case
from calibench import discrepancy
from calibench.bench.measured.files import write_measured
from calibench.discrepancy import MeasuredData

DEMO = Path(discrepancy.__file__).resolve().parent / "demo" / "gpm2002"
DIGITS = {
    "t_s": 2,
    "enc": 7,
    "x": 4,
    "y": 4,
    "vel": 5,
    "tau": 1,
    "axial": 3,
    "load": 2,
    "temp": 3,
    "speed": 2,
    "heading": 4,
}
SETS = {
    "demo_backlash.parquet": (23, {"family": "backlash", "target": "joint 2", "lam": 2.0}),
    "demo_twins.parquet": (20, {"family": "compliance", "target": "joint 1", "lam": 2.0}),
    "demo_unknown.parquet": (11, {"family": "magnet", "lam": 2.5}),
    "demo_nothing.csv": (27, {"kind": "none"}),
    "demo_warm.parquet": (7, {"family": "thermal_links", "lam": 1.5, "poses": 45, "xy": True}),
    "demo_warm_tracked.parquet": (7, {"family": "thermal_links", "lam": 1.5, "poses": 45, "xy": True}),
}
UNTRACKED = ("demo_warm.parquet",)  # the tracker's columns are taken away: one run, without them and with them


def main() -> None:
    """Write the sets; every number has the digits that an instrument would have given."""
    DEMO.mkdir(parents=True, exist_ok=True)
    for name, (seed, options) in SETS.items():
        made = case(seed, noise="gauss", **{"xy": False, **options})
        columns = {
            key: np.round(column, DIGITS.get(key) or DIGITS[key.split("_")[0]]) if column.dtype.kind == "f" else column
            for key, column in made.columns.items()
            if not (name in UNTRACKED and key in ("x", "y"))
        }
        stated = {key: v for key, v in made.metadata.items() if not (name in UNTRACKED and key == "sigma_xy")}
        path = write_measured(MeasuredData(columns, "gpm2002", stated), DEMO / name)
        print(f"{path}: {len(made.columns['t_s'])} readings, {path.stat().st_size} bytes, {made.truth['effects']}")


if __name__ == "__main__":
    main()
