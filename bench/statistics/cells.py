"""What a cell is: runs that differ in nothing but their repetition. Every statistic is of one cell, never of a mixture.

A problem is its name with its options and data, a method an optimiser with its options; a cell is both under one start,
budget and target. A task is what methods are compared on: a problem under one start, budget and goal.
"""

from __future__ import annotations

PROBLEM = ["problem", "problem_options", "data_id"]
METHOD = ["optimizer", "optimizer_options"]
SETTING = ["start", "budget", "target"]
CELL = [*PROBLEM, *METHOD, *SETTING]
TASK = [
    *PROBLEM,
    "start",
    "budget",
    "goal",
]  # the goal, not the target: who stops there is compared too
