"""Checks of measured data, for every machine, before anything is fitted.

`validate` runs all of them, `copies` finds rows that are there twice, `wild` finds numbers far from what the model can
give and the factor that would correct them.
"""
