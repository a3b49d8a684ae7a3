"""`Mount`: the measured columns are how far each star was from where the axes said it was, in arcsec on the sky.

Two components: along the circle of the first axis (`dX`, `dS`), and along the second (`dDec`, `dEl`). The axes carry no
noise. Noise that nobody states is estimated from the residuals of the richest model of a mount: all terms of the field,
a slow change with time, and with the place. It explains what any single effect could, so what it leaves is noise.
Needed: `ha`, `dec`, `star_ha`, `star_dec` [rad] and the latitude, or `az`, `el`, `star_az`, `star_el`. Where
`pier_side` is west (ASCOM), a declination within +-90 degrees is carried over the pole.
"""

from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from math import isfinite
from typing import Any, Literal, final

import numpy as np

from calibench.core.notes import Code
from calibench.core.options import suggest
from calibench.core.words import counted, plain
from calibench.discrepancy.checks.validate import entered
from calibench.discrepancy.machines.mount import geometry
from calibench.discrepancy.machines.mount.effects import FAMILIES, TARGET, build
from calibench.discrepancy.machines.mount.geometry import ARCSEC, AXES, ERRORS, FRAME, NAMED, TURNS, Kind, Numbers
from calibench.discrepancy.model.effect import LinearEffect, NotTestable
from calibench.discrepancy.model.formulations import Predicted
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import (
    DataError,
    MeasuredData,
    MisfitError,
    Sensor,
    positive,
    refuse_rows,
    with_numbers,
)
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import Joint, Roles
from calibench.discrepancy.registries import machines
from calibench.problems.base import Array, Parameter
from calibench.problems.fitting import gauss_newton

INDEX: dict[Kind, tuple[str, str]] = {"equatorial": ("IH", "ID"), "altaz": ("IA", "IE")}
Base = Literal["index", "geometry"]
_WIDEST = 90 * 3600.0  # arcsec
_FARTHEST = np.radians(45.0)  # of a star from where the mount says it points: beyond, a column is of another kind
_LOWEST = np.radians(-1.0)  # of a star that was seen
_SHARE = 0.35  # of the residuals that the richest model may spend on its numbers
_WILD = 5.0  # robust deviations beyond which a star was misidentified
_MEDIAN = 0.6744897501960817  # of the modulus of a standard Gaussian variable
_STILL = 1e-9  # of the sum of squares: a fit that tells the noise falls no further
_ALIKE = 1e-4  # relative size below which a direction of the terms is none: names of one signature


@machines.register("mount")
@final
@dataclass(frozen=True)
class Mount:
    """A telescope mount. `base` is what is calibrated: the two index errors, or all six terms of the geometry."""

    base: Base = "geometry"
    name: str = field(default="mount", init=False)

    def formulate(self, data: MeasuredData) -> Predicted:
        data, kind, latitude = accepted(data)
        free = INDEX[kind] if self.base == "index" else tuple(TURNS[kind])
        terms = (*TURNS[kind], "TF", "TX")
        sigma = data.metadata.get("sigma_arcsec")
        noise = 1.0 if sigma is None else positive(data, "sigma_arcsec", sigma)

        joints = tuple(
            Joint(f"{words} axis", name, "rotary", "rad", f"dir_{name}", told="arcsec")
            for name, words in zip(AXES[kind], NAMED[kind])
        )

        def predicted(data: MeasuredData, noise: float) -> Predicted:
            return Predicted(
                data, partial(_predicted, kind, latitude),
                tuple(Parameter(name, "arcsec", 0.0, -_WIDEST, _WIDEST) for name in free),
                measured=dict.fromkeys(ERRORS[kind], noise), inputs=(*AXES[kind], *FRAME),
                held={name: 0.0 for name in terms if name not in free}, unit="arcsec",
                instruments=tuple(Sensor(name, "star", "arcsec") for name in ERRORS[kind]),
                roles=Roles(joints=joints, time="t_s" if "t_s" in data else "", temperature="temp_K"),
                slopes=partial(_slopes, kind, latitude),
            )  # fmt: skip

        there = predicted(data, noise)
        if sigma is not None:
            return there
        if len(data) <= len(free):
            few = f"the noise is not stated: {counted(len(data), 'star')} cannot tell it, and 1 arcsec is taken"
            return predicted(data.with_note(Code.NOISE_UNSTATED, f"{few}; sigma_arcsec= states it"), noise)
        left = _left_by_all(there)
        text = (
            f"the noise is not stated: {plain(left, 3)} arcsec in each component is what all terms of the field "
            "together leave; sigma_arcsec= states it"
        )
        return predicted(data.with_note(Code.NOISE_UNSTATED, text, sigma_arcsec=left), left)


