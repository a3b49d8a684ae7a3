"""The command line: ``bench <verb> ...``.

Exit 0: done. 1: some run failed (a table of failures ends the output). 2: the request is wrong: one line that says what
and how to put it right, no traceback, nothing written. Each verb imports only what it uses: `list` must answer at once.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

_USAGE = """usage: bench VERB ...

  list problems|optimizers|studies|figures [--json]    what there is, with traits and options
  list optimizers --all                                and what is left out, with the reason
  run [-m] problem=NAME [problem.OPTION=V] optimizer=NAME [optimizer.OPTION=V] [budget=N|ci|paper]
      [seeds=N|A:B|ci|paper] [start=nominal|random] [target=V] [time_limit=S] [study=NAME] [results=DIR]
      [execution=serial|joblib] [execution.n_jobs=N] [--dry-run] [--retry-failed]
                                                       -m sweeps lists: problem=full11,full12 optimizer=lm,de;
                                                       opt.de.population=200 and prob.full12.gauge=ya2 address one
  run study=quick|cong2008 ...                         a prepared study
  identify problem=NAME [problem.OPTION=V] [noise=V] [--json]   what the data of a problem can tell at all
  paper [--budget ci|paper|N] [seeds=N] [results=DIR] [execution=serial|joblib]
                                                       rerun the papers: printed | ours | verdict | why
  status|collect|report STUDY_DIR                      progress; fold parts into tables; tables and figures
  show RUN_ID [results=DIR]                            one run (the first digits of its id suffice)
"""
_LONG = 40  # rows of a summary that `run` still prints
_LATER = {
    "compare": "comparing two studies",
    "export": "export to coco, ioh, mlflow",
    "import": "import from coco, ioh",
    "discover": "finding a missing effect",
    "design": "designing a measurement",
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the verb that `arguments` (by default the process's) begin with, and exit."""
    for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(threads, "1")  # matrices here are small; and the same bits with any number of workers
    sys.path.insert(0, os.getcwd())  # so that problem=my_module:MyProblem is found where the user stands
    argv = list(sys.argv[1:] if arguments is None else arguments)
    try:
        code = _dispatch(argv)
        sys.stdout.flush()
    except (ValueError, ModuleNotFoundError) as error:
        print(f"bench: {' '.join(str(error).split())}", file=sys.stderr)
        code = 2
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        print(f"bench: {where}{error.strerror or error}", file=sys.stderr)
        code = 2
    except KeyboardInterrupt:
        print("bench: stopped; finished runs are kept, the same command goes on from there", file=sys.stderr)
        code = 130
    sys.exit(code)


def _dispatch(argv: list[str]) -> int:
    verbs: dict[str, Callable[[list[str]], int]] = {
        "list": _list, "run": _run, "identify": _identify, "status": _status, "collect": _collect, "report": _report,
        "show": _show, "paper": _paper,
    }  # fmt: skip
    if not argv or argv[0] in ("-h", "--help", "help"):
        print(_USAGE, end="")
        return 0 if argv else 2
    verb, rest = argv[0], argv[1:]
    if verb in _LATER:
        raise ValueError(f"{verb}: not built yet ({_LATER[verb]})")
    if verb not in verbs:
        from bedrock.registry import suggest

        raise ValueError(f"unknown verb {verb!r}; {suggest(verb, verbs)}")
    if "-h" in rest or "--help" in rest:
        print(_USAGE, end="")
        return 0
    return verbs[verb](rest)


def _list(argv: list[str]) -> int:
    flags, words = _split(argv, ("--json", "--all"))
    kinds: dict[str, Callable[[], list[dict[str, Any]]]] = {
        "problems": _problem_rows, "optimizers": _optimizer_rows, "studies": _study_rows, "figures": _figure_rows
    }  # fmt: skip
    kind = words[0] if len(words) == 1 else ""
    if kind in ("effects", "machines"):
        raise ValueError(f"list {kind}: not built yet (finding a missing effect)")
    if kind not in kinds:
        from bedrock.registry import suggest

        raise ValueError(f"list {' '.join(words)}: {suggest(kind, kinds)}")
    rows = kinds[kind]()
    if "--all" in flags and kind in ("problems", "optimizers"):
        rows += _left_out_rows(kind)
    if "--json" in flags:
        print(json.dumps(rows, indent=1))
        return 0
    for row in rows:
        traits = [k for k, v in row.get("traits", {}).items() if v is True]
        traits += ["left out"] if row.get("left_out") else []
        print(f"{row['name']}" + (f"  [{', '.join(traits)}]" if traits else ""))
        print(f"    {row['about']}")
        if row.get("options"):
            print(f"    {'  '.join(option['text'] for option in row['options'])}")
    return 0


