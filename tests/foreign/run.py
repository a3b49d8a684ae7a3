"""Batches of foreign cases: ``python -m tests.foreign.run run foreign 910000 910060 OUT.jsonl``; ``score OUT.jsonl``.

Kinds are ``foreign`` (a cause of no catalogue), ``off_form`` (one of the catalogue in another form) and ``sound``. A
last word, as 300:10000, is how many readings a case has, drawn evenly over their logarithm; else 200 to 400. The first
line of a file states kind and seeds before a case is drawn; what is in the file already is not searched again. `score`
prints rates with Wilson's intervals. A foreign cause is *plainly named* where the verdict is named or ambiguous and a
finding has no caution (`strict`), and neither a caution nor a form that differs.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tests.foreign.causes import FOREIGN, OFF_FORM, noise
from tests.foreign.machines import MACHINES, Array, Machine

VISIBLE = (1.0, 6.0)
LEAST = 0.1  # of a cause must be left by calibration: of less, nothing but the error of a form is seen
FORM = 0.15  # a draw of which one textbook form leaves less is that form, as real ones are
LAWS = {"foreign": ("gauss", "gauss", "t4"), "off_form": ("gauss", "gauss", "t4"),
        "sound": ("gauss", "gauss", "t3", "t4", "mixed", "carried", "patchy")}  # fmt: skip
NOISE = {"outlier", "heavy_tails", "quantisation"}
HARMONIC = {"eccentricity", "angle_error", "second_harmonic", "periodic_error", "second_periodic_error"}
NAMES = {  # names of the catalogue for a cause off its form
    "eccentricity": HARMONIC, "cyclic": {"cyclic"}, "compliance": {"compliance", "proximal_bending"},
}  # fmt: skip
SKY = {"az": {"ACES", "ACEC", *HARMONIC}, "el": {"ECES", "ECEC", "TF", *HARMONIC}}


@dataclass(frozen=True)
class Case:
    """A file, and the truth: the cause, the joint it sits on, and what calibration leaves of it, rms in sigma.

    `near` is the part of that which the nearest textbook form on the joint leaves: near 0 the draw is that form.
    """

    machine: Machine
    columns: dict[str, Any]
    cause: str
    joint: str
    visible: float
    law: str
    near: float


def case(kind: str, seed: int, *, cause: str = "", machine: str = "", rows: int = 0, visible: float = 0.0) -> Case:
    """Draw the case of `seed`; what is asked for is fixed."""
    rng = np.random.default_rng(np.random.SeedSequence([20261128, seed]))
    name = str(rng.choice(list(MACHINES)))
    m = MACHINES[machine or name](rng, rows or int(rng.integers(200, 401)))
    law = str(rng.choice(LAWS[kind]))
    unit = noise(rng, m.day, m.draws, law)
    pool = {"foreign": FOREIGN, "off_form": OFF_FORM[m.name], "sound": {}}[kind]
    angle, push = np.zeros_like(m.day.q), np.zeros((len(m.day.t), m.push.shape[-1]))
    goal = visible or float(np.exp(rng.uniform(*np.log(VISIBLE))))
    joint, seen, near = 0, 0.0, 1.0
    names = list(pool)
    for _ in range(60 if pool else 0):
        drawn, joint = cause or str(rng.choice(names)), int(rng.integers(0, m.day.q.shape[1]))
        if m.name == "arm" and joint == 5 and drawn != "flex":
            continue  # the last joint of an arm moves next to nothing
        one, other = pool[drawn](m, rng, joint)
        rms = float(np.sqrt(np.mean(m.left(one, other) ** 2)))
        whole = np.einsum("ncj,nj->nc", m.angle, one) + np.einsum("ncd,nd->nc", m.push, other)
        if rms > 0.1 * float(
            np.sqrt(np.mean(whole**2))
        ):  # else calibration takes it away, and its form is all that is seen
            angle, push, seen, cause = one * goal / rms, other * goal / rms, goal, drawn
            near = _near(m, m.left(one, other), joint)
            break
    return Case(m, m.table(angle, push, unit), cause if seen else "", m.joints[joint] if seen else "", seen, law, near)


def _near(m: Machine, left: Array, joint: int) -> float:
    """Return the part of what is seen that the nearest of the textbook's forms on one joint leaves, in size."""
    day, q = m.day, m.day.q[:, joint]
    forms = [[q], [day.run], [day.warmth], [day.came[:, joint]], [day.torque[:, joint]], [day.speed[:, joint]]]
    forms += [[np.sin(k * q), np.cos(k * q)] for k in (1, 2)]
    none, shares = np.zeros((len(q), m.push.shape[-1])), []
    for form in forms:
        columns = []
        for values in form:
            angle = np.zeros_like(day.q)
            angle[:, joint] = values
            columns.append(m.left(angle, none))
        A = np.stack(columns, axis=1)
        rest = left - A @ np.linalg.lstsq(A, left, rcond=None)[0]
        shares.append(float(np.linalg.norm(rest) / np.linalg.norm(left)))
    return min(shares)


