"""Search stated batches of mounts and deltas: ``python -m tests.independent.mount_delta_run run NAME out.jsonl [0/2]``.

One line an answer; what is in the file already is not searched again. 0/2 takes every second case, from the first, so
that two processes share a batch. ``... score out.jsonl ...`` prints the rates of what the files hold.

A mount's circle off its centre has a phase, and the field two terms for it, of the sine and of the cosine: either
counts. A fault of which the geometry leaves mostly what is off the textbook's form is counted apart, as on the arms.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from calibench.discrepancy import MeasuredData, explain
from tests.independent import delta, mount
from tests.independent.arm6_score import Rate

BATCHES = Path(__file__).parent / "mount_delta_batches.json"
FLOORS = 1.5
OWN = 0.5  # of what is visible, at most off the textbook's form
PHASED = {
    "HCE": ("HCES", "HCEC"), "DCE": ("DCES", "DCEC"), "ACE": ("ACES", "ACEC"), "ECE": ("ECES", "ECEC"),
    "HSxA2": ("HSSA2", "HSCA2"), "HExA2": ("HESA2", "HECA2"),
}  # fmt: skip


def names_of(machine: str, truth: str) -> list[str]:
    """Return what the catalogue calls a fault; no name at all for one of no catalogue."""
    if machine == "delta":
        return [] if truth in delta.FOREIGN else [truth]
    return [] if truth in mount.OUTSIDE else [f"{term} mount" for term in PHASED.get(truth, (truth,))]


def told(machine: str, base: int, k: int) -> dict[str, Any]:
    """Return the k-th case of a base and what was said of it, as plain values."""
    if machine == "mount":
        night = mount.case(k, base=base)
        truth, visible, columns, stated = night.truth, night.visible, night.columns, night.stated
        outside = night.outside
    else:
        printer = delta.case(k, base=base)
        truth, visible, columns, stated = printer.truth or "", printer.visible, printer.columns, printer.metadata
        outside = 0.0
    report = explain(machine, MeasuredData(columns, machine, stated, f"{machine}{k}"))
    return {
        "machine": machine, "base": base, "case": k, "truth": truth, "visible": visible, "outside": outside,
        "verdict": report.verdict,
        "sets": [[rival.effect for rival in finding.set] for finding in report.findings],
        "marked": [bool(finding.form or finding.caution) for finding in report.findings],
        "floors": report.left.times if report.left else None, "seconds": float(report.seconds),
    }  # fmt: skip


def in_a_set(one: dict[str, Any]) -> bool:
    """Return whether a set of the answer holds the fault."""
    return any(name in rivals for rivals in one["sets"] for name in _names(one))


def overstated(one: dict[str, Any]) -> bool:
    """Return whether names stand as the whole of it though more than 1.5 times the floor is left."""
    return one["verdict"] in ("named", "ambiguous") and one["floors"] is not None and one["floors"] > FLOORS


def score(answers: Sequence[dict[str, Any]]) -> list[str]:
    """Return the rates of answers, a line each."""
    nothing, hidden = [one for one in answers if not one["truth"]], [one for one in answers if one["truth"]]
    named = [one for one in hidden if _names(one) and one["visible"] >= 1]
    clear = [one for one in named if one["outside"] <= OWN]
    bent = [one for one in named if one["outside"] > OWN]
    faint = [one for one in hidden if _names(one) and one["visible"] < 1]
    foreign = [one for one in hidden if not _names(one) and one["visible"] >= 1]
    verdicts = [one["verdict"] for one in foreign]
    holding = [rivals for one in clear for rivals in one["sets"] if set(rivals) & set(_names(one))]
    lines = [
        _rate("truth in a set, visible >= 1", map(in_a_set, clear)),
        _rate("truth in a set, visible >= 1, mostly off its form", map(in_a_set, bent)),
        _rate("truth in a set, visible < 1", map(in_a_set, faint)),
        _rate("truth in the first set, visible >= 1", (in_a_set({**one, "sets": one["sets"][:1]}) for one in clear)),
        _rate("alarm where nothing is missing", (one["verdict"] != "none" for one in nothing)),
        _rate("names as the whole above 1.5 floors", map(overstated, answers)),
    ]  # fmt: skip
    return [
        *map(str, lines),
        f"mean set that holds the truth: {sum(map(len, holding)) / max(len(holding), 1):.2f} of {len(holding)}",
        "no catalogue, visible >= 1: "
        + ", ".join(f"{verdicts.count(v)} {v}" for v in sorted(set(verdicts)))
        + f" of {len(verdicts)}",
    ]


def batches() -> list[dict[str, Any]]:
    """Return the batches that were stated."""
    return json.loads(BATCHES.read_text())  # type: ignore[no-any-return]


def main(verb: str, *words: str) -> None:
    """Search a batch, or score files of answers."""
    if verb == "score":
        print(*score([json.loads(line) for file in words for line in Path(file).read_text().splitlines()]), sep="\n")
        return
    name, file, *part = words
    [batch] = [one for one in batches() if one["name"] == name]
    first, each = (int(word) for word in part[0].split("/")) if part else (0, 1)
    out = Path(file)
    known = {json.loads(line)["case"] for line in out.read_text().splitlines()} if out.exists() else set()
    with out.open("a") as lines:
        for k in range(batch["first"] + first, batch["last"] + 1, each):
            if k not in known:
                print(json.dumps(told(batch["machine"], batch["base"], k)), file=lines, flush=True)


def _names(one: dict[str, Any]) -> list[str]:
    return names_of(one["machine"], one["truth"])


def _rate(what: str, hits: Iterable[bool]) -> Rate:
    seen = list(hits)
    return Rate(what, sum(seen), len(seen))


if __name__ == "__main__":
    main(*sys.argv[1:])