def _left_out_rows(kind: str) -> list[dict[str, Any]]:
    import optimizers
    import problems

    registry: Any = problems.registry if kind == "problems" else optimizers.registry
    return [{"name": name, "about": reason, "left_out": True} for name, reason in registry.left_out.items()]


def _problem_rows() -> list[dict[str, Any]]:
    import problems

    return [
        {"name": name, "about": _about(factory), "options": _option_rows(problems.registry, name)}
        for name, factory in problems.registry.factories().items()
    ]


def _optimizer_rows() -> list[dict[str, Any]]:
    from dataclasses import asdict

    import optimizers

    rows = []
    for name, factory in optimizers.registry.factories().items():
        traits = getattr(factory() if not _needs(optimizers.registry, name) else None, "traits", None)
        rows.append(
            {
                "name": name,
                "about": _about(factory),
                "traits": {} if traits is None else asdict(traits),
                "options": _option_rows(optimizers.registry, name),
            }
        )
    return rows


def _study_rows() -> list[dict[str, Any]]:
    from bench.request import study_names, study_preset

    return [{"name": name, "about": (study_preset(name) or {})["description"]} for name in study_names()]


def _figure_rows() -> list[dict[str, Any]]:
    return [
        {"name": "convergence", "about": "best error over charged evaluations, median and quartiles, rounding floor"},
        {
            "name": "gauge",
            "about": "Table 4's and Table 7's printed results on the curve along which no reading changes",
        },
    ]


def _option_rows(registry: Any, name: str) -> list[dict[str, Any]]:
    return [
        {"name": o.name, "default": o.default, "required": o.required, "text": o.describe()}
        for o in registry.options(name).values()
    ]


def _needs(registry: Any, name: str) -> bool:
    return any(option.required for option in registry.options(name).values())


def _about(factory: Any) -> str:
    described = "__doc__" in getattr(factory, "__dict__", {})  # a partial tells of itself, or of what it calls
    target = factory.func if hasattr(factory, "func") and not described else factory
    return (target.__doc__ or "").strip().partition("\n")[0]


def _run(argv: list[str]) -> int:
    from bench.request import read_request

    flags, words = _split(argv, ("-m", "--multirun", "--dry-run", "--retry-failed"))
    request = read_request(words, multirun=bool({"-m", "--multirun"} & flags))
    if "--dry-run" in flags:
        return _dry_run(request)
    from bench import stats
    from bench.progress import progress
    from bench.store import ResultStore
    from bench.sweep import carry_out

    with progress() as report:
        outcome = carry_out(request, report, retry_failed="--retry-failed" in flags)
    for path in outcome.aside:
        print(f"a damaged part was set aside as {path}")
    runs = ResultStore(request.folder).runs()
    mine = runs[runs["run_id"].isin(outcome.asked)]
    summary = stats.summary(mine)
    if len(summary) <= _LONG:
        _print_summary(summary)
    else:
        print(f"{len(summary)} cells; `bench report {request.folder}` prints and draws them")
    print(f"{len(outcome.asked)} runs ({outcome.skipped} done before) in {request.folder}/runs.parquet, traces.parquet")
    failed = mine[mine["status"] != "ok"]
    if len(mine) < len(outcome.asked):
        print(f"\n{len(outcome.asked) - len(mine)} runs have no row: their process ended; run the same command again")
        return 1
    if failed.empty:
        return 0
    print(f"\n{len(failed)} failed:")
    columns = ["run_id", "problem", "optimizer", "repetition", "error_type", "error"]
    rows = failed[columns].astype(str).to_numpy().tolist()
    _print_table(columns, [[*row[:-1], " ".join(row[-1].split())[:100]] for row in rows])
    return 1


