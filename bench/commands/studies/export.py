"""``bench export FORMAT STUDY_DIR --to OUT``: a study in the format of other tools."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from calibench.bench.commands.arguments import split_flags, split_to
from calibench.bench.exchange.folders import require_free, write_folder
from calibench.bench.exchange.studies import Study, read_study
from calibench.core.options import suggest
from calibench.core.words import print_plain as print

_FOLDERS = {
    "coco": "coco:write_coco",
    "ioh": "ioh:write_ioh",
    "csv": "csv_tables:write_csv",
    "latex": "latex:write_latex",
}
FORMATS = (*_FOLDERS, "mlflow")
_EXAMPLE = "bench export csv results/adhoc --to tables"


def run(argv: list[str]) -> int:
    """Write the study that `argv` names, and print what was written."""
    words, to = split_to("export", argv, _EXAMPLE)
    _, words = split_flags(words, ())
    if len(words) != 2:
        raise ValueError(f"export: a format ({', '.join(FORMATS)}) and one STUDY_DIR are needed, such as {_EXAMPLE}")
    name, folder = words
    if name not in FORMATS:
        raise ValueError(f"export: unknown format {name!r}; {suggest(name, FORMATS)}")
    if name == "mlflow":
        from calibench.bench.exchange.mlflow_runs import write_mlflow

        said = write_mlflow(read_study(folder), to)
    else:
        said = _to_folder(_FOLDERS[name], read_study(folder), Path(to))
    print("\n".join(said))
    return 0


def _to_folder(where: str, study: Study, target: Path) -> list[str]:
    module, _, function = where.partition(":")
    write: Callable[[Study, Path], list[str]] = getattr(import_module(f"calibench.bench.exchange.{module}"), function)
    require_free(target)
    said: list[str] = []
    write_folder(target, lambda folder: said.extend(write(study, folder)))
    return [f"{target}: {said[0]}", *said[1:]]
