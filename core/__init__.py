"""The base of all packages: registries with checked options, and compilation. It knows no problem and no optimiser."""

if __name__ == "core":  # a short name, in a checkout: nothing, as a module has its whole name alone
    __path__ = []
