"""`arm_ur10`, `arm_panda`, `arm`: calibrations of real arms, and simulated ones drawn like them (``instance=K``).

`arm_ur10`: a UR10 by a laser tracker, every so many rows of three series. `arm_panda`: a Panda whose ball sits in the
sockets of a tool; nothing is measured from outside. Both come with the package (`data/arms`, thinned, with sources and
licences). `arm`: a URDF and a CSV of one's own.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, final

import numpy as np

from calibench.problems.arm.calibration import ArmCalibration
from calibench.problems.arm.chains.chain import Chain
from calibench.problems.arm.chains.dh_file import read_dh
from calibench.problems.arm.chains.kinematics import parameter_names, parameter_units
from calibench.problems.arm.chains.urdf import read_urdf
from calibench.problems.arm.gauge import gauge
from calibench.problems.arm.instances import ArmInstance, arm_instance
from calibench.problems.arm.measured import Measured, Rotation, found_frames, read_measured, shipped
from calibench.problems.arm.readings import Index, Readings, positions, sockets
from calibench.problems.arm.readings import poses as of_poses
from calibench.problems.base import Parameter, registry
from calibench.problems.instances import check_instance, refuse_drawn

HALF = {"mm": 8.0, "rad": 0.06}  # of the box about the nominal arm; arms are wrong by some mm and mrad
GAP = 50.0  # mm between the two sockets of the tool
GAP_WEIGHT = 3.0  # a distance between sockets was measured once, and better than the ball sits


def _ur10(
    series: Literal["B", "C", "D"] = "B",
    reads: Literal["position", "pose"] = "position",
    robust: float = 0.0,
    instance: int | None = None,
) -> None:
    """Declare the options of `arm_ur10`: series, what is fitted, the size [mm] from which readings count less."""


def _panda(robust: float = 0.0, instance: int | None = None) -> None:
    """Declare the options of `arm_panda`: the size [mm] above which readings count less (0: none)."""


def _own(
    data: Path,
    urdf: Path | None = None,
    base: str = "",
    tip: str = "",
    reads: Literal["auto", "position", "pose", "sockets"] = "auto",
    rotation: Rotation = "",
    gap: float = 0.0,
    robust: float = 0.0,
    dh: Path | None = None,
    convention: str = "",
) -> None:
    """Declare the options of `arm`: gap [mm] is the distance of sockets 0 and 1 of a place, 0 where it is not known.

    `urdf`, or `dh`, a table of joints in the `convention` standard or modified, describes the arm.
    """


@final
class Ur10Family:
    """The geometry of a UR10 from places or poses by a laser tracker; each fifth reading is kept back."""

    name = "arm_ur10"
    said_if_chosen = ("instance",)

    def __call__(self, **options: Any) -> ArmCalibration:
        """Build the problem with `options` (those of ``bench list problems``)."""
        chosen = _chosen(self.name, _ur10, options)
        if chosen.get("instance") is not None:
            if options.get("series") is not None:
                raise ValueError(
                    f"arm_ur10.series={options['series']}: instance={chosen['instance']} is simulated and of no "
                    "series; leave one of the two out"
                )
            return _simulated(self.name, chosen)
        return _of_ur10(tuple(sorted(chosen.items())))


@final
class PandaFamily:
    """The geometry of a Panda from a ball in the sockets of a tool at nine places, of which two are kept back."""

    name = "arm_panda"
    said_if_chosen = ("instance",)

    def __call__(self, **options: Any) -> ArmCalibration:
        """Build the problem with `options` (those of ``bench list problems``)."""
        chosen = _chosen(self.name, _panda, options)
        if chosen.get("instance") is not None:
            return _simulated(self.name, chosen)
        return _of_panda(tuple(sorted(chosen.items())))


@final
class ArmFamily:
    """The geometry of one's own arm from its URDF, or a table of its joints, and a CSV file of measured postures."""

    name = "arm"
    said_if_chosen = ("dh", "convention")

    def __call__(self, **options: Any) -> ArmCalibration:
        """Build the problem with `options` (those of ``bench list problems``)."""
        chosen = _chosen(self.name, _own, options)
        _check_robust(self.name, chosen)
        data, file = Path(chosen["data"]), _described(chosen)
        if "dh" in chosen:
            chain = read_dh(file, chosen.get("convention", ""), "problem.").chain
        else:
            chain = read_urdf(file, "problem.").chain(chosen["base"], chosen["tip"])
        measured = read_measured(data, chain, chosen["rotation"])
        reads = _reads(chosen["reads"], measured)
        try:
            chain = found_frames(chain, measured)
        except ValueError as error:
            raise ValueError(f"data={data.name}: {error}") from None
        if "dh" in chosen:
            chosen = {key: value for key, value in chosen.items() if key not in ("urdf", "base", "tip")}
        told = chosen | {
            "dh" if "dh" in chosen else "urdf": file.name,
            "data": data.name,
        }  # no path of this machine in a row
        gap = (chosen["gap"], GAP_WEIGHT)
        return measured_problem(self.name, told, chain, measured, reads, gap, chosen["robust"])


