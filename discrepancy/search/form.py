"""The form of a named effect: on what its size depends that its formula does not have, and how far a formula is off.

After naming, the residuals are tested for each pick's own signature times a slow function of each covariate of its
part: the play of a worn gear is wider where the gear is worn. Where that is significant and large, the cause is "like"
that effect; the form stays in the model, so that no other name explains it.

Real causes differ from a catalogue's formulas by a tenth or so: by a factor 1 + m(x), m smooth. Calibration may absorb
nearly all but the term with m, which a rival may fit better; so rivals are compared by likelihood with a random m.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import final

import numpy as np

from calibench.discrepancy.diagnostics.score import columns, score_all, signatures
from calibench.discrepancy.diagnostics.smooth_term import SmoothTerm, curve
from calibench.discrepancy.fitting.fit import Fit, once, orthonormal, project_off
from calibench.discrepancy.labels import quantity_label
from calibench.discrepancy.model import effect as effects
from calibench.discrepancy.model.effect import Effect, Moment, name_of
from calibench.discrepancy.model.machine import Formulation, Quantities
from calibench.discrepancy.model.measured import MeasuredData
from calibench.discrepancy.model.roles import roles_of, words_of
from calibench.discrepancy.registries import description_of
from calibench.discrepancy.search.select import Option, Tests, close, delta_bic, option, spared
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

FORM_DIFFERS = "form differs"  # and nothing says with what
SLOW = 2  # functions of a covariate: a slope and a bend of the size
MOST = 2  # coefficients of a formula: with more of them it can already be any function of its argument
ALONG = 4  # functions of where a carriage stands: enough for one and a half waves of a screw or a guide
_ROUNDS = 10  # in which the sizes of effects settle, relative to which a prior is
_HALVINGS = 16
_WIDTHS = 1e-3, 10.0  # of a prior, between which it is halved
# sizes tried, times the fitted one: an error of the form may have moved the fitted size far off
_SIZES = (0.03, 0.1, 0.3, 1.0, 3.0)
# grids that close in on a maximum: how many, how much each is smaller, its steps of directions and of sizes
_CLOSER, _CLOSES_IN = 10, 0.5
_AROUND = np.arange(8) * np.pi / 8
_TURNS, _GRID = (-1.0, -0.5, 0.5, 1.0), np.linspace(-1.2, 1.2, 9)
_LENGTHS = (0.4, 0.8)  # part of an argument's range over which a random form keeps its size
_OFF = (0.3, 0.6, 1.0)  # parts of `form_off`: the sizes of a random form
_KNOTS = 48  # of a random curve
_PART = 1e-6  # part of the largest variance: parts of a random curve below this are left out
_LEVELS = 4  # of a column that has no slow function
_FULL = 1e-10
_PLACES = 200  # knots of a random field, at most twice as many
_PART_OF_FIELD = 1e-3  # part of the largest variance: parts of a random field below this are left out
_SETTLED = 6  # rounds in which the noise of a random form settles
_TINY = 1e-300
_SIGNS = 0.9  # mean product of two signs, from which on they are the same


@final
@dataclass(frozen=True, eq=False)
class Slow:
    """Slow functions of a covariate between `low` and `high`, less their `middle`, (m,): their mean.

    With `along` the covariate is a position at each of its moments. For an effect that is relative to home, home is
    zero, and `middle` is the value there. `unsigned` ones are functions of the covariate without its sign.
    """

    covariate: str
    column: str
    low: float
    high: float
    middle: tuple[float, ...]
    along: effects.Along | None = None
    unsigned: bool = False

    def acting(self, own: Mapping[str, Array], data: MeasuredData) -> Sequence[Moment]:
        if self.along is not None:
            return self.along(data)[self.covariate]
        return [Moment(name, name, np.asarray(data[self.column], dtype=float)) for name in own]

    def waves(self, values: Array) -> Array:
        at = np.abs(values) if self.unsigned else values
        waves = waves_over(at, self.low, self.high, len(self.middle)) - np.asarray(self.middle)
        waves[~np.isfinite(waves)] = 0.0  # rows that are not the target's
        return np.asarray(waves)


@final
@dataclass(frozen=True, eq=False)
class Modulated:
    """An `Effect`: another one, `of`, times slow functions of one or more covariates, with their own coefficients."""

    of: Effect
    over: tuple[Slow, ...]
    positions: int = 1
    twins: tuple[str, ...] = ()  # it is part of a finding, not a name
    acts_along: bool = field(init=False)  # whether the covariates are positions, or times, at which the effect acts
    family: str = field(init=False)
    target: str = field(init=False)
    formula: str = field(init=False)
    channel: str = field(init=False)
    columns: tuple[str, ...] = field(init=False)
    coefficients: tuple[str, ...] = field(init=False)
    units: tuple[str, ...] = field(init=False)
    unit: str = field(init=False)

    def __post_init__(self) -> None:
        of, by = self.of, ", ".join(slow.covariate for slow in self.over)
        numbers = [(slow.covariate, k) for slow in self.over for k in range(1, len(slow.middle) + 1)]
        vars(self).update(
            acts_along=all(slow.along is not None for slow in self.over), family=of.family,
            target=f"{of.target} by {by}", formula=f"({of.formula}) times a slow function of {by}",
            channel=of.channel, columns=(*of.columns, *(slow.column for slow in self.over if not slow.along)),
            coefficients=tuple(f"{c} by {covariate} {k}" for covariate, k in numbers for c in of.coefficients),
            units=of.units * len(numbers), unit=of.unit,
        )  # fmt: skip

    shift = effects.linear_shift
    amplitude = staticmethod(effects.size)

    def basis(self, q: Quantities, data: MeasuredData, c: Array) -> dict[str, Array]:
        own = self.of.basis(q, data, np.zeros(len(self.of.coefficients)))
        parts = [
            {one.quantity: product(slow.waves(one.at), own[one.of]) for one in slow.acting(own, data)}
            for slow in self.over
        ]
        if len(parts) == 1:
            return parts[0]
        widths = [len(slow.middle) * len(self.of.coefficients) for slow in self.over]
        starts = np.cumsum([0, *widths])
        whole: dict[str, Array] = {}
        for part, start, width in zip(parts, starts, widths, strict=False):
            for name, change in part.items():
                whole.setdefault(name, np.zeros((len(data), starts[-1])))[:, start : start + width] = change
        return whole

    def nearest(self, q: Quantities, data: MeasuredData) -> Array:
        """Return, for each coefficient of the form, the effect's own coefficients that fit it best, (k, m)."""
        own = self.of.basis(q, data, np.zeros(len(self.of.coefficients)))
        parts = []
        for slow in self.over:
            acting = slow.acting(own, data)
            scale = {one.of: float(np.linalg.norm(own[one.of])) or 1.0 for one in acting}
            plain = np.concatenate([np.asarray(own[one.of]) / scale[one.of] for one in acting])
            moved = [product(slow.waves(one.at), own[one.of]) / scale[one.of] for one in acting]
            parts.append(np.asarray(np.linalg.lstsq(plain, np.concatenate(moved), rcond=None)[0]))
        return np.concatenate(parts, axis=1)


