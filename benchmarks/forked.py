"""`bench` as a user calls it, a process each, at a fraction of the cost: forked from one that has its imports done.

A command that imports for itself takes over a second; a fork takes hundredths of one, and a thousand commands take
minutes. What it changes in its process ends with it, as that of any command does.
"""

from __future__ import annotations

import importlib
import os
import resource
import signal
import sys
import traceback
from pathlib import Path
from time import monotonic, sleep
from typing import NamedTuple

SECONDS, BYTES = 20, 10**9  # of processor time and of memory that any command may take
_MODULES = (  # what the verbs import as they are called
    "cli", "measured.files", "discovery.batch", "discovery.page.page", "calibration.request", "commands.list",
    "commands.discover", "sweep.carry_out", "commands.calibrate",
    "commands.run", "commands.exchange", "exchange.ioh",
)  # fmt: skip


class Ended(NamedTuple):
    """How a command ended."""

    code: int
    cpu: float
    memory: float
    said: str

    def faults(self) -> list[str]:
        """Return what is against the rules that hold for any command."""
        refused, lines = self.code == 2, [line for line in self.said.splitlines() if line.strip()]
        found = {
            "traceback": "Traceback (most recent call last)" in self.said,
            f"exit code {self.code}": self.code not in (0, 1, 2),
            f"above {SECONDS} s": self.cpu > SECONDS,
            "above 1 GB": self.memory > BYTES,
            "more than one line": refused and len(lines) != 1 and "usage:" not in self.said,
            "no end of a line": refused and len(self.said) > 3000 and "usage:" not in self.said,
            "a raw control character": any(ord(letter) < 32 and letter not in "\n\t\r" for letter in self.said),
        }
        return [name for name, is_so in found.items() if is_so]


def load() -> None:
    """Import what the commands import."""
    os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
    for module in _MODULES:
        importlib.import_module(f"calibench.bench.{module}")


def run(words: list[str], home: Path) -> Ended:
    """Return how ``bench WORDS`` ended in the folder `home`; its processes are ended after eight times its time."""
    began, pid = monotonic(), os.fork()
    if pid == 0:
        _command(words, home)
    while True:
        done, status, used = os.wait4(pid, os.WNOHANG)
        if done:
            break
        if monotonic() - began > 8 * SECONDS:  # the machine may be busy; one that sleeps uses no processor time
            os.killpg(pid, signal.SIGKILL)
        sleep(0.01)
    code, took = os.waitstatus_to_exitcode(status), monotonic() - began
    said = (home / "said").read_text(encoding="utf-8", errors="backslashreplace")
    cpu = used.ru_utime + used.ru_stime
    return Ended(code, max(cpu, took) if code == -signal.SIGKILL else cpu, 1024 * used.ru_maxrss, said)


def _command(words: list[str], home: Path) -> None:
    code = 1
    try:
        os.setsid()
        os.chdir(home)
        for number, name, how in ((0, os.devnull, os.O_RDONLY), (1, "said", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)):
            os.dup2(os.open(name, how), number)
        os.dup2(1, 2)
        sys.stdin, sys.stdout, sys.stderr = (
            os.fdopen(number, how, encoding="utf-8", errors=errors)
            for number, how, errors in ((0, "r", "strict"), (1, "w", "strict"), (2, "w", "backslashreplace"))
        )
        resource.setrlimit(resource.RLIMIT_CPU, (2 * SECONDS, 2 * SECONDS))
        resource.setrlimit(resource.RLIMIT_DATA, (4 * BYTES, 4 * BYTES))
        sys.argv = ["bench", *words]
        importlib.import_module("calibench.bench.cli").main(words)
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
