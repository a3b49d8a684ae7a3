"""Three known ways to close a gap between model and data, given the same cases: run in an environment of their own.

- STLSQ, the sequentially thresholded least squares of PySINDy, over the whole catalogue as library; its threshold
  and its ridge are chosen by cross-validation over poses.
- FROLS, the forward orthogonal least squares of SysIdentPy, over the same library; its order by BIC.
- A Gaussian process on the residuals (modular Kennedy-O'Hagan: calibrate first, then learn what is left), an
  anisotropic squared exponential plus noise over all covariates; it names nothing.

The two selectors get more than their users have: whitened residuals, columns already projected off the calibration
parameters, and every formula of our catalogue. Reads the cases that `export` wrote, one .npz each; writes a JSON line
a case and method: prediction-free numbers only, so that nobody needs these packages to make the table.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

FOLDS = 3
SUBSET = 200  # rows on which a process's length scales are found; its prediction uses all rows
THRESHOLDS = (0.1, 0.2, 0.4)  # of a column scaled to rms 1, in sigma
RIDGES = (0.05, 20.0)


def main() -> None:
    """Run every method on every case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", type=Path)
    parser.add_argument("--to", type=Path, required=True)
    arguments = parser.parse_args()
    methods: dict[str, Callable[[dict], tuple[np.ndarray, list[str]]]] = {
        "PySINDy STLSQ": stlsq,
        "SysIdentPy FROLS": frols,
        "Gaussian process": gaussian_process,
    }
    with arguments.to.open("w") as out:
        for path in sorted(arguments.cases.glob("*.npz")):
            case = dict(np.load(path, allow_pickle=False))
            for name, method in methods.items():
                begin = time.process_time()
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # ill-conditioned libraries are these methods' daily bread
                    prediction, named = method(case)
                left = case["residual_hold"] - prediction
                row = {
                    "case": path.stem,
                    "method": name,
                    "mean_square_after": float(np.mean(left**2)),
                    "named": named,
                    "cpu_s": time.process_time() - begin,
                }
                print(json.dumps(row), file=out, flush=True)


def stlsq(case: dict) -> tuple[np.ndarray, list[str]]:
    """Return the held-out prediction (m,) and the effects kept, the largest first."""
    import pysindy

    scale = _rms(case["columns"])
    train, hold, y = case["columns"] / scale, case["columns_hold"] / scale, case["residual"]

    def fit(rows: np.ndarray, threshold: float, ridge: float) -> np.ndarray:
        Q, R = np.linalg.qr(train[rows])  # the same least squares in fewer rows
        optimizer = pysindy.STLSQ(threshold=threshold, alpha=ridge, max_iter=50)
        optimizer.fit(R, (Q.T @ y[rows])[:, None])
        return np.asarray(optimizer.coef_[0])

    folds = np.unique(case["pose"], return_inverse=True)[1] % FOLDS
    choices = [(threshold, ridge) for threshold in THRESHOLDS for ridge in RIDGES]
    errors = [
        sum(np.sum((y[folds == k] - train[folds == k] @ fit(folds != k, *choice)) ** 2) for k in range(FOLDS))
        for choice in choices
    ]
    c = fit(np.ones(len(y), dtype=bool), *choices[int(np.argmin(errors))])
    return hold @ c, _largest_first(case["effect"], np.abs(c))


def frols(case: dict) -> tuple[np.ndarray, list[str]]:
    """Return the held-out prediction (m,) and the effects selected, in order of selection."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS

    scale = _rms(case["columns"])
    train, hold, y = case["columns"] / scale, case["columns_hold"] / scale, case["residual"]
    model = FROLS(
        order_selection=True, n_info_values=12, info_criteria="bic", ylag=1, xlag=[[1]] * train.shape[1],
        model_type="NFIR", basis_function=Polynomial(degree=1),
    )  # fmt: skip
    model.fit(X=np.vstack([train, train[-1:]]), y=np.concatenate([[0.0], y])[:, None])  # its inputs act one row later
    codes = np.asarray(model.final_model)[:, 0]
    theta = np.asarray(model.theta).ravel()
    prediction, named = np.zeros(len(hold)), []
    for code, coefficient in zip(codes, theta, strict=True):
        if code == 0:  # the constant
            prediction += coefficient
            continue
        column = int(code) // 1000 - 2
        prediction += coefficient * hold[:, column]
        named.append(str(case["effect"][column]))
    return prediction, list(dict.fromkeys(named))


def gaussian_process(case: dict) -> tuple[np.ndarray, list[str]]:
    """Return the held-out prediction (m,), constraint by constraint, and no name."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    prediction = np.zeros(len(case["residual_hold"]))
    centre, scale = case["features"].mean(axis=0), np.maximum(case["features"].std(axis=0), 1e-12)
    for output in np.unique(case["output"]):
        rows, held = case["output"] == output, case["output_hold"] == output
        kernel = ConstantKernel(1.0, (1e-3, 1e3)) * RBF(
            np.full(case["features"].shape[1], 3.0), (0.3, 1e3)
        ) + WhiteKernel(1.0, (0.2, 20.0))
        X, y = (case["features"][rows] - centre) / scale, case["residual"][rows]
        some = np.random.default_rng(0).permutation(len(y))[:SUBSET]
        kernel = GaussianProcessRegressor(kernel, random_state=0).fit(X[some], y[some]).kernel_
        model = GaussianProcessRegressor(kernel, optimizer=None).fit(X, y)
        prediction[held] = model.predict((case["features_hold"][held] - centre) / scale)
    return prediction, []


def _rms(columns: np.ndarray) -> np.ndarray:
    return np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-300)


def _largest_first(names: np.ndarray, sizes: np.ndarray) -> list[str]:
    order = np.argsort(-sizes)
    return list(dict.fromkeys(str(names[i]) for i in order if sizes[i] > 0))


if __name__ == "__main__":
    main()