def handed(drawn: Case, folder: Path, name: str = "data") -> tuple[Any, Any]:
    """Return the machine and the data of a case as `explain` takes them; files of the machine go into `folder`."""
    from calibench.discrepancy import MeasuredData
    from calibench.discrepancy.machines.arm import Arm

    m = drawn.machine
    for file, text in m.files.items():
        (folder / file).write_text(text)
    machine: Any = Arm(str(folder / "arm.urdf")) if m.name == "arm" else m.name
    return machine, MeasuredData(drawn.columns, m.name, dict(m.stated), name)


def told(kind: str, seed: int, **asked: Any) -> dict[str, Any]:
    """Return what is said of a case, and its truth, as plain values."""
    from calibench.discrepancy import explain

    drawn = case(kind, seed, **asked)
    m = drawn.machine
    with TemporaryDirectory() as folder:
        try:
            report = explain(*handed(drawn, Path(folder), f"{kind}{seed}"))
        except Exception as error:
            return {"seed": seed, "machine": m.name, "cause": drawn.cause, "verdict": "error", "text": repr(error)}
    return {
        "seed": seed, "kind": kind, "machine": m.name, "cause": drawn.cause, "joint": drawn.joint, "law": drawn.law,
        "rows": len(m.day.t), "visible": drawn.visible, "near": drawn.near, "verdict": report.verdict,
        "findings": [
            {"effect": f.effect, "family": f.family, "target": f.target, "set": [r.effect for r in f.set],
             "families": [[r.family, r.target] for r in f.set], "visible": f.visible, "form": f.form,
             "caution": [one.code for one in f.caution]}
            for f in report.findings
        ],
        "where": [[p.target, p.covariate, p.p] for p in report.where[:3]],
        "left": report.left.times if report.left else None, "gap": [report.gap.held_out_before,
        report.gap.held_out_after, report.gap.noise_floor], "notes": [n.code.value for n in report.notes],
        "seconds": report.seconds,
    }  # fmt: skip


def plainly(one: dict[str, Any], strict: bool = False) -> bool:
    """Return whether a foreign cause has a name that stands without a mark."""
    names = [f for f in one["findings"] if f["family"] not in NOISE]
    unmarked = [f for f in names if not f["caution"] and (strict or not f["form"])]
    return one["verdict"] in ("named", "ambiguous") and bool(unmarked)


def in_a_set(one: dict[str, Any]) -> bool:
    """Return whether a set holds a name of the cause at its part."""
    cause, joint = one["cause"], one["joint"]
    for family, target in (pair for f in one["findings"] for pair in f["families"]):
        if one["machine"] == "mount" and cause in ("TF", "eccentricity"):
            sky = {"TF", "ECEC"} if cause == "TF" else SKY[joint]
            if family in sky:
                return True
        elif family in NAMES.get(cause, {cause}) and _part(target) == _part(joint):
            return True
    return False


def _part(target: str) -> str:
    return {"azimuth axis": "az", "elevation axis": "el"}.get(target, target.split()[-1])


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return Wilson's interval of 95 %."""
    if not count:
        return 0.0, 1.0
    z, share = 1.96, hits / count
    middle, wide = share + z * z / (2 * count), z * np.sqrt(share * (1 - share) / count + z * z / (4 * count**2))
    return float((middle - wide) / (1 + z * z / count)), float((middle + wide) / (1 + z * z / count))


