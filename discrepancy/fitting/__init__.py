"""Calibration: the fit whose readings carry the noise, projections off its Jacobian, and fits of a handful of readings.

`fit` is the adjustment, `projection` removes what calibration absorbs, `interval` gives a size with its interval,
`residual_problem` offers a fitted model to the optimisers, `small_sample` and `price_of_adding` judge a few numbers.
"""
