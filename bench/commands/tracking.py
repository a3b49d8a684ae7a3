"""The verbs over all studies: ``bench studies|sql|note|tag|archive|delete|history|pack|unpack|ui``."""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calibench.bench.commands.console import print_json, print_table
from calibench.bench.store.manifest import Notes, StoreError, read_notes, write_notes
from calibench.bench.tracking.catalogue import advice_on, catalogue, find_study, line_of
from calibench.bench.verbs import HistoryWords, TrackingWords, UiWords
from calibench.bench.words import read, split_flags, split_word
from calibench.core.words import counted, print_plain as print

if TYPE_CHECKING:
    from calibench.bench.tracking.tables import LeftOut

_SHOWN = 50  # lines of a catalogue


def list_studies(argv: list[str]) -> int:
    flags, words = split_flags(argv, ("--json", "--all"))
    folder, filters = _folder("studies", words)
    results = Path(folder or "results")
    found = catalogue(results, filters)
    if "--json" in flags:
        print_json([asdict(entry) for entry in found])
        return 0
    if not found:
        print(f"{results}: no study is there that keeps to this{advice_on(results, filters)}")
        return 0
    shown = found if "--all" in flags else found[:_SHOWN]
    lines = [line_of(entry) for entry in shown]
    columns = [name for name in lines[0] if any(line[name] for line in lines)]
    print_table(columns, [[" ".join(line[name].split()) for name in columns] for line in lines])
    kinds = {"runs": "study", "discovery": "discovery", "calibration": "calibration"}
    plurals = {"runs": "studies", "discovery": "discoveries", "calibration": "calibrations"}
    counts = {kind: sum(entry.kind == kind for entry in found) for kind in kinds}
    texts = [f"{n} {kinds[kind] if n == 1 else plurals[kind]}" for kind, n in counts.items() if n]
    more = "; --all shows every line" if len(shown) < len(found) else ""
    print(f"\n{', '.join(texts)} in {results}{more}")
    return 0


def sql(argv: list[str]) -> int:
    from calibench.bench.tracking.tables import query

    flags, words = split_flags(argv[1:], ("--json",))
    if not argv or argv[0].startswith("--") or argv[0].startswith("results="):
        such = 'bench sql "select study, count(*) from runs group by study"'
        raise ValueError(f"sql: one SELECT is needed, such as {such}")
    results = Path(read(TrackingWords, "sql", words).results)
    names, rows, left_out = query(results, argv[0])
    _tell_left_out(left_out)
    if "--json" in flags:
        print_json([dict(zip(names, row, strict=True)) for row in rows])
    else:
        print_table(names, [["-" if cell is None else " ".join(str(cell).split()) for cell in row] for row in rows])
    return 0


def note(argv: list[str]) -> int:
    results, plain = _named("note", argv)
    if len(plain) > 2:
        raise ValueError('note: a study or run and one text are needed, such as bench note adhoc "best so far"')
    [name], text, run_id = plain[:1], "".join(plain[1:]), ""
    try:
        folder, _ = find_study(results, name)
    except ValueError:
        if not name.isalnum():
            raise
        from calibench.bench.report.one_run import find_run

        try:
            found = find_run(results, name)  # by its first digits
        except StoreError as error:
            raise ValueError(f"note: {name}: is no study in {results}, and no run: {error}") from None
        folder, run_id = found.folder, str(found.row["run_id"])
    if not text:
        noted = read_notes(folder)
        for one in noted.notes:
            if not run_id or one.run_id == run_id:
                print(f"{one.at[:16].replace('T', ' ')}  {one.run_id or 'study'}  {one.text}")
        return 0
    _change(folder, lambda notes: notes.with_note(text, run_id))
    print(f"noted of {'run ' + run_id if run_id else 'study'} in {folder}/notes.json")
    return 0


