"""Instances of `arm_ur10` and `arm_panda`: another arm, errors, postures, noise and box for each ``instance=K``.

docs/instances.md says what is drawn. Links are 0.7 .. 1.3 times as long as the maker's, to .1 mm; each parameter that
the postures determine is wrong as `problems.instances` says of the box, with h = 5 mm and .03 rad. A UR10's postures
are in the middle 70 % of the joints' ranges; a Panda's bring the ball to pairs of sockets, by the nominal arm.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from calibench.calibration import kinematics
from calibench.calibration.determined import gauge
from calibench.calibration.kinematics import Chain
from calibench.calibration.rigid import Index, rpy, shift
from calibench.calibration.urdf import read_urdf
from calibench.problems.arm.families import shipped
from calibench.problems.base import Array
from calibench.problems.instances import Box, Noise, Stream, can_be_identified, first_that_fits

NOISES = (5e-3, 1e-1)  # mm
_HALF = {"mm": 5.0, "rad": 0.03}
_DIGITS = {"mm": 3, "rad": 6}
_MIDDLE = 0.7
_WIDEST = 2.6  # rad
GAP = 50.0  # mm between the two sockets of the tool
GAP_WEIGHT = 3.0  # a distance between sockets was measured once, and better than the ball sits
_AROUND = 0.6  # rad: of a socket's postures about each other, before they are brought to it


@final
@dataclass(frozen=True, eq=False)
class ArmInstance:
    """What ``instance=K`` draws; `attempts` were drawn until one could be identified.

    `chain` is the nominal arm, `box` that of the parameters `names`, `q` the postures, `socket` their sockets (None
    where places or poses are read: `reads`).
    """

    chain: Chain
    names: tuple[str, ...]
    box: Box
    q: Array
    socket: Index | None
    reads: str
    noise: Noise
    attempts: int

    def read(self, noise: float) -> kinematics.Compared:
        """Return what the true arm gives to read, with noise of a standard deviation [mm] (turns: over 100 mm)."""
        rng = np.random.default_rng(self.noise.data_seed)
        true = kinematics.forward(self.chain, dict(zip(self.names, self.box.truth.tolist(), strict=True)), self.q)
        away, turned = noise * rng.standard_normal((2, len(self.q), 3))
        if self.socket is not None:
            count = int(self.socket.max()) + 1
            middles = np.array([true[self.socket == s, :3, 3].mean(axis=0) for s in range(count)])
            known = [
                (s, s + 1, float(np.linalg.norm(middles[s + 1] - middles[s])) + noise * float(rng.standard_normal()))
                for s in range(0, count, 2)
            ]
            return kinematics.sockets(self.q, self.socket, tuple(known), GAP_WEIGHT, true[:, :3, 3] + away)
        true[:, :3, 3] += away
        if self.reads == "pose" and noise > 0:
            true[:, :3, :3] = np.stack([rpy(*w)[:3, :3] for w in turned / 100.0]) @ true[:, :3, :3]
        return kinematics.targets(self.q, true[:, :3, 3], None if self.reads == "position" else true[:, :3, :3])


def arm_instance(family: str, instance: int, reads: str, build: Callable[[ArmInstance], Any]) -> ArmInstance:
    """Return the instance; ``build(drawn)`` makes its problem without noise."""

    def attempt_of(attempt: int) -> ArmInstance | None:
        streams = {t: Stream.of(family, instance, attempt, t) for t in ("machine", "box", "plan", "noise")}
        of, plan = streams["machine"], streams["plan"]
        chain = read_urdf(shipped("ur10.urdf" if family == "arm_ur10" else "panda.urdf")).chain()
        joints = []
        for joint in chain.joints:
            origin, factor = joint.origin.copy(), of.between(0.7, 1.3)
            origin[:3, 3] = np.round(factor * origin[:3, 3], 1)
            joints.append(replace(joint, origin=origin))
        beside = [round(of.between(30.0, 150.0), 1) * of.sign() for _ in range(2)]
        tool = shift(beside[0], beside[1], round(of.between(30.0, 150.0), 1))
        away = [round(of.between(1000.0, 3000.0), 0) * of.sign(), round(of.between(-1000.0, 1000.0), 0)]
        foot = shift(away[0], away[1], round(of.between(-500.0, 500.0), 0))
        foot = foot @ rpy(0.0, 0.0, round(of.between(-3.1, 3.1), 4))
        chain = replace(chain, joints=tuple(joints)).placed(foot, tool)

        low = np.array([max(j.lower, -_WIDEST / _MIDDLE) for j in chain.joints])
        high = np.array([min(j.upper, _WIDEST / _MIDDLE) for j in chain.joints])
        middle, half = (low + high) / 2, _MIDDLE * (high - low) / 2
        if reads == "sockets":
            drawn = _in_sockets(chain, plan, middle, half)
            if drawn is None:
                return None
            q, socket = drawn
            gaps = tuple((s, s + 1, GAP) for s in range(0, int(socket.max()) + 1, 2))
            silent = kinematics.sockets(q, socket, gaps, GAP_WEIGHT)
        else:
            n = round(plan.log_between(40.0, 160.0))
            unit = np.array([[plan.between(-1.0, 1.0) for _ in chain.joints] for _ in range(n)])
            q, socket = np.round(middle + half * unit, 6), None
            seen = kinematics.forward(chain, {}, q)
            silent = kinematics.targets(q, seen[:, :3, 3], None if reads == "position" else seen[:, :3, :3])
        names = gauge(chain, silent)
        units = kinematics.parameter_units(chain)
        width = np.array([_HALF[units[n]] for n in names])
        box = Box.drawn(streams["box"], np.zeros(len(names)), width, [_DIGITS[units[n]] for n in names])
        made = ArmInstance(
            chain=chain, names=names, box=box, q=q, socket=socket, reads=reads,
            noise=Noise.drawn(streams["noise"], *NOISES), attempts=attempt + 1,
        )  # fmt: skip
        return made if can_be_identified(build(made), len(names), made.noise.level) else None

    return first_that_fits(family, instance, attempt_of)


def _in_sockets(chain: Chain, of: Stream, middle: Array, half: Array) -> tuple[Array, Index] | None:
    """Return postures whose ball is in the sockets by the nominal arm, and their sockets; None if it gets nowhere."""
    sites, each = of.whole(5, 9), of.whole(8, 16)
    tries, points = [], []
    for _ in range(sites):
        about = middle + half * np.array([of.between(-1.0, 1.0) for _ in chain.joints])
        first = kinematics.forward(chain, {}, about[None])[0, :3, 3]
        angle = of.between(0.0, 2 * np.pi)
        for point in (first, first + GAP * np.array([np.cos(angle), np.sin(angle), 0.0])):
            beside = np.array([[of.between(-1.0, 1.0) for _ in chain.joints] for _ in range(3 * each)])
            tries += [*(about + _AROUND * beside)]
            points += [point] * (3 * each)
    at = np.array(points)

    # brought near to the points by Newton's steps of least length
    reached, names = np.array(tries), tuple(kinematics.parameter_units(chain))
    zeros = [names.index(f"zero_{joint.name}") for joint in chain.joints]
    for _ in range(10):
        rest = at - kinematics.forward(chain, {}, reached)[:, :3, 3]
        slopes = kinematics.jacobian(chain, {}, reached)[:, :3, zeros]
        step = np.einsum("njk,nk->nj", np.linalg.pinv(slopes, rcond=1e-3), rest)
        reached = reached + step * np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]

    good = (np.abs(reached - middle) <= half / _MIDDLE).all(axis=1)
    good &= np.linalg.norm(kinematics.forward(chain, {}, reached)[:, :3, 3] - at, axis=1) < 1e-3
    q, socket = [], []
    for k in range(2 * sites):
        kept = 3 * each * k + np.flatnonzero(good[3 * each * k : 3 * each * (k + 1)])[:each]
        if len(kept) < each:
            return None
        q.append(reached[kept])
        socket += [k] * each
    return np.asarray(np.round(np.concatenate(q), 6)), np.array(socket, dtype=np.int64)
