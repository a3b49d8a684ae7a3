"""Tests of one fit: which candidate or smooth term explains its residuals, and whether the stated noise is wrong.

`score` tests all candidates at once (`sums` for very many readings), `smooth_term` tests disagreement that no name of
the catalogue describes, `detectable` computes the smallest size that would be found, `noise_diagnostic` and
`sensor_scale` test the noise of sensors, `confounded` finds parameters of which readings determine only a combination.
`one_reading`, `exact_readings` and `few_equations` write the notes that stand before a verdict, `negative_size` one on
a name whose sign no machine has.
"""
