"""A thousand command lines made from a grammar of words, right and wrong: none may end in a traceback, hang, or swell.

``python -m benchmarks.command_lines [COUNT] [SEED]``, by default 1000 and 40. Each line is a process of its own, which
may take 20 s of processor time and 1 GB; it is ended at 25 s, at 60 s by the clock, or at 2 GB of data. What is against
the rules is printed with its words, and all that was taken (exit 0), so that one can judge whether that was right.
"""

from __future__ import annotations

import os
import random
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

SECONDS, BYTES = 20, 10**9  # of processor time and of data; a run that is right takes a second and .3 GB
_MINE = """
from pathlib import Path
from typing import Literal
import numpy as np

class Bowl:
    lower, upper, start = np.full(2, -1.0), np.full(2, 2.0), np.zeros(2)
    def __init__(self, tag: str = "x", data: Path = Path("x"), mode: Literal["a", "1.10"] = "a", count: int = 2,
                 scale: float = 1.0, names: dict[str, str] = None, flag: bool = False):
        self.scale = scale
    def __call__(self, x):
        return float(self.scale * x @ x)

class Angry(Bowl):
    def __call__(self, x):
        raise ValueError("\\x1b[31mno\\x07")
"""
_URDF = """<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/>
<child link="b"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/></joint></robot>"""
_ODD = [
    "", " ", "''", '""', "'", '"', "[", "]", "{", "}", "{}", "[]", "[[]]", "{a:b}", '{"a": "b c"}', "{a: 1.10}", ",",
    "1", "0", "-1", "1.5", "1e3", "1_000", "007", "0x10", "1e400", "-inf", "nan", 30 * "9", "1/2", "0/0", "3:1", "2:5",
    "a=b", "null", "None", "true", "yes", "~", "${oc.env:HOME}", "${x}", "$x", "*", "**", "?", "glob(*)",
    "glob(nlopt_LN_*)", ",,",
    "range(3)", "range(1,9,0)", "interval(0,1)", "choice(1,2)", "\N{GREEK SMALL LETTER DELTA}", "\N{PILE OF POO}",
    "\u202eabc", "a\x1b[31mb", "a\tb", "a\nb", 300 * "n", 5000 * "x", "..", "../x", "/", "/dev/null", "/proc/self/mem",
    "mine.py", "empty.csv", "binary.csv", "text.csv", "folder", "gone.csv", "secret.csv", "s3://x", "lab:1",
    "results/base",
    "os:system", "./mine.py:", "./mine.py:Nothing", "mine:Bowl", "json:loads", "./folder:Bowl", "--", "-",
    "--json", "@x",
]  # fmt: skip
_NAMES = {
    "problem": ["sensor_zero", "./mine.py:Bowl", "./mine.py:Angry", "mine:Bowl", "link_length", "delta9", "sensor_zer"],
    "optimizer": ["lm", "nlopt_LN_BOBYQA", "trf", "nlopt_LN_NELDERMEAD", "levenberg", "LM"],
    "machine": ["gpm2002", "arm", "orthoglide", "gpm"],
    "data": ["empty.csv", "binary.csv", "text.csv", "folder", "gone.csv", "secret.csv", "*.csv", "exp1"],
    "urdf": ["arm.urdf", "text.csv", "gone.urdf", "folder"],
    "study": ["s", "own.yaml", "gone.yaml", "ci", "bad.yaml"],
    "budget": ["20", "20,30", "ci", "paper", "2.5", "1e2"],
    "seeds": ["1", "0:2", "ci", "2:1"],
    "execution": ["serial", "thread"],
    "start": ["nominal", "random", "zero"],
    "level": ["auto", "zeros"],
    "hand_eye": ["eye_in_hand", "eye"],
    "convention": ["standard", "modified"],
    "by": ["goal", "value"],
    "plan": ["small", "exp1"],
}
_VERBS: dict[str, tuple[list[str], list[str], list[str]]] = {  # keys, flags, words without a key
    "run": (
        ["problem", "optimizer", "budget", "seeds", "start", "target", "time_limit", "study", "results", "execution",
         "shard", "stop_after", "replay", "problem.tag", "problem.data", "problem.mode", "problem.count",
         "problem.scale", "problem.names", "problem.flag", "problem.none", "optimizer.maxeval", "opt.lm.x",
         "prob.Bowl.tag", "tuner",
         "execution.n_jobs", "execution.inner", "n_jobs"],
        ["-m", "--dry-run", "--rerun", "--keep", "--json", "--retry-failed"], [],
    ),
    "identify": (["problem", "noise", "problem.n"], ["--json"], []),
    "discover": (["machine", "data", "columns", "units", "sigma_enc", "study", "results", "pages", "machine.free",
                  "execution", "data.x"], ["--json", "--retry"], []),
    "calibrate": (["urdf", "dh", "data", "convention", "machine.tip", "machine.observe", "columns", "units", "rotation",
                   "distance", "sigma_distance", "level", "resamples", "hand_eye", "read", "board_scale", "study"],
                  ["--json"], []),
    "design": (["machine", "data", "plan", "size", "rivals", "next", "plan.n", "machine.urdf", "plan.seed"],
               ["--json"], []),
    "list": ([], ["--json", "--all"], ["problems", "optimizers", "effects", "machines", "studies", "figures",
                                       "sensor_zero", "./mine.py:Bowl", "lm"]),
    "status": (["results"], ["--watch"], ["results/base", "results", "folder", "gone"]),
    "collect": ([], [], ["results/base", "folder", "gone", "text.csv"]),
    "report": ([], [], ["folder", "gone", "text.csv", "binary.csv"]),
    "merge": ([], ["--to", "--keep-first"], ["results/base", "results/base", "out", "folder", "gone"]),
    "compare": (["by"], ["--json", "--methods"], ["results/base", "results/base", "gone", "folder"]),
    "choose": (["optimizer", "by", "over"], ["--json"], ["results/base", "gone", "folder"]),
    "export": ([], ["--to"], ["csv", "coco", "ioh", "latex", "mlflow", "results/base", "out2", "gone"]),
    "import": ([], ["--to"], ["coco", "ioh", "folder", "out3", "gone"]),
    "show": (["results"], ["--json"], ["0", "abc", "results/base"]),
    "paper": (["budget", "seeds", "to"], ["--jsn"], ["x"]),
}  # fmt: skip


