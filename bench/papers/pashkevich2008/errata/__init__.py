"""The errata of Pashkevich et al. 2008, each with the computation that shows it.

For a formula, `printed` is the number that the printed formula gives, `read` the number it must give, and ours what the
corrected formula gives. A new erratum in the data file without its computation here is an error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from calibench.bench.papers.pashkevich2008.errata import formulas, numbers
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Row

Shown = Callable[[Printed, int], Row]


def rows(printed: Printed) -> Iterator[Row]:
    """Yield a row for each erratum of the data file. Raises `ValueError` for one without a computation."""
    for (number, place), (where, show) in zip(printed.errata(), _SHOWN, strict=True):
        if place != where:
            raise ValueError(f"erratum {number + 1} is at {place!r}: its computation is for {where!r}")
        yield show(printed, number)


_SHOWN: tuple[tuple[str, Shown], ...] = (
    ("equation (1)", formulas.equation_1),
    ("section 2.4, after equation (4)", formulas.root),
    ("equation (11), first right-hand side", formulas.first_row),
    ("section 3.4, after equation (14), angles", formulas.angles),
    ("section 3.4, after equation (14), errors of the parameters", numbers.parameter_error),
    ("Table 1, Measurements #1, x_z", numbers.slip("exp1", "rho", numbers.expected1)),
    ("Table 2, Experiment 2, {Delta rho, Delta L}, z_y_plus", numbers.sign("exp2", "full", "exp2_full", "z_y_plus")),
    ("Table 2, Experiment 2, {Delta rho}, y_z_minus", numbers.sign("exp2", "rho", "exp2_rho", "y_z_minus")),
    ("Table 2, Experiment 2, {Delta L}, z_x_plus", numbers.sign("exp2", "L", "exp2_L", "z_x_plus")),
    ("Table 2, Experiment 3, {Delta L}, z_x_plus", numbers.sign("exp3_t2", "L", "exp3_L", "z_x_plus")),
    ("Table 2, Experiment 3, 'Average' of {Delta rho, Delta L}", numbers.average3),
    ("Tables 1 and 2, Experiment 3", numbers.two_sets("exp3", "exp3_t2", "z_y")),
    ("Tables 1 and 2, Experiment 2", numbers.two_sets("exp2", "exp2", "x_y")),
    ("Table 2, heads 'Residuals' and 'Expected improvement'", numbers.heads),
    ("section 4.2, Experiment #2", numbers.less_than),
    ("section 4.2, Experiment #3", numbers.maximum),
    ("Table 2, Experiment 3, 'Exper. data', x_z_minus", numbers.slip("exp3_t2", "full", numbers.expected3)),
    ("Tables 2 and 3 and section 4.2, residual of the full set in Experiment 2", numbers.full_residual),
    ("section 2.3, after (2)", formulas.limits),
    ("section 2.4, after (3)", formulas.signs),
    ("section 2.4, after (4), A, B and C", formulas.pairs),
    ("section 2.4 (second), before (8)", formulas.alpha),
    ("section 3.2, after (11)", formulas.which_model),
    ("section 4.2, Experiment #1", numbers.resolution),
    ("section numbers", numbers.section_numbers),
)