arm_ur10, arm_panda, arm = Ur10Family(), PandaFamily(), ArmFamily()
registry.register("arm_ur10", options=_ur10)(arm_ur10)
registry.register("arm_panda", options=_panda)(arm_panda)
registry.register("arm", options=_own)(arm)


def measured_problem(
    name: str, told: Mapping[str, Any], chain: Chain, measured: Measured, reads: str, gap: tuple[float, float],
    robust: float,
) -> ArmCalibration:  # fmt: skip
    """Return the problem of measured postures: rows that are held are kept back, what is not determined is held.

    `gap` is the known distance [mm] of two sockets of a place (0: unknown) and its weight.
    """
    seen = compared(measured.where(~measured.held), reads, gap)
    held = compared(measured.where(measured.held), "position" if reads == "pose" else reads, gap)
    kept = gauge(chain, seen).kept
    units = dict(zip(parameter_names(chain), parameter_units(chain), strict=True))
    rows = [Parameter(n, units[n], 0.0, -HALF[units[n]], HALF[units[n]]) for n in kept]
    limit = robust if robust > 0 else np.inf
    return ArmCalibration(name, told, chain, seen, tuple(rows), held if len(held.q) else None, limit)


def compared(measured: Measured, reads: str, gap: tuple[float, float] = (0.0, 1.0)) -> Readings:
    """Return what of `measured` is compared: position, pose, or sockets."""
    if reads == "sockets":
        assert measured.socket is not None
        assert measured.site is not None
        numbers = {old: new for new, old in enumerate(dict.fromkeys(measured.socket.tolist()))}
        socket = np.array([numbers[s] for s in measured.socket.tolist()], dtype=np.int64)
        return sockets(measured.q, socket, _gaps(socket, measured.site, gap[0]), gap[1])
    assert measured.place is not None
    if reads == "position":
        return positions(measured.q, measured.place)
    assert measured.rotation is not None
    pose = np.tile(np.eye(4), (len(measured.q), 1, 1))
    pose[:, :3, 3], pose[:, :3, :3] = measured.place, measured.rotation
    return of_poses(measured.q, pose)


def _gaps(socket: Index, site: Index, gap: float) -> tuple[tuple[int, int, float], ...]:
    """Return the known distances: between the two sockets of each place."""
    if gap <= 0:
        return ()
    found = []
    for one in dict.fromkeys(site.tolist()):
        both = list(dict.fromkeys(socket[site == one].tolist()))
        if len(both) == 2:
            found.append((both[0], both[1], gap))
    return tuple(found)


def _reads(asked: str, measured: Measured) -> str:
    there = {
        "pose": measured.rotation is not None,
        "position": measured.place is not None,
        "sockets": measured.socket is not None,
    }
    if asked == "auto":
        return next(kind for kind, is_there in there.items() if is_there)
    if not there[asked]:
        columns = {"pose": "x y z and rx ry rz", "position": "x y z", "sockets": "socket"}[asked]
        raise ValueError(f"arm.reads={asked}: the file has no columns {columns}; leave reads out, or add them")
    return asked


