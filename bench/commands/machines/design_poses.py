"""``bench design machine=arm plan.n=N``: which poses of an arm to measure next, and when more stop to pay."""

from __future__ import annotations

import json

import numpy as np

from calibench.bench.calibration.plan import Planned, planned
from calibench.bench.commands.arguments import split_flags
from calibench.bench.commands.console import print_table
from calibench.bench.store.files.atomic_file import write_whole
from calibench.core.counted import plain
from calibench.core.words import print_plain as print

_STEPS = (0, 5, 10, 15, 20, 30, 40, 60, 80, 100, 150, 200)


def run(argv: list[str]) -> int:
    """Print the poses that are worth most, and write them to the file that was asked for."""
    flags, words = split_flags(argv, ("--json",))
    found, to = planned(words)
    if to is not None:
        heads = [f"{name} [{'rad' if turn else 'mm'}]" for name, turn in _turning(found)]
        lines = [",".join(heads), *(",".join(f"{v:.6f}" for v in row) for row in found.joints)]
        write_whole(to, lambda file: file.write(("\n".join(lines) + "\n").encode()))
    if "--json" in flags:
        print(json.dumps(found.to_dict(), allow_nan=False))
        return 0
    told = f"beside {found.measured} that are measured" if found.measured else "to begin with"
    limits = "no limits are stated" if found.limits == "none" else f"limits of the {found.limits}"
    print(f"{len(found.joints)} poses {told}, for {found.numbers} numbers of the arm; {limits}\n")
    _print_poses(found)
    print("\nerror of the calibrated arm over the workspace, from the uncertainty of its numbers alone")
    count = len(found.joints)
    steps = [n for n in _STEPS if n < count] + [count]
    print_table(["poses more", "error [mm, rms]"], [[str(n), _size(found.chosen.error[n])] for n in steps])
    enough, scatter = found.chosen.enough(found.sigma), f"the scatter of a reading, {plain(found.sigma, 3)} mm"
    if enough is None:
        print(f"more poses help: the numbers are not yet known to a third of {scatter}")
    elif enough == 0:
        print(f"more poses do not help: the numbers are known to a third of {scatter}")
    else:
        print(f"from {enough} on more poses hardly help: the numbers are known to a third of {scatter}")
    for note in found.notes:
        print(f"note: {note}")
    if to is not None:
        print(to)
    return 0


def _print_poses(found: Planned) -> None:
    turns = [turn for _, turn in _turning(found)]
    heads = [f"{name} [{'°' if turn else 'mm'}]" for name, turn in _turning(found)]
    rows = []
    for k, (joints, target) in enumerate(zip(found.joints, found.target, strict=True), start=1):
        cells = [f"{np.rad2deg(v) if turn else v:.1f}" for v, turn in zip(joints, turns, strict=True)]
        rows.append([str(k), *cells, " ".join(f"{v:.0f}" for v in target)])
    print_table(["", *heads, "target [mm]"], rows)


def _turning(found: Planned) -> list[tuple[str, bool]]:
    """Return each joint with whether it turns; one that slides does not."""
    kinds = {joint.name: joint.kind for joint in found.chain.joints}
    return [(name, kinds.get(name, "rotary") == "rotary") for name in found.chain.driven]


def _size(error: float) -> str:
    return "unknown" if error > 20 else f"{plain(error, 3)}"
