"""``bench report STUDY_DIR``: the tables, figures and page of a study; the last ones, where nothing has changed."""

import sys
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path

from calibench.bench.report.shared.kept import Kept
from calibench.core.words import print_plain as print

_SHOWN = (".csv", ".png", ".html")  # whose paths are printed


def report(argv: list[str]) -> int:
    """Write the report, or print once more what the last one printed, where it was made from the same."""
    if len(argv) == 1:
        folder = Path(argv[0])
        kept = Kept.read(folder)
        if kept.is_current(folder):
            sys.stdout.write(kept.text)
            print(*(folder / name for name in kept.written if name.endswith(_SHOWN)), sep="\n")
            print("nothing has changed since these were written")
            return 0
    import pandas as pd  # a second, with what follows

    from calibench.bench.commands.cells import print_summary
    from calibench.bench.commands.study import store_of, tell_damaged
    from calibench.bench.papers import ADDITIONS
    from calibench.bench.report.study.write import finished_runs, report_progress, write_report
    from calibench.bench.statistics.cells import mixed_code
    from calibench.bench.statistics.names import problem_titles

    store = store_of(argv)
    damaged, finished = store.damaged(), finished_runs(store)
    with report_progress() as tell:
        written = write_report(store, ADDITIONS, tell, finished)
    with redirect_stdout(StringIO()) as printed:
        print_summary(finished.summary.to_dict("list"))
        if warning := mixed_code(finished.runs):
            print(warning)
        # what the data cannot determine, once for each problem whatever its error function
        identifiability = store.folder / "identifiability.csv"
        if identifiability.exists():
            table = pd.read_csv(identifiability, keep_default_na=False)
            lost = table[table["rank"] < table["dimension"]]
            titles = problem_titles(lost, but=("error",))
            once = ~titles.duplicated()
            for title, finding in zip(titles[once], lost.loc[once, "finding"], strict=True):
                print(f"{title}: {finding}")
    sys.stdout.write(printed.getvalue())
    print(*(path for path in written if path.suffix in _SHOWN), sep="\n")
    if not damaged and not finished.manifest.get("files"):  # of classes of one's own the page may tell more, or less
        replace(Kept.read(store.folder), text=printed.getvalue()).write(store.folder)
    return tell_damaged(damaged, "`bench collect` sets it aside; it is not in the report")
