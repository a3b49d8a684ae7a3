"""Instances of `arm_ur10` and `arm_panda`: another arm, errors, postures, noise and box for each ``instance=K``.

- *nominal arm*: each link of a UR10 or Panda .7 .. 1.3 times as long, to .1 mm, and a target 30 .. 150 mm beside the
  last axis and before it; the base 1 to 3 m from the tracker, turned about the vertical.
- *true arm*: each parameter that the postures determine is wrong as `problems.instances` says of the *box*, with h = 5
  mm and .03 rad, to .001 mm and 1e-6 rad.
- *postures*: for `arm_ur10` 40 .. 160 (log-uniform) in the middle 70 % of the joints' ranges (-2.6 .. 2.6 rad at most),
  to 1e-6 rad. For `arm_panda` 5 .. 9 places of two sockets 50 mm apart, 8 .. 16 postures a socket, brought there by the
  nominal arm; how far beside the socket's point the true ball then is, is known.
- *noise* of each coordinate: none, or .005 .. .1 mm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, final

import numpy as np

from calibench.calibration.compared import Compared, poses, positions, sockets
from calibench.calibration.determined import gauge
from calibench.calibration.kinematics import Chain, forward, jacobian, parameter_names, parameter_units
from calibench.calibration.rigid import Index, rpy, shift
from calibench.calibration.urdf import read_urdf
from calibench.problems.arm.measured import shipped
from calibench.problems.base import Array
from calibench.problems.instances import Box, Noise, Stream, can_be_identified, first_that_fits

NOISES = (5e-3, 1e-1)  # mm
_HALF = {"mm": 5.0, "rad": 0.03}
_DIGITS = {"mm": 3, "rad": 6}
_MIDDLE = 0.7
_WIDEST = 2.6  # rad
_GAP = 50.0  # mm
_GAP_WEIGHT = 3.0
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

    @property
    def options(self) -> dict[str, Any]:
        """Return what the instance decides of the family's options: nothing that can be given."""
        return {}

    def read(self, noise: float) -> Compared:
        """Return what the true arm gives to read, with noise of a standard deviation [mm] (turns: over 100 mm)."""
        rng = np.random.default_rng(self.noise.data_seed)
        true = forward(self.chain, dict(zip(self.names, self.box.truth.tolist(), strict=True)), self.q)
        away, turned = noise * rng.standard_normal((2, len(self.q), 3))
        if self.socket is not None:
            count = int(self.socket.max()) + 1
            middles = np.array([true[self.socket == s, :3, 3].mean(axis=0) for s in range(count)])
            known = [
                (s, s + 1, float(np.linalg.norm(middles[s + 1] - middles[s])) + noise * float(rng.standard_normal()))
                for s in range(0, count, 2)
            ]
            return sockets(self.q, self.socket, tuple(known), _GAP_WEIGHT, true[:, :3, 3] + away)
        true[:, :3, 3] += away
        if self.reads == "position":
            return positions(self.q, true[:, :3, 3])
        if noise > 0:
            true[:, :3, :3] = np.stack([rpy(*w)[:3, :3] for w in turned / 100.0]) @ true[:, :3, :3]
        return poses(self.q, true)


@cache
def arm_instance(family: str, instance: int, reads: str, build: Callable[[ArmInstance], Any]) -> ArmInstance:
    """Return the instance; ``build(drawn)`` makes its problem without noise."""
    return first_that_fits(family, instance, lambda attempt: _attempt(family, instance, attempt, reads, build))


def _attempt(
    family: str, instance: int, attempt: int, reads: str, build: Callable[[ArmInstance], Any]
) -> ArmInstance | None:
    streams = {t: Stream.of(family, instance, attempt, t) for t in ("machine", "box", "plan", "noise")}
    chain = _arm(family, streams["machine"])
    drawn = _in_sockets(chain, streams["plan"]) if reads == "sockets" else _spread(chain, streams["plan"])
    if drawn is None:
        return None
    q, socket = drawn
    seen = forward(chain, {}, q)
    silent = (
        sockets(q, socket, tuple((s, s + 1, _GAP) for s in range(0, int(socket.max()) + 1, 2)), _GAP_WEIGHT)
        if socket is not None
        else positions(q, seen[:, :3, 3])
        if reads == "position"
        else poses(q, seen)
    )
    names = gauge(chain, silent).kept
    units = dict(zip(parameter_names(chain), parameter_units(chain), strict=True))
    half = np.array([_HALF[units[n]] for n in names])
    box = Box.drawn(streams["box"], np.zeros(len(names)), half, [_DIGITS[units[n]] for n in names])
    noise = Noise.drawn(streams["noise"], *NOISES)
    instance_ = ArmInstance(
        chain=chain, names=names, box=box, q=q, socket=socket, reads=reads, noise=noise, attempts=attempt + 1
    )
    return instance_ if can_be_identified(build(instance_), len(names), noise.level) else None


