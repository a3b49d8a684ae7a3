"""Which effects the chapter's three experiments on an Orthoglide support, beside the joint offsets that it calibrates.

Experiment 1: before mechanical tuning; 2: after it; 3: after the offsets found in 2 went into the control software, so
what 2 leaves unexplained, 3 must show (printed twice, with numbers that disagree: exp3_t1, exp3_t2).
A family that entered the catalogue after the data had been seen has a penalty, so there are three p-values: for the
catalogue as it is; for all families ever tried; and with `others` further families of the same shape that might have
been written, each taken to do as well on noise: p = 1 - (1 - p of all ever tried) (1 - p of the family alone) ^ others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import final, get_args
from weakref import WeakKeyDictionary

import numpy as np

from calibench import problems
from calibench.discrepancy.effects import catalogue
from calibench.discrepancy.fitting import small_sample as small
from calibench.discrepancy.fitting.small_sample import Calibrated, Likeness, SmallSample
from calibench.discrepancy.machines.orthoglide.formulation import planned
from calibench.discrepancy.machines.orthoglide.kinematics import printed
from calibench.discrepancy.model.effect import Effect, name_of
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.registries import machines
from calibench.problems import constants
from calibench.problems.base import Array
from calibench.problems.identifiability import FTest, f_test
from calibench.problems.orthoglide.kinematics import NAMES, PAPER
from calibench.problems.orthoglide.plans import PlanName, SetName

HANDED = "axis_intersection cyclic"
ORIENTATION = "axis_orthogonality all"
_SINGLE = (
    ORIENTATION, HANDED, "axis_intersection all", "bar_skew cyclic", "bar_skew mirrored", "bar_skew all",
    "guide_lean cyclic", "guide_lean axis z", "bar_skew leg z",
)  # fmt: skip
MODELS: Mapping[str, tuple[str, ...]] = {"offsets only": (), **{name: (name,) for name in _SINGLE}}
WHOLE = "all that experiment 2 left"
ADDED_LATER = "guide_lean"  # after all sets had been fitted and Experiment 3 predicted
RIVALS = ("guide_lean cyclic", "bar_skew cyclic", "guide_lean axis z", "bar_skew leg z", ORIENTATION, "backlash all")
_SIGMA = 0.01  # mm, section 3.4
PLANS: tuple[PlanName, ...] = ("paper", "positions", "levels", "both_ways", "cross", "rich")

# The largest sizes such a machine can have; beyond, an effect explains nothing. mm, rad, 1, mm a step. Ours, but for
# drift and zero_reading: section 4.1 repeated the cycle of Zero, Max and Min three times and saw no more than .02 mm.
PLAUSIBLE = {
    "scale": 0.01, "axis_orthogonality": 0.02, "guide_lean": 0.02, "axis_intersection": 5.0, "bar_skew": 5.0,
    "backlash": 0.5, "drift": 0.01, "zero_reading": 0.02, "gauge_tilt": 0.1, "gauge_placement": 10.0, "leg_length":
    10.0,
}  # fmt: skip


@final
@dataclass(frozen=True, eq=False)
class Prediction:
    """Rows of experiment 3 as measured and as predicted by a model of experiment 2, mm; `like` compares the two."""

    labels: tuple[str, ...]
    measured: Array
    predicted: Mapping[str, Array]
    like: Mapping[str, Likeness]

    def rms(self, model: str, rows: str = "") -> float:
        """Return the rms error of a model [mm], over the rows that begin with a letter of `rows` (all by default)."""
        kept = [k for k, label in enumerate(self.labels) if not rows or label[0] in rows]
        return float(np.sqrt(np.mean((self.measured - self.predicted[model])[kept] ** 2)))

    def refusing(self, model: str) -> tuple[str, ...]:
        """Return the rows that a model predicts no better than the joint offsets alone do."""
        plain, own = (np.abs(self.measured - self.predicted[name]) for name in ("offsets only", model))
        return tuple(label for label, a, b in zip(self.labels, plain, own) if b > a)


@final
@dataclass(frozen=True, eq=False)
class Experiments:
    """All numbers of the page, by set, by weighting (False: least squares as in the chapter; True: eq. (14)).

    Six differences have no weighting, because each is of two readings of its own. `prices` are those of the best
    candidate of the family that was added later, and of the best that was there before.
    """

    sets: Mapping[tuple[str, bool], SmallSample]
    beyond: Mapping[bool, SmallSample]
    likenesses: Mapping[tuple[str, str], Likeness]
    predictions: Mapping[tuple[str, bool], Prediction]
    rivals: Mapping[tuple[str, str], float]
    mixed_up: Mapping[tuple[str, str], float]
    corrected: Mapping[str, Likeness]
    lengths: FTest
    prices: Mapping[tuple[str, bool], tuple[Price, Price]]
    draws: int


def experiments(draws: int = 5_000) -> Experiments:
    """Return all numbers, the same at every call."""
    machine = machines.make("orthoglide")
    formulations = {name: machine.formulate(printed(name)) for name in get_args(SetName)}
    about = {(n, w): small.linear(f, weighted=w) for n, f in formulations.items() for w in (False, True)}
    lists = {name: catalogue(formulation) for name, formulation in formulations.items()}
    sets = {
        (n, w): small.small_sample(a, lists[n].candidates, PLAUSIBLE, draws)
        for (n, w), a in about.items()
        if len(a.r) > 6 or not w
    }
    out = {name: [held.effect for held in listed.alternatives] for name, listed in lists.items()}
    prices = {(n, w): price(about[n, w], lists[n].candidates, out[n], ADDED_LATER, draws) for n, w in sets}
    second = formulations["exp2"]
    handed = effect_of(second, HANDED)
    rest = [e for e in lists["exp2"].candidates if name_of(e) != HANDED]
    beyond = {
        w: small.small_sample(small.linear(second, handed, weighted=w), rest, PLAUSIBLE, draws) for w in (False, True)
    }
    pairs = [("exp1", "exp2_t1"), ("exp1", "exp3_t1"), ("exp2_t1", "exp3_t1"), ("exp2", "exp3_t2")]
    likenesses = {pair: small.likeness(*(about[name, False] for name in pair)) for pair in pairs}
    thirds = [(name, w) for name in ("exp3_t1", "exp3_t2") for w in (False, True)]
    predictions = {(name, w): predict(second, formulations[name], w) for name, w in thirds}
    size = sets["exp2", False][HANDED].coefficients
    apart = {plan: told_apart(plan, size) for plan in PLANS}
    rivals: dict[tuple[str, str], float] = {
        (plan, rival): apart[plan][rival] for plan in PLANS for rival in apart[plan]
    }
    mixed_up = {
        (name, how): small.small_sample(small.linear(machine.formulate(mix(printed(name))), weighted=False), ()).rms
        for name in ("exp1", "exp2", "exp3_t1", "exp3_t2")
        for how, mix in MIX_UPS.items()
    }
    one, three = (machine.formulate(read_instead(printed(name))) for name in ("exp1", "exp3_t2"))
    corrected = {
        "exp1": small.likeness(small.linear(one, weighted=False), about["exp2_t1", False]),
        "exp3_t2": small.likeness(about["exp2", False], small.linear(three, weighted=False)),
    }
    rho, full = (problems.make("orthoglide6", data="exp2", free=free) for free in ("rho", "full"))
    return Experiments(
        sets, beyond, likenesses, predictions=predictions, rivals=rivals, mixed_up=mixed_up, corrected=corrected,
        lengths=f_test(rho, full), prices=prices, draws=draws,
    )  # fmt: skip


def read_instead(data: MeasuredData) -> MeasuredData:
    """Return a printed set in which the one datum that is believed misprinted has its corrected value."""
    place, label = {"exp1": ("Measurements #1, x_z", "x_z"), "exp3_t2": ("'Exper. data', x_z_minus", "x_z-")}[data.name]
    (erratum,) = (e for e in constants.document(PAPER)["erratum"] if e["place"].endswith(place))
    here = np.array(labels(data)) == label
    return data.with_columns({"deviation": np.where(here, float(erratum["read"]), data["deviation"])})


MIX_UPS: Mapping[str, Callable[[MeasuredData], MeasuredData]] = {
    "as printed": lambda data: data,
    "direction and leg exchanged": lambda data: data.with_columns(
        {"leg": data["direction"], "direction": data["leg"], "posture": data["direction"]}
    ),
    "the two gauges of each leg exchanged": lambda data: data.with_columns(
        {"direction": np.array([(set("xyz") - {d, leg}).pop() for d, leg in zip(data["direction"], data["leg"])])}
    ),
    "the sign of one hand turned": lambda data: data.with_columns(
        {
            "deviation": data["deviation"]
            * np.where([leg + d in ("xz", "yx", "zy") for d, leg in zip(data["direction"], data["leg"])], -1.0, 1.0)
        }
    ),
}


def effect_of(formulation: Formulation, name: str) -> Effect:
    """Return a candidate of the catalogue by family and target."""
    if formulation not in _CATALOGUES:
        _CATALOGUES[formulation] = {name_of(effect): effect for effect in catalogue(formulation).candidates}
    return _CATALOGUES[formulation][name]


_CATALOGUES: WeakKeyDictionary[Formulation, dict[str, Effect]] = WeakKeyDictionary()


def predict(second: Formulation, third: Formulation, weighted: bool) -> Prediction:
    """Return experiment 3 as each model fitted to experiment 2 says it must be, after the printed update of rho."""
    update = constants.column(PAPER, "table3.exp2_rho")
    shift = np.array([update[name] for name in NAMES[:3]])
    predicted: dict[str, Array] = {}
    for label, chosen in MODELS.items():
        about = small.linear(second, *(effect_of(second, name) for name in chosen), weighted=weighted)
        x = about.x.copy()
        x[:3] -= shift  # the control software has applied this shift
        predicted[label] = _deviations(third, about, x)

    # what is left of experiment 2 in the rows of experiment 3: the same readings, or their differences
    plain = small.linear(second, weighted=weighted)
    left = second.data["deviation"] - _deviations(plain.model.formulation, plain, plain.x)
    of = dict(zip(labels(second.data), left))
    there = [of[label] if label in of else of[f"{label}+"] - of[f"{label}-"] for label in labels(third.data)]
    predicted[WHOLE] = predicted["offsets only"] + np.array(there)
    measured = np.asarray(third.data["deviation"])
    news = {label: p - predicted["offsets only"] for label, p in predicted.items() if label != "offsets only"}
    like = {label: small.direction(p, measured - predicted["offsets only"], len(measured)) for label, p in news.items()}
    return Prediction(labels(third.data), measured, predicted, like)


def told_apart(plan: PlanName, size: Array) -> dict[str, float]:
    """Return how far each rival stays from `HANDED` at `size` under a plan: the root of its chi2."""
    formulation = machines.make("orthoglide").formulate(planned(plan, _SIGMA))
    handed = effect_of(formulation, HANDED)
    about = small.linear(formulation, weighted=True)
    truth = about.columns(handed) @ size
    apart = {}
    for rival in RIVALS:
        try:
            columns = np.column_stack([about.J, about.columns(effect_of(formulation, rival))])
        except KeyError:
            continue
        scale = np.linalg.norm(columns, axis=0)
        u, s, _ = np.linalg.svd(columns / np.where(scale > 0, scale, 1.0), full_matrices=False)
        u = u[:, s > 1e-9 * s[0]]
        left = truth - u @ (u.T @ truth)
        apart[rival] = float(np.linalg.norm(left) / _SIGMA)
    return apart


def labels(data: MeasuredData) -> tuple[str, ...]:
    """Return the chapter's names of the readings: x_y+ for x at the leg y at its Max, x_y for a difference."""
    rows = zip(data["direction"], data["leg"], data["level_mm"], data["against_mm"])
    return tuple(f"{d}_{leg}" + ("" if against else "+" if level > 0 else "-") for d, leg, level, against in rows)


