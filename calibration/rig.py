"""Rigs: several targets on the flange read at one pose, and targets that stand with the base.

A reading is a row: the joints, the place of one target, and which one that is. A row that holds several targets becomes
as many. A target that stays where it is while others move with the arm stands with the base: how it drifts is how the
tracker drifts, and is taken out of all other readings.

A course is b_k + s(t) + w(t) x (b_k - c) for target k about their middle c: still, even in time, or from visit to visit
(s and w by straight lines between); with targets that tell a turn also w. An F test takes an even course or a turn; one
from visit to visit has to predict visits that were left out with less than half of the squares.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from calibench.calibration.columns import POSITION, TARGET, Matched
from calibench.calibration.rigid import Array, Index, rotation_of
from calibench.core.notes import Code, DataError, Note
from calibench.core.words import listed, plain

_STILL = 0.02  # of the spread of a target that moves: one with less stands with the base
_LEAST = 4  # readings of a target, in the middle, where a column names them: with fewer it names something else
_BETTER = 0.5  # of the squares of visits left out: a course from visit to visit leaves less
_F = 4.0  # times the mean square of what is left: what each further number of a course explains
_VISITS = 3  # of the base, which tell a course
_KNOTS = 40  # of a course from visit to visit
_FOLDS = 5
_ALONG = 1e-3  # of their spread: targets that lie nearer to one line tell no turn about it


def unfolded(columns: Mapping[str, Any], matched: Matched, unit: str) -> tuple[dict[str, Any], Index, list[Note]]:
    """Return columns with one target a row and no drift of the base, the row of each in `columns`, and notes.

    Places are in the columns of `matched.position`, in `unit` ("" if it is not known); `TARGET` names the targets.
    """
    n, axes, empty = len(next(iter(columns.values()))), [matched.position[axis] for axis in POSITION], ""
    if matched.targets:
        names = list(matched.targets)
        groups = [np.column_stack([columns[c] for c in group.values()]) for group in matched.targets.values()]
        places, which = np.stack(groups, axis=1).astype(float), np.tile(np.arange(len(names)), (n, 1))
        seen = np.isfinite(places).all(axis=2)
        if not seen.all():
            empty = f"; {int((~seen).sum())} of their {seen.size} readings are empty"
        seen[~seen.any(axis=1), 0] = True  # a row without any reading is counted as one
        rows = np.nonzero(seen)[0]
        places, which = places[seen], which[seen]
    else:
        words, which = np.unique(np.asarray(columns[matched.other[TARGET]]).astype(str), return_inverse=True)
        names, which, rows = words.tolist(), which.ravel(), np.arange(n)
        if np.median(np.bincount(which)) < _LEAST:
            raise DataError(
                f"column {matched.other[TARGET]} names {len(names)} targets in {n} rows, and a target is read in many "
                "poses: leave it out, or call it otherwise, where it does not say which target a row reads"
            )
        places = np.column_stack([columns[c] for c in axes]).astype(float)

    spread = np.zeros(len(names))  # the median way of a target from its middle
    for k in range(len(names)):
        known = places[(which == k) & np.isfinite(places).all(axis=1)]
        if len(known):
            spread[k] = np.median(np.linalg.norm(known - np.median(known, axis=0), axis=1))
    still = spread < _STILL * spread.max()
    moves = ~still[which]
    notes: list[Note] = []
    if still.any():
        times = np.arange(n, dtype=float)  # the number of the row, where no clock tells its time
        clock = np.asarray(columns[matched.other["t_s"]]) if "t_s" in matched.other else times
        if clock.dtype.kind in "iuf" and n and np.isfinite(clock).all() and np.ptp(clock) > 0:
            times = clock.astype(float)
        course = course_of(places[~moves], which[~moves], times[rows], moves, rows)

        # as a tracker that stood still had read them
        there, basis = places[moves], _basis(course.kind, course.knots, times[rows[moves]])
        back = np.swapaxes(rotation_of(basis @ course.turns), 1, 2) - np.eye(3)
        shifted = there - basis @ course.shifts
        places[moves] = shifted + np.einsum("nij,nj->ni", back, shifted - course.middle)
        by = float(np.nanmax(np.linalg.norm(places[moves] - there, axis=1)))
        notes.append(course.note([name for name, one in zip(names, still, strict=True) if one], by, unit))
    others = {c for group in matched.targets.values() for c in group.values()}
    made = {name: np.asarray(column)[rows][moves] for name, column in columns.items() if name not in others}
    made |= dict(zip(axes, places[moves].T, strict=True))
    made[TARGET] = np.array(names)[which[moves]]
    if (several := len(np.unique(which[moves]))) > 1:
        targets = [name for name, one in zip(names, still, strict=True) if not one]
        text = f"{several} targets on the flange, each at a place of its own: {listed(targets, _FOLDS)}{empty}"
        notes.append(Note(Code.TARGETS, text, values={"targets": targets}))
    else:
        del made[TARGET]
    return made, rows[moves], notes


@final
@dataclass(frozen=True, eq=False)
class Course:
    """How the tracker drifts: `knots` (j,) in time, shifts (j, 3) and turns (j, 3) there, about `middle` (3,).

    `kind` is still, even, or visits; `scatter` is what is left of the base's readings, rms of a coordinate.
    """

    kind: str
    knots: Array
    shifts: Array
    turns: Array
    middle: Array
    visits: int
    scatter: float = 0.0

    def note(self, names: Sequence[str], by: float, unit: str) -> Note:
        """Return what the base's targets tell, in `unit`; `by` is the most by which a reading was moved."""
        size = f" {unit}" if unit else ", in the unit of the file,"
        read = f"{listed(names, _FOLDS)} {'stands' if len(names) == 1 else 'stand'} with the base"
        values = {"course": self.kind, "visits": self.visits, "by": by, "scatter": self.scatter}
        if self.visits < _VISITS:
            text = f"{read}, and was read too seldom to tell a drift: {_VISITS} times at the least"
        elif self.kind == "still":
            text = (
                f"{read}: no drift is seen by {self.visits} visits, which scatter by {plain(self.scatter, 2)}{size} rms"
            )
        else:
            how = "evenly" if self.kind == "even" else "from visit to visit"
            turned = " and turned" if self.turns.any() else ""
            text = (
                f"{read}: by {self.visits} visits the tracker drifted{turned} {how}, which is taken out of the "
                f"readings, {plain(by, 2)}{size} at most from its mean place"
            )
        return Note(Code.BASE_DRIFT, text, values=values)


