"""``python -m benchmarks peers [--only TABLE ...]``: what peers take for the same work, in turns, in one run.

Each peer has an environment of its own, made here from pinned requirements, and a small script (`tools/NAME_peer.py`)
that does its lines of the tables. A peer that cannot be installed, and a line that fails, stay in the table with the
error. Rows are kept as Parquet, a file a table; the page is written from these files, so a part updates it.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.peers import environments
from benchmarks.peers.asking import Staying, Taken, ToolError, once
from benchmarks.peers.data import prepared
from benchmarks.peers.environments import Environment
from benchmarks.peers.measured_page import page
from benchmarks.peers.turns import Contestant, take_turns

_POSES = {"error": "J2", "plan": "disc", "n": 300, "noise": 0.0}


@dataclass(frozen=True)
class Table:
    """A table: how often its lines take turns, whether tools stay between rounds, and what they are given to do."""

    name: str
    title: str
    rounds: int
    stays: bool
    work: Mapping[str, Any] = field(default_factory=dict)
    group: str = ""
    homes: bool = False  # a second table, each line in a home where nothing is kept yet


TABLES = (
    Table("counting", "counting one evaluation: what is added to a call of the compiled objective", 9, True),
    Table("de", "an evaluation inside differential evolution, population 150", 5, True, group="optimisers"),
    Table("pso", "an evaluation inside a particle swarm, 100 particles", 5, True, group="optimisers"),
    Table("ga", "an evaluation inside a genetic algorithm, population 100", 5, True, group="optimisers"),
    Table("cmaes", "an evaluation inside CMA-ES, population 100", 5, True, group="optimisers"),
    Table("noise_level", "from the nominal parameters to the level of the noise", 3, True, group="quality"),
    Table("sweep", "one of 1000 small runs, from command to table", 3, False, {"runs": 1000, "budget": 60}),
    Table("plot", "from the shell to the first plot", 3, False, {"budget": 600}, homes=True),
    Table("report", "a report of 10 000 runs", 3, False),
    Table("calibration", "calibrating the planar robot from 300 poses", 7, True, {"options": _POSES}),
    Table("arm", "calibrating an arm of six joints from 300 poses", 5, True),
    Table("arms", "calibrating three makers' arms from 120 places each", 1, True),
    Table("hand_eye", "a camera on a hand from 40 pairs of poses", 5, True, group="cameras"),
    Table("hand_eye_wild", "the same, four of the pairs wrong by 30 mm on each axis", 5, True, group="cameras"),
    Table("reading", "reading a run into pandas", 3, False),
)


def main(words: Sequence[str]) -> None:
    """Measure the tables asked for, keep their rows, write the page."""
    groups = list(dict.fromkeys(table.group or table.name for table in TABLES))
    parser = argparse.ArgumentParser(prog="python -m benchmarks peers", description=__doc__)
    parser.add_argument("--only", nargs="+", metavar="TABLE", help=f"of {', '.join(groups)}; all without it")
    parser.add_argument("--tools", nargs="+", metavar="PEER", default=None, help="these peers and no others")
    parser.add_argument("--rounds", type=int, default=None, help="instead of each table's own number")
    parser.add_argument(
        "--out", type=Path, default=Path("results/benchmarks/peers"), help="folder of the Parquet files"
    )
    parser.add_argument("--environments", type=Path, default=Path("results/benchmarks/environments"))
    parser.add_argument("--page", type=Path, default=Path("docs/peers-measured.md"))
    asked = parser.parse_args(words)
    chosen = [table for table in TABLES if asked.only is None or (table.group or table.name) in asked.only]
    if unknown := sorted(set(asked.only or ()) - set(groups)):
        parser.error(f"{', '.join(unknown)}: no table; choices: {', '.join(groups)}")
    if unknown := sorted(set(asked.tools or ()) - set(environments.peers())):
        parser.error(f"{', '.join(unknown)}: no peer; choices: {', '.join(environments.peers())}")
    for folder in (asked.out, asked.environments):
        folder.mkdir(parents=True, exist_ok=True)
    tools = [environments.ours()]
    for name in asked.tools or environments.peers():
        tools.append(environments.build(name, asked.environments.resolve()))
        print(f"{tools[-1].version}: {tools[-1].error or 'installed'}", flush=True)
    for table in chosen:
        rows = measure(table, tools, asked.rounds or table.rounds, asked.out.resolve() / "data")
        print(rows[["benchmark", "line", "cpu_ns", "ratio", "rounds", "error"]].to_string(index=False), flush=True)
        rows.to_parquet(asked.out / f"{table.name}.parquet", index=False)
    kept = [asked.out / f"{table.name}.parquet" for table in TABLES]
    asked.page.write_text(page([pd.read_parquet(file) for file in kept if file.exists()]))


def measure(table: Table, tools: Sequence[Environment], rounds: int, data: Path) -> pd.DataFrame:
    """Return the rows of one table, with when, where and beside what load they were measured."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    with tempfile.TemporaryDirectory() as scratch, _staying(tools) as processes:
        lines = _lines(table, tools, processes)
        work = {**table.work, **prepared(table.name, {name: tool for name, (tool, _) in lines.items()}, data)}
        takes = {name: _take(table, tool, name, processes, work, Path(scratch)) for name, (tool, _) in lines.items()}
        turns = partial(take_turns, rounds=rounds, warm=table.stays, tell=partial(print, flush=True))
        contestants = {
            name: Contestant(tool.version, None if error else takes[name], error)
            for name, (tool, error) in lines.items()
        }
        rows = [turns(table.title, contestants)]
        if table.homes:
            first = {
                name: Contestant(
                    tool.version,
                    None if error else partial(_in_a_new_home, table, tool, name, work, Path(scratch)),
                    error,
                )
                for name, (tool, error) in lines.items()
            }
            rows.append(turns(f"{table.title}, the first time ever", first, rounds=1))
    told = pd.concat(rows, ignore_index=True)
    after = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    return told.assign(
        table=table.group or table.name, load_before=load, load_after=after,
        date=datetime.now(UTC).strftime("%Y-%m-%d"), machine=_machine(),
    )  # fmt: skip