def unlike(current: Fit, picks: Sequence[Effect], known: Sequence[Effect], terms: Sequence[SmoothTerm], tests: Tests,
           level: float) -> Option | None:  # fmt: skip
    """Return the clearest deviation of a pick from its formula, fitted beside all picks; None where there is none."""
    bent = {name_of(e.of) for e in known if isinstance(e, Modulated)}
    bent |= {name_of(e) for e in picks if isinstance(e, effects.OfFreePeriod)}
    data = current.at.model.formulation.data
    part_of = description_of(data.machine).part_of
    lone = tuple(term for term in terms if len(term.covariates) == 1)
    tried: list[Modulated] = []
    for pick in (pick for pick in picks if name_of(pick) not in bent):
        near = [term for term in lone if part_of(term.target) == part_of(pick.target)] or lone
        tried += once(partial(_forms_over, pick, current, near), (pick, data, *near), "forms")
    scored = [s for s, _ in score_all(current, tests.on, tried) if s.m]
    if not scored:
        return None
    best, t = max(scored, key=lambda s: delta_bic(s, tests.on)), thresholds()
    if best.p * len(scored) >= level or delta_bic(best, tests.on) < t.further_gain:
        return None
    found = option(current, best, tests.on)
    form = found.effect
    assert isinstance(form, Modulated)
    if runs_away(current, found.fit, form.of):
        return None
    large = share(found.fit, form) >= (t.along_share if form.acts_along else t.form_share)
    return found if found.gain > t.further_gain and large else None


