"""A thousand command lines made from a grammar of words, right and wrong: none may end in a traceback, hang, or swell.

``python -m benchmarks.command_lines [COUNT] [SEED]``, by default 1000 and 40. Each line is a process of its own
(`forked.py` has its limits). What is against the rules is printed with its words, and all that was taken (exit 0 or 1),
so that one can judge whether that was right.
"""

from __future__ import annotations

import random
import shlex
import shutil
import sys
import tempfile
from collections import Counter
from pathlib import Path

from benchmarks import forked
from calibench.bench.store.runs import ResultStore

_DEMO = Path(__file__).resolve().parents[1] / "discrepancy" / "demo"

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
_RIGHT = {  # lines that are taken as they stand; `paper` takes minutes
    "run": "problem=./mine.py:Bowl optimizer=lm budget=20 seeds=2",
    "identify": "problem=sensor_zero",
    "discover": "machine=gpm2002 data=demo_nothing pages=none",
    "calibrate": "urdf=six.urdf data=demo_sound.csv page=false resamples=20",
    "design": "machine=gpm2002 plan=disc",
    "list": "problems",
    "status": "results/base",
    "collect": "results/base",
    "report": "results/base",
    "merge": "results/base results/other --to out",
    "compare": "results/base results/other",
    "choose": "results/base",
    "export": "csv results/base --to out4",
    "import": "ioh ioh --to out5",
    "show": "ID results=results/base",
}


def command_lines(count: int, seed: int) -> list[list[str]]:
    """Return so many command lines: about half are right but for a word or two, and half of the words of others."""
    rng = random.Random(seed)
    verbs = [*_VERBS, "run", "run", "run", "discover", "calibrate", "design"]
    chosen = [rng.choice(verbs) for _ in range(count)]
    return [(_nearly_right if verb in _RIGHT and rng.random() < 0.5 else _line)(rng, verb) for verb in chosen]


def _nearly_right(rng: random.Random, verb: str) -> list[str]:
    keys, flags, bare = _VERBS[verb]
    words = _RIGHT[verb].split()
    for _ in range(rng.choice([0, 1, 1, 2])):
        if keys:
            key = rng.choice(keys)
            words = [word for word in words if not word.startswith(f"{key}=")]
            words.append(f"{key}={rng.choice(_NAMES.get(key, _ODD) if rng.random() < 0.6 else _ODD)}")
        elif words:
            words[rng.randrange(len(words))] = rng.choice(bare or _ODD)
    return [verb, *words, *([rng.choice(flags)] if flags and rng.random() < 0.4 else [])]


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


def _prepare(home: Path) -> None:
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
    for name in ("arm/six.urdf", "arm/demo_sound.csv"):
        shutil.copy(_DEMO / name, home)
    for line in (
        "run -m problem=sensor_zero,link_length optimizer=lm,nlopt_LN_BOBYQA budget=300 seeds=2 study=base",
        "run -m problem=sensor_zero,link_length optimizer=lm,nlopt_LN_BOBYQA budget=300 seeds=2:4 study=other",
        "export ioh results/base --to ioh",
    ):
        if (made := forked.run(line.split(), home)).code:
            raise RuntimeError(made.said)


def main(arguments: list[str]) -> int:
    """Run the command lines and print what is against the rules, and what was taken."""
    count, seed = (int(word) for word in [*arguments, *["1000", "40"][len(arguments) :]])
    forked.load()
    home = Path(tempfile.mkdtemp())
    ended = []
    try:
        _prepare(home)
        run_id = ResultStore(home / "results/base").runs()["run_id"][0]
        for line in command_lines(count, seed):
            line = [run_id if word == "ID" else word for word in line]
            one, words = forked.run(line, home), shlex.join(line)
            ended.append(one)
            if one.code < 2:
                last = one.said.strip().rpartition("\n")[2][:160]
                print(f"taken ({one.code}): bench {words[:200]!a}\n    {last!a}", flush=True)
            for fault in one.faults():
                print(f"{fault}: bench {words[:300]!a}\n    {one.said[-300:]!a}", flush=True)
    finally:
        shutil.rmtree(home, ignore_errors=True)
    faults = Counter(fault for one in ended for fault in one.faults())
    print(f"{len(ended)} command lines, seed {seed}; exit codes {dict(Counter(one.code for one in ended))}")
    print(f"longest {max(one.cpu for one in ended):.1f} s, largest {max(one.memory for one in ended) / 1e6:.0f} MB")
    print(f"against the rules: {dict(faults) or 'none'}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