def tag(argv: list[str]) -> int:
    changes = [word for word in argv if word[:1] in "+-"]
    results, plain = _named("tag", [word for word in argv if word not in changes])
    if len(plain) != 1 or not changes:
        raise ValueError("tag: a study and its tags are needed, such as bench tag adhoc +paper -draft")
    folder, _ = find_study(results, plain[0])
    noted = _change(folder, lambda notes: notes.with_tags(changes))
    print(f"{folder}: {' '.join(noted.tags) or 'no tags'}")
    return 0


def archive(argv: list[str]) -> int:
    flags, words = split_flags(argv, ("--undo",))
    results, [name] = _named("archive", words, alone=True)
    folder, _ = find_study(results, name)
    _change(folder, lambda notes: replace(notes, archived="--undo" not in flags))
    print(f"{folder}: is {'listed again' if '--undo' in flags else 'archived; `bench studies archived=*` lists it'}")
    return 0


def delete_study(argv: list[str]) -> int:
    """Delete what bench wrote in a study's folder, after a question."""
    from calibench.bench.tracking.pack import delete, files_of_ours

    flags, words = split_flags(argv, ("--yes",))
    results, [name] = _named("delete", words, alone=True)
    folder, entry = find_study(results, name)
    if folder == results:
        raise ValueError(f"delete: {results}: is the results folder itself; give the one above it by results=")
    mine, others = files_of_ours(folder)
    if "--yes" not in flags:
        size = f"{counted(len(mine), 'file')}, {entry.size / 1e6:.2f} MB"
        if not sys.stdin.isatty():
            raise ValueError(f"delete: nobody can be asked here; --yes deletes {folder} ({size})")
        print(f"delete {folder}: {entry.kind}, {entry.done} done, {size}? Type its name: ", end="")
        sys.stdout.flush()
        if sys.stdin.readline().strip() != entry.study:
            print("nothing was deleted")
            return 1
    count, left = delete(folder)
    print(f"{counted(count, 'file')} deleted")
    if others or left:
        print(f"left alone, as bench has not written it: {', '.join(path.name for path in left[:8])}")
    return 0


def history(argv: list[str]) -> int:
    """Print one method over versions of the code; with --check return 1 where the newest is worse than the tagged."""
    from calibench.bench.tracking import history as of

    flags, words = split_flags(argv, ("--json", "--check"))
    folder, rest = _folder("history", words)
    given = read(HistoryWords, "history", rest)
    results = Path(folder or given.results)
    asked = of.Asked(given.problem, given.optimizer, given.by, given.start, given.budget)
    if "--check" in flags:
        compared, base, newest = of.check(results, asked, given.tag)
        if compared.cells.empty:
            raise ValueError(f"history --check: {base} and {newest} have no cell in common")
        cells = compared.cells.to_dict("records")
        if "--json" in flags:
            print_json({"base": base, "newest": newest, "cells": cells})
        else:
            rows = [[str(row[key]) for key in ("verdict", "problem", "optimizer", "why")] for row in cells]
            print_table([f"{newest} is", "problem", "optimizer", f"beside {base}"], rows)
        return 1 if compared.count("worse") else 0
    found, left_out = of.histories(results, asked)
    _tell_left_out(left_out)
    if not found:
        raise ValueError(f"history: no run of {given.optimizer} on {given.problem} in {results}")
    if given.to is not None:
        given.to.write_text(of.page(found), encoding="utf-8")
    if "--json" in flags:
        print_json([_as_json(one) for one in found])
        return 0
    for one in found:
        start, budget, target = one.setting[1:]
        print(f"{one.called}, {start} start, budget {budget}" + (f", target {target:g}" if target else ""))
        rows = [
            [*(str(row[name]) for name in ("when", "commit", "studies", "runs", "value")),
             f"{row['verdict']}: {row['why']}" if row["verdict"] else row["why"]]
            for row in of.rows_of(one)
        ]  # fmt: skip
        print_table(["first run", "commit", "study", "runs", one.shown, "beside the one before"], rows)
        print(f"{of.sentence(one)}\n")
    if given.to is not None:
        print(given.to)
    return 0


