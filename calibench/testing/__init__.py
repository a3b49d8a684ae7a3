"""The laws that your own problem, optimiser, effect or machine must keep, as checks that you can run.

`check_problem`, `check_optimizer`, `check_effect` and `check_machine` raise `AssertionError` at the first law that is
broken, in one line: the law, what was found, what to do. What takes longer than `time_limit` seconds in all, or a
gigabyte, breaks the law that is tried. ``problem_checks(p)`` and its sisters return pairs (name, check) for a test
runner:

    @pytest.mark.parametrize(("name", "check"), testing.problem_checks(Mine()))
    def test_my_problem_keeps_the_laws(name, check):
        check()

`PROBLEM_LAWS`, `OPTIMIZER_LAWS`, `EFFECT_LAWS`, `FAMILY_LAWS` and `MACHINE_LAWS` are the laws themselves: functions
whose first argument is what is checked. The project holds all that it ships to the same functions.

>>> from calibench import problems, testing
>>> testing.check_problem(problems.make("sensor_zero"))
"""

from calibench.core.lazy import public_names
from calibench.testing.machine import (
    EFFECT_LAWS,
    FAMILY_LAWS,
    MACHINE_LAWS,
    check_effect,
    check_machine,
    effect_checks,
    machine_checks,
)
from calibench.testing.optimizer import OPTIMIZER_LAWS, check_optimizer, optimizer_checks
from calibench.testing.problem import PROBLEM_LAWS, check_problem, problem_checks

__all__ = [
    "EFFECT_LAWS", "FAMILY_LAWS", "MACHINE_LAWS", "OPTIMIZER_LAWS", "PROBLEM_LAWS", "check_effect", "check_machine",
    "check_optimizer", "check_problem", "effect_checks", "machine_checks", "optimizer_checks", "problem_checks",
]  # fmt: skip
__dir__ = public_names(__all__)
