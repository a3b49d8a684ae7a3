"""Three machines in plain NumPy that a cause acts on: the blind generator's GPM2002, an arm of six joints, a mount."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.blind.gpm2002 import families, simulate
from benchmarks.blind.gpm2002.effect import Effect, State, one_joint
from benchmarks.blind.gpm2002.encoder_effects import joint_velocity
from benchmarks.formulas.causes import OTHERS, WRITABLE, Array, Case, Cause, draw

DEMO = Path(__file__).resolve().parents[2] / "discrepancy" / "demo" / "arm" / "six.urdf"
MACHINES = ("gpm2002", "arm", "mount")
_MOUNT = ("two_waves", "crosstalk", "heat_and_wave", "maxwell_slip", "play_that_wears_in",
          "gear_of_a_sum", "hum", "bump_over_angles", "steps_in_angle")  # fmt: skip


def case(machine: str, seed: int, *, sound: bool = False) -> Case:
    """Return the case of a seed on a machine, visible at .7 to 8: in three of four the grammar can write its cause."""
    rng = np.random.default_rng([seed, MACHINES.index(machine)])
    pool = [n for n in (WRITABLE if rng.random() < 0.75 else OTHERS) if machine != "mount" or n in _MOUNT]
    name, visible = str(rng.choice(pool)), float(np.exp(rng.uniform(np.log(0.7), np.log(8.0))))
    joints = {"gpm2002": 3, "arm": 6, "mount": 2}[machine]
    own = int(rng.integers(1, 4) if machine == "arm" else rng.integers(joints))
    other = (own + 1 + int(rng.integers(joints - 1))) % joints if machine != "arm" else [1, 2, 3][(own + 1) % 3]
    cause = draw(name, own, other, rng)
    made = {"gpm2002": _gpm2002, "arm": _arm, "mount": _mount}[machine]
    columns, metadata, names, seen = made(seed, cause, own, visible, sound, rng)
    if sound:
        return Case(machine, columns, metadata, "sound", 0.0)
    met = {"own": own, "other": other, "": 0}
    truth = tuple(sorted((f"{shape} {names(what, met[of])}" for what, of, shape in cause.truth), key=_column))
    return Case(machine, columns, metadata, name, seen, (names("angle", own), *truth) if truth else ())


def _column(factor: str) -> str:
    return factor.rpartition(" ")[2]


def _gpm2002(seed: int, cause: Cause, own: int, visible: float, sound: bool, rng: np.random.Generator) -> Any:
    def read(a: float, s: State) -> Array:
        v = joint_velocity(s)
        met = {
            "angle": s.rest.motor_angles, "torque": s.rest.torque, "velocity": v,
            "direction": np.where(np.abs(v) < 1e-3, 0.0, np.sign(v)), "t": s.plan.t, "temperature": s.plan.temperature,
        }  # fmt: skip
        return one_joint(own, a * cause.error(met))

    needs = ("t_s", "temp_K", *(f"{kind}_{i}" for kind in ("vel", "dir", "tau") for i in (1, 2, 3)))
    effect = Effect(cause.name, f"joint {own + 1}", "rad", 1e-4, 0.2, needs, known=False, read=read)
    with patch.dict(families.FOREIGN, {"formula": lambda i, plan, rng: effect}):
        how = {"kind": "none"} if sound else {"family": "formula", "lam": visible}
        made = simulate.case(seed, poses=int(rng.integers(50, 90)), noise="gauss", **how)
    kinds = {"angle": "enc", "torque": "tau", "velocity": "vel", "direction": "dir"}

    def names(what: str, joint: int) -> str:
        return {"t": "t_s", "temperature": "temp_K"}.get(what) or f"{kinds[what]}_{joint + 1}"

    effects = made.truth["effects"]
    return made.columns, made.metadata, names, effects[0]["lambda"] if effects else 0.0


def _rolled(rpy: Array) -> Array:
    (a, b, c) = rpy
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return np.asarray(z @ y @ x)


def _chain() -> tuple[list[str], Array]:
    """Return the joints' names, and the origin of each: x, y, z [mm], roll, pitch, yaw; the plate's last."""
    names, origins = [], []
    for joint in ET.parse(DEMO).getroot().findall("joint"):
        origin = joint.find("origin")
        assert origin is not None
        xyz = np.array(origin.get("xyz", "0 0 0").split(), float) * 1000
        origins.append([*xyz, *np.array(origin.get("rpy", "0 0 0").split(), float)])
        if joint.get("type") != "fixed":
            names.append(str(joint.get("name")))
    return names, np.array(origins)


def _tip(origins: Array, q: Array, tool: Array) -> Array:
    place, turn = np.zeros((len(q), 3)), np.broadcast_to(np.eye(3), (len(q), 3, 3))
    for k, origin in enumerate(origins):
        place = place + turn @ origin[:3]
        turn = turn @ _rolled(origin[3:])
        if k < q.shape[1]:
            c, s, zero = np.cos(q[:, k]), np.sin(q[:, k]), np.zeros(len(q))
            z = np.stack([np.stack([c, -s, zero], -1), np.stack([s, c, zero], -1),
                          np.stack([zero, zero, zero + 1], -1)], axis=1)  # fmt: skip
            turn = turn @ z
    return np.asarray(place + turn @ tool)


def _run(n: int, joints: int, rng: np.random.Generator) -> dict[str, Array]:
    t = np.cumsum(rng.uniform(5, 15, n))
    s = (t - t[0]) / np.ptp(t)
    v = rng.uniform(0.02, 0.6, (n, joints)) * rng.choice([-1, 1], (n, joints))
    warm = rng.uniform(4, 9) * (1 - np.exp(-s / 0.3)) + rng.uniform(0.5, 2) * np.sin(2 * np.pi * (s + rng.random()))
    return {"t": t, "velocity": v, "direction": np.sign(v), "temperature": warm}


def _size(
    error: Array, signature: Array, J: Array, sigma: float, visible: float, largest: float = 0.01
) -> tuple[float, float]:
    """Return the size at which what calibration, J (N, p), leaves of a signature (N,) is `visible` sigma rms.

    No error is above `largest` [rad].
    """
    Q = np.linalg.qr(J / np.linalg.norm(J, axis=0))[0]
    left = signature - Q @ (Q.T @ signature)
    rms = float(np.sqrt(np.mean(left**2))) / sigma
    size = min(visible / max(rms, 1e-12), largest / float(np.max(np.abs(error))))
    return size, size * rms


def _arm(seed: int, cause: Cause, own: int, visible: float, sound: bool, rng: np.random.Generator) -> Any:
    names, origins = _chain()
    n = int(rng.integers(150, 320))
    low, high = np.array([[-2.0, -2.0, 0.4, -2.4, -2.2, -2.8], [2.0, -0.5, 2.2, 0.5, 2.2, 2.8]])
    q, sigma, tool = rng.uniform(low, high, (n, 6)), 0.02, np.array([30.0, 20.0, 120.0])
    met = _run(n, 6, rng) | {"angle": q}
    pull = np.stack([rng.uniform(1, 4) * np.cos(q[:, 1]), rng.uniform(1, 4) * np.cos(q[:, 1] + q[:, 2])], axis=-1)
    torque = 4e3 * rng.standard_normal((n, 6))
    torque[:, 1] += 3e4 * pull.sum(axis=1)
    torque[:, 2] += 3e4 * pull[:, 1]
    met["torque"] = torque
    machine = (
        origins + np.c_[0.3 * rng.standard_normal((len(origins), 3)), 1e-3 * rng.standard_normal((len(origins), 3))]
    )
    error, step = cause.error(met), 1e-6
    one = np.zeros((n, 6))
    one[:, own] = step * error
    base = _tip(machine, q, tool)
    signature = (_tip(machine, q + one, tool) - base).ravel() / step
    columns = []
    for k in range(origins.size):
        moved = machine.copy()
        moved.ravel()[k] += 1e-6
        columns.append((_tip(moved, q, tool) - base).ravel() / 1e-6)
    J = np.stack([c for c in columns if np.any(c)], axis=-1)
    U, values, _ = np.linalg.svd(J / np.linalg.norm(J, axis=0), full_matrices=False)
    size, seen = _size(error, signature, U[:, values > 1e-8 * values[0]], sigma, visible)
    true = q.copy()
    true[:, own] += 0 if sound else size * error
    xyz = _tip(machine, true, tool) + sigma * rng.standard_normal((n, 3))
    found: dict[str, Any] = {name: q[:, k] for k, name in enumerate(names)} | dict(zip("xyz", xyz.T))
    for key in ("velocity", "direction", "torque"):
        found |= {f"{key}_{name}": met[key][:, k] for k, name in enumerate(names)}
    found |= {"t_s": met["t"], "temperature_C": 20 + met["temperature"], "pose_id": np.arange(n)}
    found["split"] = np.where(rng.random(n) < 0.3, "hold", "train")
    prefix = {"angle": "q_", "torque": "torque_", "velocity": "velocity_", "direction": "direction_"}

    def called(what: str, joint: int) -> str:
        return {"t": "t_s", "temperature": "temp_K"}.get(what) or f"{prefix[what]}{names[joint]}"

    return found, {"machine": "arm", "urdf": str(DEMO), "sigma_mm": sigma}, called, seen


def _mount(seed: int, cause: Cause, own: int, visible: float, sound: bool, rng: np.random.Generator) -> Any:
    n, sigma, arcsec = int(rng.integers(120, 260)), 4.0, np.pi / 180 / 3600
    az, el = rng.uniform(-np.pi, np.pi, n), rng.uniform(0.35, 1.35, n)
    met = _run(n, 2, rng) | {"angle": np.stack([az, el], axis=-1)}
    error = cause.error(met)
    across = np.zeros((n, 2))
    across[:, own] = error * (np.cos(el) if own == 0 else 1.0)
    one, zero = np.ones(n), np.zeros(n)
    terms = [(np.cos(el), zero), (zero, one), (one, zero), (np.sin(el), zero), (-np.sin(az) * np.sin(el), -np.cos(az)),
             (-np.cos(az) * np.sin(el), np.sin(az)), (zero, np.cos(el))]  # fmt: skip
    J = np.stack([np.stack(pair, axis=-1).ravel() for pair in terms], axis=-1)
    size, seen = _size(error, across.ravel(), J, sigma * arcsec, visible, 0.003)
    bent = np.zeros((n, 2)) if sound else size * np.stack([error * (own == 0), error * (own == 1)], axis=-1)
    a, e = 60 * arcsec * rng.standard_normal(2)
    noise = sigma * arcsec * rng.standard_normal((n, 2))
    columns = {
        "az": az, "el": el, "star_az": az + a + bent[:, 0] + noise[:, 0] / np.cos(el),
        "star_el": el + e + bent[:, 1] + noise[:, 1],
        "t_s": met["t"], "temp_K": met["temperature"], "dir_az": met["direction"][:, 0],
        "dir_el": met["direction"][:, 1], "split": np.where(rng.random(n) < 0.3, "hold", "train"),
    }  # fmt: skip
    called = {
        "angle": ("az", "el"),
        "direction": ("dir_az", "dir_el"),
        "t": ("t_s",) * 2,
        "temperature": ("temp_K",) * 2,
    }
    metadata = {"machine": "mount", "mount": "altaz", "azimuth": "north_east", "sigma_arcsec": sigma}
    return columns, metadata, lambda what, joint: called[what][joint], seen
