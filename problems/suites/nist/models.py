"""Which data set has which model, by NIST's names: the value, its slopes, and how the readings are taken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np

from calibench.problems.base import Array
from calibench.problems.suites.nist import exponential as e
from calibench.problems.suites.nist import miscellaneous as m
from calibench.problems.suites.nist import rational as r

Formula = Callable[[Array, Array], Array]


@final
@dataclass(frozen=True)
class Model:
    """A regression: ``value(b, x)``, shape (m,), is fitted to ``response(y)``; ``slopes(b, x)``, (m, dim)."""

    value: Formula
    slopes: Formula
    response: Callable[[Array], Array] = np.asarray


MODELS = {
    "Misra1a": Model(e.saturation, e.saturation_slopes),
    "Chwirut2": Model(e.damped_fraction, e.damped_fraction_slopes),
    "Chwirut1": Model(e.damped_fraction, e.damped_fraction_slopes),
    "Lanczos3": Model(e.three_decays, e.three_decays_slopes),
    "Gauss1": Model(e.decay_and_two_peaks, e.decay_and_two_peaks_slopes),
    "Gauss2": Model(e.decay_and_two_peaks, e.decay_and_two_peaks_slopes),
    "DanWood": Model(m.power, m.power_slopes),
    "Misra1b": Model(m.inverse_square, m.inverse_square_slopes),
    "Kirby2": Model(r.quadratics, r.quadratics_slopes),
    "Hahn1": Model(r.cubics, r.cubics_slopes),
    "Nelson": Model(e.degradation, e.degradation_slopes, response=np.log),
    "MGH17": Model(e.two_decays, e.two_decays_slopes),
    "Lanczos1": Model(e.three_decays, e.three_decays_slopes),
    "Lanczos2": Model(e.three_decays, e.three_decays_slopes),
    "Gauss3": Model(e.decay_and_two_peaks, e.decay_and_two_peaks_slopes),
    "Misra1c": Model(m.inverse_root, m.inverse_root_slopes),
    "Misra1d": Model(m.adsorption, m.adsorption_slopes),
    "Roszman1": Model(m.quantum_defect, m.quantum_defect_slopes),
    "ENSO": Model(m.three_cycles, m.three_cycles_slopes),
    "MGH09": Model(r.enzyme, r.enzyme_slopes),
    "Thurber": Model(r.cubics, r.cubics_slopes),
    "BoxBOD": Model(e.saturation, e.saturation_slopes),
    "Rat42": Model(e.logistic, e.logistic_slopes),
    "MGH10": Model(e.thermistor, e.thermistor_slopes),
    "Eckerle4": Model(e.normal_peak, e.normal_peak_slopes),
    "Rat43": Model(e.richards, e.richards_slopes),
    "Bennett5": Model(m.magnetisation, m.magnetisation_slopes),
}
