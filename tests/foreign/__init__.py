"""Machines and causes of which the package knows nothing, and the rates of what is said of them."""
