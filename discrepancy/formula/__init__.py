"""A formula for an error that no effect of the catalogue explains: its grammar, its search, the effect it becomes."""

from calibench.discrepancy.formula.grammar import Run as Run
from calibench.discrepancy.formula.search import with_formula as with_formula
