"""Checks of measured data, for every machine, before anything is fitted.

`validate` runs all of them. `entered` checks the columns that any table of readings has (valid, split, poses and
visits, time), `copies` finds rows that are there twice, `wild` finds numbers far from what the model can give and the
factor that would correct them, `unused` finds statements that nothing reads.
`calibench.discrepancy.model.measured` leaves out rows with missing cells.
"""
