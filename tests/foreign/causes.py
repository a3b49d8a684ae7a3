"""Causes that no catalogue has, causes whose forms are off those of the catalogue, and noise of other laws.

A cause returns errors of a machine's encoders (n, J) and displacements (n, d) of any size; `case` scales them. Each
has physics of its own: nothing is made of a catalogue's formulas times a random factor.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.foreign.machines import Array, Day, Machine

Errors = tuple[Array, Array]
Cause = Callable[[Machine, np.random.Generator, int], Errors]


def _on(m: Machine, j: int, values: Array) -> Errors:
    angle = np.zeros_like(m.day.q)
    angle[:, j] = values
    return angle, np.zeros((len(values), m.push.shape[-1]))


def _pushed(m: Machine, push: Array) -> Errors:
    return np.zeros_like(m.day.q), push


def _other(m: Machine, j: int, rng: np.random.Generator) -> int:
    return int(rng.choice([k for k in range(m.day.q.shape[1]) if k != j]))


def _middle(values: Array) -> Array:
    """Return values from -1 to 1 over their range."""
    return np.asarray(2 * (values - values.min()) / np.ptp(values) - 1)


def walk(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    """A sensor's zero wanders: a random walk in time."""
    return _on(m, j, np.cumsum(rng.normal(size=len(m.day.t)) * np.sqrt(np.diff(m.day.t, prepend=0.0))))


