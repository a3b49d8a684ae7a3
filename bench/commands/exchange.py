"""``bench export FORMAT STUDY_DIR --to OUT``: a study in the format of other tools.

``bench import FORMAT FOLDER --to OUT``: published results as a study of ours.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from calibench.bench.commands.arguments import split_flags, split_to
from calibench.bench.exchange.coco import read_coco
from calibench.bench.exchange.ioh import read_ioh
from calibench.bench.exchange.published import PublishedRun, write_study
from calibench.bench.exchange.studies import Study, read_study, require_free, write_folder
from calibench.core.options import suggest
from calibench.core.words import counted
from calibench.core.words import print_plain as print

_FOLDERS = {
    "coco": "coco:write_coco",
    "ioh": "ioh:write_ioh",
    "csv": "csv_tables:write_csv",
    "latex": "latex:write_latex",
}
FORMATS = (*_FOLDERS, "mlflow")
_READERS: dict[str, Callable[[Path], list[PublishedRun]]] = {"coco": read_coco, "ioh": read_ioh}
_IMPORT_EXAMPLE = "bench import coco BIPOP-CMA-ES --to results/bipop"
_EXPORT_EXAMPLE = "bench export csv results/adhoc --to tables"


def export(argv: list[str]) -> int:
    """Write the study that `argv` names, and print what was written."""
    words, to = split_to("export", argv, _EXPORT_EXAMPLE)
    _, words = split_flags(words, ())
    if len(words) != 2:
        raise ValueError(
            f"export: a format ({', '.join(FORMATS)}) and one STUDY_DIR are needed, such as {_EXPORT_EXAMPLE}"
        )
    name, folder = words
    if name not in FORMATS:
        raise ValueError(f"export: unknown format {name!r}; {suggest(name, FORMATS)}")
    if name == "mlflow":
        from calibench.bench.exchange.mlflow_runs import write_mlflow

        print("\n".join(write_mlflow(read_study(folder), to)))
        return 0
    study, target = read_study(folder), Path(to)
    module, _, function = _FOLDERS[name].partition(":")
    write: Callable[[Study, Path], list[str]] = getattr(import_module(f"calibench.bench.exchange.{module}"), function)
    require_free(target)
    remarks: list[str] = []
    write_folder(target, lambda folder: remarks.extend(write(study, folder)))
    print(f"{target}: " + "\n".join(remarks))
    return 0


def import_study(argv: list[str]) -> int:
    """Make a study of the published runs that `argv` names."""
    words, to = split_to("import", argv, _IMPORT_EXAMPLE)
    _, words = split_flags(words, ())
    if len(words) != 2:
        raise ValueError(
            f"import: a format ({', '.join(_READERS)}) and one FOLDER are needed, such as {_IMPORT_EXAMPLE}"
        )
    name, folder = words[0], Path(words[1])
    if name not in _READERS:
        raise ValueError(f"import: unknown format {name!r}; {suggest(name, _READERS)}")
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
