"""`fmincon`: MATLAB's names, tests and exit flags over SciPy's SLSQP and trust-constr.

The direct call is `fmincon(fun, x0, ...)`; the registered optimiser of the same name goes through the gate. See
docs/fmincon.md.
"""

from calibench.optimizers.fmincon.method import (
    Fmincon,
    Multipliers,
    OptimValues,
    Options,
    Output,
    Result,
    fmincon,
    optimoptions,
)

__all__ = ["Fmincon", "Multipliers", "OptimValues", "Options", "Output", "Result", "fmincon", "optimoptions"]
