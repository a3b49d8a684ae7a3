"""How often a change point is seen: ``python -m benchmarks.tracking.false_alarms OUT.jsonl [CASES [SCENARIO]]``.

A line a case as it comes; a second call goes on. Each scenario draws its cases from its own seeds, 0 to CASES - 1.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.bench.tracking.history import change_point

Array = NDArray[np.float64]
Draw = Callable[[np.random.Generator, int, int], Array]


def alike(rng: np.random.Generator, epochs: int, runs: int) -> Array:
    """Return scores of epochs that differ by chance alone, shape (epochs, runs)."""
    return rng.lognormal(sigma=2.0, size=(epochs, runs))


def started_alike(rng: np.random.Generator, epochs: int, runs: int) -> Array:
    """Return the same, where the start of a repetition decides most of its score."""
    return rng.lognormal(sigma=0.5, size=(epochs, runs)) * rng.lognormal(sigma=3.0, size=runs)


def tied(rng: np.random.Generator, epochs: int, runs: int) -> Array:
    """Return scores of which two thirds are the same, such as runs that never reach the goal."""
    return np.where(rng.random((epochs, runs)) < 2 / 3, np.inf, rng.random((epochs, runs)))


def partly_kept(rng: np.random.Generator, epochs: int, runs: int) -> Array:
    """Return scores where each change of the code leaves half of the runs as they were."""
    scores = rng.lognormal(size=(epochs, runs))
    for k in range(1, epochs):
        kept = rng.random(runs) < 0.5
        scores[k, kept] = scores[k - 1, kept]
    return scores


def slower(rng: np.random.Generator, epochs: int, runs: int) -> Array:
    """Return scores that are three times as large from the middle on: a change to be found."""
    scores = rng.lognormal(sigma=0.8, size=(epochs, runs))
    scores[epochs // 2 :] *= 3.0
    return scores


SCENARIOS: dict[str, Draw] = {
    "alike": alike, "started_alike": started_alike, "tied": tied, "partly_kept": partly_kept, "slower": slower,
}  # fmt: skip
SIZES = ((2, 10), (4, 10), (10, 10), (10, 5), (20, 10))


def main(out: Path, cases: int, only: str = "") -> None:
    done = {tuple(json.loads(line)["case"]) for line in out.read_text().splitlines()[1:]} if out.exists() else set()
    with out.open("a") as file:
        if not done:
            print(json.dumps({"cases": cases, "sizes": SIZES, "scenarios": list(SCENARIOS), "level": 0.05}), file=file)
        for number, (name, draw) in enumerate(SCENARIOS.items()):
            if only not in ("", name):
                continue
            for epochs, runs in SIZES:
                for seed in range(cases):
                    case = (name, epochs, runs, seed)
                    if case in done:
                        continue
                    values = draw(np.random.default_rng([number, epochs, runs, seed]), epochs, runs)
                    parts = [np.column_stack([row, np.zeros(runs)]) for row in values]
                    kept = np.vstack([np.zeros(runs, dtype=bool), values[1:] == values[:-1]])
                    kept &= np.isfinite(values)  # goals that two runs missed are no run that was kept
                    at, p, worse = change_point(parts, [list(range(runs))] * epochs, kept, seed)
                    row: dict[str, Any] = {"case": case, "at": at, "p": p, "worse": worse}
                    print(json.dumps(row), file=file, flush=True)
    tell(out)


def tell(out: Path) -> None:
    """Print the share of alarms of each scenario and size."""
    groups: dict[tuple[str, int, int], list[dict[str, Any]]] = {}
    for line in out.read_text().splitlines()[1:]:
        row = json.loads(line)
        groups.setdefault(tuple(row["case"][:3]), []).append(row)
    for (name, epochs, runs), rows in groups.items():
        alarms = [row for row in rows if row["p"] <= 0.05]
        right = sum(row["at"] == epochs // 2 for row in alarms)
        print(f"{name:14s} {epochs:3d} epochs {runs:3d} runs: {len(alarms)}/{len(rows)} alarms, {right} at the middle")


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 500, *sys.argv[3:4])
