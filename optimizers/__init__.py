"""Optimisers with one common interface. They know no problem and no budget.

>>> from calibench import optimizers
>>> optimizers.make("de", population=40).traits.minimum_budget
40
"""

from importlib.util import find_spec
from typing import TYPE_CHECKING

from calibench.core.lazy import loader, public_names
from calibench.optimizers.base import (
    BudgetExhausted,
    Objective,
    Optimizer,
    Stop,
    TargetReached,
    TimeUp,
    Traits,
    registry,
)

if TYPE_CHECKING:
    from calibench.optimizers import fmincon, least_squares, nlopt, own, pygmo, scipy  # noqa: F401

_NLOPT = """
    GN_DIRECT GN_DIRECT_L GN_DIRECT_L_RAND GN_DIRECT_NOSCAL GN_DIRECT_L_NOSCAL GN_DIRECT_L_RAND_NOSCAL GN_ORIG_DIRECT
    GN_ORIG_DIRECT_L GN_CRS2_LM GN_ISRES GN_ESCH GN_AGS GD_STOGO GD_STOGO_RAND GN_MLSL GD_MLSL GN_MLSL_LDS GD_MLSL_LDS
    G_MLSL G_MLSL_LDS LN_COBYLA LN_BOBYQA LN_NEWUOA LN_NEWUOA_BOUND LN_NELDERMEAD LN_SBPLX LN_PRAXIS LD_SLSQP LD_LBFGS
    LD_VAR1 LD_VAR2 LD_TNEWTON LD_TNEWTON_RESTART LD_TNEWTON_PRECOND LD_TNEWTON_PRECOND_RESTART LD_MMA LD_CCSAQ AUGLAG
    AUGLAG_EQ LN_AUGLAG LN_AUGLAG_EQ LD_AUGLAG LD_AUGLAG_EQ
"""
_PYGMO = """
    de sade de1220 pso pso_gen sga bee_colony gaco gwo cmaes xnes ihs
    compass_search simulated_annealing sea ipopt mbh
"""
_SCIPY = """
    nelder_mead powell cg bfgs l_bfgs_b tnc cobyla cobyqa slsqp trust_constr newton_cg trust_ncg
    trust_exact dogleg differential_evolution dual_annealing basinhopping shgo direct brute
"""
_MODULES = ("own", "fmincon", "least_squares", "scipy", "nlopt", "pygmo")
registry.promise("calibench.optimizers.own", "de", "ga", "nine_point", "pso")
registry.promise("calibench.optimizers.fmincon", "fmincon")
registry.promise("calibench.optimizers.least_squares", "lm", "trf", "dogbox")
registry.promise("calibench.optimizers.scipy", *(f"scipy_{one}" for one in _SCIPY.split()))
registry.promise("calibench.optimizers.nlopt", *(f"nlopt_{one}" for one in _NLOPT.split()))
registry.promise("calibench.optimizers.pygmo", *(f"pygmo_{one}" for one in _PYGMO.split()))
for _name, _package in (("dfols", "dfols"), ("pycma_cmaes", "cma")):
    if find_spec(_package):
        registry.promise("calibench.optimizers.extras", _name)
    else:
        registry.exclude(_name, f"its package {_package} is not installed here: pip install 'calibench[methods]'")
for _name, _reason in (
    ("pybobyqa", "NLopt's LN_BOBYQA and SciPy's COBYQA are the same kind of search"),
    ("optuna", "its samplers are for tens of evaluations of what takes minutes; it tunes options here (tuner=)"),
):
    registry.exclude(_name, _reason)

make = registry.make
names = registry.names

__all__ = [
    "BudgetExhausted", "Objective", "Optimizer", "Stop", "TargetReached", "TimeUp", "Traits", "make", "names",
    "registry",
]  # fmt: skip

__getattr__ = loader("calibench.optimizers", {}, _MODULES)  # a start loads the optimisers that it asks for

__dir__ = public_names(__all__)
if __name__ == "optimizers":  # a short name, in a checkout: public names only, as a module has its whole name alone
    __path__ = []
