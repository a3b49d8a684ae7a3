"""What every room stands on: names with checked options, and compilation. Knows no problem and no optimiser."""

from calibench._checkout import one_module

one_module(__name__)
