"""A ball that sits in sockets: nothing is measured from outside; in one socket the ball's centre is one point.

The points are unknown, so each is calibrated beside the arm: of a tool with two sockets (`socket` 0 and 1 of one
`place`) whose distance is stated (`socket_distance_mm`) a middle and a direction, of any other three coordinates.
What is "measured" of a row, x, y, z [mm] in the frame of the base, is the first guess of its socket's point; what is
predicted is where the ball is, less how far the point is from that guess.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, ClassVar, final

import numpy as np

from calibench.calibration.columns import SITE, SOCKET
from calibench.calibration.determined import WORST, select_by_name
from calibench.calibration.kinematics import Chain
from calibench.calibration.rigid import Numbers
from calibench.calibration.start import Start
from calibench.calibration.walk import BASE, PLACE, READING, TOOL, of_joint, quantities, slopes, walk
from calibench.core.notes import Code
from calibench.discrepancy.machines.arm.readings import completed, torques
from calibench.discrepancy.model.formulations import Predicted
from calibench.discrepancy.model.machine import TINY, Quantities
from calibench.discrepancy.model.measured import DataError, MeasuredData, Sensor, positive
from calibench.discrepancy.model.roles import Instrument, Roles
from calibench.problems.base import Array, Parameter

INDEX = "socket_number"  # of all places, from 0
_BASE = np.eye(3)  # as it stands: nothing is measured in another frame


@final
@dataclass(frozen=True, eq=False)
class Sockets:
    """The points of all sockets: their first guesses (S, 3) [mm], and the pairs (P, 2) whose `distance` is stated."""

    guess: Array
    pairs: tuple[tuple[int, int], ...]
    distance: float

    @property
    def names(self) -> tuple[str, ...]:
        paired = {k for pair in self.pairs for k in pair}
        alone = tuple(f"socket{k}_{one}" for k in range(len(self.guess)) if k not in paired for one in PLACE)
        return (*(f"pair{k}_{one}" for k in range(len(self.pairs)) for one in (*PLACE, "u", "v")), *alone)

    def moved(self, q: Quantities) -> Numbers:
        """Return the displacement of each point from its guess, (S, 3) [mm]."""
        kind = np.result_type(float, *(np.asarray(q[name]) for name in self.names))
        points = self.guess.astype(kind)
        for k in range(len(points)):
            if f"socket{k}_x" in q:
                points[k] = self.guess[k] + np.array([q[f"socket{k}_{one}"] for one in PLACE])
        for k, (one, other) in enumerate(self.pairs):
            middle = (self.guess[one] + self.guess[other]) / 2 + np.array([q[f"pair{k}_{name}"] for name in PLACE])
            along, first, second = self.frames[k]
            way = along + q[f"pair{k}_u"] * first + q[f"pair{k}_v"] * second
            way = way * (self.distance / 2 / np.sqrt(np.sum(way * way)))
            points[one], points[other] = middle - way, middle + way
        return points - self.guess

    @cached_property
    def frames(self) -> list[tuple[Array, Array, Array]]:
        """Return the direction from one socket of each pair to the other, and two across it."""
        frames = []
        for one, other in self.pairs:
            way = self.guess[other] - self.guess[one]
            along = way / np.linalg.norm(way)
            first = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
            first /= np.linalg.norm(first)
            frames.append((along, first, np.cross(along, first)))
        return frames


@final
@dataclass(frozen=True, eq=False)
class _Ball:
    """The place of the ball, less the displacement of its socket from the guess."""

    chain: Chain
    sockets: Sockets
    base: ClassVar[Array] = _BASE

    def seen(self, q: Quantities) -> Numbers:
        """Return this place, (n, 3) [mm]."""
        rows = np.rint(np.real(q[INDEX])).astype(int)
        return np.asarray(walk(self.chain, _BASE, q).target - self.sockets.moved(q)[rows])

    def slopes(self, q: Quantities) -> dict[str, Array]:
        by_name = slopes(self.chain, walk(self.chain, _BASE, q))
        rows = np.rint(np.real(q[INDEX])).astype(int)
        for name in self.sockets.names:
            stepped = self.sockets.moved({**q, name: np.asarray(q[name]) + 1j * TINY})
            by_name[name] = -np.imag(stepped)[rows] / TINY
        return by_name | {INDEX: np.zeros((len(rows), 3))}


def in_sockets(chain: Chain, data: MeasuredData, roles: Roles, begin: Start) -> Predicted:
    """Return the prediction of a ball that sits in sockets; the readings are those of `begin`."""
    fitted, (index, of_place) = data.fitted, _numbered(data)
    for k, place, socket in of_place:
        if (fitted & (index == k)).sum() < 2:
            where = f"{place}, socket {socket}"
            raise DataError(f"{data.name}: place {where}: fewer than two postures are fitted; nothing closes there")
    start: dict[str, Any] = dict.fromkeys(BASE, 0.0) | quantities(chain) | dict.fromkeys(TOOL, 0.0)
    readings = {READING + n: data[READING + n] for n in chain.driven}
    ball = walk(chain, _BASE, start | readings).target
    guess = np.stack([np.median(ball[fitted & (index == k)], axis=0) for k in range(index.max() + 1)])
    by_place: dict[str, list[int]] = {}
    for k, place, _ in of_place:
        by_place.setdefault(place, []).append(k)
    sockets = Sockets(guess, (), 0.0)
    if "socket_distance_mm" in data.metadata:
        distance = positive(data, "socket_distance_mm", data.metadata["socket_distance_mm"])
        sockets = Sockets(guess, tuple((ks[0], ks[1]) for ks in by_place.values() if len(ks) == 2), distance)
    start |= dict.fromkeys(sockets.names, 0.0)
    data = data.with_columns({name: guess[index, k] for k, name in enumerate(PLACE)} | {INDEX: index.astype(float)})
    predict = _Ball(chain, sockets)
    q = start | readings | {INDEX: data[INDEX]}
    seen, rest = predict.slopes(q), np.stack([data[name] for name in PLACE], axis=-1) - predict.seen(q)
    order = (*sockets.names, *TOOL, *(f"zero_{j.name}" for j in chain.joints))
    order += tuple(name for k in (slice(3), slice(3, 6)) for j in chain.joints for name in of_joint(j.name)[k])
    units = {name: _parameter(name, start).unit for name in quantities(chain)}
    slopes_seen = {name: np.asarray(seen[name])[fitted] for name in order}
    free, vague = select_by_name(slopes_seen, order, rest[fitted], units)
    stated = data.metadata.get("sigma_mm")
    sigma = None if stated is None else positive(data, "sigma_mm", stated)
    free_ones = tuple(_parameter(name, start) for name in free)
    return Predicted(
        with_held(data, vague), predict.seen, free_ones, dict.fromkeys(PLACE, sigma),
        inputs=(*readings, INDEX), held={name: value for name, value in start.items() if name not in free},
        instruments=tuple(Sensor(name, "socket", "mm", part=name, label=f"the socket's {name}") for name in PLACE),
        roles=roles | Roles(instruments=(Instrument("sockets", PLACE, frame=False),)), slopes=predict.slopes,
        of_new=partial(_of_new, chain, guess, of_place, begin),
    )  # fmt: skip


def _parameter(name: str, start: Mapping[str, float]) -> Parameter:
    mm = name.split("_")[0] in PLACE or name.rpartition("_")[2] in PLACE
    wide = 50.0 if name.startswith(("pair", "socket", "tool")) and mm else 30.0 if mm else 0.3
    return Parameter(name, "mm" if mm else "rad", start[name], start[name] - wide, start[name] + wide)


def _of_new(
    chain: Chain, guess: Array, of_place: list[tuple[int, str, str]], begin: Start, data: MeasuredData
) -> MeasuredData:
    """Return rows that are only predicted, with the number of each socket and the first guess of its point."""
    data = completed(data, chain, begin)
    known = {(place, socket): k for k, place, socket in of_place}
    rows, there = _numbered(data)
    strange = next((one for one in there if one[1:] not in known), None)
    if strange is not None:
        raise DataError(
            f"{data.name}: place {strange[1]}, socket {strange[2]}: not among those that were fitted, so its point "
            "is not known; leave it out"
        )
    index = np.array([known[place, socket] for _, place, socket in there])[rows]
    columns = {name: guess[index, k] for k, name in enumerate(PLACE)} | {INDEX: index.astype(float)}
    start = quantities(chain) | dict.fromkeys((*BASE, *TOOL), 0.0)
    return data.with_columns(columns | torques(chain, _BASE, start, data))


def _numbered(data: MeasuredData) -> tuple[Array, list[tuple[int, str, str]]]:
    """Return the number of each row's socket, (n,), and (number, place, socket) of each."""
    if SOCKET not in data:
        raise DataError(f"{data.name}: column {SOCKET} is missing: in which socket the ball is, such as 0 or 1")
    place = np.asarray(data[SITE] if SITE in data else np.zeros(len(data))).astype(str)
    socket = np.asarray(data[SOCKET]).astype(str)
    both = np.char.add(np.char.add(place, "\t"), socket)
    names, index = np.unique(both, return_inverse=True)
    return np.ravel(index), [(k, *str(name).split("\t")) for k, name in enumerate(names)]  # type: ignore[misc]


def with_held(data: MeasuredData, vague: Sequence[str]) -> MeasuredData:
    """Return the data with a remark on the numbers that are held since these readings tell them too badly."""
    if not vague:
        return data
    many = len(vague) > 1
    kept, them = ("numbers keep their nominal values", "them") if many else ("a number keeps its nominal value", "it")
    best = f"{WORST:g} mm or {WORST:g} mrad"
    words = []
    for kind, _, joint in (name.partition("_") for name in vague):
        way = "turn about" if kind[0] == "r" else "shift along"
        words.append(f"zero of {joint}" if kind == "zero" else f"{way} {kind[-1]} of {joint}")
    known = f"{kept}, as the poses tell {them} no better than to {best}"
    text = f"{known}: {', '.join(words)}; other poses would (bench design)"
    return data.with_note(Code.UNDETERMINED, text, parameters=list(vague))
