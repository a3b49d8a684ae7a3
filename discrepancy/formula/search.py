"""The search for a formula: orthogonal forward selection over the grammar, on scores projected off calibration.

Each product of shapes is a column that a score test judges at once (Billings' FROLS with calibration as its first
terms). Numbers inside a shape are scanned, then refined; of very many rows a part is scanned, and all are fitted. Of
several formulas the one of least description is kept: twice the log-likelihood, less log N for each number, less twice
the log of the count of formulas as long. A first term must beat the best of all columns on drawn noise. A formula is
added to the model only where it predicts left-out poses, and left-out blocks of the run, better than smooth functions
do; beside it these may take what it leaves.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations
from math import nan
from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from calibench.discrepancy.diagnostics.score import ProjectedScores, family_wise, projected_scores, signatures
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm, products
from calibench.discrepancy.effects.general.columns import measured_columns
from calibench.discrepancy.fitting.fit import Fit, fit, orthonormal, predicted, reading_order, thinned
from calibench.discrepancy.fitting.journal import kept_step
from calibench.discrepancy.formula import grammar
from calibench.discrepancy.formula.grammar import Atom, FormulaEffect, Run, Term
from calibench.discrepancy.labels import quantity_of
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import columns_of, inputs_of, is_clock, roles_of
from calibench.discrepancy.noise.whiten import Noise
from calibench.discrepancy.report import Amplitude, Coefficient, Formula, FormulaRival
from calibench.discrepancy.search.smoother import fit_smooth, left_out
from calibench.discrepancy.thresholds import thresholds
from calibench.discrepancy.validation import folds
from calibench.problems.base import Array

_LONGEST = 3  # terms
_PARTS = 4  # of the poses: one is kept from both searches
_SURE = 2.0  # standard errors, over its readings, by which a formula must predict it better
_LEVEL = 0.003  # probability of any first term on noise
_KEPT = (1, 3, 1)  # formulas that are followed at each length
_TRIED = (7, 4, 4)  # best columns, or pairs of them, that are refined, at each length
_SEEN = 0.03  # part of a column's length that calibration must leave
_WITHIN = 6.0  # of description, twice the log-likelihood: rivals of the formula that is told
_FURTHER = 12.0  # gain of a further term
_RIVALS = 6
_MANY = 16  # columns: of more, one of a product must be the part's own
_DRAWN, _DRAWN_ROWS = 100, 1500
_HARMONICS = (1.0, 2.0, 3.0)
_WAVES = np.arange(0.5, 8.01, 0.5)  # a turn, or over the run
_SPANS = np.geomspace(0.03, 3.0, 9)  # of the range of a column: widths and times that are scanned
_WIDTHS = np.geomspace(0.02, 0.7, 9)
_WHOLE = 0.06  # of a turn: a number of waves this near to a whole one is tried as that
_ALIKE = 0.99999  # correlation of two columns of which one is enough
_SAME_WAY = 0.99  # of the sign of a column and a column of ways, as a file's -1, 0 and 1
_OUTSIDE = 3.0  # of description, that an error of an instrument costs where one of a joint says the same
_NUMBERS = 4_000_000  # held at once
_LONG = 20_000  # rows of a run, of more of which no shape with a memory is tried


# a column as the grammar sees it: atoms that enter products, and all that are tried in its place
_Column = tuple[tuple[Atom, ...], tuple[Atom, ...]]


@final
@dataclass(frozen=True, eq=False)
class _Found:
    """A formula with the orthonormal columns of its terms, what it explains of the scores, and its description."""

    terms: tuple[Term, ...]
    T: float
    worth: float
    p: float = 0.0

    @property
    def structure(self) -> tuple[object, ...]:
        return tuple(sorted(term.structure for term in self.terms))


def with_formula(
    ground: Fit, smooth: Fit, free: Sequence[SmoothTerm], whole: Formulation, seed: int
) -> tuple[Fit, Formula | None]:
    """Return the fit with a formula, alone or with smooth functions of what it leaves, and the formula as it is told.

    `ground` has the names that stand and no smooth functions; `smooth` is what is kept where no formula is better.
    `whole` has the held-out rows too.
    """
    formulation = ground.model.formulation
    if len(ground.r) - len(ground.x) < 12 or not np.all(np.isfinite(ground.r)) or ground.exact:
        return smooth, None
    found = _answer_of(ground, whole, seed)
    if found is None:
        return smooth, None
    at, best, rivals, units, search = found
    beside = fit_smooth(at, tuple(free))
    # whole poses, and fifths of the run
    count = thresholds().folds
    order = np.argsort(np.argsort(reading_order(formulation.data), kind="stable"), kind="stable")
    fifths: Array = np.asarray(order * count // max(len(order), 1))
    blocks = (folds(formulation.data, count), fifths)
    tried = (smooth, at, beside) if beside is not at else (smooth, at)
    errors = [[float(np.sum(left_out(one, fold) ** 2)) for fold in blocks] for one in tried]
    old, better = errors[0], []
    for one, new in zip(tried[1:], errors[1:]):
        if new[0] <= old[0] and sum(new) < sum(old):
            better.append(one)
    sure = partial(_predicts, ground, best, whole, free, seed)
    if not better or not kept_step(sure, ("predicts", ground.x, ground.r)):
        return smooth, None
    final = better[0]
    if len(better) == 2:  # smooth functions of the rest stay where they add more than chance
        gained = min(a - b for a, b in zip(errors[1], errors[2]))
        final = beside if gained > 2 * np.log(len(ground.r)) else at
    return final, _told(final, ground, best, rivals, units, search)


def _of_one(square: Array, absorbed: Array, across: Array) -> tuple[Array, NDArray[np.int_]]:
    """Return T along scores, (m, t), and the rank of m columns of length `square`, less what calibration absorbs."""
    left = square - absorbed
    seen = left > _SEEN**2 * np.maximum(square, 1e-300)
    inverse = np.where(seen, 1 / np.where(seen, left, 1.0), 0.0)
    return np.asarray(across**2 * inverse[:, None]), seen.astype(int)


def _of_several(gram: Array, left: Array, across: Array) -> tuple[Array, NDArray[np.int_]]:
    """Return T along scores, (m, t), and the rank of m sets of k columns, of products `gram`, `left` by calibration."""
    size = np.sqrt(np.maximum(np.einsum("mii->mi", gram), 1e-300))
    values, vectors = np.linalg.eigh(left / size[:, :, None] / size[:, None, :])
    kept = values > _SEEN**2
    z = vectors.transpose(0, 2, 1) @ (across / size[:, :, None])
    each = (z**2 * np.where(kept, 1 / np.where(kept, values, 1.0), 0.0)[:, :, None]).sum(axis=1)
    return each, kept.sum(axis=1)


def _together(found: Sequence[tuple[Array, NDArray[np.int_]]], extra: Array | None) -> tuple[Array, Array, Array]:
    """Return T of blocks of columns, (m, 1 + d) each, with their ranks, as `scan` returns them."""
    most = np.zeros(0 if extra is None else extra.shape[1])
    for each in (each for each, _ in found if extra is not None and len(each)):
        most = np.maximum(most, each[:, 1:].max(axis=0))
    T, ranks = [each[:, 0] for each, _ in found], [rank for _, rank in found]
    return np.concatenate([np.zeros(0), *T]), np.concatenate([np.zeros(0, dtype=int), *ranks]), most


_Answer = tuple[Fit, "_Found", tuple["_Found", ...], tuple[str, ...], "_Search"]


def _answer_of(ground: Fit, whole: Formulation, seed: int, again: bool = True) -> _Answer | None:
    """Return the fit with the best formula, it and its rivals, the units of its sizes, and the search; or None.

    `again`: it is searched once more about the machine with the first answer where this is far from the one without.
    """
    search, about = _Search(thinned(ground), whole), ground
    while True:
        found = kept_step(partial(search.best, np.random.default_rng(seed)), ("formula", about.x, about.r))
        search.forget()
        if found is None:
            return None
        best, rivals = found
        units = tuple(unit for term in best.terms for unit in (term.unit_of(search.unit(term.quantity)),) * term.sizes)
        # the fit with the formula, the numbers that have a derivative, and are no whole number of turns, fitted too
        # where that leads to a minimum
        numbers = tuple(
            (i, j)
            for i, term in enumerate(best.terms)
            for j, atom in enumerate(term.atoms)
            if atom.shape in grammar.SMOOTH_NUMBERS and not (atom.unit == "rad" and atom.number == round(atom.number))
        )
        at: Fit | None = None
        for free in dict.fromkeys((numbers, ())):
            effect = FormulaEffect(best.terms, search.run, units, free)
            x = np.concatenate([about.x, np.zeros(len(effect.coefficients))])
            held = FormulaEffect(best.terms, search.run, units)
            first = fit(ground.model.with_effects(held), ground.noise, x[: len(x) - len(free)])
            x[: len(first.x)] = first.x
            trial = fit(ground.model.with_effects(effect), ground.noise, x) if free else first
            if np.isfinite(trial.cost) and trial.cost <= min(first.cost * (1 + 1e-6), ground.cost):
                at = trial
                break
        if at is None:
            return None
        # a large error bends the fit without it: slopes are taken again where the formula brought the machine
        part = len(search.fit.r) / len(ground.r)
        gained = part * ground.noise.gained(ground.cost, at.cost, at.degrees)
        if not again or abs(gained - search.first.gain(best.T, 1)) < _WITHIN:
            return at, best, rivals, units, search
        again, p, k = False, len(ground.x), len(ground.x) + len(units)
        without = []  # the formula, to first order
        for one in (at, thinned(at)):
            model = Model(one.model.formulation, one.model.effects[:-1])
            r = one.r - one.J[:, p:k] @ one.x[p:k]
            without.append(replace(one, model=model, x=one.x[:p], r=r, J=one.J[:, :p]))
        about, search = without[0], _Search(without[1], whole)


def _predicts(ground: Fit, best: _Found, whole: Formulation, free: Sequence[SmoothTerm], seed: int) -> bool:
    """Return whether a formula searched for on three of four poses predicts the others better than smooth functions.

    Both are found anew, as what was chosen on all rows has seen the rows left out; surely better, unless it is of the
    structure of the `best` of all rows.
    """
    formulation, noise = ground.model.formulation, ground.noise
    out = folds(formulation.data, _PARTS) == _PARTS - 1
    if not out.any():
        return True
    plain = Noise(noise.scale, noise.autocorrelation, noise.t_degrees, profiled=noise.profiled)
    part = fit(Model(formulation.on(formulation.data.rows(~out)), ground.model.effects), plain, ground.x)
    rest, found = formulation.data.rows(out), _answer_of(part, whole, seed, again=False)
    if found is None:
        return False
    sure = 0.0 if found[1].structure == best.structure else _SURE  # one that is found twice is hardly chance

    def errors(one: Fit) -> Array:
        return np.asarray((noise.scores(predicted(one.model, one.x, rest, Noise())) ** 2).sum(axis=1))

    smooth = errors(fit_smooth(part, tuple(free)))

    def better(one: Fit) -> bool:
        gained = smooth - errors(one)
        return float(gained.sum()) > sure * float(np.sqrt(np.sum(gained**2)))

    return better(found[0]) or better(fit_smooth(found[0], tuple(free)))


def _told(
    final: Fit, ground: Fit, best: _Found, rivals: Sequence[_Found], units: tuple[str, ...], search: "_Search"
) -> Formula:
    effect = next(e for e in final.model.effects if isinstance(e, FormulaEffect))
    place = final.model.place_of(effect)
    c, sd = final.x[place], np.sqrt(np.maximum(np.diag(final.covariance())[place], 0.0))
    terms, k, reach = effect.at(c), len(units), final.reach
    sizes = tuple(
        Coefficient(name, float(value), unit, float(spread))
        for name, value, unit, spread in zip(effect.coefficients[:k], c, units, sd)
    )
    numbers = []
    for (i, j), part, spread in zip(effect.free, c[k:], sd[k:]):
        start, atom = effect.terms[i].atoms[j], terms[i].atoms[j]
        waves = atom.shape in ("sin", "cos", "wave")
        if waves and atom.unit != "rad":
            value, unit = 2 * np.pi / atom.number, atom.unit
            numbers.append(Coefficient(f"period over {atom.column}", value, unit, value * spread / (1 + part)))
        else:
            unit = "1" if waves else "s" if atom.shape == "lag" else atom.unit
            name = f"waves a turn of {atom.column}" if waves else f"number of {atom.text()}"
            numbers.append(Coefficient(name, atom.number, unit, float(start.number * spread)))
    y = search.first
    excess = y.total - y.degrees
    share = float(np.clip((best.T - k) / excess, 0.0, 1.0)) if excess > 0 else nan
    changed = effect.shift(final.at.recorded, final.model.formulation.data, c)
    reachable = {name: float(np.max(np.abs(change))) for name, change in changed.items()}
    return Formula(
        text=grammar.formula_text(terms), sizes=sizes, numbers=tuple(numbers),
        intervals=tuple(
            Amplitude(s.value, s.unit, (s.value - reach * s.sd, s.value + reach * s.sd)) for s in (*sizes, *numbers)
        ),
        largest=tuple(Amplitude(v, search.unit(n)) for n, v in reachable.items()),
        changes=tuple(reachable), share=share, smooth_beside=final.model.effects[-1] is not effect,
        over_time=any(is_clock(u, final.model.formulation) for u in effect.columns),
        rivals=tuple(FormulaRival(grammar.formula_text(r.terms), best.worth - r.worth) for r in rivals),
        structure=tuple(
            (t.quantity, *(f"{a.shape} {a.column}" for a in sorted(t.atoms, key=lambda a: a.column))) for t in terms
        ),
        code=grammar.class_of(terms, units, search.machine),
    )  # fmt: skip


@final
class _Search:
    """The grammar over one fit: which quantities may err over which columns, and score tests of any of its terms."""

    def __init__(self, about: Fit, whole: Formulation) -> None:
        self.fit, self.first = about, projected_scores(about)
        self.machine, self.formulation = whole.data.machine, about.model.formulation
        self.run = Run.of(whole)
        at, rows = about.at, about.at.misclosure
        self.q, self.data = at.recorded, at.model.formulation.data
        self.apart = self.formulation.decorrelate(rows) is rows and at.whiten.band is None
        self.columns: dict[str, _Column] = {}
        read: dict[str, Array] = {}
        roles, data = roles_of(self.formulation), self.formulation.data
        names = [*(j.reading for j in roles.joints), *columns_of(roles)]
        names += [name for one in self.formulation.covariates(at.recorded).values() for name in one]
        known = {*self.run.columns, *self.formulation.readings}
        names = [n for n in dict.fromkeys(names) if n in data and (n in known or data[n].dtype.kind in "iuf")]
        for name in names:
            if (column := self._column(name)) is None:
                continue
            # no two columns that say the same: a temperature in two units, an angle and where it leads
            u = self.run.read(name, self.q, self.data)
            if not any(abs(np.corrcoef(u, v)[0, 1]) > _ALIKE for v in read.values()):
                self.columns[name], read[name] = column, u
        # no sign of a velocity beside a direction that was recorded
        ways = [u for u in read.values() if len(np.unique(u)) <= 3]
        for name, (some, every) in self.columns.items():
            signs = np.sign(read[name])
            if np.ptp(signs) and any(abs(np.corrcoef(signs, way)[0, 1]) > _SAME_WAY for way in ways):
                bare, all_bare = (tuple(a for a in atoms if a.shape != "sign") for atoms in (some, every))
                self.columns[name] = bare, all_bare
        # the quantities that may err, with the columns that are a part's own
        parts: dict[str, list[str]] = {}
        for joint in roles.joints:
            parts[joint.reading] = [joint.reading, joint.direction, joint.velocity, joint.torque, joint.temperature]
        for sensor in self.formulation.sensors:
            parts.setdefault(sensor.column, [*parts, *roles.columns])
        for length in roles.lengths:
            parts[length.quantity] = [length.force, length.temperature]
        self.parts = {
            name: tuple(n for n in dict.fromkeys((*own, roles.time, roles.temperature)) if n in self.columns)
            for name, own in parts.items()
            if name in at.slopes and np.any(at.slopes[name])
        }
        joints = {joint.reading for joint in roles.joints}
        self.factor = dict.fromkeys(measured_columns(self.formulation), -1.0)
        self.outside = {s.column for s in self.formulation.sensors} - joints if joints else set()
        self.values: dict[Atom, Array] = {}
        tried = [a for _, every in self.columns.values() for a in every]
        self.waves = [(a,) for a in tried if a.shape == "wave"]
        self.products, self.own = self._products([a for a in tried if a.shape != "wave"])
        atoms = list(dict.fromkeys(a for product in self.products for a in product))
        place = {atom: k + 1 for k, atom in enumerate(atoms)}
        self.atoms = atoms
        # of each product, the rows of the table that it multiplies, (m, 2)
        self.factors = np.array([[place[a] for a in p] + [0] * (2 - len(p)) for p in self.products]).reshape(-1, 2)
        self.held = np.empty((0, 0))
        self.weights: dict[str, tuple[Array, Array | None]] = {}
        self.by_row: tuple[ProjectedScores, Array | None, Array] | None = None
        self.pulls: dict[str, tuple[ProjectedScores, Array]] = {}
        self.lengths: dict[tuple[str, int, int], tuple[Array, Array]] = {}
        single = len(tried) * len(self.own)
        pairs = sum(len(own) for own in self.own.values()) - (len(tried) - len(self.waves)) * len(self.own)
        self.count = [max(1, single), max(1, pairs)]

    # what there is

    def unit(self, name: str) -> str:
        roles = roles_of(self.formulation)
        joint = next((j for j in roles.joints if j.reading == name), None)
        sensor = next((s for s in self.formulation.sensors if s.column == name), None)
        known = quantity_of(self.machine, name).unit or self.data.units.get(name, "")
        if stated := (joint.unit if joint else "") or (sensor.unit if sensor else "") or known:
            return stated
        # by what the roles make of the column; the first of them counts
        warm = (roles.temperature, *(j.temperature for j in roles.joints), *(one.temperature for one in roles.lengths))
        by_role = dict.fromkeys(warm, "K") | ({"t_s": "s"} if roles.time == "t_s" else {})
        by_role |= dict.fromkeys((one.force for one in roles.lengths), "N")
        for j in reversed(roles.joints):
            by_role |= {j.torque: "N mm" if j.kind == "rotary" else "N", j.velocity: f"{j.unit}/s"}
        return by_role.get(name, "")

    def _column(self, name: str) -> _Column | None:
        whole = self.run.columns.get(name)
        u = np.asarray(self.q[name] if name in self.q else self.data[name], dtype=float).real
        if u.ndim != 1 or not np.all(np.isfinite(u)) or not np.ptp(u) > 1e-9 * np.max(np.abs(u)):
            return None
        levels, low, high = len(np.unique(u)), float(u.min()), float(u.max())
        unit, roles = self.unit(name), roles_of(self.formulation)
        span, origin = high - low, 0.0
        if name == roles.time:
            origin = float(whole.min()) if whole is not None else low

        def of(shape: str, numbers: Iterable[float] = (nan,)) -> list[Atom]:
            return [Atom(name, shape, float(k), origin, unit) for k in numbers]

        if levels == 2:
            return tuple(of("u")), tuple(of("u"))
        if levels <= 4:
            signed = of("abs") + of("sign") if low < 0 < high else []
            return (*of("u"), *of("square")), (*of("u"), *of("square"), *signed)
        memory = whole is not None and len(self.run.places) <= _LONG
        widths = _WIDTHS * span / 2
        operators = of("play", widths) + of("slip", widths) if memory else []
        powers = of("u") + of("square") + of("cube")
        rotary = any(j.reading == name and j.kind == "rotary" for j in roles.joints) or (unit == "rad" and span > 0.5)
        if name == roles.time:
            waves = of("wave", 2 * np.pi * np.arange(1.0, 12.1, 0.5) / span)
            every = (*of("u"), *of("square"), *of("exp", span * _SPANS), *waves)
            return (*of("u"), *of("exp", span * np.array([0.1, 0.4]))), every
        if rotary:
            first = of("u") + of("sin", _HARMONICS) + of("cos", _HARMONICS)
            sensor = np.max(np.asarray(self.formulation.sigma.get(name, 0.0)))
            moved = of("side", (max(6 * float(sensor), 1e-6 * span),)) if memory else []
            waves = of("sin", _WAVES) + of("cos", _WAVES) + of("wave", _WAVES)
            return tuple(first + moved), tuple(powers + waves + operators + moved)
        if low < 0 < high:
            number = (*of("tanh", widths), *of("dead", widths), *of("fall", widths))
            plain = of("u") + of("abs") + of("sign") + of("signed square")
            return (*plain, *of("square")), (*plain, *powers[1:], *of("root"), *number, *operators)
        delayed = []
        if memory and self.run.clock:
            delayed = of("lag", (float(np.ptp(self.run.columns[self.run.clock])) or 1.0) * _SPANS)
        waves = of("wave", 2 * np.pi * np.arange(1.0, 6.1, 0.5) / span) if name in inputs_of(self.formulation) else []
        saturated = of("tanh", widths)
        return tuple(powers[:2]), (*powers, *of("root"), *saturated, *delayed, *operators, *waves)

    def _products(self, single: Sequence[Atom]) -> tuple[list[tuple[Atom, ...]], dict[str, Array]]:
        """Return the shapes of one size and the products of two, and which of them are tried for each part at once."""
        products: list[tuple[Atom, ...]] = [(atom,) for atom in single]
        own: dict[str, list[int]] = {name: list(range(len(products))) for name in self.parts if single or self.waves}
        for (one, (first, _)), (other, (second, _)) in combinations(self.columns.items(), 2):
            pairs = [(a, b) for a in first for b in second]
            for name, places in own.items():
                if len(self.columns) <= _MANY or {one, other} & {*self.parts[name]}:
                    places += range(len(products), len(products) + len(pairs))
            products += pairs
        return products, {name: np.array(places, dtype=int) for name, places in own.items()}

    @cached_property
    def table(self) -> Array:
        """Return the values of the atoms of products, (1 + m, n), the first row of ones."""
        return np.stack([np.ones(len(self.data)), *(self.value(a)[:, 0] for a in self.atoms)], axis=0)

    @cached_property
    def wave_values(self) -> Array:
        return np.concatenate([np.empty((len(self.data), 0)), *(self.value(a) for (a,) in self.waves)], axis=1)

    def value(self, atom: Atom) -> Array:
        if atom not in self.values:
            self.values[atom] = atom.values(self.q, self.data, self.run)
        return self.values[atom]

    # score tests

    def _weights(self, quantity: str) -> tuple[Array, Array | None]:
        """Return what a change in each row adds to the scores of `_pull`, (n, c), and its square, (n,).

        There is no square where the noise of rows hangs together: the length of a column is then that of its signature.
        """
        if quantity not in self.weights:
            slope = self.fit.at.slopes[quantity]
            white = self.fit.at.whiten(slope).reshape(slope.shape) if self.apart else slope
            self.weights[quantity] = white, np.einsum("nc,nc->n", white, white) if self.apart else None
        return self.weights[quantity]

    def scan(
        self, on: ProjectedScores, quantity: str, blocks: Iterable[tuple[Array, int]], extra: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Return T, rank and, of `extra` scores (N, d), the largest T, of columns (n, m) that go k by k together."""
        p, pull = on.Q.shape[1], self._pull(quantity, on, extra)
        found = []
        for V, k in blocks:
            across, gram = V.T @ pull, self._grams(quantity, V, k)
            if k == 1:
                found.append(_of_one(gram[:, 0, 0], (across[:, :p] ** 2).sum(axis=1), across[:, p:]))
                continue
            A = across.reshape(len(gram), k, -1)
            found.append(_of_several(gram, gram - A[:, :, :p] @ A[:, :, :p].transpose(0, 2, 1), A[:, :, p:]))
        return _together(found, extra)

    def _grams(self, quantity: str, V: Array, k: int) -> Array:
        """Return the products of whitened columns, of changes V (n, m), k by k with each other, (m / k, k, k)."""
        square = self._weights(quantity)[1]
        if square is None:
            D = signatures(self.fit, {quantity: V})
            d = D.reshape(len(D), -1, k).transpose(1, 2, 0)
            return np.asarray(d @ d.transpose(0, 2, 1))
        if k == 1:
            return np.asarray(square @ V**2)[:, None, None]
        v = V.reshape(len(V), -1, k).transpose(1, 2, 0)
        return np.asarray((v * square) @ v.transpose(0, 2, 1))

    def _pull(self, quantity: str, on: ProjectedScores, extra: Array | None) -> Array:
        """Return what each row adds to products with Q and y, and `extra` scores, (n, t); that of Q and y is kept."""
        last, t = self.pulls.get(quantity), on.Q.shape[1] + 1
        if extra is None and last is not None and last[0] is on:
            return last[1]
        # Q and y, and `extra` scores, as products with them are taken row by row, (n, c, t)
        kept = self.by_row
        if kept is None or kept[0] is not on or kept[1] is not extra:
            targets = np.column_stack([on.Q, on.y, *([extra] if extra is not None else [])])
            rows = targets.reshape(*self.fit.at.misclosure.shape, -1)
            kept = on, extra, rows if self.apart else self.formulation.decorrelate(self.fit.at.whiten.back(rows))
            self.by_row = kept
        pull = np.einsum("nc,nct->nt", self._weights(quantity)[0], kept[2])
        self.pulls[quantity] = on, pull[:, :t]
        return np.asarray(pull)

    def everything(self, on: ProjectedScores, extra: Array | None = None) -> dict[str, tuple[Array, Array, Array]]:
        """Return for each quantity what `scan` does, of all its products and then its waves.

        One product of matrices serves all quantities. Lengths, and what calibration absorbs of them, are the same
        beside any terms and are computed once.
        """
        if not self.own:  # nothing that may err has a column of its own
            return {}
        p, more = self.first.Q.shape[1], on.Q.shape[1] - self.first.Q.shape[1]
        pulls = {name: self._pull(name, on, extra) for name in self.own}
        fresh = np.concatenate([pull[:, p:] for pull in pulls.values()], axis=1)
        found: dict[str, list[tuple[Array, NDArray[np.int_]]]] = {name: [] for name in pulls}
        block = max(1, _NUMBERS // max(fresh.shape))
        for start in range(0, len(self.products), block):
            V = self._values(start, block)
            across = (V @ fresh).reshape(len(V), len(pulls), -1)
            for j, (name, pull) in enumerate(pulls.items()):
                own = self.own[name]
                own = own[slice(*np.searchsorted(own, (start, start + len(V))))] - start
                if (key := (name, start, len(V))) not in self.lengths:
                    some = V[own]
                    size = self._grams(name, some.T, 1)[:, 0, 0]
                    self.lengths[key] = size, ((some @ pull[:, :p]) ** 2).sum(axis=1)
                size, absorbed = self.lengths[key]
                each = across[own, j]
                found[name].append(_of_one(size, absorbed + (each[:, :more] ** 2).sum(axis=1), each[:, more:]))
        for name, pull in pulls.items() if self.waves else ():
            W, key = self.wave_values, (name, 0, 0)
            if key not in self.lengths:
                A = (W.T @ pull[:, :p]).reshape(len(self.waves), 2, -1)
                gram = self._grams(name, W, 2)
                self.lengths[key] = gram, gram - A @ A.transpose(0, 2, 1)
            gram, left = self.lengths[key]
            A = (W.T @ pull[:, p:]).reshape(len(self.waves), 2, -1)
            left = left - A[:, :, :more] @ A[:, :, :more].transpose(0, 2, 1)
            found[name].append(_of_several(gram, left, A[:, :, more:]))
        return {name: _together(each, extra) for name, each in found.items()}

    def _values(self, start: int, block: int) -> Array:
        """Return the values of a block of products, (m, n); all of them are kept where they are one block."""
        if len(self.held):
            return self.held[start : start + block]
        first, second = self.factors[start : start + block].T
        V: Array = self.table[first] * self.table[second]
        self.held = V if len(V) == len(self.products) else self.held
        return V

    def _blocks_of(self, terms: Sequence[Term]) -> Iterable[tuple[Array, int]]:
        """Return the values of terms of one quantity, in blocks of one rank, in their order."""
        at, n = 0, len(self.data)
        while at < len(terms):
            k, end = terms[at].sizes, at
            while end < len(terms) and terms[end].sizes == k and (end - at) * k * n < _NUMBERS:
                end += 1
            values = np.empty((n, (end - at) * k), order="F")
            for j, term in enumerate(terms[at:end]):
                values[:, j * k : (j + 1) * k] = products(map(self.value, term.atoms))
            yield values, k
            at = end

    def forget(self) -> None:
        """Let go of what only a search needs: an answer is told long after it."""
        for kept in (self.values, self.weights, self.pulls, self.lengths):
            kept.clear()
        vars(self).update(table=np.empty((0, 0)), wave_values=np.empty((0, 0)), held=np.empty((0, 0)), by_row=None)

    def worth(self, T: float, rank: int, terms: Sequence[Term], on: ProjectedScores) -> float:
        """Return the description that a formula saves: what it explains, less its numbers and its place in the list."""
        numbers = rank + sum(
            a.shape in grammar.SMOOTH_NUMBERS | {"play", "slip", "dead"}
            and not (a.unit == "rad" and a.shape in ("sin", "cos", "wave") and a.number == round(a.number))
            for term in terms for a in term.atoms
        )  # fmt: skip
        # its place in the list of all formulas as long
        paid = numbers * np.log(len(on.y)) + sum(2 * np.log(self.count[len(term.atoms) - 1]) for term in terms)
        paid += sum(_OUTSIDE for term in terms if term.quantity in self.outside)
        return self.gain(self.first, T, rank) - float(paid)

    def gain(self, on: ProjectedScores, T: float, rank: int) -> float:
        """Return twice the log-likelihood that T of the scores brings; the rest is noise, of variance 1 at least.

        By the stated noise alone a chance part of a large rest would be worth much.
        """
        if on.profiled:
            return on.gain(T, rank)

        costs = []
        for rest in (on.total, max(on.total - T, 0.0)):
            mean = rest / max(on.degrees, 1)
            costs.append(on.degrees * float(mean if mean <= 1 else 1 + np.log(mean)))
        return costs[0] - costs[1]

    def forward(
        self, on: ProjectedScores, before: tuple[Term, ...], rng: np.random.Generator | None
    ) -> tuple[list[_Found], float]:
        """Return the best formulas of one term more, each structure once, and p of the best against drawn noise."""
        scored: list[tuple[float, int, Term]] = []
        most_tried = _TRIED[min(len(before), len(_TRIED) - 1)]
        for quantity, (T, ranks, _) in self.everything(on).items():
            own = self.own[quantity]
            for k in np.argsort(-T)[: 3 * most_tried]:
                atoms = self.products[own[k]] if k < len(own) else self.waves[k - len(own)]
                scored += (
                    [(float(T[k]), int(ranks[k]), Term(quantity, atoms, self.factor.get(quantity, 1.0)))]
                    if ranks[k]
                    else []
                )
        scored.sort(key=lambda s: -self._step_worth(s[0], s[1], s[2], on))
        if not scored:
            return [], 1.0
        alone, tests = float(on.test(*scored[0][:2])), sum(self.count)
        p = family_wise(alone, np.empty(0), tests)
        if p > _LEVEL and rng is not None and len(on.y) <= _DRAWN_ROWS:
            drawn = rng.standard_normal((len(on.y), _DRAWN))
            drawn -= on.Q @ (on.Q.T @ drawn)
            most = np.max([most for _, _, most in self.everything(on, drawn).values()], axis=0)
            p = family_wise(alone, np.sort(on.test(most, 1)), tests)
        tried: dict[tuple[object, ...], Term] = {}
        shown: set[tuple[str, int]] = set()  # each quantity with its best single column and its best pair
        for _, _, term in scored:
            place, kind = (term.quantity, *sorted(a.column for a in term.atoms)), (term.quantity, len(term.atoms))
            first = kind not in shown and len(shown) < most_tried // 2
            if place not in tried and (first or len(tried) < most_tried):
                shown.add(kind)
                tried[place] = term
        done = [one for term in tried.values() for one in self._refined(on, term, before)]
        unique: dict[tuple[object, ...], _Found] = {}
        for one in sorted(done, key=lambda f: -f.worth):
            unique.setdefault(one.structure, one)
        return list(unique.values()), p

    def _step_worth(self, T: float, rank: int, term: Term, on: ProjectedScores) -> float:
        place = 2 * float(np.log(self.count[len(term.atoms) - 1]))
        return self.gain(on, T, rank) - rank * float(np.log(len(on.y))) - place

    def _refined(self, on: ProjectedScores, term: Term, before: tuple[Term, ...]) -> list[_Found]:
        """Return the best terms over the same columns, whatever their shapes, their numbers refined."""
        every = [self.columns[a.column][1] for a in term.atoms]
        places: list[Term] = []
        if len(every) == 1:
            places = [replace(term, atoms=(a,)) for a in every[0]]
        else:  # all shapes of one column beside the best of the other, in turn
            fixed = list(term.atoms)
            for _ in range(2):
                for k in range(2):
                    tries = [replace(term, atoms=(a, fixed[1]) if k == 0 else (fixed[0], a)) for a in every[k]]
                    tries = sorted((t for t in tries if t.sizes <= 2), key=lambda t: t.sizes)
                    T, ranks, _ = self.scan(on, term.quantity, self._blocks_of(tries))
                    worths = [self._step_worth(float(t), int(r), one, on) if r else -np.inf
                              for t, r, one in zip(T, ranks, tries)]  # fmt: skip
                    places += [tries[j] for j in np.argsort(worths)[-4:]]
                    fixed = list(tries[int(np.argmax(worths))].atoms)
        places = sorted(dict.fromkeys(places), key=lambda t: t.sizes)
        T, ranks, _ = self.scan(on, term.quantity, self._blocks_of(places))
        by_shape: dict[tuple[object, ...], tuple[float, Term]] = {}
        for t, r, one in zip(T, ranks, places):
            worth = self._step_worth(float(t), int(r), one, on) if r else -np.inf
            if worth > by_shape.get(one.structure, (-np.inf, one))[0]:
                by_shape[one.structure] = (worth, one)
        done = []
        for _, one in sorted(by_shape.values(), key=lambda pair: -pair[0])[:2]:
            terms = (*before, self._polished(on, one))
            ordered = tuple(t for name in dict.fromkeys(t.quantity for t in terms) for t in terms if t.quantity == name)
            beside, shown, rank = self._beside(ordered)
            done.append(_Found(ordered, shown, self.worth(shown, rank, ordered, beside)))
        return done

    def _polished(self, on: ProjectedScores, term: Term) -> Term:
        """Return the term with the numbers inside its shapes refined beside what is there."""
        moving = [k for k, a in enumerate(term.atoms) if np.isfinite(a.number) and a.shape != "side"]

        def explained(one: Term) -> float:
            kept, run = self.values, self.run
            value = products(kept[a] if a in kept else a.values(self.q, self.data, run) for a in one.atoms)
            T, ranks, _ = self.scan(on, one.quantity, [(value, value.shape[1])])
            return self.gain(on, float(T[0]), int(ranks[0]))

        if not moving or len(self.run.places) > _LONG:
            return term
        start = np.array([term.atoms[k].number for k in moving])

        def moved(x: Array) -> Term:
            return term.with_numbers({k: float(s * np.exp(v)) for k, s, v in zip(moving, start, x)})

        ended = minimize(
            lambda x: -explained(moved(np.clip(x, -0.7, 0.7))), np.zeros(len(moving)), method="Nelder-Mead",
            options={
                "maxfev": 14 * len(moving), "xatol": 1e-4, "fatol": 0.01,
                "initial_simplex": np.vstack([np.zeros(len(moving)), 0.08 * np.eye(len(moving))]),
            },
        )  # type: ignore[call-overload]  # fmt: skip
        best = moved(np.clip(ended.x, -0.7, 0.7))
        whole = {
            k: float(round(best.atoms[k].number))
            for k in moving
            if best.atoms[k].unit == "rad" and best.atoms[k].shape in ("sin", "cos", "wave")
            and abs(best.atoms[k].number - round(best.atoms[k].number)) < _WHOLE and round(best.atoms[k].number)
        }  # fmt: skip
        if whole:
            simple = best.with_numbers(whole)
            if explained(simple) >= -float(ended.fun) - len(whole) * np.log(len(on.y)):
                return simple
        return best

    def _beside(self, terms: Sequence[Term]) -> tuple[ProjectedScores, float, int]:
        """Return the scores projected off some terms as well, what these explain, and their rank."""
        first = self.first
        if not terms:
            return first, 0.0, 0
        each = ({term.quantity: products(map(self.value, term.atoms))} for term in terms)
        D = np.concatenate([signatures(self.fit, change) for change in each], axis=1)
        size = np.sqrt((D**2).sum(axis=0))
        left = D / np.where(size > 0, size, 1.0)
        for _ in range(2):
            left = left - first.Q @ (first.Q.T @ left)
        U = orthonormal(left, 1e-3) if left.size else left
        z = U.T @ first.y
        return replace(first, y=first.y - U @ z, Q=np.concatenate([first.Q, U], axis=1)), float(z @ z), U.shape[1]

    def best(self, rng: np.random.Generator) -> tuple[_Found, tuple[_Found, ...]] | None:
        """Return the formula of least description with its rivals; None where the best term may be chance."""
        level = [_Found((), 0.0, 0.0)]
        top: _Found | None = None
        seen: dict[tuple[object, ...], _Found] = {}
        for length in range(_LONGEST):
            grown: list[_Found] = []
            for one in level[: _KEPT[length]]:
                on = self._beside(one.terms)[0]
                if sum(t.sizes for t in one.terms) > len(grammar.LETTERS) - 2 or on.degrees < 8:
                    continue
                after, p = self.forward(on, one.terms, rng if not length else None)
                if p > _LEVEL:
                    continue
                grown += [a for a in after if a.worth > one.worth + (_FURTHER if one.terms else 0.0)]
            for a in grown:
                if a.structure not in seen or seen[a.structure].worth < a.worth:
                    seen[a.structure] = a
            level = sorted({id(a): a for a in grown}.values(), key=lambda f: -f.worth)
            if not level:
                break
            if top is None or level[0].worth > top.worth + _FURTHER:
                top = level[0]
            elif length:
                break
        if top is None:
            return None
        # exchange: each term is searched for again beside the others, which also finds its rivals
        for _ in range(2 if len(top.terms) > 1 else 0):
            changed = False
            for k in range(len(top.terms)):
                others = tuple(t for j, t in enumerate(top.terms) if j != k)
                for a in self.forward(self._beside(others)[0], others, None)[0]:
                    seen[a.structure] = max(seen.get(a.structure, a), a, key=lambda f: f.worth)
                    if a.worth > top.worth + 0.5:
                        top, changed = a, True
                if changed:
                    break
            if not changed:
                break
        near = [f for f in seen.values() if f.structure != top.structure and top.worth - f.worth < _WITHIN]
        near.sort(key=lambda f: -f.worth)
        return top, tuple(near[:_RIVALS])
