"""Run another tool on exported cases, in an environment of its own: `PYTHON rivals.py TOOL FOLDER`.

Each is used as its pages show: PySINDy with polynomials to degree 2 and Fourier terms to order 3, sequentially
thresholded least squares with the threshold chosen on a fifth of the rows; SysIdentPy's FROLS with polynomials of
degree 2 over the columns and their sines and cosines, the length by AIC; ADCD additively, without a language model.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np


def _scaled(train: Any, hold: Any) -> tuple[Any, Any]:
    size = np.maximum(np.abs(train).max(axis=0), 1e-300)
    wide = (train.max(axis=0) - train.min(axis=0) > 1.0) & (np.abs(train).max(axis=0) < 7)  # angles stay as they are
    size = np.where(wide, 1.0, size)
    return train / size, hold / size


def pysindy(X: Any, e: Any, H: Any) -> tuple[Any, Any]:
    """Return the errors of the rows of X and H that a sparse sum of library terms predicts."""
    import pysindy as ps

    library = ps.PolynomialLibrary(degree=2) + ps.FourierLibrary(n_frequencies=3)
    kept = np.arange(len(X)) % 5 != 0
    scale = float(np.std(e)) or 1.0
    best, chosen = np.inf, None
    for threshold in (0.02, 0.05, 0.1, 0.2, 0.4):
        model = ps.SINDy(optimizer=ps.STLSQ(threshold=threshold, alpha=0.05), feature_library=library)
        model.fit(X[kept], t=1.0, x_dot=(e[kept] / scale)[:, None])
        error = float(np.mean((np.asarray(model.predict(X[~kept])).ravel() - e[~kept] / scale) ** 2))
        if error < best:
            best, chosen = error, threshold
    model = ps.SINDy(optimizer=ps.STLSQ(threshold=chosen, alpha=0.05), feature_library=library)
    model.fit(X, t=1.0, x_dot=(e / scale)[:, None])
    return tuple(scale * np.asarray(model.predict(part)).ravel() for part in (X, H))


def sysidentpy(X: Any, e: Any, H: Any) -> tuple[Any, Any]:
    """Return the errors that an orthogonal forward regression predicts."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    def wide(part: Any) -> Any:
        angles = [part[:, k] for k in range(part.shape[1]) if np.abs(X[:, k]).max() > 1.01]
        waves = [f(k * u) for u in angles for k in (1, 2, 3) for f in (np.sin, np.cos)]
        return np.column_stack([part, *waves]) if waves else part

    U, V, scale = wide(X), wide(H), float(np.std(e)) or 1.0

    def late(part: Any, y: Any) -> tuple[Any, Any]:  # its inputs are those of the row before: one row later
        return np.vstack([part, part[-1:]]), np.concatenate([y[:1], y])[:, None]

    lags = [[1] for _ in range(U.shape[1])]
    model = FROLS(order_selection=True, n_info_values=12, info_criteria="aic", xlag=lags, ylag=1, model_type="NFIR",
                  basis_function=Polynomial(degree=2), estimator=LeastSquares())  # fmt: skip
    x, y = late(U, e / scale)
    model.fit(X=x, y=y)
    return tuple(
        scale
        * np.asarray(model.predict(X=late(part, np.zeros(len(part)))[0], y=np.zeros((len(part) + 1, 1)))).ravel()[1:]
        for part in (U, V)
    )


def adcd(X: Any, e: Any, H: Any) -> tuple[Any, Any]:
    """Return the errors that the best proposed correction predicts."""
    import adcd as tool
    import sympy as sp

    columns = {f"x{k}": X[:, k] for k in range(X.shape[1])}
    scale = float(np.std(e)) or 1.0
    found = tool.fit(columns, e / scale, np.zeros(len(e)), limit_variable="x0", correction_mode="additive",
                     proposer="mock", verbose=False, max_iterations=3)  # fmt: skip
    if not str(found.best_expr):
        return np.zeros(len(X)), np.zeros(len(H))  # nothing was proposed that it keeps
    expression = sp.sympify(str(found.best_expr)).subs(
        {str(k): float(v) for k, v in dict(found.best_theta or {}).items()}
    )
    names = sorted(map(str, expression.free_symbols))
    f = sp.lambdify(names, expression, "numpy")
    return tuple(
        scale * np.broadcast_to(f(*[part[:, int(n[1:])] for n in names]), len(part)).astype(float) for part in (X, H)
    )


TOOLS: dict[str, Callable[[Any, Any, Any], tuple[Any, Any]]] = {
    "pysindy": pysindy, "sysidentpy": sysidentpy, "adcd": adcd
}  # fmt: skip

if __name__ == "__main__":
    tool, folder = sys.argv[1], Path(sys.argv[2])
    for path in sorted(folder.glob("*.npz")):
        if "_" in path.stem:
            continue
        d = np.load(path)
        X, H = _scaled(d["train_X"], d["hold_X"])
        began = time.process_time()
        try:
            train, hold = TOOLS[tool](X, d["train_e"], H)
            answer = {"train": train, "hold": hold}
        except Exception as error:
            print(path.stem, type(error).__name__, str(error)[:300], flush=True)
            answer = {}
        np.savez(folder / f"{path.stem}_{tool}.npz", seconds=time.process_time() - began, **answer)
