"""How much of an effect can be seen: lambda, the rms in sigma of what the best calibration without it leaves.

The residuals are the closure of the fitting rows, whitened by the stated noise carried through it. To first order
lambda is the signature projected off the calibration Jacobian; large effects that calibration nearly absorbs (a disc's
eccentricity: up to 99.6 %) need the refit itself, so that is what is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.blind.gpm2002.machine import ALL_FREE, ANGLE_ONLY_FREE, Array, closure, leg_errors

_STEP = np.array([1e-3] * 12 + [1e-6] * 3)


@dataclass(frozen=True)
class Eye:
    """The whitened closure about one machine and its clean readings (n, 3) and tracked points (n, 2) or None."""

    machine: Array
    readings: Array
    tracker: Array | None
    whitening: Array
    jacobian: Array
    basis: Array

    def residuals(self, machine: Array, readings: Array, tracker: Array | None) -> Array:
        """Return whitened residuals, shape (..., m), of machines (..., 15): m = n, or 3 n with a tracker."""
        if self.tracker is None or tracker is None:
            return closure(machine, readings) * self.whitening
        errors = leg_errors(machine, readings, tracker)
        white = np.einsum("nij,...nj->...ni", self.whitening, errors)
        return white.reshape(*white.shape[:-2], -1)

    @property
    def free(self) -> Array:
        """Indices of the parameters that calibration finds."""
        return ANGLE_ONLY_FREE if self.tracker is None else ALL_FREE

    def slopes(self, machine: Array, readings: Array, tracker: Array | None) -> Array:
        """Return the derivative of the residuals in the free parameters, shape (m, p), by central differences."""
        steps = np.diag(_STEP)[self.free]
        ahead = self.residuals(machine + steps, readings, tracker)
        behind = self.residuals(machine - steps, readings, tracker)
        return (ahead - behind).T / (2 * _STEP[self.free])

    def signature(self, readings: Array, tracker: Array | None) -> Array:
        """Return the whitened residuals of the true machine at disturbed readings, shape (m,)."""
        return self.residuals(self.machine, readings, tracker)

    def left_linear(self, readings: Array, tracker: Array | None) -> float:
        """Return the rms of the signature projected off the Jacobian at the true machine."""
        seen = self.signature(readings, tracker)
        return rms(seen - self.basis @ (self.basis.T @ seen))

    def left(self, readings: Array, tracker: Array | None) -> float:
        """Return the rms that calibration without the effect leaves: Gauss-Newton, its steps halved where it climbs."""
        machine, r = self.machine, self.signature(readings, tracker)
        jacobian, size = self.jacobian, rms(r)
        for _ in range(12):
            scale = np.sqrt((jacobian**2).sum(axis=0))
            gram = (jacobian / scale).T @ (jacobian / scale)
            step = np.linalg.solve(gram, (jacobian / scale).T @ r) / scale
            part = 1.0
            for _ in range(8):
                trial = machine.copy()
                trial[self.free] -= part * step
                r_trial = self.residuals(trial, readings, tracker)
                if rms(r_trial) <= size:
                    break
                part /= 2
            else:
                return size
            gained, machine, r, size = size - rms(r_trial), trial, r_trial, rms(r_trial)
            if gained <= 1e-5 * size:
                break
            jacobian = self.slopes(machine, readings, tracker)
        return size


def open_eye(machine: Array, readings: Array, tracker: Array | None, sigma_enc: float, sigma_xy: float) -> Eye:
    """Return the whitened closure of noise-free `readings` (n, 3) and `tracker` (n, 2) or None."""
    h = 1e-6
    if tracker is None:
        slopes = np.empty_like(readings)
        for i in range(3):
            nudge = h * np.eye(3)[i]
            slopes[:, i] = (closure(machine, readings + nudge) - closure(machine, readings - nudge)) / (2 * h)
        whitening = 1 / (sigma_enc * np.sqrt((slopes**2).sum(axis=1)))
    else:
        angle = (leg_errors(machine, readings + h, tracker) - leg_errors(machine, readings - h, tracker)) / (2 * h)
        k = 1e-4
        point = np.stack(
            [
                (leg_errors(machine, readings, tracker + k * e) - leg_errors(machine, readings, tracker - k * e))
                / (2 * k)
                for e in np.eye(2)
            ],
            axis=-1,
        )
        cov = sigma_xy**2 * np.einsum("nik,njk->nij", point, point)
        cov[:, range(3), range(3)] += sigma_enc**2 * angle**2
        whitening = np.linalg.inv(np.linalg.cholesky(cov))
    blank = np.zeros((0, 0))
    eye = Eye(machine, readings, tracker, whitening, blank, blank)
    jacobian = eye.slopes(machine, readings, tracker)
    basis, _ = np.linalg.qr(jacobian / np.sqrt((jacobian**2).sum(axis=0)))
    return Eye(machine, readings, tracker, whitening, jacobian, basis)


def amplitude_for(wanted: float, seen: Callable[[float], float], typical: float, largest: float) -> tuple[float, float]:
    """Return the amplitude at which seen(a), rising from 0, is `wanted` within 1 %, and what is seen there.

    At `largest` at most: beyond it the machine would be broken, not inaccurate. Secants in the logarithms.
    """
    a, lam = typical, seen(typical)
    best, order = (a, lam), 1.0
    for _ in range(14):
        if lam <= 0 or abs(np.log(best[1] / wanted)) < 0.01:
            break
        move = np.clip(np.log(wanted / lam) / order, -7.0, 7.0)
        new = min(a * np.exp(move), largest)
        if new == a:
            break
        lam_new = seen(new)
        if lam_new > 0 and abs(np.log(new / a)) > 1e-9:
            order = float(np.clip(np.log(lam_new / lam) / np.log(new / a), 0.5, 3.0))
        a, lam = new, lam_new
        if lam > 0 and abs(np.log(lam / wanted)) < abs(np.log(max(best[1], 1e-300) / wanted)):
            best = (a, lam)
    return float(best[0]), float(best[1])


def rms(values: Array) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))
