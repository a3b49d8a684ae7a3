"""SciPy's minimisers, each by SciPy's own name in lower case: ``scipy_l_bfgs_b`` is L-BFGS-B.

`settings` says what each is given and why, `adapter` runs one, `methods` registers them. Its least squares, which take
residuals, are `calibench.optimizers.least_squares`.
"""

from calibench.optimizers.scipy import methods  # noqa: F401  (they register themselves)
