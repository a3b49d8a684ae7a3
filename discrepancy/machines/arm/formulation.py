"""`Arm`: a serial arm from its URDF, seen by a tracker that measures the target's place, or its orientation as well.

Calibrated are the base, the tool, and the placement and zero of every joint, as far as the readings determine them
(`rank`). Base and tool are found from the data (`start`), so nobody has to state a frame. Data with a column `socket`
instead of the tracker's columns are formulated by `sockets`.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, final

import numpy as np

from calibench import calibration
from calibench.calibration import walk
from calibench.calibration.columns import ARM, PAYLOAD, QUATERNION, WARMTH, WAYS
from calibench.calibration.determined import select_by_name
from calibench.calibration.kinematics import Chain
from calibench.calibration.model import model_of
from calibench.calibration.rigid import Array, Numbers, beside, rotation_of, small_vector_of, vector_of
from calibench.calibration.start import Start
from calibench.core.options import suggest
from calibench.discrepancy.checks.wild import without_wild
from calibench.discrepancy.machines.arm import readings
from calibench.discrepancy.machines.arm.sockets import in_sockets, with_held
from calibench.discrepancy.model.formulations import Predicted
from calibench.discrepancy.model.machine import TINY, Description, Formulation, Quantities, Quantity, Slopes, Stated
from calibench.discrepancy.model.measured import DataError, MeasuredData, Sensor, positive
from calibench.discrepancy.model.roles import Instrument, Joint, Length, Roles
from calibench.discrepancy.registries import DEMONSTRATIONS, describe, machines
from calibench.problems.base import Parameter

TURNED = tuple(f"turn_{one}" for one in walk.PLACE)  # mrad: how the target is turned beside the start, as measured
AIM = tuple(f"aim_{one}" for one in walk.PLACE)  # rad: how it is turned at the start
TOOL_TURNS = tuple(f"tool_{one}" for one in walk.TURNS)
MILLI = 1e3
_WIDE = {"mm": 30.0, "rad": 0.1, "base": 300.0}  # within which numbers are looked for


@machines.register("arm")
@final
@dataclass(frozen=True)
class Arm:
    """An arm of the URDF file `urdf`, from its link `base` to `tip`: its root and usual leaf if none is stated.

    `dh` is a table of its joints instead (CSV or Excel), in the `convention` standard or modified. `observe` says what
    is used of the data: position, pose, or sockets; all that there is if nothing is stated.
    """

    urdf: str = ""
    base: str = ""
    tip: str = ""
    dh: str = ""
    convention: str = ""
    observe: Literal["", "position", "pose", "sockets"] = ""
    name: str = field(default="arm", init=False)

    def formulate(self, data: MeasuredData) -> Predicted:
        dh = self.dh or ("" if self.urdf else str(data.metadata.get("dh", "")))
        lost = next((key for key in ("urdf", "tip", "base") if getattr(self, key)), "") if dh else ""
        if lost:
            raise DataError(f"machine.{lost}= is of a URDF, and machine.dh= describes the arm by a table; give one")
        path = dh or str(self.urdf or data.metadata.get("urdf", ""))
        if not path:
            raise DataError(f"{data.name}: an arm needs its URDF: machine.urdf=my.urdf, or machine.dh=table.csv")
        file = Path(path).expanduser()
        shipped = DEMONSTRATIONS / "arm" / f"{file.name}.urdf"  # known by its stem
        if not dh and file.name == path and shipped.exists() and not file.exists():
            file = shipped
        convention = self.convention or str(data.metadata.get("convention", ""))
        try:
            arm = calibration.read_arm(
                file, table=bool(dh), convention=convention, base=self.base, tip=self.tip,
                data=readings.table_of_data(data),
            )  # fmt: skip
        except (calibration.ChainError, OSError) as error:
            raise DataError(str(error)) from None

        data, start = readings.accepted(data, arm, self.observe)
        if start.readings.observed == "sockets":
            at = walk.quantities(arm.chain) | dict.fromkeys((*walk.BASE, *walk.TOOL), 0.0)
            data = readings.with_loads(arm.chain, np.eye(3), at, data)
            return in_sockets(arm.chain, data, roles_for(arm.chain, data, ()), start)
        return tracked(arm.chain, data, start)


def tracked(chain: Chain, data: MeasuredData, begin: Start) -> Predicted:
    """Return the prediction of a target that a tracker sees; a fit starts at `begin`."""
    base, numbers = begin.base[:3, :3], walk.quantities(chain)
    start = dict(zip(walk.BASE, (*begin.base[:3, 3], 0.0, 0.0, 0.0))) | numbers
    start |= dict(zip(walk.TOOL, begin.tool[:3, 3]))
    q = start | {walk.READING + n: data[walk.READING + n] for n in chain.driven}
    tool, turned = begin.tool[:3, :3], readings.rotations(data)
    posed = turned is not None
    if posed:
        start |= dict.fromkeys(TOOL_TURNS, 0.0)
        data = _aimed(data, walk.walk(chain, base, q).flange[0] @ tool, turned)
    seats = model_of(chain, begin.readings, begin.base, begin.tool).seats
    others = {f"{name}_{k}": at for k, seat in enumerate(seats, start=2) for name, at in zip(walk.TOOL, seat)}
    start |= others
    if others:
        q[readings.TARGET_NUMBER] = data[readings.TARGET_NUMBER]
    predict = _Target(chain, base, tool if posed else None, len(seats))
    q |= start | ({name: data[name] for name in AIM} if posed else {})
    names = (*walk.PLACE, *TURNED) if data.has(*TURNED) else walk.PLACE
    measured = np.stack([np.asarray(data[name], dtype=float) for name in names], axis=-1)
    seen, rest = predict.slopes(q), measured - predict.seen(q)
    order = (*walk.BASE, *walk.TOOL, *others, *(TOOL_TURNS if posed else ()), *(f"zero_{j.name}" for j in chain.joints))
    order += tuple(name for k in (slice(3), slice(3, 6)) for j in chain.joints for name in walk.of_joint(j.name)[k])
    known = data.fitted & np.isfinite(rest).all(axis=1)
    units = {name: parameter(chain, name, 0.0).unit for name in numbers}
    free, vague = select_by_name({name: np.asarray(seen[name])[known] for name in order}, order, rest[known], units)
    data = with_held(readings.with_loads(chain, base, start, data), vague)
    sigma = {
        name: positive(data, key, data.metadata[key]) if key in data.metadata else None
        for names, key in ((walk.PLACE, "sigma_mm"), (TURNED if posed else (), "sigma_mrad"))
        for name in names
    }
    kinds = dict.fromkeys(walk.PLACE, ("tracker", "mm")) | dict.fromkeys(TURNED, ("orientation", "mrad"))
    formulation = Predicted(
        data, predict.seen, tuple(parameter(chain, name, start[name]) for name in free), measured=sigma,
        inputs=(
            *(walk.READING + name for name in chain.driven), *(AIM if posed else ()),
            *((readings.TARGET_NUMBER,) if others else ()),
        ),
        held={name: value for name, value in start.items() if name not in free},
        instruments=tuple(
            Sensor(name, kinds[name][0], kinds[name][1], part=name, label=f"the tracker's {name}") for name in sigma
        ),
        roles=roles_for(chain, data, (Instrument("tracker", walk.PLACE),)), slopes=predict.slopes,
        of_new=partial(_of_new, predict, start, begin),
    )  # fmt: skip
    return formulation.on(without_wild(formulation, "arm"))


@final
@dataclass(frozen=True, eq=False)
class _Target:
    """What the tracker sees of the target: its place and, where `tool` (3, 3) is given, its rotation from the start.

    Beside the first there may be `others`, which the rows name, each at its numbers tool_x_K ... from the first.
    """

    chain: Chain
    base: Array
    tool: Array | None
    others: int = 0
    _walked: list[tuple[Quantities, tuple[Any, ...], walk.Walk]] = field(default_factory=list, repr=False)

    def seen(self, q: Quantities) -> Numbers:
        """Return the place [mm], (n, 3), or with the turn [mrad], (n, 6)."""
        way = self._walk(q)
        if self.tool is None:
            return way.target
        turned = way.flange[0]
        for k in (2, 1, 0):
            turned = turned @ _tool_turn(k, q[TOOL_TURNS[k]])
        return np.concatenate([way.target, MILLI * small_vector_of(np.asarray(turned @ self._seat(q)))], axis=1)

    def slopes(self, q: Quantities) -> Mapping[str, Array]:
        way = self._walk(q)
        if self.tool is None:
            others = (f"{name}_{k}" for k in range(2, self.others + 2) for name in walk.TOOL)
            return Slopes((*walk.slope_names(self.chain, way), *others), partial(self._slope, q))
        places = walk.slopes(self.chain, way)
        tool_axes, turned = {}, way.flange[0]
        for k in (2, 1, 0):
            tool_axes[TOOL_TURNS[k]] = turned[..., :, k]
            turned = turned @ _tool_turn(k, q[TOOL_TURNS[k]])
        vectors, still = small_vector_of(turned @ self._seat(q)), np.zeros(way.target.shape)
        turns = walk.turn_slopes(self.chain, way, tool_axes, lambda axes: MILLI * beside(vectors, axes))
        for name in AIM:
            stepped = turned @ self._seat({**q, name: np.asarray(q[name]) + 1j * TINY})
            turns[name] = MILLI * np.imag(small_vector_of(stepped)) / TINY
        return {
            name: np.concatenate([places.get(name, still), turns.get(name, still)], axis=1)
            for name in (*places, *tool_axes, *AIM)
        }

    def _slope(self, q: Quantities, name: str) -> Array:
        last = self._walked and self._walked[0][0] is q  # nobody changes quantities whose slopes are kept
        way, (of_first, _, k) = self._walked[0][2] if last else self._walk(q), name.rpartition("_")
        if of_first not in walk.TOOL:
            return walk.slope(self.chain, way, name)
        mine = np.asarray(q[readings.TARGET_NUMBER]) == int(k) - 1
        return np.where(mine[:, None], walk.slope(self.chain, way, of_first), 0.0)

    def _walk(self, q: Quantities) -> walk.Walk:
        """Return the kinematics at q, the last one from the cache: `seen` and each slope ask for the same numbers."""
        for known, values, way in self._walked:
            if known is q and all(a is b for a, b in zip(values, q.values(), strict=True)):
                return way
        # the place of each row's own target
        tool = {name: np.asarray(q[name]) for name in (walk.TOOL if self.others else ())}
        for name in tool:
            for k in range(2, self.others + 2):
                mine = np.asarray(q[readings.TARGET_NUMBER]) == k - 1
                tool[name] = tool[name] + np.where(mine, q[f"{name}_{k}"], 0.0)
        way = walk.walk(self.chain, self.base, {**q, **tool} if tool else q)
        self._walked[:] = [(q, tuple(q.values()), way)]
        return way

    def _seat(self, q: Quantities) -> Numbers:
        """Return `tool` relative to the target's rotation at the start, (n, 3, 3)."""
        return np.asarray(self.tool @ np.swapaxes(rotation_of(np.stack([q[name] for name in AIM], axis=-1)), -1, -2))


