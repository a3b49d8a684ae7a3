"""Compilation by numba, the cache of its results, and trigonometry with the same bits everywhere."""
