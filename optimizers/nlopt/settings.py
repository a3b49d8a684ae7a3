"""What each NLopt algorithm is given: scaling, tolerances, memory, population, and why. The adapter obeys this table.

Every algorithm searches the unit box: rad and mm side by side become shares of their own range. What differs is what
the value's size, a tolerance or a store changes. docs/optimizers.md shows the table; the tests hold its claims.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

ROUNDING = 1e-15
NO_GRADIENT_TEST = 1e-30  # 0 would mean NLopt's own 1e-8


@dataclass(frozen=True, slots=True)
class Setting:
    """How `algorithms` are set, and `why`.

    `size_matters`: the candidates depend on the size of the value, so that the division by its first size is needed;
    where not, it changes no candidate. `parameters` go to NLopt's `set_param`. `step_ends`: when a step below 1e-15
    of the point ends a descent: never, with restarts, or always. `memory`, `population`: in words.
    """

    algorithms: tuple[str, ...]
    why: str
    size_matters: bool = False
    parameters: Mapping[str, float] = field(default_factory=dict)
    step_ends: Literal["never", "restarted", "always"] = "never"
    inner_tolerance: float | None = None
    memory: str = "none to choose"
    population: str = "none"

    @property
    def tolerances(self) -> str:
        """Return the tests that may end a search, in words."""
        tests = [f"`{name}` = {value:g}" for name, value in self.parameters.items()]
        if self.inner_tolerance is not None:
            tests.append(f"`local_tolerance` = {self.inner_tolerance:g} (ftol_rel and xtol_rel of the inner method)")
        if self.step_ends != "never":
            only = " with restarts" if self.step_ends == "restarted" else ""
            tests.append(f"`xtol_rel` = {ROUNDING:g}{only}")
        return ", ".join(tests) if tests else "none"


_RESTARTED = "With `restarts` a step at rounding ends a descent, as some never end by themselves."

SETTINGS = (
    Setting(
        ("GN_DIRECT", "GN_DIRECT_L", "GN_DIRECT_L_RAND", "GN_DIRECT_NOSCAL", "GN_DIRECT_L_NOSCAL",
         "GN_DIRECT_L_RAND_NOSCAL", "GN_ORIG_DIRECT_L"),
        "Rectangles are compared by value and size: a factor on the value changes nothing.",
    ),
    Setting(
        ("GN_ORIG_DIRECT",),
        "Gablonsky's code without the local bias chooses other rectangles when the value is multiplied.",
        size_matters=True,
    ),
    Setting(
        ("GN_CRS2_LM",), "Values are only compared. The population is that of Kaelo and Ali.",
        population="10 (dim + 1)",
    ),
    Setting(
        ("GN_ISRES",), "Values are only compared. The population is NLopt's: it follows the dimension, where Runarsson"
        " and Yao took 200 for all.", population="20 (dim + 1)",
    ),
    Setting(
        ("GN_ESCH",), "Values are only compared. The population is its authors'.", population="40, and 60 children",
    ),
    Setting(("GN_AGS",), "It divides by its own estimate of the slope: a factor on the value changes nothing."),
    Setting(
        ("GD_STOGO", "GD_STOGO_RAND"),
        "Its local search proposes other points when the value is multiplied.",
        size_matters=True,
    ),
    Setting(
        ("GD_MLSL", "GD_MLSL_LDS", "G_MLSL", "G_MLSL_LDS"),
        "A descent that ends at 1e-8 ends above our goals, and the next begins elsewhere: at 1e-15 each goes on to"
        " rounding. The inner method is SLSQP, which needs a value near 1.",
        size_matters=True, inner_tolerance=ROUNDING, population="4 new points a round",
    ),
    Setting(
        ("GN_MLSL", "GN_MLSL_LDS"),
        "As above; the inner method is BOBYQA, whose candidates no factor on the value changes.",
        inner_tolerance=ROUNDING, population="4 new points a round",
    ),
    Setting(
        ("LN_COBYLA", "LN_BOBYQA", "LN_NEWUOA", "LN_NELDERMEAD", "LN_SBPLX"),
        f"Models and simplices scale with the value: a factor on it changes nothing. {_RESTARTED}",
        step_ends="restarted",
    ),
    Setting(
        ("LN_NEWUOA_BOUND",),
        "Its models are minimised by an NLopt method inside, to which the size of the value matters, and which never"
        " ends without a tolerance.",
        size_matters=True, step_ends="always",
    ),
    Setting(
        ("LN_PRAXIS",), f"Its steps change where the value is far below 1. {_RESTARTED}",
        size_matters=True, step_ends="restarted",
    ),
    Setting(
        ("LD_SLSQP",),
        f"Undivided, a value of 1e9 ends it after one evaluation. {_RESTARTED}",
        size_matters=True, step_ends="restarted", memory="the whole Hessian, dim x dim",
    ),
    Setting(
        ("LD_LBFGS", "LD_VAR1", "LD_VAR2", "LD_TNEWTON", "LD_TNEWTON_RESTART", "LD_TNEWTON_PRECOND",
         "LD_TNEWTON_PRECOND_RESTART"),
        "Luksan's codes end where no slope is above `tolg`, an absolute 1e-8: after the division that is far above"
        " rounding, so it is switched off. Undivided, large values bring bad first steps. `storage` null: NLopt keeps"
        f" as many gradients as fit 10 MB or the budget, so none is forgotten. {_RESTARTED}",
        size_matters=True, parameters={"tolg": NO_GRADIENT_TEST}, step_ends="restarted",
        memory="all gradients; `storage` sets fewer",
    ),
    Setting(
        ("LD_MMA", "LD_CCSAQ"),
        "Their first penalty is 1, a size of the value. They end by no test of their own; with `restarts` a step at"
        " rounding ends a descent.",
        size_matters=True, step_ends="restarted",
    ),
    Setting(
        ("AUGLAG", "AUGLAG_EQ", "LD_AUGLAG", "LD_AUGLAG_EQ"),
        f"Without constraints each is its inner method, SLSQP, run to rounding. {_RESTARTED}",
        size_matters=True, inner_tolerance=ROUNDING, step_ends="restarted", memory="the inner method's",
    ),
    Setting(
        ("LN_AUGLAG", "LN_AUGLAG_EQ"),
        f"Without constraints each is its inner method, BOBYQA, run to rounding. {_RESTARTED}",
        inner_tolerance=ROUNDING, step_ends="restarted",
    ),
)  # fmt: skip

SETTING_OF: dict[str, Setting] = {algorithm: setting for setting in SETTINGS for algorithm in setting.algorithms}
