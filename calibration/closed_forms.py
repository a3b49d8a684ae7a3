"""The frame of a camera by three closed forms that other tools use, beside ours.

The board is seen at B = M A T for the arm's poses A, and the camera is X = M^-1. Motions between poses have
A_i A_j^-1 X = X B_i B_j^-1 (Tsai and Lenz 1989, Park and Martin 1994), and poses themselves B T^-1 = M A (Shah 2013).
All weigh each pair alike and find rotations first. How far noise alone has them from ours is that of pairs drawn anew.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import final

import numpy as np

from calibench.calibration.frames import nearest_rotation
from calibench.calibration.hand_eye_fit import Adjustment, Sight
from calibench.calibration.rigid import Array, inverse, rotation_of, vector_of
from calibench.core.words import plain

_MOST = 300  # pairs: of more, every second, third ...
_BESIDE = 20  # poses to which motions go from each: of 40 pairs and fewer, half of all motions
_DRAWS = 20
_BEYOND = 4.0  # times what noise does: a chance of one in 10 000


@final
@dataclass(frozen=True)
class ClosedForm:
    """The camera in its parent by a closed form of all pairs, and how far it is from ours.

    `shift` (x y z) [mm] and `turn` (about x y z of the parent) [rad] lead there from ours; `shift_near` and `turn_near`
    those of the pairs alone that our fit uses. `noise` [mm] and `noise_turn` [rad] are how far noise alone has it.
    """

    name: str
    shift: tuple[float, ...]
    turn: tuple[float, ...]
    shift_near: tuple[float, ...]
    turn_near: tuple[float, ...]
    noise: float
    noise_turn: float

    def size(self) -> str:
        """Return how far it is from ours, in words."""
        shift, turn = (float(np.linalg.norm(one)) for one in (self.shift, self.turn))
        return f"{plain(shift, 2)} mm and {plain(float(np.rad2deg(turn)), 2)}°"

    @property
    def by_noise(self) -> bool:
        """Whether noise alone may have it where the near pairs have it."""
        sizes = np.linalg.norm(self.shift_near), np.linalg.norm(self.turn_near)
        return bool(sizes[0] <= _BEYOND * self.noise and sizes[1] <= _BEYOND * self.noise_turn)


def closed_forms(found: Adjustment) -> tuple[ClosedForm, ...]:
    """Return the closed forms of the pairs that `found` was fitted to, where enough of them are near."""
    every = max(1, -(-len(found.wild) // _MOST))
    some = np.zeros(len(found.wild), dtype=bool)
    some[::every] = True
    near = some & ~found.wild
    arm, seen = found.sight.moved(found.offset), found.sight.seen.copy()
    seen[:, :3, 3] /= found.scale

    # what the board would be seen at with the noise of `found`, drawn anew
    sight: Sight = found.sight.at(near)
    true = found.mount @ sight.moved(found.offset) @ found.tool
    axes = found.axes[near].swapaxes(1, 2)
    rng = np.random.default_rng(np.random.SeedSequence([len(true), 18]))
    drawn = []
    for noise in rng.normal(size=(_DRAWS, len(true), 6)) * found.noise[found.groups]:
        error = (axes @ noise[:, :, None])[:, :, 0]
        board = true.copy()
        board[:, :3, 3] += error[:, :3] / found.scale
        board[:, :3, :3] = rotation_of(error[:, 3:]) @ true[:, :3, :3]
        drawn.append(board)

    made = []
    for name, solve in FORMS.items():
        try:
            whole, kept = (_away(found, solve(arm[one], seen[one])) for one in (some, near))
            by_noise = np.array([_away(found, solve(arm[near], board)) for board in drawn])
        except np.linalg.LinAlgError:
            continue
        rms = np.sqrt((by_noise**2).sum(axis=2).mean(axis=0))
        shift, turn, shift_near, turn_near = (tuple(map(float, one)) for one in (*whole, *kept))
        made.append(ClosedForm(name, shift, turn, shift_near, turn_near, float(rms[0]), float(rms[1])))
    return tuple(made)


def park_martin(arm: Array, seen: Array) -> Array:
    """Return X of A X = X B by the rotation that turns the vectors of B nearest to those of A."""
    a, b = _motions(arm), _motions(seen)
    return _placed(a, b, nearest_rotation(vector_of(a[:, :3, :3]).T @ vector_of(b[:, :3, :3])))


def tsai_lenz(arm: Array, seen: Array) -> Array:
    """Return X of A X = X B by vectors of 2 sin(angle / 2): skew(P_A + P_B) P = P_B - P_A, P of tan(angle / 2)."""
    a, b = _motions(arm), _motions(seen)
    vectors = [vector_of(one[:, :3, :3]) for one in (a, b)]
    p, q = (v * np.sinc(np.linalg.norm(v, axis=1, keepdims=True) / (2 * np.pi)) for v in vectors)
    rows = -np.cross((p + q)[:, None, :], np.eye(3)[None])
    half = np.linalg.lstsq(rows.reshape(-1, 3), (q - p).ravel(), rcond=None)[0]
    size = float(np.linalg.norm(half))
    vector = half / max(size, 1e-300) * 2 * np.arctan(size)
    return _placed(a, b, rotation_of(vector[None])[0])


def shah(arm: Array, seen: Array) -> Array:
    """Return the camera of B T^-1 = M A by the singular vectors of the sum of Kronecker products of rotations."""
    a, b = arm[:, :3, :3], seen[:, :3, :3]
    u, _, v = np.linalg.svd(np.einsum("nij,nkl->ikjl", a, b).reshape(9, 9))  # of X and T: X = mean of A T B'
    both = np.stack([u[:, 0], v[0]]).reshape(2, 3, 3)
    turn = nearest_rotation(both * np.sign(np.linalg.det(both[0])))[0].T
    rows = np.concatenate([b, np.tile(-np.eye(3), (len(b), 1, 1))], axis=2)
    wanted = arm[:, :3, 3] @ turn.T - seen[:, :3, 3]
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = turn, np.linalg.lstsq(rows.reshape(-1, 6), wanted.ravel(), rcond=None)[0][3:]
    return np.asarray(inverse(made))


FORMS: Mapping[str, Callable[[Array, Array], Array]] = MappingProxyType(
    {"Park-Martin": park_martin, "Tsai-Lenz": tsai_lenz, "Shah": shah}
)


def _motions(poses: Array) -> Array:
    """Return the motions between poses, (m, 4, 4), of each to some that follow it in a ring."""
    n = len(poses)
    steps = range(1, n) if n <= _BESIDE else np.unique(np.linspace(1, n // 2, _BESIDE).astype(int))
    pairs = [(i, (i + step) % n) for step in steps for i in range(n) if n > _BESIDE or i + step < n]
    first, second = np.array(pairs).T
    return np.asarray(poses[second] @ inverse(poses[first]))


def _placed(a: Array, b: Array, turn: Array) -> Array:
    """Return X with the rotation `turn`, at (R_A - 1) x = turn b - a."""
    rows, wanted = a[:, :3, :3] - np.eye(3), b[:, :3, 3] @ turn.T - a[:, :3, 3]
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = turn, np.linalg.lstsq(rows.reshape(-1, 3), wanted.ravel(), rcond=None)[0]
    return made


def _away(found: Adjustment, camera: Array) -> tuple[Array, Array]:
    ours = inverse(found.mount)
    return camera[:3, 3] - ours[:3, 3], vector_of((camera[:3, :3] @ ours[:3, :3].T)[None])[0]
