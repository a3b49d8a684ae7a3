"""`LocalModel`: a simulator near where it was calibrated, from few calls: values, slopes and curvatures of all rows.

A search asks for thousands of predictions, each a little away from the last. What lies between is told by a quadratic
about the calibrated simulator, corrected by the nearest place at which the simulator itself was called; where the terms
that a quadratic of single variables lacks could reach `_TRUST` of the noise, it is called there. So the simulator's
calls follow what the search visits, not what it asks. Rows that it does not know (new ones, shuffled ones) are called.

The noise of the simulator itself (a solver's tolerance) is told by the difference table of calls very near to each
other (ECnoise: More and Wild, SIAM J. Sci. Comput. 33(3), 2011). The step of a central difference is that at which the
third difference stands out of this noise by a factor between 1.5 and 6 (Shi, Xie, Xuan and Nocedal, Optim. Methods
Softw. 37(5), 2022, sec. 3): smaller ones are noise, larger ones curvature.

An output that is rounded, or jumps, answers very near calls alike. So third differences are taken over a ladder of
steps: those of a smooth output fall with the third power of the step, those of a kink with the first, and where they
fall more slowly and are below the noise of the readings, the output is rough at this level. Slopes along a variable in
which an output is rough are least squares of a cubic over a fan of wide points, and their noise is known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from calibench.core.words import one_line
from calibench.discrepancy.machines.simulator.caller import Caller
from calibench.discrepancy.model.machine import Quantities
from calibench.discrepancy.model.measured import DataError
from calibench.problems.base import Array

_TRUST = 0.05  # of the noise of a reading, rms: the error of the local model beyond which the simulator is called
_PLACES = 48  # places of calls that are remembered
_TABLE = 8  # calls of a difference table, which has columns up to the sixth
_NEAR = 1e-9  # of the range of a number: apart from each other by it, calls of a difference table
_RATIO = (1.5, 6.0)  # of the third difference over the noise
_ROUNDS = 12  # of fitting a step
_LONGEST = 0.05  # of the range of a number: the longest step
FEW = 8  # rows on which noise and steps are told, where rows are independent
_RADII = 0.15 / 3.0 ** np.arange(7)  # of the range of a number: of the ladder, whose steps are all but the first
_FALL = 2.5  # of the third difference over a third of the step: less is rough, 3 is a kink, 27 is smooth
_LOUD = 1e-3  # of the noise of a reading: own noise from which an output is rough
_FAN = np.array([-3.0, -1.0, 1.0, 3.0])  # steps
_BENT = 100.0  # times its slope over the range of a number: an output that bends more jumps within the step
_FLAT = 1e-5  # of the range of a number: the least step by which a parameter is told that others make up for
_TAKES_PART = 0.01  # of such a combination, in ranges
_UNTOLD = 3.0  # times the noise of all readings, for its whole range: parameters that change them less are not told
_TINY = float(np.finfo(float).eps)
_REPEATS = 6  # calibrations, each about the last one's place


@final
@dataclass(frozen=True, eq=False)
class Variable:
    """A number that is varied: its place among inputs or parameters, its range, and its limits."""

    name: str
    is_input: bool
    at: int
    width: float
    lower: float = -math.inf
    upper: float = math.inf


@final
@dataclass(frozen=True, eq=False)
class Place:
    """A place where the simulator was called: inputs (n, k), parameters (n, p), values (n, m), NaN where it was not."""

    inputs: Array
    parameters: Array
    values: Array


@final
@dataclass(eq=False)
class LocalModel:
    """The simulator over the rows of one table. `noise` and `scale` (m,) are its own and that of the readings.

    `rough` has the level, (m,), of what is rounded or jumps along a variable, and of noise that is not small.
    """

    caller: Caller
    inputs: Array
    variables: tuple[Variable, ...]
    parameters: Array
    scale: Array
    noise: Array = field(default_factory=lambda: np.zeros(0))
    steps: Mapping[str, float] = field(default_factory=dict)
    rough: dict[str, Array] = field(default_factory=dict)
    independent: bool = True
    takes_rows: bool = True  # parameters that differ from row to row
    slopes: dict[str, Array] = field(default_factory=dict)
    curves: dict[str, Array] = field(default_factory=dict)
    mixed: dict[tuple[str, str], Array] = field(default_factory=dict)  # of two parameters: they make up for each other
    reaches: dict[str, Array] = field(default_factory=dict)  # the root of a curvature, rms over the rows, (m,)
    places: list[Place] = field(default_factory=list)
    made_up: dict[str, dict[str, float]] = field(default_factory=dict)  # parameters that are held: others do the same
    refused: str = ""  # what it said where it failed first, within its bounds

    def prepare(self) -> None:
        """Call the simulator as it is, and tell what it can be asked for, its noise, and the steps of differences."""
        n = len(self.inputs)
        [values] = self.caller.ask([(self.inputs, self.parameters)])
        if not np.isfinite(values).all():
            rows = np.flatnonzero(~np.isfinite(values).all(axis=1))
            raise DataError(
                f"the simulator gives no finite number in {len(rows)} of {n} rows at the nominal parameters (the first "
                f"is row {rows[0] + 1}); leave these rows out (valid=0), or state other nominal parameters"
            )
        self.places = [Place(self.inputs, np.tile(self.parameters, (n, 1)), values)]
        few = np.unique(np.linspace(0, n - 1, min(n, FEW)).astype(int))
        size = np.maximum(np.max(np.abs(values), axis=0), 1e-300)
        if len(few) < n:
            [alone] = self.caller.ask([(self.inputs[few], self.parameters)])
            apart = np.abs(alone - values[few])
            self.independent = bool((apart <= 1e-9 * size).all())
        rows = few if self.independent else np.arange(n)
        self.noise = np.maximum(self._own_noise(rows), _TINY * size)
        if (loud := np.flatnonzero(self.noise > self.scale)).size:
            name, own, read = self.caller.names.outputs[loud[0]], self.noise[loud[0]], self.scale[loud[0]]
            raise DataError(
                f"the simulator's own noise, {own:.2g} of {name}, is larger than that of its readings, {read:.2g}: "
                "asked the same again it answers otherwise; fix its random numbers, or tighten its solver's tolerance"
            )
        if len(few) < n and not self.independent:  # a noise of its own is no dependence
            self.independent = bool((apart <= 10 * self.noise + 1e-9 * size).all())
        if self.independent:
            try:
                [each] = self.caller.ask([(self.inputs[few], np.tile(self.parameters, (len(few), 1)))])
                self.takes_rows = bool((np.abs(each - values[few]) <= 10 * self.noise + 1e-9 * size).all())
            except DataError:  # whatever a function of numbers does with arrays
                self.takes_rows = False
        else:
            self.takes_rows = False
        known = [v for v in self.variables if self.independent or not v.is_input]
        rows = few if self.independent else np.arange(n)
        rough = self.independent or bool(self._levels(known, rows)[1].any())  # of the whole table each call is dear
        self.steps = {v.name: self._step(v, rows, rough) for v in known}

    @property
    def own(self) -> Array:
        """Return the standard deviation of all in its outputs that is not smooth, (m,)."""
        return np.asarray(np.max([self.noise, *self.rough.values()], axis=0))

    def calibrate(self, measured: Array, fitted: NDArray[np.bool_], free: NDArray[np.bool_]) -> None:
        """Move the parameters that are `free` (p,) to the least squares over the rows that are `fitted`; differentiate.

        `measured` is (n, m). Where nobody states the noise, `scale` is NaN and taken from what is left.
        """
        names = [v for v in self.variables if not v.is_input]
        own = [v for v in names if free[v.at]]
        told, at_first = np.isfinite(self.scale), True
        for _ in range(_REPEATS):
            self._differentiate(names, self.places[-1])
            left = measured - self.places[-1].values
            spread = np.median(np.abs(left[fitted]), axis=0) / 0.6745
            self.scale = np.where(told, self.scale, np.maximum(spread, self.noise))
            if at_first:
                self.made_up, at_first = self._made_up(own, fitted), False
                own = [v for v in own if v.name not in self.made_up]
            if not own:
                break
            weight = 1 / np.maximum(self.scale, 1e-300)
            J = np.stack([self.slopes[v.name] for v in own], axis=-1)[fitted] * weight[None, :, None]
            r = (left[fitted] * weight).ravel()
            J = J.reshape(len(r), -1)
            length = np.linalg.norm(J, axis=0)
            length = np.where(length > 0, length, 1.0)
            step = np.linalg.lstsq(J / length, r, rcond=1e-9)[0] / length
            moved = float(np.sqrt(np.mean((J @ step) ** 2)))
            # by the step, or a part of it, to a better place within the limits
            at = self.places[-1]
            now = float(np.mean(((left / self.scale)[fitted]) ** 2))
            for part in (1.0, 0.5, 0.25, 0.1):
                p = at.parameters[0].copy()
                for v, change in zip(own, step):
                    edge = 0.01 * v.width
                    p[v.at] = float(np.clip(p[v.at] + part * change, v.lower + edge, v.upper - edge))
                try:
                    [values] = self.caller.ask([(self.inputs, p)])
                except DataError:  # a shorter step is tried
                    continue
                if np.isfinite(values).all() and np.mean((((measured - values) / self.scale)[fitted]) ** 2) < now:
                    self.places.append(Place(self.inputs, np.tile(p, (len(self.inputs), 1)), values))
                    self.parameters = p
                    break
            if self.places[-1] is at or moved < 0.05:
                break
        last = self.places[-1]
        self.parameters, self.places = last.parameters[0], [last, *self.places[:-1]]
        self.scale = np.where(told, self.scale, np.maximum(self.scale, self.noise))
        self._differentiate([v for v in self.variables if v.name in self.steps], last)
        if not any(np.any(slope) for slope in self.slopes.values()):
            raise DataError(
                "the simulator answers the same whatever its inputs and parameters are: does it read what it is given?"
            )
        if own and not any(np.any(self.slopes[v.name]) for v in own):
            which = ", ".join(v.name for v in own)
            raise DataError(f"no output depends on a parameter that is calibrated ({which}): does it read them?")

        # the mixed curvatures of parameters: those that make up for each other move far together
        p, pairs = last.parameters[0], [(a, b) for k, a in enumerate(names) for b in names[:k]]
        first = {v.name: self._offsets(v, self.steps[v.name], p)[0] for v in names}
        questions = [_varied(v, last.inputs, p, first[v.name]) for v in names]
        for a, b in pairs:
            questions.append(_varied(b, *_varied(a, last.inputs, p, first[a.name]), first[b.name]))
        answers = self.caller.ask(questions)
        one = dict(zip(first, answers))
        for (a, b), both in zip(pairs, answers[len(names) :]):
            area = first[a.name] * first[b.name]
            bend = (both - one[a.name] - one[b.name] + last.values) / area
            sure = np.isfinite(bend) & (np.abs(bend) > 4 * self.noise / abs(area))
            self.mixed[a.name, b.name] = np.where(sure, bend, 0.0)

    def _made_up(self, own: Sequence[Variable], fitted: NDArray[np.bool_]) -> dict[str, dict[str, float]]:
        """Return parameters of `own` that others make up for in all rows: name -> other -> its change for a unit of it.

        Slopes over wide steps have errors that hide it, so it is told by steps of the simulator's own noise.
        """
        if len(own) < 2:
            return {}
        base, width = self.places[0], np.array([v.width for v in own])
        step = min(max(_FLAT, 10 * math.sqrt(base.values.size) * float(np.max(self.noise / self.scale))), _LONGEST)
        sign = np.array([1.0 if self.parameters[v.at] + step * v.width <= v.upper else -1.0 for v in own])

        def changes(steps: Array) -> Array:  # of the readings, in their noise, for a width
            questions = []
            for one in np.atleast_2d(steps):
                p = self.parameters.copy()
                p[[v.at for v in own]] += one * width
                questions.append((self.inputs, p))
            answers = np.stack(self.caller.ask(questions)) - base.values
            return np.asarray((answers / self.scale)[:, fitted].reshape(len(questions), -1) / step)

        J = changes(step * np.diag(sign)).T * sign
        wide = np.stack([(self.slopes[v.name][fitted] * v.width / self.scale).ravel() for v in own], axis=-1)
        sizes, known = np.linalg.norm(J, axis=0), np.linalg.norm(wide, axis=0)
        if not ((sizes > known / 2) & (sizes < 2 * known)).all():  # it answers in steps
            return {}
        found: dict[str, dict[str, float]] = {}
        for way in np.linalg.svd(J, full_matrices=False)[2][::-1]:
            if not np.linalg.norm(changes(step * way)) < _UNTOLD:
                break
            k = max((k for k, v in enumerate(own) if v.name not in found), key=lambda k: abs(way[k]))
            units = way * width / (way[k] * width[k])
            others = [j for j, part in enumerate(way) if j != k and abs(part) > _TAKES_PART]
            found[own[k].name] = {own[j].name: float(units[j]) for j in others}
        return found

    @np.errstate(over="ignore", invalid="ignore")  # far beyond all that was read, which a fit refuses
    def predict(self, rows: NDArray[np.intp], q: Quantities) -> Array:
        """Return the prediction, (n, m), for `rows` of the table, -1 for one that it does not have, at quantities q."""
        inputs, parameters = self._asked(len(rows), q)
        if (rows < 0).any() or not self.slopes:
            return self._called(rows, inputs, parameters)
        best, least = self.places[0], math.inf
        trusted = np.maximum(_TRUST * self.scale, self.own)
        away = self._parts(rows, inputs, parameters, self.places[0])
        for place in reversed(self.places):
            if np.isnan(place.values[rows, 0]).any():
                continue
            gone = self._bend(self._parts(rows, inputs, parameters, place))
            from_base = self._parts(rows, place.inputs[rows], place.parameters[rows], self.places[0])
            off = gone * (gone + 2 * self._bend(from_base))
            error = float(np.sqrt(np.max(np.mean((off / trusted) ** 2, axis=0))))
            if error < least:
                best, least = place, error
        same = parameters.ndim == 1 or bool(np.ptp(parameters, axis=0).max(initial=0.0) == 0)
        able = same or self.takes_rows or self.caller.one
        if least > 1.0 and able and self._at_home(inputs, parameters):
            try:
                values = self._called(rows, inputs, parameters)
            except DataError as error:  # whatever a simulator does far from where it is at home
                said = error.__cause__ or error
                self.refused = self.refused or f"{type(said).__name__}: {one_line(str(said))}"
                values = np.full((len(rows), len(self.scale)), np.nan)
            if np.isfinite(values).all():
                n, m = len(self.inputs), values.shape[1]
                whole = Place(self.inputs.copy(), np.tile(self.parameters, (n, 1)), np.full((n, m), np.nan))
                whole.inputs[rows], whole.parameters[rows], whole.values[rows] = inputs, parameters, values
                self.places = [self.places[0], *self.places[1:][-_PLACES:], whole]
                return values
        there = self._parts(rows, best.inputs[rows], best.parameters[rows], self.places[0])
        changes = []  # from the base to here, and to the place, to second order
        for apart in (away, there):
            total = np.zeros((len(rows), self.places[0].values.shape[1]))
            for name, change in apart.items():
                if np.any(change):
                    d = change[:, None]
                    total += (self.slopes[name][rows] + self.curves[name][rows] * d) * d
            for (a, b), bend in self.mixed.items():
                if np.any(apart[a]) and np.any(apart[b]):
                    total += bend[rows] * (apart[a] * apart[b])[:, None]
            changes.append(total)
        return np.asarray(best.values[rows] + changes[0] - changes[1])

    def slopes_at(self, rows: NDArray[np.intp], q: Quantities) -> dict[str, Array]:
        """Return the derivative of the prediction in each variable, name -> (n, m); 0 in one that is never varied."""
        inputs, parameters = self._asked(len(rows), q)
        m = len(self.caller.names.outputs)
        if (rows < 0).any() or not self.slopes:
            found = {}
            for v in self.variables:
                if v.name not in self.steps:
                    continue
                h = self.steps[v.name]
                up, down = (self._called(rows, *_varied(v, inputs, parameters, s)) for s in (h, -h))
                found[v.name] = (up - down) / (2 * h)
        else:
            away = self._parts(rows, inputs, parameters, self.places[0])
            found = {n: self.slopes[n][rows] + 2 * self.curves[n][rows] * away[n][:, None] for n in self.slopes}
            for (a, b), bend in self.mixed.items():
                found[a] = found[a] + bend[rows] * away[b][:, None]
                found[b] = found[b] + bend[rows] * away[a][:, None]
        return {v.name: found.get(v.name, np.zeros((len(rows), m))) for v in self.variables}

    def _at_home(self, inputs: Array, parameters: Array) -> bool:
        """Return whether parameters are within their bounds, and inputs at most their range beyond what was read."""
        for v in self.variables:
            asked, beyond = (inputs if v.is_input else parameters)[..., v.at], 0.0
            lower, upper = v.lower, v.upper
            if v.is_input:
                lower, upper, beyond = float(self.inputs[:, v.at].min()), float(self.inputs[:, v.at].max()), v.width
            if not ((asked >= lower - beyond) & (asked <= upper + beyond)).all():
                return False
        return True

    def _asked(self, n: int, q: Quantities) -> tuple[Array, Array]:
        """Return inputs (n, k) and parameters, (p,) or (n, p) where an effect changes them from row to row."""
        names = self.caller.names
        inputs = np.stack([np.broadcast_to(np.asarray(q[u], dtype=float), n) for u in names.inputs], axis=-1)
        each = [np.asarray(q[p], dtype=float) for p in names.parameters]
        if all(np.ndim(p) == 0 for p in each):
            return inputs, np.array([float(p) for p in each])
        wide = np.stack([np.broadcast_to(p, n) for p in each], axis=-1)
        return inputs, wide[0] if n and np.ptp(wide, axis=0).max(initial=0.0) == 0 else wide

    def _called(self, rows: NDArray[np.intp], inputs: Array, parameters: Array) -> Array:
        """Return what the simulator itself gives; of rows that depend on each other the whole table is simulated."""
        if self.independent or (rows < 0).any():
            return self.caller.ask([(inputs, parameters)])[0]
        whole = self.inputs.copy()
        whole[rows] = inputs
        return np.asarray(self.caller.ask([(whole, parameters)])[0][rows])

    def _parts(self, rows: NDArray[np.intp], inputs: Array, parameters: Array, place: Place) -> dict[str, Array]:
        """Return how far each variable is from a place, name -> (n,)."""
        away = inputs - place.inputs[rows]
        off = parameters - place.parameters[rows]
        return {v.name: (away if v.is_input else off)[:, v.at] for v in self.variables if v.name in self.slopes}

    def _bend(self, away: Mapping[str, Array]) -> Array:
        """Return the root of the largest second-order term that these distances could have, (n, m) of rows and outputs.

        Of two variables the mixed curvature is at most the geometric mean of their own where the function is convex.
        """
        n, m = len(next(iter(away.values()))), self.places[0].values.shape[1]
        total = np.zeros((n, m))
        for name, change in away.items():
            if np.any(change):
                total = total + self.reaches[name] * np.abs(change)[:, None]
        return total

    def _differentiate(self, variables: list[Variable], at: Place) -> None:
        """Take slopes and curvatures of `variables` at a place of all rows, all calls side by side."""
        p, n = at.parameters[0], len(at.inputs)
        offsets: dict[str, list[Any]] = {}
        for v in variables:
            h = self.steps[v.name]
            offsets[v.name] = [*self._offsets(v, h, p)]
            if v.name in self.rough:  # four about the values of the place, or further within the limits
                here = at.inputs[:, v.at] if v.is_input else p[v.at]
                offsets[v.name] = [self._inward(v, here, 3 * h) - here + k * h for k in _FAN]
        answers = iter(self.caller.ask([_varied(v, at.inputs, p, s) for v in variables for s in offsets[v.name]]))
        for v in variables:
            h, off = self.steps[v.name], offsets[v.name]
            around = [next(answers) for _ in off]
            if not np.isfinite(around).all():
                bad = off[next(k for k, one in enumerate(around) if not np.isfinite(one).all())]
                far = f"{np.max(np.abs(bad)):.3g} off what was read" if v.is_input else f"{p[v.at] + bad:.6g}"
                raise DataError(f"the simulator gives no finite number where {v.name} is {far}; state narrower bounds")
            if v.name in self.rough:
                x = np.stack([np.zeros(n), *(np.broadcast_to(one, n) for one in off)], axis=-1) / h
                fit = np.linalg.pinv(x[..., None] ** np.arange(4))[:, 1:3]  # (n, 2, 5)
                terms = fit @ np.stack([at.values, *around], axis=1) / np.array([h, h * h])[:, None]
                own = np.maximum(self.noise, self.rough[v.name])
                noise = np.linalg.norm(fit, axis=-1)[..., None] * own / np.array([h, h * h])[:, None]
                slope, bend = terms[:, 0], terms[:, 1]
                chance = (2 + 8 * math.sqrt(2 / n)) * np.mean(noise[:, 0] ** 2, axis=0)
                slope, least = np.where(np.mean(slope**2, axis=0) > chance, slope, 0.0), 3 * noise[:, 1]
            else:
                (one, two), (first, second) = around, off
                if first * second < 0:
                    slope, bend = (one - two) / (2 * first), (one - 2 * at.values + two) / (2 * h * h)
                else:
                    slope = (4 * one - two - 3 * at.values) / (2 * first)
                    bend = (two - 2 * one + at.values) / (2 * h * h)
                least = 2 * self.noise / (h * h)
            bend = np.where(np.abs(bend) > least, bend, 0.0)
            self.slopes[v.name], self.curves[v.name] = slope, bend
            self.reaches[v.name] = np.sqrt(np.sqrt(np.mean(bend**2, axis=0)))
        if self.independent and (jumps := [v for v in variables if v.name not in self.rough and self._jumps(v)]):
            self._differentiate(jumps, at)

    def _jumps(self, v: Variable) -> bool:
        """Return whether an output is rough along a variable, told by rows that bend as no smooth one does; note it."""
        bend = np.abs(self.curves[v.name]) * v.width**2 / self.scale
        slope = np.abs(self.slopes[v.name]) * v.width / self.scale
        if not np.linalg.norm(bend) > 1 + _BENT * np.linalg.norm(slope):
            return False
        step = self._step(v, np.sort(np.argsort(bend.max(axis=1))[-FEW:]), True)
        if v.name in self.rough:
            self.steps = {**self.steps, v.name: step}
        return v.name in self.rough

    def _offsets(self, v: Variable, h: float, p: Array) -> tuple[float, float]:
        """Return the two offsets of a difference: to both sides, or to one where a limit is nearer than the step."""
        if v.is_input or (p[v.at] - h >= v.lower and p[v.at] + h <= v.upper):
            return h, -h
        return (h, 2 * h) if p[v.at] - h < v.lower else (-h, -2 * h)

    def _inward(self, v: Variable, values: Any, reach: float) -> Any:
        """Return values that are at least `reach` within the limits of a variable, of an input within its range."""
        column = self.inputs[:, v.at] if v.is_input else np.array([v.lower, v.upper])
        lower, upper = float(column.min()) + reach, float(column.max()) - reach
        return np.clip(values, lower, upper) if lower <= upper else values

    def _own_noise(self, rows: NDArray[np.intp]) -> Array:
        """Return the standard deviation of the simulator's own noise in each output, (m,)."""
        here, own = self.inputs[rows], [v for v in self.variables if not v.is_input]
        inward = [self.parameters[v.at] + _LONGEST * v.width <= v.upper for v in own]  # within its limits
        width = np.array([v.width if up else -v.width for v, up in zip(own, inward)])
        questions = [(here, self.parameters + _NEAR * k * width) for k in range(_TABLE)]
        if not len(width):
            [u] = [v for v in self.variables if v.is_input][:1]
            questions = [_varied(u, here, self.parameters, _NEAR * k * u.width) for k in range(_TABLE)]
        table = np.stack(self.caller.ask(questions))
        if not np.isfinite(table).all():
            raise DataError("the simulator gives no finite number right beside the nominal parameters; state others")
        found, sign = [], []
        gamma = 1.0
        for k in range(1, _TABLE - 1):
            table = np.diff(table, axis=0)
            gamma *= k / (2 * (2 * k - 1))
            found.append(np.sqrt(np.mean(gamma * table**2, axis=(0, 1))))
            sign.append(np.any(np.diff(np.sign(table), axis=0) != 0, axis=(0, 1)))
        levels, signs = np.stack(found), np.stack(sign)
        noise = levels[-1].copy()
        for j in range(levels.shape[1]):  # the first three columns that agree within a factor of 4, and change signs
            for k in range(len(levels) - 2):
                three = levels[k : k + 3, j]
                if three.min() > 0 and three.max() <= 4 * three.min() and signs[k, j]:
                    noise[j] = levels[k, j]
                    break
        return np.asarray(noise)

    def _levels(self, variables: Sequence[Variable], rows: NDArray[np.intp]) -> tuple[Array, Array]:
        """Return third differences along these variables together, as a noise, (steps, m), and how rough it is."""
        radii, m = _RADII[: None if self.independent else 4], len(self.scale)
        asked = []
        for radius in np.outer(radii, [1, -1]).ravel():
            inputs, p = self.inputs[rows], self.parameters
            for v in variables:
                here = inputs[:, v.at] if v.is_input else p[v.at]
                middle = self._inward(v, here, radii[0] * v.width)
                inputs, p = _varied(v, inputs, p, middle - here + radius * v.width)
            asked.append((inputs, p))
        each = np.array([p for _, p in asked])
        same = bool((each == each[0]).all())
        try:
            if self.independent and (same or self.takes_rows):  # all in one call
                each = each[0] if same else np.repeat(each, [len(u) for u, _ in asked], axis=0)
                [whole] = self.caller.ask([(np.concatenate([u for u, _ in asked]), each)])
                answers = np.stack(np.split(whole, len(asked)))
            else:
                answers = np.stack(self.caller.ask(asked))
        except DataError:  # whatever a simulator does where it is not at home
            return np.zeros((len(radii) - 1, m)), np.zeros(m)
        odd = answers[::2] - answers[1::2]
        levels = np.sqrt(np.mean((odd[:-1] - 3 * odd[1:]) ** 2, axis=1) / 20)
        most = self._spread()
        stays = (levels[1:] * _FALL > levels[:-1]) & (levels[1:] < most) & (levels[1:] > 30 * self.noise)
        first = levels[1 + np.argmax(stays, axis=0), np.arange(m)]
        known = np.where(self.noise > _LOUD * most, self.noise, 0.0)
        found = np.maximum(known, np.where(stays.any(axis=0), first, 0.0))
        return levels, found * np.isfinite(levels).all()

    def _spread(self) -> Array:
        """Return the noise of the readings, or where nobody states it a twentieth of an output's range, (m,)."""
        return np.where(np.isfinite(self.scale), self.scale, 0.05 * np.ptp(self.places[0].values, axis=0))

    def _step(self, v: Variable, rows: NDArray[np.intp], rough: bool) -> float:
        """Return the step of the central difference in one variable, or of the fan where an output is `rough` there."""
        if rough:
            levels, found = self._levels([v], rows)
            if found.any():
                self.rough[v.name] = found
                curved = np.max(levels / np.maximum(found, _TRUST * self._spread()), axis=1) > _RATIO[1]
                return float(_RADII[min(1 + int(np.sum(curved)), len(curved))] * v.width)
        longest = _LONGEST * v.width
        size = np.max(np.abs(self.places[0].values), axis=0)
        first = float(np.max(np.cbrt(self.noise / np.maximum(size, 1e-300)))) * v.width
        h, low, high = min(first, longest), 0.0, math.inf
        here = self.inputs[rows]
        for _ in range(_ROUNDS):
            places = (3, 1, -1, -3)
            at = self.parameters[v.at] if not v.is_input else 0.0  # an input has no limits
            if not (at - 3 * h >= v.lower and at + 3 * h <= v.upper):
                sign = 1 if at - 3 * h < v.lower else -1
                places = (3 * sign, 2 * sign, sign, 0)
            a, b, c, d = self.caller.ask([_varied(v, here, self.parameters, k * h) for k in places])
            third = np.sqrt(np.mean((a - 3 * b + 3 * c - d) ** 2, axis=0))
            ratio = float(np.max(third / (math.sqrt(20.0) * self.noise)))
            if not math.isfinite(ratio) or ratio > _RATIO[1]:
                high = h
            elif ratio < _RATIO[0]:
                if h >= longest:
                    break
                low = h
            else:
                break
            h = min(4 * h if math.isinf(high) else math.sqrt(low * high) if low > 0 else high / 4, longest)
        return h


def _varied(v: Variable, inputs: Array, parameters: Array, change: float | Array) -> tuple[Array, Array]:
    if v.is_input:
        moved = inputs.copy()
        moved[:, v.at] += change
        return moved, parameters
    p = np.array(parameters, dtype=float)
    p[..., v.at] += change
    return inputs, p