def _forms_over(pick: Effect, current: Fit, terms: Sequence[SmoothTerm]) -> list[Modulated]:
    """Return a pick times a function of each covariate of the `terms`, and of where its carriages stand."""
    data = current.at.model.formulation.data
    along = [slow_along(pick, data, m) for m in (SLOW, ALONG)] if len(pick.coefficients) <= MOST else []
    tried = [Modulated(pick, (slow,)) for slows in along for slow in slows]
    tried += [Modulated(pick, slows) for slows in along if len(slows) > 1]
    taken = {slow.covariate for slows in along for slow in slows}
    for term in terms:
        [column], [low], [high] = term.covariates, term.low, term.high
        # the size of play cannot depend on its own direction: the square of a sign is constant
        constant = term.levels and column in pick.columns
        if column in taken or term.covariate in taken or constant:
            continue
        taken.add(column)
        waves = waves_over(data[column], low, high, 1 if term.levels else SLOW)
        middle = tuple(np.nanmean(waves, axis=0).tolist())
        tried.append(Modulated(pick, (Slow(term.covariate, column, low, high, middle),)))
        if term.levels or len(pick.coefficients) > 1:
            continue
        # where it has the sign of a column, its size is a function of the column's, as friction's over the speed
        own = pick.basis(current.at.recorded, data, np.zeros(1))
        signs = [np.sign(change[:, 0]) * np.sign(data[column]) for change in own.values()]
        if all(abs(float(np.nanmean(both))) > _SIGNS for both in signs):
            far = float(np.nanmax(np.abs(data[column])))
            waves = waves_over(np.abs(data[column]), 0.0, far, SLOW)
            middle = tuple(np.nanmean(waves, axis=0).tolist())
            tried.append(Modulated(pick, (Slow(term.covariate, column, 0.0, far, middle, unsigned=True),)))
    return tried


def runs_away(before: Fit, after: Fit, pick: Effect) -> bool:
    """Return whether a pick beside a form of it is `form_runaway` times as large as without the form.

    Then both are nearly the same function of the fitted readings, and cancel each other only there.
    """
    sizes = [abs(pick.amplitude(c)) for at in (before, after) for e, c in at.model.coefficients(at.x)
             if name_of(e) == name_of(pick)]  # fmt: skip
    return not sizes[1] <= thresholds().form_runaway * sizes[0]


def forms_of(effect: Effect, among: Sequence[Effect]) -> list[Modulated]:
    return [e for e in among if isinstance(e, Modulated) and name_of(e.of) == name_of(effect)]


def form_words(effect: Effect, shapes: Sequence[Effect], formulation: Formulation) -> str:
    """Return in words on what the size of a named effect depends; "" where it depends on nothing else."""
    machine, words = formulation.data.machine, words_of(roles_of(formulation))
    phrases: dict[bool, list[str]] = {True: [], False: []}
    for slow in (slow for form in forms_of(effect, shapes) for slow in form.over):
        phrases[slow.column in effect.columns].append(f"the {quantity_label(machine, slow.covariate, words)}")
    size = f"size depends on {' and '.join(phrases[False])}" if phrases[False] else ""
    course = f"course over {' and '.join(phrases[True])} is not that of its formula" if phrases[True] else ""
    return " and ".join(filter(None, (size, course)))


def slow_along(effect: Effect, data: MeasuredData, terms: int) -> tuple[Slow, ...]:
    """Return slow functions of the position of each carriage of an effect; none where the effect gives no carriage."""
    along: effects.Along | None = getattr(effect, "along", None)
    if along is None:
        return ()
    found = []
    for covariate, moments in along(data).items():
        stands = np.concatenate([one.at for one in moments])
        low, high = float(stands.min()), float(stands.max())
        if low < high:
            more = any(one.quantity != one.of for one in moments)  # at a moment than at home, where the formula holds
            middle = waves_over(np.zeros(1) if more else stands, low, high, terms).mean(axis=0)
            found.append(Slow(covariate, covariate, low, high, tuple(middle.tolist()), along))
    return tuple(found)


def product(waves: Array, change: Array) -> Array:
    """Return the changes of an effect, (n, k), times each of m functions, (n, m k)."""
    return np.asarray((waves[:, :, None] * np.asarray(change)[:, None, :]).reshape(len(waves), -1))


def waves_over(values: Array, low: float, high: float, terms: int) -> Array:
    """Return slow functions of a covariate, (n, terms): a slope, a bend and so on; flat beyond low and high."""
    return curve(np.asarray(values, dtype=float), low, high, terms + 1)[:, 1:]