def pack_study(argv: list[str]) -> int:
    from calibench.bench.tracking.pack import pack

    to, words = split_word(argv, "--to")
    results, [name] = _named("pack", words, alone=True)
    folder, entry = find_study(results, name)
    path, digest = pack(folder, entry, Path(*to) if to else Path(f"{folder.resolve().name}.zip"))
    print(f"{path}: {entry.study}, {path.stat().st_size / 1e6:.2f} MB; digest {digest}")
    print(f"who gets it: bench unpack {path.name}")
    return 0


def unpack_study(argv: list[str]) -> int:
    from calibench.bench.tracking.pack import unpack

    flags, words = split_flags(argv, ("--trust",))
    results, [name] = _named("unpack", words, alone=True)
    done = unpack(Path(name), results, "--trust" in flags)
    print(f"{done.folder}: {counted(done.files, 'file')}, all as they were packed; digest {done.digest}")
    if done.left:
        print(
            f"{counted(done.left, 'page and drawing')} left in it, as a browser runs them; "
            f"`bench report {done.folder}` makes ours"
        )
    return 0


def ui(argv: list[str]) -> int:
    flags, words = split_flags(argv, ("--write",))
    folder, rest = _folder("ui", words)
    given = read(UiWords, "ui", rest)
    results = Path(folder or given.results)
    if not results.is_dir():
        raise ValueError(f"ui: {results}: there is no such results folder")
    try:
        from calibench.bench.ui.server import serve
    except ModuleNotFoundError as error:
        if error.name not in ("starlette", "uvicorn", "anyio"):
            raise
        raise ValueError("ui: needs starlette and uvicorn; pip install 'calibench[ui]'") from None

    said = "open {}\nCtrl-C ends it"
    serve(results, given.port, write="--write" in flags, tell=lambda at: print(said.format(at), flush=True))
    return 0


def _as_json(one: Any) -> dict[str, Any]:
    from calibench.bench.tracking.history import sentence, summary_of

    versions = []
    for i, version in enumerate(one.versions):
        low, middle, high, _ = summary_of(one, version)
        step = one.steps.get(i)
        versions.append({
            "code_digest": version.code, "commit": version.commit, "dirty": version.dirty,
            "began": version.began.isoformat(), "studies": version.studies, "runs": len(version.runs),
            "same": version.same, "median": middle, "q1": low, "q3": high,
            "verdict": step.verdict if step else None, "p": step.p if step else None, "why": step.why if step else None,
        })  # fmt: skip
    return {
        "problem": one.problem, "optimizer": one.optimizer, "options": one.options, "setting": one.setting,
        "by": one.by, "shown": one.shown, "versions": versions,
        "change": asdict(one.change) if one.change else None, "sentence": sentence(one),
    }  # fmt: skip


def _folder(verb: str, words: Sequence[str]) -> tuple[str, list[str]]:
    """Return the folder of results, bare or behind results=, "" where none is named, and the other KEY=VALUE."""
    folders = [word for word in words if "=" not in word or word.startswith("results=")]
    if len(folders) > 1:
        raise ValueError(f"{verb}: one folder of results, then KEY=VALUE; {folders[1]!r} is a second one")
    return "".join(folders).removeprefix("results="), [word for word in words if word not in folders]


def _named(verb: str, argv: Sequence[str], alone: bool = False) -> tuple[Path, list[str]]:
    """Return results= and the other words, of which there is one at least, or just one."""
    given = [word for word in argv if word.startswith("results=")]
    plain = [word for word in argv if word not in given]
    if not plain:
        raise ValueError(f"{verb}: a study is needed, by its name in the results folder; `bench studies` lists them")
    if alone and len(plain) > 1:
        raise ValueError(f"{verb}: one study is needed; {plain[1]!r} is a second word")
    return Path(read(TrackingWords, verb, given).results), plain


def _change(folder: Path, how: Any) -> Notes:
    from calibench.bench.store.runs import locked

    with locked(folder):
        noted: Notes = how(read_notes(folder))
        write_notes(folder, noted)
    return noted


def _tell_left_out(left_out: "Iterable[LeftOut]") -> None:
    for one in left_out:
        print(f"bench: {one.path}: is left out: {one.why}", file=sys.stderr)
