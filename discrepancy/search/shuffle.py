"""The control that a name of order, direction or time must pass: rows that change these among each other lose it.

What such a name explains must hang on which row was read when, after which, from which side, or how fast. So the
columns of its formula are exchanged among rows that are alike otherwise, and what it explains is asked again beside all
other findings: one projection for each shuffle. The most that any place or target of its family explains counts, as
the search has looked at all of them. Rows are alike that are of one pose, where poses were visited again, or else of a
stretch of the joint's way: the side from which a joint comes goes with where it stands, and an error over its way must
not count for play. The readings of a visit stay together. A walk of the zero, which has an order, passes.

Beside a rest without a name a name of any column is asked (`along`): what is left often goes slowly with the time, as
columns do, and two slow courses are alike by chance. There the columns are moved along the rows as a whole, around
their ends, so that each keeps its own course.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibench.discrepancy.diagnostics import score
from calibench.discrepancy.fitting.fit import Fit
from calibench.discrepancy.model.effect import Effect, LinearEffect, has_free_period, name_of, still_open
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.roles import inputs_of, roles_of
from calibench.discrepancy.registries import description_of
from calibench.discrepancy.report import Shuffled
from calibench.discrepancy.search.form import forms_of
from calibench.discrepancy.search.select import penalty
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

Rows = NDArray[np.integer[Any]]  # places of rows

_STRETCHES = 8  # of a joint's way, in each of which rows are alike
_EACH = 6  # visits in a stretch, at least
_FEWEST = 6  # visits that can change places with others: with fewer a shuffle is hardly one
_REVISITED = 0.5  # part of the visits, from which on poses count as visited again
_NUMBERS = 3  # coefficients of an effect, up to which its whole family is shuffled
_FULL = 1e-12  # of the square of a unit column
_AT_ONCE = 10  # shuffles
_MOVED = 0.1  # of the rows, by which columns are moved along them at least


def order_of(effect: Effect, formulation: Formulation) -> tuple[str, tuple[str, ...]]:
    """Return the order that an effect lives on (time, direction, velocity) and the columns that tell it; "" and ()."""
    roles, data = roles_of(formulation), formulation.data
    words = {j.direction: "direction" for j in roles.joints} | {j.velocity: "velocity" for j in roles.joints}
    words |= {name: "velocity" for one in roles.instruments for name in one.velocity}
    words |= {roles.time: "time", **description_of(data.machine).orders}
    met = [name for name in effect.columns if name in words and name in data]
    if not met or has_free_period(effect):
        return "", ()
    read = {*formulation.readings, *inputs_of(formulation)}
    return words[met[0]], tuple(name for name in effect.columns if name in data and name not in read)


def shuffled(
    at: Fit, effect: Effect, beside: Effect, family: Sequence[Effect], along: bool = False
) -> Shuffled | None:  # fmt: skip
    """Return how much `effect` explains in the place of `beside`, with its order and with shuffled ones; or None.

    `at` is the fit with all findings, `beside` among them; `family` are the candidates with which `effect` competed.
    None for an effect without an order, unless columns are to be moved `along` the rows, and where too few rows can
    change places.
    """
    formulation = at.at.model.formulation
    data, t, rng = formulation.data, thresholds(), np.random.default_rng(0)
    word, columns = order_of(effect, formulation)
    if columns:
        visits, classes = _alike(effect, formulation)
        sizes = np.bincount(classes)
        if sizes[sizes > 1].sum() < _FEWEST:
            return None
        draws = _draws(visits, classes, rng)
    else:
        read = {*formulation.readings, *inputs_of(formulation)}
        word, columns = "rows", tuple(name for name in effect.columns if name in data and name not in read)
        if not along or not columns or has_free_period(effect):
            return None
        steps = np.linspace(_MOVED, 1 - _MOVED, t.shuffles) * len(data)
        draws = (np.roll(np.arange(len(data)), int(step)) for step in rng.permutation(steps))
    on = score.projected_scores(at, without=(beside, *forms_of(beside, at.model.effects)))
    # whether what it changes in a row hangs on these columns alone, and the noise of rows on no other: then its changes
    # can be shuffled instead of the columns, and no row's whitening reads another row
    rows = at.at.misclosure
    each = len(effect.coefficients) <= _NUMBERS and len(on.y) < t.drawn_rows
    each = each and at.at.whiten.band is None and formulation.decorrelate(rows) is rows
    if each:
        source = np.random.default_rng(1).permutation(len(data))
        zero = np.zeros(len(effect.coefficients))
        kept = effect.basis(at.at.recorded, data, zero)
        other = data.with_columns({name: np.asarray(data[name])[source] for name in columns})
        moved = effect.basis(at.at.recorded, other, zero)
        each = all(np.allclose(np.asarray(kept[name])[source], moved[name]) for name in kept)
    rivals = [e for e in family if len(e.coefficients) <= _NUMBERS] if each else []
    if word == "rows":
        rivals = [e for e in rivals if e.columns == effect.columns]
    else:
        rivals = [e for e in rivals if order_of(e, formulation)[1]]
    gains = _Sums(at, on, [effect, *rivals]).gains if each else partial(_gains_of_one, at, on, effect, columns)
    sources = np.stack([np.arange(len(data)), *islice(draws, t.shuffles)])
    blocks = np.array_split(sources, range(1, len(sources), _AT_ONCE if each else 1))
    own, more, times = gains(blocks[0])[0, 0], 0, 0
    for found in (one for block in blocks[1:] for one in gains(block)):
        times += 1
        more += bool(np.max(found) >= own)
        if (more + 1) / (t.shuffles + 1) > t.shuffled_p:
            break  # more of them change nothing
    return Shuffled(word, more, times, (more + 1) / (times + 1))


def _draws(visits: Sequence[Rows], classes: Rows, rng: np.random.Generator) -> Iterator[Rows]:
    """Yield again and again for each row the row whose order it gets, (n,); visits of one class change places."""
    # the rows of each visit, the last again and again, (v, m), and of a row its visit and its place there
    lengths = np.array([*map(len, visits)])
    place = np.minimum(np.arange(lengths.max()), lengths[:, None] - 1)
    filled = np.concatenate(visits)[np.cumsum([0, *lengths[:-1]])[:, None] + place]
    visit, within = np.empty((2, lengths.sum()), dtype=int)
    visit[filled], within[filled] = np.arange(len(lengths))[:, None], place
    by_class, other = np.argsort(classes, kind="stable"), np.empty(len(classes), dtype=int)
    while True:
        other[by_class] = np.lexsort((rng.random(len(classes)), classes))
        yield np.asarray(filled[other[visit], within])


def _alike(effect: Effect, formulation: Formulation) -> tuple[Sequence[Rows], Rows]:
    """Return the rows of each visit, and the class of rows that are alike to which each visit belongs, (v,)."""
    data = formulation.data
    n = len(data)
    visit = np.unique(data["visit_id"], return_inverse=True)[1] if data.has("visit_id") else np.arange(n)
    order = np.argsort(visit, kind="stable")
    rows = np.split(order, np.flatnonzero(np.diff(visit[order])) + 1)
    first = np.array([own[0] for own in rows])
    if data.has("pose_id"):
        pose = np.unique(np.asarray(data["pose_id"])[first], return_inverse=True)[1]
        again = np.bincount(pose)[pose] > 1
        if again.mean() >= _REVISITED:
            return rows, pose
    met = set(effect.columns)
    joints = [
        j for j in roles_of(formulation).joints if j.name == effect.target or met & {j.direction, j.velocity} - {""}
    ]
    stretches = min(_STRETCHES, len(first) // _EACH)
    if len(joints) != 1 or joints[0].reading not in data or stretches < 2:
        return rows, np.zeros(len(first), dtype=int)
    stands = np.asarray(data[joints[0].reading], dtype=float)[first]
    ends = np.quantile(stands, np.linspace(0, 1, stretches + 1)[1:-1])
    return rows, np.searchsorted(ends, stands)


class _Sums:
    """The linear gains of effects whose changes are shuffled, by sums over rows."""

    def __init__(self, at: Fit, on: score.ProjectedScores, effects: Sequence[Effect]) -> None:
        self.on, self.paid, self.groups = on, np.empty(len(effects)), []
        data, targets = at.at.model.formulation.data, np.column_stack([on.Q, on.y])
        white: dict[str, Array] = {}
        alike: dict[tuple[object, ...], list[int]] = {}
        changes = [effect.basis(at.at.recorded, data, np.zeros(len(effect.coefficients))) for effect in effects]
        for k, (effect, change) in enumerate(zip(effects, changes)):
            self.paid[k] = penalty(effect, 1, len(on.y))
            alike.setdefault((*change, len(effect.coefficients)), []).append(k)
            for name in change:
                if name not in white:
                    slope = at.at.slopes[name]
                    white[name] = at.at.whiten(slope).reshape(slope.shape)
        pulls = {name: np.einsum("nc,nct->nt", one, targets.reshape(*one.shape, -1)) for name, one in white.items()}
        for (*names, _), own in alike.items():
            stacked = {name: np.stack([np.asarray(changes[k][name]).T for k in own]) for name in map(str, names)}
            pairs = {
                (one, other): np.einsum("nc,nc->n", white[one], white[other]) for one in stacked for other in stacked
            }
            self.groups.append((np.array(own), stacked, {name: pulls[name] for name in stacked}, pairs))

    def gains(self, sources: Rows) -> Array:
        """Return the gain of each effect with its order taken from the rows of each of `sources`, (s, n): (s, K)."""
        found = np.full((len(sources), len(self.paid)), -np.inf)
        for own, changes, pulls, pairs in self.groups:
            moved = {name: np.moveaxis(change[:, :, sources], 2, 0) for name, change in changes.items()}
            across = sum(change @ pulls[name] for name, change in moved.items())
            square = sum((moved[one] * pair) @ moved[other].swapaxes(2, 3) for (one, other), pair in pairs.items())
            size = np.sqrt(np.diagonal(square, axis1=2, axis2=3))
            size = np.where(size > 0, size, 1.0)
            b, absorbed = across[..., -1] / size, across[..., :-1] / size[..., None]
            left = square / size[..., None] / size[..., None, :] - absorbed @ absorbed.swapaxes(2, 3)
            values, vectors = np.linalg.eigh(left)
            kept = values > max(thresholds().visible ** 2, _FULL)
            along = np.einsum("skij,ski->skj", vectors, b) ** 2
            T, rank = np.where(kept, along / np.where(kept, values, 1.0), 0.0).sum(axis=2), kept.sum(axis=2)
            gains = self.on.gains(T, rank) - self.paid[own] - (rank - 1) * np.log(len(self.on.y))
            found[:, own] = np.where(rank > 0, gains, -np.inf)
        return found


def _gains_of_one(at: Fit, on: score.ProjectedScores, effect: Effect, columns: Sequence[str], sources: Rows) -> Array:
    """Return the linear gain, (1, 1), of an effect of any kind with its `columns` taken from the one of `sources`."""
    zero, source = np.zeros(len(effect.coefficients)), sources[0]
    other = LinearEffect(
        effect.family, effect.target, effect.formula, effect.channel, columns=effect.columns,
        coefficients=effect.coefficients, units=effect.units, unit=effect.unit,
        changes=lambda q, data: effect.basis(
            q, data.with_columns({name: np.asarray(data[name])[source] for name in columns}), zero
        ), measure=effect.amplitude,
    )  # fmt: skip
    [(found, _)] = score.score_all(at, on, [other])
    return np.array([[on.gain(found.T, found.m) - penalty(effect, found.m, len(on.y)) if found.m else -np.inf]])


def controls(
    at: Fit, sets: Sequence[Sequence[Effect]], candidates: Sequence[Effect], along: bool = False
) -> list[Mapping[str, Shuffled]]:  # fmt: skip
    """Return for each set, the first of which is in the fit, name -> the control (`shuffled`) of its effects."""
    taken = {name_of(own[0]) for own in sets}
    found: list[Mapping[str, Shuffled]] = []
    for own in sets:
        open_to = still_open(candidates, taken - {name_of(own[0])})
        told = {}
        for effect in own:
            family = [e for e in open_to if e.family == effect.family]
            if (one := shuffled(at, effect, own[0], family, along)) is not None:
                told[name_of(effect)] = one
        found.append(told)
    return found