def residuals_within(at: Fit, forms: Sequence[Modulated], most: float) -> Array:
    """Return the whitened residuals, (m,), of a fit in which no form changes its effect by more than `most` of it.

    Calibration may absorb nearly all of what a form adds. Then its fitted size is mostly noise, and a smaller one
    explains as much. So the forms get a normal prior here, as wide as may be with the largest of them within `most`.
    """
    q, data, place_of = at.at.recorded, at.model.formulation.data, at.model.place_of
    # where the coefficients of effect and form stand, the changes of the effect, the triangle of those of the form
    parts = []
    for one in forms:
        stacked = []
        for effect in (one.of, one):
            basis = effect.basis(q, data, np.zeros(len(effect.coefficients)))
            stacked.append(np.concatenate([np.asarray(part) for part in basis.values()]))
        R = np.asarray(np.linalg.qr(stacked[1], mode="r"))
        parts.append((place_of(one.of), stacked[0], place_of(one), R))
    of_forms = np.zeros(len(at.x), dtype=bool)
    for _, _, place, _ in parts:
        of_forms[place] = True
    root = np.sqrt(at.noise.weights(at.r) * (at.degrees / at.cost if at.noise.profiled else 1.0))
    whole = at.J * root[:, None]
    aim = whole @ at.x - at.r * root

    def solve(width: float) -> Array:  # with a prior of rms `width` relative to the effects as they are in the solution
        x = np.zeros(len(of_forms))
        x[~of_forms] = _least_squares(whole[:, ~of_forms], aim)
        for _ in range(_ROUNDS):
            prior = []
            for own, changes, place, R in parts:
                rows = np.zeros((len(R), len(x)))
                rows[:, place] = R / (width * float(np.linalg.norm(changes @ x[own])) + _TINY)
                prior.append(rows)
            J = np.concatenate([whole, *prior])
            x = _least_squares(J, np.concatenate([aim, np.zeros(len(J) - len(whole))]))
        return x

    low, high = np.log(_WIDTHS)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        x = solve(np.exp(middle))
        shares = [
            float(np.linalg.norm(R @ x[place]) / (np.linalg.norm(changes @ x[own]) + _TINY))
            for own, changes, place, R in parts
        ]
        low, high = (low, middle) if max(shares) > most else (middle, high)
    return np.asarray(at.r + at.J @ (solve(np.exp(low)) - at.x))


def _least_squares(A: Array, b: Array) -> Array:
    size = np.linalg.norm(A, axis=0)
    size[size == 0] = 1.0
    return np.asarray(np.linalg.lstsq(A / size, b, rcond=None)[0] / size)


def share(at: Fit, form: Modulated) -> float:
    """Return the rms change of the size relative to the size, in a fit with both; infinite without the effect."""
    parts = {name_of(e): c for e, c in at.model.coefficients(at.x)}
    if name_of(form.of) not in parts:
        return np.inf
    q, data = at.at.recorded, at.model.formulation.data
    own = form.of.shift(q, data, parts[name_of(form.of)])
    change = form.shift(q, data, parts[name_of(form)])
    whole = sum(float(np.sum(values**2)) for values in own.values())
    return float(np.sqrt(sum(float(np.sum(values**2)) for values in change.values()) / whole)) if whole else 0.0


def near(found: Sequence[Option]) -> tuple[Option, ...]:
    """Return the best option and those close to it where formulas may be off, each with its distance to the best.

    The order is kept, but the likeliest comes first where the first one is not close to it.

    An option on the same part as the best one has two likelihoods: of its exact formula, and of its formula being off.
    They are added; before the data the second is `form_odds` times as likely. So of two formulas that may both be off,
    neither wins by an exact fit alone. An option without a form, or on another part, is compared by its gain. Where
    effects give the positions at which they act, options of all parts are compared with each other, because legs that
    meet share the effect of one of them; one that is near by its gain stays. There both likelihoods have the same
    weight, because a form is visible for some options and not for others, and readings are few.
    """
    plain, top, t = close(found), max(found, key=lambda o: o.gain), thresholds()
    if not (top.gain > 0 and 0 < len(top.fit.r) < t.drawn_rows):
        return plain
    part_of = description_of(top.fit.model.formulation.data.machine).part_of
    own = {o.name for o in found if part_of(o.effect.target) == part_of(top.effect.target)}
    if top.fit.noise.profiled:
        return _near_without_noise(found, plain, top, own)
    acting = {o.name for o in found if getattr(o.effect, "along", None)}
    rivals = [o for o in found if o.name in own or (top.name in acting and o.name in acting)]
    if len(rivals) < 2:
        return plain
    worth = {o.name: one for o in rivals if (one := _worth(o, top)) is not None}
    best = max(worth.values()) - t.form * top.gain
    # a rich formula, of many numbers, stands for the form of another one
    taken_up, likelihoods = t.formula_error * top.gain, {}
    for o in (o for o in rivals if o.name in worth):
        richer = (len(o.effect.coefficients) > MOST) - (len(top.effect.coefficients) > MOST)
        likelihoods[o.name] = replace(o, behind=best - worth[o.name] + taken_up * richer)
    kept = {o.name for o in likelihoods.values() if o.behind < t.close}
    kept |= {top.name, *(o.name for o in plain if o.name not in likelihoods or o.name not in own)}
    return _likeliest_first([likelihoods.get(o.name, o) for o in found if o.name in kept])


