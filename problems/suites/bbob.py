"""`bbob`: the 24 noiseless functions of COCO (Hansen et al. 2009, 2021), each in instances: shifted, rotated, raised.

The functions are COCO's own, called through its package coco-experiment, which counts the calls too. Box and start are
COCO's: -5 to 5 in every variable, and the origin. The optimum is COCO's, and so are the targets of its data.

Source: Hansen, Auger, Ros, Mersmann, Tusar, Brockhoff (2021). COCO: a platform for comparing continuous optimizers in a
black-box setting. Optimization Methods and Software 36(1), 114-144.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Literal

from calibench.problems.base import frozen, registry
from calibench.problems.suites.black_box import BlackBox, package
from calibench.problems.suites.gaps import COCO_GAPS

Function = Literal[1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24]
_GROUPS = (  # last function of each, as the suite divides them
    (5, "separable"), (9, "moderate"), (14, "ill-conditioned"), (19, "multi-modal"), (24, "weak structure"),
)  # fmt: skip


@registry.register("bbob")
def bbob(function: Function = 1, dimension: Literal[2, 3, 5, 10, 20, 40] = 5, instance: int = 1) -> BlackBox:
    """One of COCO's 24 noiseless functions (bbob), in an instance; needs the package coco-experiment.

    Raises `ValueError` for an instance below 1, and where the package is missing.
    """
    if instance < 1:
        raise ValueError(f"bbob.instance={instance}: must be 1 or above")
    package("cocoex", "coco-experiment", "bbob")
    bare = package("cocoex.bare_problem", "coco-experiment", "bbob").BareProblem("bbob", function, dimension, instance)
    minimum = float(bare.best_value())
    built = _built(function, dimension, instance)
    return BlackBox(
        name="bbob",
        library="coco-experiment",
        options={"function": function, "dimension": dimension, "instance": instance},
        build=partial(_built, function, dimension, instance),
        lower=frozen(built.lower_bounds),
        upper=frozen(built.upper_bounds),
        start=frozen(built.initial_solution),
        default_start="nominal",
        truth=frozen(bare.best_parameter()),
        minimum=minimum,
        targets=targets(minimum),
        group=group(function),
        data_id=str(built.id),
    )


def group(function: int) -> str:
    """Return the group of one of the 24 functions: separable, moderate, ill-conditioned, multi-modal, weak structure.

    >>> group(5), group(6), group(24)
    ('separable', 'moderate', 'weak structure')
    """
    return next(name for last, name in _GROUPS if function <= last)


def targets(minimum: float) -> tuple[float, ...]:
    """Return COCO's 51 levels above `minimum`."""
    return tuple(minimum + gap for gap in COCO_GAPS)


def _built(function: int, dimension: int, instance: int) -> Any:
    """Return COCO's problem. The suite is asked for this one alone: it takes a millisecond."""
    cocoex = package("cocoex", "coco-experiment", "bbob")
    suite = cocoex.Suite("bbob", f"instances: {instance}", f"dimensions: {dimension} function_indices: {function}")
    return suite.get_problem_by_function_dimension_instance(function, dimension, instance)
