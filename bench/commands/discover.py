"""``bench discover``: what the model of a machine is missing, a verdict a set of data."""

from __future__ import annotations

import json
import sys

from calibench.bench.commands.arguments import split_flags
from calibench.bench.discovery.batch import Outcome, discover
from calibench.bench.discovery.page.words import (
    FIRST,
    SIZES,
    as_sentence,
    doubt_sentences,
    gap_sentence,
    headline,
    next_sentences,
    notes_among,
    other_notes,
    unnamed_sentences,
)
from calibench.bench.discovery.request import read_discover
from calibench.core.words import print_plain as print


def run(argv: list[str]) -> int:
    """Search the data that `argv` names and print a verdict each; 1 where a search failed."""
    flags, words = split_flags(argv, ("--json", "--retry"))
    request = read_discover(words)
    failed, count = 0, 0
    for outcome in discover(request, retry="--retry" in flags):
        failed, count = failed + outcome.record.failed, count + 1
        if "--json" in flags:
            print(json.dumps(outcome.record.line(), allow_nan=False), flush=True)
        else:
            print(_paragraph(outcome), flush=True)
    if "--json" not in flags:
        print(f"{count} searched, {failed} failed; {request.folder}/findings.parquet, gaps.parquet")
    elif failed:
        print(f"bench: {failed} of {count} failed; their lines have an error", file=sys.stderr)
    return 1 if failed else 0


def _paragraph(outcome: Outcome) -> str:
    record, report = outcome.record, outcome.record.report
    lines = [f"{record.case} ({record.machine}{', searched before' if outcome.before else ''})"]
    if report is None:
        return f"{lines[0]}\n  failed: {record.error}\n"
    lines += [f"  {note}" for note in notes_among(report.notes, FIRST)]
    lines += [f"  {line}" for line in (headline(report), *unnamed_sentences(report), gap_sentence(report))]
    sizes = notes_among(report.notes, SIZES)
    lines += [f"  {line}" for line in (*doubt_sentences(report), *map(as_sentence, sizes))]
    lines += [f"  measure next: {advice}" for advice in next_sentences(report)]
    lines += [f"  note: {note}" for note in other_notes(report.notes)]
    if outcome.page is not None:
        lines.append(f"  {outcome.page}")
    return "\n".join(lines) + "\n"
