"""From the shell to the answer.

CPU time of whole processes, bytecode and compiled code in the cache.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile

import pandas as pd

from benchmarks.rounds import Contestant, interleave

_LIST = ("list", "problems")
_RUN = ("run", "problem=sensor_zero", "optimizer=de", "budget=300", "seeds=1")
_LIBRARIES = "import numba; numba.njit; import pyarrow.parquet"
_RUN_LM = ("run", "problem=sensor_zero", "optimizer=lm", "budget=100", "seeds=1")


def rows() -> pd.DataFrame:
    """Return the rows of an empty interpreter, `bench list`, and `bench run` of a tiny cell."""
    return interleave(
        "a process, warm",
        {
            "python -c pass": _process("-c", "pass"),
            "python -c 'import numba'": _process("-c", "import numba"),
            "python -c, import numba.njit, pyarrow.parquet": _process("-c", _LIBRARIES),
            "python -c, these and scipy.optimize": _process("-c", f"{_LIBRARIES}, scipy.optimize"),
            "bench list problems": _process("-m", "bench", *_LIST),
            "bench run, a tiny cell": _process("-m", "bench", *_RUN),
            "bench run, a tiny cell of lm": _process("-m", "bench", *_RUN_LM),
        },
        rounds=5,
        clock=_cpu_of_children,
    )


def _process(*arguments: str) -> Contestant:
    def work() -> int:
        with tempfile.TemporaryDirectory() as folder:
            results = [f"results={folder}"] if "run" in arguments else []
            subprocess.run([sys.executable, *arguments, *results], check=True, capture_output=True, env=_warm())
        return 1

    return work


def _warm() -> dict[str, str]:
    """Return an environment in which Python keeps the bytecode of our modules, as it does unless it is told not to."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def _cpu_of_children() -> int:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return round((used.ru_utime + used.ru_stime) * 1e9)