def crosstalk(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    """The lines of another encoder are heard in this one."""
    other = m.day.q[:, _other(m, j, rng)]
    return _on(m, j, np.sin(rng.uniform(5, 30) * other + rng.uniform(0, 6)) * (1 + 0.5 * np.sin(m.day.q[:, j])))


def flex(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    """What the machine stands on gives way under its load, more than in proportion."""
    load = m.day.torque
    size = np.sqrt(np.sum((load / np.abs(load).max()) ** 2, axis=1))
    push = np.zeros((len(size), m.push.shape[-1]))
    if m.name == "gpm2002":
        way = m.day.torque[:, j] / np.abs(m.day.torque[:, j]).max()
        push[:, 2 * j], push[:, 2 * j + 1] = size * way, size * np.abs(way) * rng.uniform(-1, 1)
    elif m.name == "arm":
        lever = m.day.place - m.day.place.mean(axis=0)
        tilt = np.cross(lever, np.array([0, 0, 1.0]))
        push = np.cross(tilt / np.linalg.norm(tilt, axis=1).max(), lever) * size[:, None]
    else:
        az, el = m.day.q.T
        push[:, 0] = np.cos(el) ** 2 * np.sin(az) * np.sin(2 * el)
        push[:, 1] = np.abs(np.cos(az + 0.4)) ** 1.5 * np.cos(el) ** 2
    return _pushed(m, push)


def sag(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    """A part sags on one side only, and sticks to its stop on the other."""
    turn = np.cos((m.day.q[:, j] - rng.uniform(-1, 1)) * rng.uniform(0.8, 1.4))
    return _on(m, j, np.where(turn > 0, np.abs(turn) ** 1.5, 0.25 * turn) * (1 + 0.4 * m.day.run))


def stribeck(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    """Friction that falls with speed and then grows holds the joint back."""
    v = np.abs(m.day.speed[:, j])
    slow = np.median(v) * rng.uniform(0.4, 1.0)
    hold = 0.4 + np.exp(-((v / slow) ** 2)) + 0.15 * v / np.median(v)
    return _on(m, j, -m.day.came[:, j] * hold)


def stick_slip(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    """A joint winds up as it goes and lets go at once: a saw over the way since it turned back."""
    far, lag = 0.0, []
    pitch = rng.uniform(0.3, 0.9) * float(np.ptp(m.day.q[:, j]))
    for step in np.diff(m.day.q[:, j], prepend=m.day.q[0, j] - 0.1):
        far = far + step
        if abs(far) > pitch:
            far = np.sign(far) * (abs(far) % pitch)
        lag.append(far)
    return _on(m, j, np.array(lag))


def bump(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    """At one place something touches: a bump over two joints or the place."""
    at = np.stack([_middle(m.day.q[:, j]), _middle(m.day.q[:, _other(m, j, rng)])], axis=1)
    middle = at[rng.integers(len(at))] * 0.7
    return _on(m, j, np.exp(-np.sum(((at - middle) / rng.uniform(0.3, 0.6)) ** 2, axis=1)))


def coupling(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    """Two joints move one another: the sine of one times the cosine of the other."""
    a, b = m.day.q[:, j], m.day.q[:, _other(m, j, rng)]
    return _on(m, j, np.sin(a * rng.uniform(0.8, 2) + rng.uniform(0, 6)) * np.cos(b * rng.uniform(0.8, 2)))


def hot(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    """The zero follows the square of the warmth above a turning point."""
    return _on(m, j, (m.day.warmth - np.quantile(m.day.warmth, rng.uniform(0.2, 0.8))) ** 2)


def slow_heat(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    """A heavy part follows the warmth by a first-order lag of a good part of the run, and its joint turns with it."""
    late, own = [], m.day.warmth[0]
    slow = rng.uniform(0.15, 0.6)
    for now, step in zip(m.day.warmth, np.diff(m.day.run, prepend=0.0)):
        own = own + (now - own) * (1 - np.exp(-step / slow))
        late.append(own)
    return _on(m, j, np.array(late) * (1 + 0.8 * np.sin(m.day.q[:, j] + rng.uniform(0, 6))))


def beat(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    """Two wheels of nearly the same count mesh: tooth errors that beat."""
    teeth, q = rng.uniform(20, 60), m.day.q[:, j]
    return _on(m, j, np.sin(teeth * q) * np.cos(rng.uniform(1.5, 4) * q + rng.uniform(0, 6)))


def memory(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    """A belt of several strands that slip one after the other remembers where it came from."""
    way, out = float(np.ptp(m.day.q[:, j])), np.zeros(len(m.day.t))
    for part in rng.uniform(0.05, 0.5, 4):
        spring, held = 0.0, []
        for step in np.diff(m.day.q[:, j], prepend=m.day.q[0, j]):
            spring = float(np.clip(spring + step, -part * way, part * way))
            held.append(spring)
        out += np.array(held)
    return _on(m, j, out)


def cable(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    """A cable pulls once its slack is used up by two joints together."""
    a, b = _middle(m.day.q[:, j]), _middle(m.day.q[:, _other(m, j, rng)])
    return _on(m, j, np.maximum(a + rng.uniform(0.4, 1) * b - rng.uniform(-0.2, 0.4), 0) ** 1.5)


def loose(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    """A loose screw: the zero is here or there, and changes at a moment's notice."""
    changes = np.sort(rng.uniform(0, 1, rng.integers(5, 9)))
    return _on(m, j, 2.0 * (np.searchsorted(changes, m.day.run) % 2) - 1)


def warm_wave(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    """A scale that bends as it warms: a wave over the turn times the warmth."""
    w = m.day.warmth - m.day.warmth.mean()
    return _on(m, j, w * np.sin(rng.uniform(1, 2.5) * m.day.q[:, j] + rng.uniform(0, 6)))


FOREIGN: dict[str, Cause] = {
    "walk": walk, "crosstalk": crosstalk, "flex": flex, "sag": sag, "stribeck": stribeck, "stick_slip": stick_slip,
    "bump": bump, "coupling": coupling, "hot": hot, "slow_heat": slow_heat, "beat": beat, "memory": memory,
    "cable": cable, "loose": loose, "warm_wave": warm_wave,
}  # fmt: skip


# --- causes of the catalogue in forms that are not its own
def _play(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    v = np.abs(m.day.speed[:, j])
    return _on(m, j, m.day.came[:, j] * (1 - 0.35 * np.exp(-v / np.median(v) * rng.uniform(1.5, 3))))


def _spring(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    load = m.day.torque[:, j] / np.abs(m.day.torque[:, j]).max()
    return _on(m, j, load / (1 + rng.uniform(0.15, 0.4) * np.abs(load)))


def _saw(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    turn = m.day.q[:, j] + rng.uniform(0, 6)
    return _on(m, j, np.sin(turn) + rng.uniform(0.08, 0.15) * np.sin(2 * turn + 0.3))


def _teeth(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    count = m.stated["tooth_numbers"][j] if m.name == "gpm2002" else m.stated["teeth"]
    turn = count * m.day.q[:, j] + rng.uniform(0, 6)
    return _on(m, j, np.sin(turn) - rng.uniform(0.08, 0.12) * np.sin(3 * turn))


def _settling(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    slow = rng.uniform(2, 5)
    return _on(m, j, slow * m.day.run + 0.3 * (1 - np.exp(-slow * m.day.run)))


def _slow_slip(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    return _on(m, j, np.clip((m.day.run - rng.uniform(0.2, 0.7)) / rng.uniform(0.01, 0.04), 0, 1))


def _warm(m: Machine, rng: np.random.Generator, j: int) -> Errors:
    w = m.day.warmth - m.day.warmth.min()
    return _on(m, j, w + rng.uniform(0.02, 0.04) * w**2)


def _droop(m: Machine, rng: np.random.Generator, _: int) -> Errors:
    push = np.zeros((len(m.day.t), 2))
    push[:, 1] = -np.cos(m.day.q[:, 1]) * (1 + rng.uniform(0.1, 0.2) * np.cos(m.day.q[:, 1]))
    return _pushed(m, push)


OFF_FORM: dict[str, dict[str, Cause]] = {
    "gpm2002": {"backlash": _play, "compliance": _spring, "eccentricity": _saw, "cyclic": _teeth, "drift": _settling,
                "slip": _slow_slip},
    "arm": {"backlash": _play, "compliance": _spring, "eccentricity": _saw, "cyclic": _teeth, "drift": _settling,
            "slip": _slow_slip, "thermal_zero": _warm},
    "mount": {"TF": _droop, "eccentricity": _saw, "drift": _settling, "slip": _slow_slip, "thermal_zero": _warm},
}  # fmt: skip


def noise(rng: np.random.Generator, day: Day, draws: int, law: str) -> Array:
    """Return unit noise (n, draws): gauss, t4, t3, mixed (two sizes), carried (correlated in time), or patchy."""
    n = len(day.t)
    white = rng.standard_normal((n, draws))
    if law in ("t3", "t4"):
        free = float(law[1])
        return np.asarray(rng.standard_t(free, (n, draws)) / np.sqrt(free / (free - 2)))
    if law == "mixed":
        wide = rng.random((n, draws)) < 0.1
        return np.asarray(white * np.where(wide, 2.5, 1.0) / np.sqrt(0.9 + 0.1 * 6.25))
    if law == "carried":
        share, out = rng.uniform(0.2, 0.5), white.copy()
        for k in range(1, n):
            out[k] = share * out[k - 1] + np.sqrt(1 - share**2) * white[k]
        return out
    if law == "patchy":
        return np.asarray(white * (1 + 0.25 * np.sin(6 * day.run + rng.uniform(0, 6)))[:, None])
    return np.asarray(white)
