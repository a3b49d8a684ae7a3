"""The kinematics of a chain whose numbers differ from row to row: that is how an effect enters. Slopes, too.

    base:     Trans(base_x, base_y, base_z) . Rz(base_rz) Ry(base_ry) Rx(base_rx) . turned
    joint J:  (length_J along the stated way) . stated turn . Trans(x_J, y_J, z_J) . Rz(rz_J) Ry(ry_J) Rx(rx_J) . motion

`turned` is found from the data, so that the three angles stay small; `motion` is about, or along, the axis by the
reading plus `zero_J`. The target lies at tool_x, tool_y, tool_z in the frame of the flange. A complex step passes
through. A test holds it to `kinematics`, which is compiled and tens of times as fast where rows are alike.

The joints hold moments of gravity. The part about a joint's axis loads its drive, which gives way by its compliance: it
stands at q - kappa torque; the rest bends bearing and link. Masses are the URDF's, and a payload hangs at the target.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from calibench.calibration.kinematics import Chain
from calibench.calibration.rigid import Array, Numbers, cross
from calibench.core.notes import DataError

Quantities = Mapping[str, Any]
PLACE = ("x", "y", "z")
TURNS = ("rx", "ry", "rz")
BASE = tuple(f"base_{one}" for one in (*PLACE, *TURNS))
TOOL = tuple(f"tool_{one}" for one in PLACE)
READING = "q_"  # before the name of a joint: the column that it is read from
LEAST_LENGTH = 1.0  # mm, from which on a link has a length of its own


@final
@dataclass(frozen=True, eq=False)
class Walk:
    """The way from the tracker's frame to the target: where each number acts, and along or about which axis.

    `at` has name -> point (n, 3), `along` name -> direction (n, 3) of a shift, `about` name -> axis (n, 3) of a turn.
    `frames` are those of the joints before they move, turn (n, 3, 3) and place (n, 3); `flange` that of the flange.
    """

    target: Numbers
    flange: tuple[Numbers, Numbers]
    frames: tuple[tuple[Numbers, Numbers], ...]
    along: dict[str, Numbers]
    about: dict[str, tuple[Numbers, Numbers]]


def of_joint(joint: str) -> tuple[str, ...]:
    """Return the names of the six placement errors of a joint."""
    return tuple(f"{one}_{joint}" for one in (*PLACE, *TURNS))


def quantities(chain: Chain) -> dict[str, float]:
    """Return every number of the arm's own with its nominal value; `length_J` [mm] where it is not zero."""
    far = {f"length_{j.name}": float(np.linalg.norm(j.origin[:3, 3])) for j in chain.joints}
    named = {name: length for name, length in far.items() if length > LEAST_LENGTH}
    for joint in chain.joints:
        named |= dict.fromkeys((*of_joint(joint.name), f"zero_{joint.name}"), 0.0)
    return named


def walk(chain: Chain, base: Array, q: Quantities) -> Walk:
    """Return the way to the target at the quantities `q`, each (n,) or (); the base is turned by `base`, (3, 3)."""
    n = np.shape(q[READING + chain.driven[0]])
    turn: Numbers = np.eye(3)
    place: Numbers = np.zeros(3)
    along: dict[str, Numbers] = {}
    about: dict[str, tuple[Numbers, Numbers]] = {}

    def shifted(names: tuple[str, ...]) -> None:
        nonlocal place
        for k, name in enumerate(names):
            along[name] = turn[..., :, k]
            place = place + along[name] * np.asarray(q[name])[..., None]

    def turned(names: tuple[str, ...]) -> None:
        nonlocal turn
        for name, k in zip(reversed(names), (2, 1, 0)):
            about[name] = (turn[..., :, k], place)
            turn = _about(turn, np.eye(3)[k], q[name])

    shifted(BASE[:3])
    turned(BASE[3:])
    turn = _by(turn, base)
    (gains, offsets), frames = chain.following, []
    for k, joint in enumerate(chain.joints):
        way, length = joint.origin[:3, 3], f"length_{joint.name}"
        if length in q:
            along[length] = _by(turn, way / np.linalg.norm(way))
            place = place + along[length] * np.asarray(q[length])[..., None]
        else:
            place = place + _by(turn, way)
        turn = _by(turn, joint.origin[:3, :3])
        six = of_joint(joint.name)
        shifted(six[:3])
        turned(six[3:])
        frames.append((turn, place))
        stands = q[f"zero_{joint.name}"] + offsets[k]
        for gain, name in zip(gains[k], chain.driven):
            if gain:
                stands = stands + gain * q[READING + name]
        axis = _by(turn, joint.axis)
        if joint.kind == "rotary":
            about[f"zero_{joint.name}"] = (axis, place)
            turn = _about(turn, joint.axis, stands)
        else:
            along[f"zero_{joint.name}"] = axis
            place = place + axis * np.asarray(stands)[..., None]
    place = place + _by(turn, chain.tail[:3, 3])
    turn = _by(turn, chain.tail[:3, :3])
    flange = (np.broadcast_to(turn, (*n, 3, 3)), np.broadcast_to(place, (*n, 3)))
    shifted(TOOL)
    return Walk(np.broadcast_to(place, (*n, 3)), flange, tuple(frames), along, about)


