"""Tests of one fit: which candidate or smooth term would explain its residuals, and whether the noise is to blame.

`score` tests all candidates at once (`sums` for very many readings), `smooth_term` covers what has no name,
`detectable` tells the smallest size that would be found, `noise_diagnostic` and `sensor_scale` suspect sensors,
`confounded` tells which parameters readings know only together.
"""