def _near_without_noise(
    found: Sequence[Option], plain: Sequence[Option], top: Option, own: set[str]
) -> tuple[Option, ...]:
    """Return the best option and its rivals, of which `own` are on its part, where nothing tells the noise.

    A random form would be measured by a noise that holds the error of the best form itself. So a rival on the same part
    stays where the best one explains no more than it does but for an error of form: up to `formula_error` of all. Its
    distance is what it leaves, in squares of `form_off`.

    Where effects are functions of a place, the error of a form may also be a smooth random function of the place, which
    is `form_smooth` likely before the data. A place has more than one number, so such a function tells far more than
    one of a single argument. An effect that explains nothing has no form, nor has the twin of another pick. A distance
    is that of the weights under both laws.
    """
    t, count = thresholds(), top.fit.degrees
    kept = []
    for o in found:
        lost = float(np.expm1((top.gain - o.gain) / count) / np.expm1(top.gain / count))
        rich = len(o.effect.coefficients) > MOST
        if o is not top and o.name in own and not rich and 0 <= lost < t.formula_error:
            behind = min(top.fit.noise.told_apart(top.gain - o.gain, count), lost / t.form_off**2)
            kept.append(replace(o, behind=behind))
        elif o in plain:
            kept.append(o)
    beside = {name_of(e) for e in top.fit.model.effects if e is not top.effect}
    placed = [o for o in found if o.name in own and getattr(o.effect, "over", None) and o.gain > 0]
    placed = [o for o in placed if not beside & {*o.effect.twins}]
    if len(placed) < 2 or top not in placed:
        return tuple(kept)

    def shares(behind: Mapping[str, float]) -> dict[str, float]:
        weights = {name: float(np.exp(-far / 2)) for name, far in behind.items()}
        return {name: one / sum(weights.values()) for name, one in weights.items()}

    # twice the log-likelihood of each, its form off or not, less its penalty
    data = top.fit.model.formulation.data
    over: tuple[str, ...] = getattr(top.effect, "over", ())
    place = np.stack([np.asarray(data[name], dtype=float) for name in over], axis=-1)
    fields = once(lambda: [random_field(place, length) for length in _LENGTHS], (data,), "fields", over)
    likelihoods = {o.name: _likelihood(o, o.effect, top, fields) - o.paid for o in placed}
    waves: dict[tuple[str, ...], tuple[Option, Effect]] = {}
    for o in sorted(placed, key=lambda one: one.gain):  # the one that explains more comes last
        if (whole := getattr(o.effect, "whole", None)) is not None:
            waves[tuple(sorted(whole.coefficients))] = o, whole
    for o, whole in waves.values():
        paid = o.paid + float(np.log(len(o.fit.r)))
        likelihoods[o.name] = max(likelihoods[o.name], _likelihood(o, whole, top, fields) - paid)
    smooth = shares({name: max(likelihoods.values()) - one for name, one in likelihoods.items()})
    far = {}
    for o in (o for o in kept if o.name in likelihoods):
        exact = top.fit.noise.told_apart(top.gain - o.gain - spared(o, top), count)
        far[o.name] = max(0.0, o.behind if np.isfinite(o.behind) else exact)
    free = shares(far)
    both = {name: t.form_smooth * one + (1 - t.form_smooth) * free.get(name, 0.0) for name, one in smooth.items()}
    distance = {name: 2 * float(np.log(max(both.values()) / max(one, _TINY))) for name, one in both.items()}
    left = [replace(o, behind=distance[o.name]) if o.name in distance else o for o in found]
    names = {name for name, one in distance.items() if one < t.close}
    names |= {top.name, *(o.name for o in kept if o.name not in distance)}
    return _likeliest_first([o for o in left if o.name in names])


