"""What the joints of an arm hold: the moments of gravity on each of them, in its frame before it moves.

The part about a joint's axis loads its drive, which gives way by its compliance: it stands at q - kappa torque; the
rest bends bearing and link. Masses are the URDF's, and a payload hangs at the target.
"""

from collections.abc import Mapping

import numpy as np

from calibench.calibration.kinematics import Chain
from calibench.calibration.rigid import Array, cross
from calibench.calibration.walk import BASE, READING, TOOL, Walk, quantities, walk
from calibench.core.notes import DataError

GRAVITY = (0.0, 0.0, -9.81)  # m/s2


def torques(
    chain: Chain, joints: Array, tool: Array, payload: Array, measured: Mapping[str, Array], source: str
) -> Array:
    """Return the torque about each driven joint, (n, columns) [N m]: of a `measured` column [N mm], else of gravity.

    `joints` (n, columns) are read, the target is at `tool` (3,) [mm] on the tip, and `payload` (n,) [kg] hangs there.
    Raises `DataError` where nothing tells what the joints hold.
    """
    if all(joint.mass is None for joint in chain.joints) and not payload.any() and not measured:
        raise DataError(
            f"level=elastic: nothing tells what the joints hold: masses in the {source}, a column payload_kg, or "
            "torque_J of a joint J are needed"
        )
    numbers = quantities(chain) | dict.fromkeys(BASE, 0.0) | dict(zip(TOOL, tool.tolist(), strict=True))
    way = walk(chain, np.eye(3), numbers | {READING + name: joints[:, k] for k, name in enumerate(chain.driven)})
    about = torques_about_axes(chain, moments(chain, way, np.eye(3), payload, np.array(GRAVITY)))
    for k, name in enumerate(chain.driven):
        if name in measured:
            about[:, k] = np.nan_to_num(measured[name])
    return 1e-3 * about


def torques_about_axes(chain: Chain, held: Array) -> Array:
    """Return the torque that moments `held` (n, J, 3) ask of each driven joint, (n, columns) [N mm]."""
    gains, _ = chain.following
    turning = np.array([joint.kind == "rotary" for joint in chain.joints], dtype=float)
    about = np.stack([held[:, k] @ joint.axis for k, joint in enumerate(chain.joints)], axis=1)
    return np.asarray((about * turning) @ gains)


def moments(chain: Chain, way: Walk, turned: Array, payload: Array, gravity: Array) -> Array:
    """Return the moments on the joints, (n, J, 3) [N mm], in each joint's own frame."""
    pull = turned @ gravity  # m/s2, in the tracker's frame
    n = len(way.target)
    weights: list[tuple[Array, Array]] = []  # of each moving body: mass (n,) and place (n, 3)
    turns = [*way.frames[1:], way.flange]
    for k, joint in enumerate(chain.joints):
        if joint.mass is None or joint.centre is None:
            weights.append((np.zeros(n), way.target))
            continue
        # the frame that moves with joint k, from that of the next joint before it moves, or of the flange
        turn, place = turns[k]
        fixed = chain.joints[k + 1].origin if k + 1 < len(chain.joints) else chain.tail
        turn = turn @ fixed[:3, :3].T
        place = place - turn @ fixed[:3, 3]
        weights.append((np.full(n, joint.mass), place + turn @ joint.centre))
    weights.append((payload, way.target))
    on_joints = np.zeros((n, len(chain.joints), 3))
    for k in range(len(chain.joints)):
        turn, place = way.frames[k]
        held = np.zeros((n, 3))
        for mass, centre in weights[k:]:
            held -= cross(centre - place, mass[:, None] * pull)
        on_joints[:, k] = np.einsum("...ji,...j->...i", turn, held)
    return on_joints
