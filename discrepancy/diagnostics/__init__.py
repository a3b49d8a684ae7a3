"""Tests of one fit: which candidate or smooth term explains its residuals, and whether the stated noise is wrong.

`score` tests all candidates at once, `smooth_term` tests disagreement that no name of the catalogue describes, `noise`
tests the noise of sensors.
"""