def _likelihood(o: Option, effect: Effect, top: Option, fields: Sequence[Array]) -> float:
    """Return twice the log-likelihood of an effect in the place of an option's, its form off or not.

    Of a fit that is kept it is computed once: the scale of Gaussian noise adds a number to it.
    """
    if np.isfinite(o.fit.noise.t_degrees):
        return _likelihood_and_count(o, effect, top, fields)[0]
    of, scale = (o.fit.J, o.effect, *fields), o.fit.noise.scale
    likely, count, then = once(
        lambda: (*_likelihood_and_count(o, effect, top, fields), scale), of, "likelihood", effect is o.effect
    )
    return likely + 2 * count * float(np.log(scale / then))


def _likelihood_and_count(o: Option, effect: Effect, top: Option, fields: Sequence[Array]) -> tuple[float, int]:
    at, k = o.fit, len(effect.coefficients)
    J, own = np.split(at.J, [len(at.x) - len(o.effect.coefficients)], axis=1)
    Q = orthonormal(J, _FULL)
    root = np.sqrt(at.noise.weights(top.fit.r))[:, None]
    without = own @ at.x[J.shape[1] :] - at.r  # what the effect has to explain
    y = project_off(without * root[:, 0], Q, times=2)
    count = max(len(y) - Q.shape[1], 1)
    D = project_off(columns(at, effect) * root, Q, times=2)
    c = np.asarray(np.linalg.lstsq(D, y, rcond=None)[0], dtype=float)
    left = max(float(np.sum((y - D @ c) ** 2)), _TINY)
    changes = effect.basis(at.at.recorded, at.model.formulation.data, np.zeros(k))
    likely = []
    for one in fields:
        T = signatures(at, {name: product(one, change) for name, change in changes.items()})
        T = project_off(T * root, Q, times=2).reshape(len(y), -1, k) * thresholds().form_off
        likely.append(-_least(y, D, np.asarray(T), effect, c, _OFF, count) / 2)
    exact = -count * (float(np.log(left / count)) + 1)
    drawn = 2 * (np.logaddexp.reduce(likely) - np.log(len(likely)))
    return float(2 * np.logaddexp(exact / 2, (drawn + thresholds().form_odds) / 2)), count


def _likeliest_first(found: Sequence[Option]) -> tuple[Option, ...]:
    """Return options; where the first one is too far behind, the one that is least behind comes first."""
    first, likeliest = found[0], min(found, key=lambda o: o.behind)
    if not thresholds().close <= first.behind < np.inf:
        return tuple(found)
    return (likeliest, *(o for o in found if o is not likeliest))


def _worth(o: Option, top: Option) -> float | None:
    """Return twice the log-likelihood of an option, its form off or not, over that of no effect; None without a form.

    A random form is weighted as the readings in the fit `top`. With heavy tails an option's own weights would forgive a
    poor fit the readings that it misses by far. A formula of many numbers can follow any course over its argument: it
    explains the same, off or not.
    """
    at, k = o.fit.at, len(o.effect.coefficients)
    data = at.model.formulation.data
    # for each argument of the formula its signatures times the parts of random curves of it; where the option gives the
    # positions of its carriages, times slow functions of these, all together
    if slow_along(o.effect, o.fit.model.formulation.data, ALONG):
        forms = [_slow_forms(o, ALONG)]
    else:
        own, forms = o.effect.basis(at.recorded, data, np.zeros(k)), []
        for _, values in _arguments(o, data):
            curves = [random_curve(values, length) for length in _LENGTHS]
            changed = [{name: product(parts, change) for name, change in own.items()} for parts in curves]
            forms.append([signatures(o.fit, changes) for changes in changed])
    drawn = o.gain
    if (worth := _drawn(o, forms, _OFF, top)) is not None:
        drawn = top.gain + top.paid - o.paid + float(np.sum(top.fit.noise.weights(top.fit.r) * top.fit.r**2)) - worth[1]
    elif o is not top and len(o.effect.coefficients) <= MOST:
        return None
    odds = 0.0 if getattr(top.effect, "along", None) else thresholds().form_odds
    return float(2 * np.logaddexp(o.gain / 2, (drawn + odds) / 2))