def _arm(family: str, of: Stream) -> Chain:
    robot = read_urdf(shipped("ur10.urdf" if family == "arm_ur10" else "panda.urdf"))
    chain = robot.chain()
    joints = []
    for joint in chain.joints:
        origin, factor = joint.origin.copy(), of.between(0.7, 1.3)
        origin[:3, 3] = np.round(factor * origin[:3, 3], 1)
        joints.append(replace(joint, origin=origin))
    beside = [round(of.between(30.0, 150.0), 1) * of.sign() for _ in range(2)]
    tool = shift(beside[0], beside[1], round(of.between(30.0, 150.0), 1))
    away = [round(of.between(1000.0, 3000.0), 0) * of.sign(), round(of.between(-1000.0, 1000.0), 0)]
    mount = shift(away[0], away[1], round(of.between(-500.0, 500.0), 0)) @ rpy(
        0.0, 0.0, round(of.between(-3.1, 3.1), 4)
    )
    return replace(chain, joints=tuple(joints)).placed(mount, tool)


def _ranges(chain: Chain) -> tuple[Array, Array]:
    low = np.array([max(j.lower, -_WIDEST / _MIDDLE) for j in chain.joints])
    high = np.array([min(j.upper, _WIDEST / _MIDDLE) for j in chain.joints])
    return (low + high) / 2, _MIDDLE * (high - low) / 2


def _spread(chain: Chain, of: Stream) -> tuple[Array, None]:
    n = round(of.log_between(40.0, 160.0))
    middle, half = _ranges(chain)
    unit = np.array([[of.between(-1.0, 1.0) for _ in chain.joints] for _ in range(n)])
    return np.round(middle + half * unit, 6), None


def _in_sockets(chain: Chain, of: Stream) -> tuple[Array, Index] | None:
    """Return postures whose ball is in the sockets by the nominal arm, and their sockets; None if it gets nowhere."""
    middle, half = _ranges(chain)
    sites, each = of.whole(5, 9), of.whole(8, 16)
    tries, points = [], []
    for _ in range(sites):
        about = middle + half * np.array([of.between(-1.0, 1.0) for _ in chain.joints])
        first = forward(chain, {}, about[None])[0, :3, 3]
        angle = of.between(0.0, 2 * np.pi)
        for point in (first, first + _GAP * np.array([np.cos(angle), np.sin(angle), 0.0])):
            tries += [
                about + _AROUND * np.array([of.between(-1.0, 1.0) for _ in chain.joints]) for _ in range(3 * each)
            ]
            points += [point] * (3 * each)
    at = np.array(points)
    reached = _brought(chain, np.array(tries), at)
    good = (np.abs(reached - middle) <= half / _MIDDLE).all(axis=1)
    good &= np.linalg.norm(forward(chain, {}, reached)[:, :3, 3] - at, axis=1) < 1e-3
    q, socket = [], []
    for k in range(2 * sites):
        kept = 3 * each * k + np.flatnonzero(good[3 * each * k : 3 * each * (k + 1)])[:each]
        if len(kept) < each:
            return None
        q.append(reached[kept])
        socket += [k] * each
    return np.asarray(np.round(np.concatenate(q), 6)), np.array(socket, dtype=np.int64)


def _brought(chain: Chain, q: Array, point: Array) -> Array:
    """Return postures near q, (n, J), whose targets are at the points (n, 3), by Newton's steps of least length."""
    names = parameter_names(chain)
    zeros = [names.index(f"zero_{joint.name}") for joint in chain.joints]
    for _ in range(10):
        rest = point - forward(chain, {}, q)[:, :3, 3]
        slopes = jacobian(chain, {}, q)[:, :3, zeros]
        step = np.einsum("njk,nk->nj", np.linalg.pinv(slopes, rcond=1e-3), rest)
        q = q + step * np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
    return q