def _deviations(formulation: Formulation, about: Calibrated, x: Array) -> Array:
    """Return the deviations [mm] that a model fitted at x predicts for the rows of `formulation`."""
    model = Model(formulation, about.model.effects)
    return np.asarray(formulation.constraints(model.quantities(x)[1])[:, 0] + formulation.data["deviation"])


@final
@dataclass(frozen=True)
class Price:
    """`name`, the best candidate, with its own p and the chance that the best of each list does as well on noise.

    `listed`: of the list without what was added, in which the name must stand; None where it does not. `now`: of the
    catalogue as it stands. `ever`: of all that was ever tried, `tried` candidates. `chosen`: with the freedom to write
    `others` further families; None for a name that was there from the beginning, which needed no such freedom.
    """

    name: str
    p: float
    listed: float | None
    now: float
    ever: float
    chosen: float | None
    tried: int
    others: int

    @property
    def right(self) -> float:
        """Return the price that counts: with the choice where there was one, else that of all families ever tried."""
        return self.ever if self.chosen is None else self.chosen


def price(
    about: Calibrated, catalogue: Sequence[Effect], taken_out: Sequence[Effect], added: str, draws: int = 5_000
) -> tuple[Price, Price]:
    """Return the prices of the best candidate of the family `added`, and of the best that was there without it."""
    own = [e for e in catalogue if e.family == added]
    first = [*(e for e in catalogue if e.family != added), *taken_out]
    others = len({e.family for e in catalogue} - {added})
    lists = (first, catalogue, [*catalogue, *taken_out], own)
    listed, now, ever, alone = (small.small_sample(about, chosen, draws=draws) for chosen in lists)
    late = alone.candidates[0]
    kept = {c.name for c in now.candidates}
    early = next(c for c in listed.candidates if c.name in kept)
    chosen = 1 - (1 - ever[late.name].p_tried) * (1 - alone[late.name].p_tried) ** others
    tried = {"tried": ever.tried, "others": others}
    found = listed[early.name]
    return (
        Price(late.name, late.p, None, now[late.name].p_tried, ever=ever[late.name].p_tried, chosen=chosen, **tried),
        Price(early.name, found.p, found.p_tried, now[early.name].p_tried, ever=ever[early.name].p_tried, chosen=None,
              **tried),
    )  # fmt: skip
