"""COCO's folders, as its experiment library logs them and cocopp reads them, written and read: a folder an algorithm.

``bbobexp_f1.info`` lists dimensions and, for each, instance:evaluations|final gap of its runs; ``data_f1/*.dat`` has a
line an improvement, ``.tdat`` a step between them (COCO 2.8, bbob-new2). A gap is above the problem's minimum.
"""

import json
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from math import inf, isfinite
from pathlib import Path
from typing import Any

from calibench.bench.exchange import studies
from calibench.bench.exchange.studies import PublishedRun, RunRecord, Study
from calibench.core.plain import json_of
from calibench.core.words import counted, listed

SUITES = {"bbob": (range(1, 25), (2, 3, 5, 10, 20, 40))}  # functions and dimensions that cocopp has pages for
COMMENT = "% calibench "  # begins the comment of an entry, which cocopp keeps and does not read
NOT_FINITE = 3e21  # what COCO logs instead of an infinite value
PRECISION = 1e-8
_PAIR = re.compile(r"\s*([^,=]+?)\s*=\s*(\".*?\"|'.*?'|[^,]+)\s*(?=,|$)")
_RUN = re.compile(r"(\d+):(\d+)\|(\S+)")
_MINIMUM = re.compile(r"Fopt \(([^)]+)\)")
_KEPT = ("start", "budget", "library", "library_version")  # of what a comment of ours says
_NOISY_FROM = 101  # function numbers of the noisy suite, where no suite is named
_HEADER = (
    "% f evaluations | g evaluations | best noise-free fitness - Fopt ({:.16e}) + sum g_i+ | measured fitness | "
    "best measured fitness or single-digit g-values | x1 | x2...\n"
)


def write_coco(study: Study, folder: Path) -> list[str]:
    """Write the runs of `study` into `folder`; return remarks, a line each."""
    runs = studies.run_records(study)
    foreign = set()
    for run in runs:
        name, options = run.row["problem"], run.options
        function, dimension = options.get("function"), run.row["dimension"]
        functions, dimensions = SUITES.get(name, ((), ()))
        known = function in functions and dimension in dimensions and run.minimum is not None
        if not (known and isinstance(options.get("instance"), int)):
            foreign.add(f"{name} function={function} dimension={options.get('dimension')}" if name in SUITES else name)
    if foreign:
        raise ValueError(
            f"export coco: cocopp has no suite for {listed(sorted(foreign), 5)}; it reads bbob, functions 1 to 24 in "
            "dimensions 2, 3, 5, 10, 20 and 40; ioh takes any problem"
        )
    begun = [run for run in runs if run.row["charged"]]
    names = studies.file_names(sorted({run.algorithm for run in begun}))
    entries: dict[tuple[str, int, int], list[RunRecord]] = defaultdict(list)
    for run in begun:
        entries[run.algorithm, int(run.options["function"]), int(run.row["dimension"])].append(run)
    lines: dict[Path, list[str]] = defaultdict(list)
    for (algorithm, function, dimension), mine in sorted(entries.items()):
        mine.sort(key=lambda run: (run.row["repetition"], run.options["instance"]))
        home = folder / names[algorithm]
        data = f"data_f{function}/bbobexp_f{function}_DIM{dimension}"
        (home / data).parent.mkdir(parents=True, exist_ok=True)
        text = ""  # the lines of each run, the first at evaluation 1 and the last at its end
        for run in mine:
            minimum = run.minimum or 0.0
            rows = [(p.charged, studies.gap_of_value(p.value, minimum, p.reached), p.value) for p in run.course]
            if not rows or rows[0][0] > 1:
                rows.insert(0, (1, NOT_FINITE, NOT_FINITE))
            if rows[-1][0] < run.row["charged"]:
                rows.append((int(run.row["charged"]), *rows[-1][1:]))
            text += _HEADER.format(minimum)
            text += "".join(f"{n} 0 {gap:+.16e} {value:+.16e} {value:+.16e}\n" for n, gap, value in rows)
        for ending in (".dat", ".tdat"):
            (home / f"{data}{ending}").write_text(text, encoding="ascii")
        lines[home / f"bbobexp_f{function}.info"].append(_entry(names[algorithm], function, dimension, data, mine))
    for path, entry in lines.items():
        path.write_text("\n".join(entry) + "\n", encoding="utf-8")
    done = f"{counted(len(begun), 'run')} of {counted(len(names), 'algorithm')}: "
    done += f"cocopp reads {', '.join(names.values())}"
    lost = f"{counted(len(runs) - len(begun), 'run')} without an evaluation left out: COCO has no place for them"
    return [done, lost] if len(begun) < len(runs) else [done]


def _entry(name: str, function: int, dimension: int, data: str, runs: Sequence[RunRecord]) -> str:
    header = {
        "suite": repr("bbob"), "funcId": function, "DIM": dimension, "Precision": f"{PRECISION:.3e}",
        "algId": repr(name), "coco_version": repr("2.8"), "logger": repr("bbob"), "data_format": repr("bbob-new2"),
    }  # fmt: skip
    results = []
    for run in runs:
        last = run.course[-1] if run.course else None
        final = NOT_FINITE if last is None else studies.gap_of_value(last.value, run.minimum or 0.0, last.reached)
        results.append(f"{run.options['instance']}:{run.row['charged']}|{final:.16e}")
    # what the runs of an entry share and for which COCO has no field
    names = ("optimizer", "optimizer_options", "library", "library_version", "start", "budget")
    shared = {name: runs[0].row[name] for name in names if len({run.row[name] for run in runs}) == 1}
    first = ", ".join(f"{key} = {value}" for key, value in header.items())
    return "\n".join([first, COMMENT + json.dumps(shared, sort_keys=True), ", ".join([f"{data}.dat", *results])])


