"""``bench collect STUDY_DIR`` and ``bench merge``: tables, and merged studies; ``bench show``: one run."""

import sys
from pathlib import Path

from calibench.bench.commands.console import print_json
from calibench.bench.commands.status import runs_of_other_shards
from calibench.bench.report.one_run import find_run, show_run
from calibench.bench.statistics.cells import CELL, mixed_code
from calibench.bench.store.runs import ResultStore, merge
from calibench.bench.verbs import ShowWords
from calibench.bench.words import read, split_flags
from calibench.core.words import counted, print_plain as print


def collect(argv: list[str]) -> int:
    store = store_of(argv)
    aside = store.collect()
    print(f"{counted(len(store.collected()), 'run')} in {store.folder}/runs.parquet, traces.parquet")
    return tell_damaged(aside, "set aside here; nothing else is lost, the same `bench run` does its run again")


def merge_studies(argv: list[str]) -> int:
    words, to = list(argv), ""
    if "--to" in words:
        at = words.index("--to")
        to = words[at + 1] if at + 1 < len(words) else ""
        del words[at : at + 2]
    flags, folders = split_flags(words, ("--keep-first",))
    if not to or not folders:
        raise ValueError("merge: folders and where to are needed: bench merge A B --to C")
    merged = merge([Path(folder) for folder in folders], Path(to), keep_first="--keep-first" in flags)
    twice = f"; {counted(merged.twice, 'run')} stood in several folders" if merged.twice else ""
    to_do = f"; {merged.left} planned and not done" if merged.left else ""
    print(f"{counted(merged.runs, 'run')} in {to}/runs.parquet, traces.parquet{twice}{to_do}")
    if merged.in_other_shards:
        print(f"{runs_of_other_shards(merged.in_other_shards)}: merge those shards too, or the study is not whole")
    if warning := mixed_code(ResultStore(to).runs([*CELL, "code_digest"])):
        print(warning)
    return 0


def store_of(argv: list[str]) -> ResultStore:
    _, words = split_flags(argv, ())
    if len(words) != 1:
        raise ValueError("one STUDY_DIR is needed, such as results/adhoc")
    store = ResultStore(words[0])
    store.manifest()
    return store


def tell_damaged(paths: list[Path], what: str) -> int:
    for path in paths:
        print(f"bench: {path}: is damaged (not a whole part); {what}", file=sys.stderr)
    return 2 if paths else 0


def show(argv: list[str]) -> int:
    """Print the run whose id begins with the word of `argv`; a word that is a folder is where it is looked for."""
    flags, words = split_flags(argv, ("--json",))
    given = read(ShowWords, "show", [word for word in words if "=" in word])
    plain = [word for word in words if "=" not in word]
    folders = [word for word in plain if len(plain) > 1 and Path(word).is_dir()]
    ids = [word for word in plain if word not in folders]
    if len(ids) != 1 or len(folders) + bool(given.results) > 1:
        raise ValueError("show: one RUN_ID is needed, such as bench show 3f2a (the first digits suffice)")
    one = find_run(Path([*folders, given.results or "results"][0]), ids[0])
    if "--json" in flags:
        print_json(one.row)
    else:
        print(show_run(one))
    return 0