def _dry_run(request: Any) -> int:
    from bench.store import ResultStore

    store = ResultStore(request.folder)
    done = store.finished() if store.folder.is_dir() else set()
    cells: dict[str, list[bool]] = {}
    for run_id, label in request.labels.items():
        cells.setdefault(label, []).append(run_id in done)
    for label, finished in cells.items():
        print(f"{len(finished):4d} runs, {sum(finished)} done  {label}")
    print(f"{len(request.specs)} runs would go to {request.folder}; nothing was written")
    return 0


def _identify(argv: list[str]) -> int:
    from bedrock.registry import coerce
    from bench.request import build_member
    from problems import identify

    flags, words = _split(argv, ("--json",))
    noise = [w.partition("=")[2] for w in words if w.startswith("noise=")]
    problem = build_member("problem", [w for w in words if not w.startswith("noise=")])
    try:
        sigma = coerce("noise", float(noise[-1]), float) if noise else None
    except ValueError:
        raise ValueError(f"noise={noise[-1]}: a number (rad, or mm for the Orthoglide) is needed") from None
    found = identify(problem, noise=sigma)
    if "--json" in flags:
        print(json.dumps(found.to_dict(), indent=1))
        return 0
    print(f"{problem.name}: {found.sentence()}\n")
    print(f"singular values [{found.noise_unit}/mm]: {'  '.join(f'{s:.3g}' for s in found.singular_values)}\n")
    rows = [
        [name, unit, f"{value:.6g}", f"{error:.3g}" if error < float("inf") else "cannot be found"]
        for name, unit, value, error in zip(found.names, found.units, found.x, found.standard_errors, strict=True)
    ]
    _print_table(["parameter", "unit", "value", f"standard error at {found.noise:g} {found.noise_unit}"], rows)
    return 0


def _status(argv: list[str]) -> int:
    store = _store(argv)
    planned = store.manifest()["planned"]
    finished, damaged = store.finished(), store.damaged()
    runs = store.runs()
    failed = int((runs["status"] != "ok").sum())
    print(f"{store.folder}: {len(finished)} done ({failed} failed), {len(set(planned) - finished)} left")
    left: dict[str, int] = {}
    for run_id, label in planned.items():
        if run_id not in finished:
            left[label] = left.get(label, 0) + 1
    for label, count in left.items():
        print(f"{count:4d} left  {label}")
    return _tell_damaged(damaged, "`bench collect` sets it aside, the same `bench run` does its run again")


def _collect(argv: list[str]) -> int:
    store = _store(argv)
    aside = store.collect()
    print(f"{len(store.collected())} runs in {store.folder}/runs.parquet, traces.parquet")
    return _tell_damaged(aside, "set aside here; nothing else is lost, the same `bench run` does its run again")


def _report(argv: list[str]) -> int:
    from bench import stats
    from bench.report import write_report

    store = _store(argv)
    damaged = store.damaged()
    written = write_report(store)
    _print_summary(stats.summary(store.runs()))
    for finding in _findings(store.folder / "identifiability.csv"):
        print(finding)
    for path in written:
        if path.suffix in (".csv", ".png"):
            print(path)
    return _tell_damaged(damaged, "`bench collect` sets it aside; it is not in the report")


def _show(argv: list[str]) -> int:
    flags, words = _split(argv, ("--json",))
    ids = [w for w in words if not w.startswith("results=")]
    parent = Path(next((w.partition("=")[2] for w in words if w.startswith("results=")), "results"))
    if len(ids) != 1:
        raise ValueError("show: one RUN_ID is needed, such as bench show 3f2a (the first digits suffice)")
    from bench.show import find_run, show_run

    row = find_run(parent, ids[0])
    print(json.dumps(row, indent=1, default=str) if "--json" in flags else show_run(row))
    return 0


