"""Calibration: fits of models whose readings carry the noise, projections off their Jacobian, fits of few readings.

`fit` is the adjustment, `projection` removes what calibration absorbs, `interval` gives an amplitude with its interval,
`residual_problem` offers a fitted model to the optimisers, `small_sample` and `price_of_adding` are for a handful of
readings.
"""
