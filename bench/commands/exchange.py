"""``bench export FORMAT STUDY_DIR --to OUT``: a study in the format of other tools.

``bench import FORMAT FOLDER --to OUT``: published results as a study of ours.
"""

import shlex
from collections.abc import Callable
from pathlib import Path

from calibench.bench.exchange.coco import read_coco, write_coco
from calibench.bench.exchange.ioh import read_ioh, write_ioh
from calibench.bench.exchange.studies import PublishedRun, Study, read_study, require_free, write_folder, write_study
from calibench.bench.exchange.tables import write_csv, write_latex
from calibench.bench.words import split_flags, split_word
from calibench.core.options import suggest
from calibench.core.words import counted, print_plain as print

_WRITERS: dict[str, Callable[[Study, Path], list[str]]] = {
    "coco": write_coco, "ioh": write_ioh, "csv": write_csv, "latex": write_latex,
}  # fmt: skip
FORMATS = (*_WRITERS, "mlflow")
_READERS: dict[str, Callable[[Path], list[PublishedRun]]] = {"coco": read_coco, "ioh": read_ioh}


def export(argv: list[str]) -> int:
    name, folder, to = _asked("export", argv, FORMATS, "STUDY_DIR", "bench export csv results/adhoc --to tables")
    if name == "mlflow":
        from calibench.bench.exchange.mlflow_runs import write_mlflow

        print("\n".join(write_mlflow(read_study(folder), to)))
        return 0
    study, target = read_study(folder), Path(to)
    require_free(target)
    remarks: list[str] = []
    write_folder(target, lambda folder: remarks.extend(_WRITERS[name](study, folder)))
    print(f"{target}: " + "\n".join(remarks))
    return 0


def import_study(argv: list[str]) -> int:
    example = "bench import coco BIPOP-CMA-ES --to results/bipop"
    name, source, to = _asked("import", argv, tuple(_READERS), "FOLDER", example)
    folder = Path(source)
    if not folder.is_dir():
        raise ValueError(f"import: {folder}: there is no such folder; an archive is to be unpacked first")
    require_free(Path(to))
    runs = _READERS[name](folder)
    written = write_study(runs, name, folder, Path(to))
    algorithms = sorted({run.algorithm for run in runs})
    print(f"{written}: {counted(len(runs), 'published run')} of {counted(len(algorithms), 'algorithm')}, from {folder}")
    merge = f"bench merge {shlex.quote(str(written))} results/adhoc --to results/both"
    print(f"beside yours: {merge}, then bench report results/both")
    return 0


def _asked(verb: str, argv: list[str], formats: tuple[str, ...], what: str, example: str) -> tuple[str, str, str]:
    to, rest = split_word(argv, "--to")
    if not to or "--to" in rest:
        raise ValueError(f"{verb}: one --to OUT is needed, such as {example}")
    words = split_flags(rest, ())[1]
    if len(words) != 2:
        raise ValueError(f"{verb}: a format ({', '.join(formats)}) and one {what} are needed, such as {example}")
    if words[0] not in formats:
        raise ValueError(f"{verb}: unknown format {words[0]!r}; {suggest(words[0], formats)}")
    return words[0], words[1], to[0]
