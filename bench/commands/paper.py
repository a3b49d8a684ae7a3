"""``bench paper``: rerun both papers and write their ledger."""

import sys

from calibench.bench.papers.ledger import KINDS
from calibench.bench.papers.page import NONE, by_kind
from calibench.bench.papers.rerun import run_paper
from calibench.bench.sweep.carry_out import show_progress
from calibench.bench.sweep.words import read_budget, read_seeds
from calibench.bench.verbs import PaperWords
from calibench.bench.words import read
from calibench.core.words import counted, plain, print_plain as print


def run(argv: list[str]) -> int:
    """Rerun the papers at the budget in `argv` and print the result; 1 where a run failed."""
    words, rest = [], list(argv)
    while rest:
        word = rest.pop(0).removeprefix("--")
        words.append(word if "=" in word or not rest else f"{word}={rest.pop(0)}")
    given = read(PaperWords, "paper", words)
    budget = int(given.budget) if given.budget.isdecimal() else given.budget
    read_budget(budget, "of a paper", {"ci": 1, "paper": 1})
    if given.seeds:
        read_seeds(given.seeds)
    with show_progress() as report:
        ledger = run_paper(budget, given.results, given.seeds or None, given.execution, report, given.to or None)
    papers = {paper: ledger.counts(paper) for paper in dict.fromkeys(row.paper for row in ledger.rows)}
    for verdict, count in ledger.counts().items():
        print(f"{count:4d}  {verdict} ({', '.join(f'{paper} {of[verdict]}' for paper, of in papers.items())})")
    print(f"\n{'by kind':24}{''.join(f'{kind:>9}' for kind in KINDS)}")
    for verdict, of in by_kind(ledger.rows).items():
        print(f"{verdict:24}{''.join(f'{of[kind] or NONE:>9}' for kind in KINDS)}")
    print("\nclaims of the papers that do not hold:")
    for row in ledger.rows:
        if row.kind == "claim" and row.verdict == "not reproduced":
            print(f"  {row.quantity} ({row.place}): ours {plain(row.ours_median, 3)}, {row.method}")
    for path in ledger.paths:
        print(path)
    if ledger.failed:
        print(f"{counted(ledger.failed, 'run')} failed; the rows say why", file=sys.stderr)
    return 1 if ledger.failed else 0
