"""Constrained problems with known optimum and multipliers, as `fmincon` takes them.

From Hock and Schittkowski, Test Examples for Nonlinear Programming Codes (1981), by number; multipliers follow from the
KKT conditions at the printed optimum and carry MATLAB's signs. The two quadratic programmes are solved by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Example:
    """One problem: `given` are the arguments of fmincon after x0, `multipliers` its fields that are not zero."""

    name: str
    fun: Callable[[Any], float]
    gradient: Callable[[Any], Any]
    x0: list[float]
    x: list[float]
    f: float
    given: Mapping[str, Any] = field(default_factory=dict)
    constraint_gradients: Callable[[Any], Any] | None = None
    multipliers: Mapping[str, list[float]] = field(default_factory=dict)


_R3, _R5 = np.sqrt(3.0), np.sqrt(5.0)

EXAMPLES = [
    Example(
        "HS6",
        lambda x: (1 - x[0]) ** 2,
        lambda x: [-2 * (1 - x[0]), 0.0],
        [-1.2, 1.0],
        [1.0, 1.0],
        0.0,
        {"nonlcon": lambda x: ([], [10 * (x[1] - x[0] ** 2)])},
        lambda x: ([], [[-20 * x[0]], [10.0]]),
        {"eqnonlin": [0.0]},
    ),
    Example(
        "HS7",
        lambda x: np.log(1 + x[0] ** 2) - x[1],
        lambda x: [2 * x[0] / (1 + x[0] ** 2), -1.0],
        [2.0, 2.0],
        [0.0, _R3],
        -_R3,
        {"nonlcon": lambda x: ([], [(1 + x[0] ** 2) ** 2 + x[1] ** 2 - 4])},
        lambda x: ([], [[4 * x[0] * (1 + x[0] ** 2)], [2 * x[1]]]),
        {"eqnonlin": [1 / (2 * _R3)]},  # 1 = lambda 2 x2
    ),
    Example(
        "HS21",
        lambda x: 0.01 * x[0] ** 2 + x[1] ** 2 - 100,
        lambda x: [0.02 * x[0], 2 * x[1]],
        [-1.0, -1.0],
        [2.0, 0.0],
        -99.96,
        {"A": [[-10.0, 1.0]], "b": [-10.0], "lb": [2.0, -50.0], "ub": [50.0, 50.0]},
        multipliers={"lower": [0.04, 0.0]},
    ),
    Example(
        "HS24",
        lambda x: ((x[0] - 3) ** 2 - 9) * x[1] ** 3 / (27 * _R3),
        lambda x: [2 * (x[0] - 3) * x[1] ** 3 / (27 * _R3), ((x[0] - 3) ** 2 - 9) * x[1] ** 2 / (9 * _R3)],
        [1.0, 0.5],
        [3.0, _R3],
        -1.0,
        {"A": [[-1 / _R3, 1.0], [-1.0, -_R3], [1.0, _R3]], "b": [0.0, 0.0, 6.0], "lb": [0.0, 0.0]},
        # grad f = (0, -sqrt 3) = -(-1/sqrt 3, 1) l1 - (1, sqrt 3) l3
        multipliers={"ineqlin": [_R3 / 2, 0.0, 0.5]},
    ),
    Example(
        "HS28",
        lambda x: (x[0] + x[1]) ** 2 + (x[1] + x[2]) ** 2,
        lambda x: [2 * (x[0] + x[1]), 2 * (x[0] + 2 * x[1] + x[2]), 2 * (x[1] + x[2])],
        [-4.0, 1.0, 1.0],
        [0.5, -0.5, 0.5],
        0.0,
        {"Aeq": [[1.0, 2.0, 3.0]], "beq": [1.0]},
        multipliers={"eqlin": [0.0]},
    ),
    Example(
        "HS35",
        lambda x: (
            9 - 8 * x[0] - 6 * x[1] - 4 * x[2] + 2 * x[0] ** 2 + 2 * x[1] ** 2 + x[2] ** 2 + 2 * x[0] * (x[1] + x[2])
        ),
        lambda x: [-8 + 4 * x[0] + 2 * x[1] + 2 * x[2], -6 + 4 * x[1] + 2 * x[0], -4 + 2 * x[2] + 2 * x[0]],
        [0.5, 0.5, 0.5],
        [4 / 3, 7 / 9, 4 / 9],
        1 / 9,
        {"A": [[1.0, 1.0, 2.0]], "b": [3.0], "lb": [0.0, 0.0, 0.0]},
        multipliers={"ineqlin": [2 / 9]},
    ),
    Example(
        "HS43 (Rosen-Suzuki)",
        lambda x: x[0] ** 2 + x[1] ** 2 + 2 * x[2] ** 2 + x[3] ** 2 - 5 * x[0] - 5 * x[1] - 21 * x[2] + 7 * x[3],
        lambda x: [2 * x[0] - 5, 2 * x[1] - 5, 4 * x[2] - 21, 2 * x[3] + 7],
        [0.0, 0.0, 0.0, 0.0],
        [0.0, 1.0, 2.0, -1.0],
        -44.0,
        {
            "nonlcon": lambda x: (
                [
                    x @ x + x[0] - x[1] + x[2] - x[3] - 8,
                    x[0] ** 2 + 2 * x[1] ** 2 + x[2] ** 2 + 2 * x[3] ** 2 - x[0] - x[3] - 10,
                    2 * x[0] ** 2 + x[1] ** 2 + x[2] ** 2 + 2 * x[0] - x[1] - x[3] - 5,
                ],
                [],
            )
        },
        lambda x: (
            np.column_stack(
                [
                    [2 * x[0] + 1, 2 * x[1] - 1, 2 * x[2] + 1, 2 * x[3] - 1],
                    [2 * x[0] - 1, 4 * x[1], 2 * x[2], 4 * x[3] - 1],
                    [4 * x[0] + 2, 2 * x[1] - 1, 2 * x[2], -1.0],
                ]
            ),
            [],
        ),
        {"ineqnonlin": [1.0, 0.0, 2.0]},
    ),
    Example(
        "HS71",
        lambda x: x[0] * x[3] * (x[0] + x[1] + x[2]) + x[2],
        lambda x: [x[3] * (2 * x[0] + x[1] + x[2]), x[0] * x[3], x[0] * x[3] + 1, x[0] * (x[0] + x[1] + x[2])],
        [1.0, 5.0, 5.0, 1.0],
        [1.0, 4.742999637, 3.821149979, 1.379408293],
        17.014017289,
        {
            "lb": [1.0] * 4,
            "ub": [5.0] * 4,
            "nonlcon": lambda x: ([25 - x[0] * x[1] * x[2] * x[3]], [x @ x - 40]),
        },
        lambda x: (-np.prod(x) / x[:, None], 2 * x[:, None]),
        # the KKT system at the optimum to 12 digits; IPOPT's tutorial prints 0.55229366, -0.16146857, 1.08787121
        {"lower": [1.08787121, 0, 0, 0], "ineqnonlin": [0.55229366], "eqnonlin": [0.16146857]},
    ),
    Example(
        "HS76",
        lambda x: (
            x[0] ** 2
            + 0.5 * x[1] ** 2
            + x[2] ** 2
            + 0.5 * x[3] ** 2
            - x[0] * x[2]
            + x[2] * x[3]
            - x[0]
            - 3 * x[1]
            + x[2]
            - x[3]
        ),
        lambda x: [2 * x[0] - x[2] - 1, x[1] - 3, 2 * x[2] - x[0] + x[3] + 1, x[3] + x[2] - 1],
        [0.5, 0.5, 0.5, 0.5],
        [3 / 11, 23 / 11, 0.0, 6 / 11],
        -103 / 22,
        {
            "A": [[1.0, 2.0, 1.0, 1.0], [3.0, 1.0, 2.0, -1.0], [0.0, -1.0, -4.0, 0.0]],
            "b": [5.0, 4.0, -1.5],
            "lb": [0.0] * 4,
        },
        # active: the first row and x3 = 0; rows 1 and 4 of grad f + A^T l: 6/11 - 1 + l1 = 0
        multipliers={"ineqlin": [5 / 11, 0.0, 0.0], "lower": [0.0, 0.0, 19 / 11, 0.0]},
    ),
    Example(
        "QP of every kind",  # x = (1, 2, 0): min |x - (3, 2, -1)|^2 / 2
        lambda x: 0.5 * ((x[0] - 3) ** 2 + (x[1] - 2) ** 2 + (x[2] + 1) ** 2),
        lambda x: [x[0] - 3, x[1] - 2, x[2] + 1],
        [0.2, 0.3, 0.5],
        [1.0, 2.0, 0.0],
        2.5,
        {"Aeq": [[1.0, 1.0, 1.0]], "beq": [3.0], "lb": [-9.0, -9.0, 0.0], "ub": [1.0, 9.0, 9.0]},
        # (-2, 0, 1) + l_eq (1, 1, 1) - lower + upper = 0
        multipliers={"eqlin": [0.0], "lower": [0.0, 0.0, 1.0], "upper": [2.0, 0.0, 0.0]},
    ),
]
