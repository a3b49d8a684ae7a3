"""Plain SciPy, as who calibrates without a package writes it: kinematics of one's own in NumPy, and `least_squares`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import arm6
import numpy as np
from answering import ROOT, answer, timed
from scipy.optimize import least_squares


def _planar(method: str, work: Mapping[str, Any]) -> dict[str, Any]:
    """Calibrate the planar robot; of our package only the readings, box and start are taken."""
    sys.path.append(str(ROOT))
    from calibench import problems

    problem = problems.make("full12", **work["options"])
    theta, template, free = problem.readings.T, problem._template.copy(), problem._free

    def residuals(x: Any) -> Any:
        """Return 2 times the closure of the third leg where the first two meet (Cong et al. 2008, eqs. 30 to 39)."""
        q = template.copy()
        q[free] = x
        la, lb, zero = q[6:9, None], q[9:12, None], q[12:15, None]
        b = q[0:6].reshape(3, 2).T[:, :, None] + la * np.array([np.cos(theta + zero), np.sin(theta + zero)])
        bx, by = b
        ux, uy, vx, vy = bx[1] - bx[0], by[1] - by[0], bx[2] - bx[0], by[2] - by[0]
        f = 0.5 * (ux**2 + uy**2 + lb[0] ** 2 - lb[1] ** 2)
        h = 0.5 * (vx**2 + vy**2 + lb[0] ** 2 - lb[2] ** 2)
        d = ux * vy - uy * vx
        px, py = (f * vy - h * uy) / d, (h * ux - f * vx) / d
        return np.sqrt(3) * (px**2 + py**2 - lb[0] ** 2)

    np.testing.assert_allclose(residuals(problem.start), problem.residuals(problem.start), rtol=1e-8)
    found: list[Any] = []

    def calibrated() -> int:
        box = {} if method == "lm" else {"bounds": (problem.lower, problem.upper)}
        found.append(least_squares(residuals, problem.start, method=method, x_scale="jac", **box))
        return 1

    taken = timed(calibrated)
    return {**taken, "note": f"differences, {found[0].nfev} steps, sum of squares left {2 * found[0].cost:.1g}"}


def _arm(work: Mapping[str, Any]) -> dict[str, Any]:
    q, measured = arm6.seen()
    found: list[Any] = []

    def calibrated() -> int:
        found.append(
            least_squares(lambda x: (arm6.positions(x.reshape(6, 6), q) - measured).ravel(), np.zeros(36), method="trf")
        )
        return 1

    taken = timed(calibrated)
    return {
        **taken,
        "note": f"36 placement errors, differences, largest residual {np.abs(found[0].fun).max() * 1e3:.1g} mm",
    }


LINES: dict[str, dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]]] = {
    "calibration": {"plain SciPy, lm": partial(_planar, "lm"), "plain SciPy, trf": partial(_planar, "trf")},
    "arm": {"plain SciPy, trf": _arm},
}

if __name__ == "__main__":
    answer(LINES)
