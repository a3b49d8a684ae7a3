"""Compilation by numba: how, where its results are kept, and trigonometry that keeps its bits."""
