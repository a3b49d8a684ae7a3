"""The moment of gravity on each joint, of everything beyond it, from masses, pose and payload.

The masses and centres are the URDF's; the payload hangs at the target. Gravity is along `gravity` [m/s2] in the frame
of the base, down its z where nothing else is stated. The moment (n, 3) [N mm] is given in the frame of the joint before
it moves: its part along the axis loads the drive, the rest bends bearing and link. Where no mass is known, each link is
taken for a uniform rod: then the moment depends on the pose nearly as it should, and its size is a guess.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibench.discrepancy.machines.arm.geometry import Walk, cross
from calibench.problems.arm.chains.chain import Chain
from calibench.problems.base import Array

GRAVITY = (0.0, 0.0, -9.81)  # m/s2
ROD = 10.0  # kg a metre: what links of which no mass is told are taken to weigh


def moments(chain: Chain, way: Walk, turned: Array, payload: Array, gravity: Array) -> Array:
    """Return the moments on the joints, (n, J, 3) [N mm], in each joint's own frame.

    A link without a stated mass has none. `turned`, (3, 3), is the base in the frame of `way`.
    """
    pull = turned @ gravity  # m/s2, in the tracker's frame
    n = len(way.target)
    weights: list[tuple[Array, Array]] = []  # of each moving body: mass (n,) and place (n, 3)
    turns = [*way.frames[1:], way.flange]
    for k, joint in enumerate(chain.joints):
        if joint.mass is None or joint.centre is None:
            weights.append((np.zeros(n), way.target))
            continue
        turn, place = _moved(chain, k, turns[k])
        weights.append((np.full(n, joint.mass), place + turn @ joint.centre))
    weights.append((payload, way.target))
    found = np.zeros((n, len(chain.joints), 3))
    for k in range(len(chain.joints)):
        turn, place = way.frames[k]
        held = np.zeros((n, 3))
        for mass, centre in weights[k:]:
            held -= cross(centre - place, mass[:, None] * pull)
        found[:, k] = np.einsum("...ji,...j->...i", turn, held)
    return found


def as_rods(chain: Chain) -> Chain:
    """Return the chain with each link as an even rod of `ROD`, from its joint to the next one, or to the tip."""
    ways = [*(joint.origin for joint in chain.joints[1:]), chain.tail]
    joints = tuple(
        replace(joint, mass=ROD * float(np.linalg.norm(way[:3, 3])) / 1e3, centre=way[:3, 3] / 2)
        for joint, way in zip(chain.joints, ways, strict=True)
    )
    return replace(chain, joints=joints)


def _moved(chain: Chain, k: int, following: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the frame that moves with joint k, from that of the next joint before it moves, or of the flange."""
    turn, place = following
    fixed = chain.joints[k + 1].origin if k + 1 < len(chain.joints) else chain.tail
    turn = turn @ fixed[:3, :3].T
    return turn, place - turn @ fixed[:3, 3]