def bonus(o: Option) -> float:
    """Return how much more an option explains if its formula may be off; 0 where it explains no more."""
    slow = ([[form] for form in _slow_forms(o, terms)] for terms in (SLOW, thresholds().curve_terms - 1))
    gains = [_drawn(o, forms, (1.0,), o) for forms in slow]
    return max([0.0, *(before - after for before, after in filter(None, gains))])


def _drawn(
    o: Option, forms: Sequence[Sequence[Array]], off: Sequence[float], top: Option
) -> tuple[float, float] | None:
    """Return minus twice the log-likelihood of an option: of its exact formula, and with a random form."""
    at, k = o.fit, len(o.effect.coefficients)
    c = at.x[len(at.x) - k :]
    if k > MOST or at.noise.profiled or not len(at.r) or not np.linalg.norm(c) > 0 or not forms:
        return None
    root = np.sqrt(at.noise.weights(top.fit.r))
    J = at.J * root[:, None]
    Q = orthonormal(J[:, :-k], _FULL)
    D = project_off(J[:, -k:], Q, times=2)
    y = project_off(at.r * root, Q, times=2) + D @ c
    likely = []
    for alike in forms:
        shown = (project_off(form * root[:, None], Q, times=2).reshape(len(y), -1, k) for form in alike)
        parts = [-_least(y, D, np.asarray(T * thresholds().form_off), o.effect, c, off) / 2 for T in shown]
        likely.append(np.logaddexp.reduce(parts) - np.log(len(alike)))
    return float(np.sum((y - D @ c) ** 2)), float(-2 * max(likely))


def _slow_forms(o: Option, terms: int) -> list[Array]:
    """Return for each argument of an option's formula its signatures times so many slow functions of it."""
    data, k = o.fit.model.formulation.data, len(o.effect.coefficients)
    if along := slow_along(o.effect, data, ALONG):
        found = [Modulated(o.effect, along)]
    else:
        found = []
        for column, values in _arguments(o, data):
            low, high = float(np.nanmin(values)), float(np.nanmax(values))
            middle = np.nanmean(waves_over(values, low, high, terms), axis=0)
            found.append(Modulated(o.effect, (Slow(column, column, low, high, tuple(middle.tolist())),)))
    # the variance of the functions over the rows, or over the path along which something moves
    rms = []
    for form in found:
        parts = []
        for slow in form.over:
            at = np.linspace(slow.low, slow.high) if slow.along else np.asarray(data[slow.column], dtype=float)
            spread = float(np.nanvar(slow.waves(at), axis=0).sum())
            parts.append(np.full(len(slow.middle) * k, np.sqrt(spread)))
        rms.append(np.concatenate(parts))
    return [columns(o.fit, form) / one for form, one in zip(found, rms, strict=True)]


def _arguments(o: Option, data: MeasuredData) -> Iterator[tuple[str, Array]]:
    for column in dict.fromkeys(o.effect.columns):
        values = np.asarray(data[column]) if column in data else np.empty(0)
        if values.dtype.kind == "f" and len(np.unique(values[np.isfinite(values)])) > _LEVELS:
            yield column, values


def random_curve(x: Array, length: float) -> Array:
    """Return the parts, (n, m), of a random smooth function of x, (n,).

    The function is the sum of the parts times standard normal numbers. Its values are normal, their correlation is
    exp(-d^2 / 2) at a distance of d times `length`, a part of the range of x. Its mean over the finite x is zero and
    its rms there one; elsewhere it is zero.
    """
    known = np.isfinite(x)
    low, high = float(np.min(x[known])), float(np.max(x[known]))
    knots, there = np.linspace(0.0, 1.0, _KNOTS)[:, None], ((x[known] - low) / (high - low))[:, None]
    curves = _random(there, knots, length, _PART)
    parts = np.zeros((len(x), curves.shape[1]))
    parts[known] = curves
    return parts


