"""The changes of an arm's description by a calibration, with errors, and what the data do not determine."""

from __future__ import annotations

import numpy as np

from calibench.bench.calibration.fit import Fit, is_length, order_of
from calibench.bench.calibration.report.result import UNMOVED, Change, Undetermined
from calibench.core.words import plain
from calibench.problems.arm.chains.rigid import rpy, rpy_of, shift, slide, turn
from calibench.problems.arm.chains.urdf import Joint, Robot
from calibench.problems.base import Array

_WORDS = {
    "x": "shift along x", "y": "shift along y", "z": "shift along z", "rx": "turn about x", "ry": "turn about y",
    "rz": "turn about z", "zero": "zero", "gain": "scale of its reading",
    **{number: number for number in ("theta", "d", "a", "alpha", "beta")},
}  # fmt: skip
_SAME = 0.999  # of a column's square that others explain: they look alike
_STILL = 1e-9  # mm or rad: no pose tells a number of the target that moves by less from draw to draw
_TELLS = 0.05  # of a column, below which another's share in it is not told


def changes_of(fit: Fit, draws: Array) -> tuple[Change, ...]:
    """Return the changes of the kept parameters of the joints, with the interval that the `draws` (b, k) give."""
    found = []
    for k, place in enumerate(fit.kept):
        name = fit.model.names[place]
        kind, _, joint = name.partition("_")
        if kind in ("base", "tool"):
            continue
        nominal = 1.0 if kind == "gain" else 0.0
        low, high = np.quantile(draws[:, k], [0.025, 0.975]) - nominal
        unit = "mm" if is_length(name, fit.model.sliding) else "" if kind == "gain" else "rad"
        sd = float(draws[:, k].std(ddof=1))
        found.append(
            Change(name, joint, _WORDS[kind], unit, float(fit.p[place] - nominal), sd, (float(low), float(high)))
        )
    return tuple(found)


def undetermined_of(fit: Fit, draws: Array) -> tuple[Undetermined, ...]:
    """Return the parameters of the joints that keep their nominal values, each with the reason."""
    names = fit.model.names
    kept = set(fit.kept.tolist())
    rest = [
        k
        for k in order_of(names, "geometry", fit.model.sliding)
        if k not in kept and not names[k].startswith(("base_", "tool_"))
    ]
    both = np.array([*fit.kept.tolist(), *rest], dtype=np.int64)
    rows = fit.model.jacobian(fit.p, both, fit.weights)[0].reshape(-1, len(both))
    ours, others = rows[:, : len(kept)], rows[:, len(kept) :]
    scale = np.linalg.norm(ours, axis=0) + 1e-12
    shares = np.linalg.lstsq(ours / scale, others, rcond=1e-10)[0]
    left = others - (ours / scale) @ shares
    found = []
    for j, place in enumerate(rest):
        size = float(np.linalg.norm(others[:, j]))
        beyond = float(np.linalg.norm(left[:, j]))
        if size < 1e-9:
            found.append(Undetermined(names[place], UNMOVED))
        elif beyond**2 <= (1 - _SAME) * size**2:
            order = np.argsort(-np.abs(shares[:, j]))
            like = tuple(names[fit.kept[i]] for i in order[:3] if abs(shares[i, j]) > _TELLS * size)
            found.append(Undetermined(names[place], f"looks like {' with '.join(like)}", like))
        else:
            unit = "mm" if is_length(names[place], fit.model.sliding) else "mrad"
            sd = (1.0 if unit == "mm" else 1e3) / beyond
            found.append(
                Undetermined(names[place], f"these poses would tell it to {plain(max(sd, 0.01), 2)} {unit} only")
            )
    return tuple(found)


def origins_of(robot: Robot, fit: Fit, tip: str) -> dict[str, Array]:
    """Return the new origins of the URDF's joints that change, joint -> (4, 4) [mm].

    With a stated `tip` the target is that link, so the fixed joint before it gets the transform to the target.
    """
    own = {joint.name: joint for joint in robot.joints}
    found = {}
    for k, joint in enumerate(fit.model.chain.joints):
        values = fit.p[6 + 8 * k : 14 + 8 * k]
        if not (set(range(6 + 8 * k, 13 + 8 * k)) & set(fit.kept.tolist())):
            continue
        moved = (turn if joint.kind == "rotary" else slide)(joint.axis, values[7] * values[6])
        found[joint.name] = own[joint.name].origin @ _placed(values[:6]) @ moved
    if (last := _before(robot, tip)) is not None:
        target = fit.model.chain.tool @ placement(fit, "tool")
        if fit.model.turns is None:  # a position tells no rotation
            target[:3, :3] = np.eye(3)
        found[last.name] = last.origin @ target
    return found


def changes_of_tip(robot: Robot, fit: Fit, tip: str, draws: Array) -> tuple[Change, ...]:
    """Return the shift and turn of the fixed joint before a stated `tip`, along and about the axes of its frame.

    Empty without one: the target is then somewhere on the last link, and the URDF has no place for it.
    """
    last = _before(robot, tip)
    if last is None:
        return ()
    values = np.tile(fit.p[len(fit.p) - 6 :], (len(draws) + 1, 1))
    for k, place in enumerate(fit.kept):
        if place >= len(fit.p) - 6:
            values[1:, place - len(fit.p) + 6] = draws[:, k]
    told = np.array([_of_target(fit, row) for row in values])
    found = []
    for k, kind in enumerate(("x", "y", "z", "rx", "ry", "rz")[: 3 if fit.model.turns is None else 6]):
        at, beside = float(told[0, k]), told[1:, k] - told[0, k]
        if k >= 3:
            beside = (beside + np.pi) % (2 * np.pi) - np.pi
        sd = float(beside.std(ddof=1))
        if sd < _STILL:
            continue
        low, high = at + np.quantile(beside, [0.025, 0.975])
        unit = "mm" if k < 3 else "rad"
        found.append(Change(f"{kind}_{last.name}", last.name, _WORDS[kind], unit, at, sd, (float(low), float(high))))
    return tuple(found)


def _of_target(fit: Fit, tool: Array) -> Array:
    """Return x y z [mm], roll pitch yaw [rad] of the target on the tip, (6,), for a correction `tool` (6,)."""
    target = fit.model.chain.tool @ _placed(tool)
    return np.array([*target[:3, 3], *rpy_of(target)])


def _before(robot: Robot, tip: str) -> Joint | None:
    """Return the fixed joint that leads to a stated `tip`; None where none does."""
    last = next((joint for joint in robot.joints if joint.child == tip), None) if tip else None
    return None if last is None or last.moves else last


def placement(fit: Fit, name: str) -> Array:
    """Return the correction of `base` or `tool`, (4, 4)."""
    at = 0 if name == "base" else len(fit.p) - 6
    return _placed(fit.p[at : at + 6])


def _placed(values: Array) -> Array:
    made: Array = shift(values[0], values[1], values[2]) @ rpy(values[3], values[4], values[5])
    return made