class Ended(NamedTuple):
    """How one command line ended."""

    words: list[str]
    code: int
    seconds: float
    megabytes: float
    told: str

    def faults(self) -> list[str]:
        """Return what is against the rules."""
        found = {
            "traceback": "Traceback (most recent call last)" in self.told,
            f"above {SECONDS} s": self.seconds > SECONDS,
            "above 1 GB": self.megabytes > BYTES / 1e6,
            f"exit code {self.code}": self.code not in (0, 1, 2),
            "a raw control character": any(ord(c) < 32 and c not in "\n\t\r" for c in self.told),
            "more than one line": self.code == 2 and self.told.count("\n") > 1 and "usage:" not in self.told,
        }
        return [name for name, is_so in found.items() if is_so]


def command_lines(count: int, seed: int) -> list[list[str]]:
    """Return so many command lines; about half of each line is right."""
    rng = random.Random(seed)
    verbs = [*_VERBS, "run", "run", "run", "discover", "calibrate", "design"]
    return [_line(rng, rng.choice(verbs)) for _ in range(count)]


def _line(rng: random.Random, verb: str) -> list[str]:
    keys, flags, bare = _VERBS[verb]
    words = []
    if keys and rng.random() < 0.8:  # what the verb cannot do without
        words += [f"{key}={rng.choice(_NAMES[key])}" for key in keys[:4] if key in _NAMES and rng.random() < 0.9]
    for _ in range(rng.choice([0, 1, 1, 2, 3])):
        if keys:
            key = rng.choice(keys)
            words.append(f"{key}={rng.choice(_NAMES.get(key, _ODD) if rng.random() < 0.4 else _ODD)}")
    words += [rng.choice(bare) for _ in range(rng.choice([1, 2, 2, 3]))] if bare else []
    words += [rng.choice(flags)] if flags and rng.random() < 0.4 else []
    if rng.random() < 0.25:
        words.append(rng.choice(_ODD))
    if words and rng.random() < 0.2:  # misspelt: a letter less, or two exchanged
        i = rng.randrange(len(words))
        k = rng.randrange(max(1, len(words[i]) - 1))
        word = words[i]
        words[i] = word[:k] + word[k + 1 :] if rng.random() < 0.5 else word[:k] + word[k : k + 2][::-1] + word[k + 2 :]
    if words and rng.random() < 0.1:
        words.append(rng.choice(words))  # twice
    if rng.random() < 0.3:
        rng.shuffle(words)
    name = verb if rng.random() < 0.97 else rng.choice([verb[:-1], verb.upper(), "", "--version", "help", "-h"])
    return [word.replace("\0", "") for word in [name, *words]]