def _paper(argv: list[str]) -> int:
    from bedrock.registry import suggest
    from bench.ledger import run_paper
    from bench.progress import progress

    given = {"budget": "ci", "results": "results", "seeds": "", "execution": "joblib"}
    words = list(argv)
    while words:
        key, equals, value = words.pop(0).removeprefix("--").partition("=")
        if key not in given:
            raise ValueError(f"paper: unknown argument {key!r}; {suggest(key, given)}")
        if not equals and words:
            value = words.pop(0)
        if not value:
            raise ValueError(f"paper: {key} needs a value, such as {key}={given[key] or 5}")
        given[key] = value
    budget = int(given["budget"]) if given["budget"].isdigit() else given["budget"]
    with progress() as report:
        ledger = run_paper(budget, given["results"], given["seeds"] or None, given["execution"], report)
    papers = {paper: ledger.counts(paper) for paper in dict.fromkeys(row.paper for row in ledger.rows)}
    for verdict, count in ledger.counts().items():
        print(f"{count:4d}  {verdict} ({', '.join(f'{paper} {of[verdict]}' for paper, of in papers.items())})")
    print("\nsaid or implied, and does not hold:")
    for row in ledger.rows:
        if row.key.startswith("claim.") and row.verdict == "not reproduced":
            print(f"  {row.quantity} ({row.place}): ours {row.ours_median:.3g}, {row.method}")
    for path in ledger.paths:
        print(path)
    if ledger.failed:
        print(f"{ledger.failed} runs failed; their rows say why", file=sys.stderr)
    return 1 if ledger.failed else 0


def _store(argv: list[str]) -> Any:
    from bench.store import ResultStore

    _, words = _split(argv, ())
    if len(words) != 1:
        raise ValueError("one STUDY_DIR is needed, such as results/adhoc")
    store = ResultStore(words[0])
    store.manifest()
    return store


def _split(argv: list[str], known: Iterable[str]) -> tuple[set[str], list[str]]:
    """Return the flags and the other words; an unknown flag is an error."""
    from bedrock.registry import suggest

    flags = {word for word in argv if word.startswith("-")}
    for flag in flags - set(known):
        raise ValueError(f"unknown flag {flag!r}; {suggest(flag, known)}")
    return flags, [word for word in argv if not word.startswith("-")]


def _tell_damaged(paths: list[Path], what: str) -> int:
    for path in paths:
        print(f"bench: {path}: is damaged (not a whole part); {what}", file=sys.stderr)
    return 2 if paths else 0


def _findings(path: Path) -> list[str]:
    """Return, once each, what the problems' data cannot tell."""
    import pandas as pd

    table = pd.read_csv(path) if path.stat().st_size > 1 else pd.DataFrame({"rank": [], "dimension": []})
    lost = table[table["rank"] < table["dimension"]]
    said: dict[str, str] = {}
    for row in lost.to_dict("records"):
        gauge = json.loads(row["problem_options"]).get("gauge", "")
        said.setdefault(f"{row['problem']} {gauge}", f"{row['problem']} (gauge={gauge}): {row['finding']}")
    return list(said.values())


def _print_summary(table: Any) -> None:
    columns = [
        "problem",
        "optimizer",
        "runs",
        "reached",
        "best median",
        "quartiles",
        "evaluations to target",
        "kmrmse*",
    ]
    from bench.stats import method_names, problem_name

    rows = []
    for row in table.assign(optimizer=method_names(table)).to_dict("records"):
        error = json.loads(row["problem_options"]).get("error")
        name = problem_name(row["problem"], row["problem_options"], but=("error",)) + (f" {error}" if error else "")
        rows.append(
            [
                name, row["optimizer"], str(row["runs"]),
                f"{row['reached']}/{row['runs']}" if row["goal"] == row["goal"] else "-",
                f"{row['best_median']:.2e}", f"{row['best_q1']:.1e} .. {row['best_q3']:.1e}",
                f"{row['charged_to_target']:.0f}" if row["charged_to_target"] == row["charged_to_target"] else "-",
                f"{row['kmrmse_aligned_median']:.1e}" if row["kmrmse_aligned_median"] >= 0 else "-",
            ]
        )  # fmt: skip
    _print_table(columns, rows)
    print("reached: the problem's last target (or target=); kmrmse*: mm, median, modulo the gauge\n")


def _print_table(columns: list[str], rows: list[list[str]]) -> None:
    widths = [max(len(str(cell)) for cell in column) for column in zip(columns, *rows, strict=True)]
    for cells in [columns, *rows]:
        print("  ".join(str(cell).ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip())
