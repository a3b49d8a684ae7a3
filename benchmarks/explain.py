"""A hundred thousand readings explained, a fresh process each.

CPU time and largest memory of `explain` on one sealed file of 25 000 poses read four times, with a tracker's x, y; a
file counts as one evaluation. The memory stands beside the case's name.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys

import pandas as pd

from benchmarks.rounds import COLUMNS

_SEED, _POSES = 6, 25_000
_CASES = {
    "nothing missing": {"kind": "none", "noise": "gauss"},
    "compliance": {"kind": "one", "family": "compliance", "lam": 1.5, "noise": "gauss"},
    "compliance, heavy tails": {"kind": "one", "family": "compliance", "lam": 1.5, "noise": "t3"},
    "compliance, carried noise": {"kind": "one", "family": "compliance", "lam": 1.5, "noise": "ar1"},
    "two effects": {"kind": "two", "noise": "gauss"},
    "of no catalogue": {"kind": "outside", "noise": "gauss"},
}


def rows() -> pd.DataFrame:
    """Return the rows of each kind of case; `ratio` is to the one that misses nothing."""
    told = {name: _measured(wanted) for name, wanted in _CASES.items()}
    first, nan = next(iter(told.values()))[0], float("nan")
    lines = [
        ("explain, 100 000 readings", f"{name}, {gigabytes:.2f} GB", 1e9 * seconds, nan, nan, seconds / first, 1)
        for name, (seconds, gigabytes) in told.items()
    ]
    return pd.DataFrame(lines, columns=list(COLUMNS))


def _measured(wanted: dict[str, object]) -> tuple[float, float]:
    """Return CPU seconds and gigabytes, told by a process of its own with one thread."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.explain", json.dumps(wanted)],
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
    seconds, gigabytes = json.loads(done.stdout)
    return float(seconds), float(gigabytes)


def _explain(wanted: dict[str, object]) -> None:
    """Print what one case takes: of the CPU the explanation alone, of the memory the largest of the process."""

    from benchmarks.blind.gpm2002.simulate import case
    from calibench.discrepancy import MeasuredData, explain

    sealed = case(_SEED, xy=True, poses=_POSES, **wanted)  # type: ignore[arg-type]
    report = explain("gpm2002", MeasuredData(sealed.columns, "gpm2002", sealed.metadata, "many"))
    print(json.dumps([report.seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6]))


if __name__ == "__main__":
    _explain(json.loads(sys.argv[1]))
