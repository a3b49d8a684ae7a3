"""Causes that no catalogue has, on three machines: how often a formula is found, is right, and what it removes."""
