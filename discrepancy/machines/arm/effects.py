"""The effects of an arm beside the general families: base and tool that move, bearings that bend.

Base and tool move as rigid bodies, all coordinates at once: evenly during the run, or once. Under the moment of gravity
(`loads`) a joint bends across its axis, with the link behind it; about its axis the general `compliance` applies.
"""

from functools import partial

import numpy as np

from calibench.calibration.rigid import cross
from calibench.calibration.walk import BASE, PLACE, READING, TOOL, TURNS
from calibench.discrepancy.effects.general.columns import run_terms
from calibench.discrepancy.effects.general.recipe import Built, clock_of
from calibench.discrepancy.machines.arm.formulation import TOOL_TURNS, loads_in
from calibench.discrepancy.model.effect import EffectFamily, NotTestable
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.roles import roles_of
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_KIND = {name: ("mrad", 1e-3) if "_r" in name else ("mm", 1.0) for name in (*BASE, *TOOL, *TOOL_TURNS)}


def _moved(formulation: Formulation, part: str) -> tuple[tuple[str, ...], str]:
    """Return the numbers that give the place of a part, and the clock; raise `NotTestable` where nothing sees it."""
    known = {p.name for p in formulation.parameters}
    if part == "base" and BASE[0] not in known:
        raise NotTestable("nothing outside the arm was measured that the base could move against")
    turns = (name for name in TOOL_TURNS if name in {*formulation.fixed, *known})
    clock = clock_of(formulation, "the arm")
    return BASE if part == "base" else (*TOOL, *turns), clock


def _drifts(formulation: Formulation, target: str, *, name: str) -> Built:
    names, clock = _moved(formulation, target)
    t = formulation.data[clock]
    origin, span = float(t.min()), float(np.ptp(t))

    def changes(moved: tuple[str, ...], q: Quantities, data: MeasuredData) -> dict[str, Array]:
        s = run_terms((data[clock] - origin) / span)[:, :1]
        return {one: _KIND[one][1] * s * np.eye(len(moved))[k] for k, one in enumerate(moved)}

    return tuple(
        FAMILIES[name].linear(
            target, (clock,), {one: _KIND[one][0] for one in moved}, partial(changes, moved), unit="mm",
            measure=lambda c: float(np.linalg.norm(c[:3])),  # mm: its turns are reported separately
        )
        for moved in dict.fromkeys((names[:3], names))
    )  # fmt: skip


def _shifts(formulation: Formulation, target: str, *, name: str) -> Built:
    names, clock = _moved(formulation, target)
    t, family = formulation.data[clock], FAMILIES[name]
    forms = dict.fromkeys((names[:3], names))
    return tuple(e for moved in forms for e in family.steps(target, clock, t, {n: (n, *_KIND[n]) for n in moved}))


def _bends(formulation: Formulation, target: str) -> Built:
    held = loads_in(formulation, formulation.data)
    if held is None:
        raise NotTestable("nothing says what the joints of this machine hold")
    chain, _ = held
    k = next(k for k, joint in enumerate(chain.joints) if joint.name == target)
    joint = chain.joints[k]
    names = tuple(f"{one}_{target}" for one in TURNS)

    def changes(q: Quantities, data: MeasuredData) -> dict[str, Array]:
        held_now = loads_in(formulation, data)
        moment = held_now[1][:, k] if held_now else np.zeros((len(data), 3))
        across = moment - (moment @ joint.axis)[:, None] * joint.axis
        if joint.kind == "rotary":
            return {name: -across[:, i : i + 1] for i, name in enumerate(names)}
        # a column that is s out: its end turns by k M s, and is off by half of what that turn makes of s
        out = np.asarray(data[READING + target], dtype=float)[:, None]
        turned = -across * out
        back = -cross(turned, joint.axis * out) / 2
        return {n: turned[:, i : i + 1] for i, n in enumerate(names)} | {
            f"{one}_{target}": back[:, i : i + 1] for i, one in enumerate(PLACE)
        }

    across = changes({}, formulation.data)
    if not np.ptp(across[names[0]]) + np.ptp(across[names[1]]) > 0:
        raise NotTestable(f"gravity asks the same of {target} across its axis in every pose")
    most = thresholds().largest_windup / max(float(np.max(np.abs(across[name]))) for name in names)
    unit = "rad/(N mm)" if joint.kind == "rotary" else "rad/(N mm2)"
    columns = () if joint.kind == "rotary" else (READING + target,)
    return bending.linear(target, columns, {"k": unit}, changes, largest=most)


def _joints(formulation: Formulation) -> tuple[str, ...]:
    held = loads_in(formulation, formulation.data)
    return tuple(
        joint.name
        for joint in roles_of(formulation).joints
        if held is None or joint.name in {j.name for j in held[0].joints}
    )


FAMILIES: dict[str, EffectFamily] = {}
for _name, _part, _cause, _formula, _label, _built in (
    ("base_drift", "base", "The base, or the tracker, moves evenly during the run",
     "base += d s, and turns by r s; s from 0 to 1 over the run", "movement", _drifts),
    ("base_shift", "base", "The base, or the tracker, is displaced once during the run",
     "base += d, and turns by r, from a time on", "displacement", _shifts),
    ("tool_drift", "tool", "The tool creeps on the flange during the run", "tool += d s, s from 0 to 1 over the run",
     "creep", _drifts),
    ("tool_shift", "tool", "The tool, or the target, slips on the flange once during the run",
     "tool += d, and turns by r, from a time on", "slip", _shifts),
):  # fmt: skip
    FAMILIES[_name] = EffectFamily(
        _name, "arm", _cause, formula=_formula, channel="base", columns=("the time",), unit="mm", targets=(_part,),
        build=partial(_built, name=_name), label=_label,
    ).enter()  # fmt: skip
bending = EffectFamily(
    "bending", "arm", "The bearing of a joint, and the link behind it, give way to gravity across the axis",
    formula="the axis of joint i leans by k times the moment across it, of a column also times how far it is out",
    channel="link", columns=(),
    unit="rad/(N mm)", targets=("each joint",), build=_bends, targets_in=_joints, label="bending across the axis",
    bounds=("largest_windup",),
).enter()  # fmt: skip