def score(answers: Sequence[dict[str, Any]]) -> list[str]:
    """Return the rates of answers, a line each."""
    lines = []

    def rate(what: str, of: Sequence[dict[str, Any]], hit: Callable[[dict[str, Any]], bool]) -> None:
        if of:
            hits = sum(map(hit, of))
            low, high = wilson(hits, len(of))
            lines.append(f"{what}: {hits} of {len(of)}, {hits / len(of):.3f} ({low:.3f} to {high:.3f})")

    sound = [one for one in answers if one["kind"] == "sound"]
    rate("alarm on sound sets, outliers among them", sound, lambda one: one["verdict"] != "none")
    rate("alarm on sound sets, effects alone", sound,
         lambda one: one["verdict"] not in ("none", "noise") and
         (one["verdict"] == "unknown" or any(f["family"] not in NOISE for f in one["findings"])))  # fmt: skip
    rate("... of Gaussian noise", [s for s in sound if s["law"] == "gauss"], lambda one: one["verdict"] != "none")
    own = [one for one in answers if one["kind"] == "off_form" and one["cause"]]
    rate("truth in a set, forms off", own, in_a_set)
    rate("... verdict named or ambiguous", own, lambda one: one["verdict"] in ("named", "ambiguous"))
    rate("... marked by caution or form", own, lambda one: any(f["caution"] or f["form"] for f in one["findings"]))
    foreign = [one for one in answers if one["kind"] == "foreign" and one["cause"]]
    rate("foreign: plainly named, draws that are a textbook's form but for .15 left out",
         [one for one in foreign if one.get("near", 1.0) > FORM], plainly)  # fmt: skip
    rate("foreign: plainly named", foreign, plainly)
    rate("foreign: plainly named, a form that differs is no mark", foreign, lambda one: plainly(one, True))
    rate("foreign: unknown or partly", foreign, lambda one: one["verdict"] in ("unknown", "partly"))
    rate(
        "foreign: unknown, partly, or every name marked",
        foreign,
        lambda one: one["verdict"] in ("unknown", "partly") or (bool(one["findings"]) and not plainly(one)),
    )
    for machine in sorted({one["machine"] for one in foreign}):
        rate(f"... plainly named, {machine}", [one for one in foreign if one["machine"] == machine], plainly)
    for cause in sorted({one["cause"] for one in foreign}):
        those = [one for one in foreign if one["cause"] == cause]
        verdicts = Counter(one["verdict"] + ("" if plainly(one) or one["verdict"] not in ("named", "ambiguous") else
                           ", marked") for one in those)  # fmt: skip
        lines.append(f"    {cause}: " + ", ".join(f"{n} {v}" for v, n in sorted(verdicts.items())))
    return lines


def main(verb: str = "--help", *words: str) -> None:
    """Search a batch, or score files."""
    if verb not in ("run", "score") or len(words) < (4 if verb == "run" else 1):
        print(__doc__)
        return
    if verb == "score":
        lines = [json.loads(line) for file in words for line in Path(file).read_text().splitlines()]
        print(*score([one for one in lines if "verdict" in one and one["verdict"] != "error"]), sep="\n")
        print(f"errors: {sum(one.get('verdict') == 'error' for one in lines)}")
        return
    kind, first, last, file, *span = words
    out, rows = Path(file), [int(most) for most in span[0].split(":")] if span else [200, 400]
    known = {json.loads(line).get("seed") for line in out.read_text().splitlines()} if out.exists() else set()
    with out.open("a") as lines_:
        if not known:
            stated = {"batch": kind, "seeds": [int(first), int(last)], "rows": rows, "visible": VISIBLE}
            print(json.dumps(stated), file=lines_, flush=True)
        for seed in range(int(first), int(last)):
            if seed not in known:
                many = int(np.exp(np.random.default_rng([seed, *rows]).uniform(*np.log(rows)))) if span else 0
                print(json.dumps(told(kind, seed, rows=many)), file=lines_, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
