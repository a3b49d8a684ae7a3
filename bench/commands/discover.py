"""``bench discover``: what the model of a machine is missing, a verdict a set of data.

``bench design``: what data or a plan could tell apart; with plan.n=N, which poses of an arm to measure next.
"""

import json
import sys

import numpy as np

from calibench.bench.commands.console import print_table
from calibench.bench.discovery.batch import Designed, designed, read_discover, search_all
from calibench.bench.discovery.page import words as wording
from calibench.bench.discovery.page.page import smallest, untested_lines
from calibench.bench.words import split_flags
from calibench.core.words import as_sentence, plain, print_plain as print
from calibench.discrepancy.labels import effect_label

_LISTED = 10  # names of a class that are printed
_STEPS = (0, 5, 10, 15, 20, 30, 40, 60, 80, 100, 150, 200)  # poses more, of which the error is printed


def discover(argv: list[str]) -> int:
    flags, words = split_flags(argv, ("--json", "--retry"))
    request = read_discover(words)
    failed, count, known = 0, 0, 0
    for outcome in search_all(request, retry="--retry" in flags):
        failed, count, known = failed + (outcome.record.report is None), count + 1, known + outcome.before
        if "--json" in flags:
            print(json.dumps(outcome.record.line(), allow_nan=False), flush=True)
            continue
        record, report = outcome.record, outcome.record.report
        began = str(record.provenance.get("started_at", ""))[:16].replace("T", " ")
        since = f", searched before, {began} UTC: nothing is new"
        lines = [f"{record.case} ({record.machine}{since if outcome.before else ''})"]
        if report is None:
            lines.append(f"  failed: {record.error}")
        else:
            found = (wording.headline(report), *wording.unnamed_sentences(report), wording.gap_sentence(report))
            sizes = map(as_sentence, wording.notes_among(report.notes, wording.SIZES))
            lines += [f"  {note}" for note in wording.notes_among(report.notes, wording.FIRST)]
            doubts = (*wording.across_sentences(report), *wording.doubt_sentences(report))
            lines += [f"  {line}" for line in (*found, *doubts, *sizes)]
            lines += [f"  measure next: {advice}" for advice in wording.next_sentences(report)]
            lines += [f"  note: {note}" for note in wording.notes_among(report.notes, wording.LAST)]
            lines += [] if outcome.page is None else [f"  {outcome.page}"]
        print("\n".join(lines) + "\n", flush=True)
    if "--json" not in flags:
        before = f", {known} searched before (--retry searches again)" * bool(known)
        print(f"{count - known} searched{before}, {failed} failed; {request.folder}/findings.parquet, gaps.parquet")
    elif failed:
        print(f"bench: {failed} of {count} failed; their lines have an error", file=sys.stderr)
    return 1 if failed else 0


def design(argv: list[str]) -> int:
    asked = any(word.startswith("plan.n=") for word in argv)
    others = any(word.startswith(("plan=", "data=")) for word in argv)
    if "machine=arm" in argv and (asked or not others):  # which poses of an arm to measure
        return design_poses(argv)
    flags, words = split_flags(argv, ("--json",))
    answer = designed(words)
    if "--json" in flags:
        print(json.dumps(answer.to_dict(), indent=1))
    else:
        _print(answer)
    return 0


def _print(answer: Designed) -> None:
    design, further, machine = answer.design, answer.further, answer.label
    words = {s.effect: effect_label(machine, s.family, s.target) for s in design.candidates}
    print(f"{design.name}: {design.readings} readings, {design.constraints} constraints; no effect was fitted\n")
    sizes, rows = {k: len(names) for k, names in enumerate(design.classes)}, []
    for sight in design.candidates:
        seen = smallest(sight) if sight.visible else "invisible"
        group = str(sight.group + 1) if sizes.get(sight.group, 0) > 1 else ""
        rows.append([words[sight.effect], wording.share(sight.visible_fraction), seen, group])
    print_table(["effect", "visible share", "smallest size seen", "class"], rows)
    print()
    mixed = [names for names in design.classes if len(names) > 1]
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
    if further is None:
        if answer.reason:
            print(f"\nNo further readings are proposed: {answer.reason}")
        return
    print(f"\nReadings that would best split {' | '.join(words.get(name, name) for name in further.rivals)}")
    if not further.helps:
        print("  none: no reading separates these; they leave the same signature")
        return
    places = zip(further.positions, further.separation[1:])
    rows = [[f"{x:.1f}", f"{y:.1f}", f"{separation:.2f}"] for (x, y), separation in places]
    print_table(["x [mm]", "y [mm]", "separation after it [sigma]"], rows)
    print(f"  separation before: {further.separation[0]:.2f} sigma, after: {further.separation[-1]:.2f}")


def design_poses(argv: list[str]) -> int:
    flags, words = split_flags(argv, ("--json",))
    from calibench.bench.calibration.request import read_design_poses, write_design  # which a search does not need

    plan, to = read_design_poses(words)
    kinds = {joint.name: joint.kind for joint in plan.chain.joints}
    turns = [(name, kinds.get(name, "rotary") == "rotary") for name in plan.chain.driven]  # and those that slide
    files = () if to is None else write_design(plan, to)
    if "--json" in flags:
        print(json.dumps(plan.to_dict(), allow_nan=False))
        return 0
    beside = f"beside {plan.measured} that are measured" if plan.measured else "to begin with"
    limits = "no limits are stated" if plan.limits == "none" else f"limits of the {plan.limits}"
    print(f"{len(plan.joints)} poses {beside}, for {plan.numbers} numbers of the arm; {limits}\n")
    rows = []
    for k, (joints, target) in enumerate(zip(plan.joints, plan.target, strict=True), start=1):
        cells = [f"{np.rad2deg(v) if turn else v:.1f}" for v, (_, turn) in zip(joints, turns, strict=True)]
        rows.append([str(k), *cells, " ".join(f"{v:.0f}" for v in target)])
    print_table(["", *(f"{name} [{'°' if turn else 'mm'}]" for name, turn in turns), "target [mm]"], rows)
    print(
        "\nerror of the calibrated arm over the workspace, rms: by the uncertainty of its numbers alone, and with what"
    )
    print(f"no number explains; those after {len(plan.joints)} are of more that are worth as much")
    count = len(plan.joints)
    steps = {n for n in _STEPS if n < count} | {n for n, _ in plan.chosen.beyond} | {count}
    rows = [[str(one.poses), plain(one.error_mm, 3), plain(one.left_mm, 3)] for one in plan.gain if one.poses in steps]
    print_table(["poses more", "its numbers [mm]", "a fresh reading [mm]"], rows)
    enough, scatter = plan.chosen.enough(plan.sigma), f"the scatter of a reading, {plain(plan.sigma, 3)} mm"
    if enough is None:
        print(f"more poses help: the numbers are not yet known to a third of {scatter}")
    elif enough == 0:
        print(f"more poses do not help: the numbers are known to a third of {scatter}")
    else:
        print(f"from {enough} on more poses hardly help: the numbers are known to a third of {scatter}")
    for note in plan.notes:
        print(f"note: {note}")
    for file in files:
        print(file)
    return 0