def slopes(chain: Chain, way: Walk) -> dict[str, Array]:
    """Return the derivative of the target's place in each quantity, name -> (n, 3)."""
    return {name: slope(chain, way, name) for name in slope_names(chain, way)}


def slope_names(chain: Chain, way: Walk) -> tuple[str, ...]:
    """Return the names of the quantities in which `slope` gives a derivative."""
    return (*way.along, *way.about, *(READING + name for name in chain.driven))


def slope(chain: Chain, way: Walk, name: str) -> Array:
    """Return the derivative of the target's place in one quantity, (n, 3)."""
    n = way.target.shape
    if name in way.along:
        return _spread(way.along[name], n)
    if name in way.about:
        axis, at = way.about[name]
        return cross(_spread(axis, n), way.target - at)
    parts = [by * slope(chain, way, zero) for zero, by in _followers(chain, name.removeprefix(READING)).items()]
    return np.asarray(sum(parts[1:], parts[0]))


def turn_slopes(chain: Chain, way: Walk, more: dict[str, Array], measure: Callable[[Array], Array]) -> dict[str, Array]:
    """Return the derivative of the flange's rotation in each quantity, and about `more` axes, name -> (n, 3)."""
    n = way.target.shape
    axes = {name: axis for name, (axis, _) in way.about.items()} | more
    by_name = dict(zip(axes, measure(np.stack([_spread(axis, n) for axis in axes.values()]))))
    by_name |= {f"zero_{j.name}": np.zeros(n) for j in chain.joints if j.kind != "rotary"}
    for name in chain.driven:  # of a reading: the slope of each following joint's zero times its gain
        parts = [by * by_name[zero] for zero, by in _followers(chain, name).items()]
        by_name[READING + name] = np.asarray(sum(parts[1:], parts[0]))
    return by_name


def _followers(chain: Chain, driven: str) -> dict[str, float]:
    """Return the zeros of the joints that follow the reading of a driven one, each with its gain."""
    gains, _ = chain.following
    i = chain.driven.index(driven)
    return {f"zero_{j.name}": float(gains[k, i]) for k, j in enumerate(chain.joints) if gains[k, i]}


def _spread(one: Numbers, shape: tuple[int, ...]) -> Numbers:
    """Return `one` in all rows; most are so already, and broadcasting costs as much as a product."""
    return one if one.shape == shape else np.broadcast_to(one, shape)


def _by(turn: Numbers, fixed: Array) -> Numbers:
    """Return turn @ fixed, (..., 3, 3) by (3, 3) or (3,), as one product of two matrices."""
    return np.asarray((turn.reshape(-1, 3) @ fixed).reshape(turn.shape if fixed.ndim == 2 else turn.shape[:-1]))


def _about(turn: Numbers, axis: Array, angle: Any) -> Numbers:
    """Return `turn`, (..., 3, 3), followed by rotations about a unit axis."""
    angle = np.asarray(angle)
    if angle.ndim == 0 and angle == 0:
        return turn
    if angle.ndim and 1.0 in axis.tolist():  # a coordinate axis: only two columns change
        k = axis.tolist().index(1.0)
        c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
        first, second = turn[..., (k + 1) % 3], turn[..., (k + 2) % 3]
        turned = np.empty((*angle.shape, 3, 3), dtype=np.result_type(turn, c))
        turned[..., k] = turn[..., k]
        turned[..., (k + 1) % 3] = c * first + s * second
        turned[..., (k + 2) % 3] = c * second - s * first
        return turned
    x, y, z = axis
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    along = np.outer(axis, axis)
    if angle.ndim == 0:
        return _by(turn, along + np.cos(angle) * (np.eye(3) - along) + np.sin(angle) * across)
    c, s = np.cos(angle)[..., None, None], np.sin(angle)[..., None, None]
    kept = _by(turn, along)
    return np.asarray(kept + c * (turn - kept) + s * _by(turn, across))


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