def read_coco(folder: Path) -> list[PublishedRun]:
    """Return the runs in `folder` and the folders below it."""
    paths = sorted(folder.rglob("*.info"))
    if not paths:
        raise ValueError(f"import coco: {folder} has no .info file; name the folder of unpacked COCO data")
    runs: list[PublishedRun] = []
    for path in paths:
        lines = [line for line in studies.text_of_file("coco", path).splitlines() if line.strip()]
        header: dict[str, str] = {}
        columns: dict[str, Any] = {}
        for line in lines:
            if line.startswith(COMMENT):
                try:
                    comment = json_of(line.removeprefix(COMMENT))
                except ValueError:
                    raise ValueError(f"import coco: {path}: its comment {line[:40]!r} is damaged") from None
                columns = comment if isinstance(comment, dict) else {}
            elif line.startswith("%"):
                continue
            elif ".dat" in line and "funcId" not in line and "function =" not in line:
                runs += _read_entry(path, header, columns, line)
            else:
                header, columns = {key: value.strip("'\" ") for key, value in _PAIR.findall(line)}, {}
    if not runs:
        raise ValueError(f"import coco: no run is listed in the .info files of {folder}")
    return runs


def _read_entry(path: Path, header: dict[str, str], columns: dict[str, Any], line: str) -> Iterator[PublishedRun]:
    if "indicator" in header:
        raise ValueError(f"import coco: {path}: has several objectives ({header['indicator']}); there is no one value")
    try:
        function = int(header.get("funcId", header.get("function", "")))
        dimension = int(header.get("DIM", header.get("dim", "")))
    except ValueError:
        raise ValueError(f"import coco: {path}: an entry names no function and dimension") from None
    suite = header.get("suite") or ("bbob" if function < _NOISY_FROM else "bbob-noisy")
    algorithm = header.get("algId") or header.get("algorithm") or path.parent.name
    name, _, rest = line.partition(",")
    data = path.parent / name.strip().replace("\\", "/")
    listed = [(int(instance), int(count)) for instance, count, _ in _RUN.findall(rest)]
    curves = _curves(data, header)
    if len(curves) != len(listed):
        raise ValueError(f"import coco: {data}: has {len(curves)} runs, {path.name} lists {len(listed)}")
    for (instance, count), (minimum, points) in zip(listed, curves, strict=True):
        options = {"function": function, "dimension": dimension, "instance": instance}
        named = studies.named_problem(suite, options, f"{suite}_f{function:03d}_i{instance:02d}_d{dimension:02d}")
        improving: list[tuple[int, float]] = []
        for evaluation, gap in points:
            if isfinite(gap) and gap < min(NOT_FINITE, improving[-1][1] if improving else inf):
                improving.append((evaluation, gap))
        ours = named.minimum  # has all digits; data tell thirteen
        if ours is not None and abs(ours - minimum) > 1e-9 * max(1.0, abs(ours)):
            what = f"the minimum of f{function} in dimension {dimension}, instance {instance}"
            raise ValueError(f"import coco: {data}: {what}, is {minimum:g}; that of our problem is {ours:g}")
        yield PublishedRun(
            algorithm=algorithm, problem=named.problem, problem_options=named.problem_options, data_id=named.data_id,
            dimension=dimension, minimum=minimum if ours is None else ours, improvements=improving, targets=None,
            evaluations=max(count, points[-1][0] if points else 0), best_x=None,
            best=None,  # the index rounds it to two digits
            columns={key: value for key, value in columns.items() if key in _KEPT},
        )  # fmt: skip


def _curves(path: Path, header: dict[str, str]) -> list[tuple[float, list[tuple[int, float]]]]:
    """Return minimum and (evaluation, gap) points of each run, from both files, which complement each other."""
    if not path.is_file():
        raise ValueError(f"import coco: {path}: is named in an .info file and is not there")
    read: list[list[tuple[float, list[tuple[int, float]]]]] = []
    for file in (file for file in (path, path.with_suffix(".tdat")) if file.is_file()):
        curves: list[tuple[float, list[tuple[int, float]]]] = []
        begun = False
        for number, line in enumerate(studies.text_of_file("coco", file).splitlines(), 1):
            if line.startswith("%"):
                if not begun:
                    minimum = _MINIMUM.search(line)
                    curves.append((float(minimum[1] if minimum else header.get("Fopt", "0")), []))
                begun = True
                continue
            begun = False
            columns = line.split()
            if not columns or not curves:
                continue
            try:
                curves[-1][1].append((int(float(columns[0])), float(columns[2])))
            except (ValueError, IndexError):
                raise ValueError(f"import coco: {file}, line {number}: is no line of COCO data") from None
        read.append(curves)
    more = read[-1] if len(read) == 2 and len(read[1]) == len(read[0]) else [(0.0, []) for _ in read[0]]
    return [(least, sorted({*points, *extra})) for (least, points), (_, extra) in zip(read[0], more, strict=True)]
