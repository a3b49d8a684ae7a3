"""The command of `benchmarks.arms`: ``python -m benchmarks.arms within FOLDER B C D``."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.arms.series import EACH, SERIES, in_runs, series, shuffled


def main() -> None:
    """Print the table that the command line names."""
    parser = argparse.ArgumentParser(prog="benchmarks.arms", description="Measured arms on readings not fitted.")
    parser.add_argument(
        "table", choices=("within", "levels", "runs", "shuffled", "plain", "across", "sockets", "parts", "nested")
    )
    parser.add_argument("folder", type=Path, help="where the authors' files lie")
    parser.add_argument("series", nargs="*", help=f"of {', '.join(SERIES)}; all without one")
    parser.add_argument("--first", type=int, choices=range(EACH), default=0, help="first row that is kept back, from 0")
    parser.add_argument(
        "--poses", type=int, nargs="+", default=(30, 45, 60, 120), help="of `parts` and `nested`: how many are fitted"
    )
    parser.add_argument("--seeds", type=int, default=4, help="of both: how many of every size are drawn")
    parser.add_argument("--from", type=int, default=0, dest="since", help="of both: the first seed")
    parser.add_argument("--folds", type=int, default=5, help="of `nested`: how many parts are left out in turn")
    chosen = parser.parse_args()
    if unknown := sorted(set(chosen.series) - set(SERIES)):
        parser.error(f"{', '.join(unknown)}: no series; choices: {', '.join(SERIES)}")
    if chosen.table == "across":
        from benchmarks.arms.across import rows

        print(*rows(chosen.folder), sep="\n")
        return
    seeds = range(chosen.since, chosen.since + chosen.seeds)
    if chosen.table == "nested":
        from benchmarks.arms.nested import nested, rule, table as signs

        again = []
        for each in nested(chosen.folder, chosen.series or list(SERIES), seeds, chosen.poses, chosen.folds):
            print(each.line, flush=True)
            again.append(each)
        print(signs(again), rule(again), sep="\n")
        return
    if chosen.table == "parts":
        from benchmarks.arms.parts import parts, table

        found = []
        for one in parts(chosen.folder, chosen.series or list(SERIES), seeds, chosen.poses):
            print(one.line, flush=True)
            found.append(one)
        print(table(found))
        return
    if chosen.table == "sockets":
        from benchmarks.arms.sockets import rows as of_sockets

        print(*of_sockets(chosen.folder), sep="\n")
        return
    if chosen.table == "plain":
        from benchmarks.arms.plain import rows as plainly

        for name in chosen.series or SERIES:
            for line in plainly(chosen.folder, name):
                print(line, flush=True)
        return
    if chosen.table == "levels":
        from benchmarks.arms.levels import rows as by_level

        for name in chosen.series or SERIES:
            for line in by_level(chosen.folder, name):
                print(line, flush=True)
        return
    from benchmarks.arms.within import told, within

    for name in chosen.series or SERIES:
        data = series(chosen.folder, name, chosen.first)
        data = shuffled(data) if chosen.table == "shuffled" else data
        for each in in_runs(data) if chosen.table == "runs" else [data]:
            print(*told(each.name, within(each)), sep="\n", flush=True)


if __name__ == "__main__":
    main()