def _tool_turn(axis: int, angle: Any) -> Numbers:
    vector = np.zeros((np.size(angle), 3), dtype=np.result_type(angle, float))
    vector[:, axis] = np.ravel(angle)
    return rotation_of(vector)


def _of_new(target: _Target, start: Mapping[str, float], begin: Start, data: MeasuredData) -> MeasuredData:
    """Return rows that are only predicted, with all columns that the fit has."""
    chain, base = target.chain, target.base
    data = readings.completed(data, chain, begin)
    if target.tool is not None:
        q: dict[str, Any] = dict(start) | {walk.READING + n: data[walk.READING + n] for n in chain.driven}
        data = _aimed(data, walk.walk(chain, base, q).flange[0] @ target.tool, readings.rotations(data))
    return data.with_columns(readings.torques(chain, base, start, data))


def _aimed(data: MeasuredData, aim: Array, turned: Array | None) -> MeasuredData:
    """Return the data with the target's rotation at the start, (n, 3, 3), and how the measured one differs from it."""
    columns = {name: vector_of(aim)[:, k] for k, name in enumerate(AIM)}
    if turned is not None:
        beyond = MILLI * vector_of(turned @ np.swapaxes(aim, -1, -2))
        columns |= {name: beyond[:, k] for k, name in enumerate(TURNED)}
    kept = {name: c for name, c in data.columns.items() if name not in (*walk.TURNS, *QUATERNION)}
    return replace(data, columns=kept | columns)


