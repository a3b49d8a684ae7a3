"""``bench VERB --help``: the usage of one verb, and its KEY=VALUE words in a line each, with what they mean.

Nothing is imported for it, so that the answer comes at once; a test compares the words with those that the verb reads.
"""

from __future__ import annotations

import re

_ARM = {
    "machine.dh=TABLE": "the arm's table of Denavit and Hartenberg, CSV or Excel, in place of a URDF",
    "machine.convention=standard|modified": "the convention of that table; modified is Craig's",
    "machine.urdf=FILE": "the arm's URDF",
    "machine.base=LINK": "the link of the URDF where the arm begins",
    "machine.tip=LINK": "the link of the URDF where the arm ends, such as tool0",
}
_COLUMNS = {
    'columns=\'{"x":"Weg X"}\'': "which column of the file is which, where the names are others",
    "units=x:m,y:m": "the unit of columns",
    "rotation=rpy|xyz|vector": "how three angles make a rotation; found where it is not stated",
}
_PLACE = {"study=NAME": "the folder inside results=", "results=DIR": "where results go (results)"}
_FLAG = {"--json": "print JSON, for programs"}
_WORDS: dict[str, dict[str, dict[str, str]]] = {
    "calibrate": {
        "an arm": {
            "urdf=FILE": "the arm's URDF",
            "dh=TABLE": "its table of Denavit and Hartenberg, CSV or Excel, in place of a URDF",
            "convention=standard|modified": "the convention of that table; modified is Craig's",
            "data=FILE|GLOB|FOLDER": "joints and readings, a row a pose; or a folder of sockets",
            **_ARM,
            "machine.dh=TABLE": "the same as dh=",
            "machine.convention=standard|modified": "the same as convention=",
            "machine.urdf=FILE": "the same as urdf=",
            "machine=arm": "may be left out",
            "machine.observe=position|pose|sockets": "what was read; found from the columns where it is not stated",
            **_COLUMNS,
            "distance=MM": "sockets: how far the two of a place are apart",
            "sigma_distance=MM": "sockets: how well that distance is known",
            "level=auto|frames|zeros|geometry|gains": "how much of the arm is calibrated (auto)",
            "limits=true|false": "whether joints must stand inside the limits of the description (true)",
            "resamples=N": "draws for the intervals (200)",
            "page=true|false": "whether report.html is written (true)",
            **_PLACE,
            **_FLAG,
        },
        "a camera": {
            "hand_eye=eye_in_hand|eye_to_hand": "where the camera is: on the hand, or beside the robot",
            "data=FILE": "poses of flange and board, a row a pair",
            "read=board_in_camera|camera_in_board": "what the camera's columns hold",
            "flange=flange_in_base|base_in_flange": "what the robot's columns hold (flange_in_base)",
            "rotation=rpy|xyz|vector": "how three angles make a rotation; found where it is not stated",
            'columns=\'{"flange_x":"Weg X"}\'': "which column of the file is which",
            "units=flange_x:m": "the unit of columns",
            "board_scale=RATIO": "true size of the board by the size that the camera was told (1)",
            "sigma=MM": "noise of the board's place; learned where it is not stated",
            "sigma_rotation=RAD": "noise of its rotation; learned where it is not stated",
            **_PLACE,
            **_FLAG,
        },
    },
    "discover": {
        "every machine": {
            "machine=NAME": "the machine; `bench list machines` has them with their options",
            "machine.OPTION=V": "an option of the machine",
            "data=FILE|GLOB|FOLDER|NAME": "the readings",
            "data.KEY=V": "what your own machine reads of its data, where no file states it",
            'columns=\'{"x":"Weg X"}\'': "which column of the file is which, where the names are others",
            "units=x:m,y:m": "the unit of columns",
            "pages=auto|all|none": "of which sets of data a page is written (auto)",
            "execution=serial|processes": "one process, or some (serial)",
            "execution.n_jobs=N": "how many processes; -1: as many as the computer has cores",
            **_PLACE,
            **_FLAG,
            "--retry": "do failed searches again",
        },
        "machine=arm": {
            **_ARM,
            "sigma_mm=V": "noise of a read place [mm]",
            "sigma_mrad=V": "noise of a read rotation [mrad]",
            "rotation=rpy|xyz|vector": "how three angles make a rotation",
            "teeth=N": "how often an error of the gears repeats in a turn",
            "gravity=[0,0,-9.81]": "gravity in the arm's base [m/s^2]",
            "payload_kg=V": "payload of all rows, where no column has it [kg]",
            "socket_distance_mm=V": "how far the two sockets of a place are apart [mm]",
        },
    },
    "design": {
        "every machine": {
            "machine=NAME": "the machine; `bench list machines` has them with their options",
            "machine.OPTION=V": "an option of the machine",
            "data=FILE": "readings that are there",
            "plan=NAME": "a plan of readings in place of data=",
            "plan.OPTION=V": "an option of the plan",
            "size=SIGMAS": "how large the effects are that should be seen (1)",
            "rivals=A,B": "effects that the next readings should split",
            "next=K": "how many readings to propose (4)",
            **_FLAG,
        },
        "machine=arm plan.n=N: which poses to measure": {
            "plan.n=N": "how many poses to propose",
            **_ARM,
            "data=FILE": "what is measured already; poses are added to it",
            "machine.observe=position|pose": "what will be read",
            **_COLUMNS,
            "plan.by=D|E": "D: care for all numbers (the default); E: for the one that is known worst",
            "plan.sigma=MM": "noise of the readings to come (0.05)",
            "plan.sigma_rotation=RAD": "noise of their rotations (0.0005)",
            "plan.target=[0,100,100]": "where the target sits on the last link [mm]",
            "plan.limits=urdf|table|data": "which range of the joints is kept to",
            "plan.box=[x0,x1,y0,y1,z0,z1]": "keep the tip inside a box of the base [mm]",
            "plan.seed=N": "another N draws other poses to choose from (0)",
            "plan.to=FILE": "write the poses to a file [rad]",
        },
    },
    "run": {
        "every sweep": {
            "problem=NAME": "`bench list problems` has them with their options",
            "problem.OPTION=V": "an option of every problem; prob.NAME.OPTION=V of one",
            "optimizer=NAME": "`bench list optimizers` has them with their options",
            "optimizer.OPTION=V": "an option of every optimiser; opt.NAME.OPTION=V of one",
            "budget=N|ci|paper": "evaluations of a run (ci)",
            "seeds=N|A:B|ci|paper": "repetitions (ci)",
            "start=nominal|random": "where a run begins",
            "target=V": "a value that ends a run",
            "time_limit=S": "seconds that end a run",
            "shard=I/N": "of all runs the I-th of N parts",
            "stop_after=K": "failed runs after which no other is begun",
            "replay=true|false": "keep the values of a run as it goes, so that a killed one goes on",
            "execution=serial|processes|dask": "how runs are shared out (serial)",
            "execution.n_jobs=N": "how many processes",
            "execution.inner=N": "processes for the batches of one run",
            "execution.address=tcp://HOST:PORT": "of a Dask cluster",
            **_PLACE,
            "-m": "sweep: lists such as problem=full11,full12 are a run each",
            "--dry-run": "tell what would be done",
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
        "tuner=optuna": {
            "tuner=optuna": "Optuna proposes values for options",
            "tuner.trials=N": "how many settings are tried (20)",
            "tuner.sampler=tpe|random|cmaes": "how the next one is chosen (tpe)",
            "tuner.seed=N": "of the sampler (0)",
            "tuner.by=value|goal": "what is best (value)",
        },
    },
}
_WIDE = 42  # letters of a word that leave room for its meaning in the same line


def help_of(verb: str, usage: str) -> str:
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
