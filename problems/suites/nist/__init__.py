"""The 27 certified nonlinear regressions of NIST's Statistical Reference Datasets (StRD).

`models` says which data set has which model, `regression` reads the data and is the problem.
"""

from calibench.problems.suites.nist.regression import NistRegression, nist

__all__ = ["NistRegression", "nist"]
