"""``bench import FORMAT FOLDER --to OUT``: published results as a study of ours."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path

from calibench.bench.commands.arguments import split_flags, split_to
from calibench.bench.exchange.folders import require_free
from calibench.bench.exchange.published.coco import read_coco
from calibench.bench.exchange.published.ioh import read_ioh
from calibench.bench.exchange.published.study import PublishedRun, write_study
from calibench.core.counted import counted
from calibench.core.options import suggest
from calibench.core.words import print_plain as print

_FORMATS: dict[str, Callable[[Path], list[PublishedRun]]] = {"coco": read_coco, "ioh": read_ioh}
_EXAMPLE = "bench import coco BIPOP-CMA-ES --to results/bipop"


def run(argv: list[str]) -> int:
    """Make a study of the published runs that `argv` names."""
    words, to = split_to("import", argv, _EXAMPLE)
    _, words = split_flags(words, ())
    if len(words) != 2:
        raise ValueError(f"import: a format ({', '.join(_FORMATS)}) and one FOLDER are needed, such as {_EXAMPLE}")
    name, folder = words[0], Path(words[1])
    if name not in _FORMATS:
        raise ValueError(f"import: unknown format {name!r}; {suggest(name, _FORMATS)}")
    if not folder.is_dir():
        raise ValueError(f"import: {folder}: there is no such folder; an archive is to be unpacked first")
    require_free(Path(to))
    runs = _FORMATS[name](folder)
    written = write_study(runs, name, folder, Path(to))
    algorithms = sorted({run.algorithm for run in runs})
    print(f"{written}: {counted(len(runs), 'published run')} of {counted(len(algorithms), 'algorithm')}, from {folder}")
    merge = f"bench merge {shlex.quote(str(written))} results/adhoc --to results/both"
    print(f"beside yours: {merge}, then bench report results/both")
    return 0