def _predicted(kind: Kind, latitude: float, q: Quantities) -> Numbers:
    """Return the errors on the sky that the terms in `q` make, shape (n, 2), arcsec."""
    terms = {name: np.asarray(q[name]) for name in (*TURNS[kind], "TF", "TX")}
    roll, pitch = (np.asarray(q[name]) for name in AXES[kind])
    towards, axes = geometry.pointing(kind, latitude, roll, pitch, terms), geometry.tangents(*(q[n] for n in FRAME))
    return np.stack([np.sum(axis * towards, axis=1) for axis in axes], axis=-1) / ARCSEC


def _slopes(kind: Kind, latitude: float, q: Quantities) -> dict[str, Array]:
    """Return the slopes of `_predicted` in the axes and the terms, name -> (n, 2)."""
    terms = {name: np.asarray(q[name]) for name in (*TURNS[kind], "TF", "TX")}
    roll, pitch = (np.asarray(q[name]) for name in AXES[kind])
    axes = np.stack(geometry.tangents(*(np.asarray(q[n]) for n in FRAME)), axis=1) / ARCSEC
    moved = geometry.slopes_of(kind, latitude, roll, pitch, terms)
    return {name: np.einsum("nck,nk->nc", axes, one) for name, one in moved.items()}


def _left_by_all(formulation: Formulation) -> float:
    """Return the standard deviation of an error on the sky, of either component, in a fit with all terms together."""
    data, effects = formulation.data, tuple[LinearEffect, ...]()
    for name in FAMILIES:  # every term of the field that these data can test
        with suppress(NotTestable):
            effects += build(formulation, TARGET, term_name=name)
    if data.has("split"):
        formulation = formulation.on(data.rows(data.fitted))
    base = Model(formulation)
    rich = base.with_effects(*effects)
    none = np.zeros(rich.size - base.size)
    x = _fitted(base, base.start)
    columns = rich.jacobian(np.concatenate([x, none]))
    if rich.size <= _SHARE * columns.shape[0] * columns.shape[1]:
        x = _fitted(rich, np.concatenate([x, none]))
        columns = rich.jacobian(x)
        left = np.asarray(rich.residuals(x))
    else:
        left, columns = np.asarray(base.residuals(x)), base.jacobian(x)

    # in each component, (n, m, k m): a cubic of the order of the stars, and waves over the sky
    n, m = len(formulation.data), len(formulation.readings)
    order = np.asarray(formulation.data["t_s"]) if formulation.data.has("t_s") else np.arange(n)
    t = 2 * (order - order.min()) / max(float(np.ptp(order)), 1e-300) - 1
    first, second = (np.asarray(formulation.data[name]) for name in FRAME)
    orders = [(k, j) for k in (0, 1, 2) for j in (-1, 0, 1) if (k, j) > (0, 0)]
    waves = [f(k * first + j * second) for k, j in orders for f in (np.sin, np.cos)]
    for more in (np.stack([t, t**2, t**3], axis=1), np.stack(waves, axis=1)):
        each = [np.eye(m)[k][None, :, None] * more[:, None, :] for k in range(m)]
        wider = np.concatenate([columns, *each], axis=2)
        if wider.shape[2] <= _SHARE * left.size:
            columns = wider
    flat = columns.reshape(left.size, -1)
    flat = flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-300)
    rank = int(np.linalg.matrix_rank(flat, tol=_ALIKE * np.sqrt(flat.shape[1])))
    left = left - (flat @ np.linalg.lstsq(flat, left.ravel(), rcond=_ALIKE)[0]).reshape(left.shape)

    squares, spent = [], rank / left.shape[1]  # of each component, without wild stars
    for one in left.T:
        core = float(np.median(np.abs(one))) / _MEDIAN
        kept = one[np.abs(one) <= _WILD * max(core, 1e-12)]
        squares.append(float(np.sqrt(np.sum(kept**2) / max(len(kept) - spent, 1.0))) ** 2)
    return float(np.sqrt(np.mean(squares)))


def _fitted(model: Model, x: Array) -> Array:
    return gauss_newton(
        lambda x: model.residuals(x).ravel(), lambda x: model.jacobian(x).reshape(-1, model.size), x,
        rank_tolerance=_ALIKE, least_fall=_STILL,
    )  # fmt: skip