def random_field(x: Array, length: float) -> Array:
    """Return the parts, (n, m), of a random smooth function of a place x, (n, d), each of its numbers over its range.

    The same as `random_curve` over more than one number, `length` in each of them; all of x is known.
    """
    wide = np.ptp(x, axis=0)
    u = (x - x.min(axis=0)) / np.where(wide > 0, wide, 1.0)
    return _random(u, u[:: max(1, len(u) // _PLACES)], length, _PART_OF_FIELD)


def _random(u: Array, knots: Array, length: float, least: float) -> Array:
    variances, V = np.linalg.eigh(_correlation(knots, knots, length))
    held = variances > least * variances[-1]
    parts = _correlation(u, knots, length) @ (V[:, held] / np.sqrt(variances[held]))
    parts -= parts.mean(axis=0)
    return np.asarray(parts / np.sqrt(np.sum(parts**2) / len(parts)))


def _correlation(one: Array, other: Array, length: float) -> Array:
    """Return the correlation, (n, m), of a random smooth function between places (n, d) and (m, d)."""
    apart = [np.exp(-0.5 * ((a[:, None] - b) / length) ** 2) for a, b in zip(one.T, other.T)]
    return np.asarray(np.prod(apart, axis=0))


def _least(y: Array, D: Array, T: Array, effect: Effect, c: Array, off: Sequence[float], count: int = 0) -> float:
    """Return the minimum of minus twice the log-likelihood of y over possible sizes of the effect.

    All sizes along one direction share a decomposition; grids of directions and sizes close in on the best of both.
    """
    N, m, k = T.shape
    flat = T.reshape(N, m * k)
    TT, Ty, TD = (flat.T @ flat).reshape(m, k, m, k), (flat.T @ y).reshape(m, k), (flat.T @ D).reshape(m, k, k)
    TTs, TDs = TT.transpose(1, 3, 0, 2).reshape(k * k, m * m), TD.transpose(1, 2, 0).reshape(k * k, m)
    yy, Dy, DD, unit = float(y @ y), D.T @ y, (D.T @ D).ravel(), float(np.linalg.norm(c))
    shares, largest = np.square(off)[:, None], getattr(effect, "largest", np.inf)

    def likelihood(ways: Array, sizes: Array) -> Array:  # along directions (d, k), at sizes (d, s)
        squares = (ways[:, :, None] * ways[:, None, :]).reshape(-1, k * k)
        variances, V = np.linalg.eigh((squares @ TTs).reshape(-1, m, m))
        own, crossed = (one[:, None] @ V for one in (ways @ Ty.T, squares @ TDs))
        both = (own - sizes[..., None] * crossed) ** 2, variances[:, None].clip(0.0)
        half, form = ((sizes[..., None] ** 2 * one)[:, :, None] * shares for one in both)
        left = (yy - 2 * sizes * (ways @ Dy)[:, None] + sizes**2 * (squares @ DD)[:, None])[:, :, None, None]
        noise = _likeliest(left, half, form, count) if count else np.ones((*left.shape[:2], len(off), 1))
        grown = 1 + form / noise
        explained = (half / (noise**2 * grown)).sum(axis=-1) - np.log(grown).sum(axis=-1)
        likely = explained - (left / noise + count * np.log(noise))[..., 0]
        return np.asarray(-2 * (np.logaddexp.reduce(likely / 2, axis=-1) - np.log(len(off))))

    along, sizes, reach = c / unit, unit * np.array([*_SIZES, *(-size for size in _SIZES)]), 1.0
    ways = along[None]
    if k == 2:  # and the directions between it and its opposite
        ways = np.stack([np.cos(_AROUND), np.sin(_AROUND)], axis=-1) @ np.array([along, [-along[1], along[0]]])
    turns = np.concatenate([np.zeros((1, k)), *(step * np.eye(k) for step in _TURNS)])[: None if k > 1 else 1]
    for _ in range(_CLOSER):
        most = np.array([largest / max(abs(effect.amplitude(way)), _TINY) for way in ways])[:, None]
        tried = np.clip(sizes, -most, most)  # those that are possible
        found = likelihood(ways, tried)
        way, size = np.unravel_index(int(np.argmin(found)), found.shape)
        ways, sizes = ways[way] + reach * turns, tried[way, size] * np.exp(reach * _GRID)
        ways, reach = ways / np.linalg.norm(ways, axis=1, keepdims=True), reach * _CLOSES_IN
    return float(found.min())


def _likeliest(left: Array, half: Array, form: Array, count: int) -> Array:
    """Return the likeliest variance of the noise, (..., 1), for each size of a random form, by fixed points."""
    noise = np.maximum(left / count, _TINY)
    for _ in range(_SETTLED):
        both = noise + form
        explained = (half * (noise + both) / both**2).sum(axis=-1, keepdims=True)
        free = count - (form / both).sum(axis=-1, keepdims=True)
        noise = np.maximum((left - explained) / np.maximum(free, 1.0), _TINY)
    return noise
