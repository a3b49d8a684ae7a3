"""``bench VERB --help``: the usage of one verb, and its KEY=VALUE words in a line each, with what they mean.

The words are as `bench.verbs` declares them; nothing heavy is imported, so that the answer comes at once.
"""

import re

from calibench.bench import verbs
from calibench.bench.words import help_of

_FLAG = {"--json": "print JSON, for programs"}
_ARM = {word: meaning for word, meaning in help_of(verbs.PosesWords).items() if re.match(r"machine\.(?!observe)", word)}
_WORDS: dict[str, dict[str, dict[str, str]]] = {
    "calibrate": {
        "an arm": {**help_of(verbs.CalibrateWords), **_FLAG}, "a camera": {**help_of(verbs.HandEyeWords), **_FLAG},
    },
    "discover": {
        "every machine": {**help_of(verbs.DiscoverWords), **_FLAG, "--retry": "do failed searches again"},
        "machine=arm": {
            **_ARM, "sigma_mm=V": "noise of a read place [mm]", "sigma_mrad=V": "noise of a read rotation [mrad]",
            "rotation=rpy|xyz|vector": "how three angles make a rotation",
            "teeth=N": "how often an error of the gears repeats in a turn",
            "gravity=[0,0,-9.81]": "gravity in the arm's base [m/s^2]",
            "payload_kg=V": "payload of all rows, where no column has it [kg]",
            "socket_distance_mm=V": "how far the two sockets of a place are apart [mm]",
        },
    },
    "design": {
        "every machine": {**help_of(verbs.DesignWords), **_FLAG},
        "machine=arm plan.n=N: which poses to measure": help_of(verbs.PosesWords),
    },
    **{
        verb: {"words": {**help_of(words), **flags}}
        for verb, words, flags in (
            ("identify", verbs.IdentifyWords, _FLAG), ("paper", verbs.PaperWords, {}),
            ("choose", verbs.ChooseWords, _FLAG),
            ("compare", verbs.CompareWords, _FLAG | {"--methods M1 M2": "two methods, of one study or of two"}),
            ("show", verbs.TrackingWords, _FLAG), ("note", verbs.TrackingWords, {}), ("tag", verbs.TrackingWords, {}),
            ("archive", verbs.TrackingWords, {"--undo": "take it back"}),
            ("delete", verbs.TrackingWords, {"--yes": "do not ask"}),
            ("sql", verbs.TrackingWords, _FLAG), ("pack", verbs.TrackingWords, {"--to FILE": "where (STUDY.zip)"}),
            ("ui", verbs.UiWords, {"--write": "let notes and tags be written"}),
            ("unpack", verbs.TrackingWords, {"--trust": "its pages too, which a browser runs"}),
        )
    },
    "studies": {
        "words": {
            "COLUMN=VALUE, COLUMN!=VALUE": "keep those that match (do not); globs and a,b are read",
            "since=, until=": "a day (2026-11-01), a time, or how long ago (7d, 12h, 2w)",
            "archived=*": "archived ones too", "--all": "every line, where there are many", **_FLAG,
        },
    },
    "doctor": {"words": _FLAG},
    "history": {
        "words": {
            **help_of(verbs.HistoryWords), **_FLAG, "--check": "end with 1 where the newest is worse than the tagged",
        },
    },
    "run": {
        "every sweep": {
            "problem=NAME": "`bench list problems` has them with their options",
            "problem.OPTION=V": "an option of every problem; prob.NAME.OPTION=V of one",
            "optimizer=NAME": "`bench list optimizers` has them with their options",
            "optimizer.OPTION=V": "an option of every optimiser; opt.NAME.OPTION=V of one",
            "budget=N|ci|paper": "evaluations of a run (ci)", "seeds=N|A:B|ci|paper": "repetitions (ci)",
            "start=nominal|random": "where a run begins", "target=V": "a value that ends a run",
            "time_limit=S": "seconds that end a run", "shard=I/N": "of all runs the I-th of N parts",
            "stop_after=K": "failed runs after which no other is begun",
            "replay=true|false": "keep the values of a run as it goes, so that a killed one goes on",
            "execution=serial|processes|dask": "how runs are shared out (serial)",
            "execution.n_jobs=N": "how many processes", "execution.inner=N": "processes for the batches of one run",
            "execution.address=tcp://HOST:PORT": "of a Dask cluster", "study=NAME": "the folder inside results=",
            "results=DIR": "where results go (results)",
            "-m": "sweep: lists such as problem=full11,full12 are a run each",
            "--dry-run": "tell what would be done; with --all of every cell",
            "--retry-failed": "do runs that failed or ran out of time again",
            "--drop-planned": "abandon what was planned before and is not asked for now",
            "--rerun, --keep": "finished runs that other code made: again, or as they are",
        },
        "problem=arm": {
            "problem.urdf=FILE": "the arm's URDF",
            "problem.dh=TABLE": "its table of Denavit and Hartenberg, CSV or Excel, in place of a URDF",
            "problem.convention=standard|modified": "the convention of that table; modified is Craig's",
            "problem.data=FILE": "joints and readings",
        },
        "tuner=optuna": help_of(verbs.TunerWords),
    },
}  # fmt: skip
_WIDE = 42  # letters of a word that leave room for its meaning in the same line


def help_of_verb(verb: str, usage: str) -> str:
    """Return the help of one `verb`: its part of the `usage` of all, and what its words mean."""
    # the entries of `usage`, each with the lines that go on with it, that begin with the verb
    entries = re.findall(r"^  \S.*\n(?:^ {3,}.*\n)*", usage, re.MULTILINE)
    mine = [entry.strip() for entry in entries if verb in entry.split()[0].split("|")]
    lines = ["usage: bench " + re.sub(r"^(.*?\S) {3,}", r"\1\n      ", entry) for entry in mine]
    for what, words in _WORDS.get(verb, {}).items():
        lines += ["", f"{what}:"]
        for word, meaning in words.items():
            short = len(word) <= _WIDE
            lines += [f"  {word:{_WIDE}} {meaning}"] if short else [f"  {word}", f"  {'':{_WIDE}} {meaning}"]
    return "\n".join([*lines, "", "`bench --help` has all verbs"]) + "\n"
