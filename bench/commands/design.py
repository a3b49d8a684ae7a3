"""``bench design``: what data or a plan could and could not tell apart, before anything is fitted.

``bench design machine=arm plan.n=N``: which poses of an arm to measure next, and when more stop to pay.
"""

from __future__ import annotations

import json
import sys

import numpy as np
from rich.console import Console
from rich.table import Table

from calibench.bench.calibration.design import asks_for_poses, read_design_poses
from calibench.bench.commands.arguments import split_flags
from calibench.bench.commands.console import print_table
from calibench.bench.discovery.design import Designed, designed
from calibench.bench.discovery.page.page import smallest, untested_lines
from calibench.bench.discovery.page.words import share
from calibench.bench.discovery.request import read_design
from calibench.bench.store.atomic_file import write_whole
from calibench.calibration.poses import Design
from calibench.core.words import plain, printable
from calibench.core.words import print_plain as print
from calibench.discrepancy.labels import effect_label

_WIDTH = 120  # of tables that go to a file
_LISTED = 10  # names of a class that are printed
_STEPS = (0, 5, 10, 15, 20, 30, 40, 60, 80, 100, 150, 200)  # poses more, of which the error is printed


def run(argv: list[str]) -> int:
    """Print what the data or the plan that `argv` names could tell; of an arm with plan.n=, which poses to take."""
    if asks_for_poses(argv):
        return design_poses(argv)
    flags, words = split_flags(argv, ("--json",))
    request = read_design(words)
    answer = designed(request)
    if "--json" in flags:
        print(json.dumps(answer.to_dict(request.machine), indent=1))
        return 0
    console = Console(highlight=False, markup=False, width=None if sys.stdout.isatty() else _WIDTH)
    _print(console, answer, request.build_machine().name)
    return 0


def _print(console: Console, answer: Designed, machine: str) -> None:
    design = answer.design
    words = {s.effect: effect_label(machine, s.family, s.target) for s in design.candidates}
    print(f"{design.name}: {design.readings} readings, {design.constraints} constraints; no effect was fitted\n")
    _print_candidates(console, answer, machine)
    mixed = [names for names in design.classes if len(names) > 1]
    print()
    if mixed:
        print(f"Cannot be told apart by these data, at a visible size of {design.size:g} sigma:")
        for names in mixed:
            more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
            print(f"  {' | '.join(words[name] for name in names[:_LISTED])}{more}")
    else:
        print(f"All visible effects can be told apart at a visible size of {design.size:g} sigma.")
    if lines := untested_lines(machine, design.not_testable):
        print("\nCannot be tested:")
    for line in lines:
        print(f"  {line}")
    for note in design.notes:
        print(f"note: {note}")
    _print_next(console, answer, words)


def _print_candidates(console: Console, answer: Designed, machine: str) -> None:
    table = Table(box=None, pad_edge=False)
    table.add_column("effect")
    for head in ("visible share", "smallest size seen", "class"):
        table.add_column(head, justify="right")
    sizes = {k: len(names) for k, names in enumerate(answer.design.classes)}
    for sight in answer.design.candidates:
        seen = smallest(sight.minimum_detectable, sight.unit) if sight.visible else "invisible"
        group = str(sight.group + 1) if sizes.get(sight.group, 0) > 1 else ""
        table.add_row(
            printable(effect_label(machine, sight.family, sight.target)), share(sight.visible_fraction), seen, group
        )
    console.print(table)


def _print_next(console: Console, answer: Designed, words: dict[str, str]) -> None:
    further = answer.further
    if further is None:
        if answer.reason:
            print(f"\nNo further readings are proposed: {answer.reason}")
        return
    rivals = " | ".join(words.get(name, name) for name in further.rivals)
    start, end = further.separation[0], further.separation[-1]
    print(f"\nReadings that would best split {rivals}")
    if not further.helps:
        print("  none: no reading separates these; they leave the same signature")
        return
    table = Table(box=None, pad_edge=False)
    for head in ("x [mm]", "y [mm]", "separation after it [sigma]"):
        table.add_column(head, justify="right")
    for (x, y), separation in zip(further.positions, further.separation[1:]):
        table.add_row(f"{x:.1f}", f"{y:.1f}", f"{separation:.2f}")
    console.print(table)
    print(f"  separation before: {start:.2f} sigma, after: {end:.2f}")


def design_poses(argv: list[str]) -> int:
    """Print the poses that are worth most, and write them to the file that was asked for."""
    flags, words = split_flags(argv, ("--json",))
    plan, to = read_design_poses(words)
    if to is not None:
        heads = [f"{name} [{'rad' if turn else 'mm'}]" for name, turn in _turning(plan)]
        lines = [",".join(heads), *(",".join(f"{v:.6f}" for v in row) for row in plan.joints)]
        write_whole(to, lambda file: file.write(("\n".join(lines) + "\n").encode()))
    if "--json" in flags:
        print(json.dumps(plan.to_dict(), allow_nan=False))
        return 0
    beside = f"beside {plan.measured} that are measured" if plan.measured else "to begin with"
    limits = "no limits are stated" if plan.limits == "none" else f"limits of the {plan.limits}"
    print(f"{len(plan.joints)} poses {beside}, for {plan.numbers} numbers of the arm; {limits}\n")
    turns = _turning(plan)
    rows = []
    for k, (joints, target) in enumerate(zip(plan.joints, plan.target, strict=True), start=1):
        cells = [f"{np.rad2deg(v) if turn else v:.1f}" for v, (_, turn) in zip(joints, turns, strict=True)]
        rows.append([str(k), *cells, " ".join(f"{v:.0f}" for v in target)])
    print_table(["", *(f"{name} [{'°' if turn else 'mm'}]" for name, turn in turns), "target [mm]"], rows)
    print("\nerror of the calibrated arm over the workspace, from the uncertainty of its numbers alone")
    count = len(plan.joints)
    steps = [n for n in _STEPS if n < count] + [count]
    errors = {n: plan.chosen.error[n] for n in steps}
    rows = [[str(n), "unknown" if error > 20 else f"{plain(error, 3)}"] for n, error in errors.items()]
    print_table(["poses more", "error [mm, rms]"], rows)
    enough, scatter = plan.chosen.enough(plan.sigma), f"the scatter of a reading, {plain(plan.sigma, 3)} mm"
    if enough is None:
        print(f"more poses help: the numbers are not yet known to a third of {scatter}")
    elif enough == 0:
        print(f"more poses do not help: the numbers are known to a third of {scatter}")
    else:
        print(f"from {enough} on more poses hardly help: the numbers are known to a third of {scatter}")
    for note in plan.notes:
        print(f"note: {note}")
    if to is not None:
        print(to)
    return 0


def _turning(plan: Design) -> list[tuple[str, bool]]:
    """Return each joint with whether it turns; one that slides does not."""
    kinds = {joint.name: joint.kind for joint in plan.chain.joints}
    return [(name, kinds.get(name, "rotary") == "rotary") for name in plan.chain.driven]
