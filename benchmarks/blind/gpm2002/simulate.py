"""`case(seed)`: one measured file of a GPM2002 and the truth behind it, drawn as the statistics of the reports need it.

20 % of the cases miss nothing, 45 % one effect, 15 % two, 20 % one that no catalogue has. Effects are drawn by their
visible size lambda (`visible`), so that a case is as hard as it looks and not as large as its amplitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.gpm2002 import bend, families, noise
from benchmarks.blind.gpm2002.design import Plan, random_plan
from benchmarks.blind.gpm2002.effect import Dose, Effect, Signals, coarsened, run
from benchmarks.blind.gpm2002.machine import MAKERS, NAMES, Array, random_machine
from benchmarks.blind.gpm2002.record import columns_of, write
from benchmarks.blind.gpm2002.statics import Rest, settle
from benchmarks.blind.gpm2002.visible import Eye, amplitude_for, open_eye, rms

__all__ = ["Case", "case", "write"]

Kind = Literal["none", "one", "two", "outside"]
KINDS: tuple[Kind, ...] = ("none", "one", "two", "outside")
SHARES = (0.20, 0.45, 0.15, 0.20)
LAMBDA = (0.4, 4.0)
UNSEEN = 0.3  # what stays below this at the largest amplitude is invisible in these data


@dataclass(frozen=True)
class Case:
    """A measured file, `columns` and `metadata`, and apart from it the `truth` that nobody who explains it may read."""

    columns: dict[str, NDArray[Any]]
    metadata: dict[str, Any]
    truth: dict[str, Any]


def case(
    seed: int,
    *,
    xy: bool | None = None,
    family: str | None = None,
    target: str | int | None = None,
    lam: float | None = None,
    noise: noise.Law | None = None,
    kind: Kind | None = None,
    poses: int | None = None,
    bent: float | bool = False,
) -> Case:
    """Draw the case of `seed`; what is asked for is fixed, all else stays as drawn.

    `family` is the (first) effect's, `target` its joint, leg or base as "joint 2" or 2, `lam` the visible size of every
    effect [sigma], `poses` how many are fitted, four readings each. `bent`: every effect's form is off by that share of
    its size, rms; True: by one drawn from 5 to 15 %. Raises `ValueError` where they contradict another.
    """
    _check(family, target, lam, noise, kind)
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(7)]
    whole, geometry, design, hidden, sensors, papers, forms = streams
    drawn_kind = str(whole.choice(KINDS, p=SHARES))
    drawn_xy = bool(whole.random() < 0.5)
    drawn_noise = str(whole.choice(_noise_laws(), p=_noise_shares()))
    kind = kind or (("one" if family in families.KNOWN else "outside") if family else drawn_kind)
    xy, law = drawn_xy if xy is None else xy, noise or drawn_noise
    sigma = float(np.exp(whole.uniform(np.log(2.5e-5), np.log(1e-4))))
    sigma_xy = float(whole.uniform(0.01, 0.05))

    machine = random_machine(geometry)
    plan = random_plan(machine, design, poses)
    teeth = tuple(int(n) for n in design.integers(24, 121, 3))
    still = _still(machine, plan)
    scene = _Scene(machine, plan, still, xy, sigma, sigma_xy, _shake(law, len(plan.t), sensors))

    doses: list[Dose] = []
    told: list[dict[str, Any]] = []
    for effect in _draw_effects(kind, family, target, xy, plan, teeth, hidden):
        wanted = float(np.exp(hidden.uniform(*np.log(LAMBDA)))) if lam is None else lam
        off = float(forms.uniform(*bend.SHARES)) if bent is True else float(bent)
        if off:
            effect = bend.bent(effect, off, forms)
        dose, facts = scene.dose(effect, wanted)
        doses.append(dose)
        told.append(facts | {"off": off} if off else facts)

    signals = run(machine, plan, still, doses)
    readings = coarsened(signals.readings + sigma * scene.shaken[:, :3], doses)
    tracker = signals.tracker + sigma_xy * scene.shaken[:, 3:] if xy else None
    needed = {column for effect, _ in doses for column in effect.needs}
    columns, lsb, missing = columns_of(plan, machine, signals.rest, readings, tracker, sigma, needed, papers)
    nominal = MAKERS.copy()
    if not xy:
        nominal[:4] = machine[:4]  # A_1 and A_2 have been surveyed, as angles alone cannot tell them
    metadata = {
        "schema_version": 1,
        "machine": "gpm2002",
        "sigma_enc": sigma,
        "sigma_xy": sigma_xy if xy else None,
        "encoder_lsb": lsb,
        "tooth_numbers": list(teeth),
        "fixed_parameters": {} if xy else {name: float(machine[k]) for k, name in enumerate(NAMES[:4])},
        "nominal": {name: float(value) for name, value in zip(NAMES, nominal)},
    }
    truth = {
        "seed": seed,
        "kind": kind,
        "xy": xy,
        "noise": law,
        "sigma_enc": sigma,
        "sigma_xy": sigma_xy if xy else None,
        "effects": told,
        "withheld": bool(needed & set(missing)),
        "missing": missing,
        "parameters": {name: float(value) for name, value in zip(NAMES, machine)},
        "branch": plan.branch.tolist(),
        "radius": plan.radius,
        "poses": len(np.unique(plan.pose[plan.train])),
        "held_out_poses": len(np.unique(plan.pose[~plan.train])),
    }
    return Case(columns, metadata, truth)


@dataclass(frozen=True)
class _Scene:
    """One machine at work, against which each effect is measured alone."""

    machine: Array
    plan: Plan
    still: Rest
    xy: bool
    sigma: float
    sigma_xy: float
    shaken: Array

    def dose(self, effect: Effect, wanted: float) -> tuple[Dose, dict[str, Any]]:
        """Return the effect with the amplitude that is seen as `wanted`, and the facts for the truth."""
        eye = self._eye()
        small = effect.coarsen is not None or effect.family in families.DISTURBED  # like noise: nothing to absorb

        def seen(a: float) -> float:
            readings, tracker = self._fitted(self._disturbed(effect, a))
            return eye.left_linear(readings, tracker) if small else eye.left(readings, tracker)

        a, lam = amplitude_for(wanted, seen, effect.typical, effect.largest)
        invisible = lam < UNSEEN and lam < 0.9 * wanted
        if invisible:
            a, lam = effect.typical, seen(effect.typical)
        readings, tracker = self._fitted(self._disturbed(effect, a))
        whole = rms(eye.signature(readings, tracker))
        facts = {
            "family": effect.family,
            "target": effect.target,
            "amplitude": a,
            "unit": effect.unit,
            "lambda": lam,
            "lambda_asked": wanted,
            "lambda_linear": eye.left_linear(readings, tracker),
            "visible_fraction": lam / whole if whole > 0 else 0.0,
            "known": effect.known,
            "invisible": invisible,
        }
        return (effect, a), facts

    def _eye(self) -> Eye:
        readings, tracker = self._fitted(run(self.machine, self.plan, self.still, []))
        return open_eye(self.machine, readings, tracker, self.sigma, self.sigma_xy)

    def _disturbed(self, effect: Effect, a: float) -> Signals:
        signals = run(self.machine, self.plan, self.still, [(effect, a)])
        if effect.coarsen is None:
            return signals
        noise = self.sigma * self.shaken[:, :3]
        return Signals(coarsened(signals.readings + noise, [(effect, a)]) - noise, signals.tracker, signals.rest)

    def _fitted(self, signals: Signals) -> tuple[Array, Array | None]:
        rows = self.plan.train
        return signals.readings[rows], signals.tracker[rows] if self.xy else None


def _still(machine: Array, plan: Plan) -> Rest:
    members = np.broadcast_to(machine, (len(plan.t), 15))
    return settle(members, plan.position, plan.branch, plan.load, plan.preload, None, None)


def _shake(law: noise.Law, n: int, rng: np.random.Generator) -> Array:
    return noise.draw(law, (n, 5), rng)


def _noise_laws() -> tuple[str, ...]:
    return noise.LAWS


def _noise_shares() -> tuple[float, ...]:
    return noise.SHARES


def _draw_effects(
    kind: Kind,
    family: str | None,
    target: str | int | None,
    xy: bool,
    plan: Plan,
    teeth: tuple[int, int, int],
    rng: np.random.Generator,
) -> list[Effect]:
    if kind == "none":
        return []
    known = [name for name in families.KNOWN if xy or name != "tracker_lag"]
    pool = list(families.FOREIGN) if kind == "outside" else known
    drawn, leg = str(rng.choice(pool)), int(rng.integers(3))
    if target is not None:
        leg = int(str(target)[-1]) - 1 if str(target)[-1] in "123" else leg
    effects = [families.make(family or drawn, leg, plan, teeth, rng)]
    while kind == "two" and len(effects) < 2:
        other = families.make(str(rng.choice(known)), int(rng.integers(3)), plan, teeth, rng)
        if families.compatible(effects[0], other):
            effects.append(other)
    return effects


def _check(family: str | None, target: str | int | None, lam: float | None, law: str | None, kind: str | None) -> None:
    if kind is not None and kind not in KINDS:
        raise ValueError(f"kind={kind!r}: not one of {', '.join(KINDS)}")
    if law is not None and law not in noise.LAWS:
        raise ValueError(f"noise={law!r}: not one of {', '.join(noise.LAWS)}")
    if family is not None and family not in {*families.KNOWN, *families.FOREIGN}:
        raise ValueError(f"family={family!r}: not one of {', '.join([*families.KNOWN, *families.FOREIGN])}")
    if (
        family is not None
        and kind is not None
        and (kind == "none" or (kind == "outside") == (family in families.KNOWN))
    ):
        raise ValueError(f"kind={kind!r} and family={family!r} contradict each other; leave one of the two out")
    if target is not None and family is None:
        raise ValueError(f"target={target!r}: goes with a family, and none is asked for")
    if lam is not None and not lam > 0:
        raise ValueError(f"lam={lam}: a visible size above 0 is needed; for nothing missing ask kind='none'")