def _described(chosen: dict[str, Any]) -> Path:
    """Return the file that describes the arm; leave out of `chosen` what was not stated of a table."""
    for key in ("dh", "convention"):
        if not chosen[key]:
            del chosen[key]
    urdf, dh = chosen["urdf"], chosen.get("dh")
    if urdf is None and dh is None:
        raise ValueError("arm needs its description: problem.urdf=my.urdf, or problem.dh=table.csv")
    if urdf is not None and dh is not None:
        raise ValueError("problem.urdf= and problem.dh= both describe the arm; give one")
    if "convention" in chosen and dh is None:
        raise ValueError("problem.convention= is that of a table; state problem.dh= too, or leave it out")
    if dh is not None and (chosen["base"] or chosen["tip"]):
        raise ValueError("problem.base= and problem.tip= are links of a URDF; a table has none: leave them out")
    return Path(urdf if dh is None else dh)


def _chosen(name: str, declared: Callable[..., None], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return checked options with the defaults; without `instance` where there is none."""
    bound = inspect.signature(declared).bind(**registry.check(name, options))
    bound.apply_defaults()
    return {key: value for key, value in bound.arguments.items() if key != "instance" or value is not None}


def _check_robust(name: str, chosen: Mapping[str, Any]) -> None:
    if not (chosen["robust"] >= 0 and np.isfinite(chosen["robust"])):
        raise ValueError(
            f"{name}.robust={chosen['robust']:g}: a size [mm] from which readings count less, or 0 for none"
        )


@lru_cache(maxsize=32)  # a problem is a value, and reading it takes a thousand times as long as a call
def _of_ur10(given: tuple[tuple[str, Any], ...]) -> ArmCalibration:
    chosen = dict(given)
    _check_robust("arm_ur10", chosen)
    chain = read_urdf(shipped("ur10.urdf")).chain()
    measured = read_measured(shipped(f"ur10_{chosen['series'].lower()}.csv"), chain, "xyz")
    chain = found_frames(chain, measured.where(~measured.held))
    return measured_problem("arm_ur10", chosen, chain, measured, chosen["reads"], (0.0, 1.0), chosen["robust"])


@lru_cache(maxsize=32)
def _of_panda(given: tuple[tuple[str, Any], ...]) -> ArmCalibration:
    chosen = dict(given)
    _check_robust("arm_panda", chosen)
    chain = read_urdf(shipped("panda.urdf")).chain(tip="ball_link")
    measured = read_measured(shipped("panda_sockets.csv"), chain)
    return measured_problem("arm_panda", chosen, chain, measured, "sockets", (GAP, GAP_WEIGHT), chosen["robust"])


def _simulated(name: str, chosen: dict[str, Any]) -> ArmCalibration:
    """Return the problem that the instance draws: another arm of the kind, its errors, postures, noise and box."""
    _check_robust(name, chosen)
    instance: int = chosen["instance"]
    check_instance(name, instance)
    given = {key: None if key == "series" else value for key, value in chosen.items()}  # so rows say: of none
    return _drawn(name, tuple(sorted(given.items())))


@lru_cache(maxsize=256)
def _drawn(name: str, given: tuple[tuple[str, Any], ...]) -> ArmCalibration:
    chosen = dict(given)
    reads = chosen.get("reads", "sockets")
    drawn = arm_instance(name, chosen["instance"], reads, lambda one: _taken(name, chosen, one, exact=True))
    refuse_drawn(name, chosen["instance"], {}, drawn.options)
    return _taken(name, chosen | drawn.options, drawn, exact=False)


def _taken(name: str, says: dict[str, Any], drawn: ArmInstance, exact: bool) -> ArmCalibration:
    units = dict(zip(parameter_names(drawn.chain), parameter_units(drawn.chain), strict=True))
    box = zip(drawn.names, drawn.box.lower.tolist(), drawn.box.upper.tolist(), drawn.box.truth.tolist(), strict=True)
    rows = tuple(Parameter(n, units[n], 0.0, low, high, true) for n, low, high, true in box)
    limit = says["robust"] if says.get("robust", 0.0) > 0 else np.inf
    noise = 0.0 if exact else drawn.noise.level
    return ArmCalibration(name, says, drawn.chain, drawn.read(noise), rows, None, limit, noise, drawn=drawn)