def parameter(chain: Chain, name: str, start: float) -> Parameter:
    """Return a parameter with its unit, and the box in which it is looked for."""
    kind, _, joint = name.partition("_")
    slides = any(j.name == joint and j.kind == "sliding" for j in chain.joints)
    last = name.split("_")[1] if kind in ("base", "tool") else kind
    mm = last in walk.PLACE or (kind == "zero" and slides)
    wide = _WIDE["base" if kind in ("base", "tool") and mm else "mm" if mm else "rad"]
    return Parameter(name, "mm" if mm else "rad", float(start), float(start) - wide, float(start) + wide)


def loads_in(formulation: Formulation, data: MeasuredData) -> tuple[Chain, Array] | None:
    """Return the chain of an arm's formulation and the moments on its joints in each row, at the nominal arm."""
    predict = getattr(getattr(formulation, "predict", None), "__self__", None)
    if predict is None:
        return None
    start = dict(formulation.fixed) | {p.name: p.start for p in formulation.parameters}
    read = [data[name] for name in (*(walk.READING + n for n in predict.chain.driven), PAYLOAD) if name in data]
    for target, began, known, metadata, held in _LAST:
        same = target is predict and metadata is data.metadata and len(known) == len(read)
        if same and all(a is b for a, b in zip(known, read)) and began == start:
            return predict.chain, held
    held = readings.loads(predict.chain, predict.base, start, data)
    _LAST.append((predict, start, read, data.metadata, held))
    return predict.chain, held