def _lines(
    table: Table, tools: Sequence[Environment], processes: Mapping[str, Staying]
) -> dict[str, tuple[Environment, str]]:
    """Return the lines of a table: who does each, and why it cannot be done, where it cannot."""
    lines: dict[str, tuple[Environment, str]] = {}
    for tool in tools:
        if tool.error:
            lines[tool.tool] = tool, f"cannot be installed: {tool.error}"
            continue
        try:
            offered = processes[tool.tool].ask({"table": None})["lines"].get(table.name, [])
        except ToolError as error:
            lines[tool.tool] = tool, str(error)
            continue
        lines |= {name: (tool, "") for name in offered}
    return lines


def _take(
    table: Table, tool: Environment, line: str, processes: Mapping[str, Staying], work: Mapping[str, Any], scratch: Path
) -> Callable[[], Taken]:
    numbers = count()

    def take() -> Taken:
        with _folder(scratch / f"{tool.tool}{next(numbers)}") as folder:
            request = {"table": table.name, "line": line, "work": {**work, "folder": str(folder)}}
            return processes[tool.tool].take(request) if table.stays else once(tool, request)

    return take


def _in_a_new_home(table: Table, tool: Environment, line: str, work: Mapping[str, Any], scratch: Path) -> Taken:
    """Do a line where no compiled code, no list of fonts and nothing else is kept from before."""
    with _folder(scratch / "work") as folder, _folder(scratch / "home") as home:
        return once(tool, {"table": table.name, "line": line, "work": {**work, "folder": str(folder)}}, home)


@contextmanager
def _folder(path: Path) -> Iterator[Path]:
    path.mkdir(parents=True)
    try:
        yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)


@contextmanager
def _staying(tools: Sequence[Environment]) -> Iterator[dict[str, Staying]]:
    processes = {tool.tool: Staying(tool) for tool in tools}
    try:
        yield processes
    finally:
        for process in processes.values():
            process.end()


def _machine() -> str:
    from benchmarks.__main__ import processor

    return f"{processor()}, {os.cpu_count()} cores"