def accepted(data: MeasuredData) -> tuple[MeasuredData, Kind, float]:
    """Return the observations with `ERRORS` [arcsec] and `FRAME` [rad], the kind of mount, and its latitude [rad].

    The latitude is 0 where none is needed. Raises `DataError` for what is wrong.
    """
    if data.machine not in ("", "mount"):
        raise DataError(f"{data.name}: these are data of machine {data.machine!r}, not of a mount")
    stated = data.metadata.get("mount", "altaz" if "az" in data and "ha" not in data else "equatorial")
    kind = next((kind for kind in AXES if kind == stated), None)
    if kind is None:
        raise DataError(f"{data.name}: mount={stated}: equatorial or altaz is needed")
    names = (*AXES[kind], *(f"star_{name}" for name in AXES[kind]))
    missing = [name for name in names if name not in data]
    if missing:
        raise DataError(
            f"{data.name}: no column {', '.join(missing)}; an {kind} mount needs {', '.join(names)}; there are "
            f'{", ".join(data.in_file)}: columns={{"{missing[0]}": "NAME"}} tells another name'
        )
    data = entered(data)
    data = with_numbers(data, dict.fromkeys(names, np.ones(len(data), dtype=bool)))
    read = {name: np.asarray(data[name], dtype=float) for name in names}
    for name, column in read.items():
        if np.max(np.abs(column)) > 4 * np.pi:
            raise DataError(
                f"{data.name}: {name} reaches {np.max(np.abs(column)):.0f} rad; state its unit, in the heading as "
                f"[deg] or by units={name}:deg"
            )
    data, latitude, (sign, zero) = _stated(data, kind)
    if kind == "altaz":
        read |= {name: sign * read[name] + zero for name in (names[0], names[2])}

    # the axes within +-pi, the pitch beyond +-pi/2 where the tube has gone over the pole
    roll, pitch = read[names[0]], read[names[1]]
    if "pier_side" in data and kind == "equatorial":
        words = np.char.lower(np.char.strip(np.asarray(data["pier_side"]).astype(str)))
        sides = np.isin(words, ("east", "west", "e", "w"))
        refuse_rows(data, sides, lambda k: f"pier_side={words[k]}: east or west is needed")
        over = np.isin(words, ("west", "w")) & (np.cos(pitch) > 0)
        roll, pitch = np.where(over, roll + np.pi, roll), np.where(over, np.pi - pitch, pitch)
    roll, pitch = ((angle + np.pi) % (2 * np.pi) - np.pi for angle in (roll, pitch))

    star = geometry.direction(read[names[2]], read[names[3]])
    below = "the star is below the horizon; are latitude, units and hour angles right?"
    refuse_rows(data, star @ geometry.zenith(kind, latitude) >= np.sin(_LOWEST), lambda k: below, MisfitError)
    frame = geometry.angles(geometry.direction(roll, pitch))
    apart = 2 * np.arcsin(np.clip(np.linalg.norm(star - geometry.direction(*frame), axis=1) / 2, 0, 1))
    if np.median(apart) > _FARTHEST:
        raise MisfitError(
            f"{data.name}: half of the stars are more than {np.degrees(np.median(apart)):.0f} degrees from where the "
            "mount says that it points; are the units right, and is it the mount that the file states (mount=)?"
        )
    far = "deg from where the mount says that it points; leave the row out"
    refuse_rows(data, apart <= _FARTHEST, lambda k: f"the star is {np.degrees(apart[k]):.0f} {far}", MisfitError)
    columns: dict[str, Any] = {names[0]: roll, names[1]: pitch, **dict(zip(FRAME, frame))}
    for name, axis in zip(ERRORS[kind], geometry.tangents(*frame)):
        columns[name] = np.sum(axis * star, axis=1) / ARCSEC
    columns["side"] = np.where(np.cos(pitch) < 0, -1.0, 1.0)
    kept = {name: column for name, column in data.columns.items() if name not in (*names[2:], "pier_side")}
    data = replace(data, columns={**kept, **columns})  # the star's place is said by the error: once is enough
    return replace(data, machine="mount"), kind, latitude


def _stated(data: MeasuredData, kind: Kind) -> tuple[MeasuredData, float, tuple[int, float]]:
    """Return the latitude [rad], and sign and zero [rad] of azimuth as it is counted; a note where nobody says so."""
    stated, latitude = data.metadata.get("latitude_deg"), 0.0
    if stated is not None or kind != "altaz":
        try:
            latitude = float(stated)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            raise DataError(f"{data.name}: no latitude; state it in degrees: latitude_deg=39") from None
        if not (isfinite(latitude) and abs(latitude) <= 90):
            raise DataError(f"{data.name}: latitude_deg={latitude:g}: -90 to 90 degrees is needed")
    latitude = float(np.radians(latitude))
    if kind != "altaz":
        return data, latitude, geometry.AZIMUTHS[geometry.NORTH_EAST]
    counted_so = data.metadata.get("azimuth")
    if counted_so is None:
        others = " or ".join(f"azimuth={way}" for way in geometry.AZIMUTHS if way != geometry.NORTH_EAST)
        text = (
            f"nobody states how azimuth is counted: from north through east is taken; {others} states another, which "
            "turns signs of terms (AN, AW, CA, NPAE)"
        )
        data = data.with_note(Code.SIGNS_TAKEN, text, ("az",))
        return data, latitude, geometry.AZIMUTHS[geometry.NORTH_EAST]
    if counted_so not in geometry.AZIMUTHS:
        raise DataError(f"{data.name}: azimuth={counted_so}: {suggest(str(counted_so), geometry.AZIMUTHS)}")
    return data, latitude, geometry.AZIMUTHS[counted_so]
