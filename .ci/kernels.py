"""Compile the kernels of usual first steps for the wheel, by the package that is installed: kernels.py TO [DATA].

Each level of x86-64 that this processor has is compiled in a process of its own, with a cache of its own, in one order;
so the same bytes come of it again. Another processor has no level, and the wheel comes without kernels.
"""

import itertools
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from numba.core.ir import Loc
from numba.np.ufunc import array_exprs

from calibench import optimizers, problems
from calibench.bench.cli import main
from calibench.bench.execution.kernels import load_kernels
from calibench.bench.execution.run import Spec
from calibench.core.compilation.compiled import cache_folder
from calibench.core.compilation.shipped import LEVELS, level, pack
from calibench.core.sources import module_digest

PROBLEMS = ("sensor_zero", "tracking_zero", "orthoglide6", "arm_ur10")  # one of each module; they stand for its others
METHODS = ("de", "ga", "pso", "nine_point", "lm")
COMMANDS = (
    "discover machine=gpm2002 data=demo_backlash",
    "discover machine=arm data=demo_play",
    "discover machine=orthoglide data=exp1",
    "calibrate urdf={arms}/ur10.urdf data={arms}/ur10_b.csv",
)


def levels(to: Path) -> None:
    names = list(LEVELS)
    for name in names[names.index(highest) :] if (highest := level()) else ():
        with TemporaryDirectory() as folder:
            told = {"NUMBA_CPU_NAME": name, "NUMBA_CPU_FEATURES": LEVELS[name][1], "PYTHONHASHSEED": "0"}
            env = os.environ | told | {"HOME": folder, "XDG_CACHE_HOME": folder}
            subprocess.run([sys.executable, __file__, name, to], cwd=folder, env=env, check=True)


def compile_for(name: str, to: Path) -> None:
    without_this_machine()
    for problem, method in itertools.product(PROBLEMS, METHODS):
        load_kernels([Spec(problem, {}, method, {}, 10, 0)], fork=False)
    arms = Path(problems.__file__).parent / "data" / "arms"
    for command in COMMANDS:
        try:
            main(command.format(arms=arms).split())
        except SystemExit as ended:
            if ended.code:
                raise
    factories = [*map(problems.registry.factory, PROBLEMS), *map(optimizers.registry.factory, METHODS)]
    pack(cache_folder(), name, [*{module_digest(str(factory.__module__)) for factory in factories}], to)


def without_this_machine() -> None:
    """Let numba write no place of this process or disk into the code."""
    numbers, make = itertools.count(), Loc.__init__
    array_exprs.hash = lambda _expression: next(numbers)  # it names these functions by where they lie in memory

    def relative(self, filename, line, *more, **named):  # which an error tells
        make(self, filename.rpartition("/site-packages/")[2], line, *more, **named)

    Loc.__init__ = relative


if __name__ == "__main__":
    levels(Path(sys.argv[1]).resolve()) if len(sys.argv) == 2 else compile_for(sys.argv[1], Path(sys.argv[2]))
