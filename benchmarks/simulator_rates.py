"""How often the search names what was hidden in measurements of a simulated arm: `machine=simulator` on unseen cases.

    python -m benchmarks.simulator_rates --cases 100 --first 940000 --to rates.jsonl

The simulator is that of docs/my-simulator.md; the machine that is measured is integrated here, by another method, with
what that simulator lacks: Coulomb friction, encoders that are read late, a payload that nobody entered, an encoder's
scale, two of these, nothing, or what no family of effects can say (a stiffening drive, crosstalk of the drives, drag
that grows with the square of the speed). A line a case; a run that is begun again goes on. The first line states seeds.
"""

import argparse
import json
import re
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibench.discrepancy import MeasuredData, Report, explain, machines

Array = NDArray[np.float64]
KNOWN = ("friction_1", "friction_2", "late", "payload", "scale_1", "scale_2")
FOREIGN = ("stiffening", "crosstalk", "drag")
NAMES = {
    "friction_1": "backlash goal_1", "friction_2": "backlash goal_2", "late": "input_offset t",
    "payload": "parameter_over payload over box", "scale_1": "instrument_scale q1", "scale_2": "instrument_scale q2",
}  # fmt: skip
LARGEST = {
    "friction_1": 0.8, "friction_2": 0.08, "late": 0.008, "payload": 0.15, "scale_1": 0.02, "scale_2": 0.02,
    "stiffening": 2.0, "crosstalk": 0.08, "drag": 2.0,
}  # fmt: skip
NOISE, ROWS, STEPS = 1e-3, 240, 3000


@dataclass(frozen=True)
class Case:
    """What was hidden, name -> size, and the class of the case."""

    kind: str
    hidden: dict[str, float]


def drawn(rng: np.random.Generator) -> Case:
    """Return a case: nothing in a fifth of all, one effect in two fifths, two in a fifth, a foreign one in a fifth."""
    part = rng.uniform()
    if part < 0.2:
        return Case("nothing", {})
    if part < 0.8:
        names = rng.choice(KNOWN, 1 if part < 0.6 else 2, replace=False)
        kind = "one" if len(names) == 1 else "two"
    else:
        names, kind = rng.choice(FOREIGN, 1), "foreign"
    sizes = rng.uniform(0.3, 1.0, len(names))
    return Case(kind, {str(n): float(s) * LARGEST[str(n)] for n, s in zip(names, sizes)})


def measured(rng: np.random.Generator, hidden: dict[str, float]) -> dict[str, Array]:
    """Return the columns of a file: moves of an arm in a plane, by small Euler steps."""
    m1, m2, length = 2.0, 1.0, 0.4
    b, k = 20.0 * rng.uniform(0.85, 1.15), 100.0 * rng.uniform(0.85, 1.15)
    start = rng.uniform([-1.0, -1.5], [1.0, 1.5], (ROWS, 2)).T
    goal = start + rng.uniform(0.2, 0.6, (2, ROWS)) * rng.choice([-1, 1], (2, ROWS))
    t, box = rng.uniform(0.1, 0.8, ROWS), rng.integers(0, 2, ROWS).astype(float)
    tip = hidden.get("payload", 0.0) * box
    q, w, h = start.copy(), np.zeros_like(start), (t + hidden.get("late", 0.0)) / STEPS
    strength = np.array([[1.0], [0.1]])
    coulomb = np.array([[hidden.get("friction_1", 0.0)], [hidden.get("friction_2", 0.0)]])
    for _ in range(STEPS):
        behind = goal - q
        torque = strength * (k * behind * (1 + hidden.get("stiffening", 0.0) * behind**2) - b * w)
        torque = torque - coulomb * np.tanh(w / 1e-3) - strength * hidden.get("drag", 0.0) * w * np.abs(w)
        torque[0] += hidden.get("crosstalk", 0.0) * torque[1] * 10
        bent = (m2 / 2 + tip) * length**2 * np.sin(q[1])
        right = torque + np.stack([bent * (2 * w[0] * w[1] + w[1] ** 2), -bent * w[0] ** 2])
        far = (m2 / 3 + tip) * length**2
        near = far + (m2 / 2 + tip) * length**2 * np.cos(q[1])
        all_ = (m1 / 3 + m2 + tip) * length**2 + 2 * near - far
        w = w + h * np.stack([far * right[0] - near * right[1], all_ * right[1] - near * right[0]]) / (
            all_ * far - near**2
        )
        q = q + h * w
    q = q * np.array([[1 + hidden.get("scale_1", 0.0)], [1 + hidden.get("scale_2", 0.0)]])
    q = q + NOISE * rng.standard_normal(q.shape)
    side = np.sign(goal - start)
    columns = [*start, *goal, *side, t, box, *q]
    heads = ["start_1", "start_2", "goal_1", "goal_2", "goal_1_dir", "goal_2_dir", "t", "box", "q1", "q2"]
    return dict(zip(heads, columns, strict=True))


