"""The base of all packages: registries with checked options, and compilation. It knows no problem and no optimiser."""

from calibench._checkout import one_module

one_module(__name__)
