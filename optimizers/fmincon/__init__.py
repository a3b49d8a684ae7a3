"""`fmincon`: MATLAB's names, tests and exit flags over SciPy's SLSQP and trust-constr.

`direct` is the direct call, `method` the same search as a registered optimiser. The mathematics is SciPy's; ours are
MATLAB's names (`options`), tests and exit flags (`search`), and `constraints`. See docs/fmincon.md.
"""

from typing import TYPE_CHECKING

from calibench.core.lazy import loader, public_names
from calibench.optimizers.fmincon.method import Fmincon
from calibench.optimizers.fmincon.options import Options, optimoptions

if TYPE_CHECKING:
    from calibench.optimizers.fmincon.direct import Multipliers, Output, Result, fmincon
    from calibench.optimizers.fmincon.search import OptimValues

__all__ = ["Fmincon", "Multipliers", "OptimValues", "Options", "Output", "Result", "fmincon", "optimoptions"]

_HOMES = dict.fromkeys(("Multipliers", "Output", "Result", "fmincon"), "direct") | {"OptimValues": "search"}
__getattr__ = loader(__name__, _HOMES)  # as every start lists the names of all that there is


__dir__ = public_names(__all__)