def _prepare(home: Path, bench: list[str]) -> None:
    """Fill the folder of the command lines: files of all kinds, and a study."""
    (home / "mine.py").write_text(_MINE)
    (home / "arm.urdf").write_text(_URDF)
    (home / "empty.csv").write_text("")
    (home / "binary.csv").write_bytes(random.Random(1).randbytes(3000))
    (home / "text.csv").write_text("x,y\n1,2\n3,four\n")
    (home / "secret.csv").write_text("x\n1\n")
    (home / "secret.csv").chmod(0)
    (home / "folder").mkdir()
    (home / "own.yaml").write_text("budget: 20\nseeds: 1\nsweeps:\n  - [problem=./mine.py:Bowl, optimizer=lm]\n")
    (home / "bad.yaml").write_text("sweeps: [[[\n")
    words = ["run", "problem=sensor_zero", "optimizer=lm", "budget=300", "seeds=2", "study=base"]
    subprocess.run([*bench, *words], cwd=home, check=True, capture_output=True)


def _call(bench: list[str], words: list[str], home: Path) -> Ended:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS + 5, SECONDS + 5))
        resource.setrlimit(resource.RLIMIT_DATA, (2 * BYTES, 2 * BYTES))

    began = time.monotonic()
    told = home / "told.txt"
    with told.open("wb") as file:
        process = subprocess.Popen(
            [*bench, *words], cwd=home, stdin=subprocess.DEVNULL, stdout=file, stderr=file, preexec_fn=limit,
            start_new_session=True,
        )  # fmt: skip
        deadline = began + 3 * SECONDS
        while True:
            pid, status, used = os.wait4(process.pid, os.WNOHANG)
            if pid:
                break
            if time.monotonic() > deadline:
                os.killpg(process.pid, 9)
            time.sleep(0.02)
    code = os.waitstatus_to_exitcode(status)
    process.returncode = code
    return Ended(
        words, code, used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3, told.read_text(errors="backslashreplace")
    )


def main(arguments: list[str]) -> int:
    """Run the command lines and print what is against the rules, and what was taken."""
    count, seed = (int(word) for word in [*arguments, *["1000", "40"][len(arguments) :]])
    bench = [sys.executable, "-P", "-m", "calibench"]
    home = Path(tempfile.mkdtemp())
    try:
        _prepare(home, bench)
        ended = []
        for line in command_lines(count, seed):
            ended.append(_call(bench, line, home))
            if ended[-1].code == 0:
                lines = ended[-1].told.strip().splitlines()
                last = (lines[-1] if lines else "")[:160]
                print(f"taken: bench {shlex.join(line)[:200]!a}\n    {last!a}", flush=True)
            for fault in ended[-1].faults():
                print(f"{fault}: bench {shlex.join(line)[:300]!a}\n    {ended[-1].told[-300:]!a}", flush=True)
    finally:
        shutil.rmtree(home, ignore_errors=True)
    faults = Counter(fault for one in ended for fault in one.faults())
    print(f"{len(ended)} command lines, seed {seed}; exit codes {dict(Counter(one.code for one in ended))}")
    print(f"longest {max(one.seconds for one in ended):.1f} s, largest {max(one.megabytes for one in ended):.0f} MB")
    print(f"against the rules: {dict(faults) or 'none'}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