def scored(seed: int, simulator: str) -> dict[str, object]:
    """Return what the search said of the case of a seed, beside what was hidden."""
    rng = np.random.default_rng(seed)
    case = drawn(rng)
    columns: dict[str, NDArray[np.generic]] = {**measured(rng, case.hidden)}
    columns["split"] = np.where(np.arange(ROWS) % 3 == 0, "hold", "train")
    began = time.perf_counter()
    report: Report = explain(
        machines.make("simulator", call=simulator), MeasuredData(columns, "simulator", {}, f"case_{seed}")
    )
    sets = [[rival.effect for rival in finding.set] or [finding.effect] for finding in report.findings]
    truths = [NAMES[name] for name in case.hidden if name in NAMES]
    gap = report.gap
    return {
        "seed": seed, **asdict(case), "verdict": report.verdict, "sets": sets,
        "right": all(any(truth in names for names in sets) for truth in truths) if truths else None,
        "before": gap.held_out_before, "after": gap.held_out_after, "floor": gap.noise_floor,
        "closed": gap.excess_shrink, "seconds": time.perf_counter() - began,
    }  # fmt: skip


def summary(lines: list[dict[str, object]]) -> str:
    """Return the counts by the kind of a case."""
    said = []
    for kind in ("nothing", "one", "two", "foreign"):
        own = [line for line in lines if line["kind"] == kind]
        verdicts = {
            v: sum(line["verdict"] == v for line in own) for v in sorted({str(line["verdict"]) for line in own})
        }
        right = [line for line in own if line["right"]]
        closed = [float(str(line["closed"])) for line in own if line["closed"] is not None and kind != "nothing"]
        middle = f", gap closed {np.nanmedian(closed):.3f} in the median" if closed else ""
        said.append(f"{kind}: {len(own)}; {verdicts}; every hidden name in a set: {len(right)}{middle}")
    return "\n".join(said)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--first", type=int, default=940000)
    parser.add_argument("--to", type=Path, default=Path("simulator_rates.jsonl"))
    asked = parser.parse_args()
    page = (Path(__file__).resolve().parent.parent / "docs" / "my-simulator.md").read_text()
    [code] = re.findall(r"```python arm.py\n(.*?)```", page, re.DOTALL)
    head = {"seeds": [asked.first, asked.first + asked.cases - 1], "rows": ROWS, "noise": NOISE}
    asked.to.parent.mkdir(parents=True, exist_ok=True)
    if not asked.to.exists():
        asked.to.write_text(json.dumps(head) + "\n")
    known = {json.loads(line)["seed"] for line in asked.to.read_text().splitlines()[1:]}
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "arm.py").write_text(code)
        for seed in (s for s in range(asked.first, asked.first + asked.cases) if s not in known):
            line = scored(seed, f"{folder}/arm.py:move")
            with asked.to.open("a") as file:
                file.write(json.dumps(line) + "\n")
    print(summary([json.loads(line) for line in asked.to.read_text().splitlines()[1:]]))


if __name__ == "__main__":
    main()
