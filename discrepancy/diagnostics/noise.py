"""The noise of a search: as stated, as repeats of readings correct it, or learned from what a fit leaves.

Each kind of sensor has its scale, by maximum likelihood under a t law from the differences of back-to-back readings, in
which a missing effect cancels; outlying readings and heavy tails must show there too. Two traps are looked for: columns
in exact levels while the inputs scatter, whose saw-tooth waves explain to the last digit; and one reading that makes
nearly all of what is left, without which the sum of squares falls by r' (I - H)^-1 r (Cook and Weisberg 1982, ch. 2).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.fft import dct
from scipy.optimize import minimize
from scipy.special import fdtrc, gammainc, ndtr

from calibench.core.notes import Code, Note
from calibench.core.words import plain
from calibench.discrepancy.diagnostics.far_readings import Pattern, Standing, columns_of, pattern_of
from calibench.discrepancy.fitting.fit import Fit, Linearised, fit, linearise, orthonormal, reading_order, readings_of
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured import blamable, kinds_of, sensor_of
from calibench.discrepancy.model.model import Model, relearned, told_by_middle
from calibench.discrepancy.model.roles import inputs_of, unknown_noise_of
from calibench.discrepancy.noise import laws
from calibench.discrepancy.noise.laws import NoiseFinding, mixture
from calibench.discrepancy.noise.repeats import TAILS, law_of, pairs_of, variance
from calibench.discrepancy.noise.whiten import ROUNDING, Noise
from calibench.discrepancy.thresholds import thresholds
from calibench.problems.base import Array

_MOST_LEFT = 0.1  # of the sum of squares, without the reading
_LEAST_LEFT = 3  # equations beside the parameters, without the reading
_RANK = 1e-10  # of the largest singular value


def one_reading(at: Fit) -> tuple[int, float] | None:
    """Return the row without which the fit leaves a tenth of its sum of squares, and how much nearer the others lie."""
    n = len(at.model.formulation.data)
    width, odd = divmod(len(at.r), n)
    if odd or not width or at.exact:
        return None
    r, q = np.asarray(at.r).reshape(n, width), orthonormal(at.J, _RANK)
    freedom = len(at.r) - q.shape[1] - width
    whole = float(np.sum(r**2))
    if freedom < _LEAST_LEFT or not whole > 0:
        return None
    blocks = q.reshape(n, width, -1)
    beside = np.eye(width) - blocks @ blocks.transpose(0, 2, 1)
    # a reading that alone determines a parameter tells nothing of itself
    known = np.linalg.eigvalsh(beside)[:, 0] > 1e-9
    if not known.any():
        return None
    falls = np.zeros(n)
    falls[known] = np.einsum("ij,ij->i", r[known], np.linalg.solve(beside[known], r[known][..., None])[..., 0])
    k = int(np.argmax(falls))
    left = max(whole - falls[k], 1e-12 * whole)
    if left > _MOST_LEFT * whole or n * fdtrc(width, freedom, falls[k] / width / (left / freedom)) > _CHANCE:
        return None
    return k, float(np.sqrt(whole / len(at.r) / (left / (len(at.r) - width))))


_CORES = (0.75, 1.0)
_NOTHING, _FAR_LESS = 1e-4, 0.5  # times the stated noise: less than the first has no noise at all
_SEEN_FROM = 3.0  # standard deviations from which on a reading is seen to be far off
_CHANCE = 1e-6  # that readings of the stated noise leave so little
_SCALES = 0.7, 1.05  # between which noise is as stated
_SETTLED = 3  # times that a law and the fit beside it are found anew
_LIKELY = 0.9  # weight of a reading that is told to be far off
_MOST_FAR = 0.3  # of the readings are far off: of more the rest tells no noise


def less_than_stated(at: Fit) -> float | None:
    """Return how many times the stated noise a fit leaves, where that is far less than by chance; else None."""
    if unknown_noise_of(at.model.formulation):
        return None
    energy = float(np.sum(at.r**2))
    times = float(np.sqrt(energy / at.degrees))
    if at.exact or not _NOTHING < times < _FAR_LESS or gammainc(at.degrees / 2, energy / 2) > _CHANCE:
        return None
    return times


def outlying(at: Fit) -> tuple[tuple[NoiseFinding, ...], tuple[Pattern, ...]]:
    """Return the cause of readings far beyond the stated noise: one sensor, or all; nothing without repeats.

    Those that time, place or a column carries are no noise: second comes what carries them.
    """
    formulation, t = at.model.formulation, thresholds()
    found: list[NoiseFinding] = []
    no_noise: list[Pattern] = []
    columns: dict[str, Array] = {}
    r, signatures = whitened(at.at)
    for alike in kinds_of(blamable(formulation.sensors)):
        first, second = pairs_of(formulation.data)
        names = [sensor.column for sensor in alike]
        # the rows in which all of them are read, (n,)
        reads = getattr(formulation, "reads", None)  # of `Blocks`, and of what stands around them
        read = np.ones(len(formulation.data), dtype=bool)
        read = read if reads is None else np.all([read, *map(reads, names)], axis=0)
        first, second = first[read[first]], second[read[first]]
        if len(first) < t.repeat_pairs:
            continue
        # the changes between repeats in their standard deviations, (m, k): of the readings, or where the machine did
        # not come to the same place of the residuals, in which its way from one place to the other is taken out
        data, of = formulation.data, [formulation.readings.index(name) for name in names]
        change = np.stack([np.asarray(data[name])[second] - np.asarray(data[name])[first] for name in names], axis=-1)
        change = change / np.hypot(at.at.sigma[first][:, of], at.at.sigma[second][:, of])
        left = [laws.changes_left(r, signatures[name], first, second) for name in names]
        still = laws.returned(change, np.stack([one for one, _ in left], axis=-1))
        parts = np.ones(change.shape) if still else np.stack([part for _, part in left], axis=-1)
        change = change if still else np.stack([one for one, _ in left], axis=-1)
        change = change - np.median(change, axis=0)
        change = change / _wider(change.ravel(), t.wide_core_all)
        d = np.asarray(change / [_wider(one, t.wide_core_one) for one in change.T])
        whole, beside = d, len(names)  # of all sensors together
        if not still:  # where a machine moved, no more than its constraints tell
            whole = (r[second] - r[first]) / np.sqrt(2)
            whole = whole - np.median(whole, axis=0)
            whole, beside = whole / _wider(whole.ravel(), t.wide_core_all), whole.shape[1]
        # also without the changes around the largest in time: a step shows only there, wild readings show everywhere
        place = np.argsort(np.argsort(first, kind="stable"))
        away = np.abs(place - place[np.argmax(np.abs(d).max(axis=1))])
        elsewhere = away > max(1.0, t.wild_moment * len(d))
        if not (_are_beyond(whole, d) and _are_beyond(whole[elsewhere], d[elsewhere], t.wild_elsewhere)):
            continue
        worst = int(np.argmax([contamination(d[:, k]) for k in range(len(names))]))
        everywhere = mixture((d**2).ravel(), parts.ravel())
        weights = everywhere.weights.reshape(d.shape)
        energy = (weights * np.minimum(d**2, t.wild_energy_most)).sum(axis=0)
        concentrated = beside >= len(names) and bool(energy[worst] >= t.wild_share * energy.sum())
        lone = [mixture(one**2, part) for one, part in zip(d.T, parts.T)]
        if not still:
            worst = int(np.argmax([one.gain for one in lone]))
            everywhere = mixture((whole**2).sum(axis=1), np.ones(len(whole)), degrees=beside)
        # the weight of "one encoder"
        one = float(1 / (1 + np.exp(np.clip((everywhere.gain - lone[worst].gain) / 2, -50, 50))))
        blamed = alike[worst]
        if concentrated or one > 0.5:
            law = laws.outliers_of(formulation, blamed, r, signatures[blamed.column])
            rival = ("heavy_tails", "all", 1 - one)
        else:
            law, rival = laws.heavy_tails_in(formulation, r), ("outlier", blamed.part, one)
        # visits are far off one by one, as an error of a reading shows in two changes of three repeats
        one_of = lone[worst] if law.family == "outlier" else everywhere
        far = one_of.weights.reshape(len(d), -1).max(axis=1)
        part = parts[:, worst] if law.family == "outlier" else parts.max(axis=1)
        chance = 2 * ndtr(-_SEEN_FROM / np.sqrt(1 + one_of.tau**2 * part))
        _, row, visit = np.unique(np.asarray(data["visit_id"])[first], return_index=True, return_inverse=True)
        likely, odds = np.zeros(len(row)), np.zeros(len(row))
        np.maximum.at(likely, visit, far)
        np.add.at(odds, visit, chance)
        columns = columns or columns_of(at)
        by = pattern_of(law.target, likely, odds, {name: values[first[row]] for name, values in columns.items()})
        if by is not None:
            no_noise.append(by)
            continue
        near = not concentrated and rival[2] > t.wild_rival
        found.append(replace(law, rival=rival, alike=blamed.kind) if near else law)
    shared = [f for f in found if f.family != "outlier"]  # heavy tails are those of all readings: told once
    return (*(f for f in found if f.family == "outlier"), *shared[:1]), tuple(no_noise)


def _are_beyond(whole: Array, each: Array, part: float = 1.0) -> bool:
    """Return whether changes have readings far beyond the noise, of all sensors or one, by a part of the thresholds."""
    t = thresholds()
    return len(each) >= t.repeat_pairs and (
        contamination(whole) > part * t.wild_gain_all
        or any(contamination(one) > part * t.wild_gain_one for one in each.T)
    )


def outlying_untold(at: Fit) -> tuple[NoiseFinding, ...]:
    """Return the laws of readings far off in what a fit leaves, where no repeats tell of them; () where there is none.

    They are few, further off than wider noise would put them, and anywhere: what time, place or a column carries is
    no noise. They pull at the fit, so their law is that beside a fit that trusts them less.
    """
    formulation, columns = at.model.formulation, columns_of(at)
    found: list[NoiseFinding] = []
    sensors = {s.part or s.column: replace(s, part=s.part or s.column) for s in formulation.sensors}
    while sensors:
        there, own = beside_outlying(at, found), [*sensors.values()]
        for _ in range(_SETTLED):
            r, signatures = _left(there.model, there.x, found)
            tried = [laws.outliers_of(formulation, one, r, signatures[one.column]) for one in own]
            law = max(tried, key=lambda one: one.gain)
            there, own = beside_outlying(at, [*found, law]), [sensors[law.target]]
        column = sensors.pop(law.target).column
        s, size = signatures[column], law.amplitude / float(np.median(formulation.sigma[column]))
        square = float(np.sum((s * r).sum(axis=1) ** 2) / max(float(np.sum(s**2)), 1e-300))
        wider = len(r) * (square - 1 - np.log(square)) if square > 1 else 0.0
        if law.weights.mean() > _MOST_FAR or law.gain < wider + thresholds().wild_gain_one:
            break
        chance = 2 * ndtr(-_SEEN_FROM / np.sqrt(1 + size**2 * (s**2).sum(axis=1)))
        others = {name: values for name, values in columns.items() if name != column}  # it is far off in its own
        if pattern_of(law.target, law.weights, chance, others) is not None:
            return ()
        found.append(law)
    return tuple(found)


def beside_outlying(at: Fit, suspects: Sequence[NoiseFinding]) -> Fit:
    """Return a fit again, with the readings that are suspected trusted less."""
    noise = replace(at.noise, extra=_sum(at.noise.extra, *(s.extra for s in suspects)))
    return fit(at.model, noise, at.x, about=at)


def rows_far_off(at: Fit, whole: Formulation) -> Standing | None:
    """Return the rows of `whole` that are far off by the laws of `outlying_untold`; None where repeats tell of them."""
    if at.noise.from_repeats or not at.noise.profiled:
        return None
    alike = {name: variance for name, variance in at.noise.extra.items() if np.ndim(variance) == 0}
    there = fit(Model(whole, at.model.effects), replace(at.noise, extra=alike), at.x)
    wild = outlying_untold(there)
    far = np.any([np.zeros(len(whole.data)), *(s.weights > _LIKELY for s in wild)], axis=0)
    if not far.any():
        return None
    beside = beside_outlying(there, wild)
    times = float(np.sqrt(np.mean((_left(beside.model, beside.x)[0][far] ** 2).max(axis=1))))
    only = next(iter(wild[0].extra)) if len(wild) == 1 else ""
    runs = tuple((int(row),) for row in np.sort(whole.data.row_numbers[far]))
    fitted = np.isin(at.model.formulation.data.row_numbers, whole.data.row_numbers[far], invert=True)
    return Standing(runs, times, only, wild[0].amplitude, fitted)


def outliers_under(model: Model, x: Array, target: str) -> NoiseFinding:
    """Return the outlying readings of the sensor at `target` under a model at x, over all rows of its formulation."""
    sensor = sensor_of(model.formulation.sensors, target)
    r, signatures = _left(model, x)
    return laws.outliers_of(model.formulation, sensor, r, signatures[sensor.column])


def contamination(d: Array) -> float:
    """Return the gain of "small noise, and some values far beyond it" over laws without outliers, for differences d."""
    seen = -np.inf
    for core in _CORES:
        mixed = mixture((d.ravel() / core) ** 2, np.ones(d.size))
        seen = max(seen, mixed.gain / 2 + Noise(core).loglikelihood(d))
    one = -np.inf
    for t_degrees in (*TAILS, np.inf):  # each law at its most likely scale near the stated one
        scale = float(np.clip(np.sqrt(variance(d.ravel(), t_degrees)), *_SCALES))
        one = max(one, Noise(scale, 0.0, t_degrees).loglikelihood(d))
    return float(2 * (seen - one))


def _wider(values: Array, deviations: float) -> float:
    """Return the spread of the middle half of `values` if it is significantly above 1, by `deviations`; else 1."""
    spread = laws.middle_half(values)
    return spread if spread > 1 + deviations * laws.QUARTILES / np.sqrt(len(values)) else 1.0


def whitened(at: Linearised) -> tuple[Array, dict[str, Array]]:
    """Return the whitened residuals, and the signature of a stated deviation of each reading, (n, c) each."""
    shape = at.misclosure.shape
    names = at.model.formulation.readings
    scaled = at.reading_slopes * at.sigma[:, None, :]
    signatures = {name: at.whiten(scaled[:, :, k]).reshape(shape) for k, name in enumerate(names)}
    return at.whiten(at.misclosure).reshape(shape), signatures


def _left(model: Model, x: Array, beside: Sequence[NoiseFinding] = ()) -> tuple[Array, dict[str, Array]]:
    """Return what `whitened` does of a model at x, under the stated noise and the laws `beside` it."""
    readings = readings_of(model)
    return whitened(linearise(model, Noise(extra=_sum(*(s.extra for s in beside))), x, readings, readings))


def sound_fit(plain: Fit) -> tuple[Fit, tuple[NoiseFinding, ...], tuple[Pattern, ...], tuple[Note, ...]]:
    """Return the fit with its noise corrected where repeats contradict the stated one; the suspected sensors; notes.

    Before the notes come far readings that are no noise.
    """
    at = plain
    added, notes = sensor_scales(plain)
    if added:
        at = fit(plain.model, Noise(extra=added), plain.x)
    # the sensors whose values have steps coarse enough to matter, for a fit under the stated noise
    r, signatures = whitened(at.at)
    formulation = at.model.formulation
    sensors = blamable(formulation.sensors)
    found = [laws.quantisation_of(formulation, sensor, r, signatures[sensor.column]) for sensor in sensors]
    suspects = []
    for one in (one for one in found if one.amplitude > 0 and one.gain > thresholds().step_gain):
        # m readings of one value have the same error: with m times the variance each, they weigh as one
        [(name, variance_of)], data = one.extra.items(), formulation.data
        step = np.round(np.asarray(data[name]) / one.amplitude)
        pose = np.unique(data["pose_id"], return_inverse=True)[1] if data.has("pose_id") else np.zeros(len(step))
        _, place, count = np.unique(np.stack([step, pose]), axis=1, return_inverse=True, return_counts=True)
        suspects.append(replace(one, extra={name: variance_of * count[place.ravel()]}))
    if suspects:
        at = fit(plain.model, Noise(extra=_sum(added, *(s.extra for s in suspects))), plain.x)
    outside, no_noise = outlying(at)
    wild = [s.extra for s in outside if s.family == "outlier"]
    if wild:
        at = fit(plain.model, Noise(extra=_sum(at.noise.extra, *wild)), at.x)
    stated = len(unknown_noise_of(formulation)) < len(formulation.readings)
    return at, (*suspects, *outside), no_noise, notes if stated else ()


def law_at(at: Fit) -> tuple[Noise, int, tuple[Note, ...]]:
    """Return the law of the noise that repeats show in what a fit leaves, their number, and remarks on it."""
    formulation = at.model.formulation
    stated = len(unknown_noise_of(formulation)) < len(formulation.readings)
    return law_of(at.r.reshape(len(formulation.data), -1), formulation.data, stated)


def noise_at(sound: Fit, suspects: Sequence[NoiseFinding], whole: Formulation) -> tuple[Noise, tuple[Note, ...]]:
    """Return the noise that repeated readings show, and remarks on it. `whole` has the held-out rows too."""
    data, unknown = sound.model.formulation.data, unknown_noise_of(whole)
    noise, repeats, remarks = law_at(sound)
    if any(note.code is Code.NO_REPEATS for note in whole.data.notes):  # the machine has its own note on it
        remarks = tuple(note for note in remarks if note.code is not Code.NO_REPEATS)
    if any(s.family == "quantisation" for s in suspects):
        noise, remarks = Noise(), ()  # coarse readings repeat the same value, so repeats tell nothing about their noise
    noise = replace(noise, extra=sound.noise.extra)
    if unknown and (len(unknown) < len(whole.readings) or not noise.from_repeats):
        behind = max(len(unknown) * told_by_middle(len(data), sound.J.shape[1] / len(whole.readings)), repeats)
        noise = replace(noise, profiled=True, known=min(noise.known, behind))
    return noise, remarks


_SLOW = 20  # waves over the run: what is as slow is no noise
_SHARES = np.linspace(0.0, 0.6, 31)  # of the noise, that are carried on
_REFUSED = 6.63  # twice the log-likelihood behind the likeliest: above what is nearer lies one true share of 200


def carried(at: Fit) -> tuple[float, ...]:
    """Return parts of the noise that what a fit leaves may carry from one reading to the next: likeliest to largest.

    By the likelihood of its waves over the run (Whittle 1953), but for the slow ones: what changes slowly is no noise.
    What holds at all parts that are not refused holds at the true one (Berger and Boos 1994).
    """
    places = reading_order(at.model.formulation.data)
    order = np.argsort(places, kind="stable")
    r = np.asarray(at.r).reshape(len(order), -1)[order]
    if len(r) <= 2 * _SLOW:
        return ()
    powers = np.mean(dct(r, axis=0, norm="ortho")[_SLOW + 1 :] ** 2, axis=1)
    turns = np.cos(np.pi * np.arange(_SLOW + 1, len(r)) / len(r))
    kept = np.mean(_SHARES[:, None] ** np.diff(places[order]), axis=1)[:, None]  # some of the rows were not searched
    shapes = 1 / (1 - 2 * kept * turns + kept**2)
    scales = np.mean(powers / shapes, axis=1)
    likely = -r.shape[1] * np.sum(np.log(scales[:, None] * shapes), axis=1)
    best, last = int(np.argmax(likely)), int(np.flatnonzero(likely > likely.max() - _REFUSED)[-1])
    return tuple(float(_SHARES[k]) for k in sorted({best, (best + last) // 2, last} - {0}))


def learned_beside(at: Fit, suspects: Sequence[NoiseFinding]) -> tuple[Formulation, Noise, tuple[Note, ...]]:
    """Return the formulation with its unknown noise learned from what the effects of a fit leave, the law, and remarks.

    The first estimate of a column contains the effects that move it, so columns that no effect moves look too noisy.
    """
    formulation = relearned(at.model.formulation, at.at.misclosure, len(at.x))
    model, blamed = Model(formulation, at.model.effects), _sum(*(s.extra for s in suspects))
    calm = fit(model, Noise(extra=blamed), at.x)
    added, _ = sensor_scales(calm)
    calm = fit(model, Noise(extra=_sum(added, blamed)), at.x) if added else calm
    return (formulation, *noise_at(calm, suspects, formulation))


def _sum(*variances: Mapping[str, Array | float]) -> dict[str, Array | float]:
    total: dict[str, Array | float] = {}
    for one in variances:
        for name, size in one.items():
            total[name] = total.get(name, 0.0) + size
    return total


_GRIDDED = 3  # kinds of sensors up to which every combination of scales is tried to begin with


def sensor_scales(at: Fit) -> tuple[dict[str, float], tuple[Note, ...]]:
    """Return what to add to the stated variance of each reading whose kind has the wrong stated noise, and a note."""
    names = at.model.formulation.readings
    kinds = [tuple(sensor.column for sensor in alike) for alike in kinds_of(at.model.formulation.sensors)]
    first, second = pairs_of(at.model.formulation.data)
    if len(first) < thresholds().repeat_pairs or len(kinds) < 2:
        return {}, ()
    shape = at.at.misclosure.shape
    white = at.r.reshape(shape)
    scatter = float(np.median((white[second] - white[first]) ** 2) / 2 / 0.455)
    if np.all(np.abs(white[second] - white[first]) <= ROUNDING):
        return {}, ()  # repeats that are the same tell no noise
    if 1 / thresholds().scatter_asked < scatter < thresholds().scatter_asked:
        return {}, ()
    # what the stated noise of each kind adds to the differences of pairs, (m, c, c); a kind that no pair reads keeps
    # its statement, and so does one of unknown noise whose repeats are mostly the same number
    parts, read = [], []
    data, unknown = at.model.formulation.data, set(unknown_noise_of(at.model.formulation))
    for k, kind in enumerate(kinds):
        own = (at.at.reading_slopes * at.at.sigma[:, None, :])[:, :, [names.index(name) for name in kind]]
        spread = own @ own.transpose(0, 2, 1)
        parts.append(np.asarray((spread[first] + spread[second]) / 2))
        change = np.stack([np.asarray(data[name])[second] - np.asarray(data[name])[first] for name in kind])
        if parts[k].any() and not (set(kind) <= unknown and not np.median(np.abs(change))):
            read.append(k)
    if not read:
        return {}, ()
    tails = thresholds().scale_tails

    def cost(logs: Sequence[float] | Array) -> float:
        covariance = sum(np.exp(2 * log) * parts[k] for log, k in zip(logs, read))
        z, size = _whitened(at, covariance, first, second)
        return float(2 * size + (tails + z.shape[1]) * np.log1p((z**2).sum(axis=1) / tails).sum())

    level = np.log(np.mean((white[second] - white[first]) ** 2) / 2 + 1e-12) / 2
    grid = np.linspace(-1.0, 2.0, 7) * max(abs(level), 1.0) * np.sign(level or 1.0)
    start: Sequence[float] = [float(level)] * len(read)  # of many kinds a grid would cost more than it finds
    if len(read) <= _GRIDDED:
        start = min(product(grid, repeat=len(read)), key=cost)
    best = minimize(cost, np.array(start), method="Nelder-Mead", options={"maxiter": 120})
    scales = [1.0] * len(kinds)
    for k, log in zip(read, best.x):
        scales[k] = float(np.exp(log))
    if len(read) < len(kinds):  # a t law's scale is not a deviation; the others' scales are
        left = _whitened(at, np.asarray(sum(scales[k] ** 2 * parts[k] for k in read)), first, second)[0]
        deviation = float(np.sqrt(np.median(left**2) / 0.455))
        scales = [scale * deviation if k in read else scale for k, scale in enumerate(scales)]
    if max(scales) < thresholds().scale_ratio * min(scales):
        return {}, ()
    extra: dict[str, float] = {}
    for kind, scale in ((kinds[k], scales[k]) for k in read):
        extra |= {name: (scale**2 - 1) * float(np.mean(at.at.sigma[:, names.index(name)] ** 2)) for name in kind}
    each = "; ".join(f"{', '.join(kinds[k])}: {plain(scales[k], 2)} times" for k in read)
    text = f"repeats scatter otherwise than the stated noise ({each}); their scatter is used"
    times = {name: scales[k] for k in read for name in kinds[k]}
    return extra, (Note(Code.NOISE_MISSTATED, text, tuple(times), values=times),)


def _whitened(at: Fit, covariance: Array, first: Array, second: Array) -> tuple[Array, float]:
    """Return the differences of pairs whitened by `covariance` (m, c, c), (m, c), and the logarithm of its root."""
    f = at.at.misclosure
    d = (f[second] - f[first]) / np.sqrt(2)
    lower = np.linalg.cholesky(covariance)
    z = np.linalg.solve(lower, d[:, :, None])[:, :, 0]
    return np.asarray(z), float(np.log(np.diagonal(lower, axis1=1, axis2=2)).sum())


_LEAST_EACH = 3.0  # readings in a level, on average
_APART = 6.0  # times what scatters within them: levels that are nearer are steps of a coarse scale
_STILL = 0.1  # times what is left within a level: so much the reading itself moves there at most
_MOSTLY = 0.5  # of the rms of what is left: so much of it is within levels at least


def exact_readings(at: Fit) -> dict[str, tuple[int, float]]:
    """Return the measured columns that come in exact levels while what a fit leaves is the scatter of the inputs."""
    formulation = at.model.formulation
    names, misclosure = tuple(formulation.readings), np.asarray(at.at.misclosure)
    if not inputs_of(formulation) or misclosure.ndim != 2 or misclosure.shape[1] != len(names):
        return {}
    found = {}
    for k, name in enumerate(names):
        y, left = np.asarray(formulation.data[name], dtype=float), misclosure[:, k]
        rms = float(np.sqrt(np.mean(left**2)))
        order = np.argsort(y, kind="stable")
        gaps = np.diff(y[order])
        level = np.empty(len(y), dtype=int)
        level[order] = np.concatenate([[0], np.cumsum(gaps > 2 * rms)])
        count = int(level.max()) + 1
        if not rms > 0 or count < 2 or len(y) < _LEAST_EACH * count:
            continue
        within = []
        for values in (y, left):
            means = np.bincount(level, values, count) / np.bincount(level, minlength=count)
            within.append(float(np.sqrt(np.mean((values - means[level]) ** 2))))
        own, scatter = within
        nearest = float(gaps[gaps > 2 * rms].min())
        if own <= _STILL * scatter and scatter >= _MOSTLY * rms and nearest >= _APART * scatter:
            found[name] = (count, scatter / max(own, 1e-3 * scatter))
    return found
