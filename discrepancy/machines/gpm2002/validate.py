"""What is checked of measured data of the GPM2002 before anything is computed: columns, units, rows, stated noise.

What makes a fit meaningless is a `DataError`; what only costs something is a note, which every report repeats.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.core.options import shown, suggest
from calibench.discrepancy.checks.enter import entered
from calibench.discrepancy.model.measured.complete import with_numbers
from calibench.discrepancy.model.measured.data import NO_REPEATS, DataError, MeasuredData
from calibench.discrepancy.model.measured.stated import finite, nominal_numbers, positive
from calibench.problems.base import Array
from calibench.problems.planar.gpm2002 import NAMES

ENCODERS = ("enc_1", "enc_2", "enc_3")
SHARED = ("t_s", "temp_K", "speed", "heading", "load_x", "load_y")
OWN = ("vel", "dir", "tau", "axial")
COVARIATES = (*SHARED, *(f"{kind}_{i}" for kind in OWN for i in (1, 2, 3)))
_KNOWN = (*ENCODERS, "x", "y", *COVARIATES, "pose_id", "visit_id", "repeat", "split", "valid")
_MOST_TEETH = 1e6  # of a gear: a tooth has an angle that doubles still tell
_SPARE = 0.05  # of the rows may go for the sake of a covariate that is not a number there; beyond, the column goes


def validated(data: MeasuredData) -> MeasuredData:
    """Return the data as they can be used, with notes; raise `DataError` for data that cannot be used."""
    _of_this_machine(data)
    data = _usable_rows(_known_columns(entered(data)))
    data = _in_radians(data)
    data = _stated_noise(data)
    _check_stated(data)
    _enough(data)
    return _remarks(data)


def _of_this_machine(data: MeasuredData) -> None:
    stated = data.metadata.get("machine", data.machine)
    if stated != "gpm2002":
        raise DataError(f"{data.name}: these data are of machine {stated!r}; machine=gpm2002 cannot use them")
    missing = [column for column in ENCODERS if column not in data]
    if len(missing) == len(ENCODERS) and not any(_nearest(column, list(data.columns)) for column in missing):
        raise DataError(
            f"{data.name}: columns {', '.join(missing)} are missing, there are {', '.join(data.in_file)}: "
            "data of another machine? (state it: machine=NAME)"
        )
    if missing:
        near = {column: name for column in missing if (name := _nearest(column, list(data.in_file)))}
        told = f" (is {missing[0]} called {near[missing[0]]}?)" if missing[0] in near else ""
        raise DataError(
            f"{data.name}: column {', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing{told}; there are "
            f"{', '.join(data.in_file)}; rename it in the file, or state its name: "
            f'columns={{"{missing[0]}": "{near.get(missing[0], "NAME")}"}}'
        )


def _nearest(column: str, there: list[str]) -> str:
    plain = {_plain(name): name for name in there if name not in _KNOWN}
    close = difflib.get_close_matches(_plain(column), list(plain), n=1, cutoff=0.75)
    return plain[close[0]] if close else ""


def _plain(name: str) -> str:
    return "".join(letter for letter in name.lower() if letter.isalnum())


def _known_columns(data: MeasuredData) -> MeasuredData:
    """Return the data with columns of numbers; a note for every unknown column says which known one it may be."""
    columns: dict[str, NDArray[Any]] = {}
    for name, column in data.columns.items():
        if name in ("split", "pose_id", "visit_id", "valid") or name not in _KNOWN:
            columns[name] = column
            continue
        try:
            columns[name] = np.asarray(column, dtype=float)
        except (TypeError, ValueError):
            raise DataError(f"{data.name}: column {name} holds {str(column[0])!r}: numbers are needed") from None
    data = data.with_columns(columns)
    for name in data.columns:
        wanted = [known for known in _KNOWN if known not in data and _nearest(known, [name])]
        if name not in _KNOWN and wanted:
            data = data.with_note(f"column {name} is not known and not used; did you mean {wanted[0]}?")
    if data.has("x") != data.has("y"):
        data = _without(data, ("x", "y"), "x and y go together: one of them is missing, so only the angles are used")
    return data


def _without(data: MeasuredData, columns: tuple[str, ...], note: str) -> MeasuredData:
    kept = {name: column for name, column in data.columns.items() if name not in columns}
    return replace(data, columns=kept).with_note(note)


def _usable_rows(data: MeasuredData) -> MeasuredData:
    still = [column for column in ENCODERS if len(data) > 1 and (data[column] == data[column][0]).all()]
    if still and np.isfinite(data[still[0]][0]):
        raise DataError(f"{data.name}: {', '.join(still)} never varies: is the encoder read at all?")
    needed = list(ENCODERS)
    there = np.all([np.isfinite(data[column]) for column in ENCODERS], axis=0)
    if there.any() and data.has("x", "y"):
        tracked = np.isfinite(data["x"]) & np.isfinite(data["y"])
        if tracked[there].mean() < 0.5:
            data = _without(data, ("x", "y"), "x, y are missing in most rows, so only the angles are used")
        else:
            needed += ["x", "y"]
    for name in COVARIATES:
        if name not in data:
            continue
        bad = ~np.isfinite(data[name])
        if bad.mean() > _SPARE:
            data = _without(data, (name,), f"column {name} is not a number in {bad.mean():.0%} of the rows: not used")
        else:
            needed.append(name)
    return with_numbers(data, dict.fromkeys(needed, np.ones(len(data), dtype=bool)))


def _in_radians(data: MeasuredData) -> MeasuredData:
    turned = []
    for column in ENCODERS:
        reading = data[column]
        if np.ptp(reading) > 2.02 * np.pi:
            raise DataError(
                f"{data.name}: {column} ranges over {np.ptp(reading):.4g}, more than a turn: it looks like degrees; "
                "radians are needed (multiply by pi/180)"
            )
        middle = float(np.angle(np.exp(1j * reading).mean()))
        whole = reading - 2 * np.pi * np.round((reading - middle) / (2 * np.pi))
        if np.ptp(whole) < np.ptp(reading) - np.pi:
            data = data.with_columns({column: whole})
            turned.append(column)
    if "heading" in data and np.ptp(data["heading"]) > 4.04 * np.pi:
        raise DataError(f"{data.name}: heading ranges over {np.ptp(data['heading']):.4g}: radians are needed")
    if turned:
        data = data.with_note(f"{', '.join(turned)} jumps by a turn; whole turns are taken out")
    return data


def _stated_noise(data: MeasuredData) -> MeasuredData:
    """Return the data with sigma_enc, and with a tracker sigma_xy, in the metadata: as stated, or from repeats."""
    groups = {"sigma_enc": ENCODERS} | ({"sigma_xy": ("x", "y")} if data.has("x", "y") else {})
    for key, columns in groups.items():
        stated = data.metadata.get(key)
        if stated is not None:
            positive(data, key, stated)
            continue
        told = _from_repeats(data, columns)
        if told > 0:
            data = replace(data, metadata={**data.metadata, key: told})
            data = data.with_note(f"{key} is not stated; back-to-back repeats give {told:.3g}, which is used")
        elif key == "sigma_xy":
            data = _without(data, ("x", "y"), "sigma_xy is not stated and no repeats tell it: only the angles are used")
        else:
            raise DataError(f"{data.name}: {key} is neither in the metadata nor told by repeats; state it [rad]")
    return data


def _check_stated(data: MeasuredData) -> None:
    """Refuse statements on the encoders that cannot be right; a missing statement is no error."""
    resolution, teeth = data.metadata.get("encoder_lsb"), data.metadata.get("tooth_numbers")
    if resolution is not None:
        positive(data, "encoder_lsb", resolution)
    each = list(teeth.values()) if isinstance(teeth, Mapping) else teeth
    if isinstance(each, Sequence) and not isinstance(each, str):
        good = (isinstance(teeth, Mapping) or len(each) in (0, len(ENCODERS))) and all(_counts(n) for n in each)
    else:
        good = _counts(each)
    if not good:
        raise DataError(
            f"{data.name}: metadata tooth_numbers={shown(teeth)}: a number for each of the three joints is needed "
            "(null: not known), or one for all"
        )


def _counts(number: Any) -> bool:
    return number is None or (isinstance(number, int | float) and 0 <= number <= _MOST_TEETH)


def _from_repeats(data: MeasuredData, columns: tuple[str, ...]) -> float:
    """Return the spread of readings that follow each other within a visit over sqrt 2, robust; 0 without ten pairs."""
    if "visit_id" not in data:
        return 0.0
    order = np.argsort(data["visit_id"], kind="stable")
    same = data["visit_id"][order][1:] == data["visit_id"][order][:-1]
    if same.sum() < 10:
        return 0.0
    change = np.concatenate([np.diff(data[column][order])[same] for column in columns])
    return float(np.median(np.abs(change)) / 0.6745 / np.sqrt(2))


def _enough(data: MeasuredData) -> None:
    each, free = (3, 15) if data.has("x", "y") else (1, 11)
    sigma = float(data.metadata["sigma_enc"])
    poses = len(np.unique(np.round(np.stack([data[c] for c in ENCODERS]) / (100 * sigma)), axis=1).T)
    if poses * each < free + 3:
        raise DataError(
            f"{data.name}: {poses} different poses give {poses * each} equations: too few for {free} parameters; "
            f"measure {-(-2 * free // each)} poses or more"
        )


def _remarks(data: MeasuredData) -> MeasuredData:
    if "t_s" in data:
        again = len(data) - len(np.unique(data["t_s"]))
        if again:
            data = data.with_note(f"{again} rows repeat a time stamp; steps in time cannot fall between them")
    repeated = "visit_id" in data and len(np.unique(data["visit_id"])) < len(data)
    if not repeated:
        why = "" if data.has("pose_id", "visit_id") else " can be told without columns pose_id and visit_id"
        data = data.with_note(
            f"no repeats{why}: the stated noise is taken on trust; "
            "were it larger, noise would be taken for a missing effect",
            NO_REPEATS,
        )
    if "split" not in data or not (data["split"] == "hold").any():
        data = data.with_note("no rows are held out: the gap on unseen poses is by cross-validation")
    needed = [name for name in COVARIATES if name in data and name.partition("_")[0] in ("t", "temp", *OWN)]
    still = [name for name in needed if not np.ptp(data[name]) > 0]
    if still:
        data = data.with_note(f"{', '.join(still)} never varies; effects that need it cannot be tested")
    return data


def stated_numbers(data: MeasuredData) -> tuple[dict[str, float], tuple[str, ...]]:
    """Return the nominal numbers, and the names of those held, that the metadata state (names alone, or with values).

    Raises `DataError` for a name there is not and for a value that is no finite number.
    """
    numbers = nominal_numbers(data, NAMES)
    fixed = data.metadata.get("fixed_parameters") or ()
    if not isinstance(fixed, str | Sequence | Mapping):
        raise DataError(f"{data.name}: metadata fixed_parameters={fixed!r}: names, or names with values, are needed")
    held = (fixed,) if isinstance(fixed, str) else tuple(fixed)
    for name in held:
        if name not in NAMES:
            told = shown(name)
            raise DataError(f"{data.name}: metadata fixed_parameters names {told!r}; {suggest(told, NAMES)}")
    if len(set(held)) == len(NAMES):
        raise DataError(f"{data.name}: metadata fixed_parameters holds all parameters: nothing is left to calibrate")
    if isinstance(fixed, Mapping):
        numbers |= {name: finite(data, name, value) for name, value in fixed.items()}
    return numbers, held


def rows_for_start(data: MeasuredData, n: int) -> Array:
    """Return the indices of at most `n` rows spread over the data."""
    return np.unique(np.linspace(0, len(data) - 1, min(n, len(data))).round().astype(int))
