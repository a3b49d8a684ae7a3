"""The errata of Cong et al. 2008, each with the computation that shows it.

For a formula, `printed` is the number that the printed formula gives, `read` the number it must give, and ours what the
corrected formula gives. A new erratum in the data file without its computation here is an error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from calibench.bench.papers.cong2008.errata import formulas, numbers
from calibench.bench.papers.evidence import Evidence
from calibench.bench.papers.published import Printed
from calibench.bench.papers.row import Row

Shown = Callable[[Printed, Evidence, int], Row]


def rows(printed: Printed, evidence: Evidence) -> Iterator[Row]:
    """Yield a row for each erratum of the data file. Raises `KeyError` for one without a computation."""
    for number, place in printed.errata():
        yield _SHOWN[place](printed, evidence, number)


_SHOWN: Mapping[str, Shown] = {
    "equation (15)": formulas.projector,
    "section 2.4, step 5": formulas.grid,
    "equation (32)": formulas.squares,
    "equation (34)": formulas.passive_angle,
    "equation (35)": formulas.home_angles,
    "section 3.1, after (36)": formulas.equation_36,
    "equation (38), row 1": formulas.first_leg,
    "equation (44)": formulas.decoupled,
    "Table 3, three columns, and Table 4, last column, row la3": numbers.la3,
    "Table 4, column '12 values', rows la1 la2 la3": numbers.from_curve(("la1", "la2", "la3")),
    "Table 4, column '12 values', rows lb2 lb3": numbers.from_curve(("lb2", "lb3")),
    "Tables 3 and 4 against Tables 5 to 7, lb3": numbers.two_machines,
    "Table 6, GA under J1, against section 4.4": numbers.undecidable,
    "section 4.4, end of the text on the figures": numbers.figure,
    "Table 7, row ya2": numbers.ya2,
    "Table 7, kmrmse, and the text below it": numbers.mean_square,
    "section 2.5, initial value of d": numbers.first_d,
    "Table 5, nominal z2": numbers.empty_cell,
    "section 4.4, below Table 7": numbers.largest,
    "section 2.3, before (20)": formulas.components,
    "section 4.4, first paragraph": formulas.indices,
    "section 4.3, after (47)": formulas.uniform,
}
