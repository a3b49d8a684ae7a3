"""Calibration: fits of models whose readings carry the noise, projections off their Jacobian, fits of few readings.

`fit` is the adjustment, `kept` remembers where fits ended, `rank` holds what data cannot determine, `small_sample` is
for a handful of readings.
"""
