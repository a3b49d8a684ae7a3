"""The 27 certified nonlinear regressions of NIST's Statistical Reference Datasets (StRD).

`tables` reads the data and the certified values as NIST prints them, `exponential`, `rational` and `miscellaneous` hold
the models by NIST's classes, `models` says which data set has which, `regression` is the problem.
"""

from calibench.problems.suites.nist.regression import NistRegression, nist

__all__ = ["NistRegression", "nist"]
