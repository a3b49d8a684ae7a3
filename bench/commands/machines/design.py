"""``bench design``: what data or a plan could and could not tell apart, before anything is fitted."""

from __future__ import annotations

import json
import sys

from rich.console import Console
from rich.table import Table

from calibench.bench.calibration.plan import asks_for_poses
from calibench.bench.commands.arguments import split_flags
from calibench.bench.commands.machines import design_poses
from calibench.bench.discovery.design import Designed, designed
from calibench.bench.discovery.page.limits import smallest, untested_lines
from calibench.bench.discovery.page.quantity import share
from calibench.bench.discovery.request import read_design
from calibench.core.words import print_plain as print
from calibench.core.words import printable
from calibench.discrepancy.labels import effect_label

_WIDTH = 120  # of tables that go to a file
_LISTED = 10  # names of a class that are printed


def run(argv: list[str]) -> int:
    """Print what the data or the plan that `argv` names could tell; of an arm with plan.n=, which poses to take."""
    if asks_for_poses(argv):
        return design_poses.run(argv)
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
    found = answer.design
    words = {s.effect: effect_label(machine, s.family, s.target) for s in found.candidates}
    print(f"{found.name}: {found.readings} readings, {found.constraints} constraints; no effect was fitted\n")
    _print_candidates(console, answer, machine)
    mixed = [names for names in found.classes if len(names) > 1]
    print()
    if mixed:
        print(f"Cannot be told apart by these data, at a visible size of {found.size:g} sigma:")
        for names in mixed:
            more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
            print(f"  {' | '.join(words[name] for name in names[:_LISTED])}{more}")
    else:
        print(f"All visible effects can be told apart at a visible size of {found.size:g} sigma.")
    _print_untested(answer, machine)
    for note in found.notes:
        print(f"note: {note}")
    _print_next(console, answer, words)


def _print_candidates(console: Console, answer: Designed, machine: str) -> None:
    """Print what can be seen at all, and from which size on."""
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


def _print_untested(answer: Designed, machine: str) -> None:
    if lines := untested_lines(machine, answer.design.not_testable):
        print("\nCannot be tested:")
    for line in lines:
        print(f"  {line}")


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