_LAST: deque[tuple[_Target, Mapping[str, float], list[Array], Mapping[str, Any], Array]] = deque(maxlen=2)


def roles_for(chain: Chain, data: MeasuredData, instruments: tuple[Instrument, ...]) -> Roles:
    there = {name: name for name in data.columns}
    kinds = {j.mimic.joint if j.mimic else j.name: j.kind for j in reversed(chain.joints)}
    stated = data.metadata.get("teeth", {})  # one number for all, or one a joint; 0 where it states none
    teeth = stated if isinstance(stated, Mapping) else dict.fromkeys(chain.driven, stated)
    for name, value in teeth.items():
        if name not in chain.driven:
            raise DataError(f"teeth={stated}: {name!r} is no joint of this arm; {suggest(str(name), chain.driven)}")
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = float("nan")
        if not 0 <= number < np.inf:
            example = f"""teeth='{{"{chain.driven[0]}":101}}'"""
            raise DataError(f"teeth={stated}: a number above 0 for all joints, or one a joint: teeth=101, {example}")
    joints = []
    for name in chain.driven:
        way, speed, load = (there.get(f"{kind}_{name}", "") for kind in ("direction", "velocity", "torque"))
        reading, number = walk.READING + name, float(teeth.get(name, 0.0))
        joints.append(Joint(name, reading, kinds[name], direction=way, velocity=speed, torque=load, teeth=number))
    known = walk.quantities(chain)
    links = tuple(Length(f"link to {j.name}", f"length_{j.name}") for j in chain.joints if f"length_{j.name}" in known)
    time = readings.ROW if readings.ROW in data else there.get("t_s", "")
    return Roles(tuple(joints), links, time=time, temperature=there.get(WARMTH, ""), instruments=instruments)


describe(
    "arm",
    Description(
        columns=ARM.columns,
        quantities=(
            *(
                Quantity(f"{body}_{one}", unit, f"{body}: {words}")
                for body in ("base", "tool")
                for one, (unit, words) in WAYS.items()
            ),
            *(Quantity(TURNED[k], "mrad", f"the tool's turn about {one}, as measured") for k, one in enumerate("xyz")),
            *(Quantity(AIM[k], "rad", f"the tool's turn about {one}") for k, one in enumerate("xyz")),
            Quantity(readings.ROW, "", "row"), Quantity(readings.TARGET_NUMBER, "", "target"),
        ),
        stated=(
            Stated("sigma_mm", "positive"), Stated("sigma_mrad", "positive"), Stated("teeth"),
            Stated("gravity", "list", "gravity=[0,0,-9.81]"), Stated("rotation"),
            Stated("socket_distance_mm", "positive"), Stated(PAYLOAD), Stated("urdf"), Stated("dh"),
            Stated("convention"),
        ),
        targets={"base": "the base", "tool": "the tool"},
        # held numbers are those that the readings do not tell from others; frames move as bodies
        replaced=("free_number", "frame_drift", "frame_shift"),
        named=ARM.named,
    ),
)  # fmt: skip