def course_of(places: Array, which: Index, times: Array, moves: Any, rows: Index) -> Course:
    """Return the course that targets of the base, at `places` (m, 3), tell; `moves` (n,) marks all other readings.

    Of all readings `times` (n,) and `rows` (n,) are given. What is read between two poses is one visit.
    """
    known = np.isfinite(places).all(axis=1)
    places, which = places[known], np.unique(which[known], return_inverse=True)[1].ravel()
    visit = np.searchsorted(np.unique(rows[moves]), rows[~moves][known], side="right")
    visit = np.unique(visit, return_inverse=True)[1].ravel()
    count, middle, times = int(visit.max()) + 1, places.mean(axis=0), times[~moves][known]
    middles = np.array([places[which == k].mean(axis=0) for k in range(int(which.max()) + 1)])
    apart = np.linalg.svd(middles - middles.mean(axis=0), compute_uv=False)
    tells = len(middles) > 2 and bool(apart[1] > _ALONG * apart[0])
    of_visits = np.bincount(visit, times) / np.bincount(visit)
    knots = np.unique(np.quantile(of_visits, np.linspace(0, 1, min(_KNOTS, count))))

    def rest_of(kind: str, turning: bool, keep: Any = slice(None)) -> tuple[Array, int]:
        """Return what a course fitted to the readings of `keep` leaves of all, (m, 3), and its numbers."""
        mine = knots if kind == "even" else knots[np.isin(knots, of_visits[np.unique(visit[keep])])]
        basis = _basis(kind, mine, times)
        at, shifts, turns = _solved(places[keep], which[keep], basis[keep], middle, turning)
        there = at[which] + basis @ shifts + np.cross(basis @ turns, middles[which] - middle)
        return places - there, basis.shape[1] * (6 if turning else 3)

    def explains(course: tuple[str, bool], simple: tuple[str, bool]) -> bool:
        """Tell whether a course explains more than a simple one by more than chance makes it (F)."""
        (rest, more), (other, numbers) = rest_of(*course), rest_of(*simple)
        spare = places.size - 3 * len(middles) - more
        return spare > 0 and ((other**2).sum() - (rest**2).sum()) * spare > _F * (more - numbers) * (rest**2).sum()

    best = ("still", False)
    if count >= _VISITS:
        if explains(("even", False), best):
            best = ("even", False)
        left = dict.fromkeys(("even", "visits"), 0.0)  # of visits left out
        for kind in left:
            for fold in range(min(_FOLDS, count)):
                out = visit % min(_FOLDS, count) == fold
                left[kind] += float((rest_of(kind, False, ~out)[0][out] ** 2).sum())
        if left["visits"] < _BETTER * min(left["even"], float((rest_of("still", False)[0] ** 2).sum())):
            best = ("visits", False)
        turned = (best[0] if best[0] != "still" else "even", True)
        if tells and explains(turned, best):
            best = turned
    basis = _basis(best[0], knots, times)
    at, shifts, turns = _solved(places, which, basis, middle, best[1])
    rest = places - (at[which] + basis @ shifts + np.cross(basis @ turns, middles[which] - middle))
    return Course(best[0], knots, shifts, turns, middle, count, float(np.sqrt((rest**2).mean())))


