"""The noise at a fit: as stated, as repeats of readings correct it, or learned from what the fit leaves.

`sound_fit` corrects the stated noise where repeats contradict that of some sensors, `noise_at` returns the law that all
repeats show, and `learned_beside` learns noise that nobody states from what found effects leave.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from calibench.discrepancy.diagnostics.noise_diagnostic import coarse_sensors, outlying
from calibench.discrepancy.diagnostics.sensor_scale import sensor_scales
from calibench.discrepancy.fitting.fit import Fit, fit
from calibench.discrepancy.model.formulations.learned_noise import relearned, told_by_middle
from calibench.discrepancy.model.machine import Formulation
from calibench.discrepancy.model.measured.data import NO_REPEATS
from calibench.discrepancy.model.model import Model
from calibench.discrepancy.model.roles import unknown_noise_of
from calibench.discrepancy.noise.mixture import NoiseFinding
from calibench.discrepancy.noise.repeats import Repeats, law_of
from calibench.discrepancy.noise.whiten import Noise
from calibench.problems.base import Array


def sound_fit(plain: Fit) -> tuple[Fit, tuple[NoiseFinding, ...], tuple[str, ...]]:
    """Return the fit with its noise corrected where repeats contradict the stated one; the suspected sensors; notes."""
    at = plain
    added, notes = sensor_scales(plain)
    if added:
        at = fit(plain.model, Noise(extra=added), plain.x)
    suspects = coarse_sensors(at)
    if suspects:
        at = fit(plain.model, Noise(extra=_sum(added, *(s.extra for s in suspects))), plain.x)
    outside = outlying(at)
    wild = [s.extra for s in outside if s.family == "outlier"]
    if wild:
        at = fit(plain.model, Noise(extra=_sum(at.noise.extra, *wild)), at.x)
    return at, (*suspects, *outside), notes if _stated(plain.model.formulation) else ()


def law_at(at: Fit) -> tuple[Noise, Repeats, tuple[str, ...]]:
    """Return the law of the noise that repeats show in what a fit leaves, the repeats, and remarks on it."""
    formulation = at.model.formulation
    return law_of(at.r.reshape(len(formulation.data), -1), formulation.data, _stated(formulation))


def noise_at(sound: Fit, suspects: Sequence[NoiseFinding], whole: Formulation) -> tuple[Noise, tuple[str, ...]]:
    """Return the noise that repeated readings show, and remarks on it. `whole` has the held-out rows too."""
    data, unknown = sound.model.formulation.data, unknown_noise_of(whole)
    noise, told, remarks = law_at(sound)
    if told.few and NO_REPEATS in whole.data.noted:
        remarks = ()  # the machine has its own remark on it
    if any(s.family == "quantisation" for s in suspects):
        noise, remarks = Noise(), ()  # coarse readings repeat the same value, so repeats tell nothing about their noise
    noise = replace(noise, extra=sound.noise.extra)
    if unknown and (_stated(whole) or not noise.from_repeats):
        behind = max(len(unknown) * told_by_middle(len(data), sound.J.shape[1] / len(whole.readings)), told.n_pairs)
        noise = replace(noise, profiled=True, known=min(noise.known, behind))
    return noise, remarks


def learned_beside(at: Fit, suspects: Sequence[NoiseFinding]) -> tuple[Formulation, Noise, tuple[str, ...]]:
    """Return the formulation with its unknown noise learned from what the effects of a fit leave, the law, and remarks.

    The first estimate of a column contains the effects that move it. The tests take all residuals to have equal
    variance, so the columns that no effect moves would look too noisy, and a right name would leave something.
    """
    formulation = relearned(at.model.formulation, at.at.misclosure, len(at.x))
    model, blamed = Model(formulation, at.model.effects), _sum(*(s.extra for s in suspects))
    calm = fit(model, Noise(extra=blamed), at.x)
    added, _ = sensor_scales(calm)
    calm = fit(model, Noise(extra=_sum(added, blamed)), at.x) if added else calm
    return (formulation, *noise_at(calm, suspects, formulation))


def _stated(formulation: Formulation) -> bool:
    """Return whether the noise of any reading is stated."""
    return len(unknown_noise_of(formulation)) < len(formulation.readings)


def _sum(*variances: Mapping[str, Array | float]) -> dict[str, Array | float]:
    total: dict[str, Array | float] = {}
    for one in variances:
        for name, variance in one.items():
            total[name] = total.get(name, 0.0) + variance
    return total