def _basis(kind: str, knots: Array, times: Array) -> Array:
    """Return what a course of this kind is made of, at `times`, (n, j)."""
    if kind == "still":
        return np.zeros((len(times), 0))
    if kind == "even":
        return np.asarray((times - knots.mean()) / max(float(np.ptp(knots)), 1e-300))[:, None]
    return np.stack([np.interp(times, knots, one) for one in np.eye(len(knots))], axis=1)


def _solved(places: Array, which: Index, basis: Array, middle: Array, turning: bool) -> tuple[Array, Array, Array]:
    """Return the places of the targets (k, 3), and shifts and turns (j, 3), by least squares, the shortest."""
    n, j, count = len(places), basis.shape[1], int(which.max()) + 1
    about = places - middle
    size = float(np.sqrt((about**2).mean())) or 1.0
    eye = np.eye(3)
    of_targets = (np.eye(count)[which][:, :, None, None] * eye).transpose(0, 2, 1, 3).reshape(3 * n, -1)
    of_shifts = (basis[:, :, None, None] * eye).transpose(0, 2, 1, 3).reshape(3 * n, -1)
    across = np.stack([np.cross(one, about) for one in eye], axis=-1) / size  # (n, 3, 3): of a turn about each axis
    of_turns = (basis[:, :, None, None] * across[:, None]).transpose(0, 2, 1, 3).reshape(3 * n, -1)
    rows = np.hstack([of_targets, of_shifts, *([of_turns] if turning else [])])
    solved: Array = np.asarray(np.linalg.lstsq(rows, about.ravel(), rcond=1e-9)[0], dtype=float)
    turns: Array = solved[3 * (count + j) :].reshape(-1, 3) / size if turning else np.zeros((j, 3))
    seats: Array = np.asarray(solved[: 3 * count].reshape(-1, 3) + middle)
    shifts: Array = solved[3 * count : 3 * (count + j)].reshape(-1, 3)
    return seats, shifts, turns
